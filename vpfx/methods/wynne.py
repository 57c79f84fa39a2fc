"""The recommended method: the paper's variant of Scarlatos, rules 1 to 4, in two modes.

* Pass mode is the paper to the letter: a start grid, then each pass looks at every edge once for its most significant
  point, and inside the faces with no broken edge; one pass a level.
* Bounded mode repeats guarded passes until no post is off by more than the bound of the level.

The four rules are the only ways to cut (`vpfx.methods.cut`); the modes differ in which edges they break and where
(`vpfx.methods.breaks`). Source: paper-facts §2, design.md §5, specs/methods.md M-100 … M-160.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import InputError, InvariantError
from vpfx.methods import breaks
from vpfx.methods import options as shared
from vpfx.methods.base import Method, Patch
from vpfx.methods.borders import LevelRule
from vpfx.methods.feature_points import FeaturePoints, best_of
from vpfx.methods.fit import FitRule, fit_heights
from vpfx.methods.refine import (
    BOUND_SLACK,
    LEAST_SHARE,
    MOST_PASSES,
    ROUNDING,
    Refinement,
    build_levels,
    reach_bound,
)
from vpfx.methods.scan import Candidates, ScanRule
from vpfx.methods.settle import SettleRule, settle_faces
from vpfx.methods.undo import undo_breaks
from vpfx.model import CUTS, Hierarchy

__all__ = ["METHOD", "build"]

Faces = NDArray[np.int32]
Places = NDArray[np.float64]

# Bounded mode (figures and reasons: specs/methods.md M-140)
GUARD = 0.8  # an edge may break if it is at least this share of the longest edge of both its faces
MIDDLE = 0.4  # a break keeps this share of the edge from both its ends
N_PLACE = 13  # places looked at there
WANTED = 0.5  # a face over the bound wants edges broken by posts that are off by more than this share of the bound
BAND = ScanRule(band=0.45, end_share=0.15, inner_share=1.0, inner_away=0.0)  # rule 4 is never wanted
SETTLE = SettleRule(guard=0.5, middle=0.3, n_place=13, reach=4.0, pair_reach=3.0, rounds=2)
MOST_THIN = 17.0  # settling and undoing leave no child with a greater thinness ...
LATER_THIN = 16.0  # ... at levels after the first, whose faces were cut more often ...
DECAY = 1.25  # ... unless that of the face times this is greater still
SWEEPS = 2  # through the cuts of a level, to undo needless breaks
FIT_SHARE = 0.98  # of the bound: a fitted node keeps so near to the posts' surface

DIAGONALS = {"shorter": 0, "random": 1, "least-error": 2}
DEFAULTS: dict[str, Any] = {
    **shared.SHARED,
    "xy_tolerance": 0.0,
    "xy_ratio": 0.1,
    "fit": None,
    "diagonal": "shorter",
}
FITS = {
    "max-error": FitRule(stages=(1.35, 1.15, 1.05, 1.0, 1.0), powers=(0, 2, 4, 6, 8)),
    "rmse": FitRule(stages=(1.0, 1.0, 1.0), powers=(0,)),
}


class _Mesh(Refinement):
    """The mesh in the making, with what bounded mode does to it."""

    most_thin, decay = MOST_THIN, DECAY

    def __init__(self, patch: Patch, options: Mapping[str, Any]) -> None:
        super().__init__(patch, options, diagonal=DIAGONALS[options["diagonal"]])
        most = max(len(border.rank) for border in patch.borders)
        self.ranks = np.stack([np.pad(b.rank, (0, most - len(b.rank))) for b in patch.borders])

    def break_borders(self, faces: Faces, level: int) -> tuple[Faces, Places]:
        """Return the sides of faces that fixed borders break at a level, and their nodes."""
        limits = np.array([b.limit[level] if b.is_fixed else -1 for b in self.patch.borders], np.int64)
        broken: tuple[Faces, Places] = breaks.force_border_breaks(
            faces, self.forest.mesh, self.ranks, limits, self.patch.heights, self.forest.side_state
        )
        return broken

    def most_significant(self, one: tuple[Faces, Places], other: tuple[Any, Places]) -> tuple[Faces, Places]:
        """Of breaks of the same sides keep those farther from the side; of equals, those of the first."""
        sides, places = np.concatenate([one[0], other[0]]), np.concatenate([one[1], other[1]])
        nodes, face_nodes, _ = self.forest.mesh
        start, end = nodes[face_nodes[sides // 3, sides % 3]], nodes[face_nodes[sides // 3, (sides + 1) % 3]]
        along = (((places - start) * (end - start))[:, :2]).sum(axis=1) / ((end - start)[:, :2] ** 2).sum(axis=1)
        rise = np.abs(places[:, 2] - (start[:, 2] + along * (end[:, 2] - start[:, 2])))
        kept = best_of(sides, rise)
        return sides[kept].astype(np.int32), places[kept]

    def settle(self, faces: Faces, bound: float, found: Candidates) -> tuple[Faces, NDArray[np.bool_]]:
        """Break sides that settle faces; return them, their nodes being the last ones, and which faces are settled."""
        forest = self.forest
        settled = forest.face_error[faces] <= bound
        forest.reserve_nodes(3 * (len(faces) + SETTLE.n_place) + 2)
        broken: Faces = settle_faces(
            faces, forest.n_node, forest.tree, self.patch.heights, self.terms(bound), tuple(SETTLE), forest.side_state,
            forest.face_error, tuple(found), settled,
        )  # fmt: skip
        forest.n_node += len(broken)
        return broken, settled

    def fit(self, faces: Faces, first_node: int, bound: float, powers: tuple[int, ...]) -> None:
        """Fit the heights of nodes to the posts of some leaves: those from the first one on that are on no fixed border."""
        forest = self.forest
        is_free = np.zeros(forest.n_node, bool)
        is_free[forest.face_nodes[faces]] = True
        is_free[:first_node] = False
        last = np.array(self.patch.heights.shape) - 1
        for i, border in enumerate(self.patch.borders):  # south, east, north, west
            if border.is_fixed:
                line = (0, last[1], last[0], 0)[i]
                is_free &= forest.nodes[: forest.n_node, 1 - i % 2] != line
        forest.face_error[: forest.n_face] = np.inf
        nodes, face_nodes, heights = forest.nodes, forest.face_nodes, self.patch.heights
        fit_heights(faces, nodes, face_nodes, heights, is_free, np.array(powers), bound, FIT_SHARE * bound)

    def undo(self, faces: Faces, bound: float) -> None:
        """Undo what turned out needless of the cuts of some faces, in this order."""
        forest, faces = self.forest, np.ascontiguousarray(faces)
        for _ in range(SWEEPS):
            undo_breaks(faces, forest.tree, forest.side_state, forest.face_error, self.patch.heights, self.terms(bound))


def _reach_bound(mesh: _Mesh, level: int, bound: float, fit_rule: FitRule | None) -> None:
    """Cut until no post is off by more than the bound and the fixed borders have all nodes of the level; then undo."""
    with reach_bound(mesh, bound) as inner_bound:
        if fit_rule:
            _fit_to_bound(mesh, level, inner_bound, fit_rule)
        else:
            mesh.undo(_cut_to_bound(mesh, mesh.leaves, level, inner_bound)[::-1], inner_bound)


def _fit_to_bound(mesh: _Mesh, level: int, bound: float, rule: FitRule) -> None:
    """Cut and undo to the bound of each stage, and in between fit the heights of the nodes new at this level."""
    forest = mesh.forest
    first_node = forest.n_node if level else 0
    was_leaf = forest.is_leaf(np.arange(forest.n_face, dtype=np.int32))
    for share, following in pairwise((*rule.stages, 0.0)):
        _cut_to_bound(mesh, forest.leaves(mesh.leaves)[0], level, share * bound)
        is_cut = ~forest.is_leaf(np.arange(forest.n_face, dtype=np.int32))
        is_cut[: len(was_leaf)] &= was_leaf
        mesh.undo(np.flatnonzero(is_cut)[::-1].astype(np.int32), share * bound)
        if following:
            mesh.fit(forest.leaves(mesh.leaves)[0], first_node, bound, rule.powers)


def _cut_to_bound(mesh: _Mesh, faces: Faces, level: int, bound: float) -> Faces:
    """Cut leaves as `_reach_bound` says and return the faces cut, the first ones first."""
    forest, patch = mesh.forest, mesh.patch
    faces_cut: list[Faces] = []
    over, new = faces[forest.face_error[faces] > bound], faces
    for _ in range(MOST_PASSES):
        found = mesh.scan(over, WANTED * bound, BAND)
        forced, places = mesh.break_borders(new, level)
        first_node = forest.add_nodes(places)
        forest.side_node[forced] = np.arange(first_node, forest.n_node)
        settling, settled = mesh.settle(over, bound, found)
        chosen = breaks.choose_breaks(
            over, forest.tree, patch.heights.shape[1], patch.aspect, GUARD, forest.side_state, tuple(found), settled
        )
        forest.add_nodes(breaks.place_nodes(chosen, forest.mesh, patch.heights, MIDDLE, N_PLACE))
        to_cut, new = mesh.cut(over, np.concatenate([forced, settling, chosen]), first_node, bound, found)
        if len(new) == 0:
            if (forest.face_error[over] > bound).any():
                raise InvariantError(f"wynne: level {level}: found a face off by more than {bound} m that nothing cuts")
            return np.concatenate([np.empty(0, np.int32), *faces_cut])
        faces_cut.append(to_cut)
        is_left = (forest.face_error[over] > bound) & forest.is_leaf(over)
        over = np.concatenate([over[is_left], new])
    raise InvariantError(f"wynne: level {level}: found no end after {MOST_PASSES} passes")


def _one_pass(mesh: _Mesh, level: int, options: Mapping[str, Any], points: FeaturePoints | None) -> None:
    """Look once at every edge and every face, as the paper does."""
    forest, patch, faces = mesh.forest, mesh.patch, mesh.leaves
    tolerance, share = options["tolerance"] + ROUNDING, max(options["xy_ratio"], LEAST_SHARE)
    away = options["xy_tolerance"] / patch.post_metres[1]
    rule = ScanRule(band=-1.0, end_share=0.0, inner_share=share, inner_away=away)
    found = mesh.scan(faces, tolerance, rule)
    forced, forced_places = mesh.break_borders(faces, level)
    chosen, places = breaks.find_significant(
        faces, forest.mesh, patch.heights, patch.aspect, tolerance, away, share, forest.side_state
    )
    inside = None
    if points:
        chosen, places = mesh.most_significant((chosen, places), points.find_breaks(tolerance, away, share))
        inside = points.find_inner(found, mesh.residual, tolerance, rule)
    first_node = forest.add_nodes(np.concatenate([forced_places, places]))
    mesh.cut(faces, np.concatenate([forced, chosen]), first_node, np.inf, found, inside)


def checked(options: Mapping[str, Any]) -> dict[str, Any]:
    """Options as plain Python values, each checked by itself; the mode may still be open.

    Raises
    ------
    InputError
        A value makes no sense.
    """
    found = shared.checked("wynne", options)
    shared.chosen("wynne", options, "diagonal", (*DIAGONALS,))
    if options["fit"] is not None:
        shared.chosen("wynne", options, "fit", (*FITS,))
    return found


def levels(options: Mapping[str, Any]) -> list[LevelRule | None]:
    """Rule of every level for the borders; None for a level that is the start mesh.

    Raises
    ------
    InputError
        Neither or both of max_error and passes are given, or an option of the other mode.
    """
    n_level = shared.n_level("wynne", options, DEFAULTS)
    if options["max_error"] is None and options["fit"] is not None:
        raise InputError("wynne: found fit without max_error, expected both or none")
    if options["max_error"] is not None:
        bounds = shared.bounds_of("wynne", options)
        return [LevelRule(bound * (1.0 - BOUND_SLACK), MIDDLE, 0.0, 0.0, True) for bound in bounds]
    tolerance, away, share = (options[name] for name in ("tolerance", "xy_tolerance", "xy_ratio"))
    rule = LevelRule(tolerance + ROUNDING, 0.0, away, max(share, LEAST_SHARE), False)
    return [None, *[rule] * (n_level - 1)]


def build(patch: Patch, options: Mapping[str, Any]) -> Hierarchy:
    """Build all levels over one patch.

    Parameters
    ----------
    patch : Patch
    options : mapping
        All keys of `DEFAULTS`.

    Returns
    -------
    Hierarchy
        Nodes in posts of the patch; faces of each level in the order of their parents.

    Raises
    ------
    InvariantError
        The bound was not reached: a bug.
    """
    mesh = _Mesh(patch, options)
    if options["passes"] is not None:
        bounds = [np.nan] * (1 + options["passes"])
        points = FeaturePoints(patch, mesh.forest) if patch.lines else None
        return build_levels(mesh, bounds, lambda level: _one_pass(mesh, level, options, points) if level else None)
    bounds = shared.bounds_of("wynne", options)

    def refine(level: int) -> None:
        is_last = level == len(bounds) - 1 and not patch.has_more
        mesh.most_thin = LATER_THIN if level else MOST_THIN
        _reach_bound(mesh, level, bounds[level], FITS.get(options["fit"]) if is_last else None)

    return build_levels(mesh, bounds, refine)


METHOD = Method(
    name="wynne",
    title="variant of Scarlatos by Wynne",
    source="Abdelguerfi et al. 1998, doi:10.1080/136588198241536, §5",
    adjacent=True,
    nested=True,
    bounded=True,
    tiled=True,
    voids=True,
    cuts=CUTS[:4],
    defaults=DEFAULTS,
    checked=checked,
    levels=levels,
    squares=shared.squares,
    build=build,
    features="points",
    variants={"": {}, "over Delaunay": {"start": "delaunay"}},
)
