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

Another table compares at the same root mean square of the errors, RMSE: vpfx with heights fitted for that (--fit rmse), within
the bound, against what pyfqmr's quadric decimation, which has no bound, needs for the RMSE that vpfx has.

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
from judge import Mesh, Verdict, greatest_degree, judge
from numpy.typing import NDArray
from peers import mesh_decimated, mesh_greedy, mesh_rtin, mesh_vpfx
from pymartini import Martini

from vpfx.dem import read_grid
from vpfx.geometry import face_shapes
from vpfx.model import Grid

REPOSITORY = Path(__file__).resolve().parents[1]
NEW_MEXICO = REPOSITORY / "fixtures/dem/new_mexico_cell_5min_1arcsec.tif"
BIG_TUJUNGA = REPOSITORY.parent / "shared/data/dem/big_tujunga_utm11_30m.tif"

PROTOTYPE = {
    "big_tujunga_utm11_30m": {80: (1.03, 31.8), 40: (1.15, 30.9), 20: (1.20, 30.3), 10: (1.30, 29.7)},
    "new_mexico_cell_5min_1arcsec": {20: (1.08, 32.1), 10: (1.21, 31.1), 5: (1.52, 30.1), 2: (2.16, 29.6)},
    "jacksboro_257": {80: (1.06, 30.3), 40: (1.18, 29.9), 20: (1.32, 29.8), 10: (1.57, 29.2)},
}
"""Ratio to greedy and mean perimeter²/area by case and bound in metres; source: design.md §5."""

STEPS = 24
"""Halvings of the error asked of pymartini."""

GUESSES = 4
"""Numbers of triangles asked of pyfqmr, each nearer to the RMSE."""

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


def compare_decimated(case: Case) -> list[Line]:
    """Lines of fitted and pyfqmr at the RMSE of fitted, for every bound."""
    grid, lines = case.grid, []
    for bound in case.bounds:
        fitted = mesh_vpfx(grid, [bound], "rmse")[0]
        own = judge(fitted, grid.heights)
        n_face, peer = decimate(grid, own.rmse, len(fitted.face_nodes))
        lines.append(
            {
                "bound": bound,
                "triangles": len(fitted.face_nodes),
                "rmse": own.rmse,
                "max_error": own.max_error,
                "is_held": own.max_error <= bound and own.n_missed == 0 and own.is_cover,
                "pyfqmr_triangles": n_face,
                "pyfqmr_max_error": peer.max_error,
                "ratio": len(fitted.face_nodes) / n_face,
            }
        )
    return lines


def decimate(grid: Grid, rmse: float, n_face: int) -> tuple[int, Verdict]:
    """Triangles that pyfqmr needs for a RMSE, from a first guess, and what the judge found at the last one.

    The RMSE falls nearly as a power of the triangles: each guess goes along the line through the two nearest of those before.
    """
    known: list[tuple[float, float]] = []
    for _ in range(GUESSES):
        mesh = mesh_decimated(grid, n_face)
        verdict = judge(mesh, grid.heights)
        known.append((np.log(len(mesh.face_nodes)), np.log(verdict.rmse / rmse)))
        known.sort(key=lambda point: abs(point[1]))
        (n, off), (other_n, other_off) = (
            known[0],
            known[1] if len(known) > 1 else (known[0][0] - 1.0, known[0][1] + 0.8),
        )
        n_face = round(np.exp(n - off * (other_n - n) / (other_off - off) if other_off != off else n))
    return n_face, verdict


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


def decimated_text(lines: Sequence[Line]) -> str:
    rows = [["bound", "RMSE", "triangles", "max error", "pyfqmr", "its max error", "ratio"]]
    for line in lines:
        errors = f"{line['max_error']:.3f}{' ' if line['is_held'] else '*'}", f"{line['pyfqmr_max_error']:.3f}"
        counts = f"{line['triangles']}", f"{line['pyfqmr_triangles']}"
        rows.append([f"{line['bound']:g}", f"{line['rmse']:.3f}", counts[0], errors[0], counts[1], errors[1],
                     f"{line['ratio']:.2f}"])  # fmt: skip
    return table_text(rows, left=())


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
                "rmse_lines": compare_decimated(case),
                "costs": costs(case),
            }
        )
        if not options.json:
            print(f"{case.name}, {shape[0]} × {shape[1]} posts\n{lines_text(results[-1]['lines'])}\n")
            part = f"south-western {rtin_size(shape)} × {rtin_size(shape)} posts"
            print(f"{case.name}, {part}\n{lines_text(results[-1]['rtin_lines'])}\n")
            print(f"{case.name}, the same RMSE\n{decimated_text(results[-1]['rmse_lines'])}\n")
            print(f"{case.name}, cost of all levels\n{costs_text(results[-1]['costs'])}\n", flush=True)
    if options.json:
        print(json.dumps(results, indent=2))
    sys.exit(not all(line["is_held"] for r in results for line in (*r["lines"], *r["rtin_lines"], *r["rmse_lines"])))


if __name__ == "__main__":
    main()
