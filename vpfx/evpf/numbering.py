"""Numbers of primitives: which nodes, edges and faces a tile of a level has, in which rows (specs/evpf.md E-200 to E-222)."""

from __future__ import annotations

import math
from collections import OrderedDict
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.checks import number, whole_number
from vpfx.errors import InputError, StoreFormatError
from vpfx.evpf.planar import Sides
from vpfx.store.arrays import NONE_ID, look_up
from vpfx.store.reader import StoreReader
from vpfx.store.tiles import Tiling

__all__ = ["FIRST_FACE", "MOST_TILES", "EdgeRows", "LevelTiles", "Summary", "TileNumbers", "tiling_of"]

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

FIRST_FACE = 2
"""Row in `fac` of the first face of a tile: the universe has row 1."""

MOST_TILES = 2**15 - 1
"""Tiles of a store: `tile_id` is S (E-101)."""


class EdgeRows(NamedTuple):
    """Which edges a tile of a level has: those of the tile alone, then those whose ids are set aside for borders.

    Attributes
    ----------
    most_set_aside : int
        Greatest edge id set aside for borders; those of the tile alone are greater.
    first_own, n_own : int
        Least id of the edges of the tile alone, which follow each other but for those left out, and their number.
    left_out : int64 (n,)
        Edges of the store that the tile has in pieces, ascending.
    set_aside : int64 (n,)
        Ids, ascending.
    """

    most_set_aside: int
    first_own: int
    n_own: int
    left_out: Ints
    set_aside: Ints

    def indices(self, edge_ids: Ints) -> Ints:
        """Indices of edges that the tile has."""
        own = edge_ids - self.first_own - np.searchsorted(self.left_out, edge_ids)
        return np.where(edge_ids > self.most_set_aside, own, self.n_own + np.searchsorted(self.set_aside, edge_ids))


class TileNumbers(NamedTuple):
    """What a tile of a level has; rows count from 1, indices from 0.

    Attributes
    ----------
    node_ids : int64 (n_node,)
        Ids in the store, in the order of rows.
    edge_ids : int64 (n_edge,)
        The same of edges: those of the tile alone, then those whose ids are set aside for borders.
    edges : EdgeRows
        Which these are.
    faces : dict of str to array (n_face,)
        Rows of `face` in the store; index i is row i + 2 of `fac`.
    sides : Sides
        Of the faces, in indices of nodes and edges; a side with nodes inside is in pieces.
    junctions : tuple of int64, int64, float64 (n_junction,)
        Indices of faces and of nodes inside their sides, and gaps in metres, in the order of `tjunct.rat`.
    """

    node_ids: Ints
    edge_ids: Ints
    edges: EdgeRows
    faces: dict[str, NDArray[Any]]
    sides: Sides
    junctions: tuple[Ints, Ints, Floats]

    @property
    def side_end(self) -> Ints:
        """Node at which each side ends, (n_side,)."""
        after = np.arange(1, len(self.sides.start) + 1)
        after[self.sides.first[1:] - 1] = self.sides.first[:-1]
        return self.sides.start[after]

    def first_edge(self) -> Ints:
        """Lowest edge at each node, (n_node,)."""
        lowest = np.full(len(self.node_ids), len(self.edge_ids), np.int64)
        np.minimum.at(lowest, self.sides.start, self.sides.edge)
        np.minimum.at(lowest, self.side_end, self.sides.edge)
        return lowest


class Summary(NamedTuple):
    """What other tiles have to know of a tile of a level.

    Attributes
    ----------
    node_ids, lowest_edge : int64 (n,)
        Its nodes on borders, ascending, and the index of the lowest edge at each.
    edges : EdgeRows
    """

    node_ids: Ints
    lowest_edge: Ints
    edges: EdgeRows


class _Junctions(NamedTuple):
    """Rows of `t_junction`, by edge."""

    edge_id: Ints
    node_id: Ints
    gap: Floats


