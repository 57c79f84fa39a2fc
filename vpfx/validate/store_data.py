"""What the rules of stores look at: the file, its table of contents, its small tables; read when first asked for.

Nothing here is checked: the rules do that. What cannot be read raises `sqlite3.Error` or `StoreFormatError`.
"""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from vpfx.errors import StoreError, StoreFormatError
from vpfx.store.arrays import TableReader
from vpfx.store.contents import INTERRUPTED, error_code
from vpfx.store.ddl import schema_sql

__all__ = ["HEADER", "Object", "StoreData", "open_store_data"]

HEADER = 100  # bytes
Rows = list[tuple[Any, ...]]


class Object(NamedTuple):
    """A row of the table of contents of SQLite.

    Attributes
    ----------
    kind : str
        ``table``, ``view``, ``index`` or ``trigger``.
    table : str
        That it belongs to.
    sql : str or None
    """

    kind: str
    table: str
    sql: str | None


@contextmanager
def open_store_data(path: Path) -> Iterator[StoreData]:
    """Open a file that may be a store.

    Raises
    ------
    StoreError
        The system refuses to read it.
    """
    try:
        with path.open("rb") as file:
            head, size = file.read(HEADER), os.fstat(file.fileno()).st_size
    except OSError as error:
        raise StoreError(f"{path}: cannot be read: {error.strerror}") from error
    data = StoreData(path, head, size)
    try:
        yield data
    finally:
        data.close()


class StoreData:
    """A file that may be a store; made by `open_store_data`.

    Attributes
    ----------
    path : Path
    head : bytes
        The first 100, or fewer if there are no more.
    size : int
        Bytes.
    """

    def __init__(self, path: Path, head: bytes, size: int) -> None:
        self.path, self.head, self.size = path, head, size
        self._connection: sqlite3.Connection | None = None

    def close(self) -> None:
        """Close the file."""
        if self._connection is not None:
            self._connection.close()

    @cached_property
    def interrupted(self) -> str:
        """What to say of a change that was interrupted; empty if none was."""
        try:
            self._open()
        except sqlite3.Error as error:
            if error_code(error) != sqlite3.SQLITE_READONLY_ROLLBACK:
                raise
            return INTERRUPTED
        return ""

    def _open(self) -> sqlite3.Connection:
        """Open the database for reading, safely; from here on one state of it is seen."""
        if self._connection is None:
            connection = sqlite3.connect(f"{self.path.absolute().as_uri()}?mode=ro", uri=True, isolation_level=None)
            connection.text_factory = lambda text: text.decode("utf-8", "replace")
            try:
                connection.execute("PRAGMA trusted_schema = OFF")
                reader = TableReader(connection, self.path)
                with suppress(StoreFormatError):  # whoever asks for rows is told; here the pages are mapped, no more
                    reader.rows("level", [])
                connection.execute("BEGIN")
                connection.execute("SELECT 1 FROM sqlite_schema LIMIT 1").fetchone()
            except BaseException:
                connection.close()
                raise
            self._connection, self._reader = connection, reader
        return self._connection

    @property
    def reader(self) -> TableReader:
        """What reads rows as arrays."""
        self._open()
        return self._reader

    def select(self, query: str, values: Sequence[Any] = ()) -> Rows:
        """Rows that SQLite gives for a query."""
        return self._open().execute(query, values).fetchall()

    def first(self, query: str, most: int, values: Sequence[Any] = ()) -> Rows:
        """Return the first rows that SQLite gives for a query."""
        return self._open().execute(query, values).fetchmany(most)

    @cached_property
    def objects(self) -> dict[str, Object]:
        """Tables, views, indexes and triggers by name."""
        query = "SELECT name, type, tbl_name, sql FROM sqlite_schema"
        return {row[0]: Object(*row[1:]) for row in self.select(query)}

    @cached_property
    def expected_objects(self) -> dict[str, Object]:
        """Those of the schema of the format (R-101)."""
        model = sqlite3.connect(":memory:")
        try:
            model.executescript("".join(map(schema_sql, ("vpfx.sql", "gpkg.sql", "views.sql"))))
            rows = model.execute("SELECT name, type, tbl_name, sql FROM sqlite_schema").fetchall()
        finally:
            model.close()
        return {row[0]: Object(*row[1:]) for row in rows}

    @cached_property
    def known_tables(self) -> list[str]:
        """Tables whose SQL is that of the format, so that nothing strange is in it."""
        return [name for name, found in self.objects.items() if found.kind == "table" and self._is_known(name)]

    @cached_property
    def has_strange_tables(self) -> bool:
        """Whether there are tables or indexes that the format does not know."""
        return any(
            found.kind in ("table", "index") and not self._is_known(name) for name, found in self.objects.items()
        )

    def _is_known(self, name: str) -> bool:
        return self.objects[name] == self.expected_objects.get(name)
