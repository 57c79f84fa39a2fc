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

from vpfx.checks import number, whole_number, whole_numbers
from vpfx.errors import InputError, InvariantError
from vpfx.methods import breaks
from vpfx.methods.base import Method, Patch
from vpfx.methods.borders import LevelRule
from vpfx.methods.fit import FitRule, fit_heights
from vpfx.methods.forest import Forest
from vpfx.methods.scan import Candidates, ScanRule, candidates, measure, scan_faces
from vpfx.methods.settle import SettleRule, settle_faces
from vpfx.methods.start import start_mesh
from vpfx.methods.trial import Terms, choose_diagonals
from vpfx.methods.undo import undo_breaks
from vpfx.model import Hierarchy

__all__ = ["METHOD", "build"]

Faces = NDArray[np.int32]
Places = NDArray[np.float64]

ROUNDING = 1e-9  # metres: heights that differ by less are taken as equal in pass mode
LEAST_SHARE = 1e-6  # of an edge: nearer to an end, or to an edge from inside, a node would make a face without area

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
BOUND_SLACK = 1e-6  # the builder works to the bound less this share, so that rounding never shows a post over it
SWEEPS = 2  # through the cuts of a level, to undo needless breaks
FIT_SHARE = 0.98  # of the bound: a fitted node keeps so near to the posts' surface
MOST_LEVELS = 32
MOST_PASSES = 1000  # a level takes 10 to 40; more is a bug

DIAGONALS = {"shorter": 0, "random": 1, "least-error": 2}
DEFAULTS: dict[str, Any] = {
    "max_error": None,
    "passes": None,
    "fit": None,
    "grid": None,
    "tolerance": 0.0,
    "xy_tolerance": 0.0,
    "xy_ratio": 0.1,
    "diagonal": "shorter",
    "start": "grid",
    "start_posts": 200,
}
FITS = {
    "max-error": FitRule(stages=(1.35, 1.15, 1.05, 1.0, 1.0), powers=(0, 2, 4, 6, 8)),
    "rmse": FitRule(stages=(1.0, 1.0, 1.0), powers=(0,)),
}
PASS_OPTIONS = ("tolerance", "xy_tolerance", "xy_ratio")
SQUARE = 72  # posts to a side of a start square if nothing is asked; as many in all where posts are not square


class _Mesh:
    """The mesh in the making over one patch."""

    def __init__(self, patch: Patch, options: Mapping[str, Any]) -> None:
        significant = options["start_posts"] if options["start"] == "delaunay" else 0
        start = start_mesh(patch, *patch.n_square, significant)
        row, col = start.posts[:, 0], start.posts[:, 1]
        nodes = np.stack([col, row, patch.heights[row, col]], axis=1).astype(np.float64)
        self.patch = patch
        self.forest = Forest(nodes, np.ascontiguousarray(start.face_nodes), start.is_filled)
        self.leaves = np.arange(self.forest.n_face, dtype=np.int32)
        self.residual = np.full(patch.heights.shape, np.nan)
        self.diagonal = DIAGONALS[options["diagonal"]]
        self.most_thin = MOST_THIN
        self.fit_rule: FitRule | None = None
        self.least_bound = 16.0 * float(np.spacing(np.fmax.reduce(np.abs(patch.heights), axis=None, initial=0.0)))
        most = max(len(border.rank) for border in patch.borders)
        self.ranks = np.stack([np.pad(b.rank, (0, most - len(b.rank))) for b in patch.borders])

    def terms(self, bound: float) -> tuple[Any, ...]:
        """What cuts have to keep, as kernels take it."""
        return tuple(Terms(self.patch.aspect, bound, self.most_thin, DECAY, self.diagonal, self.patch.seed))

    def scan(self, faces: Faces, threshold: float, rule: ScanRule) -> Candidates:
        """Compare faces with their posts."""
        forest, patch = self.forest, self.patch
        found = candidates(faces, forest.slot)
        scan_faces(
            faces, forest.mesh, patch.heights, self.residual, threshold, patch.aspect, tuple(rule), forest.face_error,
            tuple(found),
        )  # fmt: skip
        return found

    def measure(self) -> tuple[float, float, int]:
        """Compare the leaves that were never scanned with their posts; return the figures of all posts."""
        new = self.leaves[np.isinf(self.forest.face_error[self.leaves])]
        self.scan(new, np.inf, BAND)
        self.forest.slot[new] = -1
        return measure(self.residual, self.patch.is_owned)

    def break_borders(self, faces: Faces, level: int) -> tuple[Faces, Places]:
        """Return the sides of faces that fixed borders break at a level, and their nodes."""
        limits = np.array([b.limit[level] if b.is_fixed else -1 for b in self.patch.borders], np.int64)
        broken: tuple[Faces, Places] = breaks.force_border_breaks(
            faces, self.forest.mesh, self.ranks, limits, self.patch.heights, self.forest.side_state
        )
        return broken

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

    def cut(self, faces: Faces, broken: Faces, first_node: int, bound: float, found: Candidates) -> tuple[Faces, Faces]:
        """Cut at broken sides, and scanned faces without one inside; return the faces cut and their children."""
        forest, patch = self.forest, self.patch
        most = 2 * len(broken) + len(faces)
        to_cut, post = np.empty(most, np.int32), np.empty(most, np.int64)
        n_cut = breaks.list_cuts(faces, broken, first_node, forest.mesh, forest.side_node, tuple(found), to_cut, post)
        to_cut, post = to_cut[:n_cut], post[:n_cut]
        row, col = np.divmod(post[post >= 0], patch.heights.shape[1])
        inner_node = np.where(post >= 0, forest.n_node - (n_cut - len(row)) + np.arange(n_cut), -1).astype(np.int32)
        forest.add_nodes(np.stack([col, row, patch.heights[row, col]], axis=1))
        is_flipped = choose_diagonals(
            to_cut, forest.nodes, forest.face_nodes, forest.side_node, patch.heights, self.terms(bound)
        )
        return to_cut, forest.cut(to_cut, inner_node, is_flipped)

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
        forest = self.forest
        for _ in range(SWEEPS):
            undo_breaks(faces, forest.tree, forest.side_state, forest.face_error, self.patch.heights, self.terms(bound))


