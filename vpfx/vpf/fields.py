"""Columns of a table as fields that a GIS knows: numbers and texts with nulls, dates in ISO form, coded values explained.

Source: specs/vpf.md, V-430 to V-432.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import VpfFormatError
from vpfx.vpf.header import TEXT_KINDS
from vpfx.vpf.table import Column, Ragged, Table
from vpfx.vpf.values import is_null, parse_date, texts

__all__ = ["Field", "decode_fields", "free_name", "iso_date", "text_field"]

Described = Mapping[tuple[str, str], Mapping[int | str, str]]


class Field(NamedTuple):
    """Values of a field.

    Attributes
    ----------
    values : int16, int32, float32, float64 or object (n,)
        Objects are str or None; of numbers, any where they are null.
    is_null : bool (n,)
    """

    values: NDArray[Any]
    is_null: NDArray[np.bool_]

    def to_list(self) -> list[Any]:
        """Values as Python's own, None where null."""
        return [None if null else value for null, value in zip(self.is_null, self.values.tolist(), strict=True)]


def text_field(values: list[str | None]) -> Field:
    """Texts as a field."""
    array = np.array([*values, None], object)[:-1]
    return Field(array, np.array([value is None for value in values], bool))


def decode_fields(
    table: Table, described: Described | None = None, name: str = "", *, without: tuple[str, ...] = ()
) -> dict[str, Field]:
    """Fields of a table by their names in lower case.

    Parameters
    ----------
    table : Table
    described : mapping, optional
        What coded values mean (`vpfx.vpf.values.value_descriptions`).
    name : str
        Name of the table there.
    without : tuple of str
        Columns to leave out, in lower case.

    Returns
    -------
    dict of str to Field
        Beside a column ``x`` with coded values stands ``x_description``. A triplet gives up to three fields: ``x``, and
        where some row has them ``x_tile_id`` and ``x_ext_id``. Columns of type X are left out.

    Examples
    --------
    >>> from vpfx.vpf.table import Layout, decode, encode
    >>> layout = Layout("Lines", (Column("id", "I", 1, "P"), Column("acc", "S"), Column("seen", "D")))
    >>> rows = {"id": [1, 2], "acc": [1, None], "seen": ["19991105000000.00000", None]}
    >>> fields = decode_fields(decode(*encode(layout, rows)), {("a.lft", "acc"): {1: "Accurate"}}, "a.lft")
    >>> {field: values.to_list() for field, values in fields.items()}
    {'id': [1, 2], 'acc': [1, None], 'acc_description': ['Accurate', None], 'seen': ['1999-11-05', None]}
    """
    fields: dict[str, Field] = {}
    taken = set(table.columns)
    for column in table.layout.columns:
        key = column.name.lower()
        if key in without:
            continue
        for suffix, field in _decoded(column, table[key]).items():
            fields[free_name(f"{key}{suffix}", taken) if suffix else key] = field
        meanings = (described or {}).get((name.lower(), key))
        if meanings and key in fields:
            fields[free_name(f"{key}_description", taken)] = _explained(fields[key], meanings)
    return fields


def free_name(name: str, taken: set[str]) -> str:
    """Return a name that is not taken, with underscores behind it if need be, and take it."""
    while name in taken:
        name += "_"
    taken.add(name)
    return name


def _decoded(column: Column, values: NDArray[Any] | Ragged) -> dict[str, Field]:
    """Fields that a column makes, by what is added to its name."""
    kind = column.kind
    if kind == "X":
        return {}
    if kind in TEXT_KINDS:
        return {"": text_field(texts(values))}
    null = is_null(values, kind)
    if kind == "D":
        dates = texts(values)
        return {"": text_field([None if date is None else iso_date(date) for date in dates])}
    if kind == "K" and not isinstance(values, Ragged):
        fields = {
            suffix: Field(values[..., i], values[..., i] == 0) for i, suffix in enumerate(("", "_tile_id", "_ext_id"))
        }
        return {suffix: field for suffix, field in fields.items() if not suffix or not field.is_null.all()}
    if isinstance(values, Ragged) or values.ndim > 1:
        rows = [values.row(i) for i in range(values.n_row)] if isinstance(values, Ragged) else values
        return {"": text_field([None if gone else _listed(row) for row, gone in zip(rows, null, strict=True)])}
    return {"": Field(values, null)}


def _listed(row: NDArray[Any]) -> str:
    """Numbers of a row as text: blanks in a place, commas between places."""
    return ", ".join(" ".join(map(str, place)) for place in np.atleast_2d(row).tolist())


def iso_date(text: str) -> str | None:
    """Return a date of type D as ISO 8601 has it, no more exact than it is; what is no date comes back as it is.

    Examples
    --------
    >>> iso_date("19991105123000.00000"), iso_date("19890000000000.00000"), iso_date("autumn"), iso_date("00000000000000")
    ('1999-11-05T12:30:00', '1989', 'autumn', None)
    """
    with suppress(VpfFormatError):
        date = parse_date(text)
        if date is None:
            return None
        parts = [text[a : a + 2].strip(" ") or "00" for a in (4, 6)]
        if parts[0] == "00":
            return f"{date.year:04d}"
        if parts[1] == "00":
            return f"{date.year:04d}-{date.month:02d}"
        has_time = (date.hour, date.minute, date.second) != (0, 0, 0) or date.tzinfo is not None
        return date.isoformat() if has_time else date.date().isoformat()
    return text


def _explained(field: Field, meanings: Mapping[int | str, str]) -> Field:
    """What values of a field mean; null where that is not told."""
    return text_field([None if value is None else meanings.get(value) or None for value in field.to_list()])
