"""The planar graph of one tile: edges, rings, void faces and winged-edge links from the sides of its faces alone.

Nothing is taken from links stored elsewhere, so that both can be compared::

       w            Round v, counter-clockwise from edge vu: where a face has a side from v to u, the next edge is that
        |           of the face's side before, here from w to v. Where none has, there is outside, as far as the next
    g --v-- u       edge that no face has a side along that ends at v. If v has several such edges, directions decide,
                    and are compared exactly.

Way 2·e + i runs along edge e towards its start (i = 0) or its end (i = 1). To its right is what is swept first from e
round that node: `left_face` and `left_edge` for 0, `right_face` and `right_edge` for 1 (specs/format.md R-161).
"""

from __future__ import annotations

from functools import cmp_to_key
from typing import NamedTuple

import numpy as np
import shapely
from numba import njit
from numpy.typing import NDArray

from vpfx.errors import InvariantError
from vpfx.exact import orientations

__all__ = ["OUTSIDE", "Planar", "Sides", "by_direction", "planar_graph"]

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

OUTSIDE = 0
"""Index of the universe face; faces follow from 1, then void faces."""


class Sides(NamedTuple):
    """Sides of faces, face by face, counter-clockwise: where one ends the next one of the face starts.

    Attributes
    ----------
    start : int64 (n_side,)
        Node at which the side starts.
    edge : int64 (n_side,)
        Edge along which it runs.
    first : int64 (n_face + 1,)
        First side of each face, and the number of sides.
    """

    start: Ints
    edge: Ints
    first: Ints


class Planar(NamedTuple):
    """A planar graph with all its faces: the universe, those given, void faces.

    Attributes
    ----------
    way_face : int64 (2 * n_edge,)
        Face to the right of each way.
    way_next : int64 (2 * n_edge,)
        Edge met next, counter-clockwise round its end.
    ring_face, ring_start : int64 (n_ring,)
        Rings by face, outer ring first; -1 is the start of the outer ring that the universe lacks.
    n_face : int
        Faces given.
    n_void : int
        Void faces.
    """

    way_face: Ints
    way_next: Ints
    ring_face: Ints
    ring_start: Ints
    n_face: int
    n_void: int


