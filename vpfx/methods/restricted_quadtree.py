"""Restricted quadtree (von Herzen & Barr 1987): neighbours differ by at most one halving, and faces are drawn without cracks.

Each square is drawn as a fan round its middle, with a face more on each side where the neighbour is finer. specs/methods.md
M-560. Cost of a pass: O(posts + n log n).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from vpfx.methods import options as shared
from vpfx.methods.base import Method, Patch
from vpfx.methods.squares import Drawing, Leaves, build_quadtree, name_places
from vpfx.model import Hierarchy
from vpfx.topology import NONE

__all__ = ["METHOD", "build"]

DEFAULTS: dict[str, Any] = {name: shared.SHARED[name] for name in ("max_error", "passes", "grid", "tolerance")}
ROUND = ((0, 0), (1, 0), (2, 0), (2, 1), (2, 2), (1, 2), (0, 2), (0, 1))  # corners and middles of sides, in half sides


def mend(leaves: Leaves) -> Leaves:
    """Split leaves until none has a neighbour across a side that is more than twice finer."""
    while True:
        is_coarse = np.zeros(len(leaves.x), bool)
        for i, j in ((0.5, -1), (0.5, 1), (-1, 0.5), (1, 0.5)):  # a place just beyond each side
            x = leaves.x + (leaves.size // 2 if i == 0.5 else (leaves.size if i > 0 else -1))
            y = leaves.y + (leaves.size // 2 if j == 0.5 else (leaves.size if j > 0 else -1))
            beside = leaves.find(x, y)
            is_there = beside != NONE
            is_coarse[beside[is_there][leaves.size[beside[is_there]] > 2 * leaves.size[is_there]]] = True
        if not is_coarse.any():
            return leaves
        leaves = leaves.split(is_coarse)


def draw(leaves: Leaves) -> Drawing:
    """Draw each leaf as a fan round its middle."""
    half = leaves.size // 2
    rim = np.stack([np.stack([leaves.x + i * half, leaves.y + j * half], axis=1) for i, j in ROUND], axis=1)
    names = name_places(rim[..., 0], rim[..., 1])
    is_corner = np.isin(names[:, 1::2], np.unique(names[:, ::2]))  # of a finer neighbour
    middle = np.stack([leaves.x + half, leaves.y + half], axis=1)
    corners, kept = [], []
    for side in range(4):
        start, at, end = rim[:, 2 * side], rim[:, 2 * side + 1], rim[:, (2 * side + 2) % 8]
        is_broken = is_corner[:, side][:, None]
        corners += [
            np.stack([start, np.where(is_broken, at, end), middle], axis=1),
            np.stack([at, end, middle], axis=1),
        ]
        kept += [np.ones(len(half), bool), is_corner[:, side]]
    is_kept = np.stack(kept, axis=1)
    return Drawing(np.stack(corners, axis=1)[is_kept], np.nonzero(is_kept)[0])


def build(patch: Patch, options: Mapping[str, Any]) -> Hierarchy:
    """Build all levels over one patch."""
    return build_quadtree(patch, "restricted_quadtree", options, draw, mend)


METHOD = Method(
    name="restricted_quadtree",
    title="restricted quadtree",
    source="von Herzen & Barr 1987, Computer Graphics 21(4) 103–110",
    adjacent=True,
    nested=True,
    bounded=True,
    tiled=False,
    voids=False,
    cuts=(),
    defaults=DEFAULTS,
    checked=partial(shared.checked, "restricted_quadtree"),
    levels=partial(shared.free_levels, "restricted_quadtree", defaults=DEFAULTS),
    squares=shared.squares,
    build=build,
)
