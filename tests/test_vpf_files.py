"""VPF tables as files: wrong rows and indexes, names of indexes, what is left of tables that failed."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from vpf_oracle import table_of

from vpfx.errors import InputError, NotFoundError, StoreError, VpfFormatError
from vpfx.vpf import writer
from vpfx.vpf.table import Column, Layout, TableWriter, decode, encode, open_table, read_table, write_table

ID = Column("id", "I", 1, "P", "Row id")
TEXTS = Layout("Texts", (ID, Column("string", "T", -1)))

# --- rows that are wrong ----------------------------------------------------------------------------------------------

LINE = table_of(b"id=I,1,P,:n=T,*,N,:c=C,*,N,:")


def row(number, text=b"", coordinates=b"", n_text=None, n_coordinate=None):
    counts = len(text) if n_text is None else n_text, len(coordinates) // 8 if n_coordinate is None else n_coordinate
    return struct.pack("<ii", number, counts[0]) + text + struct.pack("<i", counts[1]) + coordinates


@pytest.mark.parametrize("count", [-1, -(2**31), 2**31 - 1, 2_000_000, 2])
@pytest.mark.parametrize("field", ["n_text", "n_coordinate"])
def test_counts_are_bounded_by_the_file(count, field):
    data = LINE + row(1, b"a", b"12345678") + row(2, b"a", b"", **{field: count})
    with pytest.raises(VpfFormatError, match=r"edg: row 2: found a row at offset \d+ that runs over the end .*V-121"):
        decode(data, path="edg")


def test_bytes_behind_the_last_row_are_told(tmp_path):
    for rows, n_row, n_stray in ((row(1), 1, 0), (row(1) + b"\n", 1, 1), (row(1) + bytes(11), 1, 11), (b"\n", 0, 1)):
        (tmp_path / "txt").write_bytes(LINE + rows)
        with open_table(tmp_path / "txt") as file:
            assert (file.n_row, file.stray) == (n_row, n_stray)
    data, _ = encode(Layout("Made up", (ID,)), {"id": [1, 2]})
    assert decode(data + b"\n")["id"].tolist() == [1, 2]


def indexed(words, tail=b""):
    """Index of a table of two rows of 13 and 20 bytes, with some words changed."""
    first = len(LINE)
    right = [2, first, first, 13, first + 13, 20]
    return np.array([words.get(i, word) for i, word in enumerate(right)], "<u4").tobytes() + tail


TWO_ROWS = LINE + row(1, b"a") + row(2, b"", b"12345678")


@pytest.mark.parametrize(
    ("index", "problem"),
    [
        (indexed({}), ""),
        (indexed({1: len(LINE) - 4}), ""),  # as OGDI writes it
        (indexed({1: 7}), f"word 2: found 7, expected {len(LINE)} (V-130)"),
        (
            np.frombuffer(indexed({}), "<u4").byteswap().tobytes(),
            "found the other byte order than in its table (V-131)",
        ),
        (b"", "found 0 bytes for 0 rows, expected 8"),
        (indexed({})[:-1], "found 23 bytes for 2 rows, expected 24"),
        (indexed({}, b"\0"), "found 25 bytes for 2 rows, expected 24"),
        (indexed({0: 3}), "found 24 bytes for 3 rows, expected 32"),
        (indexed({0: 1})[:16], "found rows up to offset"),
        (indexed({0: 0})[:8], "found rows up to offset"),
        (indexed({2: 4}), "row 1: found offset 4 and length 13, expected offset"),
        (indexed({3: 12}), "row 2: found offset"),
        (indexed({4: 2**32 - 1}), "row 2: found offset 4294967295 and length 20"),
        (indexed({5: 2**32 - 1}), "row 2: found offset"),
        (indexed({5: 21}), "row 2: found offset"),
        (indexed({5: 0}), "found rows up to offset"),
    ],
)
def test_wrong_indexes_are_told_and_not_used(tmp_path, index, problem):
    (tmp_path / "txt").write_bytes(TWO_ROWS)
    (tmp_path / "txx").write_bytes(index)
    with open_table(tmp_path / "txt") as file:
        assert file.index_problem.startswith(problem)
        assert bool(file.index_problem) == bool(problem)
        assert file.read()["id"].tolist() == [1, 2]
        assert file.stray == 0


@pytest.mark.parametrize("shift", [-9, -1, 1, 7])
def test_indexes_that_cut_rows_elsewhere_are_told(shift):
    index = indexed({3: 13 + shift, 4: len(LINE) + 13 + shift, 5: 20 - shift})
    with pytest.raises(VpfFormatError, match=r"edg: row [12].*; if the index file is wrong, .* without it \(V-120\)"):
        decode(TWO_ROWS, index, "edg")


# --- files ------------------------------------------------------------------------------------------------------------


def names_in(folder):
    return sorted(path.name for path in folder.iterdir())


def test_fcs_has_two_indexes(tmp_path):
    write_table(tmp_path / "fcs", TEXTS, {"id": [1], "string": ["a"]})
    assert names_in(tmp_path) == ["fcs", "fcx", "fcz"]
    assert (tmp_path / "fcx").read_bytes() == (tmp_path / "fcz").read_bytes()
    (tmp_path / "fcz").unlink()
    with open_table(tmp_path / "fcs") as file:
        assert file.index_problem == ""


@pytest.mark.parametrize(("table", "index"), [("EDG", "EDX"), ("edg.", "edx."), ("edg.", "edx"), ("EDG", "edx.")])
def test_indexes_are_found_whatever_their_case(tmp_path, table, index):
    write_table(tmp_path / "edg", TEXTS, {"id": [1], "string": ["a"]})
    (tmp_path / "edg").rename(tmp_path / "moved").rename(tmp_path / table)
    (tmp_path / "edx").rename(tmp_path / index)
    with open_table(tmp_path / table) as file:
        assert file.index_problem == ""


def test_tables_of_one_length_ignore_indexes(tmp_path):
    write_table(tmp_path / "rng", Layout("Rings", (ID,)), {"id": [1, 2]})
    assert names_in(tmp_path) == ["rng"]
    (tmp_path / "rnx").write_bytes(b"?")
    assert read_table(tmp_path / "rng")["id"].tolist() == [1, 2]


@pytest.mark.parametrize("layout", [TEXTS, Layout("Rings", (ID,))])
def test_no_table_has_the_name_of_an_index(tmp_path, layout):
    with pytest.raises(InputError, match="'rnx': found no index name for it"):
        TableWriter(tmp_path / "rnx", layout)
    assert names_in(tmp_path) == []


def test_what_is_no_file_is_not_found(tmp_path):
    for path in (tmp_path, tmp_path / "edg"):
        with pytest.raises(NotFoundError, match="a name: found no file, expected a table"):
            read_table(path, name="a name")


def test_tables_that_change_while_open(tmp_path):
    write_table(tmp_path / "rng", Layout("Rings", (ID,)), {"id": range(5000)})
    with open_table(tmp_path / "rng") as file:
        (tmp_path / "rng").write_bytes(b"")
        with pytest.raises(VpfFormatError, match=r"found fewer bytes than the 20\d\d\d there were"):
            file.read()


@pytest.mark.parametrize("at", ["append", "block", "rename", "long"])
def test_nothing_is_left_of_a_table_that_failed(tmp_path, monkeypatch, at):
    def write():
        with TableWriter(tmp_path / "edg", TEXTS) as sink:
            sink.append({"id": [1], "string": ["a"]})
            if at == "append":
                sink.append({"id": [2], "string": ["Ω"]})
            if at == "block":
                raise StoreError("stopped")
            if at == "long":
                monkeypatch.setattr(writer, "MOST_OFFSET", 200)
                sink.append({"id": [2], "string": ["a" * 150]})

    if at == "rename":
        (tmp_path / "edg").mkdir()
    with pytest.raises((InputError, StoreError)) as error:
        write()
    if at == "long":
        assert "expected up to 200, what an index file can hold (V-141); use smaller tiles" in str(error.value)
    assert names_in(tmp_path) == (["edg"] if at == "rename" else [])


def test_a_refused_part_is_not_forgotten(tmp_path):
    sink = TableWriter(tmp_path / "edg", TEXTS)
    with pytest.raises(InputError, match="expected characters of Latin-1"):
        sink.append({"id": [1], "string": ["Ω"]})
    for step in (sink.close, lambda: sink.append({"id": [1], "string": ["a"]})):
        with pytest.raises(InputError, match="found a writer that is closed, or whose rows were refused"):
            step()
    assert names_in(tmp_path) == []


def test_folders_that_are_missing(tmp_path):
    with pytest.raises(StoreError, match="cannot be written: No such file"):
        write_table(tmp_path / "none" / "edg", TEXTS, {"id": [], "string": []})


def test_a_table_is_replaced_when_the_new_one_is_whole(tmp_path):
    write_table(tmp_path / "edg", TEXTS, {"id": [1], "string": ["old"]})
    with TableWriter(tmp_path / "edg", TEXTS) as sink:
        sink.append({"id": [1], "string": ["new"]})
        assert read_table(tmp_path / "edg")["string"].values.tobytes() == b"old"
    assert read_table(tmp_path / "edg")["string"].values.tobytes() == b"new"
