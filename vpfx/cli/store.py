"""`vpfx info` and `vpfx plot`."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import click

from vpfx.cli.common import app, numbers, print_json, print_levels

__all__ = ["info", "plot"]


@app.command()
@click.argument("store", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def info(store: Path, as_json: bool) -> None:
    """Tell what a store holds: levels, counts, bounds, measured errors, extent, CRS, sources, size.

    Example: vpfx info n36.gpkg
    """
    started = time.perf_counter()
    from vpfx.store.reader import open_reader

    with open_reader(store) as opened:
        tiles = len(opened.tiles()["tile_id"])
        facts = {
            **opened.metadata, "store": str(store), "bytes": store.stat().st_size, "tiles": tiles,
            "extent": list(opened.extent), "sources": opened.sources,
        }  # fmt: skip
        if as_json:
            print_json(opened.levels, time.perf_counter() - started, facts)
            return
        print_levels(opened.levels)
        _print_facts(facts)


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
    from vpfx.dem.reference import unit_metres
    from vpfx.store.reader import open_reader

    with open_reader(store) as opened:
        number = opened.level_or_finest(level)
        tin = opened.tin(number, None if bbox is None else numbers(bbox, "bbox", float))
        line, metres = opened.levels[number], unit_metres(opened.crs, opened.extent)
    values = plotting.find_values(tin, style, dem, attribute)
    bound = "" if line.max_error_bound is None else f", ±{line.max_error_bound:g} m"
    title = f"{store.name}, level {number}{bound}, {tin.n_face:,} faces"
    label = attribute if style == "attribute" and attribute else ""
    plotting.plot_tin(tin, output, style, metres=metres, values=values, title=title, label=label, overwrite=overwrite)
    print(f"{output}: {output.stat().st_size:,} bytes, {title}")
