"""Rules V750 to V753: bounding rectangles and spatial indexes of a tile."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from vpfx.validate.report import ERROR, Defects, Rule, one, some
from vpfx.validate.vpf.folders import TableData, places, read_index, rectangles, rounded
from vpfx.validate.vpf.tile import TileData
from vpfx.vpf import spatial_index

__all__ = ["RULES"]

Floats = NDArray[np.float64]

STEPS = 255
"""Steps of a spatial index, each way."""
SLACK = 1e-3
"""Of a step: producers round in single precision."""
INDEXES = {"nsi": "end", "csi": "cnd", "esi": "edg", "fsi": "fac", "tsi": "txt"}


def _boxes(tile: TileData, primitive: str) -> Floats | None:
    """Box of each primitive of a kind; None if they are not known."""
    if primitive == "edg":
        return tile.edge_boxes
    if primitive == "fac":
        return tile.face_boxes
    if primitive == "txt":
        table = tile.table("txt")
        found = None if table is None else places(table.rows, "shape_line")
        return None if found is None else found.boxes()
    xyz = tile.node_places if primitive == "cnd" else tile.entity_places
    return None if xyz is None else np.concatenate([xyz[:, :2], xyz[:, :2]], axis=1)


def _check_rectangles(tile: TileData, name: str, primitive: str) -> Iterator[Defects]:
    """Compare the rectangles of a table with what they are of."""
    table, boxes = tile.table(name), _boxes(tile, primitive)
    count = tile.coverage.count(primitive, tile.tile_id)
    box = rectangles(table)
    if table is None or box is None or count is None:
        return
    if table.n_row != count:
        yield one(f"table={table.where}", f"found {table.n_row} rows, expected {count}, one a row of {primitive}")
    elif boxes is not None:
        found = box.astype(np.float64)
        with np.errstate(invalid="ignore"):
            is_wrong = ~((found[:, :2] <= boxes[:, :2]) & (found[:, 2:] >= boxes[:, 2:])).all(axis=1)
        wrong = np.flatnonzero(is_wrong & np.isfinite(boxes).all(axis=1))
        yield from some(wrong, _describe_box(table, found, boxes))


def _describe_box(table: TableData, found: Floats, boxes: Floats) -> Callable[[int], tuple[str, str]]:
    return lambda i: (
        f"table={table.where} row={i + 1}",
        f"found the rectangle {rounded(found[i])}, expected it to hold {rounded(boxes[i])}",
    )


def check_edge_boxes(tile: TileData) -> Iterator[Defects]:
    """Rectangles of edges hold them."""
    yield from _check_rectangles(tile, "ebr", "edg")


def check_face_boxes(tile: TileData) -> Iterator[Defects]:
    """Rectangles of faces, but the universe, hold them."""
    yield from _check_rectangles(tile, "fbr", "fac")


def _index(tile: TileData, name: str) -> tuple[spatial_index.SpatialIndex | None, str]:
    """A spatial index, or what is wrong with it."""
    return read_index(tile.folder.files[name], spatial_index.read)


def _name(tile: TileData, name: str) -> str:
    return f"index={tile.folder.place(tile.folder.files[name].name)}"


def check_indexes(tile: TileData) -> Iterator[Defects]:
    """A spatial index has each row of its primitives once."""
    for name, primitive in INDEXES.items():
        count = tile.coverage.count(primitive, tile.tile_id)
        if name not in tile.folder.files or count is None:
            continue
        index, problem = _index(tile, name)
        if index is None:
            yield one(_name(tile, name), problem)
            continue
        if index.stray:
            yield one(_name(tile, name), f"found {index.stray} bytes behind the last entry, expected none")
        if len(index.ids) != count:
            yield one(
                _name(tile, name), f"found {len(index.ids)} primitives, expected {count}, the rows of {primitive}"
            )
        elif not np.array_equal(np.sort(index.ids), np.arange(1, count + 1)):
            other = np.setdiff1d(np.arange(1, count + 1), index.ids)
            yield one(
                _name(tile, name), f"found no entry for {len(other)} rows, such as {other[0]}, expected each once"
            )


def check_index_boxes(tile: TileData) -> Iterator[Defects]:
    """The boxes of a spatial index hold the primitives, and stand in their bins."""
    for name, primitive in INDEXES.items():
        boxes = _boxes(tile, primitive) if name in tile.folder.files else None
        index = None if boxes is None else _index(tile, name)[0]
        if index is None or boxes is None or len(index.ids) != len(boxes):
            continue
        if not np.array_equal(np.sort(index.ids), np.arange(1, len(boxes) + 1)):
            continue
        extent = np.array(index.extent)
        width = extent[2:] - extent[:2]
        with np.errstate(invalid="ignore", divide="ignore"):
            low, high = (STEPS * ((part - extent[:2]) / width) for part in np.split(boxes[index.ids - 1], 2, axis=1))
            is_short = index.boxes[:, :2] > np.clip(low, 0, STEPS) + SLACK
            is_short |= index.boxes[:, 2:] < np.clip(high, 0, STEPS) - 1 - SLACK  # readers look one step farther
        wrong = np.flatnonzero(is_short.any(axis=1))
        yield from some(wrong, _describe_entry(_name(tile, name), index, boxes))
        yield from some(index.misplaced, _describe_misplaced(_name(tile, name)))


def _describe_misplaced(where: str) -> Callable[[int], tuple[str, str]]:
    message = "found it in a bin whose place does not hold its box, expected it farther up"
    return lambda i: (f"{where} primitive={i}", message)


def _describe_entry(where: str, index: spatial_index.SpatialIndex, boxes: Floats) -> Callable[[int], tuple[str, str]]:
    def describe(i: int) -> tuple[str, str]:
        shown, own = tuple(index.boxes[i].tolist()), index.ids[i]
        expected = f"expected steps that hold {rounded(boxes[own - 1])}"
        return f"{where} primitive={own}", f"found the box {shown} in steps of {index.extent}, {expected}"

    return describe


RULES = (
    Rule("V750", "edge_boxes", ERROR, "V-506", "the rectangle of an edge does not hold it", check_edge_boxes, "tile",
         needs=("table_header", "table_rows", "edge_places")),
    Rule("V751", "face_boxes", ERROR, "V-506", "the rectangle of a face does not hold it", check_face_boxes, "tile",
         needs=("primitive_references", "edge_ends", "edge_places", "edges_cross", "edges_overlap", "ring_faces",
                "face_count")),
    Rule("V752", "spatial_index", ERROR, "V-300", "a spatial index does not have each primitive once", check_indexes, "tile",
         needs=("table_header", "table_rows", "face_count")),
    Rule("V753", "spatial_boxes", ERROR, "V-301", "a box of a spatial index is not that of its primitive", check_index_boxes,
         "tile", needs=("edge_ends", "edge_places", "ring_faces", "spatial_index")),
)  # fmt: skip
