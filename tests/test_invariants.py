"""The judge is judged: a small valid mesh passes, and each of many ways to break it is found for what it is."""

from __future__ import annotations

import contextlib
import math
from fractions import Fraction
from types import SimpleNamespace

import invariants
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from invariants_ground import find_ground, judge_cover, judge_runs
from invariants_levels import judge_shared_areas
from invariants_store import next_around

LATTICE = {"x0": -114.1, "y0": 32.3, "dx": 1 / 3600, "dy": 1 / 1200}  # no float holds these exactly

# Level 1 breaks the diagonal of the left square, level 0 ── 2 faces a square; faces 2 and 3 do not change.
#
#   3 ───── 5 ───── 2        3 ───── 5 ───── 2      columns 0, 2, 4; rows 0, 2
#   │ 1   ╱ │ 3   ╱ │        │ ╲   ╱ │     ╱ │      node 6 at (0.6, 0.6)
#   │   ╱   │   ╱   │        │   6   │   ╱   │
#   │ ╱   0 │ ╱   2 │        │ ╱   ╲ │ ╱     │
#   0 ───── 4 ───── 1        0 ───── 4 ───── 1
PLACES = np.array([(0, 0), (4, 0), (4, 2), (0, 2), (2, 0), (2, 2), (0.6, 0.6)])
COARSE = np.array([(0, 4, 5), (0, 5, 3), (4, 1, 2), (4, 2, 5)])
FINE = np.array([(0, 4, 6), (6, 4, 5), (0, 6, 3), (6, 5, 3), (4, 1, 2), (4, 2, 5)])
LINKS = np.array([(0, 0), (0, 1), (1, 2), (1, 3), (2, 4), (3, 5)])
HEIGHTS = np.array([[10, 14, 13, 12, 18], [11, 16, 12, 17, 15], [19, 12, 11, 13, 14.0]])


def grid_of(heights, **lattice):
    return invariants.Posts(np.asarray(heights, float), **(LATTICE | lattice))


def to_nodes(places, z, posts):
    return np.column_stack([posts.x0 + places[:, 0] * posts.dx, posts.y0 + places[:, 1] * posts.dy, z])


def exact_errors(nodes, faces, posts):
    """Vertical error at each valid post of the ground by fractions, one post and face at a time."""
    errors = {}
    for row, col in np.argwhere(find_ground(posts.heights).has_post):
        p = [Fraction(float(v)) for v in (posts.x0 + col * posts.dx, posts.y0 + row * posts.dy)]
        for face in faces:
            corners = [[Fraction(float(v)) for v in nodes[n]] for n in face]
            parts = []
            for i in range(3):
                a, b = corners[(i + 1) % 3], corners[(i + 2) % 3]
                parts.append((b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]))
            if min(parts) >= -sum(parts) * Fraction(1, 10**9):
                z = sum(part * corner[2] for part, corner in zip(parts, corners, strict=True)) / sum(parts)
                error = abs(z - Fraction(float(posts.heights[row, col])))
                errors[row, col] = min(error, errors.get((row, col), error))
    return np.array([float(error) for error in errors.values()])


def example():
    """Return the mesh drawn above as a namespace with the fields of `Hierarchy`, and its posts."""
    posts = grid_of(HEIGHTS)
    z = [*(posts.heights[int(v), int(u)] for u, v in PLACES[:6]), 17]
    nodes, levels = to_nodes(PLACES, z, posts), [COARSE.copy(), FINE.copy()]
    errors = [exact_errors(nodes, faces, posts) for faces in levels]
    return SimpleNamespace(
        nodes=nodes,
        node_level=np.array([0] * 6 + [1]),
        level_faces=levels,
        links=[LINKS.copy()],
        face_is_filled=[np.zeros(len(faces), bool) for faces in levels],
        max_error_bound=[float(e.max()) for e in errors],
        max_error=[float(e.max()) for e in errors],
        squared_error=[float((e * e).sum()) for e in errors],
        n_post=[len(e) for e in errors],
        node_z_parent=np.array([*[math.nan] * 6, nodes[0, 2] + 0.3 * (nodes[5, 2] - nodes[0, 2])]),
    ), posts


def test_valid_hierarchy_passes():
    hierarchy, posts = example()
    figures = invariants.judge_hierarchy(hierarchy, posts)
    assert [(f.n_node, f.n_edge, f.n_face, f.n_post) for f in figures] == [(6, 9, 4, 15), (7, 12, 6, 15)]
    assert [f.max_error for f in figures] == pytest.approx(hierarchy.max_error, rel=1e-12)


