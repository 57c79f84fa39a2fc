"""`store.pages`: rows appended page by page read back through SQLite, and SQLite finds nothing wrong with the file."""

from __future__ import annotations

import ctypes.util
import random
import sqlite3
from collections.abc import Sequence
from contextlib import closing
from functools import cache
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from vpfx.errors import InputError, InvariantError, StoreError, UnknownNameError
from vpfx.store import page_file
from vpfx.store.pages import NULL_INT, PageWriter

PAGE_SIZES = (512, 4096, 65536)
DDL = {
    "rowid": "CREATE TABLE t (id INTEGER PRIMARY KEY, a INTEGER, r REAL, d, b BLOB)",
    "key": "CREATE TABLE t (k INTEGER, f, a INTEGER, r REAL, b BLOB, PRIMARY KEY (k, f)) WITHOUT ROWID",
    "index": "CREATE TABLE t (id INTEGER PRIMARY KEY, a INTEGER, r REAL, b BLOB); CREATE INDEX t_i ON t (a, r, b)",
}
QUERIES = {
    "rowid": "SELECT * FROM t ORDER BY id",
    "key": "SELECT * FROM t ORDER BY k, f",
    "index": "SELECT a, r, b, id FROM t INDEXED BY t_i ORDER BY a, r, b, id",
}

# every width of an integer, on both sides of the border (fileformat2 §2.1)
BORDERS = sorted(
    {sign * (1 << bit) + step for bit in (0, 7, 15, 23, 31, 47, 62) for sign in (-1, 1) for step in (-1, 0)}
)
INTS = [NULL_INT, NULL_INT + 1, 2**63 - 1, 0, *BORDERS]
FLOATS = [np.nan, 0.0, 1.0, -1.0, 0.5, 1e300, -np.inf, np.inf, 2.0**47 - 1, 2.0**47, -(2.0**60), 128.0, -129.0]


@cache
def empty_file(kind: str, page_size: int) -> bytes:
    with TemporaryDirectory() as folder, closing(sqlite3.connect(Path(folder) / "empty.db")) as connection:
        connection.executescript(f"PRAGMA page_size = {page_size}; {DDL[kind]}")
        return (Path(folder) / "empty.db").read_bytes()


def make_file(path: Path, kind: str, page_size: int = 4096) -> Path:
    path.write_bytes(empty_file(kind, page_size))
    return path


def make_columns(kind: str, n_row: int, seed: int, length: int = 3) -> list[np.ndarray]:
    """Return rows for the tree of a kind, in the order of its keys."""
    rng = np.random.default_rng(seed)
    ids = np.cumsum(rng.integers(1, 4, n_row))
    ints = rng.choice(np.array(INTS), n_row)
    reals, others = rng.choice(np.array(FLOATS), (2, n_row))
    blobs = rng.integers(0, 256, (n_row, length)).astype(np.uint8)
    if kind == "rowid":
        return [ids, ints, reals, others, blobs]
    if kind == "key":
        return [ids // 5, ids + 0.5, ints, reals, blobs]
    blob_keys = [blobs[:, i] for i in reversed(range(length))]
    order = np.lexsort([ids, *blob_keys, np.where(np.isnan(reals), -1e308, np.maximum(reals, -1e307)), ints])
    return [ints[order], reals[order], blobs[order], ids[order]]


def cut(columns: list[np.ndarray], cuts: list[int]) -> list[list[np.ndarray]]:
    """Return the rows as calls, cut before each of the rows given."""
    edges = sorted({0, len(columns[0]), *cuts})
    return [[column[low:high] for column in columns] for low, high in pairwise(edges)]


def write(path: Path, kind: str, calls: list[list[np.ndarray]]) -> None:
    """Write calls to the tree of a kind; for an index, the rows of its table too."""
    with PageWriter(path) as writer:
        for columns in calls:
            writer.append("t_i" if kind == "index" else "t", columns)
        if kind == "index" and calls:
            columns = [np.concatenate(parts) for parts in zip(*calls, strict=True)]
            order = np.argsort(columns[3])
            writer.append("t", [columns[i][order] for i in (3, 0, 1, 2)])


def to_rows(columns: list[np.ndarray]) -> list[tuple[Any, ...]]:
    """Return the rows as SQLite should return them."""
    values = []
    for column in columns:
        if column.ndim == 2:
            values.append([row.tobytes() for row in column])
        else:
            values.append([None if x == NULL_INT or x != x else x for x in column.tolist()])
    return list(zip(*values, strict=True))


def sql(path: Path, *statements: str, values: Sequence[object] = ()) -> list[tuple[Any, ...]]:
    """Run statements, each with an integrity check behind it, and return the rows of the last."""
    rows = []
    with closing(sqlite3.connect(path)) as connection:
        for statement in statements:
            rows = connection.execute(statement, values).fetchall()
            connection.commit()
            assert connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
    return rows


def read(path: Path, kind: str) -> list[tuple[Any, ...]]:
    return sql(path, QUERIES[kind])


def count(path: Path, what: str) -> int:
    with closing(sqlite3.connect(path)) as connection:
        return int(connection.execute(f"PRAGMA {what}").fetchone()[0])


@pytest.mark.parametrize("kind", list(DDL))
@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    page_size=st.sampled_from(PAGE_SIZES),
    n_row=st.integers(0, 200),
    length=st.integers(0, 30),
    cuts=st.lists(st.integers(0, 200), max_size=60),
    seed=st.integers(0, 2**32 - 1),
    is_shuffled=st.booleans(),
)
def test_rows_read_back(tmp_path, kind, page_size, n_row, length, cuts, seed, is_shuffled):
    columns = make_columns(kind, n_row, seed, length)
    calls = cut(columns, [at for at in cuts if at < n_row])
    if is_shuffled:
        random.Random(seed).shuffle(calls)
    path = make_file(tmp_path / "rows.db", kind, page_size)
    write(path, kind, calls)
    assert read(path, kind) == to_rows(columns)


