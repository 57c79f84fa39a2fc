"""Ground with data: which half squares of the post lattice a mesh may cover, and their outline.

Ground with data is the union of the lattice triangles whose three corners are valid posts (specs/methods.md M-300). A
square with four valid corners is covered whole, one with three by the triangle of these three, any other not at all.
Its outline runs along lattice edges and diagonals, so it follows every void to within a post.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = [
    "corners_on_ground",
    "distances",
    "inner_posts",
    "is_covered",
    "outline_nodes",
    "outline_segments",
    "square_codes",
]

Mask = NDArray[np.bool_]

# Octants round a post, counter-clockwise from east: each lies in one square, on one side of one diagonal of it.
# (row and column of the square relative to the post, corner of the square that the octant's lattice triangle lacks when
# the square is cut): corner numbers are bits of the code: 0 = SW, 1 = SE, 2 = NW, 3 = NE.
_FULL = 15
_SQUARES = ((0, 0), (0, -1), (-1, -1), (-1, 0))  # north-east, north-west, south-west, south-east of the post
_OWN_CORNER = (0, 1, 3, 2)  # the post is this corner of that square
_FIRST_CORNER = (1, 3, 2, 0)  # the corner met first when turning counter-clockwise through the square
_LAST_CORNER = (2, 0, 1, 3)


def square_codes(is_valid: Mask) -> NDArray[np.uint8]:
    """Code of every lattice square: which of its corners span ground.

    Parameters
    ----------
    is_valid : bool (n_row, n_col)
        Valid posts, row 0 in the south.

    Returns
    -------
    uint8 (n_row - 1, n_col - 1)
        Bits 1 SW, 2 SE, 4 NW, 8 NE of the valid corners where at least three are valid, else 0.

    Examples
    --------
    >>> square_codes(np.array([[True, True, False], [True, True, True]])).tolist()
    [[15, 13]]
    """
    valid = is_valid.astype(np.uint8)
    corners = valid[:-1, :-1], valid[:-1, 1:], valid[1:, :-1], valid[1:, 1:]
    code = sum(corner << bit for bit, corner in enumerate(corners))
    return np.where(sum(corners) >= 3, code, 0).astype(np.uint8)


def corners_on_ground(squares: NDArray[np.uint8]) -> Mask:
    """Tell which posts touch covered ground: bool (n_row, n_col)."""
    n_row, n_col = squares.shape
    touched = np.zeros((n_row + 1, n_col + 1), bool)
    for bit, (row, col) in enumerate(((0, 0), (0, 1), (1, 0), (1, 1))):
        touched[row : row + n_row, col : col + n_col] |= (squares >> bit & 1).astype(bool)
    return touched


def _octants(squares: NDArray[np.uint8]) -> Mask:
    """Coverage of the eight octants round each post, counter-clockwise from east: bool (8, n_row, n_col)."""
    n_row, n_col = squares.shape
    padded = np.zeros((n_row + 2, n_col + 2), np.uint8)
    padded[1:-1, 1:-1] = squares
    octants = np.empty((8, n_row + 1, n_col + 1), bool)
    for quadrant, (row, col) in enumerate(_SQUARES):
        code = padded[1 + row : n_row + 2 + row, 1 + col : n_col + 2 + col]
        has = [(code >> bit & 1).astype(bool) for bit in range(4)]
        own, first, last = (corner[quadrant] for corner in (_OWN_CORNER, _FIRST_CORNER, _LAST_CORNER))
        opposite = 3 - own
        # without its opposite corner a square is the triangle own-first-last, which fills both octants at the post
        octants[2 * quadrant] = has[own] & has[first] & (has[last] | has[opposite])
        octants[2 * quadrant + 1] = has[own] & has[last] & (has[first] | has[opposite])
    return octants


def inner_posts(squares: NDArray[np.uint8]) -> Mask:
    """Tell which posts have covered ground all round: bool (n_row, n_col)."""
    return np.asarray(_octants(squares).all(axis=0), bool)


def outline_nodes(squares: NDArray[np.uint8]) -> Mask:
    """Posts at which the outline of the ground bends or touches itself.

    Parameters
    ----------
    squares : uint8 (n_row - 1, n_col - 1)
        Codes by `square_codes`; everything beyond them counts as not covered.

    Returns
    -------
    bool (n_row, n_col)

    Examples
    --------
    >>> outline_nodes(np.full((1, 2), 15, np.uint8)).astype(int).tolist()
    [[1, 0, 1], [1, 0, 1]]
    """
    octants = _octants(squares)
    count = octants.sum(axis=0)
    starts = (octants & ~np.roll(octants, 1, axis=0)).sum(axis=0)
    is_straight = (starts == 1) & (count == 4)
    return (starts > 0) & ~is_straight


def outline_segments(squares: NDArray[np.uint8], is_node: Mask) -> NDArray[np.int32]:
    """Straight pieces of the outline of the ground between the given nodes.

    Parameters
    ----------
    squares : uint8 (n_row - 1, n_col - 1)
    is_node : bool (n_row, n_col)
        At least the posts of `outline_nodes`.

    Returns
    -------
    int32 (n_segment, 2, 2)
        (row, column) of both ends of each piece.
    """
    octants = _octants(squares)
    found = []
    # unit edges that leave a post to the east, north-east, north, north-west: octant after and before the direction
    for octant, (row_step, col_step) in enumerate(((0, 1), (1, 1), (1, 0), (1, -1))):
        is_edge = octants[octant] != octants[octant - 1]
        row, col = np.nonzero(is_edge)
        line, along = (row, col) if row_step == 0 else (col * row_step - row * col_step, row)
        order = np.lexsort((along, line))
        row, col, line, along = row[order], col[order], line[order], along[order]
        follows = np.zeros(len(row), bool)
        follows[1:] = (line[1:] == line[:-1]) & (along[1:] == along[:-1] + 1)
        is_start = ~follows | is_node[row, col]
        is_end = np.ones(len(row), bool)
        is_end[:-1] = is_start[1:]
        ends = np.stack([row[is_end] + row_step, col[is_end] + col_step], axis=1)
        found.append(np.stack([np.stack([row[is_start], col[is_start]], axis=1), ends], axis=1))
    return np.concatenate(found).astype(np.int32)


def is_covered(squares: NDArray[np.uint8], u: NDArray[np.float64], v: NDArray[np.float64]) -> Mask:
    """Tell which places (u, v), in posts, lie on ground with data; places on its outline may go either way."""
    n_row, n_col = squares.shape
    col = np.clip(np.floor(u).astype(np.int64), 0, n_col - 1)
    row = np.clip(np.floor(v).astype(np.int64), 0, n_row - 1)
    code = squares[row, col]
    x, y = u - col, v - row
    inside = [x + y >= 1, y >= x, y <= x, x + y <= 1]  # of the triangle that lacks corner SW, SE, NW, NE
    covered = code == _FULL
    for bit, is_inside in enumerate(inside):
        covered |= (code == _FULL - (1 << bit)) & is_inside
    return covered


@njit(nogil=True, cache=True)
def distances(is_node, most):
    """Distance of every post to the nearest node, counted in king's moves and cut off at `most`: int32 (n_row, n_col)."""
    n_row, n_col = is_node.shape
    out = np.full((n_row + 2, n_col + 2), most, np.int32)
    for row in range(n_row):
        for col in range(n_col):
            if is_node[row, col]:
                out[row + 1, col + 1] = 0
    for row in range(1, n_row + 1):
        for col in range(1, n_col + 1):
            near = min(out[row - 1, col - 1], out[row - 1, col], out[row - 1, col + 1], out[row, col - 1])
            out[row, col] = min(out[row, col], near + 1)
    for row in range(n_row, 0, -1):
        for col in range(n_col, 0, -1):
            near = min(out[row + 1, col - 1], out[row + 1, col], out[row + 1, col + 1], out[row, col + 1])
            out[row, col] = min(out[row, col], near + 1)
    return out[1:-1, 1:-1]
