"""Rings of all faces of a tile from its winged edges alone, also where links or names of faces are wrong: pure functions.

An edge has two sides. Side ``2 * edge`` runs from start to end and has ``right_face`` on its right; side ``2 * edge + 1`` runs
back and has ``left_face`` on its right. A ring is sides in order, its face always on the right: so outer rings come out
clockwise, inner ones counter-clockwise.

```
                right_edge of e                 At the end node, the first edge counter-clockwise after e is
               /                                right_edge: the next side of the ring of the right face. At the
    s ---e--> t     right face below            start node left_edge is, for the ring of the left face, which
                                                runs e backwards.
```

Source: specs/vpf.md, V-410 to V-413.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["FoundRings", "Rings", "WingedEdges", "find_rings", "next_sides", "rings_of", "simple_rings"]

Indices = NDArray[np.int64]


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


class FoundRings(NamedTuple):
    """Rings of all faces of a tile.

    Attributes
    ----------
    rings : Rings
        Simple ones: no node twice, no edge in both directions.
    mended : int64 (n,)
        Faces, ascending, whose rings could not be walked by the links alone.
    lost : int64 (n,)
        Faces, ascending, whose edges do not close up; they have no ring.
    """

    rings: Rings
    mended: Indices
    lost: Indices


def find_rings(edges: WingedEdges) -> FoundRings:
    """All rings of a tile, from its edges alone: what the face and ring tables say is not needed.

    Parameters
    ----------
    edges : WingedEdges
        Planar, with nodes and faces (topology level 3). May be damaged.

    Returns
    -------
    FoundRings

    Notes
    -----
    A face whose links run through all its sides and return is taken so. Of any other the sides that name it are joined at
    their nodes, whatever the links say. Where these do not close up, a ring of the links most of whose sides name the face is
    taken. Links and names of faces each tell the rings; so one of them may be wrong. Cost: O(n_edge log n_edge).

    Examples
    --------
    Two faces on both sides of edge 1; a link of edge 0 is wrong:

    >>> start, end = np.array([0, 0, 1]), np.array([1, 1, 0])
    >>> right, left = np.array([1, 2, 2]), np.array([0, 1, 0])
    >>> edges = WingedEdges(start, end, right, left, np.array([0, 2, 1]), np.array([2, 0, 0]))
    >>> found = find_rings(edges)
    >>> [part.tolist() for part in np.split(found.rings.sides, found.rings.starts[1:-1])], found.rings.faces.tolist()
    ([[1, 5], [2, 4], [0, 3]], [0, 2, 1])
    >>> found.mended.tolist(), found.lost.tolist()
    ([1], [])
    """
    face_of, from_node, to_node = _side_faces(edges), *_side_nodes(edges)
    follower = next_sides(edges)
    is_named = face_of >= 0
    agrees = is_named & (follower >= 0) & (face_of[follower] == face_of)
    starts, sides = _closed(_one_to_one(np.where(agrees, follower, -1)))
    walked = Rings(starts, sides, face_of[sides[starts[:-1]]])
    left_over = is_named.copy()
    left_over[sides] = False
    mended = np.unique(face_of[left_over])
    if len(mended) == 0:
        return FoundRings(simple_rings(edges, walked), mended, mended)
    is_open = np.isin(face_of, mended) & is_named
    link, open_faces = _joined(np.flatnonzero(is_open), face_of, from_node, to_node)
    starts, sides = _closed(link)
    joined = Rings(starts, sides, face_of[sides[starts[:-1]]])
    by_most = _rings_by_most(follower, face_of, open_faces)
    rings = _concatenate([rings_of(walked, mended, others=True), joined, by_most])
    lost = np.setdiff1d(open_faces, by_most.faces)
    return FoundRings(simple_rings(edges, rings), np.setdiff1d(mended, lost), lost)


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
    link, at_node = _sides_of(edges.right_edge, edges.left_edge), _sides_of(edges.end_node, edges.start_node)
    face = _side_faces(edges)
    is_there = (link >= 0) & (link < n_edge) & (at_node >= 0)
    link = np.where(is_there, link, 0)
    if n_edge == 0:
        return link
    forwards = is_there & (edges.start_node[link] == at_node)
    backwards = is_there & (edges.end_node[link] == at_node)
    is_loop = forwards & backwards
    backwards &= ~is_loop | ((edges.right_face[link] != face) & (edges.left_face[link] == face))
    return np.where(backwards, 2 * link + 1, np.where(forwards, 2 * link, -1))


def _side_faces(edges: WingedEdges) -> Indices:
    """Face on the right of each side, (2 * n_edge,)."""
    return _sides_of(edges.right_face, edges.left_face)


def _sides_of(forwards: Indices, backwards: Indices) -> Indices:
    """Values of the sides of edges, from those of the one side and of the other."""
    return np.stack([forwards, backwards], axis=1).ravel().astype(np.int64)


def _side_nodes(edges: WingedEdges) -> tuple[Indices, Indices]:
    """Node that each side leaves, and that it comes to, numbered anew without gaps; -1 stays -1."""
    known, number = np.unique(_sides_of(edges.start_node, edges.end_node), return_inverse=True)
    from_node = number.ravel() - int(len(known) > 0 and known[0] < 0)
    return from_node, from_node.reshape(-1, 2)[:, ::-1].ravel()


def _one_to_one(follower: Indices) -> Indices:
    """Follow no side from two."""
    count = np.bincount(follower[follower >= 0], minlength=len(follower))
    return np.where((follower >= 0) & (count[follower] == 1), follower, -1)


def _joined(sides: Indices, face_of: Indices, from_node: Indices, to_node: Indices) -> tuple[Indices, Indices]:
    """Join sides of each face at their nodes: the side that follows each, and the faces whose sides do not close up."""
    n_node = int(from_node.max(initial=0)) + 2
    leaving = face_of[sides] * n_node + from_node[sides] + 1
    coming = face_of[sides] * n_node + to_node[sides] + 1
    keys, at = np.unique(np.concatenate([leaving, coming]), return_inverse=True)
    at = at.ravel()
    surplus = np.bincount(at[: len(sides)], minlength=len(keys)) - np.bincount(at[len(sides) :], minlength=len(keys))
    is_nowhere = keys % n_node == 0
    open_faces = np.unique(keys[(surplus != 0) | is_nowhere] // n_node)
    is_even = ~np.isin(face_of[sides], open_faces)
    sides, leaving, coming = sides[is_even], leaving[is_even], coming[is_even]
    link = np.full(len(face_of), -1, np.int64)
    link[sides[np.argsort(coming, kind="stable")]] = sides[np.argsort(leaving, kind="stable")]
    return link, open_faces


def _rings_by_most(follower: Indices, face_of: Indices, faces: Indices) -> Rings:
    """Rings of the links more than half of whose sides name one of some faces."""
    starts, sides = _closed(_one_to_one(follower))
    ring_of = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    pairs, count = np.unique(np.stack([ring_of, face_of[sides]], axis=1), axis=0, return_counts=True)
    is_most = 2 * count > np.diff(starts)[pairs[:, 0]]
    chosen = np.full(len(starts) - 1, -1, np.int64)
    chosen[pairs[is_most, 0]] = pairs[is_most, 1]
    others = chosen[~np.isin(chosen, faces)]
    return rings_of(Rings(starts, sides, chosen), others, others=True)


def rings_of(rings: Rings, faces: Indices, *, others: bool = False) -> Rings:
    """Rings of some faces, or of all others."""
    keep = np.isin(rings.faces, faces, invert=others)
    n_side = np.diff(rings.starts)
    starts = np.concatenate([[0], np.cumsum(n_side[keep])])
    return Rings(starts, rings.sides[np.repeat(keep, n_side)], rings.faces[keep])


def _concatenate(parts: list[Rings]) -> Rings:
    """All rings of some."""
    n_side = np.concatenate([np.diff(part.starts) for part in parts])
    sides, faces = (np.concatenate([part[i] for part in parts]) for i in (1, 2))
    return Rings(np.concatenate([[0], np.cumsum(n_side)]), sides, faces)


@njit(nogil=True, cache=True)
def _closed(follower):
    """Cycles of sides, where no side follows two: starts and sides; in the order of their least sides."""
    n_side = len(follower)
    starts, n_ring = np.zeros(n_side + 1, np.int64), 0
    sides, filled = np.empty(n_side, np.int64), 0
    is_seen = np.zeros(n_side, np.bool_)
    for first in range(n_side):
        side, count = first, filled
        while side >= 0 and not is_seen[side]:
            is_seen[side] = True
            sides[count] = side
            count += 1
            side = follower[side]
        if count > filled and side == first:
            filled = count
            n_ring += 1
            starts[n_ring] = filled
    return starts[: n_ring + 1].copy(), sides[:filled].copy()


def simple_rings(edges: WingedEdges, rings: Rings) -> Rings:
    """Cut rings where they come to a node for the second time, and drop edges that are run in and out.

    Parameters
    ----------
    edges : WingedEdges
    rings : Rings
        Closed ones.

    Returns
    -------
    Rings
        No node is twice in one of them; so an inner ring that touches the outer one, or hangs on it by a bridge, is a ring
        of its own.

    Notes
    -----
    Cost: O(sides), and sorting the nodes.

    Examples
    --------
    The spur of `next_sides` goes:

    >>> node, far = np.array([0, 0]), np.array([0, 1])
    >>> edges = WingedEdges(node, far, np.array([1, 1]), np.array([0, 1]), np.array([1, 1]), np.array([0, 0]))
    >>> simple_rings(edges, Rings(np.array([0, 3]), np.array([0, 2, 3]), np.array([1])))
    Rings(starts=array([0, 1]), sides=array([0]), faces=array([1]))
    """
    from_node, _ = _side_nodes(edges)
    starts, sides, ring_of = _cut_at_nodes(rings.starts, rings.sides, from_node)
    return Rings(starts, sides, rings.faces[ring_of])


@njit(nogil=True, cache=True)
def _cut_at_nodes(starts, sides, from_node):
    r"""Cut rings at nodes met twice: starts and sides of the pieces, and the ring that each comes from.

    ```
      a --> b     The sides so far lie on a stack. When node b is met again, the sides since b are a ring; they are taken
           / ^    off the stack, and the walk goes on from b.
          v   \
          c --> d
    ```
    """
    n_side = len(sides)
    out_starts, out, ring_of = np.zeros(n_side + 1, np.int64), np.empty(n_side, np.int64), np.empty(n_side, np.int64)
    n_out, filled = 0, 0
    stack = np.empty(n_side, np.int64)
    place = np.full(from_node.max() + 1 if len(from_node) else 0, -1, np.int64)  # of a node on the stack
    for ring in range(len(starts) - 1):
        height = 0
        for i in range(starts[ring], starts[ring + 1] + 1 if starts[ring] < starts[ring + 1] else 0):
            is_end = i == starts[ring + 1]
            node = from_node[sides[starts[ring] if is_end else i]]
            low = place[node]
            if low >= 0:
                if height - low != 2 or stack[low] // 2 != stack[low + 1] // 2:
                    for j in range(low, height):
                        out[filled] = stack[j]
                        filled += 1
                    n_out += 1
                    out_starts[n_out], ring_of[n_out - 1] = filled, ring
                for j in range(low, height):
                    place[from_node[stack[j]]] = -1
                height = low
            if not is_end:
                place[node], stack[height] = height, sides[i]
                height += 1
    return out_starts[: n_out + 1].copy(), out[:filled].copy(), ring_of[:n_out].copy()
