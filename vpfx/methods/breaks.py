"""Where edges break: the guarded choice of bounded mode and the paper's single look of pass mode.

Both fill two arrays for `vpfx.methods.cut.cut_faces`: a state per side (kept on the lower of two twins) and, for rule 4,
the post inside a face.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from vpfx.methods.scan import surface_height

__all__ = [
    "choose_breaks",
    "choose_diagonals",
    "find_significant",
    "force_border_breaks",
    "place_nodes",
    "side_lengths",
]

NONE = -1
OPEN, BROKEN, REPLACED, KEPT = 0, 1, 2, 3  # states of a side; KEPT: part of a fixed border that has no break here
SAME_LENGTH = 1.0 + 1e-12  # sides whose squared lengths differ by less are equally long: the first is taken


@njit(nogil=True, cache=True)
def side_lengths(nodes, face_nodes, aspect):
    """Squared length of every side, in heights of a post spacing: float64 (3 * n_face,)."""
    out = np.empty(3 * len(face_nodes))
    for side in range(len(out)):
        start, end = face_nodes[side // 3, side % 3], face_nodes[side // 3, (side % 3 + 1) % 3]
        east = (nodes[end, 0] - nodes[start, 0]) * aspect
        north = nodes[end, 1] - nodes[start, 1]
        out[side] = east * east + north * north
    return out


@njit(nogil=True, cache=True)
def _first_rank(rank, limit, a, b):
    """Post of least rank below the limit strictly between posts a < b of a border, NONE if there is none."""
    best, at = limit, NONE
    for post in range(a + 1, b):
        if rank[post] < best:
            best, at = rank[post], post
    return at


@njit(nogil=True, cache=True)
def force_border_breaks(nodes, face_nodes, side_twin, ranks, limits, shape, state, side_node, new_nodes, heights):
    """Break the sides on fixed borders where the border says so, and lock the others.

    Parameters
    ----------
    ranks : int32 (4, n_most)
        Rank of each post of the south, east, north and west border.
    limits : int64 (4,)
        Posts with lower ranks are nodes at this level; -1 for a border that is not fixed.
    shape : (n_row, n_col)
    state, side_node : int8, int32 (3 * n_face,)
        Changed in place; new nodes are numbered from len(nodes).
    new_nodes : float64 (n_side, 3)
        Takes the new nodes.

    Returns
    -------
    int
        Number of new nodes.
    """
    count = 0
    for side in range(3 * len(face_nodes)):
        if side_twin[side] != NONE:
            continue
        face, i = side // 3, side % 3
        start, end = face_nodes[face, i], face_nodes[face, (i + 1) % 3]
        for border in range(4):
            across = 1 if border % 2 == 0 else 0
            line = 0 if border == 0 or border == 3 else (shape[0] - 1 if across == 1 else shape[1] - 1)
            if limits[border] < 0 or nodes[start, across] != line or nodes[end, across] != line:
                continue
            a, b = nodes[start, 1 - across], nodes[end, 1 - across]
            at = _first_rank(ranks[border], limits[border], int(min(a, b)), int(max(a, b)))
            state[side] = KEPT if at == NONE else BROKEN
            if at != NONE:
                u, v = (at, line) if across == 1 else (line, at)
                new_nodes[count, 0], new_nodes[count, 1], new_nodes[count, 2] = u, v, heights[v, u]
                side_node[side] = len(nodes) + count
                count += 1
    return count


@njit(nogil=True, cache=True)
def _longest(face, length, state):
    """Longest side of a face among those that may break; NONE if none may."""
    best = NONE
    for side in range(3 * face, 3 * face + 3):
        if state[side] != KEPT and (best == NONE or length[side] > length[best] * SAME_LENGTH):
            best = side
    return best


@njit(nogil=True, cache=True)
def _is_guarded(side, length, state, guard):
    """Tell whether a side is long enough for its face: at least `guard` of the longest side that may break."""
    return length[side] >= guard * guard * length[_longest(side // 3, length, state)]


@njit(nogil=True, cache=True)
def _nearest_side(face, nodes, face_nodes, col, row, aspect, state):
    """Side of a face nearest to a post among those that may break; NONE if none may."""
    best, nearest = NONE, np.inf
    for i in range(3):
        a, b = face_nodes[face, i], face_nodes[face, (i + 1) % 3]
        east, north = (nodes[b, 0] - nodes[a, 0]) * aspect, nodes[b, 1] - nodes[a, 1]
        cross = east * (row - nodes[a, 1]) - north * (col - nodes[a, 0]) * aspect
        distance = cross * cross / (east * east + north * north)
        if state[3 * face + i] != KEPT and distance < nearest:
            best, nearest = 3 * face + i, distance
    return best


@njit(nogil=True, cache=True)
def _wish(face, nodes, face_nodes, side_twin, n_col, bound, aspect, guard, length, state, found):
    """Side to break for a face with an offending post that is near no side and not in the middle: nearest or longest."""
    side_error, side_along, side_post, face_error, face_post, _ = found
    row, col = face_post[face] // n_col, face_post[face] % n_col
    side = _nearest_side(face, nodes, face_nodes, col, row, aspect, state)
    if side == NONE:
        return NONE
    twin = side_twin[side]
    is_free = _is_guarded(side, length, state, guard) and (twin == NONE or _is_guarded(twin, length, state, guard))
    if not is_free:
        return _longest(face, length, state)
    if side_error[side] <= bound and (twin == NONE or side_error[twin] <= bound):
        a, b = face_nodes[face, side % 3], face_nodes[face, (side % 3 + 1) % 3]
        east, north = (nodes[b, 0] - nodes[a, 0]) * aspect, nodes[b, 1] - nodes[a, 1]
        side_along[side] = ((col - nodes[a, 0]) * aspect * east + (row - nodes[a, 1]) * north) / length[side]
        side_error[side] = face_error[face]
        side_post[side] = face_post[face]
    return side


@njit(nogil=True, cache=True)
def choose_breaks(nodes, face_nodes, side_twin, n_col, bound, aspect, guard, length, state, found):
    """Choose the sides to break so that no face gets needlessly thin.

    A side with an offending post in its band is broken if it is at least `guard` of the longest side of both its faces;
    else the longest sides of the faces it is too short for are broken in its place, under the same condition. A face with
    an offending post that is near no side and not in the middle breaks its nearest side, or its longest.

    Parameters
    ----------
    nodes, face_nodes, side_twin, found
        The mesh and what `scan_faces` found.
    n_col : int
        Columns of posts.
    bound, aspect, guard : float
    length : float64 (3 * n_face,)
        Squared lengths by `side_lengths`.
    state : int8 (3 * n_face,)
        Changed in place: BROKEN on the lower twin of each side chosen. Sides of fixed borders are decided before.

    Notes
    -----
    Source: design.md §5 ("band"); specs/methods.md M-140. Each replacement is longer by 1 / guard, so the chain ends.
    """
    side_error, _, _, face_error, _, inner_post = found
    n_face = len(face_nodes)
    stack = np.empty(9 * n_face + 3, np.int64)
    top = 0
    for face in range(n_face):
        if face_error[face] <= bound:
            continue
        has_side = False
        for side in range(3 * face, 3 * face + 3):
            if side_error[side] > bound and state[side] == OPEN:
                stack[top] = side
                top += 1
                has_side = True
        if not has_side and inner_post[face] == NONE:
            side = _wish(face, nodes, face_nodes, side_twin, n_col, bound, aspect, guard, length, state, found)
            if side != NONE:
                stack[top] = side
                top += 1
    while top > 0:
        top -= 1
        side = stack[top]
        twin = np.int64(side_twin[side])
        key = side if twin == NONE else min(side, twin)
        if state[key] != OPEN:
            continue
        state[key] = BROKEN
        for own in (side, twin):
            if own != NONE and not _is_guarded(own, length, state, guard):
                state[key] = REPLACED
                stack[top] = _longest(own // 3, length, state)
                top += 1


@njit(nogil=True, cache=True)
def place_nodes(
    nodes, face_nodes, side_twin, heights, bound, middle, state, found, side_node, face_node, new_nodes, count
):
    """Make the nodes of all chosen breaks, and of rule 4 in faces with no broken side.

    Parameters
    ----------
    middle : float
        A break keeps this share of the side from both its ends.
    side_node, face_node : int32 (3 * n_face,), (n_face,)
        Take the node of each side and each face.
    new_nodes : float64 (n_most, 3)
        Takes the new nodes after the `count` it has.

    Returns
    -------
    int
        Number of new nodes.
    """
    side_error, side_along, side_post, face_error, _, inner_post = found
    n_col = heights.shape[1]
    for side in range(3 * len(face_nodes)):
        if state[side] != BROKEN or side_node[side] != NONE:
            continue
        twin = side_twin[side]
        best = side
        if twin != NONE:
            better = side_error[twin] > side_error[side]
            tied = side_error[twin] == side_error[side] and side_post[twin] < side_post[side]
            best = twin if better or tied else side
        start, end = face_nodes[best // 3, best % 3], face_nodes[best // 3, (best % 3 + 1) % 3]
        along = 0.5
        if side_error[best] > bound:
            along = min(max(side_along[best], middle), 1.0 - middle)
        u = nodes[start, 0] + along * (nodes[end, 0] - nodes[start, 0])
        v = nodes[start, 1] + along * (nodes[end, 1] - nodes[start, 1])
        new_nodes[count, 0], new_nodes[count, 1], new_nodes[count, 2] = u, v, surface_height(heights, u, v)
        side_node[side] = len(nodes) + count
        if twin != NONE:
            side_node[twin] = side_node[side]
        count += 1
    for face in range(len(face_nodes)):
        is_cut = False
        for side in range(3 * face, 3 * face + 3):
            is_cut = is_cut or side_node[side] != NONE
        post = inner_post[face]
        if not is_cut and face_error[face] > bound and post != NONE:
            row, col = post // n_col, post % n_col
            new_nodes[count, 0], new_nodes[count, 1], new_nodes[count, 2] = col, row, heights[row, col]
            face_node[face] = len(nodes) + count
            count += 1
    return count


@njit(nogil=True, cache=True)
def _mixed(seed, value):
    """Random 64 bits from a seed and a number (splitmix64): the same on every machine."""
    x = np.uint64(seed) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(value)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


@njit(nogil=True, cache=True)
def _chord_error(heights, nodes, new_nodes, a, b):
    """Greatest height between the posts' surface and the straight line from node a to b, taken once a post, metres."""
    n = len(nodes)
    start = nodes[a] if a < n else new_nodes[a - n]
    end = nodes[b] if b < n else new_nodes[b - n]
    n_step = int(max(abs(end[0] - start[0]), abs(end[1] - start[1]))) + 1
    worst = 0.0
    for step in range(1, n_step):
        t = step / n_step
        height = surface_height(heights, start[0] + t * (end[0] - start[0]), start[1] + t * (end[1] - start[1]))
        worst = max(worst, abs(height - (start[2] + t * (end[2] - start[2]))))
    return worst


