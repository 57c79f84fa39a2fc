"""Values of tables: runs of different length, texts, nulls, dates.

Source: specs/vpf.md, V-112 to V-114.
"""

from __future__ import annotations

import datetime as dt
import math
import re
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import InputError, VpfFormatError
from vpfx.vpf.header import TEXT_KINDS

__all__ = [
    "NULL_DATE",
    "NULL_INT",
    "NULL_SHORT",
    "NULL_TEXTS",
    "Ragged",
    "date_text",
    "is_null",
    "null_text",
    "parse_date",
    "ragged",
    "texts",
]

NULL_SHORT = -(2**15)
NULL_INT = -(2**31)
NULL_DATE = " " * 20
NULL_TEXTS = ("", "-", "--", "N/A")
"""Texts of fixed length that mean nothing, blanks round them left out (V-112)."""


class Ragged(NamedTuple):
    """A column whose rows have different numbers of elements: row i is ``values[starts[i]:starts[i + 1]]``.

    Examples
    --------
    >>> lines = Ragged(np.array([0, 2, 2]), np.array([[0.0, 0.0], [1.0, 0.5]], np.float32))
    >>> lines.n_row, lines.row(0).tolist(), len(lines.row(1))
    (2, [[0.0, 0.0], [1.0, 0.5]], 0)
    """

    starts: NDArray[np.int64]  # (n_row + 1,), ascending from 0
    values: NDArray[Any]  # (n_value, ...): uint8 for text, float32 or float64 (n_value, 2 or 3) for coordinates

    @property
    def n_row(self) -> int:
        """Number of rows."""
        return len(self.starts) - 1

    @property
    def counts(self) -> NDArray[np.int64]:
        """Number of elements of each row, int64 (n_row,)."""
        return np.diff(self.starts)

    def row(self, index: int) -> NDArray[Any]:
        """Return the elements of one row."""
        return self.values[self.starts[index] : self.starts[index + 1]]

    def rows(self, start: int, stop: int) -> Ragged:
        """Return the rows from start to before stop; values are not copied."""
        first, last = self.starts[start], self.starts[stop]
        return Ragged(self.starts[start : stop + 1] - first, self.values[first:last])


def ragged(rows: Sequence[Any], width: int = 0) -> Ragged:
    """Return rows of different lengths as one Ragged; None is a row of nothing.

    Parameters
    ----------
    rows : sequence
        Of str (Latin-1), bytes, or None; with a width of arrays (n, width), or None.
    width : int, optional
        Numbers of an element: 2 or 3 for coordinates, 0 for text.

    Raises
    ------
    InputError
        A row cannot be made bytes or such an array.

    Examples
    --------
    >>> ragged(["ab", None, "c"]).starts.tolist()
    [0, 2, 2, 3]
    >>> ragged([[(0, 1), (2, 3)], []], 2).values.shape
    (2, 2)
    """
    if width:
        try:
            parts = [np.zeros((0, width)) if row is None else np.asarray(row).reshape(-1, width) for row in rows]
        except (TypeError, ValueError) as error:
            raise InputError(f"found rows that are not arrays (n, {width}): {error}") from None
        values = np.concatenate(parts) if parts else np.zeros((0, width))
        lengths = [len(part) for part in parts]
    else:
        texts = [_as_bytes(row, i) for i, row in enumerate(rows)]
        values = np.frombuffer(b"".join(texts), np.uint8)
        lengths = [len(text) for text in texts]
    return Ragged(np.concatenate([[0], np.cumsum(lengths, dtype=np.int64)]).astype(np.int64), values)


def _as_bytes(text: Any, row: int) -> bytes:
    if text is None:
        return b""
    if isinstance(text, bytes):
        return text
    try:
        return text.encode("latin-1")
    except (UnicodeEncodeError, AttributeError):
        raise InputError(f"row {row + 1}: found {text!r}, expected characters of Latin-1") from None


