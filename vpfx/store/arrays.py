"""Rows of tables as arrays: from the pages where that is safe, else through SQL."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import StoreError, StoreFormatError
from vpfx.store.mapping import map_pages
from vpfx.store.page_reader import OTHER, PAGE, REAL, WHOLE, find_leaves, read_records

__all__ = ["NONE_ID", "TableReader", "look_up", "runs_of", "to_array"]

NONE_ID = -1  # stands for NULL in integer columns of arrays
MOST_SKIPPED = 256  # ids between two rows that are read in one sweep
KINDS = {"INTEGER": WHOLE, "DOUBLE": REAL}
WAL = 2  # read version in the header of a file whose newest pages may lie in another one


class TableReader:
    """Reads rows of tables with integer keys.

    Parameters
    ----------
    connection : sqlite3.Connection
        Open for reading, in autocommit mode.
    path : Path
        The same file.

    Notes
    -----
    Pages are read under SQLite's own shared lock, so that no writer changes them meanwhile; where the newest pages may lie in
    a write-ahead log, rows are read through SQL.
    """

    def __init__(self, connection: sqlite3.Connection, path: Path) -> None:
        self._connection, self._path = connection, path
        self._pages = map_pages(path)
        self._roots: dict[str, int] = dict(
            connection.execute("SELECT name, rootpage FROM sqlite_schema WHERE type = 'table'").fetchall()
        )
        self._columns: dict[str, list[tuple[str, int]]] = {}

    def rows(self, table: str, low: int, high: int) -> dict[str, NDArray[Any]]:
        """Rows with ids from low to high, in their order.

        Parameters
        ----------
        table : str
            A table of the schema with an integer key.
        low, high : int

        Returns
        -------
        dict of str to array
            One int64 or float64 array a column that holds numbers; NULL is -1, or NaN in columns of reals.

        Raises
        ------
        StoreError
            Somebody is writing.
        StoreFormatError
            A page or a record is broken, or holds a value of another kind.
        """
        with self._held() as data:
            columns = self._columns_of(table)
            if data is None:
                return self._by_sql(table, columns, low, high)
            leaves, most = find_leaves(data, self._roots[table], low, high)
            kinds = np.array([OTHER if i == 0 else kind for i, (_, kind) in enumerate(columns)])
            room = max(most, 0)
            wholes = np.empty((int((kinds == WHOLE).sum()), room), np.int64)
            reals, ids = np.empty((int((kinds == REAL).sum()), room)), np.empty(room, np.int64)
            count = most if most < 0 else read_records(data, leaves, low, high, kinds, wholes, reals, ids)
        if count < 0:
            raise StoreFormatError(
                str(self._path), f"table {table}", "found a broken page, expected a sound file", "R-100"
            )
        found, n_whole, n_real = {columns[0][0]: ids[:count].copy()}, 0, 0
        for name, kind in columns[1:]:
            if kind == WHOLE:
                found[name], n_whole = wholes[n_whole, :count].copy(), n_whole + 1
            elif kind == REAL:
                found[name], n_real = reals[n_real, :count].copy(), n_real + 1
        return found

    def _columns_of(self, table: str) -> list[tuple[str, int]]:
        """Names of the columns of a table, its key first, and what they give."""
        if table not in self._columns:
            described = self._connection.execute(f"PRAGMA table_info({table})").fetchall()
            self._columns[table] = [(row[1], KINDS.get(row[2], OTHER)) for row in described]
        return self._columns[table]

    @contextmanager
    def _held(self) -> Iterator[NDArray[np.uint8] | None]:
        """Give the pages as no writer changes them, or None where SQL has to read them."""
        while True:
            if self._pages is None:
                self._pages = map_pages(
                    self._path
                )  # the file was edited here, or has grown or shrunk since it was mapped
            self._connection.execute("BEGIN")
            try:
                self._lock()
                (count,) = self._connection.execute("PRAGMA page_count").fetchone()
                if self._pages is None or count == self._pages.count:
                    yield self._sure_bytes()
                    return
            finally:
                self._connection.execute("COMMIT")
            self._pages = None

    def _sure_bytes(self) -> NDArray[np.uint8] | None:
        """Return the pages if they are all there is: not where the newest ones may lie in a write-ahead log."""
        if self._pages is None:
            return None
        data = self._pages.bytes
        (mode,) = self._connection.execute("PRAGMA journal_mode").fetchone()
        is_sure = mode != "wal" and data[19] != WAL and int.from_bytes(data[16:18].tobytes(), "big") == PAGE
        return data if is_sure else None

    def _lock(self) -> None:
        """Take SQLite's shared lock, which a transaction gets with its first read."""
        try:
            self._connection.execute("SELECT 1 FROM sqlite_schema LIMIT 1").fetchone()
        except sqlite3.OperationalError as error:
            raise StoreError(f"{self._path}: cannot be read: {error}; somebody is writing, try again") from error

    def _by_sql(self, table: str, columns: list[tuple[str, int]], low: int, high: int) -> dict[str, NDArray[Any]]:
        names = [name for i, (name, kind) in enumerate(columns) if i == 0 or kind != OTHER]
        key = columns[0][0]
        query = f"SELECT {', '.join(names)} FROM {table} WHERE {key} BETWEEN ? AND ? ORDER BY {key}"
        rows = self._connection.execute(query, (low, high)).fetchall()
        values = zip(*rows, strict=True) if rows else ([] for _ in names)
        reals = {name for name, kind in columns if kind == REAL}
        return {name: to_array(column, name in reals) for name, column in zip(names, values, strict=True)}


def runs_of(ids: NDArray[np.int64]) -> list[tuple[int, int]]:
    """First and last of the runs of ascending ids that are near enough to each other to be read in one sweep.

    Examples
    --------
    >>> runs_of(np.array([1, 5, 1000, 1001]))
    [(1, 5), (1000, 1001)]
    """
    if len(ids) == 0:
        return []
    end = np.flatnonzero(np.diff(ids.view(np.uint64)) > MOST_SKIPPED)  # no difference is too large
    return list(zip(ids[np.append(0, end + 1)].tolist(), ids[np.append(end, len(ids) - 1)].tolist(), strict=True))


def look_up(known: NDArray[np.int64], wanted: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Find numbers among ascending ones: their places, the first of equals, and which are there at all.

    Examples
    --------
    >>> look_up(np.array([2, 5, 5, 9]), np.array([5, 6, -1]))
    (array([1, 3, 0]), array([ True, False, False]))
    """
    at = np.searchsorted(known, wanted)
    is_there = at < len(known)
    is_there[is_there] = known[at[is_there]] == wanted[is_there]
    return at, is_there


def to_array(values: Any, is_real: bool = False) -> NDArray[Any]:
    """Array of one column of rows; NULL is -1, or NaN in columns of reals."""
    if any(isinstance(value, str) for value in values[:1]):
        return np.array(values)
    if is_real or any(isinstance(value, float) for value in values[:1]):
        return np.array(values, np.float64)
    try:
        return np.array(values, np.int64)
    except TypeError:
        return np.array([NONE_ID if value is None else value for value in values], np.int64)