def _set(field, index, value, level=None):
    """Return a mutation that writes one entry of an array of the hierarchy."""

    def mutate(h, _):
        target = getattr(h, field)
        (target if level is None else target[level])[index] = value

    return mutate


def _add_node(h, place, posts, faces):
    u, v = place
    h.nodes = np.vstack([h.nodes, (posts.x0 + u * posts.dx, posts.y0 + v * posts.dy, 12)])
    h.node_level = np.append(h.node_level, 1)
    h.node_z_parent = np.append(h.node_z_parent, 0.0)
    h.level_faces[1] = np.array(faces)
    h.face_is_filled[1] = np.zeros(len(faces), bool)


def _crack(h, posts):
    """Give face 5 a twin of node 5, one ulp away."""
    _add_node(h, (2, 2), posts, [*FINE[:5], (4, 2, 7)])
    h.nodes[7] = h.nodes[5]
    h.nodes[7, 0] = np.nextafter(h.nodes[5, 0], 0)


def _move(node, axis, spacings):
    def mutate(h, posts):
        h.nodes[node, axis] += spacings * (posts.dx, posts.dy)[axis]

    return mutate


def _drop(face):
    def mutate(h, _):
        h.level_faces[1] = np.delete(h.level_faces[1], face, axis=0)
        h.face_is_filled[1] = h.face_is_filled[1][1:]

    return mutate


def _twins(h, posts):
    """Use a second node at the place of node 6."""
    _add_node(h, (0, 0), posts, [*FINE[:2], (0, 7, 3), (7, 5, 3), *FINE[4:]])
    h.nodes[7] = h.nodes[6]


def _half_split(h, _):
    """Split face 0 of level 0 at node 6, but not its neighbour across the broken edge."""
    h.level_faces[1] = np.array([*FINE[:2], *COARSE[1:]])


def _with(faces, place):
    return lambda h, posts: _add_node(h, place, posts, faces)


MUTATIONS = {
    "flipped": (_set("level_faces", 2, (0, 3, 6), 1), "level 1: face 2: not counter-clockwise"),
    "collapsed": (_set("level_faces", 2, (0, 6, 6), 1), "level 1: face 2: not counter-clockwise"),
    "no such node": (_set("level_faces", (0, 2), 9, 1), "face 0: a corner is not one of the 7 nodes"),
    "later node": (_set("level_faces", (0, 2), 6, 0), "level 0: face 0: a corner is not one of the 6 nodes"),
    "not a number": (_set("nodes", (5, 2), math.nan), "level 0: node 5: a coordinate is not a finite number"),
    "twin node": (_twins, "node 6 and node 7 share a place"),
    "unused node": (_with(FINE, (3, 1)), "level 1: node 7: no face uses it"),
    "wrong node level": (_set("node_level", 6, 0), "level 0: node 6: no face uses it"),
    "unsorted nodes": (_set("node_level", 2, 1), "node 3: nodes are not sorted by level"),
    "dropped inside": (_drop(1), "edge node .* has no other face and does not lie on the outline"),
    "dropped at the border": (_drop(5), "edge node .* has no other face and does not lie on the outline"),
    "third face": (_with([*FINE, (0, 6, 7)], (0.1, 1.9)), "edge node 6 – node 0 .*more than two faces"),
    "same sense": (_with([*FINE, (0, 4, 7)], (2, 2.5)), "edge node 0 – node 4 .*used twice in the same sense"),
    "overlap": (_with([*FINE, (7, 2, 1)], (3.9, 1)), "edge node 1 – node 2 .*: used twice|not counter"),
    "overlap beyond": (_with([*FINE, (2, 1, 7)], (5, 1)), "edge .*node 7 .*does not lie on the outline"),
    "T-junction": (_half_split, "T-junction: node 6 lies within edge node 0 – node 5 of face 2"),
    "crack of an ulp": (_crack, "level 1: (T-junction: node|face .*does not lie on the outline)"),
    "off the outline": (_move(4, 1, 1e-8), "edge node 0 – node 4 has no other face and does not lie on the outline"),
    "beyond the corner": (_move(1, 0, 1e-8), "level 0: face 2: edge .*does not lie on the outline"),
    "short of the corner": (_move(2, 1, -1e-8), "level 0: face .*: edge .*does not lie on the outline"),
    "across an edge": (_move(6, 0, 2.0), "not counter-clockwise"),
    "off its parent's edge": (_move(6, 0, 1e-7), r"level 1: face \d: node 6 lies .* outside its parent face \d"),
    "wrong height": (_set("nodes", (5, 2), 30.0), r"level 0: post \(2, 2\): 19 m off face \d, the bound is"),
    "bound too low": (_set("max_error_bound", 1, 1.0), r"level 1: post .* the bound is 1.0 m"),
    "rising bounds": (_set("max_error_bound", 0, 0.5), "level 1: its bound .* above the 0.5"),
    "claimed error": (_set("max_error", 1, 4.5), "level 1: max_error is 4.5, measured"),
    "claimed rmse": (_set("squared_error", 0, 3.0), "level 0: rmse is .*, measured"),
    "claimed posts": (_set("n_post", 0, 14), "level 0: n_post is 14, measured 15"),
    "childless parent": (_set("links", (4, 0), 3, 0), "level 0: face 2: no child"),
    "swapped parents": (_set("links", slice(4, 6), [(3, 4), (2, 5)], 0), "level 1: face [45]: only child of face"),
    "wrong parent": (
        _set("links", slice(1, 3), [(1, 1), (0, 2)], 0),
        "face 1: node 4 lies .* outside its parent face 1",
    ),
    "missing link": (_set("links", 0, LINKS[1:]), "level 1: face 0: 0 parents, expected one"),
    "two parents": (_set("links", 0, np.vstack([LINKS, (0, 5)])), "level 1: face 5: 2 parents, expected one"),
    "link to nowhere": (_set("links", (5, 1), 6, 0), "level 1: link .*: no such face"),
    "unsorted links": (_set("links", slice(0, 2), [(0, 1), (0, 0)], 0), "level 1: link 1: links are not sorted"),
    "height of the level before": (_set("node_z_parent", 6, 10.31), "level 1: node 6: z_parent is .*10.31"),
    "no height of the level before": (_set("node_z_parent", 6, math.nan), "level 1: node 6: z_parent is .*nan"),
    "flag not inherited": (_set("face_is_filled", 5, True, 1), "no other face|lie on the outline"),
}


