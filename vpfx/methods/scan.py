"""Vertical errors of posts against faces: the kernels that read every post of a face.

All places are in posts of the patch: u is the column, v the row. ``aspect`` turns u into units of v for lengths.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vpfx.topology import NONE

__all__ = [
    "PLAIN",
    "Candidates",
    "ScanRule",
    "candidates",
    "columns_of",
    "find_worst",
    "heights_at",
    "measure",
    "place_sides",
    "rows_of",
    "scan_faces",
    "scan_mesh",
    "surface_height",
]

# A post this near a face's edge counts as inside, in posts: no post may fall between two faces by rounding.
EDGE_SLACK = 1e-9


class ScanRule(NamedTuple):
    """Which posts count for what.

    Attributes
    ----------
    band : float
        Half width of the band round an edge in which posts count for the edge, heights of a post spacing.
    end_share : float
        Posts whose foot is nearer than this share of the edge to its ends do not count for the edge.
    inner_share : float
        A post counts as inside for rule 4 if its least barycentric share is at least this ...
    inner_away : float
        ... and it is so far from every edge, heights of a post spacing.
    """

    band: float
    end_share: float
    inner_share: float
    inner_away: float


PLAIN = ScanRule(band=-1.0, end_share=0.0, inner_share=1.0, inner_away=0.0)  # errors only
NO_TWINS = np.empty(0, np.int32)  # errors do not hang on neighbours


class Candidates(NamedTuple):
    """What a scan of some faces found: places where a mesh is off by more than the bound.

    Attributes
    ----------
    slot : int32 (n_face,)
        Place of each face of the mesh in the arrays below, -1 if it was not scanned.
    side_error : float64 (3 * n_scan,)
        Greatest error over the threshold among the posts in the band of the side, 0 for none.
    face_post : int64 (n_scan,)
        Post of the greatest error in the face, row × n_col + column; -1 for none.
    inner_post : int64 (n_scan,)
        Post in the middle of the face with the greatest error over the threshold, -1 for none.
    """

    slot: np.ndarray
    side_error: np.ndarray
    face_post: np.ndarray
    inner_post: np.ndarray


def candidates(faces: np.ndarray, slot: np.ndarray) -> Candidates:
    """Room for the candidates of some faces, and their places in `slot`."""
    n = len(faces)
    slot[faces] = np.arange(n, dtype=np.int32)
    return Candidates(slot, np.zeros(3 * n), *np.empty((2, n), np.int64))


@njit(nogil=True, cache=True, inline="always")
def surface_height(heights, u, v):
    """Height of the posts' surface at (u, v), metres.

    Bilinear in a square with four valid corners, the plane of three where one is void, else the nearest valid corner;
    continuous over ground with data and equal to the posts at the posts. NaN where no corner is valid.
    """
    col, row = int(np.floor(u)), int(np.floor(v))
    col = (col if col < heights.shape[1] - 2 else heights.shape[1] - 2) if col > 0 else 0
    row = (row if row < heights.shape[0] - 2 else heights.shape[0] - 2) if row > 0 else 0
    x, y = u - col, v - row
    south = heights[row, col] * (1.0 - x) + heights[row, col + 1] * x
    height = south * (1.0 - y) + (heights[row + 1, col] * (1.0 - x) + heights[row + 1, col + 1] * x) * y
    return _height_by_void(heights, row, col, x, y) if np.isnan(height) else height


@njit(nogil=True, cache=True)
def _height_by_void(heights, row, col, x, y):
    """Height in a square with a void corner, see `surface_height`."""
    sw, se = heights[row, col], heights[row, col + 1]
    nw, ne = heights[row + 1, col], heights[row + 1, col + 1]
    n_void = int(np.isnan(sw)) + int(np.isnan(se)) + int(np.isnan(nw)) + int(np.isnan(ne))
    if n_void == 1:  # continue the plane of the three others to the void corner
        if np.isnan(sw):
            sw = se + nw - ne
        elif np.isnan(se):
            se = sw + ne - nw
        elif np.isnan(nw):
            nw = sw + ne - se
        else:
            ne = se + nw - sw
        return (sw * (1.0 - x) + se * x) * (1.0 - y) + (nw * (1.0 - x) + ne * x) * y
    nearest, height = 9.0, np.nan
    for j in range(2):
        for i in range(2):
            corner = heights[row + j, col + i]
            distance = (x - i) ** 2 + (y - j) ** 2
            if not np.isnan(corner) and distance < nearest:
                nearest, height = distance, corner
    return height


@njit(nogil=True, cache=True)
def heights_at(heights, u, v):
    """Heights of the posts' surface at some places, float64 (n,), see `surface_height`."""
    found = np.empty(len(u))
    for i in range(len(u)):
        found[i] = surface_height(heights, u[i], v[i])
    return found


