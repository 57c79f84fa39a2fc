"""Tile hierarchies ⇄ rows: the only place where 0-based indices and 1-based ids meet.

`tile_rows` gives the rows of one tile, complete but for what only both sides of a border know; `border_rows` gives the
rest once all tiles are done (specs/format.md R-150 … R-180).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import InvariantError
from vpfx.geometry import face_slopes
from vpfx.model import Hierarchy
from vpfx.store.tiles import EAST, NORTH, SOUTH, WEST, Tile, Tiling
from vpfx.topology import Sides, outside_links, sides

__all__ = ["NULL", "FirstIds", "LevelRows", "NodeRows", "Place", "TileRows", "border_rows", "tile_rows"]

NULL = np.iinfo(np.int64).min
"""Stands for NULL in integer columns."""

Ids = NDArray[np.int64]
Table = tuple[NDArray[Any], ...]


class Place(NamedTuple):
    """Where posts lie: post (row, col) at x0 + dx·col, y0 + dy·row, CRS units."""

    x0: float
    y0: float
    dx: float
    dy: float


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

    def table(self) -> Table:
        """Columns in the order of the schema."""
        x, y, z = (np.ascontiguousarray(self.xyz[:, i]) for i in range(3))
        blob = np.ascontiguousarray(self.xyz.astype("<f8")).view(np.uint8).reshape(-1, 24)
        return self.node_id, self.tile_id, self.level, x, y, z, blob

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
    open_sides: OpenSides


class TileRows(NamedTuple):
    """Rows of one tile."""

    nodes: list[NodeRows]
    shared_nodes: NodeRows
    levels: list[LevelRows]
    next_ids: FirstIds


@dataclass(frozen=True)
class _TileNodes:
    """Nodes of a tile in all the ways the rows need them."""

    tile: Tile
    tiling: Tiling
    ids: Ids
    u: NDArray[np.float64]
    v: NDArray[np.float64]
    n_shared_id: int


def tile_rows(
    hierarchy: Hierarchy, tile: Tile, tiling: Tiling, place: Place, post_metres: tuple[float, float], first: FirstIds
) -> TileRows:
    """Rows of one tile.

    Parameters
    ----------
    hierarchy : Hierarchy
        Its nodes are in posts from the tile's south-west corner.
    tile, tiling, place
        Where the tile lies.
    post_metres : tuple of float
        Width and height of a post spacing, metres: for slope and aspect.
    first : FirstIds
        Running ids to start from.
    """
    u, v = hierarchy.nodes[:, 0], hierarchy.nodes[:, 1]
    x = place.x0 + place.dx * (tile.first_col + u)
    y = place.y0 + place.dy * (tile.first_row + v)
    ids = tiling.shared_node_ids(tile, u, v)
    own = ids == 0
    ids[own] = first.node + np.arange(int(own.sum()))
    level = hierarchy.node_level.astype(np.int64)
    everything = NodeRows(
        ids, np.full(len(ids), tile.number + 1, np.int64), level, np.stack([x, y, hierarchy.nodes[:, 2]], axis=1)
    )
    metric = hierarchy.nodes * np.array([*post_metres, 1.0])
    known = _TileNodes(tile, tiling, ids, u, v, tiling.n_border_node_id)
    levels: list[LevelRows] = []
    next_edge, next_face = first.edge, first.face
    parents = np.empty(0, np.int64)
    for k in range(hierarchy.n_level):
        faces = hierarchy.level_faces[k]
        face_ids = next_face + np.arange(len(faces), dtype=np.int64)
        rows = _level_rows(hierarchy, k, known, metric, face_ids, parents, next_edge)
        levels.append(rows)
        next_edge += len(rows.edges[0])
        next_face += len(faces)
        parents = face_ids
    return TileRows(
        [everything.part(own & (level == k)) for k in range(hierarchy.n_level)],
        everything.part(~own),
        levels,
        FirstIds(first.node + int(own.sum()), next_edge, next_face),
    )


def _level_rows(
    hierarchy: Hierarchy, level: int, known: _TileNodes, metric: NDArray[np.float64], face_ids: Ids, parents: Ids,
    first_edge: int,
) -> LevelRows:  # fmt: skip
    faces = hierarchy.level_faces[level]
    mesh = sides(faces, len(known.ids))
    edge_id, is_border, is_forward, is_own = _edge_ids(mesh, known, level, first_edge)
    previous_edge = edge_id[mesh.previous]
    face_of_side = np.repeat(face_ids, 3)
    outside, follower = _outside(mesh, known, edge_id)
    own = np.flatnonzero(is_own)
    twin = mesh.twin[own]
    after = previous_edge[twin]
    alone = np.flatnonzero(twin < 0)
    after[alone] = follower[np.searchsorted(outside, own[alone])]  # -1 only where border_rows writes the row
    tile_id = np.full(len(own), known.tile.number + 1, np.int64)
    edges = (
        edge_id[own], tile_id, np.full(len(own), level, np.int64), known.ids[mesh.start[own]], known.ids[mesh.end[own]],
        np.where(twin < 0, NULL, face_of_side[twin]), face_of_side[own], after, previous_edge[own],
    )  # fmt: skip
    slope, aspect = face_slopes(metric, faces)
    nodes, by_face = known.ids[faces], edge_id.reshape(-1, 3)
    aspect_units = np.where(np.isnan(aspect), 0, np.round(np.nan_to_num(aspect) * 100)).astype(np.int64) % 36000
    face_rows = (
        face_ids, np.full(len(faces), known.tile.number + 1, np.int64), np.full(len(faces), level, np.int64),
        nodes[:, 0], nodes[:, 1], nodes[:, 2], by_face[:, 0], by_face[:, 1], by_face[:, 2],
        hierarchy.face_is_filled[level].astype(np.int64), np.round(slope * 100).astype(np.int64),
        np.where(np.isnan(aspect), NULL, aspect_units),
    )  # fmt: skip
    links: Table = (np.empty(0, np.int64), np.empty(0, np.int64))
    if level:
        pairs = hierarchy.links[level - 1]
        links = (face_ids[pairs[:, 1]], parents[pairs[:, 0]])
    ends = known.ids[mesh.start[outside]], known.ids[mesh.end[outside]]
    at = outside[np.minimum(*ends) <= known.n_shared_id]
    start, end = mesh.start[at], mesh.end[at]
    open_sides = OpenSides(
        edge_id[at], known.ids[start], known.ids[end], face_of_side[at], previous_edge[at],
        known.u[end] - known.u[start], known.v[end] - known.v[start], is_border[at], is_forward[at],
    )  # fmt: skip
    return LevelRows(edges, face_rows, links, open_sides)


def _edge_ids(
    mesh: Sides, known: _TileNodes, level: int, first_edge: int
) -> tuple[Ids, NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Edge id of every side; whether it lies on a border, runs in the edge's direction, and stands for the edge."""
    index = np.arange(len(mesh.twin))
    edge_id = np.zeros(len(index), np.int64)
    is_border = np.zeros(len(index), bool)
    is_forward = np.ones(len(index), bool)
    n_row, n_col = known.tile.shape
    alone = mesh.twin < 0
    lines = {SOUTH: (known.v, 0, known.u), EAST: (known.u, n_col - 1, known.v),
             NORTH: (known.v, n_row - 1, known.u), WEST: (known.u, 0, known.v)}  # fmt: skip
    for side, (across, line, along) in lines.items():
        border = known.tiling.border(known.tile, side)
        if border < 0:
            continue
        on = np.flatnonzero(alone & (across[mesh.start] == line) & (across[mesh.end] == line))
        offset = np.minimum(along[mesh.start[on]], along[mesh.end[on]]).astype(np.int64)
        edge_id[on] = known.tiling.border_edge_id(border, level, offset)
        is_border[on] = True
        is_forward[on] = side in (SOUTH, EAST)  # counter-clockwise round the tile: east in the south, north in the east
    is_late = alone & ~is_border & (known.ids[mesh.end] <= known.n_shared_id)
    edge_id[is_late] = known.tiling.late_edge_id(known.tile, level, np.arange(int(is_late.sum())))
    is_own = ~is_border & ~is_late & (alone | (index < mesh.twin))
    edge_id[is_own] = first_edge + np.arange(int(is_own.sum()))
    other = np.flatnonzero(~alone & ~is_own)
    edge_id[other] = edge_id[mesh.twin[other]]
    return edge_id, is_border, is_forward, is_own


