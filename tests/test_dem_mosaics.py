"""Several elevation files as one DEM: the same posts in any order, or a message that says what does not fit."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import shared_dem
from rasters import lattice_of, ramp, read_all, write_tiff

from vpfx.dem import Dem, open_dem
from vpfx.dem.mosaic import MAX_OPEN_FILES
from vpfx.errors import DemFormatError, InputError

# --- mosaics ----------------------------------------------------------------------------------------------------------


@pytest.fixture
def tiles(tmp_path):
    """Four tiles of one surface that share their border posts, and the surface."""
    whole = ramp(21, 31)
    cuts = {"sw": (0, 0), "se": (0, 15), "nw": (10, 0), "ne": (10, 15)}
    paths = [
        write_tiff(tmp_path / f"{name}.tif", whole[r : r + 11, c : c + 16], x0=10 + c / 120, y0=45 + r / 120)
        for name, (r, c) in cuts.items()
    ]
    return paths, whole


def test_mosaic_is_the_surface_in_any_order(tiles):
    paths, whole = tiles
    found = []
    for ordered in (paths, paths[::-1], [paths[2], *paths]):
        with open_dem(ordered) as dem:
            np.testing.assert_array_equal(dem.read(0, 21, 0, 31), whole)
            np.testing.assert_array_equal(dem.read(9, 12, 14, 17), whole[9:12, 14:17])
            found.append((lattice_of(dem), dem.crs, sorted({source.name for source in dem.sources})))
    assert found[0] == found[1] == found[2]
    assert found[0][0] == (21, 31, 10.0, 45.0, 1 / 120, 1 / 120)
    with open_dem(paths, bbox=(10.1, 45.05, 10.2, 45.15)) as dem:
        np.testing.assert_array_equal(dem.read(0, dem.n_row, 0, dem.n_col), whole[6:19, 12:25])
    with open_dem([paths[0], paths[3]]) as dem:  # nothing known in two corners
        assert np.isnan(dem.read(11, 21, 0, 15)).all()


def test_mosaic_that_disagrees_names_files_post_heights_and_count(tiles, tmp_path, monkeypatch):
    paths, whole = tiles
    wrong = whole[:11, 15:].copy()
    wrong[5, 0] += 4
    wrong[7, 0] += 1
    write_tiff(paths[1], wrong, x0=10 + 15 / 120)
    expected = rf"se\.tif: post at \(10\.125, 45\.04166667\): found {wrong[5, 0]} m, expected {whole[5, 15]} m as in "
    with pytest.raises(DemFormatError, match=expected + r".*sw\.tif; 2 of 11 shared posts disagree") as error:
        open_dem(paths)
    with pytest.raises(DemFormatError) as other:
        open_dem(paths[::-1])
    assert str(error.value) == str(other.value)
    monkeypatch.setattr(Dem, "check_overlaps", lambda self: None)
    with open_dem(paths) as dem:
        assert dem.read(0, 5, 0, 31).shape == (5, 31)
        with pytest.raises(DemFormatError, match="1 of 1 shared posts disagree"):
            dem.read(5, 6, 0, 31)


def test_mosaic_fills_a_void_from_the_other_file(tmp_path):
    whole = ramp(5, 5, "float32")
    holed = whole.copy()
    holed[1:3, 3:] = np.nan
    one = write_tiff(tmp_path / "a.tif", holed[:, :5])
    other = write_tiff(tmp_path / "b.tif", whole[:, 3:], x0=10 + 3 / 120)
    np.testing.assert_array_equal(read_all([one, other]), whole)
    np.testing.assert_array_equal(read_all([other, one]), whole)


def test_mosaic_of_files_that_do_not_fit(tmp_path):
    one = write_tiff(tmp_path / "a.tif", ramp(5, 5))
    cases = [
        ({"x0": 11.002}, r"found posts \+0\.24 columns and \+0 rows beside those of .*a\.tif"),
        ({"x0": 11.0, "dx": 1 / 60}, r"b\.tif: found spacing 0\.0166.* expected 0\.00833.* as in .*a\.tif"),
        ({"x0": 11.0, "crs": "EPSG:4269"}, "found CRS NAD83, expected WGS 84"),
        ({"x0": 11.0, "crs": None}, "found CRS none, expected WGS 84"),
        ({"x0": 11.0, "crs": "EPSG:4326+5773"}, "found vertical datum EPSG:5773, expected unknown"),
    ]
    for options, message in cases:
        other = write_tiff(tmp_path / "b.tif", ramp(5, 5), **options)
        with pytest.raises(DemFormatError, match=message):
            open_dem([other, one])
    write_tiff(tmp_path / "b.tif", ramp(5, 5), x0=10 + (5 + 1e-4) / 120)
    with open_dem([tmp_path / "b.tif", one]) as dem:  # a hair beside is on the lattice
        assert (dem.n_col, dem.x0, dem.dx) == (10, 10.0, 1 / 120)
    with pytest.raises(InputError, match="found no file"):
        open_dem([])


def test_mosaic_of_hgt_tiles_is_the_same_as_one_file(tmp_path):
    tiles = [shared_dem("N50E011.hgt.zip"), shared_dem("N49E011.hgt.zip")]
    with open_dem(tiles) as dem:
        heights = dem.read(0, 2401, 0, 1201)
        assert [source.name for source in dem.sources] == ["N49E011.hgt.zip", "N50E011.hgt.zip"]
        joined = write_tiff(
            tmp_path / "one.tif", np.nan_to_num(heights, nan=-32768).astype("int16"), 11.0, 49.0, 1 / 1200, 1 / 1200
        )
        with open_dem(joined, nodata=-32768) as one:
            assert lattice_of(one) == lattice_of(dem) == (2401, 1201, 11.0, 49.0, 1 / 1200, 1 / 1200)
            assert one.crs == dem.crs
            np.testing.assert_array_equal(one.read(0, 2401, 0, 1201), heights)
    assert np.isnan(heights).sum() == 28


def test_a_great_mosaic_keeps_few_files_open(tmp_path):
    whole = ramp(3, 2 * (MAX_OPEN_FILES + 9) + 1)
    paths = [
        write_tiff(tmp_path / f"{c}.tif", whole[:, c : c + 3], x0=10 + c / 120) for c in range(0, whole.shape[1] - 1, 2)
    ]
    with open_dem(paths) as dem:
        for _ in range(2):
            np.testing.assert_array_equal(dem.read(0, 3, 0, dem.n_col), whole)
            assert sum(part.raster.is_open for part in dem._parts) <= MAX_OPEN_FILES
