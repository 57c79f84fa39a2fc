"""Areas and volumes against faces that are cut up one by one."""

from __future__ import annotations

import json
import math
from itertools import pairwise

import numpy as np
import pytest
import shapely
from rasters import CELL
from small_stores import MOST, ask, build_kind, clipped

import vpfx
from vpfx.errors import InputError, NotFoundError
from vpfx.query.volumes import volume


@pytest.fixture(scope="module", params=MOST)
def store(request, tmp_path_factory):
    with vpfx.open_store(build_kind(request.param, tmp_path_factory.mktemp("volumes"))) as opened:
        yield opened


def above(corners):
    """Volume of a flat piece, given as corners (x, y, height), over the height 0."""
    kept = []
    for p, q in zip(corners, [*corners[1:], *corners[:1]], strict=True):
        if p[2] >= 0:
            kept.append(p)
        if p[2] * q[2] < 0:
            share = p[2] / (p[2] - q[2])
            kept.append(tuple(s + share * (t - s) for s, t in zip(p, q, strict=True)))
    return sum(area(a, b, c) * (a[2] + b[2] + c[2]) / 3 for a, b, c in fans(kept))


def fans(corners):
    return [(corners[0], b, c) for b, c in pairwise(corners[1:])]


def area(a, b, c):
    return ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])) / 2


def sloped(a, b, c):
    """Area in space."""
    return float(np.linalg.norm(np.cross(np.subtract(b, a), np.subtract(c, a)))) / 2


def height(triangle, x, y):
    """Height of the plane of three corners at a place."""
    a, b, c = triangle
    return a[2] + (area(a, (x, y), c) * (b[2] - a[2]) + area(a, b, (x, y)) * (c[2] - a[2])) / area(a, b, c)


def by_looking(tin, windows, reference):
    """Area, surface, cut and fill of a level within convex windows, each with its sign; coordinates are metres."""
    total = np.zeros(4)
    for sign, window in windows:
        for corners in tin.nodes[tin.face_nodes].tolist():
            piece = clipped([tuple(c) for c in corners], window)
            for part, plane in reference(piece):
                gaps = [(x, y, z - plane(x, y)) for x, y, z in part]
                flat = sum(area(*fan) for fan in fans(part))
                total += sign * np.array(
                    [
                        flat,
                        sum(sloped(*fan) for fan in fans(part)),
                        above(gaps),
                        above([(x, y, -z) for x, y, z in gaps]),
                    ]
                )
    return total


def to_plane(a, b=0.0, c=0.0):
    return lambda piece: [(piece, lambda x, y: a + b * x + c * y)] if len(piece) > 2 else []


def to_level(tin):
    """Cut pieces up by the faces of another level."""
    triangles = [[tuple(c) for c in corners] for corners in tin.nodes[tin.face_nodes].tolist()]
    low, high = tin.nodes[tin.face_nodes].min(axis=1), tin.nodes[tin.face_nodes].max(axis=1)

    def parts(piece):
        if len(piece) < 3:
            return
        corners = np.array(piece)
        near = (low[:, :2] < corners.max(axis=0)[:2]).all(axis=1) & (high[:, :2] > corners.min(axis=0)[:2]).all(axis=1)
        for k in np.flatnonzero(near):
            part = clipped(piece, [c[:2] for c in triangles[k]])
            if len(part) > 2:
                yield part, lambda x, y, k=k: height(triangles[k], x, y)

    return parts


