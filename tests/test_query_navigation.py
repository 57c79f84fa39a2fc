"""Neighbours, rings, parents and children against searches of whole tables."""

from __future__ import annotations

import math
import sqlite3
from collections import defaultdict
from contextlib import closing

import numpy as np
import pytest
from conftest import slow_apart
from surfaces import SOLID, VOIDS, hills, write_dem

import vpfx
from vpfx.errors import InputError, NotFoundError
from vpfx.query import horizontal, vertical

KINDS = {
    "one tile": ("hills", {"max_error": (20, 5, 1)}),
    "tiles": ("hills", {"max_error": (20, 5, 2), "tile_size": 16}),
    "voids": ("void", {"passes": 3}),
    "void tiles": ("void", {"passes": 2, "tile_size": 8}),
    "T-junctions": ("cliff", {"method": "scarlatos", "passes": 3}),
    "pyramid": ("hills", {"method": "delaunay_pyramid", "max_error": (20, 8, 4), "tile_size": 25}),
}


class Tables:
    """The tables of a store as Python dictionaries."""

    def __init__(self, path):
        with closing(sqlite3.connect(path)) as store:
            rows = store.execute(
                "SELECT face_id, level, node_1, node_2, node_3, slope_centidegrees FROM face"
            ).fetchall()
            self.links = store.execute("SELECT parent_face, child_face FROM parent_child").fetchall()
            self.places = {row[0]: row[1:] for row in store.execute("SELECT node_id, x, y FROM node")}
            self.edges = store.execute("SELECT edge_id, level, start_node, end_node FROM edge").fetchall()
        self.level = {row[0]: row[1] for row in rows}
        self.corners = {row[0]: row[2:5] for row in rows}
        self.slope = {row[0]: row[5] for row in rows}
        self.by_side = defaultdict(list)
        self.by_node = defaultdict(list)
        for face, corners in self.corners.items():
            for i in range(3):
                self.by_side[self.level[face], frozenset((corners[i], corners[(i + 1) % 3]))].append(face)
                self.by_node[self.level[face], corners[i]].append(face)

    def across(self, face):
        """Faces beyond the three edges, -1 outside."""
        a, b, c = self.corners[face]
        sides = [self.by_side[self.level[face], frozenset(pair)] for pair in ((a, b), (b, c), (c, a))]
        return [next((other for other in side if other != face), -1) for side in sides]

    def touching(self, face):
        """Faces with a common corner."""
        return sorted({f for node in self.corners[face] for f in self.by_node[self.level[face], node]} - {face})

    def reached(self, start, step):
        """Everything that can be reached by a step."""
        found, left = set(start), list(start)
        while left:
            for other in step(left.pop()):
                if other not in found:
                    found.add(other)
                    left.append(other)
        return sorted(found)


@pytest.fixture(scope="module", params=KINDS)
def world(request, tmp_path_factory):
    """A store, and its tables."""
    surface, options = KINDS[request.param]
    heights = {"hills": hills(36, 32), "void": VOIDS["ring with island"].heights, "cliff": SOLID["cliff"].heights}[
        surface
    ]
    folder = tmp_path_factory.mktemp("query")
    path = vpfx.build(write_dem(folder / "a.tif", heights), folder / "a.gpkg", **options).path
    with vpfx.open_store(path) as store:
        yield store, Tables(path)


def faces_of(tables, level):
    return sorted(face for face, at in tables.level.items() if at == level)


def test_neighbours_over_edges(world):
    store, tables = world
    faces = np.random.default_rng(1).permutation(list(tables.corners))
    found = horizontal.edge_neighbours(store, faces)
    assert found.tolist() == [tables.across(face) for face in faces.tolist()]


def test_neighbours_over_nodes(world):
    store, tables = world
    for level in range(len(store.levels)):
        faces = faces_of(tables, level)
        found = horizontal.node_neighbours(store, faces)
        pieces = np.split(found.ids, found.offsets[1:-1])
        assert [piece.tolist() for piece in pieces] == [tables.touching(face) for face in faces]


