"""What other programs find in the rows of a store, and what is left when a build does not end well."""

from __future__ import annotations

import errno
import math
import re
import resource
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import fiona
import numpy as np
import pytest
import shapely
from invariants import judge_store
from pyproj import CRS, Geod
from shapely.geometry import shape
from surfaces import hills, noise, query, write_dem

from vpfx.errors import InputError, StoreError
from vpfx.pipeline import build
from vpfx.store.writer import StoreWriter

ROOT = Path(__file__).resolve().parents[1]
BOUNDS = (20.0, 8.0)
TILE_SIZE = 16
KINDS = {"node": "3D Point", "edge": "3D LineString", "face": "3D Polygon"}
ATTRIBUTES = ["level", "tile", "tile_level", "node", "edge", "face", "source", "feature_class"]
MANDATORY = {"gpkg_spatial_ref_sys", "gpkg_contents", "gpkg_geometry_columns", "gpkg_extensions"}


def surface():
    """Hills with a lake, and voids that cross and touch tile borders."""
    heights = hills(41, 50)
    heights[26:36, 3:15] = 5.3
    for void in (np.s_[10:20, 14:19], np.s_[5, 25:40], np.s_[27:30, 30:33]):
        heights[void] = np.nan
    return heights


@pytest.fixture(scope="module")
def dem(tmp_path_factory):
    return write_dem(tmp_path_factory.mktemp("dem") / "hills.tif", surface())


@pytest.fixture(scope="module")
def store(dem):
    build(dem, dem.with_name("hills.gpkg"), max_error=BOUNDS, tile_size=TILE_SIZE)
    judge_store(dem.with_name("hills.gpkg"), dem)
    return dem.with_name("hills.gpkg")


def features(path, layer, **options):
    """Return the features of a layer as {id: (geometry, attributes)}."""
    with fiona.open(path, layer=layer) as found:
        rows = list(found.filter(**options))
    return {row.properties[f"{layer[:4]}_id"]: (shape(row.geometry), dict(row.properties)) for row in rows}


# --- what other programs find ---------------------------------------------------------------------------------------------


def test_sqlite_finds_nothing_wrong(store):
    assert query(store, "PRAGMA integrity_check") == [("ok",)]
    assert query(store, "PRAGMA foreign_key_check") == []
    assert query(store, "PRAGMA journal_mode") == [("delete",)]
    assert query(store, "PRAGMA freelist_count") == [(0,)]


def test_file_is_a_geopackage(store):
    head = store.read_bytes()[:100]
    assert head[:16] == b"SQLite format 3\0"
    assert (head[68:72], int.from_bytes(head[60:64], "big")) == (b"GPKG", 10400)
    tables = {name for (name,) in query(store, "SELECT name FROM sqlite_schema")}
    assert tables >= MANDATORY
    assert [row[0] for row in query(store, "SELECT srs_id FROM gpkg_spatial_ref_sys ORDER BY 1")] == [
        -1,
        0,
        4326,
        32613,
    ]
    contents = query(store, "SELECT table_name, data_type, srs_id FROM gpkg_contents ORDER BY 1")
    layers = sorted(f"{kind}_{level}" for kind in KINDS for level in range(len(BOUNDS)))
    assert contents == sorted([(n, "features", 32613) for n in layers] + [(n, "attributes", None) for n in ATTRIBUTES])
    columns = query(
        store, "SELECT table_name, column_name, geometry_type_name, srs_id, z, m FROM gpkg_geometry_columns"
    )
    upper = {kind: name.split()[1].upper() for kind, name in KINDS.items()}
    assert sorted(columns) == [(name, "geom", upper[name[:4]], 32613, 1, 0) for name in layers]
    assert {scope for (scope,) in query(store, "SELECT scope FROM gpkg_extensions")} == {"write-only"}


def test_fiona_opens_every_layer(store):
    spatial = []
    for name in fiona.listlayers(store):
        with fiona.open(store, layer=name) as layer:
            count = len(list(layer))
            assert count == len(layer)
            if layer.schema["geometry"] != "None":
                spatial.append(name)
                kind, level = name.split("_")
                assert layer.schema["geometry"] == KINDS[kind]
                assert layer.crs.to_epsg() == 32613
                assert layer.bounds == (5e5, 4e6, 5e5 + 49 * 30, 4e6 + 40 * 30)
                assert [(count,)] == query(store, f"SELECT {kind}_count FROM level WHERE level = ?", int(level))
    assert sorted(spatial) == sorted(f"{kind}_{level}" for kind in KINDS for level in range(len(BOUNDS)))
    assert sorted(set(fiona.listlayers(store)) - set(spatial)) == sorted(ATTRIBUTES)


