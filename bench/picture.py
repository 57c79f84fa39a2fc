"""Draw the levels of a store side by side: shaded faces with their edges.

The picture of README.md was made so::

    vpfx build fixtures/dem/new_mexico_cell_5min_1arcsec.tif -o new_mexico.gpkg --max-error 40,20,10,5
    python bench/picture.py new_mexico.gpkg specs/levels.png
"""

from __future__ import annotations

import argparse

import matplotlib
import numpy as np

import vpfx

matplotlib.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.collections import PolyCollection

SUN_AZIMUTH, SUN_HEIGHT = 315.0, 45.0  # degrees


def shade(tin: vpfx.Tin) -> np.ndarray:
    """Brightness of each face under a sun in the north-west: 0 … 1."""
    slope = np.radians(tin.face_attributes["slope"])
    aspect = np.radians(np.nan_to_num(tin.face_attributes["aspect"]))
    height, azimuth = np.radians(SUN_HEIGHT), np.radians(SUN_AZIMUTH)
    light = np.sin(height) * np.cos(slope) + np.cos(height) * np.sin(slope) * np.cos(azimuth - aspect)
    return np.clip(light, 0.0, 1.0)


def draw(store: vpfx.Store, path: str) -> None:
    """Draw every level into one picture."""
    figure, axes = plt.subplots(1, len(store.levels), figsize=(3.4 * len(store.levels), 3.8), squeeze=False)
    for axis, line in zip(axes[0], store.levels, strict=True):
        tin = store.tin(line.level)
        corners = tin.nodes[:, :2][tin.face_nodes]
        height = tin.nodes[:, 2][tin.face_nodes].mean(axis=1)
        tint = matplotlib.colormaps["gist_earth"](0.35 + 0.5 * (height - height.min()) / max(np.ptp(height), 1e-9))
        tint[:, :3] *= shade(tin)[:, None]
        axis.add_collection(PolyCollection(corners, facecolors=tint, edgecolors="#00000060", linewidths=0.2))
        axis.set_xlim(store.extent.min_x, store.extent.max_x)
        axis.set_ylim(store.extent.min_y, store.extent.max_y)
        axis.set_aspect(1.0 / np.cos(np.radians((store.extent.min_y + store.extent.max_y) / 2)))
        axis.set_axis_off()
        bound = "" if line.max_error_bound is None else f", ±{line.max_error_bound:g} m"
        axis.set_title(f"level {line.level}{bound}\n{line.faces:,} faces", fontsize=9)
    figure.tight_layout()
    figure.savefig(path, dpi=90)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("store")
    parser.add_argument("picture")
    arguments = parser.parse_args()
    with vpfx.open_store(arguments.store) as opened:
        draw(opened, arguments.picture)
