"""Columns of other types than they should have: each column of each table of a database is read or refused, never a crash."""

from __future__ import annotations

import pytest
import vpf_oracle as oracle
from vpf_databases import write_database
from vpf_maps import Map

from vpfx.errors import VpfFormatError, VpfxError
from vpfx.vpf.catalog import open_database
from vpfx.vpf.layers import crs_of
from vpfx.vpf.layouts import PRIMITIVES
from vpfx.vpf.listing import list_database, list_lines, table_rows
from vpfx.vpf.opening import feature_classes, open_coverages
from vpfx.vpf.reader import read_class, read_primitives
from vpfx.vpf.table import index_name, read_table

TABLES = [
    "lat", "lib/cat", "lib/grt", "lib/tileref/tileref.aft", "lib/tileref/fbr", "lib/land/fcs", "lib/land/fca",
    "lib/land/int.vdt", "lib/land/char.vdt", "lib/land/area.ajt", "lib/land/point.pft", "lib/land/00/00/edg",
    "lib/land/00/00/cnd", "lib/land/00/00/txt",
]  # fmt: skip
TYPES = [("T", 8), ("I", 1), ("I", 2), ("F", -1), ("K", 1), ("X", 1)]


def value_of(kind, count, number):
    """A value of a type, as the oracle writes it."""
    if kind == "K":
        return number, 0, 0
    if kind in "TX":
        return str(number).encode().ljust(count)
    return [(number,) * len(oracle.NUMBERS[kind])] * abs(count)


def read_all(root):
    """Read all there is, as far as it can be read; return lines on what cannot."""
    problems = list_lines(list_database(open_database(root)))
    opened = open_coverages(root)
    for coverage in opened.coverages:
        classes, told = feature_classes(coverage)
        problems.append(str(crs_of(coverage)))
        for read, given in [(read_class, classes.values()), (read_primitives, PRIMITIVES)]:
            for one in given:
                try:
                    rows = read(coverage, one)
                except VpfxError as error:
                    problems.append(str(error))
                    continue
                assert {len(field.values) for field in rows.fields.values()} <= {len(rows.geometry)}
                problems += rows.problems
        problems += told
    return problems


@pytest.mark.parametrize("name", TABLES)
def test_columns_of_any_type_are_read_or_refused(name, tmp_path):
    root = write_database(tmp_path / "db", Map([[1, 2]], tile=1))
    path = root / name
    path.with_name(index_name(path.name)).unlink(missing_ok=True)
    order, header, at = oracle.split(path.read_bytes())
    fields = oracle.fields_of(header)
    rows, _ = oracle.rows_of(path.read_bytes(), fields, order, at)
    before = read_all(root)
    n_told = 0
    cases = [(i, *form) for i in range(len(fields)) for form in TYPES[i % 3 :: 3]]
    for i, kind, count in cases:
        changed = [*fields[:i], oracle.Field(fields[i].name, kind, count), *fields[i + 1 :]]
        values = [[*row[:i], value_of(kind, count, number), *row[i + 1 :]] for number, row in enumerate(rows, 1)]
        path.write_bytes(oracle.table_bytes(order, changed, values)[0])
        assert len(table_rows(read_table(path), is_nested=False)[1]) == len(rows)
        try:
            n_told += read_all(root) != before
        except VpfFormatError:
            n_told += 1
    assert n_told > 2


def test_dates_are_single(tmp_path):
    (tmp_path / "a.rat").write_bytes(oracle.table_of(b"id=I,1,P,:seen=D,2,N,:"))
    with pytest.raises(VpfFormatError, match=r"column 'seen': found D,2, expected D,1 \(V-111\)"):
        read_table(tmp_path / "a.rat")