@pytest.mark.parametrize("kind", list(DDL))
@pytest.mark.parametrize("page_size", PAGE_SIZES)
def test_newer_sqlite_agrees(tmp_path, kind, page_size):
    apsw = pytest.importorskip("apsw")
    columns = make_columns(kind, 500, 7)
    calls = cut(columns, list(range(0, 500, 17)))
    random.Random(7).shuffle(calls)
    path = make_file(tmp_path / "rows.db", kind, page_size)
    write(path, kind, calls)
    with closing(apsw.Connection(str(path))) as connection:
        assert list(connection.execute("PRAGMA integrity_check")) == [("ok",)]
        assert list(connection.execute(QUERIES[kind])) == to_rows(columns)


@pytest.mark.parametrize("kind", list(DDL))
@pytest.mark.parametrize("order", ["forward", "backward", "shuffled", "interleaved"])
def test_deep_trees(tmp_path, kind, order):
    columns = make_columns(kind, 20_000, 1)
    calls = cut(columns, list(range(0, 20_000, 250)))
    orders = {"backward": calls[::-1], "interleaved": calls[::2] + calls[1::2]}
    orders["shuffled"] = random.Random(1).sample(calls, len(calls))
    path = make_file(tmp_path / "deep.db", kind, 512)
    write(path, kind, orders.get(order, calls))
    assert read(path, kind) == to_rows(columns)
    assert count(path, "freelist_count") == 0


@pytest.mark.parametrize("kind", list(DDL))
def test_small_calls_fill_pages(tmp_path, kind):
    columns = make_columns(kind, 1000, 2)
    path, other = (make_file(tmp_path / name, kind, 1024) for name in ("one.db", "many.db"))
    write(path, kind, [columns])
    write(other, kind, cut(columns, list(range(1000))))
    assert path.read_bytes() == other.read_bytes()
    n_page = count(path, "page_count")
    sql(path, "VACUUM")
    assert n_page <= count(path, "page_count")


def test_calls_between_others_cost_little(tmp_path):
    columns = [column[::2] for column in make_columns("rowid", 40_000, 9)]
    calls = cut(columns, list(range(0, 20_000, 1000)))
    for i in range(1, len(calls) - 1, 3):
        calls[i], calls[i + 1] = calls[i + 1], calls[i]
    path = make_file(tmp_path / "t.db", "rowid")
    write(path, "rowid", calls)
    n_page = count(path, "page_count")
    assert sql(path, "VACUUM", QUERIES["rowid"]) == to_rows(columns)
    assert n_page <= count(path, "page_count") + 2 * len(calls)


