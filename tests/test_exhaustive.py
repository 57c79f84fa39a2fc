"""All grids of 3 × 3 posts: every choice of heights 0 and 1, and every choice of voids, through every method; judged."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from invariants import judge_hierarchy
from invariants_ground import find_ground
from surfaces import noise
from test_methods import CASES

from vpfx.model import Grid
from vpfx.pipeline import build_hierarchy

POSTS = 9
RUNS = {
    "wynne, passes": ({}, {"passes": 2}),
    "wynne, least error": ({}, {"max_error": (0.4, 0.2), "diagonal": "least-error"}),
}
for name, case in CASES.items():
    mode = {"max_error": (0.4, 0.2)} if case.bounded else {"passes": 2}
    allowed = {"is_adjacent": case.adjacent, "is_nested": case.nested}
    RUNS[name] = allowed, {"method": case.method, **case.options, **mode}
PARTS = 32  # each test takes every 32nd grid
QUICK = {"wynne": 4}  # parts of the quick stage; one of the others
EVERY = [
    pytest.param(run, part, marks=() if part < QUICK.get(run, 1) else pytest.mark.slow)
    for run, part in itertools.product(RUNS, range(PARTS))
]


def judged(grid, options, **allowed):
    """Build and judge; the message names the grid."""
    try:
        h = build_hierarchy(grid, **options)
        if find_ground(grid.heights).n_triangle:
            judge_hierarchy(h, grid, **allowed)
        else:
            assert not any(len(faces) for faces in h.level_faces)
    except Exception as error:
        raise AssertionError(f"{options}, heights {grid.heights.tolist()}: {error!r}") from error


def grids_of(values):
    return (np.reshape(heights, (3, 3)) for heights in itertools.product(values, repeat=POSTS))


def test_all_grids_are_met():
    assert len({heights.tobytes() for heights in grids_of((0.0, 1.0))}) == 512


@pytest.mark.parametrize(("run", "part"), EVERY)
def test_every_grid_of_two_heights(run, part):
    allowed, options = RUNS[run]
    for heights in itertools.islice(grids_of((0.0, 1.0)), part, None, PARTS):
        judged(Grid(heights), options, **allowed)


@pytest.mark.parametrize(("run", "part"), EVERY)
def test_every_choice_of_voids(run, part):
    allowed, options = RUNS[run]
    heights = noise(3, 3, 11)
    for is_void in itertools.islice(grids_of((0, 1)), part, None, PARTS):
        if run in CASES and not CASES[run].voids and is_void.any():
            continue
        judged(Grid(np.where(is_void, np.nan, heights)), options, **allowed)


@pytest.mark.slow
@pytest.mark.parametrize("options", [{"max_error": (0.2,)}, {"passes": 1}], ids=str)
def test_every_seventh_grid_of_three_heights(options):
    for heights in itertools.islice(grids_of((0.0, 1.0, 2.0)), 0, None, 7):
        judged(Grid(heights), options)


@pytest.mark.slow
def test_every_choice_of_voids_filled():
    heights = noise(3, 3, 11)
    for is_void in grids_of((0, 1)):
        grid = Grid(np.where(is_void, np.nan, heights))
        if find_ground(grid.heights).n_triangle:
            judge_hierarchy(build_hierarchy(grid, fill=True, max_error=(4.0, 1.0)), grid)
