"""Cuts of mixed levels: no crack, no overlap, bounds held, heights that follow the eye; against searches of whole tables."""

from __future__ import annotations

import json
import math
import sqlite3
from functools import cached_property

import numpy as np
import pytest
import shapely
from conftest import slow_apart
from invariants_mesh import border_length, judge_mesh, total_area
from rasters import CELL
from surfaces import SOLID, VOIDS, hills, write_dem

import vpfx
from vpfx.cli import main
from vpfx.dem import read_grid
from vpfx.dem.reference import unit_metres
from vpfx.errors import InputError, NotFoundError, StoreFormatError
from vpfx.query.cut import MORPH, cut

KINDS = {
    "one tile": ("hills", {"max_error": (40, 20, 10, 5)}),
    "tiles": ("hills", {"max_error": (40, 20, 10, 5), "tile_size": 16}),
    "narrow steps": ("hills", {"max_error": (20, 15, 10, 7, 5), "tile_size": 30}),
    "one level": ("hills", {"max_error": (10,)}),
    "void tiles": ("void", {"passes": 2, "tile_size": 8}),
    "passes": ("hills", {"passes": 4}),
    "ternary": ("hills", {"method": "ternary", "passes": 4}),
    "cat": ("hills", {"method": "cat", "max_error": (40, 20, 8)}),
    "restricted_quadtree": ("hills", {"method": "restricted_quadtree", "max_error": (40, 20, 8)}),
}
LONG = ("passes", "cat", "restricted_quadtree")
FACTOR = 3.0
"""Q-340: faces of a cut by those of the least set of faces that holds the tolerance, cracks or not."""


class World:
    """A store, its levels and links in memory, and its posts."""

    def __init__(self, store, grid):
        self.store, self.grid = store, grid
        self.tins = [store.tin(level) for level in range(len(store.levels))]
        self.links = [store.links(level) for level in range(1, len(store.levels))]

    @cached_property
    def lineage(self):
        """Face of every level that each face of the last level comes from, int64 (n_face, n_level)."""
        columns = [self.tins[-1].face_attributes["face_id"]]
        for links in reversed(self.links):
            columns.append(dict(map(tuple, links[:, ::-1].tolist())))
            columns[-1] = np.array([columns[-1][face] for face in columns[-2].tolist()])
        return np.stack(columns[::-1], axis=1)

    @cached_property
    def corners(self):
        """Corners of every face of the store as they are stored, by id."""
        return {
            face: tin.nodes[nodes]
            for tin in self.tins
            for face, nodes in zip(tin.face_attributes["face_id"].tolist(), tin.face_nodes, strict=True)
        }

    def eyes(self):
        """Eyes over the ground, on it, and far away."""
        x0, y0, x1, y1 = self.store.extent
        size = x1 - x0
        top = float(np.nanmax(self.grid.heights))
        for x, y, z in ((0.3, 0.4, 5.0), (0.0, 0.0, 0.0), (1.8, 0.5, 300.0), (0.5, 0.5, 4000.0), (-0.1, 1.1, -500.0)):
            yield x0 + x * size, y0 + y * (y1 - y0), top + z


@pytest.fixture(scope="module", params=slow_apart(KINDS, LONG))
def world(request, tmp_path_factory):
    surface, options = KINDS[request.param]
    heights = {"hills": hills(32, 29), "void": VOIDS["ring with island"].heights}[surface]
    folder = tmp_path_factory.mktemp("cut")
    dem = write_dem(folder / "a.tif", heights)
    path = vpfx.build(dem, folder / "a.gpkg", **options).path
    with vpfx.open_store(path) as store:
        yield World(store, read_grid(dem))


def judge(world, found):
    """Judge a cut as a mesh, as a choice of faces, and by its errors."""
    faces, nodes = found.face_attributes, found.node_attributes
    last = world.tins[-1]
    border = judge_mesh(found.nodes, found.face_nodes)
    assert len(border.junctions) == len(border.long) == 0
    assert total_area(found.nodes[:, :2], found.face_nodes) == pytest.approx(
        total_area(last.nodes[:, :2], last.face_nodes), rel=1e-12
    )
    outline = judge_mesh(last.nodes, last.face_nodes).half
    assert border_length(found.nodes[:, :2], found.face_nodes, border.half) == pytest.approx(
        border_length(last.nodes[:, :2], last.face_nodes, outline), rel=1e-9
    )
    chosen = np.isin(world.lineage, faces["face_id"])
    assert (chosen.sum(axis=1) == 1).all()
    judge_pieces(world, found)
    judge_errors(world, found)
    assert ((nodes["weight"] >= 0) & (nodes["weight"] <= 1)).all()
    is_full = np.isin(np.arange(found.n_node), found.face_nodes[faces["level"] == 0]) & (nodes["level"] == 0)
    assert (nodes["weight"][is_full] == 1).all()
    return chosen.argmax(axis=1)


