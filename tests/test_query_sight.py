"""Sight against every face under every ray."""

from __future__ import annotations

import json
import math
from fractions import Fraction

import numpy as np
import pytest
import shapely
from rasters import CELL
from small_stores import MOST, ask, build_kind
from surfaces import write_dem

import vpfx
from vpfx.errors import InputError, NotFoundError
from vpfx.query.lines import profile
from vpfx.query.location import locate
from vpfx.query.sight import _blocked, line_of_sight, viewshed, walk

BLOCKED, SEEN = 1e-5, 1e-7
"""Metres of ground above a ray: more is surely blocked, less is surely seen."""


@pytest.fixture(scope="module", params=MOST)
def store(request, tmp_path_factory):
    with vpfx.open_store(build_kind(request.param, tmp_path_factory.mktemp("sight"))) as opened:
        yield opened


def by_looking(tin, eye, end):
    """Most ground above a ray, and the share at which it is first above; faces are cut by GEOS, planes solved."""
    ray = shapely.LineString([eye[:2], end[:2]])
    faces = shapely.polygons(tin.nodes[tin.face_nodes, :2])
    most, first = -math.inf, math.inf
    for face in np.flatnonzero(shapely.intersects(ray, faces)):
        part = shapely.get_coordinates(shapely.intersection(ray, faces[face]))
        corners = tin.nodes[tin.face_nodes[face]]
        origin = corners[0]
        rise = np.linalg.solve((corners[1:] - origin)[:, :2], (corners[1:] - origin)[:, 2])
        shares = np.clip(np.hypot(*(part - eye[:2]).T) / ray.length, 1e-7, 1 - 1e-7)
        low, high = min(shares), max(shares)
        if low == high and (low <= 1e-7 or high >= 1 - 1e-7):
            continue
        gaps = []
        for share in (low, high):
            place = eye + share * (end - eye)
            gaps.append(float(origin[2] + (place[:2] - origin[:2]) @ rise - place[2]))
        most = max(most, *gaps)
        if max(gaps) > BLOCKED:
            at = low if gaps[0] > 0 else low + (high - low) * -gaps[0] / (gaps[1] - gaps[0])
            first = min(first, at)
    return most, first


def exactly(tin, observer, end):
    """Most ground above a ray, in exact numbers: over each face, where the ray meets its corners and edges."""
    start, goal = ([Fraction(float(value)) for value in place] for place in (observer, end))
    way = [b - a for a, b in zip(start, goal, strict=True)]
    most = Fraction(-(10**9))
    for corners in tin.nodes[tin.face_nodes].tolist():
        corners = [[Fraction(p) - s for p, s in zip(corner, start, strict=True)] for corner in corners]
        side = [way[0] * y - way[1] * x for x, y, _ in corners]
        met = []
        for i, j in ((0, 1), (1, 2), (2, 0)):
            if side[i] * side[j] < 0 or side[i] == 0:
                share = side[i] / (side[i] - side[j]) if side[i] else 0
                x, y, z = (p + share * (q - p) for p, q in zip(corners[i], corners[j], strict=True))
                met.append(((x * way[0] + y * way[1]) / (way[0] ** 2 + way[1] ** 2), z))
        (low, z_low), (high, z_high) = (min(met), max(met)) if met else ((2, 0), (2, 0))
        if low >= 1 or high <= 0:
            continue
        rise = (z_high - z_low) / (high - low) if high > low else 0
        most = max(most, *(z_low + rise * (at - low) - at * way[2] for at in (max(low, 0), min(high, 1))))
    return most


