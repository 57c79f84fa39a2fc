"""Measures of levels against slow counts that share no code with them, and the paper's table 2."""

from __future__ import annotations

import itertools
import math
import re
from pathlib import Path

import numpy as np
import pytest
from invariants_mesh import judge_mesh
from surfaces import SOLID, SURFACES, relief_of
from test_methods import CASES
from test_morph import heights_at_posts

from vpfx.compare import compare, table_1
from vpfx.dem import read_grid
from vpfx.errors import InputError
from vpfx.measures import (
    NORMAL,
    measure_accuracy,
    measure_hierarchy,
    measure_shape,
    measure_step,
    streakiness,
)
from vpfx.methods import METHODS
from vpfx.model import CUTS, Tin
from vpfx.pipeline import build_hierarchy
from vpfx.report import to_text
from vpfx.table_2 import cut_equilateral, table_2

ROOT = Path(__file__).resolve().parents[1]
TABLE_2 = {
    "ternary": (1.0, 12.37, 12.37, 12.37),
    "quaternary": (0.0, 1.0, 1.0, 1.0),
    "scarlatos": (0.53, 7.02, 12.37, 1.0),
    "wynne": (0.45, 6.48, 12.37, 1.0),
}
"""Streakiness and average, greatest and least sliveriness as printed (paper-facts §4)."""


def test_table_2_is_the_papers():
    found = table_2()
    assert set(TABLE_2) <= set(found)
    for name, (streaks, *shapes) in TABLE_2.items():
        assert round(found[name][0], 2) == streaks
        assert found[name][1:] == pytest.approx(shapes, abs=0.02)


def test_the_page_shows_the_tables():
    page = (ROOT / "specs/methods.md").read_text(encoding="utf-8")
    grid = read_grid(ROOT / "fixtures/dem/new_mexico_cell_5min_1arcsec.tif")
    assert to_text(table_1(compare(grid, passes=3, grid=(9, 9), tolerance=5))) in page
    for name, figures in table_2().items():
        streaks, *shapes = (f"{figure:.2f}" for figure in figures)
        assert re.search(rf"^\| `{name}` \| {streaks} \(.*\) \| {' .*'.join(shapes)} ", page, re.MULTILINE), name


def test_children_of_an_equilateral_triangle():
    """Exact values of paper-facts §4, and the children make up the triangle."""
    root = math.sqrt(3)
    ternary, half = (1 + 2 / root) ** 2 * 4 * root, (1.5 + root / 2) ** 2 * 8 / root
    expected = {
        "one edge": [half] * 2,
        "two edges": [12 * root, half, ternary],
        "three edges": [12 * root] * 4,
        "centre": [ternary] * 3,
    }
    for kind, shapes in expected.items():
        assert sorted(cut_equilateral(kind)) == pytest.approx(sorted(shapes)), kind
    assert cut_equilateral("centre and one edge").mean() == pytest.approx(29.011, abs=1e-3)


def test_streakiness_counts_bisections():
    assert math.isnan(streakiness([0] * len(CUTS)))
    for count in itertools.product(range(3), repeat=len(CUTS)):
        one, two, three, centre, both = count
        vertex, edge = one + two + 3 * centre + 3 * both, one + 2 * two + 3 * three + both
        if vertex + edge:
            assert streakiness(count) == vertex / (vertex + edge)


@pytest.mark.parametrize("surface", ["noise", "cliff", "lon lat", "ring with island"])
@pytest.mark.parametrize("case", CASES)
def test_measures_against_slow_counts(case, surface):
    grid, case = SURFACES[surface], CASES[case]
    if np.isnan(grid.heights).any() and not case.voids:
        pytest.skip("squares cannot follow voids")
    tolerance = 0.1 * relief_of(grid)
    h = build_hierarchy(grid, method=case.method, passes=2, tolerance=tolerance, **case.options)
    metres = np.array(grid.post_metres) / (grid.dx, grid.dy)
    cuts = 0
    if not case.nested:
        assert h.cuts.sum() == 0
    for level, found in enumerate(measure_hierarchy(h, grid, tolerance)):
        tin = h.tin(level)
        assert (found.nodes, found.faces) == (tin.n_node, tin.n_face)
        judge_shape(tin, metres, found.shape)
        error = heights_at_posts(tin.nodes, tin.face_nodes, grid) - grid.heights
        error = error[~np.isnan(error)]
        assert found.accuracy.posts == len(error)
        if case.adjacent:
            accuracy = [np.abs(error).max(), np.sqrt((error**2).mean()), np.percentile(np.abs(error), 99), error.mean()]
            assert found.accuracy[:4] == pytest.approx(accuracy, rel=1e-9, abs=1e-9 * relief_of(grid))
        cuts = cuts + h.cuts[level]
        assert found.streakiness == pytest.approx(streakiness(cuts), nan_ok=True)
        if level and not case.nested:
            parents = np.bincount(h.links[level - 1][:, 1], minlength=tin.n_face)
            assert found.step.one_parent == (parents == 1).mean()
            assert np.isnan(found.step[3:]).all() == (parents > 1).any()
        elif level:
            judge_step(h, level, tolerance, found.step)


