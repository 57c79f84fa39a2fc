"""Reads a store and a DEM for the judge, by plain sqlite3 and rasterio, and judges the tables and the winged edges."""

from __future__ import annotations

import functools
import math
import sqlite3
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import rasterio
from invariants_ground import Posts
from invariants_mesh import UNIT, Label, coordinate_tolerance, require

SIX = ("start_node", "end_node", "right_face", "left_face", "right_edge", "left_edge")
"""The columns of winged-edge topology."""

CORE = {
    "level": ("level", "max_error_bound", "max_error", "rmse", "node_count", "edge_count", "face_count"),
    "tile": ("tile_id", "tile_name", "xmin", "ymin", "xmax", "ymax"),
    "node": ("node_id", "tile_id", "level", "x", "y", "z", "xyz"),
    "edge": ("edge_id", "tile_id", "level", *SIX),
    "face": ("face_id", "tile_id", "level", "node_1", "node_2", "node_3", "edge_1", "edge_2", "edge_3"),
    "parent_child": ("parent_face", "child_face"),
}
"""The public SQL interface (design, section 4)."""

ANGLE = 64 * UNIT
"""Directions further apart than this many radians are in the right order: each is off by at most one half-ulp for its
differences and two ulps of π for the arc tangent, nine half-ulps of 2, and two are compared."""

REGISTRATION = 1e-6
"""Part of a spacing by which the origin of a lattice may differ between two accounts of it: 0.03 mm at one arc-second."""

PRINTED = 1e-9
"""Part of itself by which a spacing may differ between two accounts of it: files print some ten digits."""

BESIDE = 1e-7
"""Directions nearer to each other than this many radians, with nothing between, are those of edges along a longer one."""

MOSAIC = 1e-3
"""Part of a spacing by which the posts of files of one lattice may lie apart: far less than a lattice of their own."""

METRES = {"ft": 0.3048, "foot": 0.3048, "feet": 0.3048, "us-ft": 1200 / 3937, "us survey foot": 1200 / 3937}
"""Metres per unit of height; any other unit is taken for the metre."""


class Tables(NamedTuple):
    """What belongs to no single level."""

    connection: sqlite3.Connection
    levels: list[tuple[Any, ...]]  # rows of `level`, columns as in CORE
    tile_ids: Any
    tiles: Any  # (n_tile, 4) xmin, ymin, xmax, ymax
    node_ids: Any
    node_level: Any  # ascending, so that a level has a leading part of the nodes
    nodes: Any  # (n_node, 3)
    face_ids: Any  # of all levels, ascending
    face_level: Any
    links: Any  # (n_link, 2) face ids: parent, child
    z_parent: Any  # (n_node,) NaN for NULL; None where the store has no such column


class Level(NamedTuple):
    """The rows of one level as indices; -1 is NULL."""

    label: Label
    nodes: Any  # (n_node, 3) those of this level only
    faces: Any  # (n_face, 3) nodes
    face_edges: Any  # (n_face, 3)
    is_filled: Any  # (n_face,)
    edge_ids: Any
    ends: Any  # (n_edge, 2) start, end
    sides: Any  # (n_edge, 2) left, right face
    wings: Any  # (n_edge, 2) left, right edge
    junctions: Any  # (n, 2) node inside an edge, edge
    gaps: Any  # (n,) height of the node less that of the edge
    z_parent: Any  # (n_node,) NaN for NULL; None where the store has no such column