@pytest.mark.parametrize("crs", [None, "+proj=laea +lat_0=52 +lon_0=10 +ellps=bessel", "EPSG:4326", "EPSG:4269"])
def test_crs_is_kept(crs, tmp_path):
    place = {} if crs and "laea" in crs else {"x0": 10.0, "y0": 50.0, "step": 1e-3}
    dem = write_dem(tmp_path / "a.tif", noise(5, 6), crs=crs, **place)
    build(dem, tmp_path / "a.gpkg", max_error=(5.0,))
    with fiona.open(tmp_path / "a.gpkg", layer="face_0") as layer:
        assert CRS.from_user_input(layer.crs_wkt) == CRS(crs) if crs else "ndefined" in layer.crs_wkt or not layer.crs


def test_geometries_are_those_of_the_rows(store):
    places = {row[0]: row[1:] for row in query(store, "SELECT node_id, x, y, z FROM node")}
    for level in range(len(BOUNDS)):
        for node, (point, attributes) in features(store, f"node_{level}").items():
            assert point.coords[0] == places[node]
            assert attributes["z"] == places[node][2]
        rows = query(store, "SELECT edge_id, start_node, end_node FROM edge WHERE level = ?", level)
        lines = {edge: list(line.coords) for edge, (line, _) in features(store, f"edge_{level}").items()}
        assert lines == {edge: [places[start], places[end]] for edge, start, end in rows}
        rows = query(store, "SELECT face_id, node_1, node_2, node_3, node_1 FROM face WHERE level = ?", level)
        rings = {face: list(part.exterior.coords) for face, (part, _) in features(store, f"face_{level}").items()}
        assert rings == {face: [places[node] for node in nodes] for face, *nodes in rows}


@pytest.mark.parametrize("layer", ["node_1", "edge_1", "face_0", "face_1"])
def test_boxes_find_what_they_touch(store, layer):
    everything = features(store, layer)
    ids, shapes = list(everything), np.array([geometry for geometry, _ in everything.values()])
    random, counts = np.random.default_rng(4), set()
    for i in range(30):
        x, y = (np.sort(random.uniform(-100.0, side, 2)) for side in (49 * 30 + 100, 40 * 30 + 100))
        if i % 3 == 0:  # the sides of the box run through posts
            x, y = np.round(x / 30) * 30, np.round(y / 30) * 30
        box = 5e5 + x[0], 4e6 + y[0], 5e5 + x[1], 4e6 + y[1]
        expected = {ids[i] for i in np.flatnonzero(shapely.intersects(shapes, shapely.box(*box)))}
        assert set(features(store, layer, bbox=box)) == expected, box
        counts.add(len(expected))
    assert len(counts) > 10


# --- attributes -------------------------------------------------------------------------------------------------------------


def slope_and_aspect(ring, scale):
    """Degrees from the normal of a face, whose horizontal part points downhill."""
    a, b, c = (np.array(corner) * (*scale, 1.0) for corner in ring[:3])
    east, north, up = np.cross(b - a, c - a)
    level = math.hypot(east, north) == 0
    slope = math.degrees(math.atan2(math.hypot(east, north), up))
    return slope, None if level else math.degrees(math.atan2(east, north)) % 360


def check_faces(path, scale_of):
    level_faces = 0
    parent_of = dict(query(path, "SELECT child_face, parent_face FROM parent_child"))
    tiles = {row[0]: shapely.box(*row[1:]) for row in query(path, "SELECT tile_id, xmin, ymin, xmax, ymax FROM tile")}
    coarser = {}
    for level in range(len(BOUNDS)):
        faces = features(path, f"face_{level}")
        for face, (part, row) in faces.items():
            assert (row["level"], row["is_filled"], row["parent"]) == (level, 0, parent_of.get(face))
            assert level == 0 or coarser[row["parent"]][0].contains(part.centroid)
            assert tiles[row["tile_id"]].contains(part.centroid)
            slope, aspect = slope_and_aspect(part.exterior.coords, scale_of(tiles[row["tile_id"]]))
            assert row["slope"] == pytest.approx(slope, abs=0.00501)
            if row["aspect"] is None or aspect is None:
                level_faces += 1
                assert slope < 0.005
            elif slope > 0.01:  # below, the rounding of heights turns the face
                assert 0 <= row["aspect"] < 360
                assert abs((row["aspect"] - aspect + 180) % 360 - 180) < 0.00501
        coarser = faces
    return level_faces


def test_faces_have_slope_aspect_parent_and_tile(store):
    assert check_faces(store, lambda _: (1.0, 1.0)) > 0