def test_rings_are_in_order(world):
    store, tables = world
    ends = {row[0]: row[2:] for row in tables.edges}
    for level in range(len(store.levels)):
        nodes = [node for at, node in tables.by_node if at == level]
        at_node = defaultdict(set)
        for edge, at, start, end in tables.edges:
            if at == level:
                at_node[start].add(edge)
                at_node[end].add(edge)
        found = horizontal.rings(store, nodes, level)
        for i, node in enumerate(nodes):
            ring = slice(found.offsets[i], found.offsets[i + 1])
            edges, faces = found.edge_ids[ring].tolist(), found.face_ids[ring].tolist()
            assert set(edges) == at_node[node]
            assert len(edges) == len(set(edges))
            assert edges[0] == min(edges)
            assert sorted(face for face in faces if face != -1) == sorted(tables.by_node[level, node])
            x, y = tables.places[node]
            others = [tables.places[sum(ends[edge]) - node] for edge in edges]
            angles = [math.atan2(v - y, u - x) for u, v in others]
            turns = sum((b - a) % (2 * math.pi) for a, b in zip(angles, angles[1:] + angles[:1], strict=True))
            assert turns == pytest.approx(2 * math.pi if len(angles) > 1 else 0)
            for j, face in enumerate(faces):
                if face != -1:
                    following = edges[(j + 1) % len(edges)]
                    assert {*ends[edges[j]], *ends[following]} <= set(tables.corners[face])


