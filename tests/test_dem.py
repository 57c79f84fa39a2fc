"""vpfx.dem: every format gives the same posts; gaps, units, mosaics and bad files are treated as documented."""

from __future__ import annotations

import gzip
import hashlib
import http.server
import threading
import tomllib
import zipfile
from pathlib import Path

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from conftest import shared_dem
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import Geod
from rasterio.enums import ColorInterp
from rasterio.transform import Affine, from_origin

from vpfx.dem import Dem, open_dem, read_grid
from vpfx.dem.lattice import Lattice
from vpfx.dem.mosaic import MAX_OPEN_FILES
from vpfx.errors import DemFormatError, InputError, NotFoundError
from vpfx.model import Extent

FIXTURES = Path(__file__).resolve().parents[1] / "fixtures" / "dem"
CELL = FIXTURES / "new_mexico_cell_5min_1arcsec.tif"
DT2 = FIXTURES / "new_mexico_n36_w108.dt2"
VOIDS = FIXTURES / "new_mexico_voids.tif"
UTM = FIXTURES / "new_mexico_utm13_30m.tif"


def ramp(n_row, n_col, dtype="int16"):
    """Return heights that tell every post from its neighbours; south first, some below zero."""
    return (np.arange(n_row)[:, None] * 7 % 500 + np.arange(n_col) * 3 % 400 - 50).astype(dtype)


def write_tiff(path, heights, x0=10.0, y0=45.0, dx=1 / 120, dy=1 / 120, crs="EPSG:4326", **extra):
    """Write heights (south first) with post (0, 0) at x0, y0."""
    n_row, n_col = heights.shape
    transform = from_origin(x0 - dx / 2, y0 + (n_row - 0.5) * dy, dx, dy)
    profile = {"driver": "GTiff", "height": n_row, "width": n_col, "count": 1, "dtype": heights.dtype}
    with rasterio.open(path, "w", **{**profile, "crs": crs, "transform": transform, **extra}) as dataset:
        dataset.write(heights[::-1], 1)
    return path


def read_all(paths, **options):
    with open_dem(paths, **options) as dem:
        return dem.read(0, dem.n_row, 0, dem.n_col)


def lattice_of(dem):
    return dem.n_row, dem.n_col, dem.x0, dem.y0, dem.dx, dem.dy


# --- fixtures ---------------------------------------------------------------------------------------------------------


def test_index_lists_every_fixture_and_nothing_else():
    index = tomllib.loads((FIXTURES / "INDEX.toml").read_text(encoding="utf-8"))
    assert {"package", "member", "licence", "script"} <= set(index.pop("source"))
    assert set(index) == {path.name for path in FIXTURES.iterdir()} - {"INDEX.toml"}
    for name, entry in index.items():
        assert hashlib.sha256((FIXTURES / name).read_bytes()).hexdigest() == entry["sha256"], name
        assert {"description", "posts", "spacing", "crs"} <= set(entry), name


def test_cell_fixture_is_the_shared_file():
    with open_dem(CELL) as ours, open_dem(shared_dem(CELL.name)) as theirs:
        assert lattice_of(ours) == lattice_of(theirs)
        assert ours.crs == theirs.crs
        np.testing.assert_array_equal(ours.read(0, 300, 0, 300), theirs.read(0, 300, 0, 300))


def test_dted_fixture_is_genuine():
    content = DT2.read_bytes()
    assert len(content) == 3428 + 300 * (12 + 2 * 300)
    for col in range(300):
        record = content[3428 + col * 612 : 3428 + (col + 1) * 612]
        assert record[:8] == b"\xaa" + col.to_bytes(3, "big") + col.to_bytes(2, "big") + b"\0\0"
        assert sum(record[:-4]) == int.from_bytes(record[-4:], "big")
    with rasterio.Env(DTED_VERIFY_CHECKSUM="YES"), rasterio.open(DT2) as dataset:
        north_first = dataset.read(1)
    with open_dem(DT2) as dem:
        assert lattice_of(dem) == (300, 300, -107 - 40 / 60, 36 + 20 / 60, 1 / 3600, 1 / 3600)
        assert (dem.vertical_unit, dem.vertical_unit_is_assumed, dem.vertical_datum) == ("metre", False, "EPSG:5773")
        np.testing.assert_array_equal(dem.read(0, 300, 0, 300), north_first[::-1])


# --- formats ----------------------------------------------------------------------------------------------------------

DEGREE = (121, 121, 1 / 120, 1 / 120)
FORMATS = {
    "tif": ("GTiff", "a.tif", DEGREE),
    "asc": ("AAIGrid", "a.asc", DEGREE),
    "vrt": ("VRT", "a.vrt", DEGREE),
    "dem": ("USGSDEM", "a.dem", DEGREE),
    "dt0": ("DTED", "n45.dt0", DEGREE),
    "dt1_zone": ("DTED", "n56.dt1", (1201, 601, 6 / 3600, 3 / 3600)),
    "hgt": ("SRTMHGT", "N45E010.hgt", (1201, 1201, 1 / 1200, 1 / 1200)),
}


