"""Small stores of every kind that queries have to cope with, by name."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from conftest import slow_apart
from surfaces import SOLID, VOIDS, hills, write_dem

import vpfx
from vpfx.cli import main

__all__ = ["KINDS", "MOST", "ask", "build_kind", "clipped"]

KINDS: dict[str, tuple[Any, dict[str, Any]]] = {
    "one tile": (hills(32, 28), {"max_error": (20, 4)}),
    "tiles": (hills(32, 28), {"max_error": (20, 4), "tile_size": 12}),
    "voids in tiles": (VOIDS["ring with island"].heights, {"passes": 2, "tile_size": 8}),
    "T-junctions": (SOLID["cliff"].heights, {"method": "scarlatos", "passes": 3}),
    "pyramid": (hills(30, 30, 3), {"method": "delaunay_pyramid", "max_error": (20, 8, 4)}),
    "steps": (SOLID["steps"].heights, {"max_error": (4, 1), "tile_size": 8}),
}
"""Heights and options of `vpfx.build`; each has at least two levels."""
MOST = slow_apart(KINDS, ["steps"])
"""All of them, for tests whose judges take long."""


def build_kind(name: str, folder: Path) -> Path:
    """Build a store of a kind; return its path."""
    heights, options = KINDS[name]
    return vpfx.build(write_dem(folder / "a.tif", heights), folder / "a.gpkg", **options).path


def clipped(triangle, window):
    """Corners of a triangle cut to a convex, counter-clockwise window, by its sides one after the other."""
    corners = list(triangle)
    for a, b in pairwise([*window, window[0]]):
        kept = []
        for p, q in zip(corners, [*corners[1:], *corners[:1]], strict=True):
            of_p, of_q = ((b[0] - a[0]) * (r[1] - a[1]) - (b[1] - a[1]) * (r[0] - a[0]) for r in (p, q))
            if of_p >= 0:
                kept.append(p)
            if of_p * of_q < 0:
                share = of_p / (of_p - of_q)
                kept.append(tuple(s + share * (t - s) for s, t in zip(p, q, strict=True)))
        corners = kept
    return corners


def ask(capsys: Any, *arguments: Any) -> tuple[int, str, str]:
    """Run `vpfx query`; return exit code, stdout and stderr."""
    with pytest.raises(SystemExit) as ended:
        main(["query", *map(str, arguments)])
    assert isinstance(ended.value.code, int)
    return ended.value.code, *capsys.readouterr()
