"""Rules V70x: single tables, whatever they are about; and the one pass over a table that tells what its rows break."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import VpfFormatError
from vpfx.validate.report import ERROR, WARNING, Defects, Rule, Tally, one
from vpfx.validate.vpf.columns import missing_columns, wanted_columns, wrong_types
from vpfx.validate.vpf.folders import TableData, numbers
from vpfx.vpf.header import TEXT_KINDS, Column
from vpfx.vpf.table import Ragged, Table
from vpfx.vpf.values import NULL_INT, NULL_SHORT, is_null, null_text, parse_date

__all__ = ["RULES", "ScannedTable"]

NOT_REFERRED_TO = {"dht", "lat", "lht", "grt", "cat", "dqt", "fcs", "fit", "vdt", "doc"}
"""Tables whose rows no other table names by number."""
MOST_KEY_BYTES = 1 << 26
"""Bytes of a column of keys that are compared with each other."""
MOST_DATES = 10_000
"""Different dates of a part of a table that are looked at."""
DATE = re.compile(rb"(\d{14}|\d{4} {10}|\d{6} {8}|\d{8} {6})\.(\d{5}|[+-]\d{4}| {5})")


class Scan:
    """What one pass over a table found.

    Attributes
    ----------
    problem : str
        Why the pass ended early; empty if it did not.
    ids, keys, texts, nulls : Tally
        Ids that are not row numbers; keys without value or not unique; characters and dates; nulls of other forms.
    """

    def __init__(self) -> None:
        self.problem = ""
        self.ids, self.keys, self.texts, self.nulls = Tally(), Tally(), Tally(), Tally()


class ScannedTable:
    """A table and what one pass over it found; the pass is made when it is first asked for."""

    def __init__(self, table: TableData) -> None:
        self.table, self.where, self.head = table, table.where, table.head

    @cached_property
    def scan(self) -> Scan:
        """What one pass over the rows found."""
        return _scan(self.table)


def _scan(table: TableData) -> Scan:
    """Go through the rows of a table."""
    found = Scan()
    keys: dict[str, list[NDArray[Any]]] = {}
    try:
        for start, rows in table.batches():
            _check_ids(found, table, start, rows)
            for column in rows.layout.columns:
                where = f"table={table.where} column={column.name}"
                values = rows[column.name]
                if column.key.upper()[:1] in ("P", "U") and column.name.lower() != "id":
                    _check_nulls(found.keys, where, start, is_null(values, column.kind))
                    if not isinstance(values, Ragged) and values.ndim == 1:
                        keys.setdefault(column.name, []).append(values)
                _check_column(found, column, values, where, start)
    except VpfFormatError as error:
        found.problem = str(error).removeprefix(f"{error.path}: ")
        return found
    for name, parts in keys.items():
        if sum(part.nbytes for part in parts) <= MOST_KEY_BYTES:
            _check_unique(found.keys, f"table={table.where} column={name}", np.concatenate(parts))
    return found


def _check_ids(found: Scan, table: TableData, start: int, rows: Table) -> None:
    ids = numbers(rows, "id")
    if ids is not None:
        wrong = np.flatnonzero(ids != np.arange(start + 1, start + rows.n_row + 1))
        found.ids.add(
            wrong,
            lambda i: (f"table={table.where} row={start + i + 1}", f"found id {ids[i]}, expected {start + i + 1}"),
        )


def _check_nulls(tally: Tally, where: str, start: int, is_none: NDArray[np.bool_]) -> None:
    tally.add(
        np.flatnonzero(is_none), lambda i: (f"{where} row={start + i + 1}", "found no value in a key, expected one")
    )


def _check_unique(tally: Tally, where: str, values: NDArray[Any]) -> None:
    order = np.argsort(values, kind="stable")
    again = np.sort(order[1:][values[order[1:]] == values[order[:-1]]])
    tally.add(
        again, lambda i: (f"{where} row={i + 1}", f"found {_shown(values[i])} in an earlier row too, expected it once")
    )


def _check_column(found: Scan, column: Column, values: Any, where: str, start: int) -> None:
    if column.kind in TEXT_KINDS:
        is_wrong = _has_wrong_bytes(values, most=127 if column.kind == "T" else 255)
        what = "a control character" if column.kind != "T" else "a byte that is no printable ASCII"
        expected = "expected printable characters" + (" of ASCII; type L has Latin-1" if column.kind == "T" else "")
        found.texts.add(
            np.flatnonzero(is_wrong), lambda i: (f"{where} row={start + i + 1}", f"found {what}, {expected}")
        )
        if column.count > 2 and not isinstance(values, Ragged):
            wrong = is_null(values, column.kind) & (values != null_text(column.count))
            found.nulls.add(
                np.flatnonzero(wrong),
                lambda i: (f"{where} row={start + i + 1}", f"found {_shown(values[i])} for no text, expected 'N/A'"),
            )
    elif column.kind == "D":
        _check_dates(found.texts, values, where, start)
    elif column.kind in "SI":
        other = (NULL_SHORT if column.kind == "S" else NULL_INT) + 1
        elements, row = _elements(values)
        found.nulls.add(
            row[elements == other],
            lambda i: (f"{where} row={start + i + 1}", f"found {other} for no number, expected {other - 1}"),
        )


def _elements(values: Any) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """All elements of a column of whole numbers, (n,), and the index of the row that each is in."""
    if isinstance(values, Ragged):
        return values.values.ravel(), np.repeat(np.arange(values.n_row), values.counts)
    return values.ravel(), np.repeat(np.arange(len(values)), math.prod(values.shape[1:]))


def _has_wrong_bytes(values: Any, most: int) -> NDArray[np.bool_]:
    """Tell which texts have control characters, or bytes above the greatest allowed."""
    if isinstance(values, Ragged):
        data = values.values
        is_wrong = (data > most) | (data == 127) | ((data < 32) & ~np.isin(data, np.frombuffer(b"\t\n\r", np.uint8)))
        total = np.concatenate([[0], np.cumsum(is_wrong)])
        counts: NDArray[np.bool_] = np.diff(total[values.starts]) > 0
        return counts
    data = np.ascontiguousarray(values).view(np.uint8).reshape(len(values), -1)
    is_any: NDArray[np.bool_] = (
        ((data > most) | (data == 127) | (data < 32)).any(axis=1) if data.size else np.zeros(len(values), bool)
    )
    return is_any


def _check_dates(tally: Tally, values: NDArray[Any], where: str, start: int) -> None:
    different, inverse = np.unique(values, return_inverse=True)
    is_wrong = np.zeros(len(different), bool)
    for i, text in enumerate(different[:MOST_DATES].tolist()):
        is_wrong[i] = not _is_date(text)
    tally.add(
        np.flatnonzero(is_wrong[inverse]),
        lambda i: (
            f"{where} row={start + i + 1}",
            f"found date {_shown(values[i])}, expected YYYYMMDDHHMMSS.ZZZZZ or blanks",
        ),
    )


def _is_date(text: bytes) -> bool:
    if not text.strip(b" \0") or text.strip(b" ") in (b"N/A", b"-"):
        return True
    if DATE.fullmatch(text.ljust(20)) is None:
        return False
    try:
        parse_date(text)
    except VpfFormatError:
        return False
    return True


def _shown(value: Any) -> str:
    """A value in a message: short, and in one line."""
    if isinstance(value, bytes):
        return repr(value.decode("latin-1").rstrip(" "))[:60]
    return str(value)[:60]


def _is_list(data: ScannedTable) -> bool:
    return data.table.kind in NOT_REFERRED_TO or data.table.kind[1:] == "jt"


def check_readable(data: ScannedTable) -> Iterator[Defects]:
    """The header says what the rows are."""
    if data.head is None:
        yield one(f"table={data.where}", data.table.problem)


def check_rows(data: ScannedTable) -> Iterator[Defects]:
    """All rows follow the header."""
    if data.scan.problem:
        yield one(f"table={data.where}", data.scan.problem)


def check_stray(data: ScannedTable) -> Iterator[Defects]:
    """No byte follows the last row."""
    if data.head is not None and data.head.stray:
        yield one(
            f"table={data.where}",
            f"found {data.head.stray} bytes behind the last of {data.head.n_row} rows, expected none",
        )


def check_index(data: ScannedTable) -> Iterator[Defects]:
    """The index file says where the rows are."""
    head = data.head
    if head is not None and head.has_index and head.index_problem and not _is_harmless(head.index_problem):
        yield one(f"table={data.where}", f"index file: {head.index_problem}")


def check_index_header(data: ScannedTable) -> Iterator[Defects]:
    """The index file is in the byte order of its table, and names its first row."""
    head = data.head
    if head is not None and head.has_index and head.index_problem and _is_harmless(head.index_problem):
        yield one(f"table={data.where}", f"index file: {head.index_problem}")


def _is_harmless(problem: str) -> bool:
    """Whether the places of rows are right all the same."""
    return problem.startswith("word 2") or "byte order" in problem


def check_ids(data: ScannedTable) -> Iterator[Defects]:
    """Rows that others name by number have that number as id."""
    if not _is_list(data):
        yield from data.scan.ids.defects()


def check_list_ids(data: ScannedTable) -> Iterator[Defects]:
    """The same of tables whose rows nobody names."""
    for ids in data.scan.ids.defects() if _is_list(data) else ():
        where, message = ids.describe(0)
        yield one(where, message if ids.n_defect == 1 else f"{message}; {ids.n_defect} rows are so")


def check_columns(data: ScannedTable) -> Iterator[Defects]:
    """A table of the standard has the columns that readers look for, in types that they read."""
    head = data.head
    if head is None:
        return
    where = f"table={data.where}"
    first = head.layout.columns[0].name
    if first.lower() != "id":
        yield one(f"{where} column={first}", f"found column {first!r} first, expected 'id'")
    wanted = wanted_columns(data.table.kind, data.table.name, 0 if data.table.level is None else data.table.level)
    for name in missing_columns(head.layout, wanted):
        yield one(where, f"found no column {name!r}, expected one")
    for name, kind, expected in wrong_types(head.layout, wanted):
        yield one(f"{where} column={name}", f"found type {kind}, expected one of {expected}")


def check_keys(data: ScannedTable) -> Iterator[Defects]:
    """Columns marked as primary or unique have a value in each row, another in each."""
    yield from data.scan.keys.defects()


def check_texts(data: ScannedTable) -> Iterator[Defects]:
    """Texts have printable characters of their type, and dates are dates."""
    yield from data.scan.texts.defects()


RULES = (
    Rule("V700", "table_header", ERROR, "V-102", "the header of a table cannot be read", check_readable, "table"),
    Rule("V701", "table_rows", ERROR, "V-121", "the rows of a table do not follow its header", check_rows, "table",
         needs=("table_header",)),
    Rule("V702", "stray_bytes", ERROR, "V-122", "bytes follow the last row of a table", check_stray, "table",
         needs=("table_header", "table_rows")),
    Rule("V703", "table_index", ERROR, "V-130", "an index file does not fit its table", check_index, "table",
         needs=("table_header", "table_rows")),
    Rule("V704", "table_index_header", WARNING, "V-130", "an index file says another place or byte order than its table",
         check_index_header, "table", needs=("table_header", "table_index")),
    Rule("V705", "row_ids", ERROR, "V-105", "the ids of a table are not its row numbers", check_ids, "table",
         needs=("table_rows",)),
    Rule("V706", "list_ids", WARNING, "V-105", "the ids of a list are not its row numbers", check_list_ids, "table",
         needs=("table_rows",)),
    Rule("V707", "table_columns", ERROR, "V-250", "a table of the standard lacks a column, or has it in another type",
         check_columns, "table", needs=("table_header",)),
    Rule("V708", "key_values", ERROR, "V-250", "a key has no value, or one that is not unique", check_keys, "table",
         needs=("table_rows",)),
    Rule("V709", "text_values", WARNING, "V-113", "a text has other characters than its type, or a date is none", check_texts,
         "table", needs=("table_rows",)),
)  # fmt: skip