def test_rowids_of_every_length(tmp_path):
    borders = {(1 << bit) + step for bit in (0, 7, 14, 21, 28, 35, 42, 49, 56) for step in (-1, 0, 1)}
    ids = np.array([-(2**63) + 1, -(2**40), -129, -1, *sorted(borders), 2**63 - 1])
    path = make_file(tmp_path / "t.db", "rowid", 512)
    columns = [ids, ids, ids.astype(float), ids.astype(float), np.zeros((len(ids), 2), np.uint8)]
    write(path, "rowid", cut(columns, list(range(0, len(ids), 3))))
    assert [row[:2] for row in read(path, "rowid")] == [(x, x) for x in ids.tolist()]
    for x in ids.tolist():
        assert sql(path, "SELECT a FROM t WHERE id = ?", values=(x,)) == [(x,)]


def test_numbers_take_the_room_that_sqlite_gives_them(tmp_path):
    columns = [np.arange(len(INTS)) + 1, np.array(INTS)]
    floats = np.resize(np.array(FLOATS), len(INTS))
    columns += [floats, floats, np.zeros((len(INTS), 60), np.uint8)]
    ours = make_file(tmp_path / "ours.db", "rowid")
    write(ours, "rowid", [columns])
    theirs = make_file(tmp_path / "theirs.db", "rowid")
    with closing(sqlite3.connect(theirs)) as connection, connection:
        connection.executemany("INSERT INTO t VALUES (?, ?, ?, ?, ?)", to_rows(columns))
    cells = []
    for path in (ours, theirs):
        page = path.read_bytes()[4096:8192]
        pointers = np.frombuffer(page, ">u2", int.from_bytes(page[3:5], "big"), 8).tolist()
        assert len(pointers) == len(INTS)
        ends = dict(pairwise([*sorted(pointers), 4096]))
        cells.append([page[low : ends[low]] for low in pointers])
    assert cells[0] == cells[1]
    assert read(ours, "rowid") == to_rows(columns)


def test_minus_zero_stays(tmp_path):
    path = make_file(tmp_path / "t.db", "rowid")
    zeros = np.array([-0.0, 0.0])
    write(path, "rowid", [[np.arange(2), np.arange(2), zeros, zeros, np.zeros((2, 0), np.uint8)]])
    assert [np.signbit(row[2:4]).tolist() for row in read(path, "rowid")] == [[True, True], [False, False]]


def test_all_types_of_integers_and_floats(tmp_path):
    path = make_file(tmp_path / "t.db", "rowid")
    for int_type, float_type in ("u1", "f4"), ("i2", "f8"), ("u4", ">f4"), ("u8", "f2"), (">i8", "f8"):
        ids, floats = np.array([3, 100], int_type), np.array([0.5, 2], float_type)
        write(make_file(path, "rowid"), "rowid", [[ids, ids[::-1], floats, floats[::-1], np.zeros((2, 1), np.uint8)]])
        assert read(path, "rowid") == [(3, 100, 0.5, 2.0, b"\0"), (100, 3, 2.0, 0.5, b"\0")]


@pytest.mark.parametrize("kind", list(DDL))
@pytest.mark.parametrize("page_size", [512, 4096])
def test_sqlite_goes_on_with_the_file(tmp_path, kind, page_size):
    path = make_file(tmp_path / "t.db", kind, page_size)
    write(path, kind, cut(make_columns(kind, 2000, 3), [500]))
    others, key = ("f, a", "k") if kind == "key" else ("a, b", "id")
    sql(
        path,
        f"INSERT INTO t ({key}, {others}) SELECT {key} + 100000, 1, 2 FROM t WHERE {key} % 3 = 0 GROUP BY {key}",
        f"DELETE FROM t WHERE {key} % 4 = 1",
        "UPDATE t SET a = a + 1, b = zeroblob(700), r = r * 1.5 WHERE a < 10000",
        f"INSERT INTO t ({key}, {others}) VALUES (-3, -1, zeroblob(99999))",
        "VACUUM",
    )


