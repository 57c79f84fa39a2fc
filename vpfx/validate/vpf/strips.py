r"""Segments in strips: which of them cross, and on which side of them a place lies.

A *strip* is a band of the plane from west to east. Each segment stands in every strip it reaches, in the order of its western
ends, so what may touch it is found by going on in the list for as long as lists begin west of its eastern end::

        strip 1   ---a---   ----c----        strip 1: a, c, d
                          \
        strip 0  -----b----  d               strip 0: b, d
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vpfx.exact import orientation

__all__ = ["CROSS", "OVERLAP", "Segments", "Strips", "find_clashes", "is_inside", "make_segments", "make_strips"]

CROSS, OVERLAP = 1, 2
"""Two segments have a place in common that is not allowed; or more than one place."""

MOST_STRIPS = 4096
MOST_ENTRIES = 3
"""Entries of all strips together, for each segment: with more, strips are made wider."""


class Segments(NamedTuple):
    """Straight pieces of edges, those of no length left out.

    Attributes
    ----------
    ends : float64 (n, 4)
        x and y of the first end, then of the second.
    edge : int64 (n,)
        Index of the edge.
    is_first, is_last : bool (n,)
        Whether the segment begins, or ends, its edge.
    """

    ends: NDArray[np.float64]
    edge: NDArray[np.int64]
    is_first: NDArray[np.bool_]
    is_last: NDArray[np.bool_]


class Strips(NamedTuple):
    """Segments by strips.

    Attributes
    ----------
    cuts : float64 (n_strip - 1,)
        y between strips; a place on a cut belongs to the upper strip.
    bucket : int64 (n_strip + 1,)
        Strip s holds ``entry[bucket[s]:bucket[s + 1]]``.
    entry : int64
        Indices of segments, by their western ends.
    """

    cuts: NDArray[np.float64]
    bucket: NDArray[np.int64]
    entry: NDArray[np.int64]


def make_segments(starts: NDArray[np.int64], places: NDArray[np.float64]) -> Segments:
    """Cut edges into segments.

    Parameters
    ----------
    starts : int64 (n_edge + 1,)
        Edge e has the places ``starts[e]`` to ``starts[e + 1]``, at least one.
    places : float64 (n_place, 2)

    Examples
    --------
    >>> make_segments(np.array([0, 3]), np.array([[0, 0], [1, 0], [1, 1.0]])).is_last
    array([False,  True])
    """
    edge = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    is_kept = np.ones(len(places), bool)  # not where it repeats the place before it in its edge
    is_kept[1:] = (edge[1:] != edge[:-1]) | (places[1:] != places[:-1]).any(axis=1)
    edge, places = edge[is_kept], places[is_kept]
    (here,) = np.nonzero(edge[1:] == edge[:-1])
    before, after = np.concatenate([[-1], edge[:-1]])[here], np.concatenate([edge, [-1]])[here + 2]
    ends = np.concatenate([places[here], places[here + 1]], axis=1)
    return Segments(np.ascontiguousarray(ends, np.float64), edge[here], before != edge[here], after != edge[here])


def make_strips(segments: Segments) -> Strips:
    """Put segments into strips.

    Notes
    -----
    Strips are narrow where there are many segments. Cost: O(n log n); memory is in proportion to the segments.

    Examples
    --------
    >>> strips = make_strips(make_segments(np.array([0, 2, 4]), np.array([[5, 0], [6, 0], [0, 0], [1, 0.0]])))
    >>> strips.entry
    array([1, 0])
    """
    low, high = (extreme(segments.ends[:, 1], segments.ends[:, 3]) for extreme in (np.minimum, np.maximum))
    middle = np.sort((low + high) / 2.0)
    n_strip = int(np.clip(np.sqrt(len(low)) / 2, 1, MOST_STRIPS))
    while True:
        cuts = np.unique(middle[np.arange(1, n_strip) * len(middle) // n_strip])
        first, last = (np.searchsorted(cuts, y, side="right") for y in (low, high))
        count = last - first + 1
        if count.sum() <= MOST_ENTRIES * len(low) or n_strip == 1:
            break
        n_strip //= 2
    order = np.argsort(np.minimum(segments.ends[:, 0], segments.ends[:, 2]), kind="stable")
    entry = np.repeat(order, count[order])
    begin = np.cumsum(count[order]) - count[order]
    strip = np.arange(len(entry)) - np.repeat(begin - first[order], count[order])
    by_strip = np.argsort(strip, kind="stable")
    bucket = np.searchsorted(strip[by_strip], np.arange(len(cuts) + 2))
    return Strips(cuts, bucket.astype(np.int64), entry[by_strip])


@njit(nogil=True, cache=True)
def _is_on(px, py, ax, ay, bx, by):
    """Tell whether a place on the line through a and b lies between them."""
    return min(ax, bx) <= px <= max(ax, bx) and min(ay, by) <= py <= max(ay, by)


@njit(nogil=True, cache=True)
def _may_meet(i, j, end_i, end_j, segments):
    """Tell whether two segments may touch where end 0 or 1 of one is end 0 or 1 of the other."""
    is_end_i = segments.is_first[i] if end_i == 0 else segments.is_last[i]
    is_end_j = segments.is_first[j] if end_j == 0 else segments.is_last[j]
    if is_end_i and is_end_j:
        return True
    is_next = segments.edge[i] == segments.edge[j] and abs(i - j) == 1 and end_i != end_j
    return is_next and ((i < j) == (end_i == 1))


@njit(nogil=True, cache=True)
def _clash(i, j, segments):
    """What two segments have in common that they may not: 0 nothing, CROSS or OVERLAP."""
    ends = segments.ends
    ax, ay, bx, by = ends[i, 0], ends[i, 1], ends[i, 2], ends[i, 3]
    cx, cy, dx, dy = ends[j, 0], ends[j, 1], ends[j, 2], ends[j, 3]
    turn_c, turn_d = orientation(ax, ay, bx, by, cx, cy), orientation(ax, ay, bx, by, dx, dy)
    if turn_c * turn_d > 0:
        return 0
    turn_a, turn_b = orientation(cx, cy, dx, dy, ax, ay), orientation(cx, cy, dx, dy, bx, by)
    if turn_a * turn_b > 0:
        return 0
    if turn_c * turn_d < 0 and turn_a * turn_b < 0:
        return CROSS
    if turn_c == 0 and turn_d == 0:  # on one line
        axis = 0 if ax != bx else 1
        low = max(min(ends[i, axis], ends[i, axis + 2]), min(ends[j, axis], ends[j, axis + 2]))
        high = min(max(ends[i, axis], ends[i, axis + 2]), max(ends[j, axis], ends[j, axis + 2]))
        if low < high:
            return OVERLAP
    for end_i in range(2):
        px, py = ends[i, 2 * end_i], ends[i, 2 * end_i + 1]
        for end_j in range(2):
            if px == ends[j, 2 * end_j] and py == ends[j, 2 * end_j + 1]:
                return 0 if _may_meet(i, j, end_i, end_j, segments) else CROSS
    is_touched = (
        (turn_a == 0 and _is_on(ax, ay, cx, cy, dx, dy))
        or (turn_b == 0 and _is_on(bx, by, cx, cy, dx, dy))
        or (turn_c == 0 and _is_on(cx, cy, ax, ay, bx, by))
        or (turn_d == 0 and _is_on(dx, dy, ax, ay, bx, by))
    )
    return CROSS if is_touched else 0


@njit(nogil=True, cache=True)
def _find_clashes(segments, strips, first, most):
    """Pairs of segments that clash, at most so many of each kind, and the number of all pairs of each kind."""
    ends = segments.ends
    pairs, n_pair, count = np.empty((2 * most, 3), np.int64), 0, np.zeros(3, np.int64)
    for strip in range(len(strips.bucket) - 1):
        low, high = strips.bucket[strip], strips.bucket[strip + 1]
        for slot in range(low, high):
            i = strips.entry[slot]
            east = max(ends[i, 0], ends[i, 2])
            south, north = min(ends[i, 1], ends[i, 3]), max(ends[i, 1], ends[i, 3])
            for other in range(slot + 1, high):
                j = strips.entry[other]
                if min(ends[j, 0], ends[j, 2]) > east:
                    break
                if min(ends[j, 1], ends[j, 3]) > north or max(ends[j, 1], ends[j, 3]) < south:
                    continue
                if max(first[i], first[j]) != strip:
                    continue  # seen in the strip where both are for the first time
                kind = _clash(i, j, segments)
                if kind > 0:
                    if count[kind] < most:
                        pairs[n_pair, 0], pairs[n_pair, 1], pairs[n_pair, 2] = min(i, j), max(i, j), kind
                        n_pair += 1
                    count[kind] += 1
    return pairs[:n_pair], count


def find_clashes(segments: Segments, strips: Strips, most: int = 100) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Places that edges have in common and may not: all but nodes that end both.

    Parameters
    ----------
    segments : Segments
    strips : Strips
        Of the same segments.
    most : int
        Pairs of each kind to name.

    Returns
    -------
    pairs : int64 (n, 3)
        Two indices of segments, and `CROSS` or `OVERLAP`.
    count : int64 (3,)
        Pairs there are, by kind.

    Notes
    -----
    Exact. Cost: O(n log n) where segments are short against the whole, and their number squared at worst.

    Examples
    --------
    >>> segments = make_segments(np.array([0, 2, 4]), np.array([[0, 0], [2, 2], [0, 2], [2, 0.0]]))
    >>> find_clashes(segments, make_strips(segments))
    (array([[0, 1, 1]]), array([0, 1, 0]))
    """
    first = np.searchsorted(strips.cuts, np.minimum(segments.ends[:, 1], segments.ends[:, 3]), side="right")
    return _find_clashes(segments, strips, first, most)