@njit(nogil=True, cache=True, inline="always")
def columns_of(corner, steps, row, n_col):
    """First and last column of the posts of one row inside a face, edges included.

    The slack is one across the edge: along the row it is the larger the flatter the edge, up to the corners.
    """
    low, high = min(corner[0, 0], corner[1, 0], corner[2, 0]), max(corner[0, 0], corner[1, 0], corner[2, 0])
    low, high = low - EDGE_SLACK, high + EDGE_SLACK
    for i in range(3):
        crossing = corner[i, 0] + steps[i, 6] * (row - corner[i, 1])
        slack = EDGE_SLACK * (1.0 + abs(steps[i, 6]))
        if steps[i, 1] < 0.0:  # the inside lies to the west of a northward edge
            high = min(high, crossing + slack)
        elif steps[i, 1] > 0.0:
            low = max(low, crossing - slack)
    first, last = int(np.ceil(low)), int(np.floor(high))
    return first if first > 0 else 0, last if last < n_col - 1 else n_col - 1


@njit(nogil=True, cache=True, inline="always")
def place_sides(corner, steps):
    """Fill what `columns_of` and the cross products need of steps (3, 7), see `_measure_sides`."""
    for i in range(3):
        j = (i + 1) % 3
        east, north = corner[j, 0] - corner[i, 0], corner[j, 1] - corner[i, 1]
        steps[i, 0] = north * corner[i, 0] - east * corner[i, 1]
        steps[i, 1], steps[i, 2] = -north, east
        steps[i, 6] = east / north if north != 0.0 else 0.0


@njit(nogil=True, cache=True, inline="always")
def _measure_sides(area, aspect, band, inner_share, inner_away, steps):
    """Fill the rest of steps (3, 7): what decides whether a post at (col, row) counts for side i.

    cross = steps[i, 0] + steps[i, 1] * col + steps[i, 2] * row is twice the area between side and post, so its distance
    times a length; up to steps[i, 3] the post is in the band, from steps[i, 4] on it is in the middle. steps[i, 5] is
    the squared length, steps[i, 6] how far the side goes east for each row to the north.
    """
    for i in range(3):
        square = (steps[i, 2] * aspect) ** 2 + steps[i, 1] * steps[i, 1]
        width = np.sqrt(square) / aspect
        steps[i, 3] = band * width
        steps[i, 4] = max(inner_share * area, inner_away * width)
        steps[i, 5] = square


@njit(nogil=True, cache=True, inline="always")
def _plane(corner):
    """Twice the area of a face, and how much its plane rises for each column and each row."""
    ax, ay, az = corner[0, 0], corner[0, 1], corner[0, 2]
    bx, by, cx, cy = corner[1, 0], corner[1, 1], corner[2, 0], corner[2, 1]
    rise_b, rise_c = corner[1, 2] - az, corner[2, 2] - az
    area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    east = (rise_b * (cy - ay) - rise_c * (by - ay)) / area
    north = (rise_c * (bx - ax) - rise_b * (cx - ax)) / area
    return area, east, north


@njit(nogil=True, cache=True, inline="always")
def rows_of(corner, n_row):
    """First and last row of posts that a face reaches."""
    south, north = min(corner[0, 1], corner[1, 1], corner[2, 1]), max(corner[0, 1], corner[1, 1], corner[2, 1])
    return max(0, int(np.ceil(south - EDGE_SLACK))), min(n_row - 1, int(np.floor(north + EDGE_SLACK)))


