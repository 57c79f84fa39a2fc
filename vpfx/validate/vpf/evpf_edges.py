"""Rules V781, V782: edges run as in the store, and name across borders what E-200 and E-210 say, and no more."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.validate.report import ERROR, Defects, Rule, Tally, some
from vpfx.validate.vpf.evpf_data import EvpfTile, LevelTables
from vpfx.validate.vpf.evpf_tiles import TILE
from vpfx.validate.vpf.stars import find_targets, sort_stars
from vpfx.validate.vpf.tiling import BorderEdges, Borders

__all__ = ["RULES", "add_border"]

Ids = NDArray[np.int64]
Floats = NDArray[np.float64]


class Lines(NamedTuple):
    """Edges at borders over all tiles, each line once.

    Attributes
    ----------
    of_edge : int64 (n_edge,)
        Line of each edge of the tiles.
    nodes : int64 (n_line, 2)
        Places where lines start and end, by number.
    follower : int64 (2 * n_line,)
        The line that is met first when turning counter-clockwise round the start, and round the end, of each.
    """

    of_edge: Ids
    nodes: Ids
    follower: Ids


def border_lines(tile: EvpfTile) -> tuple[Floats, Floats]:
    """X and y of the borders of a tile with others, as coordinates are written; sides of the extent are none."""
    evpf = tile.level.evpf
    tiling = evpf.tiling
    lattice = evpf.lattice
    assert tiling is not None
    assert lattice is not None
    own = tiling.tile(tile.tile_id - 1)
    cols = [line for line in (own.first_col, own.last_col) if 0 < line < lattice.n_col - 1]
    rows = [line for line in (own.first_row, own.last_row) if 0 < line < lattice.n_row - 1]
    x, y = lattice.x0 + lattice.dx * np.array(cols, np.float64), lattice.y0 + lattice.dy * np.array(rows, np.float64)
    return (
        (x, y) if evpf.is_double else (x.astype(np.float32).astype(np.float64), y.astype(np.float32).astype(np.float64))
    )


def check_edges(tile: EvpfTile) -> Iterator[Defects]:
    """Edges are straight; on borders they run east or north, else so that the only, or the lesser, face lies to the left."""
    edges = tile.tile.edges
    if edges is None or edges.faces is None or tile.tile.plane is None:
        return
    starts, xyz = edges.places
    where = tile.tile.place("edg")
    bent = np.flatnonzero(np.diff(starts) != 2)
    yield from some(bent, lambda i: (f"{where} row={i + 1}", f"found {starts[i + 1] - starts[i]} places, expected two"))
    if len(bent):
        return
    start, end = xyz[0::2, :2], xyz[1::2, :2]
    x, y = border_lines(tile)
    is_east = (start[:, 1] == end[:, 1]) & np.isin(start[:, 1], y)
    is_north = (start[:, 0] == end[:, 0]) & np.isin(start[:, 0], x)
    right, left = edges.faces[:, 0, 0], edges.faces[:, 1, 0]
    is_face = [(face > 1) & (face <= tile.n_face + 1) for face in (right, left)]
    is_turned = np.where(is_face[0] & is_face[1], right < left, ~is_face[1]) & ~_is_at_junction(tile)
    is_turned = np.where(is_east, end[:, 0] < start[:, 0], np.where(is_north, end[:, 1] < start[:, 1], is_turned))
    message = "found face {} to the right and {} to the left, expected the edge to run the other way".format
    yield from some(np.flatnonzero(is_turned), lambda i: (f"{where} row={i + 1}", message(right[i], left[i])))


def _is_at_junction(tile: EvpfTile) -> NDArray[np.bool_]:
    """Tell which edges are parts of longer ones: in the store these have no face on one side."""
    plane, graph = tile.tile.plane, tile.tile.graph
    face, node = tile.junctions
    assert plane is not None
    assert graph is not None
    if not len(face):
        return np.zeros(len(graph.nodes), bool)
    most = int(graph.nodes.max(initial=0)) + 1
    known = face * most + node
    found = np.zeros(len(graph.nodes), bool)
    for way in (0, 1):
        own = plane.side_face.reshape(-1, 2)[:, way]
        found |= np.isin(own[:, None] * most + graph.nodes, known).any(axis=1)
    return found


def add_border(tile: EvpfTile, borders: Borders) -> None:
    """Gather what a tile says at its borders, and all edges that touch them."""
    places, tiling = tile.tile.node_places, tile.level.evpf.tiling
    if places is not None and tiling is not None and 1 <= tile.tile_id <= tiling.n_tile:
        x, y = border_lines(tile)
        borders.add(tile.tile, np.isin(places[:, 0], x) | np.isin(places[:, 1], y))
        tile.level.n_face[tile.tile_id] = tile.n_face


def _lines(edges: BorderEdges) -> Lines:
    """Join the edges of all tiles; one on a border runs the same way in both."""
    places, of_end = np.unique(edges.ends.reshape(-1, 2), axis=0, return_inverse=True)
    nodes, of_edge = np.unique(of_end.reshape(-1, 2), axis=0, return_inverse=True)
    starts, xy = np.arange(len(nodes) + 1) * 2, np.ascontiguousarray(places[nodes.ravel()])
    bucket, star, _ = sort_stars(nodes.ravel(), len(places), starts, xy, find_targets(starts, xy))
    follower = np.empty(len(star), np.int64)
    follower[star] = np.roll(star, -1) // 2
    first, last = bucket[:-1], bucket[1:] - 1
    follower[star[last]] = star[first] // 2
    return Lines(of_edge.ravel(), nodes, follower)


def _least(keys: Ids, tile: Ids, row: Ids) -> tuple[Ids, Ids, Ids]:
    """For each different key the least tile that has it, and the least row there; keys rise."""
    order = np.lexsort((row, tile, keys))
    different, first = np.unique(keys[order], return_index=True)
    return different, tile[order[first]], row[order[first]]


def check_borders(level: LevelTables) -> Iterator[Defects]:
    """External parts of nodes, faces and links."""
    borders = level.borders
    edges, external = borders.edges, borders.external
    if not len(edges.tile) or "tjunct.rat" in level.rows:
        return
    lines, tally = _lines(edges), Tally()
    expected = np.concatenate([_face_parts(level, edges, lines), _link_parts(edges, lines), _node_parts(edges, lines)])
    found = np.column_stack([external.tile, external.row, external.column, external.other_tile, external.other_row])
    _compare(borders, tally, found, expected)
    yield from tally.defects()


def _face_parts(level: LevelTables, edges: BorderEdges, lines: Lines) -> Ids:
    """External parts that faces should have: tile, row, column, other tile, other row."""
    order = np.lexsort((edges.tile, lines.of_edge))
    pair = np.flatnonzero(lines.of_edge[order[1:]] == lines.of_edge[order[:-1]])
    one, other = order[pair], order[pair + 1]
    tiles, of_edge = np.unique(edges.tile, return_inverse=True)
    most = np.array([level.n_face[tile] + 1 for tile in tiles.tolist()], np.int64)[of_edge]
    parts = []
    for own, there in ((one, other), (other, one)):
        for side in (0, 1):
            face = edges.faces[there, side, 0]
            is_face = (face > 1) & (face <= most[there])
            column = np.full(len(own), side)
            rows = np.column_stack([edges.tile[own], edges.row[own], column, edges.tile[there], face])
            parts.append(rows[is_face])
    return np.concatenate(parts)


def _link_parts(edges: BorderEdges, lines: Lines) -> Ids:
    """External parts that links at borders should have."""
    n_line = len(lines.nodes)
    keys, least_tile, least_row = _least(lines.of_edge, edges.tile, edges.row)
    own_keys = np.unique(edges.tile * n_line + lines.of_edge)
    parts = []
    for way, column in ((0, 3), (1, 2)):  # left_edge turns round the start, right_edge round the end
        follower = lines.follower[2 * lines.of_edge + way]
        is_away = edges.is_border[:, way] & ~np.isin(edges.tile * n_line + follower, own_keys)
        at = np.searchsorted(keys, follower[is_away])
        part = [
            edges.tile[is_away],
            edges.row[is_away],
            np.full(int(is_away.sum()), column),
            least_tile[at],
            least_row[at],
        ]
        parts.append(np.column_stack(part))
    return np.concatenate(parts)


def _node_parts(edges: BorderEdges, lines: Lines) -> Ids:
    """External parts that first edges of nodes should have: the next tile that has the node, and its lowest edge there."""
    place = lines.nodes[lines.of_edge]
    is_border = edges.is_border.ravel()
    node, tile = place.ravel()[is_border], np.repeat(edges.tile, 2)[is_border]
    row, cnd = np.repeat(edges.row, 2)[is_border], edges.nodes.ravel()[is_border]
    most = int(tile.max(initial=0)) + 1
    keys, _, lowest = _least(node * most + tile, tile, row)
    _, first = np.unique(node * most + tile, return_index=True)
    own_node, own_tile = np.divmod(keys, most)
    begin = np.searchsorted(own_node, own_node, side="left")
    end = np.searchsorted(own_node, own_node, side="right")
    following = np.where(np.arange(len(keys)) + 1 < end, np.arange(len(keys)) + 1, begin)
    is_shared = end - begin > 1
    column = np.full(len(keys), 4)
    rows = np.column_stack([own_tile, cnd[first], column, own_tile[following], lowest[following]])
    return rows[is_shared]


def _compare(borders: Borders, tally: Tally, found: Ids, expected: Ids) -> None:
    """Compare external parts found with those expected, by tile, row and column."""
    both = np.concatenate([found, expected])
    _, key = np.unique(both[:, :3], axis=0, return_inverse=True)
    key = key.ravel()
    n_key = int(key.max(initial=-1)) + 1
    told, wanted = np.zeros((n_key, 2), np.int64), np.zeros((n_key, 2), np.int64)
    place = np.zeros((n_key, 3), np.int64)
    told[key[: len(found)]], wanted[key[len(found) :]] = found[:, 3:], expected[:, 3:]
    place[key] = both[:, :3]
    wrong = np.flatnonzero((told != wanted).any(axis=1))

    def describe(i: int) -> tuple[str, str]:
        return borders.locate(
            *place[i].tolist()
        ), f"found {_part(told[i])} across the border, expected {_part(wanted[i])}"

    tally.add(wrong, describe)


def _part(part: Ids) -> str:
    return f"row {part[1]} of tile {part[0]}" if part[0] else "nothing"


RULES = (
    Rule("V781", "evpf_edges", ERROR, "E-210", "an edge does not run as in the store", check_edges, "evpf tile",
         needs=(*TILE, "evpf_rings", "evpf_junctions", "evpf_tiles")),
    Rule("V782", "evpf_borders", ERROR, "E-210", "a tile does not name what lies across its border", check_borders,
         "evpf level", needs=(*TILE, "evpf_tiles", "evpf_edges", "edge_links", "external_range", "external_faces",
                              "external_edges")),
)  # fmt: skip
