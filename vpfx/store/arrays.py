"""Rows of tables as arrays: from the pages where that is safe, else through SQL."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import StoreFormatError
from vpfx.store.mapping import Pages, key_of, map_pages
from vpfx.store.page_pairs import read_pairs
from vpfx.store.page_reader import OTHER, PAGE, REAL, WHOLE, find_leaves, read_records

__all__ = ["NONE_ID", "NO_IDS", "SWEEP", "TableReader", "look_up", "runs_of", "to_array"]

NONE_ID = -1  # stands for NULL in integer columns of arrays
NO_IDS = 1, 0  # an empty run
SWEEP = (
    256  # ids that SQL may read for nothing between two that are asked for: less than the cost of one more statement
)
LINKS = {"child_face": ("parent_child", "parent_face"), "parent_face": ("parent_child_by_parent", "child_face")}
"""Columns of links: the B-tree that is sorted by it, and the other column."""
KINDS = {"INTEGER": WHOLE, "DOUBLE": REAL}
COOKIE = slice(40, 44)  # bytes of the header that change with the schema
WAL = 2  # read version in the header of a file whose newest pages may lie in another one

Runs = list[tuple[int, int]]


class TableReader:
    """Reads rows of tables with integer keys.

    Parameters
    ----------
    connection : sqlite3.Connection
        Open for reading, in autocommit mode.
    path : Path
        The same file.
    key : (int, int), optional
        What `vpfx.store.mapping.key_of` said of it when it was opened: another file may have its name by now.

    Notes
    -----
    Pages are read under SQLite's own shared lock, so that no writer changes them meanwhile; where the newest pages may lie in
    a write-ahead log, rows are read through SQL.
    """

    def __init__(self, connection: sqlite3.Connection, path: Path, key: tuple[int, int] | None = None) -> None:
        self._connection, self._path = connection, path
        self._key = key_of(path) if key is None else key
        self._pages: Pages | None = None
        self._roots: dict[str, int] = {}
        self._columns: dict[str, list[tuple[str, int]]] = {}
        self._cookie = b""  # of the schema when the roots were read: VACUUM moves them

    def rows(self, table: str, runs: Runs) -> dict[str, NDArray[Any]]:
        """Rows with ids of some runs, in their order.

        Parameters
        ----------
        table : str
            A table of the schema with an integer key.
        runs : list of (int, int)
            First and last id of each, ascending.

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
        lows, highs = _limits(runs)
        with self._held_bytes() as data:
            columns = self._columns_of(table)
            if data is None:
                return self._by_sql(table, columns, runs)
            leaves, most = find_leaves(data, self._roots.get(table, 0), lows, highs)
            kinds = np.array([OTHER if i == 0 else kind for i, (_, kind) in enumerate(columns)])
            room = max(most, 0)
            wholes = np.empty((int((kinds == WHOLE).sum()), room), np.int64)
            reals, ids = np.empty((int((kinds == REAL).sum()), room)), np.empty(room, np.int64)
            count = most if most < 0 else read_records(data, leaves, lows, highs, kinds, wholes, reals, ids)
            self._check(count, table)
        found, n_whole, n_real = {columns[0][0]: ids[:count].copy()}, 0, 0
        for name, kind in columns[1:]:
            if kind == WHOLE:
                found[name], n_whole = wholes[n_whole, :count].copy(), n_whole + 1
            elif kind == REAL:
                found[name], n_real = reals[n_real, :count].copy(), n_real + 1
        return found

    def links(self, own: str, runs: Runs) -> NDArray[np.int64]:
        """Pairs of linked faces.

        Parameters
        ----------
        own : str
            ``child_face`` or ``parent_face``: the column that the runs are about.
        runs : list of (int, int)
            First and last id of each, ascending.

        Returns
        -------
        int64 (n, 2)
            That column and the other, ascending.

        Raises
        ------
        StoreError, StoreFormatError
            As of `rows`.
        """
        index, other = LINKS[own]
        query = f"SELECT {own}, {other} FROM parent_child WHERE {own} BETWEEN ? AND ? ORDER BY {own}, {other}"
        lows, highs = _limits(runs)
        with self._held_bytes() as data:
            if data is None:
                rows = [row for run in runs for row in self._connection.execute(query, run)]
                return self._whole_numbers(rows, "parent_child")
            pairs, count = read_pairs(data, self._roots.get(index, 0), lows, highs)
            self._check(count, index)
            return pairs[:count].copy()

    def _whole_numbers(self, rows: list[tuple[Any, ...]], table: str) -> NDArray[np.int64]:
        """Pairs of SQL as an array."""
        if not all(isinstance(value, int) for row in rows for value in row):
            message = "found a value that is no whole number"
            raise StoreFormatError(str(self._path), f"table {table}", message, "R-102")
        return np.array(rows, np.int64).reshape(-1, 2)

    def _check(self, count: int, table: str) -> None:
        """Refuse what a kernel found broken."""
        if count < 0:
            message = "found a broken page, expected a sound file"
            raise StoreFormatError(str(self._path), f"table {table}", message, "R-100")

    def _columns_of(self, table: str) -> list[tuple[str, int]]:
        """Names of the columns of a table, its key first, and what they give."""
        if table not in self._columns:
            described = self._connection.execute(f"PRAGMA table_info({table})").fetchall()
            self._columns[table] = [(row[1], KINDS.get(row[2], OTHER)) for row in described]
        return self._columns[table]

    @contextmanager
    def _held_bytes(self) -> Iterator[NDArray[np.uint8] | None]:
        """Give the pages as no writer changes them, or None where SQL has to read them."""
        _warm()
        if self._connection.in_transaction:  # no new mapping: closing its handle would drop the lock that is held
            yield self._sure_bytes()
            return
        for is_last in (False, True):
            if self._pages is None:  # the file was edited here, or is not the size it was when it was mapped
                self._pages = self._mapped()
            with self.held():
                data = self._sure_bytes()
                if data is not None or is_last:
                    yield data
                    return
            self._pages = None

    def _mapped(self) -> Pages | None:
        """Map the pages, if the file of that name is still the one that is open."""
        try:
            pages = map_pages(self._path)
        except OSError:
            return None
        return pages if pages is not None and pages.key == self._key else None

    @contextmanager
    def held(self) -> Iterator[None]:
        """Keep the state of the file as it is for some questions: a transaction that reads, or the one that is open."""
        if self._connection.in_transaction:
            yield
            return
        self._connection.execute("BEGIN")
        try:
            self._lock()
            yield
        finally:
            self._connection.execute("COMMIT")

    def _sure_bytes(self) -> NDArray[np.uint8] | None:
        """Return the pages if they are all there is: not where the newest ones may lie in a write-ahead log."""
        if self._pages is None:
            return None
        facts = ("page_count", "page_size", "journal_mode")
        count, size, mode = (self._connection.execute(f"PRAGMA {fact}").fetchone()[0] for fact in facts)
        data = self._pages.bytes
        if (count, size) != (self._pages.count, PAGE) or mode == "wal" or data[19] == WAL:
            return None
        self._read_roots(data[COOKIE].tobytes())
        return data

    def _read_roots(self, cookie: bytes) -> None:
        """Read where tables and indexes begin, if the schema is not the one known."""
        if cookie != self._cookie:
            query = "SELECT name, rootpage FROM sqlite_schema WHERE typeof(rootpage) = 'integer' AND rootpage > 0"
            self._roots, self._columns, self._cookie = dict(self._connection.execute(query).fetchall()), {}, cookie

    def _lock(self) -> None:
        """Take SQLite's shared lock, which a transaction gets with its first read."""
        self._connection.execute("SELECT 1 FROM sqlite_schema LIMIT 1").fetchone()

    def _by_sql(self, table: str, columns: list[tuple[str, int]], runs: Runs) -> dict[str, NDArray[Any]]:
        names = [name for i, (name, kind) in enumerate(columns) if i == 0 or kind != OTHER]
        key = columns[0][0]
        query = f"SELECT {', '.join(names)} FROM {table} WHERE {key} BETWEEN ? AND ? ORDER BY {key}"
        rows = [row for run in runs for row in self._connection.execute(query, run)]
        values = zip(*rows, strict=True) if rows else ([] for _ in names)
        reals = {name for name, kind in columns if kind == REAL}
        try:
            return {name: to_array(column, name in reals) for name, column in zip(names, values, strict=True)}
        except (TypeError, ValueError, OverflowError) as error:
            raise StoreFormatError(
                str(self._path), f"table {table}", "found a value of another kind", "R-102"
            ) from error


