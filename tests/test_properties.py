"""Random grids with voids, random bounds and spacings: judged, deterministic, and the same at every scale."""

from __future__ import annotations

import dataclasses

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as of_numpy
from invariants import judge_hierarchy
from invariants_ground import find_ground
from test_methods import arrays_of

from vpfx.model import Grid
from vpfx.pipeline import build_hierarchy

SHAPES = st.tuples(st.integers(2, 12), st.integers(2, 12))
WHOLE = st.integers(-4, 4).map(float)
ANY = st.floats(-1000.0, 1000.0, width=32)
SIZES = st.sampled_from([1.0, 0.5, 0.1, 3.0])
DIAGONALS = st.sampled_from(["shorter", "random", "least-error"])


@st.composite
def grids(draw):
    """Whole or any heights on 2 … 12 rows and columns; none, some or most of the posts void."""
    shape = draw(SHAPES)
    heights = draw(of_numpy.arrays(float, shape, elements=draw(st.sampled_from([WHOLE, ANY]))))
    valid = draw(st.sampled_from([st.just(True), st.integers(0, 9).map(bool), st.booleans()]))
    heights[~draw(of_numpy.arrays(bool, shape, elements=valid))] = np.nan
    return Grid(heights, post_metres=(draw(SIZES), 1.0))


@st.composite
def falling(draw):
    """One to three bounds as shares of 10 m; none so small that whole heights shatter."""
    shares = draw(st.lists(st.floats(0.04, 2.0), min_size=1, max_size=3, unique=True))
    return [10.0 * share for share in sorted(shares, reverse=True)]


def judged(grid, **options):
    """Build twice, compare and judge; without ground the levels must be empty."""
    h = build_hierarchy(grid, **options)
    assert arrays_of(h) == arrays_of(build_hierarchy(grid, **options))
    if find_ground(grid.heights).n_triangle:
        judge_hierarchy(h, grid)
    else:
        assert not any(len(faces) for faces in h.level_faces)
    return h


@settings(deadline=None, max_examples=100)
@given(grids(), falling(), DIAGONALS)
@example(Grid(np.array([[0.0, np.nan], [np.nan, 0.0]])), [1.0], "shorter")
def test_bounded_mode(grid, bounds, diagonal):
    h = judged(grid, max_error=bounds, diagonal=diagonal)
    first = build_hierarchy(grid, max_error=bounds[:1], diagonal=diagonal)
    assert h.level_faces[0].tobytes() == first.level_faces[0].tobytes(), "a finer level changed a coarser one"


@settings(deadline=None, max_examples=100)
@given(grids(), st.integers(0, 3), st.floats(0.0, 2.0), st.floats(0.01, 0.49), DIAGONALS, st.integers(0, 20))
def test_pass_mode(grid, passes, tolerance, ratio, diagonal, start_posts):
    start = {"start": "delaunay", "start_posts": start_posts} if start_posts > 10 else {}
    judged(grid, passes=passes, tolerance=tolerance, xy_ratio=ratio, diagonal=diagonal, seed=start_posts, **start)


@settings(deadline=None, max_examples=40)
@given(grids(), falling())
def test_filled(grid, bounds):
    if find_ground(grid.heights).n_triangle:
        h = build_hierarchy(grid, max_error=bounds, fill=True)
        judge_hierarchy(h, grid)
        assert any(flags.any() for flags in h.face_is_filled) == bool(np.isnan(grid.heights).any())


def assert_scaled(grid, scale, one, other):
    """Build a surface and the same one in other units; everything is the same but for the unit of z."""
    scaled = dataclasses.replace(grid, heights=grid.heights * scale)
    h, g = build_hierarchy(grid, **one), build_hierarchy(scaled, **other)
    assert (h.nodes * (1.0, 1.0, scale)).tobytes() == g.nodes.tobytes()
    assert [faces.tobytes() for faces in h.level_faces] == [faces.tobytes() for faces in g.level_faces]
    assert [error * scale for error in h.max_error] == list(g.max_error)


@settings(deadline=None, max_examples=40)
@given(grids(), falling(), st.integers(-40, 40))
def test_powers_of_two_change_nothing(grid, bounds, power):
    """Heights and bounds scaled by a power of two give the same floats but for the exponent, so the same faces."""
    scale = 2.0**power
    assert_scaled(grid, scale, {"max_error": bounds}, {"max_error": [bound * scale for bound in bounds]})


@settings(deadline=None, max_examples=40)
@given(grids(), st.floats(0.1, 20.0), st.integers(-10, 10))
def test_powers_of_two_change_nothing_in_pass_mode(grid, tolerance, power):
    """As above, within what the allowance for rounding leaves: it is so many metres whatever the heights."""
    scale = 2.0**power
    assert_scaled(grid, scale, {"passes": 2, "tolerance": tolerance}, {"passes": 2, "tolerance": tolerance * scale})
