"""Cuts on trial and breaks that settle faces, against a judge that looks at every post with exact fractions."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from surfaces import noise

from vpfx.methods import breaks
from vpfx.methods.forest import Forest
from vpfx.methods.scan import ScanRule, candidates, scan_faces
from vpfx.methods.settle import SettleRule, settle_faces
from vpfx.methods.trial import HOLDS, TOO_THIN, Terms, choose_diagonals, gather_posts, make_room, thinness, try_cut

N_POST = 13
NEAR = Fraction(1, 10**9)
RULE = SettleRule(guard=0.5, middle=0.3, n_place=11, reach=10.0, pair_reach=10.0, rounds=2)
SQUARES = np.array([[0, 1, 4], [0, 4, 3], [1, 2, 4], [2, 5, 4]], np.int32)  # diagonals lean opposite ways


def terms(bound, most_thin=np.inf):
    return tuple(Terms(aspect=1.0, bound=bound, most_thin=most_thin, decay=1.0, diagonal=0, seed=0))


def errors(corners, heights):
    """Exact errors of the valid posts in a face, edges included: a node on an edge is off it by its rounding."""
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = [[Fraction(float(value)) for value in corner] for corner in corners]
    area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    assert area > 0
    found = []
    for row in range(len(heights)):
        for col in range(heights.shape[1]):
            share_b = ((col - ax) * (cy - ay) - (cx - ax) * (row - ay)) / area
            share_c = ((bx - ax) * (row - ay) - (col - ax) * (by - ay)) / area
            if min(share_b, share_c, 1 - share_b - share_c) >= -NEAR and np.isfinite(heights[row, col]):
                height = az + share_b * (bz - az) + share_c * (cz - az)
                found.append(abs(height - Fraction(float(heights[row, col]))))
    return found


def children(corners, breaks_at, flip):
    """Children of a face by rules 1 to 3, as the paper draws them; breaks_at[i] is on the side from corner i, or None."""
    broken = [i for i in range(3) if breaks_at[i] is not None]
    if len(broken) == 3:
        m = breaks_at
        return [(corners[0], m[0], m[2]), (m[0], corners[1], m[1]), (m[1], corners[2], m[2]), (m[0], m[1], m[2])]
    i = next(i for i in broken if len(broken) == 1 or (i + 1) % 3 in broken)
    a, b, c = corners[i], corners[(i + 1) % 3], corners[(i + 2) % 3]
    m, o = breaks_at[i], breaks_at[(i + 1) % 3]
    if len(broken) == 1:
        return [(a, m, c), (m, b, c)]
    return [(m, b, o), *([(m, o, c), (a, m, c)] if flip else [(a, m, o), (a, o, c)])]


@st.composite
def cut_faces(draw):
    """A face, nodes on some of its sides, and heights."""
    place = st.tuples(st.integers(0, N_POST - 1), st.integers(0, N_POST - 1))
    posts = draw(st.lists(place, min_size=3, max_size=3, unique=True))
    (ax, ay), (bx, by), (cx, cy) = posts
    area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    if area < 0:
        posts = posts[::-1]
    shares = [draw(st.none() | st.floats(0.2, 0.8)) for _ in range(3)]
    heights = noise(N_POST, N_POST, draw(st.integers(0, 99)))
    corners = [np.array([u, v, heights[v, u]], float) for u, v in posts]
    nodes = [
        None if share is None else corners[i] + share * (corners[(i + 1) % 3] - corners[i]) + [0.0, 0.0, 1.0]
        for i, share in enumerate(shares)
    ]
    return area != 0, corners, nodes, heights


def tried(corners, nodes, heights, flip, limits):
    """What `try_cut` says of a face with breaks."""
    rows = np.array([*corners, *[[0, 0, 0] if node is None else node for node in nodes]], float)
    face_nodes = np.array([[0, 1, 2]], np.int32)
    side_node = np.array([-1 if node is None else 3 + i for i, node in enumerate(nodes)], np.int32)
    posts, corner, steps = make_room(heights.size)
    n_post = gather_posts(0, rows, face_nodes, heights, posts, corner, steps)
    return try_cut(0, flip, 0, posts, n_post, rows, face_nodes, side_node, limits), n_post


@settings(deadline=None, max_examples=80)
@given(cut_faces(), st.booleans(), st.sampled_from([0.5, 3.0, 8.0, 15.0, 30.0]))
def test_a_cut_on_trial_holds_where_no_post_is_off(face, flip, bound):
    is_face, corners, nodes, heights = face
    if not is_face:
        return
    (found, taken), n_post = tried(corners, nodes, heights, flip, terms(bound))
    assert n_post == len(errors(corners, heights))

    def worst(way):
        parts = [corners] if all(node is None for node in nodes) else children(corners, nodes, way)
        return max(max(errors(part, heights), default=0) for part in parts)

    asked, other = worst(flip), worst(not flip)
    if any(abs(error - Fraction(bound)) < 1e-9 for error in (asked, other)):
        return
    is_two = sum(node is not None for node in nodes) == 2
    assert (found == HOLDS) == (asked <= bound or (is_two and other <= bound))
    assert taken == (flip if asked <= bound or not is_two or other > bound else not flip)


def test_thinness():
    nodes = np.array([[0, 0, 0], [1, 0, 0], [0.5, np.sqrt(0.75), 0], [0, 1, 0], [2, 0, 0]])
    assert thinness.py_func(nodes, 0, 1, 2, 1.0) == pytest.approx(4 * np.sqrt(3))
    assert thinness.py_func(nodes, 0, 1, 3, 1.0) == pytest.approx(8)
    assert thinness.py_func(nodes, 0, 4, 3, 0.5) == pytest.approx(8)
    assert thinness.py_func(nodes, 0, 3, 1, 1.0) == np.inf


@pytest.mark.parametrize("most_thin", [9.0, 12.0, 1e9])
def test_thin_children_are_refused(most_thin):
    corners = [np.array([0.0, 0, 0]), np.array([12.0, 0, 0]), np.array([0.0, 12, 0])]
    heights = np.zeros((N_POST, N_POST))
    for share in (0.1, 0.25, 0.5):
        nodes = [corners[0] + share * (corners[1] - corners[0]), None, None]
        thin = max(
            (sum(((p - q) ** 2).sum() for p, q in zip(part, np.roll(part, 1, axis=0), strict=True)))
            / (0.5 * abs(np.linalg.det([part[1][:2] - part[0][:2], part[2][:2] - part[0][:2]])))
            for part in children(corners, nodes, False)
        )
        (found, _), _ = tried(corners, nodes, heights, False, terms(1.0, most_thin))
        assert found == (HOLDS if thin <= most_thin else TOO_THIN), share


def forest_over(heights):
    """Two squares of posts, each cut in two."""
    last = N_POST - 1
    row, col = np.array([0, 0, 0, last, last, last]), np.array([0, last, 2 * last, 0, last, 2 * last])
    nodes = np.stack([col, row, heights[row, col]], axis=1).astype(float)
    return Forest(nodes, SQUARES.copy(), np.zeros(len(SQUARES), bool))


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10**6), st.floats(0.3, 2.0))
def test_settled_faces_hold_and_nothing_that_held_is_spoilt(seed, bound):
    rng = np.random.default_rng(seed)
    u, v = np.meshgrid(np.arange(2 * N_POST - 1), np.arange(N_POST))
    waves = rng.normal(size=4)
    heights = waves[0] * np.abs(u - rng.integers(3, 22)) * 0.3 + waves[1] * np.sin(v / 3) + waves[2] * np.cos(u / 4)
    forest = forest_over(heights)
    faces = np.arange(len(SQUARES), dtype=np.int32)
    found = candidates(faces, forest.slot)
    scan_faces(
        faces, forest.mesh, heights, np.zeros_like(heights), bound / 2, 1.0, tuple(ScanRule(0.45, 0.15, 1.0, 0.0)),
        forest.face_error, tuple(found),
    )  # fmt: skip
    held = forest.face_error[faces] <= bound
    settled = held.copy()
    forest.reserve_nodes(100)
    broken = settle_faces(
        faces, forest.n_node, forest.tree, heights, terms(bound, 17.0), tuple(RULE), forest.side_state,
        forest.face_error, tuple(found), settled,
    )  # fmt: skip
    assert (settled >= held).all()
    assert len(np.unique(broken)) == len(broken)
    assert len(broken) <= 2 * np.count_nonzero(settled & ~held)
    first = forest.n_node
    forest.n_node += len(broken)
    to_cut, post = np.empty(20, np.int32), np.empty(20, np.int64)
    n = breaks.list_cuts(faces, broken, first, forest.mesh, forest.side_node, tuple(found), to_cut, post)
    assert (post[:n] < 0).all()
    is_flipped = choose_diagonals(
        to_cut[:n], forest.nodes, forest.face_nodes, forest.side_node, heights, terms(bound, 17.0)
    )
    forest.cut(to_cut[:n], post[:n].astype(np.int32), is_flipped)
    for face in np.flatnonzero(settled):
        leaves, _ = forest.leaves(np.array([face], np.int32))
        for leaf in leaves:
            assert max(errors(forest.nodes[forest.face_nodes[leaf]], heights)) <= bound + 1e-9
