"""Thematic indexes of VPF, such as ``f_code.ati``: which rows of a table have a value (specs/vpf.md, V-350 to V-353).

::

    header   | directory: value, offset, count | value, offset, count | … | row ids of value 1 | row ids of value 2 | …
    60 bytes                     |                                          ↑
                                 +------------------------------------------+
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vpfx.errors import InputError, VpfFormatError

__all__ = ["ThematicIndex", "build", "read"]

HEADER = struct.Struct("<iiiccic12s25sc3x")
WRITTEN = "ISFT"
"""Kinds of column that are indexed; readers stumble over the others (V-353)."""

MOST_SHORT = 32767
"""Rows of a table whose ids are kept in two bytes."""

MOST_NAME = 24
"""Characters of a column's name: readers lose one of the 25 (V-353)."""

DTYPES = {"I": "i4", "S": "i2", "F": "f4", "R": "f8", "T": "S", "L": "S", "D": "S20"}


class Header(NamedTuple):
    """The first 60 bytes, and what follows from them."""

    order: str
    first: int  # byte after the directory
    n_value: int
    n_row: int
    index_type: str
    kind: str
    n_element: int
    id_kind: str
    table_name: str
    column_name: str
    is_sorted: bool


@dataclass(frozen=True, eq=False)
class ThematicIndex:
    """A thematic index as read.

    Attributes
    ----------
    table_name, column_name : str
        What is indexed, as the header names it.
    index_type : str
        ``I`` or ``T``, lists of rows; ``B``, bit arrays; ``G``, bit arrays of the letters that occur in names.
    kind : str
        Type of the column: I, S, F, R, T, L or D.
    n_row : int
        Rows of the table.
    is_sorted : bool
        The header says that the directory is sorted.
    is_rising : bool
        It is.
    values : array (n_value,)
        Distinct values, rising; texts as bytes without the spaces behind them.
    starts, ids : int64 (n_value + 1,), int32 (n,)
        Rows of value i are ``ids[starts[i]:starts[i + 1]]``; rows count from 1.

    Examples
    --------
    >>> index = read(build(["BA010", "BH000", "BA010"], "shore.lft", "f_code", "T", 5))
    >>> index.values.tolist(), index.rows("BA010").tolist(), index.rows("XX000").tolist()
    ([b'BA010', b'BH000'], [1, 3], [])
    """

    table_name: str
    column_name: str
    index_type: str
    kind: str
    n_row: int
    is_sorted: bool
    is_rising: bool
    values: NDArray[Any]
    starts: NDArray[np.int64]
    ids: NDArray[np.int32]

    def rows(self, value: Any) -> NDArray[np.int32]:
        """Rows that have a value, int32 (n,), rising; of the letters of names, rows in whose name the letter occurs.

        Raises
        ------
        InputError
            The value is no number where the column holds numbers, or no text where it holds texts.
        """
        key = self._key(value)
        if key != key:  # NaN, which stands last
            low, high = int(np.sum(~np.isnan(self.values))), len(self.values)
        else:
            low, high = np.searchsorted(self.values, key, "left"), np.searchsorted(self.values, key, "right")
        return np.sort(self.ids[self.starts[low] : self.starts[high]])

    def _key(self, value: Any) -> Any:
        is_text = self.values.dtype.kind == "S"
        if is_text and isinstance(value, str | bytes):
            return (value.encode("latin-1", "replace") if isinstance(value, str) else value).rstrip(b" \0")
        if not is_text and isinstance(value, int | float | np.number):
            return self.values.dtype.type(value) if self.values.dtype.kind == "f" else value
        wanted = "text" if is_text else "number"
        raise InputError(f"{self.column_name}: found {value!r}, expected a {wanted}")


def build(values: ArrayLike, table_name: str, column_name: str, kind: str, count: int = 1) -> bytes:
    """Bytes of a thematic index with lists of rows.

    Parameters
    ----------
    values : array (n_row,)
        The column, row by row: numbers, or texts as str or bytes.
    table_name, column_name : str
        What is indexed; at most 12 and 24 characters.
    kind : str
        Type of the column: I, S, F or T.
    count : int
        Characters of a text; 1 for numbers.

    Returns
    -------
    bytes

    Raises
    ------
    InputError
        The kind is not indexed, a value does not fit it, or a name is too long.

    Notes
    -----
    Source: specs/vpf.md, V-350, V-351, V-353. Cost: O(n log n).

    Examples
    --------
    >>> data = build(["BA010", "BH000", "BA010", "BA010"], "shore.lft", "f_code", "T", 5)
    >>> data[60:].hex(" ")
    '42 41 30 31 30 56 00 00 00 03 00 00 00 42 48 30 30 30 02 00 00 00 00 00 00 00 01 00 03 00 04 00'
    """
    column = _column(values, kind, count)
    names = _name(table_name, 12).ljust(12), _name(column_name, MOST_NAME)
    distinct, value_of, counts = np.unique(column, return_inverse=True, return_counts=True)
    ids = np.argsort(value_of.ravel(), kind="stable") + 1
    id_kind = "S" if len(column) <= MOST_SHORT else "I"
    directory = np.empty(len(distinct), _entry("<", kind, count))
    first = HEADER.size + directory.nbytes
    is_list = counts > 1
    directory["value"] = distinct
    directory["count"] = np.where(is_list, counts, 0)
    n_before = np.cumsum(directory["count"], dtype=np.int64) - directory["count"]
    places = first + n_before * np.dtype(DTYPES[id_kind]).itemsize
    if len(column) and places[-1] + 4 * counts[-1] > 2**31 - 1:
        raise InputError(f"{column_name}: found {len(column):,} rows, expected an index of less than 2 GB")
    directory["offset"] = np.where(is_list, places, ids[np.cumsum(counts) - counts])
    lists = ids[np.repeat(is_list, counts)].astype(f"<{DTYPES[id_kind]}")
    header = HEADER.pack(
        first, len(distinct), len(column), b"I", kind.encode(), count, id_kind.encode(), *names, b"S",
    )  # fmt: skip
    return header + directory.tobytes() + lists.tobytes()


