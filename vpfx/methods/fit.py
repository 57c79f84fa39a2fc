"""Heights of nodes fitted to the posts instead of taken from them (specs/methods.md M-147).

Least squares of the posts' errors over all faces at once; then, to come near the least greatest error, of higher and higher
powers of them: each step weighs a post by what it is off by after the one before. A face gives a matrix of its three
nodes, the sum of all is solved by conjugate gradients, one face after the other, so that every machine finds the same bytes.
Arrays are those of `vpfx.methods.forest.Forest`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from vpfx.methods.scan import surface_height
from vpfx.methods.trial import gather_posts, make_room

__all__ = ["FitRule", "fit_heights"]

LEAST_WEIGHT = 0.2  # of the bound: posts that are off by less weigh as if they were off by so much
STAY = 1e-3  # weight of a node's own height, of a post of least weight
MOST_STEPS = 30  # of conjugate gradients
NEAR_ENOUGH = 1e-6  # share of the squared remainder at the start


class FitRule(NamedTuple):
    """What heights are fitted for.

    Attributes
    ----------
    stages : tuple of float
        Bounds, of that of the level, that are reached one after the other; heights are fitted between two of them.
    powers : tuple of int
        Of a post's error by the bound: its weight in the least squares of each step of a fit.
    """

    stages: tuple[float, ...]
    powers: tuple[int, ...]


@njit(nogil=True, cache=True, error_model="numpy")
def _sum_posts(faces, nodes, face_nodes, heights, power, bound, matrix, pull):
    """Fill what the posts of each face ask of its nodes: matrix (n, 6) as 00 11 22 01 12 20, pull (n, 3)."""
    posts, corner, steps = make_room(heights.size)
    for k in range(len(faces)):
        a, b, c = face_nodes[faces[k], 0], face_nodes[faces[k], 1], face_nodes[faces[k], 2]
        n_post = gather_posts(np.int64(faces[k]), nodes, face_nodes, heights, posts, corner, steps)
        to_b, up_b = nodes[b, 0] - nodes[a, 0], nodes[b, 1] - nodes[a, 1]
        to_c, up_c = nodes[c, 0] - nodes[a, 0], nodes[c, 1] - nodes[a, 1]
        area = to_b * up_c - to_c * up_b
        matrix[k], pull[k] = 0.0, 0.0
        for i in range(n_post):
            u, v = posts[0, i] - nodes[a, 0], posts[1, i] - nodes[a, 1]
            share_b, share_c = (u * up_c - to_c * v) / area, (to_b * v - u * up_b) / area
            share_a = 1.0 - share_b - share_c
            error = share_a * nodes[a, 2] + share_b * nodes[b, 2] + share_c * nodes[c, 2] - posts[2, i]
            if np.isnan(error):
                continue
            off = abs(error) / bound
            weight = (off if off > LEAST_WEIGHT else LEAST_WEIGHT) ** power
            matrix[k, 0] += weight * share_a * share_a
            matrix[k, 1] += weight * share_b * share_b
            matrix[k, 2] += weight * share_c * share_c
            matrix[k, 3] += weight * share_a * share_b
            matrix[k, 4] += weight * share_b * share_c
            matrix[k, 5] += weight * share_c * share_a
            pull[k, 0] -= weight * share_a * error
            pull[k, 1] -= weight * share_b * error
            pull[k, 2] -= weight * share_c * error


@njit(nogil=True, cache=True)
def _multiply(faces, face_nodes, matrix, vector, product):
    """Add the sum of the faces' matrices times a vector (n_node,) to the product."""
    for k in range(len(faces)):
        a, b, c = face_nodes[faces[k], 0], face_nodes[faces[k], 1], face_nodes[faces[k], 2]
        at_a, at_b, at_c = vector[a], vector[b], vector[c]
        product[a] += matrix[k, 0] * at_a + matrix[k, 3] * at_b + matrix[k, 5] * at_c
        product[b] += matrix[k, 3] * at_a + matrix[k, 1] * at_b + matrix[k, 4] * at_c
        product[c] += matrix[k, 5] * at_a + matrix[k, 4] * at_b + matrix[k, 2] * at_c


@njit(nogil=True, cache=True)
def _solve(faces, face_nodes, matrix, pull, stay, is_free):
    """Solve for the change of all heights, (n_node,) metres, 0 for nodes that are not free."""
    n_node = len(is_free)
    diagonal, rest = np.full(n_node, stay), np.zeros(n_node)
    for k in range(len(faces)):
        for i in range(3):
            diagonal[face_nodes[faces[k], i]] += matrix[k, i]
            rest[face_nodes[faces[k], i]] += pull[k, i]
    change, way, product = np.zeros(n_node), np.zeros(n_node), np.empty(n_node)
    size = 0.0
    for node in range(n_node):
        rest[node] = rest[node] if is_free[node] else 0.0
        way[node] = rest[node] / diagonal[node]
        size += rest[node] * way[node]
    enough = NEAR_ENOUGH * size
    for _ in range(MOST_STEPS):
        if size <= enough:
            break
        product[:] = stay * way
        _multiply(faces, face_nodes, matrix, way, product)
        along = 0.0
        for node in range(n_node):
            along += way[node] * product[node]
        before, size = size, 0.0
        for node in range(n_node):
            if is_free[node]:
                change[node] += before / along * way[node]
                rest[node] -= before / along * product[node]
                size += rest[node] * rest[node] / diagonal[node]
        for node in range(n_node):
            way[node] = rest[node] / diagonal[node] + size / before * way[node]
    return change


@njit(nogil=True, cache=True)
def fit_heights(faces, nodes, face_nodes, heights, is_free, powers, bound, limit):
    """Fit the heights of nodes so that the posts' errors get small.

    Parameters
    ----------
    faces : int32 (n,)
        The leaves.
    nodes
        Heights of free nodes are changed in place.
    heights : float64 (n_row, n_col)
        Of the posts, metres, NaN for voids.
    is_free : bool (n_node,)
    powers : int64 (n,)
        As in `FitRule`.
    bound : float
        Error that the mesh is to come down to, metres.
    limit : float
        No node is moved farther from the posts' surface at its place, metres, so that cutting can always mend what is off.

    Notes
    -----
    Source: iteratively reweighted least squares (Lawson 1961, in the form of Karlovitz 1970); specs/methods.md M-147. Cost:
    O(posts + steps × faces) for each power.
    """
    matrix, pull = np.empty((len(faces), 6)), np.empty((len(faces), 3))
    for power in powers:
        _sum_posts(faces, nodes, face_nodes, heights, power, bound, matrix, pull)
        change = _solve(faces, face_nodes, matrix, pull, STAY * LEAST_WEIGHT**power, is_free)
        for node in range(len(is_free)):
            if is_free[node]:
                surface = surface_height(heights, nodes[node, 0], nodes[node, 1])
                height = nodes[node, 2] + change[node] / (power + 1)  # a step of Newton's for the power + 2
                height = surface - limit if height < surface - limit else height
                nodes[node, 2] = surface + limit if height > surface + limit else height
