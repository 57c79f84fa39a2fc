"""Prescribed edges: surveyed lines on a fine lattice, cut where they cross, as nodes and edges of a mesh.

Coordinates are rounded to `STEP`, so that floats hold them exactly and no predicate has to round; crossings are nodes of
the same lattice (snap rounding, by GEOS). specs/methods.md M-545.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from rasterio.features import shapes

from vpfx.methods.base import Patch
from vpfx.methods.scan import heights_at

__all__ = ["NO_LINES", "STEP", "Lines", "node_lines"]

STEP = 1.0 / 256
"""Posts: what coordinates of lines are rounded to."""

FULL = 15  # code of a square with four valid corners


class Lines(NamedTuple):
    """Prescribed nodes and edges.

    Attributes
    ----------
    nodes : float64 (n_node, 3)
        u, v in posts, height in metres; no two at one place.
    edges : int32 (n_edge, 2)
        Nodes; no two edges cross or overlap.
    """

    nodes: NDArray[np.float64]
    edges: NDArray[np.int32]

    @property
    def is_post(self) -> NDArray[np.bool_]:
        """Which nodes lie on posts."""
        on: NDArray[np.bool_] = (self.nodes[:, :2] == np.floor(self.nodes[:, :2])).all(axis=1)
        return on


NO_LINES = Lines(np.empty((0, 3)), np.empty((0, 2), np.int32))


def node_lines(patch: Patch) -> Lines:
    """Return the lines of a patch as prescribed nodes and edges.

    Parameters
    ----------
    patch : Patch
        Lines of one vertex are points.

    Returns
    -------
    Lines
        Cut off at the sides of the patch, and a square short of squares with a void. Nodes without a height, and those on
        posts, are on the posts' surface.

    Notes
    -----
    Cost: O(n log n) of vertices and crossings.
    """
    if not patch.lines:
        return NO_LINES
    ground = _ground(patch)
    given = _with_heights(patch)
    is_point = [bool((line[:, :2] == line[0, :2]).all()) for line in given]
    lines = [shapely.linestrings(line) for line, is_one in zip(given, is_point, strict=True) if not is_one]
    clipped = shapely.intersection(shapely.union_all(lines, grid_size=STEP), ground, grid_size=STEP)
    pieces = shapely.get_parts(shapely.union_all([clipped], grid_size=STEP))
    pieces = pieces[shapely.get_type_id(pieces) == shapely.GeometryType.LINESTRING]
    vertex, piece = shapely.get_coordinates(pieces, include_z=True, return_index=True)
    points = np.array([line[0, :3] for line, is_one in zip(given, is_point, strict=True) if is_one]).reshape(-1, 3)
    points[:, :2] = np.round(points[:, :2] / STEP) * STEP
    points = points[shapely.intersects_xy(ground, points[:, :2])]
    vertices = np.concatenate([vertex, points])
    places, first, node = np.unique(vertices[:, :2], axis=0, return_index=True, return_inverse=True)
    follows = np.flatnonzero(piece[1:] == piece[:-1])
    edges = np.sort(np.stack([node.ravel()[follows], node.ravel()[follows + 1]], axis=1), axis=1)
    surface = heights_at(patch.heights, *places.T.copy())
    height = vertices[first, 2]
    found = Lines(np.column_stack([places, height]), np.unique(edges, axis=0).astype(np.int32))
    found.nodes[:, 2] = np.where(np.isnan(height) | found.is_post, surface, height)
    return found


def _with_heights(patch: Patch) -> list[NDArray[np.float64]]:
    """Lines with the heights of the posts' surface where they have none, if any has its own; else without.

    GEOS would make up what is missing from other lines.
    """
    if all(np.isnan(line[:, 2]).all() for line in patch.lines):
        return [line if (line[:, :2] == line[0, :2]).all() else line[:, :2] for line in patch.lines]
    filled = []
    for line in patch.lines:
        surface = heights_at(patch.heights, *np.ascontiguousarray(line[:, :2].T))
        filled.append(np.column_stack([line[:, :2], np.where(np.isnan(line[:, 2]), surface, line[:, 2])]))
    return filled


def _ground(patch: Patch) -> shapely.Geometry:
    """Return the rectangle of a patch without the squares that lack a post, and those beside them."""
    n_row, n_col = patch.squares.shape
    rectangle = shapely.box(0, 0, n_col, n_row)
    lacks = np.pad(patch.squares != FULL, 1)
    if not lacks.any():
        return rectangle
    near = np.zeros((n_row, n_col), np.uint8)
    for row in range(3):
        for col in range(3):
            near |= lacks[row : row + n_row, col : col + n_col]
    voids = [shapely.geometry.shape(shape) for shape, _ in shapes(near, mask=near.astype(bool))]
    return shapely.difference(rectangle, shapely.union_all(voids))
