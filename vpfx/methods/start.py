"""Start meshes: the coarsest triangles of a patch, before any cut.

* A grid of squares, each cut in two, where the patch has no void.
* The constrained Delaunay triangulation of outline, grid and posts in between, where it has: every triangle lies either on
  ground with data or on ground without.
* The Delaunay triangulation of the most significant posts, if asked for.

All nodes are posts; diagonals of neighbouring squares lean opposite ways (specs/methods.md M-120, M-310, M-130).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pythoncdt
from numpy.typing import NDArray

from vpfx.errors import InvariantError
from vpfx.methods.base import Patch
from vpfx.methods.ground import distances, inner_posts, is_covered, outline_nodes, outline_segments
from vpfx.methods.lines import NO_LINES, Lines

__all__ = ["NOTHING", "Start", "border_nodes_of", "fixed_sides_of", "grid_posts", "start_mesh", "triangulate"]

ASPECT_STEP = 1.0 / 1024  # what the width of a post spacing by its height is rounded to for triangulating


class Start(NamedTuple):
    """A start mesh.

    Attributes
    ----------
    nodes : float64 (n_node, 3)
        u, v in posts, height in metres; those that are no posts stand last.
    face_nodes : int32 (n_face, 3)
        Counter-clockwise.
    is_filled : bool (n_face,)
        Faces on ground without data.
    """

    nodes: NDArray[np.float64]
    face_nodes: NDArray[np.int32]
    is_filled: NDArray[np.bool_]


NOTHING = Start(np.empty((0, 3)), np.empty((0, 3), np.int32), np.empty(0, bool))


def grid_posts(n_post: int, n_square: int) -> NDArray[np.int64]:
    """Posts at which a side of n_post posts is cut into n_square parts, as even as whole posts allow.

    Examples
    --------
    >>> grid_posts(301, 9).tolist()
    [0, 33, 67, 100, 133, 167, 200, 233, 267, 300]
    """
    n_square = max(1, min(n_square, n_post - 1))
    steps = np.arange(n_square + 1, dtype=np.int64)
    return (2 * steps * (n_post - 1) + n_square) // (2 * n_square)


def start_mesh(patch: Patch, n_row: int, n_col: int, n_significant: int = 0) -> Start:
    """Triangles to start from.

    Parameters
    ----------
    patch : Patch
    n_row, n_col : int
        Squares of the grid from south to north and from west to east.
    n_significant : int
        If not 0: start from the Delaunay triangulation of so many most significant posts instead of the grid.

    Returns
    -------
    Start
        It covers just the ground with data, or everything if the patch keeps its voids.

    Raises
    ------
    InvariantError
        The triangulation does not have the sides it was given.
    """
    shape = patch.heights.shape
    rows, cols = grid_posts(shape[0], n_row), grid_posts(shape[1], n_col)
    if not patch.squares.any() and not patch.keeps_voids:
        return NOTHING
    is_border_node = border_nodes_of(patch)
    plain = not n_significant and (patch.squares == 15).all()
    on_grid = np.zeros(shape, bool)
    on_grid[np.ix_(rows, cols)] = True
    if plain and not (is_border_node & ~on_grid).any():
        return _cut_squares(patch, rows, cols)
    if n_significant:
        on_grid[1:-1, 1:-1] = False
        on_grid |= _significant_posts(patch.heights, n_significant)
    spacing = max(1, min(shape[0] // n_row, shape[1] // n_col))
    return triangulate(patch, on_grid, is_border_node, spacing)


def border_nodes_of(patch: Patch, level: int | None = None) -> NDArray[np.bool_]:
    """Posts on fixed borders that are nodes of a level, or of the start mesh."""
    south, east, north, west = patch.borders
    is_node = np.zeros(patch.heights.shape, bool)
    for border, line in ((south, (0, ...)), (north, (-1, ...)), (west, (..., 0)), (east, (..., -1))):
        if border.is_fixed:
            is_node[line] |= border.rank < (border.n_start if level is None else border.limit[level])
    return is_node


def _cut_squares(patch: Patch, rows: NDArray[np.int64], cols: NDArray[np.int64]) -> Start:
    row, col = np.meshgrid(rows, cols, indexing="ij")
    n_col = len(cols)
    j, i = np.meshgrid(np.arange(len(rows) - 1), np.arange(n_col - 1), indexing="ij")
    a = (j * n_col + i).ravel()
    b, c, d = a + 1, a + n_col + 1, a + n_col
    leans = ((i + j) % 2 == 1).ravel()[:, None]
    lower = np.where(leans, np.stack([a, b, d], axis=1), np.stack([a, b, c], axis=1))
    upper = np.where(leans, np.stack([b, c, d], axis=1), np.stack([a, c, d], axis=1))
    faces = np.stack([lower, upper], axis=1).reshape(-1, 3).astype(np.int32)
    return Start(_place_posts(patch, row.ravel(), col.ravel()), faces, np.zeros(len(faces), bool))


def _place_posts(patch: Patch, row: NDArray[np.integer], col: NDArray[np.integer]) -> NDArray[np.float64]:
    """Nodes on posts."""
    return np.stack([col, row, patch.heights[row, col]], axis=1).astype(np.float64)


def _significant_posts(heights: NDArray[np.float64], count: int) -> NDArray[np.bool_]:
    """Mark the `count` inner posts that differ most from the mean of their four neighbours; ties go to the south-west."""
    middle = heights[1:-1, 1:-1]
    around = heights[:-2, 1:-1] + heights[2:, 1:-1] + heights[1:-1, :-2] + heights[1:-1, 2:]
    significance = np.abs(middle - around / 4).ravel()
    significance[np.isnan(significance)] = -1
    best = np.argsort(-significance, kind="stable")[:count]
    inner = np.zeros(middle.size, bool)
    inner[best[significance[best] > 0]] = True
    chosen = np.zeros(heights.shape, bool)
    chosen[1:-1, 1:-1] = inner.reshape(middle.shape)
    return chosen


def _graded_posts(is_outline: NDArray[np.bool_], spacing: int) -> NDArray[np.bool_]:
    """Posts in between outline and grid: at distance d ≥ 2 on the lattice of twice the power of two up to d (M-310)."""
    distance = distances(is_outline, 2 * spacing)
    step = 2 << np.floor(np.log2(np.maximum(distance, 1))).astype(np.int64)
    row, col = np.ogrid[: distance.shape[0], : distance.shape[1]]
    return (distance >= 2) & (distance < spacing) & (row % step == 0) & (col % step == 0)


def triangulate(
    patch: Patch, on_grid: NDArray[np.bool_], is_node: NDArray[np.bool_], spacing: int, lines: Lines = NO_LINES
) -> Start:
    """Constrained Delaunay triangulation of outline, borders, grid, lines and the posts in between.

    Parameters
    ----------
    on_grid : bool (n_row, n_col)
        Posts that are nodes where they lie inside the ground or on a free border.
    is_node : bool (n_row, n_col)
        Posts of the ground that are nodes anyway.
    spacing : int
        Posts in between outline and grid are less than so many from the outline.
    lines : Lines
        Prescribed nodes and edges.

    Returns
    -------
    Start
    """
    domain = np.full_like(patch.squares, 15) if patch.keeps_voids else patch.squares
    is_side = np.zeros(on_grid.shape, bool)
    is_side[[0, -1], :] = is_side[:, [0, -1]] = True
    free = is_side & on_grid & ~fixed_sides_of(patch)
    corners = outline_nodes(domain) | (outline_nodes(patch.squares) if patch.keeps_voids else False)
    is_corner = corners | is_node | free
    of_lines = lines.nodes[lines.is_post, 1::-1].astype(np.int64)
    is_corner[of_lines[:, 0], of_lines[:, 1]] = True
    inner = ~is_side & (on_grid | _graded_posts(outline_nodes(patch.squares) & ~is_side, spacing))
    segments = outline_segments(domain, is_corner)
    if patch.keeps_voids:
        segments = np.concatenate([segments, outline_segments(patch.squares, is_corner)])
    on_line = _posts_on(segments, on_grid.shape)
    inner &= ~on_line & ~is_corner & inner_posts(domain)
    row, col = (np.concatenate(both) for both in zip(np.nonzero(is_corner), np.nonzero(inner), strict=True))
    nodes = np.concatenate([_place_posts(patch, row, col), lines.nodes[~lines.is_post]])
    edges = _index_edges(nodes, len(row), segments, lines, on_grid.shape)
    faces = _delaunay(nodes[:, :2], edges, patch.aspect)
    centre = nodes[faces, :2].mean(axis=1)
    has_data = is_covered(patch.squares, centre[:, 0], centre[:, 1])
    if not patch.keeps_voids:
        faces, has_data = faces[has_data], has_data[has_data]
    used = np.unique(faces)
    renumber = np.zeros(len(nodes), np.int32)
    renumber[used] = np.arange(len(used))
    return Start(nodes[used], renumber[faces], ~has_data)


def fixed_sides_of(patch: Patch) -> NDArray[np.bool_]:
    """Posts on fixed borders."""
    south, east, north, west = patch.borders
    fixed = np.zeros(patch.heights.shape, bool)
    fixed[0] |= south.is_fixed
    fixed[-1] |= north.is_fixed
    fixed[:, 0] |= west.is_fixed
    fixed[:, -1] |= east.is_fixed
    return fixed


def _posts_on(segments: NDArray[np.int32], shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Posts on the given lattice segments."""
    on = np.zeros(shape, bool)
    step = np.sign(segments[:, 1] - segments[:, 0])
    count = np.abs(segments[:, 1] - segments[:, 0]).max(axis=1) + 1
    which = np.repeat(np.arange(len(segments)), count)
    along = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    place = segments[which, 0] + along[:, None] * step[which]
    on[place[:, 0], place[:, 1]] = True
    return on


