r"""Undoing breaks that turned out needless, the last ones first (specs/methods.md M-145).

A break on an edge is undone if both faces at it have only leaves as children, and no post is off by more than the
bound when the two are cut again without it; a node inside a face likewise. So rules 1 to 4 stay the only ways to cut.
Arrays are those of `vpfx.methods.forest.Forest`, `tree` its tuple. Breaking side 0 of F by m made two faces of each;
without m::

          / \               / \         outer: the twins, outside, of the sides at the rim; they stay
         / | \   F         /   \   F
        ----m----    →    -------       halves: the sides of the new children on the rim
         \ | /   G         \   /   G
          \ /               \ /         both faces get new sides where m was: those become twins
"""

from __future__ import annotations

import numpy as np
from numba import njit

from vpfx.methods.breaks import KEPT, OPEN
from vpfx.methods.cut import cut_one, is_whole
from vpfx.methods.trial import HOLDS, gather_posts, holding_diagonal, make_room, try_cut
from vpfx.topology import NONE

__all__ = ["undo_breaks"]


@njit(nogil=True, cache=True)
def _has_only_leaves(face, tree):
    """Tell whether a face is cut, but none of its children."""
    first_child, n_child = tree[4], tree[5]
    for child in range(first_child[face], first_child[face] + n_child[face]):
        if n_child[child] != 0:
            return False
    return n_child[face] != 0


@njit(nogil=True, cache=True)
def _find_outer(face, tree, outer):
    """Fill outer (3, 2) with the twins of the child sides on the two halves of each side; a whole side has only the first."""
    _, face_nodes, side_twin, side_node, first_child, n_child = tree
    for i in range(3):
        start, end, middle = face_nodes[face, i], face_nodes[face, (i + 1) % 3], side_node[3 * face + i]
        outer[i, 0] = outer[i, 1] = NONE
        for child in range(first_child[face], first_child[face] + n_child[face]):
            for j in range(3):
                a, b = face_nodes[child, j], face_nodes[child, (j + 1) % 3]
                if a == start and b == (end if middle == NONE else middle):
                    outer[i, 0] = side_twin[3 * child + j]
                elif a == middle and b == end:
                    outer[i, 1] = side_twin[3 * child + j]


@njit(nogil=True, cache=True)
def _would_hold(face, tree, face_error, heights, terms, room):
    """Tell whether a face cut anew by the breaks it has keeps the bound, and its children their shape."""
    nodes, face_nodes, _, side_node, _, _ = tree
    if is_whole(face, side_node) and not np.isinf(face_error[face]):
        return face_error[face] <= terms[1]
    posts, corner, steps = room
    n_post = gather_posts(face, nodes, face_nodes, heights, posts, corner, steps)
    return try_cut(face, np.bool_(False), np.int64(0), posts, n_post, nodes, face_nodes, side_node, terms)[0] == HOLDS


@njit(nogil=True, cache=True)
def _cut_anew(face, tree, side_state, face_error, heights, terms, halves, room):
    """Cut a face by the breaks it has, in the place of its children, or make it a leaf; halves (3, 2) as in `cut_one`."""
    nodes, face_nodes, side_twin, side_node, first_child, n_child = tree
    if is_whole(face, side_node):
        n_child[face] = 0
        face_error[face] = np.inf
        for i in range(3):
            side_twin[3 * face + i] = NONE
            halves[i, 0] = halves[i, 1] = 3 * face + i
        return
    flip = holding_diagonal(face, nodes, face_nodes, side_node, heights, terms, room)
    first = np.int64(first_child[face])
    side_twin[3 * first : 3 * (first + n_child[face])] = NONE
    side_state[3 * first : 3 * (first + n_child[face])] = OPEN
    n_child[face] = cut_one(face, side_node, np.int64(NONE), flip, first, face_nodes, side_twin, halves)
    face_error[first : first + n_child[face]] = np.inf


@njit(nogil=True, cache=True)
def _join(halves, outer, side_twin):
    """Make the child sides of a face and those outside it twins again; NONE in `outer` leaves a side alone."""
    for i in range(3):
        for h in range(2):
            if outer[i, h] != NONE:
                side_twin[halves[i, h]] = outer[i, h]
                side_twin[outer[i, h]] = halves[i, h]


@njit(nogil=True, cache=True)
def undo_breaks(faces, tree, side_state, face_error, heights, terms):
    """Undo the breaks that the bound does not need.

    Parameters
    ----------
    faces : int32 (n,)
        Faces that were cut, in the order in which to try.
    side_state
        Sides of fixed borders are KEPT; those of faces that are new become OPEN.
    face_error
        Becomes infinite for faces that are new, or leaves again.
    terms : tuple
        A `vpfx.methods.trial.Terms`. The bound holds on all leaves, before and after.

    Returns
    -------
    int
        Breaks undone.

    Notes
    -----
    Cost: O(n + posts of the faces). Nodes that are left over stay in the forest.
    """
    _, _, side_twin, side_node, _, _ = tree
    outer, other_outer = np.empty((3, 2), np.int32), np.empty((3, 2), np.int32)
    halves, other_halves = np.empty((3, 2), np.int32), np.empty((3, 2), np.int32)
    room = make_room(heights.size)
    count = 0
    for k in range(len(faces)):
        face = np.int64(faces[k])
        if _has_only_leaves(face, tree) and is_whole(face, side_node):
            if _would_hold(face, tree, face_error, heights, terms, room):  # rule 4
                _find_outer(face, tree, outer)
                _cut_anew(face, tree, side_state, face_error, heights, terms, halves, room)
                _join(halves, outer, side_twin)
                count += 1
            continue
        for side in range(3 * face, 3 * face + 3):
            node, twin = side_node[side], side_twin[side]
            other = np.int64(NONE if twin == NONE else twin // 3)
            if node == NONE or 0 <= twin < side or side_state[side] == KEPT or not _has_only_leaves(face, tree):
                continue
            if other != NONE and not _has_only_leaves(other, tree):
                continue
            side_node[side] = NONE
            if other != NONE:
                side_node[twin] = NONE
            is_needless = True
            for own in (face, other) if is_whole(face, side_node) else (other, face):  # what is known costs nothing
                if own != NONE and is_needless:
                    is_needless = _would_hold(own, tree, face_error, heights, terms, room)
            side_node[side] = node
            if other != NONE:
                side_node[twin] = node
            if not is_needless:
                continue
            _find_outer(face, tree, outer)
            outer[side % 3] = NONE
            side_node[side] = NONE
            _cut_anew(face, tree, side_state, face_error, heights, terms, halves, room)
            _join(halves, outer, side_twin)
            if other != NONE:
                _find_outer(other, tree, other_outer)
                other_outer[twin % 3] = NONE
                side_node[twin] = NONE
                _cut_anew(other, tree, side_state, face_error, heights, terms, other_halves, room)
                _join(other_halves, other_outer, side_twin)
                side_twin[halves[side % 3, 0]] = other_halves[twin % 3, 0]
                side_twin[other_halves[twin % 3, 0]] = halves[side % 3, 0]
            count += 1
    return count
