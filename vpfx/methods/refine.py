"""Cutting a start mesh again and again: what all methods have in common that do so.

A method says how one level is reached from the one before; `build_levels` makes a hierarchy of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import InputError, InvariantError
from vpfx.geometry import heights_on_faces
from vpfx.methods import breaks
from vpfx.methods.base import Patch
from vpfx.methods.cut import count_cuts
from vpfx.methods.forest import Forest
from vpfx.methods.scan import PLAIN, Candidates, ScanRule, candidates, find_worst, measure, scan_faces
from vpfx.methods.start import start_mesh
from vpfx.methods.trial import Terms, choose_diagonals
from vpfx.model import Hierarchy
from vpfx.topology import NONE

__all__ = [
    "BOUND_SLACK",
    "LEAST_SHARE",
    "MOST_PASSES",
    "NO_SIDES",
    "ROUNDING",
    "Refinement",
    "build_by_passes",
    "build_levels",
    "heights_before",
    "reach_bound",
    "repeat_passes",
]

Faces = NDArray[np.int32]
Sides = NDArray[np.int64]
Places = NDArray[np.float64]

ROUNDING = 1e-9  # metres: heights that differ by less are taken as equal in pass mode
LEAST_SHARE = 1e-6  # of an edge: nearer to an end, or to an edge from inside, a node would make a face without area
BOUND_SLACK = 1e-6  # the builder works to the bound less this share, so that rounding never shows a post over it
MOST_PASSES = 1000  # a level takes 10 to 40; more is a bug
NO_SIDES = np.empty(0, np.int32)


class Refinement:
    """The mesh in the making over one patch.

    Parameters
    ----------
    patch : Patch
    options : mapping
        With start and start_posts of `vpfx.methods.options.SHARED`.
    is_joined : bool
        Whether a face knows its neighbours; else each is cut by itself.
    diagonal : int
        As for `vpfx.methods.cut.choose_diagonal`.
    """

    most_thin, decay = np.inf, np.inf

    def __init__(self, patch: Patch, options: Mapping[str, Any], is_joined: bool = True, diagonal: int = 0) -> None:
        significant = options["start_posts"] if options["start"] == "delaunay" else 0
        start = start_mesh(patch, *patch.n_square, significant)
        self.patch = patch
        self.forest = Forest(start.nodes, np.ascontiguousarray(start.face_nodes), start.is_filled, is_joined)
        self.leaves = np.arange(self.forest.n_face, dtype=np.int32)
        self.residual = np.full(patch.heights.shape, np.nan)
        self.diagonal = diagonal
        self.least_bound = 16.0 * float(np.spacing(np.fmax.reduce(np.abs(patch.heights), axis=None, initial=0.0)))

    def terms(self, bound: float) -> tuple[Any, ...]:
        """What cuts have to keep, as kernels take it."""
        return tuple(Terms(self.patch.aspect, bound, self.most_thin, self.decay, self.diagonal, self.patch.seed))

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
        forest = self.forest
        new = self.leaves[np.isinf(forest.face_error[self.leaves])]
        self.scan(new, np.inf, PLAIN)
        forest.slot[new] = -1
        if not forest.is_joined:
            find_worst(self.leaves, forest.nodes, forest.face_nodes, self.patch.heights, self.residual)
        return measure(self.residual, self.patch.is_owned)

    def first_of_twins(self, sides: Sides) -> Sides:
        """Put the lower of two twins in the place of either, each once."""
        twin = self.forest.side_twin[sides]
        return np.unique(np.where((twin != NONE) & (twin < sides), twin, sides))

    def break_twins(self, sides: Sides, places: Places) -> None:
        """Break sides, and their twins, at places."""
        forest = self.forest
        first_node = forest.add_nodes(places)
        node, twin = np.arange(first_node, forest.n_node, dtype=np.int32), forest.side_twin[sides]
        forest.side_node[sides] = node
        forest.side_node[twin[twin != NONE]] = node[twin != NONE]

    def is_broken(self, faces: Faces) -> NDArray[np.bool_]:
        """Tell which sides of faces are broken, (n, 3)."""
        broken: NDArray[np.bool_] = self.forest.side_node[3 * faces[:, None] + np.arange(3)] != NONE
        return broken

    def find_across(self, faces: Faces) -> Faces:
        """Find the other faces at the broken sides of some faces."""
        twin = self.forest.side_twin[(3 * faces[:, None] + np.arange(3))[self.is_broken(faces)]]
        return np.setdiff1d(twin[twin != NONE] // 3, faces).astype(np.int32)

    def cut(
        self, faces: Faces, broken: Faces, first_node: int, bound: float, found: Candidates,
        inside: tuple[Faces, Places] | None = None,
    ) -> tuple[Faces, Faces]:  # fmt: skip
        """Cut at broken sides, and scanned faces without one inside; return the faces cut and their children.

        Parameters
        ----------
        faces, found
            What was scanned.
        broken : int32 (n,)
            Sides; their nodes are counted from `first_node`.
        inside : tuple of int32 (n,) and float64 (n, 3), optional
            Further faces, and places inside, at which those are cut that have no broken side.
        """
        forest = self.forest
        most = 2 * len(broken) + len(faces)
        to_cut, post = np.empty(most, np.int32), np.empty(most, np.int64)
        n_cut = breaks.list_cuts(faces, broken, first_node, forest.mesh, forest.side_node, tuple(found), to_cut, post)
        faces, places = to_cut[:n_cut], self.place_posts(post[:n_cut])
        if inside is not None:
            is_whole = ~self.is_broken(inside[0]).any(axis=1)
            faces, places = np.append(faces, inside[0][is_whole]), np.concatenate([places, inside[1][is_whole]])
        return faces, self.cut_at(faces, places, bound)

    def place_posts(self, post: NDArray[np.int64]) -> Places:
        """Return the places of posts, NaN for post -1."""
        heights = self.patch.heights
        row, col = np.divmod(post, heights.shape[1])
        return np.where((post >= 0)[:, None], np.stack([col, row, heights[row, col]], axis=1), np.nan)

    def cut_at(self, faces: Faces, places: Places, bound: float = np.inf) -> Faces:
        """Cut faces by the breaks they have and at a place inside, NaN for none; return their children."""
        forest, patch = self.forest, self.patch
        has_place = ~np.isnan(places[:, 0])
        inner_node = np.where(has_place, forest.n_node + np.cumsum(has_place) - 1, -1).astype(np.int32)
        forest.add_nodes(places[has_place])
        is_flipped = choose_diagonals(
            faces, forest.nodes, forest.face_nodes, forest.side_node, patch.heights, self.terms(bound)
        )
        return forest.cut(faces, inner_node, is_flipped)


@contextmanager
def reach_bound(mesh: Refinement, bound: float) -> Iterator[float]:
    """Give the bound to work to, and refuse one that is too small for the heights or the coordinates.

    Raises
    ------
    InputError
        The bound is below the rounding of heights, or faces got too small on the way.
    """
    advice = "its faces get smaller than coordinates can tell apart; give a larger bound"
    too_small = InputError(f"max_error: found {bound:g} m, too small for this DEM: {advice}")
    if bound < mesh.least_bound:
        raise too_small
    try:
        yield bound * (1.0 - BOUND_SLACK)
    except ZeroDivisionError:  # of a kernel, by the area or the length of nothing
        raise too_small from None


def repeat_passes(mesh: Refinement, level: int, bound: float, one_pass: Callable[[Faces, float], Faces]) -> None:
    """Make passes over the leaves that are off by more than a bound until there are none.

    Parameters
    ----------
    one_pass : callable
        ``one_pass(faces, bound)`` cuts every one of the faces, in some way, and returns all children.
    """
    forest = mesh.forest
    with reach_bound(mesh, bound) as inner_bound:
        new = mesh.leaves
        for _ in range(MOST_PASSES):
            unknown = new[np.isinf(forest.face_error[new])]
            mesh.scan(unknown, np.inf, PLAIN)
            forest.slot[unknown] = -1
            over = new[forest.face_error[new] > inner_bound]
            if len(over) == 0:
                return
            new = one_pass(over, inner_bound)
            if forest.is_leaf(over).any():
                raise InvariantError(f"level {level}: found a face off by more than {bound} m that nothing cuts")
    raise InvariantError(f"level {level}: found no end after {MOST_PASSES} passes")


def build_levels(mesh: Refinement, bounds: Sequence[float], refine: Callable[[int], None]) -> Hierarchy:
    """Build all levels of a mesh.

    Parameters
    ----------
    bounds : sequence of float
        Bound of each level, metres; NaN for none.
    refine : callable
        ``refine(level)`` cuts the leaves on the way to a level.

    Returns
    -------
    Hierarchy
        Nodes in posts of the patch; faces of each level in the order of their parents.
    """
    forest = mesh.forest
    faces, links, filled, measures, cuts = [], [], [], [], []
    for level in range(len(bounds)):
        refine(level)
        mesh.leaves, parent = forest.leaves(mesh.leaves)
        if level:
            links.append(np.stack([parent, np.arange(len(parent), dtype=np.int32)], axis=1))
        faces.append(forest.face_nodes[mesh.leaves])
        filled.append(forest.is_filled[mesh.leaves])
        measures.append(mesh.measure())
        cuts.append(count_cuts(*forest.tree[3:], forest.n_face))
    errors, squared, posts = zip(*measures, strict=True)
    node_level = np.full(forest.n_node, len(faces), np.int32)  # as long as no face has the node
    for level in reversed(range(len(faces))):
        node_level[faces[level]] = level
    is_used = node_level < len(faces)
    index = (np.cumsum(is_used) - 1).astype(np.int32)
    nodes, node_level = forest.nodes[: forest.n_node][is_used], node_level[is_used]
    level_faces = tuple(index[level] for level in faces)
    return Hierarchy(
        nodes, node_level, level_faces, tuple(links), tuple(filled), tuple(bounds), errors, squared, posts,
        node_z_parent=heights_before(nodes, node_level, level_faces, links),
        cuts=np.diff(np.array(cuts), axis=0, prepend=0),
    )  # fmt: skip


def build_by_passes(
    mesh: Refinement, options: Mapping[str, Any], one_pass: Callable[[Faces, float], Faces]
) -> Hierarchy:
    """Build all levels of a mesh by passes: as many as it takes towards a bound, else one a level after the start mesh.

    Parameters
    ----------
    options : mapping
        With passes and tolerance, and max_error if the method can hold one.
    one_pass : callable
        ``one_pass(faces, bound)`` cuts those of the leaves that are off by more than the bound and returns all children.
    """
    bounds, passes = options.get("max_error"), options["passes"]

    def refine(level: int) -> None:
        if bounds is not None:
            repeat_passes(mesh, level, bounds[level], one_pass)
        elif level:
            one_pass(mesh.leaves, options["tolerance"] + ROUNDING)

    return build_levels(mesh, bounds if bounds is not None else [np.nan] * (1 + passes), refine)


def heights_before(
    nodes: Places, node_level: Faces, level_faces: Sequence[Faces], links: Sequence[Faces]
) -> NDArray[np.float64]:
    """Height of the surface of the level before at each node, metres; NaN for nodes of level 0."""
    found = np.full(len(nodes), np.nan)
    for level in range(1, len(level_faces)):
        faces = level_faces[level]
        corner = np.flatnonzero(node_level[faces.ravel()] == level)
        node, first = np.unique(faces.ravel()[corner], return_index=True)
        parent = links[level - 1][corner[first] // 3, 0]
        found[node] = heights_on_faces(nodes, level_faces[level - 1], parent, nodes[node, :2])
    return found
