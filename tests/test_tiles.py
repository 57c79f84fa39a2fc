"""Stores of many tiles: the same bytes from any number of workers, borders decided by their own posts, voids anywhere."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from invariants import judge_store
from surfaces import noise, write_dem

from vpfx.dem import read_grid
from vpfx.errors import InputError
from vpfx.pipeline import build
from vpfx.store.tiles import Tiling

CELL = Path(__file__).resolve().parents[1] / "fixtures" / "dem" / "new_mexico_cell_5min_1arcsec.tif"
STEP = 1 / 3600
ROWS = ("level", "tile", "tile_level", "node", "edge", "face", "parent_child")
MODES = {
    "bounded": {"max_error": (40.0, 15.0)},
    "passes": {"passes": 2, "tolerance": 2.0, "grid": (2, 1)},
    "delaunay": {"passes": 1, "start": "delaunay", "start_posts": 10, "diagonal": "random"},
}


def crop(path, rows=slice(0, 90), cols=slice(0, 120), **options):
    """Write some posts of the New Mexico cell, in their places."""
    grid = read_grid(CELL)
    place = {"x0": grid.x0 + cols.start * STEP, "y0": grid.y0 + rows.start * STEP, "step": STEP, "crs": 4269}
    return write_dem(path, grid.heights[rows, cols], **place, **options)


def rows_of(path, *tables):
    """All rows of some tables, in order."""
    with closing(sqlite3.connect(path)) as store:
        return {table: sorted(store.execute(f"SELECT * FROM {table}").fetchall()) for table in tables or ROWS}


def build_and_judge(dems, output, **options):
    report = build(dems, output, overwrite=True, workers=1, **options)
    judge_store(output, dems)
    return report


def hilly(n_row, n_col, seed=0):
    """Slopes with some noise: 60 m of relief."""
    row, col = np.mgrid[0.0:n_row, 0.0:n_col]
    return 20 * np.sin(row / 5) + 20 * np.cos(col / 7) + noise(n_row, n_col, seed)


# --- any cut, any workers, any files -------------------------------------------------------------------------------------


@pytest.mark.parametrize("tile_size", [17, 32, 1000])
@pytest.mark.parametrize("mode", MODES)
def test_terrain_in_tiles(mode, tile_size, tmp_path):
    dem = crop(tmp_path / "nm.tif")
    report = build_and_judge(dem, tmp_path / "nm.gpkg", tile_size=tile_size, **MODES[mode])
    assert report.tiles == {17: 6 * 7, 32: 3 * 4, 1000: 1}[tile_size]
    assert [line.faces for line in report.levels] == sorted(line.faces for line in report.levels)


@pytest.mark.parametrize("mode", MODES)
def test_any_number_of_workers_gives_the_same_bytes(mode, tmp_path):
    dem = crop(tmp_path / "nm.tif")
    stores = []
    for i, workers in enumerate((1, 2, 4, 50, 1)):
        build(dem, tmp_path / f"{i}.gpkg", workers=workers, tile_size=17, seed=3, **MODES[mode])
        stores.append((tmp_path / f"{i}.gpkg").read_bytes())
    assert all(store == stores[0] for store in stores[1:])


@pytest.mark.parametrize("cut", [46, 45, 13])
@pytest.mark.parametrize("mode", MODES)
def test_two_files_give_what_their_mosaic_gives(mode, cut, tmp_path):
    """The files share a row of posts, which lies on a tile border or not."""
    whole = crop(tmp_path / "whole.tif", slice(0, 91))
    parts = [crop(tmp_path / "a.tif", slice(0, cut + 1)), crop(tmp_path / "b.tif", slice(cut, 91))]
    build(whole, tmp_path / "whole.gpkg", tile_size=30, **MODES[mode])
    build(parts, tmp_path / "parts.gpkg", tile_size=30, **MODES[mode])
    assert rows_of(tmp_path / "whole.gpkg") == rows_of(tmp_path / "parts.gpkg")
    assert len(rows_of(tmp_path / "parts.gpkg", "source")["source"]) == 2


def test_one_tile_numbers_from_one(tmp_path):
    heights = hilly(30, 40)
    heights[5:9, 5:9] = np.nan
    build(write_dem(tmp_path / "a.tif", heights), tmp_path / "a.gpkg", **MODES["bounded"])
    for table, rows in rows_of(tmp_path / "a.gpkg", "node", "edge", "face").items():
        assert [row[0] for row in rows] == list(range(1, len(rows) + 1)), table


def test_tiles_are_as_even_as_posts_allow():
    for n_post in range(2, 60):
        for size in range(8, 20):
            steps = np.diff(Tiling(n_post, 100, size, 1).row_lines)
            assert (steps.sum(), steps.max() - steps.min() <= 1) == (n_post - 1, True)
            assert steps.max() <= size < steps.sum() / (len(steps) - 1) if len(steps) > 1 else steps[0] <= size


@pytest.mark.parametrize("options", [{"tile_size": 7}, {"tile_size": -8}, {"workers": 0}, {"workers": -1}])
def test_senseless_numbers_are_refused(options, tmp_path):
    dem = write_dem(tmp_path / "a.tif", hilly(20, 20))
    with pytest.raises(InputError, match=r"found -?\d.*expected at least"):
        build(dem, tmp_path / "a.gpkg", **MODES["bounded"], **options)
    assert not (tmp_path / "a.gpkg").exists()


# --- borders ----------------------------------------------------------------------------------------------------------------


def border_nodes(path, lines):
    """Nodes on inner tile lines with the level at which they appear."""
    found = set()
    for level, x, y, z in sorted(row[2:6] for row in rows_of(path, "node")["node"]):
        if round((x - 5e5) / 30, 6) in lines[1] or round((y - 4e6) / 30, 6) in lines[0]:
            found.add((level, x, y, z))
    return found


@pytest.mark.parametrize("mode", MODES)
def test_borders_are_decided_by_their_own_posts(mode, tmp_path):
    tiling = Tiling(40, 50, 13, 2)
    lines = tiling.row_lines.tolist(), tiling.col_lines.tolist()
    heights = hilly(40, 50)
    other = noise(40, 50, 9) * 3
    for axis in range(2):
        place = [slice(None)] * 2
        place[axis] = lines[axis]
        other[tuple(place)] = heights[tuple(place)]
    inner = [set(line[1:-1]) for line in lines]
    found = []
    for i, surface in enumerate((heights, other)):
        dem = write_dem(tmp_path / f"{i}.tif", surface)
        build_and_judge(dem, tmp_path / f"{i}.gpkg", tile_size=13, **MODES[mode])
        found.append(border_nodes(tmp_path / f"{i}.gpkg", inner))
    assert found[0] == found[1]
    assert {level for level, *_ in found[0]} == set(range(2 + (mode == "passes")))
    assert rows_of(tmp_path / "0.gpkg", "face") != rows_of(tmp_path / "1.gpkg", "face")


# --- voids and tile borders ---------------------------------------------------------------------------------------------------

#   Tiles of 8 posts on 33 × 33: borders at 8, 16, 24, corners where they meet.
WINDOWS = {
    "across a border": np.s_[3:6, 6:11],
    "along a border": np.s_[2:7, 8],
    "touching from the west": np.s_[3:6, 5:8],
    "touching from the east": np.s_[3:6, 9:12],
    "one post beside": np.s_[3:6, 4:7],
    "over a corner": np.s_[14:19, 14:19],
    "a corner alone": np.s_[16, 16],
    "touching a corner": np.s_[17:20, 17:20],
    "one post beside a corner": np.s_[18:20, 18:20],
    "all but the borders of a tile": np.s_[9:16, 9:16],
    "a whole tile": np.s_[8:17, 8:17],
    "a row of tiles": np.s_[8:17, :],
    "where a border meets the outside": np.s_[0:2, 7:10],
    "a border's end": np.s_[0, 8],
}


@pytest.mark.parametrize("fill", [False, True], ids=["open", "filled"])
@pytest.mark.parametrize("name", WINDOWS)
def test_voids_beside_borders(name, fill, tmp_path):
    heights = hilly(33, 33)
    heights[WINDOWS[name]] = np.nan
    dem = write_dem(tmp_path / "a.tif", heights)
    report = build_and_judge(dem, tmp_path / "a.gpkg", tile_size=8, fill=fill, max_error=(20.0, 9.0))
    assert report.ground.void_posts == np.isnan(heights).sum()
    with closing(sqlite3.connect(tmp_path / "a.gpkg")) as store:
        assert (store.execute("SELECT max(is_filled) FROM face").fetchone()[0] == 1) is fill


@pytest.mark.parametrize("name", WINDOWS)
def test_filled_voids_keep_to_the_heights_around(name, tmp_path):
    """No height of a filled store is beyond those of the posts."""
    heights = hilly(33, 33)
    heights[WINDOWS[name]] = np.nan
    dem = write_dem(tmp_path / "a.tif", heights)
    build(dem, tmp_path / "a.gpkg", tile_size=8, fill=True, passes=1)
    z = np.array([row[5] for row in rows_of(tmp_path / "a.gpkg", "node")["node"]])
    assert np.nanmin(heights) - 1e-4 <= z.min() <= z.max() <= np.nanmax(heights) + 1e-4


@st.composite
def masks(draw):
    """Void posts on about 40 × 40: single ones and rectangles, gathered near the tile lines or anywhere."""
    shape = draw(st.integers(20, 42)), draw(st.integers(20, 42))
    tile_size = draw(st.integers(8, 16))
    tiling = Tiling(*shape, tile_size, 1)
    is_void = np.zeros(shape, bool)
    for _ in range(draw(st.integers(1, 12))):
        window = []
        for axis, lines in enumerate((tiling.row_lines.tolist(), tiling.col_lines.tolist())):
            start = draw(st.sampled_from(lines) | st.integers(0, shape[axis] - 1)) + draw(st.integers(-3, 3))
            start = min(max(start, 0), shape[axis] - 1)
            window.append(slice(start, start + draw(st.sampled_from([1, 1, 2, 3, 9]))))
        is_void[tuple(window)] = True
    if draw(st.booleans()):
        is_void |= np.random.default_rng(draw(st.integers(0, 99))).random(shape) < draw(st.sampled_from([0.1, 0.4]))
    return is_void, tile_size


def judge_masked(folder, drawn, mode, fill):
    is_void, tile_size = drawn
    heights = np.where(is_void, np.nan, hilly(*is_void.shape))
    dem = write_dem(folder / "a.tif", heights)
    build_and_judge(dem, folder / "a.gpkg", tile_size=tile_size, fill=fill, **MODES[mode])


@settings(deadline=None, max_examples=15)
@given(masks(), st.sampled_from([*MODES]), st.booleans())
def test_random_voids(tmp_path_factory, drawn, mode, fill):
    judge_masked(tmp_path_factory.mktemp("voids"), drawn, mode, fill)


@pytest.mark.slow
@settings(deadline=None, max_examples=300)
@given(masks(), st.sampled_from([*MODES]), st.booleans())
def test_many_random_voids(tmp_path_factory, drawn, mode, fill):
    judge_masked(tmp_path_factory.mktemp("voids"), drawn, mode, fill)


# --- budgets ------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("tile_size", [100, 20])
def test_budgets_of_faces(tile_size, tmp_path):
    dem = crop(tmp_path / "nm.tif", slice(0, 41), slice(0, 51))
    budgets = (100, 400)
    report = build(dem, tmp_path / "a.gpkg", max_faces=budgets, tile_size=tile_size)
    judge_store(tmp_path / "a.gpkg", dem)
    bounds = [line.max_error_bound for line in report.levels]
    assert [row[1] for row in rows_of(tmp_path / "a.gpkg", "level")["level"]] == bounds
    assert all(line.faces <= budget for line, budget in zip(report.levels, budgets, strict=True))
    build(dem, tmp_path / "b.gpkg", max_error=bounds, tile_size=tile_size)
    assert rows_of(tmp_path / "a.gpkg") == rows_of(tmp_path / "b.gpkg")
    for level, budget in enumerate(budgets):
        tighter = [*bounds[:level], 0.98 * bounds[level]]
        faces = build(dem, tmp_path / f"{level}.gpkg", max_error=tighter, tile_size=tile_size).levels[-1].faces
        assert faces > budget, f"level {level}: {faces} faces hold {tighter[-1]} m, found {bounds[level]} m"


REFUSED = [((), "rising"), ((1,), "rising"), ((200, 100), "rising"), ((100, 100), "rising"), ((3,), "start grid")]


@pytest.mark.parametrize(("budgets", "message"), REFUSED)
def test_senseless_budgets_are_refused(budgets, message, tmp_path):
    dem = write_dem(tmp_path / "a.tif", hilly(20, 20))
    with pytest.raises(InputError, match=message):
        build(dem, tmp_path / "a.gpkg", max_faces=budgets, tile_size=10)
    with pytest.raises(InputError, match="only one"):
        build(dem, tmp_path / "a.gpkg", max_faces=(100,), passes=1)
    assert [path.name for path in tmp_path.iterdir()] == ["a.tif"]
