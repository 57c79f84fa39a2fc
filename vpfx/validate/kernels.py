"""Kernels of the rules: whole levels at a time, each in time that grows with what it looks at."""

from __future__ import annotations

import numpy as np
from numba import njit

__all__ = [
    "expected_links",
    "face_at_edges",
    "find_dense",
    "judge_corners",
    "judge_sides",
    "measure_posts",
    "measure_rises",
    "measure_slopes",
    "measure_tiles",
    "walk_chains",
    "walk_slits",
]

MISSING = -1


@njit(nogil=True, cache=True, error_model="numpy")
def find_dense(ids, wanted, index):
    """Fill places of numbers in ascending ones by a table of all between first and last; -1 where there is none."""
    low = ids[0]
    table = np.full(ids[-1] - low + 1, MISSING, np.int32)
    for i in range(len(ids)):
        table[ids[i] - low] = i
    for i in range(len(wanted)):
        is_between = wanted[i] >= low and wanted[i] <= ids[-1]
        index[i] = table[wanted[i] - low] if is_between else MISSING


@njit(nogil=True, cache=True, error_model="numpy")
def judge_sides(face_nodes, face_edges, edge_nodes, edge_faces, turn, wrong_side, wrong_face):
    r"""Compare edges and faces: each side of a face is an edge that joins its nodes and has the face on that hand.

    ::

        c           edge_faces[e] = (left, right). Side i of a face runs from node i to the next. Counter-clockwise, so
        | \        the face lies to the left of each side: to the left of an edge that runs the same way, else to the
        |  \       right. A face that turns the other way has its own finding: its hands are exchanged here.
        a---b

    Parameters
    ----------
    face_nodes, face_edges : int32 (n_face, 3)
    edge_nodes, edge_faces : int32 (n_edge, 2)
        Start and end; left and right face, -1 for none.
    turn : int8 (n_face,)
        By `vpfx.geometry.face_turns`.
    wrong_side : bool (n_face, 3)
        Takes whether an edge does not join the nodes of the side.
    wrong_face : bool (n_face, 3)
        Takes whether the edge joins them, but does not have the face on its hand.
    """
    for face in range(len(face_nodes)):
        for i in range(3):
            start, end = face_nodes[face, i], face_nodes[face, (i + 1) % 3]
            edge = face_edges[face, i]
            is_same = edge_nodes[edge, 0] == start and edge_nodes[edge, 1] == end
            is_other = edge_nodes[edge, 0] == end and edge_nodes[edge, 1] == start
            wrong_side[face, i] = not (is_same or is_other)
            hand = 0 if is_same else 1
            if turn[face] < 0:
                hand = 1 - hand
            is_there = edge_faces[edge, hand] == face
            if turn[face] == 0:
                is_there = edge_faces[edge, 0] == face or edge_faces[edge, 1] == face
            wrong_face[face, i] = not wrong_side[face, i] and not is_there


@njit(nogil=True, cache=True, error_model="numpy")
def face_at_edges(face_edges, edge_faces, side):
    """Fill which side of its left and right face each edge is, int8 (n_edge, 2): -1 if there is no face or it is none."""
    for edge in range(len(edge_faces)):
        for hand in range(2):
            side[edge, hand] = -1
            face = edge_faces[edge, hand]
            if face >= 0:
                for i in range(3):
                    if face_edges[face, i] == edge:
                        side[edge, hand] = i


@njit(nogil=True, cache=True, error_model="numpy")
def walk_slits(long, end, follower, goal, short, owner, is_closed):
    """Walk along the short sides beside long ones, from the end of each to its start, and list them.

    ::

        goal ------------- long ------------►          short, next, …: `follower` leads from each to the one behind
             ◄---- next --- node ◄-- short --          it, on the other side of the slit

    Parameters
    ----------
    long : int64 (n_long,)
        Sides whose follower is shorter and leaves the same way.
    end, follower : int64 (n,)
    goal : int64 (n_long,)
        Start of each long side.
    short, owner : int64 (room,)
        Take sides and the numbers of the long ones; the walk ends where there is no more room.
    is_closed : bool (n_long,)
        Takes whether the short sides lead to the goal.

    Returns
    -------
    int
        Number of short sides.
    """
    count = 0
    for i in range(len(long)):
        side = follower[long[i]]
        while side >= 0 and count < len(short) and not is_closed[i]:
            short[count], owner[count] = side, i
            count += 1
            is_closed[i] = end[side] == goal[i]
            side = follower[side]
    return count


