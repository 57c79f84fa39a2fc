"""`vpfx query` region, range, contours and volume: questions about parts of a level."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from vpfx.cli.common import numbers, print_table
from vpfx.cli.output import area_flags, check_output, give, level_flag, read_bbox, read_polygon
from vpfx.cli.query import query
from vpfx.errors import InputError

__all__ = ["contours", "height_range", "region", "volume"]

FORMS = ("geojson", "table", "json")
TITLES = ("face", "tile", "is_filled", "slope", "aspect")


@query.command()
@click.argument("store", type=click.Path(path_type=Path))
@level_flag
@area_flags("Faces that touch it: min x, min y, max x, max y in CRS units.")
@click.option("--tile", type=int, help="Faces of this tile.")
@click.option("--format", "form", default="table", show_default=True, help="table, json, or geojson (WGS 84).")
@click.option("-o", "--output", metavar="FILE", type=click.Path(path_type=Path), help="File for the answer.")
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
def region(
    store: Path, level: int | None, bbox: str | None, polygon: str | None, polygon_layer: str | None, tile: int | None,
    form: str, output: Path | None, overwrite: bool,
) -> None:  # fmt: skip
    """Give the faces of a level that touch a rectangle or a polygon, or are of a tile; all that is given must hold.

    Example: vpfx query region n36.gpkg --level 1 --bbox=-107.66,36.35,-107.64,36.37 --format geojson
    """
    from vpfx.query import region as asking
    from vpfx.store.reader import open_reader

    if form not in FORMS:
        raise InputError(f"--format: found {form!r}, expected one of: {', '.join(FORMS)}")
    check_output(output, overwrite, store, polygon)
    with open_reader(store) as opened:
        number, area = opened.level_or_finest(level), read_polygon(opened, polygon, polygon_layer)
        tin = asking.region(opened, number, bbox=read_bbox(bbox), polygon=area, tile_id=tile)
        ids: Any = tin.face_attributes.get("face_id", [])
        rows = asking.rows_as_dicts(opened.fetch("face", ids)) if form != "geojson" else []
    told = f"{tin.n_face:,} faces of level {number}"
    if form == "geojson":
        give(asking.to_geojson(tin), output, told)
    elif form == "json":
        give({"level": number, "faces": rows}, output, told)
    else:
        give(_aligned([[_text(row[name]) for name in TITLES] for row in rows]), output, told)


def _text(value: Any) -> str:
    return "–" if value is None else f"{value:.10g}" if not isinstance(value, bool) else str(value).lower()


def _aligned(rows: list[list[str]]) -> str:
    """Rows under their titles, to the right."""
    widths = [max(map(len, column)) for column in zip(TITLES, *rows, strict=True)]
    return "\n".join("  ".join(map(str.rjust, row, widths)) for row in ([*TITLES], *rows))


@query.command("range")
@click.argument("store", type=click.Path(path_type=Path))
@level_flag
@area_flags("Only within: min x, min y, max x, max y in CRS units.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def height_range(
    store: Path, level: int | None, bbox: str | None, polygon: str | None, polygon_layer: str | None, as_json: bool
) -> None:
    """Tell the lowest and the highest place of the surface within a rectangle and a polygon.

    Prints x, y (CRS units) and height (metres) of each; a dash where there is no ground.

    Example: vpfx query range n36.gpkg --bbox=-107.66,36.35,-107.64,36.37
    """
    from vpfx.query.region import elevation_range
    from vpfx.report import plain
    from vpfx.store.reader import open_reader

    with open_reader(store) as opened:
        number, area = opened.level_or_finest(level), read_polygon(opened, polygon, polygon_layer)
        found = elevation_range(opened, number, bbox=read_bbox(bbox), polygon=area)
    places = {name: plain(place.tolist()) for name, place in found._asdict().items()}
    if as_json:
        give({"level": number, **{k: dict(zip("xyz", place, strict=True)) for k, place in places.items()}}, None)
        return
    for name, place in places.items():
        print(f"{name:<7}", *map(_text, place))


@query.command()
@click.argument("store", type=click.Path(path_type=Path))
@level_flag
@click.option("--heights", metavar="Z,Z,…", help="Heights, metres.")
@click.option("--interval", type=float, help="Instead: every multiple of it that the ground reaches, metres.")
@click.option("--bbox", metavar="X,Y,X,Y", help="Lines are cut off at it: min x, min y, max x, max y in CRS units.")
@click.option("-o", "--output", metavar="FILE", type=click.Path(path_type=Path), help="File for the GeoJSON.")
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
def contours(
    store: Path, level: int | None, heights: str | None, interval: float | None, bbox: str | None, output: Path | None,
    overwrite: bool,
) -> None:  # fmt: skip
    """Give the contours of a level as GeoJSON (WGS 84): joined lines across tiles, higher ground to their left.

    Example: vpfx query contours n36.gpkg --interval 20 -o contours.geojson
    """
    from vpfx.query import contours as asking
    from vpfx.query.region import region as faces_in
    from vpfx.store.reader import open_reader

    if (heights is None) == (interval is None):
        raise InputError("contours: found heights and an interval, or neither, expected --heights or --interval")
    check_output(output, overwrite, store)
    box = read_bbox(bbox)
    with open_reader(store) as opened:
        number = opened.level_or_finest(level)
        if heights is not None:
            wanted: Any = numbers(heights, "heights", float)
        else:
            wanted = asking.even_heights(faces_in(opened, number, bbox=box), interval or 0.0)
        found = asking.contours(opened, number, wanted, bbox=box)
        document = asking.to_geojson(found, opened.crs)
    count = sum(len(contour.lines.geoms) for contour in found)
    give(document, output, f"{count:,} lines at {len(found):,} heights of level {number}")


@query.command()
@click.argument("store", type=click.Path(path_type=Path))
@level_flag
@area_flags()
@click.option("--plane", metavar="Z|A,B,C", help="Reference: a height, metres, or the plane A + B·x + C·y.")
@click.option("--other-level", type=int, help="Instead: the surface of this level.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def volume(
    store: Path, level: int | None, polygon: str | None, polygon_layer: str | None, plane: str | None,
    other_level: int | None, as_json: bool,
) -> None:  # fmt: skip
    """Tell area, surface area, and the volumes above (cut) and below (fill) a plane or another level, within a polygon.

    Example: vpfx query volume n36.gpkg --plane 2000
    """
    from vpfx.query.volumes import volume as measure
    from vpfx.store.reader import open_reader

    given: Any = None if plane is None else numbers(plane, "plane", float)
    with open_reader(store) as opened:
        number, area = opened.level_or_finest(level), read_polygon(opened, polygon, polygon_layer)
        given = given[0] if given is not None and len(given) == 1 else given
        found = measure(opened, number, area, plane=given, other_level=other_level)
    if as_json:
        give({"level": number, **found._asdict()}, None)
        return
    titles = ("area", "m²"), ("surface area", "m²"), ("cut", "m³"), ("fill", "m³"), ("net", "m³")
    print_table([[title, unit, f"{value:,.3f}"] for (title, unit), value in zip(titles, found, strict=True)], "text")
