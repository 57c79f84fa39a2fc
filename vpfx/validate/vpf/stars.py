r"""Edges round nodes, the walks round faces that follow, and which of them goes round each part from outside: kernels.

An edge e has two *sides*: 2e leaves its start node, 2e + 1 its end node; d ^ 1 is the other side of the edge::

                         left_face(e)
        start node  o--- 2e ---> <--- 2e + 1 ---o  end node
                         right_face(e)

Turning counter-clockwise round a node leads from side to side of its *star*. Walking along side d, one arrives where d ^ 1
leaves; going on with the next side counter-clockwise after that one keeps the same face on the right: the walk is one *ring*.

The place of a part that lies farthest west, of those farthest south, sees no edge of the part to its west. The ring that passes
on that side of it goes round the part. Walked with its face on the right it runs counter-clockwise, and the part lies inside
that face, of which it is an inner ring::

          o-----o
         /       \        the ring passes * on its west: with what surrounds the part on the
        *   face  o       right it goes down along the edges here
         \       /
          o-----o
"""

from __future__ import annotations

import numpy as np
from numba import njit

from vpfx.exact import orientation

__all__ = ["find_inner_rings", "find_rings", "find_targets", "label_parts", "sort_stars", "wrong_links"]


@njit(nogil=True, cache=True)
def find_targets(starts, places):
    """For each side, the first place of its edge that is not where the side leaves.

    Parameters
    ----------
    starts : int64 (n_edge + 1,)
        Edge e has the places ``starts[e]`` to ``starts[e + 1]``, at least one.
    places : float64 (n_place, 2)

    Returns
    -------
    int64 (2 * n_edge,)
        Indices of places; -1 where all places of the edge are one.

    Examples
    --------
    >>> find_targets(np.array([0, 3]), np.array([[0, 0], [0, 0], [1, 0.0]])).tolist()
    [2, 1]
    """
    n_edge = len(starts) - 1
    target = np.full(2 * n_edge, -1, np.int64)
    for edge in range(n_edge):
        first, last = starts[edge], starts[edge + 1] - 1
        for i in range(first + 1, last + 1):
            if places[i, 0] != places[first, 0] or places[i, 1] != places[first, 1]:
                target[2 * edge] = i
                break
        for i in range(last - 1, first - 1, -1):
            if places[i, 0] != places[last, 0] or places[i, 1] != places[last, 1]:
                target[2 * edge + 1] = i
                break
    return target


