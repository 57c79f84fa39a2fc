"""Write a fractal DEM of any size, always the same for a seed: ``python bench/fractal.py 4097 -o fractal.tif``.

The amplitudes of the surface fall with 1/f^1.6, rough as mountains. A side of 1 025 posts has 1 000 m between its lowest and
its highest post, others in proportion to the square root of the side; posts lie 30 m apart in UTM zone 13.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import rasterio
from rasterio.transform import from_origin

SPACING = 30.0  # metres
RELIEF = 1000.0  # metres
SIDE = 1025  # posts that have this relief
ROUGHNESS = 1.6  # exponent of the frequency


def heights_of(side: int, seed: int) -> np.ndarray:
    """Heights of side × side posts, metres."""
    noise = np.fft.rfft2(np.random.default_rng(seed).standard_normal((side, side), np.float32))
    frequency = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side)[None])
    frequency[0, 0] = np.inf
    surface = np.fft.irfft2(noise / frequency**ROUGHNESS, (side, side))
    surface -= surface.min()
    return (surface * (RELIEF * np.sqrt(side / SIDE) / surface.max())).astype(np.float32)


def main() -> None:
    """Write the file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("side", type=int)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    corner = from_origin(300_000 - SPACING / 2, 4_500_000 + SPACING / 2, SPACING, SPACING)
    profile = {"driver": "GTiff", "width": given.side, "height": given.side, "count": 1, "dtype": "float32",
               "crs": "EPSG:32613", "transform": corner, "compress": "deflate", "predictor": 3}  # fmt: skip
    with rasterio.open(given.output, "w", **profile) as dem:
        dem.write(heights_of(given.side, given.seed), 1)


if __name__ == "__main__":
    main()