@pytest.mark.parametrize("name", MUTATIONS)
def test_broken_hierarchy_is_found(name):
    mutate, message = MUTATIONS[name]
    hierarchy, posts = example()
    mutate(hierarchy, posts)
    with pytest.raises(AssertionError, match=message):
        invariants.judge_hierarchy(hierarchy, posts)


def test_t_junctions_may_be_allowed():
    """Then the sides across have to run along the longer one, and the greatest error at a post counts."""
    hierarchy, posts = example()
    _half_split(hierarchy, posts)
    nodes, faces = hierarchy.nodes, hierarchy.level_faces[1]
    border = invariants.judge_tin(nodes, faces, posts=posts, is_adjacent=False)
    assert border.junctions.tolist() == [[6, 6]]  # side 0 of face 2
    with pytest.raises(AssertionError, match=r"does not lie on the outline|no edge .* along a longer one"):
        invariants.judge_tin(nodes, np.delete(faces, 1, axis=0), posts=posts, is_adjacent=False)
    nodes[6, :2] = to_nodes(np.array([[1.0, 1.0]]), 0.0, posts)[0, :2]  # on a post
    errors = []
    for z in (posts.heights[1, 1], 50.0):
        nodes[6, 2] = z
        measured = [
            invariants.judge_bound(nodes, faces, np.zeros(5, bool), posts, is_adjacent=is_adjacent)
            for is_adjacent in (True, False)
        ]
        errors.append([m.squared_error for m in measured])
    across = posts.heights[1, 1] - (nodes[0, 2] + nodes[5, 2]) / 2
    assert errors[0][1] - errors[0][0] == pytest.approx(across**2)
    assert errors[1][1] > errors[1][0]


