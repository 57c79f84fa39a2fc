"""`vpfx query`: questions to a store."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import click

from vpfx.cli.common import app, numbers, read_stdin
from vpfx.errors import InputError, NotFoundError

__all__ = ["at", "nearest", "profile", "query"]


@app.group(no_args_is_help=True)
def query() -> None:
    """Ask a store; nothing is ever written to it."""


@query.command()
@click.argument("store", type=click.Path(path_type=Path))
@click.option("--level", type=int, help="Level to ask.  [default: the finest]")
@click.option(
    "--points", required=True, metavar="FILE|-", help="Places, one a line: x and y in CRS units, by blanks or a comma."
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def at(store: Path, level: int | None, points: str, as_json: bool) -> None:
    """Tell face, height, slope and aspect at places.

    Prints x, y, z, face, slope and aspect, a line each place; a dash where there is no face. --json adds the normal.

    Example: vpfx query at n36.gpkg --level 1 --points places.txt
    """
    from vpfx.query.location import locate
    from vpfx.store.reader import open_reader

    places = _read_places(points)
    with open_reader(store) as opened:
        number = opened.level_or_finest(level)
        found = locate(opened, places, number)
    rows = zip(
        places, found.z.tolist(), found.face_ids.tolist(), found.slope.tolist(), found.aspect.tolist(), strict=True
    )
    told = [
        (x, y, *map(_or_none, (z, None if face < 0 else face, slope, aspect)))
        for (x, y), z, face, slope, aspect in rows
    ]
    if as_json:
        names = ("x", "y", "z", "face", "slope", "aspect")
        points_told = [dict(zip(names, row, strict=True)) for row in told]
        for point, normal in zip(points_told, found.normal.tolist(), strict=True):
            point["normal"] = None if point["face"] is None else normal
        document = {"level": number, "points": points_told}
        print(json.dumps(document, indent=2, ensure_ascii=False))
        return
    for row in told:
        print(" ".join("–" if value is None else f"{value:.10g}" for value in row))


@query.command()
@click.argument("store", type=click.Path(path_type=Path))
@click.option("--level", type=int, help="Level to ask.  [default: the finest]")
@click.option("--line", required=True, metavar="X,Y,X,Y,…", help="Two places or more, in CRS units.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def profile(store: Path, level: int | None, line: str, as_json: bool) -> None:
    """Tell what lies under a line: every face, and distance and height where the line comes in and goes out.

    Prints face, distance in, distance out (CRS units), height in and height out (metres), a line each face.

    Example: vpfx query profile n36.gpkg --line=-107.66,36.35,-107.60,36.40
    """
    from vpfx.query.lines import profile as follow
    from vpfx.store.reader import open_reader

    given = numbers(line, "line", float)
    if len(given) < 4 or len(given) % 2:
        raise InputError(f"--line: found {len(given)} numbers, expected x and y of two places or more")
    with open_reader(store) as opened:
        number = opened.level_or_finest(level)
        found = follow(opened, list(zip(given[::2], given[1::2], strict=True)), number)
    heights = zip(found.start[:, 2].tolist(), found.end[:, 2].tolist(), strict=True)
    rows = zip(found.face_ids.tolist(), found.distance.tolist(), heights, strict=True)
    if as_json:
        pieces = [{"face": face, "distance": distance, "z": z} for face, distance, z in rows]
        print(json.dumps({"level": number, "pieces": pieces}, indent=2))
        return
    for face, distance, z in rows:
        print(face, *(f"{value:.10g}" for value in (*distance, *z)))


@query.command()
@click.argument("store", type=click.Path(path_type=Path))
@click.option("--level", type=int, help="Level to ask.  [default: the finest]")
@click.option(
    "--points", required=True, metavar="FILE|-", help="Places, one a line: x and y in CRS units, by blanks or a comma."
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def nearest(store: Path, level: int | None, points: str, as_json: bool) -> None:
    """Tell the node nearest to each place, seen from above; of several as near the one of least id.

    Prints node, distance (CRS units), x, y and height, a line each place; a dash where there is no node.

    Example: vpfx query nearest n36.gpkg --points places.txt
    """
    from vpfx.query.nearest import nearest_nodes
    from vpfx.store.reader import open_reader

    places = _read_places(points)
    with open_reader(store) as opened:
        number = opened.level_or_finest(level)
        found = nearest_nodes(opened, places, number)
    told = [
        (None if node < 0 else node, *map(_or_none, (distance, *place)))
        for node, distance, place in zip(*(values.tolist() for values in found), strict=True)
    ]
    if as_json:
        names = ("node", "distance", "x", "y", "z")
        document = {"level": number, "points": [dict(zip(names, row, strict=True)) for row in told]}
        print(json.dumps(document, indent=2, ensure_ascii=False))
        return
    for row in told:
        print(" ".join("–" if value is None else f"{value:.10g}" for value in row))


def _or_none(value: float | None) -> Any:
    return None if value is None or math.isnan(value) else value


def _read_places(path: str) -> list[tuple[float, float]]:
    """Read places from a file, or from stdin."""
    if path == "-":
        lines = read_stdin().splitlines()
    else:
        try:
            lines = Path(path).read_text(encoding="utf-8").splitlines()
        except (OSError, UnicodeDecodeError) as error:
            raise NotFoundError(f"{path}: cannot be read as text: {error}") from error
    places = []
    for number, line in enumerate(lines, start=1):
        parts = line.replace(",", " ").split()
        if not parts:
            continue
        try:
            x, y = map(float, parts)
        except ValueError:
            raise InputError(f"{path}: line {number}: found {line[:40]!r}, expected two numbers, x and y") from None
        places.append((x, y))
    return places
