"""Editing attributes: all or nothing, savepoints, what is refused and why; and many readers beside one writer."""

from __future__ import annotations

import multiprocessing
import shutil
import sqlite3
import subprocess
import sys
import threading
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from surfaces import hills, query, write_dem

import vpfx
from vpfx.attach import attach_sql
from vpfx.errors import InputError, NotFoundError, StoreError, StoreFormatError
from vpfx.query.attributes import attributes
from vpfx.query.sql import answer_sql
from vpfx.store import edit
from vpfx.store.classes import Column
from vpfx.store.edit import edit_store

DEPTHS = "SELECT depth FROM soil ORDER BY feature_id"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("edit")
    path = vpfx.build(
        write_dem(folder / "a.tif", hills(40, 40)), folder / "a.gpkg", max_error=(30, 10), tile_size=20
    ).path
    with edit_store(path) as editor:
        editor.create_class("soil", {"kind": "text", "depth": Column("real", "m", "to the rock")}, "soils")
        ids = editor.add_features("soil", {"kind": ["clay", "sand"], "depth": [1.0, 2.0]})
        editor.set_faces("soil", [1, 2, 3], ids[[0, 1, 0]])
    return path


@pytest.fixture
def path(made, tmp_path):
    return shutil.copy(made, tmp_path / "a.gpkg")


def on_faces(path):
    return query(path, "SELECT face_id, feature_id, share FROM face_feature ORDER BY 1, 2")


def test_ids_can_be_given(path):
    """The importer gives features and classes the ids they had."""
    with edit_store(path) as editor:
        assert editor.create_class("rock", {"age": "integer"}, class_id=9).class_id == 9
        assert editor.add_features("rock", {"age": [3, 4]}, [12, 7]).tolist() == [12, 7]
        assert editor.add_features("rock", {"age": [5]}).tolist() == [13]
        with pytest.raises(InputError, match="found 1 ids and columns of 2 values, expected as many"):
            editor.add_features("rock", {"age": [3, 4]}, [20])
    assert query(path, "SELECT * FROM rock") == [(7, 4), (12, 3), (13, 5)]
    with pytest.raises(InputError, match="UNIQUE constraint failed"), edit_store(path) as editor:
        editor.add_features("rock", {"age": [6]}, [1])


def test_what_was_made(path):
    assert query(path, "SELECT * FROM soil") == [(1, "clay", 1.0), (2, "sand", 2.0)]
    assert on_faces(path) == [(1, 1, 1.0), (2, 2, 1.0), (3, 1, 1.0)]
    with vpfx.open_store(path) as store:
        soil = store.classes["soil"]
    assert soil.columns == {"kind": Column("text"), "depth": Column("real", "m", "to the rock")}
    assert query(path, "SELECT data_type, description FROM gpkg_contents WHERE table_name = 'soil'") == [
        ("attributes", "soils")
    ]
    assert query(path, "SELECT scope FROM gpkg_extensions WHERE table_name = 'soil'") == [("write-only",)]
    assert query(path, "PRAGMA foreign_key_check") == []
    assert query(path, "PRAGMA journal_mode") == [("delete",)]


def test_dropping_leaves_nothing(path):
    with edit_store(path) as editor:
        editor.describe_values("soil", "kind", {"clay": "holds water"})
    assert query(path, "SELECT value, description FROM value_description") == [("clay", "holds water")]
    with edit_store(path) as editor:
        editor.drop_class("soil")
    for table in ("feature_class", "feature_column", "value_description", "feature", "face_feature"):
        assert query(path, f"SELECT * FROM {table}") == []
    for table, column in (
        ("gpkg_contents", "table_name"),
        ("gpkg_extensions", "table_name"),
        ("sqlite_schema", "name"),
    ):
        assert query(path, f"SELECT * FROM {table} WHERE {column} = 'soil'") == []


def test_an_exception_undoes_all(path):
    before = path.read_bytes()

    def step():
        with edit_store(path) as editor:
            editor.drop_class("soil")
            editor.create_class("forest", {"kind": "text"})
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        step()
    assert path.read_bytes() == before


