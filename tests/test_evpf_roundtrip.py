"""Stores as VPF and back: the same bytes with double precision, the same rows but for rounded places with single."""

from __future__ import annotations

import hashlib
import json
import sqlite3
import string
import struct
from contextlib import closing, suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from conftest import slow_apart
from hypothesis import example, given, settings
from hypothesis import strategies as st
from rasters import CELL, FIXTURES, UTM
from rasters import VOIDS as VOIDS_FILE
from small_stores import MOST, build_kind
from surfaces import VOIDS, hills, noise, query, write_dem

import vpfx
from vpfx.errors import InputError
from vpfx.evpf.reading import import_vpf
from vpfx.evpf.writing import export_vpf
from vpfx.store.edit import edit_store

STREAMS = FIXTURES.parent / "features" / "new_mexico_streams.geojson"

CHANGED = {"node": ["x", "y", "z", "z_parent", "xyz"], "level": ["border_digest"], "tile_level": ["digest"]}
"""Columns that single precision changes, by table."""


def there(store, folder, **options):
    """Write a store as VPF."""
    folder.parent.mkdir(exist_ok=True)
    return export_vpf(store, folder, **options).path


def back(folder, store):
    """Make a store from VPF, and nothing else."""
    before = set(store.parent.iterdir())
    path = import_vpf(folder, store).path
    assert set(store.parent.iterdir()) == before | {store}
    return path


