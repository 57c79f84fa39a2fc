"""One tile of a level, ready to be written: its primitives as arrays of rows (specs/evpf.md chapter 2)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import InputError, InvariantError, StoreFormatError
from vpfx.evpf.numbering import LevelTiles, TileNumbers
from vpfx.evpf.planar import OUTSIDE, Planar, planar_graph
from vpfx.evpf.precision import find_broken, rounded
from vpfx.model import Extent
from vpfx.store.arrays import look_up

__all__ = ["TileGraph", "read_graph"]

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]


class TileGraph(NamedTuple):
    """Primitives of one tile and level.

    Attributes
    ----------
    tile_id : int
    extent : Extent
        Of the tile.
    numbers : TileNumbers
    nodes : dict of str to array (n_node,)
        Rows of `node` in the store.
    xyz : float64 (n_node, 3)
        Places as written.
    edge_nodes : int64 (n_edge, 2)
        Start and end, as indices.
    planar : Planar
    first_edge : int64 (n_node, 3)
        Triplets of `cnd`.
    faces, links : int64 (n_edge, 2, 3)
        Triplets of `edg`: left, right.
    """

    tile_id: int
    extent: Extent
    numbers: TileNumbers
    nodes: dict[str, NDArray[Any]]
    xyz: Floats
    edge_nodes: Ints
    planar: Planar
    first_edge: Ints
    faces: Ints
    links: Ints

    @property
    def n_primitive(self) -> int:
        """Rows of the longest table."""
        return max(len(self.nodes["node_id"]), len(self.edge_nodes), 1 + self.planar.n_face + self.planar.n_void)


def read_graph(tiles: LevelTiles, tile: int, extent: Extent, *, is_double: bool) -> TileGraph:
    """Read a tile of a level and make its planar graph.

    Parameters
    ----------
    tiles : LevelTiles
    tile : int
        Index of the tile.
    extent : Extent
        Of the tile.
    is_double : bool
        Whether places are written as they are; else rounded.

    Raises
    ------
    InputError
        A face would not be a face any more in single precision; the message names the first of the tile.
    StoreFormatError
        Rows of the store do not fit.
    """
    numbers = tiles.numbers(tile)
    nodes = tiles.store.fetch("node", numbers.node_ids)
    exact = np.stack([nodes[axis] for axis in "xyz"], axis=1)
    xyz = exact if is_double else rounded(exact)
    edges = _edge_rows(tiles, numbers)
    edge_nodes = _edge_nodes(tiles, tile, numbers, edges)
    if not is_double:
        broken = find_broken(xyz, numbers, edge_nodes, _borders(tiles, tile, extent), exact)
        if broken is not None:
            raise InputError(_refusal(tiles, tile, numbers, *broken))
    try:
        planar = planar_graph(xyz[:, :2], edge_nodes, numbers.sides)
    except InvariantError as error:
        raise tiles.broken(tile, str(error), "R-170") from error
    store_faces = np.stack([edges["left_face"], edges["right_face"]], axis=1)
    _check_faces(tiles, tile, planar, store_faces, has_junctions=len(numbers.junctions[0]) > 0)
    next_edges = np.stack([edges["left_edge"], edges["right_edge"]], axis=1)
    faces = _triplets(planar.way_face, _faces_elsewhere(tiles, tile, store_faces.ravel()))
    links = _triplets(planar.way_next, _edges_elsewhere(tiles, tile, numbers, next_edges.ravel()))
    first_edge = _triplets(numbers.first_edge(), _nodes_elsewhere(tiles, tile, numbers))
    return TileGraph(
        tile + 1, extent, numbers, nodes, xyz, edge_nodes, planar, first_edge, faces.reshape(-1, 2, 3),
        links.reshape(-1, 2, 3),
    )  # fmt: skip


def _triplets(index: Ints, elsewhere: tuple[Ints, Ints]) -> Ints:
    """Triplets of rows, from indices, and external parts."""
    return np.stack([index + 1, *elsewhere], axis=1)


def _edge_rows(tiles: LevelTiles, numbers: TileNumbers) -> dict[str, NDArray[Any]]:
    """Rows of `edge` in the store, in the order of the tile's edges."""
    n_set_aside = len(numbers.edges.set_aside)  # the least ids
    rows = tiles.store.fetch("edge", np.roll(numbers.edge_ids, n_set_aside))
    return {name: np.roll(values, -n_set_aside) for name, values in rows.items()}


