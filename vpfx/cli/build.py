"""`vpfx build`."""

from __future__ import annotations

from typing import Any

import click

from vpfx.cli.common import (
    PASSES,
    announce_compilation,
    app,
    feature_flags,
    feature_options,
    given_options,
    print_json,
    print_levels,
    progress,
)

__all__ = ["build"]

MAX_ERROR = (40.0, 20.0, 10.0, 5.0)  # bounds where none are given, metres
OF_DEM = ("crs", "bbox", "band", "nodata", "vertical_unit", "vertical_datum")  # options of `vpfx.dem.open_dem`


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
@click.option("--split", type=int, help="quadtree: cut a square into so many by so many, 2, 3 or 4.  [default: 2]")
@click.option("--shared-edges", is_flag=True, help="scarlatos: an edge that one face breaks is broken in both.")
@click.option(
    "--start", default="grid", show_default=True, help="Start mesh: grid, or delaunay of the most significant posts."
)
@click.option("--start-posts", default=200, show_default=True, help="Posts of the delaunay start of a tile.")
@feature_flags(
    "Surveyed lines and areas: prescribed edges of constrained_delaunay_pyramid, further points of wynne's passes."
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
    announce_compilation(quiet or as_json)
    from vpfx import pipeline
    from vpfx.methods import METHODS

    given = given_options(values)
    if not {"max_error", "max_faces", "passes"} & set(given):
        part = METHODS.get(values["method"])
        given |= {"max_error": MAX_ERROR} if part is None or part.bounded else {"passes": PASSES}
    dem_options = {name: given.pop(name) for name in OF_DEM if name in given}
    given["feature_options"] = feature_options(given)
    with progress(quiet or as_json) as show:
        report = pipeline.build(dem, output, progress=show, dem_options=dem_options, **given)
    if as_json:
        facts = {"store": str(report.path), "tiles": report.tiles, **report.ground._asdict()}
        print_json(report.levels, report.seconds, facts)
    elif not quiet:
        print_levels(report.levels)
        size = report.path.stat().st_size
        tiles = f"{report.tiles} tile{'s' if report.tiles > 1 else ''}"
        print(f"{report.path}: {size:,} bytes, {report.ground.posts:,} posts, {tiles}, {report.seconds:.1f} s")
