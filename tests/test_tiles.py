"""Stores of many tiles: the same bytes from any number of workers, borders decided by their own posts, voids anywhere."""

from __future__ import annotations

import hashlib
import itertools
import math
import sqlite3
import struct
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from conftest import slow_apart
from hypothesis import given, settings
from hypothesis import strategies as st
from invariants import judge_store
from surfaces import hills, noise, query, write_dem
from test_methods import CASES

from vpfx.dem import read_grid
from vpfx.errors import InputError, VpfxError
from vpfx.methods import METHODS
from vpfx.pipeline import build
from vpfx.store.digest import Digest, read_digest
from vpfx.store.records import NULL_INT
from vpfx.store.tiles import Tiling

CELL = Path(__file__).resolve().parents[1] / "fixtures" / "dem" / "new_mexico_cell_5min_1arcsec.tif"
STEP = 1 / 3600
ROWS = ("level", "tile", "tile_level", "node", "edge", "face", "parent_child", "shared_area", "t_junction")
MODES = {
    "bounded": {"max_error": (40.0, 15.0)},
    "fitted": {"max_error": (40.0, 15.0), "fit": "max-error"},
    "fitted for rmse": {"max_error": (40.0, 15.0), "fit": "rmse"},
    "passes": {"passes": 2, "tolerance": 2.0, "grid": (2, 1)},
    "ternary": {"method": "ternary", "passes": 2},
    "pyramid": {"method": "delaunay_pyramid", "max_error": (40.0, 15.0)},
    "pyramid, passes": {"method": "delaunay_pyramid", "passes": 2, "tolerance": 2.0, "grid": (2, 1)},
    "delaunay": {"passes": 1, "start": "delaunay", "start_posts": 10, "diagonal": "random"},
}
LONG = ("fitted for rmse", "pyramid, passes", "ternary")
EVERY = slow_apart(MODES, LONG)


def crop(path, rows=slice(0, 90), cols=slice(0, 120), **options):
    """Write some posts of the New Mexico cell, in their places."""
    grid = read_grid(CELL)
    place = {"x0": grid.x0 + cols.start * STEP, "y0": grid.y0 + rows.start * STEP, "step": STEP, "crs": "EPSG:4269"}
    return write_dem(path, grid.heights[rows, cols], **place, **options)


def rows_of(path, *tables):
    """All rows of some tables, in order; of nearly all if none are named."""
    return {table: sorted(query(path, f"SELECT * FROM {table}")) for table in tables or ROWS}


def build_and_judge(dems, output, **options):
    report = build(dems, output, overwrite=True, workers=1, **options)
    judge_store(output, dems)
    return report


# --- any cut, any workers, any files -------------------------------------------------------------------------------------


@pytest.mark.parametrize("tile_size", slow_apart([17, 32, 1000], [32]))
@pytest.mark.parametrize("mode", EVERY)
def test_terrain_in_tiles(mode, tile_size, tmp_path):
    dem = crop(tmp_path / "nm.tif")
    report = build_and_judge(dem, tmp_path / "nm.gpkg", tile_size=tile_size, **MODES[mode])
    assert report.tiles == {17: 6 * 7, 32: 3 * 4, 1000: 1}[tile_size]
    assert [line.faces for line in report.levels] == sorted(line.faces for line in report.levels)


@pytest.mark.parametrize("mode", EVERY)
def test_any_number_of_workers_gives_the_same_bytes(mode, tmp_path):
    dem = crop(tmp_path / "nm.tif")
    stores = []
    for i, workers in enumerate((1, 2, 50)):
        build(dem, tmp_path / f"{i}.gpkg", workers=workers, tile_size=17, seed=3, **MODES[mode])
        stores.append((tmp_path / f"{i}.gpkg").read_bytes())
    assert all(store == stores[0] for store in stores[1:])


