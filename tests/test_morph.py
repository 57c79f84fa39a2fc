"""Blending a level into the one before by z_parent: at its ends it is the two levels, at every post (specs/format.md R-150)."""

from __future__ import annotations

import numpy as np
import pytest
from surfaces import SURFACES, bounds_of, relief_of
from test_methods import CASES

from vpfx.pipeline import build_hierarchy

MORPHING = [name for name, case in CASES.items() if case.nested and case.adjacent]


def heights_at_posts(nodes, faces, grid):
    """Height of a level at every post, NaN where no face is: each post against all faces."""
    n_row, n_col = grid.heights.shape
    a, b, c = ((nodes[faces[:, i]] - (grid.x0, grid.y0, 0.0)) / (grid.dx, grid.dy, 1.0) for i in range(3))
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    found = np.full((n_row, n_col), np.nan)
    for row, col in np.ndindex(n_row, n_col):
        at_b = ((col - a[:, 0]) * (c - a)[:, 1] - (row - a[:, 1]) * (c - a)[:, 0]) / area
        at_c = ((b - a)[:, 0] * (row - a[:, 1]) - (b - a)[:, 1] * (col - a[:, 0])) / area
        inside = np.minimum(np.minimum(at_b, at_c), 1.0 - at_b - at_c)
        best = int(np.argmax(inside)) if len(inside) else -1
        if best >= 0 and inside[best] > -1e-6:
            z = a[best, 2] + at_b[best] * (b - a)[best, 2] + at_c[best] * (c - a)[best, 2]
            found[row, col] = z
    return found


def blended(h, level, t):
    """Nodes of a level, those new at it on the way from the level before (t = 0) to their own heights (t = 1)."""
    nodes = h.tin(level).nodes.copy()
    n_node = len(nodes)
    z_parent = np.where(h.node_level[:n_node] == level, h.node_z_parent[:n_node], nodes[:, 2])
    nodes[:, 2] = z_parent + t * (nodes[:, 2] - z_parent)
    return nodes


@pytest.mark.parametrize("surface", SURFACES)
@pytest.mark.parametrize("case", MORPHING)
def test_a_blend_begins_and_ends_with_the_two_levels(case, surface):
    grid, case = SURFACES[surface], CASES[case]
    if np.isnan(grid.heights).any() and not case.voids:
        pytest.skip("squares cannot follow voids")
    mode = {"max_error": bounds_of(grid, 0.5, 0.2)} if case.bounded else {"passes": 2}
    h = build_hierarchy(grid, method=case.method, **mode, **case.options)
    slack = 1e-9 * np.nanmax(np.abs(grid.heights))
    for level in range(1, h.n_level):
        ends = [heights_at_posts(h.nodes, h.level_faces[k], grid) for k in (level - 1, level)]
        blend = [heights_at_posts(blended(h, level, t), h.level_faces[level], grid) for t in (0.0, 1.0, 0.5)]
        for found, expected in zip(blend, (*ends, (ends[0] + ends[1]) / 2), strict=True):
            np.testing.assert_allclose(found, expected, rtol=0, atol=slack)


def test_what_has_a_height_of_the_level_before():
    h = build_hierarchy(SURFACES["noise"], passes=2)
    assert (np.isnan(h.node_z_parent) == (h.node_level == 0)).all()
    new = h.node_level == 1
    assert np.abs(h.nodes[new, 2] - h.node_z_parent[new]).max() > 0.1 * relief_of(SURFACES["noise"])
