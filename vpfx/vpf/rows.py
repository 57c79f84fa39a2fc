"""Rows of a table: bytes to columns and back, whole blocks of rows at a time.

Rows of fixed length are records of NumPy, packed; rows of different lengths are taken apart by kernels.

Source: specs/vpf.md, V-110 to V-120.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import VpfFormatError
from vpfx.vpf import kernels
from vpfx.vpf.header import COUNTED, KINDS, TEXT_KINDS, Column, Layout
from vpfx.vpf.values import Ragged

__all__ = [
    "decode_rows",
    "empty_column",
    "encode_rows",
    "iter_blocks",
    "record_type",
    "row_sizes",
    "scan_steps",
    "step_of",
]

BLOCK = 1 << 18
"""Bytes of rows that are worked on at a time: they stay in the processor's cache from one column to the next."""

Columns = Mapping[str, Any]
"""Arrays and Raggeds by lower-case name."""


def element_type(column: Column, order: str = "=") -> np.dtype[Any]:
    """Return the type of what a row has of a column, such as ``('<f4', (2,))`` for a pair of coordinates.

    Examples
    --------
    >>> element_type(Column("name", "T", 8)), element_type(Column("at", "C", 1)).shape
    (dtype('S8'), (2,))
    """
    if column.kind == "K":
        return np.dtype((np.int64, (3,)))
    if column.kind in TEXT_KINDS:
        return np.dtype("u1" if column.count == COUNTED else f"S{column.count}")
    member, n_member, _ = KINDS[column.kind]
    shape = (column.count,) * (column.count > 1) + (n_member,) * (n_member > 1)
    kind = np.dtype(order + member if member[0] != "S" else member)
    return np.dtype((kind, shape)) if shape else kind


def empty_column(column: Column, n_row: int) -> NDArray[Any]:
    """Return room for the rows of a column of fixed length, or for triplets, in native byte order."""
    return np.empty((n_row, 0), np.uint8) if column.kind == "X" else np.empty(n_row, element_type(column))


def record_type(layout: Layout) -> np.dtype[Any]:
    """Return the packed record that a row of fixed length is; columns of no bytes are left out.

    Examples
    --------
    >>> record_type(Layout("", (Column("id", "I"), Column("at", "C")), order=">")).itemsize
    12
    """
    fields = [(c.name.lower(), element_type(c, layout.order)) for c in layout.columns if c.kind != "X"]
    return np.dtype({"names": [name for name, _ in fields], "formats": [kind for _, kind in fields]})


