"""VPF tables by the book and one value at a time, with `struct` alone: what the codec of vpfx is held against.

Nothing here is shared with vpfx. Written from the facts about MIL-STD-2407 that specs/vpf.md gives.
"""

from __future__ import annotations

import struct
from typing import Any, NamedTuple

NUMBERS = {"F": "f", "R": "d", "S": "h", "I": "i", "C": "ff", "B": "dd", "Z": "fff", "Y": "ddd"}
TEXTS = "TLNM"


class Broken(Exception):
    """The bytes are no table."""


class Field(NamedTuple):
    """One column: count -1 is `*`."""

    name: str
    kind: str
    count: int


def fields_of(header: str) -> list[Field]:
    """Return the columns of a well-formed header without escapes."""
    columns = header.split(";", 3)[3].removesuffix(";").removesuffix(":")
    fields = []
    for text in columns.split(":"):
        name, definition = text.split("=", 1)
        kind, count = definition.split(",")[:2]
        fields.append(Field(name, kind, -1 if count.strip() == "*" else int(count)))
    return fields


def split(data: bytes) -> tuple[str, str, int]:
    """Return byte order, header text and offset of the first row."""
    order = ">" if data[4:5] in (b"M", b"m") else "<"
    (length,) = struct.unpack(order + "i", data[:4])
    return order, data[4 : 4 + length].decode("latin-1"), 4 + length


class Reader:
    """Takes values from bytes, one behind the other."""

    def __init__(self, data: bytes, at: int, order: str) -> None:
        self.data, self.at, self.order = data, at, order

    def take(self, n: int) -> bytes:
        if n < 0 or self.at + n > len(self.data):
            raise Broken(f"{n} bytes at {self.at} of {len(self.data)}")
        self.at += n
        return self.data[self.at - n : self.at]

    def numbers(self, code: str) -> tuple[Any, ...]:
        return struct.unpack(self.order + code, self.take(struct.calcsize("<" + code)))

    def triplet(self) -> tuple[int, int, int]:
        (code,) = self.take(1)
        parts = []
        for shift in (6, 4, 2, 0):
            letter = {0: "", 1: "B", 2: "H", 3: "I"}[code >> shift & 3]
            parts.append(self.numbers(letter)[0] if letter else 0)
        return tuple(parts[:3])

    def field(self, field: Field) -> Any:
        """Return bytes of a text, a tuple of a triplet, else a list of elements, each a tuple."""
        if field.kind == "K":
            return self.triplet()
        if field.kind == "X":
            return []
        count = field.count if field.count >= 0 else self.numbers("i")[0]
        if count < 0:
            raise Broken(f"count {count}")
        if field.kind in TEXTS:
            return self.take(count)
        if field.kind == "D":
            return self.take(20 * count)
        code = NUMBERS[field.kind]
        if count * struct.calcsize("<" + code) > len(self.data) - self.at:
            raise Broken(f"count {count}")
        return [self.numbers(code) for _ in range(count)]


def rows_of(data: bytes, fields: list[Field], order: str, at: int) -> tuple[list[list[Any]], int]:
    """Return the rows from an offset on, and the bytes left behind the last, fewer than the shortest row has."""
    sizes = {**{kind: struct.calcsize("<" + code) for kind, code in NUMBERS.items()}, "D": 20, "X": 0}
    least = sum(1 if f.kind == "K" else 4 if f.count < 0 else f.count * sizes.get(f.kind, 1) for f in fields)
    reader, rows = Reader(data, at, order), []
    while len(data) - reader.at >= least:
        rows.append([reader.field(field) for field in fields])
    return rows, len(data) - reader.at


def put_triplet(order: str, triplet: tuple[int, int, int]) -> bytes:
    """Return a triplet with the shortest widths."""
    code, parts = 0, b""
    for shift, value in zip((6, 4, 2), triplet, strict=True):
        width = 0 if value == 0 else 1 if value <= 255 else 2 if value <= 65535 else 3
        code |= width << shift
        if width:
            parts += struct.pack(order + " BHI"[width], value)
    return bytes([code]) + parts


def put_field(order: str, field: Field, value: Any) -> bytes:
    """Return the bytes of a value, given as `Reader.field` returns it."""
    if field.kind == "K":
        return put_triplet(order, value)
    if field.kind == "X":
        return b""
    if field.kind in TEXTS + "D":
        body, count = value, len(value)
    else:
        body, count = b"".join(struct.pack(order + NUMBERS[field.kind], *element) for element in value), len(value)
    return (struct.pack(order + "i", count) if field.count < 0 else b"") + body


def table_bytes(order: str, fields: list[Field], rows: list[list[Any]], n_name: int = 3) -> tuple[bytes, bytes]:
    """Return a table with so many names behind each description, and its index."""
    columns = "".join(
        f"{f.name}={f.kind},{'*' if f.count < 0 else f.count},N,About {f.name},{'-,' * n_name}:" for f in fields
    )
    header = f"{'M' if order == '>' else 'L'};Made up;-;{columns};".encode()
    data = struct.pack(order + "i", len(header)) + header
    index = struct.pack(order + "ii", len(rows), len(data))
    for row in rows:
        body = b"".join(put_field(order, field, value) for field, value in zip(fields, row, strict=True))
        index += struct.pack(order + "II", len(data), len(body))
        data += body
    return data, index


def table_of(columns: bytes, order: bytes = b"L", rows: bytes = b"") -> bytes:
    """Return a little-endian table with definitions of columns, or a big-endian one with the letter M."""
    text = order + b";Made up;-;" + columns + b";"
    return len(text).to_bytes(4, "big" if order in b"Mm" and order else "little") + text + rows