def _outside(mesh: Sides, known: _TileNodes, edge_id: Ids) -> tuple[NDArray[np.int64], Ids]:
    """Sides without twin and the next edge over the outside of each, -1 where other tiles have a say."""
    at = np.flatnonzero(mesh.twin < 0)
    start, end = mesh.start[at], mesh.end[at]
    follower = outside_links(start, end, known.u[end] - known.u[start], known.v[end] - known.v[start])
    is_shared = known.ids[end] <= known.n_shared_id
    if (follower[~is_shared] < 0).any():
        raise InvariantError(f"tile {known.tile.name}: found an outline that does not close")
    return at, np.where(is_shared, -1, edge_id[at][follower])


def border_rows(parts: Sequence[OpenSides], level: int, tiling: Tiling) -> Table:
    """Edges on borders between tiles, and outline edges of single tiles that end there; columns of `edge` in order of id.

    Parameters
    ----------
    parts : sequence of OpenSides
        What each tile left open on this level.
    """
    sides_of = OpenSides(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
    on = np.flatnonzero(sides_of.is_border)
    order = on[np.lexsort((~sides_of.is_forward[on], sides_of.edge_id[on]))]
    edge_id, first, count = np.unique(sides_of.edge_id[order], return_index=True, return_counts=True)
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
    nothing = np.full(len(late), NULL)
    columns = (
        (edge_id, sides_of.edge_id[late]),
        (start, sides_of.start_id[late]),
        (end, sides_of.end_id[late]),
        (np.where(right >= 0, sides_of.face_id[right], NULL), nothing),
        (np.where(left >= 0, sides_of.face_id[left], NULL), sides_of.face_id[late]),
        (right_edge, follower[late]),
        (left_edge, sides_of.previous_edge[late]),
    )
    ids, *others = (np.concatenate(pair) for pair in columns)
    in_order = np.argsort(ids)
    edge_ids = ids[in_order]
    owner = tiling.edge_owner(edge_ids) + 1
    return edge_ids, owner, np.full(len(ids), level, np.int64), *(column[in_order] for column in others)