def step_of(row_size: int) -> int:
    """Return how many rows to work on at a time."""
    return max(1, BLOCK // row_size)


def iter_blocks(n_row: int, row_size: int) -> Iterator[slice]:
    """Yield the rows to work on at a time."""
    step = step_of(row_size)
    for start in range(0, n_row, step):
        yield slice(start, min(start + step, n_row))


def scan_steps(layout: Layout) -> NDArray[np.int64]:
    """Return what a row consists of, for `scan_rows`: int64 (n_step, 2); columns of one length become one step."""
    steps: list[list[int]] = []
    for column in layout.columns:
        if column.kind == "K":
            steps.append([kernels.TRIPLET, 0])
        elif column.count == COUNTED:
            steps.append([kernels.COUNT, KINDS[column.kind].size])
        elif steps and steps[-1][0] == kernels.SKIP:
            steps[-1][1] += column.size
        else:
            steps.append([kernels.SKIP, column.size])
    return np.array(steps, np.int64)


def decode_rows(layout: Layout, data: NDArray[np.uint8], bounds: NDArray[np.int64], first: int, path: str) -> Columns:
    """Return the columns of rows of different lengths.

    Parameters
    ----------
    layout : Layout
        What the table has.
    data : uint8 (n_byte,)
        Bytes of the rows.
    bounds : int64 (n_row + 1,)
        Where rows start in them; the last row ends at the last.
    first : int
        Number of the first row in its table, and the file's name, for messages.
    path : str
        The file.

    Raises
    ------
    VpfFormatError
        A row does not end where it should; the message names it (V-120).
    """
    at, ends = bounds[:-1].copy(), bounds[1:]
    columns: dict[str, Any] = {}
    for column in layout.columns:
        values, bad = _take_column(column, data, at, ends, layout.order == ">")
        if bad >= 0:
            found = f"found bytes that end before the row does, at {bounds[-1] and int(at[bad] - bounds[bad])} of it"
            expected = f"expected {int(ends[bad] - bounds[bad])} bytes with column {column.name!r} in them"
            raise VpfFormatError(path, f"row {first + bad + 1}", f"{found}, {expected}", "V-120")
        columns[column.name.lower()] = values
    wrong = np.flatnonzero(at != ends)
    if len(wrong):
        row = int(wrong[0])
        sizes = int(at[row] - bounds[row]), int(ends[row] - bounds[row])
        message = f"found columns of {sizes[0]} bytes in a row of {sizes[1]}, expected as many"
        raise VpfFormatError(path, f"row {first + row + 1}", message, "V-120")
    return columns


def _take_column(
    column: Column, data: NDArray[np.uint8], at: NDArray[np.int64], ends: NDArray[np.int64], is_big: bool
) -> tuple[Any, int]:
    """Return the values of a column and the first row that is too short or -1; move all places behind the values."""
    if column.kind == "K":
        triplets = empty_column(column, len(at))
        return triplets, kernels.take_triplets(data, at, ends, is_big, triplets)
    if column.count == COUNTED:
        size, starts = KINDS[column.kind].size, np.zeros(len(at) + 1, np.int64)
        bad = kernels.take_counts(data, at, ends, size, is_big, starts)
        if bad >= 0:
            return None, bad
        out = np.empty(int(starts[-1]) * size, np.uint8)
        kernels.take_runs(data, at, starts, size, out)
        at += 4 + size * np.diff(starts)
        return Ragged(starts, _typed(out, column, is_big)), -1
    short = np.flatnonzero(at + column.size > ends)
    if len(short):
        return None, int(short[0])
    values = empty_column(column, len(at))
    if column.size:
        kernels.take_words(data, at, is_big, _words(values, column))
    at += column.size
    return values, -1


def _typed(out: NDArray[np.uint8], column: Column, is_big: bool) -> NDArray[Any]:
    """Return the bytes of elements as elements in native byte order."""
    one = element_type(column._replace(count=1))
    if column.kind in TEXT_KINDS:
        return out
    values = out.view(one.base).reshape(-1, *one.shape)
    return values.byteswap(inplace=True) if _is_swapped(is_big, one) else values


def _is_swapped(is_big: bool, kind: np.dtype[Any]) -> bool:
    return kind.base.kind != "S" and (np.dtype(">i4").isnative != is_big)


def _words(values: NDArray[Any], column: Column) -> NDArray[Any]:
    """Return values (n_row, ...) as unsigned numbers (n_row, n) that share their memory."""
    member = KINDS[column.kind].member
    word = "u1" if member[0] == "S" else f"u{member[1]}"
    return values.reshape(-1).view(word).reshape(len(values), -1)


def row_sizes(layout: Layout, columns: Columns, n_row: int) -> NDArray[np.int64]:
    """Return the bytes of each row, int64 (n_row,)."""
    sizes = np.full(n_row, layout.row_size, np.int64)
    for column in layout.columns:
        values = columns[column.name.lower()]
        if column.kind == "K":
            sizes += kernels.triplet_sizes(values) - 1
        elif column.count == COUNTED:
            sizes += values.counts * KINDS[column.kind].size
    return sizes


def encode_rows(layout: Layout, columns: Columns, bounds: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Return the bytes of rows of different lengths.

    Parameters
    ----------
    layout : Layout
        What the table has.
    columns : mapping
        Arrays and Raggeds in native byte order, checked.
    bounds : int64 (n_row + 1,)
        Where rows start, and where the last ends.
    """
    data, at, is_big = np.empty(int(bounds[-1]), np.uint8), bounds[:-1].copy(), layout.order == ">"
    for column in layout.columns:
        values = columns[column.name.lower()]
        if column.kind == "K":
            kernels.put_triplets(data, at, is_big, values)
        elif column.count == COUNTED:
            size = KINDS[column.kind].size
            elements = values.values
            if _is_swapped(is_big, elements.dtype) and elements.dtype.itemsize > 1:
                elements = elements.byteswap()
            runs = np.ascontiguousarray(elements).reshape(-1).view(np.uint8)
            kernels.put_runs(data, at, is_big, values.starts, size, runs)
            at += 4 + size * values.counts
        elif column.size:
            kernels.put_words(data, at, is_big, _words(np.ascontiguousarray(values), column))
            at += column.size
    return data