def test_savepoints(path):
    def failing(editor):
        with editor.savepoint():
            editor.drop_class("soil")
            raise ZeroDivisionError

    def rows(editor):
        return editor.connection.execute("SELECT face_id, feature_id FROM face_feature").fetchall()

    with edit_store(path) as editor, editor.savepoint() as outer:
        editor.set_faces("soil", [1], 2)
        with editor.savepoint() as inner:
            editor.clear_faces("soil", [1, 2, 3])
            inner.undo()
            editor.clear_faces("soil", [3])
        assert rows(editor) == [(1, 2), (2, 2)]
        with pytest.raises(ZeroDivisionError):
            failing(editor)
        assert rows(editor) == [(1, 2), (2, 2)]
        outer.undo()
        editor.set_faces("soil", [7], 1)
    assert on_faces(path) == [(1, 1, 1.0), (2, 2, 1.0), (3, 1, 1.0), (7, 1, 1.0)]


def test_undoing_an_outer_savepoint_inside_an_inner_one(path):
    before = query(path, DEPTHS)
    with edit_store(path) as editor:
        with editor.savepoint() as outer:
            editor.add_features("soil", {"depth": [3.0]})
            with editor.savepoint():
                editor.add_features("soil", {"depth": [4.0]})
                outer.undo()
                editor.add_features("soil", {"depth": [5.0]})
        with editor.savepoint(), pytest.raises(InputError, match="block is over"):
            outer.undo()
    assert query(path, DEPTHS) == [*before, (5.0,)]


def test_a_killed_writer_is_told_and_undone(path, tmp_path):
    """The files of a writer that has written some pages: who reads says what to do, who writes undoes it."""
    before, faces = query(path, DEPTHS), query(path, "SELECT * FROM face")
    killed = tmp_path / "killed.gpkg"
    with closing(sqlite3.connect(path, isolation_level=None)) as writer:
        writer.execute("PRAGMA cache_size = 5")
        writer.execute("BEGIN")
        writer.execute("UPDATE face SET slope_centidegrees = 1")
        for suffix in ("", "-journal"):
            shutil.copy(f"{path}{suffix}", f"{killed}{suffix}")
            shutil.copy(f"{path}{suffix}", tmp_path / f"kept{suffix}")
    for ask in (lambda: vpfx.open_store(killed), lambda: answer_sql(killed, DEPTHS)):
        with pytest.raises(StoreError, match="a change that was interrupted, which waits to be undone"):
            ask()
    shutil.copy(path, killed)
    Path(f"{killed}-journal").unlink()
    with vpfx.open_store(killed) as store:  # and the writer is killed behind its back
        for suffix in ("", "-journal"):
            shutil.copy(tmp_path / f"kept{suffix}", f"{killed}{suffix}")
        with pytest.raises(StoreError, match="a change that was interrupted, which waits"), store.snapshot():
            pass
    attach_sql(killed, "steep", "SELECT face_id, 1 AS yes FROM face WHERE face_id < 5")
    assert query(killed, DEPTHS) == before
    assert query(killed, "SELECT * FROM face") == faces
    assert not (tmp_path / "killed.gpkg-journal").exists()


def test_a_failed_step_leaves_the_rest(path):
    with edit_store(path) as editor:
        with pytest.raises(InputError, match="column depth: found 'deep', expected a real"):
            editor.add_features("soil", {"kind": ["loam", "till"], "depth": [3.0, "deep"]})
        editor.add_features("soil", {"kind": ["loam"]})
    assert query(path, "SELECT * FROM soil")[2:] == [(3, "loam", None)]


def test_setting_replaces_and_shares(path):
    with edit_store(path) as editor:
        editor.set_faces("soil", [1, 1, 2], [1, 2, 1], [0.25, 0.5, 1 + 1e-12])
    assert on_faces(path) == [(1, 1, 0.25), (1, 2, 0.5), (2, 1, 1.0), (3, 1, 1.0)]


