r"""Cutting faces by the paper's rules 1 to 4 and by Scarlatos' fifth cut: the one kernel that cuts, and rules for diagonals.

Side ``s = 3 * face + i`` runs from node i of a face to the next:

           n2                  rule 1: one side broken             rule 2: two, the corner goes and a diagonal cuts the rest
          /  \                  rule 3: all three                   rule 4: none, but a node inside
     s=2 /    \ s=1
        /      \                m[i] = node that breaks side i      p = node inside
      n0 ------ n1        Scarlatos' fifth: one side broken and a node inside, which is joined to the corners and the break
          s=0
"""

from __future__ import annotations

import numpy as np
from numba import njit

from vpfx.methods.scan import surface_height
from vpfx.topology import NONE

__all__ = ["MOST_CHILDREN", "choose_diagonal", "count_cuts", "cut_faces", "cut_one", "is_whole"]

MOST_CHILDREN = 4


@njit(nogil=True, cache=True)
def is_whole(face, side_node):
    """Tell whether no side of a face is broken."""
    return side_node[3 * face] == NONE and side_node[3 * face + 1] == NONE and side_node[3 * face + 2] == NONE


@njit(nogil=True, cache=True)
def cut_one(face, side_node, p, flip, n, child, inner, halves):
    """Write the children of one face at child[n:], return how many.

    child (n_child, 3), the nodes of all faces, gets theirs; inner (3 * n_child,) the twins of sides between siblings; halves
    (3, 2) the child sides that lie on the first and the second half of each side (the same twice if unbroken).
    """
    nodes = (child[face, 0], child[face, 1], child[face, 2])
    m = (side_node[3 * face], side_node[3 * face + 1], side_node[3 * face + 2])
    count = 0
    for i in range(3):
        count += m[i] != NONE
    if count == 0:  # rule 4: child i stands on side i, its apex is p
        for i in range(3):
            child[n + i, 0], child[n + i, 1], child[n + i, 2] = nodes[i], nodes[(i + 1) % 3], p
            halves[i, 0] = halves[i, 1] = 3 * (n + i)
            inner[3 * (n + i) + 1] = 3 * (n + (i + 1) % 3) + 2
            inner[3 * (n + i) + 2] = 3 * (n + (i + 2) % 3) + 1
        return 3
    if count == 3:  # rule 3: child i is the corner at node i, child 3 the middle
        for i in range(3):
            before = (i + 2) % 3
            child[n + i, 0], child[n + i, 1], child[n + i, 2] = nodes[i], m[i], m[before]
            halves[i, 0] = 3 * (n + i)
            halves[before, 1] = 3 * (n + i) + 2
            child[n + 3, i] = m[i]
            inner[3 * (n + i) + 1] = 3 * (n + 3) + before
            inner[3 * (n + 3) + before] = 3 * (n + i) + 1
        return 4
    i = 0
    if (
        count == 1 and p != NONE
    ):  # the fifth: child i and i + 1 stand on the halves of the broken side, the others follow
        while m[i] == NONE:
            i += 1
        j, k = (i + 1) % 3, (i + 2) % 3
        rim = (nodes[i], m[i], nodes[j], nodes[k])
        for c in range(4):
            child[n + c, 0], child[n + c, 1], child[n + c, 2] = rim[c], rim[(c + 1) % 4], p
            inner[3 * (n + c) + 1] = 3 * (n + (c + 1) % 4) + 2
            inner[3 * (n + c) + 2] = 3 * (n + (c + 3) % 4) + 1
        halves[i, 0], halves[i, 1] = 3 * n, 3 * (n + 1)
        halves[j, 0] = halves[j, 1] = 3 * (n + 2)
        halves[k, 0] = halves[k, 1] = 3 * (n + 3)
        return 4
    if count == 1:  # rule 1: a = (n_i, m, n_k), b = (m, n_j, n_k)
        while m[i] == NONE:
            i += 1
        j, k = (i + 1) % 3, (i + 2) % 3
        child[n, 0], child[n, 1], child[n, 2] = nodes[i], m[i], nodes[k]
        child[n + 1, 0], child[n + 1, 1], child[n + 1, 2] = m[i], nodes[j], nodes[k]
        halves[i, 0], halves[i, 1] = 3 * n, 3 * (n + 1)
        halves[j, 0] = halves[j, 1] = 3 * (n + 1) + 1
        halves[k, 0] = halves[k, 1] = 3 * n + 2
        inner[3 * n + 1] = 3 * (n + 1) + 2
        inner[3 * (n + 1) + 2] = 3 * n + 1
        return 2
    while m[i] == NONE or m[(i + 1) % 3] == NONE:
        i += 1
    j, k = (i + 1) % 3, (i + 2) % 3
    # rule 2: corner c = (m_i, n_j, m_j); the quadrilateral n_i, m_i, m_j, n_k is cut from n_i to m_j, or (flip) from m_i to n_k
    child[n, 0], child[n, 1], child[n, 2] = m[i], nodes[j], m[j]
    halves[i, 1] = 3 * n
    halves[j, 0] = 3 * n + 1
    a, b = 3 * (n + 1), 3 * (n + 2)
    if flip:  # a = (m_i, m_j, n_k), b = (n_i, m_i, n_k)
        child[n + 1, 0], child[n + 1, 1], child[n + 1, 2] = m[i], m[j], nodes[k]
        child[n + 2, 0], child[n + 2, 1], child[n + 2, 2] = nodes[i], m[i], nodes[k]
        inner[3 * n + 2], inner[a] = a, 3 * n + 2
        inner[a + 2], inner[b + 1] = b + 1, a + 2
        halves[i, 0] = b
        halves[j, 1] = a + 1
        halves[k, 0] = halves[k, 1] = b + 2
    else:  # a = (n_i, m_i, m_j), b = (n_i, m_j, n_k)
        child[n + 1, 0], child[n + 1, 1], child[n + 1, 2] = nodes[i], m[i], m[j]
        child[n + 2, 0], child[n + 2, 1], child[n + 2, 2] = nodes[i], m[j], nodes[k]
        inner[3 * n + 2], inner[a + 1] = a + 1, 3 * n + 2
        inner[a + 2], inner[b] = b, a + 2
        halves[i, 0] = a
        halves[j, 1] = b + 1
        halves[k, 0] = halves[k, 1] = b + 2
    return 3