def test_slopes_of_degrees_are_in_metres(tmp_path):
    dem = write_dem(tmp_path / "a.tif", surface(), x0=10.0, y0=60.0, step=1e-3, crs="EPSG:4326")
    build(dem, tmp_path / "a.gpkg", max_error=BOUNDS, tile_size=25)

    def scale_of(tile):
        (lon,), (lat,) = tile.centroid.xy
        inv = Geod(ellps="WGS84").inv
        return inv(lon - 5e-4, lat, lon + 5e-4, lat)[2] * 1e3, inv(lon, lat - 5e-4, lon, lat + 5e-4)[2] * 1e3

    check_faces(tmp_path / "a.gpkg", scale_of)


def test_level_ground_has_no_aspect(store):
    assert query(store, "SELECT count(*) > 0 FROM face WHERE slope_centidegrees = 0") == [(1,)]
    rows = query(store, "SELECT slope_centidegrees, aspect_centidegrees FROM face WHERE slope_centidegrees = 0")
    assert {aspect for _, aspect in rows} == {None}


# --- ids and index ----------------------------------------------------------------------------------------------------


def test_rows_of_a_tile_and_level_lie_together(store):
    for table in KINDS:
        rows = query(store, f"SELECT {table}_id, tile_id, level FROM {table}")
        groups = {}
        for number, *group in rows:
            groups.setdefault(tuple(group), []).append(number)
        limits = query(store, f"SELECT tile_id, level, first_{table}, last_{table} FROM tile_level")
        inside = set()
        for tile, level, first, last in limits:
            run = [] if first is None else list(range(first, last + 1))
            assert set(run) <= set(groups.get((tile, level), []))
            inside.update(run)
        border = {number for number, *_ in rows} - inside
        assert min(number for number, *_ in rows) > 0
        assert max(border, default=0) < min(inside)
        if table == "face":
            assert not border
        if table == "edge":
            ranges = query(store, "SELECT level, first_border_edge, last_border_edge FROM level")
            levels = {number: level for number, _, level in rows if number in border}
            assert all(any(n == level and a <= edge <= b for n, a, b in ranges) for edge, level in levels.items())


def test_index_finds_tiles(store):
    tiles = query(store, "SELECT tile_id, xmin, ymin, xmax, ymax FROM tile")
    assert len(tiles) == 3 * 4
    sql = "SELECT tile_id FROM tile_index WHERE xmin <= ? AND xmax >= ? AND ymin <= ? AND ymax >= ? ORDER BY 1"
    random = np.random.default_rng(8)
    for _ in range(50):
        x, y = np.sort(random.uniform(5e5, 5e5 + 1470, 2)), np.sort(random.uniform(4e6, 4e6 + 1200, 2))
        expected = [t for t, *e in tiles if e[0] <= x[1] and e[2] >= x[0] and e[1] <= y[1] and e[3] >= y[0]]
        assert [row[0] for row in query(store, sql, x[1], x[0], y[1], y[0])] == expected


# --- builds that do not end well ----------------------------------------------------------------------------------------------


def failing_build(dem, output, error=StoreError, **options):
    """Build, expect an error and that nothing has changed beside the output; return the message."""
    before = {path.name: path.read_bytes() for path in dem.parent.iterdir() if path.is_file()}
    with pytest.raises(error) as failure:
        build(dem, output, **{"max_error": BOUNDS, "tile_size": TILE_SIZE, **options})
    assert {path.name: path.read_bytes() for path in dem.parent.iterdir() if path.is_file()} == before
    return str(failure.value)


@pytest.fixture(params=[False, True], ids=["new", "old"])
def target(request, tmp_path):
    """Return a DEM and the place of a store; there may be an old file that is to be replaced."""
    if request.param:
        (tmp_path / "a.gpkg").write_bytes(b"the old store")
    return write_dem(tmp_path / "hills.tif", surface()), tmp_path / "a.gpkg"


@pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError, InputError, OSError])
@pytest.mark.parametrize("method", ["add", "_write_borders", "_write_tiles", "_publish"])
def test_errors_leave_nothing(target, monkeypatch, method, error):
    calls = []
    real = getattr(StoreWriter, method)

    def fail(self, *arguments):
        calls.append(method)
        if len(calls) == (3 if method == "add" else 1):
            raise error("no")
        return real(self, *arguments)

    monkeypatch.setattr(StoreWriter, method, fail)
    failing_build(*target, error=(StoreError, OSError) if error is OSError else error, overwrite=True)
    assert calls


def test_errors_of_the_progress_leave_nothing(target):
    failing_build(*target, error=ZeroDivisionError, overwrite=True, progress=lambda *_: 1 / 0)


