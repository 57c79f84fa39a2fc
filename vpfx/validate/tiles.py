"""Rules V6xx: tiles, what lies in them, and ids by place (R-130, R-131, R-150, R-152)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from vpfx.store.tiles import LATE_SHARE
from vpfx.validate.kernels import measure_tiles
from vpfx.validate.level_data import LevelData, border_of
from vpfx.validate.report import ERROR, Defects, Rule, one, some
from vpfx.validate.store_data import StoreData
from vpfx.validate.values import is_number

__all__ = ["RULES"]

COVER_PART, COVER_SLACKS = 1e-12, 4.0
"""Of the area of a tile, slacks of places along the perimeters of its faces, by which faces may add up to less or more."""


def check_extents(data: StoreData) -> Iterator[Defects]:
    """Extents are those of the posts on the lines between tiles, bit for bit."""
    x, y = data.tile_lines
    row, col = np.divmod(np.arange(len(data.tiles)), data.tiling.n_tile_col)
    expected = np.column_stack([x[col], y[row], x[col + 1], y[row + 1]])
    wrong = np.flatnonzero((data.boxes != expected).any(axis=1))
    yield from some(
        wrong, lambda i: (f"tile={i + 1}", f"found {data.boxes[i].tolist()}, the posts make {expected[i].tolist()}")
    )


def check_index(data: StoreData) -> Iterator[Defects]:
    """The index of tiles holds each tile, rounded outwards to single precision and no further."""
    rows = data.select("SELECT tile_id, xmin, ymin, xmax, ymax FROM tile_index ORDER BY tile_id")
    found = {row[0]: row[1:] for row in rows}
    for tile_id, _, *box in data.tiles:
        told = found.pop(tile_id, None)
        where = f"table=tile_index tile={tile_id}"
        if told is None or not all(map(is_number, told)):
            yield one(where, f"found {told}, expected the extent of the tile")
            continue
        is_outside = told[0] <= box[0] and told[1] <= box[1] and told[2] >= box[2] and told[3] >= box[3]
        reach = 4 * max(abs(value) for value in box) * 2.0**-23 + 1e-30
        if not is_outside or max(abs(a - b) for a, b in zip(told, box, strict=True)) > reach:
            yield one(where, f"found {list(told)}, expected {box}, rounded outwards to single precision")
    for tile_id in sorted(found):
        yield one(f"table=tile_index tile={tile_id}", "found a row, but no such tile")


def check_node_places(data: StoreData) -> Iterator[Defects]:
    """A node lies in the extent of its tile, borders included."""
    box = data.boxes[data.nodes["tile_id"] - 1]
    x, y = data.xyz[:, 0], data.xyz[:, 1]
    is_inside = (x >= box[:, 0]) & (y >= box[:, 1]) & (x <= box[:, 2]) & (y <= box[:, 3])

    def text(i: int) -> tuple[str, str]:
        where = f"tile={data.nodes['tile_id'][i]} node={data.nodes['node_id'][i]}"
        return where, f"found ({x[i]}, {y[i]}), not in the extent {box[i].tolist()}"

    yield from some(np.flatnonzero(~is_inside), text)


def check_node_ids(data: StoreData) -> Iterator[Defects]:
    """Nodes on borders and corners have the id of their place and the tile of least id there, others a running one."""
    tiling, ids = data.tiling, data.nodes["node_id"]
    if not tiling.n_border:
        return
    col, row = data.lines_of_nodes.T
    expected = np.zeros(len(ids), np.int64)
    is_corner = (col >= 0) & (row >= 0)
    expected[is_corner] = 1 + row[is_corner] * (tiling.n_tile_col + 1) + col[is_corner]
    for axis, at in ((0, row), (1, col)):
        on = np.flatnonzero(~is_corner & (at > 0) & (at < (tiling.n_tile_row, tiling.n_tile_col)[axis]))
        border, offset = border_of(tiling, axis, at[on], data.places[on, axis])
        expected[on] = tiling.n_corner + border * tiling.border_width + offset
    is_running = ids > tiling.n_border_node_id
    is_wrong = np.where(expected > 0, ids != expected, ~is_running)
    owner = np.where(expected > 0, tiling.node_owner(np.maximum(expected, 1)) + 1, data.nodes["tile_id"])
    is_wrong |= owner != data.nodes["tile_id"]

    def text(i: int) -> tuple[str, str]:
        wanted = f"id {expected[i]}" if expected[i] else f"an id above {tiling.n_border_node_id}"
        tile = data.nodes["tile_id"][i]
        return f"tile={tile} node={ids[i]}", f"found id {ids[i]}, tile {tile}; its place has {wanted}, tile {owner[i]}"

    yield from some(np.flatnonzero(is_wrong), text)


def check_border_ranges(data: StoreData) -> Iterator[Defects]:
    """Each level sets the ids of its edges on borders aside by the formula."""
    for row in data.level_rows:
        expected = data.tiling.border_edge_ids(row.level) or (None, None)
        found = (row.first_border_edge, row.last_border_edge)
        if found != expected:
            yield one(f"level={row.level}", f"border edges: found {found[0]} … {found[1]}, expected {expected}")


def check_edge_ids(level: LevelData) -> Iterator[Defects]:
    """Edges on borders, and outline edges that end on one, have the id of their place, others a running one."""
    tiling, edges = level.data.tiling, level.edges
    if not tiling.n_border:
        return
    border, offset = level.borders
    expected = np.zeros(len(border), np.int64)
    on = border >= 0
    expected[on] = tiling.border_edge_id(0, level.level, border[on] * tiling.border_width + offset[on])
    end_id = level.data.nodes["node_id"][level.edge_nodes[:, 1]]
    is_late = ~on & (level.edge_faces[:, 1] < 0) & (end_id <= tiling.n_border_node_id)
    late = np.flatnonzero(is_late)
    face = level.edge_faces[late, 0]
    tile = level.faces["tile_id"][face] - 1
    late = late[np.lexsort((level.edge_sides[late, 0], face, tile))]
    tile = level.faces["tile_id"][level.edge_faces[late, 0]] - 1
    rank = np.arange(len(late)) - np.searchsorted(tile, tile)
    first = 1 + tiling.n_border * tiling.border_width + tile * LATE_SHARE * tiling.border_width
    expected[late] = tiling.border_edge_id(0, level.level, 0) - 1 + first + rank  # type: ignore[arg-type]
    ids = edges["edge_id"]
    is_wrong = np.where(expected > 0, ids != expected, ids <= tiling.n_border_edge_id)

    def text(i: int) -> tuple[str, str]:
        wanted = f"id {expected[i]}" if expected[i] else f"an id above {tiling.n_border_edge_id}"
        return level.place("edge", i), f"found id {ids[i]}, its place has {wanted}"

    yield from some(np.flatnonzero(is_wrong), text)


def check_edge_tiles(level: LevelData) -> Iterator[Defects]:
    """An edge is of the tile of its faces, on a border of the lesser tile there."""
    tiling, tile_id = level.data.tiling, level.edges["tile_id"]
    border, _ = level.borders
    of_face = np.append(level.faces["tile_id"], 0)
    left, right = of_face[level.edge_faces].T
    is_inside = ((left == tile_id) | (left == 0)) & ((right == tile_id) | (right == 0))
    on = border >= 0
    is_good = is_inside
    if on.any():
        is_good = np.where(on, tile_id == tiling.border_owner(np.maximum(border, 0)) + 1, is_inside)
    yield from some(
        np.flatnonzero(~is_good),
        lambda i: (
            level.place("edge", i),
            f"found tile {tile_id[i]}, its faces are of {left[i]} and {right[i]} (0 is none)",
        ),
    )


def _boxes_and_areas(level: LevelData) -> tuple[NDArray[np.bool_], NDArray[np.float64], NDArray[np.float64]]:
    """Whether each face lies in the extent of its tile; areas and perimeters of the faces of each tile."""
    n_tile = len(level.data.tiles)
    found = np.empty(len(level.face_nodes), np.bool_), np.zeros(n_tile), np.zeros(n_tile)
    measure_tiles(level.data.xyz, level.face_nodes, level.faces["tile_id"] - 1, level.data.boxes, *found)
    return found


def check_face_places(level: LevelData) -> Iterator[Defects]:
    """A face lies in the extent of its tile."""
    is_inside, _, _ = level.once(_boxes_and_areas)
    yield from some(
        np.flatnonzero(~is_inside), lambda i: (level.place("face", i), "found a corner outside the extent of its tile")
    )


def check_cover(level: LevelData) -> Iterator[Defects]:
    """Where all ground has data, or was filled, faces cover each tile, no more and no less, and make one piece."""
    data, metadata = level.data, level.data.metadata
    if metadata["void_posts"] and not metadata["options"].get("fill"):
        return
    _, total, perimeter = level.once(_boxes_and_areas)
    expected = (data.boxes[:, 2] - data.boxes[:, 0]) * (data.boxes[:, 3] - data.boxes[:, 1])
    wrong = np.flatnonzero(
        ~(np.abs(total - expected) <= COVER_PART * expected + COVER_SLACKS * data.place_slack * perimeter)
    )
    where = f"level={level.level}"
    yield from some(
        wrong,
        lambda i: (f"{where} tile={i + 1}", f"found faces of {total[i]:.12g} in all, the tile has {expected[i]:.12g}"),
    )
    euler = int((data.nodes["level"] <= level.level).sum()) - len(level.edges["edge_id"]) + len(level.face_nodes)
    if not len(level.t_junctions["gap"]) and not len(wrong) and euler != 1:
        yield one(where, f"found {euler} for nodes - edges + faces, expected 1")


PLACED = ("tile_extent", "node_values")
RULES = (
    Rule("V601", "tile_extent", ERROR, "R-130", "the extent of a tile is not that of its posts", check_extents,
         needs=("tiles", "levels")),
    Rule("V602", "tile_index", ERROR, "R-131", "the index of tiles does not hold the tiles", check_index,
         needs=("tile_extent",)),
    Rule("V603", "node_place", ERROR, "R-150", "a node lies outside its tile", check_node_places, needs=PLACED),
    Rule("V604", "node_id", ERROR, "R-152", "a node does not have the id or the tile of its place", check_node_ids,
         needs=("node_place",)),
    Rule("V605", "border_range", ERROR, "R-152", "a level does not set the right ids aside for edges on borders",
         check_border_ranges, needs=("tiles", "levels")),
    Rule("V606", "edge_id", ERROR, "R-152", "an edge does not have the id of its place", check_edge_ids, "level",
         ("node_id", "border_range", "edge_direction", "face_place")),
    Rule("V607", "edge_tile", ERROR, "R-152", "an edge is not of the tile of its faces", check_edge_tiles, "level",
         ("node_id", "edge_faces", "edge_alone", "face_place")),
    Rule("V608", "face_place", ERROR, "R-150", "a face lies outside its tile", check_face_places, "level",
         ("node_place", "face_reference", "row_range")),
    Rule("V609", "cover", ERROR, "R-120", "faces do not cover the ground once", check_cover, "level",
         ("face_place", "face_clockwise", "face_area", "post_counts", "level_counts", "edge_alone", "node_unused",
          "t_junction")),
)  # fmt: skip