@pytest.mark.parametrize("cut", slow_apart([46, 45, 13], [45]))
@pytest.mark.parametrize("mode", EVERY)
def test_two_files_give_what_their_mosaic_gives(mode, cut, tmp_path):
    """The files share a row of posts, which lies on a tile border or not."""
    whole = crop(tmp_path / "whole.tif", slice(0, 91))
    parts = [crop(tmp_path / "a.tif", slice(0, cut + 1)), crop(tmp_path / "b.tif", slice(cut, 91))]
    build(whole, tmp_path / "whole.gpkg", tile_size=30, **MODES[mode])
    build(parts, tmp_path / "parts.gpkg", tile_size=30, **MODES[mode])
    assert rows_of(tmp_path / "whole.gpkg") == rows_of(tmp_path / "parts.gpkg")
    assert len(rows_of(tmp_path / "parts.gpkg", "source")["source"]) == 2


@pytest.mark.parametrize("case", CASES)
def test_every_method_writes_a_store(case, tmp_path):
    case, dem, n_junction = CASES[case], crop(tmp_path / "nm.tif", slice(0, 60), slice(0, 50)), 0
    for mode in ({"passes": 3, "tolerance": 10.0}, {"max_error": (40.0, 15.0)})[: 1 + case.bounded]:
        report = build_and_judge(dem, tmp_path / "nm.gpkg", method=case.method, tile_size=32, **mode, **case.options)
        assert report.tiles == (4 if case.tiled else 1)
        n_junction += len(rows_of(tmp_path / "nm.gpkg", "t_junction")["t_junction"])
        cuts = dict(query(tmp_path / "nm.gpkg", "SELECT kind, sum(cut_count) FROM level_cut GROUP BY kind"))
        assert {kind for kind, count in cuts.items() if count} <= set(METHODS[case.method].cuts)
    assert (n_junction == 0) == case.adjacent


def test_one_tile_numbers_from_one(tmp_path):
    heights = hills(30, 40)
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


# --- borders ----------------------------------------------------------------------------------------------------------------


def border_nodes(path, lines):
    """Nodes on inner tile lines with the level at which they appear."""
    found = set()
    for level, x, y, z in sorted(row[2:6] for row in rows_of(path, "node")["node"]):
        if round((x - 5e5) / 30, 6) in lines[1] or round((y - 4e6) / 30, 6) in lines[0]:
            found.add((level, x, y, z))
    return found


@pytest.mark.parametrize("mode", EVERY)
def test_borders_are_decided_by_their_own_posts(mode, tmp_path):
    tiling = Tiling(40, 50, 13, 2)
    lines = tiling.row_lines.tolist(), tiling.col_lines.tolist()
    heights = hills(40, 50)
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
    assert {level for level, *_ in found[0]} == ({0} if mode == "ternary" else set(range(2 + ("passes" in mode))))
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


@pytest.mark.parametrize("fill", slow_apart([False, True], [True]), ids=["open", "filled"])
@pytest.mark.parametrize("name", WINDOWS)
def test_voids_beside_borders(name, fill, tmp_path):
    heights = hills(33, 33)
    heights[WINDOWS[name]] = np.nan
    dem = write_dem(tmp_path / "a.tif", heights)
    report = build_and_judge(dem, tmp_path / "a.gpkg", tile_size=8, fill=fill, max_error=(20.0, 9.0))
    assert report.ground.void_posts == np.isnan(heights).sum()
    assert query(tmp_path / "a.gpkg", "SELECT max(is_filled) FROM face") == [(int(fill),)]


@pytest.mark.parametrize("name", WINDOWS)
def test_filled_voids_keep_to_the_heights_around(name, tmp_path):
    """No height of a filled store is beyond those of the posts."""
    heights = hills(33, 33)
    heights[WINDOWS[name]] = np.nan
    dem = write_dem(tmp_path / "a.tif", heights)
    build(dem, tmp_path / "a.gpkg", tile_size=8, fill=True, passes=1)
    z = np.array([row[5] for row in rows_of(tmp_path / "a.gpkg", "node")["node"]])
    assert np.nanmin(heights) - 1e-4 <= z.min() <= z.max() <= np.nanmax(heights) + 1e-4


@pytest.mark.parametrize("tile_size", [8, 100])
def test_posts_that_span_no_ground_can_be_filled(tile_size, tmp_path):
    """All faces are marked, and no error was measured."""
    heights = np.full((20, 20), np.nan)
    heights[::2, ::2] = noise(10, 10)
    dem = write_dem(tmp_path / "a.tif", heights)
    report = build_and_judge(dem, tmp_path / "a.gpkg", tile_size=tile_size, fill=True, **MODES["bounded"])
    assert report.ground.isolated_posts == 100
    assert query(tmp_path / "a.gpkg", "SELECT min(is_filled), count(*) > 0 FROM face") == [(1, 1)]
    assert query(tmp_path / "a.gpkg", "SELECT max_error, rmse, post_count FROM level") == [(0.0, 0.0, 0)] * 2


