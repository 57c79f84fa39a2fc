"""What is known of the places on the sides of a face, where a node may break it (specs/methods.md M-142).

Arrays are those of `vpfx.methods.forest.Forest`, `terms` is a `vpfx.methods.trial.Terms`, `rule` a
`vpfx.methods.settle.SettleRule`, `room` what `vpfx.methods.trial.make_room` and `vpfx.methods.leeway.find_leeways` ask for.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from vpfx.methods.breaks import OPEN, is_guarded, place_on_side
from vpfx.methods.cut import is_whole
from vpfx.methods.leeway import find_leeways, share_of
from vpfx.methods.trial import HOLDS, gather_posts, greatest_thinness, try_cut
from vpfx.topology import NONE

__all__ = [
    "GAIN",
    "HEIGHT",
    "LEFT_HIGH",
    "LEFT_LOW",
    "PAIR_STEP",
    "RIGHT_HIGH",
    "RIGHT_LOW",
    "fill_across",
    "fill_places",
    "fits",
    "put_on_side",
]

# Of a place: between which heights a node there lets the faces to its left and its right hold; posts' surface; significance
LEFT_LOW, LEFT_HIGH, RIGHT_LOW, RIGHT_HIGH, HEIGHT, GAIN = range(6)
PAIR_STEP = 2  # two breaks are tried at every second place


@njit(nogil=True, cache=True, inline="always")
def put_on_side(side, share, node, nodes, face_nodes, heights):
    """Put a node on a side, on the posts' surface, and return its significance, metres."""
    u, v, height, significance = place_on_side(side, share, nodes, face_nodes, heights)
    nodes[node, 0], nodes[node, 1], nodes[node, 2] = u, v, height
    return significance


@njit(nogil=True, cache=True)
def _may_break(side, tree, aspect, guard, side_state):
    """Tell whether a side is whole, not on a fixed border, and long enough for both its faces."""
    nodes, face_nodes, side_twin, side_node = tree
    if side_state[side] != OPEN or side_node[side] != NONE:
        return False
    twin = np.int64(side_twin[side])
    if not is_guarded(side, nodes, face_nodes, aspect, guard, side_state):
        return False
    return twin == NONE or is_guarded(twin, nodes, face_nodes, aspect, guard, side_state)


@njit(nogil=True, cache=True, inline="always")
def fits(height, leeways, place):
    """Tell whether a node at a place lets the faces on both sides of it hold."""
    is_left = leeways[place, LEFT_LOW] <= height <= leeways[place, LEFT_HIGH]
    return is_left and leeways[place, RIGHT_LOW] <= height <= leeways[place, RIGHT_HIGH]


@njit(nogil=True, cache=True)
def _fill_leeways(side, n_post, node, tree, heights, terms, rule, room, leeways):
    """Fill leeways (n_place, ≥ 4) for the places of a side, the posts of its face being gathered.

    In a face with breaks only a node on the posts' surface fits, and only every PAIR_STEP-th place is looked at.
    """
    nodes, face_nodes, _, side_node = tree
    posts, _, _, work, bins = room
    face, i, middle, n_place = side // 3, side % 3, rule[1], rule[2]
    if is_whole(face, side_node):
        a, b, c = (
            np.int64(face_nodes[face, i]), np.int64(face_nodes[face, (i + 1) % 3]), np.int64(face_nodes[face, (i + 2) % 3]),
        )  # fmt: skip
        most = greatest_thinness(face, nodes, face_nodes, terms)
        find_leeways(a, b, c, posts, n_post, nodes, terms[0], terms[1], most, middle, n_place, work, bins, leeways)
        return
    hint = np.int64(0)
    side_node[side] = node
    leeways[:, LEFT_LOW], leeways[:, RIGHT_LOW] = np.inf, np.inf
    for place in range(0, n_place, PAIR_STEP):
        put_on_side(side, share_of(place, middle, n_place), node, nodes, face_nodes, heights)
        found = try_cut(face, np.bool_(False), hint, posts, n_post, nodes, face_nodes, side_node, terms)[0]
        hint = found if found >= 0 else hint
        leeways[place, LEFT_LOW] = leeways[place, RIGHT_LOW] = nodes[node, 2] if found == HOLDS else np.inf
        leeways[place, LEFT_HIGH] = leeways[place, RIGHT_HIGH] = nodes[node, 2]
    side_node[side] = NONE


@njit(nogil=True, cache=True)
def fill_across(side, node, tree, heights, terms, rule, room, across):
    """Fill across (n_place, 4) with the leeways of the face across a side, at the places of the side."""
    nodes, face_nodes, side_twin, _ = tree
    posts, corner, steps, _, _ = room
    twin, n_place = np.int64(side_twin[side]), rule[2]
    n_post = gather_posts(twin // 3, nodes, face_nodes, heights, posts, corner, steps)
    _fill_leeways(twin, n_post, node, tree, heights, terms, rule, room, across)
    for place in range(n_place // 2):
        for j in range(4):
            across[place, j], across[n_place - 1 - place, j] = across[n_place - 1 - place, j], across[place, j]


@njit(nogil=True, cache=True)
def fill_places(face, node, tree, heights, terms, rule, side_state, room, places):
    """Fill what is to be known of all places on the sides of a face, (3, n_place, 6); return whether it settles as it is."""
    nodes, face_nodes, _, side_node = tree
    posts, corner, steps, _, _ = room
    middle, n_place = rule[1], rule[2]
    n_post = gather_posts(face, nodes, face_nodes, heights, posts, corner, steps)
    is_broken = not is_whole(face, side_node)
    flip, hint = np.bool_(False), np.int64(0)
    if is_broken and try_cut(face, flip, hint, posts, n_post, nodes, face_nodes, side_node, terms)[0] == HOLDS:
        return True
    for i in range(3):
        side = 3 * face + i
        if not _may_break(side, tree, terms[0], rule[0], side_state):
            places[i, :, LEFT_LOW] = places[i, :, RIGHT_LOW] = np.inf
            places[i, :, HEIGHT], places[i, :, GAIN] = np.nan, 0.0
            continue
        _fill_leeways(side, n_post, node, tree, heights, terms, rule, room, places[i])
        for place in range(n_place):
            is_left = places[i, place, LEFT_LOW] <= places[i, place, LEFT_HIGH]
            is_right = places[i, place, RIGHT_LOW] <= places[i, place, RIGHT_HIGH]
            if (is_left and is_right) or ((is_left or is_right) and place % PAIR_STEP == 0):
                gain = put_on_side(side, share_of(place, middle, n_place), node, nodes, face_nodes, heights)
                places[i, place, HEIGHT], places[i, place, GAIN] = nodes[node, 2], gain
            else:
                places[i, place, HEIGHT], places[i, place, GAIN] = np.nan, 0.0
    return False
