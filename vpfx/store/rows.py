"""Meshes of tiles → rows: the only place where 0-based indices and 1-based ids meet.

`tile_rows` gives the rows of one tile, complete but for what only both sides of a border know; `border_rows` gives the
rest once all tiles are done (specs/format.md R-150 … R-180).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vpfx.errors import InvariantError
from vpfx.store.mesh import LevelMesh, TileMesh, TJunctions
from vpfx.store.records import NULL_INT
from vpfx.store.tiles import EAST, NORTH, SOUTH, WEST, Tile, Tiling
from vpfx.topology import find_twins, outside_links

__all__ = ["FirstIds", "LevelRows", "NodeRows", "TileRows", "border_rows", "tile_rows"]

Ids = NDArray[np.int64]
Table = tuple[NDArray[Any], ...]


class FirstIds(NamedTuple):
    """Next free running id of each table."""

    node: int
    edge: int
    face: int


class NodeRows(NamedTuple):
    """Columns of `node`."""

    node_id: Ids
    tile_id: Ids
    level: Ids
    xyz: NDArray[np.float64]
    z_parent: NDArray[np.float64]

    def table(self) -> Table:
        """Columns in the order of the schema."""
        x, y, z = (np.ascontiguousarray(self.xyz[:, i]) for i in range(3))
        blob = np.ascontiguousarray(self.xyz.astype("<f8")).view(np.uint8).reshape(-1, 24)
        return self.node_id, self.tile_id, self.level, x, y, z, self.z_parent, blob

    def part(self, chosen: Any) -> NodeRows:
        """Return some of the rows."""
        return NodeRows(*(column[chosen] for column in self))


class OpenSides(NamedTuple):
    """Outside sides of one tile and level that touch a node shared with other tiles.

    Each runs with its face on the left. `is_border`: on a border between tiles; `is_forward`: in the edge's direction.
    """

    edge_id: Ids
    start_id: Ids
    end_id: Ids
    face_id: Ids
    previous_edge: Ids
    east: NDArray[np.float64]
    north: NDArray[np.float64]
    is_border: NDArray[np.bool_]
    is_forward: NDArray[np.bool_]


class LevelRows(NamedTuple):
    """Rows of one tile and level: columns in the order of the schema."""

    edges: Table
    faces: Table
    links: Table
    t_junctions: Table
    shared_areas: Table
    open_sides: OpenSides


class TileRows(NamedTuple):
    """Rows of one tile."""

    nodes: list[NodeRows]
    shared_nodes: NodeRows
    levels: list[LevelRows]
    next_ids: FirstIds

    def tables(self, level: int) -> dict[str, Table]:
        """Make what of a level does not hang on other tiles, by the names of the tables."""
        rows = self.levels[level]
        return {
            "node": self.nodes[level].table(), "edge": rows.edges, "face": rows.faces, "parent_child": rows.links,
            "t_junction": rows.t_junctions, "shared_area": rows.shared_areas,
        }  # fmt: skip


@dataclass(frozen=True)
class _TileNodes:
    """Nodes of a tile in all the ways the rows need them."""

    tile: Tile
    tiling: Tiling
    ids: Ids
    u: NDArray[np.float64]
    v: NDArray[np.float64]
    n_shared_id: int


def tile_rows(mesh: TileMesh, tiling: Tiling, first: FirstIds) -> TileRows:
    """Rows of one tile.

    Parameters
    ----------
    mesh : TileMesh
    tiling : Tiling
    first : FirstIds
        Running ids to start from.
    """
    tile, level = mesh.tile, mesh.node_level
    u, v = np.ascontiguousarray(mesh.uv[:, 0]), np.ascontiguousarray(mesh.uv[:, 1])
    ids = tiling.shared_node_ids(tile, u, v)
    own = ids == 0
    ids[own] = first.node + np.arange(int(own.sum()))
    everything = NodeRows(ids, np.full(len(ids), tile.number + 1, np.int64), level, mesh.xyz, mesh.z_parent)
    known = _TileNodes(tile, tiling, ids, u, v, tiling.n_border_node_id)
    levels: list[LevelRows] = []
    next_edge, next_face = first.edge, first.face
    parents = np.empty(0, np.int64)
    for k, of_level in enumerate(mesh.levels):
        face_ids = next_face + np.arange(len(of_level.faces), dtype=np.int64)
        rows = _level_rows(of_level, k, known, face_ids, parents, next_edge)
        levels.append(rows)
        next_edge += len(rows.edges[0])
        next_face += len(face_ids)
        parents = face_ids
    own_rows = [everything.part(own & (level == k)) for k in range(len(mesh.levels))]
    next_ids = FirstIds(first.node + int(own.sum()), next_edge, next_face)
    return TileRows(own_rows, everything.part(~own), levels, next_ids)


def _level_rows(
    mesh: LevelMesh, level: int, known: _TileNodes, face_ids: Ids, parents: Ids, first_edge: int
) -> LevelRows:
    faces = mesh.faces
    twin = find_twins(faces, len(known.ids))
    outside, given_id = _outside_sides(faces, twin, known, level)
    outside = _along_sides(outside, mesh, known)
    edge_id, next_edge = _number_edges(twin, outside.at, given_id, first_edge)
    follower = _followers(outside, known, edge_id)
    tile_id = known.tile.number + 1
    edges = np.empty((9, next_edge - first_edge), np.int64)
    edges[0] = np.arange(first_edge, next_edge)
    edges[1:3] = [[tile_id], [level]]
    _fill_edges(faces, twin, known.ids, edge_id, follower, first_edge, face_ids, edges[3:])
    face_rows = np.empty((12, len(faces)), np.int64)
    face_rows[0], face_rows[1], face_rows[2] = face_ids, tile_id, level
    face_rows[3:6], face_rows[6:9] = known.ids[faces].T, edge_id.reshape(-1, 3).T
    face_rows[9:] = mesh.is_filled, mesh.slope, mesh.aspect
    links: Table = (face_ids[mesh.links[:, 1]], parents[mesh.links[:, 0]])
    nothing = np.empty(0, np.int64)
    shared_areas: Table = (nothing, nothing, np.empty(0)) if mesh.link_area is None else (*links, mesh.link_area)
    t_junctions = _t_junction_rows(mesh.t_junctions, known, level, edge_id)
    open_sides = _open_sides(outside, known, edge_id, face_ids)
    return LevelRows(tuple(edges), tuple(face_rows), links, t_junctions, shared_areas, open_sides)


def _t_junction_rows(found: TJunctions, known: _TileNodes, level: int, edge_id: Ids) -> Table:
    """Columns of `t_junction`, by edge, then node."""
    ids = edge_id[found.side], known.ids[found.node]
    order = np.lexsort(ids[::-1])
    tile_id, levels = np.full(len(order), known.tile.number + 1), np.full(len(order), level)
    return tuple(column[order] for column in (*ids, tile_id, levels, found.gap))


def _open_sides(outside: _Outside, known: _TileNodes, edge_id: Ids, face_ids: Ids) -> OpenSides:
    """Return the outside sides that touch a node shared with other tiles."""
    is_open = np.minimum(known.ids[outside.start], known.ids[outside.end]) <= known.n_shared_id
    at, start, end = outside.at[is_open], outside.start[is_open], outside.end[is_open]
    return OpenSides(
        edge_id[at], known.ids[start], known.ids[end], face_ids[at // 3], edge_id[at // 3 * 3 + (at + 2) % 3],
        outside.east[is_open], outside.north[is_open], outside.is_border[is_open], outside.is_forward[is_open],
    )  # fmt: skip


class _Outside(NamedTuple):
    """Sides without twin, and their directions, in posts.

    `is_border`: on a border between tiles; `is_forward`: in the edge's direction.
    """

    at: NDArray[np.int64]
    start: NDArray[np.int32]
    end: NDArray[np.int32]
    east: NDArray[np.float64]
    north: NDArray[np.float64]
    is_border: NDArray[np.bool_]
    is_forward: NDArray[np.bool_]


def _outside_sides(
    faces: NDArray[np.int32], twin: NDArray[np.int32], known: _TileNodes, level: int
) -> tuple[_Outside, Ids]:
    """Sides without twin, in order, and the edge ids of those whose rows `border_rows` writes; 0 for the others."""
    at = np.flatnonzero(twin < 0)
    start, end = faces[at // 3, at % 3], faces[at // 3, (at + 1) % 3]
    edge_id = np.zeros(len(at), np.int64)
    is_border = np.zeros(len(at), bool)
    is_forward = np.ones(len(at), bool)
    n_row, n_col = known.tile.shape
    lines = {SOUTH: (known.v, 0, known.u), EAST: (known.u, n_col - 1, known.v),
             NORTH: (known.v, n_row - 1, known.u), WEST: (known.u, 0, known.v)}  # fmt: skip
    for side, (across, line, along) in lines.items():
        border = known.tiling.border(known.tile, side)
        if border < 0:
            continue
        on = np.flatnonzero((across[start] == line) & (across[end] == line))
        offset = np.minimum(along[start[on]], along[end[on]]).astype(np.int64)
        edge_id[on] = known.tiling.border_edge_id(border, level, offset)
        is_border[on] = True
        is_forward[on] = side in (SOUTH, EAST)  # counter-clockwise round the tile: east in the south, north in the east
    is_late = ~is_border & (known.ids[end] <= known.n_shared_id)
    edge_id[is_late] = known.tiling.late_edge_id(known.tile, level, np.arange(int(is_late.sum())))
    east, north = known.u[end] - known.u[start], known.v[end] - known.v[start]
    return _Outside(at, start, end, east, north, is_border, is_forward), edge_id


def _along_sides(outside: _Outside, mesh: LevelMesh, known: _TileNodes) -> _Outside:
    """Give the sides along one with nodes inside its direction: rounded places put them beside it (R-161)."""
    side, node, _ = mesh.t_junctions
    if not len(side):
        return outside
    ends = mesh.faces[side // 3, side % 3], mesh.faces[side // 3, (side + 1) % 3]
    (east, north), (to_east, to_north) = (
        (known.u[end] - known.u[ends[0]], known.v[end] - known.v[ends[0]]) for end in (ends[1], node)
    )
    order = np.lexsort((to_east * east + to_north * north, side))
    is_first = np.append(True, np.diff(side[order]) > 0)
    one, other = np.where(is_first, ends[0][order], np.roll(node[order], 1)), node[order]
    last = order[np.append(is_first[1:], True)]
    pieces = np.concatenate([other, ends[1][last]]), np.concatenate([one, node[last]])  # run against the side
    of = np.concatenate([order, last])
    n_node = len(known.ids)
    key = outside.start.astype(np.int64) * n_node + outside.end
    by_key = np.argsort(key)
    wanted = pieces[0].astype(np.int64) * n_node + pieces[1]
    at = by_key[np.minimum(np.searchsorted(key[by_key], wanted), len(key) - 1)]
    is_there = key[at] == wanted
    outside.east[at[is_there]], outside.north[at[is_there]] = -east[of[is_there]], -north[of[is_there]]
    return outside


def _followers(outside: _Outside, known: _TileNodes, edge_id: Ids) -> Ids:
    """Return the next edge over the outside of each side without twin, -1 where other tiles have a say."""
    follower = outside_links(outside.start, outside.end, outside.east, outside.north)
    is_shared = known.ids[outside.end] <= known.n_shared_id
    if (follower[~is_shared] < 0).any():
        raise InvariantError(f"tile {known.tile.name}: found an outline that does not close")
    return np.where(is_shared, -1, edge_id[outside.at][follower])


@njit(nogil=True, cache=True)
def _number_edges(twin, outside, given_id, next_id):  # type: ignore[no-untyped-def]
    """Return the edge id of every side and the next free one.

    Sides without twin (`outside`, in order) have the id given if that is not 0. All other edges are counted from `next_id`
    in the order of their first sides.
    """
    edge_id = np.zeros(len(twin), np.int64)
    for i in range(len(outside)):
        edge_id[outside[i]] = given_id[i]
    for side in range(len(twin)):
        if 0 <= twin[side] < side:
            edge_id[side] = edge_id[twin[side]]
        elif edge_id[side] == 0:
            edge_id[side] = next_id
            next_id += 1
    return edge_id, next_id


@njit(nogil=True, cache=True)
def _fill_edges(face_nodes, twin, node_id, edge_id, follower, first_edge, face_id, rows):  # type: ignore[no-untyped-def]
    """Fill start_node … left_edge, int64 (6, n_edge), of the edges from id `first_edge` on.

    `follower` has the next edge over the outside for each side without twin, in order.
    """
    n_outside = 0
    for side in range(len(twin)):
        face, other = side // 3, twin[side]
        if 0 <= other < side:
            continue
        after = NULL_INT
        if other < 0:
            after = follower[n_outside]
            n_outside += 1
        else:
            after = edge_id[other + 2 if other % 3 == 0 else other - 1]
        row = edge_id[side] - first_edge
        if row >= 0:
            rows[0, row] = node_id[face_nodes[face, side % 3]]
            rows[1, row] = node_id[face_nodes[face, (side + 1) % 3]]
            rows[2, row] = NULL_INT if other < 0 else face_id[other // 3]
            rows[3, row] = face_id[face]
            rows[4, row] = after
            rows[5, row] = edge_id[side + 2 if side % 3 == 0 else side - 1]


def border_rows(parts: Sequence[OpenSides], level: int, tiling: Tiling) -> Table:
    """Edges on borders between tiles, and outline edges of single tiles that end there; columns of `edge` in order of id.

    Parameters
    ----------
    parts : sequence of OpenSides
        What each tile left open on this level.

    Raises
    ------
    InvariantError
        Two tiles differ on what lies on the border between them.
    """
    sides_of = OpenSides(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
    on = np.flatnonzero(sides_of.is_border)
    order = on[np.lexsort((~sides_of.is_forward[on], sides_of.edge_id[on]))]
    edge_id, first, count = np.unique(sides_of.edge_id[order], return_index=True, return_counts=True)
    _check_pairs(sides_of, order, first, count)
    left = np.where(sides_of.is_forward[order[first]], order[first], -1)
    right = np.where(
        sides_of.is_forward[order[first]], np.where(count == 2, order[first + count - 1], -1), order[first]
    )
    single = np.flatnonzero(~sides_of.is_border | ~np.isin(sides_of.edge_id, edge_id[count == 2]))
    links = outside_links(
        sides_of.start_id[single], sides_of.end_id[single], sides_of.east[single], sides_of.north[single]
    )
    follower = np.full(len(sides_of.edge_id), -1, np.int64)
    follower[single] = np.where(links >= 0, sides_of.edge_id[single][links], -1)
    some = np.where(left >= 0, left, right)
    start = np.where(left >= 0, sides_of.start_id[some], sides_of.end_id[some])
    end = np.where(left >= 0, sides_of.end_id[some], sides_of.start_id[some])
    right_edge = np.where(right >= 0, sides_of.previous_edge[right], follower[left])
    left_edge = np.where(left >= 0, sides_of.previous_edge[left], follower[right])
    late = np.flatnonzero(~sides_of.is_border & (sides_of.end_id <= tiling.n_border_node_id))
    nothing = np.full(len(late), NULL_INT)
    columns = (
        (edge_id, sides_of.edge_id[late]),
        (start, sides_of.start_id[late]),
        (end, sides_of.end_id[late]),
        (np.where(right >= 0, sides_of.face_id[right], NULL_INT), nothing),
        (np.where(left >= 0, sides_of.face_id[left], NULL_INT), sides_of.face_id[late]),
        (right_edge, follower[late]),
        (left_edge, sides_of.previous_edge[late]),
    )
    ids, *others = (np.concatenate(pair) for pair in columns)
    in_order = np.argsort(ids)
    edge_ids = ids[in_order]
    owner = tiling.edge_owner(edge_ids) + 1
    return edge_ids, owner, np.full(len(ids), level, np.int64), *(column[in_order] for column in others)


def _check_pairs(sides: OpenSides, order: Ids, first: Ids, count: Ids) -> None:
    """Refuse sides on borders that are not the same for both tiles, or overlap.

    `order` has the sides on borders by edge, the forward one first, `first` and `count` where those of each edge are.
    """
    one, other = order[first], order[first + count - 1]
    length = (np.abs(sides.east[one]) + np.abs(sides.north[one])).astype(np.int64)  # posts; ids count these too
    edge_id = sides.edge_id[one]
    is_pair = sides.is_forward[one] & ~sides.is_forward[other] & (sides.start_id[one] == sides.end_id[other])
    is_good = (count == 1) | ((count == 2) & is_pair & (sides.end_id[one] == sides.start_id[other]))
    is_good[:-1] &= edge_id[:-1] + length[:-1] <= edge_id[1:]
    if not is_good.all():
        raise InvariantError(f"edge {edge_id[~is_good][0]}: found a border that the tiles beside it have differently")