@njit(nogil=True, cache=True)
def cut_faces(faces, inner_node, is_flipped, face_nodes, side_twin, side_node, first_child, n_child, slot, n_face):
    """Cut faces that have a break or a node inside.

    Parameters
    ----------
    faces : int32 (n_cut,)
        Leaves; both faces at each broken side are among them.
    inner_node : int32 (n_cut,)
        Node inside the face, -1 for none; looked at where no side is broken (rule 4), or one (the fifth cut).
    is_flipped : bool (n_cut,)
        Which diagonal rule 2 takes: False from the start of the first broken side, True from its break.
    face_nodes, side_twin, side_node, first_child, n_child, slot
        Of `vpfx.methods.forest.Forest`, changed in place; children are put from `n_face` on and must have room there.

    Returns
    -------
    int
        Number of faces with the children.

    Notes
    -----
    Source: paper-facts §2, rules 1–4; specs/methods.md M-110. Cost: O(n_cut).
    """
    halves = np.empty((len(faces), 3, 2), np.int32)
    n = n_face
    for k in range(len(faces)):
        face = np.int64(faces[k])
        for side in range(3 * n, 3 * (n + MOST_CHILDREN)):
            side_twin[side] = side_node[side] = NONE
        added = cut_one(face, side_node, np.int64(inner_node[k]), is_flipped[k], n, face_nodes, side_twin, halves[k])
        first_child[face], n_child[face], slot[face] = n, added, k
        for child in range(n, n + added):
            first_child[child], n_child[child], slot[child] = NONE, 0, NONE
        n += added
    for k in range(len(faces)):
        for i in range(3):
            other = side_twin[3 * faces[k] + i]
            if other == NONE:
                continue
            if n_child[other // 3] == 0:
                side_twin[halves[k, i, 0]] = other
                side_twin[other] = halves[k, i, 0]
            else:
                across = halves[slot[other // 3], other % 3]
                side_twin[halves[k, i, 0]] = across[1]
                side_twin[halves[k, i, 1]] = across[0]
    for face in faces:
        slot[face] = NONE
    return n


@njit(nogil=True, cache=True)
def count_cuts(side_node, first_child, n_child, n_face):
    """Count the cuts of a forest by kind, int64 (5,) as `vpfx.model.CUTS`; what was undone counts no more."""
    count = np.zeros(5, np.int64)
    for face in range(n_face):
        n_broken = 0
        for side in range(3 * face, 3 * face + 3):
            n_broken += side_node[side] != NONE
        if n_child[face] == 0:
            continue
        if n_broken == 0:
            count[3] += 1
        elif n_broken == 1 and n_child[face] == 4:
            count[4] += 1
        else:
            count[n_broken - 1] += 1
    return count


@njit(nogil=True, cache=True)
def _mixed(seed, value):
    """Random 64 bits from a seed and a number (splitmix64): the same on every machine."""
    x = np.uint64(seed) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(value)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


@njit(nogil=True, cache=True)
def _chord_error(heights, start, end):
    """Greatest height between the posts' surface and the straight line between two nodes, taken once a post, metres."""
    n_step = int(max(abs(end[0] - start[0]), abs(end[1] - start[1]))) + 1
    worst = 0.0
    for step in range(1, n_step):
        t = step / n_step
        height = surface_height(heights, start[0] + t * (end[0] - start[0]), start[1] + t * (end[1] - start[1]))
        worst = max(worst, abs(height - (start[2] + t * (end[2] - start[2]))))
    return worst


@njit(nogil=True, cache=True)
def choose_diagonal(face, nodes, face_nodes, side_node, heights, aspect, rule, seed):
    """Choose the diagonal of rule 2: True for the one from the break of the first broken side, see `cut_faces`.

    Parameters
    ----------
    rule : int
        0: the shorter; 1: at random from `seed`; 2: the one nearer to the posts' surface.

    Returns
    -------
    bool
        False for a face that has not two broken sides.
    """
    m = side_node[3 * face : 3 * face + 3]
    if (m[0] != NONE) + (m[1] != NONE) + (m[2] != NONE) != 2:
        return False
    i = 0
    while m[i] == NONE or m[(i + 1) % 3] == NONE:
        i += 1
    a, b = nodes[face_nodes[face, i]], nodes[m[(i + 1) % 3]]
    c, d = nodes[m[i]], nodes[face_nodes[face, (i + 2) % 3]]
    if rule == 1:
        return _mixed(seed, face) & np.uint64(1) == np.uint64(1)
    if rule == 2:
        return _chord_error(heights, c, d) < _chord_error(heights, a, b)
    plain = ((a[0] - b[0]) * aspect) ** 2 + (a[1] - b[1]) ** 2
    other = ((d[0] - c[0]) * aspect) ** 2 + (d[1] - c[1]) ** 2
    return other < plain
