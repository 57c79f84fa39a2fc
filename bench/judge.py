"""The judge of the benchmarks: compares any mesh with every post, in numpy, sharing nothing with the builder."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Mesh", "Verdict", "areas", "greatest_degree", "judge"]

NEAR = 1e-8
"""Post spacings by which a post may miss a face and still count as touched: nodes are rounded to CRS units."""

SAMPLES = 1 << 22
"""Posts looked at in one go, about; bounds the memory of the judge."""

Floats = NDArray[np.float64]


class Mesh(NamedTuple):
    """Nodes as column, row (in post spacings, row 0 in the south) and height; faces counter-clockwise."""

    nodes: Floats
    face_nodes: NDArray[np.int32]


class Verdict(NamedTuple):
    """What the judge found: greatest error and root mean square of the errors, metres, valid posts no face touches, fit."""

    max_error: float
    rmse: float
    n_missed: int
    is_cover: bool  # all faces counter-clockwise, and their areas sum up to the extent


def areas(nodes: Floats, face_nodes: NDArray[np.int32]) -> Floats:
    """Area of each face in squares of posts; negative if clockwise."""
    a, b, c = (nodes[face_nodes[:, i], :2] for i in range(3))
    return ((b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (c[:, 0] - a[:, 0]) * (b[:, 1] - a[:, 1])) / 2


def judge(mesh: Mesh, heights: Floats) -> Verdict:
    """Compare a mesh with every post in or on its faces, in numpy and in pieces."""
    area = areas(mesh.nodes, mesh.face_nodes)
    extent = (heights.shape[0] - 1.0) * (heights.shape[1] - 1.0)
    corners = mesh.nodes[mesh.face_nodes]
    box = corners[..., :2].max(axis=1) - corners[..., :2].min(axis=1)
    load = np.cumsum((box + 1).prod(axis=1))
    error = np.full(heights.shape, np.nan)
    is_touched = np.zeros(heights.shape, bool)
    for part in np.split(corners, np.searchsorted(load, np.arange(SAMPLES, load[-1], SAMPLES))):
        col, row, height = sample(part, heights.shape)
        is_touched[row, col] = True
        np.fmax.at(error, (row, col), np.abs(height - heights[row, col]))
    is_cover = bool((area > 0).all() and abs(area.sum() - extent) <= 1e-9 * extent)
    n_missed = int((np.isfinite(heights) & ~is_touched).sum())
    return Verdict(float(np.nanmax(error)), float(np.sqrt(np.nanmean(error**2))), n_missed, is_cover)


def sample(corners: Floats, shape: tuple[int, ...]) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats]:
    """Find the posts in or on each face, and the height of the face there.

    Parameters
    ----------
    corners : float64 (n_face, 3, 3)
        Column, row and height of the corners.
    shape : tuple of int
        Numbers of rows and columns of the posts.
    """
    col, row, height = np.moveaxis(corners, 2, 0)
    face, at_row = spread(row.min(axis=1), row.max(axis=1), shape[0])
    # the stretch of the row inside the face ends where the row crosses its sides
    from_row, to_row = row[face], np.roll(row, -1, axis=1)[face]
    from_col, to_col = col[face], np.roll(col, -1, axis=1)[face]
    line = at_row[:, None]
    is_crossed = (np.minimum(from_row, to_row) - NEAR <= line) & (line <= np.maximum(from_row, to_row) + NEAR)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.clip(np.nan_to_num((line - from_row) / (to_row - from_row)), 0.0, 1.0)
    crossing = from_col + share * (to_col - from_col)
    west = np.where(is_crossed, crossing, np.inf).min(axis=1)
    stretch, at_col = spread(west, np.where(is_crossed, crossing, -np.inf).max(axis=1), shape[1])
    face, at_row = face[stretch], at_row[stretch]
    (p_col, p_row, p_height), (q_col, q_row, q_height) = (
        np.moveaxis(corners[:, i] - corners[:, 0], 1, 0) for i in (1, 2)
    )
    twice = p_col * q_row - q_col * p_row
    east, north = (p_height * q_row - q_height * p_row) / twice, (q_height * p_col - p_height * q_col) / twice
    found = height[face, 0] + east[face] * (at_col - col[face, 0]) + north[face] * (at_row - row[face, 0])
    return at_col, at_row, found


def spread(low: Floats, high: Floats, n: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Whole numbers of 0…n - 1 in each range, as (index of the range, number)."""
    first = np.clip(np.ceil(low - NEAR), 0, n).astype(np.int64)
    count = np.maximum(np.clip(np.floor(high + NEAR), -1, n - 1).astype(np.int64) - first + 1, 0)
    owner = np.repeat(np.arange(len(first)), count)
    return owner, np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count) + first[owner]


def greatest_degree(face_nodes: NDArray[np.int32]) -> int:
    """Edges at the node that has most of them."""
    sides = np.sort(np.concatenate([face_nodes[:, [0, 1]], face_nodes[:, [1, 2]], face_nodes[:, [2, 0]]]), axis=1)
    return int(np.bincount(np.unique(sides, axis=0).ravel()).max())
