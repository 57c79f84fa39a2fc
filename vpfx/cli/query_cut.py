"""`vpfx query cut`: one TIN of mixed levels, for an eye or a focus."""

from __future__ import annotations

import math
from pathlib import Path

import click

from vpfx.cli.common import numbers, print_table
from vpfx.cli.output import area_flags, check_output, give, read_bbox, read_polygon
from vpfx.cli.query import query
from vpfx.errors import InputError

__all__ = ["cut"]


@query.command()
@click.argument("store", type=click.Path(path_type=Path))
@click.option("--eye", metavar="X,Y,Z", help="Place of an eye: x, y in CRS units, height in metres.")
@click.option("--screen-error", default=2.0, show_default=True, help="Vertical error allowed on its screen, pixels.")
@click.option("--fov", default=60.0, show_default=True, help="Its vertical field of view, degrees.")
@click.option("--screen-height", default=1080, show_default=True, help="Height of its screen, pixels.")
@click.option("--error", type=float, help="Instead of an eye: vertical error allowed, metres; in the polygon if given.")
@click.option("--growth", type=float, help="Metres it may grow by for each metre away.  [default: any error there]")
@click.option("--morph", default=0.25, show_default=True, help="Share of a distance over which a level fades in.")
@area_flags("Only tiles that touch it: min x, min y, max x, max y in CRS units.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
@click.option("-o", "--output", metavar="FILE", type=click.Path(path_type=Path), help="File for the faces, GeoJSON.")
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
def cut(
    store: Path, eye: str | None, screen_error: float, fov: float, screen_height: int, error: float | None,
    growth: float | None, morph: float, bbox: str | None, polygon: str | None, polygon_layer: str | None, as_json: bool,
    output: Path | None, overwrite: bool,
) -> None:  # fmt: skip
    """Cover the ground once with faces of mixed levels, without cracks: coarse where that is enough.

    Prints faces by level, how many of them are pieces that fit a finer neighbour, and the greatest error, metres.

    Example: vpfx query cut n36.gpkg --eye=-107.62,36.37,2600 --screen-error 4
    """
    from vpfx.query.cut import cut as make
    from vpfx.query.region import to_geojson
    from vpfx.store.reader import open_reader

    if eye is not None and polygon is not None:
        raise InputError("cut: found an eye and a polygon, expected --polygon with --error")
    check_output(output, overwrite, store, polygon)
    with open_reader(store) as opened:
        tin = make(
            opened, None if eye is None else numbers(eye, "eye", float), screen_error=screen_error, fov=fov,
            screen_height=screen_height, error=error, focus=read_polygon(opened, polygon, polygon_layer),
            growth=math.inf if growth is None else growth, bbox=read_bbox(bbox), morph=morph,
        )  # fmt: skip
        levels = range(len(opened.levels))
    of = tin.face_attributes
    rows = []
    for level in levels:
        is_here = of["level"] == level
        rows.append(
            (
                level,
                int(is_here.sum()),
                int(of["is_stitched"][is_here].sum()),
                float(of["max_error"][is_here].max(initial=0.0)),
            )
        )
    names = ("level", "faces", "stitched", "max_error")
    if as_json:
        give({"faces": tin.n_face, "levels": [dict(zip(names, row, strict=True)) for row in rows]}, None)
    else:
        texts = [[f"{level}", f"{faces:,}", f"{stitched:,}", f"{worst:.3f}"] for level, faces, stitched, worst in rows]
        print_table([["level", "faces", "stitched", "max error m"], *texts], "text")
    if output is not None:
        give(to_geojson(tin), output, f"{tin.n_face:,} faces")
