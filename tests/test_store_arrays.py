"""Rows as arrays from pages: the same as SQLite gives, whatever the range; nothing broken is followed."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from surfaces import SOLID, VOIDS, hills, write_dem

import vpfx
from vpfx.errors import StoreError, StoreFormatError
from vpfx.store.arrays import NONE_ID, TableReader
from vpfx.store.connection import open_reading

TABLES = ("node", "edge", "face", "tile", "tile_level")


@pytest.fixture(scope="module")
def stores(tmp_path_factory):
    """Stores of one tile and of many, with voids, T-junctions and links of many to many."""
    folder = tmp_path_factory.mktemp("stores")
    large = write_dem(folder / "large.tif", hills(60, 50))
    void = write_dem(folder / "void.tif", VOIDS["ring with island"].heights)
    spike = write_dem(folder / "spike.tif", SOLID["cliff"].heights)
    return [
        vpfx.build(large, folder / "one.gpkg", max_error=(20, 5, 1)).path,
        vpfx.build(large, folder / "tiles.gpkg", max_error=(20, 5), tile_size=16).path,
        vpfx.build(void, folder / "void.gpkg", passes=2).path,
        vpfx.build(spike, folder / "scarlatos.gpkg", method="scarlatos", passes=3).path,
        vpfx.build(large, folder / "pyramid.gpkg", method="delaunay_pyramid", max_error=(20, 5)).path,
    ]


def opened(path):
    return closing(sqlite3.connect(f"{path.as_uri()}?mode=ro", uri=True, isolation_level=None))


def by_sql(connection, table, low, high):
    """Columns of numbers as lists, None for NULL."""
    described = connection.execute(f"PRAGMA table_info({table})").fetchall()
    names = [row[1] for row in described if row[2] in ("INTEGER", "DOUBLE")]
    key = described[0][1]
    rows = connection.execute(
        f"SELECT {', '.join(names)} FROM {table} WHERE {key} BETWEEN ? AND ? ORDER BY {key}", (low, high)
    )
    return {name: list(column) for name, column in zip(names, zip(*rows, strict=True), strict=False)}


def check(found, expected):
    if not expected:
        assert all(len(values) == 0 for values in found.values())
        return
    assert list(found) == list(expected)
    for name, values in expected.items():
        if found[name].dtype == np.float64:
            np.testing.assert_array_equal(found[name], np.array([np.nan if v is None else v for v in values]))
        else:
            assert found[name].dtype == np.int64
            assert found[name].tolist() == [NONE_ID if v is None else v for v in values], name


@pytest.mark.parametrize("table", TABLES)
def test_rows_are_those_of_sql(table, stores):
    rng = np.random.default_rng(4)
    for path in stores:
        with opened(path) as connection:
            reader = TableReader(connection, path)
            ids = [row[0] for row in connection.execute(f"SELECT {table}_id FROM {table} ORDER BY 1")]
            ranges = [(1, 2**62), (ids[0], ids[0]), (ids[-1], ids[-1]), (ids[-1] + 1, 2**62), (5, 4)]
            ranges += [tuple(sorted(rng.choice(ids, 2).tolist())) for _ in range(20)]
            ranges += [(low - 1, high + 1) for low, high in ranges[-5:]]
            for low, high in ranges:
                check(reader.rows(table, [(low, high)]), by_sql(connection, table, low, high))


@pytest.mark.parametrize(("own", "other"), [("child_face", "parent_face"), ("parent_face", "child_face")])
def test_links_are_those_of_sql(own, other, stores):
    rng = np.random.default_rng(8)
    query = f"SELECT {own}, {other} FROM parent_child WHERE {own} BETWEEN ? AND ? ORDER BY 1, 2"
    for path in stores:
        with opened(path) as connection:
            reader = TableReader(connection, path)
            (last,) = connection.execute(f"SELECT max({own}) FROM parent_child").fetchone()
            runs = [(-5, 2**62), (1, 1), (last, last), (last + 1, 2**62), (5, 4)]
            runs += [tuple(np.sort(rng.integers(0, last + 2, 2)).tolist()) for _ in range(30)]
            for run in runs:
                assert reader.links(own, [run]).tolist() == [list(row) for row in connection.execute(query, run)]
            several = sorted(rng.choice(last, 8, replace=False).tolist())
            several = list(zip(several[::2], several[1::2], strict=True))
            expected = [list(row) for run in several for row in connection.execute(query, run)]
            assert reader.links(own, several).tolist() == expected
            assert reader.links(own, []).shape == (0, 2)


def test_levels_are_those_of_sql(stores):
    """Corners of the faces of a level, by joins."""
    query = (
        "SELECT f.face_id, a.x, a.y, a.z, b.x, b.y, b.z, c.x, c.y, c.z FROM face f JOIN node a ON a.node_id = f.node_1 "
        "JOIN node b ON b.node_id = f.node_2 JOIN node c ON c.node_id = f.node_3 WHERE f.level = ? ORDER BY f.face_id"
    )
    for path in stores:
        with vpfx.open_store(path) as store, opened(path) as connection:
            for level in range(len(store.levels)):
                tin = store.tin(level)
                expected = np.array(connection.execute(query, (level,)).fetchall())
                order = np.argsort(tin.face_attributes["face_id"])
                np.testing.assert_array_equal(tin.face_attributes["face_id"][order], expected[:, 0])
                np.testing.assert_array_equal(tin.nodes[tin.face_nodes[order]].reshape(-1, 9), expected[:, 1:])


def test_parts_of_levels_are_those_of_the_whole(stores):
    """The faces whose bounding boxes touch a rectangle, with all their attributes."""
    rng = np.random.default_rng(5)
    for path in stores:
        with vpfx.open_store(path) as store:
            x0, y0, x1, y1 = store.extent
            for level in range(len(store.levels)):
                whole = store.tin(level)
                corner = whole.nodes[whole.face_nodes, :2]
                for _ in range(4):
                    box = np.sort(rng.uniform((x0, y0), (x1, y1), (2, 2)), axis=0)
                    touches = (corner.min(axis=1) <= box[1]).all(axis=1) & (corner.max(axis=1) >= box[0]).all(axis=1)
                    part = store.tin(level, box.ravel())
                    np.testing.assert_array_equal(
                        part.face_attributes["face_id"], whole.face_attributes["face_id"][touches]
                    )
                    np.testing.assert_array_equal(part.nodes[part.face_nodes], whole.nodes[whole.face_nodes[touches]])
                    for name in ("node_id", "level", "z_parent"):
                        one, other = part.node_attributes[name], whole.node_attributes[name]
                        np.testing.assert_array_equal(one[part.face_nodes], other[whole.face_nodes[touches]])


def test_values_of_every_kind_are_read(tmp_path, stores):
    """Whole numbers of every width, reals that are whole, NULL."""
    path = tmp_path / "a.gpkg"
    shutil.copy(stores[0], path)
    values = [
        0,
        1,
        -1,
        127,
        -128,
        2**15,
        -(2**15),
        2**23 - 1,
        -(2**23),
        2**31,
        -(2**31),
        2**47,
        2**48,
        -(2**63),
        2**63 - 1,
    ]
    with closing(sqlite3.connect(path)) as connection, connection:
        for i, value in enumerate(values):
            connection.execute("UPDATE edge SET right_face = ? WHERE edge_id = ?", (value, i + 1))
        connection.execute("UPDATE edge SET right_face = NULL WHERE edge_id = 16")
        for i, value in enumerate([0.0, 1.0, -3.0, 1e300, -5e-324, 0.1, 2.0**40]):
            connection.execute("UPDATE node SET z = ? WHERE node_id = ?", (value, i + 1))
    with opened(path) as connection:
        reader = TableReader(connection, path)
        assert reader.rows("edge", [(1, 16)])["right_face"].tolist() == [*values, NONE_ID]
        assert reader.rows("node", [(1, 7)])["z"].tolist() == [0.0, 1.0, -3.0, 1e300, -5e-324, 0.1, 2.0**40]


def test_changes_by_others_are_seen(tmp_path, stores):
    path = tmp_path / "a.gpkg"
    shutil.copy(stores[0], path)
    with opened(path) as connection, closing(sqlite3.connect(path)) as other:
        reader = TableReader(connection, path)
        count = len(reader.rows("face", [(1, 2**62)])["face_id"])
        with other:
            other.execute("UPDATE face SET slope_centidegrees = 7 WHERE face_id = 1")
        assert reader.rows("face", [(1, 1)])["slope_centidegrees"].tolist() == [7]
        with other:  # the file grows
            other.execute("CREATE TABLE more AS SELECT * FROM face")
            other.execute("UPDATE face SET slope_centidegrees = 8 WHERE face_id = 1")
        assert reader.rows("face", [(1, 1)])["slope_centidegrees"].tolist() == [8]
        assert len(reader.rows("face", [(1, 2**62)])["face_id"]) == count
        with other:
            other.execute("DROP TABLE more")
        nodes = by_sql(other, "node", 1, 2**62)
        other.execute("VACUUM")  # tables begin elsewhere
        check(reader.rows("node", [(1, 2**62)]), nodes)


def test_a_write_ahead_log_is_read_through_sql(tmp_path, stores):
    path = tmp_path / "a.gpkg"
    shutil.copy(stores[0], path)
    with closing(sqlite3.connect(path)) as other:
        other.execute("PRAGMA journal_mode = WAL")
        with other:
            other.execute("UPDATE face SET slope_centidegrees = 9 WHERE face_id = 1")
        with opened(path) as connection:
            reader = TableReader(connection, path)
            assert reader.rows("face", [(1, 1)])["slope_centidegrees"].tolist() == [9]
            check(reader.rows("node", [(1, 2**62)]), by_sql(connection, "node", 1, 2**62))
            links = [
                list(row)
                for row in connection.execute("SELECT child_face, parent_face FROM parent_child ORDER BY 1, 2")
            ]
            assert reader.links("child_face", [(1, 2**62)]).tolist() == links
            with other:
                other.execute("INSERT INTO parent_child VALUES (99999999, 'x')")
            with pytest.raises(StoreFormatError, match="parent_child: found a value that is no whole number"):
                reader.links("child_face", [(1, 2**62)])


def test_a_log_that_has_grown_is_read(tmp_path, stores):
    """As QGIS leaves it: pages that are not in the file yet; opened before, and after."""
    path = tmp_path / "a.gpkg"
    shutil.copy(stores[0], path)
    with vpfx.open_store(path) as before, closing(sqlite3.connect(path)) as other:
        faces = before.tin(0).n_face
        other.execute("PRAGMA journal_mode = WAL")
        other.execute("PRAGMA wal_autocheckpoint = 0")
        with other:
            other.execute("CREATE TABLE more AS SELECT * FROM face")
            other.execute("UPDATE face SET slope_centidegrees = 9 WHERE face_id = 1")
        with vpfx.open_store(path) as after:
            for store in (before, after):
                assert store.fetch("face", [1])["slope_centidegrees"].tolist() == [9]
                assert store.tin(0).n_face == faces


@pytest.mark.parametrize("size", [1024, 8192])
def test_other_page_sizes_are_read(size, tmp_path, stores):
    path = tmp_path / "a.gpkg"
    shutil.copy(stores[1], path)
    with closing(sqlite3.connect(path)) as other:
        other.execute(f"PRAGMA page_size = {size}")
        other.execute("VACUUM")
    with vpfx.open_store(path) as store, vpfx.open_store(stores[1]) as expected:
        np.testing.assert_array_equal(store.tin(1).nodes, expected.tin(1).nodes)


@pytest.mark.parametrize("way", ["same size", "grown", "gone"])
def test_a_file_that_is_replaced_stays_the_one_that_was_opened(way, tmp_path, stores):
    path, new = tmp_path / "a.gpkg", tmp_path / "b.gpkg"
    shutil.copy(stores[0], path), shutil.copy(stores[0], new)
    with closing(sqlite3.connect(new)) as other, other:
        other.execute("UPDATE face SET slope_centidegrees = 9")
        if way == "grown":
            other.execute("CREATE TABLE more AS SELECT * FROM face")
    with vpfx.open_store(path) as store:
        new.replace(path) if way != "gone" else path.unlink()
        assert store.fetch("face", [1])["slope_centidegrees"][0] != 9
        assert store.tin(0).face_attributes["slope"][0] != 0.09


def test_ranges_of_strangers_are_checked(tmp_path, stores):
    for change in ("DELETE FROM tile_level", "UPDATE tile_level SET first_face = 'x'", "UPDATE tile_level SET last_face = NULL",
                   "UPDATE tile_level SET first_face = 1, last_face = 1000000"):  # fmt: skip
        path = tmp_path / "a.gpkg"
        shutil.copy(stores[0], path)
        with closing(sqlite3.connect(path)) as other, other:
            other.execute(change)
        with vpfx.open_store(path) as store, pytest.raises(StoreFormatError, match="tile_level: tile 1, level 1"):
            store.tin(1)


def test_a_locked_store_is_told(tmp_path, stores):
    path = tmp_path / "a.gpkg"
    shutil.copy(stores[0], path)
    with closing(open_reading(path)) as connection, closing(sqlite3.connect(path, isolation_level=None)) as other:
        connection.execute("PRAGMA busy_timeout = 10")
        reader = TableReader(connection, path)
        other.execute("BEGIN EXCLUSIVE")
        with pytest.raises(StoreError, match="locked"):
            reader.rows("face", [(1, 10)])
        other.execute("COMMIT")
        assert len(reader.rows("face", [(1, 10)])["face_id"]) == 10


@pytest.mark.slow
def test_broken_pages_are_not_followed(tmp_path, stores):
    """Single bytes changed, and whole pages; each table is read whole."""
    whole, rng = bytearray(Path(stores[1]).read_bytes()), np.random.default_rng(6)
    path, outcomes = tmp_path / "a.gpkg", set()
    with opened(stores[1]) as connection:
        sound = TableReader(connection, stores[1])
        sound.rows("face", [])
        roots = dict(sound._roots)
    for trial in range(300):
        changed = bytearray(whole)
        page = rng.choice(list(roots.values())) if trial % 3 == 0 else rng.integers(1, len(whole) // 4096)
        start = (int(page) - 1) * 4096 + (100 if page == 1 else 0)
        for _ in range(1 + trial % 4):
            changed[start + int(rng.integers(0, 200 if trial % 2 else 3900))] = int(rng.integers(0, 256))
        path.write_bytes(changed)
        with opened(path) as connection:
            try:
                reader = TableReader(connection, path)
                reader._roots, reader._cookie = roots, bytes(changed[40:44])
                for table in TABLES:
                    reader.rows(table, [(1, 2**62)])
                for own in ("child_face", "parent_face"):
                    reader.links(own, [(1, 2**62)])
            except (StoreFormatError, StoreError, sqlite3.DatabaseError):
                outcomes.add("refused")
            else:
                outcomes.add("read")
    assert outcomes == {"read", "refused"}
