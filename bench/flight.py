"""Fly over a store and draw what a cut for the eye looks like: ``python bench/flight.py STORE -o FOLDER``.

Writes a frame a step, faces shaded and tinted by their level, and a sheet of some of them. What would show through a crack is
magenta: pixels of that colour below the skyline are counted. Printed for each frame: faces by level, stitched ones, seconds of
the cut, such pixels, and how much the surface moved at fixed places since the frame before, beside how much it may (Q-320).

Example::

    vpfx build fixtures/dem/new_mexico_cell_5min_1arcsec.tif -o nm.gpkg --max-error 40,20,10,5 --tile-size 128
    python bench/flight.py nm.gpkg -o frames --height 250 --screen-error 4
"""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.tri import LinearTriInterpolator, Triangulation

import vpfx
from vpfx.dem.reference import unit_metres
from vpfx.model import Tin
from vpfx.query.cut import MORPH, cut
from vpfx.query.location import locate
from vpfx.report import to_text

WIDTH, HEIGHT, FOV = 960, 540, 60.0  # pixels, degrees from top to bottom
NEAREST = 1.0  # metres before the eye
PITCH = math.radians(-12.0)
LIGHT = np.array([-0.5, 0.4, 0.75])
TINTS = plt.get_cmap("viridis")
CRACK, SKY = (1.0, 0.0, 1.0), (0.75, 0.85, 1.0)


def view(tin: Tin, eye: np.ndarray, heading: float, metres: tuple[float, float], n_level: int) -> np.ndarray:
    """Picture of a TIN from an eye, uint8 (HEIGHT, WIDTH, 3): faces from the farthest to the nearest."""
    place = (tin.nodes - eye) * (*metres, 1.0)
    ahead = np.array([math.sin(heading) * math.cos(PITCH), math.cos(heading) * math.cos(PITCH), math.sin(PITCH)])
    right = np.array([math.cos(heading), -math.sin(heading), 0.0])
    up = np.cross(right, ahead)
    seen = np.stack([place @ right, place @ up, place @ ahead], axis=1)[
        tin.face_nodes
    ]  # right, up and ahead of the eye
    corner = place[tin.face_nodes]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    light = np.clip((normal @ LIGHT) / np.linalg.norm(normal, axis=1) / np.linalg.norm(LIGHT), 0.15, 1.0)
    level = tin.face_attributes["level"] / max(1, n_level - 1)
    colour = (0.35 * TINTS(level)[:, :3] + 0.65) * light[:, None]
    is_ahead = (seen[..., 2] > NEAREST).any(axis=1)
    order = np.flatnonzero(is_ahead)[np.argsort(-seen[is_ahead, :, 2].mean(axis=1))]
    polygons = [on_screen(face) for face in seen[order]]
    figure = plt.figure(figsize=(WIDTH / 100, HEIGHT / 100), dpi=100)
    axes = figure.add_axes((0, 0, 1, 1), xlim=(0, WIDTH), ylim=(0, HEIGHT), facecolor=CRACK)
    axes.add_collection(PolyCollection(polygons, facecolors=colour[order], edgecolors="none", antialiased=False))
    axes.axis("off")
    figure.patch.set_facecolor(CRACK)
    figure.canvas.draw()
    pixels = np.asarray(figure.canvas.buffer_rgba())[..., :3].copy()
    plt.close(figure)
    return pixels


def on_screen(face: np.ndarray) -> np.ndarray:
    """Pixels of the corners of a face, cut off just before the eye."""
    focal = HEIGHT / 2 / math.tan(math.radians(FOV) / 2)
    kept = []
    for a, b in zip(face, np.roll(face, -1, axis=0), strict=True):
        if a[2] >= NEAREST:
            kept.append(a)
        if (a[2] < NEAREST) != (b[2] < NEAREST):
            kept.append(a + (NEAREST - a[2]) / (b[2] - a[2]) * (b - a))
    corners = np.array(kept)
    return np.array([WIDTH / 2, HEIGHT / 2]) + focal * corners[:, :2] / corners[:, 2:]


