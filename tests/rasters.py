"""Elevation files with known posts, the fixtures by name, and short ways to read them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rasterio
from rasterio.transform import from_origin

from vpfx.dem import open_dem

__all__ = ["CELL", "DT2", "FIXTURES", "UTM", "VOIDS", "lattice_of", "ramp", "read_all", "write_tiff"]

FIXTURES = Path(__file__).resolve().parents[1] / "fixtures" / "dem"
CELL = FIXTURES / "new_mexico_cell_5min_1arcsec.tif"
DT2 = FIXTURES / "new_mexico_n36_w108.dt2"
VOIDS = FIXTURES / "new_mexico_voids.tif"
UTM = FIXTURES / "new_mexico_utm13_30m.tif"


def ramp(n_row, n_col, dtype="int16"):
    """Return heights that tell every post from its neighbours; south first, some below zero."""
    return (np.arange(n_row)[:, None] * 7 % 500 + np.arange(n_col) * 3 % 400 - 50).astype(dtype)


def write_tiff(path, heights, x0=10.0, y0=45.0, dx=1 / 120, dy=1 / 120, crs="EPSG:4326", **extra):
    """Write heights (south first) with post (0, 0) at x0, y0."""
    n_row, n_col = heights.shape
    transform = from_origin(x0 - dx / 2, y0 + (n_row - 0.5) * dy, dx, dy)
    profile = {"driver": "GTiff", "height": n_row, "width": n_col, "count": 1, "dtype": heights.dtype}
    with rasterio.open(path, "w", **{**profile, "crs": crs, "transform": transform, **extra}) as dataset:
        dataset.write(heights[::-1], 1)
    return path


def read_all(paths, **options):
    with open_dem(paths, **options) as dem:
        return dem.read(0, dem.n_row, 0, dem.n_col)


def lattice_of(dem):
    return dem.n_row, dem.n_col, dem.x0, dem.y0, dem.dx, dem.dy