@pytest.mark.parametrize("mode", [*MODES, "budgets"])
@pytest.mark.parametrize("tile_size", [8, 100])
@pytest.mark.parametrize(("fill", "message"), [(True, "no valid post in the DEM"), (False, "no ground with data")])
def test_nothing_but_voids_is_refused(fill, message, tile_size, mode, tmp_path):
    dem = write_dem(tmp_path / "a.tif", np.full((20, 20), np.nan))
    with pytest.raises(InputError, match=f"found {message}, expected"):
        build(dem, tmp_path / "a.gpkg", tile_size=tile_size, fill=fill, **MODES.get(mode, {"max_faces": (100, 300)}))
    assert [path.name for path in tmp_path.iterdir()] == ["a.tif"]


def test_filling_starts_from_rows_of_tile_borders(tmp_path):
    heights = np.full((20, 20), np.nan)
    heights[3:5, 6] = 5.0
    dem = write_dem(tmp_path / "a.tif", heights)
    with pytest.raises(InputError, match=r"found no valid post on rows of tile borders, .*--tile-size"):
        build(dem, tmp_path / "a.gpkg", tile_size=8, fill=True, passes=1)
    assert build_and_judge(dem, tmp_path / "a.gpkg", tile_size=20, fill=True, passes=1).levels[1].faces == 2


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
    heights = np.where(is_void, np.nan, hills(*is_void.shape))
    dem = write_dem(folder / "a.tif", heights)
    build_and_judge(dem, folder / "a.gpkg", tile_size=tile_size, fill=fill, **MODES[mode])


@settings(deadline=None, max_examples=8)
@given(masks(), st.sampled_from([*MODES]), st.booleans())
def test_random_voids(tmp_path_factory, drawn, mode, fill):
    judge_masked(tmp_path_factory.mktemp("voids"), drawn, mode, fill)


@pytest.mark.slow
@settings(deadline=None, max_examples=100)
@given(masks(), st.sampled_from([*MODES]), st.booleans())
def test_many_random_voids(tmp_path_factory, drawn, mode, fill):
    judge_masked(tmp_path_factory.mktemp("voids"), drawn, mode, fill)


# --- digests ------------------------------------------------------------------------------------------------------------------


def pierced():
    """Hills with voids that cross and touch tile borders."""
    heights = hills(41, 50)
    for void in (np.s_[10:20, 14:19], np.s_[5, 25:40], np.s_[27:30, 30:33]):
        heights[void] = np.nan
    return heights


