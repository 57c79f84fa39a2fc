"""A slow judge of VPF topology at level 3, one value at a time and in fractions; no code of vpfx is used.

It is told the rows of ``cnd``, ``edg``, ``fac``, ``rng`` and ``end`` as lists of numbers, ids from 1, 0 for none.
"""

from __future__ import annotations

import functools
import itertools
from fractions import Fraction
from typing import Any, NamedTuple

__all__ = ["Tables", "is_valid"]


class Tables(NamedTuple):
    """Rows of the tables of a tile; each is a list, so that a test can change it."""

    nodes: list[list[Any]]  # first edge, place
    edges: list[list[Any]]  # start and end node, right and left face, right and left edge, places
    faces: list[list[Any]]  # ring pointer
    rings: list[list[Any]]  # face, start edge
    entities: list[list[Any]]  # containing face, place


def exact(place):
    return Fraction(place[0]), Fraction(place[1])


def turn(a, b, c):
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def meeting(a, b, c, d):
    """What two segments have in common: None, a place, or "line"."""
    p, q = (b[0] - a[0], b[1] - a[1]), (d[0] - c[0], d[1] - c[1])
    det = p[0] * q[1] - p[1] * q[0]
    to_c = c[0] - a[0], c[1] - a[1]
    if det != 0:
        t, u = (to_c[0] * q[1] - to_c[1] * q[0]) / det, (to_c[0] * p[1] - to_c[1] * p[0]) / det
        return (a[0] + t * p[0], a[1] + t * p[1]) if 0 <= t <= 1 and 0 <= u <= 1 else None
    if to_c[0] * p[1] - to_c[1] * p[0] != 0:
        return None
    axis = 0 if p[0] != 0 else 1
    low, high = (
        max(min(a, b, key=lambda x: x[axis]), min(c, d, key=lambda x: x[axis]), key=lambda x: x[axis]),
        min(max(a, b, key=lambda x: x[axis]), max(c, d, key=lambda x: x[axis]), key=lambda x: x[axis]),
    )
    if low[axis] > high[axis]:
        return None
    return low if low[axis] == high[axis] else "line"


def without_repeats(places):
    found = [exact(place) for place in places]
    return [place for i, place in enumerate(found) if i == 0 or place != found[i - 1]]


def is_planar(lines):
    """Tell whether lines meet at their ends only."""
    segments = [
        (i, k, len(line) - 2, line[k], line[k + 1]) for i, line in enumerate(lines) for k in range(len(line) - 1)
    ]
    for (i, k, last_i, a, b), (j, m, last_j, c, d) in itertools.combinations(segments, 2):
        common = meeting(a, b, c, d)
        if common is None:
            continue
        if common == "line":
            return False
        ends_i = [end for end, is_end in ((a, k == 0), (b, k == last_i)) if is_end]
        ends_j = [end for end, is_end in ((c, m == 0), (d, m == last_j)) if is_end]
        is_bend = i == j and abs(k - m) == 1 and common == (b if k < m else a)
        if not is_bend and not (common in ends_i and common in ends_j):
            return False
    return True


def star_order(one, other):
    """Compare two directions by the way from east, counter-clockwise."""
    halves = [direction[1] < 0 or (direction[1] == 0 and direction[0] < 0) for direction in (one, other)]
    if halves[0] != halves[1]:
        return -1 if halves[1] else 1
    cross = one[0] * other[1] - one[1] * other[0]
    return -1 if cross > 0 else 1 if cross < 0 else 0


def stars_of(edges, lines):
    """Ends of edges round each node: (edge, end) counter-clockwise."""
    stars = {}
    for i, (edge, line) in enumerate(zip(edges, lines, strict=True)):
        for end, node, (x, y), (x1, y1) in ((0, edge[0], line[0], line[1]), (1, edge[1], line[-1], line[-2])):
            stars.setdefault(node, []).append(((x1 - x, y1 - y), (i, end)))
    by_direction = functools.cmp_to_key(lambda a, b: star_order(a[0], b[0]))
    return {node: [side for _, side in sorted(star, key=by_direction)] for node, star in stars.items()}


def area_of(ring, lines):
    places = [place for i, end in ring for place in (lines[i] if end == 0 else lines[i][::-1])[:-1]]
    return sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(places, places[1:] + places[:1], strict=True)) / 2


