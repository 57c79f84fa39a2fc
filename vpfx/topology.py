"""From faces to edges, neighbours and winged-edge links: pure functions on arrays.

A mesh is ``face_nodes (n_face, 3)``, counter-clockwise. Side ``s = 3 * face + i`` runs from node i of the face to the next;
an edge is a pair of twin sides, or a side without twin on the outside.
"""

from __future__ import annotations

import numpy as np
import shapely
from numba import njit
from numpy.typing import NDArray

__all__ = ["NONE", "find_t_junctions", "find_twins", "outside_links"]

Indices = NDArray[np.int64]
NONE = -1
"""Stands for no node, side or face in arrays of indices."""

SAME_WAY = 1e-7
"""Radians: sides that leave a node so near to each other run side by side, with nothing between them."""

ON_SIDE = 1e-9
"""Share of a side's length by which a node may lie beside it and still lie on it."""


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
    n_face = len(face_nodes)
    bucket = np.zeros(n_node + 1, np.int32)
    for face in range(n_face):
        for i in range(3):
            bucket[face_nodes[face, i] + 1] += 1
    for node in range(n_node):
        bucket[node + 1] += bucket[node]
    fill = bucket[:-1].copy()
    sides, ends = np.empty(3 * n_face, np.int32), np.empty(3 * n_face, np.int32)
    for face in range(n_face):
        for i in range(3):
            slot = fill[face_nodes[face, i]]
            fill[face_nodes[face, i]] += 1
            sides[slot], ends[slot] = 3 * face + i, face_nodes[face, (i + 1) % 3]
    twin = np.full(3 * n_face, NONE, np.int32)
    for face in range(n_face):
        for i in range(3):
            if twin[3 * face + i] != NONE:
                continue
            start, end = face_nodes[face, i], face_nodes[face, (i + 1) % 3]
            for slot in range(bucket[end], bucket[end + 1]):
                if ends[slot] == start:
                    twin[3 * face + i] = sides[slot]
                    twin[sides[slot]] = 3 * face + i
                    break
    return twin


def outside_links(
    start: NDArray[np.integer], end: NDArray[np.integer], east: NDArray[np.float64], north: NDArray[np.float64]
) -> NDArray[np.int64]:
    """Next side over the outside for every side that has no twin.

    Parameters
    ----------
    start, end : integers (n_side,)
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
    Source: vpf-facts §4.2, "cyclic also over the outside". Along an edge with a node inside, two sides run side by side with
    nothing between; that is the outside too. Cost: O(n log n), and n² for sides that share one node.

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
        turn[np.abs(turn) < SAME_WAY] = 0.0
        follower[side] = choices[np.argmin(np.where(turn >= 0, turn, turn + 2 * np.pi))]
    return follower


def find_t_junctions(
    nodes: NDArray[np.float64], face_nodes: NDArray[np.int32], twin: NDArray[np.int32]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Nodes that lie inside a side without twin.

    Parameters
    ----------
    nodes : float64 (n_node, 3)
    face_nodes : int32 (n_face, 3)
    twin : int32 (3 * n_face,)
        As `find_twins` gives it.

    Returns
    -------
    side, node : int64 (n,)
        Sorted by side, then node; only nodes that end a side without twin can lie in one.
    gap : float64 (n,)
        Height of the node less that of the side at its place, metres.

    Notes
    -----
    Cost: O(n log n) in the sides without twin.

    Examples
    --------
    Node 3 lies inside the edge from 0 to 1, half a metre above it:

    >>> nodes = np.array([[0, 0, 0], [4, 0, 0], [2, 3, 0], [2, 0, 0.5], [2, -3, 0]])
    >>> faces = np.array([[0, 1, 2], [0, 4, 3], [3, 4, 1]], np.int32)
    >>> find_t_junctions(nodes, faces, find_twins(faces, 5))
    (array([0]), array([3]), array([0.5]))
    """
    open_sides = np.flatnonzero(twin < 0)
    start, end = face_nodes[open_sides // 3, open_sides % 3], face_nodes[open_sides // 3, (open_sides % 3 + 1) % 3]
    ends = np.unique(start)
    way = nodes[end] - nodes[start]
    length = np.hypot(way[:, 0], way[:, 1])
    lines = shapely.linestrings(np.stack([nodes[start, :2], nodes[end, :2]], axis=1))
    points = shapely.points(nodes[ends, :2])
    at_point, at_line = shapely.STRtree(lines).query(points, "dwithin", ON_SIDE * length.max(initial=0.0))
    node, line = ends[at_point], at_line
    to_node = nodes[node] - nodes[start[line]]
    along = (to_node[:, :2] * way[line, :2]).sum(axis=1) / length[line] ** 2
    beside = np.abs(to_node[:, 0] * way[line, 1] - to_node[:, 1] * way[line, 0]) / length[line]
    is_inside = (beside <= ON_SIDE * length[line]) & (along > ON_SIDE) & (along < 1.0 - ON_SIDE)
    gap = (to_node[:, 2] - along * way[line, 2])[is_inside]
    side, node = open_sides[line[is_inside]].astype(np.int64), node[is_inside].astype(np.int64)
    order = np.lexsort((node, side))
    return side[order], node[order], gap[order]
