"""Delaunay pyramid (De Floriani 1989): each level the Delaunay triangulation of a growing set of posts.

specs/methods.md M-540.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

from vpfx.methods import options as shared
from vpfx.methods.base import Method, Patch
from vpfx.methods.lines import NO_LINES
from vpfx.methods.pyramid import build_pyramid, levels
from vpfx.model import Hierarchy

__all__ = ["METHOD", "build"]


def build(patch: Patch, options: Mapping[str, Any]) -> Hierarchy:
    """Build all levels over one patch."""
    return build_pyramid(patch, options, NO_LINES)


METHOD = Method(
    name="delaunay_pyramid",
    title="Delaunay pyramid",
    source="De Floriani 1989, IEEE Computer Graphics and Applications 9(2) 67–78",
    adjacent=True,
    nested=False,
    bounded=True,
    tiled=True,
    voids=True,
    cuts=(),
    defaults=shared.SHARED,
    checked=partial(shared.checked, "delaunay_pyramid"),
    levels=partial(levels, "delaunay_pyramid"),
    squares=shared.squares,
    build=build,
)
