"""Contours against every face, one by one, in exact numbers."""

from __future__ import annotations

import json
import math
from collections import Counter
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
import shapely
from rasters import CELL
from small_stores import MOST, ask, build_kind

import vpfx
from vpfx.errors import InputError, NotFoundError
from vpfx.query.contours import contours, contours_of, even_heights, to_geojson


@pytest.fixture(scope="module", params=MOST)
def store(request, tmp_path_factory):
    with vpfx.open_store(build_kind(request.param, tmp_path_factory.mktemp("contours"))) as opened:
        yield opened


def heights_of(tin):
    """Some heights, those of nodes among them, and one above all ground."""
    z = tin.nodes[:, 2]
    return [*np.linspace(z.min(), z.max(), 6)[1:-1].tolist(), *np.unique(z)[:: max(1, len(np.unique(z)) // 3)].tolist(),
            float(z.max() + 1)]  # fmt: skip


def by_looking(tin, height):
    """Pieces of a contour as a pair of places, each an edge of the mesh or a node and its place, face by face."""
    pieces = []
    for face in tin.face_nodes.tolist():
        ends = []
        for i, j in zip(face, face[1:] + face[:1], strict=True):
            a, b = tin.nodes[i].tolist(), tin.nodes[j].tolist()
            if (a[2] >= height) == (b[2] >= height):
                continue
            share = (Fraction(height) - Fraction(a[2])) / (Fraction(b[2]) - Fraction(a[2]))
            place = tuple(float(Fraction(p) + share * (Fraction(q) - Fraction(p))) for p, q in zip(a, b, strict=True))
            name = i if share == 0 else j if share == 1 else frozenset((i, j))
            ends.append((name, place[:2], a[2] >= height))
        if ends and ends[0][0] != ends[1][0]:
            (first, one, falls), (last, other, _) = ends
            pieces.append(((first, one), (last, other)) if falls else ((last, other), (first, one)))
    count = Counter((a[0], b[0]) for a, b in pieces)
    return [(a, b) for a, b in pieces if not count[(b[0], a[0])]]


def segments(lines):
    return [pair for line in lines.geoms for pair in pairwise(line.coords)]


def test_the_pieces_are_those_of_every_face(store):
    for level in (0, len(store.levels) - 1):
        tin = store.tin(level)
        for contour in contours(store, level, heights_of(tin)):
            pieces = by_looking(tin, contour.height)
            found = sorted(tuple(p[:2] + q[:2]) for p, q in segments(contour.lines))
            looked = sorted(a[1] + b[1] for a, b in pieces)
            assert len(found) == len(looked)
            tree = shapely.STRtree([shapely.LineString([p[:2], p[2:]]) for p in found])
            for piece in looked:
                near = tree.query(shapely.LineString([piece[:2], piece[2:]]), "dwithin", 1e-6)
                assert any(max(abs(s - t) for s, t in zip(piece, found[k], strict=True)) < 1e-6 for k in near)
            assert contour.lines.length == pytest.approx(sum(math.dist(p[:2], p[2:]) for p in looked))


def test_every_vertex_lies_on_an_edge_at_the_height(store):
    tin = store.tin(1)
    sides = tin.nodes[np.concatenate([tin.face_nodes[:, [0, 1]], tin.face_nodes[:, [1, 2]], tin.face_nodes[:, [2, 0]]])]
    lines = shapely.linestrings(sides[:, :, :2])
    tree = shapely.STRtree(lines)
    for contour in contours(store, 1, heights_of(tin)):
        for x, y, z in shapely.get_coordinates(contour.lines, include_z=True).tolist():
            assert z == contour.height
            place = shapely.Point(x, y)
            heights = []
            for side in tree.query(place, "dwithin", 1e-6):
                share = lines[side].project(place, normalized=True)
                heights.append(sides[side, 0, 2] + share * (sides[side, 1, 2] - sides[side, 0, 2]))
            assert min(abs(height - z) for height in heights) < 1e-5


def test_lines_are_closed_or_end_outside(store):
    """An end of a line that no other line goes on from lies on an edge with one face."""
    for level in (0, len(store.levels) - 1):
        tin = store.tin(level)
        sides = Counter(frozenset(pair) for face in tin.face_nodes.tolist() for pair in pairwise([*face, face[0]]))
        rim = shapely.union_all([shapely.LineString(tin.nodes[list(s), :2]) for s, n in sides.items() if n == 1])
        for contour in contours(store, level, heights_of(tin)):
            balance = Counter()
            for line in contour.lines.geoms:
                assert line.is_simple
                balance[line.coords[0]] += 1
                balance[line.coords[-1]] -= 1
            for (x, y, _), count in balance.items():
                assert count == 0 or rim.distance(shapely.Point(x, y)) < 1e-6


def test_higher_ground_lies_to_the_left(store):
    tin = store.tin(1)
    faces = shapely.polygons(tin.nodes[tin.face_nodes, :2])
    tree = shapely.STRtree(faces)
    for contour in contours(store, 1, heights_of(tin)[:4]):
        for (ax, ay, _), (bx, by, _) in segments(contour.lines):
            middle = np.array([(ax + bx) / 2, (ay + by) / 2])
            left = np.array([ay - by, bx - ax])
            for face in tree.query(shapely.Point(middle), "dwithin", 1e-9):
                a, b, c = tin.nodes[tin.face_nodes[face]]
                rise = np.linalg.solve([b[:2] - a[:2], c[:2] - a[:2]], [b[2] - a[2], c[2] - a[2]])
                centre = (a + b + c) / 3
                if abs((centre[:2] - middle) @ left) > 1e-9 and rise.any() and max(a[2], b[2], c[2]) > contour.height:
                    assert rise @ left >= -1e-9 * np.linalg.norm(left) or min(a[2], b[2], c[2]) >= contour.height


def test_a_window_cuts_lines_off(store):
    x0, y0, x1, y1 = store.extent
    box = (x0 + 0.21 * (x1 - x0), y0 + 0.33 * (y1 - y0), x0 + 0.77 * (x1 - x0), y0 + 0.72 * (y1 - y0))
    heights = heights_of(store.tin(1))
    for whole, part in zip(contours(store, 1, heights), contours(store, 1, heights, bbox=box), strict=True):
        expected = shapely.force_2d(whole.lines).intersection(shapely.box(*box))
        assert part.lines.length == pytest.approx(expected.length, abs=1e-6)
        assert part.lines.is_empty or part.lines.hausdorff_distance(expected) < 1e-6
        assert np.all(shapely.get_coordinates(part.lines, include_z=True)[:, 2] == part.height)


def test_flat_ground_and_ridges_give_no_line():
    flat = vpfx.Tin(np.array([[0, 0, 5.0], [1, 0, 5], [1, 1, 5], [0, 1, 5]]), np.array([[0, 1, 2], [0, 2, 3]]))
    assert contours_of(flat, [5])[0].lines.is_empty
    nodes = np.array([[0, 0, 5.0], [0, 9, 5], [1, 5, 0], [-1, 5, 0]])
    ridge = vpfx.Tin(nodes, np.array([[0, 2, 1], [0, 1, 3]]))
    assert contours_of(ridge, [5])[0].lines.is_empty
    valley = vpfx.Tin(nodes * [1, 1, -1], ridge.face_nodes)
    assert contours_of(valley, [-5])[0].lines.is_empty
    bank = vpfx.Tin(np.add(nodes, [[0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 5]]), ridge.face_nodes)
    assert contours_of(bank, [5])[0].lines.wkt == "MULTILINESTRING Z ((0 0 5, 0 9 5))"


def test_the_same_lines_with_tiles_and_without(tmp_path):
    """Levels of one mesh cut into tiles give each line in one piece: no end lies inside."""
    path = vpfx.build(CELL, tmp_path / "a.gpkg", max_error=(40, 20), tile_size=100).path
    with vpfx.open_store(path) as opened:
        tin = opened.tin(1)
        found = contours(opened, 1, even_heights(tin, 25.0))
        again = contours(opened, 1, even_heights(tin, 25.0))
        x0, y0, x1, y1 = opened.extent
    assert [c.lines.wkb for c in found] == [c.lines.wkb for c in again]
    assert len(found) > 5
    for contour in found:
        for line in contour.lines.geoms:
            if not line.is_closed:
                for x, y, _ in (line.coords[0], line.coords[-1]):
                    assert min(abs(x - x0), abs(x - x1), abs(y - y0), abs(y - y1)) < 1e-9


def test_what_cannot_be_asked_is_told(store):
    for heights in ([np.nan], [[1, 2]], [np.inf]):
        with pytest.raises(InputError, match="heights: found"):
            contours(store, 0, heights)
    with pytest.raises(NotFoundError, match="no level 9"):
        contours(store, 9, [1])
    with pytest.raises(InputError, match="rectangle with area"):
        contours(store, 0, [1], bbox=(0, 0, 0, 1))
    for interval in (0, -1, np.nan, 1e-9):
        with pytest.raises(InputError, match="interval: found"):
            even_heights(store.tin(0), interval)
    assert contours(store, 0, []) == []
    assert json.dumps([c.height for c in contours(store, 0, [1, 0])]) == "[1.0, 0.0]"


def test_the_command_gives_lines(store, capsys, tmp_path):
    level = len(store.levels) - 1
    heights = even_heights(store.tin(level), 2.5)
    expected = json.loads(json.dumps(to_geojson(contours(store, level, heights), store.crs)))
    code, out, _ = ask(capsys, "contours", store.path, "--interval", 2.5)
    assert (code, json.loads(out)) == (0, expected)
    target = tmp_path / "a.geojson"
    code, out, _ = ask(capsys, "contours", store.path, "--heights=-3,4.5", "--level", 0, "-o", target)
    features = json.loads(target.read_text())["features"]
    assert [feature["properties"]["height"] for feature in features] == [-3.0, 4.5]
    lines = [line for feature in features for line in feature["geometry"]["coordinates"]]
    assert all(-106 < x < -104 and 36 < y < 37 for line in lines for x, y, _ in line)
    assert f"{len(lines):,} lines at 2 heights of level 0" in out
    for arguments, message in (
        ([], "expected --heights or --interval"),
        (["--heights", "1", "--interval", "2"], "expected --heights or --interval"),
        (["--heights", "a"], "--heights: found 'a'"),
        (["--heights", "nan"], "heights: found"),
        (["--interval", "0"], "interval: found 0"),
        (["--interval", "5", "--bbox", "1,1,1,2"], "rectangle with area"),
    ):
        code, out, err = ask(capsys, "contours", store.path, *arguments)
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert message in err
