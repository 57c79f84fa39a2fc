"""Write the Jacksboro fault DEM, which comes with matplotlib, as a GeoTIFF: ``python bench/jacksboro.py OUT.tif``."""

from __future__ import annotations

import sys

import numpy as np
import rasterio
from matplotlib.cbook import get_sample_data
from rasterio.transform import from_origin


def main(path: str) -> None:
    """Write whole metres, north first; places of posts are the middles of the given extent's pixels."""
    with get_sample_data("jacksboro_fault_dem.npz") as data:
        heights, west, north = data["elevation"], float(data["xmin"]), float(data["ymax"])
        width, height = float(data["dx"]), float(data["dy"])
    profile = {
        "driver": "GTiff", "height": heights.shape[0], "width": heights.shape[1], "count": 1, "dtype": "float32",
        "crs": "EPSG:4326", "transform": from_origin(west, north, width, height),
    }  # fmt: skip
    with rasterio.open(path, "w", **profile) as dataset:
        dataset.write(heights.astype(np.float32), 1)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(sys.argv[1])
