"""Planar graphs of random pieces of a lattice: void faces against a flood over the triangles that are left out."""

from __future__ import annotations

from collections import defaultdict
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from vpfx.errors import InvariantError
from vpfx.evpf.planar import OUTSIDE, Sides, by_direction, planar_graph

N = 6  # squares along a side of the lattice


def lattice():
    """Return nodes and triangles, counter-clockwise, of squares cut in two."""
    row, col = np.mgrid[0 : N + 1, 0 : N + 1]
    xy = np.stack([col.ravel(), row.ravel() + 0.25 * (col.ravel() % 2)], axis=1).astype(float)
    triangles = []
    for r in range(N):
        for c in range(N):
            a, b, d, e = r * (N + 1) + c, r * (N + 1) + c + 1, (r + 1) * (N + 1) + c, (r + 1) * (N + 1) + c + 1
            triangles += [(a, b, e), (a, e, d)]
    return xy, triangles


def graph_of(xy, faces):
    """Return edges, sides and the planar graph of some triangles; nodes that are no corners stay."""
    edges, start, edge = {}, [], []
    for a, b, c in faces:
        for p, q in ((a, b), (b, c), (c, a)):
            start.append(p)
            edge.append(edges.setdefault((min(p, q), max(p, q)), len(edges)))
    sides = Sides(np.array(start, int), np.array(edge, int), np.arange(0, 3 * len(faces) + 1, 3))
    nodes = np.array(list(edges), int).reshape(-1, 2)
    return nodes, planar_graph(xy, nodes, sides)


def regions(triangles, is_kept):
    """Number what is left out by a flood across sides; what reaches the rim is 0."""
    beside = defaultdict(list)
    for i, corners in enumerate(triangles):
        for p, q in pairwise([*corners, corners[0]]):
            beside[min(p, q), max(p, q)].append(i)
    region = {}
    for first in [*(i for pair in beside.values() if len(pair) == 1 for i in pair), *range(len(triangles))]:
        if is_kept[first] or first in region:
            continue
        at_rim = any(len(pair) == 1 and first in pair for pair in beside.values())
        number = OUTSIDE if at_rim else 1 + max([*region.values(), 0])
        waiting = [first]
        while waiting:
            i = waiting.pop()
            if i in region or is_kept[i]:
                continue
            region[i] = number
            for p, q in pairwise([*triangles[i], triangles[i][0]]):
                waiting += beside[min(p, q), max(p, q)]
    return region, beside


@settings(max_examples=150, deadline=None)
@given(arrays(bool, 2 * N * N, elements=st.sampled_from([True, True, True, False])))
def test_void_faces_are_what_a_flood_finds(is_kept):
    xy, triangles = lattice()
    kept = [i for i, keep in enumerate(is_kept) if keep]
    edge_nodes, graph = graph_of(xy, [triangles[i] for i in kept])
    region, beside = regions(triangles, is_kept)
    n_region = len({number for number in region.values() if number != OUTSIDE})
    name = {}
    for edge, (p, q) in enumerate(edge_nodes.tolist()):
        for i in (0, 1):
            face = int(graph.way_face[2 * edge + i])
            if face in range(1, graph.n_face + 1):
                assert kept[face - 1] in beside[min(p, q), max(p, q)]
                continue
            across = [t for t in beside[min(p, q), max(p, q)] if not is_kept[t]]
            assert len(across) <= 1
            number = region[across[0]] if across else OUTSIDE
            assert (face == OUTSIDE) == (number == OUTSIDE)
            assert name.setdefault(number, face) == face
    assert len(set(name.values())) == len(name)
    assert len(set(name) - {OUTSIDE}) <= n_region  # a region that no side faces is one of no kept triangle
    assert graph.n_void == len(set(name) - {OUTSIDE})
    n_node = len(np.unique(edge_nodes))
    n_rim = len(graph.ring_face) - 1 - graph.n_face - graph.n_void
    assert n_node - len(edge_nodes) + 1 + graph.n_face + graph.n_void == 1 + n_rim
    outer = [
        int(graph.ring_start[graph.ring_face == face][0])
        for face in range(graph.n_face + 1, 1 + graph.n_face + graph.n_void)
    ]
    assert outer == sorted(outer)


def test_directions_nearer_than_doubles_tell():
    """Two directions whose angles are one double: exact arithmetic orders them, either way round."""
    xy = np.array([[0.0, 0.0], [1e15, 1.0], [1e15 + 8, 1.0], [-1.0, 0.0]])
    for away in ([1, 2, 3], [2, 1, 3], [3, 1, 2]):
        order, same = by_direction(xy, np.zeros(3, int), np.array(away))
        assert [away[i] for i in order] == [2, 1, 3]
        assert len(same) == 0


def test_faces_on_each_other_are_refused():
    xy = np.array([[0, 0], [4, 0], [0, 4], [3, 1], [1, 3.0]])
    with pytest.raises(InvariantError, match="lie on each other"):
        graph_of(xy, [(0, 1, 2), (0, 3, 4)])
