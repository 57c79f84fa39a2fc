"""`vpfx query` sight and viewshed: what is seen from a place."""

from __future__ import annotations

import json
from pathlib import Path

import click

from vpfx.cli.common import numbers
from vpfx.cli.output import check_output, give, level_flag, read_bbox
from vpfx.cli.query import query
from vpfx.errors import InputError

__all__ = ["sight", "viewshed"]

FORMS = ("geojson", "json")


@query.command()
@click.argument("store", type=click.Path(path_type=Path))
@level_flag
@click.option("--observer", required=True, metavar="X,Y,H", help="Place: x, y in CRS units, metres above the ground.")
@click.option("--target", multiple=True, required=True, metavar="X,Y,H", help="The same; may be given again.")
@click.option("--absolute", is_flag=True, help="H is the height itself, not above the ground.")
@click.option("--curvature", is_flag=True, help="The earth is round, with 7/6 of its radius for the bent light.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def sight(
    store: Path, level: int | None, observer: str, target: tuple[str, ...], absolute: bool, curvature: bool,
    as_json: bool,
) -> None:  # fmt: skip
    """Tell which targets are seen from a place, and where the others are first blocked.

    Prints a line each target: visible, or blocked with x, y (CRS units) and height (metres) of the place.

    Example: vpfx query sight n36.gpkg --observer=-107.66,36.35,1.7 --target=-107.6,36.4,10
    """
    from vpfx.query.sight import line_of_sight
    from vpfx.store.reader import open_reader

    place, targets = numbers(observer, "observer", float), [numbers(text, "target", float) for text in target]
    for text, given in zip((observer, *target), (place, *targets), strict=True):
        if len(given) != 3:
            raise InputError(f"sight: found {text!r}, expected x, y and a height")
    with open_reader(store) as opened:
        number = opened.level_or_finest(level)
        found = line_of_sight(opened, number, place, targets, is_absolute=absolute, curvature=curvature)
    rows = list(zip(found.is_visible.tolist(), found.blocked_at.tolist(), strict=True))
    if as_json:
        told = [{"is_visible": seen, "blocked_at": None if seen else at} for seen, at in rows]
        print(json.dumps({"level": number, "targets": told}, indent=2, allow_nan=False))
        return
    for seen, at in rows:
        print("visible" if seen else f"blocked {' '.join(f'{value:.10g}' for value in at)}")


@query.command()
@click.argument("store", type=click.Path(path_type=Path))
@level_flag
@click.option("--observer", required=True, metavar="X,Y,H", help="Place: x, y in CRS units, metres above the ground.")
@click.option("--target-height", type=float, default=0.0, show_default=True, help="Above the middles of faces, metres.")
@click.option("--reach", type=float, help="Only faces whose middle is no farther away, metres.")
@click.option("--bbox", metavar="X,Y,X,Y", help="Only faces that touch it: min x, min y, max x, max y in CRS units.")
@click.option("--curvature", is_flag=True, help="The earth is round, with 7/6 of its radius for the bent light.")
@click.option("--format", "form", default="geojson", show_default=True, help="geojson (WGS 84) or json (ids of faces).")
@click.option("-o", "--output", metavar="FILE", type=click.Path(path_type=Path), help="File for the answer.")
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
def viewshed(
    store: Path, level: int | None, observer: str, target_height: float, reach: float | None, bbox: str | None,
    curvature: bool, form: str, output: Path | None, overwrite: bool,
) -> None:  # fmt: skip
    """Give the faces whose middle is seen from a place, and those whose is not.

    Example: vpfx query viewshed n36.gpkg --observer=-107.64,36.36,1.7 --reach 2000 -o seen.geojson
    """
    from vpfx.query import sight as asking
    from vpfx.query.region import to_geojson
    from vpfx.store.reader import open_reader

    place = numbers(observer, "observer", float)
    if len(place) != 3:
        raise InputError(f"--observer: found {observer!r}, expected x, y and a height")
    if form not in FORMS:
        raise InputError(f"--format: found {form!r}, expected one of: {', '.join(FORMS)}")
    check_output(output, overwrite, store)
    options = {"observer_height": place[2], "target_height": target_height, "reach": reach, "curvature": curvature}
    with open_reader(store) as opened:
        number = opened.level_or_finest(level)
        found = asking.viewshed(opened, number, place[:2], bbox=read_bbox(bbox), **options)
        seen = found.face_ids[found.is_visible].tolist()
        hidden = found.face_ids[~found.is_visible].tolist()
        document = (
            to_geojson(asking.shown(opened, number, found))
            if form == "geojson"
            else {"level": number, "visible": seen, "hidden": hidden}
        )
    share = f"{len(seen) / max(1, len(found.face_ids)):.1%}"
    give(document, output, f"{len(seen):,} of {len(found.face_ids):,} faces of level {number} are seen, {share}")
