"""VPF tables: bytes to arrays and back, against worked values, a slow decoder of its own and real tables."""

from __future__ import annotations

import numpy as np
import pytest
import vpf_oracle as oracle
from conftest import shared_vpf
from hypothesis import given, settings
from hypothesis import strategies as st
from vpf_made import as_given, as_rows, layout_of, tables

from vpfx.errors import InputError
from vpfx.vpf.table import (
    Column,
    Layout,
    Ragged,
    TableWriter,
    decode,
    encode,
    index_name,
    open_table,
    read_table,
    write_table,
)

RING_HEADER = b"L;Ring Table;-;id=I,1,P,Row id,-,-,-,:face_id=I,1,N,Face,-,-,-,:start_edge=I,1,N,First edge,-,-,-,:;"
RING_ROWS = "01 00 00 00  01 00 00 00  02 00 00 00  02 00 00 00  02 00 00 00  02 00 00 00"
ID = Column("id", "I", 1, "P", "Row id")
EDGES = Layout("Edge", (ID, Column("right_face", "K", 1, "N", "Face")))
TEXTS = Layout("Texts", (ID, Column("string", "T", -1)))


# --- worked values ----------------------------------------------------------------------------------------------------


def test_ring_table_is_the_one_of_the_page():
    columns = (ID, Column("face_id", "I", 1, "N", "Face"), Column("start_edge", "I", 1, "N", "First edge"))
    data, index = encode(Layout("Ring Table", columns), {"id": [1, 2], "face_id": [1, 2], "start_edge": [2, 2]})
    assert data == b"\x64\0\0\0" + RING_HEADER + bytes.fromhex(RING_ROWS)
    assert index is None
    assert decode(data)["start_edge"].tolist() == [2, 2]


def test_index_is_the_one_of_the_page():
    data, index = encode(EDGES, {"id": [1, 2], "right_face": np.array([(2, 0, 0), (300, 4, 9)])})
    assert data[-15:] == bytes.fromhex("01 00 00 00 40 02            02 00 00 00 94 2C 01 04 09")
    first = len(data) - 15
    assert index == np.array([2, first, first, 6, first + 6, 9], "<u4").tobytes()
    for given_index in (index, None):
        assert decode(data, given_index)["right_face"].tolist() == [[2, 0, 0], [300, 4, 9]]


@pytest.mark.parametrize(
    ("triplet", "little", "big"),
    [
        ((0, 0, 0), "00", "00"),
        ((64, 0, 0), "40 40", "40 40"),
        ((546, 0, 0), "80 22 02", "80 02 22"),
        ((5, 12, 7), "54 05 0C 07", "54 05 0C 07"),
        ((5, 12, 300), "58 05 0C 2C 01", "58 05 0C 01 2C"),
        ((0, 12, 7), "14 0C 07", "14 0C 07"),
        ((70000, 3, 70001), "DC 70 11 01 00 03 71 11 01 00", "DC 00 01 11 70 03 00 01 11 71"),
        ((255, 256, 65535), "68 FF 00 01 FF FF", "68 FF 01 00 FF FF"),
        ((65536, 0, 2**32 - 1), "CC 00 00 01 00 FF FF FF FF", "CC 00 01 00 00 FF FF FF FF"),
    ],
)
def test_triplets_are_those_of_the_page(triplet, little, big):
    for order, text in (("<", little), (">", big)):
        data, _ = encode(EDGES._replace(order=order), {"id": [1], "right_face": [triplet]})
        assert data[-len(bytes.fromhex(text)) :] == bytes.fromhex(text)
        assert decode(data)["right_face"].tolist() == [list(triplet)]