def shares_of(corner, places):
    """Shares of the corners of faces in places (n, …, 2), each from its own area."""
    a, b, c = (corner[:, i, :2] for i in range(3))
    whole = cross(b - a, c - a)
    if places.ndim == 3:
        a, b, c, whole = a[:, None], b[:, None], c[:, None], whole[:, None]
    return np.stack([cross(q - p, places - p) / whole for p, q in ((b, c), (c, a), (a, b))], axis=-1)


def cross(one, other):
    """Cross products in the plane."""
    return one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]


def judge_pieces(world, found):
    """Every face lies in the stored face it names, and pieces of one cover it."""
    ids, source = np.unique(found.face_attributes["face_id"], return_inverse=True)
    stored = np.array([world.corners[face] for face in ids.tolist()])[source]
    own = found.nodes[found.face_nodes]
    assert shares_of(stored, own[..., :2]).min() > -1e-9
    part = cross(*(own[:, i, :2] - own[:, 0, :2] for i in (1, 2))) / cross(
        *(stored[:, i, :2] - stored[:, 0, :2] for i in (1, 2))
    )
    np.testing.assert_allclose(np.bincount(source, part), 1.0, atol=1e-9)
    is_whole = ~found.face_attributes["is_stitched"]
    np.testing.assert_array_equal(own[is_whole, :, :2], stored[is_whole, :, :2])


def heights_at(found, places):
    """Face and height of a TIN at places, by GEOS; -1 and NaN where none is found."""
    corner = found.nodes[found.face_nodes]
    tree = shapely.STRtree(shapely.polygons(corner[:, [0, 1, 2, 0], :2]))
    place, at = tree.query(shapely.points(places), "intersects")
    face, z = np.full(len(places), -1), np.full(len(places), np.nan)
    face[place] = at
    z[place] = (shares_of(corner[at], places[place]) * corner[at, :, 2]).sum(axis=1)
    return face, z


def judge_errors(world, found):
    """No post is off by more than its face says, and no face that could be finer says more than is allowed."""
    faces, grid = found.face_attributes, world.grid
    row, col = np.nonzero(np.isfinite(grid.heights))
    places = np.stack([grid.x0 + col * grid.dx, grid.y0 + row * grid.dy], axis=1)
    face, z = heights_at(found, places)
    on = face >= 0
    assert on.mean() > 0.8
    error = np.abs(z - grid.heights[row, col])[on]
    assert (error <= faces["max_error"][face[on]] + 1e-6).all()
    judge_tolerance(world.store, faces)


def judge_tolerance(store, faces):
    """No face says more than is allowed, except that none says less than the last level can."""
    assert (faces["max_error"] <= np.maximum(faces["tolerance"], store.levels[-1].max_error)).all()


def fewest(world, tolerance_of):
    """Count the faces of the least set that covers the extent and holds the tolerance, cracks or not."""
    is_open, count = np.ones(len(world.lineage), bool), 0
    for level, line in enumerate(world.store.levels):
        ids = np.unique(world.lineage[is_open, level])
        corners = np.array([world.corners[face] for face in ids.tolist()]).reshape(-1, 3, 3)
        is_good = np.full(len(ids), level == len(world.tins) - 1) | (line.max_error <= tolerance_of(corners))
        count += int(is_good.sum())
        is_open &= ~np.isin(world.lineage[:, level], ids[is_good])
    return count