def read_posts(*paths: Any) -> Posts:
    """Read elevation files that lie on one lattice; where two have a post, the first valid one counts."""
    parts = []
    for path in paths:
        name = f"/vsigzip/{path}" if str(path).endswith(".gz") else path
        with rasterio.Env(CPL_VSIL_GZIP_WRITE_PROPERTIES="NO"), rasterio.open(name) as dataset:
            a, b, c, d, e, f = tuple(dataset.transform)[:6]
            require(b == d == 0 and a > 0 > e, f"{path}: found transform {(a, b, c, d, e, f)}, expected north up")
            heights = np.ma.filled(dataset.read(1, masked=True).astype(np.float64), np.nan)[::-1]
            heights = (heights * dataset.scales[0] + dataset.offsets[0]) * METRES.get(str(dataset.units[0]).lower(), 1)
            parts.append(Posts(heights, c + a / 2, f + e * (len(heights) - 0.5), a, -e))
    dx, dy = parts[0].dx, parts[0].dy
    x0, y0 = min(part.x0 for part in parts), min(part.y0 for part in parts)
    corners = []
    for path, part in zip(paths, parts, strict=True):
        offset = np.array([(part.y0 - y0) / dy, (part.x0 - x0) / dx])
        ends = offset + (np.array(part.heights.shape) - 1) * (part.dy / dy, part.dx / dx)
        wrong = max(np.abs(offset - np.rint(offset)).max(), np.abs(ends - np.rint(ends)).max())
        require(wrong <= MOSAIC, f"{path}: its posts are {wrong:.3g} spacings off the lattice of {paths[0]}")
        corners.append(np.rint(offset).astype(int))
    shape = np.max([corner + part.heights.shape for corner, part in zip(corners, parts, strict=True)], axis=0)
    heights = np.full(shape, np.nan)
    for (row, col), part in zip(corners, parts, strict=True):
        window = heights[row : row + part.heights.shape[0], col : col + part.heights.shape[1]]
        np.copyto(window, part.heights, where=np.isnan(window))
    return Posts(heights, x0, y0, dx, dy)


def register(posts: Any, tiles: Any) -> Posts:
    """Take the lattice from the tile borders if they lie on posts, but not to the last ulp.

    A builder may read 0.000833333333333 as 1/1200. That is no defect of its mesh; a greater shift is.
    """
    origin, spacing = [posts.x0, posts.y0], [posts.dx, posts.dy]
    for axis in range(2):
        borders = tiles[:, [axis, axis + 2]]
        number = np.rint((borders - origin[axis]) / spacing[axis])
        off = np.abs(borders - (origin[axis] + number * spacing[axis])).max()
        reach = (REGISTRATION + PRINTED * number.max()) * spacing[axis]
        if coordinate_tolerance(tiles) / 2 < off <= reach and number.max() > number.min():
            spacing[axis] = (borders.max() - borders.min()) / (number.max() - number.min())
            origin[axis] = borders.min() - number.min() * spacing[axis]
    return Posts(posts.heights, origin[0], origin[1], spacing[0], spacing[1])


def read_tables(path: Any) -> Tables:
    """Open a store read-only and judge everything that belongs to no single level."""
    connection = sqlite3.connect(f"{Path(path).resolve().as_uri()}?mode=ro", uri=True)
    for table, columns in CORE.items():
        found = [row[1] for row in connection.execute(f"PRAGMA table_info({table})")]
        missing = [column for column in columns if column not in found]
        require(not missing, f"table {table}: found columns {found}, missing {missing}")
    levels = connection.execute(f"SELECT {', '.join(CORE['level'])} FROM level ORDER BY level").fetchall()
    numbers = [row[0] for row in levels]
    require(numbers and numbers == list(range(len(levels))), f"table level: found {numbers}, expected levels 0, 1, …")
    for table in ("node", "edge", "face"):
        wrong = connection.execute(f"SELECT {table}_id FROM {table} WHERE level >= {len(levels)}").fetchone()
        require(wrong is None, f"{table} {wrong and wrong[0]}: its level does not exist")
    tile_ids = _ids(connection, "tile")
    tiles = _floats(connection, "tile", ("xmin", "ymin", "xmax", "ymax"), "tile_id")
    for i in np.flatnonzero((tiles[:, 0] >= tiles[:, 2]) | (tiles[:, 1] >= tiles[:, 3])):
        raise AssertionError(f"tile {tile_ids[i]}: its extent {tiles[i].tolist()} is empty")
    node_rows = _integers(connection, "node", ("node_id", "tile_id", "level"), order="level, node_id")
    nodes = _floats(connection, "node", ("x", "y", "z"), "level, node_id")
    _judge_blobs(connection, node_rows[:, 0], nodes)
    _ids(connection, "node"), _ids(connection, "edge"), _ids(connection, "face")
    faces = _integers(connection, "face", ("face_id", "level"))
    tables = Tables(
        connection,
        levels,
        tile_ids,
        tiles,
        node_rows[:, 0],
        node_rows[:, 2],
        nodes,
        *faces.T,
        None,
        _read_z_parent(connection),
    )
    _judge_extent(tables, "node", node_rows[:, 0], node_rows[:, 1], nodes[:, None, :2])
    return tables._replace(links=_read_links(tables))


