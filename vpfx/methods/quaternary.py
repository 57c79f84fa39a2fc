"""Quaternary cuts: the middles of the three edges are joined, four children.

Selective: only faces that need it are cut, each by itself, so a neighbour that is not cut has a node inside its edge: a
T-junction. Total: all faces of a level are cut as soon as one needs it. Nodes lie on the posts' surface. specs/methods.md
M-510. Cost of a pass: O(posts of the faces + n log n).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vpfx.methods import options as shared
from vpfx.methods.base import Method, Patch
from vpfx.methods.breaks import place_nodes
from vpfx.methods.refine import Refinement, build_by_passes
from vpfx.methods.side_nodes import SideNodes
from vpfx.model import Hierarchy

__all__ = ["METHOD", "build"]

Faces = NDArray[np.int32]
DEFAULTS: dict[str, Any] = {**shared.SHARED, "total": False}


class _Mesh(Refinement):
    """The mesh in the making."""

    def __init__(self, patch: Patch, options: Mapping[str, Any]) -> None:
        super().__init__(patch, options, is_joined=False)
        self.side_nodes = SideNodes(self.forest)
        self.is_total = options["total"]

    def middles(self, sides: NDArray[np.int64]) -> NDArray[np.float64]:
        """Places of the middles of sides, on the posts' surface."""
        places: NDArray[np.float64] = place_nodes(sides, self.forest.mesh, self.patch.heights, 0.5, 3)
        return places

    def one_pass(self, faces: Faces, bound: float) -> Faces:
        """Cut faces that are off by more than a bound, or all leaves as soon as one is; return their children."""
        forest = self.forest
        faces = faces[forest.face_error[faces] > bound]
        if self.is_total and len(faces):
            faces = forest.leaves(self.leaves)[0]
        sides = (3 * faces.astype(np.int64)[:, None] + np.arange(3)).ravel()
        self.side_nodes.break_sides(sides, self.middles)
        return forest.cut(faces, np.full(len(faces), -1, np.int32), np.zeros(len(faces), bool))


def checked(options: Mapping[str, Any]) -> dict[str, Any]:
    """Options as plain Python values, each checked by itself."""
    return shared.checked("quaternary", options) | {"total": bool(options["total"])}


def build(patch: Patch, options: Mapping[str, Any]) -> Hierarchy:
    """Build all levels over one patch."""
    mesh = _Mesh(patch, options)
    return build_by_passes(mesh, options, mesh.one_pass)


METHOD = Method(
    name="quaternary",
    title="quaternary",
    source="Abdelguerfi et al. 1998, doi:10.1080/136588198241536, §3",
    adjacent=False,
    nested=True,
    bounded=True,
    tiled=False,
    voids=True,
    cuts=("three edges",),
    defaults=DEFAULTS,
    checked=checked,
    levels=partial(shared.free_levels, "quaternary", defaults=DEFAULTS),
    squares=shared.squares,
    build=build,
    variants={"selective": {}, "total": {"total": True}},
)
