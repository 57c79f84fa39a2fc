"""Meshes of the peers and of vpfx over the same posts, for the benchmarks.

pyfqmr weighs lengths in all directions, so it gets places in metres; where the DEM does not say how far apart its posts are,
30 m. It keeps the nodes on the rim, so that its meshes cover the same ground.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyfqmr
from judge import Mesh, areas
from numpy.typing import NDArray
from pydelatin import Delatin

from vpfx.model import Grid, Tin

__all__ = ["mesh_decimated", "mesh_greedy", "mesh_rtin", "mesh_vpfx"]

AGGRESSIVENESS = (7, 9, 11)
"""Of pyfqmr: less is better, but does not come down to few triangles."""

MORE = 1.1
"""Times the triangles asked for, at most, for a mesh to count as decimated to them."""

UNKNOWN_SPACING = 30.0
"""Metres between posts where the DEM has none."""

Floats = NDArray[np.float64]


def mesh_of_tin(tin: Tin, grid: Grid) -> Mesh:
    nodes = (tin.nodes - np.array([grid.x0, grid.y0, 0.0])) / np.array([grid.dx, grid.dy, 1.0])
    return Mesh(nodes, tin.face_nodes)


def mesh_of_posts(col: NDArray[Any], row: NDArray[Any], face_nodes: NDArray[Any], heights: Floats) -> Mesh:
    """Return a mesh whose nodes are posts; clockwise faces (of all or of none) are turned."""
    nodes = np.stack([col, row, heights[row, col]], axis=1).astype(np.float64)
    faces = np.asarray(face_nodes).reshape(-1, 3).astype(np.int32)
    return Mesh(nodes, faces if areas(nodes, faces[:1])[0] > 0 else faces[:, ::-1])


def mesh_greedy(heights: Floats, bound: float) -> Mesh:
    """Mesh posts with pydelatin, which counts rows from the other side."""
    found = Delatin(heights.astype(np.float32), max_error=bound)
    col, row = found.vertices[:, :2].astype(np.int64).T
    return mesh_of_posts(col, len(heights) - 1 - row, found.triangles, heights)


def mesh_rtin(tile: Any, heights: Floats, asked: float) -> Mesh:
    """Mesh a tile of pymartini, made of the heights."""
    vertices, triangles = tile.get_mesh(asked)
    col, row = np.asarray(vertices).reshape(-1, 2).astype(np.int64).T
    return mesh_of_posts(col, row, triangles, heights)


def mesh_vpfx(grid: Grid, bounds: Sequence[float], fit: str | None = None) -> list[Mesh]:
    from vpfx.pipeline import build_hierarchy  # late: it loads numba, which build.py's memory figures must not see

    hierarchy = build_hierarchy(grid, max_error=tuple(bounds), fit=fit)
    return [mesh_of_tin(hierarchy.tin(level), grid) for level in range(len(bounds))]


def mesh_decimated(grid: Grid, n_face: int) -> Mesh:
    """Decimate the triangles of all posts with pyfqmr to so many, as little aggressively as comes down to them."""
    n_row, n_col = grid.heights.shape
    scale = np.array([*(grid.post_metres if grid.post_metres != (1.0, 1.0) else [UNKNOWN_SPACING] * 2), 1.0])
    row, col = np.mgrid[:n_row, :n_col]
    nodes = np.stack([col, row, grid.heights], axis=-1).reshape(-1, 3)
    south_west = (np.arange(n_row - 1)[:, None] * n_col + np.arange(n_col - 1)).ravel()
    corners = south_west[:, None] + np.array([0, 1, n_col + 1, 0, n_col + 1, n_col])
    for aggressiveness in AGGRESSIVENESS:
        simplify = pyfqmr.Simplify()
        simplify.setMesh(nodes * scale, corners.reshape(-1, 3).astype(np.int32))
        simplify.simplify_mesh(n_face, aggressiveness=aggressiveness, preserve_border=True, verbose=False)
        kept, face_nodes, _ = simplify.getMesh()
        if len(face_nodes) <= MORE * n_face:
            return Mesh(kept / scale, np.asarray(face_nodes, np.int32))
    raise SystemExit(f"pyfqmr: comes not down to {n_face} triangles")
