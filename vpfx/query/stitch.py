"""Cutting faces that have nodes inside their edges, so that they fit their neighbours (specs/query.md Q-330)."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vpfx.topology import find_t_junctions, find_twins

__all__ = ["stitch"]

Faces = NDArray[np.int32]


def stitch(nodes: NDArray[np.float64], face_nodes: Faces) -> tuple[Faces, NDArray[np.int64]]:
    """Cut faces at the nodes that lie inside their edges.

    Parameters
    ----------
    nodes : float64 (n_node, 3)
    face_nodes : int32 (n_face, 3)
        Counter-clockwise; where two edges meet that are not the same, nodes of one lie on the other.

    Returns
    -------
    face_nodes : int32 (n, 3)
        First the faces that stay as they are, in their order, then the pieces of the others.
    source : int64 (n,)
        The face that each comes from.

    Notes
    -----
    No node is added: a face with n nodes inside its edges becomes n + 1. Cost: O(n_face), O(n log n) in edges that do not fit.

    Examples
    --------
    Node 3 lies inside the edge from 0 to 1:

    >>> nodes = np.array([[0, 0, 0], [4, 0, 0], [2, 3, 0], [2, 0, 0], [2, -3, 0.0]])
    >>> faces, source = stitch(nodes, np.array([[0, 1, 2], [0, 4, 3], [3, 4, 1]], np.int32))
    >>> faces.tolist(), source.tolist()
    ([[0, 4, 3], [3, 4, 1], [1, 2, 3], [2, 0, 3]], [1, 2, 0, 0])
    """
    side, node, _ = find_t_junctions(nodes, face_nodes, find_twins(face_nodes, len(nodes)))
    start, end = nodes[face_nodes[side // 3, side % 3]], nodes[face_nodes[side // 3, (side + 1) % 3]]
    along = ((nodes[node] - start)[:, :2] * (end - start)[:, :2]).sum(axis=1)
    order = np.lexsort((along, side))
    side, node = side[order], node[order].astype(np.int32)
    cut = np.unique(side // 3)
    first = np.searchsorted(side, 3 * cut[:, None] + np.arange(4))
    count = first[:, 3] - first[:, 0] + 1
    pieces = np.empty((int(count.sum()), 3), np.int32)
    _cut_faces(face_nodes[cut], first, node, pieces)
    kept = np.delete(np.arange(len(face_nodes)), cut)
    return np.concatenate([face_nodes[kept], pieces]), np.concatenate([kept, np.repeat(cut, count)])


@njit(nogil=True, cache=True)
def _cut_faces(face_nodes, first, node, pieces):  # type: ignore[no-untyped-def]
    r"""Fill the pieces of faces; nodes inside side i of face f are ``node[first[f, i]:first[f, i + 1]]``, in its direction.

    Where one side has none, the corner across it is the apex of a strip between the two others. Else the middle nodes p, q
    and r of the three sides make one piece, and each corner the apex of a strip up to them::

              c
             / \           strip from a up to p and r:
            r---q            a, p1, p2 … p  along the first side
           / \ / \          a, r1, r2 … r  along the third, backwards
          a---p---b
    """
    done = np.int64(0)
    chain = np.empty((2, len(node) + 2), np.int32)
    for face in range(len(face_nodes)):
        low, high = first[face, :3], first[face, 1:]
        empty = -1
        for i in range(3):
            if low[i] == high[i]:
                empty = i
        if empty >= 0:
            apex = (empty + 2) % 3
            done = _strip(
                face_nodes[face], low, high, node, apex, high[apex], low[(apex + 2) % 3] - 1, chain, pieces, done
            )
            continue
        middle = (low + high) // 2
        pieces[done] = node[middle[0]], node[middle[1]], node[middle[2]]
        done += 1
        for apex in range(3):
            done = _strip(
                face_nodes[face], low, high, node, apex, middle[apex], middle[(apex + 2) % 3], chain, pieces, done
            )


@njit(nogil=True, cache=True)
def _strip(corners, low, high, node, apex, last, other_last, chain, pieces, done):  # type: ignore[no-untyped-def]
    """Fill the strip at a corner, up to a node of the side that leaves it and one of the side that arrives; return the count.

    A node number past the side's own means the corner at its far end.
    """
    before = (apex + 2) % 3
    n_p, n_q = 1, 1
    chain[0, 0] = chain[1, 0] = corners[apex]
    for i in range(low[apex], min(last + 1, high[apex])):
        chain[0, n_p] = node[i]
        n_p += 1
    if last == high[apex]:
        chain[0, n_p] = corners[(apex + 1) % 3]
        n_p += 1
    for i in range(high[before] - 1, max(other_last, low[before]) - 1, -1):
        chain[1, n_q] = node[i]
        n_q += 1
    if other_last < low[before]:
        chain[1, n_q] = corners[before]
        n_q += 1
    pieces[done] = chain[0, 0], chain[0, 1], chain[1, 1]
    done += 1
    p, q = 1, 1
    while p < n_p - 1 or q < n_q - 1:
        if q == n_q - 1 or (p < n_p - 1 and p * (n_q - 1) <= q * (n_p - 1)):
            pieces[done] = chain[0, p], chain[0, p + 1], chain[1, q]
            p += 1
        else:
            pieces[done] = chain[0, p], chain[1, q + 1], chain[1, q]
            q += 1
        done += 1
    return done