def judge_need(world, level, tolerance_of):
    """No face is refined unless one near it needs it (Q-320), or it has but one child."""
    errors = [line.max_error for line in world.store.levels]
    most = math.inf
    for k in reversed(range(len(errors) - 1)):
        tin = world.tins[k]
        ids, of_id = tin.face_attributes["face_id"], world.lineage[:, k]
        floor = errors[k] if k == len(errors) - 2 else max(errors[k], (1.0 + MORPH) * most)
        most = max(floor, (errors[k] + errors[k + 1] + (world.store.levels[k + 1].max_rise or 0.0)) / 2.0)
        needs = tolerance_of(tin.nodes[tin.face_nodes]) <= (1.0 + MORPH) * most * (1.0 + 1e-12)
        sides = {}
        for face, corner in enumerate(tin.face_nodes.tolist()):
            for i in range(3):
                sides.setdefault(frozenset((corner[i], corner[(i + 1) % 3])), []).append(face)
        pairs = np.array([pair for pair in sides.values() if len(pair) == 2]).reshape(-1, 2)
        for _ in range(len(errors) - 1 - k):
            spread = needs.copy()
            np.logical_or.at(spread, pairs[:, 0], needs[pairs[:, 1]])
            np.logical_or.at(spread, pairs[:, 1], needs[pairs[:, 0]])
            needs = spread
        parents, count = np.unique(world.links[k][:, 0], return_counts=True)
        is_refined = np.isin(ids, of_id[level > k])
        assert not (is_refined & ~needs).any()
        assert np.array_equal(parents, np.sort(ids))
        assert not (is_refined & ~needs & (count[np.argsort(np.argsort(ids))] > 1)).any()


def distances(world, eye, corners):
    """Distances from an eye to faces: in plan by GEOS, in height to the least and greatest height of any node."""
    plan = shapely.distance(shapely.Point(eye[:2]), shapely.polygons(corners[:, [0, 1, 2, 0], :2]))
    z = world.tins[0].nodes[:, 2]
    rise = sum(line.max_rise or 0.0 for line in world.store.levels)
    return np.hypot(plan, max(0.0, eye[2] - z.max() - rise, z.min() - rise - eye[2]))


def test_cuts_for_an_eye(world):
    for eye in world.eyes():
        before = None
        for screen_error in (1.0, 8.0, 40.0, 200.0):
            found = cut(world.store, eye, screen_error=screen_error)
            level = judge(world, found)
            share = screen_error * 2.0 * math.tan(math.radians(30.0)) / 1080
            np.testing.assert_allclose(
                found.face_attributes["tolerance"],
                share
                * distances(
                    world, eye, np.array([world.corners[f] for f in found.face_attributes["face_id"].tolist()])
                ),
                atol=1e-9,
            )
            assert before is None or (level <= before).all(), "coarser where more error is allowed"
            before = level
            assert found.n_face >= fewest(
                world, lambda corners, share=share, eye=eye: share * distances(world, eye, corners)
            )
            judge_need(world, level, lambda corners, share=share, eye=eye: share * distances(world, eye, corners))


def test_cuts_that_change_at_once(world):
    for eye in world.eyes():
        found = cut(world.store, eye, screen_error=30.0, morph=0.0)
        judge(world, found)
        assert set(np.unique(found.node_attributes["weight"])) <= {0.0, 1.0}
        assert found.n_face <= cut(world.store, eye, screen_error=30.0).n_face


def test_bounds_hold_for_eyes_anywhere(world):
    rng = np.random.default_rng(1)
    x0, y0, x1, y1 = world.store.extent
    for i in range(60):
        eye = (*rng.uniform((x0, y0), (x1, y1)), rng.uniform(-60.0, 100.0))
        found = cut(world.store, eye, screen_error=10 ** rng.uniform(0.5, 2.8), morph=(0.25, 0.0, 0.05)[i % 3])
        judge_tolerance(world.store, found.face_attributes)
        judge_planes(found)


def judge_planes(found):
    """Pieces of one stored face lie in one plane: the nodes of finer levels there are on its edges."""
    source = np.unique(found.face_attributes["face_id"], return_inverse=True)[1]
    corner = found.nodes[found.face_nodes]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    slope = normal[:, :2] / normal[:, 2:]
    first = np.unique(source, return_index=True)[1]
    drift = np.abs(slope - slope[first][source]).max(axis=1, initial=0.0)
    size = np.ptp(corner[..., :2], axis=1).min(axis=1, initial=np.inf)
    assert (drift * size <= 1e-6).all()