def _read_z_parent(connection: Any) -> Any:
    """Read the heights of the level before at the nodes."""
    if "z_parent" not in [row[1] for row in connection.execute("PRAGMA table_info(node)")]:
        return None
    values = [row[0] for row in connection.execute("SELECT z_parent FROM node ORDER BY level, node_id")]
    require(all(value is None or isinstance(value, float) for value in values), "table node: z_parent is no number")
    return np.array([math.nan if value is None else value for value in values], np.float64)


def _integers(
    connection: Any, table: str, columns: Any, *, nullable: Any = (), where: str = "1", order: str = "1"
) -> Any:
    """Rows of positive integers (levels: not negative) as an array; NULL, where it is allowed, as 0."""
    tests = [f"{c} IS NOT NULL AND (typeof({c}) != 'integer' OR {c} < 1)" for c in nullable]
    tests += [f"typeof({c}) != 'integer' OR {c} < {int(c != 'level')}" for c in columns if c not in nullable]
    wrong = connection.execute(f"SELECT {', '.join(columns)} FROM {table} WHERE {' OR '.join(tests)}").fetchone()
    found = dict(zip(columns, wrong or (), strict=False))
    require(wrong is None, f"table {table}: found {found}, expected positive integers")
    chosen = ", ".join(f"ifnull({column}, 0)" if column in nullable else column for column in columns)
    rows = connection.execute(f"SELECT {chosen} FROM {table} WHERE {where} ORDER BY {order}").fetchall()
    return np.array(rows, dtype=np.int64).reshape(-1, len(columns))


def _floats(connection: Any, table: str, columns: Any, order: str) -> Any:
    """Rows of finite numbers as an array."""
    tests = " OR ".join(f"typeof({c}) NOT IN ('real', 'integer') OR abs({c}) > 1e300" for c in columns)
    wrong = connection.execute(f"SELECT {table}_id FROM {table} WHERE {tests}").fetchone()
    require(wrong is None, f"{table} {wrong and wrong[0]}: one of {', '.join(columns)} is not a finite number")
    rows = connection.execute(f"SELECT {', '.join(columns)} FROM {table} ORDER BY {order}").fetchall()
    return np.array(rows, dtype=np.float64).reshape(-1, len(columns))


def _ids(connection: Any, table: str) -> Any:
    """Return the ids of a table, positive and unique."""
    ids = _integers(connection, table, (f"{table}_id",))[:, 0]
    for i in np.flatnonzero(ids[1:] == ids[:-1]):
        raise AssertionError(f"{table} {ids[i]}: its id is not unique")
    return ids


def _judge_blobs(connection: Any, ids: Any, nodes: Any) -> None:
    """Each node's blob holds its x, y, z as little-endian doubles."""
    blobs = [row[0] for row in connection.execute("SELECT xyz FROM node ORDER BY level, node_id")]
    for i in (i for i, blob in enumerate(blobs) if not isinstance(blob, bytes) or len(blob) != 24):
        raise AssertionError(f"node {ids[i]}: xyz is not a blob of 24 bytes")
    held = np.frombuffer(b"".join(blobs), dtype="<f8").reshape(-1, 3)
    for i in np.flatnonzero((held != nodes).any(axis=1)):
        raise AssertionError(f"node {ids[i]}: xyz holds {held[i].tolist()}, the columns {nodes[i].tolist()}")


