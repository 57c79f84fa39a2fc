"""Digests of the rows of one tile and level: what shows a silent change (specs/format.md R-140)."""

from __future__ import annotations

import hashlib
import sqlite3
from collections.abc import Sequence
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vpfx.store.records import NULL_INT

__all__ = ["REALS", "Digest", "read_digest"]

MOST_WORD = 2**31 - 1

_TABLES = (
    ("node", "node_id, tile_id, level, x, y, z, z_parent, xyz", "node_id BETWEEN {first_node} AND {last_node}", "node_id"),
    ("edge", "edge_id, tile_id, level, start_node, end_node, right_face, left_face, right_edge, left_edge",
     "edge_id BETWEEN {first_edge} AND {last_edge}", "edge_id"),
    ("face", "face_id, tile_id, level, node_1, node_2, node_3, edge_1, edge_2, edge_3, is_filled, slope_centidegrees, "
     "aspect_centidegrees", "face_id BETWEEN {first_face} AND {last_face}", "face_id"),
    ("parent_child", "child_face, parent_face", "child_face BETWEEN {first_face} AND {last_face}", "child_face, parent_face"),
    ("t_junction", "edge_id, node_id, tile_id, level, gap", "edge_id BETWEEN {first_edge} AND {last_edge}",
     "edge_id, node_id"),
    ("shared_area", "child_face, parent_face, area", "child_face BETWEEN {first_face} AND {last_face}",
     "child_face, parent_face"),
)  # fmt: skip
REALS = ("x", "y", "z", "z_parent", "gap", "area")
"""Columns of doubles in those tables."""


class Digest:
    """BLAKE2b, 16 bytes, over columns of rows; what goes in for which value is said in specs/format.md R-140."""

    def __init__(self) -> None:
        self._hash = hashlib.blake2b(digest_size=16)

    def add(self, columns: Sequence[NDArray[Any]]) -> None:
        """Take the columns of some rows of one table, each column whole: int64, with NULL_INT for NULL, or other bytes."""
        for column in columns:
            if column.dtype == np.int64:
                words = np.empty(len(column), "<i4")
                column = words if _shorten(column, words) else column
            self._hash.update(np.ascontiguousarray(column).data)

    def value(self) -> bytes:
        """Return the digest."""
        return self._hash.digest()


@njit(nogil=True, cache=True)
def _shorten(column, words):  # type: ignore[no-untyped-def]
    """Copy integers to `words`, int32, NULL as the least; return whether all have room there."""
    has_room = True
    for i in range(len(column)):
        is_null = column[i] == NULL_INT
        has_room = has_room and (is_null or abs(column[i]) <= MOST_WORD)
        words[i] = -MOST_WORD - 1 if is_null else column[i]
    return has_room


def _columns(names: Sequence[str], rows: Sequence[Sequence[Any]]) -> list[NDArray[Any]]:
    """Columns of rows as they were when written."""
    columns: list[NDArray[Any]] = []
    for name, values in zip(names, zip(*rows, strict=True), strict=False):
        kinds = {type(value) for value in values}
        if name in REALS and kinds <= {float, type(None)}:
            columns.append(np.array([np.nan if value is None else value for value in values]))
        elif kinds == {bytes}:
            columns.append(np.frombuffer(b"".join(values), np.uint8))
        elif kinds <= {int, type(None)}:
            columns.append(np.array([NULL_INT if value is None else value for value in values], np.int64))
        else:  # no column that vpfx wrote: any other bytes will do
            columns.append(np.frombuffer(repr(values).encode(), np.uint8))
    return columns


def read_digest(connection: sqlite3.Connection, tile_id: int, level: int) -> bytes:
    """Compute the digest of a tile and level from its rows."""
    names = ("first_node", "last_node", "first_edge", "last_edge", "first_face", "last_face")
    row = connection.execute(
        f"SELECT {', '.join(names)} FROM tile_level WHERE tile_id = ? AND level = ?", (tile_id, level)
    ).fetchone()
    limits = {name: 0 if value is None else value for name, value in zip(names, row, strict=True)}
    digest = Digest()
    for table, columns, where, order in _TABLES:
        query = f"SELECT {columns} FROM {table} WHERE {where.format(**limits)} ORDER BY {order}"
        digest.add(_columns(columns.split(", "), connection.execute(query).fetchall()))
    return digest.value()
