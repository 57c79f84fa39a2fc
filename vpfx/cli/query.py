"""`vpfx query`: questions to a store."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import click

from vpfx.cli.common import app
from vpfx.errors import InputError, NotFoundError

__all__ = ["at", "query"]


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

    Prints x, y, z, face, slope and aspect, a line each place; a dash where there is no face.

    Example: echo -107.62 36.37 | vpfx query at n36.gpkg --level 1 --points -
    """
    from vpfx.query.location import locate
    from vpfx.store.store import open_store

    places = _read_places(points)
    with open_store(store) as opened:
        number = len(opened.levels) - 1 if level is None else level
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
        lines = sys.stdin.read().splitlines()
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
