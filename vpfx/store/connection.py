"""SQLite opened for reading, so that what it refuses is an error of vpfx that names the file."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

from vpfx.errors import StoreError, StoreFormatError, VpfxError

__all__ = ["INTERRUPTED", "ReadingConnection", "error_code", "error_kind", "open_reading", "refusal"]

INTERRUPTED = (
    "found a change that was interrupted, which waits to be undone; open it for writing once: "
    'vpfx sql STORE "SELECT 1" --write'
)
"""What to tell of a hot journal."""


def error_code(error: Exception) -> int:
    """Extended code of what SQLite refused; its general error where there is none."""
    return int(getattr(error, "sqlite_errorcode", sqlite3.SQLITE_ERROR))


def error_kind(error: Exception) -> int:
    """Primary code of what SQLite refused: the last eight bits of the extended one."""
    return error_code(error) & 0xFF


class ReadingConnection(sqlite3.Connection):
    """A connection that only reads; made by `open_reading`.

    Attributes
    ----------
    path : Path
        The file, as it is told.
    """

    path: Path

    def execute(self, query: str, values: Sequence[Any] = (), /) -> _Cursor:  # type: ignore[override]
        """Run a statement.

        Raises
        ------
        StoreError, StoreFormatError
            As of `open_reading`; the cursor too.
        """
        return self.cursor(_Cursor).execute(query, values)


class _Cursor(sqlite3.Cursor):
    """Rows of a statement."""

    def execute(self, query: str, values: Sequence[Any] = (), /) -> _Cursor:  # type: ignore[override]
        with self._told():
            super().execute(query, values)
        return self

    def fetchone(self) -> Any:
        with self._told():
            return super().fetchone()

    def fetchall(self) -> list[Any]:
        with self._told():
            return super().fetchall()

    def __iter__(self) -> Iterator[Any]:  # type: ignore[override]
        """Give all rows that are left: none is asked for by itself."""
        return iter(self.fetchall())

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Make an error of SQLite one of vpfx; a cursor of a closed connection is a fault of the caller."""
        try:
            yield
        except sqlite3.ProgrammingError:
            raise
        except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
            raise refusal(error, cast(ReadingConnection, self.connection).path) from error


def refusal(error: Exception, path: Path) -> VpfxError:
    """Return what SQLite refused to read as an error that says what to do."""
    if error_code(error) == sqlite3.SQLITE_READONLY_ROLLBACK:
        return StoreError(f"{path}: {INTERRUPTED}")
    if error_kind(error) in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
        return StoreError(f"{path}: cannot be read: {error}; somebody is writing, try again")
    reason = "no SQLite database" if error_kind(error) == sqlite3.SQLITE_NOTADB else f"a damaged database ({error})"
    return StoreFormatError(str(path), "", f"found {reason}, expected a store made by vpfx build")


def open_reading(path: Path) -> ReadingConnection:
    """Open a SQLite file for reading, in autocommit mode and with untrusted schema.

    Parameters
    ----------
    path : Path

    Raises
    ------
    StoreError
        It cannot be opened, somebody is writing, or a change was interrupted.
    StoreFormatError
        It is no SQLite database, or a damaged one; statements run later raise the same.

    Examples
    --------
    >>> open_reading(Path("README.md")).execute("SELECT 1 FROM sqlite_schema")
    Traceback (most recent call last):
    vpfx.errors.StoreFormatError: README.md: found no SQLite database, expected a store made by vpfx build
    """
    uri = f"{path.absolute().as_uri()}?mode=ro"
    try:
        connection = sqlite3.connect(uri, uri=True, isolation_level=None, factory=ReadingConnection)
    except (OSError, sqlite3.Error) as error:
        raise StoreError(f"{path}: cannot be opened: {error}") from error
    connection.path = path
    try:
        connection.execute("PRAGMA trusted_schema = OFF")
    except BaseException:
        connection.close()
        raise
    return connection