def cracks(pixels: np.ndarray) -> int:
    """Count pixels of the crack's colour below the skyline, and paint the sky."""
    is_empty = (pixels == np.round(np.array(CRACK) * 255)).all(axis=2)
    is_sky = np.logical_and.accumulate(is_empty, axis=0)
    pixels[is_sky] = np.round(np.array(SKY) * 255)
    return int((is_empty & ~is_sky).sum())


def fly(path: Path, folder: Path, height: float, screen_error: float, n_frame: int) -> None:
    """Draw the frames and print the table."""
    rows = [["frame", "faces by level", "stitched", "cut s", "crack pixels", "moved m", "may m"]]
    frames = []
    with vpfx.open_store(path) as store:
        metres, n_level = unit_metres(store.crs, store.extent), len(store.levels)
        low, high = np.array(store.extent[:2]), np.array(store.extent[2:])
        places = np.random.default_rng(1).uniform(low, high, (2000, 2))
        share = screen_error * 2 * math.tan(math.radians(FOV) / 2) / HEIGHT
        steps = zip(store.levels, store.levels[1:], strict=False)
        fastest = max(after.max_rise * share / (MORPH * before.max_error) for before, after in steps)
        along = np.linspace(0.08, 0.75, n_frame)
        track = low + np.stack([along, 0.1 + 0.5 * along + 0.1 * np.sin(6 * along)], axis=1) * (high - low)
        ground = locate(store, track, 0).z
        z = np.full(n_frame, np.nanmax(ground) + height)
        before, eye_before = None, None
        for i, eye in enumerate(np.column_stack([track, z])):
            step = (track[min(i + 1, n_frame - 1)] - track[max(i - 1, 0)]) * metres
            start = time.perf_counter()
            tin = cut(store, eye, screen_error=screen_error, fov=FOV, screen_height=HEIGHT)
            seconds = time.perf_counter() - start
            pixels = view(tin, eye, math.atan2(*step), metres, n_level)
            n_crack = cracks(pixels)
            plt.imsave(folder / f"frame_{i:03}.png", pixels)
            frames.append(pixels)
            mesh = Triangulation(tin.nodes[:, 0], tin.nodes[:, 1], tin.face_nodes)
            now = LinearTriInterpolator(mesh, tin.nodes[:, 2])(*places.T)
            moved, may = "–", "–"
            if before is not None:
                way = float(np.linalg.norm((eye - eye_before) * (*metres, 1.0)))
                moved, may = f"{np.abs(now - before).max():.2f}", f"{fastest * way:.2f}"
            before, eye_before = now, eye
            counts = " ".join(map(str, np.bincount(tin.face_attributes["level"], minlength=n_level)))
            stitched = str(int(tin.face_attributes["is_stitched"].sum()))
            rows.append([str(i), counts, stitched, f"{seconds:.3f}", str(n_crack), moved, may])
    print(to_text(rows))
    shown = frames[:: max(1, n_frame // 9)][:9]
    blank = [np.full_like(frames[0], 255)] * (-len(shown) % 3)
    sheet = np.concatenate([np.concatenate([*shown, *blank][k : k + 3], axis=1) for k in range(0, len(shown), 3)])
    plt.imsave(folder / "sheet.png", sheet[::2, ::2])


def main() -> None:
    """Fly."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("store", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--height", type=float, default=250.0, help="metres over the highest ground of the track")
    parser.add_argument("--screen-error", type=float, default=4.0, help="pixels")
    parser.add_argument("--frames", type=int, default=36)
    given = parser.parse_args()
    given.output.mkdir(parents=True, exist_ok=True)
    fly(given.store, given.output, given.height, given.screen_error, given.frames)


if __name__ == "__main__":
    main()