def test_voids():
    """A void under a face, a post without a face and a flag that is not inherited each have their own message."""
    hierarchy, posts = example()
    nodes, no = hierarchy.nodes, np.zeros(6, bool)
    holed = posts._replace(heights=np.where(HEIGHTS == 17, np.nan, HEIGHTS))
    with pytest.raises(AssertionError, match=r"face [45]: covers the void post \(1, 3\)"):
        invariants.judge_bound(nodes, FINE, no, holed)
    with pytest.raises(AssertionError, match=r"edge .* does not lie on the outline|no edge lies on it"):
        invariants.judge_tin(nodes, FINE, posts=holed)
    with pytest.raises(AssertionError, match=r"post \(0, 3\): no face covers it"):
        invariants.judge_bound(nodes, FINE[:4], no[:4], posts)
    with pytest.raises(AssertionError, match=r"level 0: face 5: is_filled differs from its parent face 3"):
        invariants.judge_links(nodes, COARSE, FINE, LINKS, is_filled=(np.zeros(4), np.arange(6) == 5))
    with pytest.raises(AssertionError, match=r"faces cover .*, expected 8.0"):
        invariants.judge_tin(nodes, FINE, expected_area=8.0)
    invariants.judge_tin(nodes, FINE, expected_area=8.0 / 3600 / 1200)


def test_no_ground():
    """Where nothing has data, faces that are all filled must cover the rectangle, and there is nothing to measure."""
    hierarchy, posts = example()
    hierarchy.face_is_filled = [np.ones(len(faces), bool) for faces in hierarchy.level_faces]
    hierarchy.max_error = hierarchy.squared_error = hierarchy.n_post = [0, 0]
    void = posts._replace(heights=np.where(HEIGHTS == 17, HEIGHTS, math.nan))
    figures = invariants.judge_hierarchy(hierarchy, void)
    assert [(f.n_post, f.max_error, f.rmse, f.n_face) for f in figures] == [(0, 0, 0, 4), (0, 0, 0, 6)]
    for change, message in (
        ({"n_post": [0, 1]}, "level 1: n_post is 1, measured 0"),
        ({"max_error": [0, 1e-9]}, "level 1: max_error is 1e-09, measured 0"),
        ({"squared_error": [1e-9, 0]}, "level 0: rmse is .*, measured 0"),
        ({"face_is_filled": [np.ones(4), np.arange(6) > 0]}, "level 1: faces, but no ground with data"),
        ({"level_faces": [COARSE, FINE[:5]], "face_is_filled": [np.ones(4), np.ones(5)]}, "not lie on the outline"),
    ):
        with pytest.raises(AssertionError, match=message):
            invariants.judge_hierarchy(SimpleNamespace(**{**vars(hierarchy), **change}), void)


def test_runs_that_are_covered_in_part():
    """The sides along a run of the outline begin and end with it, and each begins where the last ended."""
    ground = find_ground(HEIGHTS)  # its first run is the northern border, four posts long
    for low, high, message in (
        ((0, 2, 3), (2, 3, 4), None),
        ((1, 2), (2, 4), "on row 2 from 0 to 4: a gap or two edges at 1"),
        ((0, 2), (1, 4), "on row 2 from 0 to 4: a gap or two edges at 2"),
        ((0, 0), (4, 4), "on row 2 from 0 to 4: a gap or two edges at 0"),
        ((0, 2), (2, 3), "on row 2 from 0 to 4: edges end at 3"),
    ):
        others = [(0, 4), (0, 2), (0, 2)]
        run = np.array([0] * len(low) + [1, 2, 3])
        sides = np.array([*low, *(o[0] for o in others)]), np.array([*high, *(o[1] for o in others)])
        with pytest.raises(AssertionError, match=message) if message else contextlib.nullcontext():
            judge_runs(ground, run, *sides, 1e-9, invariants.Label())


def test_further_witnesses():
    """Area and Euler characteristic are compared even where the outline is right; nothing and too much are refused."""
    (hierarchy, posts), ground = example(), find_ground(HEIGHTS)
    nodes = hierarchy.nodes
    for wrong, message in (
        ({"euler": 0}, "V - E \\+ F is 1, that of"),
        ({"n_triangle": 15}, "faces cover .*, the ground is"),
    ):
        with pytest.raises(AssertionError, match=message):
            judge_cover(nodes, FINE, posts, ground._replace(**wrong))
    void = posts._replace(heights=np.full(HEIGHTS.shape, math.nan))
    with pytest.raises(AssertionError, match=r"faces, but no ground with data"):
        invariants.judge_tin(nodes, FINE, posts=void)
    with pytest.raises(AssertionError, match="faces, but no ground with data"):
        invariants.judge_bound(nodes, FINE, np.zeros(6, bool), void)
    with pytest.raises(AssertionError, match="face 1: not counter-clockwise"):
        invariants.judge_bound(nodes, [FINE[0], FINE[1][::-1]], np.zeros(2, bool), posts)
    with pytest.raises(AssertionError, match="level 0: no faces"):
        invariants.judge_tin(nodes, FINE[:0])
    with pytest.raises(AssertionError, match="a lattice too large"):
        find_ground(np.broadcast_to(0.0, (1 << 22, 2)))
    measured = invariants.judge_bound(nodes, FINE, np.zeros(6, bool), posts)
    with pytest.raises(AssertionError, match=r"level 0: max_error is 3.5, its bound 3.4"):
        invariants.judge_figures(measured, 3.4, 3.5, measured.rmse, invariants.Label())