@njit(nogil=True, cache=True, error_model="numpy")
def expected_links(face_edges, edge_faces, edge_sides, link):
    """Fill the next edge round start and end of every edge that has a face on that hand, int32 (n_edge, 2).

    Counter-clockwise round the start the left face is swept first, round the end the right face; either is left by the side
    before.
    """
    for edge in range(len(edge_faces)):
        for hand in range(2):
            face, side = edge_faces[edge, hand], edge_sides[edge, hand]
            if face >= 0 and side >= 0:
                link[edge, hand] = face_edges[face, (side + 2) % 3]


@njit(nogil=True, cache=True, error_model="numpy")
def measure_slopes(places, face_nodes, metres, slack, found):
    """Measure slope and aspect of faces, and how far rounding of places may carry them.

    Parameters
    ----------
    places : float64 (n_node, 3)
        In post spacings; heights in metres.
    face_nodes : int32 (n_face, 3)
    metres : float64 (n_face, 2)
        Size of a post spacing in the tile of each face.
    slack : float64 (3,)
        Post spacings by which a place may be off, east and north; metres by which a height may.
    found : float64 (n_face, 4)
        Takes slope, its slack, aspect (NaN for level ground) and its slack: hundredths of a degree.

    Notes
    -----
    The rise in a direction is a height times a length by the area. A place that is off by d changes the area by up to d times
    the perimeter, so the rise by that part of itself; and products of heights and lengths round. Where rounding may take the
    whole area, any rise may have been.
    """
    for face in range(len(face_nodes)):
        a, b, c = face_nodes[face]
        width, height = metres[face]
        x1, y1 = (places[b, 0] - places[a, 0]) * width, (places[b, 1] - places[a, 1]) * height
        x2, y2 = (places[c, 0] - places[a, 0]) * width, (places[c, 1] - places[a, 1]) * height
        z1, z2 = places[b, 2] - places[a, 2], places[c, 2] - places[a, 2]
        area = x1 * y2 - x2 * y1
        east, north = (z1 * y2 - z2 * y1) / area, (z2 * x1 - z1 * x2) / area
        steepness = np.hypot(east, north)
        perimeter = np.hypot(x1, y1) + np.hypot(x2, y2) + np.hypot(x2 - x1, y2 - y1)
        off = max(slack[0] * width, slack[1] * height)
        share = off * perimeter / area
        reach = 4.0 * (steepness * share + (off + 1e-15 * perimeter) * (abs(z1) + abs(z2)) / area)
        reach = (reach + 4.0 * slack[2] * perimeter / area) / (1.0 - share) if share < 1.0 else np.inf
        found[face, 0] = 100.0 * np.degrees(np.arctan(steepness))
        least = np.arctan(steepness - min(reach, steepness))
        most = np.arctan(steepness + reach)
        found[face, 1] = 100.0 * np.degrees(max(np.arctan(steepness) - least, most - np.arctan(steepness))) + 1e-6
        direction = np.degrees(np.arctan2(-east, -north)) if steepness > 0.0 else np.nan
        found[face, 2] = 100.0 * (direction + 360.0 if direction < 0.0 else direction)
        found[face, 3] = 100.0 * (np.degrees(np.arcsin(reach / steepness)) if reach < steepness else 180.0) + 1e-6


