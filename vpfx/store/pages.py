"""Bulk loading of SQLite tables and indexes: B-tree pages laid out here and appended to the file.

What comes out is an ordinary SQLite file, several times sooner than through prepared statements. It is for a file that
is being made and that nobody else has open. Source: "SQLite file format", sqlite.org/fileformat2.html::

    columns ─ records ─► cells ─ page_cells ─► pages ─ page_file ─► file
                           page_tree: which cells stand on which page, and the pages above
"""

from __future__ import annotations

import sqlite3
from collections.abc import Sequence
from contextlib import closing, suppress
from pathlib import Path
from types import TracebackType

import numpy as np

from vpfx.errors import InputError, StoreError, UnknownNameError
from vpfx.store.page_file import PageFile, Spool
from vpfx.store.page_tree import Shape, Tree, find_kinds
from vpfx.store.records import NULL_INT

__all__ = ["NULL_INT", "PageWriter", "reason_of"]


class PageWriter:
    """Appends rows to the empty tables and indexes of a new SQLite file, page by page.

    Only B-trees are written: the rows of an index must be appended to it like those of a table, and constraints
    (NOT NULL, UNIQUE of an index, CHECK, foreign keys, the types of STRICT tables), triggers and AUTOINCREMENT are the
    caller's care. Nobody else may have the file open, and one thread at a time may use the writer; its kernels release
    the GIL.

    As a context manager it closes the file when the block ends. After an error in the block SQLite finds the tables
    empty as before, and pages behind the end that the next writer of the file overwrites. After an error in `append`
    the writer is closed.

    Parameters
    ----------
    path : Path
        A file with its tables and indexes, made and closed by SQLite: UTF-8, journal mode DELETE, no auto-vacuum.
    name : str
        What messages call the file; the path if empty.

    Raises
    ------
    StoreError
        The file cannot be opened or is of another sort.

    Examples
    --------
    >>> from tempfile import mkdtemp
    >>> path = Path(mkdtemp()) / "posts.db"
    >>> with closing(sqlite3.connect(path)) as connection:
    ...     _ = connection.execute("CREATE TABLE post (post_id INTEGER PRIMARY KEY, z REAL)")
    >>> with PageWriter(path) as writer:
    ...     writer.append("post", [np.array([1, 2]), np.array([4808.5, np.nan])])
    >>> with closing(sqlite3.connect(path)) as connection:
    ...     connection.execute("SELECT * FROM post").fetchall()
    [(1, 4808.5), (2, None)]
    """

    def __init__(self, path: Path, name: str = "") -> None:
        self._name = name or str(path)
        self._trees: dict[str, Tree] = {}
        try:
            with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as connection:
                names = ("page_size", "page_count", "auto_vacuum", "encoding", "journal_mode")
                facts = {name: connection.execute(f"PRAGMA {name}").fetchone()[0] for name in names}
                self._shapes = read_shapes(connection)
            self._spool = Spool(path.parent, 2 * facts["page_size"])
            self._file = PageFile(path, facts["page_size"], facts["page_count"])
            facts["reserved bytes"] = self._file.read(1)[20]
        except (OSError, sqlite3.Error) as error:
            raise StoreError(f"{self._name}: cannot be opened: {reason_of(error)}") from error
        expected = {"auto_vacuum": 0, "encoding": "UTF-8", "journal_mode": "delete", "reserved bytes": 0}
        for fact, value in expected.items():
            if facts[fact] != value:
                self._release()
                raise StoreError(f"{self._name}: {fact}: found {facts[fact]}, expected {value}")

    def __enter__(self) -> PageWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
        else:
            self._release()

    def append(self, name: str, columns: Sequence[np.ndarray]) -> None:
        """Append rows to a table or an index.

        The keys of a call ascend. Calls may come in any order, but the range of keys of one may not overlap that of
        another. A call whose keys directly follow those of an earlier one fills up the page begun by it.

        Parameters
        ----------
        name : str
            A rowid table whose first column is INTEGER PRIMARY KEY, a table WITHOUT ROWID whose PRIMARY KEY is its
            first columns in order, or an index.
        columns : sequence of array
            For a table its columns as declared; for an index its columns and, behind them, those that SQLite adds:
            the rowid, or the columns of the primary key that the index does not have yet. Integers of any type
            (n_row,), NULL_INT for NULL; floats (n_row,), NaN for NULL; uint8 (n_row, length) for blobs. A column
            keeps its kind and length from call to call.

        Raises
        ------
        UnknownNameError
            There is no such table or index.
        InputError
            The number, kind or length of columns is wrong, a record does not fit on a page, the primary key is of
            another sort, or the writer is closed.
        InvariantError
            Keys do not ascend, or overlap those of an earlier call.
        StoreError
            The table is not empty, or the medium refused.

        Notes
        -----
        Integral floats in columns of REAL affinity are stored as integers and read back as floats, as with SQLite.
        Cost: O(n_row), and a search among the segments. Calls that jump back and forth cost about a page each.
        """
        if self._file.handle.closed:
            raise InputError(f"{self._name}: found a closed writer, expected an open one")
        columns = [np.asarray(column) for column in columns]
        tree = self._trees.get(name) or self._make_tree(name, columns)
        if find_kinds(tree.shape, columns) != (tree.kinds, tree.lengths):
            raise InputError(f"{name}: found columns of other kinds or lengths, expected those of the first call")
        if len(columns[0]) == 0:
            return
        try:
            tree.append(columns)
        except OSError as error:
            self._release()
            raise StoreError(f"{self._name}: cannot be written: {reason_of(error)}") from error
        except BaseException:
            self._release()
            raise

    def close(self) -> None:
        """Finish the trees and the header, and write everything to the medium; a second call does nothing.

        Raises
        ------
        StoreError
            The medium refused.
        """
        if self._file.handle.closed:
            return
        try:
            for tree in self._trees.values():
                tree.finish()
            self._file.finish()
        except OSError as error:
            raise StoreError(f"{self._name}: cannot be written: {reason_of(error)}") from error
        finally:
            self._release()

    def _make_tree(self, name: str, columns: Sequence[np.ndarray]) -> Tree:
        if name not in self._shapes:
            known = ", ".join(sorted(self._shapes))
            raise UnknownNameError(f"{self._name}: unknown table or index {name!r}; known: {known}")
        shape = self._shapes[name]
        if shape.problem:
            raise InputError(f"{self._name}: {name}: found {shape.problem}, which PageWriter cannot write")
        page = self._file.read(shape.root)
        if page[0] < 10 or page[3:5] != b"\0\0":  # an interior page, or a leaf with cells
            raise StoreError(f"{self._name}: {name}: found rows, expected an empty table or index")
        self._trees[name] = Tree(shape, self._file, self._spool, columns)
        return self._trees[name]

    def _release(self) -> None:
        for file in (self._file, self._spool):
            with suppress(OSError):  # a full medium refuses even this; what led here is the error to tell
                file.close()