@pytest.mark.parametrize(
    ("text", "triplet"),
    [
        ("41 07 63", [7, 0, 0]),  # a reserved field behind
        ("43 07 01 02 03 04", [7, 0, 0]),
        ("C0 07 00 00 00", [7, 0, 0]),  # wider than need be
        ("54 07 00 00", [7, 0, 0]),  # zeros told
    ],
)
def test_triplets_of_other_writers_are_read(text, triplet):
    empty, _ = encode(EDGES, {"id": [], "right_face": []})
    data = empty + b"\1\0\0\0" + bytes.fromhex(text) + b"\2\0\0\0\0"
    assert decode(data)["right_face"].tolist() == [triplet, [0, 0, 0]]


@pytest.mark.parametrize(
    ("name", "index"),
    [
        ("edg", "edx"), ("cnd", "cnx"), ("end", "enx"), ("txt", "txx"), ("rng", "rnx"), ("fac", "fax"), ("fca", "fcx"),
        ("roadl.lft", "roadl.lfx"), ("tileref.aft", "tileref.afx"), ("notes.rat", "notes.rax"), ("int.vdt", "int.vdx"),
        ("dqt", "dqx"), ("fcs", "fcz"), ("FCS", "FCZ"), ("EDG.", "EDX."),
    ],
)  # fmt: skip
def test_index_names_are_those_of_the_page(name, index):
    assert index_name(name) == index


@pytest.mark.parametrize("name", ["edx", "", ".", "x."])
def test_some_names_have_no_index(name):
    with pytest.raises(InputError, match="V-132"):
        index_name(name)


# --- random tables ----------------------------------------------------------------------------------------------------


@given(made=tables(), order=st.sampled_from("<>"))
@settings(max_examples=120, deadline=None)
def test_what_is_written_is_what_the_oracle_writes(made, order):
    fields, rows = made
    data, index = encode(layout_of(fields, order), as_given(fields, rows))
    expected, expected_index = oracle.table_bytes(order, fields, rows)
    assert data == expected
    is_variable = any(field.count < 0 or field.kind == "K" for field in fields)
    assert index == (expected_index if is_variable else None)


@given(
    made=tables("TLNMFRSICBZYDKX"),
    order=st.sampled_from("<>"),
    n_name=st.integers(0, 3),
    with_index=st.sampled_from(["own", "other order", "none"]),
)
@settings(max_examples=150, deadline=None)
def test_what_the_oracle_writes_is_read(made, order, n_name, with_index):
    fields, rows = made
    data, index = oracle.table_bytes(order, fields, rows, n_name)
    if with_index == "other order":
        index = np.frombuffer(index, "u4").byteswap().tobytes()
    table = decode(data, None if with_index == "none" else index)
    assert table.n_row == len(rows)
    assert table.layout == layout_of(fields, order)
    assert as_rows(table, fields) == repr(rows)
    for column in table.columns.values():
        values = column.values if isinstance(column, Ragged) else column
        assert values.dtype.isnative
        assert values.flags.c_contiguous


@given(made=tables(), order=st.sampled_from("<>"), cut=st.integers(0, 5), step=st.integers(1, 3))
@settings(max_examples=40, deadline=None)
def test_streams_are_the_whole(tmp_path_factory, made, order, cut, step):
    fields, rows = made
    path = tmp_path_factory.mktemp("stream") / "edg"
    with TableWriter(path, layout_of(fields, order)) as sink:
        for part in (rows[:cut], rows[cut:]):
            sink.append(as_given(fields, part))
        assert sink.n_row == len(rows)
    data, index = oracle.table_bytes(order, fields, rows)
    assert path.read_bytes() == data
    with open_table(path) as file:
        assert file.n_row == len(rows)
        assert file.index_problem == ""
        found = [as_rows(table, fields) for table in file.batches(step)]
        assert found == [repr(rows[i : i + step]) for i in range(0, len(rows), step)]
        assert as_rows(file.read(-2), fields) == repr(rows[-2:])
        assert file.read(3, 1).n_row == 0
    index_path = path.with_name("edx")
    if index_path.exists():
        assert index_path.read_bytes() == index
        index_path.unlink()
        with open_table(path) as file:
            assert "found no index file" in file.index_problem
            assert as_rows(file.read(cut), fields) == repr(rows[cut:])