def _reach_bound(mesh: _Mesh, level: int, bound: float) -> None:
    """Cut until no post is off by more than the bound and the fixed borders have all nodes of the level; then undo."""
    advice = "its faces get smaller than coordinates can tell apart; give a larger bound"
    too_small = InputError(f"max_error: found {bound:g} m, too small for this DEM: {advice}")
    if bound < mesh.least_bound:
        raise too_small
    bound *= 1.0 - BOUND_SLACK
    try:
        if mesh.fit_rule:
            _fit_to_bound(mesh, level, bound, mesh.fit_rule)
        else:
            mesh.undo(_cut_to_bound(mesh, mesh.leaves, level, bound)[::-1], bound)
    except ZeroDivisionError:  # of a kernel, by the area or the length of nothing
        raise too_small from None


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


def _one_pass(mesh: _Mesh, level: int, options: Mapping[str, Any]) -> None:
    """Look once at every edge and every face, as the paper does."""
    forest, patch, faces = mesh.forest, mesh.patch, mesh.leaves
    tolerance, share = options["tolerance"] + ROUNDING, max(options["xy_ratio"], LEAST_SHARE)
    away = options["xy_tolerance"] / patch.post_metres[1]
    found = mesh.scan(faces, tolerance, ScanRule(band=-1.0, end_share=0.0, inner_share=share, inner_away=away))
    forced, forced_places = mesh.break_borders(faces, level)
    chosen, places = breaks.find_significant(
        faces, forest.mesh, patch.heights, patch.aspect, tolerance, away, share, forest.side_state
    )
    first_node = forest.add_nodes(np.concatenate([forced_places, places]))
    mesh.cut(faces, np.concatenate([forced, chosen]), first_node, np.inf, found)


def checked(options: Mapping[str, Any]) -> dict[str, Any]:
    """Options as plain Python values, each checked by itself; the mode may still be open.

    Raises
    ------
    InputError
        A value makes no sense.
    """
    found = dict(options)
    if options["max_error"] is not None:
        found["max_error"] = _checked_bounds(options)
    if options["passes"] is not None:
        found["passes"] = whole_number(options["passes"], "wynne: passes", 0, MOST_LEVELS - 1)
    for name in PASS_OPTIONS:
        found[name] = number(options[name], f"wynne: {name}", 0, 0.5 if name == "xy_ratio" else np.inf)
    if options["diagonal"] not in [*DIAGONALS]:
        raise InputError(f"wynne: found diagonal {options['diagonal']!r}, expected one of: {', '.join(DIAGONALS)}")
    if options["fit"] not in (None, *FITS):
        raise InputError(f"wynne: found fit {options['fit']!r}, expected one of: {', '.join(FITS)}")
    if options["start"] not in ("grid", "delaunay"):
        raise InputError(f"wynne: found start {options['start']!r}, expected grid or delaunay")
    if options["grid"] is not None:
        found["grid"] = whole_numbers(options["grid"], "wynne: grid", 1)
        if len(found["grid"]) != 2:
            raise InputError(f"wynne: grid: found {found['grid']}, expected columns and rows of squares")
    found["start_posts"] = whole_number(options["start_posts"], "wynne: start_posts", 1)
    return found


