"""Elevation files: every format gives the same posts, and what is no DEM is refused in one line."""

from __future__ import annotations

import gzip
import hashlib
import http.server
import threading
import tomllib
import zipfile

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from conftest import shared_dem
from hypothesis import given, settings
from hypothesis import strategies as st
from rasterio.transform import Affine
from rasters import CELL, DT2, FIXTURES, UTM, VOIDS, lattice_of, ramp, read_all, write_tiff

from vpfx.dem import open_dem
from vpfx.dem.lattice import Lattice
from vpfx.errors import DemFormatError, InputError, NotFoundError

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
