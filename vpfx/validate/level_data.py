"""What the rules look at of one level: its rows as arrays of indices, read when first asked for."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from vpfx.exact import face_turns
from vpfx.store.tiles import Tiling
from vpfx.validate.kernels import face_at_edges, find_dense
from vpfx.validate.outside import Outside, Slits, find_outside, find_slits, straighten
from vpfx.validate.store_data import RANGED, StoreData
from vpfx.validate.values import LevelRow

__all__ = ["LevelData", "StepData", "border_of", "find_ids", "rows_between"]

SPARSE = 8
"""Numbers between the first and last id for each id, up to which a table of all of them is made."""
FEW = 1 << 16

Indices = NDArray[np.int32]
Ids = NDArray[np.int64]
Made = TypeVar("Made")


def find_ids(ids: Ids, wanted: NDArray[np.int64]) -> Indices:
    """Places of numbers in ascending ids, -1 where there is none.

    Parameters
    ----------
    ids : int64 (n,)
        Ascending, each once.
    wanted : int64 (any shape)

    Examples
    --------
    >>> find_ids(np.array([3, 5, 10**15]), np.array([[5, 4], [10**15, -1]])).tolist()
    [[1, -1], [2, -1]]
    """
    index = np.full(wanted.size, -1, np.int32)
    flat = np.ascontiguousarray(wanted).ravel()
    if len(ids) and int(ids[-1]) - int(ids[0]) <= SPARSE * (len(ids) + len(flat)) + FEW:
        find_dense(ids, flat, index)
    elif len(ids):
        at = np.minimum(np.searchsorted(ids, flat), len(ids) - 1)
        index = np.where(ids[at] == flat, at, -1).astype(np.int32)
    return index.reshape(wanted.shape)


def rows_between(ids: Ids, low: int, high: int) -> slice:
    """Rows whose ids, which are ascending, lie in a range; both its ends are in it.

    Examples
    --------
    >>> rows_between(np.array([3, 5, 2**63 - 1]), 4, 2**63 - 1)
    slice(1, 3, None)
    """
    return slice(int(np.searchsorted(ids, low)), int(np.searchsorted(ids, high, side="right")))


def border_of(tiling: Tiling, axis: int, line: Ids, along: NDArray[np.float64]) -> tuple[Ids, Ids]:
    """Numbers of the borders that places lie on, and their posts from the west or south end (R-152).

    Parameters
    ----------
    tiling : Tiling
    axis : int
        0 for borders that run east, 1 for those that run north.
    line : int64 (n,)
        Line between tile rows, or columns, of each place, counted from the side of the extent; neither that nor the last.
    along : float64 (n,)
        Post spacings of each from the western, or southern, side of the extent.
    """
    lines = tiling.row_lines if axis else tiling.col_lines
    post = np.rint(along).astype(np.int64)
    part = np.clip(np.searchsorted(lines, post, side="right") - 1, 0, len(lines) - 2)
    border = (line - 1) * tiling.n_tile_col + part
    if axis:
        border = (tiling.n_tile_row - 1) * tiling.n_tile_col + part * (tiling.n_tile_col - 1) + line - 1
    return border, post - lines[part]


class LevelData:
    """The rows of one level.

    Attributes
    ----------
    data : StoreData
    level : int
    """

    def __init__(self, data: StoreData, level: int) -> None:
        self.data, self.level = data, level
        self._made: dict[Callable[[LevelData], Any], Any] = {}

    def once(self, make: Callable[[LevelData], Made]) -> Made:
        """Return what a function makes of the level: made when it is first asked for, as several rules want it."""
        if make not in self._made:
            self._made[make] = make(self)
        return self._made[make]

    @property
    def row(self) -> LevelRow:
        """Its row of the table `level`."""
        return self.data.level_rows[self.level]

    def runs(self, table: str) -> list[tuple[int, int]]:
        """First and last ids of the rows of each tile; the tiles come in the order of ids."""
        limits = self.data.ranges[:, self.level, RANGED.index(table)]
        return [(low, high) for low, high in limits.tolist() if low <= high]

    @cached_property
    def faces(self) -> dict[str, NDArray[Any]]:
        """Rows of `face` as columns."""
        return self.data.columns("face", self.runs("face"))

    @cached_property
    def edges(self) -> dict[str, NDArray[Any]]:
        """Rows of `edge` as columns, those on borders first."""
        first = self.row.first_border_edge
        border = [] if first is None else [(first, self.row.last_border_edge)]
        return self.data.columns("edge", border + self.runs("edge"))

    @cached_property
    def links(self) -> Ids:
        """Pairs (child_face, parent_face) of faces of this level, (n, 2), ascending."""
        return self.data.reader.links("child_face", self.runs("face"))

    @cached_property
    def t_junctions(self) -> dict[str, NDArray[Any]]:
        """Rows of `t_junction` of edges of this level as columns, by edge, then node."""
        return self.data.pair_columns("t_junction", self.runs("edge"))

    @cached_property
    def junctions(self) -> tuple[Indices, Indices]:
        """Edge of the level and node of the store that each T-junction names, as indices; -1 if there is no such one."""
        edge = find_ids(self.edges["edge_id"], self.t_junctions["edge_id"])
        return edge, find_ids(self.data.nodes["node_id"], self.t_junctions["node_id"])

    @cached_property
    def shared_areas(self) -> dict[str, NDArray[Any]]:
        """Rows of `shared_area` of faces of this level as columns, by child, then parent."""
        return self.data.pair_columns("shared_area", self.runs("face"))

    @cached_property
    def face_nodes(self) -> Indices:
        """Corners of the faces as indices of nodes of the store, (n_face, 3); -1 if there is no such node."""
        return self._indices(self.data.nodes["node_id"], self.faces, ("node_1", "node_2", "node_3"))

    @cached_property
    def face_edges(self) -> Indices:
        """Edges of the faces as indices of edges of the level, (n_face, 3); -1 if the level has no such edge."""
        return self._indices(self.edges["edge_id"], self.faces, ("edge_1", "edge_2", "edge_3"))

    @cached_property
    def edge_nodes(self) -> Indices:
        """Start and end of the edges as indices of nodes of the store, (n_edge, 2)."""
        return self._indices(self.data.nodes["node_id"], self.edges, ("start_node", "end_node"))

    @cached_property
    def edge_faces(self) -> Indices:
        """Left and right faces of the edges as indices of faces of the level, (n_edge, 2); -1 for the outside."""
        return self._indices(self.faces["face_id"], self.edges, ("left_face", "right_face"))

    @cached_property
    def edge_links(self) -> Indices:
        """Left and right edges of the edges as indices of edges of the level, (n_edge, 2)."""
        return self._indices(self.edges["edge_id"], self.edges, ("left_edge", "right_edge"))

    @cached_property
    def edge_sides(self) -> NDArray[np.int8]:
        """Which side of its left and right face each edge is, (n_edge, 2); -1 for none."""
        side = np.empty((len(self.edge_faces), 2), np.int8)
        face_at_edges(self.face_edges, self.edge_faces, side)
        return side

    @cached_property
    def outside(self) -> Outside:
        """Edges without a face on one hand."""
        return find_outside(self.edge_nodes, self.edge_faces, self.straight_places)

    @cached_property
    def borders(self) -> tuple[Ids, Ids]:
        """Number of the border between tiles that each edge lies on, -1 if none; posts from there to its west or south end."""
        data, tiling, (start, end) = self.data, self.data.tiling, self.edge_nodes.T
        border, offset = np.full(len(start), -1, np.int64), np.zeros(len(start), np.int64)
        for axis in range(2):
            line = data.lines_of_nodes[start, 1 - axis]
            is_on = (line > 0) & (line < (tiling.n_tile_row, tiling.n_tile_col)[axis])
            on = np.flatnonzero(is_on & (line == data.lines_of_nodes[end, 1 - axis]))
            along = np.minimum(data.places[start[on], axis], data.places[end[on], axis])
            border[on], offset[on] = border_of(tiling, axis, line[on], along)
        return border, offset

    @cached_property
    def slits(self) -> Slits:
        """Edges along which shorter ones run."""
        return find_slits(self.outside, self.straight_places)

    @cached_property
    def straight_places(self) -> NDArray[np.float64]:
        """Places of nodes in post spacings, (n_node, 2); in single precision those told inside edges are on them again."""
        edge, node = self.junctions
        if not self.data.is_single or not len(edge):
            return self.data.places
        spacing = np.array([self.data.metadata["lattice"][name] for name in ("dx", "dy")])
        xy = straighten(self.data.places * spacing, self.edge_nodes[edge], node, 2 * self.data.place_slack)
        return xy / spacing

    @cached_property
    def turns(self) -> NDArray[np.int8]:
        """Which way round the nodes of the faces go, exactly: 1 counter-clockwise, -1 clockwise, 0 on one line."""
        return face_turns(self.data.xyz, self.face_nodes)

    @cached_property
    def is_new(self) -> NDArray[np.bool_]:
        """Nodes of the store that are new at this level."""
        return self.data.nodes["level"] == self.level

    def _indices(self, ids: Ids, rows: dict[str, NDArray[Any]], columns: tuple[str, ...]) -> Indices:
        """Places of what some columns name."""
        return find_ids(ids, np.stack([rows[column] for column in columns], axis=1))

    def place(self, table: str, index: int) -> str:
        """Name a row of `face` or `edge`: ``level=2 tile=14 face=310``."""
        rows = self.faces if table == "face" else self.edges
        return f"level={self.level} tile={rows['tile_id'][index]} {table}={rows[f'{table}_id'][index]}"

    def node(self, index: int) -> str:
        """Name a node: ``level=2 tile=14 node=77``."""
        nodes = self.data.nodes
        return f"level={self.level} tile={nodes['tile_id'][index]} node={nodes['node_id'][index]}"


class StepData:
    """Two levels that follow each other, and what links them.

    Attributes
    ----------
    coarse, fine : LevelData
    """

    def __init__(self, coarse: LevelData, fine: LevelData) -> None:
        self.coarse, self.fine = coarse, fine

    @property
    def data(self) -> StoreData:
        """The store."""
        return self.fine.data

    @cached_property
    def pairs(self) -> Indices:
        """Linked faces as indices in the coarse and in the fine level, (n, 2); -1 if the level has no such face."""
        links = self.fine.links
        parent = find_ids(self.coarse.faces["face_id"], links[:, 1])
        child = find_ids(self.fine.faces["face_id"], links[:, 0])
        return np.stack([parent, child], axis=1)
