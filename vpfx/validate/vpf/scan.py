"""One pass over a table: what its rows break whatever they mean."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import VpfFormatError
from vpfx.validate.report import MOST_SHOWN, Defects
from vpfx.validate.vpf.folders import TableData, numbers
from vpfx.vpf.header import TEXT_KINDS, Column
from vpfx.vpf.table import Ragged, Table
from vpfx.vpf.values import NULL_INT, NULL_SHORT, is_null, null_text, parse_date

__all__ = ["Scan", "ScannedTable", "Tally", "scan"]

MOST_KEY_BYTES = 1 << 26
"""Bytes of a column of keys that are compared with each other."""
MOST_DATES = 10_000
"""Different dates of a part of a table that are looked at."""
DATE = re.compile(rb"(\d{14}|\d{4} {10}|\d{6} {8}|\d{8} {6})\.(\d{5}|[+-]\d{4}| {5})")


class Tally:
    """Defects of one kind, gathered in parts: the first are told, all are counted."""

    def __init__(self) -> None:
        self.count = 0
        self._shown: list[tuple[str, str]] = []

    def add(self, index: NDArray[Any], describe: Callable[[int], tuple[str, str]]) -> None:
        """Add the defects at some indices."""
        for i in index[: MOST_SHOWN - len(self._shown)].tolist():
            self._shown.append(describe(i))
        self.count += len(index)

    def tell(self, where: str, message: str) -> None:
        """Add one defect."""
        self.add(np.zeros(1, np.int64), lambda _: (where, message))

    def defects(self) -> Iterator[Defects]:
        """Yield them, if there are any."""
        if self.count:
            yield Defects(self.count, lambda i: self._shown[i])


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
        return scan(self.table)


def scan(table: TableData) -> Scan:
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
        found.nulls.add(
            np.flatnonzero(values == other),
            lambda i: (f"{where} row={start + i + 1}", f"found {other} for no number, expected {other - 1}"),
        )


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