@njit(nogil=True, cache=True)
def choose_diagonals(nodes, new_nodes, face_nodes, side_node, heights, aspect, rule, seed):
    """Choose the diagonal of rule 2 in every face with two broken sides.

    Parameters
    ----------
    rule : int
        0: the shorter; 1: at random from `seed`; 2: the one nearer to the posts' surface.

    Returns
    -------
    bool (n_face,)
        True for the diagonal from the break of the first broken side, see `vpfx.methods.cut`.
    """
    n_face, n = len(face_nodes), len(nodes)
    flip = np.zeros(n_face, np.bool_)
    for face in range(n_face):
        m = side_node[3 * face : 3 * face + 3]
        if (m[0] != NONE) + (m[1] != NONE) + (m[2] != NONE) != 2:
            continue
        i = 0
        while m[i] == NONE or m[(i + 1) % 3] == NONE:
            i += 1
        a, b = face_nodes[face, i], m[(i + 1) % 3]
        c, d = m[i], face_nodes[face, (i + 2) % 3]
        if rule == 1:
            flip[face] = _mixed(seed, face) & np.uint64(1) == np.uint64(1)
        elif rule == 2:
            flip[face] = _chord_error(heights, nodes, new_nodes, c, d) < _chord_error(heights, nodes, new_nodes, a, b)
        else:
            p, q = new_nodes[b - n], new_nodes[c - n]
            plain = ((nodes[a, 0] - p[0]) * aspect) ** 2 + (nodes[a, 1] - p[1]) ** 2
            other = ((nodes[d, 0] - q[0]) * aspect) ** 2 + (nodes[d, 1] - q[1]) ** 2
            flip[face] = other < plain
    return flip


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
def find_significant(nodes, face_nodes, side_twin, heights, aspect, tolerance, away, share, state, found):
    """Look at every edge once for its most significant point, as the paper does.

    Parameters
    ----------
    tolerance : float
        A point is significant if it is off by more than this, metres.
    away : float
        Points nearer than this to an end of the edge are not looked at, in heights of a post spacing.
    share : float
        The same as a share of the edge's length.
    state, found
        Changed in place as by `choose_breaks`.
    """
    side_error, side_along, _, _, _, _ = found
    for side in range(3 * len(face_nodes)):
        twin = side_twin[side]
        if state[side] != OPEN or (twin != NONE and twin < side):
            continue
        a, b = face_nodes[side // 3, side % 3], face_nodes[side // 3, (side % 3 + 1) % 3]
        east, north = nodes[b, 0] - nodes[a, 0], nodes[b, 1] - nodes[a, 1]
        along_east = abs(east) >= abs(north)
        is_forward = east > 0 if along_east else north > 0
        start, end = (a, b) if is_forward else (b, a)
        length = np.sqrt((east * aspect) ** 2 + north * north)
        at = _most_significant(heights, nodes[start], nodes[end], tolerance, max(share, away / length))
        if not np.isnan(at):
            state[side] = BROKEN
            side_error[side] = np.inf
            side_along[side] = at if is_forward else 1.0 - at
            if twin != NONE:
                side_error[twin] = 0.0