def test_cuts_for_a_focus(world):
    x0, y0, x1, y1 = world.store.extent
    size = x1 - x0
    corner = shapely.box(x0, y0, x0 + size / 4, y0 + size / 4)
    ring = (
        shapely.Point((x0 + x1) / 2, (y0 + y1) / 2).buffer(size / 3).difference(shapely.box(x0, y0, x1, y0 + size / 2))
    )
    for focus in (None, corner, ring):
        for error in (5.0, 12.0, 1e6):
            for growth in (math.inf, 0.2):
                found = cut(world.store, error=error, focus=focus, growth=growth)
                judge(world, found)
    last, line = len(world.tins) - 1, world.store.levels[-1]
    whole = cut(world.store, error=line.max_error)
    if all(other.max_error > line.max_error for other in world.store.levels[:-1]):
        np.testing.assert_array_equal(
            np.sort(whole.face_attributes["face_id"]), world.tins[last].face_attributes["face_id"]
        )
    coarse = cut(world.store, error=1e6)
    assert coarse.n_face == world.tins[0].n_face


def test_each_face_as_a_focus(world):
    """A focus that just touches nodes and edges: rounding must not let a face be nearer than its parent."""
    rng = np.random.default_rng(7)
    for level in range(1, len(world.tins)):
        faces = world.tins[level].face_attributes["face_id"].tolist()
        for face in rng.permutation(faces)[:12].tolist():
            focus = shapely.Polygon(world.corners[face][:, :2])
            judge(world, cut(world.store, error=0.0, focus=focus))


def test_eyes_far_away(world):
    x0, y0 = world.store.extent[:2]
    for eye in ((1e25, y0, 0.0), (x0, y0, 1e308), (-1e300, 1e300, -1e300)):
        assert cut(world.store, eye).n_face == world.tins[0].n_face
    near = cut(world.store, (x0, y0, 0.0), screen_error=1e-320, fov=1e-320)
    assert (near.face_attributes["level"] == len(world.tins) - 1).all()


def test_whole_levels_are_as_stored(world):
    """Near enough and far enough a cut is a level, node by node."""
    x0, y0, x1, y1 = world.store.extent
    near = cut(world.store, ((x0 + x1) / 2, (y0 + y1) / 2, 0.0), screen_error=1e-3)
    for found, tin in ((near, world.tins[-1]), (cut(world.store, (x0, y0, 1e9)), world.tins[0])):
        order = np.argsort(found.face_attributes["face_id"])
        np.testing.assert_array_equal(found.face_attributes["face_id"][order], tin.face_attributes["face_id"])
        if found is near:
            np.testing.assert_allclose(found.nodes[found.face_nodes[order]], tin.nodes[tin.face_nodes], atol=1e-9)


@pytest.mark.parametrize("morph", [MORPH, 1.0])
def test_heights_follow_a_moving_eye(world, morph):
    """Along a flight heights change at most as fast as weights may, however short the steps."""
    store, screen_error = world.store, 60.0
    x0, y0, x1, y1 = store.extent
    places = np.random.default_rng(5).uniform((x0, y0), (x1, y1), (60, 2))
    share = screen_error * 2.0 * math.tan(math.radians(30.0)) / 1080
    rises = [(line.max_rise or 0.0) for line in store.levels[1:]]
    errors = [line.max_error for line in store.levels[:-1]]
    fastest = max((rise * share / (morph * error) for rise, error in zip(rises, errors, strict=True)), default=0.0)
    start, way = np.array([x0 - 100.0, y0 + 40.0, 60.0]), np.array([0.8, 0.55, 0.2])
    for step in (40.0, 1e-3):
        before = None
        for i in range(16):
            found = cut(
                store,
                start + (700.0 if step < 1 else 0.0) * way + i * step * way,
                screen_error=screen_error,
                morph=morph,
            )
            _, z = heights_at(found, places)
            assert before is None or np.nanmax(np.abs(z - before)) <= fastest * step * 1.01 + 1e-9
            before = z


