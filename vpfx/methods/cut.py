r"""Cutting faces by the paper's rules 1 to 4: the one kernel that turns a mesh with breaks into the next mesh.

A mesh in the making is two flat arrays. Side ``s = 3 * face + i`` runs from node i of the face to the next:

    face_nodes (n_face, 3)   node indices, counter-clockwise
    side_twin (3 * n_face,)  the side of the neighbouring face that runs the other way; -1 where there is none

           n2                  rule 1: one side broken             rule 2: two, the corner goes and a diagonal cuts the rest
          /  \                  rule 3: all three                   rule 4: none, but a node inside
     s=2 /    \ s=1
        /      \                m[i] = node that breaks side i      p = node inside
      n0 ------ n1
          s=0
"""

from __future__ import annotations

import numpy as np
from numba import njit

__all__ = ["cut_faces"]

NONE = -1


@njit(nogil=True, cache=True)
def _cut_one(face, face_nodes, side_break, p, flip, n, child, inner, halves):
    """Write the children of one face at child[n:], return how many.

    child (n_child, 3) gets their nodes; inner (3 * n_child,) the twins of sides between siblings; halves (n_side, 2) the
    child sides that lie on the first and the second half of each side (the same twice if unbroken).
    """
    nodes = (face_nodes[face, 0], face_nodes[face, 1], face_nodes[face, 2])
    m = (side_break[3 * face], side_break[3 * face + 1], side_break[3 * face + 2])
    s = 3 * face
    count = 0
    for i in range(3):
        count += m[i] != NONE
    if count == 0 and p == NONE:
        for i in range(3):
            child[n, i] = nodes[i]
            halves[s + i, 0] = halves[s + i, 1] = 3 * n + i
        return 1
    if count == 0:  # rule 4: child i stands on side i, its apex is p
        for i in range(3):
            child[n + i, 0], child[n + i, 1], child[n + i, 2] = nodes[i], nodes[(i + 1) % 3], p
            halves[s + i, 0] = halves[s + i, 1] = 3 * (n + i)
            inner[3 * (n + i) + 1] = 3 * (n + (i + 1) % 3) + 2
            inner[3 * (n + i) + 2] = 3 * (n + (i + 2) % 3) + 1
        return 3
    if count == 3:  # rule 3: child i is the corner at node i, child 3 the middle
        for i in range(3):
            before = (i + 2) % 3
            child[n + i, 0], child[n + i, 1], child[n + i, 2] = nodes[i], m[i], m[before]
            halves[s + i, 0] = 3 * (n + i)
            halves[s + before, 1] = 3 * (n + i) + 2
            child[n + 3, i] = m[i]
            inner[3 * (n + i) + 1] = 3 * (n + 3) + before
            inner[3 * (n + 3) + before] = 3 * (n + i) + 1
        return 4
    i = 0
    if count == 1:  # rule 1: a = (n_i, m, n_k), b = (m, n_j, n_k)
        while m[i] == NONE:
            i += 1
        j, k = (i + 1) % 3, (i + 2) % 3
        child[n, 0], child[n, 1], child[n, 2] = nodes[i], m[i], nodes[k]
        child[n + 1, 0], child[n + 1, 1], child[n + 1, 2] = m[i], nodes[j], nodes[k]
        halves[s + i, 0], halves[s + i, 1] = 3 * n, 3 * (n + 1)
        halves[s + j, 0] = halves[s + j, 1] = 3 * (n + 1) + 1
        halves[s + k, 0] = halves[s + k, 1] = 3 * n + 2
        inner[3 * n + 1] = 3 * (n + 1) + 2
        inner[3 * (n + 1) + 2] = 3 * n + 1
        return 2
    while m[i] == NONE or m[(i + 1) % 3] == NONE:
        i += 1
    j, k = (i + 1) % 3, (i + 2) % 3
    # rule 2: corner c = (m_i, n_j, m_j); the quadrilateral n_i, m_i, m_j, n_k is cut from n_i to m_j, or (flip) from m_i to n_k
    child[n, 0], child[n, 1], child[n, 2] = m[i], nodes[j], m[j]
    halves[s + i, 1] = 3 * n
    halves[s + j, 0] = 3 * n + 1
    a, b = 3 * (n + 1), 3 * (n + 2)
    if flip:  # a = (m_i, m_j, n_k), b = (n_i, m_i, n_k)
        child[n + 1, 0], child[n + 1, 1], child[n + 1, 2] = m[i], m[j], nodes[k]
        child[n + 2, 0], child[n + 2, 1], child[n + 2, 2] = nodes[i], m[i], nodes[k]
        inner[3 * n + 2], inner[a] = a, 3 * n + 2
        inner[a + 2], inner[b + 1] = b + 1, a + 2
        halves[s + i, 0] = b
        halves[s + j, 1] = a + 1
        halves[s + k, 0] = halves[s + k, 1] = b + 2
    else:  # a = (n_i, m_i, m_j), b = (n_i, m_j, n_k)
        child[n + 1, 0], child[n + 1, 1], child[n + 1, 2] = nodes[i], m[i], m[j]
        child[n + 2, 0], child[n + 2, 1], child[n + 2, 2] = nodes[i], m[j], nodes[k]
        inner[3 * n + 2], inner[a + 1] = a + 1, 3 * n + 2
        inner[a + 2], inner[b] = b, a + 2
        halves[s + i, 0] = a
        halves[s + j, 1] = b + 1
        halves[s + k, 0] = halves[s + k, 1] = b + 2
    return 3


@njit(nogil=True, cache=True)
def cut_faces(face_nodes, side_twin, side_break, face_inner, face_flip):
    """Cut every face that has a break, by rules 1 to 4.

    Parameters
    ----------
    face_nodes : int32 (n_face, 3)
    side_twin : int32 (3 * n_face,)
    side_break : int32 (3 * n_face,)
        Node that breaks the side, -1 for none; the same on both twins.
    face_inner : int32 (n_face,)
        Node inside the face, -1 for none; looked at only where no side is broken (rule 4).
    face_flip : bool (n_face,)
        Which diagonal rule 2 takes: False from the start of the first broken side, True from its break.

    Returns
    -------
    child_nodes : int32 (n_child, 3)
        Children in the order of their parents; an uncut face is its own child.
    child_twin : int32 (3 * n_child,)
    child_parent : int32 (n_child,)
        Index of the face each child lies in.

    Notes
    -----
    Source: paper-facts §2, rules 1–4; specs/methods.md M-110. Cost: O(n_face).
    """
    n_face = len(face_nodes)
    n_child = 0
    for face in range(n_face):
        count = 0
        for i in range(3):
            count += side_break[3 * face + i] != NONE
        n_child += count + 1 if count else (3 if face_inner[face] != NONE else 1)
    child = np.empty((n_child, 3), np.int32)
    twin = np.full(3 * n_child, NONE, np.int32)
    parent = np.empty(n_child, np.int32)
    halves = np.empty((3 * n_face, 2), np.int32)
    n = 0
    for face in range(n_face):
        added = _cut_one(face, face_nodes, side_break, face_inner[face], face_flip[face], n, child, twin, halves)
        parent[n : n + added] = face
        n += added
    for side in range(3 * n_face):
        other = side_twin[side]
        if other != NONE:
            twin[halves[side, 0]] = halves[other, 1]
            twin[halves[side, 1]] = halves[other, 0]
    return child, twin, parent
