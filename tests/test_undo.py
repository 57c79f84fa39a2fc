"""Forests of faces: cutting and undoing leave a mesh, and undo what is needless."""

from __future__ import annotations

from random import Random

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from surfaces import noise

from vpfx.methods.forest import Forest
from vpfx.methods.trial import Terms
from vpfx.methods.undo import undo_breaks
from vpfx.topology import find_twins

N_POST = 9
SQUARE = np.array([[0, 1, 3], [0, 3, 2]], np.int32)


def start(heights):
    """Two faces over a square of posts."""
    row, col = np.array([0, 0, N_POST - 1, N_POST - 1]), np.array([0, N_POST - 1, 0, N_POST - 1])
    return Forest(np.stack([col, row, heights[row, col]], axis=1).astype(float), SQUARE.copy(), np.zeros(2, bool))


def cut_some(forest, heights, random):
    """Break some sides of leaves half way, and some other leaves inside; return the faces cut."""
    leaves, _ = forest.leaves(np.arange(2, dtype=np.int32))
    faces = set()
    for face in leaves:
        for side in range(3 * face, 3 * face + 3):
            twin = forest.side_twin[side]
            if forest.side_node[side] >= 0 or random.random() < 0.6:
                continue
            ends = forest.nodes[forest.face_nodes[face, [side % 3, (side + 1) % 3]]]
            node = ends.mean(axis=0)
            node[2] = heights[int(node[1]), int(node[0])]
            forest.side_node[side] = forest.add_nodes(node[None])
            if twin >= 0:
                forest.side_node[twin] = forest.side_node[side]
            faces |= {face, twin // 3} if twin >= 0 else {face}
    inner = dict.fromkeys(faces, -1)
    for face in set(leaves.tolist()) - faces:
        if random.random() < 0.3:
            shares = np.array([[0.5, 0.25, 0.25]])  # exact in binary
            inner[face] = forest.add_nodes(shares @ forest.nodes[forest.face_nodes[face]])
    order = np.array(sorted(inner), np.int32)
    forest.cut(order, np.array([inner[face] for face in order], np.int32), np.zeros(len(order), bool))
    return order


def judge(forest):
    """The leaves are a mesh that tiles the square, and know their twins; return them."""
    leaves, _ = forest.leaves(np.arange(2, dtype=np.int32))
    faces = forest.face_nodes[leaves]
    place = np.full(forest.n_face, -1)
    place[leaves] = np.arange(len(leaves))
    sides = (3 * leaves[:, None] + np.arange(3)).ravel()
    twin = forest.side_twin[sides]
    assert np.where(twin < 0, -1, 3 * place[twin // 3] + twin % 3).tolist() == find_twins(faces, forest.n_node).tolist()
    a, b, c = (forest.nodes[faces[:, i], :2] for i in range(3))
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (c[:, 0] - a[:, 0]) * (b[:, 1] - a[:, 1])
    assert (area > 0).all()
    assert area.sum() == 2 * (N_POST - 1) ** 2
    return leaves


def undo(forest, cuts, heights, bound):
    last_first = np.concatenate(cuts)[::-1].copy()
    terms = Terms(aspect=1.0, bound=bound, most_thin=np.inf, decay=1.0, diagonal=0, seed=0)
    return undo_breaks(last_first, forest.tree, forest.side_state, forest.face_error, heights, tuple(terms))


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 10**6).map(Random), st.integers(1, 4))
def test_flat_ground_needs_no_cut(random, passes):
    heights = np.zeros((N_POST, N_POST))
    forest = start(heights)
    cuts = [cut_some(forest, heights, random) for _ in range(passes)]
    judge(forest)
    while undo(forest, cuts, heights, 0.5):
        judge(forest)
    assert judge(forest).tolist() == [0, 1]
    assert (forest.side_node[:6] == -1).all()


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 10**6).map(Random), st.integers(1, 4), st.sampled_from([0.1, 3.0, 6.0, 9.0]))
def test_what_is_left_keeps_the_bound(random, passes, bound):
    heights = noise(N_POST, N_POST)
    forest = start(heights)
    cuts = [cut_some(forest, heights, random) for _ in range(passes)]
    before = judge(forest)
    count = undo(forest, cuts, heights, bound)
    after = judge(forest)
    assert len(before) - len(after) >= count  # an edge on the outside has one face, a node inside two to spare
    new = {tuple(nodes) for nodes in forest.face_nodes[after].tolist()} - {
        tuple(nodes) for nodes in forest.face_nodes[before].tolist()
    }
    assert all(holds(forest, nodes, heights, bound) for nodes in new)


def holds(forest, nodes, heights, bound):
    """Compare a face with all posts inside or on its edges, by barycentric coordinates."""
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = forest.nodes[list(nodes)]
    row, col = np.mgrid[0:N_POST, 0:N_POST].astype(float)
    area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    share_b = ((col - ax) * (cy - ay) - (cx - ax) * (row - ay)) / area
    share_c = ((bx - ax) * (row - ay) - (col - ax) * (by - ay)) / area
    inside = (share_b >= -1e-9) & (share_c >= -1e-9) & (share_b + share_c <= 1 + 1e-9)
    error = np.abs(heights - (az + share_b * (bz - az) + share_c * (cz - az)))
    return bool((error[inside] <= bound + 1e-9).all())
