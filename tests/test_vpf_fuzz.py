"""Hostile VPF tables: the corpus, cut at every byte, changed at every byte, changed at random; bounded memory."""

from __future__ import annotations

import hashlib
import itertools
import random
import tomllib
import tracemalloc

import numpy as np
import pytest
from fuzz_vpf import BYTES, CORPUS, cases, header_of, judge, seeds
from vpf_oracle import table_of

from vpfx.errors import VpfFormatError
from vpfx.vpf.table import decode, open_table

INDEX = tomllib.loads((CORPUS / "INDEX.toml").read_text(encoding="utf-8"))
SEEDS = seeds()
ID = b"id=I,1,P,Row id,-,-,-,:"


def test_index_lists_every_table_and_nothing_else():
    index = dict(INDEX)
    assert {"licence", "script"} <= set(index.pop("source"))
    assert set(index) == {path.name for path in CORPUS.iterdir()} - {"INDEX.toml"}
    for name, entry in index.items():
        assert hashlib.sha256((CORPUS / name).read_bytes()).hexdigest() == entry["sha256"], name
        assert entry["description"], name
    assert sum((CORPUS / name).stat().st_size for name in index) < 100_000


@pytest.mark.parametrize("name", SEEDS)
def test_corpus(name):
    judge(SEEDS[name])
    entry = INDEX[name]
    if "error" in entry:
        with pytest.raises(VpfFormatError) as error:
            decode(*SEEDS[name], name)
        assert error.value.requirement == entry["error"]
    elif "rows" in entry:
        with open_table(CORPUS / name) as file:
            assert file.read().n_row == entry["rows"]
            assert file.stray == entry.get("stray", 0)
            assert entry.get("index", "") in file.index_problem
            assert bool(file.index_problem) == ("index" in entry)


@pytest.mark.parametrize("name", SEEDS)
def test_cut_at_every_byte(name):
    data, index = SEEDS[name]
    full = decode(data, index) if judge((data, index)) is not None else None
    for n in range(len(data)):
        table = judge((data[:n], index))
        assert table is None or full is None or table.n_row <= full.n_row
    for n in range(len(index or b"")):
        judge((data, index[:n]))


@pytest.mark.parametrize("name", SEEDS)
def test_every_byte_of_the_header_changed(name):
    data, index = SEEDS[name]
    chance = random.Random(name)
    header = header_of(data)
    for at in range(header[1] if header else min(len(data), 120)):
        for value in {data[at] ^ 1, *chance.sample(BYTES, 2)}:
            judge((data[:at] + bytes([value]) + data[at + 1 :], index if at % 2 else None))


@pytest.mark.parametrize("name", [name for name, (_, index) in SEEDS.items() if index])
def test_every_byte_of_rows_and_index_changed(name):
    data, index = SEEDS[name]
    header = header_of(data)
    for at, value in itertools.product(range(header[1], len(data)), (0, 0x7F, 0xFF)):
        judge((data[:at] + bytes([value]) + data[at + 1 :], index if value else None))
    for at, value in itertools.product(range(len(index)), (0, 1, 0xFF)):
        judge((data, index[:at] + bytes([value]) + index[at + 1 :]))


def test_changes_at_random():
    n_table = sum(judge(case) is not None for case in itertools.islice(cases(2407), 1500))
    assert 200 < n_table < 1200


N_BYTE = 1_000_000
HOSTILE = {
    "rows of one byte": table_of(b"id=K,1,P,:", rows=bytes(N_BYTE)),
    "rows of one byte, fixed": table_of(b"id=T,1,P,:", rows=bytes(N_BYTE)),
    "rows of nothing but counts": table_of(b"id=T,*,P,:b=Y,*,N,:", rows=bytes(N_BYTE)),
    "as many columns as may be": table_of(b"".join(b"c%d=T,*,N,:" % i for i in range(1000)), rows=bytes(N_BYTE)),
    "empty columns": table_of(ID + b"".join(b"c%d=X,9,N,:" % i for i in range(999)), rows=bytes(N_BYTE)),
    "a row as long as can be": table_of(b"".join(b"c%d=T,2000000,N,:" % i for i in range(1000)), rows=bytes(N_BYTE)),
    "escapes": table_of(ID + b"a=T,1,N," + b"\\," * 120_000 + b":"),
    "semicolons": table_of(b";" * 250_000),
    "colons": table_of(ID + b":" * 250_000),
    "columns": table_of(b"".join(b"c%d=T,1,N,:" % i for i in range(15_000))),
    "commas": table_of(ID + b"a=T,1" + b"," * 250_000 + b":"),
    "counts": table_of(b"id=T,*,P,:", rows=b"\xff\xff\xff\x7f" * (N_BYTE // 4)),
    "ones": table_of(b"id=T,*,P,:", rows=(b"\1\0\0\0a" * (N_BYTE // 5))),
}
MOST_PER_BYTE = 64
"""Bytes of memory for a byte of the file (V-150)."""


@pytest.mark.parametrize("name", HOSTILE)
def test_memory_is_bounded_by_the_size_of_the_file(name):
    data = HOSTILE[name]
    read(table_of(b"id=K,1,P,:b=T,*,N,:", rows=bytes(50)))  # the kernels are compiled before
    tracemalloc.start()
    try:
        read(data)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < MOST_PER_BYTE * len(data) + (1 << 22)


def read(data):
    """Read a table or find it wrong."""
    try:
        return decode(data)
    except VpfFormatError:
        return None


def test_hostile_tables_are_what_they_are_called():
    n_row = {name: getattr(read(data), "n_row", None) for name, data in HOSTILE.items()}
    assert n_row == {
        "rows of one byte": N_BYTE, "rows of one byte, fixed": N_BYTE, "rows of nothing but counts": N_BYTE // 8,
        "as many columns as may be": N_BYTE // 4000, "empty columns": N_BYTE // 4, "a row as long as can be": 0,
        "escapes": 0, "semicolons": None, "colons": 0, "columns": None, "commas": 0, "counts": None, "ones": N_BYTE // 5,
    }  # fmt: skip


def test_an_index_longer_than_its_table_is_not_read(tmp_path):
    """The number of rows is held against the size of the index before anything is made for them."""
    (tmp_path / "edg").write_bytes(HOSTILE["rows of one byte"][:1000])
    with open(tmp_path / "edx", "wb") as file:
        file.write(np.array([2**28, 4], "<u4").tobytes())
        file.truncate(8 + 8 * 2**28)  # takes no room on the disk
    tracemalloc.start()
    try:
        with open_table(tmp_path / "edg") as table:
            assert table.index_problem.startswith("row 1: found offset 0")
            assert tracemalloc.get_traced_memory()[1] < 1 << 24
    finally:
        tracemalloc.stop()