def read(data: bytes, path: str = "") -> ThematicIndex:
    """Read a thematic index of any type.

    Parameters
    ----------
    data : bytes
        The whole file.
    path : str
        Named in messages.

    Returns
    -------
    ThematicIndex

    Raises
    ------
    VpfFormatError
        The bytes break V-350 to V-352.

    Examples
    --------
    >>> read(build([7, 7, -1], "road.lft", "edg_id", "I")).rows(7)
    array([1, 2], dtype=int32)
    """
    header = _read_header(data, path)
    directory = np.frombuffer(data, _entry(header.order, header.kind, header.n_element), header.n_value, HEADER.size)
    values = directory["value"].astype(directory["value"].dtype.newbyteorder("="))
    if values.dtype.kind == "S":
        values = np.char.rstrip(values)
    rank = np.argsort(values, kind="stable")
    offsets, counts = directory["offset"][rank].astype(np.int64), directory["count"][rank].astype(np.int64)
    is_single = counts == 0 if header.index_type != "G" else np.zeros(len(counts), bool)
    if header.index_type in "BG":
        starts, ids = _read_bits(data, path, header, offsets, is_single)
    else:
        starts, ids = _read_lists(data, path, header, offsets, counts)
    if len(ids) and (ids.min() < 1 or ids.max() > header.n_row):
        wrong = ids.min() if ids.min() < 1 else ids.max()
        raise VpfFormatError(path, "", f"found row {wrong}, expected rows from 1 to {header.n_row}", "V-351")
    is_rising = bool(np.all(rank == np.arange(len(rank))))
    return ThematicIndex(
        header.table_name, header.column_name, header.index_type, header.kind, header.n_row, header.is_sorted,
        is_rising, values[rank], starts, ids.astype(np.int32),
    )  # fmt: skip


def _entry(order: str, kind: str, count: int) -> np.dtype[Any]:
    """One entry of the directory."""
    value = f"S{count}" if DTYPES[kind] == "S" else f"{order}{DTYPES[kind]}"
    return np.dtype([("value", value), ("offset", f"{order}i4"), ("count", f"{order}i4")])


def _column(values: ArrayLike, kind: str, count: int) -> NDArray[Any]:
    """Values as they stand in the directory."""
    if kind not in WRITTEN or len(kind) != 1:
        raise InputError(f"found a column of type {kind}, expected one of: {', '.join(WRITTEN)}")
    if count < 1 or (kind != "T" and count != 1):
        raise InputError(f"found {count} elements a value of type {kind}, expected 1, or the characters of a text")
    column = np.asarray(values)
    if kind == "T":
        return _texts(column, count)
    dtype = np.dtype(DTYPES[kind])
    if column.size == 0:
        return np.empty(0, dtype)
    if column.ndim != 1 or column.dtype.kind not in ("iuf" if kind == "F" else "iu"):
        raise InputError(f"found values of {column.dtype} {column.shape}, expected one number of type {kind} a row")
    if kind != "F" and (column.min() < np.iinfo(dtype).min or column.max() > np.iinfo(dtype).max):
        raise InputError(f"found values from {column.min()} to {column.max()}, expected type {kind}")
    return column.astype(dtype)


def _texts(column: NDArray[Any], count: int) -> NDArray[np.bytes_]:
    if column.size == 0:
        return np.empty(0, f"S{count}")
    if column.ndim != 1 or column.dtype.kind not in "US":
        raise InputError(f"found values of {column.dtype} {column.shape}, expected one text a row")
    try:
        encoded = np.char.encode(column, "latin-1") if column.dtype.kind == "U" else column
    except UnicodeEncodeError as error:
        raise InputError(f"found the text {error.object[:40]!r}, expected Latin-1") from error
    widths = np.char.str_len(encoded)
    if widths.max() > count:
        text = encoded[np.argmax(widths)].decode("latin-1")
        raise InputError(f"found the text {text[:40]!r} of {widths.max()} characters, expected at most {count}")
    return np.char.ljust(encoded, count)


def _name(name: str, most: int) -> bytes:
    if not name.isascii() or not 1 <= len(name) <= most:
        raise InputError(f"found the name {name!r}, expected 1 to {most} ASCII characters")
    return name.encode()


