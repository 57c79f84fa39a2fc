"""What the posts of a DEM mean: voids, units, datum and CRS, bands, boxes and blocks are treated as documented."""

from __future__ import annotations

import numpy as np
import pytest
import rasterio
from conftest import shared_dem
from pyproj import Geod
from rasterio.enums import ColorInterp
from rasters import CELL, DT2, UTM, VOIDS, lattice_of, ramp, read_all, write_tiff

from vpfx.dem import open_dem, read_grid
from vpfx.errors import DemFormatError, InputError
from vpfx.model import Extent

# --- voids ------------------------------------------------------------------------------------------------------------


def test_voids_by_nodata_mask_alpha_and_nan(tmp_path):
    heights = ramp(6, 7, "float32")
    expected = heights.astype(float)
    expected[2, 3] = np.nan
    valid = np.where(np.isnan(expected), 0, 255).astype("uint8")
    coded = np.where(np.isnan(expected), -9999, heights).astype("float32")
    files = {
        "nan": write_tiff(tmp_path / "nan.tif", expected.astype("float32")),
        "nodata": write_tiff(tmp_path / "nodata.tif", coded, nodata=-9999),
        "lowest": write_tiff(
            tmp_path / "low.tif", np.where(np.isnan(expected), np.float32(-3.4e38), heights), nodata=-3.4e38
        ),
        "mask": write_tiff(tmp_path / "mask.tif", heights),
        "internal": tmp_path / "internal.tif",
        "alpha": write_tiff(tmp_path / "alpha.tif", heights, count=2),
    }
    with rasterio.open(files["mask"], "r+") as dataset:
        dataset.write_mask(valid[::-1])
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True):
        write_tiff(files["internal"], heights)
        with rasterio.open(files["internal"], "r+") as dataset:
            dataset.write_mask(valid[::-1])
    with rasterio.open(files["alpha"], "r+") as dataset:
        dataset.colorinterp = [ColorInterp.gray, ColorInterp.alpha]
        dataset.write(valid[::-1].astype("float32"), 2)
    for key, path in files.items():
        np.testing.assert_array_equal(read_all(path), expected, err_msg=key)


def test_nodata_option_replaces_the_value_in_the_file(tmp_path):
    path = write_tiff(tmp_path / "a.tif", np.array([[0, 1, 2], [3, 4, 5]], dtype="int16"), nodata=0)
    assert np.isnan(read_all(path)[0, 0])
    np.testing.assert_array_equal(read_all(path, nodata=5), [[0, 1, 2], [3, 4, np.nan]])


def test_infinite_heights_are_refused_unless_declared_void(tmp_path):
    path = write_tiff(tmp_path / "a.tif", np.array([[0, 1], [np.inf, 3]], dtype="float32"), x0=4.0, dx=1.0, dy=1.0)
    with pytest.raises(DemFormatError, match=r"a\.tif: post at \(4, 46\): found an infinite height"):
        read_all(path)
    np.testing.assert_array_equal(read_all(path, nodata=np.inf), [[0, 1], [np.nan, 3]])


# --- units, datum, CRS ------------------------------------------------------------------------------------------------


def test_heights_are_metres_whatever_the_unit(tmp_path):
    heights = ramp(3, 3)
    plain = write_tiff(tmp_path / "plain.tif", heights)
    tagged = write_tiff(tmp_path / "tagged.tif", heights)
    with rasterio.open(tagged, "r+") as dataset:
        dataset.units = ["ft"]
    compound = write_tiff(tmp_path / "compound.tif", heights, crs="EPSG:2227+6360")  # NAVD88, US survey feet
    cases = [
        (plain, {}, "metre", True, 1.0),
        (plain, {"vertical_unit": "US survey foot"}, "us_survey_foot", False, 1200 / 3937),
        (tagged, {}, "foot", False, 0.3048),
        (tagged, {"vertical_unit": "m"}, "metre", False, 1.0),
        (compound, {}, "us_survey_foot", False, 1200 / 3937),
        (plain, {"crs": "EPSG:4326+6360"}, "us_survey_foot", False, 1200 / 3937),
    ]
    for path, options, unit, is_assumed, metres in cases:
        with open_dem(path, **options) as dem:
            assert (dem.vertical_unit, dem.vertical_unit_is_assumed) == (unit, is_assumed)
            np.testing.assert_array_equal(dem.read(0, 3, 0, 3), heights * metres)
    with pytest.raises(DemFormatError, match="found foot at the band and metre in the CRS"):
        open_dem(tagged, crs="EPSG:4326+5773")
    with rasterio.open(tagged, "r+") as dataset:
        dataset.units = ["furlong"]
    with pytest.raises(DemFormatError, match="unit: found 'furlong', expected one of metre"):
        open_dem(tagged)
    with pytest.raises(InputError, match="vertical_unit: found 'fathom'"):
        open_dem(plain, vertical_unit="fathom")


