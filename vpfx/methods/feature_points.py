"""Vertices of surveyed lines as further candidates for nodes, beside the posts; specs/methods.md M-155."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

from vpfx.geometry import barycentric
from vpfx.methods.base import Patch
from vpfx.methods.breaks import OPEN
from vpfx.methods.forest import Forest
from vpfx.methods.ground import is_covered
from vpfx.methods.scan import Candidates, ScanRule, heights_at
from vpfx.topology import NONE

__all__ = ["FeaturePoints", "best_of"]

Faces = NDArray[np.int32]
Sides = NDArray[np.int64]
Places = NDArray[np.float64]
Floats = NDArray[np.float64]

BAND = 0.5
"""A point so near an edge counts for the edge, at its foot; heights of a post spacing."""


class FeaturePoints:
    """The vertices of the lines of a patch, and the leaves in which they lie.

    Parameters
    ----------
    patch : Patch
    forest : Forest
        With its start faces only.

    Attributes
    ----------
    places : float64 (n, 3)
        u, v in posts and heights in metres, of the posts' surface where a line has none; those on ground only, each once.
    """

    def __init__(self, patch: Patch, forest: Forest) -> None:
        self._forest, self._aspect = forest, patch.aspect
        places = np.unique(np.concatenate([np.empty((0, 3)), *patch.lines]), axis=0)
        places = places[
            shapely.intersects_xy(shapely.box(0, 0, *np.array(patch.heights.shape)[::-1] - 1), places[:, :2])
        ]
        if not patch.keeps_voids:
            places = places[is_covered(patch.squares, places[:, 0], places[:, 1])]
        height = heights_at(patch.heights, *np.ascontiguousarray(places[:, :2].T))
        places[:, 2] = np.where(np.isnan(places[:, 2]), height, places[:, 2])
        start = shapely.polygons(forest.nodes[forest.face_nodes][:, [0, 1, 2, 0], :2])
        point, face = shapely.STRtree(start).query(shapely.points(places[:, :2]), predicate="intersects")
        known, first = np.unique(point, return_index=True)
        self.places: Places = places[known]
        self._face = face[first].astype(np.int64)

    def _descend(self) -> None:
        """Go on to the leaves."""
        forest = self._forest
        _, _, _, _, first_child, n_child = forest.tree
        while len(inner := np.flatnonzero(n_child[self._face] > 0)):
            face = self._face[inner]
            best, least = face, np.full(len(face), -np.inf)
            for i in range(int(n_child[face].max())):
                child = np.where(i < n_child[face], first_child[face] + i, first_child[face])
                share = self._shares(child, self.places[inner]).min(axis=1)
                best, least = np.where(share > least, child, best), np.maximum(share, least)
            self._face[inner] = best

    def _shares(self, face: NDArray[np.int64], places: Places) -> Floats:
        return barycentric(self._forest.nodes[self._forest.face_nodes[face]], places[:, :2])

    def find_inner(self, found: Candidates, residual: Floats, tolerance: float, rule: ScanRule) -> tuple[Faces, Places]:
        """Find the faces in which a point is off by more than the best post for rule 4, and the places of these points.

        Parameters
        ----------
        found : Candidates
            Of all leaves; where a point is better, the post is taken out.
        residual : float64 (n_row, n_col)
            Errors at the posts, metres.
        tolerance : float
            Points off by no more are not significant, metres.
        rule : ScanRule
            Which points count as inside.
        """
        self._descend()
        face, forest = self._face, self._forest
        share, corner = self._shares(face, self.places), forest.nodes[forest.face_nodes[face]]
        error = np.abs(self.places[:, 2] - (share * corner[..., 2]).sum(axis=1))
        length, area = self._sides(corner)
        is_inner = (share >= rule.inner_share).all(axis=1)
        is_inner &= (share * area[:, None] * self._aspect >= rule.inner_away * length).all(axis=1)
        chosen = best_of(face, error, is_inner & (error > tolerance))
        slot = found.slot[face[chosen]]
        post = found.inner_post[slot]
        is_better = (post == NONE) | (error[chosen] > residual.ravel()[post])
        found.inner_post[slot[is_better]] = NONE
        return face[chosen[is_better]].astype(np.int32), self.places[chosen[is_better]]

    def find_breaks(self, tolerance: float, away: float, share: float) -> tuple[Sides, Places]:
        """Find the sides beside which a point is off, the lower of two twins each, and the feet of the farthest ones.

        Parameters
        ----------
        tolerance, away, share
            As for `vpfx.methods.breaks.find_significant`.
        """
        self._descend()
        face, forest = np.repeat(self._face, 3), self._forest
        i, places = np.tile(np.arange(3), len(self._face)), np.repeat(self.places, 3, axis=0)
        start, end = forest.nodes[forest.face_nodes[face, i]], forest.nodes[forest.face_nodes[face, (i + 1) % 3]]
        to_ground = np.array([self._aspect, 1.0])
        along, to_place = (end - start)[:, :2] * to_ground, (places - start)[:, :2] * to_ground
        length = np.hypot(*along.T)
        at = (along * to_place).sum(axis=1) / length**2
        foot = start + at[:, None] * (end - start)
        distance = np.abs(along[:, 0] * to_place[:, 1] - along[:, 1] * to_place[:, 0]) / length
        error = np.abs(places[:, 2] - foot[:, 2])
        least = np.maximum(share, away / length)
        side = 3 * face + i
        twin = forest.side_twin[side].astype(np.int64)
        side = np.where((twin != NONE) & (twin < side), twin, side)
        is_break = (distance <= BAND) & (at >= least) & (at <= 1.0 - least) & (error > tolerance)
        chosen = best_of(side, error, is_break & (forest.side_state[side] == OPEN))
        return side[chosen], np.column_stack([foot[chosen, :2], places[chosen, 2]])

    def _sides(self, corner: Floats) -> tuple[Floats, Floats]:
        """Lengths of the sides across from each corner, heights of a post spacing, and twice the areas, in posts."""
        across = (np.roll(corner, -2, axis=1) - np.roll(corner, -1, axis=1))[..., :2]
        b, c = (corner[:, k, :2] - corner[:, 0, :2] for k in (1, 2))
        return np.hypot(across[..., 0] * self._aspect, across[..., 1]), b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0]


def best_of(group: NDArray[np.integer], error: Floats, is_wanted: NDArray[np.bool_] | None = None) -> NDArray[np.int64]:
    """Index of the greatest error among the wanted of each group, groups ascending; of equals the first.

    Examples
    --------
    >>> best_of(np.array([7, 2, 7, 2]), np.array([1.0, 5.0, 3.0, 5.0]))
    array([1, 2])
    """
    wanted = np.arange(len(group)) if is_wanted is None else np.flatnonzero(is_wanted)
    order = wanted[np.lexsort((wanted, -error[wanted], group[wanted]))]
    return order[np.unique(group[order], return_index=True)[1]]