def areas(store):
    """Polygons, and the convex windows that they are the sum of."""
    x0, y0, x1, y1 = store.extent

    def at(*shares):
        return [(x0 + u * (x1 - x0), y0 + v * (y1 - y0)) for u, v in shares]

    everything = [(x0 - 1, y0 - 1), (x1 + 1, y0 - 1), (x1 + 1, y1 + 1), (x0 - 1, y1 + 1)]
    outer, hole = at((0.1, 0.15), (0.93, 0.2), (0.7, 0.91)), at((0.5, 0.3), (0.7, 0.31), (0.66, 0.52))
    other = at((-0.2, 0.8), (0.3, 0.7), (0.2, 1.2))
    tin = store.tin(0)
    on_nodes = tin.nodes[tin.face_nodes[len(tin.face_nodes) // 2], :2].tolist()
    return [
        (None, [(1, everything)]),
        (shapely.Polygon(outer, [hole]), [(1, outer), (-1, hole)]),
        (shapely.MultiPolygon([shapely.Polygon(outer[::-1]), shapely.Polygon(other)]), [(1, outer), (1, other)]),
        (shapely.Polygon(on_nodes), [(1, on_nodes)]),
    ]


def assert_like(found, expected, scale):
    """Compare to the accuracy of rounding: of the area times the relief."""
    assert found.area_m2 == pytest.approx(expected[0], rel=1e-9, abs=1e-5)
    assert found.surface_area_m2 == pytest.approx(expected[1], rel=1e-9, abs=1e-5)
    assert found.cut_m3 == pytest.approx(expected[2], rel=1e-9, abs=1e-9 * scale)
    assert found.fill_m3 == pytest.approx(expected[3], rel=1e-9, abs=1e-9 * scale)
    assert found.net_m3 == pytest.approx(expected[2] - expected[3], rel=1e-9, abs=1e-9 * scale)


def test_planes(store):
    level = len(store.levels) - 1
    tin = store.tin(level)
    z = float(np.median(tin.nodes[:, 2]))
    x0, y0, x1, y1 = store.extent
    tilted = (z - 0.01 * x0 + 0.02 * y0, 0.01, -0.02)
    scale = (x1 - x0) * (y1 - y0) * (np.ptp(tin.nodes[:, 2]) + 1)
    for polygon, windows in areas(store):
        for plane in (z, z - 1e3, tilted):
            expected = by_looking(tin, windows, to_plane(*np.atleast_1d(plane)))
            assert_like(volume(store, level, polygon, plane=plane), expected, 10 * scale)


def test_levels(store):
    last = len(store.levels) - 1
    x0, y0, x1, y1 = store.extent
    scale = (x1 - x0) * (y1 - y0) * (np.ptp(store.tin(last).nodes[:, 2]) + 1)
    for polygon, windows in areas(store)[1:3]:
        for level, other in ((last, 0), (0, 1), (1, 1)):
            expected = by_looking(store.tin(level), windows, to_level(store.tin(other)))
            assert_like(volume(store, level, polygon, other_level=other), expected, scale)
    there, back = volume(store, last, other_level=0), volume(store, 0, other_level=last)
    assert there.cut_m3 == pytest.approx(back.fill_m3, rel=1e-9)
    assert there.area_m2 == pytest.approx(back.area_m2, rel=1e-9)
    assert volume(store, 0, other_level=0)[2:] == pytest.approx((0, 0, 0), abs=1e-9 * scale)


def test_what_cannot_be_asked_is_told(store):
    for options in ({}, {"plane": 1.0, "other_level": 0}):
        with pytest.raises(InputError, match="expected one of them"):
            volume(store, 0, **options)
    for plane in (np.nan, (1, 2), "high", (1, 2, np.inf), [[1]]):
        with pytest.raises(InputError, match="plane: found"):
            volume(store, 0, plane=plane)
    with pytest.raises(NotFoundError, match="no level 9"):
        volume(store, 0, other_level=9)
    with pytest.raises(InputError, match="found a Point"):
        volume(store, 0, shapely.Point(0, 0), plane=0)
    x1, y1 = store.extent[2:]
    assert volume(store, 0, shapely.box(x1 + 1, y1, x1 + 2, y1 + 1), plane=0) == (0, 0, 0, 0, 0)
    assert volume(store, 0, shapely.box(x1 + 1, y1, x1 + 2, y1 + 1), other_level=1) == (0, 0, 0, 0, 0)


def test_a_real_store_in_metres(tmp_path):
    """In longitude and latitude areas are metres of the middle of the extent; parts sum up to the whole."""
    path = vpfx.build(CELL, tmp_path / "a.gpkg", max_error=(40, 10), tile_size=100).path
    with vpfx.open_store(path) as opened:
        x0, y0, x1, y1 = opened.extent
        middle = math.radians((y0 + y1) / 2)
        wide = math.radians(x1 - x0) * 6378137 * math.cos(middle) / math.sqrt(1 - 0.00669438 * math.sin(middle) ** 2)
        whole = volume(opened, 1, plane=2000)
        assert whole.area_m2 == pytest.approx(wide * (y1 - y0) * 110_970, rel=2e-4)
        assert whole.area_m2 < whole.surface_area_m2 < 2 * whole.area_m2
        xm, ym = x0 + 0.37 * (x1 - x0), y0 + 0.61 * (y1 - y0)
        quarters = [(x0, y0, xm, ym), (xm, y0, x1, ym), (x0, ym, xm, y1), (xm, ym, x1, y1)]
        parts = [volume(opened, 1, shapely.box(*box), plane=2000) for box in quarters]
        np.testing.assert_allclose(np.sum(parts, axis=0), whole, rtol=1e-9)
        parts = [volume(opened, 1, shapely.box(*box), other_level=0) for box in quarters]
        np.testing.assert_allclose(np.sum(parts, axis=0)[:4], volume(opened, 1, other_level=0)[:4], rtol=1e-9)


def test_the_command_tells_volumes(store, capsys):
    x0, y0, x1, y1 = store.extent
    area = shapely.Polygon([(x0, y0), (x1, y0 + 9), (x0 + 50, y1)])
    for arguments, options in (
        (["--plane", 3], {"plane": 3.0}),
        (["--plane=1,0.5,-0.25"], {"plane": (1.0, 0.5, -0.25)}),
        (["--other-level", 1], {"other_level": 1}),
    ):
        expected = volume(store, 0, area, **options)
        code, out, _ = ask(capsys, "volume", store.path, "--level", 0, "--polygon", area.wkt, *arguments, "--json")
        found = json.loads(out)
        assert (code, found.pop("level")) == (0, 0)
        assert found == expected._asdict()
    _, out, _ = ask(capsys, "volume", store.path, "--plane", 3)
    assert len(out.splitlines()) == 5
    for arguments, code, message in (
        ([], 2, "expected one of them"),
        (["--plane", "1", "--other-level", "0"], 2, "expected one of them"),
        (["--plane", "1,2"], 2, "plane: found"),
        (["--plane", "high"], 2, "--plane: found 'high'"),
        (["--other-level", "9"], 3, "found no level 9"),
    ):
        found = ask(capsys, "volume", store.path, *arguments)
        assert (found[0], found[1], found[2].count("\n")) == (code, "", 1)
        assert message in found[2]
