"""Rows of a table: bytes to columns and back, whole blocks of rows at a time.

Rows of fixed length are records of NumPy, packed; rows of different lengths are taken apart by kernels.

Source: specs/vpf.md, V-110 to V-120.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

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

_HINT = "; if the index file is wrong, the table can be read without it"

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
    member, n_member, _ = KINDS[column.kind]
    if column.kind in TEXT_KINDS:
        return np.dtype("u1" if column.count == COUNTED else f"S{column.count}")
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
    """Return how many rows of one length to work on at a time."""
    return max(1, BLOCK // row_size)


def iter_blocks(n_row: int, row_size: int) -> Iterator[slice]:
    """Yield the rows of one length to work on at a time."""
    step = step_of(row_size)
    for start in range(0, n_row, step):
        yield slice(start, min(start + step, n_row))


def iter_uneven_blocks(bounds: NDArray[np.int64]) -> Iterator[slice]:
    """Yield the rows to work on at a time, where row i lies between bounds i and i + 1."""
    start, n_row = 0, len(bounds) - 1
    while start < n_row:
        stop = max(start + 1, int(np.searchsorted(bounds, bounds[start] + BLOCK, "right")) - 1)
        yield slice(start, stop)
        start = stop


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


def decode_rows(
    layout: Layout,
    data: NDArray[np.uint8],
    bounds: NDArray[np.int64],
    columns: dict[str, Any],
    *,
    path: str,
    first: int,
) -> None:
    """Take rows of different lengths apart.

    Parameters
    ----------
    layout : Layout
        What the table has.
    data : uint8 (n_byte,)
        Bytes of the rows.
    bounds : int64 (n_row + 1,)
        Where rows start in them, and where the last ends.
    columns : dict
        Room for each column that is no Ragged, filled here; Raggeds are put beside it.
    path : str
        The file, for messages.
    first : int
        Number of rows before these, for messages.

    Raises
    ------
    VpfFormatError
        The values of a row do not end where the row does; the message names it (V-120).
    """
    at, ends = bounds[:-1].copy(), bounds[1:]
    rows = _Rows(data, at, ends, layout.order == ">")
    for column in layout.columns:
        if column.count == COUNTED:
            columns[column.name.lower()], bad = _take_ragged(column, rows)
        else:
            bad = _take_array(column, rows, columns[column.name.lower()])
        if bad >= 0:
            where = f"row {first + bad + 1}: column {column.name!r}"
            found = f"found a value that runs over the end of its row, at byte {ends[bad] - bounds[bad]} of it"
            raise VpfFormatError(path, where, f"{found}, expected it to end before{_HINT}", "V-120")
    wrong = np.flatnonzero(at != ends)
    if len(wrong):
        row = int(wrong[0])
        message = f"found values of {at[row] - bounds[row]} bytes in a row of {ends[row] - bounds[row]}"
        raise VpfFormatError(path, f"row {first + row + 1}", f"{message}, expected as many{_HINT}", "V-120")


class _Rows(NamedTuple):
    """Rows that are taken apart, column by column."""

    data: NDArray[np.uint8]  # (n_byte,)
    at: NDArray[np.int64]  # (n_row,), the place of the next column in each row; moves on
    ends: NDArray[np.int64]  # (n_row,)
    is_big: bool


def _take_array(column: Column, rows: _Rows, values: NDArray[Any]) -> int:
    """Fill a column; move on; return the first row that is too short, or -1."""
    if column.kind == "K":
        return kernels.take_triplets(*rows, values)
    short = np.flatnonzero(rows.at + column.size > rows.ends)
    if len(short):
        return int(short[0])
    if column.kind != "X":
        kernels.take_bytes(rows.data, rows.at, _as_bytes(values, column.size))
        _swap(values, rows.is_big)
        np.add(rows.at, column.size, out=rows.at)
    return -1


def _take_ragged(column: Column, rows: _Rows) -> tuple[Ragged, int]:
    """Return a column whose rows say how much they have, and the first row that is too short, or -1."""
    size, starts = KINDS[column.kind].size, np.zeros(len(rows.at) + 1, np.int64)
    bad = kernels.take_counts(*rows, size, starts)
    values = np.empty(starts[-1] if bad < 0 else 0, element_type(column))
    if bad < 0:
        kernels.take_runs(rows.data, rows.at, starts, size, _as_bytes(values, size).reshape(-1))
        _swap(values, rows.is_big)
        np.add(rows.at, 4 + size * np.diff(starts), out=rows.at)
    return Ragged(starts, values), bad


def join_ragged(column: Column, parts: list[Ragged]) -> Ragged:
    """Return parts of a column, one behind the other."""
    if len(parts) == 1:
        return parts[0]
    counts = np.concatenate([np.zeros(1, np.int64), *(part.counts for part in parts)])
    nothing = np.empty(0, element_type(column))
    return Ragged(np.cumsum(counts), np.concatenate([nothing, *(part.values for part in parts)]))


def _as_bytes(values: NDArray[Any], size: int) -> NDArray[np.uint8]:
    """Return values of so many bytes as bytes, uint8 (n, size), that share their memory."""
    return values.reshape(-1).view(np.uint8).reshape(len(values), size)


def _swap(values: NDArray[Any], is_big: bool) -> NDArray[Any]:
    """Put the bytes of values in the other order, if that is not the processor's; return them."""
    if values.dtype.kind != "S" and np.dtype(">i4").isnative != is_big:
        values.byteswap(inplace=True)
    return values


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
            size, runs = KINDS[column.kind].size, _swap(values.values.copy(), is_big)
            kernels.put_runs(data, at, is_big, values.starts, size, _as_bytes(runs, size).reshape(-1))
            at += 4 + size * values.counts
        elif column.kind != "X":
            kernels.put_bytes(data, at, _as_bytes(_swap(values.copy(), is_big), column.size))
            at += column.size
    return data
