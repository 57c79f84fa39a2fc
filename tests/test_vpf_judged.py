"""Topology of VPF, broken at random, is judged by `vpfx validate` as by a slow judge of another make."""

from __future__ import annotations

import itertools
from fractions import Fraction

import numpy as np
import planar_judge
import pytest
import shapely
from planar_judge import Tables
from vpf_bytes import ID, NULL_INT, Style, col, write
from vpf_maps import Map

from vpfx.validate import validate
from vpfx.validate.vpf.stars import find_targets, sort_stars
from vpfx.validate.vpf.strips import CROSS, OVERLAP, find_clashes, make_segments, make_strips

STYLE = Style()
COLUMNS = (("nodes", 0, "edges"), ("faces", 0, "rings"), ("rings", 0, "faces"), ("rings", 1, "edges"), ("entities", 0, "faces"),
           ("edges", 0, "nodes"), ("edges", 1, "nodes"), ("edges", 2, "faces"), ("edges", 3, "faces"), ("edges", 4, "edges"),
           ("edges", 5, "edges"))  # fmt: skip
"""Table, column, and table of the rows it names."""


def tables_of(ground):
    """The tables of a map without tiles."""
    tile = ground.whole
    edges = [
        [e.start_node, e.end_node, e.right_face, e.left_face, e.right_edge, e.left_edge, list(e.places)]
        for e in tile.edges
    ]
    first = [min(i for i, e in enumerate(edges, 1) if n in e[:2]) for n in range(1, len(tile.nodes) + 1)]
    rings = [[1, 0], *([face, start] for face, _, start, _ in tile.rings)]
    pointers = [[next(i for i, row in enumerate(rings, 1) if row[0] == face)] for face in range(1, tile.n_face + 1)]
    points = [[face, ground.square(cell).centroid.coords[0]] for cell, face in sorted(tile.face_at.items())]
    points = [[face, tuple(np.float32(place).astype(float).tolist())] for face, place in points]
    return Tables([list(row) for row in zip(first, tile.nodes, strict=True)], edges, pointers, rings, points)


def write_tables(folder, tables):
    """Write the tables as a coverage."""

    def put(name, columns, rows):
        write(folder, STYLE, name, [ID, *columns], [(i, *row) for i, row in enumerate(rows, 1)])

    links = [col(name, "K") for name in ("right_face", "left_face", "right_edge", "left_edge")]
    put("edg", [col("start_node", "I"), col("end_node", "I"), *links, col("coordinates", "C", "*")], tables.edges)
    put("cnd", [col("first_edge", "K"), col("coordinate", "C")], [(edge, [place]) for edge, place in tables.nodes])
    put("fac", [col("ring_ptr", "I")], tables.faces)
    put("rng", [col("face_id", "I"), col("start_edge", "I")], [(face, edge or NULL_INT) for face, edge in tables.rings])
    put(
        "end",
        [col("containing_face", "I"), col("coordinate", "C")],
        [(face, [place]) for face, place in tables.entities],
    )


def break_one(tables, random):
    """Change something, or put it another way."""
    way = int(random.integers(5))
    if way <= 1:
        name, column, other = COLUMNS[random.integers(len(COLUMNS))]
        rows = getattr(tables, name)
        rows[random.integers(len(rows))][column] = int(random.integers(0, len(getattr(tables, other)) + 2))
    elif way == 2:
        i, j = random.integers(1, len(tables.rings), 2).tolist()
        tables.rings[i], tables.rings[j] = tables.rings[j], tables.rings[i]
    elif way == 3:
        edge = tables.edges[random.integers(len(tables.edges))]
        at = int(random.integers(len(edge[6])))
        others = [place for other in tables.edges for place in other[6]]
        moved = edge[6][at][0] + int(random.integers(-40, 41)) / 32, edge[6][at][1] + int(random.integers(-40, 41)) / 32
        edge[6][at] = moved if random.random() < 0.7 else others[random.integers(len(others))]
    else:
        point = tables.entities[random.integers(len(tables.entities))]
        inside = 10 + random.random() * 4, 50 + random.random() * 4
        others = [place for other in tables.edges for place in other[6]]
        place = inside if random.random() < 0.8 else others[random.integers(len(others))]
        point[1] = tuple(np.float32(place).astype(float).tolist())


