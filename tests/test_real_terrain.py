"""Every elevation file at hand: built, and judged in full, or refused in one line; as VPF and back."""

from __future__ import annotations

import filecmp
from pathlib import Path

import pytest
import rasterio
from conftest import SHARED, shared_dem
from invariants import judge_store
from rasterio.merge import merge

from vpfx.errors import DemFormatError
from vpfx.evpf.reading import import_vpf
from vpfx.evpf.writing import export_vpf
from vpfx.pipeline import build
from vpfx.validate import validate
from vpfx.validate.report import NOTE

FIXTURES = Path(__file__).parents[1] / "fixtures" / "dem"
FIXTURE_FILES = sorted(path.name for path in FIXTURES.iterdir() if path.suffix != ".toml")
RASTERS = (".tif", ".dem", ".zip", ".gz", ".dt0", ".dt1", ".dt2")
SHARED_FILES = sorted(path.name for path in (SHARED / "data" / "dem").glob("*") if path.suffix in RASTERS)
# Posts 900 m apart in the Rockies: finer bounds take millions of faces, which the judge reads for an hour.
COARSE = {"dted0_mosaic_n20w125_30deg.tif": (1500, 800)}


@pytest.mark.parametrize("name", FIXTURE_FILES)
def test_fixture(name: str, tmp_path: Path) -> None:
    store = tmp_path / "store.gpkg"
    report = build(FIXTURES / name, store, max_error=(40, 20, 10), tile_size=150)
    judge_store(store, FIXTURES / name)
    assert [line.max_error_bound for line in report.levels] == [40, 20, 10]


@pytest.mark.slow
@pytest.mark.parametrize("name", SHARED_FILES)
def test_shared_dem(name: str, tmp_path: Path) -> None:
    path = shared_dem(name)
    store = tmp_path / "store.gpkg"
    bounds = COARSE.get(name, (160, 80, 40))
    report = build(path, store, max_error=bounds)
    figures = judge_store(store, path)
    assert len(figures) == len(report.levels) == len(bounds)


@pytest.mark.slow
@pytest.mark.parametrize("name", SHARED_FILES)
def test_shared_dem_as_vpf(name: str, tmp_path: Path) -> None:
    """In tiles: both precisions are clean VPF, and what comes back is the store, or a clean one."""
    store = build(shared_dem(name), tmp_path / "store.gpkg", max_error=COARSE.get(name, (100, 50)), tile_size=450).path
    for is_double in (False, True):
        written = export_vpf(store, tmp_path / "vpf", is_double=is_double, overwrite=True).path
        assert [found for found in validate(written).findings if found.severity != NOTE] == []
        back = import_vpf(written, tmp_path / "back.gpkg", overwrite=True).path
        if is_double:
            assert filecmp.cmp(store, back, shallow=False)
        else:
            assert validate(back).findings == ()


def test_what_is_no_raster_is_refused_in_one_line(tmp_path: Path) -> None:
    path = shared_dem("jacksboro_fault_dem.npz")
    with pytest.raises(DemFormatError) as caught:
        build(path, tmp_path / "store.gpkg", max_error=(40,))
    assert str(caught.value).count("\n") == 0
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_two_neighbours_equal_their_mosaic(tmp_path: Path) -> None:
    import sqlite3

    south, north = shared_dem("N49E011.hgt.zip"), shared_dem("N50E011.hgt.zip")
    heights, transform = merge([south, north])
    with rasterio.open(south) as source:
        profile = {**source.profile, "driver": "GTiff", "height": heights.shape[1], "transform": transform}
    with rasterio.open(tmp_path / "mosaic.tif", "w", **profile) as target:
        target.write(heights)
    build([north, south], tmp_path / "two.gpkg", max_error=(80, 40))
    build(tmp_path / "mosaic.tif", tmp_path / "one.gpkg", max_error=(80, 40))
    rows = []
    for name in ("two.gpkg", "one.gpkg"):
        connection = sqlite3.connect(tmp_path / name)
        tables = ("level", "tile", "tile_level", "node", "edge", "face", "parent_child")
        rows.append({table: connection.execute(f"SELECT * FROM {table}").fetchall() for table in tables})
        connection.close()
    assert rows[0] == rows[1]
