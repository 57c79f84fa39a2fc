r"""Which ring goes round each part of a graph from outside: kernels.

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

__all__ = ["find_inner_rings"]


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
        As in `vpfx.validate.vpf.stars`; edges do not cross.

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