@pytest.fixture(scope="module")
def pierced_store(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pierced")
    build(write_dem(folder / "a.tif", pierced()), folder / "a.gpkg", max_error=(20.0, 8.0), tile_size=16)
    return folder / "a.gpkg"


def border_digest(connection, level):
    """BLAKE2b over the columns of the border nodes that are new at a level and of its border edges."""
    digest = hashlib.blake2b(digest_size=16)
    first = "SELECT ifnull(min(first_{0}), 1 << 60) FROM tile_level"
    nodes = f"SELECT * FROM node WHERE level = ? AND node_id < ({first.format('node')}) ORDER BY node_id"
    edges = f"SELECT * FROM edge WHERE level = ? AND edge_id < ({first.format('edge')}) ORDER BY edge_id"
    for sql in (nodes, edges):
        rows = connection.execute(sql, (level,))
        names = [column[0] for column in rows.description]
        for name, column in zip(names, zip(*rows, strict=True), strict=False):
            digest.update(column_bytes(column, name == "z_parent"))
    return digest.digest()


def column_bytes(column, is_real=False):
    """What R-140 says goes in for a column."""
    if isinstance(column[0], bytes):
        return b"".join(column)
    if is_real or isinstance(column[0], float):
        column = [math.nan if value is None else value for value in column]
        return struct.pack(f"<{len(column)}d", *column)
    is_short = all(value is None or -(2**31) < value < 2**31 for value in column)
    null, code = (-(2**31), "i") if is_short else (-(2**63), "q")
    return struct.pack(f"<{len(column)}{code}", *(null if value is None else value for value in column))


@pytest.mark.parametrize(
    "column", [[0, -1, None], [2**31 - 1, 1 - 2**31], [2**31, None], [-(2**31)], [2**62, 0]], ids=str
)
def test_width_of_integers_in_digests(column):
    digest = Digest()
    digest.add([np.array([NULL_INT if value is None else value for value in column])])
    assert digest.value() == hashlib.blake2b(column_bytes(column), digest_size=16).digest()


def digests_of(connection):
    """Digests of all tiles and levels and of the borders, computed anew."""
    pairs = connection.execute("SELECT tile_id, level FROM tile_level ORDER BY 1, 2").fetchall()
    levels = [level for (level,) in connection.execute("SELECT level FROM level ORDER BY 1").fetchall()]
    return [read_digest(connection, *p) for p in pairs], [border_digest(connection, level) for level in levels]


def stored_digests(connection):
    tiles = connection.execute("SELECT digest FROM tile_level ORDER BY tile_id, level").fetchall()
    levels = connection.execute("SELECT border_digest FROM level ORDER BY level").fetchall()
    return [row[0] for row in tiles], [row[0] for row in levels]


@pytest.mark.parametrize("options", [{}, {"fill": True}, {"tile_size": 100}, {"tile_size": 8, "passes": 1}], ids=str)
def test_digests_are_those_of_the_rows(options, tmp_path):
    mode = {} if "passes" in options else {"max_error": (20.0, 8.0)}
    build(write_dem(tmp_path / "a.tif", pierced()), tmp_path / "a.gpkg", **{"tile_size": 16, **mode, **options})
    with closing(sqlite3.connect(tmp_path / "a.gpkg")) as connection:
        stored = stored_digests(connection)
        assert stored == digests_of(connection)
        assert all(len(digest) == 16 for digest in itertools.chain(*stored))


CHANGES = {
    "next": lambda v: {
        int: lambda: v + 1,
        float: lambda: math.nextafter(v, 1e9),
        bytes: lambda: v[:-1] + bytes([v[-1] ^ 1]),
    },
    "negative": lambda v: {int: lambda: -1 - v, float: lambda: -1.0 - v, bytes: lambda: v[1:] + v[:1]},
    "half": lambda v: {int: lambda: v + 0.5, float: lambda: v / 2 + 0.5, bytes: lambda: v[:12]},
    "text": lambda v: dict.fromkeys((int, float, bytes), lambda: f"{v!r} m"),
    "other type": lambda v: {int: lambda: b"\0", float: lambda: b"\0", bytes: lambda: 5},
}


@settings(deadline=None, max_examples=150)
@given(
    st.sampled_from(["node", "edge", "face", "parent_child"]),
    st.integers(0, 10**6),
    st.integers(0, 20),
    st.sampled_from([*CHANGES]),
)
def test_digests_notice_any_changed_value(pierced_store, table, row, column, change):
    with closing(sqlite3.connect(pierced_store)) as connection:
        names = [info[1] for info in connection.execute(f"PRAGMA table_info({table})")]
        keys = ["child_face", "parent_face"] if table == "parent_child" else [f"{table}_id"]
        rows = connection.execute(f"SELECT {', '.join(names)} FROM {table}").fetchall()
        row, column = rows[row % len(rows)], column % len(names)
        old = row[column] if row[column] is not None else 0
        if names[column] in keys and change != "next":
            return  # SQLite refuses what is no integer
        new = old + 10**9 if names[column] in keys else CHANGES[change](old)[type(old)]()
        where = " AND ".join(f"{key} = ?" for key in keys)
        values = [new, *(row[names.index(key)] for key in keys)]
        connection.execute(f"UPDATE {table} SET {names[column]} = ? WHERE {where}", values)
        try:
            found = digests_of(connection)
        except (VpfxError, TypeError, struct.error):  # found out too
            found = None
        assert found != stored_digests(connection), f"{table} {values[1:]}: {names[column]} {old!r} → {new!r}"
        connection.rollback()