PACKED = [(key, packing) for key in FORMATS for packing in ("plain", "gz", "zip") if key != "vrt" or packing == "plain"]


@pytest.mark.parametrize(("key", "packing"), PACKED)
def test_formats_give_the_same_posts(tmp_path, key, packing):
    driver, name, (n_row, n_col, dx, dy) = FORMATS[key]
    y0 = 56.0 if key == "dt1_zone" else 45.0
    heights = ramp(n_row, n_col)
    write_tiff(tmp_path / "source.tif", heights, y0=y0, dx=dx, dy=dy)
    path = tmp_path / name
    rasterio.shutil.copy(tmp_path / "source.tif", path, driver=driver)
    if packing == "gz":
        path = path.with_name(name + ".gz")
        path.write_bytes(gzip.compress((tmp_path / name).read_bytes(), 1))
    if packing == "zip":
        path = path.with_name(name + ".zip")
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            for member in sorted(tmp_path.glob(f"{name.split('.')[0]}.*")):  # with what lies beside it, such as a .prj
                if member != path:
                    archive.write(member, member.name)
    before = sorted(tmp_path.iterdir())
    with open_dem(path, crs="EPSG:4326") as dem:  # a packed .asc has lost its .prj
        assert lattice_of(dem) == (n_row, n_col, 10.0, y0, dx, dy)
        assert dem.sources[0].driver == driver
        assert dem.sources[0].sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
        assert dem.sources[0].n_byte == path.stat().st_size
        assert (dem.sources[0].path, dem.sources[0].name) == (str(path), path.name)
        np.testing.assert_array_equal(dem.read(0, n_row, 0, n_col), heights)
    assert sorted(tmp_path.iterdir()) == before  # GDAL leaves nothing beside the input


@pytest.mark.parametrize("dtype", ["i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8"])
def test_all_real_types(tmp_path, dtype):
    heights = np.arange(12).reshape(3, 4).astype(dtype)
    np.testing.assert_array_equal(read_all(write_tiff(tmp_path / "a.tif", heights)), heights)


def test_pixel_is_point_and_area_twins_have_equal_posts(tmp_path):
    area, point = tmp_path / "area.tif", tmp_path / "point.tif"
    for path, tag in ((area, "Area"), (point, "Point")):
        write_tiff(path, ramp(5, 6))
        with rasterio.open(path, "r+") as dataset:
            dataset.update_tags(AREA_OR_POINT=tag)
    with open_dem(area) as one, open_dem(point) as other:
        assert lattice_of(one) == lattice_of(other) == (5, 6, 10.0, 45.0, 1 / 120, 1 / 120)


@pytest.mark.parametrize("south_up", [False, True])
@pytest.mark.parametrize("mirrored", [False, True])
def test_rasters_that_run_the_other_way(tmp_path, south_up, mirrored):
    heights = ramp(4, 5)
    stored = heights[:: 1 if south_up else -1, :: -1 if mirrored else 1]
    a, c = (-2.0, 109.0) if mirrored else (2.0, 99.0)
    e, f = (3.0, 198.5) if south_up else (-3.0, 210.5)
    path = tmp_path / "a.tif"
    profile = {"driver": "GTiff", "height": 4, "width": 5, "count": 1, "dtype": "int16", "crs": "EPSG:32611"}
    with rasterio.open(path, "w", transform=Affine(a, 0, c, 0, e, f), **profile) as dataset:
        dataset.write(stored, 1)
    with open_dem(path) as dem:
        assert lattice_of(dem) == (4, 5, 100.0, 200.0, 2.0, 3.0)
        np.testing.assert_array_equal(dem.read(1, 3, 1, 4), heights[1:3, 1:4])


def test_rounding_noise_goes_and_nothing_else():
    noisy = Lattice(1201, 1201, 11.000000000000002, -1e-15, 0.00083333333333, 0.00083333333333, 3600).tidied()
    assert (noisy.x0, noisy.y0, noisy.dx, noisy.dy) == (11.0, 0.0, 3 / 3600, 3 / 3600)
    assert noisy.tidied() == noisy
    for real in (Lattice(9, 9, 376328.6554542635, 0.1, 30.0, 30.0), Lattice(9, 9, -107.7, 36.3, 9.2592592e-05, 0.1)):
        assert real.tidied() == real


@settings(max_examples=30, deadline=None)
@given(row=st.tuples(st.integers(0, 99), st.integers(1, 100)), col=st.tuples(st.integers(0, 99), st.integers(1, 100)))
def test_any_block_is_a_part_of_the_whole(row, col):
    row, col = (min(row), max(row[1], row[0] + 1)), (min(col), max(col[1], col[0] + 1))
    with open_dem(VOIDS) as dem:
        whole = dem.read(0, 100, 0, 100)
        np.testing.assert_array_equal(dem.read(*row, *col), whole[slice(*row), slice(*col)])


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


# --- hostile files ----------------------------------------------------------------------------------------------------


