"""Tables of the extension, read without trust: there, with their columns, rows counted (specs/evpf.md E-100, E-101)."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import NotFoundError, VpfFormatError
from vpfx.evpf.texts import from_vpf
from vpfx.vpf.catalog import Coverage
from vpfx.vpf.header import COUNTED, TEXT_KINDS, Layout
from vpfx.vpf.table import Ragged, Table, TableFile, open_table
from vpfx.vpf.values import texts

__all__ = ["Run", "TileRuns", "check", "given_texts", "open_checked", "read_checked", "read_texts"]

BATCH = 1 << 15
"""Rows of a table by tile that are read at once."""


def open_checked(coverage: Coverage, name: str, wanted: Mapping[str, str], tile_id: int = 0) -> TableFile:
    """Open a table of a coverage that has some columns; a context manager.

    Parameters
    ----------
    coverage : Coverage
    name : str
    wanted : mapping of str to str
        Columns and the type letters each may have; a ``*`` behind them is the count `*`. Fixed texts may have any width.
    tile_id : int, optional
        Of the tile, for primitives.

    Raises
    ------
    VpfFormatError
        There is no such table, or it lacks a column or has it in another form.
    """
    try:
        file = open_table(coverage.table(name, tile_id))
    except NotFoundError as error:
        raise VpfFormatError("", "", f"{error}, expected one", "E-100") from None
    try:
        _check_columns(file.layout, wanted, file.path)
    except BaseException:
        file.close()
        raise
    return file


def read_checked(coverage: Coverage, name: str, wanted: Mapping[str, str], tile_id: int = 0) -> Table:
    """Return a whole table, as `open_checked`, with rows that count from 1.

    Raises
    ------
    VpfFormatError
        As `open_checked`, or a row or its id is broken.
    """
    with open_checked(coverage, name, wanted, tile_id) as file:
        table = file.read()
    _check_ids(table)
    return table


def _check_columns(layout: Layout, wanted: Mapping[str, str], path: str) -> None:
    for name, form in wanted.items():
        column = layout.find(name)
        kinds, counted = form.removesuffix("*"), form.endswith("*")
        if column is None:
            raise VpfFormatError(path, "header", f"found no column {name!r}, expected one", "E-100")
        is_good = column.kind in kinds and (column.count == COUNTED) == counted
        if not is_good or (column.kind not in TEXT_KINDS and not counted and column.count != 1):
            found = f"{column.kind},{'*' if column.count == COUNTED else column.count}"
            expected = " or ".join(kinds) + (",*" if counted else "")
            raise VpfFormatError(path, "header", f"found column {name!r} of type {found}, expected {expected}", "E-100")


def _check_ids(table: Table, start: int = 0) -> None:
    """Refuse a part of a table, from row index `start` on, whose rows do not count from 1."""
    expected = np.arange(start + 1, start + 1 + table.n_row)
    ids = table["id"]
    check(ids == expected, table.path, "found id {}, expected {}", "E-101", ids, expected, start=start)


def check(
    is_good: Any, path: str, message: str, requirement: str, *values: NDArray[Any], start: int = 0,
    rows: NDArray[Any] | None = None,
) -> None:  # fmt: skip
    """Raise for the first row that is not good.

    Parameters
    ----------
    is_good : bool (n,)
    path : str
        The table.
    message : str
        What was found and expected, with a place in braces for each of the values.
    requirement : str
    *values : array (n,)
        What to tell of the row.
    start : int, optional
        Row index of the first.
    rows : integers (n,), optional
        Row indices, where they do not follow each other.

    Raises
    ------
    VpfFormatError

    Examples
    --------
    >>> level = np.array([0, 2])
    >>> check(level == [0, 1], "tin1/level.rat", "found level {}", "E-410", level)
    Traceback (most recent call last):
    vpfx.errors.VpfFormatError: tin1/level.rat: row 2: found level 2 (E-410)
    """
    is_good = np.asarray(is_good)
    if not is_good.all():
        first = int(np.argmin(is_good))
        row = start + first if rows is None else int(rows[first])
        told = message.format(*(value[first].tolist() for value in values))
        raise VpfFormatError(path, f"row {row + 1}", told, requirement)


def read_texts(table: Table, name: str) -> list[str | None]:
    """Return the texts of a counted column as they were before they were written; None for nulls.

    Raises
    ------
    VpfFormatError
        A backslash means nothing.
    """
    column: Ragged = table[name]
    data = column.values.tobytes().decode("latin-1")
    found: list[str | None] = []
    for row, (start, end) in enumerate(pairwise(column.starts.tolist()), 1):
        try:
            found.append(from_vpf(data[start:end]) if end > start else None)
        except VpfFormatError as error:
            raise VpfFormatError(table.path, f"row {row}: {name}", str(error)) from None
    return found


def given_texts(table: Table, name: str) -> list[Any]:
    """Return the texts of a column, counted or of fixed width, of which none may be null.

    Raises
    ------
    VpfFormatError
        One is null, or a backslash means nothing.
    """
    found = read_texts(table, name) if isinstance(table[name], Ragged) else texts(table[name])
    if None in found:
        raise VpfFormatError(table.path, f"row {found.index(None) + 1}", f"found no {name}, expected a text", "E-101")
    return found


class Run:
    """Rows of one tile.

    Attributes
    ----------
    path : str
        The table.
    start : int
        Row index of the first.
    n_row : int
    """

    def __init__(self, path: str, start: int, parts: list[dict[str, NDArray[Any]]]) -> None:
        self.path, self.start = path, start
        self._columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        self.n_row = len(self._columns["tile_id"])

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self._columns[name]

    def __contains__(self, name: str) -> bool:
        return name in self._columns


class TileRuns:
    """The rows of a table without counted columns, by tile.

    Parameters
    ----------
    file : TableFile
        With columns `id` and `tile_id`; stays open as long as rows are taken.
    """

    def __init__(self, file: TableFile) -> None:
        self._file = file
        self._at = 0  # row index of the next row to hand out
        self._batch: Table | None = None
        self._batch_start = 0

    def take(self, tile_id: int) -> Run:
        """Return the rows of a tile, the next in order.

        Raises
        ------
        VpfFormatError
            An id is not that of its row, or rows of other tiles come first.
        """
        start = self._at
        parts = []
        while True:
            part, is_end = self._leading(tile_id)
            parts.append(part)
            if is_end:
                return Run(self._file.path, start, parts)

    def finish(self) -> None:
        """Refuse rows that are left: they are of no tile."""
        if self._at < self._file.n_row:
            found = self._file.read(self._at, self._at + 1)["tile_id"][0]
            message = f"found tile {found}, expected one of the library, in order"
            raise VpfFormatError(self._file.path, f"row {self._at + 1}", message, "E-101")

    def _leading(self, tile_id: int) -> tuple[dict[str, NDArray[Any]], bool]:
        """Rows of the tile at the head of the batch, and whether no more may follow."""
        if self._batch is None or self._at == self._batch_start + self._batch.n_row:
            self._batch = self._file.read(self._at, self._at + BATCH)
            self._batch_start = self._at
            _check_ids(self._batch, self._at)
        first = self._at - self._batch_start
        tiles = self._batch["tile_id"][first:]
        is_same = tiles == tile_id
        n_row = len(tiles) if is_same.all() else int(np.argmin(is_same))
        if n_row < len(tiles) and tiles[n_row] < tile_id:
            message = f"found tile {tiles[n_row]} where tile {tile_id} or a later one is due, expected rows by tile"
            raise VpfFormatError(self._file.path, f"row {self._at + n_row + 1}", message, "E-101")
        part = {name: values[first : first + n_row] for name, values in self._batch.columns.items()}
        self._at += n_row
        return part, n_row < len(tiles) or self._at == self._file.n_row