def tiling_of(store: StoreReader) -> Tiling:
    """Return how the extent of a store is cut.

    Raises
    ------
    StoreFormatError
        Lattice, tile size and tiles do not fit.
    """
    ((n_tile,),) = store.raw("SELECT count(*) FROM tile")
    try:
        lattice = store.metadata["lattice"]
        n_row, n_col = (whole_number(lattice[name], name, 2) for name in ("n_row", "n_col"))
        for name in ("dx", "dy"):
            number(lattice[name], name, math.ulp(0.0))
        size = whole_number(store.metadata["options"]["tile_size"], "tile_size", 1)
        expected = -(-(n_row - 1) // size) * -(-(n_col - 1) // size)
        if expected != n_tile:
            raise StoreFormatError(str(store.path), "table tile", f"found {n_tile} rows, expected {expected}", "R-130")
        return Tiling(n_row, n_col, size, len(store.levels))
    except (InputError, KeyError) as error:
        message = f"found no lattice of posts in tiles ({error})"
        raise StoreFormatError(str(store.path), "table metadata", message, "R-110") from None


class LevelTiles:
    """The tiles of one level of a store, read one by one.

    Parameters
    ----------
    store : StoreReader
    tiling : Tiling
    level : int

    Attributes
    ----------
    n_face, face_offset : int64 (n_tile,)
        Faces of each tile, and of all tiles before it.
    most_set_aside : int
        Greatest edge id set aside for borders.
    """

    def __init__(self, store: StoreReader, tiling: Tiling, level: int) -> None:
        self.store, self.tiling, self.level = store, tiling, level
        query = "SELECT first_edge, last_edge, first_face, last_face FROM tile_level WHERE level = ? ORDER BY tile_id"
        limits = store.select(query, (level,))
        if len(limits["first_face"]) != tiling.n_tile:
            message = f"found {len(limits['first_face'])} tiles of level {level}, expected {tiling.n_tile}"
            raise StoreFormatError(str(store.path), "table tile_level", message, "R-132")
        self._first_face, self.n_face = self._runs(limits, "face")
        self._first_edge, self._n_edge = self._runs(limits, "edge")
        self.face_offset = np.cumsum(self.n_face) - self.n_face
        self.most_set_aside = tiling.n_border_edge_id
        self._summaries: OrderedDict[int, Summary] = OrderedDict()

    def broken(self, tile: int, message: str, requirement: str) -> StoreFormatError:
        """Return an error that names a tile of this level."""
        where = f"level {self.level}, tile {tile + 1}"
        return StoreFormatError(str(self.store.path), where, message, requirement)

    def _runs(self, limits: dict[str, NDArray[Any]], what: str) -> tuple[Ints, Ints]:
        """First id and number of ids of each tile."""
        first, last = limits[f"first_{what}"], limits[f"last_{what}"]
        is_none = (first == NONE_ID) & (last == NONE_ID)
        if not {first.dtype.kind, last.dtype.kind} <= {"i"} or not (is_none | ((first > 0) & (last >= first))).all():
            message = f"found a range of {what}s of level {self.level} that is none"
            raise StoreFormatError(str(self.store.path), "table tile_level", message, "R-132")
        return first, np.where(is_none, 0, last - first + 1)

    def _tile_of(self, ids: Ints, first: Ints, count: Ints, what: str) -> Ints:
        filled = np.flatnonzero(count)
        at = np.searchsorted(first[filled], ids, side="right") - 1
        tile = filled[np.maximum(at, 0)] if len(filled) else np.zeros(len(ids), np.int64)
        is_there = (at >= 0) & (ids < first[tile] + count[tile])
        if not is_there.all():
            message = f"found {what} {ids[~is_there][0]} named, expected one of level {self.level}"
            raise StoreFormatError(str(self.store.path), f"level {self.level}", message, "R-132")
        return tile

    def tile_of_faces(self, face_ids: Ints) -> Ints:
        """Index of the tile of each face."""
        return self._tile_of(face_ids, self._first_face, self.n_face, "face")

    def fac_ids(self, face_ids: Ints) -> Ints:
        """Row in `fac` of each face."""
        return face_ids - self._first_face[self.tile_of_faces(face_ids)] + FIRST_FACE

    def tinface_ids(self, face_ids: Ints) -> Ints:
        """Row in `tinface.aft` of each face."""
        tile = self.tile_of_faces(face_ids)
        return face_ids - self._first_face[tile] + self.face_offset[tile] + 1

    def tile_of_own_edges(self, edge_ids: Ints) -> Ints:
        """Index of the tile of each edge that is of one tile alone."""
        return self._tile_of(edge_ids, self._first_edge, self._n_edge, "edge")

    def numbers(self, tile: int) -> TileNumbers:
        """Number the primitives of a tile.

        Raises
        ------
        StoreFormatError
            Faces, edges and T-junctions do not fit.
        """
        faces = self.store.tile_faces(self.level, tile + 1)
        if len(faces["face_id"]) != self.n_face[tile]:
            raise self.broken(tile, f"found {len(faces['face_id'])} faces, expected {self.n_face[tile]}", "R-132")
        node_ids, face_nodes = np.unique(np.stack([faces[f"node_{i}"] for i in (1, 2, 3)], axis=1), return_inverse=True)
        of_sides = np.stack([faces[f"edge_{i}"] for i in (1, 2, 3)], axis=1).ravel()
        junctions = self._junctions(tile)
        edge_ids, edges = self._edges(tile, of_sides, np.unique(junctions.edge_id))
        sides = Sides(face_nodes.ravel(), edges.indices(of_sides), np.arange(0, len(of_sides) + 1, 3))
        none = np.zeros(0, np.int64)
        numbers = TileNumbers(node_ids, edge_ids, edges, faces, sides, (none, none, np.zeros(0)))
        return self._with_pieces(tile, numbers, of_sides, junctions) if len(junctions.edge_id) else numbers

    def _junctions(self, tile: int) -> _Junctions:
        """T-junctions of a tile: all lie on its own edges or on those set aside for it."""
        query = (
            "SELECT edge_id, node_id, gap FROM t_junction WHERE edge_id BETWEEN ? AND ? AND level = ? AND tile_id = ?"
        )
        first = self._first_edge[tile]
        runs = [(first, first + self._n_edge[tile] - 1), self.tiling.border_edge_ids(self.level) or (1, 0)]
        parts = [self.store.select(query, (int(low), int(high), self.level, tile + 1)) for low, high in runs]
        columns = (np.concatenate([part[name] for part in parts]) for name in _Junctions._fields)
        edge_id, node_id, gap = columns
        return _Junctions(edge_id.astype(np.int64), node_id.astype(np.int64), gap.astype(np.float64))

    def _edges(self, tile: int, of_sides: Ints, left_out: Ints) -> tuple[Ints, EdgeRows]:
        """Ids of the edges of a tile, without those in pieces, in the order of rows."""
        first, count = int(self._first_edge[tile]), int(self._n_edge[tile])
        is_own = of_sides > self.most_set_aside
        at = of_sides[is_own] - first
        is_good = count <= len(at) and at.min(initial=0) >= 0 and at.max(initial=-1) < count
        if not is_good or len(np.unique(at)) < count:
            raise self.broken(tile, "found faces that do not name each edge of the tile", "R-132")
        both = first + np.arange(count), np.unique(of_sides[~is_own])
        own, set_aside = (ids[~np.isin(ids, left_out)] for ids in both)
        edges = EdgeRows(self.most_set_aside, first, len(own), left_out, set_aside)
        return np.concatenate([own, set_aside]), edges

    def _with_pieces(self, tile: int, numbers: TileNumbers, of_sides: Ints, junctions: _Junctions) -> TileNumbers:
        """Put the shorter edges in the place of those that have nodes inside."""
        node, is_known = look_up(numbers.node_ids, junctions.node_id)
        order = np.argsort(of_sides, kind="stable")
        at, has_side = look_up(of_sides[order], junctions.edge_id)
        if not (is_known.all() and has_side.all()):
            raise self.broken(tile, "found a T-junction without its face or node", "R-190")
        side = order[at]
        start, end = numbers.sides.start, numbers.side_end
        xy = self.places(numbers.node_ids)[:, :2]
        way, to_node = xy[end[side]] - xy[start[side]], xy[node] - xy[start[side]]
        along = np.lexsort(((way * to_node).sum(axis=1), side))
        side, node, gap = side[along], node[along], junctions.gap[along]
        is_cut = np.zeros(len(start), bool)
        is_cut[side] = True
        in_order = np.argsort(np.concatenate([np.arange(len(start)), side]), kind="stable")
        starts = np.concatenate([start, node])[in_order]
        whole = np.concatenate([~is_cut, np.zeros(len(side), bool)])[in_order]
        edges = np.concatenate([numbers.sides.edge, np.full(len(side), -1)])[in_order]
        of_face = np.concatenate([np.arange(len(start)), side])[in_order] // 3
        sides = Sides(starts, edges, np.searchsorted(of_face, np.arange(len(start) // 3 + 1)))
        pieces = numbers._replace(sides=sides)
        low, high = np.minimum(starts, pieces.side_end), np.maximum(starts, pieces.side_end)
        key = low * len(numbers.node_ids) + high
        known, first = np.unique(key[whole], return_index=True)
        found, is_edge = look_up(known, key[~whole])
        if not is_edge.all():
            raise self.broken(tile, "found an edge with a node inside without the shorter edges along it", "R-190")
        edges[~whole] = edges[whole][first[found]]
        by_face = np.lexsort((node, side // 3))
        return pieces._replace(junctions=(side[by_face] // 3, node[by_face], gap[by_face]))

    def places(self, node_ids: Ints) -> Floats:
        """Places of nodes, (n, 3): CRS units and metres."""
        nodes = self.store.fetch("node", node_ids)
        return np.stack([nodes[axis] for axis in "xyz"], axis=1)

    def summary(self, tile: int) -> Summary:
        """Say what other tiles have to know of a tile; of the last three rows of tiles it is kept."""
        if tile in self._summaries:
            self._summaries.move_to_end(tile)
            return self._summaries[tile]
        numbers = self.numbers(tile)
        at = slice(0, np.searchsorted(numbers.node_ids, self.tiling.n_border_node_id, side="right"))
        found = Summary(numbers.node_ids[at].copy(), numbers.first_edge()[at].copy(), numbers.edges)
        self._summaries[tile] = found
        while len(self._summaries) > 3 * self.tiling.n_tile_col + 3:
            self._summaries.popitem(last=False)
        return found
