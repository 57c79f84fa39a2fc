"""The paper's experiment on a cell of posts: a 9 × 9 start grid, three passes, points of surveyed lines as further candidates.

``python bench/experiment.py`` takes the New Mexico cell and its streams from ``fixtures/``; a DEM and lines of your own::

    python bench/experiment.py mark_twain_cell_5min_1arcsec.tif --features mark_twain_lake_shoreline.geojson -o out
    python bench/experiment.py killeen_w098_n31.dt0 --bbox=-97.5834,31.0833,-97.4999,31.1667 -o out

It prints nodes, faces and errors of every level beside the paper's figures, and draws the paper's figures: A1, shaded relief
of the source; A2 to A5, plan view, wireframe and shaded wireframe of each level.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vpfx import Grid, Hierarchy, Tin, build_hierarchy, read_grid
from vpfx.dem.reference import unit_metres
from vpfx.features import read_features
from vpfx.plot import draw_tin, picture
from vpfx.report import to_text

FIXTURES = Path(__file__).resolve().parents[1] / "fixtures"
CELL, STREAMS = FIXTURES / "dem/new_mexico_cell_5min_1arcsec.tif", FIXTURES / "features/new_mexico_streams.geojson"
SETTINGS: dict[str, Any] = {"passes": 3, "grid": (9, 9)}
PAPER_POINTS, PAPER_NODES = 90_939, 1_737  # posts and shoreline nodes; nodes of the group's TIN
STEPS = 20  # halvings in the search for a tolerance
STYLES = "plan", "wireframe", "shaded"
SIZE = 5.0, 5.0  # of one drawing, inches


def source_mesh(grid: Grid) -> Tin:
    """Mesh of all posts, each square cut in two."""
    n_row, n_col = grid.heights.shape
    row, col = np.indices((n_row, n_col))
    x, y = grid.x0 + col * grid.dx, grid.y0 + row * grid.dy
    nodes = np.stack([x, y, grid.heights], axis=-1).reshape(-1, 3)
    a = (row * n_col + col)[:-1, :-1].ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + n_col + 1], 1), np.stack([a, a + n_col + 1, a + n_col], 1)])
    faces = faces[~np.isnan(nodes[faces, 2]).any(axis=1)]
    used, index = np.unique(faces, return_inverse=True)
    return Tin(nodes[used], index.reshape(-1, 3), crs=grid.crs)


def level_table(hierarchy: Hierarchy, n_point: int) -> list[list[str]]:
    """Rows of texts: nodes, their share of all points, faces and errors of every level."""
    rows = [["level", "nodes", "of all points", "faces", "max error m", "rmse m"]]
    for level in range(hierarchy.n_level):
        tin = hierarchy.tin(level)
        rmse = (hierarchy.squared_error[level] / max(hierarchy.n_post[level], 1)) ** 0.5
        share = f"{100 * tin.n_node / n_point:.2f} %"
        row = [
            f"{level}",
            f"{tin.n_node:,}",
            share,
            f"{tin.n_face:,}",
            f"{hierarchy.max_error[level]:.2f}",
            f"{rmse:.3f}",
        ]
        rows.append(row)
    return rows


def find_tolerance(grid: Grid, lines: Sequence[Any], n_node: int) -> tuple[float, Hierarchy]:
    """Find the least tolerance, by halving, that leaves the last level no more nodes than asked for."""
    low, high = 0.0, float(np.nanmax(grid.heights) - np.nanmin(grid.heights))
    best = build_hierarchy(grid, tolerance=high, lines=lines, **SETTINGS)
    for _ in range(STEPS):
        middle = (low + high) / 2
        found = build_hierarchy(grid, tolerance=middle, lines=lines, **SETTINGS)
        if len(found.nodes) <= n_node:
            high, best = middle, found
        else:
            low = middle
    return high, best


def draw(hierarchy: Hierarchy, grid: Grid, folder: Path, suffix: str) -> None:
    """Draw figures A1 to A5."""
    metres = unit_metres(grid.crs, grid.extent)
    with picture(folder / f"A1_source{suffix}", overwrite=True) as (figure, ((axis,),)):
        source = source_mesh(grid)
        scale = draw_tin(axis, source, "relief", metres=metres, title=f"source, {source.n_node:,} posts")
        figure.colorbar(scale, ax=axis, shrink=0.7, label="height, m")
    for level in range(hierarchy.n_level):
        tin, path = hierarchy.tin(level), folder / f"A{level + 2}_level_{level}{suffix}"
        with picture(path, 1, len(STYLES), size=SIZE, overwrite=True) as (figure, axes):
            for axis, style in zip(axes[0], STYLES, strict=True):
                draw_tin(axis, tin, style, metres=metres, title=style)
            figure.suptitle(f"level {level}: {tin.n_node:,} nodes, {tin.n_face:,} faces", fontsize=10)


def main() -> None:
    """Run the experiment."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dem", nargs="?")
    parser.add_argument("--features")
    parser.add_argument("--bbox", type=lambda text: tuple(map(float, text.split(","))))
    parser.add_argument("--tolerance", type=float, default=5.0, help="metres")
    parser.add_argument("--suffix", default=".png", choices=[".png", ".pdf", ".svg"])
    parser.add_argument("-o", "--output", type=Path, help="folder for the figures; without it none are drawn")
    given = parser.parse_args()
    features = given.features or (None if given.dem else STREAMS)
    grid = read_grid(given.dem or CELL, bbox=given.bbox)
    lines = read_features(features, grid.crs, grid.extent).lines if features else ()
    points = {tuple(place) for line in lines for place in line[:, :2].tolist()}
    n_post = int((~np.isnan(grid.heights)).sum())
    print(f"{n_post:,} posts and {len(points):,} points of lines; tolerance {given.tolerance:g} m\n")
    hierarchy = build_hierarchy(grid, tolerance=given.tolerance, lines=lines, **SETTINGS)
    print(to_text(level_table(hierarchy, n_post + len(points))))
    if points:
        plain = build_hierarchy(grid, tolerance=given.tolerance, **SETTINGS)
        own = {tuple(node) for node in hierarchy.nodes.tolist()} - {tuple(node) for node in plain.nodes.tolist()}
        print(f"\nwithout the points {len(plain.nodes):,} nodes; {len(own):,} nodes are there with the points only")
    tolerance, small = find_tolerance(grid, lines, PAPER_NODES)
    share = 100 * len(small.nodes) / (n_post + len(points))
    print(f"\nthe paper: {PAPER_NODES:,} nodes of {PAPER_POINTS:,} points ({100 * PAPER_NODES / PAPER_POINTS:.2f} %)")
    print(f"here: {len(small.nodes):,} nodes ({share:.2f} %) at a tolerance of {tolerance:.2f} m\n")
    print(to_text(level_table(small, n_post + len(points))))
    if given.output:
        given.output.mkdir(parents=True, exist_ok=True)
        draw(hierarchy, grid, given.output, given.suffix)
        print("\n" + "\n".join(str(path) for path in sorted(given.output.glob(f"A?_*{given.suffix}"))))


if __name__ == "__main__":
    main()
