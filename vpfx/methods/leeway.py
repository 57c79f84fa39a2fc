"""Between which heights a node on a side must lie for the two faces beside it to hold the bound (specs/methods.md M-142).

A node m on the side from a to b cuts the face a, b, c in two. Seen from c, a post lies behind a place of the side, and
holds if the side is neither too high nor too low there. As the side runs straight from a to m, that says how steep it may
be: one look at the posts gives the answer for all places of m at once, and for the faces on its left and its right by
themselves.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from vpfx.methods.trial import squares_and_area

__all__ = ["find_leeways", "share_of"]

OUTSIDE = -1e-9  # least weight of a corner of a face in a post that counts as inside it
TINY = 1e-12  # least weight to divide by


@njit(nogil=True, cache=True, inline="always")
def share_of(place, middle, n_place):
    """Share of a side at one of its places, which lie evenly spread between `middle` and 1 - `middle`."""
    return middle + (1.0 - 2.0 * middle) * place / (n_place - 1)


@njit(nogil=True, cache=True, inline="always")
def _is_thin(to_b, up_b, to_c, up_c, most):
    """Tell whether a face's squared sides are more than `most` times its area; b and c as seen from a, in square units."""
    squares, area = squares_and_area(to_b, up_b, to_c, up_c)
    return squares > most * area


@njit(nogil=True, cache=True, error_model="numpy")
def find_leeways(a, b, c, posts, n_post, nodes, aspect, bound, most, middle, n_place, work, bins, leeways):
    """Find least and greatest height of a node on the side from a to b of a face, for all its places.

    Parameters
    ----------
    a, b, c : int
        Nodes of the face, counter-clockwise.
    posts, n_post
        Posts of the face, or of a larger one, as `vpfx.methods.trial.gather_posts` finds them.
    most : float
        Faces of a greater `vpfx.methods.trial.thinness` get no leeway.
    work, bins : float64 (6, ≥ n_post), (n_place + 1, 4)
        Room.
    leeways : float64 (n_place, ≥ 4)
        Takes the least and greatest height, metres, with which the face a, m, c holds the bound, then those of m, b, c; the
        least is the greater one where no height will do. A post on the line from c to m counts for one of the two.

    Notes
    -----
    Cost: O(posts + places).
    """
    ax, ay, az = nodes[a, 0], nodes[a, 1], nodes[a, 2]
    to_b, up_b, bz = nodes[b, 0] - ax, nodes[b, 1] - ay, nodes[b, 2]
    to_c, up_c, cz = nodes[c, 0] - ax, nodes[c, 1] - ay, nodes[c, 2]
    per_area, n_step = 1.0 / (to_b * up_c - to_c * up_b), (n_place - 1) / (1.0 - 2.0 * middle)
    east_b, north_b, east_c, north_c = up_c * per_area, -to_c * per_area, -up_b * per_area, to_b * per_area
    for place in range(n_place + 1):
        bins[place, 0] = bins[place, 2] = -np.inf
        bins[place, 1] = bins[place, 3] = np.inf
    for k in range(n_post):
        u, v = posts[0, k] - ax, posts[1, k] - ay
        weight_b, weight_c = east_b * u + north_b * v, east_c * u + north_c * v
        weight_a = 1.0 - weight_b - weight_c
        rest, on_side = posts[2, k] - weight_c * cz, weight_a + weight_b
        least = weight_a if weight_a < weight_b else weight_b
        work[0, k] = weight_c if weight_c < least else least
        places_before = (weight_b / (on_side if on_side > TINY else TINY) - middle) * n_step + 1.0
        places_before = places_before if places_before > 0.0 else 0.0
        work[1, k] = places_before if places_before < n_place else n_place
        per_a, per_b = 1.0 / (weight_b if weight_b > TINY else TINY), 1.0 / (weight_a if weight_a > TINY else TINY)
        work[2, k], work[3, k] = (rest - on_side * az) * per_a, bound * per_a
        work[4, k], work[5, k] = (rest - on_side * bz) * per_b, bound * per_b
    for k in range(n_post):
        if work[0, k] < OUTSIDE:
            continue
        at = int(work[1, k])
        low, high = work[2, k] - work[3, k], work[2, k] + work[3, k]  # NaN for voids
        bins[at, 0] = low if low > bins[at, 0] else bins[at, 0]
        bins[at, 1] = high if high < bins[at, 1] else bins[at, 1]
        low, high = work[4, k] - work[5, k], work[4, k] + work[5, k]
        bins[at, 2] = low if low > bins[at, 2] else bins[at, 2]
        bins[at, 3] = high if high < bins[at, 3] else bins[at, 3]
    step = (1.0 - 2.0 * middle) / (n_place - 1)
    to_b, to_c = to_b * aspect, to_c * aspect
    low, high = -np.inf, np.inf
    for place in range(n_place):  # a post to the left of a place is to the left of all that follow
        low = bins[place, 0] if bins[place, 0] > low else low
        high = bins[place, 1] if bins[place, 1] < high else high
        share = middle + place * step
        leeways[place, 0], leeways[place, 1] = az + share * low, az + share * high
        if low <= high and _is_thin(share * to_b, share * up_b, to_c, up_c, most):
            leeways[place, 0] = np.inf
    low, high = -np.inf, np.inf
    for place in range(n_place - 1, -1, -1):
        low = bins[place + 1, 2] if bins[place + 1, 2] > low else low
        high = bins[place + 1, 3] if bins[place + 1, 3] < high else high
        share = 1.0 - middle - place * step
        leeways[place, 2], leeways[place, 3] = bz + share * low, bz + share * high
        if low <= high and _is_thin(
            share * to_b, share * up_b, to_c - (1.0 - share) * to_b, up_c - (1.0 - share) * up_b, most
        ):
            leeways[place, 2] = np.inf