def is_within(place, ring, lines):
    """Tell whether a place lies within a ring, by the edges that a ray to the east meets."""
    odd = False
    for i, end in ring:
        line = lines[i] if end == 0 else lines[i][::-1]
        for a, b in itertools.pairwise(line):
            if (a[1] > place[1]) != (b[1] > place[1]):
                x = a[0] + (place[1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
                odd ^= x > place[0]
    return odd


def is_in_range(tables):
    n_node, n_edge, n_face, n_ring = map(len, (tables.nodes, tables.edges, tables.faces, tables.rings))
    for a, b, right, left, right_edge, left_edge, _ in tables.edges:
        if not (1 <= a <= n_node and 1 <= b <= n_node and 1 <= right <= n_face and 1 <= left <= n_face):
            return False
        if not (1 <= right_edge <= n_edge and 1 <= left_edge <= n_edge):
            return False
    return (
        all(0 <= edge <= n_edge for edge, _ in tables.nodes)
        and all(0 <= ring <= n_ring for (ring,) in tables.faces)
        and all(1 <= face <= n_face and 0 <= edge <= n_edge for face, edge in tables.rings)
        and all(1 <= face <= n_face for face, _ in tables.entities)
    )


def is_valid(tables):
    """Tell whether the tables are what V-500 to V-505 ask for."""
    if not is_in_range(tables):
        return False
    lines = [without_repeats(edge[6]) for edge in tables.edges]
    places = [exact(place) for _, place in tables.nodes]
    if any(len(line) < 2 for line in lines) or len(set(places)) < len(places):
        return False
    if any(
        (line[0], line[-1]) != (places[e[0] - 1], places[e[1] - 1]) for e, line in zip(tables.edges, lines, strict=True)
    ):
        return False
    if not is_planar(lines):
        return False
    stars = stars_of(tables.edges, lines)
    following = {}
    for star in stars.values():
        for side, other in zip(star, star[1:] + star[:1], strict=True):
            following[side] = other
            i, end = side
            if tables.edges[i][4 if end else 5] != other[0] + 1:
                return False
    for n, (first, _) in enumerate(tables.nodes, 1):
        if n not in stars or first - 1 not in {i for i, _ in stars[n]}:
            return False
    return faces_are_valid(tables, lines, following)


def faces_are_valid(tables, lines, following):
    rings, left = [], set(following)
    while left:
        at = first = min(left)
        ring = []
        while True:
            ring.append(at)
            left.discard(at)
            at = following[at[0], 1 - at[1]]
            if at == first:
                break
        rings.append(ring)
    faces = [{tables.edges[i][2 + end] for i, end in ring} for ring in rings]
    if any(len(found) > 1 for found in faces):
        return False
    face_of = [found.pop() for found in faces]
    areas = [area_of(ring, lines) for ring in rings]
    outer = [face for face, area in zip(face_of, areas, strict=True) if area < 0]
    if sorted(outer) != list(range(2, len(tables.faces) + 1)):
        return False
    return ring_rows_are_valid(tables, rings, face_of, areas) and is_contained(tables, lines, rings, face_of, areas)


def ring_rows_are_valid(tables, rings, face_of, areas):
    ring_of = {side: k for k, ring in enumerate(rings) for side in ring}
    seen, first_row = [], {}
    for row, (face, start) in enumerate(tables.rings, 1):
        is_first = face not in first_row
        first_row.setdefault(face, row)
        if not is_first and tables.rings[row - 2][0] != face:
            return False
        if start == 0:
            if face != 1 or not is_first:
                return False
            continue
        sides = [(start - 1, end) for end in (0, 1) if tables.edges[start - 1][2 + end] == face]
        if not sides:
            return False
        k = ring_of[sides[0]]
        seen.append(k)
        if (areas[k] < 0) != (is_first and face != 1):
            return False
    pointers = [ring for (ring,) in tables.faces]
    return sorted(seen) == list(range(len(rings))) and pointers == [
        first_row.get(f, -1) for f in range(1, len(pointers) + 1)
    ]


def is_contained(tables, lines, rings, face_of, areas):
    def around(place, but):
        found = [
            (-areas[k], face_of[k])
            for k, ring in enumerate(rings)
            if areas[k] < 0 and k not in but and is_within(place, ring, lines)
        ]
        return min(found)[1] if found else 1

    part = parts_of(tables.edges)
    for k, ring in enumerate(rings):
        if areas[k] >= 0:
            own = {m for m, other in enumerate(rings) if part[other[0][0]] == part[ring[0][0]]}
            if around(lines[ring[0][0]][0], own) != face_of[k]:
                return False
    for face, place in tables.entities:
        here = exact(place)
        if any(meeting(a, b, here, here) is not None for line in lines for a, b in itertools.pairwise(line)):
            return False
        if around(here, ()) != face:
            return False
    return True


def parts_of(edges):
    """A number for each edge, equal for those that hang together."""
    of_node = {}
    for edge in edges:
        merged = {of_node.setdefault(edge[0], edge[0]), of_node.setdefault(edge[1], edge[1])}
        for node, own in of_node.items():
            if own in merged:
                of_node[node] = min(merged)
    return [of_node[edge[0]] for edge in edges]