def reason_of(error: Exception) -> str:
    """Return what the system said, without the file name that it adds: it may be that of a hidden file.

    Examples
    --------
    >>> reason_of(OSError(28, "No space left on device", ".a.gpkg.17.tmp"))
    'No space left on device'
    """
    return getattr(error, "strerror", None) or str(error)


def read_shapes(connection: sqlite3.Connection) -> dict[str, Shape]:
    """Return the shape of every table and index of a database by name; source §2.3 to §2.6."""
    rows = connection.execute("SELECT name, tbl_name, rootpage FROM sqlite_schema WHERE rootpage > 0").fetchall()
    names = {row[0] for row in rows}
    return {name: read_shape(connection, name, table, root, names) for name, table, root in rows}


def read_shape(connection: sqlite3.Connection, name: str, table: str, root: int, names: set[str]) -> Shape:
    """Return the shape of a table, or of an index of a table; `names` are those that have a B-tree of their own."""
    columns = connection.execute("SELECT type, pk, hidden FROM pragma_table_xinfo(?)", (table,)).fetchall()
    primary = connection.execute("SELECT name FROM pragma_index_list(?) WHERE origin = 'pk'", (table,)).fetchall()
    is_table = name == table
    # a table WITHOUT ROWID is listed as an index that has no B-tree beside that of the table
    index = next((row[0] for row in primary if row[0] not in names), "") if is_table else name
    entries = connection.execute("SELECT cid, desc, key FROM pragma_index_xinfo(?)", (index,)).fetchall()
    order = [row[0] for row in entries] if index else list(range(len(columns)))
    is_alias = not primary and columns[0][0].upper() == "INTEGER" and columns[0][1] == 1
    problem = ""
    if any(row[2] for row in columns):
        problem = "generated columns"
    elif any(row[1] for row in entries):
        problem = "a descending key"
    elif is_table and order != list(range(len(columns))):
        problem = "a primary key that is not the first columns in order"
    elif not index and not is_alias:
        problem = "a first column that is not INTEGER PRIMARY KEY"
    affinities = tuple(find_affinity(columns[cid][0]) if cid >= 0 else "" for cid in order)
    n_key = sum(row[2] for row in entries) if is_table else len(entries)
    return Shape(name, root, not index, affinities, n_key if index else 1, problem)


def find_affinity(declared: str) -> str:
    """Return REAL or TEXT if a declared type has that affinity, else nothing (sqlite.org/datatype3.html, §3.1).

    Examples
    --------
    >>> find_affinity("DOUBLE PRECISION"), find_affinity("varchar(20)"), find_affinity("POINT")
    ('REAL', 'TEXT', '')
    """
    for affinity, words in (("", ("INT",)), ("TEXT", ("CHAR", "CLOB", "TEXT")), ("REAL", ("REAL", "FLOA", "DOUB"))):
        if any(word in declared.upper() for word in words):
            return affinity
    return ""