def _read_header(data: bytes, path: str) -> Header:
    """The header in the byte order in which its sizes agree."""
    if len(data) < HEADER.size:
        raise VpfFormatError(path, "header", f"found {len(data)} bytes, expected at least {HEADER.size}", "V-350")
    for order in "<>":
        first, n_value, n_row, *letters, table, column, sort = struct.unpack_from(order + HEADER.format[1:], data)
        index_type, kind, id_kind = (letters[i].decode("latin-1").upper() for i in (0, 1, 3))
        header = Header(
            order, first, n_value, n_row, index_type, kind, letters[2], id_kind, _text(table), _text(column),
            sort in b"Ss",
        )  # fmt: skip
        wrong = _header_problem(header, len(data))
        if not wrong:
            return header
        if order == "<":
            first_wrong = wrong
    raise VpfFormatError(path, "header", first_wrong, "V-350")


def _header_problem(header: Header, size: int) -> str:
    """What is wrong with a header, or nothing."""
    if header.index_type not in "ITBG":
        return f"found an index of type {header.index_type!r}, expected I, T, B or G"
    if header.kind not in DTYPES or (header.index_type == "G" and header.kind not in "TL"):
        return f"found a column of type {header.kind!r}, expected one of: {', '.join(DTYPES)}"
    if header.id_kind not in "IS":
        return f"found row ids of type {header.id_kind!r}, expected S or I"
    if not 1 <= header.n_element <= size or (header.kind not in "TLD" and header.n_element != 1):
        return f"found {header.n_element} elements a value, expected 1, or the characters of a text"
    if header.n_row < 0 or header.n_value < 0:
        return f"found {header.n_value} values of {header.n_row} rows, expected numbers from 0 on"
    first = HEADER.size + header.n_value * _entry("<", header.kind, header.n_element).itemsize
    if first > size or header.first not in (HEADER.size, first):
        return f"found {header.n_value} values, data from byte {header.first} of {size}, expected it at {first}"
    return ""


def _text(name: bytes) -> str:
    """A name, up to the first NUL: what stands behind it is not part of it."""
    return name.split(b"\0")[0].decode("latin-1").strip()


def _read_lists(
    data: bytes, path: str, header: Header, offsets: NDArray[np.int64], counts: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Lists of rows, one behind the other: where each starts, and the ids. A count of 0 says: the offset is the row."""
    dtype = np.dtype(f"{header.order}{DTYPES[header.id_kind]}")
    _check_places(path, header, offsets, counts * dtype.itemsize, len(data))
    starts = np.concatenate([[0], np.cumsum(np.maximum(counts, 1))])
    ids = np.empty(starts[-1], np.int64)
    ids[starts[:-1]] = offsets
    is_list = counts > 0
    where = np.repeat(is_list, np.maximum(counts, 1))
    n_before = np.cumsum(counts[is_list]) - counts[is_list]
    items = np.arange(counts[is_list].sum()) - np.repeat(n_before, counts[is_list])
    places = np.repeat(offsets[is_list], counts[is_list]) + items * dtype.itemsize
    raw = np.frombuffer(data, np.uint8)[places[:, None] + np.arange(dtype.itemsize)]
    ids[where] = np.ascontiguousarray(raw).view(dtype).ravel()
    return starts, ids


def _read_bits(
    data: bytes, path: str, header: Header, offsets: NDArray[np.int64], is_single: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Bit arrays as lists of rows; the lowest bit of the first byte is row 1."""
    width = -(-header.n_row // 8)
    _check_places(path, header, offsets, np.where(is_single, 0, width), len(data))
    raw = np.frombuffer(data, np.uint8)[offsets[~is_single, None] + np.arange(width if (~is_single).any() else 0)]
    bits = np.unpackbits(raw, axis=1, bitorder="little")[:, : header.n_row]
    counts = np.ones(len(offsets), np.int64)
    counts[~is_single] = np.count_nonzero(bits, axis=1)
    ids = np.empty(counts.sum(), np.int64)
    ids[np.repeat(is_single, counts)] = offsets[is_single]
    ids[np.repeat(~is_single, counts)] = np.nonzero(bits)[1] + 1
    return np.concatenate([[0], np.cumsum(counts)]), ids


def _check_places(path: str, header: Header, offsets: NDArray[np.int64], sizes: NDArray[np.int64], size: int) -> None:
    """Refuse data outside the file, and more of it than the file has room for: lists do not share bytes."""
    first = HEADER.size + header.n_value * _entry("<", header.kind, header.n_element).itemsize
    is_wrong = (sizes < 0) | ((sizes > 0) & ((offsets < first) | (offsets + sizes > size)))
    if is_wrong.any():
        i = int(np.argmax(is_wrong))
        message = f"found {sizes[i]} bytes of rows at byte {offsets[i]}, expected them between {first} and {size}"
        raise VpfFormatError(path, "directory", message, "V-351")
    if sizes.sum() > size - first:
        message = f"found {sizes.sum()} bytes of rows, expected at most {size - first}: no row has two values"
        raise VpfFormatError(path, "directory", message, "V-351")
