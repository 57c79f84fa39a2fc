"""Small surfaces by name, a way to put one into a file, and a way to ask what a store holds.

Each is a `Grid`; those of `VOIDS` lack posts. `NO_GROUND` have valid posts, but no three that make a lattice triangle.
"""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from rasterio.transform import from_origin

from vpfx.model import Grid

__all__ = [
    "NODATA",
    "NO_GROUND",
    "SOLID",
    "SURFACES",
    "VOIDS",
    "bounds_of",
    "hills",
    "noise",
    "query",
    "relief_of",
    "write_dem",
]

NODATA = -32767.0


def noise(n_row: int, n_col: int, seed: int = 0) -> Any:
    """Heights with nothing in common, ± 10 m."""
    return np.random.default_rng(seed).uniform(-10.0, 10.0, (n_row, n_col))


def hills(n_row: int, n_col: int, seed: int = 0) -> Any:
    """Slopes with some noise: 100 m of relief."""
    row, col = np.mgrid[0.0:n_row, 0.0:n_col]
    return 20 * np.sin(row / 5) + 20 * np.cos(col / 7) + noise(n_row, n_col, seed)


def _spike() -> Any:
    heights = np.zeros((17, 17))
    heights[7, 9] = 100.0
    return heights


def _without(heights: Any, *windows: Any) -> Any:
    """Return a copy with voids in the given windows."""
    heights = np.array(heights, float)
    for window in windows:
        heights[window] = np.nan
    return heights


def _ring() -> Any:
    """Ground with a round void in the middle, and an island in that."""
    row, col = np.mgrid[-8:9, -8:9]
    away = np.hypot(row, col)
    return np.where((away > 5.5) | (away < 2.5), noise(17, 17, 5), np.nan)


def _almost_void() -> Any:
    """Two squares of ground that meet in one post, far from the sides."""
    heights = np.full((20, 20), np.nan)
    heights[9:11, 9:11], heights[10:12, 10:12] = noise(2, 2, 6), noise(2, 2, 7)
    return heights


def _one_triangle() -> Any:
    heights = np.full((6, 6), np.nan)
    heights[2, 3], heights[3, 3], heights[3, 2] = 1.0, 2.0, 4.0
    return heights


def _isolated() -> Any:
    heights = np.full((6, 6), np.nan)
    heights[::2, ::2] = 3.0
    return heights


ROW, COL = np.mgrid[0.0:17.0, 0.0:17.0]

SOLID = {
    "flat": Grid(np.full((9, 9), 7.0)),
    "ramp": Grid(3.0 * ROW[:9, :12] - 2.0 * COL[:9, :12]),
    "cone": Grid(100.0 - 10.0 * np.hypot(ROW - 8.0, COL - 7.0)),
    "spike": Grid(_spike()),
    "saddle": Grid((ROW - 8.0) * (COL - 8.0)),
    "noise": Grid(noise(17, 14)),
    "cliff": Grid(np.where(COL + ROW / 3.0 > 9.0, 80.0, 0.0)),
    "steps": Grid(10.0 * (COL // 4.0) + 5.0 * (ROW // 3.0)),
    "whole metres": Grid(np.round(noise(15, 15, 1) / 5.0)),
    "2 x 2": Grid(np.array([[0.0, 1.0], [2.0, 9.0]])),
    "3 x 50": Grid(noise(3, 50, 2)),
    "50 x 3": Grid(noise(50, 3, 3)),
    "huge": Grid(1e6 * noise(12, 12, 4), x0=1e9, y0=-1e9, dx=1e4, dy=2e4, post_metres=(1e4, 2e4)),
    "tiny": Grid(1e-6 * noise(12, 12, 4), dx=1e-6, dy=1e-6, post_metres=(1e-6, 1e-6)),
    "lon lat": Grid(noise(13, 12, 5), x0=-114.1, y0=59.9, dx=1 / 1200, dy=1 / 1200, post_metres=(46.5, 93.0)),
}
"""Every post is valid."""

VOIDS = {
    "one void": Grid(_without(noise(11, 11), np.s_[5, 4])),
    "border void": Grid(_without(noise(11, 13, 1), np.s_[0, 4:7], np.s_[8:, 12])),
    "diagonal voids": Grid(_without(noise(11, 11, 2), np.s_[4, 5], np.s_[5, 6])),
    "ragged": Grid(np.where((ROW * 7 + COL * 5) % 11 < 3, np.nan, noise(17, 17, 3))),
    "checkerboard": Grid(np.where((ROW[:8, :9] + COL[:8, :9]) % 2 + (ROW[:8, :9] % 5 < 3) < 2, noise(8, 9, 4), np.nan)),
    "ring with island": Grid(_ring()),
    "almost all void": Grid(_almost_void()),
    "one triangle": Grid(_one_triangle()),
    "void corner": Grid(_without(noise(2, 2), np.s_[1, 0])),
    "lon lat voids": Grid(_without(noise(12, 9), np.s_[3:7, 2:5]), -114.1, 59.9, 3e-4, 3e-4, post_metres=(15.0, 30.0)),
}

NO_GROUND = {"all void": Grid(np.full((5, 7), np.nan)), "isolated posts": Grid(_isolated())}

SURFACES = {**SOLID, **VOIDS}


def relief_of(grid: Grid) -> float:
    """Greatest height less the least; 1 m for level ground."""
    return float(np.nanmax(grid.heights) - np.nanmin(grid.heights)) or 1.0


def bounds_of(grid: Grid, *shares: float) -> tuple[float, ...]:
    """Error bounds as shares of the relief."""
    return tuple(share * relief_of(grid) for share in shares or (0.5, 0.2, 0.05))


def write_dem(
    path: Path, heights: Any, *, x0: float = 5e5, y0: float = 4e6, step: float = 30.0, crs: str | None = "EPSG:32613"
) -> Path:
    """Write heights (south first, NaN for voids) as GeoTIFF with post (0, 0) at x0, y0."""
    n_row, n_col = heights.shape
    profile = {
        "driver": "GTiff", "height": n_row, "width": n_col, "count": 1, "dtype": "float64", "nodata": NODATA,
        "crs": crs, "transform": from_origin(x0 - step / 2, y0 + (n_row - 0.5) * step, step, step),
    }  # fmt: skip
    with rasterio.open(path, "w", **profile) as dataset:
        dataset.write(np.nan_to_num(heights, nan=NODATA)[::-1], 1)
    return path


def query(path: Path, sql: str, *values: Any) -> list[Any]:
    """Return the rows that a store gives for some SQL."""
    with closing(sqlite3.connect(path)) as store:
        return store.execute(sql, values).fetchall()