@pytest.mark.parametrize("seed", range(12))
def test_rays_through_nodes_along_edges_and_over_voids(seed):
    """On a lattice with faces left out nearly every ray meets nodes, edges and corners of voids."""
    rng = np.random.default_rng(seed)
    n, step = 7, (1.0, 30.0, 1 / 3)[seed % 3]
    row, col = np.indices((n, n))
    place = np.column_stack([col.ravel(), row.ravel()]) * step + (0.0, 5e5, 0.1)[seed % 4 % 3]
    nodes = np.column_stack([place, rng.integers(0, 4, n * n)])
    a = (row * n + col)[:-1, :-1][rng.random((n - 1, n - 1)) > 0.15]
    rising, falling = np.split(rng.permutation(a), [len(a) // 2])
    corners = [(rising, 0, 1, n + 1), (rising, 0, n + 1, n), (falling, 0, 1, n), (falling, 1, n + 1, n)]
    tin = vpfx.Tin(nodes, np.concatenate([np.stack([at + i for i in ijk], axis=1) for at, *ijk in corners]))
    own = rng.integers(n * n)
    observer = nodes[own] + np.array([0, 0, rng.integers(4)])
    ends = np.delete(nodes + rng.integers(0, 4, (n * n, 1)) * np.array([0, 0, 1]), own, axis=0)
    share = _blocked(tin, observer, ends, (0.0, 0.0), is_first=True)
    np.testing.assert_array_equal(np.isinf(share), np.isinf(_blocked(tin, observer, ends, (0.0, 0.0), is_first=False)))
    for end, is_visible in zip(ends, np.isinf(share), strict=True):
        most = exactly(tin, observer, end)
        assert is_visible == (most < 1e-6)
        assert not 1e-9 < most < 1e-3


def places(store, level, rng, n):
    """Places with ground: anywhere, at nodes and on edges."""
    tin = store.tin(level)
    nodes = tin.nodes[rng.choice(tin.n_node, n), :2]
    middles = tin.nodes[tin.face_nodes[rng.choice(tin.n_face, n), :2], :2].mean(axis=1)
    anywhere = rng.uniform(store.extent[:2], store.extent[2:], (4 * n, 2))
    anywhere = anywhere[locate(store, anywhere, level).face_ids > 0][:n]
    found = np.concatenate([nodes, middles, anywhere])
    return found[locate(store, found, level).face_ids > 0]


def test_targets_are_seen_or_blocked(store):
    rng = np.random.default_rng(11)
    unsure = total = 0
    for level in (0, len(store.levels) - 1):
        tin = store.tin(level)
        targets = places(store, level, rng, 9)
        heights = np.where(np.arange(len(targets)) % 3 == 0, 0.0, rng.uniform(0, 15, len(targets)))
        for xy, height in zip(places(store, level, rng, 1), (0.5, 5, 20), strict=False):
            ends = np.column_stack([targets, heights])
            found = line_of_sight(store, level, (*xy, height), ends)
            eye = np.array([*xy, locate(store, [xy], level).z[0] + height])
            above = ends + np.column_stack([np.zeros_like(targets), locate(store, targets, level).z])
            again = line_of_sight(store, level, eye, above, is_absolute=True)
            np.testing.assert_array_equal(again.is_visible, found.is_visible)
            for end, is_visible, at in zip(above, found.is_visible, found.blocked_at, strict=True):
                if np.array_equal(end[:2], eye[:2]):
                    continue
                most, first = by_looking(tin, eye, end)
                total += 1
                if SEEN < most <= BLOCKED:
                    unsure += 1
                    continue
                assert is_visible == (most <= SEEN)
                assert np.isnan(at).all() == is_visible
                if not is_visible:
                    share = np.hypot(*(at - eye)[:2]) / np.hypot(*(end - eye)[:2])
                    np.testing.assert_allclose(at, eye + share * (end - eye), atol=1e-6)
                    assert share <= first + 1e-6
                    assert share == pytest.approx(first, abs=1e-4)
    assert total > 30
    assert unsure < total / 10


def test_faces_are_seen_or_hidden(store):
    rng = np.random.default_rng(12)
    level = len(store.levels) - 1
    tin = store.tin(level)
    for xy in places(store, level, rng, 1):
        found = viewshed(store, level, xy, observer_height=3.0, target_height=0.5)
        np.testing.assert_array_equal(found.face_ids, tin.face_attributes["face_id"])
        eye = np.array([*xy, locate(store, [xy], level).z[0] + 3.0])
        for k in rng.choice(tin.n_face, min(40, tin.n_face), replace=False):
            most, _ = by_looking(tin, eye, tin.nodes[tin.face_nodes[k]].mean(axis=0) + np.array([0, 0, 0.5]))
            assert SEEN < most <= BLOCKED or found.is_visible[k] == (most <= SEEN)


def test_reach_and_rectangle_leave_faces_out(store):
    level = len(store.levels) - 1
    tin = store.tin(level)
    x0, y0, x1, y1 = store.extent
    xy = places(store, level, np.random.default_rng(13), 1)[0]
    whole = viewshed(store, level, xy)
    middle = tin.nodes[tin.face_nodes].mean(axis=1)
    is_near = np.hypot(*(middle[:, :2] - xy).T) <= 150
    near = viewshed(store, level, xy, reach=150)
    np.testing.assert_array_equal(near.face_ids, whole.face_ids[is_near])
    np.testing.assert_array_equal(near.is_visible, whole.is_visible[is_near])
    box = (x0, y0, (x0 + x1) / 2, y1)
    touches = shapely.intersects(shapely.polygons(tin.nodes[tin.face_nodes, :2]), shapely.box(*box))
    part = viewshed(store, level, xy, bbox=box)
    np.testing.assert_array_equal(part.face_ids, whole.face_ids[touches])
    np.testing.assert_array_equal(part.is_visible, whole.is_visible[touches])
    assert len(viewshed(store, level, xy, bbox=(x1 + 9, y0, x1 + 10, y1)).face_ids) == 0
    assert len(viewshed(store, level, xy, reach=1e-6).face_ids) in (0, 1)


def test_nothing_blocks_over_a_void(tmp_path):
    """A wall hides what lies behind it, but not across a void where the wall would stand."""
    heights = np.zeros((11, 11))
    heights[:, 5] = 50.0
    heights[4:7, 4:7] = np.nan
    path = vpfx.build(write_dem(tmp_path / "a.tif", heights), tmp_path / "a.gpkg", max_error=(0.1,), tile_size=8).path
    x, y = 5e5, 4e6
    with vpfx.open_store(path) as opened:
        found = line_of_sight(opened, 0, (x, y + 150, 1.7), [(x + 300, y + 150, 0), (x + 300, y + 300, 0)])
        assert found.is_visible.tolist() == [True, False]
        assert np.isnan(found.blocked_at[0]).all()
        upright = line_of_sight(opened, 0, (x, y, 9), [(x, y, 1), (x, y, 20), (x, y, -4)])
        assert upright.is_visible.tolist() == [True, True, False]
        np.testing.assert_allclose(upright.blocked_at[2], (x, y, 0), atol=1e-9)
        with pytest.raises(InputError, match=r"targets: found no ground at \(500150, 4000150\)"):
            line_of_sight(opened, 0, (x, y, 1), (x + 150, y + 150, 1))
        with pytest.raises(InputError, match="observer: found no ground"):
            viewshed(opened, 0, (x - 150, y + 150))


def test_the_earth_is_round(tmp_path):
    """Over a plain of 120 km a height h sees the ground as far as the root of 2 R h, R being 7/6 of the earth's radius."""
    path = vpfx.build(
        write_dem(tmp_path / "a.tif", np.zeros((3, 61)), step=2000.0), tmp_path / "a.gpkg", max_error=(1,), tile_size=9
    ).path
    far = np.arange(1000.0, 119000, 1000)
    radius = 6_371_000 * 7 / 6
    with vpfx.open_store(path) as opened:
        for height in (2.0, 30.0, 200.0):
            targets = np.column_stack([5e5 + far, np.full(len(far), 4e6 + 1500), np.zeros(len(far))])
            assert line_of_sight(opened, 0, (5e5, 4e6 + 1500, height), targets).is_visible.all()
            found = line_of_sight(opened, 0, (5e5, 4e6 + 1500, height), targets, curvature=True)
            np.testing.assert_array_equal(found.is_visible, far <= math.sqrt(2 * radius * height))
            first = found.blocked_at[~found.is_visible]
            assert (first[:, 0] - 5e5 <= math.sqrt(2 * radius * height) + 1e-6).all()
            tall = targets + np.array([0, 0, 100.0])
            found = line_of_sight(opened, 0, (5e5, 4e6 + 1500, height), tall, curvature=True)
            reach = math.sqrt(2 * radius * height) + math.sqrt(2 * radius * 100)
            np.testing.assert_array_equal(found.is_visible, far <= reach)


def test_curvature_hides_more(store):
    level = len(store.levels) - 1
    xy = places(store, level, np.random.default_rng(14), 1)[0]
    flat, bent = (viewshed(store, level, xy, curvature=curvature).is_visible for curvature in (False, True))
    assert not (bent & ~flat).any()


def test_walks_are_those_of_profiles(store):
    x0, y0, x1, y1 = store.extent
    np.testing.assert_array_equal(walk(store, 1, (x0, y0), (x1, y1)), profile(store, [(x0, y0), (x1, y1)], 1).face_ids)
    assert walk(store, 1, (x0, y0), (x0, y0)).tolist() == [f for f in locate(store, [(x0, y0)], 1).face_ids if f > 0]
    with pytest.raises(InputError, match="start: found"):
        walk(store, 1, (1, 2, 3), (0, 0))


def test_what_cannot_be_asked_is_told(store):
    x, y = places(store, 0, np.random.default_rng(15), 1)[0]
    for observer in ((1, 2), (x, y, np.nan), "here", [(x, y, 1), (x, y, 2)]):
        with pytest.raises(InputError, match="observer: found"):
            line_of_sight(store, 0, observer, (x, y, 0))
    with pytest.raises(InputError, match="targets: found"):
        line_of_sight(store, 0, (x, y, 0), (x, y))
    for options in ({"observer_height": np.nan}, {"target_height": np.inf}, {"reach": 0}, {"reach": np.nan}):
        with pytest.raises(InputError, match="found"):
            viewshed(store, 0, (x, y), **options)
    with pytest.raises(NotFoundError, match="no level 9"):
        viewshed(store, 9, (x, y))
    with pytest.raises(NotFoundError, match="no level 9"):
        line_of_sight(store, 9, (x, y, 1), (x, y, 1), is_absolute=True)


def test_a_real_store_sees_both_ways(tmp_path):
    """From hill to hill in longitude and latitude: who sees is seen, on many tiles as on one."""
    seen = []
    for size in (100, 400):
        path = vpfx.build(CELL, tmp_path / f"{size}.gpkg", max_error=(20,), tile_size=size).path
        rng = np.random.default_rng(16)
        with vpfx.open_store(path) as opened:
            spots = rng.uniform(opened.extent[:2], opened.extent[2:], (25, 2))
            table = np.column_stack([spots, np.full(25, 1.7)])
            there = np.array([line_of_sight(opened, 0, spot, table).is_visible for spot in table])
            np.testing.assert_array_equal(there, there.T)
            assert there.diagonal().all()
            seen.append(there.mean())
    assert 0.04 < min(seen) <= max(seen) < 0.9


def test_the_commands_tell_what_is_seen(store, capsys, tmp_path):
    level = len(store.levels) - 1
    x, y = places(store, level, np.random.default_rng(17), 1)[0].tolist()
    targets = [(*place, 1.0) for place in places(store, level, np.random.default_rng(18), 4).tolist()]
    expected = line_of_sight(store, level, (x, y, 2.0), targets)
    options = [text for target in targets for text in ("--target", ",".join(map(repr, target)))]
    code, out, _ = ask(capsys, "sight", store.path, "--observer", f"{x!r},{y!r},2", *options)
    assert code == 0
    assert [line == "visible" for line in out.splitlines()] == expected.is_visible.tolist()
    _, out, _ = ask(capsys, "sight", store.path, "--observer", f"{x!r},{y!r},2", *options, "--json")
    for told, seen, at in zip(json.loads(out)["targets"], *expected, strict=True):
        assert told == {"is_visible": seen, "blocked_at": None if seen else at.tolist()}
    shed = viewshed(store, level, (x, y), observer_height=2.0, reach=200)
    place = ["--observer", f"{x!r},{y!r},2", "--reach", 200]
    _, out, _ = ask(capsys, "viewshed", store.path, *place, "--format", "json")
    document = json.loads(out)
    assert document["visible"] == shed.face_ids[shed.is_visible].tolist()
    assert document["hidden"] == shed.face_ids[~shed.is_visible].tolist()
    target = tmp_path / "a.geojson"
    code, out, _ = ask(capsys, "viewshed", store.path, *place, "-o", target)
    features = json.loads(target.read_text())["features"]
    assert {feature["id"]: feature["properties"]["is_visible"] for feature in features} == dict(
        zip(shed.face_ids.tolist(), shed.is_visible.tolist(), strict=True)
    )
    assert f"{shed.is_visible.sum()} of {len(shed.face_ids)} faces" in out


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["sight", "--observer", "1,2", "--target", "1,2,3"], 2, "sight: found '1,2', expected x, y and a height"),
        (["sight", "--observer", "1,2,3", "--target", "here"], 2, "--target: found 'here'"),
        (["sight", "--observer", "1,2,3", "--target", "1,2,3"], 2, "observer: found no ground at (1, 2)"),
        (["viewshed", "--observer", "1,2,3"], 2, "observer: found no ground"),
        (["viewshed", "--observer", "1,2"], 2, "--observer: found '1,2'"),
        (["viewshed", "--observer", "1,2,3", "--reach", "0"], 2, "reach: found 0"),
        (["viewshed", "--observer", "1,2,3", "--format", "table"], 2, "--format: found 'table'"),
        (["viewshed", "--observer", "1,2,3", "--level", "9"], 3, "found no level 9"),
    ],
)
def test_the_commands_refuse(arguments, code, message, store, capsys):
    found = ask(capsys, arguments[0], store.path, *arguments[1:])
    assert (found[0], found[1], found[2].count("\n")) == (code, "", 1)
    assert message in found[2]
