"""Ternary cuts (De Floriani 1989): a significant post inside a face is joined to its three corners.

The edges of the start mesh are never broken, so no bound can be held along them; specs/methods.md M-500. Cost of a pass:
O(posts of the faces).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vpfx.methods import options as shared
from vpfx.methods.base import Method, Patch
from vpfx.methods.refine import LEAST_SHARE, NO_SIDES, Refinement, build_by_passes
from vpfx.methods.scan import ScanRule
from vpfx.model import Hierarchy

__all__ = ["METHOD", "build"]

DEFAULTS: dict[str, Any] = {name: value for name, value in shared.SHARED.items() if name != "max_error"} | {
    "xy_tolerance": 0.0,
    "xy_ratio": 0.1,
}


def build(patch: Patch, options: Mapping[str, Any]) -> Hierarchy:
    """Build all levels over one patch: the start mesh, and one a pass."""
    mesh = Refinement(patch, options)
    away = options["xy_tolerance"] / patch.post_metres[1]
    rule = ScanRule(band=-1.0, end_share=0.0, inner_share=max(options["xy_ratio"], LEAST_SHARE), inner_away=away)

    def one_pass(faces: NDArray[np.int32], tolerance: float) -> NDArray[np.int32]:
        found = mesh.scan(faces, tolerance, rule)
        return mesh.cut(faces, NO_SIDES, mesh.forest.n_node, np.inf, found)[1]

    return build_by_passes(mesh, options, one_pass)


METHOD = Method(
    name="ternary",
    title="ternary",
    source="De Floriani 1989, IEEE Computer Graphics and Applications 9(2) 67–78",
    adjacent=True,
    nested=True,
    bounded=False,
    tiled=True,
    voids=True,
    cuts=("centre",),
    defaults=DEFAULTS,
    checked=partial(shared.checked, "ternary"),
    levels=partial(shared.free_levels, "ternary", defaults=DEFAULTS),
    squares=shared.squares,
    build=build,
)
