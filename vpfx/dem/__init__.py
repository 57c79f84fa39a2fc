"""Elevation files as lattices of posts: a thin layer over rasterio.

`open_dem` reads block by block, `read_grid` reads a small DEM whole. Whatever the format, a post is the centre of a
pixel, row 0 lies in the south, heights are metres and voids are NaN. All formats are GDAL's; none is parsed here.
"""

from vpfx.dem.dem import Dem, open_dem, read_grid
from vpfx.dem.paths import Source

__all__ = ["Dem", "Source", "open_dem", "read_grid"]