def judge_shape(tin, metres, shape):
    """Compare with counts face by face."""
    slivers, angles, edges = [], [], set()
    for face in tin.face_nodes.tolist():
        corners = [tin.nodes[n, :2] * metres for n in face]
        sides = [math.dist(corners[i], corners[(i + 1) % 3]) for i in range(3)]
        half = sum(sides) / 2
        area = math.sqrt(max(0.0, half * math.prod(half - side for side in sides)))
        slivers.append(4 * half * half / area)
        a, b, c = sorted(sides)
        angles.append(math.degrees(math.acos((b * b + c * c - a * a) / (2 * b * c))))
        edges |= {frozenset((face[i], face[(i + 1) % 3])) for i in range(3)}
    degree = np.bincount([node for edge in edges for node in edge])
    expected = [
        np.mean(slivers),
        max(slivers),
        min(slivers),
        np.mean(slivers) - NORMAL,
        *np.percentile(angles, (5, 50)),
    ]
    assert shape[3:9] == pytest.approx(expected, rel=1e-4)
    assert shape[9:] == (pytest.approx(degree[degree > 0].mean()), degree.max())
    border = judge_mesh(tin.nodes, tin.face_nodes, is_adjacent=False)
    gaps = []
    for node, side in border.junctions.tolist():
        a, b = (tin.nodes[tin.face_nodes[side // 3, (side + i) % 3]] for i in range(2))
        share = math.dist(tin.nodes[node, :2], a[:2]) / math.dist(b[:2], a[:2])
        gaps.append(abs(tin.nodes[node, 2] - a[2] - share * (b[2] - a[2])))
    found = shape.t_junctions, shape.max_gap, shape.mean_gap
    assert found == (len(gaps), pytest.approx(max(gaps, default=0.0)), pytest.approx(np.mean(gaps) if gaps else 0.0))


def judge_step(h, level, tolerance, step):
    """Compare with counts parent by parent."""
    points, children = [], {}
    for parent, child in h.links[level - 1].tolist():
        children.setdefault(parent, []).append(child)
    for family in children.values():
        if len(family) > 1:
            nodes = {node for child in family for node in h.level_faces[level][child].tolist()}
            new = [node for node in nodes if h.node_level[node] == level]
            points.append(sum(abs(h.nodes[node, 2] - h.node_z_parent[node]) > tolerance for node in new))
    assert step.one_parent == 1.0
    assert step.area_error < 1e-9
    assert step.cuts == len(points)
    assert h.cuts[level].sum() in (0, len(points))  # 0 where squares are cut
    assert step.needless == pytest.approx(np.mean([p == 0 for p in points]) if points else 0.0)
    assert step.points_per_cut == pytest.approx(np.mean(points) if points else 0.0)


def test_what_is_not_nested_is_told():
    h = build_hierarchy(SOLID["noise"], passes=1)
    coarse, fine, rise = h.tin(0), h.tin(1), np.full(h.tin(1).n_node, np.nan)
    links = np.vstack([h.links[0], [(1, 0)]])
    step = measure_step(coarse, fine, links, rise)
    assert step.one_parent == 1 - 1 / fine.n_face
    assert step.cuts == 0
    assert np.isnan([step.area_error, step.needless, step.points_per_cut]).all()


def test_nothing_to_measure_is_refused():
    empty = Tin(np.empty((0, 3)), np.empty((0, 3), np.int32))
    with pytest.raises(InputError, match="found no face"):
        measure_shape(empty)
    with pytest.raises(InputError, match="no valid post under the faces"):
        measure_accuracy(empty, SOLID["noise"])


def test_methods_make_the_cuts_they_name():
    for name, method in METHODS.items():
        h = build_hierarchy(SOLID["noise"], method=name, passes=3, grid=(3, 2))
        made = {kind for kind, count in zip(CUTS, h.cuts.sum(axis=0), strict=True) if count}
        assert made <= set(method.cuts), name
