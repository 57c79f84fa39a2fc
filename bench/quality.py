"""Triangles for the same true greatest error, and their shapes: vpfx against pydelatin and pymartini.

All meshers get the same posts in the same run, and one judge, written here and sharing nothing with the builder,
compares every mesh with every post. "vpfx single" is one level built for that bound alone, "vpfx ladder" the level of a
hierarchy of all bounds, "vpfx fitted" one level with heights fitted within the bound (--fit). pymartini takes squares
of 2^n + 1 posts only, so it has a table of its own, over the largest such square in the south-west; it is asked for
whatever keeps the bound at the posts. Lengths are in metres.

Columns: triangles and their ratio to greedy Delaunay insertion (pydelatin); nodes in percent of the posts; greatest
error at the posts (* = over the bound, or faces that do not cover the extent exactly once); mean perimeter²/area; 5th
percentile of the smallest angle, degrees; greatest degree; ratio and mean perimeter²/area of the prototype (design.md
§5, "band"), with "< prototype" where "vpfx single" is not at least as good. Exit code 1 if a mesh does not hold its
bound.

A last table tells what the better mesh costs: processor seconds of all levels, the least of some runs in turn, against
the same rules and guard without settling and undoing ("plain"), over the whole DEM and its south-western quarter.

Example: ``python bench/quality.py --dem hills.tif --bounds 40,20,10 --json``
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydelatin import Delatin
from pymartini import Martini

from vpfx.dem import read_grid
from vpfx.geometry import face_shapes
from vpfx.model import Grid, Tin

REPOSITORY = Path(__file__).resolve().parents[1]
NEW_MEXICO = REPOSITORY / "fixtures/dem/new_mexico_cell_5min_1arcsec.tif"
BIG_TUJUNGA = REPOSITORY.parent / "shared/data/dem/big_tujunga_utm11_30m.tif"

PROTOTYPE = {
    "big_tujunga_utm11_30m": {80: (1.03, 31.8), 40: (1.15, 30.9), 20: (1.20, 30.3), 10: (1.30, 29.7)},
    "new_mexico_cell_5min_1arcsec": {20: (1.08, 32.1), 10: (1.21, 31.1), 5: (1.52, 30.1), 2: (2.16, 29.6)},
    "jacksboro_257": {80: (1.06, 30.3), 40: (1.18, 29.9), 20: (1.32, 29.8), 10: (1.57, 29.2)},
}
"""Ratio to greedy and mean perimeter²/area by case and bound in metres; source: design.md §5."""

NEAR = 1e-8
"""Post spacings by which a post may miss a face and still count as touched: nodes are rounded to CRS units."""

SAMPLES = 1 << 22
"""Posts looked at in one go, about; bounds the memory of the judge."""

STEPS = 24
"""Halvings of the error asked of pymartini."""

ROUNDING = float(np.finfo(np.float32).eps)
"""pydelatin works in single precision: its bound counts as held to this share of the greatest height."""

GREEDY, RTIN, SINGLE, LADDER = "pydelatin", "pymartini", "vpfx single", "vpfx ladder"
FITTED = "vpfx fitted"
RUNS = 5
"""Runs of each mesh that is timed."""

Floats = NDArray[np.float64]
Line = dict[str, Any]


class Case(NamedTuple):
    """Posts and the bounds to hold on them, metres, coarse to fine."""

    name: str
    grid: Grid
    bounds: tuple[float, ...]


class Mesh(NamedTuple):
    """Nodes as column, row (in post spacings, row 0 in the south) and height; faces counter-clockwise."""

    nodes: Floats
    face_nodes: NDArray[np.int32]


class Verdict(NamedTuple):
    """What the judge found: the greatest error in metres, valid posts no face touches, and whether faces fit."""

    max_error: float
    n_missed: int
    is_cover: bool  # all faces counter-clockwise, and their areas sum up to the extent


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
    is_missed = np.isfinite(heights)
    worst = 0.0
    for part in np.split(corners, np.searchsorted(load, np.arange(SAMPLES, load[-1], SAMPLES))):
        col, row, height = sample(part, heights.shape)
        is_missed[row, col] = False
        worst = float(np.fmax.reduce(np.abs(height - heights[row, col]), initial=worst))
    is_cover = bool((area > 0).all() and abs(area.sum() - extent) <= 1e-9 * extent)
    return Verdict(worst, int(is_missed.sum()), is_cover)


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


def make_line(mesher: str, mesh: Mesh, grid: Grid, bound: float, n_greedy: int) -> Line:
    """Judge and measure one mesh."""
    verdict = judge(mesh, grid.heights)
    slack = ROUNDING * float(np.abs(grid.heights).max()) if mesher == GREEDY else 0.0
    sliveriness, angle = face_shapes(mesh.nodes[:, :2] * np.array(grid.post_metres), mesh.face_nodes)
    return {
        "bound": bound,
        "mesher": mesher,
        "triangles": len(mesh.face_nodes),
        "ratio": len(mesh.face_nodes) / n_greedy,
        "kept_percent": 100.0 * len(np.unique(mesh.face_nodes)) / grid.heights.size,
        "max_error": verdict.max_error,
        "is_held": verdict.max_error <= bound + slack and verdict.n_missed == 0 and verdict.is_cover,
        "perimeter2_per_area": float(sliveriness.mean()),
        "angle_5": float(np.percentile(angle, 5)),
        "degree": greatest_degree(mesh.face_nodes),
    }


def compare(case: Case) -> list[Line]:
    """Lines of greedy, single and ladder for every bound, with the prototype's figures where they are known."""
    lines = []
    ladder = mesh_vpfx(case.grid, case.bounds)
    for bound, level in zip(case.bounds, ladder, strict=True):
        greedy = mesh_greedy(case.grid.heights, bound)
        n_greedy = len(greedy.face_nodes)
        lines.append(make_line(GREEDY, greedy, case.grid, bound, n_greedy))
        single = make_line(SINGLE, mesh_vpfx(case.grid, [bound])[0], case.grid, bound, n_greedy)
        if bound in PROTOTYPE.get(case.name, {}):
            ratio, shape = single["prototype"] = PROTOTYPE[case.name][bound]
            is_fewer = round(single["ratio"], 2) <= ratio  # compared as they are given, rounded
            single["is_as_good"] = is_fewer and round(single["perimeter2_per_area"], 1) <= shape
        fitted = mesh_vpfx(case.grid, [bound], "max-error")[0]
        lines += [single, make_line(LADDER, level, case.grid, bound, n_greedy)]
        lines.append(make_line(FITTED, fitted, case.grid, bound, n_greedy))
    return lines


