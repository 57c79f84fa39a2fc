"""Where primitives go on in other tiles: the external parts of triplets (specs/evpf.md E-200, E-210)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import StoreFormatError
from vpfx.evpf.numbering import LevelTiles, TileNumbers
from vpfx.store.arrays import look_up

__all__ = ["Elsewhere", "edges_elsewhere", "faces_elsewhere", "nodes_elsewhere"]

Ints = NDArray[np.int64]


class Elsewhere(NamedTuple):
    """External parts: tile and row there, 0 where there is none.

    Attributes
    ----------
    tile_id, ext_id : int64 (n,)
    """

    tile_id: Ints
    ext_id: Ints


def _nowhere(n: int) -> Elsewhere:
    return Elsewhere(np.zeros(n, np.int64), np.zeros(n, np.int64))


def faces_elsewhere(tiles: LevelTiles, tile: int, face_ids: Ints) -> Elsewhere:
    """Faces of other tiles among those of ways.

    Parameters
    ----------
    tiles : LevelTiles
    tile : int
        The tile that the ways are of.
    face_ids : int64 (n,)
        As the store names them; -1 is the outside.
    """
    found = _nowhere(len(face_ids))
    known = np.flatnonzero(face_ids >= 0)
    of = tiles.tile_of_faces(face_ids[known])
    other = known[of != tile]
    found.tile_id[other] = of[of != tile] + 1
    found.ext_id[other] = tiles.fac_ids(face_ids[other])
    return found


def edges_elsewhere(tiles: LevelTiles, tile: int, numbers: TileNumbers, edge_ids: Ints) -> Elsewhere:
    """Edges that the tile does not have: the least tile that has each, and its row there.

    Parameters
    ----------
    edge_ids : int64 (n,)
        Of the store.

    Raises
    ------
    StoreFormatError
        An edge is of no tile nearby.
    """
    found = _nowhere(len(edge_ids))
    is_own = edge_ids > tiles.most_set_aside
    has = look_up(numbers.edge_ids[numbers.n_own_edge :], edge_ids)[1]
    has[is_own] = tiles.tile_of_own_edges(edge_ids[is_own]) == tile
    wanted, index = np.unique(edge_ids[~has], return_inverse=True)
    of = _least_tiles(tiles, wanted)
    row = np.zeros(len(wanted), np.int64)
    for other in np.unique(of).tolist():
        at = of == other
        row[at] = tiles.summary(other).edge_rows(wanted[at], tiles.most_set_aside)
    found.tile_id[~has], found.ext_id[~has] = of[index] + 1, row[index]
    return found


def _least_tiles(tiles: LevelTiles, edge_ids: Ints) -> Ints:
    """Index of the least tile that has each edge."""
    is_own = edge_ids > tiles.most_set_aside
    of = np.empty(len(edge_ids), np.int64)
    of[is_own] = tiles.tile_of_own_edges(edge_ids[is_own])
    rows = tiles.store.fetch("edge", edge_ids[~is_own])
    if (rows["level"] != tiles.level).any():
        raise StoreFormatError(str(tiles.store.path), "table edge", "found a link to an edge of another level", "R-161")
    some = np.where(rows["left_face"] < 0, rows["right_face"], rows["left_face"])
    other = np.where(rows["right_face"] < 0, rows["left_face"], rows["right_face"])
    of[~is_own] = np.minimum(tiles.tile_of_faces(some), tiles.tile_of_faces(other))
    return of


def nodes_elsewhere(tiles: LevelTiles, tile: int, numbers: TileNumbers) -> Elsewhere:
    """For each node the tile of next greater id that has it, the least after the greatest, and the lowest edge there."""
    found = _nowhere(len(numbers.node_ids))
    n_shared = int(np.searchsorted(numbers.node_ids, tiles.tiling.n_border_node_id, side="right"))
    if n_shared == 0:
        return found
    around = _tiles_around(tiles, tile)
    summaries = [tiles.summary(other) for other in around]
    node = np.concatenate([summary.node_ids for summary in summaries])
    edge = np.concatenate([summary.lowest_edge for summary in summaries])
    of = np.repeat(around, [len(summary.node_ids) for summary in summaries])
    at, is_here = look_up(numbers.node_ids[:n_shared], node)
    at, edge, of = at[is_here], edge[is_here], of[is_here]
    after = np.where(of > tile, of - tile, of - tile + tiles.tiling.n_tile)
    order = np.lexsort((after, at))
    first = order[np.append(True, at[order][1:] != at[order][:-1])] if len(order) else order
    found.tile_id[at[first]], found.ext_id[at[first]] = of[first] + 1, edge[first]
    return found


def _tiles_around(tiles: LevelTiles, tile: int) -> list[int]:
    """Tiles that touch a tile."""
    tiling = tiles.tiling
    row, col = divmod(tile, tiling.n_tile_col)
    return [
        r * tiling.n_tile_col + c
        for r in range(max(row - 1, 0), min(row + 2, tiling.n_tile_row))
        for c in range(max(col - 1, 0), min(col + 2, tiling.n_tile_col))
        if (r, c) != (row, col)
    ]
