"""Scarlatos & Pavlidis 1992: each face by itself takes one of five cuts, as its own posts ask for.

An edge is broken in a face if a post of that face near it is off; a post inside the face is its centre. Cuts: centre; centre
and one edge; one edge; two edges; three edges. The face across may not break the edge: then there is a T-junction. With
shared edges an edge that one face breaks is broken in both. specs/methods.md M-530. Cost of a pass: O(posts of the faces).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vpfx.methods import options as shared
from vpfx.methods.base import Method, Patch
from vpfx.methods.breaks import find_significant, place_nodes
from vpfx.methods.refine import LEAST_SHARE, Refinement, build_by_passes
from vpfx.methods.scan import ScanRule
from vpfx.methods.side_nodes import SideNodes
from vpfx.model import CUTS, Hierarchy
from vpfx.topology import NONE

__all__ = ["METHOD", "build"]

Faces = NDArray[np.int32]
Sides = NDArray[np.int64]
DEFAULTS: dict[str, Any] = {**shared.SHARED, "xy_tolerance": 0.0, "xy_ratio": 0.1, "shared_edges": False}
BAND = 0.5  # posts so near an edge, in heights of a post spacing, ask for it to be broken


class _Mesh(Refinement):
    """The mesh in the making."""

    def __init__(self, patch: Patch, options: Mapping[str, Any]) -> None:
        super().__init__(patch, options, is_joined=options["shared_edges"])
        self.side_nodes = SideNodes(self.forest)
        self.must_cut = options["max_error"] is not None
        self.away = options["xy_tolerance"] / patch.post_metres[1]
        self.share = max(options["xy_ratio"], LEAST_SHARE)

    def one_pass(self, faces: Faces, tolerance: float) -> Faces:
        """Cut faces where they are off by more than a tolerance, towards a bound also through their longest sides."""
        forest = self.forest
        found = self.scan(faces, tolerance, ScanRule(BAND, self.share, self.share, self.away))
        forest.slot[faces] = NONE
        wanting = np.flatnonzero(found.side_error > 0.0)
        wanted = self.first_of_twins(3 * faces[wanting // 3].astype(np.int64) + wanting % 3)
        sides, places = find_significant(
            np.unique(wanted // 3).astype(np.int32), forest.mesh, self.patch.heights, self.patch.aspect, tolerance,
            self.away, self.share, forest.side_state,
        )  # fmt: skip
        is_wanted = np.isin(sides, wanted)
        self._break(sides[is_wanted], places[is_wanted])
        if self.must_cut:
            idle = faces[(self._count_breaks(faces) == 0) & (found.inner_post < 0)]
            sides = self.first_of_twins(self._longest_sides(idle))
            self._break(sides, place_nodes(sides, forest.mesh, self.patch.heights, 0.5, 3))
        n_break = self._count_breaks(faces)
        post = np.where(n_break <= 1, found.inner_post, NONE)
        is_cut = (n_break > 0) | (post != NONE)
        across = self.find_across(faces)
        to_cut = np.concatenate([faces[is_cut], across])
        post = np.concatenate([post[is_cut], np.full(len(across), NONE, np.int64)])
        return self.cut_at(to_cut, self.place_posts(post))

    def _count_breaks(self, faces: Faces) -> NDArray[np.int64]:
        """Count the broken sides of faces."""
        return self.is_broken(faces).sum(axis=1)

    def _longest_sides(self, faces: Faces) -> Sides:
        """Find the longest side of each face, the first of equals."""
        corner = self.forest.nodes[self.forest.face_nodes[faces], :2] * np.array([self.patch.aspect, 1.0])
        square = ((np.roll(corner, -1, axis=1) - corner) ** 2).sum(axis=2)
        return 3 * faces.astype(np.int64) + square.argmax(axis=1)

    def _break(self, sides: Sides, places: NDArray[np.float64]) -> None:
        """Break sides at places, those that are twins on both faces."""
        if self.forest.is_joined:
            self.break_twins(sides, places)
            return
        order = np.argsort(sides)
        self.side_nodes.break_sides(sides, lambda some: places[order][np.searchsorted(sides[order], some)])


def checked(options: Mapping[str, Any]) -> dict[str, Any]:
    """Options as plain Python values, each checked by itself."""
    return shared.checked("scarlatos", options) | {"shared_edges": bool(options["shared_edges"])}


def build(patch: Patch, options: Mapping[str, Any]) -> Hierarchy:
    """Build all levels over one patch."""
    mesh = _Mesh(patch, options)
    return build_by_passes(mesh, options, mesh.one_pass)


METHOD = Method(
    name="scarlatos",
    title="Scarlatos",
    source="Scarlatos & Pavlidis 1992, CVGIP: Graphical Models and Image Processing 54(2) 147–161",
    adjacent=False,
    nested=True,
    bounded=True,
    tiled=False,
    voids=True,
    cuts=CUTS,
    defaults=DEFAULTS,
    checked=checked,
    levels=partial(shared.free_levels, "scarlatos", defaults=DEFAULTS),
    squares=shared.squares,
    build=build,
    variants={"by itself": {}, "shared edges": {"shared_edges": True}},
)