def test_rows_of_many_blocks(tmp_path, monkeypatch):
    """Rows longer than a block of the scan, and blocks of many rows, in one table."""
    rng = np.random.default_rng(2407)
    counts = np.where(np.arange(3000) % 700 == 5, 200_000, rng.integers(0, 40, 3000))
    lines = Ragged(np.concatenate([[0], np.cumsum(counts)]), rng.random((counts.sum(), 2)).astype(np.float32))
    names = [f"name {i}" for i in range(3000)]
    layout = Layout("Lines", (ID, Column("name", "T", -1), Column("face", "K"), Column("coordinates", "C", -1)))
    columns = {"id": np.arange(3000), "name": names, "face": np.arange(3000) * 97, "coordinates": lines}
    for order in "<>":
        write_table(tmp_path / "edg", layout._replace(order=order), columns)
        for _ in ("with an index", "without"):
            table = read_table(tmp_path / "edg")
            assert (table["coordinates"].values == lines.values).all()
            assert (table["coordinates"].starts == lines.starts).all()
            assert (table["face"][:, 0] == np.arange(3000) * 97).all()
            assert table["name"].values.tobytes().decode() == "".join(names)
            with open_table(tmp_path / "edg") as file:
                assert (file.read(705, 707)["coordinates"].row(0) == lines.row(705)).all()
            (tmp_path / "edx").unlink(missing_ok=True)


# --- real tables ------------------------------------------------------------------------------------------------------


def real_tables():
    """Every table of the real data, by its path below the folder, with its bytes."""
    root = shared_vpf("PROVENANCE.md").parent
    found = {}
    for path in sorted(root.rglob("*")):
        data = path.read_bytes() if path.is_file() else b""
        if data[4:5] in (b"L", b";") and data[4:].count(b";") >= 4:
            found[path.relative_to(root).as_posix()] = path
    assert len(found) == 41
    return found


def test_real_tables_read_as_the_oracle_reads_them():
    for path in real_tables().values():
        data = path.read_bytes()
        order, header, at = oracle.split(data)
        fields = oracle.fields_of(header)
        rows, n_stray = oracle.rows_of(data, fields, order, at)
        with open_table(path) as file:
            assert file.index_problem == ""
            assert (file.stray, file.n_row) == (n_stray, len(rows))
            assert as_rows(file.read(), fields) == repr(rows)
        assert as_rows(decode(data), fields) == repr(rows)


def test_real_tables_come_out_as_they_went_in():
    """All that have three names a column, a letter for the order, no comma in a text and no stray byte."""
    same, refused, different = [], [], []
    for name, path in real_tables().items():
        table = read_table(path)
        try:
            data, index = encode(table.layout, table.columns)
        except InputError:
            refused.append(name.rsplit("/", 1)[1])
            continue
        (same if data == path.read_bytes() else different).append(name)
        if index is not None and name in same:
            assert index == path.with_name(index_name(path.name)).read_bytes()
    assert len(same) == 31
    assert set(refused) == {"ebr", "fbr", "rng"}  # their descriptions have a comma
    assert [name.rsplit("/", 1)[1] for name in different] == ["cnd", "edg", "dqt", "tileref.aft"]


def test_rows_of_dnc_come_out_as_they_went_in():
    """Its headers have two names a column, but the rows are the same, triplets and null columns too."""
    for name in ("cnd", "edg"):
        path = shared_vpf(f"dnc13_coa/browse/coa/{name}")
        table = read_table(path)
        data, _ = encode(table.layout, table.columns)
        assert data.endswith(path.read_bytes()[oracle.split(path.read_bytes())[2] :])
    assert table.n_row == 996


def test_real_stray_byte_is_told():
    with open_table(shared_vpf("vm2alv2_texash/texash/tileref/tileref.aft")) as file:
        assert (file.n_row, file.stray) == (1, 1)
