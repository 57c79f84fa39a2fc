"""Rings from winged edges: faces put together where links or names of faces are wrong, damage of every kind."""

from __future__ import annotations

import numpy as np
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from vpf_maps import Map

from vpfx.vpf.rings import WingedEdges, find_rings, next_sides

LABELS = st.lists(st.lists(st.integers(0, 3), min_size=6, max_size=6), min_size=2, max_size=5)


def winged(tile):
    """Links of a tile as arrays."""
    return WingedEdges(
        *(np.array([getattr(edge, name) - 1 for edge in tile.edges], np.int64) for name in WingedEdges._fields)
    )


def polygon(tile, rings, face):
    """Area of a face (from 1) by its rings."""
    outer, inner = [], []
    for i in np.flatnonzero(rings.faces == face - 1).tolist():
        places = []
        for side in rings.sides[rings.starts[i] : rings.starts[i + 1]].tolist():
            edge = tile.edges[side // 2].places
            places += (edge[::-1] if side % 2 else edge)[:-1]
        ring = shapely.LinearRing(places)
        (inner if ring.is_ccw else outer).append(ring)
    if face == 1:
        assert not outer
        return None
    assert len(outer) == 1
    found = shapely.Polygon(outer[0], inner)
    assert found.is_valid
    return found


def check_faces(ground, tile, found, but=()):
    for face in range(1, tile.n_face + 1):
        if face - 1 not in found.lost and face not in but:
            area = polygon(tile, found.rings, face)
            assert face == 1 or area.equals(ground.face_polygon(tile, face)), face


@settings(max_examples=40, deadline=None)
@given(LABELS, st.integers(0, 99), st.integers(0, 12))
def test_rings_go_round_the_faces(labels, seed, n_spur):
    """Islands, faces that touch at nodes, bridges and spurs come out as areas of squares."""
    ground = Map(labels, seed, tile=3 if seed % 2 else 0, n_spur=n_spur)
    for tile in ground.tiles:
        found = find_rings(winged(tile))
        assert len(found.mended) == len(found.lost) == 0
        check_faces(ground, tile, found)


@settings(max_examples=40, deadline=None)
@given(LABELS, st.integers(0, 99), st.data())
def test_wrong_links_are_mended(labels, seed, data):
    """The names of the faces tell the rings too."""
    ground = Map(labels, seed, n_spur=seed % 9)
    tile = ground.whole
    if not tile.edges:
        return
    edges = winged(tile)
    some = st.integers(0, len(tile.edges) - 1)
    for row, wrong in data.draw(
        st.lists(st.tuples(some, st.integers(-2, len(tile.edges) + 1)), min_size=1, max_size=6)
    ):
        data.draw(st.sampled_from([edges.right_edge, edges.left_edge]))[row] = wrong
    found = find_rings(edges)
    assert len(found.lost) == 0
    check_faces(ground, tile, found)


@settings(max_examples=40, deadline=None)
@given(LABELS, st.integers(0, 99), st.data())
def test_a_wrong_face_is_told_by_the_links(labels, seed, data):
    """An edge that names another face: the two faces are found by the ring that most of their edges make, or lost."""
    ground = Map(labels, seed)
    tile = ground.whole
    rows = [i for i, edge in enumerate(tile.edges) if edge.start_node != edge.end_node]
    if not rows:
        return
    edges, row = winged(tile), data.draw(st.sampled_from(rows))
    faces = data.draw(st.sampled_from([edges.right_face, edges.left_face]))
    right, wrong = int(faces[row]), data.draw(st.integers(0, tile.n_face - 1))
    faces[row] = wrong
    found = find_rings(edges)
    assert set(found.lost.tolist()) | set(found.mended.tolist()) <= {right, wrong}
    check_faces(ground, tile, found)


def test_links_that_never_return_end():
    """Two edges that send whoever follows the links to and fro, beside where it began."""
    start, end = np.array([0, 1, 1]), np.array([1, 2, 2])
    links = np.array([1, 2, 1]), np.array([0, 2, 1])
    edges = WingedEdges(start, end, np.array([1, 1, 1]), np.array([1, 1, 1]), *links)
    assert find_rings(edges).mended.tolist() == [1]


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(*[st.integers(-2, 5)] * 6), max_size=8))
def test_nonsense_gives_closed_simple_rings(rows):
    edges = WingedEdges(*np.array(rows, np.int64).reshape(-1, 6).T)
    ends = np.stack([edges.start_node, edges.end_node, edges.end_node, edges.start_node], axis=1).reshape(-1, 2)
    rings = find_rings(edges).rings
    assert len(rings.sides) <= 2 * len(rows)
    for low, high in zip(rings.starts, rings.starts[1:], strict=False):
        ring = ends[rings.sides[low:high]]
        assert np.array_equal(ring[:, 1], np.roll(ring[:, 0], -1))
        assert len(np.unique(ring[:, 0])) == len(ring)


def test_great_numbers_cost_nothing():
    """Nodes and faces are numbers from a file: nothing is made as long as they are great."""
    great = np.array([2**31 - 2])
    edges = WingedEdges(great, great, great, great - 1, np.array([0]), np.array([0]))
    found = find_rings(edges)
    assert sorted(found.rings.faces.tolist()) == [2**31 - 3, 2**31 - 2]
    assert next_sides(edges).tolist() == [0, 1]


def test_no_edges_no_rings():
    none = np.zeros(0, np.int64)
    found = find_rings(WingedEdges(*[none] * 6))
    assert [len(part) for part in (*found.rings, found.mended, found.lost)] == [1, 0, 0, 0, 0]