def test_children_that_leave_a_gap():
    """Corners inside are not enough: one half only is a gap, and so is a part a billionth narrower than the whole."""
    nodes = np.array([(0, 0, 0), (8, 0, 0), (0, 8, 0), (4, 4, 0), (4 - 1e-9, 4, 0), (4, 4 - 1e-9, 0)], float)
    for family in ([(0, 1, 3)], [(0, 1, 3), (0, 4, 2)], [(0, 1, 5), (0, 5, 2)]):
        links = [(0, i) for i in range(len(family))]
        with pytest.raises(AssertionError, match=r"face 0: children cover|only child"):
            invariants.judge_links(nodes, [(0, 1, 2)], family, links)
    invariants.judge_links(nodes, [(0, 1, 2)], [(0, 1, 3), (0, 3, 2)], [(0, 0), (0, 1)])


def lattice_mesh(posts, up, filled=False):
    """Triangulate the ground, or the rest of the rectangle; `up` tells which diagonal cuts a square."""
    n_row, n_col = posts.heights.shape
    faces = []
    for row, col in np.ndindex(n_row - 1, n_col - 1):
        sw, se, nw, ne = (
            post[0] * n_col + post[1] for post in ((row, col), (row, col + 1), (row + 1, col), (row + 1, col + 1))
        )
        void = [post for post in (sw, se, nw, ne) if np.isnan(posts.heights.flat[post])]
        is_up = up[row, col] if len(void) != 1 else void[0] in (se, nw)
        pair = [(sw, se, ne), (sw, ne, nw)] if is_up else [(sw, se, nw), (se, ne, nw)]
        faces += [face for face in pair if (len(void) > 1 or bool(set(face) & set(void))) == filled]
    return np.array(faces, np.int64).reshape(-1, 3)


def compact(nodes, faces):
    used, index = np.unique(faces, return_inverse=True)
    return nodes[used], index.reshape(-1, 3)


