"""Stores that came from single precision: they say so, and rules allow for rounding, no more."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing

import pytest
from rule_fixtures import refresh_blobs, refresh_digests
from small_stores import KINDS
from surfaces import hills, query, write_dem

import vpfx
from vpfx.evpf.reading import import_vpf
from vpfx.evpf.writing import export_vpf
from vpfx.validate import validate

PLACES = {
    "UTM": {"step": 10.0, "crs": "EPSG:32611"},
    "lon lat": {"x0": -107.3, "y0": 36.2, "step": 1 / 3600, "crs": "EPSG:4326"},
}
SURFACES = {
    **KINDS,
    "T-junctions in tiles": (hills(30, 26), {"method": "scarlatos", "passes": 3, "tile_size": 9}),
    "quaternary": (hills(33, 33, 5), {"method": "quaternary", "max_error": (20, 8, 4)}),
}
WRONG = {
    "V201": "UPDATE metadata SET value = 'half' WHERE name = 'coordinate_precision'",
    "V310": "UPDATE t_junction SET gap = gap + 9 WHERE edge_id = (SELECT max(edge_id) FROM t_junction)",
    "V404": "UPDATE face SET slope_centidegrees = (slope_centidegrees + 4000) % 9000 WHERE face_id = 1",
    "V405": "UPDATE face SET aspect_centidegrees = (aspect_centidegrees + 9000) % 36000 WHERE face_id = 1",
    "V513": "UPDATE level SET max_rise = max_rise + 0.01 WHERE level = 1",
    "V513 V514": "UPDATE node SET z_parent = z_parent + 99 WHERE node_id = (SELECT max(node_id) FROM node)",
}


def made(folder, heights, options, place):
    """Build a store, and return it, its DEM and what comes back of it from single precision."""
    dem = write_dem(folder / "a.tif", heights, **place)
    store = vpfx.build(dem, folder / "a.gpkg", **options).path
    return store, dem, import_vpf(export_vpf(store, folder / "single").path, folder / "single.gpkg").path


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("name", SURFACES)
def test_what_comes_back_is_valid(name, place, tmp_path):
    _, dem, again = made(tmp_path, *SURFACES[name], PLACES[place])
    assert validate(again, dem=[dem]).findings == ()


def test_tiles_whose_corners_are_rounded(tmp_path):
    """The rectangles and the index of the tiles hold the corners as they are and as they are written."""
    place = {"x0": -107.7047689924195, "y0": 36.2966205300755, "step": 39 / 10800, "crs": "EPSG:4269"}
    dem = write_dem(tmp_path / "a.tif", hills(23, 67), **place)
    store = vpfx.build(dem, tmp_path / "a.gpkg", max_error=(20,), tile_size=11).path
    assert validate(export_vpf(store, tmp_path / "single").path).findings == ()


@pytest.fixture(scope="module")
def junctions(tmp_path_factory):
    """Return a store with T-junctions that came from single precision, of nested levels."""
    heights, options = SURFACES["T-junctions in tiles"]
    return made(tmp_path_factory.mktemp("junctions"), heights, options, PLACES["UTM"])


@pytest.mark.parametrize("codes", WRONG)
def test_what_is_wrong_is_found(codes, junctions, tmp_path):
    path = shutil.copy(junctions[2], tmp_path / "a.gpkg")
    with closing(sqlite3.connect(path)) as store:
        store.execute(WRONG[codes])
        refresh_blobs(store)
        refresh_digests(store)
        store.commit()
    assert {finding.code for finding in validate(path).findings} == set(codes.split())


def test_nothing_is_allowed_for_where_nobody_says_so(junctions, tmp_path):
    path = shutil.copy(junctions[2], tmp_path / "a.gpkg")
    with closing(sqlite3.connect(path)) as store:
        store.execute("DELETE FROM metadata WHERE name = 'coordinate_precision'")
        store.commit()
    assert {finding.code for finding in validate(path).findings} >= {"V309", "V404", "V513"}


def test_double_precision_keeps_what_a_store_says(junctions, tmp_path):
    """What came from single precision travels on in double with all its bytes; a double store never gets the name."""
    store, _, single = junctions
    for path, expected in ((single, [("single",)]), (store, [])):
        folder = export_vpf(path, tmp_path / path.stem, is_double=True).path
        again = import_vpf(folder, tmp_path / path.name).path
        assert again.read_bytes() == path.read_bytes()
        assert query(again, "SELECT value FROM metadata WHERE name = 'coordinate_precision'") == expected