def test_vertical_datum_is_found_declared_or_unknown(tmp_path):
    plain = write_tiff(tmp_path / "a.tif", ramp(3, 3))
    ellipsoidal = write_tiff(tmp_path / "b.tif", ramp(3, 3), crs="EPSG:4979")
    depths = write_tiff(tmp_path / "c.tif", ramp(3, 3), crs="EPSG:4326+5715")
    cases = [
        (plain, {}, "unknown"),
        (plain, {"crs": "EPSG:4326+5773"}, "EPSG:5773"),
        (plain, {"vertical_datum": "EPSG:5703"}, "EPSG:5703"),
        (ellipsoidal, {}, "WGS 84 ellipsoid"),
        (DT2, {"vertical_datum": "EPSG:5703"}, "EPSG:5703"),
        (depths, {"vertical_datum": "lake level"}, "lake level"),
    ]
    for path, options, datum in cases:
        with open_dem(path, **options) as dem:
            assert dem.vertical_datum == datum
            assert "VERTCRS" not in dem.crs
    with pytest.raises(DemFormatError, match="found depths"):
        open_dem(depths)
    with pytest.raises(InputError, match=r"found vertical datum EPSG:5773 .* but crs says EPSG:3855"):
        open_dem(DT2, crs="EPSG:4326+3855")


def test_crs_option_fills_a_gap_but_does_not_contradict(tmp_path):
    bare = write_tiff(tmp_path / "bare.tif", ramp(3, 3), crs=None)
    with open_dem(bare) as dem:
        assert dem.crs == ""
        assert dem.post_metres(0, 3, 0, 3) == (dem.dx, dem.dy)
    with open_dem(bare, crs=4326) as one, open_dem(write_tiff(tmp_path / "a.tif", ramp(3, 3)), crs=4326) as other:
        assert one.crs == other.crs
    with pytest.raises(InputError, match="found CRS NAD83, but crs says WGS 84"):
        open_dem(CELL, crs="EPSG:4326")
    for crs in ("EPSG:0", "EPSG:5773", "EPSG:4978"):
        with pytest.raises(InputError, match="crs: found"):
            open_dem(bare, crs=crs)


def test_latitudes_that_are_none_are_refused(tmp_path):
    with open_dem(write_tiff(tmp_path / "pole.tif", ramp(5, 5), y0=88.0, dy=0.5)) as dem:
        assert dem.extent.max_y == 90.0
    utm = write_tiff(tmp_path / "utm.tif", ramp(5, 5), y0=4e6, dx=30.0)
    with pytest.raises(DemFormatError, match=r"utm\.tif.*found latitudes from 4e\+06° .*expected -90° … 90°"):
        open_dem(utm)


def test_post_metres(tmp_path):
    geod = Geod(ellps="WGS84")
    with open_dem(write_tiff(tmp_path / "a.tif", ramp(121, 121), y0=-90.0, dx=1 / 60)) as dem:
        width, height = dem.post_metres(60, 121, 0, 121)
        lat = -90 + 90 / 120
        assert width == pytest.approx(geod.inv(0, lat, 1 / 60, lat)[2], rel=1e-9)
        assert height == pytest.approx(geod.inv(0, lat - 1 / 240, 0, lat + 1 / 240)[2], rel=1e-9)
        assert min(dem.post_metres(0, 1, 0, 1)) > 0  # at the pole
    with open_dem(UTM) as dem:
        assert dem.post_metres(0, 10, 0, 10) == (30.0, 30.0)
    with open_dem(write_tiff(tmp_path / "feet.tif", ramp(3, 3), dx=10.0, dy=20.0, crs="EPSG:2227")) as dem:
        assert dem.post_metres(0, 3, 0, 3) == pytest.approx((12000 / 3937, 24000 / 3937), rel=1e-9)


# --- bands, boxes, blocks ---------------------------------------------------------------------------------------------