def quarter(nodes, faces):
    """Cut each face into four at the middles of its sides, computed in floats, and link them."""
    ends, index = np.unique(
        np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)), axis=0, return_inverse=True
    )
    a, b, c = faces.T
    ab, bc, ca = len(nodes) + index.reshape(-1, 3).T
    parts = np.stack([(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]).transpose(2, 0, 1).reshape(-1, 3)
    return (
        np.vstack([nodes, nodes[ends].mean(axis=1)]),
        parts,
        np.stack([np.arange(len(parts)) // 4, np.arange(len(parts))], axis=1),
    )


@st.composite
def ground(draw):
    """Draw a small grid with voids on an awkward lattice, and diagonals."""
    n_row, n_col = draw(st.integers(2, 5)), draw(st.integers(2, 5))
    random = np.random.default_rng(draw(st.integers(0, 10**6)))
    heights = np.where(
        random.random((n_row, n_col)) < draw(st.sampled_from((0, 0.1, 0.3))),
        np.nan,
        random.normal(500, 30, (n_row, n_col)),
    )
    x0, dx = draw(st.sampled_from(((0.0, 1.0), (-114.1, 1 / 3600), (4.2e6, 30.3), (-7.7, 3.3), (1e-3, 1e-7))))
    posts = grid_of(heights, x0=x0, dx=dx, y0=x0 / 3, dy=dx * 1.7)
    return posts, random.random(heights.shape) < 0.5, random


@settings(max_examples=40, deadline=None)
@given(ground())
def test_any_ground(case):
    """A mesh of the ground passes, and so do its quarters; not so with one corner changed or one face gone."""
    posts, up, random = case
    n_row, n_col = posts.heights.shape
    places = np.array([(col, row) for row in range(n_row) for col in range(n_col)], float)
    every = to_nodes(places, np.nan_to_num(posts.heights.ravel()) + random.normal(0, 3, n_row * n_col), posts)
    real, rest = lattice_mesh(posts, up), lattice_mesh(posts, up, filled=True)
    if not len(real):
        return
    everything, flags = np.vstack([real, rest]), np.arange(len(real) + len(rest)) >= len(real)
    invariants.judge_tin(every, everything, is_filled=flags, posts=posts)
    nodes, faces = compact(every, real)
    invariants.judge_tin(nodes, faces, posts=posts)
    finer, parts, links = quarter(nodes, faces)
    invariants.judge_tin(finer, parts, posts=posts)
    invariants.judge_links(finer, faces, parts, links)
    errors = exact_errors(finer, parts, posts)
    measured = invariants.judge_bound(finer, parts, np.zeros(len(parts), bool), posts, bound=errors.max())
    assert measured.n_post == len(errors)
    assert measured.least_max <= errors.max() <= measured.greatest_max <= errors.max() + 1e-6
    assert measured.rmse == pytest.approx(math.sqrt(np.mean(errors**2)), rel=1e-9)
    with pytest.raises(AssertionError, match="the bound is"):
        invariants.judge_bound(finer, parts, np.zeros(len(parts), bool), posts, bound=errors.max() - 1e-6)
    wrong, face, corner = parts.copy(), random.integers(len(parts)), random.integers(3)
    wrong[face, corner] = (wrong[face, corner] + random.integers(1, len(finer))) % len(finer)
    for broken in (wrong, np.delete(parts, face, axis=0)):
        with pytest.raises(AssertionError, match="level 0: "):
            invariants.judge_tin(finer, broken, posts=posts)


@settings(max_examples=100, deadline=None)
@given(
    st.lists(st.tuples(st.integers(-3, 3), st.integers(-3, 3)), min_size=1, max_size=12, unique=True),
    st.integers(40, 52),
)
def test_directions_are_sorted_exactly(ends, bits):
    """Around a node, spokes that floats cannot tell apart are still met in the right order."""
    ways = sorted(
        {(Fraction(x) + Fraction(y, 2**bits), Fraction(y)) for x, y in ends if x or y},
        key=lambda w: math.atan2(w[1], w[0]),
    )
    unlike = [
        w
        for i, w in enumerate(ways)
        if not any(w[0] * v[1] == w[1] * v[0] and w[0] * v[0] + w[1] * v[1] > 0 for v in ways[:i])
    ]
    if not unlike:
        return
    xy = np.array([(0.0, 0.0), *((float(x), float(y)) for x, y in unlike)])
    following = next_around(xy, np.zeros(len(unlike), int), np.arange(1, len(xy)))
    assert sorted(following[: len(unlike)]) == list(range(len(unlike)))
    for i, j in enumerate(following[: len(unlike)]):
        for k in set(range(len(unlike))) - {i, j}:
            assert _turn(unlike[i], unlike[j]) < _turn(unlike[i], unlike[k])


def _turn(start, end):
    """Return a number that grows with the angle from one direction counter-clockwise to another; exact."""
    cross, dot = start[0] * end[1] - start[1] * end[0], start[0] * end[0] + start[1] * end[1]
    if cross == 0:
        return Fraction(4 if dot > 0 else 2)
    return (1 if cross > 0 else 3) - dot / (abs(dot) + abs(cross)) * (1 if cross > 0 else -1)


def test_shared_areas():
    """The judge of links of many to many: two ways to cut a square, every pair of faces shares a quarter of it."""
    nodes = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0.0]])
    one, other = np.array([[0, 1, 2], [0, 2, 3]]), np.array([[0, 1, 3], [1, 2, 3]])
    links, areas = np.array([[0, 0], [1, 0], [0, 1], [1, 1]]), np.ones(4)
    judge_shared_areas(nodes, one, other, links, areas, invariants.Label(1))
    for wrong, shares, message in (
        (links[:3], areas[:3], "parent 1: shares 1 of its area 2"),
        (links, np.array([1.1, 0.9, 0.9, 1.1]), r"link \(0, 0\): shares 1.1, found 1"),
        (links, np.array([1.0, 1.0, 2.0, 0.0]), r"link \[1, 1\]: shares 0"),
        (links[[1, 0, 2, 3]], areas, "links 0, 1: not in order"),
    ):
        with pytest.raises(AssertionError, match=message):
            judge_shared_areas(nodes, one, other, wrong, shares, invariants.Label(1))
