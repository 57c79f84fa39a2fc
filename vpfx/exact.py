"""Which way three places turn: exact, whatever doubles round.

Source: J. R. Shewchuk, Adaptive precision floating-point arithmetic and fast robust geometric predicates, 1997.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["face_turns", "orientation", "orientations"]

Floats = NDArray[np.float64]

SURE_TURN = 3.3306690738754716e-16
"""Of the two products whose difference is a turn: what the difference exceeds where its sign is sure (Shewchuk §4.3)."""


@njit(nogil=True, cache=True)
def _product(a, b):
    """Product of two doubles as a rounded number and the exact rest (Dekker)."""
    whole = a * b
    split_a, split_b = 134217729.0 * a, 134217729.0 * b
    high_a, high_b = split_a - (split_a - a), split_b - (split_b - b)
    low_a, low_b = a - high_a, b - high_b
    rest = low_a * low_b - (((whole - high_a * high_b) - low_a * high_b) - high_a * low_b)
    return whole, rest


@njit(nogil=True, cache=True)
def _sign_of_sum(terms):
    """Sign of a sum of doubles, without rounding; the terms are overwritten with numbers that do not overlap."""
    for i in range(len(terms)):
        carry = terms[i]
        for j in range(i):
            whole = carry + terms[j]
            part = whole - carry
            terms[j] = (carry - (whole - part)) + (terms[j] - part)
            carry = whole
        terms[i] = carry
    for i in range(len(terms) - 1, -1, -1):
        if terms[i] != 0.0:
            return 1 if terms[i] > 0.0 else -1
    return 0


@njit(nogil=True, cache=True)
def orientation(ax, ay, bx, by, cx, cy):
    """Which way a → b → c turns, exactly.

    Parameters
    ----------
    ax, ay, bx, by, cx, cy : float64
        Finite; products of two of them neither overflow nor fall below the normal doubles.

    Returns
    -------
    int
        1 counter-clockwise, -1 clockwise, 0 if the three lie on one line.

    Notes
    -----
    Where rounding could decide, the six products of the determinant are added up without rounding.

    Examples
    --------
    >>> orientation(0.0, 0.0, 3.0, 0.1, 3e8, 1e7), orientation(0.0, 0.0, 3.0, 0.1, 3e8, np.nextafter(1e7, 2e7))
    (-1, 1)
    """
    left, right = (ax - cx) * (by - cy), (ay - cy) * (bx - cx)
    turn = left - right
    if abs(turn) > SURE_TURN * (abs(left) + abs(right)):
        return 1 if turn > 0.0 else -1
    terms = np.empty(12)
    terms[0], terms[1] = _product(ax, by)
    terms[2], terms[3] = _product(-ay, bx)
    terms[4], terms[5] = _product(bx, cy)
    terms[6], terms[7] = _product(-by, cx)
    terms[8], terms[9] = _product(cx, ay)
    terms[10], terms[11] = _product(-cy, ax)
    return _sign_of_sum(terms)


def orientations(a: Floats, b: Floats, c: Floats) -> NDArray[np.int8]:
    """Tell on which side of a → b the places c lie, exactly.

    Parameters
    ----------
    a, b, c : float64 (n, 2)

    Returns
    -------
    int8 (n,)
        1 where c lies to the left (a, b, c turn counter-clockwise), -1 to the right, 0 on the line.

    Notes
    -----
    See `orientation`.

    Examples
    --------
    >>> a, b = np.array([[0.0, 0.0]] * 2), np.array([[1e17, 1e17]] * 2)
    >>> orientations(a, b, np.array([[1.0, 1.0], [1.0, 1.0000000000000002]])).tolist()
    [0, 1]
    """
    turn = np.empty(len(a), np.int8)
    _fill_orientations(*(np.asarray(places, np.float64) for places in (a, b, c)), turn)
    return turn


@njit(nogil=True, cache=True)
def _fill_orientations(a, b, c, turn):
    for i in range(len(turn)):
        turn[i] = orientation(a[i, 0], a[i, 1], b[i, 0], b[i, 1], c[i, 0], c[i, 1])


@njit(nogil=True, cache=True)
def face_turns(nodes, face_nodes):
    """Which way round the nodes of each face go, seen from above: exact.

    Parameters
    ----------
    nodes : float64 (n_node, 2 or 3)
        No other type: it would be reckoned in.
    face_nodes : integers (n_face, 3)

    Returns
    -------
    int8 (n_face,)
        1 counter-clockwise, -1 clockwise, 0 on one line.

    Notes
    -----
    See `orientation`.

    Examples
    --------
    The third place lies above the diagonal, on it and below it, by one unit in the last place:

    >>> nodes = np.array([[0.1, 0.1], [0.3, 0.3], [0.7, 0.7], [0.7, np.nextafter(0.7, 1)], [0.7, np.nextafter(0.7, 0)]])
    >>> face_turns(nodes, np.array([[0, 1, 3], [0, 1, 2], [0, 1, 4]])).tolist()
    [1, 0, -1]
    """
    turn = np.empty(len(face_nodes), np.int8)
    for face in range(len(face_nodes)):
        a, b, c = nodes[face_nodes[face, 0]], nodes[face_nodes[face, 1]], nodes[face_nodes[face, 2]]
        turn[face] = orientation(a[0], a[1], b[0], b[1], c[0], c[1])
    return turn
