"""The command line: one function a command, no logic. Data go to stdout, messages to stderr."""

from __future__ import annotations

import io
import json
import re
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from vpfx import __version__
from vpfx.errors import InputError, VpfxError
from vpfx.store.summary import LevelSummary

__all__ = ["app", "main"]

USAGE, FAILURE, INTERRUPTED = 2, 3, 130  # exit codes; 0 is good, 1 is for findings

MAX_ERROR = (40.0, 20.0, 10.0, 5.0)  # bounds where none are given, metres
PASSES = 3  # of methods that hold no bound
OF_DEM = ("crs", "bbox", "band", "nodata", "vertical_unit", "vertical_datum")  # options of `vpfx.dem.open_dem`
OF_FEATURES = {"features_layer": "layer", "features_z": "use_z"}  # options of `vpfx.features.read_features`


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a command; every error is one line on stderr and an exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        code = app.main(arguments, prog_name="vpfx", standalone_mode=False)
    except click.exceptions.NoArgsIsHelpError as error:
        print(error.format_message(), file=sys.stderr)
        sys.exit(USAGE)
    except click.UsageError as error:
        command = error.ctx.command_path if error.ctx else "vpfx"
        _fail(f"{command}: {error.format_message().rstrip('.')}. See: {command} --help", USAGE)
    except InputError as error:
        _fail(f"vpfx: {error}", USAGE)
    except VpfxError as error:
        _fail(f"vpfx: {error}", FAILURE)
    except OSError as error:
        _fail(f"vpfx: cannot write the output: {error}", FAILURE)
    except MemoryError:
        _fail("vpfx: found too little memory; try a smaller --tile-size or fewer --workers", FAILURE)
    except (KeyboardInterrupt, click.Abort):
        _fail("vpfx: interrupted; nothing was changed", INTERRUPTED)
    sys.exit(code or 0)


def _fail(message: str, code: int) -> None:
    print(" ".join(message.split("\n")), file=sys.stderr)
    sys.exit(code)


def _numbers(text: str, name: str, kind: type) -> tuple[Any, ...]:
    """Numbers between commas."""
    try:
        return tuple(kind(part) for part in text.split(","))
    except ValueError:
        wanted = "whole numbers" if kind is int else "numbers"
        raise InputError(f"--{name}: found {text!r}, expected {wanted} between commas") from None


def _given(values: Mapping[str, Any]) -> dict[str, Any]:
    """Options that stand on the command line, as Python values."""
    context = click.get_current_context()
    given = {
        name: value
        for name, value in values.items()
        if context.get_parameter_source(name) is ParameterSource.COMMANDLINE
    }
    for name, kind in (("max_error", float), ("max_faces", int), ("bbox", float)):
        if name in given:
            given[name] = _numbers(given[name], name.replace("_", "-"), kind)
    if "grid" in given:
        given["grid"] = _grid(given["grid"])
    return given


def _grid(text: str) -> tuple[int, int]:
    """Squares of the start grid as COLUMNSxROWS."""
    found = re.fullmatch(r"([1-9][0-9]{0,5})[xX×]([1-9][0-9]{0,5})", text)
    if not found:
        raise InputError(f"--grid: found {text!r}, expected columns x rows, such as 9x9")
    return int(found[1]), int(found[2])


@click.group(no_args_is_help=True)
@click.version_option(__version__, prog_name="vpfx", message="%(prog)s %(version)s")
def app() -> None:
    """Hierarchical TINs from elevation grids, kept as VPF-style primitive tables in one tiled GeoPackage."""


