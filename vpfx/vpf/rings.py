"""Rings round faces, from the winged edges of a tile: pure functions on arrays.

An edge has two sides. Side ``2 * edge`` runs from start to end and has ``right_face`` on its right; side ``2 * edge + 1`` runs
back and has ``left_face`` on its right. A ring is sides in order, its face always on the right: so outer rings come out
clockwise, inner ones counter-clockwise.

```
                right_edge of e                 At the end node, the first edge counter-clockwise after e is
               /                                right_edge: the next side of the ring of the right face. At the
    s ---e--> t     right face below            start node left_edge is, for the ring of the left face, which
                                                runs e backwards.
```

Source: vpf-facts §4.2, §4.3; specs/vpf.md, V-410, V-411.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["PROBLEMS", "Rings", "WingedEdges", "next_sides", "side_faces", "sides_of", "walk_rings"]

Indices = NDArray[np.int64]

CLOSED, NO_START, NOT_NAMED, OFF_NODE, OFF_FACE, NO_RETURN, REPEATED = range(7)

PROBLEMS = (
    "",
    "has no start edge in the table",
    "starts with an edge that does not name its face",
    "comes to an edge that does not touch the node",
    "comes to an edge that does not name its face",
    "never returns to its start",
    "is the ring of an earlier row",
)
"""What can be wrong with a ring that is walked, by number; 0 is nothing."""


class WingedEdges(NamedTuple):
    """Edges of a tile with their links, as indices from 0; -1 is none.

    Attributes
    ----------
    start_node, end_node, right_face, left_face : int64 (n_edge,)
    right_edge, left_edge : int64 (n_edge,)
        Next edge at the end node and at the start node.
    """

    start_node: Indices
    end_node: Indices
    right_face: Indices
    left_face: Indices
    right_edge: Indices
    left_edge: Indices


class Rings(NamedTuple):
    """Rings of sides.

    Attributes
    ----------
    starts : int64 (n_ring + 1,)
        Ring i is ``sides[starts[i]:starts[i + 1]]``.
    sides : int64 (n_side,)
        ``2 * edge``, or ``2 * edge + 1`` where the edge is run backwards.
    faces : int64 (n_ring,)
        Index of the face that each ring belongs to.
    """

    starts: Indices
    sides: Indices
    faces: Indices


def next_sides(edges: WingedEdges) -> Indices:
    """Side that follows each side by the links; whether it names the same face is not looked at.

    Parameters
    ----------
    edges : WingedEdges

    Returns
    -------
    int64 (2 * n_edge,)
        -1 where the link names no edge, or one that does not touch the node.

    Notes
    -----
    Which way the next edge runs is told by the node; of a loop, by the face. Cost: O(n_edge).

    Examples
    --------
    A loop, edge 0, with a spur inside, edge 1, that starts at the loop's node; face 1 is inside:

    >>> node, far = np.array([0, 0]), np.array([0, 1])
    >>> edges = WingedEdges(node, far, np.array([1, 1]), np.array([0, 1]), np.array([1, 1]), np.array([0, 0]))
    >>> next_sides(edges).tolist()
    [2, 1, 3, 0]
    """
    n_edge = len(edges.start_node)
    link, at_node = sides_of(edges.right_edge, edges.left_edge), sides_of(edges.end_node, edges.start_node)
    face = side_faces(edges)
    is_there = (link >= 0) & (link < n_edge) & (at_node >= 0)
    link = np.where(is_there, link, 0)
    if n_edge == 0:
        return link
    forwards = is_there & (edges.start_node[link] == at_node)
    backwards = is_there & (edges.end_node[link] == at_node)
    is_loop = forwards & backwards
    backwards &= ~is_loop | ((edges.right_face[link] != face) & (edges.left_face[link] == face))
    return np.where(backwards, 2 * link + 1, np.where(forwards, 2 * link, -1))


def side_faces(edges: WingedEdges) -> Indices:
    """Face on the right of each side, (2 * n_edge,)."""
    return sides_of(edges.right_face, edges.left_face)


def sides_of(forwards: Indices, backwards: Indices) -> Indices:
    """Values of the sides of edges, from those of the one side and of the other."""
    return np.stack([forwards, backwards], axis=1).ravel().astype(np.int64)


def walk_rings(edges: WingedEdges, faces: Indices, start_edges: Indices) -> tuple[Rings, NDArray[np.int8]]:
    """Rings from their start edges, as a ring table names them.

    Parameters
    ----------
    edges : WingedEdges
    faces, start_edges : int64 (n_ring,)
        Indices; -1 is none.

    Returns
    -------
    Rings
        One for each start edge. An edge with the face on both sides is run in and out. Empty where there is a problem.
    int8 (n_ring,)
        Number in `PROBLEMS`.

    Notes
    -----
    A walk ends where it meets a side for the second time, its own or an earlier ring's. Cost: O(n_edge + n_ring), whatever
    the links say.

    Examples
    --------
    The spur of `next_sides`, from its loop; edge 7 is not there:

    >>> node, far = np.array([0, 0]), np.array([0, 1])
    >>> edges = WingedEdges(node, far, np.array([1, 1]), np.array([0, 1]), np.array([1, 1]), np.array([0, 0]))
    >>> rings, problem = walk_rings(edges, np.array([1, 1]), np.array([0, 7]))
    >>> rings.sides.tolist(), rings.starts.tolist(), PROBLEMS[problem[1]]
    ([0, 2, 3], [0, 3, 3], 'has no start edge in the table')
    """
    faces, start_edges = np.asarray(faces, np.int64), np.asarray(start_edges, np.int64)
    starts, sides, problem = _walk(next_sides(edges), side_faces(edges), faces, start_edges)
    return Rings(starts, sides, faces), problem


@njit(nogil=True, cache=True)
def _walk(follower, face_of, faces, start_edges):
    """Rings from start edges: starts, sides, problems; a side is in one walk only."""
    n_side, n_ring = len(follower), len(faces)
    starts, problem = np.zeros(n_ring + 1, np.int64), np.zeros(n_ring, np.int8)
    sides, filled = np.empty(n_side, np.int64), 0
    walk_of = np.full(n_side, -1, np.int64)
    for ring in range(n_ring):
        face, edge = faces[ring], start_edges[ring]
        starts[ring + 1] = filled
        if edge < 0 or 2 * edge >= n_side or face < 0:
            problem[ring] = NO_START
            continue
        first = 2 * edge if face_of[2 * edge] == face else 2 * edge + 1
        if face_of[first] != face:
            problem[ring] = NOT_NAMED
            continue
        if walk_of[first] >= 0:
            problem[ring] = REPEATED if problem[walk_of[first]] == CLOSED else NO_RETURN
            continue
        side, count = first, filled
        while True:
            walk_of[side] = ring
            sides[count] = side
            count += 1
            side = follower[side]
            if side == first:
                break
            if side < 0:
                problem[ring] = OFF_NODE
            elif face_of[side] != face:
                problem[ring] = OFF_FACE
            elif walk_of[side] >= 0:
                problem[ring] = NO_RETURN
            if problem[ring] != CLOSED:
                break
        if problem[ring] == CLOSED:
            filled = count
            starts[ring + 1] = filled
    return starts, sides[:filled].copy(), problem