@njit(nogil=True, cache=True, error_model="numpy")
def walk_chains(key, last, following, begin, corners, n_node, is_good):
    """Walk round the outer sides of the children of each parent, and judge whether they pass its corners in order.

    Parameters
    ----------
    key : int64 (n_side,)
        Parent · n_node + first node of each outer side, ascending; those of a parent stand together.
    last : int64 (n_side,)
        Last node of each.
    following : int64 (n_side,)
        The first side of the same parent that begins there, -1 if none does.
    begin : int64 (n_face,)
        Where the side that begins at the first corner of each parent would stand.
    corners : int64 (n_face, 3)
    is_good : bool (n_face,)
        Takes whether the sides of the parent are one chain, each passed once.
    """
    at = 0
    for face in range(len(corners)):
        count = 0
        while at + count < len(key) and key[at + count] // n_node == face:
            count += 1
        side, passed, n_corner, is_sound = begin[face], 0, 0, count > 0
        while is_sound and passed < count:
            is_sound = side >= at and side < at + count
            if is_sound:
                passed += 1
                n_corner += last[side] == corners[face, (n_corner + 1) % 3]
                is_sound = (last[side] == corners[face, 0]) == (passed == count)
                side = following[side]
        is_good[face] = is_sound and n_corner == 3 and key[begin[face]] == face * n_node + corners[face, 0]
        at += count


@njit(nogil=True, cache=True, error_model="numpy")
def judge_corners(nodes, parents, children, away):
    """Measure how far the corners of children lie outside their parents, CRS units; 0 or less if they do not.

    Parameters
    ----------
    nodes : float64 (n_node, 3)
    parents, children : int32 (n, 3)
        Corners.
    away : float64 (n,)
    """
    for k in range(len(parents)):
        worst = -np.inf
        for i in range(3):
            a, b = parents[k, i], parents[k, (i + 1) % 3]
            east, north = nodes[b, 0] - nodes[a, 0], nodes[b, 1] - nodes[a, 1]
            length = np.hypot(east, north)
            for j in range(3):
                c = children[k, j]
                cross = north * (nodes[c, 0] - nodes[a, 0]) - east * (nodes[c, 1] - nodes[a, 1])
                if length > 0.0:
                    worst = max(worst, cross / length)
        away[k] = worst


@njit(nogil=True, cache=True, error_model="numpy")
def measure_rises(nodes, parents, faces, z_parent, reach, off, slack):
    """Measure how far the told heights of the level before are from its faces at the corners of their children.

    Parameters
    ----------
    nodes : float64 (n_node, 3)
    parents, faces : int32 (n_face, 3)
        Corners of the parent of each face, and its own.
    z_parent : float64 (n_node,)
        Heights told, metres.
    reach : float
        CRS units by which a place may be off by rounding.
    off : float64 (n_node,)
        Takes the least distance from any of the parents' planes, or from their edge if the node lies on it, metres.
    slack : float64 (n_node,)
        Takes how far rounding may carry it there, metres.
    """
    for face in range(len(faces)):
        a, b, c = parents[face]
        x1, y1, z1 = nodes[b, 0] - nodes[a, 0], nodes[b, 1] - nodes[a, 1], nodes[b, 2] - nodes[a, 2]
        x2, y2, z2 = nodes[c, 0] - nodes[a, 0], nodes[c, 1] - nodes[a, 1], nodes[c, 2] - nodes[a, 2]
        area = x1 * y2 - x2 * y1
        if not area > 0.0:
            continue
        for j in range(3):
            node = faces[face, j]
            x, y = nodes[node, 0] - nodes[a, 0], nodes[node, 1] - nodes[a, 1]
            to_b, to_c = (x * y2 - x2 * y) / area, (x1 * y - x * y1) / area
            height = nodes[a, 2] + to_b * z1 + to_c * z2
            distance = abs(height - z_parent[node])
            for i in range(3):
                p, q = parents[face, i], parents[face, (i + 1) % 3]
                east, north = nodes[q, 0] - nodes[p, 0], nodes[q, 1] - nodes[p, 1]
                length = np.hypot(east, north)
                u, v = nodes[node, 0] - nodes[p, 0], nodes[node, 1] - nodes[p, 1]
                if abs(u * north - v * east) <= 4.0 * reach * length:
                    along = (u * east + v * north) / (length * length)
                    on_edge = nodes[p, 2] + along * (nodes[q, 2] - nodes[p, 2])
                    distance = min(distance, abs(on_edge - z_parent[node]))
            if distance < off[node]:
                off[node] = distance
                steep = np.hypot(z1 * y2 - z2 * y1, z2 * x1 - z1 * x2) / area
                slack[node] = min(4.0 * reach * steep, abs(z1) + abs(z2))