def _edge_nodes(tiles: LevelTiles, tile: int, numbers: TileNumbers, edges: dict[str, NDArray[Any]]) -> Ints:
    """Start and end of each edge as indices, in the direction of the store."""
    sides = numbers.sides
    found = np.empty((len(numbers.edge_ids), 2), np.int64)
    found[sides.edge, 0], found[sides.edge, 1] = sides.start, numbers.side_end
    is_turned = numbers.node_ids[found[:, 0]] != edges["start_node"]
    found[is_turned] = found[is_turned][:, ::-1]
    ends = numbers.node_ids[found]
    if (ends[:, 0] != edges["start_node"]).any() or (ends[:, 1] != edges["end_node"]).any():
        raise tiles.broken(tile, "found an edge that does not join the nodes of its faces", "R-170")
    is_forward = sides.start == found[sides.edge, 0]
    far = found[sides.edge, np.where(is_forward, 1, 0)]
    sides_of = np.bincount(2 * sides.edge + is_forward)
    if (far != numbers.side_end).any() or sides_of.max(initial=0) > 1:
        raise tiles.broken(tile, "found an edge with two faces on one side, or nodes that are not theirs", "R-170")
    return found


def _check_faces(tiles: LevelTiles, tile: int, planar: Planar, store_faces: Ints, *, has_junctions: bool) -> None:
    """Compare the faces of edges that the store names with those of the graph."""
    named = np.flatnonzero(store_faces.ravel() >= 0)
    ids = store_faces.ravel()[named]
    is_here = tiles.tile_of_faces(ids) == tile
    is_given = (planar.way_face > OUTSIDE) & (planar.way_face <= planar.n_face)
    is_given[named] = False
    differs = (planar.way_face[named[is_here]] + 1 != tiles.fac_ids(ids[is_here])).any()
    if differs or (is_given.any() and not has_junctions):  # beside a shorter edge lies the face whose edge is in pieces
        raise tiles.broken(tile, "found an edge whose faces do not name it", "R-160")


def _borders(tiles: LevelTiles, tile: int, extent: Extent) -> Extent:
    """Sides of a tile that are borders, NaN for the others."""
    row, col = divmod(tile, tiles.tiling.n_tile_col)
    is_border = (col > 0, row > 0, col < tiles.tiling.n_tile_col - 1, row < tiles.tiling.n_tile_row - 1)
    return Extent(*np.where(is_border, extent, np.nan).tolist())


def _refusal(tiles: LevelTiles, tile: int, numbers: TileNumbers, face: int, what: str) -> str:
    place = tiles.places(np.sort([numbers.faces[f"node_{i}"][face] for i in (1, 2, 3)]))[:, :2].mean(axis=0)
    where = f"level {tiles.level}, tile {tile + 1}: face {numbers.faces['face_id'][face]} at ({place[0]:.10g}, {place[1]:.10g})"
    return f"{tiles.store.path}: {where} {what} in single precision (E-201); give --double"


class _Elsewhere(NamedTuple):
    """External parts: tile and row there, 0 where there is none.

    Attributes
    ----------
    tile_id, ext_id : int64 (n,)
    """

    tile_id: Ints
    ext_id: Ints


def _nowhere(n: int) -> _Elsewhere:
    return _Elsewhere(np.zeros(n, np.int64), np.zeros(n, np.int64))


def _faces_elsewhere(tiles: LevelTiles, tile: int, face_ids: Ints) -> _Elsewhere:
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


def _edges_elsewhere(tiles: LevelTiles, tile: int, numbers: TileNumbers, edge_ids: Ints) -> _Elsewhere:
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
    has = look_up(numbers.edges.set_aside, edge_ids)[1]
    has[is_own] = tiles.tile_of_own_edges(edge_ids[is_own]) == tile
    wanted, index = np.unique(edge_ids[~has], return_inverse=True)
    of = _least_tiles(tiles, wanted)
    row = np.zeros(len(wanted), np.int64)
    for other in np.unique(of).tolist():
        at = of == other
        row[at] = tiles.summary(other).edges.indices(wanted[at]) + 1
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


def _nodes_elsewhere(tiles: LevelTiles, tile: int, numbers: TileNumbers) -> _Elsewhere:
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
    found.tile_id[at[first]], found.ext_id[at[first]] = of[first] + 1, edge[first] + 1
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
