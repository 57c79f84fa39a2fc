"""Where edges break: the guarded choice of bounded mode and the paper's single look of pass mode.

Both return the sides to break, each the lower of two twins. Arrays that are not explained are those of
`vpfx.methods.forest.Forest` (`mesh`: its nodes, face_nodes and side_twin) and of `vpfx.methods.scan.Candidates` (`found`).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from vpfx.methods.cut import is_whole
from vpfx.methods.scan import surface_height
from vpfx.topology import NONE

__all__ = [
    "choose_breaks",
    "find_significant",
    "force_border_breaks",
    "is_guarded",
    "list_cuts",
    "place_nodes",
    "place_on_side",
]

OPEN, BROKEN, REPLACED, KEPT = range(4)  # states of a side; KEPT: on a fixed border, which alone says where it breaks
SAME_LENGTH = 1.0 + 1e-12  # sides whose squared lengths differ by less are equally long: the first is taken


@njit(nogil=True, cache=True)
def _square_length(side, nodes, face_nodes, aspect):
    """Squared length of a side, in heights of a post spacing."""
    start, end = face_nodes[side // 3, side % 3], face_nodes[side // 3, (side % 3 + 1) % 3]
    east = (nodes[end, 0] - nodes[start, 0]) * aspect
    north = nodes[end, 1] - nodes[start, 1]
    return east * east + north * north


@njit(nogil=True, cache=True)
def _first_rank(rank, limit, a, b):
    """Post of least rank below the limit strictly between posts a < b of a border, NONE if there is none."""
    best, at = limit, NONE
    for post in range(a + 1, b):
        if rank[post] < best:
            best, at = rank[post], post
    return at


@njit(nogil=True, cache=True)
def force_border_breaks(faces, mesh, ranks, limits, heights, side_state):
    """Break the sides of some faces on fixed borders where the border says so, and lock the others.

    Parameters
    ----------
    faces : int32 (n,)
    ranks : int32 (4, n_most)
        Rank of each post of the south, east, north and west border.
    limits : int64 (4,)
        Posts with lower ranks are nodes at this level; -1 for a border that is not fixed.
    side_state : int8 (≥ 3 * n_face,)
        Changed in place: KEPT on the sides of fixed borders.

    Returns
    -------
    int32 (n_broken,), float64 (n_broken, 3)
        The sides that are broken, and their nodes.
    """
    nodes, face_nodes, side_twin = mesh
    n_row, n_col = heights.shape
    broken, places = np.empty(3 * len(faces), np.int32), np.empty((3 * len(faces), 3))
    count = 0
    for face in faces:
        for i in range(3):
            side = 3 * face + i
            if side_twin[side] != NONE:
                continue
            start, end = face_nodes[face, i], face_nodes[face, (i + 1) % 3]
            for border in range(4):
                across = 1 if border % 2 == 0 else 0
                line = 0 if border == 0 or border == 3 else (n_row - 1 if across == 1 else n_col - 1)
                if limits[border] < 0 or nodes[start, across] != line or nodes[end, across] != line:
                    continue
                side_state[side] = KEPT
                a, b = nodes[start, 1 - across], nodes[end, 1 - across]
                at = _first_rank(ranks[border], limits[border], int(min(a, b)), int(max(a, b)))
                if at != NONE:
                    u, v = (at, line) if across == 1 else (line, at)
                    places[count, 0], places[count, 1], places[count, 2] = u, v, heights[v, u]
                    broken[count] = side
                    count += 1
    return broken[:count], places[:count]


@njit(nogil=True, cache=True)
def _longest(face, nodes, face_nodes, aspect, side_state):
    """Longest side of a face among those that may break, and its squared length; NONE if none may."""
    best, most = NONE, 0.0
    for side in range(3 * face, 3 * face + 3):
        length = _square_length(side, nodes, face_nodes, aspect)
        if side_state[side] != KEPT and (best == NONE or length > most * SAME_LENGTH):
            best, most = side, length
    return best, most


@njit(nogil=True, cache=True)
def is_guarded(side, nodes, face_nodes, aspect, guard, side_state):
    """Tell whether a side is long enough for its face: at least `guard` of the longest side that may break."""
    most = _longest(side // 3, nodes, face_nodes, aspect, side_state)[1]
    return _square_length(side, nodes, face_nodes, aspect) >= guard * guard * most


@njit(nogil=True, cache=True)
def _nearest_side(face, nodes, face_nodes, col, row, aspect, side_state):
    """Side of a face nearest to a post among those that may break; NONE if none may."""
    best, nearest = NONE, np.inf
    for i in range(3):
        a, b = face_nodes[face, i], face_nodes[face, (i + 1) % 3]
        east, north = (nodes[b, 0] - nodes[a, 0]) * aspect, nodes[b, 1] - nodes[a, 1]
        cross = east * (row - nodes[a, 1]) - north * (col - nodes[a, 0]) * aspect
        distance = cross * cross / (east * east + north * north)
        if side_state[3 * face + i] != KEPT and distance < nearest:
            best, nearest = 3 * face + i, distance
    return best


@njit(nogil=True, cache=True)
def _wish(face, post, tree, n_col, aspect, guard, side_state):
    """Side to break for a face with an offending post that is near no side: nearest or longest."""
    nodes, face_nodes, side_twin = tree[0], tree[1], tree[2]
    side = _nearest_side(face, nodes, face_nodes, post % n_col, post // n_col, aspect, side_state)
    if side == NONE:
        return NONE
    for own in (side, np.int64(side_twin[side])):
        if own != NONE and not is_guarded(own, nodes, face_nodes, aspect, guard, side_state):
            return _longest(face, nodes, face_nodes, aspect, side_state)[0]
    return side


@njit(nogil=True, cache=True)
def choose_breaks(faces, tree, n_col, aspect, guard, side_state, found, settled):
    """Choose the sides to break of faces that are not settled, so that no face gets needlessly thin.

    A side with a post in its band that is off is broken if it is at least `guard` of the longest side of both its faces;
    else the longest sides of the faces it is too short for are broken in its place, under the same condition. A face with
    no such side, and no break, breaks the side nearest to its worst post, or its longest.

    Parameters
    ----------
    faces : int32 (n_scan,)
        Faces as they were scanned.
    tree : tuple
        `Forest.tree`.
    n_col : int
        Columns of posts.
    aspect, guard : float
    side_state
        Sides of fixed borders are KEPT; left as it is.
    settled : bool (n_scan,)

    Returns
    -------
    int32 (n,)
        Sides to break, ascending.

    Notes
    -----
    Source: design.md §5 ("band"); specs/methods.md M-140. Each replacement is longer by 1 / guard, so the chain ends.
    """
    nodes, face_nodes, side_twin, side_node, _, _ = tree
    _, side_error, face_post, _ = found
    stack = np.empty(3 * len(side_state) + 3, np.int32)  # touched only as far as it is filled
    seen = np.empty(len(side_state), np.int32)
    top, n_seen = 0, 0
    for k in range(len(faces)):
        face = np.int64(faces[k])
        if settled[k]:
            continue
        has_side = not is_whole(face, side_node)
        for i in range(3):
            if side_error[3 * k + i] > 0.0 and side_state[3 * face + i] == OPEN:
                stack[top] = 3 * face + i
                top += 1
                has_side = True
        if not has_side:
            side = _wish(face, face_post[k], tree, n_col, aspect, guard, side_state)
            if side != NONE:
                stack[top] = side
                top += 1
    while top > 0:
        top -= 1
        side = np.int64(stack[top])
        twin = np.int64(side_twin[side])
        key = side if twin == NONE else min(side, twin)
        if side_state[key] != OPEN or side_node[key] != NONE:
            continue
        side_state[key] = BROKEN
        seen[n_seen] = key
        n_seen += 1
        for own in (side, twin):
            if own != NONE and not is_guarded(own, nodes, face_nodes, aspect, guard, side_state):
                side_state[key] = REPLACED
                stack[top] = _longest(own // 3, nodes, face_nodes, aspect, side_state)[0]
                top += 1
    n_broken = 0
    for i in range(n_seen):
        if side_state[seen[i]] == BROKEN:
            seen[n_broken] = seen[i]
            n_broken += 1
        side_state[seen[i]] = OPEN
    return np.sort(seen[:n_broken])


@njit(nogil=True, cache=True, inline="always")
def place_on_side(side, share, nodes, face_nodes, heights):
    """Place at a share of a side, u, v and height of the posts' surface there, and how far that is from the side, metres."""
    start, end = face_nodes[side // 3, side % 3], face_nodes[side // 3, (side % 3 + 1) % 3]
    u = nodes[start, 0] + share * (nodes[end, 0] - nodes[start, 0])
    v = nodes[start, 1] + share * (nodes[end, 1] - nodes[start, 1])
    height = surface_height(heights, u, v)
    return u, v, height, abs(height - (nodes[start, 2] + share * (nodes[end, 2] - nodes[start, 2])))


@njit(nogil=True, cache=True)
def place_nodes(broken, mesh, heights, middle, n_place):
    """Place the nodes of chosen breaks where the posts' surface is farthest from the side; of equals, nearest to its middle.

    Parameters
    ----------
    broken : int32 (n,)
        Sides.
    middle : float
        A break keeps this share of the side from both its ends.
    n_place : int
        Places looked at on each side, evenly spread; odd.

    Returns
    -------
    float64 (n, 3)
        The nodes.
    """
    nodes, face_nodes, _ = mesh
    places = np.empty((len(broken), 3))
    for n in range(len(broken)):
        most = -1.0
        for place in range(n_place):
            step = (place + 1) // 2 * (1 if place % 2 == 0 else -1)  # from the middle outwards
            share = 0.5 + step * (1.0 - 2.0 * middle) / (n_place - 1)
            u, v, height, significance = place_on_side(broken[n], share, nodes, face_nodes, heights)
            if significance > most:
                most = significance
                places[n, 0], places[n, 1], places[n, 2] = u, v, height
    return places


@njit(nogil=True, cache=True)
def list_cuts(faces, broken, first_node, mesh, side_node, found, to_cut, to_cut_post):
    """List the faces to cut: those at broken sides, then those of rule 4, which have an inner post and no broken side.

    Parameters
    ----------
    faces : int32 (n_scan,)
        Faces as they were scanned; their slots are given back, those of faces to cut by `vpfx.methods.cut.cut_faces`.
    broken : int32 (n,)
        Sides; their nodes are counted from `first_node`.
    side_node
        Takes the nodes of broken sides and their twins.
    to_cut, to_cut_post : int32, int64 (≥ 2 * n + n_scan,)
        Take the faces, and their posts for rule 4, -1 for the others.

    Returns
    -------
    int
        Number of faces to cut.
    """
    side_twin = mesh[2]
    slot, inner_post = found[0], found[3]
    count = 0
    for face in faces:
        slot[face] = NONE
    for i in range(len(broken)):
        for side in (broken[i], side_twin[broken[i]]):
            if side == NONE:
                continue
            face = side // 3
            side_node[side] = first_node + i
            if slot[face] == NONE:
                slot[face] = count
                to_cut[count], to_cut_post[count] = face, NONE
                count += 1
    for k in range(len(faces)):
        face = faces[k]
        if is_whole(face, side_node) and inner_post[k] != NONE:
            to_cut[count], to_cut_post[count] = face, inner_post[k]
            count += 1
    return count


@njit(nogil=True, cache=True)
def _most_significant(heights, start, end, tolerance, away):
    """Most significant point of an edge: where it crosses the lattice, how far along, NaN if none is off by more.

    The edge is walked from its south-west end; it is looked at where it crosses columns of posts, or rows if it is
    steeper. Points nearer than `away` (a share of the edge) to an end are not looked at.
    """
    east, north = end[0] - start[0], end[1] - start[1]
    axis = 0 if abs(east) >= abs(north) else 1
    span = end[axis] - start[axis]
    best, at = tolerance, np.nan
    for post in range(int(np.floor(start[axis])) + 1, int(np.ceil(end[axis]))):
        along = (post - start[axis]) / span
        if along < away or along > 1.0 - away:
            continue
        height = surface_height(heights, start[0] + along * east, start[1] + along * north)
        error = abs(height - (start[2] + along * (end[2] - start[2])))
        if error > best:
            best, at = error, along
    return at


@njit(nogil=True, cache=True)
def find_significant(faces, mesh, heights, aspect, tolerance, away, share, side_state):
    """Look at every edge of some faces once for its most significant point, as the paper does.

    Parameters
    ----------
    faces : int32 (n,)
    tolerance : float
        A point is significant if it is off by more than this, metres.
    away : float
        Points nearer than this to an end of the edge are not looked at, in heights of a post spacing.
    share : float
        The same as a share of the edge's length.

    Returns
    -------
    int32 (n_broken,), float64 (n_broken, 3)
        The sides that are broken, and their nodes.
    """
    nodes, face_nodes, side_twin = mesh
    broken, places = np.empty(3 * len(faces), np.int32), np.empty((3 * len(faces), 3))
    count = 0
    for face in faces:
        for i in range(3):
            side = 3 * face + i
            if side_state[side] != OPEN or 0 <= side_twin[side] < side:
                continue
            a, b = face_nodes[face, i], face_nodes[face, (i + 1) % 3]
            east, north = nodes[b, 0] - nodes[a, 0], nodes[b, 1] - nodes[a, 1]
            is_forward = east > 0 if abs(east) >= abs(north) else north > 0
            start, end = (a, b) if is_forward else (b, a)
            length = np.sqrt((east * aspect) ** 2 + north * north)
            at = _most_significant(heights, nodes[start], nodes[end], tolerance, max(share, away / length))
            if np.isnan(at):
                continue
            at = at if is_forward else 1.0 - at
            u, v = nodes[a, 0] + at * east, nodes[a, 1] + at * north
            places[count, 0], places[count, 1], places[count, 2] = u, v, surface_height(heights, u, v)
            broken[count] = side
            count += 1
    return broken[:count], places[:count]
