"""Random VPF tables for tests, and rows as vpfx has them beside those of the oracle."""

from __future__ import annotations

import numpy as np
import vpf_oracle as oracle
from hypothesis import strategies as st

from vpfx.vpf.header import KINDS
from vpfx.vpf.table import Column, Layout, Ragged
from vpfx.vpf.values import ragged

NAMES = [f"c{i}" for i in range(6)]
ASCII = st.characters(min_codepoint=32, max_codepoint=126)
BYTES = {"T": ASCII, "N": ASCII, "M": ASCII, "D": ASCII, "L": st.characters(min_codepoint=1, max_codepoint=255)}
FLOATS = {"f": st.floats(width=32), "d": st.floats(), "h": st.integers(-(2**15), 2**15 - 1)}
FLOATS["i"] = st.integers(-(2**31), 2**31 - 1)
IDS = st.one_of(st.just(0), st.integers(0, 300), st.integers(0, 2**32 - 1))


@st.composite
def tables(draw, kinds="TLFRSICBZYDKX"):
    """Columns and rows as the oracle has them."""
    fields = [oracle.Field("id", "I", 1)]
    for name in NAMES[: draw(st.integers(0, len(NAMES)))]:
        kind = draw(st.sampled_from(kinds))
        several = "TLCBZY" if "N" not in kinds else "TLNMCBZYFRSI"
        count = draw(st.sampled_from([-1, 1, 2, 5])) if kind in several else 1
        fields.append(oracle.Field(name, kind, count))
    return fields, [[draw(value_of(field)) for field in fields] for _ in range(draw(st.integers(0, 5)))]


def value_of(field):
    """Values of a column, as the oracle has them."""
    if field.kind == "K":
        return st.tuples(IDS, IDS, IDS)
    if field.kind == "X":
        return st.just([])
    count = {"min_size": 0, "max_size": 4} if field.count < 0 else {"min_size": field.count, "max_size": field.count}
    if field.kind == "D":
        count = {"min_size": 20, "max_size": 20}
    if field.kind in BYTES:
        return st.text(BYTES[field.kind], **count).map(lambda text: text.encode("latin-1"))
    code = oracle.NUMBERS[field.kind]
    return st.lists(st.tuples(*(FLOATS[letter] for letter in code)), **count)


def as_given(fields, rows):
    """Rows of the oracle as columns to write."""
    columns = {}
    for i, field in enumerate(fields):
        values = [row[i] for row in rows]
        if field.kind == "K":
            columns[field.name] = np.array(values, np.int64).reshape(-1, 3)
        elif field.kind in BYTES:
            columns[field.name] = values
        elif field.count < 0:
            columns[field.name] = ragged(values, len(oracle.NUMBERS[field.kind]))
        elif field.kind != "X":
            shape = (len(rows), *(field.count,) * (field.count > 1), *KINDS[field.kind][1:2] * (field.kind in "CBZY"))
            columns[field.name] = np.array(values).reshape(shape).astype(KINDS[field.kind].member)
    return columns


def as_rows(table, fields):
    """Columns of a table as rows of the oracle; NaN as text, which is equal to itself."""
    columns = []
    for field in fields:
        column = table[field.name]
        rows = [column.row(i) for i in range(column.n_row)] if isinstance(column, Ragged) else list(column)
        if field.kind in BYTES and field.count < 0:
            columns.append([row.tobytes() for row in rows])
        elif field.kind in BYTES:
            width = column.dtype.itemsize
            columns.append([column.tobytes()[i * width : (i + 1) * width] for i in range(len(column))])
        elif field.kind == "K":
            columns.append([tuple(row) for row in column.tolist()])
        elif field.kind == "X":
            columns.append([[] for _ in rows])
        else:
            width = len(oracle.NUMBERS[field.kind])
            columns.append([list(map(tuple, np.reshape(row, (-1, width)).tolist())) for row in rows])
    return repr([list(row) for row in zip(*columns, strict=True)])


def layout_of(fields, order):
    return Layout("Made up", tuple(Column(f.name, f.kind, f.count, "N", f"About {f.name}") for f in fields), "-", order)