@njit(nogil=True, cache=True)
def is_inside(places, face, own_part, faces, part, segments, strips):
    """Tell whether places lie inside faces.

    Parameters
    ----------
    places : float64 (n, 2)
    face : int64 (n,)
        The face each place is asked about; 0 is the universe.
    own_part : int64 (n,)
        Part of the graph whose edges are passed over; -1 for none.
    faces : int64 (n_edge, 2)
        Right and left face of the edges that the segments belong to.
    part : int64 (n_edge,)
        Part of the graph that each edge belongs to.
    segments, strips
        From `make_segments` and `make_strips`; they do not cross.

    Returns
    -------
    bool (n,)
        False on the sides of the face too.

    Notes
    -----
    Exact: counts the segments between the face and others that a ray to the west meets.

    Examples
    --------
    A square with face 1 inside, walked clockwise:

    >>> square = np.array([[0, 0], [0, 4], [4, 4], [4, 0], [0, 0.0]])
    >>> segments = make_segments(np.array([0, 5]), square)
    >>> places, ones, none = np.array([[1, 1], [4, 1], [5, 1.0]]), np.ones(3, np.int64), np.full(3, -1)
    >>> is_inside(places, ones, none, np.array([[1, 0]]), np.array([0]), segments, make_strips(segments))
    array([ True, False, False])
    """
    found = np.zeros(len(places), np.bool_)
    for k in range(len(places)):
        x, y = places[k, 0], places[k, 1]
        is_in = face[k] == 0
        strip = np.searchsorted(strips.cuts, y, side="right")
        for slot in range(strips.bucket[strip], strips.bucket[strip + 1]):
            i = strips.entry[slot]
            ax, ay, bx, by = segments.ends[i, 0], segments.ends[i, 1], segments.ends[i, 2], segments.ends[i, 3]
            if min(ax, bx) > x:
                break
            edge = segments.edge[i]
            right, left = faces[edge, 0], faces[edge, 1]
            if left == right or (left != face[k] and right != face[k]) or part[edge] == own_part[k]:
                continue
            if ay > by:
                ax, ay, bx, by = bx, by, ax, ay
            turn = orientation(ax, ay, bx, by, x, y)
            if turn == 0 and min(ax, bx) <= x <= max(ax, bx) and ay <= y <= by:
                is_in = False
                break
            if ay <= y < by and turn < 0:
                is_in = not is_in
        found[k] = is_in
    return found
