"""What a caller wants written as arrays that are ready for it: types, widths and ranges checked, None made null.

Source: specs/vpf.md, V-110 to V-117.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import InputError
from vpfx.vpf import kernels
from vpfx.vpf.header import COUNTED, KINDS, MOST_COUNT, TEXT_KINDS, Column, Layout
from vpfx.vpf.rows import element_type
from vpfx.vpf.values import NULL_INT, NULL_SHORT, Ragged, date_text, null_text, ragged

__all__ = ["as_columns"]

MOST_ID = 2**32 - 1


def as_columns(layout: Layout, given: Mapping[str, Any], path: str) -> tuple[dict[str, Any], int]:
    """Return the columns to write, by lower-case name, in the order of the layout, and the number of rows.

    Raises
    ------
    InputError
        A column is missing, unknown, of another length, or has a value that its type cannot hold; the message names it
        (V-117).
    """
    by_name = {name.lower(): values for name, values in given.items()}
    known = {column.name.lower(): column for column in layout.columns}
    missing = [name for name, column in known.items() if name not in by_name and column.kind != "X"]
    unknown = [name for name in by_name if name not in known]
    if missing or unknown:
        raise InputError(f"{path}: found columns {list(by_name)}, expected {list(known)} (V-117)")
    lengths = {name: _length(values, f"{path}: column {name!r}") for name, values in by_name.items()}
    n_row = lengths[layout.columns[0].name.lower()]
    different = next((name for name, length in lengths.items() if length != n_row), None)
    if different is not None:
        raise InputError(f"{path}: column {different!r}: found {lengths[different]} rows, expected {n_row} (V-117)")
    columns: dict[str, Any] = {}
    for name, column in known.items():
        where = f"{path}: column {name!r}"
        if column.kind == "X":
            columns[name] = np.empty((n_row, 0), np.uint8)
        elif column.count == COUNTED:
            columns[name] = _as_ragged(column, by_name[name], where)
        else:
            columns[name] = _as_array(column, by_name[name], n_row, where)
    return columns, n_row


def _length(values: Any, where: str) -> int:
    try:
        return values.n_row if isinstance(values, Ragged) else len(values)
    except TypeError:
        raise InputError(f"{where}: found {type(values).__name__}, expected rows (V-117)") from None


def _as_array(column: Column, values: Any, n_row: int, where: str) -> NDArray[Any]:
    """Return the values of a column of fixed length."""
    if isinstance(values, Ragged):
        raise InputError(f"{where}: found rows of different lengths, expected {column.count} elements each (V-117)")
    if not isinstance(values, np.ndarray):
        values = _without_none(column, list(values))
    if column.kind in TEXT_KINDS + "D":
        return _as_text(column, values, n_row, where)
    try:
        array = np.asarray(values) if n_row else np.empty(0, element_type(column))
    except (ValueError, OverflowError) as error:
        raise InputError(f"{where}: {error} (V-117)") from None
    shape = (n_row, *element_type(column).shape)
    if column.kind == "K" and array.shape == (n_row,):
        array = np.stack([array, np.zeros_like(array), np.zeros_like(array)], axis=1)
    if array.shape != shape:
        raise InputError(f"{where}: found an array of shape {array.shape}, expected {shape} (V-117)")
    return _as_numbers(column, array, where)


def _without_none(column: Column, values: list[Any]) -> list[Any]:
    """Return a list whose rows None are the null of the type (V-112), and whose dates are text."""
    if column.kind == "D":
        values = [date_text(value) if value is None or isinstance(value, dt.date) else value for value in values]
    if column.kind in TEXT_KINDS + "D":
        null: Any = null_text(column.count).decode()
        strings = (value.decode("latin-1") if isinstance(value, bytes) else value for value in values)
        return [null if value is None else value for value in strings]
    if all(value is not None for value in values):
        return values
    null = {"S": NULL_SHORT, "I": NULL_INT}.get(column.kind, np.nan)
    if column.kind == "K":
        null = 0 if all(value is None or np.ndim(value) == 0 for value in values) else (0, 0, 0)
    elif column.kind in "CBZY":
        null = np.full(element_type(column).shape, np.nan)
    return [null if value is None else value for value in values]


def _as_numbers(column: Column, array: NDArray[Any], where: str) -> NDArray[Any]:
    """Return numbers in the type of a column, if it can hold them."""
    kind = element_type(column).base
    wanted = "iu" if kind.kind == "i" else "iuf"
    if array.dtype.kind not in wanted and array.size:
        raise InputError(f"{where}: found values of type {array.dtype}, expected {kind} (V-117)")
    if kind.kind == "i" and array.size and (array.dtype != kind or column.kind == "K"):
        least, most = (0, MOST_ID) if column.kind == "K" else (np.iinfo(kind).min, np.iinfo(kind).max)
        if array.min() < least or array.max() > most:
            row = int(np.flatnonzero(((array < least) | (array > most)).reshape(len(array), -1).any(axis=1))[0])
            raise InputError(f"{where}: row {row + 1}: found {array[row]}, expected {least} … {most} (V-117)")
    with np.errstate(over="ignore"):
        cast = np.ascontiguousarray(array, kind)
    if array.dtype == np.float64 and kind == np.float32 and array.size:
        _refuse_overflow(array, cast, where)
    return cast


def _refuse_overflow(array: NDArray[Any], cast: NDArray[Any], where: str) -> None:
    if np.isinf(cast).any() and (np.isinf(cast) != np.isinf(array)).any():
        raise InputError(f"{where}: found numbers beyond those of 32 bits, expected at most 3.4e38 (V-117)")


def _as_text(column: Column, values: Any, n_row: int, where: str) -> NDArray[Any]:
    """Return texts as bytes, blanks behind them up to the width of the column."""
    if isinstance(values, list) and not all(isinstance(value, str | bytes) for value in values):
        raise InputError(f"{where}: found values that are no texts, expected {n_row} texts (V-117)")
    array = np.asarray(values) if n_row else np.empty(0, "S1")
    if array.dtype.kind not in "SU" or array.shape != (n_row,):
        raise InputError(f"{where}: found an array of {array.dtype} {array.shape}, expected texts ({n_row},) (V-117)")
    width, most = element_type(column).itemsize, _most_character(column)
    out = np.empty((n_row, width), np.uint8)
    bad = kernels.pad_texts(_as_characters(array, where), most, out)
    if bad >= 0:
        name = "Latin-1" if most == 255 else "ASCII (type L takes Latin-1)"
        expected = f"expected at most {width} characters of {name}"
        raise InputError(f"{where}: row {bad + 1}: found {array[bad].item()!r}, {expected} (V-113)")
    return out.reshape(-1).view(f"S{width}")


def _as_characters(array: NDArray[Any], where: str) -> NDArray[np.uint8]:
    """Return texts as characters of Latin-1, uint8 (n_row, n), NULs behind short ones."""
    n_row, array = len(array), np.ascontiguousarray(array)
    if array.dtype.kind == "S":
        return array.view(np.uint8).reshape(n_row, -1) if n_row else np.empty((0, 1), np.uint8)
    codes = array.astype(array.dtype.newbyteorder("=")).view(np.uint32).reshape(n_row, -1)
    beyond = np.flatnonzero((codes > 255).any(axis=1))
    if len(beyond):
        row = int(beyond[0])
        raise InputError(f"{where}: row {row + 1}: found {array[row].item()!r}, expected characters of Latin-1 (V-113)")
    return codes.astype(np.uint8)


def _most_character(column: Column) -> int:
    return 255 if column.kind == "L" else 127


def _as_ragged(column: Column, values: Any, where: str) -> Ragged:
    """Return the values of a column of different lengths."""
    n_member = KINDS[column.kind].n_member
    is_text = column.kind in TEXT_KINDS
    if not isinstance(values, Ragged):
        try:
            values = ragged(values, 0 if is_text else n_member)
        except InputError as error:
            raise InputError(f"{where}: {error}") from None
    starts, elements = np.asarray(values.starts, np.int64), np.asarray(values.values)
    counts = np.diff(starts)
    if not len(starts) or starts[0] != 0 or (counts < 0).any() or starts[-1] != len(elements):
        raise InputError(f"{where}: found starts of rows that do not ascend from 0 to {len(elements)} (V-117)")
    if counts.size and counts.max() > MOST_COUNT:
        row = int(counts.argmax())
        raise InputError(f"{where}: row {row + 1}: found {counts[row]} elements, expected at most {MOST_COUNT} (V-111)")
    if is_text:
        if elements.dtype != np.uint8 or elements.ndim != 1:
            raise InputError(f"{where}: found {elements.dtype} {elements.shape}, expected uint8 (n,) (V-117)")
        if elements.size and elements.max() > _most_character(column):
            beyond = int(np.flatnonzero(elements > _most_character(column))[0])
            row = int(np.searchsorted(starts, beyond, "right"))
            raise InputError(f"{where}: row {row}: found a character beyond ASCII, which type L takes (V-113)")
        return Ragged(starts, np.ascontiguousarray(elements))
    if elements.ndim != 2 or elements.shape[1] != n_member:
        raise InputError(f"{where}: found an array of shape {elements.shape}, expected (n, {n_member}) (V-117)")
    return Ragged(starts, _as_numbers(column._replace(count=1), elements, where))