@app.command()
@click.argument("dem", nargs=-1, required=True, metavar="DEM...")
@click.option("-o", "--output", required=True, metavar="STORE.gpkg", help="The store to make.")
@click.option(
    "--method",
    default="wynne",
    show_default=True,
    help="ternary, quaternary, cat, delaunay_pyramid, constrained_delaunay_pyramid, quadtree, restricted_quadtree, "
    "scarlatos, wynne.",
)
@click.option(
    "--max-error", metavar="A,B,…", help="Bound of each level, coarse to fine, metres.  [default: 40,20,10,5]"
)
@click.option(
    "--max-faces",
    metavar="N,M,…",
    help="Instead: budget of faces of each level; the smallest bound that fits is found.",
)
@click.option("--passes", type=int, help="Instead: pass mode, so many levels after the start grid, one pass each.")
@click.option(
    "--fit",
    is_flag=False,
    flag_value="max-error",
    metavar="[max-error|rmse]",
    help="Fit the heights of the last level's nodes within its bound: for a quarter fewer faces, or for the least RMSE.",
)
@click.option("--grid", metavar="9x9", help="Squares of the start grid of a tile, columns x rows.")
@click.option(
    "--tolerance", default=0.0, show_default=True, help="Pass mode: a point off by more is significant, metres."
)
@click.option(
    "--xy-tolerance",
    default=0.0,
    show_default=True,
    help="Pass mode: least distance of a break from both ends, metres.",
)
@click.option("--xy-ratio", default=0.1, show_default=True, help="Pass mode: the same as a share of the edge.")
@click.option(
    "--diagonal",
    default="shorter",
    show_default=True,
    help="Rule 2 takes this diagonal: shorter, random, least-error; with a bound, the other where only that keeps it.",
)
@click.option(
    "--total/--selective",
    help="quaternary: cut all faces as soon as one needs it, or only those that do.  [default: selective]",
)
@click.option("--shared-edges", is_flag=True, help="scarlatos: an edge that one face breaks is broken in both.")
@click.option(
    "--start", default="grid", show_default=True, help="Start mesh: grid, or delaunay of the most significant posts."
)
@click.option("--start-posts", default=200, show_default=True, help="Posts of the delaunay start of a tile.")
@click.option(
    "--features",
    multiple=True,
    metavar="FILE",
    help="Surveyed lines and areas: prescribed edges of constrained_delaunay_pyramid, further points of wynne's passes.",
)
@click.option("--features-layer", metavar="NAME", help="Layer of such a file with several.")
@click.option(
    "--features-z", is_flag=True, help="Their vertices keep their own z, metres, instead of the DEM's heights."
)
@click.option("--seed", default=0, show_default=True, help="Start of all random choices.")
@click.option("--fill", is_flag=True, help="Fill voids by interpolation and mark the faces there.")
@click.option("--crs", metavar="EPSG:4326", help="CRS of files that state none.")
@click.option("--bbox", metavar="X,Y,X,Y", help="Only the posts inside: min x, min y, max x, max y in CRS units.")
@click.option("--band", default=1, show_default=True, help="Band of the raster.")
@click.option("--nodata", type=float, help="Height that marks voids, whatever the file says.")
@click.option("--vertical-unit", metavar="UNIT", help="metre, foot or us_survey_foot, whatever the file says.")
@click.option("--vertical-datum", metavar="NAME", help="Such as EPSG:5773, whatever the file says.")
@click.option("--tile-size", type=int, help="Most post spacings along a side of a tile.  [default: 512]")
@click.option("--workers", type=int, help="Threads that triangulate.  [default: the processors]")
@click.option("--overwrite", is_flag=True, help="Replace an existing store, once the new one is complete.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
@click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors.")
def build(dem: tuple[str, ...], output: str, as_json: bool, quiet: bool, **values: Any) -> None:
    """Turn elevation files into a hierarchical TIN store; several files form a mosaic.

    Example: vpfx build n36.dt2 -o n36.gpkg --max-error 40,20,10,5
    """
    _announce_compilation(quiet or as_json)
    from vpfx import pipeline
    from vpfx.methods import METHODS

    given = _given(values)
    if not {"max_error", "max_faces", "passes"} & set(given):
        part = METHODS.get(values["method"])
        given |= {"max_error": MAX_ERROR} if part is None or part.bounded else {"passes": PASSES}
    dem_options = {name: given.pop(name) for name in OF_DEM if name in given}
    given["feature_options"] = {to: given.pop(name) for name, to in OF_FEATURES.items() if name in given}
    with _progress(quiet or as_json) as progress:
        report = pipeline.build(dem, output, progress=progress, dem_options=dem_options, **given)
    if as_json:
        facts = {"store": str(report.path), "tiles": report.tiles, **report.ground._asdict()}
        _print_json(report.levels, report.seconds, facts)
    elif not quiet:
        _print_levels(report.levels)
        size = report.path.stat().st_size
        tiles = f"{report.tiles} tile{'s' if report.tiles > 1 else ''}"
        print(f"{report.path}: {size:,} bytes, {report.ground.posts:,} posts, {tiles}, {report.seconds:.1f} s")


@app.command()
@click.argument("dem", nargs=-1, required=True, metavar="DEM...")
@click.option("--methods", default="all", show_default=True, metavar="NAME,…", help="Methods of `vpfx build --method`.")
@click.option("--passes", type=int, help="Pass mode: so many levels after the start grid.  [default: 3]")
@click.option("--max-error", metavar="A,B,…", help="Instead: bound of each level, coarse to fine, metres.")
@click.option("--grid", metavar="9x9", help="Squares of the start grid, columns x rows.")
@click.option("--tolerance", type=float, help="Pass mode: a point off by more is significant, metres.  [default: 0]")
@click.option("--bbox", metavar="X,Y,X,Y", help="Only the posts inside: min x, min y, max x, max y in CRS units.")
@click.option("--level", type=int, help="Level that is shown.  [default: the finest]")
@click.option("--format", "form", default="text", show_default=True, help="text, markdown, csv or json (all levels).")
def compare(dem: tuple[str, ...], methods: str, form: str, level: int | None, **values: Any) -> None:
    """Build methods side by side on the same posts and print the paper's table 1, measured.

    Example: vpfx compare n36.dt2 --passes 3 --grid 9x9 --tolerance 5
    """
    _announce_compilation(form != "text")
    from vpfx import compare as comparing
    from vpfx.dem import read_grid

    if form not in (*comparing.FORMATS, "json"):
        raise InputError(f"--format: found {form!r}, expected one of: {', '.join(comparing.FORMATS)}, json")
    given = _given(values)
    if not {"max_error", "passes"} & set(given):
        given["passes"] = PASSES
    grid = read_grid(dem, bbox=given.pop("bbox", None))
    found = comparing.compare(grid, () if methods == "all" else methods.split(","), **given)
    left_out = (set(comparing.METHODS) if methods == "all" else set(methods.split(","))) - {one.method for one in found}
    if left_out:
        print(
            f"vpfx: left out, as they keep no bound or follow no voids: {', '.join(sorted(left_out))}", file=sys.stderr
        )
    last = len(found[0].levels) - 1
    if level is not None and not 0 <= level <= last:
        raise InputError(f"--level: found {level}, expected 0 … {last}")
    if form == "json":
        print(json.dumps([comparing.to_dict(one) for one in found], indent=2, ensure_ascii=False))
        return
    print(comparing.FORMATS[form](comparing.table_1(found, last if level is None else level)).rstrip())


@app.command()
@click.argument("store", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def info(store: Path, as_json: bool) -> None:
    """Tell what a store holds: levels, counts, bounds, measured errors, extent, CRS, sources, size.

    Example: vpfx info n36.gpkg
    """
    started = time.perf_counter()
    from vpfx.store.store import open_store

    with open_store(store) as opened:
        tiles = len(opened.tiles()["tile_id"])
        facts = {
            **opened.metadata, "store": str(store), "bytes": store.stat().st_size, "tiles": tiles,
            "extent": list(opened.extent), "sources": opened.sources,
        }  # fmt: skip
        if as_json:
            _print_json(opened.levels, time.perf_counter() - started, facts)
            return
        _print_levels(opened.levels)
        _print_facts(facts)


@app.command()
@click.argument("store", type=click.Path(path_type=Path))
@click.option(
    "-o", "--output", required=True, metavar="PICTURE", type=click.Path(path_type=Path), help="PNG, PDF or SVG."
)
@click.option("--level", type=int, help="Level to draw.  [default: the finest]")
@click.option(
    "--style", default="shaded", show_default=True,
    help="plan, wireframe, shaded, relief, slope, level, error (with --dem), attribute (with --attribute).",
)  # fmt: skip
@click.option(
    "--dem", multiple=True, metavar="DEM", help="Elevation file the store was built from; may be given again."
)
@click.option("--attribute", metavar="NAME", help="Numbers of the faces to draw: aspect, tile_id, is_filled, …")
@click.option("--bbox", metavar="X,Y,X,Y", help="Only faces that touch it: min x, min y, max x, max y in CRS units.")
@click.option("--overwrite", is_flag=True, help="Replace an existing picture.")
def plot(
    store: Path, output: Path, level: int | None, style: str, dem: tuple[str, ...], attribute: str | None,
    bbox: str | None, overwrite: bool,
) -> None:  # fmt: skip
    """Draw a level of a store, from above or as a view, with scale bar, north and colour bar.

    Example: vpfx plot n36.gpkg --level 2 --style shaded -o n36.png
    """
    from vpfx import plot as plotting
    from vpfx.store.store import open_store

    with open_store(store) as opened:
        number = len(opened.levels) - 1 if level is None else level
        tin = opened.tin(number, None if bbox is None else _numbers(bbox, "bbox", float))
        line, metres = opened.levels[number], plotting.unit_metres(opened.crs, opened.extent)
    values = plotting.find_values(tin, style, dem, attribute)
    bound = "" if line.max_error_bound is None else f", ±{line.max_error_bound:g} m"
    title = f"{store.name}, level {number}{bound}, {tin.n_face:,} faces"
    label = attribute if style == "attribute" and attribute else ""
    plotting.plot_tin(tin, output, style, metres=metres, values=values, title=title, label=label, overwrite=overwrite)
    print(f"{output}: {output.stat().st_size:,} bytes, {title}")


def _print_facts(facts: dict[str, Any]) -> None:
    crs = facts.pop("crs_wkt2")
    options = ", ".join(f"{name}={value}" for name, value in facts.pop("options").items() if value is not None)
    sources = facts.pop("sources")
    lines = [*facts.items(), ("crs", crs.split('"')[1] if '"' in crs else "unknown"), ("options", options)]
    for source in sources:
        size = f"{source['byte_count']} bytes, {source['driver']}"
        lines.append(("source", f"{source['name']}: {size}, sha256 {source['sha256']}"))
    width = max(len(name) for name, _ in lines)
    for name, value in lines:
        print(f"{name:<{width}}  {value}")


def _print_json(levels: Sequence[LevelSummary], seconds: float, facts: dict[str, Any]) -> None:
    document = {**facts, "levels": [line._asdict() for line in levels], "seconds": round(seconds, 3)}
    print(json.dumps(document, indent=2, ensure_ascii=False))


def _print_levels(levels: Sequence[LevelSummary]) -> None:
    table = Table(box=None, pad_edge=False)
    for title in ("level", "bound m", "max error m", "rmse m", "nodes", "edges", "faces"):
        table.add_column(title, justify="right", no_wrap=True)
    for line in levels:
        bound = "–" if line.max_error_bound is None else f"{line.max_error_bound:g}"
        table.add_row(
            str(line.level), bound, f"{line.max_error:.3f}", f"{line.rmse:.3f}", f"{line.nodes:,}", f"{line.edges:,}",
            f"{line.faces:,}",
        )  # fmt: skip
    Console(width=100, highlight=False).print(table)


@contextmanager
def _progress(is_quiet: bool) -> Iterator[Any]:
    """Yield a function that shows tiles done of tiles in all: a bar on a terminal, nothing elsewhere."""
    console = Console(stderr=True)
    if is_quiet or not console.is_terminal:
        yield None
        return
    columns = TextColumn("tiles"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("tiles", total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _announce_compilation(is_quiet: bool) -> None:
    """Say that the first run compiles the kernels, if it will."""
    from vpfx.methods.scan import scan_faces

    cache = Path(scan_faces.stats.cache_path)
    if not is_quiet and not any(cache.glob("scan.scan_faces*.nbi")):
        print("vpfx: compiling kernels, once; later runs start at once", file=sys.stderr)
