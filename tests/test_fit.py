"""Fitted heights of nodes, against a least-squares solver that shares no code with them, and what they are for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from surfaces import noise

from vpfx.dem import read_grid
from vpfx.methods import fit
from vpfx.methods.wynne import FITS
from vpfx.model import Grid
from vpfx.pipeline import build_hierarchy

NEW_MEXICO = Path(__file__).resolve().parents[1] / "fixtures/dem/new_mexico_cell_5min_1arcsec.tif"
# A square of posts, cut in four round a node off the posts.
NODES = np.array([[0.0, 0, 0], [12, 0, 0], [12, 12, 0], [0, 12, 0], [5.25, 6.5, 0]])
FACES = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]], np.int32)


def shares(face, u, v):
    """Shares of a face's corners in a place; None outside."""
    corners = np.vstack([NODES[face, :2].T, np.ones(3)])
    found = np.linalg.solve(corners, [u, v, 1.0])
    return found if found.min() > -1e-9 else None


def design(heights):
    """What each face makes of each of its posts: a row of shares of the nodes, and the height of the post."""
    rows, wanted = [], []
    for face in FACES:
        for v in range(heights.shape[0]):
            for u in range(heights.shape[1]):
                found = shares(face, u, v)
                if found is not None and np.isfinite(heights[v, u]):
                    rows.append(np.zeros(len(NODES)))
                    rows[-1][face] = found
                    wanted.append(heights[v, u])
    return np.array(rows), np.array(wanted)


def fitted(heights, is_free, bound=1.0, limit=1e9, powers=FITS["max-error"].powers):
    nodes = NODES.copy()
    nodes[~is_free, 2] = 7.0
    fit.fit_heights(np.arange(4, dtype=np.int32), nodes, FACES, heights, is_free, np.array(powers), bound, limit)
    return nodes


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("n_fixed", [0, 2])
def test_the_first_step_is_that_of_least_squares(n_fixed, seed):
    heights = noise(13, 13, seed)
    heights[3, 4] = np.nan
    is_free = np.arange(5) >= n_fixed
    nodes, faces = NODES.copy(), np.arange(4, dtype=np.int32)
    nodes[:, 2] = np.where(is_free, 0.0, 7.0)
    matrix, pull = np.empty((4, 6)), np.empty((4, 3))
    fit._sum_posts(faces, nodes, FACES, heights, 0, 1.0, matrix, pull)
    change = fit._solve(faces, FACES, matrix, pull, 0.0, is_free)
    rows, wanted = design(heights)
    expected = np.linalg.lstsq(rows[:, is_free], wanted - rows[:, ~is_free].sum(axis=1) * 7.0, rcond=None)[0]
    assert (change[~is_free] == 0).all()
    assert change[is_free] == pytest.approx(expected, rel=2e-3, abs=2e-3 * np.abs(expected).max())


@pytest.mark.parametrize("seed", range(5))
def test_least_squares_leave_the_least_rmse(seed):
    heights = noise(13, 13, seed)
    rows, wanted = design(heights)
    least = np.linalg.lstsq(rows, wanted, rcond=None)[0]
    found = fitted(heights, np.ones(5, bool), powers=FITS["rmse"].powers)[:, 2]
    assert np.square(rows @ found - wanted).sum() == pytest.approx(np.square(rows @ least - wanted).sum(), rel=1e-4)


@pytest.mark.parametrize("seed", range(5))
def test_the_greatest_error_comes_near_the_least_there_is(seed):
    heights = noise(13, 13, seed)
    rows, wanted = design(heights)
    squares = np.abs(rows @ np.linalg.lstsq(rows, wanted, rcond=None)[0] - wanted).max()
    found = np.abs(rows @ fitted(heights, np.ones(5, bool), bound=squares)[:, 2] - wanted).max()
    assert found < squares
    # no heights do better than this: of any weights of the posts that no mesh feels, what the posts make of them
    null = np.linalg.svd(rows.T)[2][len(NODES) :]
    least = max(abs(way @ wanted) / np.abs(way).sum() for way in null)
    assert found >= least


def test_no_node_leaves_the_surface_by_more_than_the_limit():
    heights = noise(13, 13, 3)
    nodes = fitted(heights, np.ones(5, bool), limit=2.0)
    surface = (heights[6, 5] + heights[7, 5]) / 2 * 0.75 + (heights[6, 6] + heights[7, 6]) / 2 * 0.25
    corners = heights[[0, 0, 12, 12], [0, 12, 12, 0]]
    off = np.abs(nodes[:, 2] - [*corners, surface])
    assert off.max() == pytest.approx(2.0)  # and one of them would go farther
    assert np.abs(fitted(heights, np.ones(5, bool))[:, 2] - [*corners, surface]).max() > 2.0


def test_only_the_last_level_is_fitted():
    grid = Grid(noise(33, 33, 1))
    plain, fitted_one = (build_hierarchy(grid, max_error=(20.0, 10.0), fit=fit) for fit in (None, "max-error"))
    assert plain.level_faces[0].shape == fitted_one.level_faces[0].shape
    for h in (plain, fitted_one):
        nodes = h.nodes[h.node_level == 0]
        is_post = (nodes[:, :2] % 1 == 0).all(axis=1)
        assert (nodes[is_post, 2] == grid.heights[nodes[is_post, 1].astype(int), nodes[is_post, 0].astype(int)]).all()
    assert (plain.tin(0).nodes == fitted_one.tin(0).nodes).all()


@pytest.mark.parametrize("bound", [20.0, 10.0])
def test_what_fitted_heights_save(bound):
    grid = read_grid(NEW_MEXICO)
    plain, fewest, nearest = (build_hierarchy(grid, max_error=(bound,), fit=fit) for fit in (None, *FITS))
    assert fewest.tin(0).n_face < 0.8 * plain.tin(0).n_face
    assert nearest.tin(0).n_face < 1.1 * plain.tin(0).n_face
    assert nearest.squared_error[0] < 0.75 * plain.squared_error[0]
