"""Nodes of a tile: places that come back to the lattice of posts, and which of them are one (specs/evpf.md E-500, E-501)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import VpfFormatError
from vpfx.evpf.checked import check
from vpfx.store.tiles import EAST, NORTH, SOUTH, WEST, Place, Tile, Tiling

__all__ = ["NodeTable", "TileNodes"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class NodeTable(NamedTuple):
    """Nodes of a tile in one coverage, in the order of `cnd`.

    Attributes
    ----------
    path : str
        Of `cnd`, for messages.
    xyz : float64 (n_node, 3)
        Finite.
    z_parent : float64 (n_node,)
        NaN where there is none.
    first_level : int64 (n_node,)
    """

    path: str
    xyz: Floats
    z_parent: Floats
    first_level: Ints


class TileNodes:
    """Nodes of a tile over all levels; those with the same x and y in two coverages are one.

    Parameters
    ----------
    tile : Tile
    tiling : Tiling
    place : Place
        Where the posts lie.
    is_double : bool
        Whether places are the store's own; else they are rounded to floats.

    Attributes
    ----------
    xyz, uv, node_level, z_parent
        As in `vpfx.store.mesh.TileMesh`.
    """

    def __init__(self, tile: Tile, tiling: Tiling, place: Place, is_double: bool) -> None:
        self._tile, self._tiling, self._place, self._is_double = tile, tiling, place, is_double
        self._written = np.empty((0, 3))
        self.xyz, self.uv = np.empty((0, 3)), np.empty((0, 2))
        self.node_level, self.z_parent = np.empty(0, np.int64), np.empty(0)

    def add(self, level: int, found: NodeTable) -> Ints:
        """Take the nodes of the next level.

        Returns
        -------
        int64 (n_node,)
            Index of each among the nodes of the tile.

        Raises
        ------
        VpfFormatError
            Two nodes lie in one place, one has changed from a level to the next or is missing, or one lies where the tile
            has no place for it.
        """
        keys = _keys(found.xyz)
        self._check_apart(keys, found)
        known = _keys(self._written)
        order = np.argsort(known)
        at = np.searchsorted(known[order], keys)
        index = order[np.minimum(at, len(known) - 1)] if len(known) else np.zeros(len(keys), np.int64)
        is_known = known[index] == keys if len(known) else np.zeros(len(keys), bool)
        self._check_same(found, index, is_known, level)
        new = np.flatnonzero(~is_known)
        index[new] = len(known) + np.arange(len(new))
        xy, uv = self._on_lattice(found, new)
        self._written = np.concatenate([self._written, found.xyz[new]])
        self.xyz = np.concatenate([self.xyz, np.column_stack([xy, found.xyz[new, 2]])])
        self.uv = np.concatenate([self.uv, uv])
        self.node_level = np.concatenate([self.node_level, np.full(len(new), level)])
        self.z_parent = np.concatenate([self.z_parent, found.z_parent[new]])
        return index

    def _check_apart(self, keys: NDArray[np.complex128], found: NodeTable) -> None:
        order = np.argsort(keys, kind="stable")
        same = np.flatnonzero(keys[order][1:] == keys[order][:-1])
        is_first = np.ones(len(keys), bool)
        is_first[order[same + 1]] = False
        x, y, _ = found.xyz.T
        check(is_first, found.path, "found a second node at ({}, {}), expected one", "E-201", x, y)

    def _check_same(self, found: NodeTable, index: Ints, is_known: NDArray[np.bool_], level: int) -> None:
        """Refuse nodes that differ from those of levels before, and levels that lack one of them."""
        row = np.flatnonzero(is_known)
        old = index[row]
        is_same = _bits(self._written[old]) == _bits(found.xyz[row])
        z, other = self.z_parent[old], found.z_parent[row]
        is_same = is_same.all(axis=1) & ((z == other) | (np.isnan(z) & np.isnan(other)))
        message = "found a node that differs from the one of the level before at its place, expected the same bytes"
        check(is_same, found.path, message, "E-201", rows=row)
        first = np.full(len(is_known), level)
        first[row] = self.node_level[old]
        given = found.first_level
        message = "found first_level {} in tinnode.pft, expected {}, the first coverage that has the node"
        check(given == first, found.path, message, "E-300", given, first)
        if len(row) < len(self.node_level):
            message = f"found {len(row)} nodes of the levels before, expected all {len(self.node_level)}"
            raise VpfFormatError(found.path, "", message, "E-200")

    def _on_lattice(self, found: NodeTable, row: Ints) -> tuple[Floats, Floats]:
        """Places as the store has them, and in posts from the corner of the tile.

        Where both x and y are those of a post the node is at the post; one that is so near that floats do not tell it from
        the post comes there too. On a side of the tile x, or y, is that of the side.
        """
        tile, place = self._tile, self._place
        low, high = place.at(tile.first_col, tile.first_row), place.at(tile.last_col, tile.last_row)
        first, last = np.array([tile.first_col, tile.first_row]), np.array([tile.last_col, tile.last_row])
        given = found.xyz[row, :2]
        written, sides = self._as_written(given), self._as_written([low, high])
        for axis in range(2):
            is_inside = (written[:, axis] >= sides[0, axis]) & (written[:, axis] <= sides[1, axis])
            message = f"found {'xy'[axis]} {{}}, expected one of the tile, {low[axis]} to {high[axis]}"
            check(is_inside, found.path, message, "E-104", given[:, axis], rows=row)
        lattice = (given - place[:2]) / place[2:]
        whole = np.clip(np.rint(lattice), first, last)
        post = np.stack(place.at(whole[:, 0], whole[:, 1]), axis=1)
        is_post = self._as_written(post) == written
        if not self._is_double:
            is_post &= is_post.all(axis=1, keepdims=True) | (whole == first) | (whole == last)
        uv = np.where(is_post, whole, lattice) - first
        self._check_borders(found, row, uv)
        return np.where(is_post, post, given), uv

    def _as_written(self, values: Any) -> NDArray[Any]:
        """Coordinates as the directory has them."""
        return np.asarray(values) if self._is_double else np.asarray(values, np.float32)

    def _check_borders(self, found: NodeTable, row: Ints, uv: Floats) -> None:
        """Refuse nodes on borders that are at no post: they have no id (specs/format.md R-152)."""
        n_row, n_col = self._tile.shape
        u, v = uv.T
        lines = {SOUTH: (v == 0, u), EAST: (u == n_col - 1, v), NORTH: (v == n_row - 1, u), WEST: (u == 0, v)}
        message = "found a node on a border between tiles and at no post, expected one at a post"
        for side, (is_on, along) in lines.items():
            if self._tiling.border(self._tile, side) >= 0:
                check(~is_on | (along == np.floor(along)), found.path, message, "E-501", rows=row)


def _keys(xyz: Floats) -> NDArray[np.complex128]:
    """One value a place, which can be sorted and compared."""
    return np.ascontiguousarray(xyz[:, :2]).view(np.complex128).ravel()


def _bits(xyz: Floats) -> NDArray[np.uint64]:
    return np.ascontiguousarray(xyz).view(np.uint64)