def levels(options: Mapping[str, Any]) -> list[LevelRule | None]:
    """Rule of every level for the borders; None for a level that is the start mesh.

    Raises
    ------
    InputError
        Neither or both of max_error and passes are given, or a tolerance of pass mode without passes.
    """
    if (options["max_error"] is None) == (options["passes"] is None):
        raise InputError("wynne: found neither or both of max_error and passes, expected one of them")
    if options["passes"] is None and any(options[name] != DEFAULTS[name] for name in PASS_OPTIONS):
        raise InputError("wynne: found a tolerance of pass mode without passes, expected both or none")
    if options["max_error"] is None and options["fit"] is not None:
        raise InputError("wynne: found fit without max_error, expected both or none")
    if options["max_error"] is not None:
        return [LevelRule(bound * (1.0 - BOUND_SLACK), MIDDLE, 0.0, 0.0, True) for bound in _checked_bounds(options)]
    tolerance, away, share = (options[name] for name in PASS_OPTIONS)
    rule = LevelRule(tolerance + ROUNDING, 0.0, away, max(share, LEAST_SHARE), False)
    return [None, *[rule] * options["passes"]]


def _checked_bounds(options: Mapping[str, Any]) -> list[float]:
    """Bounds as numbers, checked to be positive and falling."""
    given = options["max_error"]
    try:
        bounds = [] if isinstance(given, str) else [float(bound) for bound in given]
    except (TypeError, ValueError):
        bounds = []
    if not 0 < len(bounds) <= MOST_LEVELS or any(not 0 < bound < np.inf for bound in bounds):
        raise InputError(f"wynne: found max_error {given}, expected 1 … {MOST_LEVELS} positive numbers of metres")
    if any(fine >= coarse for coarse, fine in pairwise(bounds)):
        raise InputError(f"wynne: found max_error {given}, expected each smaller than the one before")
    return bounds


def squares(options: Mapping[str, Any], n_row: int, n_col: int, aspect: float) -> tuple[int, int]:
    """Rows and columns of the start grid over n_row × n_col posts: as asked, or squares on the ground (`SQUARE`)."""
    if options["grid"]:
        return options["grid"][1], options["grid"][0]
    side = SQUARE * np.sqrt(aspect)
    n_south, n_east = round((n_row - 1) / side), round((n_col - 1) * aspect / side)
    return min(max(1, n_south), n_row - 1), min(max(1, n_east), n_col - 1)


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
    rules = levels(options)
    mesh = _Mesh(patch, options)
    forest = mesh.forest
    faces, links, filled, measures = [], [], [], []
    for level, rule in enumerate(rules):
        if rule is not None and rule.repeats:
            is_last = level == len(rules) - 1 and not patch.has_more
            mesh.most_thin = LATER_THIN if level else MOST_THIN
            mesh.fit_rule = FITS.get(options["fit"]) if is_last else None
            _reach_bound(mesh, level, _checked_bounds(options)[level])
        elif rule is not None:
            _one_pass(mesh, level, options)
        mesh.leaves, parent = forest.leaves(mesh.leaves)
        if level:
            links.append(np.stack([parent, np.arange(len(parent), dtype=np.int32)], axis=1))
        faces.append(forest.face_nodes[mesh.leaves])
        filled.append(forest.is_filled[mesh.leaves])
        measures.append(mesh.measure())
    errors, squared, posts = zip(*measures, strict=True)
    node_level = np.full(forest.n_node, len(faces), np.int32)  # as long as no face has the node
    for level in reversed(range(len(faces))):
        node_level[faces[level]] = level
    is_used = node_level < len(faces)
    index = (np.cumsum(is_used) - 1).astype(np.int32)
    nodes, level_faces = forest.nodes[: forest.n_node][is_used], tuple(index[level] for level in faces)
    return Hierarchy(
        nodes, node_level[is_used], level_faces, tuple(links), tuple(filled),
        tuple(_checked_bounds(options) if options["passes"] is None else [float("nan")] * len(faces)), errors, squared, posts,
    )  # fmt: skip


METHOD = Method(
    name="wynne",
    title="variant of Scarlatos by Wynne",
    source="Abdelguerfi et al. 1998, doi:10.1080/136588198241536, §5",
    nested=True,
    defaults=DEFAULTS,
    checked=checked,
    levels=levels,
    squares=squares,
    build=build,
)