@pytest.mark.parametrize("seed", range(12))
def test_random_damage_is_noticed(seed, tmp_path):
    random = np.random.default_rng(seed)
    verdicts = set()
    for case in range(12):
        labels = random.integers(0, 3, (3, 4))
        labels[1, 1] = 1
        tables = tables_of(Map(labels, seed=int(random.integers(1000)), n_spur=int(random.integers(3))))
        for _ in range(case % 3):
            break_one(tables, random)
        folder = tmp_path / str(case)
        write_tables(folder, tables)
        report = validate(folder)
        found = [finding for finding in report.findings if finding.code[:3] in ("V72", "V73")]
        assert {finding.code for finding in report.findings} - {finding.code for finding in found} <= {"V762"}
        assert (not found) == planar_judge.is_valid(tables), (seed, case, found[:3])
        verdicts.add(not found)
    assert verdicts == {True, False}


def lines_at_random(random, n_line):
    """Lines on a small lattice: many touch, cross or run along each other."""
    lines = [random.integers(0, 6, (random.integers(2, 5), 2)).astype(float) for _ in range(n_line)]
    return [line for line in lines if len(np.unique(line, axis=0)) > 1]


def test_clashes_are_those_of_fractions():
    random = np.random.default_rng(3)
    for _ in range(150):
        lines = lines_at_random(random, int(random.integers(1, 8)))
        starts = np.concatenate([[0], np.cumsum([len(line) for line in lines])]).astype(np.int64)
        places = np.concatenate([*lines, np.empty((0, 2))])
        segments = make_segments(starts, places)
        pairs, count = find_clashes(segments, make_strips(segments), most=1000)
        assert count.sum() == len(pairs)
        exact = [planar_judge.without_repeats(line) for line in lines]
        assert (len(pairs) == 0) == planar_judge.is_planar(exact)
        ends = [tuple(map(planar_judge.exact, segment.reshape(2, 2))) for segment in segments.ends]
        along = [
            (i, j)
            for (i, a), (j, b) in itertools.combinations(enumerate(ends), 2)
            if planar_judge.meeting(*a, *b) == "line"
        ]
        assert sorted((i, j) for i, j, kind in pairs.tolist() if kind == OVERLAP) == along
        for i, j, kind in pairs.tolist():
            assert kind in (CROSS, OVERLAP)
            assert shapely.LineString(segments.ends[i].reshape(2, 2)).intersects(
                shapely.LineString(segments.ends[j].reshape(2, 2))
            )


def test_strips_hold_many_and_long_segments():
    """A comb of long lines and dense short ones: each pair is found once, whatever the strips."""
    random = np.random.default_rng(8)
    short = random.random((3000, 1, 2)) + random.random((3000, 2, 2)) * 0.01
    long = np.stack([random.random((60, 2)), random.random((60, 2))], axis=1)
    ends = np.concatenate([short, long])
    segments = make_segments(np.arange(len(ends) + 1) * 2, ends.reshape(-1, 2))
    strips = make_strips(segments)
    assert len(strips.cuts) > 5
    pairs, count = find_clashes(segments, strips, most=10**6)
    lines = shapely.linestrings(ends)
    one, other = shapely.STRtree(lines).query(lines, "intersects")
    expected = {(i, j) for i, j in zip(one.tolist(), other.tolist(), strict=True) if i < j}
    assert {(i, j) for i, j, _ in pairs.tolist()} == expected
    assert count[CROSS] == len(expected)


def test_stars_are_sorted_exactly():
    """Directions that differ by the last bit, and many at one node."""
    random = np.random.default_rng(5)
    for n_edge in (3, 9, 200):
        centre = random.random(2)
        ends = centre + random.integers(-3, 4, (n_edge, 2)) + random.integers(-2, 3, (n_edge, 2)) * 2.0**-52
        ends[(ends == centre).all(axis=1)] += 1.0
        places = np.stack([np.tile(centre, (n_edge, 1)), ends], axis=1).reshape(-1, 2)
        starts, node = np.arange(n_edge + 1) * 2, np.tile([0, -1], n_edge)
        _, star, is_beside = sort_stars(node, 1, starts, places, find_targets(starts, places))
        way = [
            tuple(Fraction(a) - Fraction(b) for a, b in zip(ends[side // 2], centre, strict=True))
            for side in star.tolist()
        ]
        compared = [planar_judge.star_order(a, b) for a, b in itertools.pairwise(way)]
        assert all(value <= 0 for value in compared)
        assert [value == 0 for value in compared] == is_beside[1:].tolist()