@njit(nogil=True, cache=True)
def scan_faces(faces, mesh, heights, residual, threshold, aspect, rule, face_error, found):
    """Compare some faces with their posts.

    Parameters
    ----------
    faces : int32 (n_scan,)
    mesh : tuple
        `Forest.mesh`.
    heights : float64 (n_row, n_col)
        Metres; NaN posts are passed over.
    residual : float64 (n_row, n_col)
        Takes the vertical error of every post looked at, metres.
    threshold : float
        Errors up to this are none for edges and middles, metres.
    aspect : float
        Width of a post spacing divided by its height.
    rule : tuple
        A `ScanRule`: which posts count for an edge and which for the middle of a face.
    face_error : float64 (n_face,)
        Takes the greatest error in each face, metres.
    found : tuple
        `Candidates`, changed in place. Both as plain tuples: numba takes longer to open named ones than most calls run.

    Notes
    -----
    Cost: O(posts of the faces looked at).
    """
    n_row, n_col = heights.shape
    nodes, face_nodes, _ = mesh
    _, side_error, face_post, inner_post = found
    band, least, inner_share, inner_away = rule
    corner, steps = np.empty((3, 3)), np.empty((3, 7))
    for k in range(len(faces)):
        face = faces[k]
        for i in range(3):
            for j in range(3):
                corner[i, j] = nodes[face_nodes[face, i], j]
        area, east, north = _plane(corner)
        place_sides(corner, steps)
        _measure_sides(area, aspect, band, inner_share, inner_away, steps)
        worst, worst_post, inner, inner_at = 0.0, NONE, threshold, NONE
        south, top = rows_of(corner, n_row)
        for row in range(south, top + 1):
            first, last = columns_of(corner, steps, row, n_col)
            base = corner[0, 2] + north * (row - corner[0, 1]) - east * corner[0, 0]
            for col in range(first, last + 1):
                error = abs(heights[row, col] - (base + east * col))
                residual[row, col] = error
                if error > worst:  # never for NaN
                    worst, worst_post = error, row * n_col + col
                if error > threshold:
                    is_inner = True
                    for i in range(3):
                        cross = steps[i, 0] + steps[i, 1] * col + steps[i, 2] * row
                        is_inner = is_inner and cross >= steps[i, 4]
                        side = 3 * k + i
                        if cross <= steps[i, 3] and error > side_error[side]:
                            u, v = (col - corner[i, 0]) * aspect**2, row - corner[i, 1]
                            along = (u * steps[i, 2] - v * steps[i, 1]) / steps[i, 5]
                            if least <= along <= 1.0 - least:
                                side_error[side] = error
                    if is_inner and error > inner:
                        inner, inner_at = error, row * n_col + col
        face_error[face], face_post[k], inner_post[k] = worst, worst_post, inner_at


def scan_mesh(
    nodes: NDArray[np.float64],
    face_nodes: NDArray[np.int32],
    heights: NDArray[np.float64],
    residual: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Compare all faces of a mesh with their posts.

    Parameters
    ----------
    nodes : float64 (n_node, 3)
        In posts; heights in metres.
    face_nodes : int32 (n_face, 3)
    heights, residual
        As for `scan_faces`.

    Returns
    -------
    error : float64 (n_face,)
        Greatest vertical error in or on each face, metres; 0 without a valid post.
    post : int64 (n_face,)
        Where that is, -1 if nowhere.

    Examples
    --------
    >>> nodes, heights = np.array([[0.0, 0, 0], [2, 0, 0], [0, 2, 0]]), np.zeros((3, 3))
    >>> heights[0, 1] = 5.0
    >>> scan_mesh(nodes, np.array([[0, 1, 2]], np.int32), heights, np.empty((3, 3)))
    (array([5.]), array([1]))
    """
    faces = np.arange(len(face_nodes), dtype=np.int32)
    found, error = candidates(faces, np.full(len(faces), NONE, np.int32)), np.empty(len(faces))
    mesh = nodes, face_nodes, NO_TWINS
    scan_faces(faces, mesh, heights, residual, np.inf, 1.0, tuple(PLAIN), error, tuple(found))
    return error, found.face_post


@njit(nogil=True, cache=True)
def find_worst(faces, nodes, face_nodes, heights, residual):
    """Find how far above every post some faces are, metres; where faces differ, that which is farthest off counts.

    Parameters
    ----------
    residual : float64 (n_row, n_col)
        Takes surface less post; NaN for posts in none of the faces.
    """
    n_row, n_col = heights.shape
    corner, steps = np.empty((3, 3)), np.empty((3, 7))
    residual[:] = np.nan
    for face in faces:
        for i in range(3):
            for j in range(3):
                corner[i, j] = nodes[face_nodes[face, i], j]
        _, east, north = _plane(corner)
        place_sides(corner, steps)
        south, top = rows_of(corner, n_row)
        for row in range(south, top + 1):
            first, last = columns_of(corner, steps, row, n_col)
            base = corner[0, 2] + north * (row - corner[0, 1]) - east * corner[0, 0]
            for col in range(first, last + 1):
                error = base + east * col - heights[row, col]
                if not abs(error) <= abs(residual[row, col]):
                    residual[row, col] = error


@njit(nogil=True, cache=True)
def measure(residual, is_owned):
    """Greatest error, sum of squared errors and number of the posts that are owned, in row order."""
    worst, squares, count = 0.0, 0.0, 0
    n_row, n_col = residual.shape
    for row in range(n_row):
        for col in range(n_col):
            if is_owned[row, col]:
                worst = max(worst, abs(residual[row, col]))
                squares += residual[row, col] ** 2
                count += 1
    return worst, squares, count