def files(folder):
    """Bytes of all files below a folder, but for the features of faces: what they inherit hangs on areas that are rounded."""
    found = {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    return {name: data for name, data in found.items() if not name.endswith(".ajt")}


def tables(path):
    """Values of all tables of a store, by table and column, and the definitions."""
    with closing(sqlite3.connect(path)) as store:
        names = [name for (name,) in store.execute("SELECT name FROM sqlite_schema WHERE type = 'table' ORDER BY 1")]
        found = {"definitions": {"sql": sorted(store.execute("SELECT type, name, sql FROM sqlite_schema"), key=repr)}}
        for name in names:
            cursor = store.execute(f"SELECT * FROM {name}")
            columns = [column[0] for column in cursor.description]
            rows = sorted(cursor.fetchall(), key=repr)
            found[name] = {column: [row[i] for row in rows] for i, column in enumerate(columns)}
        return found


def assert_double(store, folder):
    """Compare a store that nobody edited with itself after the way there and back: every byte is the same."""
    again = back(there(store, folder / "double", is_double=True), folder / "double.gpkg")
    assert hashlib.sha256(again.read_bytes()).digest() == hashlib.sha256(store.read_bytes()).digest()


def assert_single(store, folder):
    """Compare what comes back from single precision, and what is exported again."""
    vpf = there(store, folder / "single")
    again = back(vpf, folder / "single.gpkg")
    assert files(there(again, folder / "again" / "single")) == files(vpf)
    was, found = tables(store), tables(again)
    assert ("coordinate_precision", "single") in zip(*found["metadata"].values(), strict=True)
    for column, value in zip(("name", "value"), ("coordinate_precision", "single"), strict=True):
        found["metadata"][column].remove(value)
    for table, columns in was.items():
        kept = [name for name in columns if name not in CHANGED.get(table, ())]
        if table != "node":  # their rows may be sorted otherwise
            assert {name: found[table][name] for name in kept} == {name: columns[name] for name in kept}, table
    assert_nodes(store, again)


def float32(value):
    return None if value is None else struct.unpack("<f", struct.pack("<f", value))[0]


def assert_nodes(store, again):
    """Nodes have their ids; those at posts come back to the bit, other places and heights as near as floats are."""
    (lattice,) = query(store, "SELECT value FROM metadata WHERE name = 'lattice'")[0]
    x0, y0, dx, dy = (json.loads(lattice)[name] for name in ("x0", "y0", "dx", "dy"))
    columns = "SELECT node_id, tile_id, level, x, y, z, z_parent FROM node ORDER BY 1"
    for old, new in zip(query(store, columns), query(again, columns), strict=True):
        (*ids, x, y, z, z_parent), (*new_ids, new_x, new_y, new_z, new_parent) = old, new
        assert new_ids == ids
        assert (new_z, new_parent) == (float32(z), float32(z_parent))
        post = x0 + dx * round((x - x0) / dx), y0 + dy * round((y - y0) / dy)
        if (new_x, new_y) != (x, y):
            assert post != (x, y)
            # one that floats do not tell from a post has come to the post
            reach = 1.0 if (new_x, new_y) == post else 0.5
            for a, b in ((x, new_x), (y, new_y)):
                assert abs(a - b) <= reach * float(np.spacing(np.float32(abs(a))))


# --- stores as they are built -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", MOST)
def test_kinds(kind, tmp_path):
    store = build_kind(kind, tmp_path)
    assert_double(store, tmp_path)
    assert_single(store, tmp_path)


@pytest.mark.parametrize("name", VOIDS)
def test_voids(name, tmp_path):
    dem = write_dem(tmp_path / "a.tif", VOIDS[name].heights)
    store = vpfx.build(dem, tmp_path / "a.gpkg", max_error=(9, 3), tile_size=8).path
    assert_double(store, tmp_path)


FIXED = {
    "New Mexico in tiles": (CELL, {"max_error": (80, 40), "tile_size": 128}),
    "UTM": (UTM, {"max_error": (60, 40), "tile_size": 64}),
    "pyramid": (UTM, {"method": "delaunay_pyramid", "max_error": (80, 60, 40), "tile_size": 90}),
    "quadtree": (UTM, {"method": "quadtree", "max_error": (60, 40), "tile_size": 64}),
    "filled": (VOIDS_FILE, {"max_error": (40, 20), "tile_size": 60, "fill": True}),
    "scarlatos with voids": (VOIDS_FILE, {"method": "scarlatos", "passes": 3, "tile_size": 60}),
}


@pytest.mark.parametrize("name", slow_apart(FIXED, ["quadtree", "filled"]))
def test_real_terrain(name, tmp_path):
    dem, options = FIXED[name]
    store = vpfx.build(dem, tmp_path / "a.gpkg", **options).path
    assert_double(store, tmp_path)
    assert_single(store, tmp_path)


def test_prescribed_edges(tmp_path):
    """Nodes of lines lie off the posts; where floats do not tell them apart, single precision is refused."""
    options = {"method": "constrained_delaunay_pyramid", "max_error": (80, 60), "tile_size": 150, "features": STREAMS}
    store = vpfx.build(CELL, tmp_path / "a.gpkg", **options).path
    assert_double(store, tmp_path)
    with pytest.raises(InputError, match="give --double"):
        there(store, tmp_path / "single")


@pytest.mark.parametrize("x0", [179.9, -180.05])
def test_antimeridian(x0, tmp_path):
    dem = write_dem(tmp_path / "a.tif", hills(14, 20), x0=x0, y0=-17.3, step=1 / 120, crs="EPSG:4326")
    store = vpfx.build(dem, tmp_path / "a.gpkg", max_error=(20, 5), tile_size=10).path
    assert max(x for (x,) in query(store, "SELECT x FROM node")) > (180 if x0 > 0 else -180)
    assert_double(store, tmp_path)
    assert_single(store, tmp_path)


@st.composite
def surfaces(draw):
    """Heights of few posts, some of them void, but a square with ground; and how to build them."""
    n_row, n_col = draw(st.integers(2, 22)), draw(st.integers(2, 22))
    heights = noise(n_row, n_col, draw(st.integers(0, 99)))
    heights[2:, 2:][np.random.default_rng(draw(st.integers(0, 99))).random((max(n_row - 2, 0), max(n_col - 2, 0)))
                    < draw(st.sampled_from([0.0, 0.0, 0.05, 0.3, 0.8]))] = np.nan  # fmt: skip
    places = {
        "utm": {},
        "lon lat": {"x0": -107.3, "y0": 36.2, "step": 1 / 1200, "crs": "EPSG:4326"},
        "none": {"crs": None},
    }
    place = places[draw(st.sampled_from(list(places)))]
    bounds = sorted(
        draw(st.sets(st.sampled_from([0.5, 1.0, 2.0, 4.0, 8.0, 16.0]), min_size=1, max_size=4)), reverse=True
    )
    options = {
        "method": draw(st.sampled_from(["wynne", "wynne", "delaunay_pyramid"])), "max_error": tuple(bounds),
        "tile_size": draw(st.sampled_from([8, 9, 30])), "fill": draw(st.booleans()),
    }  # fmt: skip
    return heights, place, options


@settings(max_examples=5, deadline=None)
@given(surfaces())
def test_any_store(case):
    heights, place, options = case
    with TemporaryDirectory() as name:
        folder = Path(name)
        dem = write_dem(folder / "a.tif", heights, **place)
        store = vpfx.build(dem, folder / "a.gpkg", **options).path
        assert_double(store, folder)
        with suppress(InputError):  # floats are too coarse
            assert_single(store, folder)


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(surfaces())
def test_many_stores(case):
    test_any_store.hypothesis.inner_test(case)


# --- attributes -------------------------------------------------------------------------------------------------------------

NAMES = st.text(string.ascii_lowercase + string.digits + "_", min_size=1, max_size=14).map("q".__add__)
TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=9) | st.sampled_from(
    ["", "\\", "\\e", "\\u0041", "N/A", "-", " ", "a  ", "naïve", "Δ\\δ", "🌍", "\0", "x\ny", "é\\"]
)
VALUES = {
    "text": TEXTS,
    "integer": st.integers(-(2**63), 2**63 - 1) | st.integers(-(2**31), 2**31 - 1) | st.integers(-3, 3),
    "real": st.floats(allow_nan=False, allow_infinity=False),
    "date": st.dates().map(str),
}


