"""Leeways of a node on a side, against exact fractions: inside them a face holds, outside it does not."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from surfaces import noise
from test_settle import N_POST, errors

from vpfx.methods.leeway import find_leeways, share_of
from vpfx.methods.trial import gather_posts, make_room, thinness

N_PLACE, MIDDLE = 3, 0.3
FAR = 1e5  # metres: a post in a corner that is off leaves a leeway only beyond all reason


def leeways(corners, heights, bound, most=np.inf):
    """Leeways at the places of the first side, and the nodes there without their heights."""
    nodes = np.array(corners, float)
    posts, corner, steps = make_room(heights.size)
    n_post = gather_posts(0, nodes, np.array([[0, 1, 2]], np.int32), heights, posts, corner, steps)
    found = np.empty((N_PLACE, 4))
    work, bins = np.empty((6, heights.size)), np.empty((N_PLACE + 1, 4))
    find_leeways(0, 1, 2, posts, n_post, nodes, 1.0, bound, most, MIDDLE, N_PLACE, work, bins, found)
    places = [nodes[0] + share_of(p, MIDDLE, N_PLACE) * (nodes[1] - nodes[0]) for p in range(N_PLACE)]
    return found, places


@st.composite
def faces(draw):
    place = st.tuples(st.integers(0, N_POST - 1), st.integers(0, N_POST - 1))
    (ax, ay), (bx, by), (cx, cy) = posts = draw(st.lists(place, min_size=3, max_size=3, unique=True))
    area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    heights = noise(N_POST, N_POST, draw(st.integers(0, 99)))
    lifts = [draw(st.sampled_from([0.0, 3.0, -5.0])) for _ in range(3)]
    corners = [np.array([u, v, heights[v, u] + lift]) for (u, v), lift in zip(posts, lifts, strict=True)]
    for _ in range(draw(st.integers(0, 3))):
        heights[draw(st.integers(0, N_POST - 1)), draw(st.integers(0, N_POST - 1))] = np.nan
    return area, corners if area > 0 else corners[::-1], heights


@settings(deadline=None, max_examples=25)
@given(faces(), st.sampled_from([1.0, 4.0, 10.0, 25.0]))
def test_a_face_holds_inside_the_leeway_and_not_outside(face, bound):
    area, (a, b, c), heights = face
    if area == 0:
        return
    found, places = leeways((a, b, c), heights, bound)
    for place, (u, v, _) in enumerate(places):
        low, high = found[place, ::2].max(), found[place, 1::2].min()

        def is_held(height, u=u, v=v):
            m = np.array([u, v, height])
            return all(error <= Fraction(bound) for part in ((a, m, c), (m, b, c)) for error in errors(part, heights))

        near = 1e-5 * max(1.0, min(abs(high - low), 1e3))
        if low > high + near or low > FAR or high < -FAR:
            assert not any(is_held(height) for height in np.linspace(*np.clip([high, low], -FAR, FAR), 5))
        elif low < high - 2 * near:
            low_in, high_in = np.clip([low + near, high - near], -FAR, FAR)
            assert is_held(low_in)
            assert is_held(high_in)
            assert is_held((low_in + high_in) / 2)
            assert not (low > -FAR and is_held(low - near))
            assert not (high < FAR and is_held(high + near))


@pytest.mark.parametrize("most", [8.0, 10.0, 14.0, 30.0])
def test_thin_faces_have_no_leeway(most):
    corners = [np.array([0.0, 0, 0]), np.array([12.0, 0, 0]), np.array([3.0, 9, 0])]
    found, places = leeways(corners, np.zeros((N_POST, N_POST)), 1.0, most)
    for place, m in enumerate(places):
        nodes = np.array([*corners, m])
        for (low, high), part in zip(found[place].reshape(2, 2), ((0, 3, 2), (3, 1, 2)), strict=True):
            assert (low <= high) == (thinness.py_func(nodes, *part, 1.0) <= most)