def test_spare_pages_go_to_the_freelist(tmp_path):
    path = make_file(tmp_path / "t.db", "rowid", 512)
    columns = make_columns("rowid", 300, 4)
    with PageWriter(path) as writer:
        writer.append("t", columns)
        number, pages = writer._file.take()
        pages[:9] = 0
        writer._file.keep(9)
        writer._file.spare += range(number, number + 9)
    assert read(path, "rowid") == to_rows(columns)
    assert 0 < count(path, "freelist_count") < 9
    sql(path, "INSERT INTO t (b) VALUES (zeroblob(9999))")
    assert count(path, "freelist_count") == 0


@pytest.mark.parametrize("page_size", PAGE_SIZES)
@pytest.mark.parametrize("distance", [0, 1, 2, 5])
def test_lock_page_is_left_out(tmp_path, monkeypatch, page_size, distance):
    monkeypatch.setattr(page_file, "BUFFER_BYTES", 3 * page_size)
    monkeypatch.setattr(page_file, "PENDING_BYTE", (distance + 2) * page_size + 7)
    path = tmp_path / "pages"
    path.write_bytes(bytes(2 * page_size))
    file = page_file.PageFile(path, page_size, 2)
    lock_page = distance + 3
    numbers: list[int] = []
    for n_page in (1, 2, 3, 1, 1, 2):
        number, pages = file.take()
        for i in range(min(n_page, len(pages))):
            pages[i] = number + i
            numbers.append(number + i)
        file.keep(min(n_page, len(pages)))
        assert file.n_page == numbers[-1]
    file.finish()
    file.close()
    assert numbers == [number for number in range(3, numbers[-1] + 1) if number != lock_page]
    pages = np.frombuffer(path.read_bytes(), np.uint8).reshape(-1, page_size)
    assert len(pages) == numbers[-1]
    assert all((pages[number - 1] == number).all() for number in numbers)


def test_sqlite_leaves_out_the_same_page(tmp_path, monkeypatch):
    library = ctypes.CDLL(ctypes.util.find_library("sqlite3"))
    if not hasattr(library, "sqlite3_test_control"):
        pytest.skip("no SQLite library that could be told to lock another page")
    columns = make_columns("rowid", 20_000, 5)
    path = tmp_path / "t.db"
    is_good = {}
    library.sqlite3_test_control(11, ctypes.c_uint(1 << 16))  # SQLITE_TESTCTRL_PENDING_BYTE
    try:
        for pending_byte in (1 << 16, 1 << 30):
            monkeypatch.setattr(page_file, "PENDING_BYTE", pending_byte)
            write(make_file(path, "rowid", 512), "rowid", [columns])
            try:
                is_good[pending_byte] = read(path, "rowid") == to_rows(columns)
            except (AssertionError, sqlite3.DatabaseError):
                is_good[pending_byte] = False
    finally:
        library.sqlite3_test_control(11, ctypes.c_uint(1 << 30))
    if is_good[1 << 30]:
        pytest.skip("Python has a SQLite of its own, whose lock page stays")
    assert is_good[1 << 16]


def test_after_an_error_the_tables_are_empty(tmp_path):
    path = make_file(tmp_path / "t.db", "rowid", 512)
    columns = make_columns("rowid", 5000, 6)
    with pytest.raises(InvariantError):
        write(path, "rowid", [columns, columns])
    assert read(path, "rowid") == []
    write(path, "rowid", [[column[:9] for column in columns]])
    assert read(path, "rowid") == to_rows([column[:9] for column in columns])
    assert path.stat().st_size == count(path, "page_count") * 512
    with pytest.raises(StoreError, match="found rows"):
        write(path, "rowid", [columns])


ONE = np.array([1])
BLOB = np.zeros((1, 2), np.uint8)


