"""One tile of a level, ready to be written: its primitives as arrays of rows (specs/evpf.md chapter 2)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import InputError, InvariantError
from vpfx.evpf.crossing import edges_elsewhere, faces_elsewhere, nodes_elsewhere
from vpfx.evpf.numbering import LevelTiles, TileNumbers
from vpfx.evpf.planar import OUTSIDE, Planar, planar_graph
from vpfx.evpf.precision import find_broken, rounded
from vpfx.model import Extent

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
    faces = _triplets(planar.way_face, faces_elsewhere(tiles, tile, store_faces.ravel()))
    links = _triplets(planar.way_next, edges_elsewhere(tiles, tile, numbers, next_edges.ravel()))
    first_edge = _triplets(numbers.first_edge(), nodes_elsewhere(tiles, tile, numbers))
    return TileGraph(
        tile + 1, extent, numbers, nodes, xyz, edge_nodes, planar, first_edge, faces.reshape(-1, 2, 3),
        links.reshape(-1, 2, 3),
    )  # fmt: skip


def _triplets(index: Ints, elsewhere: tuple[Ints, Ints]) -> Ints:
    """Triplets of rows, from indices, and external parts."""
    return np.stack([index + 1, *elsewhere], axis=1)


def _edge_rows(tiles: LevelTiles, numbers: TileNumbers) -> dict[str, NDArray[Any]]:
    """Rows of `edge` in the store, in the order of the tile's edges."""
    n_shared = len(numbers.edge_ids) - numbers.n_own_edge
    rows = tiles.store.fetch("edge", np.roll(numbers.edge_ids, n_shared))
    return {name: np.roll(values, -n_shared) for name, values in rows.items()}


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
