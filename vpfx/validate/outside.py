"""The outside of a level: edges without a face on one hand, how they follow each other, and slits between them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.validate.kernels import walk_slits

__all__ = ["Outside", "Slits", "find_outside", "find_slits", "straighten"]

SAME_WAY = 1e-7
"""Radians between directions that count as one: places inside an edge are rounded, so lie beside it by a hair."""

ROOM = 4
"""Times as many steps along slits as there are sides: in a mesh each is passed once."""

MOST_ROUNDS = 32
"""Times that nodes are put on edges whose own ends were: edges inside edges inside edges."""

Ints = NDArray[np.int64]


class Outside(NamedTuple):
    """Hands of edges without a face. Each runs with the ground on its left: along the edge if the right hand is empty.

    Attributes
    ----------
    edge : int64 (n,)
    hand : int64 (n,)
        0 left, 1 right: the hand that is empty.
    start, end : int64 (n,)
        Nodes.
    follower : int64 (n,)
        Which one is met first, turning counter-clockwise over the outside round the end; -1 if none starts there.
    is_slit : bool (n,)
        Whether the follower leaves in the same direction, so that the outside between has no width.
    """

    edge: Ints
    hand: Ints
    start: Ints
    end: Ints
    follower: Ints
    is_slit: NDArray[np.bool_]


class Slits(NamedTuple):
    """Edges along which shorter ones run, from end to end, with nothing between.

    Attributes
    ----------
    long, short : int64 (n,)
        Edges; those along a long one stand together, in order from its one end to the other.
    node : int64 (n,)
        Where the short edge ends: a node inside the long one, -1 for the last.
    broken : int64 (m,)
        Edges along which others run, but not from end to end.
    """

    long: Ints
    short: Ints
    node: Ints
    broken: Ints


def find_outside(edge_nodes: NDArray[np.int32], edge_faces: NDArray[np.int32], places: NDArray[np.float64]) -> Outside:
    """Find the hands of edges without a face, and the order in which they follow each other.

    Parameters
    ----------
    edge_nodes, edge_faces : int32 (n_edge, 2)
        Start and end; left and right face, -1 for none.
    places : float64 (n_node, 2)

    Notes
    -----
    Source: specs/format.md R-161. Cost: O(n log n) in the hands without a face.

    Examples
    --------
    One triangle whose edges run counter-clockwise; the first is followed by the second:

    >>> nodes = np.array([[0, 1], [1, 2], [2, 0]], np.int32)
    >>> faces = np.array([[0, -1]] * 3, np.int32)
    >>> find_outside(nodes, faces, np.array([[0, 0], [1, 0], [0, 1.0]])).follower.tolist()
    [1, 2, 0]
    """
    edge, hand = np.nonzero(edge_faces < 0)
    start, end = edge_nodes[edge, 1 - hand].astype(np.int64), edge_nodes[edge, hand].astype(np.int64)
    way = places[end] - places[start]
    leaving, back = (
        np.arctan2(north + 0.0, east + 0.0) for east, north in (way.T, -way.T)
    )  # + 0.0: no direction is -π
    follower = _follow(start, end, leaving, back)
    turn = np.abs(leaving[follower] - back)
    is_slit = (follower >= 0) & (np.minimum(turn, 2 * np.pi - turn) < SAME_WAY) & (edge[follower] != edge)
    return Outside(edge, hand, start, end, follower, is_slit)


def _follow(start: Ints, end: Ints, leaving: NDArray[np.float64], back: NDArray[np.float64]) -> Ints:
    """Find for each side which one starts at its end and is met first, turning counter-clockwise from the way back.

    All ends and starts are sorted by node, then by direction; ends a hair earlier, so that a start in the same direction comes
    next. The first start behind an end is met first; where the node has none behind, its first one is.
    """
    n = len(start)
    earlier = back - SAME_WAY
    earlier[earlier < -np.pi] += 2 * np.pi
    is_start = np.repeat([False, True], n)
    order = np.lexsort((is_start, np.concatenate([earlier, leaving]), np.concatenate([end, start])))
    is_start = is_start[order]
    starts, ends = order[is_start] - n, order[~is_start]
    behind = np.cumsum(is_start)[~is_start]  # as many starts stand before each end: the next is the first one behind it
    node_of_start = np.append(start[starts], -1)
    first = np.minimum(np.searchsorted(start[starts], end[ends]), n)
    at = np.where(node_of_start[behind] == end[ends], behind, first)
    follower = np.empty(n, np.int64)
    follower[ends] = np.where(node_of_start[at] == end[ends], np.append(starts, -1)[at], -1)
    return follower


def find_slits(outside: Outside, places: NDArray[np.float64]) -> Slits:
    """Find the edges with nodes inside: those along which shorter edges run.

    Notes
    -----
    Source: specs/format.md R-190. Cost: O(n).
    """
    way = places[outside.end] - places[outside.start]
    length = np.hypot(way[:, 0], way[:, 1])
    at = np.flatnonzero(outside.is_slit)
    long = at[length[at] > length[outside.follower[at]]]
    room = ROOM * len(outside.edge)
    short, owner, is_closed = np.empty(room, np.int64), np.empty(room, np.int64), np.zeros(len(long), np.bool_)
    goal = outside.start[long]
    count = walk_slits(long, outside.end, outside.follower, goal, short, owner, is_closed)
    other = outside.follower[at[length[at] < length[outside.follower[at]]]]
    broken = np.concatenate([outside.edge[long[~is_closed]], np.setdiff1d(outside.edge[other], outside.edge[long])])
    short, owner = short[:count], owner[:count]
    short, owner = short[is_closed[owner]], owner[is_closed[owner]]
    node = np.where(outside.end[short] == goal[owner], -1, outside.end[short])
    return Slits(outside.edge[long[owner]], outside.edge[short], node, np.unique(broken))


def straighten(
    xy: NDArray[np.float64], ends: NDArray[np.int32], inside: NDArray[np.int32], reach: float
) -> NDArray[np.float64]:
    """Put nodes inside edges back on them, where rounding may have moved them aside.

    Parameters
    ----------
    xy : float64 (n_node, 2)
        Places, CRS units.
    ends : int32 (n, 2)
        Start and end of an edge.
    inside : int32 (n,)
        A node that is told to lie inside it.
    reach : float
        CRS units; nodes farther from where they belong stay.

    Returns
    -------
    float64 (n_node, 2)

    Examples
    --------
    >>> straighten(np.array([[0, 0], [4, 0], [1, 0.25]]), np.array([[0, 1]]), np.array([2]), 0.5)[2].tolist()
    [1.0, 0.0]
    """
    moved = xy.copy()
    for _ in range(MOST_ROUNDS):
        start, end = moved[ends[:, 0]], moved[ends[:, 1]]
        way = end - start
        square = np.maximum((way * way).sum(axis=1), np.finfo(np.float64).tiny)
        along = ((xy[inside] - start) * way).sum(axis=1) / square
        goal = start + along[:, None] * way
        is_near = (np.hypot(*(goal - xy[inside]).T) <= reach) & (along > 0) & (along < 1)
        before = moved[inside[is_near]]
        moved[inside[is_near]] = goal[is_near]
        if np.array_equal(before, moved[inside[is_near]]):
            break
    return moved