@pytest.mark.parametrize(
    ("name", "columns", "error", "words"),
    [
        ("s", [ONE], UnknownNameError, "known: n, sqlite_autoindex_n_1, t, t_i"),
        ("t", [ONE, ONE], InputError, "2 columns, expected 4"),
        ("t_i", [ONE, ONE * 1.0, BLOB], InputError, "3 columns, expected 4"),
        ("t", [ONE, ONE, np.zeros(2), BLOB], InputError, "column 2: found 2 rows"),
        ("t", [ONE, ONE, ONE, np.array(["x"])], InputError, "column 3: found <U1"),
        ("t", [ONE * 1.0, ONE, ONE, BLOB], InputError, "rowids"),
        ("t", [np.array([NULL_INT]), ONE, ONE, BLOB], InputError, "rowids"),
        ("t", [ONE, np.array([2**63], "u8"), ONE, BLOB], InputError, "at most 2"),
        ("t", [ONE, ONE, ONE, np.zeros((1, 473), np.uint8)], InputError, "at most 477"),
        ("t_i", [ONE, ONE, np.zeros((1, 97), np.uint8), ONE + 1], InputError, "at most 102"),
        ("n", [ONE, ONE], InputError, "not INTEGER PRIMARY KEY"),
        ("t", [np.array([1, 1]), *[np.ones(2)] * 3], InvariantError, "row 1 of a call"),
        ("t", [np.array([*range(9999), 5]), *[np.ones(10_000)] * 3], InvariantError, r"\(5,\) behind \(9998,\)"),
        ("t_i", [ONE.repeat(2), np.array([0, np.nan]), BLOB.repeat(2, 0), ONE.repeat(2)], InvariantError, "row 1"),
    ],
)
def test_bad_rows(tmp_path, name, columns, error, words):
    path = tmp_path / "t.db"
    with closing(sqlite3.connect(path)) as connection:
        connection.executescript(f"PRAGMA page_size = 512; {DDL['index']}; CREATE TABLE n (id INT PRIMARY KEY, a)")
    with pytest.raises(error, match=words), PageWriter(path) as writer:
        writer.append(name, columns)
    assert read(path, "index") == []


@pytest.mark.parametrize(
    "calls", ["1-5 5-9", "1-5 3-4", "5-9 1-5", "1-2 8-9 4-8", "1-2 8-9 2-3", "4-5 1-9", "1-2 8-9 1-2"]
)
def test_calls_that_overlap(tmp_path, calls):
    path = make_file(tmp_path / "t.db", "rowid")
    columns = make_columns("rowid", 20, 8)
    with PageWriter(path) as writer:
        *good, bad = ([column[int(call[0]) : int(call[2]) + 1] for column in columns] for call in calls.split())
        for part in good:
            writer.append("t", part)
        with pytest.raises(InvariantError, match=r"^t: found keys from .* overlapping"):
            writer.append("t", bad)
        with pytest.raises(InputError, match="closed writer"):
            writer.append("t", columns)


@pytest.mark.parametrize(
    ("statements", "error", "words"),
    [
        ("PRAGMA auto_vacuum = 1; CREATE TABLE t (a)", StoreError, "auto_vacuum: found 1"),
        ("PRAGMA encoding = 'UTF-16le'; CREATE TABLE t (a)", StoreError, "encoding: found UTF-16le"),
        ("PRAGMA journal_mode = WAL; CREATE TABLE t (a)", StoreError, "journal_mode: found wal"),
        ("CREATE TABLE t (a INTEGER PRIMARY KEY DESC, b)", InputError, "not INTEGER PRIMARY KEY"),
        ("CREATE TABLE t (a, b INTEGER PRIMARY KEY)", InputError, "not INTEGER PRIMARY KEY"),
        ("CREATE TABLE t (a, b, PRIMARY KEY (b)) WITHOUT ROWID", InputError, "not the first columns in order"),
        ("CREATE TABLE t (a, b, PRIMARY KEY (a DESC)) WITHOUT ROWID", InputError, "descending"),
        ("CREATE TABLE t (a INTEGER PRIMARY KEY, b AS (a + 1) STORED)", InputError, "generated"),
        ("CREATE TABLE t (a INTEGER PRIMARY KEY, b VARCHAR(9))", InputError, "affinity TEXT"),
        ("", StoreError, "cannot be opened"),
    ],
)
def test_files_and_tables_of_another_sort(tmp_path, statements, error, words):
    path = tmp_path / "t.db"
    if statements:
        with closing(sqlite3.connect(path)) as connection:
            connection.executescript(statements)
    with pytest.raises(error, match=words), PageWriter(path) as writer:
        writer.append("t", [ONE, ONE])
    assert path.exists() == bool(statements)