def test_bands_scale_and_offset(tmp_path):
    path = write_tiff(tmp_path / "a.tif", ramp(3, 3), count=2)
    with rasterio.open(path, "r+") as dataset:
        dataset.write(ramp(3, 3)[::-1] + 1, 2)
        dataset.scales, dataset.offsets = (1.0, 0.5), (0.0, -100.0)
    np.testing.assert_array_equal(read_all(path, band=2), (ramp(3, 3) + 1) * 0.5 - 100)
    for band in (0, 3):
        with pytest.raises(InputError, match=rf"a\.tif: found no band {band}, expected 1…2; number of bands: 2"):
            open_dem(path, band=band)
    for band in (1.0, True, "1"):
        with pytest.raises(InputError, match=r"band: found .*, expected a whole number"):
            open_dem(path, band=band)
    np.testing.assert_array_equal(read_all(path, band=np.uint8(1)), ramp(3, 3))
    with pytest.raises(DemFormatError, match="band 1: found complex64 values"):
        open_dem(write_tiff(tmp_path / "complex.tif", ramp(3, 3, "complex64")))


def test_bbox_keeps_the_posts_inside_and_on_the_border(tmp_path):
    heights = ramp(11, 11)
    path = write_tiff(tmp_path / "a.tif", heights, dx=0.1, dy=0.1)
    for bbox in (Extent(10.2, 45.3, 10.5, 45.9), (10.2 + 1e-8, 45.21, 10.59, 45.9 - 1e-8)):
        with open_dem(path, bbox=bbox) as dem:
            assert dem.extent == pytest.approx(Extent(10.2, 45.3, 10.5, 45.9), abs=1e-12)
            np.testing.assert_array_equal(dem.read(0, 7, 0, 4), heights[3:10, 2:6])
    with open_dem(path, bbox=(-180, -90, 180, 90)) as dem:
        assert dem.extent == Extent(10.0, 45.0, 11.0, 46.0)
    for bbox in ((0, 0, 1, 1), (10.2, 45.3, 10.2, 45.9), (10.21, 45.31, 10.22, 45.32)):
        with pytest.raises(InputError, match=r"expected at least 2 × 2; the posts span \(10\.0, 45\.0, 11\.0, 46\.0\)"):
            open_dem(path, bbox=bbox)
    for bbox in ((1, 2, 3), (10.5, 45.0, 10.2, 46.0), (np.nan, 0, 1, 1)):
        with pytest.raises(InputError, match="bbox: found"):
            open_dem(path, bbox=bbox)


def test_blocks_must_exist_and_the_dem_be_open():
    with open_dem(VOIDS) as dem:
        for block in ((0, 101, 0, 100), (-1, 5, 0, 5), (5, 5, 0, 5)):
            with pytest.raises(InputError, match="expected posts of"):
                dem.read(*block)
    with pytest.raises(InputError, match="found a closed DEM"):
        dem.read(0, 1, 0, 1)


def test_grid_is_the_whole_dem(monkeypatch):
    grid = read_grid(str(VOIDS))
    with open_dem(VOIDS) as dem:
        assert (*grid.heights.shape, grid.x0, grid.y0, grid.dx, grid.dy) == lattice_of(dem)
        assert grid.crs == dem.crs
        assert grid.post_metres == dem.post_metres(0, 100, 0, 100)
    monkeypatch.setattr("vpfx.dem.dem.MAX_GRID_POSTS", 9999)
    with pytest.raises(InputError, match="found 100 × 100 posts, expected at most 9999"):
        read_grid(VOIDS)


def test_one_row_of_posts_is_an_input_error(tmp_path):
    with pytest.raises(InputError, match="found 1 × 9 posts in all"):
        open_dem(write_tiff(tmp_path / "a.tif", ramp(1, 9)))


def test_packed_dted2_block_by_block():
    with open_dem(shared_dem("olympic_n48_w125_from_srtm1.dt2.gz")) as dem:
        blocks = [dem.read(row, min(row + 257, 3601), 0, 257) for row in range(0, 3600, 256)]
        whole = dem.read(0, 3601, 0, 257)
    with open_dem(shared_dem("N48W125.hgt.zip")) as hgt:
        np.testing.assert_array_equal(whole, hgt.read(0, 3601, 0, 257))
    np.testing.assert_array_equal(np.vstack([blocks[0], *(block[1:] for block in blocks[1:])]), whole)