def planar_graph(xy: Floats, edge_nodes: Ints, sides: Sides) -> Planar:
    """Make the planar graph of the faces of one tile.

    Parameters
    ----------
    xy : float64 (n_node, 2)
    edge_nodes : int64 (n_edge, 2)
        Start and end of each edge; every edge is a side of one face or two.
    sides : Sides

    Returns
    -------
    Planar

    Raises
    ------
    InvariantError
        Edges leave a node in the same direction, or faces lie on each other there.

    Examples
    --------
    Two faces of a square, the diagonal is edge 0:

    >>> xy = np.array([[0, 0], [2, 0], [2, 2], [0, 2.0]])
    >>> edges = np.array([[0, 2], [0, 1], [1, 2], [2, 3], [3, 0]])
    >>> sides = Sides(np.array([0, 1, 2, 0, 2, 3]), np.array([1, 2, 0, 0, 3, 4]), np.array([0, 3, 6]))
    >>> graph = planar_graph(xy, edges, sides)
    >>> graph.way_face.reshape(-1, 2).tolist()  # left, right
    [[2, 1], [1, 0], [1, 0], [2, 0], [2, 0]]
    >>> graph.way_next.reshape(-1, 2).tolist()
    [[4, 2], [0, 2], [1, 3], [0, 4], [3, 1]]
    >>> list(zip(graph.ring_face.tolist(), graph.ring_start.tolist()))
    [(0, -1), (0, 1), (1, 1), (2, 0)]
    """
    n_face = len(sides.first) - 1
    face_of = np.repeat(np.arange(n_face), np.diff(sides.first))
    before = np.arange(len(sides.edge)) - 1
    before[sides.first[:-1]] = sides.first[1:] - 1
    way = 2 * sides.edge + (sides.start != edge_nodes[sides.edge, 0])
    way_face = np.full(2 * len(edge_nodes), -1, np.int64)
    way_next = np.full(2 * len(edge_nodes), -1, np.int64)
    way_face[way], way_next[way] = face_of + 1, sides.edge[before]
    outside = np.flatnonzero(way_face < 0)
    outline = _outline(xy, edge_nodes[outside // 2, 1 - outside % 2], edge_nodes[outside // 2, outside % 2])
    is_rim = _rims(xy, outline)
    lowest = np.full(len(is_rim), len(edge_nodes), np.int64)
    np.minimum.at(lowest, outline.cycle, outside // 2)
    voids = np.flatnonzero(~is_rim)
    voids = voids[np.argsort(lowest[voids])]
    cycle_face = np.full(len(is_rim), OUTSIDE, np.int64)
    cycle_face[voids] = n_face + 1 + np.arange(len(voids))
    if len(voids) and is_rim.sum() > 1:
        cycle_face[is_rim] = _faces_round(xy, outline, is_rim, cycle_face)
    way_face[outside], way_next[outside] = cycle_face[outline.cycle], outside[outline.follower] // 2
    ring_face = np.concatenate([[OUTSIDE], np.arange(1, n_face + 1), cycle_face])
    ring_start = np.concatenate([[-1], sides.edge[sides.first[:-1]], lowest])
    is_inner = np.concatenate([np.zeros(n_face + 1, bool), is_rim])
    order = np.lexsort((ring_start, is_inner, ring_face))
    return Planar(way_face, way_next, ring_face[order], ring_start[order], n_face, len(voids))


class _Outline(NamedTuple):
    """Ways with the outside to their right.

    Attributes
    ----------
    start, end : int64 (n_way,)
        Nodes.
    follower : int64 (n_way,)
        Place of the next one.
    walk : int64 (n_way,)
        Places, cycle by cycle, as they follow each other.
    cycle : int64 (n_way,)
        Number of the cycle of each.
    """

    start: Ints
    end: Ints
    follower: Ints
    walk: Ints
    cycle: Ints


def _outline(xy: Floats, start: Ints, end: Ints) -> _Outline:
    """Join ways over the outside."""
    leaving = np.argsort(start, kind="stable")
    node, first, count = np.unique(start[leaving], return_index=True, return_counts=True)
    row = np.searchsorted(node, end)
    if not np.array_equal(np.bincount(row, minlength=len(node)), count):
        raise InvariantError("planar graph: found an outline that does not close")
    follower = leaving[first[row]]
    arriving = np.flatnonzero(count[row] > 1)
    if len(arriving):
        several = np.flatnonzero(count[np.searchsorted(node, start)] > 1)
        follower[arriving] = _turn(
            xy, np.stack([end[arriving], start[arriving]]), np.stack([start[several], end[several]]), several
        )
    return _Outline(start, end, follower, *_cycles(follower))


def _turn(xy: Floats, arriving: Ints, leaving: Ints, number: Ints) -> Ints:
    """Numbers of the ways that follow those that arrive where several leave: the first counter-clockwise.

    Parameters
    ----------
    xy : float64 (n_node, 2)
    arriving, leaving : int64 (2, n)
        The node, and the other end.
    number : int64 (n,)
        Of those that leave.
    """
    node, away = np.concatenate([arriving, leaving], axis=1)
    n = arriving.shape[1]
    order, same = by_direction(xy, node, away)
    if len(same):
        raise InvariantError("planar graph: found edges that lie on each other")
    node, is_arriving = node[order], order < n
    group = np.flatnonzero(np.append(True, node[1:] != node[:-1]))
    after = np.arange(1, len(node) + 1)
    after[np.append(group[1:], len(node)) - 1] = group
    if (is_arriving == is_arriving[after]).any():
        raise InvariantError("planar graph: found faces that lie on each other")
    found = np.empty(n, np.int64)
    found[order[is_arriving]] = number[order[after[is_arriving]] - n]
    return found


def by_direction(xy: Floats, node: Ints, away: Ints) -> tuple[Ints, Ints]:
    """Order edges at nodes by node, then counter-clockwise from east, exactly.

    Parameters
    ----------
    xy : float64 (n_node, 2)
    node, away : int64 (n,)
        Each edge runs from `node` to `away`.

    Returns
    -------
    order : int64 (n,)
    same : int64 (n_same,)
        Places in it of edges that leave in the same direction as the one before.

    Examples
    --------
    >>> xy = np.array([[0, 0], [1, 1], [1, -1], [2, 2], [-1, 0.0]])
    >>> by_direction(xy, np.zeros(4, int), np.array([1, 2, 3, 4]))
    (array([0, 2, 3, 1]), array([1]))
    """
    step = xy[away] - xy[node]
    half = np.where((step[:, 1] > 0) | ((step[:, 1] == 0) & (step[:, 0] > 0)), 0, 1)
    order = np.lexsort((np.arctan2(step[:, 1], step[:, 0]) % (2 * np.pi), half, node))
    at_node = node[order]
    turn = _turns(xy, at_node, away[order], half[order])
    for at in np.unique(at_node[np.flatnonzero(turn < 0)]).tolist():  # doubles told the order wrong: next to none
        place = np.arange(*np.searchsorted(at_node, (at, at + 1)))

        def compare(p: int, q: int) -> int:
            found = orientations(xy[node[[p]]], xy[away[[p]]], xy[away[[q]]])[0]
            return int(half[p] - half[q]) if half[p] != half[q] else -int(found)

        order[place] = sorted(order[place].tolist(), key=cmp_to_key(compare))
    return order, np.flatnonzero(_turns(xy, at_node, away[order], half[order]) == 0) + 1


def _turns(xy: Floats, node: Ints, away: Ints, half: Ints) -> NDArray[np.int8]:
    """Turn from each edge to the next one at its node, 1 where that is at another node or beyond east or west."""
    turn = np.ones(max(len(node) - 1, 0), np.int8)
    at = np.flatnonzero((node[1:] == node[:-1]) & (half[1:] == half[:-1]))
    turn[at] = orientations(xy[node[at]], xy[away[at]], xy[away[at + 1]])
    return turn


@njit(nogil=True, cache=True)
def _cycles(follower):
    """Items cycle by cycle, as they follow each other, and the number of the cycle of each item."""
    walk, cycle = np.empty(len(follower), np.int64), np.full(len(follower), -1, np.int64)
    place, count = 0, 0
    for first in range(len(follower)):
        if cycle[first] >= 0:
            continue
        at = first
        while cycle[at] < 0:
            walk[place], cycle[at] = at, count
            place, at = place + 1, follower[at]
        count += 1
    return walk, cycle


def _rims(xy: Floats, outline: _Outline) -> NDArray[np.bool_]:
    """Tell which cycles are rims, not round a void: at their western node the outside lies to the west too.

    All edges there run east, or north; a sector swept from one to the next has the west in it if it turns right.
    """
    u, v, w = outline.start, outline.end, outline.end[outline.follower]
    western = v[_western(xy, outline)]
    at = np.flatnonzero(v == western[outline.cycle])
    turns_right = orientations(xy[v[at]], xy[u[at]], xy[w[at]]) < 0
    is_rim = np.zeros(len(western), bool)
    is_rim[outline.cycle[at[turns_right]]] = True
    return is_rim


def _western(xy: Floats, outline: _Outline) -> Ints:
    """Place of a way of each cycle that ends at its western, of these its southern node."""
    order = np.lexsort((xy[outline.end, 1], xy[outline.end, 0], outline.cycle))
    first = np.searchsorted(outline.cycle[order], np.arange(outline.cycle.max(initial=-1) + 1))
    return order[first]


def _faces_round(xy: Floats, outline: _Outline, is_rim: NDArray[np.bool_], cycle_face: Ints) -> Ints:
    """Face that each rim lies in: the smallest void face round it, or the universe.

    GEOS tells by exact orientation whether a place lies in a ring. The western node of a rim lies in none of the void
    faces of its own ground, at most on one.
    """
    of_void = outline.walk[~is_rim[outline.cycle[outline.walk]]]  # cycle by cycle, ascending
    voids, ring = np.unique(outline.cycle[of_void], return_inverse=True)
    polygons = shapely.polygons(shapely.linearrings(xy[outline.end[of_void]], indices=ring))
    shapely.prepare(polygons)
    points = shapely.points(xy[outline.end[_western(xy, outline)[is_rim]]])
    point, polygon = shapely.STRtree(polygons).query(points)
    is_in = shapely.contains_properly(polygons[polygon], points[point])
    point, polygon = point[is_in], polygon[is_in]
    found = np.full(len(points), OUTSIDE, np.int64)
    by_area = np.argsort(-shapely.area(polygons[polygon]), kind="stable")
    found[point[by_area]] = cycle_face[voids[polygon[by_area]]]
    return found