def _index_edges(
    nodes: NDArray[np.float64], n_post: int, segments: NDArray[np.int32], lines: Lines, shape: tuple[int, int]
) -> NDArray[np.int64]:
    """Pairs of nodes: pieces of the outline, and edges of lines; the first n_post nodes are posts."""
    index = np.full(shape, -1, np.int64)
    place = nodes[:n_post, 1::-1].astype(np.int64)
    index[place[:, 0], place[:, 1]] = np.arange(n_post)
    row, col = np.floor(lines.nodes[:, 1::-1]).astype(np.int64).T
    of_line = np.where(lines.is_post, index[row, col], n_post - 1 + np.cumsum(~lines.is_post))
    ends = np.concatenate([index[segments[..., 0], segments[..., 1]], of_line[lines.edges]])
    if (ends < 0).any():
        raise InvariantError("start mesh: found an outline piece without node at its end")
    return np.unique(np.sort(ends, axis=1), axis=0)


def _delaunay(places: NDArray[np.float64], edges: NDArray[np.int64], aspect: float) -> NDArray[np.int32]:
    """Triangles of the constrained Delaunay triangulation on the ground, counter-clockwise, in a canonical order."""
    mesh = pythoncdt.Triangulation(
        pythoncdt.VertexInsertionOrder.AUTO, pythoncdt.IntersectingConstraintEdges.NOT_ALLOWED, 0.0
    )
    width = max(np.round(aspect / ASPECT_STEP), 1.0) * ASPECT_STEP  # few bits: products with places are exact
    mesh.insert_vertices(places * np.array([width, 1.0]))
    mesh.insert_edges(edges.astype(np.uintc))
    mesh.erase_super_triangle()
    faces = mesh.triangles_array()["vertices"].astype(np.int32)
    first = np.argmin(faces, axis=1)
    faces = np.stack([faces[np.arange(len(faces)), (first + i) % 3] for i in range(3)], axis=1)
    return faces[np.lexsort((faces[:, 2], faces[:, 1], faces[:, 0]))]
