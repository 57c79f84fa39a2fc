"""Questions in SQL: run without trust in the file or the question, and answers as texts.

A question can read and do nothing else: no other file is opened, nothing is set, no code is loaded. With leave to write it
changes rows of attributes (specs/format.md R-222 to R-225) in one transaction, and nothing else.
"""

from __future__ import annotations

import csv
import io
import json
import math
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from vpfx.errors import InputError, NotFoundError
from vpfx.store.connection import error_kind
from vpfx.store.contents import check_schema
from vpfx.store.edit import edit_store, told

__all__ = ["FORMATS", "Answer", "answer_sql", "to_arrow", "to_csv", "to_json", "to_table"]

BETWEEN_LOOKS = 20_000
"""Instructions of SQLite's machine between two looks whether somebody interrupts: some milliseconds."""

READING = {sqlite3.SQLITE_SELECT, sqlite3.SQLITE_READ, sqlite3.SQLITE_RECURSIVE}
WRITING = {sqlite3.SQLITE_INSERT, sqlite3.SQLITE_UPDATE, sqlite3.SQLITE_DELETE}
FORBIDDEN_FUNCTIONS = {"load_extension", "fts3_tokenizer"}
ABOUT_TABLES = {
    "table_info",
    "table_xinfo",
    "table_list",
    "index_list",
    "index_info",
    "index_xinfo",
    "foreign_key_list",
}
ABOUT_FILE = {"application_id", "user_version", "page_size", "page_count", "freelist_count", "encoding", "journal_mode",
              "integrity_check", "quick_check", "foreign_key_check", "compile_options", "database_list"}  # fmt: skip
WRITABLE = {"value_description", "feature", "face_feature"}

OF_FILE = {
    sqlite3.SQLITE_BUSY,
    sqlite3.SQLITE_LOCKED,
    sqlite3.SQLITE_CORRUPT,
    sqlite3.SQLITE_NOTADB,
    sqlite3.SQLITE_IOERR,
}
"""Errors that are not of the question."""

Authorizer = Callable[..., int]


class Answer(NamedTuple):
    """What SQLite answers.

    Attributes
    ----------
    names : tuple of str
        Of the columns; none where nothing is returned.
    rows : list of tuple
        Values are int, float, str, bytes or None.
    n_changed : int
        Rows that were inserted, changed or deleted by the statement itself.
    """

    names: tuple[str, ...]
    rows: list[tuple[Any, ...]]
    n_changed: int = 0


def answer_sql(
    path: str | Path, question: str, *, write: bool = False, deliver: Callable[[Answer], None] | None = None
) -> Answer:
    """Put one SQL statement to a store.

    Parameters
    ----------
    path : path
        The store; it is not changed, and may be read-only in a read-only folder, unless `write`.
    question : str
    write : bool
        Whether rows of attributes may be changed; all or nothing.
    deliver : callable, optional
        Takes the answer before changes are kept: what it raises undoes them.

    Returns
    -------
    found : Answer

    Raises
    ------
    InputError
        SQLite does not understand the question, or it wants to do what it may not.
    NotFoundError, StoreFormatError, StoreError
        There is no such store, or somebody is writing.
    KeyboardInterrupt
        Somebody interrupted; nothing was changed.

    Examples
    --------
    ``answer_sql("n36.gpkg", "SELECT count(*) FROM face_neighbour WHERE face_id = 1").rows``
    """
    path = Path(path)
    if not write:
        with _reading(path) as connection:
            answer = _ask(connection, question, _guard(frozenset()))
        if deliver is not None:
            deliver(answer)
        return answer
    with edit_store(path) as editor:
        answer = _ask(editor.connection, question, _guard(frozenset(WRITABLE | set(editor.classes))))
        if deliver is not None:
            deliver(answer)
        return answer


@contextmanager
def _reading(path: Path) -> Iterator[sqlite3.Connection]:
    """Open a store for reading, checked, in a transaction of one state of the file."""
    if not path.is_file():
        raise NotFoundError(f"{path}: found no such file, expected a store made by vpfx build")
    connection = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, isolation_level=None)
    try:
        connection.execute("PRAGMA trusted_schema = OFF")
        connection.execute("PRAGMA query_only = ON")
        connection.execute("BEGIN")
        check_schema(connection, path)
        yield connection
    except sqlite3.DatabaseError as error:
        raise told(error, path) from error
    finally:
        connection.close()


def _guard(writable: frozenset[str]) -> Authorizer:
    """Return what tells SQLite which steps of a question are allowed."""

    def allow(action: int, first: str | None, second: str | None, database: str | None, _: str | None) -> int:
        is_fine = action in READING
        if action == sqlite3.SQLITE_FUNCTION:
            is_fine = (second or "").lower() not in FORBIDDEN_FUNCTIONS
        elif action == sqlite3.SQLITE_PRAGMA:
            name = (first or "").lower()
            is_fine = name in ABOUT_TABLES or (name in ABOUT_FILE and second is None)
        elif action in WRITING:
            is_fine = first in writable and database == "main"
        return sqlite3.SQLITE_OK if is_fine else sqlite3.SQLITE_DENY

    return allow


