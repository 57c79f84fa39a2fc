"""Breaks that settle a face: with them no post of it is off by more than the bound (specs/methods.md M-142).

A pass first looks for the fewest breaks that settle its faces: one, on a side where that settles the face across too, or
where the face across holds all the same, or, if nothing else helps, where it has to be cut anyway; then two at a time. Of
all places of a break the most significant one that settles the face is taken: where the posts' surface is farthest from
the edge. Arrays are those of `vpfx.methods.forest.Forest` and `vpfx.methods.scan.Candidates`, `terms` a
`vpfx.methods.trial.Terms`, `rule` a `SettleRule`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from vpfx.methods.borrow import borrowed
from vpfx.methods.cut import is_whole
from vpfx.methods.leeway import find_leeways, share_of
from vpfx.methods.places import (
    GAIN,
    HEIGHT,
    LEFT_HIGH,
    LEFT_LOW,
    PAIR_STEP,
    RIGHT_HIGH,
    RIGHT_LOW,
    fill_across,
    fill_places,
    fits,
    put_on_side,
)
from vpfx.methods.trial import gather_posts, greatest_thinness, make_room
from vpfx.topology import NONE

__all__ = ["SettleRule", "settle_faces"]

BOTH, HOLDING, ANY = range(3)  # what a break does to the face across: settle it, find it holding, leave it to later


class SettleRule(NamedTuple):
    """How hard to look for breaks that settle a face.

    Attributes
    ----------
    guard : float
        A side may break if it is at least this share of the longest side of both its faces.
    middle : float
        A break keeps this share of the side from both its ends.
    n_place : int
        Places on a side, evenly spread, of an odd number; two breaks at once are tried at every second one.
    reach, pair_reach : float
        Faces that are off by more than so many bounds are not tried with one break, with two; the second is not the greater.
    rounds : int
        Times that all faces are gone through.
    """

    guard: float
    middle: float
    n_place: int
    reach: float
    pair_reach: float
    rounds: int


@njit(nogil=True, cache=True)
def _break(side, node, side_twin, side_node):
    """Let a node break a side."""
    side_node[side] = node
    if side_twin[side] != NONE:
        side_node[side_twin[side]] = node


@njit(nogil=True, cache=True)
def _settle_with_one(
    kind, faces, n_node, count, tree, heights, terms, rule, face_error, slot, places, state, room, across
):
    """Break sides, each of which settles its face and does to the face across what `kind` says."""
    nodes, face_nodes, side_twin, side_node = tree
    is_stale, settled, broken = state
    bound, middle, n_place = terms[1], rule[1], rule[2]
    for k in range(len(faces)):
        if settled[k] or is_stale[k]:
            continue
        best, best_side, best_place = -1.0, np.int64(NONE), 0
        for i in range(3):
            side = np.int64(3 * faces[k] + i)
            twin = np.int64(side_twin[side])
            other = twin // 3 if twin != NONE else np.int64(NONE)
            is_over = twin != NONE and face_error[other] > bound and not settled[slot[other]]
            if side_node[side] != NONE or is_over != (kind != HOLDING):
                continue
            if kind == BOTH and face_error[other] > rule[3] * bound:
                continue
            is_known = False
            for place in range(n_place):
                height, gain = places[k, i, place, HEIGHT], places[k, i, place, GAIN]
                if gain <= best or not fits(height, places[k, i], place):
                    continue
                if twin != NONE and kind != ANY:
                    if kind == BOTH and not is_stale[slot[other]]:
                        if not fits(height, places[slot[other], twin % 3], n_place - 1 - place):
                            continue
                    else:
                        if not is_known:
                            fill_across(side, n_node + count, tree, heights, terms, rule, room, across)
                            is_known = True
                        if not fits(height, across, place):
                            continue
                best, best_side, best_place = gain, side, place
        if best_side == NONE:
            continue
        put_on_side(best_side, share_of(best_place, middle, n_place), n_node + count, nodes, face_nodes, heights)
        _break(best_side, n_node + count, side_twin, side_node)
        broken[count] = best_side
        count += 1
        settled[k] = True
        if side_twin[best_side] != NONE and slot[side_twin[best_side] // 3] != NONE:
            at = slot[side_twin[best_side] // 3]
            settled[at] = settled[at] or kind == BOTH
            is_stale[at] = True
    return count


@njit(nogil=True, cache=True)
def _fill_pairs(face, i, node, n_post, tree, terms, rule, places, room, leeways, holds):
    """Fill which nodes on side i and the next settle a face together, holds (n_pair, n_pair); tell whether any do.

    The nodes of the places stand from `node` on, side by side. Either diagonal makes a face of one of the nodes only; where
    that holds, the two others come from a face of that node and two corners, cut by the other node.
    """
    nodes, face_nodes, _, _ = tree
    posts, _, _, work, bins = room
    n_pair, j = rule[2] // PAIR_STEP + 1, (i + 1) % 3
    a, b, c = face_nodes[face, i], face_nodes[face, j], face_nodes[face, (i + 2) % 3]
    most = greatest_thinness(face, nodes, face_nodes, terms)
    aspect, bound, middle = terms[0], terms[1], rule[1]
    holds[:] = False
    is_found = False
    for diagonal in range(2):  # from a to the node on the second side, then from the one on the first side to c
        fixed, free, start, end = (j, i, a, b) if diagonal == 0 else (i, j, b, c)
        low, high = (RIGHT_LOW, RIGHT_HIGH) if diagonal == 0 else (LEFT_LOW, LEFT_HIGH)
        for place in range(n_pair):
            at, apex = place * PAIR_STEP, node + fixed * n_pair + place
            if not places[fixed, at, low] <= places[fixed, at, HEIGHT] <= places[fixed, at, high]:
                continue
            find_leeways(
                np.int64(start), np.int64(end), apex, posts, n_post, nodes, aspect, bound, most, middle, n_pair, work, bins,
                leeways,
            )  # fmt: skip
            for other in range(n_pair):
                if fits(places[free, other * PAIR_STEP, HEIGHT], leeways, other):
                    one, two = (other, place) if diagonal == 0 else (place, other)
                    holds[one, two] = is_found = True
    return is_found


@njit(nogil=True, cache=True)
def _rank_places(places, gains, order):
    """Fill order (n_pair,) with every PAIR_STEP-th place, the most significant first."""
    for place in range(len(order)):
        gain, at = places[place * PAIR_STEP, GAIN], place
        while at > 0 and gains[at - 1] < gain:
            gains[at], order[at] = gains[at - 1], order[at - 1]
            at -= 1
        gains[at], order[at] = gain, place


@njit(nogil=True, cache=True)
def _settle_with_two(
    face, node, tree, heights, terms, rule, face_error, slot, settled, places, room, pair_room, across
):
    """Break two sides of a whole face so that it is settled and none across is spoilt; return the first, or NONE."""
    nodes, face_nodes, side_twin, side_node = tree
    posts, corner, steps, _, _ = room
    leeways, holds, gains, order = pair_room
    bound, middle, n_place = terms[1], rule[1], rule[2]
    n_pair = n_place // PAIR_STEP + 1
    is_found = np.int64(0)
    n_post = gather_posts(face, nodes, face_nodes, heights, posts, corner, steps)
    for i in range(3):
        for place in range(n_pair):
            share = share_of(place, middle, n_pair)
            put_on_side(3 * face + i, share, node + 2 + i * n_pair + place, nodes, face_nodes, heights)
        _rank_places(places[i], gains, order[i])
    for i in range(3):
        is_found |= _fill_pairs(face, i, node + 2, n_post, tree, terms, rule, places, room, leeways, holds[i]) << i
    is_known = 0
    for total in range(2 * n_pair - 1 if is_found else 0):
        for i in range(3):
            if not is_found >> i & 1:
                continue
            for rank in range(max(0, total - n_pair + 1), min(total, n_pair - 1) + 1):
                j, one, two = (i + 1) % 3, order[i, rank], order[(i + 1) % 3, total - rank]
                if not holds[i, one, two]:
                    continue
                is_good = True
                for k, place in ((i, one), (j, two)):
                    side = np.int64(3 * face + k)
                    if not is_known >> k & 1:
                        is_known |= 1 << k
                        twin = side_twin[side]
                        if twin == NONE or (face_error[twin // 3] > bound and not settled[slot[twin // 3]]):
                            across[k, :, LEFT_LOW] = across[k, :, RIGHT_LOW] = -np.inf
                            across[k, :, LEFT_HIGH] = across[k, :, RIGHT_HIGH] = np.inf
                        else:
                            fill_across(side, node, tree, heights, terms, rule, room, across[k])
                    is_good = is_good and fits(places[k, place * PAIR_STEP, HEIGHT], across[k], place * PAIR_STEP)
                if is_good:
                    nodes[node] = nodes[node + 2 + i * n_pair + one]
                    nodes[node + 1] = nodes[node + 2 + j * n_pair + two]
                    _break(3 * face + i, node, side_twin, side_node)
                    _break(3 * face + j, node + 1, side_twin, side_node)
                    return i
    return NONE


@njit(nogil=True, cache=True)
def _settle(
    faces, n_node, nodes, face_nodes, side_twin, side_node, heights, terms, rule, side_state, face_error, slot, settled,
    broken, is_stale, posts, corner, steps, work, bins, places, across, leeways, holds, gains, order,
):  # fmt: skip
    """Do what `settle_faces` says, with room for all it needs; return how many sides are broken.

    A face is stale if its places are not known, or if it got a break since.
    """
    faces, heights, side_state, face_error = (
        borrowed(faces), borrowed(heights), borrowed(side_state), borrowed(face_error)
    )  # fmt: skip
    slot, settled, broken, is_stale = borrowed(slot), borrowed(settled), borrowed(broken), borrowed(is_stale)
    nodes, face_nodes, side_twin, side_node = (
        borrowed(nodes), borrowed(face_nodes), borrowed(side_twin), borrowed(side_node)
    )  # fmt: skip
    room = (borrowed(posts), borrowed(corner), borrowed(steps), borrowed(work), borrowed(bins))
    places, across = borrowed(places), borrowed(across)
    pair_room = (borrowed(leeways), borrowed(holds), borrowed(gains), borrowed(order))
    tree, state = (nodes, face_nodes, side_twin, side_node), (is_stale, settled, broken)
    bound, n, count = terms[1], len(faces), np.int64(0)
    for turn in range(rule[5]):
        for k in range(n):
            face = np.int64(faces[k])
            if settled[k] or not is_stale[k] or face_error[face] > rule[3] * bound:
                continue
            settled[k] = fill_places(face, n_node + count, tree, heights, terms, rule, side_state, room, places[k])
            is_stale[k] = settled[k]
        for kind in (BOTH, HOLDING, ANY):
            count = _settle_with_one(
                kind, faces, n_node, count, tree, heights, terms, rule, face_error, slot, places, state, room, across[0]
            )
        for k in range(n if turn == 0 else 0):  # later, a face that may be settled has a break
            face = np.int64(faces[k])
            if settled[k] or is_stale[k] or face_error[face] > rule[4] * bound or not is_whole(face, side_node):
                continue
            first = _settle_with_two(
                face, n_node + count, tree, heights, terms, rule, face_error, slot, settled, places[k], room, pair_room,
                across,
            )  # fmt: skip
            if first == NONE:
                continue
            settled[k] = True
            for side in (3 * face + first, 3 * face + (first + 1) % 3):
                broken[count] = side
                count += 1
                if side_twin[side] != NONE and slot[side_twin[side] // 3] != NONE:
                    is_stale[slot[side_twin[side] // 3]] = True
    return count


@njit(nogil=True, cache=True)
def settle_faces(faces, n_node, tree, heights, terms, rule, side_state, face_error, found, settled):
    """Break sides so that as many faces as possible are settled, by as few breaks as possible.

    Parameters
    ----------
    faces : int32 (n_scan,)
        Faces as they were scanned; some may have breaks.
    n_node : int
        Nodes so far; `tree` has room for 3 * (n_scan + n_place) + 2 more.
    tree : tuple
        `Forest.tree`; gets the nodes, in the order of the sides returned, and the breaks.
    rule : tuple
        A `SettleRule`.
    settled : bool (n_scan,)
        True for faces that hold; changed in place.

    Returns
    -------
    int32 (n_broken,)
        The sides that are broken.

    Notes
    -----
    Source: specs/methods.md M-142. Cost: O(posts of the faces + places tried).
    """
    n, n_place, n_pair = len(faces), rule[2], rule[2] // PAIR_STEP + 1
    broken, is_stale, places = np.empty(3 * n, np.int32), np.ones(n, np.bool_), np.empty((n, 3, n_place, 6))
    posts, corner, steps = make_room(heights.size)
    work, bins, across = np.empty((6, heights.size)), np.empty((n_place + 1, 4)), np.empty((3, n_place, 4))
    leeways, holds = np.empty((n_pair, 4)), np.empty((3, n_pair, n_pair), np.bool_)
    gains, order = np.empty(n_pair), np.empty((3, n_pair), np.int64)
    nodes, face_nodes, side_twin, side_node, _, _ = tree
    count = _settle(
        faces, n_node, nodes, face_nodes, side_twin, side_node, heights, terms, rule, side_state, face_error, found[0],
        settled, broken, is_stale, posts, corner, steps, work, bins, places, across, leeways, holds, gains, order,
    )  # fmt: skip
    return broken[:count]
