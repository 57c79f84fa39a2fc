"""Quadtrees over a start grid of squares: leaves, nodes, and the levels made of them.

A place is a pair of whole numbers, `UNITS` to a side of a start square, so that neighbours name a node alike. What faces a leaf
is drawn as is up to the method.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import InputError, InvariantError
from vpfx.methods.base import Patch
from vpfx.methods.refine import BOUND_SLACK, MOST_PASSES, heights_before
from vpfx.methods.scan import find_worst, heights_at, measure, scan_mesh
from vpfx.methods.start import grid_posts
from vpfx.model import CUTS, Hierarchy
from vpfx.topology import NONE

__all__ = ["UNITS", "Drawing", "Leaves", "build_quadtree", "name_places"]

Places = NDArray[np.int64]
UNITS = {2: 2**20, 3: 3**12, 4: 4**10}
"""Units to a side of a start square, by how many squares to a side one is cut into: it can be cut so often."""


class Leaves(NamedTuple):
    """Squares of a level: places of their south-western corners, and their sides, in units, int64 (n_leaf,)."""

    x: Places
    y: Places
    size: Places

    def split(self, which: NDArray[np.bool_], n: int = 2) -> Leaves:
        """Put n × n squares in the place of some leaves, from west to east and then from south to north."""
        owner = np.repeat(np.arange(len(which)), np.where(which, n * n, 1))
        part = np.arange(len(owner)) - np.searchsorted(owner, owner)
        size = np.where(which, self.size // n, self.size)[owner]
        return Leaves(self.x[owner] + size * (part % n), self.y[owner] + size * (part // n), size)

    def find(self, x: Places, y: Places) -> Places:
        """Find the leaf that holds each place (its south and west side belong to it), NONE outside."""
        found = np.full(len(x), NONE)
        for size in np.unique(self.size):
            of_size = np.flatnonzero(self.size == size)
            keys = name_places(self.x[of_size], self.y[of_size])
            order = np.argsort(keys)
            wanted = name_places(x // size * size, y // size * size)
            at = np.minimum(np.searchsorted(keys[order], wanted), len(keys) - 1)
            is_there = keys[order][at] == wanted
            found[is_there] = of_size[order[at]][is_there]
        return found


class Drawing(NamedTuple):
    """Faces of the leaves of a level.

    Attributes
    ----------
    corners : int64 (n_face, 3, 2)
        Places, counter-clockwise.
    leaf : int64 (n_face,)
        The leaf that each face lies in.
    """

    corners: Places
    leaf: Places


def name_places(x: Places, y: Places) -> Places:
    """Return one number for each place."""
    return (y << 32) + x


class _Lattice:
    """Where places lie, in posts, and how high."""

    def __init__(self, patch: Patch, unit: int) -> None:
        self.patch, self.unit = patch, unit
        n_row, n_col = patch.heights.shape
        self.rows, self.cols = grid_posts(n_row, patch.n_square[0]), grid_posts(n_col, patch.n_square[1])

    def start(self) -> Leaves:
        """Return the squares of the start grid."""
        y, x = np.meshgrid(np.arange(len(self.rows) - 1), np.arange(len(self.cols) - 1), indexing="ij")
        return Leaves(x.ravel() * self.unit, y.ravel() * self.unit, np.full(x.size, self.unit))

    def nodes(self, keys: Places) -> NDArray[np.float64]:
        """Return u, v and the height of the posts' surface of named places."""
        u, v = self._along(self.cols, keys & 0xFFFFFFFF), self._along(self.rows, keys >> 32)
        return np.stack([u, v, heights_at(self.patch.heights, u, v)], axis=1)

    def _along(self, lines: NDArray[np.int64], units: Places) -> NDArray[np.float64]:
        """Turn units along rows or columns into posts; start squares lie between the lines."""
        square = np.minimum(units // self.unit, len(lines) - 2)
        share = (units - square * self.unit) / self.unit
        posts: NDArray[np.float64] = lines[square] + share * (lines[square + 1] - lines[square])
        return posts


class _Level(NamedTuple):
    """A level as it was drawn."""

    leaves: Leaves
    drawing: Drawing
    keys: Places  # of the corners, (n_face, 3)
    error: NDArray[np.float64]  # greatest of each face
    figures: tuple[float, float, int]


def _draw(lattice: _Lattice, leaves: Leaves, draw: Callable[[Leaves], Drawing], is_adjacent: bool) -> _Level:
    """Draw a level and compare it with its posts."""
    patch, drawing = lattice.patch, draw(leaves)
    keys = name_places(drawing.corners[..., 0], drawing.corners[..., 1])
    names, index = np.unique(keys, return_inverse=True)
    face_nodes = np.ascontiguousarray(index.reshape(-1, 3), np.int32)
    nodes, residual = lattice.nodes(names), np.full(patch.heights.shape, np.nan)
    error, _ = scan_mesh(nodes, face_nodes, patch.heights, residual)
    if not is_adjacent:
        find_worst(np.arange(len(face_nodes), dtype=np.int32), nodes, face_nodes, patch.heights, residual)
    return _Level(leaves, drawing, keys, error, measure(residual, patch.is_owned))


def build_quadtree(
    patch: Patch,
    method: str,
    options: Any,
    draw: Callable[[Leaves], Drawing],
    mend: Callable[[Leaves], Leaves] | None = None,
    n_split: int = 2,
) -> Hierarchy:
    """Build all levels of a quadtree over one patch.

    Parameters
    ----------
    method : str
        Its name, for messages.
    options : mapping
        With max_error, passes and tolerance of `vpfx.methods.options.SHARED`.
    draw : callable
        Leaves → faces; those of a part must lie in those of its square.
    mend : callable, optional
        Leaves after splitting → leaves that can be drawn without T-junctions.
    n_split : int
        A square is cut into so many by so many.

    Raises
    ------
    InputError
        There are voids, whose outline squares cannot follow, or the bound is too small.
    """
    if not (patch.squares == 15).all():
        raise InputError(f"{method}: found voids in the DEM, whose outline squares cannot follow; take another method")
    lattice, bounds = _Lattice(patch, UNITS[n_split]), options["max_error"]
    level = _draw(lattice, lattice.start(), draw, mend is not None)
    levels = []
    for number in range(len(bounds) if bounds is not None else 1 + options["passes"]):
        limit = options["tolerance"] if bounds is None else bounds[number] * (1.0 - BOUND_SLACK)
        for turn in range(MOST_PASSES):
            is_over = np.zeros(len(level.leaves.x), bool)
            is_over[level.drawing.leaf[level.error > limit]] = True
            if not is_over.any() or (bounds is None and turn == min(number, 1)):
                break
            if level.leaves.size[is_over].min() < n_split**2:
                raise InputError(f"max_error: found {limit:g} m, too small for this DEM; give a larger bound")
            leaves = level.leaves.split(is_over, n_split)
            level = _draw(lattice, leaves if mend is None else mend(leaves), draw, mend is not None)
        else:
            raise InvariantError(f"{method}: level {number}: found no end after {MOST_PASSES} passes")
        levels.append(level)
    return _to_hierarchy(lattice, levels, bounds if bounds is not None else [np.nan] * len(levels))


def _link(coarse: _Level, fine: _Level) -> NDArray[np.int32]:
    """Pairs (parent, child): the face of the coarse leaf that has the middle of the fine face."""
    middle = fine.drawing.corners.mean(axis=1)
    leaf = coarse.leaves.find(*np.floor(middle).astype(np.int64).T)
    first, last = (np.searchsorted(coarse.drawing.leaf, leaf, side=side) for side in ("left", "right"))
    best, parent = np.full(len(middle), -np.inf), np.full(len(middle), NONE)
    for i in range(int((last - first).max(initial=0))):
        face = np.minimum(first + i, last - 1)
        corner = coarse.drawing.corners[face].astype(np.float64)
        ahead, to_middle = np.roll(corner, -1, axis=1) - corner, middle[:, None] - corner
        inside = (ahead[..., 0] * to_middle[..., 1] - ahead[..., 1] * to_middle[..., 0]).min(axis=1)
        is_better = inside > best
        best[is_better], parent[is_better] = inside[is_better], face[is_better]
    return np.stack([parent, np.arange(len(parent))], axis=1).astype(np.int32)


def _to_hierarchy(lattice: _Lattice, levels: list[_Level], bounds: list[float]) -> Hierarchy:
    """Number the nodes by level, and link the faces of neighbouring levels."""
    keys, first_level = np.empty(0, np.int64), np.empty(0, np.int32)
    for number, level in enumerate(levels):
        new = np.setdiff1d(level.keys, keys)
        keys = np.concatenate([keys, new])
        first_level = np.concatenate([first_level, np.full(len(new), number, np.int32)])
    order = np.argsort(keys)
    faces = tuple(order[np.searchsorted(keys[order], level.keys)].astype(np.int32) for level in levels)
    nodes, links = lattice.nodes(keys), tuple(_link(*step) for step in pairwise(levels))
    errors, squared, posts = zip(*(level.figures for level in levels), strict=True)
    return Hierarchy(
        nodes, first_level, faces, links, tuple(np.zeros(len(level), bool) for level in faces), tuple(bounds), errors,
        squared, posts, node_z_parent=heights_before(nodes, first_level, faces, links),
        cuts=np.zeros((len(levels), len(CUTS)), np.int64),
    )  # fmt: skip