def _judge_extent(tables: Tables, table: str, ids: Any, tile_ids: Any, corners: Any) -> None:
    """Every row's tile exists and its extent holds the corners (n, n_corner, 2)."""
    tile = _to_index(tables.tile_ids, tile_ids, lambda i: f"{table} {ids[i]}: tile {tile_ids[i]}")
    reach = coordinate_tolerance(tables.tiles)
    low, high = tables.tiles[tile, None, :2] - reach, tables.tiles[tile, None, 2:] + reach
    for i in np.flatnonzero(((corners < low) | (corners > high)).any(axis=(1, 2))):
        raise AssertionError(f"{table} {ids[i]}: not within the extent of its tile {tile_ids[i]}")


def _to_index(ids: Any, values: Any, name: Any) -> Any:
    """Places of `values` in the ascending `ids`; 0, which stands for NULL, becomes -1."""
    index = np.searchsorted(ids, values)
    is_wrong = (np.append(ids, -1)[index] != values) & (values != 0)
    if is_wrong.any():
        raise AssertionError(f"{name(int(np.argmax(is_wrong)))} does not exist")
    return np.where(values == 0, -1, index)


def _read_links(tables: Tables) -> Any:
    """Pairs of face ids; each joins two faces of consecutive levels."""
    links = _integers(tables.connection, "parent_child", CORE["parent_child"], order="2, 1")
    level = []
    for i, kind in enumerate(CORE["parent_child"]):
        values = links[:, i]
        level.append(tables.face_level[_to_index(tables.face_ids, values, lambda n, k=kind, v=values: f"{k} {v[n]}")])
    for i in np.flatnonzero(level[1] != level[0] + 1):
        raise AssertionError(f"link {links[i].tolist()}: joins faces of levels {level[0][i]} and {level[1][i]}")
    return links


def read_level(tables: Tables, level: int) -> Level:
    """Read the faces and edges of one level; every reference must lead to a row of this level."""
    where, n_node = f"level = {level}", int(np.searchsorted(tables.node_level, level, side="right"))
    face_rows = _integers(tables.connection, "face", CORE["face"], where=where)
    edge_rows = _integers(tables.connection, "edge", CORE["edge"], nullable=CORE["edge"][5:7], where=where)
    face_ids, edge_ids = face_rows[:, 0], edge_rows[:, 0]
    label = Label(level, tables.node_ids, face_ids)
    by_id = np.argsort(tables.node_ids)

    def lookup(kind: str, rows: Any, first: int, count: int) -> Any:
        """Find the indices of what some columns of the rows name."""
        table = "face" if rows is face_rows else "edge"
        ids = {"node": tables.node_ids[by_id], "edge": edge_ids, "face": face_ids}[kind]
        columns = []
        for i in range(first, first + count):
            values, name = rows[:, i], CORE[table][i]
            text = f"level {level}: {table} {{}}: {name} {{}} of this level"
            columns.append(_to_index(ids, values, lambda n, v=values, t=text: t.format(rows[n, 0], v[n])))
        return np.stack(columns, axis=1)

    faces, ends = by_id[lookup("node", face_rows, 3, 3)], by_id[lookup("node", edge_rows, 3, 2)]
    for table, rows, corners in (("face", face_rows, faces), ("edge", edge_rows, ends)):
        for i, j in np.argwhere(corners >= n_node):
            node = corners[i, j]
            raise AssertionError(
                f"level {level}: {table} {rows[i, 0]}: {label.node(node)} is of level {tables.node_level[node]}"
            )
        _judge_extent(tables, table, rows[:, 0], rows[:, 1], tables.nodes[corners, :2])
    return Level(
        label,
        tables.nodes[:n_node],
        faces,
        lookup("edge", face_rows, 6, 3),
        _read_flags(tables.connection, label),
        edge_ids,
        ends,
        lookup("face", edge_rows, 5, 2)[:, ::-1],
        lookup("edge", edge_rows, 7, 2)[:, ::-1],
        *_read_junctions(tables, level, by_id, edge_ids),
        tables.z_parent if tables.z_parent is None else tables.z_parent[:n_node],
    )


