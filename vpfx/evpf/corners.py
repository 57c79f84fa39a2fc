"""From rings to corners: the faces of a tile as its rings have them (specs/evpf.md E-220, E-222).

A ring is walked with its face to the right, so clockwise: from the start edge, edge_1, which arrives at node_1, over edge_3 to
node_3 and over edge_2 back to node_2.

```
             3                       along edge_1 from 2 to 1, then edge_3, then edge_2;
           ·   ·   edge_2            a side with nodes inside is in pieces, and the ring has as many more edges
   edge_3 ·  f   ·
         ·         ·
        1 --edge_1-- 2
```
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["BROKEN", "Corners", "Edges", "Rings", "face_corners", "walk_rings"]

Ints = NDArray[np.int64]

BROKEN = {
    1: "found an edge that has another face",
    2: "found an edge that does not go on where the one before ends",
    3: "found a ring that does not close",
    4: "found a ring of fewer than three edges",
}
"""What can be wrong with a ring, by code; 0 is right."""


class Edges(NamedTuple):
    """Edges of one tile; indices from 0, faces as ids in `fac`.

    Attributes
    ----------
    start_node, end_node, right_face, left_face, right_edge, left_edge : int64 (n_edge,)
    """

    start_node: Ints
    end_node: Ints
    right_face: Ints
    left_face: Ints
    right_edge: Ints
    left_edge: Ints


class Rings(NamedTuple):
    """Rings that have been walked.

    Attributes
    ----------
    first : int64 (n_ring + 1,)
        Where each ring starts in `node`.
    node : int64 (n,)
        Nodes at which edges arrive, in the order of the walk.
    broken : int
        First ring that is wrong, -1 if none is.
    code : int
        What is wrong with it: see `BROKEN`.
    """

    first: Ints
    node: Ints
    broken: int
    code: int


class Corners(NamedTuple):
    """Corners of faces.

    Attributes
    ----------
    faces : int64 (n_face, 3)
        Nodes, counter-clockwise; edge_1 joins the first two.
    side, node : int64 (n,)
        Nodes inside sides: side 3·face + i, and the node.
    broken : int
        First face that has not three corners, -1 if there is none.
    """

    faces: Ints
    side: Ints
    node: Ints
    broken: int


def walk_rings(edges: Edges, face_id: Ints, start_edge: Ints) -> Rings:
    """Walk rings, each edge with the face to its right.

    Parameters
    ----------
    edges : Edges
        Nodes and edges they name exist.
    face_id, start_edge : int64 (n_ring,)

    Returns
    -------
    Rings
        Complete if no ring is broken.

    Notes
    -----
    Every side of an edge is walked once at most, whatever the links say. Cost: O(n_edge).

    Examples
    --------
    A triangle, its edges counter-clockwise, face 2 to their left:

    >>> u, v = np.array([0, 1, 2]), np.array([1, 2, 0])
    >>> edges = Edges(u, v, np.array([1, 1, 1]), np.array([2, 2, 2]), np.array([1, 2, 0]), np.array([2, 0, 1]))
    >>> walk_rings(edges, np.array([2]), np.array([0])).node.tolist()
    [0, 2, 1]
    """
    first = np.zeros(len(face_id) + 1, np.int64)
    node = np.empty(2 * len(edges.start_node), np.int64)
    broken, code = _walk(*edges, face_id, start_edge, first, node)
    return Rings(first, node[: first[-1]], int(broken), int(code))


@njit(nogil=True, cache=True)
def _walk(start_node, end_node, right_face, left_face, right_edge, left_edge, face_id, start_edge, first, node):
    """Fill `first` and `node`; return the first ring that is broken and why, or (-1, 0)."""
    is_walked = np.zeros(2 * len(start_node), np.bool_)
    at = 0
    for ring in range(len(face_id)):
        edge, here, origin = start_edge[ring], -1, -1
        while True:
            if right_face[edge] == face_id[ring] and not is_walked[2 * edge + 1]:
                side, leaves, arrives, after = 2 * edge + 1, start_node[edge], end_node[edge], right_edge[edge]
            elif left_face[edge] == face_id[ring]:
                side, leaves, arrives, after = 2 * edge, end_node[edge], start_node[edge], left_edge[edge]
            else:
                return ring, 3 if right_face[edge] == face_id[ring] else 1
            if is_walked[side]:
                return ring, 3
            if here >= 0 and leaves != here:
                return ring, 2
            if here < 0:
                origin = leaves
            is_walked[side] = True
            here = arrives
            node[at] = arrives
            at += 1
            edge = after
            if here == origin and edge == start_edge[ring]:
                break
        first[ring + 1] = at
        if at - first[ring] < 3:
            return ring, 4
    return -1, 0


def face_corners(rings: Rings, junction_face: Ints, junction_node: Ints) -> Corners:
    """Take the corners of faces out of their rings.

    Parameters
    ----------
    rings : Rings
        One a face, none broken.
    junction_face, junction_node : int64 (n_junction,)
        Nodes that are no corners, by face.

    Returns
    -------
    Corners
        Junctions in the order of faces and of the walk; fewer than given where one is not in the ring of its face.

    Examples
    --------
    Node 3 lies in edge_3, between nodes 1 and 2 of the ring:

    >>> face_corners(Rings(np.array([0, 4]), np.array([1, 3, 2, 0]), -1, 0), np.array([0]), np.array([3]))
    Corners(faces=array([[1, 0, 2]]), side=array([2]), node=array([3]), broken=-1)
    """
    n_face = len(rings.first) - 1
    face = np.repeat(np.arange(n_face), np.diff(rings.first))
    width = int(max(rings.node.max(initial=-1), junction_node.max(initial=-1))) + 1
    is_inside = np.isin(face * width + rings.node, junction_face * width + junction_node)
    n_corner = np.bincount(face[~is_inside], minlength=n_face)
    broken = np.flatnonzero(n_corner != 3)
    if len(broken):
        return Corners(np.empty((0, 3), np.int64), np.empty(0, np.int64), np.empty(0, np.int64), int(broken[0]))
    corners = rings.node[~is_inside].reshape(n_face, 3)
    before = np.cumsum(~is_inside) - 3 * face  # corners of the face met so far: 0 and 3 on edge_1
    at = np.flatnonzero(is_inside)
    side = np.array([0, 2, 1, 0])[before[at]]
    return Corners(corners[:, [0, 2, 1]], 3 * face[at] + side, rings.node[at], -1)