class Interrupted(ThreadPoolExecutor):
    def shutdown(self, *_, **__):
        raise KeyboardInterrupt


def test_a_second_interrupt_leaves_nothing(target, monkeypatch):
    monkeypatch.setattr("vpfx.store.writer.ThreadPoolExecutor", Interrupted)
    failing_build(*target, error=KeyboardInterrupt, overwrite=True, progress=lambda *_: 1 / 0)


SCRIPT = """
import sys, time
from vpfx.pipeline import build

def wait(done, total):
    if done == 2:
        print("two tiles are done", flush=True)
        time.sleep(100)

build(sys.argv[1], sys.argv[2], max_error=(20.0, 8.0), tile_size=16, overwrite=True, progress=wait)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_signals_leave_the_old_store(target, number):
    dem, output = target
    before = {path.name: path.read_bytes() for path in dem.parent.iterdir()}
    command = [sys.executable, "-c", SCRIPT, str(dem), str(output)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        assert process.stdout.readline() == b"two tiles are done\n"
        process.send_signal(number)
        assert process.wait(30) != 0
    after = {path.name: path.read_bytes() for path in dem.parent.iterdir()}
    if number == signal.SIGKILL:  # nobody could tidy up
        (left_over,) = set(after) - set(before)
        assert left_over.startswith(f".{output.name}.")
        assert left_over.endswith(".tmp")
        after.pop(left_over)
    assert after == before


def test_overwrite_must_be_asked_for(dem, tmp_path):
    dem, output = write_dem(tmp_path / "hills.tif", surface()), tmp_path / "a.gpkg"
    build(dem, output, max_error=BOUNDS)
    first = output.read_bytes()
    assert "overwrite" in failing_build(dem, output)
    build(dem, output, max_error=BOUNDS[:1], overwrite=True)
    assert output.read_bytes() != first
    judge_store(output, dem)


LINKS = {"gone.gpkg": "a link that leads nowhere", "a.gpkg": "a link that leads nowhere", "kept": "an existing file"}


@pytest.mark.parametrize("leads_to", LINKS)
def test_a_link_in_the_place_is_a_file(leads_to, tmp_path):
    """It is replaced if that is asked for; what it leads to is left alone (R-100)."""
    dem, output = write_dem(tmp_path / "hills.tif", surface()), tmp_path / "a.gpkg"
    (tmp_path / "kept").write_bytes(b"kept")
    output.symlink_to(leads_to)
    message = failing_build(dem, output)
    assert message == f"{output}: found {LINKS[leads_to]}; give another name or --overwrite"
    assert output.is_symlink()
    build(dem, output, max_error=BOUNDS, overwrite=True)
    assert not output.is_symlink()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.gpkg", "hills.tif", "kept"]
    assert (tmp_path / "kept").read_bytes() == b"kept"
    judge_store(output, dem)


@pytest.mark.parametrize("name", ["missing/a.gpkg", "hills.tif/a.gpkg", "hills.tif/deeper/a.gpkg", ".", "n" * 300])
def test_places_that_cannot_be_written(name, tmp_path):
    dem = write_dem(tmp_path / "hills.tif", surface())
    message = failing_build(dem, tmp_path / name, overwrite=True)
    assert "\n" not in message
    assert str(tmp_path / name) in message


@contextmanager
def largest_file(n_byte):
    """Let no file grow beyond so many bytes, as if the disk were full."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_byte, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("share", [0.0, 0.005, 0.1, 0.5, 0.9, 0.97, 0.999])
def test_full_disk_leaves_the_old_store(target, store, share):
    dem, output = target
    with largest_file(int(share * store.stat().st_size)):
        message = failing_build(dem, output, overwrite=True)
    assert "\n" not in message
    assert message.startswith(f"{output}: cannot be written: ")
    assert ".tmp" not in message


@pytest.mark.parametrize("at", ["PageFile.__init__", "PageFile.flush", "PageFile.finish", "Spool.__init__", "os.fsync"])
def test_what_the_medium_refuses_is_told_under_the_name_given(at, target, monkeypatch):
    """Whatever file the system names, hidden ones as a rule."""
    dem, output = target

    def refuse(*_):
        raise OSError(errno.ENOSPC, "No space left on device", f".{output.name}.17.tmp")

    monkeypatch.setattr(at if at.startswith("os.") else f"vpfx.store.page_file.{at}", refuse)
    message = failing_build(dem, output, overwrite=True)
    assert re.fullmatch(rf"{re.escape(str(output))}: cannot be (opened|written): No space left on device", message)