REFUSED = {
    "class is there": (InputError, "'soil', a table or view", lambda e: e.create_class("soil", {"a": "text"})),
    "table is there": (InputError, "'node', a table or view", lambda e: e.create_class("node", {"a": "text"})),
    "layer is there": (InputError, "'face_1', a table or view", lambda e: e.create_class("face_1", {"a": "text"})),
    "view is there": (InputError, "'region', a table or view", lambda e: e.create_class("region", {"a": "text"})),
    "capitals": (InputError, "small letter", lambda e: e.create_class("Soil", {"a": "text"})),
    "quote": (InputError, "small letter", lambda e: e.create_class('a"b', {"a": "text"})),
    "too long": (InputError, "small letter", lambda e: e.create_class("a" * 32, {"a": "text"})),
    "reserved": (InputError, "begins as tables", lambda e: e.create_class("gpkg_a", {"a": "text"})),
    "keyword": (InputError, "a word of SQL", lambda e: e.create_class("order", {"a": "text"})),
    "the clock as column": (InputError, "a word of SQL", lambda e: e.create_class("a", {"current_date": "date"})),
    "keyword as column": (InputError, "a word of SQL", lambda e: e.create_class("a", {"select": "text"})),
    "no column": (InputError, "expected 1 …", lambda e: e.create_class("a", {})),
    "key as column": (InputError, "none of them feature_id", lambda e: e.create_class("a", {"feature_id": "text"})),
    "unknown kind": (InputError, "found kind 'blob'", lambda e: e.create_class("a", {"b": "blob"})),
    "no class": (NotFoundError, "no feature class 'a'; there are: soil", lambda e: e.add_features("a", {"b": [1]})),
    "no such column": (InputError, "no column 'b'", lambda e: e.add_features("soil", {"b": [1]})),
    "other lengths": (InputError, r"columns of \[1, 2\] values", lambda e: e.add_features(
        "soil", {"kind": ["a"], "depth": [1, 2]})),
    "text as real": (InputError, "column depth: found 'x'", lambda e: e.add_features("soil", {"depth": ["x"]})),
    "infinite": (InputError, "column depth: found 'inf'", lambda e: e.add_features("soil", {"depth": [np.inf]})),
    "number as text": (InputError, "column kind: found '1'", lambda e: e.add_features("soil", {"kind": [1]})),
    "no face": (NotFoundError, "no face 99999", lambda e: e.set_faces("soil", [1, 99999], 1)),
    "no feature": (NotFoundError, "no feature 9 of the class", lambda e: e.set_faces("soil", [1], 9)),
    "text as face": (InputError, "faces: found", lambda e: e.set_faces("soil", ["one"], 1)),
    "no share": (InputError, "face 1: found share 0", lambda e: e.set_faces("soil", [1], 1, 0.0)),
    "share NaN": (InputError, "face 1: found share nan", lambda e: e.set_faces("soil", [1], 1, np.nan)),
    "too much": (InputError, "face 1: found shares that add up to 1.5", lambda e: e.set_faces(
        "soil", [1, 1], [1, 2], [0.75, 0.75])),
    "twice": (InputError, "face 1: found feature 1 twice", lambda e: e.set_faces("soil", [1, 1], 1, 0.1)),
    "no described column": (InputError, "no column 'a'", lambda e: e.describe_values("soil", "a", {1: "b"})),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_refused(case, path):
    kind, message, step = REFUSED[case]
    before = path.read_bytes()
    with pytest.raises(kind, match=message), edit_store(path) as editor:
        step(editor)
    assert path.read_bytes() == before


@pytest.mark.parametrize("value", ["1998-02-30", "1998-1-1", "98-01-01", "now", "1998-01-01T00:00", 19980101])
def test_days_that_are_none(value, path):
    with edit_store(path) as editor:
        editor.create_class("survey", {"day": "date"})
    with pytest.raises(InputError, match="expected a date"), edit_store(path) as editor:
        editor.add_features("survey", {"day": [value]})
    with pytest.raises(InputError, match="constraint"):
        answer_sql(path, f"INSERT INTO survey SELECT 1, {value!r}", write=True)


def test_what_is_no_store(path, tmp_path):
    text, foreign = tmp_path / "text.gpkg", tmp_path / "foreign.gpkg"
    text.write_text("none " * 999)
    with closing(sqlite3.connect(foreign)) as connection:
        connection.execute("CREATE TABLE node (a)")
    for wrong, kind in ((text, StoreFormatError), (foreign, StoreFormatError), (tmp_path / "no.gpkg", NotFoundError)):
        with pytest.raises(kind), edit_store(wrong):
            pass
    assert not (tmp_path / "no.gpkg").exists()


# --- readers and writers ----------------------------------------------------------------------------------------------------


def test_readers_see_the_state_before(path):
    """While somebody edits, readers read; they see nothing of it until the end."""
    with edit_store(path) as editor:
        editor.connection.execute("UPDATE soil SET depth = 9")
        editor.add_features("soil", {"kind": ["x" * 1000] * 5000})  # more than SQLite's cache holds
        assert answer_sql(path, DEPTHS).rows == [(1.0,), (2.0,)]
    assert answer_sql(path, f"{DEPTHS} LIMIT 3").rows == [(9.0,), (9.0,), (None,)]


def test_two_writers(path, monkeypatch):
    monkeypatch.setattr(edit, "BUSY_SECONDS", 0.1)
    with edit_store(path) as editor:
        editor.clear_faces("soil", [1])
        with pytest.raises(StoreError, match=r"is locked: .*nothing was changed, try again later"), edit_store(path):
            pass
    assert [row[0] for row in on_faces(path)] == [2, 3]


def test_a_reader_that_stays_keeps_the_writer_out(path, monkeypatch):
    monkeypatch.setattr(edit, "BUSY_SECONDS", 0.1)
    with closing(sqlite3.connect(path, isolation_level=None)) as reader:
        reader.execute("BEGIN")
        before = reader.execute(DEPTHS).fetchall()
        with pytest.raises(StoreError, match="is locked"), edit_store(path) as editor:
            editor.connection.execute("UPDATE soil SET depth = 9")
        assert reader.execute(DEPTHS).fetchall() == before
    assert answer_sql(path, DEPTHS).rows == before


def test_the_second_writer_waits(path):
    begun, order = threading.Event(), []

    def second():
        begun.wait()
        with edit_store(path) as editor:
            order.append("second")
            editor.connection.execute("UPDATE soil SET depth = depth + 1")

    thread = threading.Thread(target=second)
    thread.start()
    with edit_store(path) as editor:
        begun.set()
        thread.join(0.5)
        order.append("first")
        editor.connection.execute("UPDATE soil SET depth = depth * 10")
    thread.join()
    assert order == ["first", "second"]
    assert answer_sql(path, DEPTHS).rows == [(11.0,), (21.0,)]


def read_on(path, stop, found):
    """Read until told to stop; both values of a state have to be those of one transaction."""
    count = 0
    while not stop.is_set():
        try:
            rows = answer_sql(path, DEPTHS).rows
            with vpfx.open_store(path) as store:
                columns = attributes(store, [1, 2], "soil").columns
        except StoreError as error:
            if "try again" not in str(error):
                found.put(repr(error))
            continue
        if rows[1][0] != rows[0][0] + 1 or columns["depth"][1] != columns["depth"][0] + 1:
            found.put((rows, columns["depth"].tolist()))
        count += 1
    found.put(count)


@pytest.mark.slow
def test_many_readers_beside_one_writer(path):
    """Processes that read while another one edits see whole transactions, or are told to try again."""
    with vpfx.open_store(path) as store:
        attributes(store, [1], "soil")  # kernels are compiled here, not by a reader that holds a lock
    context = multiprocessing.get_context("spawn")
    stop, found = context.Event(), context.Queue()
    readers = [context.Process(target=read_on, args=(path, stop, found)) for _ in range(2)]
    for reader in readers:
        reader.start()
    for step in range(150):
        with edit_store(path) as editor:
            editor.connection.execute("UPDATE soil SET depth = ? WHERE feature_id = 1", (step,))
            editor.connection.execute("UPDATE soil SET depth = ? WHERE feature_id = 2", (step + 1,))
    stop.wait(4)
    stop.set()
    counts = [found.get(timeout=60) for _ in readers]
    for reader in readers:
        reader.join(60)
    assert all(isinstance(count, int) and count > 0 for count in counts), counts
    assert query(path, "PRAGMA integrity_check") == [("ok",)]


def test_reading_through_pages_keeps_the_lock(path, monkeypatch):
    """In one process: stores opened, read and let go while somebody edits do not take the editor's lock away."""
    monkeypatch.setattr(edit, "BUSY_SECONDS", 0.1)
    before = vpfx.open_store(path)
    faces = before.rows("face", 0)["face_id"]
    with edit_store(path) as editor:
        editor.connection.execute("UPDATE soil SET depth = 9")
        before.close()
        del before
        with vpfx.open_store(path) as store:
            assert store.rows("face", 0)["face_id"].tolist() == store.fetch("face", faces)["face_id"].tolist()
            assert store.tin(0).n_face == len(faces)
            assert attributes(store, [1], "soil").columns["depth"].tolist() == [1.0]
        code = f"import sqlite3; sqlite3.connect({str(path)!r}, timeout=0.1).execute('BEGIN IMMEDIATE')"
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
        assert "database is locked" in done.stderr
    with vpfx.open_store(path) as store:
        assert attributes(store, [1], "soil").columns["depth"].tolist() == [9.0]
        assert store.fetch("face", faces)["face_id"].tolist() == faces.tolist()