@njit(nogil=True, cache=True)
def _turn(a, b, starts, places, target):
    """Sign of the way from side a to side b of one star, counted from east, counter-clockwise: 1 if b lies behind a."""
    at_a = starts[a // 2] if a % 2 == 0 else starts[a // 2 + 1] - 1
    at_b = starts[b // 2] if b % 2 == 0 else starts[b // 2 + 1] - 1
    ox, oy = places[at_a, 0], places[at_a, 1]
    ax, ay = places[target[a], 0], places[target[a], 1]
    bx, by = places[target[b], 0], places[target[b], 1]
    is_low_a = ay < oy or (ay == oy and ax < ox)
    is_low_b = by < places[at_b, 1] or (by == places[at_b, 1] and bx < places[at_b, 0])
    if is_low_a != is_low_b:
        return -1 if is_low_a else 1
    return orientation(ax, ay, bx, by, ox, oy)


@njit(nogil=True, cache=True)
def _merge_sort(sides, spare, starts, places, target):
    """Sort the sides of one star counter-clockwise, from east; those of one direction keep their order."""
    n, width = len(sides), 1
    while width < n:
        for low in range(0, n, 2 * width):
            middle, high = min(low + width, n), min(low + 2 * width, n)
            i, j = low, middle
            for k in range(low, high):
                if i < middle and (j >= high or _turn(sides[i], sides[j], starts, places, target) >= 0):
                    spare[k] = sides[i]
                    i += 1
                else:
                    spare[k] = sides[j]
                    j += 1
        sides[:] = spare[:n]
        width *= 2


@njit(nogil=True, cache=True)
def sort_stars(side_node, n_node, starts, places, target):
    """Sort the sides round every node.

    Parameters
    ----------
    side_node : int64 (n_side,)
        The node each side leaves; a side with -1 belongs to no star.
    n_node : int
    starts, places : arrays
        As in `find_targets`; sides of one node leave from one place.
    target : int64 (n_side,)
        From `find_targets`; not -1 where there is a node.

    Returns
    -------
    bucket : int64 (n_node + 1,)
        The star of node n is ``star[bucket[n]:bucket[n + 1]]``.
    star : int64 (n_side or less,)
        Sides, counter-clockwise from east.
    is_beside : bool (n_side or less,)
        Whether the side runs the same way as the one before it in the star.

    Notes
    -----
    Exact. Cost: O(n log n).

    Examples
    --------
    One node with edges to the west, the east and the north:

    >>> places = np.array([[0, 0], [-1, 0], [0, 0], [1, 0], [0, 0], [0, 1.0]])
    >>> starts, node = np.array([0, 2, 4, 6]), np.array([0, -1, 0, -1, 0, -1])
    >>> sort_stars(node, 1, starts, places, find_targets(starts, places))[1].tolist()
    [2, 4, 0]
    """
    bucket = np.zeros(n_node + 1, np.int64)
    for side in range(len(side_node)):
        if side_node[side] >= 0:
            bucket[side_node[side] + 1] += 1
    most = 0
    for node in range(n_node):
        most = max(most, bucket[node + 1])
        bucket[node + 1] += bucket[node]
    fill = bucket[:-1].copy()
    star = np.empty(bucket[n_node], np.int64)
    for side in range(len(side_node)):
        if side_node[side] >= 0:
            star[fill[side_node[side]]] = side
            fill[side_node[side]] += 1
    spare, is_beside = np.empty(most, np.int64), np.zeros(len(star), np.bool_)
    for node in range(n_node):
        low, high = bucket[node], bucket[node + 1]
        _merge_sort(star[low:high], spare, starts, places, target)
        for slot in range(low + 1, high):
            is_beside[slot] = _turn(star[slot - 1], star[slot], starts, places, target) == 0
    return bucket, star, is_beside


@njit(nogil=True, cache=True)
def wrong_links(bucket, star, is_beside, link):
    """Sides whose link is not the next edge counter-clockwise.

    Parameters
    ----------
    bucket, star, is_beside : arrays
        From `sort_stars`.
    link : int64 (n_side,)
        The edge each side names as next round the node it leaves: ``left_edge`` of sides 2e, ``right_edge`` of 2e + 1.

    Returns
    -------
    wrong : int64 (n,)
        Sides.
    expected : int64 (n,)
        The edge met first.

    Notes
    -----
    Where edges leave side by side, every order of them will do.

    Examples
    --------
    >>> bucket, star = np.array([0, 3]), np.array([2, 4, 0])
    >>> link = np.array([1, -1, 0, -1, 0, -1])
    >>> [part.tolist() for part in wrong_links(bucket, star, np.zeros(3, bool), link)]
    [[2], [2]]
    """
    is_wrong, follower = np.zeros(len(link), np.bool_), np.full(len(link), -1, np.int64)
    slot_of, group = np.full(len(link), -1, np.int64), np.empty(len(star), np.int64)
    for slot in range(len(star)):
        slot_of[star[slot]] = slot
    for node in range(len(bucket) - 1):
        low, high = bucket[node], bucket[node + 1]
        n_group = 0
        for slot in range(low, high):
            n_group += 0 if is_beside[slot] else 1
            group[slot] = n_group  # sides that leave the same way are one group
        for slot in range(low, high):
            side = star[slot]
            follower[side] = star[slot + 1 if slot + 1 < high else low] // 2
            is_wrong[side] = True
            for other in range(2 * link[side], 2 * link[side] + 2):
                at = slot_of[other] if 0 <= other < len(link) else -1
                if low <= at < high and (at != slot or high - low == 1):
                    is_wrong[side] &= (group[at] - group[slot]) % n_group > 1
    wrong = np.flatnonzero(is_wrong)
    return wrong, follower[wrong]


@njit(nogil=True, cache=True)
def find_rings(bucket, star):
    """Number the walks round the faces.

    Parameters
    ----------
    bucket, star : arrays
        From `sort_stars`; every side is in a star.

    Returns
    -------
    follower : int64 (n_side,)
        The side that a walk goes on with.
    ring : int64 (n_side,)
        Number of the walk, from 0 in the order of the least sides.
    n_ring : int

    Examples
    --------
    An edge alone, and an edge that is a loop (its sides leave north and east of one node):

    >>> find_rings(np.array([0, 1, 2, 4]), np.array([0, 1, 2, 3]))[1].tolist()
    [0, 0, 1, 2]
    """
    follower = np.empty(len(star), np.int64)
    for node in range(len(bucket) - 1):
        low, high = bucket[node], bucket[node + 1]
        for slot in range(low, high):
            follower[star[slot] ^ 1] = star[slot + 1 if slot + 1 < high else low]
    ring, n_ring = np.full(len(star), -1, np.int64), 0
    for first in range(len(star)):
        if ring[first] < 0:
            side = first
            while ring[side] < 0:
                ring[side] = n_ring
                side = follower[side]
            n_ring += 1
    return follower, ring, n_ring


@njit(nogil=True, cache=True)
def label_parts(start_node, end_node, n_node):
    """Number what hangs together.

    Parameters
    ----------
    start_node, end_node : int64 (n_edge,)
    n_node : int

    Returns
    -------
    part : int64 (n_node,)
        Number of each node's part, from 0 in the order of the least nodes.
    n_part : int

    Examples
    --------
    >>> label_parts(np.array([3, 1]), np.array([0, 1]), 4)
    (array([0, 1, 2, 0]), 3)
    """
    root = np.arange(n_node)
    for edge in range(len(start_node)):
        a, b = start_node[edge], end_node[edge]
        while root[a] != a:
            root[a] = root[root[a]]
            a = root[a]
        while root[b] != b:
            root[b] = root[root[b]]
            b = root[b]
        root[max(a, b)] = min(a, b)
    part, n_part = np.empty(n_node, np.int64), 0
    for node in range(n_node):
        if root[node] == node:
            part[node] = n_part
            n_part += 1
        else:
            part[node] = part[root[node]]
    return part, n_part


@njit(nogil=True, cache=True)
def _first_from_south(star, starts, places, target):
    """The side of a star that comes first when turning from south over east to north."""
    for slot in range(len(star)):
        side = star[slot]
        at = starts[side // 2] if side % 2 == 0 else starts[side // 2 + 1] - 1
        if places[target[side], 1] < places[at, 1]:
            return side
    return star[0]


@njit(nogil=True, cache=True)
def _side_to_west(edge, at, starts, places):
    """The side of an edge that has on its right what lies west of a bend, the westernmost place of the edge."""
    x, y = places[at, 0], places[at, 1]
    before, after = at - 1, at + 1
    while before > starts[edge] and places[before, 0] == x and places[before, 1] == y:
        before -= 1
    while after < starts[edge + 1] - 1 and places[after, 0] == x and places[after, 1] == y:
        after += 1
    turn = orientation(places[before, 0], places[before, 1], x, y, places[after, 0], places[after, 1])
    return 2 * edge if turn > 0 else 2 * edge + 1


@njit(nogil=True, cache=True)
def find_inner_rings(start_node, end_node, node_part, n_part, starts, places, target, bucket, star):
    """Westernmost place, and a side of the ring round it, of each part that has edges.

    Parameters
    ----------
    start_node, end_node : int64 (n_edge,)
    node_part : int64 (n_node,)
        Part of each node, from 0.
    n_part : int
    starts, places, target, bucket, star : arrays
        As in `sort_stars`; edges do not cross.

    Returns
    -------
    place : int64 (n_part,)
        Index of a place; -1 for a part without edges.
    side : int64 (n_part,)
        The side of an edge that has on its right what surrounds the part; -1 likewise.

    Examples
    --------
    A loop from its easternmost place, clockwise: its western bend is place 2, the outside lies to its left:

    >>> places, starts = np.array([[4, 0], [2, -2], [0, 0], [2, 2], [4, 0.0]]), np.array([0, 5])
    >>> node = np.array([0])
    >>> find_inner_rings(node, node, node, 1, starts, places, np.array([1, 3]), np.array([0, 2]), np.array([1, 0]))
    (array([2]), array([1]))
    """
    place, edge_of = np.full(n_part, -1, np.int64), np.full(n_part, -1, np.int64)
    for edge in range(len(start_node)):
        part = node_part[start_node[edge]]
        for i in range(starts[edge], starts[edge + 1]):
            best = place[part]
            is_better = best < 0 or places[i, 0] < places[best, 0]
            if is_better or (places[i, 0] == places[best, 0] and places[i, 1] < places[best, 1]):
                place[part], edge_of[part] = i, edge
    side = np.full(n_part, -1, np.int64)
    for part in range(n_part):
        if place[part] < 0:
            continue
        edge, at = edge_of[part], place[part]
        node = -1
        first, last = starts[edge], starts[edge + 1] - 1
        if places[at, 0] == places[first, 0] and places[at, 1] == places[first, 1]:
            node = start_node[edge]
        elif places[at, 0] == places[last, 0] and places[at, 1] == places[last, 1]:
            node = end_node[edge]
        if node >= 0:
            side[part] = _first_from_south(star[bucket[node] : bucket[node + 1]], starts, places, target)
        else:
            side[part] = _side_to_west(edge, at, starts, places)
    return place, side
