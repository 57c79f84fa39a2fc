"""Breaks that settle a face: with them no post of it is off by more than the bound (specs/methods.md M-142).

A pass first looks for the fewest breaks that settle its faces: one, on a side where that settles the face across too, or
where the face across holds all the same, or, if nothing else helps, where it has to be cut anyway; then two at a time. Of
all places of a break the most significant one that settles the face is taken: where the posts' surface is farthest from
the edge. Arrays are those of `vpfx.methods.forest.Forest` and `vpfx.methods.scan.Candidates`, `terms` a
`vpfx.methods.trial.Terms`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from vpfx.methods.borrow import borrowed
from vpfx.methods.breaks import OPEN, is_guarded, place_on_side
from vpfx.methods.cut import is_whole
from vpfx.methods.trial import HOLDS, gather_posts, make_room, try_cut
from vpfx.topology import NONE

__all__ = ["SettleRule", "settle_faces"]

BOTH, HOLDING, ANY = range(
    3
)  # what a break may do to the face across: settle it, find it holding, or leave it to later


class SettleRule(NamedTuple):
    """How hard to look for breaks that settle a face.

    Attributes
    ----------
    guard : float
        A side may break if it is at least this share of the longest side of both its faces.
    middle : float
        A break keeps this share of the side from both its ends.
    n_place : int
        Places on a side, evenly spread.
    n_pair_place : int
        Places on each of two sides.
    reach, pair_reach : float
        Faces that are off by more than so many bounds are not tried with one break, with two.
    rounds : int
        Times that all faces are gone through.
    """

    guard: float
    middle: float
    n_place: int
    n_pair_place: int
    reach: float
    pair_reach: float
    rounds: int


@njit(nogil=True, cache=True, inline="always")
def _share(place, middle, n_place):
    """Share of a side at a place of it."""
    return middle + (1.0 - 2.0 * middle) * place / (n_place - 1)


@njit(nogil=True, cache=True, inline="always")
def _place(side, share, node, nodes, face_nodes, heights):
    """Put a node on a side, on the posts' surface, and return its significance, metres."""
    u, v, height, significance = place_on_side(side, share, nodes, face_nodes, heights)
    nodes[node, 0], nodes[node, 1], nodes[node, 2] = u, v, height
    return significance


@njit(nogil=True, cache=True)
def _break(side, node, side_twin, side_node):
    """Let a node, or NONE, break a side."""
    side_node[side] = node
    if side_twin[side] != NONE:
        side_node[side_twin[side]] = node


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


@njit(nogil=True, cache=True)
def _rank_places(side, first, middle, n_place, nodes, face_nodes, heights, gains, order):
    """Put nodes from `first` on at all places of a side; fill gains and order (n_place,), the most significant place first."""
    for place in range(n_place):
        gain = _place(side, _share(place, middle, n_place), first + place, nodes, face_nodes, heights)
        at = place
        while at > 0 and gains[at - 1] < gain:
            gains[at], order[at] = gains[at - 1], order[at - 1]
            at -= 1
        gains[at], order[at] = gain, place


@njit(nogil=True, cache=True)
def _list_options(face, n_post, node, tree, heights, terms, rule, side_state, options, significance, room):
    """List single breaks that settle a face, its posts being gathered; return how many.

    Options are the most significant first, as side × places + place.
    """
    nodes, face_nodes, _, side_node = tree
    posts, _, _, gains, order = room
    guard, middle, n_place = rule[0], rule[1], rule[2]
    n, hint = 0, 0
    for i in range(3):
        side = np.int64(3 * face + i)
        if not _may_break(side, tree, terms[0], guard, side_state):
            continue
        _rank_places(side, node, middle, n_place, nodes, face_nodes, heights, gains[i], order[i])
        for rank in range(n_place):
            side_node[side] = node + order[i, rank]
            found = try_cut(face, False, hint, posts, n_post, nodes, face_nodes, side_node, terms)[0]
            hint = found if found >= 0 else hint
            if found == HOLDS:
                at = n
                while at > 0 and significance[at - 1] < gains[i, rank]:
                    significance[at], options[at] = significance[at - 1], options[at - 1]
                    at -= 1
                significance[at], options[at] = gains[i, rank], i * n_place + order[i, rank]
                n += 1
        side_node[side] = NONE
    return n