def test_few_faces_on_real_ground(tmp_path):
    """The New Mexico cell in tiles, eyes over a mesa and beyond: few more faces than any set that holds the tolerance."""
    path = vpfx.build(CELL, tmp_path / "a.gpkg", max_error=(40, 20, 10, 5), tile_size=128).path
    with vpfx.open_store(path) as store:
        world = World(store, read_grid(CELL))
        x0, y0, x1, y1 = store.extent
        width, height = unit_metres(store.crs, store.extent)
        rise = sum(line.max_rise or 0.0 for line in store.levels)
        z = world.tins[0].nodes[:, 2]
        for x, y, top in ((0.3, 0.4, 2300.0), (-1.0, 0.4, 2600.0), (0.5, 0.4, 3500.0)):
            eye = x0 + x * (x1 - x0), y0 + y * (y1 - y0), top
            for screen_error in (2.0, 8.0, 20.0):
                share = screen_error * 2.0 * math.tan(math.radians(30.0)) / 1080

                def tolerance_of(corners, eye=eye, share=share):
                    to = (corners[:, [0, 1, 2, 0], :2] - eye[:2]) * (width, height)
                    above = max(0.0, eye[2] - z.max() - rise, z.min() - rise - eye[2])
                    return share * np.hypot(shapely.distance(shapely.Point(0, 0), shapely.polygons(to)), above)

                found = cut(store, eye, screen_error=screen_error)
                judge_tolerance(store, found.face_attributes)
                assert len(judge_mesh(found.nodes, found.face_nodes).junctions) == 0
                least = fewest(world, tolerance_of)
                assert least <= found.n_face <= FACTOR * least
                assert least <= cut(store, eye, screen_error=screen_error, morph=0.0).n_face <= FACTOR / 1.5 * least


def test_part_of_the_tiles(tmp_path):
    path = vpfx.build(
        write_dem(tmp_path / "a.tif", hills(40, 36)), tmp_path / "a.gpkg", max_error=(40, 20, 5), tile_size=16
    ).path
    with vpfx.open_store(path) as store:
        x0, y0, x1, _ = store.extent
        tiles = store.tiles((x0, y0, x0 + 10, y0 + 10))
        found = cut(store, (x0, y0, 100.0), bbox=(x0, y0, x0 + 10, y0 + 10))
        assert set(found.face_attributes["tile_id"]) == set(tiles["tile_id"].tolist())
        assert found.nodes[:, 0].max() == tiles["xmax"].max()
        assert cut(store, error=5.0, bbox=(x1 + 1, y0, x1 + 2, y0 + 1)).n_face == 0


def test_reads_what_it_returns(tmp_path, monkeypatch):
    """Rows read grow with the faces returned, not with the store."""
    dem = write_dem(tmp_path / "a.tif", hills(120, 120))
    path = vpfx.build(dem, tmp_path / "a.gpkg", max_error=(60, 30, 15, 8, 4), tile_size=20).path
    with vpfx.open_store(path) as store:
        read = []
        rows = store._reader.rows
        monkeypatch.setattr(store._reader, "rows", lambda *given: read.append(rows(*given)) or read[-1])
        x0, y0, *_ = store.extent
        shares = []
        for screen_error in (3.0, 10.0, 30.0):
            read.clear()
            found = cut(store, (x0, y0, 100.0), screen_error=screen_error)
            shares.append(sum(len(next(iter(part.values()))) for part in read) / found.n_face)
            tiles = {
                tile for part in read if "face_id" in part for tile in part["tile_id"][part["level"] == 4].tolist()
            }
        assert max(shares) < 6.0
        assert len(tiles) < len(store.tiles()["tile_id"])


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "expected one of the two"),
        ({"eye": (0, 0, 0), "error": 3.0}, "expected one of the two"),
        ({"eye": (0, 0)}, "eye: found .*expected x, y and z"),
        ({"eye": (0, 0, math.nan)}, "eye: found"),
        ({"eye": (0, 0, 0), "screen_error": 0.0}, "screen error and a height above 0"),
        ({"eye": (0, 0, 0), "fov": 180.0}, "field of view"),
        ({"eye": (0, 0, 0), "screen_height": 0}, "a height above 0"),
        ({"eye": (0, 0, 0), "morph": -0.1}, "morph: found -0.1"),
        ({"error": -1.0}, "error of -1.0 m"),
        ({"error": math.nan}, "error of nan m"),
        ({"error": 1.0, "growth": 0.0}, "growth above 0"),
        ({"error": 1.0, "focus": shapely.Point(0, 0)}, "focus: found POINT"),
        ({"error": 1.0, "focus": shapely.Polygon([(0, 0), (1, 1), (1, 0), (0, 1)])}, "focus: found POLYGON"),
        ({"error": 1.0, "bbox": (1, 0, 0, 1)}, "bbox: found"),
        ({"error": 1.0, "bbox": "abcd"}, "bbox: found"),
        ({"error": 1.0, "bbox": 5}, "bbox: found"),
        ({"error": "a"}, "error of a m"),
        ({"eye": "abc"}, "eye: found abc"),
        ({"eye": (0, 0, 0), "morph": "a"}, "morph: found a"),
        ({"eye": (0, 0, 0), "screen_height": math.inf}, "found 2.0 pixels"),
        ({"eye": (0, 0, 0), "focus": shapely.box(0, 0, 1, 1)}, "an eye and a focus"),
        ({"eye": (0, 0, 0), "growth": 2.0}, "an eye and a focus or growth"),
    ],
)
def test_wrong_input_is_told(given, message, world):
    with pytest.raises(InputError, match=message):
        cut(world.store, **given)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "delaunay_pyramid", "max_error": (20, 8)}, "found levels that are not nested"),
        ({"method": "scarlatos", "passes": 3}, "found T-junctions"),
    ],
)
def test_levels_that_cannot_be_cut_are_refused(options, message, tmp_path):
    path = vpfx.build(write_dem(tmp_path / "a.tif", SOLID["cliff"].heights), tmp_path / "a.gpkg", **options).path
    with vpfx.open_store(path) as store, pytest.raises(InputError, match=message):
        cut(store, error=1.0)


