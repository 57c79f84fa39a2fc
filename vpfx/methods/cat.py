"""Continuous adaptive terrain (Willis 1996): the adaptive variant of the quaternary method, for morphing without cracks.

Faces that need it are cut in four at the middles of their edges; a face across an edge that is broken so takes the same node,
by rules 1 to 3. So a level can be blended into the next by `z_parent` with no crack on the way. specs/methods.md M-520.
Cost of a pass: O(posts of the faces + n log n).
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
from vpfx.model import CUTS, Hierarchy

__all__ = ["METHOD", "build"]

Faces = NDArray[np.int32]
DEFAULTS: dict[str, Any] = dict(shared.SHARED)


class _Mesh(Refinement):
    """The mesh in the making."""

    def one_pass(self, faces: Faces, bound: float) -> Faces:
        """Cut faces that are off by more than a bound in four, and those across as they have to be; return all children."""
        forest = self.forest
        faces = faces[forest.face_error[faces] > bound]
        sides = self.first_of_twins((3 * faces.astype(np.int64)[:, None] + np.arange(3)).ravel())
        self.break_twins(sides, place_nodes(sides, forest.mesh, self.patch.heights, 0.5, 3))
        to_cut = np.concatenate([faces, self.find_across(faces)])
        return self.cut_at(to_cut, np.full((len(to_cut), 3), np.nan))


def build(patch: Patch, options: Mapping[str, Any]) -> Hierarchy:
    """Build all levels over one patch."""
    mesh = _Mesh(patch, options)
    return build_by_passes(mesh, options, mesh.one_pass)


METHOD = Method(
    name="cat",
    title="continuous adaptive terrain",
    source="Willis 1996, MultiGen; after Abdelguerfi et al. 1998, doi:10.1080/136588198241536, §3",
    adjacent=True,
    nested=True,
    bounded=True,
    tiled=False,
    voids=True,
    cuts=CUTS[:3],
    defaults=DEFAULTS,
    checked=partial(shared.checked, "cat"),
    levels=partial(shared.free_levels, "cat", defaults=DEFAULTS),
    squares=shared.squares,
    build=build,
)
