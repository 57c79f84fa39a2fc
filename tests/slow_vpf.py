"""A slow reader of VPF tables, row by row with `struct`, that shares no code with vpfx: what the exporter's tests judge by."""

from __future__ import annotations

import math
import struct
from itertools import pairwise
from pathlib import Path
from typing import Any

__all__ = ["bins", "read", "rows_of"]

SIZES = {"T": 1, "L": 1, "S": 2, "I": 4, "F": 4, "R": 8, "D": 20, "X": 0}
MEMBERS = {"C": "2f", "Z": "3f", "B": "2d", "Y": "3d"}
WIDTHS = ("", "B", "H", "I")


class Cursor:
    """Bytes that are read from front to back."""

    def __init__(self, data: bytes, at: int = 0) -> None:
        self.data, self.at = data, at

    def take(self, form: str) -> Any:
        """Return the next values."""
        values = struct.unpack_from(f"<{form}", self.data, self.at)
        self.at += struct.calcsize(f"<{form}")
        return values if len(values) > 1 else values[0]

    def text(self, size: int) -> bytes:
        """Return the next bytes."""
        self.at += size
        return self.data[self.at - size : self.at]

    def triplet(self) -> tuple[int, int, int]:
        """Return the next id, tile and id there; 0 is none."""
        code = self.take("B")
        assert code & 3 == 0
        return tuple(self.take(WIDTHS[code >> shift & 3]) if code >> shift & 3 else 0 for shift in (6, 4, 2))

    def value(self, kind: str, count: str) -> Any:
        """Return the next value of a column; null is None."""
        if kind in "TL" or kind in MEMBERS:
            n = self.take("i") if count == "*" else int(count)
            if kind in MEMBERS:
                tuples = [self.take(MEMBERS[kind]) for _ in range(n)]
                return tuples if count == "*" else tuples[0]
            text = self.text(n).decode("ascii" if kind == "T" else "latin-1")
            if count == "*":
                return text if n else None
            return None if text.rstrip() in ("", "-", "--", "N/A") else text.rstrip()
        assert count == "1"
        if kind == "K":
            return self.triplet()
        if kind == "D":
            return self.text(20).decode().strip() or None
        number = self.take({"S": "h", "I": "i", "F": "f", "R": "d"}[kind])
        is_null = math.isnan(number) if kind in "FR" else number == {"S": -(2**15), "I": -(2**31)}[kind]
        return None if is_null else number


def head_of(data: bytes) -> tuple[int, dict[str, list[str]]]:
    """Return where the rows begin, and type, count, key, description and names of each column."""
    size = int.from_bytes(data[:4], "little")
    text = data[4 : 4 + size].decode("ascii")
    order, description, narrative, columns, rest = text.split(";")
    assert (order, narrative, rest) == ("L", "-", "")
    assert description
    fields = {}
    for column in columns.removesuffix(":").split(":"):
        name, definition = column.split("=")
        *parts, last = definition.split(",")
        assert last == ""
        assert len(parts) == 7
        assert parts[2] in "PUN"
        fields[name] = parts
    assert next(iter(fields)) == "id"
    return 4 + size, fields


def read(path: Path) -> dict[str, list[Any]]:
    """Return the columns of a table; its index, its ids and its last byte are checked."""
    data = path.read_bytes()
    first, fields = head_of(data)
    cursor, rows, places = Cursor(data, first), [], []
    while cursor.at < len(data):
        places.append(cursor.at)
        rows.append([cursor.value(kind, count) for kind, count, *_ in fields.values()])
    assert cursor.at == len(data)
    is_variable = any(kind == "K" or count == "*" for kind, count, *_ in fields.values())
    index = path.with_name(f"{path.name[:-1]}{'X' if path.name.isupper() else 'x'}")
    if is_variable:
        bounds = [*places, len(data)]
        entries = [number for place, end in pairwise(bounds) for number in (place, end - place)]
        assert index.read_bytes() == struct.pack(f"<{2 + len(entries)}I", len(rows), first, *entries)
    assert [row[0] for row in rows] == list(range(1, len(rows) + 1))
    return {name: [row[i] for row in rows] for i, name in enumerate(fields)}


def rows_of(path: Path, *names: str) -> list[tuple[Any, ...]]:
    """Return rows of some columns, or of all but the id."""
    table = read(path)
    return list(zip(*(table[name] for name in names or list(table)[1:]), strict=True))


def bins(path: Path) -> tuple[tuple[float, ...], dict[int, list[tuple[int, ...]]]]:
    """Return extent and entries (xmin, ymin, xmax, ymax, id) of a spatial index, by the number of their bin."""
    cursor = Cursor(path.read_bytes())
    count, *extent, n_bin = cursor.take("i4fi")
    sizes = [cursor.take("ii") for _ in range(n_bin)]
    found, offset = {}, 0
    for number, (place, size) in enumerate(sizes, 1):
        assert place == offset
        found[number] = [cursor.take("4Bi") for _ in range(size)]
        offset += 8 * size
    assert cursor.at == len(cursor.data)
    assert sum(map(len, found.values())) == count
    return tuple(extent), found