@cache
def _warm() -> None:
    """Compile the kernels before a lock is held: the first time takes some seconds."""
    page, none = np.frombuffer(bytes(PAGE), np.uint8), np.empty(0, np.int64)
    find_leaves(page, 1, none, none)
    read_records(page, none, none, none, none, np.empty((0, 0), np.int64), np.empty((0, 0)), none)
    read_pairs(page, 1, none, none)


def _limits(runs: Runs) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First and last ids of runs as arrays; of none an empty one."""
    lows, highs = np.array(runs or [NO_IDS], np.int64).T
    return np.ascontiguousarray(lows), np.ascontiguousarray(highs)


def runs_of(ids: NDArray[np.int64], most_skipped: int = 0) -> list[tuple[int, int]]:
    """First and last of the runs of ascending numbers between which no more than some are left out.

    Examples
    --------
    >>> runs_of(np.array([1, 2, 5, 1000]))
    [(1, 2), (5, 5), (1000, 1000)]
    >>> runs_of(np.array([1, 2, 5, 1000]), SWEEP)
    [(1, 5), (1000, 1000)]
    """
    if len(ids) == 0:
        return []
    end = np.flatnonzero(np.diff(ids.view(np.uint64)) > most_skipped + 1)  # no difference is too large
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
    if is_real or any(isinstance(value, float) for value in values[:1]):
        return np.array(values, np.float64)
    if any(isinstance(value, str) for value in values[:1]):
        return np.array(values)
    try:
        return np.array(values, np.int64)
    except TypeError:
        return np.array([NONE_ID if value is None else value for value in values], np.int64)