def _read_junctions(tables: Tables, level: int, by_id: Any, edge_ids: Any) -> tuple[Any, Any]:
    """Nodes inside edges as the store tells them, and their gaps; none where the store has no such table."""
    if not tables.connection.execute("SELECT 1 FROM sqlite_schema WHERE name = 't_junction'").fetchone():
        return np.empty((0, 2), np.int64), np.empty(0)
    sql = f"SELECT node_id, edge_id, gap FROM t_junction WHERE level = {level} ORDER BY edge_id, node_id"
    rows = tables.connection.execute(sql).fetchall()
    wrong = [row for row in rows if not all(isinstance(v, k) for v, k in zip(row, (int, int, float), strict=True))]
    require(not wrong, f"table t_junction: found {wrong[:1]}, expected a node, an edge and a gap")
    node_ids, edges, gaps = (np.array([row[i] for row in rows]) for i in range(3))
    node = _to_index(tables.node_ids[by_id], node_ids.astype(np.int64), lambda i: f"t_junction: node {node_ids[i]}")
    edge = _to_index(edge_ids, edges.astype(np.int64), lambda i: f"t_junction: edge {edges[i]} of level {level}")
    return np.stack([by_id[node], edge], axis=1), gaps.astype(np.float64)


def read_shared_areas(tables: Tables, is_step: Any) -> Any:
    """Areas that some of the links share; None where the store tells none."""
    if not tables.connection.execute("SELECT 1 FROM sqlite_schema WHERE name = 'shared_area'").fetchone():
        return None
    rows = tables.connection.execute("SELECT parent_face, child_face, area FROM shared_area ORDER BY 2, 1").fetchall()
    if not rows:
        return None
    require(
        [row[:2] for row in rows] == [tuple(link) for link in tables.links.tolist()], "table shared_area: other pairs"
    )
    require(all(isinstance(row[2], float) for row in rows), "table shared_area: an area is no number")
    return np.array([row[2] for row in rows])[is_step]


def _read_flags(connection: Any, label: Label) -> Any:
    """Read `is_filled` of the faces of one level; false where the store has no such column."""
    if "is_filled" not in [row[1] for row in connection.execute("PRAGMA table_info(face)")]:
        return np.zeros(len(label.face_ids), bool)
    sql = f"SELECT is_filled FROM face WHERE level = {label.level} ORDER BY face_id"
    values = [value for (value,) in connection.execute(sql)]
    label.accuse([v not in (0, 1) for v in values], lambda i: f"{label.face(i)}: is_filled is {values[i]!r}")
    return np.array(values, bool)