def south_west(grid: Grid, n_row: int, n_col: int) -> Grid:
    return Grid(grid.heights[:n_row, :n_col], grid.x0, grid.y0, grid.dx, grid.dy, grid.crs, grid.post_metres)


def costs(case: Case) -> list[Line]:
    """Processor seconds of all levels, better and plain, over a quarter of the DEM and the whole."""
    from vpfx.methods import wynne

    better = wynne.SETTLE, wynne.SWEEPS
    rules = {"better": better, "plain": (wynne.SETTLE._replace(rounds=0), 0)}
    n_row, n_col = case.grid.heights.shape
    lines = []
    for grid in (south_west(case.grid, n_row // 2 + 1, n_col // 2 + 1), case.grid):
        line: Line = {"posts": grid.heights.size, **dict.fromkeys(rules, np.inf)}
        for name in [*rules] * RUNS:
            wynne.SETTLE, wynne.SWEEPS = rules[name]
            start = time.process_time()
            mesh = mesh_vpfx(grid, case.bounds)[-1]
            line[name] = min(line[name], time.process_time() - start)
            line[f"{name}_faces"] = len(mesh.face_nodes)
        lines.append({**line, "ratio": line["better"] / line["plain"]})
    wynne.SETTLE, wynne.SWEEPS = better
    return lines


def rtin_size(shape: Sequence[int]) -> int:
    """Posts along the side of the largest square that pymartini takes and that lies inside."""
    return 1 + (1 << (min(shape) - 1).bit_length() - 1)


def compare_rtin(case: Case) -> list[Line]:
    """Lines of pymartini, greedy and single for every bound, on the largest square of 2^n + 1 posts."""
    grid, size = case.grid, rtin_size(case.grid.heights.shape)
    window = south_west(grid, size, size)
    tile = Martini(size).create_tile(window.heights.astype(np.float32))
    lines = []
    for bound in case.bounds:
        greedy = mesh_greedy(window.heights, bound)
        single = mesh_vpfx(window, [bound])[0]
        asked = find_asked(tile, window.heights, bound)
        rtin = mesh_rtin(tile, window.heights, asked)
        meshes = {GREEDY: greedy, RTIN: rtin, SINGLE: single}
        lines += [make_line(name, mesh, window, bound, len(greedy.face_nodes)) for name, mesh in meshes.items()]
        lines[-2]["asked"] = asked
    return lines


def find_asked(tile: Any, heights: Floats, bound: float) -> float:
    """Greatest error to ask of pymartini, about, that holds the bound at the posts; 0 always does."""
    held, over = 0.0, bound
    while over < 1024 * bound and judge(mesh_rtin(tile, heights, over), heights).max_error <= bound:
        held, over = over, 2 * over
    for _ in range(STEPS):
        middle = (held + over) / 2
        if judge(mesh_rtin(tile, heights, middle), heights).max_error <= bound:
            held = middle
        else:
            over = middle
    return held


def table_text(rows: Sequence[Sequence[str]], left: Sequence[int]) -> str:
    """Rows of texts as aligned columns, those listed in `left` to the left; the first row is the heading."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = []
    for row in rows:
        cells = [
            text.ljust(w) if i in left else text.rjust(w) for i, (text, w) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)


def lines_text(lines: Sequence[Line]) -> str:
    rows = [
        ["bound", "mesher", "triangles", "ratio", "nodes %", "max error", "p²/area", "angle", "degree", "prototype"]
    ]
    for line in lines:
        note = ""
        if "prototype" in line:
            note = "{:.2f}, {:.1f}".format(*line["prototype"]) + ("" if line["is_as_good"] else "  < prototype")
        elif "asked" in line:
            note = f"asked {line['asked']:.2f}"
        rows.append(
            [
                f"{line['bound']:g}",
                line["mesher"],
                f"{line['triangles']}",
                f"{line['ratio']:.2f}",
                f"{line['kept_percent']:.1f}",
                f"{line['max_error']:.3f}{' ' if line['is_held'] else '*'}",
                f"{line['perimeter2_per_area']:.1f}",
                f"{line['angle_5']:.1f}",
                f"{line['degree']}",
                note,
            ]
        )
    return table_text(rows, left=(1, 9))


def costs_text(lines: Sequence[Line]) -> str:
    rows = [["posts", "seconds", "faces", "plain seconds", "plain faces", "ratio"]]
    for line in lines:
        faces = f"{line['better_faces']}", f"{line['plain_faces']}"
        seconds = f"{line['better']:.2f}", f"{line['plain']:.2f}"
        rows.append([f"{line['posts']}", seconds[0], faces[0], seconds[1], faces[1], f"{line['ratio']:.2f}"])
    return table_text(rows, left=())


def jacksboro() -> Grid:
    """Return the first 257 rows and columns of matplotlib's sample DEM, row 0 to the north, posts 1 × 1 apart."""
    from matplotlib.cbook import get_sample_data

    with get_sample_data("jacksboro_fault_dem.npz") as data:
        return Grid(data["elevation"][:257, :257][::-1].astype(np.float64))


def cases(asked: Sequence[tuple[str, tuple[float, ...]]]) -> Iterator[Case]:
    """Yield the DEMs asked for, or the three known ones."""
    for path, bounds in asked:
        yield Case(Path(path).stem, read_grid(path), bounds)
    if asked:
        return
    yield Case(NEW_MEXICO.stem, read_grid(NEW_MEXICO), (20.0, 10.0, 5.0, 2.0))
    yield Case("jacksboro_257", jacksboro(), (80.0, 40.0, 20.0, 10.0))
    if BIG_TUJUNGA.exists():
        yield Case(BIG_TUJUNGA.stem, read_grid(BIG_TUJUNGA), (80.0, 40.0, 20.0, 10.0))
    else:
        print(f"{BIG_TUJUNGA.stem}: left out: no file {BIG_TUJUNGA.name}", file=sys.stderr)


def parse_bounds(text: str) -> tuple[float, ...]:
    """Read bounds in metres, such as 40,20,10; they come back coarse to fine."""
    bounds = sorted({float(word) for word in text.split(",")}, reverse=True)
    if bounds[-1] <= 0:
        raise argparse.ArgumentTypeError(f"found {text}, expected positive numbers of metres")
    return tuple(bounds)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dem", action="append", default=[], help="elevation file; may be given several times")
    bounds_help = "metres, such as 40,20,10; one list for each --dem"
    parser.add_argument("--bounds", action="append", default=[], type=parse_bounds, help=bounds_help)
    parser.add_argument("--json", action="store_true", help="print JSON in place of tables")
    options = parser.parse_args()
    if len(options.dem) != len(options.bounds):
        parser.error(f"found {len(options.dem)} --dem and {len(options.bounds)} --bounds, expected as many")
    results = []
    for case in cases(list(zip(options.dem, options.bounds, strict=True))):
        if np.isnan(case.grid.heights).any():
            print(f"{case.name}: left out: it has voids, which the peers do not know", file=sys.stderr)
            continue
        shape = list(case.grid.heights.shape)
        results.append(
            {
                "case": case.name,
                "posts": shape,
                "lines": compare(case),
                "rtin_lines": compare_rtin(case),
                "costs": costs(case),
            }
        )
        if not options.json:
            print(f"{case.name}, {shape[0]} × {shape[1]} posts\n{lines_text(results[-1]['lines'])}\n")
            part = f"south-western {rtin_size(shape)} × {rtin_size(shape)} posts"
            print(f"{case.name}, {part}\n{lines_text(results[-1]['rtin_lines'])}\n")
            print(f"{case.name}, cost of all levels\n{costs_text(results[-1]['costs'])}\n", flush=True)
    if options.json:
        print(json.dumps(results, indent=2))
    sys.exit(not all(line["is_held"] for r in results for line in (*r["lines"], *r["rtin_lines"])))


if __name__ == "__main__":
    main()
