"""Hierarchical quadrilaterals: squares cut into 2 × 2, 3 × 3 or 4 × 4 where they need it, each written as two triangles.

Each square by itself, so a finer neighbour leaves nodes inside its sides: T-junctions. specs/methods.md M-550. Cost of a pass:
O(posts + n log n).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from vpfx.checks import whole_number
from vpfx.methods import options as shared
from vpfx.methods.base import Method, Patch
from vpfx.methods.squares import UNITS, Drawing, Leaves, build_quadtree
from vpfx.model import Hierarchy

__all__ = ["METHOD", "build"]

DEFAULTS: dict[str, Any] = {name: shared.SHARED[name] for name in ("max_error", "passes", "grid", "tolerance")} | {
    "split": 2
}


def draw(leaves: Leaves) -> Drawing:
    """Cut each leaf from south-west to north-east: then the halves of a part lie in those of its square."""
    x, y, size = leaves
    sw, se, ne, nw = (np.stack([x + i * size, y + j * size], axis=1) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))
    corners = np.stack([np.stack([sw, se, ne], axis=1), np.stack([sw, ne, nw], axis=1)], axis=1)
    return Drawing(corners.reshape(-1, 3, 2), np.repeat(np.arange(len(x)), 2))


def checked(options: Mapping[str, Any]) -> dict[str, Any]:
    """Options as plain Python values, each checked by itself."""
    split = whole_number(options["split"], "quadtree: split", min(UNITS), max(UNITS))
    return shared.checked("quadtree", options) | {"split": split}


def build(patch: Patch, options: Mapping[str, Any]) -> Hierarchy:
    """Build all levels over one patch."""
    return build_quadtree(patch, "quadtree", options, draw, n_split=options["split"])


METHOD = Method(
    name="quadtree",
    title="hierarchical quadrilaterals",
    source="Abdelguerfi et al. 1998, doi:10.1080/136588198241536, fig. 10",
    adjacent=False,
    nested=True,
    bounded=True,
    tiled=False,
    voids=False,
    cuts=(),
    defaults=DEFAULTS,
    checked=checked,
    levels=partial(shared.free_levels, "quadtree", defaults=DEFAULTS),
    squares=shared.squares,
    build=build,
    variants={"quarters": {}, "ninths": {"split": 3}, "sixteenths": {"split": 4}},
)