def judge_edges(level: Level) -> None:
    """Judge the edges of a level whose faces `judge_mesh` has passed.

    They are those of the faces, each once, with the right faces and wings; ``edge_i`` joins ``node_i`` and the next.
    """
    label, (start, end), n_node = level.label, level.ends.T, len(level.nodes)

    def name(i: int) -> str:
        return f"edge {level.edge_ids[i]} ({label.node(start[i])} → {label.node(end[i])})"

    def compare(column: str, found: Any, expected: Any, say: Any) -> None:
        def text(i: int) -> str:
            there, here = ("NULL" if index < 0 else say(index) for index in (found[i], expected[i]))
            return f"{name(i)}: {column} is {there}, expected {here}"

        label.accuse(found != expected, text)

    key = np.minimum(start, end) * n_node + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    same = key[order[1:]] == key[order[:-1]]
    label.accuse(same, lambda i: f"{name(order[i])} and {name(order[i + 1])} join the same nodes")
    first, second = level.faces.ravel(), np.roll(level.faces, -1, axis=1).ravel()
    side = first * n_node + second
    by_side = np.argsort(side)
    for i, column, wanted in ((0, "left_face", start * n_node + end), (1, "right_face", end * n_node + start)):
        at = by_side[np.minimum(np.searchsorted(side[by_side], wanted), len(side) - 1)]
        compare(column, level.sides[:, i], np.where(side[at] == wanted, at // 3, -1), label.face)
    label.accuse((level.sides < 0).all(axis=1), lambda i: f"{name(i)}: no face uses it")
    edge = level.face_edges.ravel()
    is_wrong = key[edge] != np.minimum(first, second) * n_node + np.maximum(first, second)
    label.accuse(
        is_wrong,
        lambda h: (
            f"{label.face(h // 3)}: edge_{h % 3 + 1} is {name(edge[h])}, expected one that joins "
            f"{label.node(first[h])} and {label.node(second[h])}"
        ),
    )
    has_left = (level.sides >= 0).T.ravel() if len(level.junctions) else None
    following = next_around(level.nodes[:, :2], start, end, has_left).reshape(2, -1) % len(start)
    for i, column in enumerate(("left_edge", "right_edge")):
        compare(column, level.wings[:, i], following[i], lambda e: f"edge {level.edge_ids[e]}")


def next_around(xy: Any, start: Any, end: Any, has_left: Any = None) -> Any:
    """For each edge leaving its start, then for each leaving its end: the next leaving that node counter-clockwise.

    Edge e leaves its start as e and its end as ``n_edge + e``. Angles sort them; where two are too near each other for
    floats, all edges of that node are sorted exactly. Where there are T-junctions, two edges may run side by side: the one
    without a face to its left (`has_left`, in this order of edges) is met first.
    """
    origin, target = np.concatenate([start, end]), np.concatenate([end, start])
    angle = np.arctan2(*(xy[target] - xy[origin] + 0.0).T[::-1])  # + 0.0: no direction is at -π
    order = np.lexsort((angle, origin))
    node, angle = origin[order], angle[order]
    is_last = np.ones(len(order), bool)
    is_last[:-1] = node[1:] != node[:-1]
    first = np.flatnonzero(np.roll(is_last, 1))
    last = np.flatnonzero(is_last)
    gap = np.roll(angle, -1) - angle
    gap[last] = np.where(first == last, 2 * np.pi, angle[first] + 2 * np.pi - angle[last])
    for i in np.unique(np.searchsorted(last, np.flatnonzero(gap < ANGLE))):
        fan = order[first[i] : last[i] + 1]
        order[first[i] : last[i] + 1] = _sort_around(xy, origin[fan[0]], target[fan], fan)
    if has_left is not None:
        run = np.searchsorted(last, np.arange(len(order)))
        for i in np.flatnonzero((np.abs(gap) < BESIDE) & (first[run] != last[run])):
            j = first[run[i]] if i == last[run[i]] else i + 1
            if has_left[order[i]] and not has_left[order[j]]:
                order[i], order[j] = order[j], order[i]
    following = np.roll(order, -1)
    following[last] = order[first]
    result = np.empty_like(order)
    result[order] = following
    return result


def _sort_around(xy: Any, origin: int, targets: Any, fan: Any) -> list[int]:
    """Sort edges that leave one node by direction, from just above west counter-clockwise to west, without error."""
    x0, y0 = (Fraction(float(value)) for value in xy[origin])
    ways = [(Fraction(float(x)) - x0, Fraction(float(y)) - y0) for x, y in xy[targets]]

    def compare(i: int, j: int) -> int:
        (ax, ay), (bx, by) = ways[i], ways[j]
        difference = (ay >= 0) - (by >= 0) or by * ax * -1 + bx * ay or bx - ax
        return (difference > 0) - (difference < 0)

    return [int(fan[i]) for i in sorted(range(len(fan)), key=functools.cmp_to_key(compare))]