def refused(path, **options):
    """Return the one-line message with which a file is refused, or an empty text if it is read."""
    message = str(path)
    try:
        read_all(path, **options)
    except (DemFormatError, InputError) as error:
        message = str(error)
    assert "\n" not in message
    assert message.startswith(str(path))
    return message.removeprefix(str(path))


def test_files_that_are_no_dem(tmp_path, capfd):
    np.savez(tmp_path / "a.npz", np.zeros((3, 3)))
    contents = {"empty.tif": b"", "text.dt1": b"UHL1 no, just words\n" * 300, "short.hgt": b"\0" * 1201}
    for name, content in {**contents, "x.gz": b"\x1f", "x.zip": b"PK", "N00E000.hgt": b"\0" * 7}.items():
        (tmp_path / name).write_bytes(content)
    for path in sorted(tmp_path.iterdir()):
        assert "cannot be opened" in refused(path) or path.name == "x.zip", path
    assert "found a broken archive" in refused(tmp_path / "x.zip")
    assert "found a directory" in refused(tmp_path)
    for path in ("http://127.0.0.1:1/a.tif", "/vsicurl/http://127.0.0.1:1/a.tif", "s3://b/a.tif", "zip+http://b/a.zip"):
        assert "found a remote or virtual path" in refused(path)
    with pytest.raises(NotFoundError, match=r"none\.tif: there is no such file"):
        open_dem(tmp_path / "none.tif")
    assert capfd.readouterr() == ("", "")


def test_archives_with_none_or_two_rasters_or_odd_compression(tmp_path):
    for name, members in (("none.zip", ["a.txt", "b.txt"]), ("two.zip", ["a.tif", "b.TIF"])):
        with zipfile.ZipFile(tmp_path / name, "w") as archive:
            for member in members:
                archive.write(CELL, member)
    assert "found 0 rasters" in refused(tmp_path / "none.zip")
    assert "found 2 rasters" in refused(tmp_path / "two.zip")
    with zipfile.ZipFile(tmp_path / "odd.zip", "w", zipfile.ZIP_LZMA) as archive:
        archive.write(CELL, "a.tif")
    assert "found compression method 14" in refused(tmp_path / "odd.zip")


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_grids_without_place_or_rotated(tmp_path):
    path = tmp_path / "a.tif"
    assert "found no georeference" in refused(write_tiff(path, ramp(3, 3), transform=Affine.identity()))
    rotated = Affine(0.08, 0.06, 10, 0.06, -0.08, 45)
    assert "found a rotated or sheared grid" in refused(write_tiff(path, ramp(3, 3), transform=rotated))
    for spacing, place in ((1e-300, 45.0), (1e308, 0.0), (1.0, 1e300)):
        lost = Affine(spacing, 0, place, 0, -spacing, place)
        assert "expected posts that can be told apart" in refused(write_tiff(path, ramp(3, 3), transform=lost))


def test_odd_bytes_in_texts_of_a_vrt(tmp_path, capfd):
    rasterio.shutil.copy(DT2, tmp_path / "a.vrt", driver="VRT")
    content = (tmp_path / "a.vrt").read_bytes()
    for old, new in ((b"<UnitType>m", b"<UnitType>\x80"), (b"<SRS", b"<\x80RS"), (b"</SRS", b"</\xffRS")):
        assert old in content
        (tmp_path / "b.vrt").write_bytes(content.replace(old, new))
        refused(tmp_path / "b.vrt")
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("path", [DT2, VOIDS, UTM])
def test_cut_and_changed_files_are_read_or_refused(tmp_path, path, capfd):
    content = path.read_bytes()
    rng = np.random.default_rng(1)
    target = tmp_path / path.name
    for n_byte in [*range(0, 3428, 857), *rng.integers(3428, len(content), 12).tolist(), len(content) - 1]:
        target.write_bytes(content[:n_byte])
        assert refused(target), n_byte
    for place in [*rng.integers(0, 728, 40).tolist(), *rng.integers(0, len(content), 20).tolist()]:
        changed = bytearray(content)
        changed[place] ^= int(rng.integers(1, 256))
        target.write_bytes(changed)
        refused(target)
    assert capfd.readouterr() == ("", "")


def test_a_vrt_does_not_reach_the_network(tmp_path):
    asked = []

    class Handler(http.server.BaseHTTPRequestHandler):
        def handle(self):
            asked.append(self.client_address)

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    url = f"http://127.0.0.1:{server.server_port}/a.tif"
    rasterio.shutil.copy(VOIDS, tmp_path / "a.vrt", driver="VRT")
    text = (tmp_path / "a.vrt").read_text()
    start, stop = text.index("<SourceFilename"), text.index("</SourceFilename>")
    for source in (url, f"/vsicurl/{url}", f"/vsicurl_streaming/{url}", f"/vsizip/vsicurl/{url}.zip/a.tif"):
        (tmp_path / "b.vrt").write_text(f'{text[:start]}<SourceFilename relativeToVRT="0">{source}{text[stop:]}')
        assert refused(tmp_path / "b.vrt")
    server.shutdown()
    server.server_close()
    assert asked == []