@pytest.mark.parametrize("k", slow_apart([0, 1, 3, 100], [100]))
@pytest.mark.parametrize("over", ["edge", "node"])
def test_k_rings(k, over, world):
    store, tables = world
    for level in range(len(store.levels)):
        start = faces_of(tables, level)[:: max(1, len(faces_of(tables, level)) // 2)]
        expected = newest = set(start)
        for _ in range(k):
            beside = [tables.across(face) if over == "edge" else tables.touching(face) for face in newest]
            newest = {face for some in beside for face in some} - {-1} - expected
            expected = expected | newest
        assert horizontal.k_ring(store, start, k, over=over).tolist() == sorted(expected)


def test_flood_and_components(world):
    store, tables = world
    for level in range(len(store.levels)):
        faces = faces_of(tables, level)
        middle = float(np.median([tables.slope[face] for face in faces]))
        steep = {face for face in faces if tables.slope[face] >= middle}
        start = faces[:5]
        expected = tables.reached(
            [f for f in start if f in steep], lambda f, steep=steep: [o for o in tables.across(f) if o in steep]
        )
        found = horizontal.flood(store, start, lambda rows, least=middle: rows["slope_centidegrees"] >= least)
        assert found.tolist() == expected
        some = sorted(steep)
        labels = horizontal.components(store, some)
        expected, n_piece = {}, 0
        for face in some:
            if face not in expected:
                piece = tables.reached([face], lambda f, steep=steep: [o for o in tables.across(f) if o in steep])
                expected |= dict.fromkeys(piece, n_piece)
                n_piece += 1
        assert labels.tolist() == [expected[face] for face in some]


def test_parents_and_children(world):
    store, tables = world
    up, down = defaultdict(list), defaultdict(list)
    for parent, child in sorted(tables.links):
        up[child].append(parent)
        down[parent].append(child)
    faces = np.random.default_rng(2).permutation(list(tables.corners))[:400]
    for ask, links in ((vertical.parents, up), (vertical.children, down)):
        found = ask(store, faces)
        assert list(zip(found.of.tolist(), found.face_ids.tolist(), strict=True)) == [
            (i, other) for i, face in enumerate(faces.tolist()) for other in links[face]
        ]
    found = vertical.siblings(store, faces)
    expected = [sorted({c for p in up[face] for c in down[p]} - {face}) for face in faces.tolist()]
    assert list(zip(found.of.tolist(), found.face_ids.tolist(), strict=True)) == [
        (i, other) for i, others in enumerate(expected) for other in others
    ]


def test_zooming(world):
    store, tables = world
    up, down = defaultdict(set), defaultdict(set)
    for parent, child in tables.links:
        up[child].add(parent)
        down[parent].add(child)
    faces = np.random.default_rng(3).permutation(list(tables.corners))[:200].tolist()
    for level in range(len(store.levels)):
        expected = []
        for face in faces:
            found = {face}
            while found and tables.level[next(iter(found))] != level:
                links = up if tables.level[next(iter(found))] > level else down
                found = {other for one in found for other in links[one]}
            expected.append(sorted(found))
        found = vertical.related(store, faces, level)
        assert list(zip(found.of.tolist(), found.face_ids.tolist(), strict=True)) == [
            (i, other) for i, others in enumerate(expected) for other in others
        ]
        together = sorted({other for others in expected for other in others})
        assert vertical.descendants(store, faces, level).tolist() == together


def clipped_area(one, other):
    """Area that two triangles share, clipped side by side (Sutherland and Hodgman)."""
    polygon = [tuple(map(float, place)) for place in one]
    for i in range(3):
        (ax, ay), (bx, by) = other[i], other[(i + 1) % 3]
        off = [(bx - ax) * (y - ay) - (by - ay) * (x - ax) for x, y in polygon]
        kept = []
        for j, (place, here) in enumerate(zip(polygon, off, strict=True)):
            before, there = polygon[j - 1], off[j - 1]
            if here * there < 0:
                t = there / (there - here)
                kept.append((before[0] + t * (place[0] - before[0]), before[1] + t * (place[1] - before[1])))
            if here >= 0:
                kept.append(place)
        polygon = kept
    return abs(sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(polygon, polygon[1:] + polygon[:1], strict=True))) / 2


def test_shared_areas(world):
    """Areas that faces share with parents, children and faces of any level, against triangles clipped one by one."""
    store, tables = world
    x0, y0 = store.extent[:2]
    places = {
        face: [(tables.places[node][0] - x0, tables.places[node][1] - y0) for node in corners]
        for face, corners in tables.corners.items()
    }
    faces = np.random.default_rng(6).permutation(list(tables.corners))[:25]
    asked = [(vertical.parents, ()), (vertical.children, ())]
    asked += [(vertical.related, (level,)) for level in range(len(store.levels))]
    for ask, level in asked:
        plain = ask(store, faces, *level)
        found = ask(store, faces, *level, with_area=True)
        areas = dict(zip(zip(found.of.tolist(), found.face_ids.tolist(), strict=True), found.area, strict=True))
        assert len(areas) == len(found.of)
        for of, other in zip(plain.of.tolist(), plain.face_ids.tolist(), strict=True):
            expected = clipped_area(places[int(faces[of])], places[other])
            assert areas.pop((of, other), 0.0) == pytest.approx(expected, rel=1e-6, abs=1e-4)
        assert not areas
        whole = np.array([clipped_area(places[face], places[face]) for face in faces.tolist()])
        is_asked = np.isin(np.arange(len(faces)), found.of)
        covered = np.bincount(found.of, found.area, minlength=len(faces))
        np.testing.assert_allclose(covered[is_asked], whole[is_asked], rtol=1e-6)


def test_nothing_is_asked(world):
    store, _ = world
    assert horizontal.edge_neighbours(store, []).shape == (0, 3)
    assert horizontal.node_neighbours(store, []).ids.tolist() == []
    assert horizontal.rings(store, [], 0).offsets.tolist() == [0]
    assert horizontal.components(store, []).tolist() == []
    assert horizontal.k_ring(store, [], 2).tolist() == []
    assert horizontal.flood(store, [], lambda rows: rows["face_id"] > 0).tolist() == []
    for ask in (vertical.parents, vertical.children, vertical.siblings):
        assert ask(store, []).face_ids.tolist() == []
        assert len(ask(store, []).of) == 0
    assert vertical.related(store, [], 0, with_area=True).area.tolist() == []
    assert vertical.descendants(store, [], 0).tolist() == []


def test_what_is_not_there_is_told(world):
    store, tables = world
    with pytest.raises(NotFoundError, match="found no face 123456789"):
        horizontal.edge_neighbours(store, [1, 123456789])
    with pytest.raises(NotFoundError, match="found no face"):
        vertical.parents(store, [-1])
    with pytest.raises(NotFoundError, match="found no level 9"):
        vertical.related(store, [1], 9)
    with pytest.raises(InputError, match="expected whole numbers"):
        vertical.children(store, ["one"])
    with pytest.raises(InputError, match="expected faces of one level"):
        horizontal.node_neighbours(store, [faces_of(tables, 0)[0], faces_of(tables, 1)[0]])
    with pytest.raises(InputError, match="expected none or more over edge or node"):
        horizontal.k_ring(store, [1], -1)
    newest = next(node for level, node in tables.by_node if level == 1 and (0, node) not in tables.by_node)
    with pytest.raises(NotFoundError, match="level 0: found no face at node"):
        horizontal.rings(store, [newest], 0)
