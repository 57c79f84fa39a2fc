"""Rules V21x and V22x: rows of nodes, edges, faces and links: values, ranges, counts, references (R-102, R-120 to R-182)."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from vpfx.errors import StoreFormatError
from vpfx.validate.level_data import LevelData, StepData, rows_between
from vpfx.validate.report import ERROR, MOST_SHOWN, Defects, Rule, one, some
from vpfx.validate.store_data import RANGED, StoreData

__all__ = ["RULES"]

MOST_SLOPE, MOST_ASPECT = 9000, 35999  # hundredths of a degree
NULLABLE = {"edge": ("right_face", "left_face"), "face": ("aspect_centidegrees",)}
"""Columns of whole numbers that may be NULL."""
REFERENCES = {
    "edge": (("edge_nodes", "start_node", "end_node"), ("edge_links", "left_edge", "right_edge")),
    "face": (("face_nodes", "node_1", "node_2", "node_3"), ("face_edges", "edge_1", "edge_2", "edge_3")),
}
"""Of the tables: arrays of indices that their columns give."""


def check_node_values(data: StoreData) -> Iterator[Defects]:
    """Every value of a node is of its kind and in its range."""
    try:
        nodes = data.nodes
    except StoreFormatError as error:
        yield from _strange_values(data, "node", ("z_parent",), str(error))
        return
    ids, is_good = nodes["node_id"], np.isfinite(data.xyz).all(axis=1)
    is_good &= (nodes["tile_id"] >= 1) & (nodes["tile_id"] <= len(data.tiles)) & ~np.isinf(nodes["z_parent"])
    is_good &= (nodes["level"] >= 0) & (nodes["level"] < len(data.level_rows)) & (ids >= 1)
    (count,) = data.select("SELECT count(*) FROM node")[0]
    if count != len(ids):
        yield one("table=node", f"found {count - len(ids)} ids below 1, expected positive ones")

    def text(i: int) -> tuple[str, str]:
        values = {name: nodes[name][i].item() for name in ("tile_id", "level", "x", "y", "z", "z_parent")}
        return f"node={ids[i]}", f"found {values}, expected a tile, a level and finite numbers"

    yield from some(np.flatnonzero(~is_good), text)


def _strange_values(data: StoreData, table: str, nullable: Any, reason: str) -> Iterator[Defects]:
    """Rows of a table with a value of another kind, as SQLite finds them; the reason why they are looked for, if none."""
    described = data.select(f"PRAGMA table_info({table})")
    kinds = {"INTEGER": "'integer'", "DOUBLE": "'real'", "BLOB": "'blob'"}
    tests = [
        f"typeof({name}) NOT IN ({kinds[declared]}{', ' + repr('null') if name in nullable else ''})"
        for _, name, declared, *_ in described
    ]
    key = described[0][1]
    where = " OR ".join(tests)
    (count,) = data.select(f"SELECT count(*) FROM {table} WHERE {where}")[0]
    rows = data.first(f"SELECT {key} FROM {table} WHERE {where} ORDER BY {key}", MOST_SHOWN)
    if count:
        yield Defects(count, lambda i: (f"{table}={rows[i][0]}", "found a value of another kind"))
    else:
        yield one(f"table={table}", reason)


def check_row_values(level: LevelData) -> Iterator[Defects]:
    """Every value of edges, faces, links and what belongs to them is of its kind and in its range."""
    for table, nullable in NULLABLE.items():
        try:
            rows = level.edges if table == "edge" else level.faces
        except StoreFormatError as error:
            yield from _strange_values(level.data, table, nullable, str(error))
            return
        is_good = np.ones(len(rows["tile_id"]), bool)
        for name, values in rows.items():
            least, most = _limits(level, name)
            is_good &= ((values >= least) & (values <= most)) | ((values == -1) if name in nullable else False)

        def text(i: int, table: str = table, rows: Any = rows) -> tuple[str, str]:
            values = {name: int(column[i]) for name, column in rows.items()}
            return level.place(table, i), f"found {values}, of which one is not in its range (-1 is NULL)"

        yield from some(np.flatnonzero(~is_good), text)
    for table, judge in (
        ("parent_child", _judge_links),
        ("t_junction", _judge_junctions),
        ("shared_area", _judge_areas),
    ):
        try:
            yield from judge(level)
        except StoreFormatError as error:
            yield from _strange_values(level.data, table, (), str(error))


def _limits(level: LevelData, name: str) -> tuple[int, int]:
    """Least and greatest value of a column."""
    known = {
        "level": (0, len(level.data.level_rows) - 1),
        "tile_id": (1, len(level.data.tiles)),
        "is_filled": (0, 1),
        "slope_centidegrees": (0, MOST_SLOPE),
        "aspect_centidegrees": (0, MOST_ASPECT),
    }
    return known.get(name, (1, 2**63 - 1))


def _judge_links(level: LevelData) -> Iterator[Defects]:
    """Ids of linked faces are positive."""
    links = level.links
    wrong = np.flatnonzero((links < 1).any(axis=1))
    yield from some(
        wrong, lambda i: (f"level={level.level} face={links[i, 0]}", f"found the parent {links[i, 1]}, expected an id")
    )


def _judge_junctions(level: LevelData) -> Iterator[Defects]:
    """T-junctions have positive ids, the level of their edge, and a finite gap."""
    rows = level.t_junctions
    is_good = (
        (rows["node_id"] >= 1) & (rows["tile_id"] >= 1) & (rows["level"] == level.level) & np.isfinite(rows["gap"])
    )

    def text(i: int) -> tuple[str, str]:
        where = f"level={level.level} edge={rows['edge_id'][i]} node={rows['node_id'][i]}"
        return where, "found a T-junction of which a value is not in its range, or of another level"

    yield from some(np.flatnonzero(~is_good), text)


def _judge_areas(level: LevelData) -> Iterator[Defects]:
    """Shared areas are above 0 and finite, and of faces."""
    rows = level.shared_areas
    area, parent = rows["area"], rows["parent_face"]
    is_good = (parent >= 1) & (area > 0) & np.isfinite(area)

    def text(i: int) -> tuple[str, str]:
        where = f"level={level.level} face={rows['child_face'][i]}"
        return where, f"found {area[i]} shared with {parent[i]}, expected an area"

    yield from some(np.flatnonzero(~is_good), text)


def check_stray_rows(data: StoreData) -> Iterator[Defects]:
    """No row has an id between, before or behind the ranges."""
    borders = [(row.first_border_edge, row.last_border_edge) for row in data.level_rows]
    set_aside = {"edge": [limits for limits in borders if limits[0] is not None], "node": []}
    if data.tiling.n_border_node_id:
        set_aside["node"] = [(1, data.tiling.n_border_node_id)]
    for i, table in enumerate(RANGED):
        ranges = data.ranges[:, :, i].reshape(-1, 2).tolist()
        yield from _rows_in_gaps(data, table, f"{table}_id", table, ranges + set_aside.get(table, []))
    with_parents = data.ranges[:, 1:, 2].reshape(-1, 2).tolist()
    for table in ("parent_child", "shared_area"):
        yield from _rows_in_gaps(data, table, "child_face", "face", with_parents)
    yield from _rows_in_gaps(data, "t_junction", "edge_id", "edge", data.ranges[:, :, 1].reshape(-1, 2).tolist())


def _rows_in_gaps(data: StoreData, table: str, key: str, of: str, ranges: list[Any]) -> Iterator[Defects]:
    """Rows of a table that lie in none of some ranges."""
    following = -(2**63)
    for low, high in [*sorted(tuple(limits) for limits in ranges if limits[0] <= limits[1]), (None, None)]:
        if low is None or low > following:
            behind = "" if low is None else f" AND {key} < {low}"  # texts come behind all numbers
            where = f"FROM {table} WHERE {key} >= {following}{behind}"
            (count,) = data.select(f"SELECT count(*) {where}")[0]
            if count:
                rows = data.first(f"SELECT {key} {where}", MOST_SHOWN)
                ids = [row[0] for row in rows]
                yield Defects(count, partial(_stray, table, of, ids))
        following = following if high is None else max(following, min(high, 2**63 - 2) + 1)


def _stray(table: str, of: str, ids: list[Any], i: int) -> tuple[str, str]:
    return f"table={table} {of}={ids[i]}", "found a row that is in no range of ids"


def check_node_ranges(data: StoreData) -> Iterator[Defects]:
    """Nodes in the range of a tile and level are of both, and as many as the range has ids."""
    nodes = data.nodes
    for tile, level in np.ndindex(data.ranges.shape[:2]):
        yield from _check_range(nodes, "node", data.ranges[tile, level, 0], tile, level)


def check_row_ranges(level: LevelData) -> Iterator[Defects]:
    """Edges and faces in the range of a tile and level are of both, and as many as the range has ids."""
    for i, table in ((1, "edge"), (2, "face")):
        rows = level.edges if table == "edge" else level.faces
        for tile, limits in enumerate(level.data.ranges[:, level.level, i]):
            yield from _check_range(rows, table, limits, tile, level.level)


def _check_range(rows: Any, table: str, limits: Any, tile: int, level: int) -> Iterator[Defects]:
    """Rows of one range of ids."""
    low, high = limits.tolist()
    part, expected = rows_between(rows[f"{table}_id"], low, high), high + 1 - low
    where = f"level={level} tile={tile + 1}"
    if part.stop - part.start != expected:
        yield one(where, f"{table}: found {part.stop - part.start} rows, expected {expected}, as many as the range has")
    tile_id, found_level, ids = rows["tile_id"][part], rows["level"][part], rows[f"{table}_id"][part]
    wrong = np.flatnonzero((tile_id != tile + 1) | (found_level != level))

    def text(i: int) -> tuple[str, str]:
        found = f"found tile {tile_id[i]}, level {found_level[i]}"
        return f"{where} {table}={ids[i]}", f"{found}, expected those of its range"

    yield from some(wrong, text)


def check_counts(level: LevelData) -> Iterator[Defects]:
    """The table of levels counts what is there."""
    n_node = int((level.data.nodes["level"] <= level.level).sum())
    found = {"node_count": n_node, "edge_count": len(level.edges["edge_id"]), "face_count": len(level.faces["face_id"])}
    for name, count in found.items():
        if getattr(level.row, name) != count:
            yield one(f"level={level.level}", f"{name}: found {getattr(level.row, name)}, counted {count}")


def check_xyz(data: StoreData) -> Iterator[Defects]:
    """The blob of a node holds its place, bit for bit."""
    blobs = data.blobs
    expected = np.ascontiguousarray(data.xyz.astype("<f8")).view(np.uint8).reshape(-1, 24)
    wrong = np.flatnonzero((blobs != expected).any(axis=1)) if len(blobs) == len(expected) else np.empty(0, np.int64)
    if len(blobs) != len(expected):
        yield one("table=node", "xyz: found a blob that has not 24 bytes")

    def text(i: int) -> tuple[str, str]:
        held = blobs[i].view("<f8").tolist()
        return f"node={data.nodes['node_id'][i]}", f"xyz: found {held}, expected {data.xyz[i].tolist()}"

    yield from some(wrong, text)


def check_edge_references(level: LevelData) -> Iterator[Defects]:
    """What an edge names is there, and belongs to its level."""
    yield from _missing(level, "edge")
    names = ("left_face", "right_face")
    told = np.stack([level.edges[name] for name in names], axis=1)
    index = np.flatnonzero(((level.edge_faces < 0) & (told >= 0)).ravel())
    yield from some(index, lambda i: (level.place("edge", i // 2), _no_such(names[i % 2], told.ravel()[i], level)))


def check_face_references(level: LevelData) -> Iterator[Defects]:
    """What a face names is there, and belongs to its level."""
    yield from _missing(level, "face")


def _no_such(name: str, found: int, level: LevelData) -> str:
    return f"{name}: found {found}, expected one of level {level.level}"


def _missing(level: LevelData, table: str) -> Iterator[Defects]:
    """References of a table that lead nowhere, or to a node of a finer level."""
    rows = level.edges if table == "edge" else level.faces
    node_level = np.append(level.data.nodes["level"], len(level.data.level_rows))
    for array, *names in REFERENCES[table]:
        found = getattr(level, array)
        is_wrong = found < 0 if array.endswith(("edges", "links")) else node_level[found] > level.level
        n = len(names)

        def text(i: int, names: Any = names, n: int = n) -> tuple[str, str]:
            return level.place(table, i // n), _no_such(names[i % n], rows[names[i % n]][i // n], level)

        yield from some(np.flatnonzero(is_wrong.ravel()), text)


def check_link_references(step: StepData) -> Iterator[Defects]:
    """Links join a face of one level and one of the level before, of the same tile."""
    links = step.fine.links
    parent, child = step.pairs.T
    is_wrong = (parent < 0) | (child < 0)
    tiles = step.coarse.faces["tile_id"], step.fine.faces["tile_id"]
    if len(tiles[0]) and len(tiles[1]):
        is_wrong |= tiles[0][parent] != tiles[1][child]
    where = f"level={step.fine.level}"
    expected = f"expected a face of level {step.coarse.level} and of the same tile"
    yield from some(
        np.flatnonzero(is_wrong),
        lambda i: (f"{where} face={links[i, 0]}", f"found the parent {links[i, 1]}, {expected}"),
    )


def check_junction_references(level: LevelData) -> Iterator[Defects]:
    """A T-junction names an edge and a node of its level, and its tile."""
    rows, (edge, node) = level.t_junctions, level.junctions
    tile_of_edge = np.append(level.edges["tile_id"], 0)  # where there is no such edge
    level_of_node = np.append(level.data.nodes["level"], len(level.data.level_rows))
    is_wrong = (tile_of_edge[edge] != rows["tile_id"]) | (level_of_node[node] > level.level)

    def text(i: int) -> tuple[str, str]:
        tile_id, edge_id, node_id = (rows[name][i] for name in ("tile_id", "edge_id", "node_id"))
        where = f"level={level.level} tile={tile_id} edge={edge_id} node={node_id}"
        return where, "found no such edge or node on this level, or another tile"

    yield from some(np.flatnonzero(is_wrong), text)


READY = ("range_order", "node_values", "row_values", "node_range", "row_range")
RULES = (
    Rule("V210", "node_values", ERROR, "R-102", "a value of a node is of another kind or not in its range",
         check_node_values, needs=("tile_levels",)),
    Rule("V211", "row_values", ERROR, "R-102", "a value of an edge, a face or a link is of another kind or not in its range",
         check_row_values, "level", ("range_order",)),
    Rule("V212", "stray_row", ERROR, "R-132", "a row lies in no range of ids", check_stray_rows,
         needs=("range_order",)),
    Rule("V213", "node_range", ERROR, "R-132", "nodes are not those of their range", check_node_ranges,
         needs=("range_order", "node_values")),
    Rule("V214", "row_range", ERROR, "R-132", "edges or faces are not those of their range", check_row_ranges, "level",
         ("range_order", "row_values")),
    Rule("V215", "level_counts", ERROR, "R-120", "the rows of a level are not as many as it counts", check_counts, "level",
         READY),
    Rule("V216", "node_xyz", ERROR, "R-150", "the blob of a node does not hold its place", check_xyz,
         needs=("node_values",)),
    Rule("V220", "edge_reference", ERROR, "R-160", "an edge names a node, face or edge that is not there",
         check_edge_references, "level", READY),
    Rule("V221", "face_reference", ERROR, "R-170", "a face names a node or edge that is not there",
         check_face_references, "level", READY),
    Rule("V222", "link_reference", ERROR, "R-180", "a link does not lead from level to level inside its tile",
         check_link_references, "step", READY),
    Rule("V223", "junction_reference", ERROR, "R-190", "a T-junction names an edge or node that is not there",
         check_junction_references, "level", READY),
)  # fmt: skip