@njit(nogil=True, cache=True, error_model="numpy")
def measure_posts(places, face_nodes, is_filled, heights, on_line, error, void_of):
    r"""Measure the vertical errors of faces at the posts in and on them; where faces differ the greatest counts.

    Row by row: where it enters and leaves the face, by the edges, so that no height is extrapolated::

            c
           / \           low and high are where the row crosses two edges; posts between them lie in the face, and their
      row ⋅⋅⋅⋅⋅⋅         heights between those of the crossings
         /     \
        a-------b

    Parameters
    ----------
    places : float64 (n_node, 3)
        In post spacings; heights in metres.
    face_nodes : int32 (n_face, 3)
    is_filled : bool (n_face,)
        Faces that no post judges.
    heights : float64 (n_row, n_col)
    on_line : float
        Post spacings within which a post lies on an edge.
    error : float64 (n_row, n_col)
        Takes the errors, metres; NaN at first, and where there is no valid post or no face.
    void_of : int64 (n_face,)
        Takes a post without height inside the face, -1 at first.
    """
    n_row, n_col = heights.shape
    for face in range(len(face_nodes)):
        if is_filled[face]:
            continue
        south, north = np.inf, -np.inf
        for i in range(3):
            south, north = min(south, places[face_nodes[face, i], 1]), max(north, places[face_nodes[face, i], 1])
        for row in range(max(0, int(np.ceil(south - on_line))), min(n_row - 1, int(np.floor(north + on_line))) + 1):
            low, high, z_low, z_high = np.inf, -np.inf, 0.0, 0.0
            for i in range(3):
                p, q = face_nodes[face, i], face_nodes[face, (i + 1) % 3]
                rise = places[q, 1] - places[p, 1]
                for end in range(2):
                    part = float(end)
                    if abs(rise) > on_line:
                        part = (row - places[p, 1]) / rise
                        if part < -on_line / abs(rise) or part > 1.0 + on_line / abs(rise):
                            continue
                        part = min(1.0, max(0.0, part))
                    elif abs(row - places[p, 1]) > on_line:
                        continue
                    u = places[p, 0] + part * (places[q, 0] - places[p, 0])
                    z = places[p, 2] + part * (places[q, 2] - places[p, 2])
                    if u < low:
                        low, z_low = u, z
                    if u > high:
                        high, z_high = u, z
            if low > high:
                continue
            for col in range(max(0, int(np.ceil(low - on_line))), min(n_col - 1, int(np.floor(high + on_line))) + 1):
                if np.isnan(heights[row, col]):
                    if low + on_line < col < high - on_line and south + on_line < row < north - on_line:
                        void_of[face] = row * n_col + col
                    continue
                part = min(1.0, max(0.0, (col - low) / (high - low))) if high - low > on_line else 0.0
                off = abs(z_low + part * (z_high - z_low) - heights[row, col])
                if not off <= error[row, col]:
                    error[row, col] = off


@njit(nogil=True, cache=True, error_model="numpy")
def measure_tiles(nodes, face_nodes, tile, boxes, is_inside, area, perimeter):
    """Compare faces with the extents of their tiles, and add up areas and perimeters tile by tile.

    Parameters
    ----------
    nodes : float64 (n_node, 3)
    face_nodes : int32 (n_face, 3)
    tile : int64 (n_face,)
        Index of the tile of each face.
    boxes : float64 (n_tile, 4)
    is_inside : bool (n_face,)
        Takes whether the face lies in the extent.
    area, perimeter : float64 (n_tile,)
        Take the sums, 0 at first.
    """
    for face in range(len(face_nodes)):
        a, b, c = face_nodes[face]
        box = boxes[tile[face]]
        inside = True
        for node in (a, b, c):
            x, y = nodes[node, 0], nodes[node, 1]
            inside = inside and x >= box[0] and y >= box[1] and x <= box[2] and y <= box[3]
        is_inside[face] = inside
        x1, y1 = nodes[b, 0] - nodes[a, 0], nodes[b, 1] - nodes[a, 1]
        x2, y2 = nodes[c, 0] - nodes[a, 0], nodes[c, 1] - nodes[a, 1]
        area[tile[face]] += (x1 * y2 - x2 * y1) / 2
        perimeter[tile[face]] += np.hypot(x1, y1) + np.hypot(x2, y2) + np.hypot(x2 - x1, y2 - y1)