def test_broken_links_are_told(tmp_path):
    path = vpfx.build(write_dem(tmp_path / "a.tif", hills(20, 20)), tmp_path / "a.gpkg", max_error=(40, 10)).path
    with sqlite3.connect(path) as other:
        other.execute("DELETE FROM parent_child WHERE parent_face = 1")
    with vpfx.open_store(path) as store, pytest.raises(StoreFormatError, match="found a face without children"):
        cut(store, error=10.0)
    with sqlite3.connect(path) as other:
        other.execute("INSERT INTO parent_child SELECT 99999999, 1")
    with vpfx.open_store(path) as store, pytest.raises(NotFoundError, match="found no face 99999999"):
        cut(store, error=10.0)


def test_the_command(tmp_path, capsys):
    """Counts by level are those of the function, the file holds all faces, and what is wrong is one line."""
    path = vpfx.build(CELL, tmp_path / "a.gpkg", max_error=(40, 20, 10)).path
    box = "POLYGON ((-107.64 36.36, -107.62 36.36, -107.62 36.38, -107.64 36.36))"
    with vpfx.open_store(path) as store:
        focus = shapely.from_wkt(box)
        expected = {("--error", "10", "--polygon", box): store.cut(error=10.0, focus=focus)}
        expected["--eye=-107.62,36.37,2600", "--screen-error", "20"] = store.cut(
            (-107.62, 36.37, 2600.0), screen_error=20.0
        )
    for arguments, tin in expected.items():
        output = tmp_path / "cut.geojson"
        with pytest.raises(SystemExit, match="0"):
            main(["query", "cut", str(path), *arguments, "--json", "-o", str(output), "--overwrite"])
        told = json.loads(capsys.readouterr().out.splitlines()[0])
        assert told["faces"] == tin.n_face
        counts = np.bincount(tin.face_attributes["level"], minlength=3)
        assert [line["faces"] for line in told["levels"]] == counts.tolist()
        assert len(json.loads(output.read_text())["features"]) == tin.n_face
        with pytest.raises(SystemExit, match="0"):
            main(["query", "cut", str(path), *arguments])
        assert [line.split()[1] for line in capsys.readouterr().out.splitlines()[1:4]] == [f"{n:,}" for n in counts]
    wrong = {(): 2, ("--eye=1,2",): 2, ("--error", "1", "--eye=1,2,3"): 2, ("--eye=1,2,3", "--polygon", box): 2,
             ("--error", "1", "-o", str(path)): 2, ("--error", "1", "-o", str(output)): 3}  # fmt: skip
    for arguments, code in wrong.items():
        with pytest.raises(SystemExit, match=str(code)):
            main(["query", "cut", str(path), *arguments])
        assert capsys.readouterr().err.count("\n") == 1