def _ask(connection: sqlite3.Connection, question: str, guard: Authorizer) -> Answer:
    """Run one statement under guard; an interruption ends it."""
    connection.text_factory = lambda text: text.decode("utf-8", "replace")
    connection.execute("SELECT 1 FROM tile_index LIMIT 0")  # an R*Tree prepares writing when it is first used
    connection.set_authorizer(guard)
    connection.set_progress_handler(lambda: 0, BETWEEN_LOOKS)  # Python looks for signals when it is called
    try:
        cursor = connection.execute(question)
        rows = cursor.fetchall()
    except (sqlite3.Error, sqlite3.Warning, ValueError) as error:
        text = str(error)
        if text == "interrupted":
            raise KeyboardInterrupt from error
        if error_kind(error) in OF_FILE:
            raise
        if "not authorized" in text or "prohibited" in text:
            text = f"{text}: a question may read, and with --write change rows of attributes"
        raise InputError(f"SQL: {' '.join(text.split())}") from error
    finally:
        connection.set_authorizer(None)
        connection.set_progress_handler(None, 0)
    names = tuple(column[0] for column in cursor.description or ())
    return Answer(names, rows, max(cursor.rowcount, 0))


def to_table(answer: Answer) -> bytes:
    """Return an answer as aligned columns under their names, numbers to the right; a dash is NULL.

    Examples
    --------
    >>> print(to_table(Answer(("face_id", "kind"), [(7, "clay"), (12, None)])).decode())
    face_id  kind
          7  clay
         12  –
    """
    cells = [[_plain(value, "–") for value in row] for row in answer.rows]
    is_number = [
        all(isinstance(value, int | float | None) for value in column) for column in zip(*answer.rows, strict=True)
    ] or [False] * len(answer.names)
    widths = [max(map(len, column)) for column in zip(answer.names, *cells, strict=True)]
    lines = [
        "  ".join(text.rjust(width) if number else text.ljust(width)
                  for text, width, number in zip(row, widths, is_number, strict=True)).rstrip()
        for row in (answer.names, *cells)
    ]  # fmt: skip
    return ("\n".join(lines) + "\n").encode() if answer.names else b""


def to_csv(answer: Answer) -> bytes:
    """Return an answer as comma-separated values (RFC 4180) with a heading; NULL is empty.

    Examples
    --------
    >>> to_csv(Answer(("a", "b"), [(1, "x,y"), (None, b"x")])).decode().splitlines()
    ['a,b', '1,"x,y"', ',78']
    """
    text = io.StringIO()
    if answer.names:
        csv.writer(text).writerows([answer.names, *([_plain(value, "") for value in row] for row in answer.rows)])
    return text.getvalue().encode()


def to_json(answer: Answer) -> bytes:
    """Return an answer as JSON: a list of objects, one a row; of columns of one name the later ones are numbered.

    Examples
    --------
    >>> to_json(Answer(("a", "a"), [(1, None)])).decode().split()
    ['[', '{"a":', '1,', '"a_2":', 'null}', ']']
    """
    names: list[str] = []
    for name in answer.names:
        numbered = (f"{name}_{i}" for i in range(2, len(answer.names) + 2))
        names.append(name if name not in names else next(new for new in numbered if new not in names))
    rows = [dict(zip(names, map(_jsonable, row), strict=True)) for row in answer.rows]
    lines = ",\n".join(f"  {json.dumps(row, ensure_ascii=False)}" for row in rows)
    return (f"[\n{lines}\n]\n" if rows else "[]\n").encode("utf-8", "backslashreplace")


def to_arrow(answer: Answer) -> bytes:
    """Return an answer as a file of Apache Arrow (Feather 2): int64, double, string and binary columns.

    Raises
    ------
    InputError
        A column holds values of several kinds.
    NotFoundError
        pyarrow is not installed.
    """
    try:
        import pyarrow
    except ImportError as error:
        raise NotFoundError("arrow: found no pyarrow, expected it: pip install 'vpfx[arrow]'") from error
    columns = []
    for i, name in enumerate(answer.names):
        try:
            columns.append(pyarrow.array(_column([row[i] for row in answer.rows])))
        except (pyarrow.ArrowInvalid, pyarrow.ArrowTypeError) as error:
            raise InputError(f"column {name}: found values of several kinds, expected one; use CAST") from error
    table = pyarrow.Table.from_arrays(columns, names=list(answer.names))
    sink = io.BytesIO()
    with pyarrow.ipc.new_file(sink, table.schema) as writer:
        writer.write_table(table)
    return sink.getvalue()


FORMATS: dict[str, Callable[[Answer], bytes]] = {
    "table": to_table, "csv": to_csv, "json": to_json, "arrow": to_arrow
}  # fmt: skip
"""Ways to write an answer."""


def _column(values: Sequence[Any]) -> list[Any]:
    """Values with whole numbers as reals where reals stand beside them."""
    is_real = any(isinstance(value, float) for value in values)
    return [float(value) if is_real and isinstance(value, int) else value for value in values]


def _plain(value: Any, null: str) -> str:
    """One value as text on one line; blobs in hexadecimal."""
    if value is None:
        return null
    if isinstance(value, bytes):
        return value.hex()
    return value.replace("\n", "\\n") if isinstance(value, str) and null else str(value)


def _jsonable(value: Any) -> Any:
    if isinstance(value, bytes):
        return value.hex()
    return None if isinstance(value, float) and not math.isfinite(value) else value