@njit(nogil=True, cache=True)
def _settle_with_two(face, node, tree, heights, terms, rule, side_state, face_error, slot, settled, room):
    """Break two sides of a whole face so that it is settled and none across is spoilt; return the first, or NONE."""
    nodes, face_nodes, side_twin, side_node = tree
    aspect, bound = terms[0], terms[1]
    guard, middle, n_place = rule[0], rule[1], rule[3]
    posts, corner, steps, gains, order = room
    verdict = np.zeros((3, n_place), np.int8)  # of the face across: 1 it may be broken there, -1 not, 0 not known yet
    n_side = 0
    for i in range(3):
        side = np.int64(3 * face + i)
        if not _may_break(side, tree, aspect, guard, side_state):
            verdict[i] = -1
            continue
        n_side += 1
        other = np.int64(side_twin[side] // 3) if side_twin[side] != NONE else np.int64(NONE)
        if other == NONE or (face_error[other] > bound and not settled[slot[other]]):
            verdict[i] = 1
        _rank_places(side, node + 2 + i * n_place, middle, n_place, nodes, face_nodes, heights, gains[i], order[i])
        for rank in range(n_place):
            order[i, rank] += node + 2 + i * n_place
    if n_side < 2:
        return NONE
    n_post, hint = gather_posts(face, nodes, face_nodes, heights, posts, corner, steps), 0
    for total in range(2 * n_place - 1):
        for i in range(3):
            j = (i + 1) % 3
            for rank in range(max(0, total - n_place + 1), min(total, n_place - 1) + 1):
                if verdict[i, rank] < 0 or verdict[j, total - rank] < 0:
                    continue
                one, two = order[i, rank], order[j, total - rank]
                side_node[3 * face + i], side_node[3 * face + j] = one, two
                offender = try_cut(face, False, hint, posts, n_post, nodes, face_nodes, side_node, terms)[0]
                side_node[3 * face + i] = side_node[3 * face + j] = NONE
                hint = offender if offender >= 0 else hint
                holds = offender == HOLDS
                for k, at in ((i, rank), (j, total - rank)):
                    if holds and verdict[k, at] == 0:
                        twin = np.int64(side_twin[3 * face + k])
                        side_node[twin] = order[k, at]
                        n_other = gather_posts(twin // 3, nodes, face_nodes, heights, posts, corner, steps)
                        offender = try_cut(twin // 3, False, 0, posts, n_other, nodes, face_nodes, side_node, terms)[0]
                        side_node[twin] = NONE
                        verdict[k, at] = 1 if offender == HOLDS else -1
                        gather_posts(face, nodes, face_nodes, heights, posts, corner, steps)
                    holds = holds and verdict[k, at] > 0
                if holds:
                    nodes[node], nodes[node + 1] = nodes[one], nodes[two]
                    _break(3 * face + i, node, side_twin, side_node)
                    _break(3 * face + j, node + 1, side_twin, side_node)
                    return i
    return NONE


@njit(nogil=True, cache=True)
def _settle_with_one(kind, faces, n_node, count, tree, heights, terms, rule, face_error, slot, options, state, room):
    """Break sides by listed options, each of which settles its face and does to the face across what `kind` says."""
    nodes, face_nodes, side_twin, side_node = tree
    n_option, is_stale, settled, broken = state
    posts, corner, steps, _, _ = room
    bound, middle, n_place = terms[1], rule[1], rule[2]
    for k in range(len(faces)):
        if settled[k] or is_stale[k]:
            continue
        last_side, hint, n_post = np.int64(NONE), 0, 0
        for i in range(n_option[k]):
            side, place = np.int64(3 * faces[k] + options[k, i] // n_place), options[k, i] % n_place
            if side_node[side] != NONE:
                continue
            twin = np.int64(side_twin[side])
            other = twin // 3 if twin != NONE else np.int64(NONE)
            is_over = twin != NONE and face_error[other] > bound and not settled[slot[other]]
            if is_over != (kind != HOLDING):
                continue
            _place(side, _share(place, middle, n_place), n_node + count, nodes, face_nodes, heights)
            _break(side, n_node + count, side_twin, side_node)
            if twin != NONE and kind != ANY:
                if side != last_side:
                    n_post, hint = gather_posts(other, nodes, face_nodes, heights, posts, corner, steps), 0
                    last_side = side
                offender = try_cut(other, False, hint, posts, n_post, nodes, face_nodes, side_node, terms)[0]
                if offender != HOLDS:
                    hint = offender if offender >= 0 else hint
                    _break(side, NONE, side_twin, side_node)
                    continue
            broken[count] = side
            count += 1
            settled[k] = True
            if is_over:
                settled[slot[other]] = kind == BOTH
                is_stale[slot[other]] = True
            break
    return count


@njit(nogil=True, cache=True)
def _settle(
    faces, n_node, nodes, face_nodes, side_twin, side_node, heights, terms, rule, side_state,
    face_error, slot, settled, broken, options, significance, n_option, is_stale, posts, corner, steps, gains, order,
):  # fmt: skip
    """Do what `settle_faces` says, with room for all it needs; return how many sides are broken.

    A face is stale if its options are not known, or if it got a break since.
    """
    faces, heights, side_state, face_error = (
        borrowed(faces), borrowed(heights), borrowed(side_state), borrowed(face_error)
    )  # fmt: skip
    slot, settled, broken = borrowed(slot), borrowed(settled), borrowed(broken)
    options, significance, n_option, is_stale = (
        borrowed(options), borrowed(significance), borrowed(n_option), borrowed(is_stale)
    )  # fmt: skip
    nodes, face_nodes, side_twin, side_node = (
        borrowed(nodes), borrowed(face_nodes), borrowed(side_twin), borrowed(side_node)
    )  # fmt: skip
    posts, corner, steps = borrowed(posts), borrowed(corner), borrowed(steps)
    tree, state = (nodes, face_nodes, side_twin, side_node), (n_option, is_stale, settled, broken)
    room = (posts, corner, steps, borrowed(gains), borrowed(order))
    n, count = len(faces), 0
    for turn in range(rule[6]):
        for k in range(n):
            face = np.int64(faces[k])
            n_option[k] = 0  # those of the turn before failed
            if settled[k] or not is_stale[k] or face_error[face] > rule[4] * terms[1]:
                continue
            n_post = gather_posts(face, nodes, face_nodes, heights, posts, corner, steps)
            if not is_whole(face, side_node):
                settled[k] = try_cut(face, False, 0, posts, n_post, nodes, face_nodes, side_node, terms)[0] == HOLDS
            if not settled[k]:
                n_option[k] = _list_options(
                    face, n_post, n_node + count, tree, heights, terms, rule, side_state, options[k], significance, room
                )
                is_stale[k] = False
        for kind in (BOTH, HOLDING, ANY):
            count = _settle_with_one(
                kind, faces, n_node, count, tree, heights, terms, rule, face_error, slot, options, state, room
            )
        for k in range(n if turn == 0 else 0):  # later, a face that may be settled has a break
            face = np.int64(faces[k])
            if settled[k] or face_error[face] > rule[5] * terms[1] or not is_whole(face, side_node):
                continue
            first = _settle_with_two(
                face, n_node + count, tree, heights, terms, rule, side_state, face_error, slot, settled, room
            )
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
        Nodes so far; `tree` has room for n_place + 3 * (n_scan + n_pair_place) + 2 more.
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
    Source: specs/methods.md M-142. Cost: O(posts of the faces, for each place tried).
    """
    n = len(faces)
    broken, options = np.empty(3 * n, np.int32), np.empty((n, 3 * rule[2]), np.int8)
    significance, n_option = np.empty(3 * rule[2]), np.zeros(n, np.int8)
    is_stale = np.ones(n, np.bool_)
    posts, corner, steps = make_room(heights.size)
    most = max(rule[2], rule[3])
    gains, order = np.empty((3, most)), np.empty((3, most), np.int64)
    nodes, face_nodes, side_twin, side_node, _, _ = tree
    count = _settle(
        faces, n_node, nodes, face_nodes, side_twin, side_node, heights, terms, rule, side_state, face_error, found[0],
        settled, broken, options, significance, n_option, is_stale, posts, corner, steps, gains, order,
    )  # fmt: skip
    return broken[:count]
