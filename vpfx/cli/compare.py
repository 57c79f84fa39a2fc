"""`vpfx compare` and `vpfx measure`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click

from vpfx.cli.common import (
    PASSES,
    announce_compilation,
    app,
    check_form,
    feature_flags,
    feature_options,
    given_options,
    print_table,
)
from vpfx.errors import InputError

__all__ = ["compare", "measure"]


@app.command()
@click.argument("dem", nargs=-1, required=True, metavar="DEM...")
@click.option("--methods", default="all", show_default=True, metavar="NAME,…", help="Methods of `vpfx build --method`.")
@click.option("--passes", type=int, help="Pass mode: so many levels after the start grid.  [default: 3]")
@click.option("--max-error", metavar="A,B,…", help="Instead: bound of each level, coarse to fine, metres.")
@click.option("--grid", metavar="9x9", help="Squares of the start grid, columns x rows.")
@click.option("--tolerance", type=float, help="Pass mode: a point off by more is significant, metres.  [default: 0]")
@click.option("--bbox", metavar="X,Y,X,Y", help="Only the posts inside: min x, min y, max x, max y in CRS units.")
@feature_flags("Surveyed lines and areas, for the methods that take some.")
@click.option("--draw", metavar="PICTURE", help="Draw the methods side by side: PNG, PDF or SVG.")
@click.option(
    "--style", default="plan", show_default=True, help="Of that picture: plan, wireframe, shaded, relief, slope, level."
)
@click.option(
    "--curves", metavar="PICTURE", help="Draw errors against faces, with greedy Delaunay insertion for reference."
)
@click.option("--overwrite", is_flag=True, help="Replace existing pictures.")
@click.option("--level", type=int, help="Level that is shown.  [default: the finest]")
@click.option("--format", "form", default="text", show_default=True, help="text, markdown, csv or json (all levels).")
def compare(dem: tuple[str, ...], methods: str, form: str, level: int | None, **values: Any) -> None:
    """Build methods side by side on the same posts and print the paper's table 1, measured.

    Example: vpfx compare n36.dt2 --passes 3 --grid 9x9 --tolerance 5
    """
    announce_compilation(form != "text")
    from vpfx import compare as comparing
    from vpfx import gallery
    from vpfx.dem import read_grid
    from vpfx.dem.reference import unit_metres
    from vpfx.features import read_features
    from vpfx.plot import check_picture

    check_form(form)
    given = given_options(values)
    for name in ("draw", "curves"):
        if given.pop(name, None):
            check_picture(Path(values[name]), values["overwrite"])
    if values["draw"] and values["draw"] == values["curves"]:
        raise InputError(f"--curves: found {values['curves']}, which is the picture of --draw; give another name")
    if values["style"] not in gallery.STYLES:
        raise InputError(f"--style: found {values['style']!r}, expected one of: {', '.join(gallery.STYLES)}")
    for name in ("style", "overwrite"):
        given.pop(name, None)
    if not {"max_error", "passes"} & set(given):
        given["passes"] = PASSES
    bbox, features, how = given.pop("bbox", None), given.pop("features", ()), feature_options(given)
    if how and not features:
        raise InputError("--features: found none, but options of it; give a file")
    last = len(given["max_error"]) - 1 if given.get("max_error") else given["passes"]
    if level is not None and not 0 <= level <= last:
        raise InputError(f"--level: found {level}, expected 0 … {last}")
    grid = read_grid(dem, bbox=bbox)
    lines = read_features(features, grid.crs, grid.extent, **how).lines if features else ()
    names = () if methods == "all" else methods.split(",")
    found = comparing.compare(grid, names, lines=lines, **given)
    left_out = ", ".join(part.name for part in comparing.choose_methods(grid, names, given)[1])
    if left_out:
        print(f"vpfx: left out, as they keep no bound or follow no voids: {left_out}", file=sys.stderr)
    shown = last if level is None else level
    if values["draw"]:
        metres = unit_metres(grid.crs, grid.extent)
        gallery.draw_methods(
            found, values["draw"], level=shown, style=values["style"], metres=metres, overwrite=values["overwrite"]
        )
    if values["curves"]:
        curve = gallery.greedy_curve(grid, found)
        gallery.draw_curves(found, curve, values["curves"], overwrite=values["overwrite"])
    if form == "json":
        print(json.dumps([comparing.to_dict(one) for one in found], indent=2, ensure_ascii=False))
        return
    print_table(comparing.table_1(found, shown), form)


@app.command()
@click.argument("path", type=click.Path(path_type=Path), metavar="STORE|MESH")
@click.option(
    "--level", "levels", type=int, multiple=True, help="Level to measure; may be given again.  [default: all]"
)
@click.option("--dem", multiple=True, metavar="DEM", help="Elevation file to measure errors at; may be given again.")
@click.option("--crs", metavar="EPSG:4326", help="CRS of a mesh, which names none.  [default: that of --dem]")
@click.option("--format", "form", default="text", show_default=True, help="text, markdown, csv or json.")
def measure(path: Path, levels: tuple[int, ...], dem: tuple[str, ...], crs: str | None, form: str) -> None:
    """Measure the levels of a store, or a mesh: T-junctions, slivers, angles, degrees, nesting, cuts, errors.

    A mesh is a PLY, STL, OBJ, OFF or GLB file with places in x and y and heights in z.

    Example: vpfx measure n36.gpkg --dem n36.dt2
    """
    announce_compilation(form != "text")
    from vpfx import measures, report
    from vpfx.dem import read_grid
    from vpfx.dem.reference import parse_crs, unit_metres
    from vpfx.mesh_files import SUFFIXES, read_mesh
    from vpfx.model import Extent
    from vpfx.store.reader import open_reader

    check_form(form)
    grid = read_grid(dem) if dem else None
    if path.suffix.lower() in SUFFIXES:
        if levels:
            raise InputError(f"--level: found {levels[0]}, but {path} is a mesh, which has none; leave it out")
        tin = read_mesh(path)
        wkt = parse_crs(crs).to_wkt() if crs else (grid.crs if grid else "")
        extent = Extent(*tin.nodes[:, :2].min(axis=0), *tin.nodes[:, :2].max(axis=0))
        found = [measures.measure_mesh(tin, unit_metres(wkt, extent), grid)]
    else:
        if crs:
            raise InputError(f"--crs: found {crs}, but {path} is a store, which names its own; leave it out")
        with open_reader(path) as store:
            found = measures.measure_store(store, levels, grid)
    if form == "json":
        print(json.dumps(report.plain(found), indent=2, ensure_ascii=False))
        return
    print_table(report.level_table(found), form)
