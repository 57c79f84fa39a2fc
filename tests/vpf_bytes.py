"""VPF tables and databases written with `struct` alone, in the ways of several producers; no code of vpfx is used."""

from __future__ import annotations

import struct
from dataclasses import dataclass

NULL_INT = -(2**31)
SIZES = {"I": "i", "S": "h", "F": "f", "R": "d", "C": "ff", "Z": "fff", "B": "dd", "Y": "ddd"}


@dataclass(frozen=True)
class Style:
    """How a producer writes."""

    order: str = "<"
    has_order: bool = True  # else the header has no letter, which means little-endian
    is_upper: bool = False
    dot: str = ""
    has_index: bool = True
    link: str = "K"  # kind of the links of edges
    coordinate: str = "C"
    tile_kind: str = "S"
    is_old: bool = False  # names and keys of 1992
    has_rings: bool = True  # else no `fac` and `rng`
    stray: bytes = b""  # behind the last row
    has_heights: bool = False  # else heights, where the coordinates have some, are no numbers

    def named(self, name):
        """Name of a file."""
        return (name.upper() if self.is_upper else name) + ("" if "." in name else self.dot)

    def column(self, name):
        """Name of a column."""
        return name.upper() if self.is_upper or self.is_old else name


def table(style, columns, rows):
    """Bytes of a table and of its index; columns are (name, type, count, key, value table)."""
    tail = "-,:" if style.is_old else "-,-,:"
    keys = {"N": "N", "P": "P", "U": "U"} | ({"N": "F"} if style.is_old else {})
    text = "".join(
        f"{style.column(name)}={kind},{count},{keys[key]},about {name},{values},{tail}"
        for name, kind, count, key, values in columns
    )
    letter = {"<": "L", ">": "M"}[style.order] if style.has_order else ""
    head = f"{letter};A table;-;{text};".encode("ascii")
    data, places = struct.pack(style.order + "i", len(head)) + head, []
    for row in rows:
        packed = b"".join(_packed(style, *column[1:3], value) for column, value in zip(columns, row, strict=True))
        places.append((len(data), len(packed)))
        data += packed
    index = struct.pack(style.order + "ii", len(places), 4 + len(head))
    index += b"".join(struct.pack(style.order + "II", *place) for place in places)
    is_variable = any(column[1] == "K" or column[2] == "*" for column in columns)
    return data + style.stray, index if is_variable else None


def _packed(style, kind, count, value):
    if kind == "X":
        return b""
    if kind == "K":
        return triplet(style.order, *(value if isinstance(value, tuple) else (value, 0, 0)))
    if kind in "TL":
        raw = value.encode("latin-1") if isinstance(value, str) else value
        if count == "*":
            return struct.pack(style.order + "i", len(raw)) + raw
        assert len(raw) <= int(count), value
        return raw.ljust(int(count))
    if kind == "D":
        return value.encode().ljust(20)
    code = style.order + SIZES[kind]
    if kind not in "CZBY":
        return struct.pack(code, value)
    body = b"".join(struct.pack(code, *place) for place in value)
    return struct.pack(style.order + "i", len(value)) + body if count == "*" else body


def triplet(order, *values):
    """An id of three parts, each as short as it can be."""
    head, body = 0, b""
    for shift, value in zip((6, 4, 2), values, strict=True):
        width = 0 if not value else 1 if value < 256 else 2 if value < 65536 else 3
        head |= width << shift
        body += struct.pack(order + ("", "B", "H", "I")[width], value) if width else b""
    return bytes([head]) + body


def index_name(name):
    return "fcz" if name == "fcs" else name[:-1] + "x"


def write(folder, style, name, columns, rows):
    """Write a table, and its index where it needs one."""
    data, index = table(style, columns, rows)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / style.named(name)).write_bytes(data)
    if index is not None and style.has_index:
        (folder / style.named(index_name(name))).write_bytes(index)


ID = ("id", "I", 1, "P", "-")


def col(name, kind, count=1, values="-"):
    return (name, kind, count, "N", values)
