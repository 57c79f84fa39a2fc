"""Posts of faces: none falls between two faces by rounding."""

import numpy as np
import pytest
from surfaces import hills

from vpfx.methods.scan import find_worst, scan_mesh
from vpfx.model import Grid
from vpfx.pipeline import build_hierarchy

UP = 2e-15
BY_THEMSELVES = np.array([[2, 10 + UP, 0], [8.4375, 10 - UP, 0], [4, 10, 0], [7.5, 9, 0], [6, 12, 0], [2, 9, 0]])
FACES = np.array([[0, 1, 4], [3, 1, 2], [3, 2, 5], [5, 2, 0]], np.int32)


@pytest.mark.parametrize("turned", [False, True], ids=["flat", "steep"])
def test_no_post_falls_into_a_crack_of_rounding(turned):
    """North of row 10 lies one face, south of it others that broke the edge, each place rounded by itself."""
    nodes, faces, heights = BY_THEMSELVES, FACES, np.zeros((14, 12))
    if turned:
        nodes, faces, heights = nodes[:, [1, 0, 2]], FACES[:, ::-1].copy(), heights.T.copy()
    residual = np.empty(heights.shape)
    find_worst(np.arange(len(faces), dtype=np.int32), nodes, faces, heights, residual)
    row = residual[:, 10] if turned else residual[10]
    assert np.flatnonzero(np.isfinite(row)).tolist() == [2, 3, 4, 5, 6, 7, 8]


def test_the_slack_of_a_flat_edge_ends_at_its_corners():
    """A sliver as flat as the slack has the posts between its corners, and no others of the row."""
    nodes, heights = np.array([[2.0, 3.0, 0.0], [5.0, 3.0 - 1e-12, 0.0], [7.0, 3.0 + 1e-12, 0.0]]), np.zeros((8, 12))
    residual = np.full(heights.shape, np.nan)
    scan_mesh(nodes, np.array([[0, 1, 2]], np.int32), heights, residual)
    assert np.argwhere(np.isfinite(residual)).tolist() == [[3, col] for col in range(2, 8)]


def test_every_post_is_measured_where_faces_are_cut_by_themselves():
    heights = hills(33, 28, 7)
    hierarchy = build_hierarchy(Grid(heights), method="scarlatos", max_error=(20, 6))
    assert np.isfinite(hierarchy.squared_error).all()
    assert list(hierarchy.n_post) == [heights.size] * 2
