"""From faces to edges, neighbours and winged-edge links: pure functions on arrays.

A mesh is ``face_nodes (n_face, 3)``, counter-clockwise. Side ``s = 3 * face + i`` runs from node i of the face to the next;
an edge is a pair of twin sides, or a side without twin on the outside.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["Sides", "find_twins", "outside_links", "sides"]

Indices = NDArray[np.int64]
NONE = -1


class Sides(NamedTuple):
    """Sides of a mesh.

    Attributes
    ----------
    start, end : int64 (3 * n_face,)
        Node indices.
    twin : int64 (3 * n_face,)
        The side that runs the other way; -1 outside.
    previous : int64 (3 * n_face,)
        The side of the same face that ends where this one starts: the next edge counter-clockwise round its start node.
    """

    start: Indices
    end: Indices
    twin: Indices
    previous: Indices


@njit(nogil=True, cache=True)
def find_twins(face_nodes, n_node):
    """Twin side of every side of a mesh.

    Parameters
    ----------
    face_nodes : int32 (n_face, 3)
        Node indices, counter-clockwise; no two sides run the same way between the same nodes.
    n_node : int
        Number of nodes.

    Returns
    -------
    int32 (3 * n_face,)
        The side that runs the other way, -1 where there is none.

    Notes
    -----
    Sides are sorted into buckets by their start node. Cost: O(n_face × degree).

    Examples
    --------
    >>> find_twins(np.array([[0, 1, 2], [2, 1, 3]], dtype=np.int32), 4).tolist()
    [-1, 3, -1, 1, -1, -1]
    """
    n_side = 3 * len(face_nodes)
    bucket = np.zeros(n_node + 1, np.int32)
    for face in range(len(face_nodes)):
        for i in range(3):
            bucket[face_nodes[face, i] + 1] += 1
    for node in range(n_node):
        bucket[node + 1] += bucket[node]
    fill = bucket[:-1].copy()
    sides = np.empty(n_side, np.int32)
    for side in range(n_side):
        start = face_nodes[side // 3, side % 3]
        sides[fill[start]] = side
        fill[start] += 1
    twin = np.full(n_side, NONE, np.int32)
    for side in range(n_side):
        if twin[side] != NONE:
            continue
        face, i = side // 3, side % 3
        start, end = face_nodes[face, i], face_nodes[face, (i + 1) % 3]
        for slot in range(bucket[end], bucket[end + 1]):
            other = sides[slot]
            if face_nodes[other // 3, (other % 3 + 1) % 3] == start:
                twin[side] = other
                twin[other] = side
                break
    return twin


def sides(face_nodes: NDArray[np.int32], n_node: int) -> Sides:
    """Sides of a mesh and their twins.

    Parameters
    ----------
    face_nodes : int32 (n_face, 3)
        Node indices, counter-clockwise.
    n_node : int
        Number of nodes.

    Examples
    --------
    >>> sides(np.array([[0, 1, 2], [2, 1, 3]], dtype=np.int32), 4).twin.tolist()
    [-1, 3, -1, 1, -1, -1]
    """
    start = face_nodes.ravel().astype(np.int64)
    end = np.roll(face_nodes, -1, axis=1).ravel().astype(np.int64)
    index = np.arange(len(start), dtype=np.int64)
    previous = np.where(index % 3 == 0, index + 2, index - 1)
    twin = find_twins(np.ascontiguousarray(face_nodes, dtype=np.int32), n_node).astype(np.int64)
    return Sides(start, end, twin, previous)


def outside_links(
    start: Indices, end: Indices, east: NDArray[np.float64], north: NDArray[np.float64]
) -> NDArray[np.int64]:
    """Next side over the outside for every side that has no twin.

    Parameters
    ----------
    start, end : int64 (n_side,)
        Node of each end; any numbers that are equal for equal nodes.
    east, north : float64 (n_side,)
        Direction from start to end.

    Returns
    -------
    int64 (n_side,)
        For each side the one that is met first when turning counter-clockwise round its end, away from its face, among
        those that start there; -1 if none of the given sides starts there.

    Notes
    -----
    Source: vpf-facts §4.2, "cyclic also over the outside". Cost: O(n log n), and n² for sides that share one node.

    Examples
    --------
    Round the outside of one triangle:

    >>> outside_links(np.array([0, 1, 2]), np.array([1, 2, 0]), np.array([1.0, -1, 0]), np.array([0.0, 1, -1])).tolist()
    [1, 2, 0]
    """
    order = np.argsort(start, kind="stable")
    first = np.searchsorted(start[order], end, side="left")
    count = np.searchsorted(start[order], end, side="right") - first
    follower = np.where(count > 0, order[np.minimum(first, len(order) - 1)] if len(order) else -1, -1)
    for side in np.flatnonzero(count > 1):
        choices = order[first[side] : first[side] + count[side]]
        cross = -east[side] * north[choices] + north[side] * east[choices]
        dot = -east[side] * east[choices] - north[side] * north[choices]
        turn = np.arctan2(cross, dot)
        follower[side] = choices[np.argmin(np.where(turn > 0, turn, turn + 2 * np.pi))]
    return follower