def texts(column: NDArray[Any] | Ragged) -> list[str | None]:
    """Return the rows of a column of text as strings, None for nulls.

    Blanks and NULs at the end are left out. Every byte is taken for a character of Latin-1 (V-113).

    Parameters
    ----------
    column : bytes S{c} (n_row,), or Ragged of uint8
        As a table has it.

    Examples
    --------
    >>> texts(np.array([b"river   ", b"N/A     ", b"        "]))
    ['river', None, None]
    >>> texts(ragged(["Elbe", ""]))
    ['Elbe', None]
    """
    if isinstance(column, Ragged):
        data, bounds = column.values.tobytes().decode("latin-1"), column.starts.tolist()
        return [data[a:b].rstrip(" \0") if b > a else None for a, b in pairwise(bounds)]
    found = (text.decode("latin-1").rstrip(" \0") for text in column.ravel().tolist())
    return [None if text.strip() in NULL_TEXTS else text for text in found]


def is_null(column: NDArray[Any] | Ragged, kind: str) -> NDArray[np.bool_]:
    """Tell which rows of a column are null (V-112).

    Parameters
    ----------
    column : array (n_row, ...) or Ragged
        As a table has it.
    kind : str
        Type of the column.

    Returns
    -------
    bool (n_row,)
        A row of several elements is null if all of them are.

    Examples
    --------
    >>> is_null(np.array([1, NULL_INT, -(2**31) + 1], np.int32), "I").tolist()
    [False, True, True]
    """
    if isinstance(column, Ragged):
        return column.counts == 0
    if len(column) == 0:
        return np.zeros(0, bool)
    if kind == "X":
        return np.ones(len(column), bool)
    flat = column.reshape(len(column), math.prod(column.shape[1:]))
    nulls: Any
    if kind in TEXT_KINDS + "D":
        nulls = np.isin(np.char.strip(flat, b" \0"), [text.encode() for text in NULL_TEXTS])
    elif kind in "SI":
        null = NULL_SHORT if kind == "S" else NULL_INT
        nulls = (flat == null) | (flat == null + 1)
    else:
        nulls = flat == 0 if kind == "K" else np.isnan(flat)
    return nulls.all(axis=1)


def null_text(count: int) -> bytes:
    """Return the null of a text of fixed length (V-112).

    Examples
    --------
    >>> null_text(1), null_text(2), null_text(5)
    (b'-', b'--', b'N/A  ')
    """
    return b"-" * count if count < 3 else b"N/A".ljust(count)


def date_text(date: dt.date | None) -> str:
    """Return a date, or date and time, as the 20 characters of type D; blanks for None (V-114).

    A time with a zone is told in UTC.

    Examples
    --------
    >>> date_text(dt.date(1999, 11, 5))
    '19991105000000.00000'
    """
    if date is None:
        return NULL_DATE
    if isinstance(date, dt.datetime) and date.tzinfo is not None:
        date = date.astimezone(dt.UTC)
    time = date.strftime("%H%M%S") if isinstance(date, dt.datetime) else "000000"
    return f"{date.year:04d}{date.month:02d}{date.day:02d}{time}.00000"


def parse_date(text: str | bytes | None) -> dt.datetime | None:
    """Return the date and time that type D tells; None where nothing is told (V-114).

    Parts that are zero or blank are the first month, the first day, or no hours, minutes and seconds. A zone told as sign,
    hours and minutes gives a time with that zone, zeros one without.

    Raises
    ------
    VpfFormatError
        It is no date.

    Examples
    --------
    >>> parse_date("19890000000000.00000")
    datetime.datetime(1989, 1, 1, 0, 0)
    >>> parse_date(" " * 20) is None
    True
    """
    if isinstance(text, bytes):
        text = text.decode("latin-1")
    text = (text or "").rstrip("\0")
    if not text.strip(" 0.-"):
        return None
    match = re.fullmatch(r"(\d{4})([\d ]{0,2})([\d ]{0,2})([\d ]{0,2})([\d ]{0,2})([\d ]{0,2})[. ]?(.*)", text)
    try:
        if match is None:
            raise ValueError
        month, day, hour, minute, second = (int(match[i].strip() or 0) for i in range(2, 7))
        return dt.datetime(int(match[1]), month or 1, day or 1, hour, minute, second, tzinfo=_zone(match[7]))
    except ValueError:
        raise VpfFormatError("", "", f"found date {text[:40]!r}, expected YYYYMMDDHHMMSS.ZZZZZ", "V-114") from None


def _zone(text: str) -> dt.timezone | None:
    match = re.fullmatch(r"([+-])(\d\d)(\d\d)", text.strip())
    if match is None:
        return None
    offset = dt.timedelta(hours=int(match[2]), minutes=int(match[3]))
    return dt.timezone(-offset if match[1] == "-" else offset)