@st.composite
def classes(draw):
    """Feature classes: name, description, columns by name, rows, and described values."""
    found = []
    for name in draw(st.lists(NAMES, min_size=1, max_size=3, unique=True)):
        columns = {}
        for column in draw(st.lists(NAMES | st.just("store_id"), min_size=1, max_size=4, unique=True)):
            columns[column] = draw(st.tuples(st.sampled_from(list(VALUES)), TEXTS, TEXTS))
        values = [st.none() | VALUES[kind] for kind, _, _ in columns.values()]
        rows = draw(st.lists(st.tuples(*values), max_size=4))
        described = draw(
            st.lists(st.tuples(st.sampled_from(list(columns)), TEXTS, TEXTS), max_size=3, unique_by=lambda v: v[:2])
        )
        found.append((name, draw(TEXTS), columns, rows, described))
    return found


def attach(store, found, seed, first_id):
    """Put classes into a store, with gaps between the ids, and their features on faces."""
    chance = np.random.default_rng(seed)
    faces = [face for (face,) in query(store, "SELECT face_id FROM face ORDER BY 1")]
    with edit_store(store) as editor:
        for number, (name, description, columns, rows, described) in enumerate(found):
            editor.create_class(name, columns, description, class_id=2 * number + first_id)
            ids = first_id + number + np.cumsum(chance.integers(1, 4, len(rows))) * len(found) * 3
            values = {column: [row[i] for row in rows] for i, column in enumerate(columns)}
            editor.add_features(name, values, ids)
            editor.connection.executemany(
                "INSERT INTO value_description VALUES (?, ?, ?, ?)",
                [(2 * number + first_id, *row) for row in described],
            )
            if rows:
                chosen = chance.choice(faces, min(len(faces), 9), replace=False)
                editor.set_faces(name, chosen, chance.choice(ids, len(chosen)), chance.uniform(0.1, 1, len(chosen)))


@pytest.fixture(scope="module")
def bare(tmp_path_factory):
    """Return a store without attributes."""
    dem = write_dem(tmp_path_factory.mktemp("bare") / "a.tif", hills(12, 10))
    return vpfx.build(dem, dem.with_name("a.gpkg"), max_error=(20, 9), tile_size=8).path


SPECIAL = [
    (
        "soil",
        "",
        {"name": ("text", "", ""), "n": ("integer", "m", "\\")},
        [("a  ", 2**40), ("\0", None)],
        [("n", " ", "")],
    )
]
NOTHING = [("soil", "Böden", {"n": ("integer", "", ""), "day": ("date", "", "")}, [], [])]


@settings(max_examples=5, deadline=None)
@example(found=SPECIAL, seed=0, first_id=1)
@example(found=[("q0", "", {"q_": ("text", "", "")}, [], [])], seed=0, first_id=1)
@example(found=NOTHING, seed=0, first_id=7)
@given(found=classes(), seed=st.integers(0, 99), first_id=st.sampled_from([1, 1, 7]))
def test_any_attributes(bare, found, seed, first_id):
    """Rows of all tables come back, ids with their gaps too."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        store = folder / "a.gpkg"
        store.write_bytes(bare.read_bytes())
        attach(store, found, seed, first_id)
        again = back(there(store, folder / "double", is_double=True), folder / "double.gpkg")
        assert tables(again) == tables(store)
        if found is SPECIAL:
            assert_single(store, folder)
