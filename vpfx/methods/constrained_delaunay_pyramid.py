"""Constrained Delaunay pyramid (De Floriani 1989): as the Delaunay pyramid, with prescribed edges at every level.

The edges are those of surveyed lines and outlines of areas: breaklines, shorelines. specs/methods.md M-545.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

from vpfx.errors import InputError
from vpfx.methods import options as shared
from vpfx.methods.base import Method, Patch
from vpfx.methods.lines import node_lines
from vpfx.methods.pyramid import build_pyramid, levels
from vpfx.model import Hierarchy

__all__ = ["METHOD", "build"]


def build(patch: Patch, options: Mapping[str, Any]) -> Hierarchy:
    """Build all levels over one patch.

    Raises
    ------
    InputError
        There are lines, but none on ground with data.
    """
    lines = node_lines(patch)
    if patch.lines and len(lines.nodes) == 0:
        raise InputError("features: found none on ground with data, expected some; a square beside a void has none")
    return build_pyramid(patch, options, lines)


METHOD = Method(
    name="constrained_delaunay_pyramid",
    title="constrained Delaunay pyramid",
    source="De Floriani 1989, IEEE Computer Graphics and Applications 9(2) 67–78",
    adjacent=True,
    nested=False,
    bounded=True,
    tiled=False,
    voids=True,
    cuts=(),
    defaults=shared.SHARED,
    checked=partial(shared.checked, "constrained_delaunay_pyramid"),
    levels=partial(levels, "constrained_delaunay_pyramid"),
    squares=shared.squares,
    build=build,
    features="edges",
)
