"""Cutting one face on trial: which diagonal it takes, whether its children keep their shape, and whether they hold the bound.

The posts of a face are gathered once; every way to cut it is then judged by them. Arrays are those of
`vpfx.methods.forest.Forest`, `terms` is a `Terms` as a plain tuple. Arrays are handed on one by one: numba takes longer to open
tuples of them than a trial takes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from vpfx.methods.cut import choose_diagonal
from vpfx.methods.scan import columns_of, place_sides, rows_of
from vpfx.topology import NONE

__all__ = [
    "HOLDS",
    "TOO_THIN",
    "Terms",
    "choose_diagonals",
    "gather_posts",
    "greatest_thinness",
    "holding_diagonal",
    "make_room",
    "squares_and_area",
    "thinness",
    "try_cut",
]

HOLDS, TOO_THIN = -1, -2  # in place of a post


class Terms(NamedTuple):
    """What a cut has to keep.

    Attributes
    ----------
    aspect : float
        Width of a post spacing divided by its height.
    bound : float
        No post may be off by more, metres; infinite if nothing has to be kept, shapes included.
    most_thin : float
        No child may have a greater `thinness` ...
    decay : float
        ... unless that of the face times this is greater still.
    diagonal, seed : int
        As for `vpfx.methods.cut.choose_diagonal`.
    """

    aspect: float
    bound: float
    most_thin: float
    decay: float
    diagonal: int
    seed: int


@njit(nogil=True, cache=True)
def make_room(n_post):
    """Room to gather up to so many posts."""
    return np.empty((3, n_post)), np.empty((3, 3)), np.empty((3, 7))


@njit(nogil=True, cache=True)
def gather_posts(face, nodes, face_nodes, heights, posts, corner, steps):
    """Put column, row and height (NaN for voids) of all posts of a face into posts, (3, n), and return how many they are."""
    n_row, n_col = heights.shape
    for i in range(3):
        for j in range(3):
            corner[i, j] = nodes[face_nodes[face, i], j]
    place_sides(corner, steps)
    south, top = rows_of(corner, n_row)
    n = 0
    for row in range(south, top + 1):
        first, last = columns_of(corner, steps, row, n_col)
        u, v = float(first), float(row)
        for col in range(first, last + 1):
            posts[0, n], posts[1, n], posts[2, n] = u, v, heights[row, col]
            u += 1.0
            n += 1
    return n


@njit(nogil=True, cache=True, inline="always")
def squares_and_area(to_b, up_b, to_c, up_c):
    """Sum of the squared sides of a face, and its area, by two corners as seen from the third."""
    squares = to_b * to_b + up_b * up_b + to_c * to_c + up_c * up_c + (to_b - to_c) ** 2 + (up_b - up_c) ** 2
    return squares, 0.5 * (to_b * up_c - to_c * up_b)


@njit(nogil=True, cache=True, inline="always")
def thinness(nodes, a, b, c, aspect):
    """Squared sides of a face divided by its area: 6.9 if they are equal, 8 for half a square, 16 for a needle of 14.6°."""
    to_b, up_b = (nodes[b, 0] - nodes[a, 0]) * aspect, nodes[b, 1] - nodes[a, 1]
    to_c, up_c = (nodes[c, 0] - nodes[a, 0]) * aspect, nodes[c, 1] - nodes[a, 1]
    squares, area = squares_and_area(to_b, up_b, to_c, up_c)
    return squares / area if area > 0.0 else np.inf


@njit(nogil=True, cache=True)
def greatest_thinness(face, nodes, face_nodes, terms):
    """Greatest thinness that a child of a face may have."""
    a, b, c = face_nodes[face, 0], face_nodes[face, 1], face_nodes[face, 2]
    return max(terms[2], terms[3] * thinness(nodes, a, b, c, terms[0]))


@njit(nogil=True, cache=True, inline="always")
def _plane_of(nodes, a, b, c):
    """Plane of a face: rise for each column, for each row, and height at the origin."""
    to_b, up_b, rise_b = nodes[b, 0] - nodes[a, 0], nodes[b, 1] - nodes[a, 1], nodes[b, 2] - nodes[a, 2]
    to_c, up_c, rise_c = nodes[c, 0] - nodes[a, 0], nodes[c, 1] - nodes[a, 1], nodes[c, 2] - nodes[a, 2]
    area = to_b * up_c - to_c * up_b
    east, north = (rise_b * up_c - rise_c * up_b) / area, (rise_c * to_b - rise_b * to_c) / area
    return east, north, nodes[a, 2] - east * nodes[a, 0] - north * nodes[a, 1]


@njit(nogil=True, cache=True, inline="always")
def _line_of(nodes, a, b):
    """Line from a to b: what is positive to the left of it, for each column, for each row, and at the origin."""
    east, north = nodes[b, 0] - nodes[a, 0], nodes[b, 1] - nodes[a, 1]
    return -north, east, north * nodes[a, 0] - east * nodes[a, 1]


@njit(nogil=True, cache=True, inline="always")
def _at(plane, u, v):
    """Value of a plane or a line at a place."""
    return plane[0] * u + plane[1] * v + plane[2]


@njit(nogil=True, cache=True)
def _try_none(a, b, c, hint, posts, n_post, nodes, bound):
    """Look for a post by which a face is off."""
    plane = _plane_of(nodes, a, b, c)
    for k in range(-1 if n_post else 0, n_post):
        at = hint if k < 0 else k
        if abs(_at(plane, posts[0, at], posts[1, at]) - posts[2, at]) > bound:
            return at
    return HOLDS


@njit(nogil=True, cache=True)
def _try_one(a, b, c, m, hint, posts, n_post, nodes, aspect, bound, most):
    """Cut by rule 1: m breaks the side from a to b."""
    if thinness(nodes, a, m, c, aspect) > most or thinness(nodes, m, b, c, aspect) > most:
        return TOO_THIN
    line, plane_a, plane_b = _line_of(nodes, m, c), _plane_of(nodes, a, m, c), _plane_of(nodes, m, b, c)
    for k in range(-1 if n_post else 0, n_post):
        at = hint if k < 0 else k
        u, v = posts[0, at], posts[1, at]
        height = _at(plane_a, u, v) if _at(line, u, v) > 0.0 else _at(plane_b, u, v)
        if abs(height - posts[2, at]) > bound:
            return at
    return HOLDS


@njit(nogil=True, cache=True)
def _try_two(a, b, c, m, o, flip, hint, posts, n_post, nodes, aspect, bound, most):
    """Cut by rule 2: m breaks the side from a to b, o that from b to c; the diagonal is a to o, or (flip) m to c."""
    start, end, right, left = (m, c, o, a) if flip else (a, o, m, c)
    if thinness(nodes, m, b, o, aspect) > most:
        return TOO_THIN
    if thinness(nodes, start, right, end, aspect) > most or thinness(nodes, start, end, left, aspect) > most:
        return TOO_THIN
    line, diagonal = _line_of(nodes, m, o), _line_of(nodes, start, end)
    plane_b, plane_right = _plane_of(nodes, m, b, o), _plane_of(nodes, start, right, end)
    plane_left = _plane_of(nodes, start, end, left)
    for k in range(-1 if n_post else 0, n_post):
        at = hint if k < 0 else k
        u, v = posts[0, at], posts[1, at]
        if _at(line, u, v) < 0.0:
            height = _at(plane_b, u, v)
        else:
            height = _at(plane_left, u, v) if _at(diagonal, u, v) > 0.0 else _at(plane_right, u, v)
        if abs(height - posts[2, at]) > bound:
            return at
    return HOLDS


@njit(nogil=True, cache=True)
def _try_three(a, b, c, m, o, p, hint, posts, n_post, nodes, aspect, bound, most):
    """Cut by rule 3: m breaks the side from a to b, o that from b to c, p that from c to a."""
    if thinness(nodes, a, m, p, aspect) > most or thinness(nodes, m, b, o, aspect) > most:
        return TOO_THIN
    if thinness(nodes, o, c, p, aspect) > most or thinness(nodes, m, o, p, aspect) > most:
        return TOO_THIN
    line_a, line_b, line_c = _line_of(nodes, p, m), _line_of(nodes, m, o), _line_of(nodes, o, p)
    plane_a, plane_b, plane_c = _plane_of(nodes, a, m, p), _plane_of(nodes, m, b, o), _plane_of(nodes, o, c, p)
    middle = _plane_of(nodes, m, o, p)
    for k in range(-1 if n_post else 0, n_post):
        at = hint if k < 0 else k
        u, v = posts[0, at], posts[1, at]
        if _at(line_a, u, v) < 0.0:
            height = _at(plane_a, u, v)
        elif _at(line_b, u, v) < 0.0:
            height = _at(plane_b, u, v)
        else:
            height = _at(plane_c, u, v) if _at(line_c, u, v) < 0.0 else _at(middle, u, v)
        if abs(height - posts[2, at]) > bound:
            return at
    return HOLDS


@njit(nogil=True, cache=True)
def try_cut(face, flip, hint, posts, n_post, nodes, face_nodes, side_node, terms):
    """Cut a face on trial by the breaks it has.

    Parameters
    ----------
    flip : bool
        Diagonal of rule 2 that is tried first, see `vpfx.methods.cut.cut_faces`.
    hint : int
        The post, of those gathered, to look at first.
    posts, n_post
        What `gather_posts` found in the face.

    Returns
    -------
    int, bool
        HOLDS, or why not: which of the posts is off by more than the bound, or TOO_THIN; and the diagonal that rule 2 takes:
        `flip`, unless it does not hold and the other does.

    Notes
    -----
    Give face and hint as int64, and no constants: numba compiles this, and what it calls, once more for every other type.
    """
    aspect, bound = terms[0], terms[1]
    first, n_broken = 0, 0
    for i in range(3):
        is_broken, is_next = side_node[3 * face + i] != NONE, side_node[3 * face + (i + 1) % 3] != NONE
        n_broken += is_broken
        if is_broken and (is_next or side_node[3 * face + (i + 2) % 3] == NONE):
            first = i  # the only break, or the first of two; with three, any
    a, b, c = face_nodes[face, first], face_nodes[face, (first + 1) % 3], face_nodes[face, (first + 2) % 3]
    m, o = side_node[3 * face + first], side_node[3 * face + (first + 1) % 3]
    if n_broken == 0:
        return _try_none(a, b, c, hint, posts, n_post, nodes, bound), flip
    most = greatest_thinness(face, nodes, face_nodes, terms)
    if n_broken == 1:
        return _try_one(a, b, c, m, hint, posts, n_post, nodes, aspect, bound, most), flip
    if n_broken == 3:
        p = side_node[3 * face + (first + 2) % 3]
        return _try_three(a, b, c, m, o, p, hint, posts, n_post, nodes, aspect, bound, most), flip
    found = _try_two(a, b, c, m, o, flip, hint, posts, n_post, nodes, aspect, bound, most)
    if found != HOLDS:
        hint = np.int64(max(found, 0))
        if _try_two(a, b, c, m, o, not flip, hint, posts, n_post, nodes, aspect, bound, most) == HOLDS:
            return HOLDS, not flip
    return found, flip


@njit(nogil=True, cache=True)
def holding_diagonal(face, nodes, face_nodes, side_node, heights, terms, room):
    """Choose the diagonal of rule 2 in a face: as asked, or the other where only that holds the bound.

    Parameters
    ----------
    room : tuple
        What `make_room` returns.

    Returns
    -------
    bool
        True for the diagonal from the break of the first broken side; False for a face that has not two broken sides.
    """
    if (side_node[3 * face] != NONE) + (side_node[3 * face + 1] != NONE) + (side_node[3 * face + 2] != NONE) != 2:
        return False
    aspect, bound, _, _, diagonal, seed = terms
    flip = choose_diagonal(face, nodes, face_nodes, side_node, heights, aspect, diagonal, seed)
    if np.isinf(bound):
        return flip
    posts, corner, steps = room
    n_post = gather_posts(face, nodes, face_nodes, heights, posts, corner, steps)
    return try_cut(face, flip, np.int64(0), posts, n_post, nodes, face_nodes, side_node, terms)[1]


@njit(nogil=True, cache=True)
def choose_diagonals(faces, nodes, face_nodes, side_node, heights, terms):
    """Choose the diagonals of some faces, bool (n,), as `holding_diagonal` does."""
    room = make_room(heights.size)
    is_flipped = np.empty(len(faces), np.bool_)
    for k in range(len(faces)):
        is_flipped[k] = holding_diagonal(np.int64(faces[k]), nodes, face_nodes, side_node, heights, terms, room)
    return is_flipped
