"""Rules V12x: digests, which show every changed byte of the rows (R-140, R-141)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vpfx.store.digest import Digest
from vpfx.store.records import NULL_INT
from vpfx.validate.level_data import LevelData, rows_between
from vpfx.validate.report import ERROR, Defects, Rule, one

__all__ = ["RULES"]

NODE = ("node_id", "tile_id", "level", "x", "y", "z", "z_parent")
EDGE = ("edge_id", "tile_id", "level", "start_node", "end_node", "right_face", "left_face", "right_edge", "left_edge")
FACE = (
    "face_id", "tile_id", "level", "node_1", "node_2", "node_3", "edge_1", "edge_2", "edge_3", "is_filled",
    "slope_centidegrees", "aspect_centidegrees",
)  # fmt: skip
"""Columns in the order of R-140; nodes have their blob behind them."""


def _columns(rows: dict[str, NDArray[Any]], names: tuple[str, ...], part: Any) -> list[NDArray[Any]]:
    """Some rows of some columns as digests take them: NULL_INT where arrays have -1 for NULL."""
    found = [rows[name][part] for name in names]
    return [np.where(values == -1, NULL_INT, values) if values.dtype == np.int64 else values for values in found]


def check_digests(level: LevelData) -> Iterator[Defects]:
    """The digest of a tile and level is that of its rows."""
    data, links = level.data, level.links
    junctions, shared = level.t_junctions, level.shared_areas
    for tile, (of_node, of_edge, of_face) in enumerate(data.ranges[:, level.level]):
        digest, rows = Digest(), rows_between(data.nodes["node_id"], *of_node)
        digest.add([*_columns(data.nodes, NODE, rows), data.blobs[rows]])
        digest.add(_columns(level.edges, EDGE, rows_between(level.edges["edge_id"], *of_edge)))
        digest.add(_columns(level.faces, FACE, rows_between(level.faces["face_id"], *of_face)))
        digest.add(list(np.ascontiguousarray(links[rows_between(links[:, 0], *of_face)].T)))
        for columns, key, limits in ((junctions, "edge_id", of_edge), (shared, "child_face", of_face)):
            rows = rows_between(columns[key], *limits)
            digest.add([column[rows] for column in columns.values()])
        row = data.tile_levels[tile * len(data.level_rows) + level.level]
        if digest.value() != row[-1]:
            message = f"found {row[-1].hex()}, the rows have {digest.value().hex()}"
            yield one(f"level={level.level} tile={tile + 1}", message)


def check_border_digest(level: LevelData) -> Iterator[Defects]:
    """The digest of a level's borders is that of the rows whose ids are set aside."""
    data, digest = level.data, Digest()
    if level.row.first_border_edge is not None:
        nodes = np.flatnonzero(level.is_new & (data.nodes["node_id"] <= data.tiling.n_border_node_id))
        digest.add([*_columns(data.nodes, NODE, nodes), data.blobs[nodes]])
        rows = rows_between(level.edges["edge_id"], level.row.first_border_edge, level.row.last_border_edge)
        digest.add(_columns(level.edges, EDGE, rows))
    if digest.value() != level.row.border_digest:
        message = f"found {level.row.border_digest.hex()}, the rows have {digest.value().hex()}"
        yield one(f"level={level.level}", message)


READY = ("range_order", "node_values", "row_values", "node_xyz")
RULES = (
    Rule("V120", "digest", ERROR, "R-140", "rows of a tile and level were changed", check_digests, "level", READY),
    Rule("V121", "border_digest", ERROR, "R-141", "rows on borders were changed", check_border_digest, "level", READY),
)  # fmt: skip
