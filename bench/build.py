"""A whole build: DEM to finished store against pydelatin and pymartini meshing the same posts.

vpfx reads the file, builds all levels and writes the store; the peers get the posts in memory and make one mesh at the
finest bound, pymartini of the posts padded to a square of 2^n + 1, its set-up included. All run in turn in one process
with kernels warm; seconds are medians (least … greatest). Processor seconds are those of all threads: where other
programs keep the machine busy, their ratio is the steadier one. Peak memory is that of a process of its own for each,
imports and posts included. Greatest errors are measured at every post by the judge of bench/judge.py; pymartini does
not keep what it is asked for. Compare the ratios of one run only.

The rows of the four big tables are then written once more from the finished store into fresh files of the same schema:
by sqlite3's executemany with journal and synchronous off, its tuples made beforehand, and from arrays by PageWriter,
which flushes to the medium; both keep the index. Exit code 1 if a level does not hold its bound.

Example: ``python bench/build.py hills.tif --max-error 40,20,10 --repeat 5 --json``
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from judge import Mesh, judge
from numpy.typing import NDArray
from peers import mesh_greedy, mesh_rtin
from pydelatin import Delatin
from pymartini import Martini
from quality import NEW_MEXICO, parse_bounds, table_text

from vpfx.dem import Dem, open_dem, read_grid
from vpfx.model import Grid

VPFX, GREEDY, RTIN, NOTHING = "vpfx", "pydelatin", "pymartini", "nothing"
TABLES = ("node", "edge", "face", "parent_child")
STORE = "bench.gpkg"
INDEX = "parent_child_by_parent"
WARM_TILE = 128  # posts: cuts the fixture into tiles, so that the kernels of borders get warm too
READ_ROWS = 512  # rows of posts read in one go
CALL_ROWS = 20_000  # rows of one insert, as of one tile and level

Posts = NDArray[np.float32]
Columns = list[NDArray[Any]]
Seconds = NDArray[np.float64]  # of the wall clock, and of the processors


class Job(NamedTuple):
    """What is measured."""

    dem: Path
    bounds: tuple[float, ...]
    repeat: int


def blocks(dem: Dem) -> Iterator[tuple[int, NDArray[np.float64]]]:
    """Read all posts, some rows at a time, each block with its first row."""
    for row in range(0, dem.n_row, READ_ROWS):
        yield row, dem.read(row, min(row + READ_ROWS, dem.n_row), 0, dem.n_col)


def find_voids(path: Path) -> bool:
    """Tell whether any post is void."""
    with open_dem(path) as dem:
        return any(np.isnan(block).any() for _, block in blocks(dem))


def read_posts(path: Path) -> Posts:
    """Read all posts in single precision, which is what the peers take, without ever holding them in double."""
    with open_dem(path) as dem:
        posts = np.empty((dem.n_row, dem.n_col), np.float32)
        for row, block in blocks(dem):
            posts[row : row + len(block)] = block
    return posts


def padded(posts: NDArray[Any]) -> NDArray[Any]:
    """Repeat the last row and column up to a square of 2^n + 1 posts."""
    side = 1 + (1 << (max(posts.shape) - 2).bit_length())
    return np.pad(posts, ((0, side - posts.shape[0]), (0, side - posts.shape[1])), mode="edge")


def run_vpfx(job: Job, folder: Path) -> Path:
    """Build the store of a job and return its path."""
    from vpfx.pipeline import build  # late: it loads numba, which the peers' memory figures must not see

    path = folder / STORE
    build(job.dem, path, max_error=job.bounds)
    return path


def run_greedy(posts: Posts, bound: float) -> int:
    return len(Delatin(posts, max_error=bound).triangles)


def run_rtin(square: Posts, bound: float) -> int:
    _, triangles = Martini(len(square)).create_tile(square).get_mesh(bound)
    return len(triangles)


def run_alone(job: Job, contender: str) -> float:
    """Run one contender once and return the peak memory of this process, MB."""
    if contender == VPFX:
        with tempfile.TemporaryDirectory() as folder:
            run_vpfx(job, Path(folder))
    else:
        posts = read_posts(job.dem)
        if contender == GREEDY:
            run_greedy(posts, job.bounds[-1])
        elif contender == RTIN:
            run_rtin(padded(posts), job.bounds[-1])
    unit = 1 if sys.platform == "darwin" else 1024  # of ru_maxrss, bytes
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def peak_memory(job: Job, contender: str) -> float:
    """Run one contender in a process of its own; call it while this process is small, as Linux hands its peak down."""
    bounds = ",".join(map(str, job.bounds))
    command = [sys.executable, __file__, str(job.dem), "--max-error", bounds, "--alone", contender]
    return float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def measure_memory(job: Job, contenders: Sequence[str]) -> dict[str, float]:
    peak_memory(job._replace(dem=NEW_MEXICO), VPFX)  # compiles kernels that are in no cache yet
    return {contender: peak_memory(job, contender) for contender in (*contenders, NOTHING)}


def timed(function: Callable[..., Any], *arguments: Any) -> Seconds:
    wall, processor = time.perf_counter(), time.process_time()
    function(*arguments)
    return np.array([time.perf_counter() - wall, time.process_time() - processor])


def measure_times(job: Job, contenders: Sequence[str], folder: Path) -> dict[str, list[Seconds]]:
    """Seconds of each contender, run in turn."""
    from vpfx.pipeline import build

    posts = read_posts(job.dem)
    square = padded(posts)
    build(NEW_MEXICO, folder / "warm.gpkg", max_error=job.bounds, tile_size=WARM_TILE)
    ways = {VPFX: (run_vpfx, job, folder), GREEDY: (run_greedy, posts, job.bounds[-1])}
    ways[RTIN] = (run_rtin, square, job.bounds[-1])
    seconds: dict[str, list[Seconds]] = {contender: [] for contender in contenders}
    for _ in range(job.repeat):
        for contender in contenders:
            if contender == VPFX:
                (folder / STORE).unlink(missing_ok=True)
            seconds[contender].append(timed(*ways[contender]))
    return seconds


def judge_peers(grid: Grid, bound: float) -> dict[str, tuple[int, float]]:
    """Triangles and greatest error of the peers; of pymartini's triangles those that reach into the posts."""
    square = padded(grid.heights)
    rtin = mesh_rtin(Martini(len(square)).create_tile(square.astype(np.float32)), square, bound)
    least = rtin.nodes[rtin.face_nodes, :2].min(axis=1)
    is_inside = (least < np.array(grid.heights.shape[::-1]) - 1).all(axis=1)
    meshes = {GREEDY: mesh_greedy(grid.heights, bound), RTIN: Mesh(rtin.nodes, rtin.face_nodes[is_inside])}
    return {name: (len(mesh.face_nodes), judge(mesh, grid.heights).max_error) for name, mesh in meshes.items()}


def read_level(store: sqlite3.Connection, level: int, grid: Grid) -> Mesh:
    """Read one level with plain SQL."""
    node_id = read_array(store, "SELECT node_id FROM node WHERE level <= ? ORDER BY node_id", level, np.int64)
    nodes = read_array(store, "SELECT x, y, z FROM node WHERE level <= ? ORDER BY node_id", level, np.float64)
    faces = read_array(store, "SELECT node_1, node_2, node_3 FROM face WHERE level = ?", level, np.int64)
    places = (nodes - np.array([grid.x0, grid.y0, 0.0])) / np.array([grid.dx, grid.dy, 1.0])
    return Mesh(places, np.searchsorted(node_id[:, 0], faces).astype(np.int32))


def read_array(store: sqlite3.Connection, query: str, level: int, dtype: type) -> NDArray[Any]:
    return np.concatenate([np.array(rows, dtype) for rows in pieces(store.execute(query, (level,)))])


def judge_levels(path: Path, grid: Grid) -> list[dict[str, Any]]:
    """Judge every level of a store, beside what the store says of itself."""
    has_voids = bool(np.isnan(grid.heights).any())
    found = []
    with closing(sqlite3.connect(path)) as store:
        query = "SELECT level, max_error_bound, max_error, face_count FROM level ORDER BY level"
        for level, bound, recorded, n_face in store.execute(query).fetchall():
            mesh = read_level(store, level, grid)
            verdict = judge(mesh, grid.heights)
            is_whole = has_voids or (verdict.is_cover and verdict.n_missed == 0)
            is_held = verdict.max_error <= bound and is_whole and len(mesh.face_nodes) == n_face
            line = {"level": level, "bound": bound, "faces": n_face, "max_error": verdict.max_error}
            found.append({**line, "recorded_max_error": recorded, "is_held": is_held})
    return found


def pieces(cursor: sqlite3.Cursor) -> Iterator[list[tuple[Any, ...]]]:
    """Rows of a cursor, as many at a time as one insert takes."""
    while rows := cursor.fetchmany(CALL_ROWS):
        yield rows


def to_columns(rows: list[tuple[Any, ...]]) -> Columns:
    """Turn rows into the arrays that PageWriter takes."""
    from vpfx.store.pages import NULL_INT

    columns: Columns = []
    for values in zip(*rows, strict=True):
        if isinstance(values[0], bytes):
            columns.append(np.frombuffer(b"".join(values), np.uint8).reshape(len(values), -1))
        else:
            columns.append(np.array([NULL_INT if value is None else value for value in values]))
    return columns


def replay_python(store: sqlite3.Connection, path: Path) -> Seconds:
    """Write the rows of a store with `executemany` and return the seconds without those of reading."""
    target = sqlite3.connect(path, isolation_level=None)
    target.executescript("PRAGMA journal_mode = OFF; PRAGMA synchronous = OFF; BEGIN")
    seconds = np.zeros(2)
    for table in TABLES:
        for rows in pieces(store.execute(f"SELECT * FROM {table} ORDER BY 1, 2")):
            insert = f"INSERT INTO {table} VALUES ({', '.join('?' * len(rows[0]))})"
            seconds += timed(target.executemany, insert, rows)
    return seconds + timed(target.execute, "COMMIT") + timed(target.close)


def replay_pages(store: sqlite3.Connection, path: Path) -> Seconds:
    """Write the rows of a store with PageWriter and return the seconds without those of reading."""
    from vpfx.store.pages import PageWriter

    links: list[Columns] = []
    seconds = np.zeros(2)
    with PageWriter(path) as writer:
        for table in TABLES:
            for rows in pieces(store.execute(f"SELECT * FROM {table} ORDER BY 1, 2")):
                columns = to_columns(rows)
                seconds += timed(writer.append, table, columns)
                if table == "parent_child":
                    links.append(columns)
        if links:
            seconds += timed(append_index, writer, *map(np.concatenate, zip(*links, strict=True)))
        return seconds + timed(writer.close)


def append_index(writer: Any, children: NDArray[np.int64], parents: NDArray[np.int64]) -> None:
    """Sort the links by parent and append them to their index."""
    by_parent = np.lexsort((children, parents))
    for at in range(0, len(by_parent), CALL_ROWS):
        part = by_parent[at : at + CALL_ROWS]
        writer.append(INDEX, (parents[part], children[part]))


def make_file(path: Path, page_size: int) -> Path:
    """Make a store without rows, in the place of an old one, and return its path."""
    from vpfx.store.ddl import schema_sql

    path.unlink(missing_ok=True)
    with closing(sqlite3.connect(path)) as connection:
        connection.execute(f"PRAGMA page_size = {page_size}")
        connection.executescript(schema_sql("vpfx.sql"))
    return path


def check_rows(path: Path, n_row: dict[str, int]) -> None:
    """Make sure that a replay wrote what it should."""
    with closing(sqlite3.connect(path)) as connection:
        answer = connection.execute("PRAGMA integrity_check").fetchone()[0]
        counts = {table: connection.execute(f"SELECT count(*) FROM {table}").fetchone()[0] for table in TABLES}
    if answer != "ok" or counts != n_row:
        raise SystemExit(f"{path.name}: found {answer}, {counts}, expected ok, {n_row}")


def measure_rows(path: Path, repeat: int, folder: Path) -> dict[str, Any]:
    """Replay the rows of a store in both ways, in turn."""
    ways = {"sqlite3 executemany": replay_python, "PageWriter": replay_pages}
    seconds: dict[str, list[Seconds]] = {name: [] for name in ways}
    with closing(sqlite3.connect(path)) as store:
        page_size = store.execute("PRAGMA page_size").fetchone()[0]
        n_row = {table: store.execute(f"SELECT count(*) FROM {table}").fetchone()[0] for table in TABLES}
        for _ in range(repeat):
            for name, replay in ways.items():
                target = make_file(folder / "replay.db", page_size)
                seconds[name].append(replay(store, target))
                check_rows(target, n_row)
    medians = {name: np.median(values, axis=0) for name, values in seconds.items()}
    speeds = {name: sum(n_row.values()) / median[0] for name, median in medians.items()}
    ratio, processor_ratio = medians["sqlite3 executemany"] / medians["PageWriter"]
    return {"rows": n_row, "rows_per_s": speeds, "ratio": ratio, "processor_ratio": processor_ratio}


def contender_lines(
    grid: Grid, seconds: dict[str, list[Seconds]], judged: dict[str, tuple[int, float]], memory: dict[str, float]
) -> list[dict[str, Any]]:
    lines = []
    for name, values in seconds.items():
        wall, processor = np.median(values, axis=0)
        ratios = [None, None]
        if GREEDY in seconds:
            ratios = list(np.median(values, axis=0) / np.median(seconds[GREEDY], axis=0))
        line = {"contender": name, "seconds": wall, "all_seconds": [value[0] for value in values]}
        line |= {"processor_seconds": processor, "ratio": ratios[0], "processor_ratio": ratios[1]}
        line |= {"posts_per_s": grid.heights.size / wall, "triangles": judged[name][0], "max_error": judged[name][1]}
        lines.append({**line, "peak_mb": memory[name]})
    return lines


def measure(job: Job, folder: Path) -> dict[str, Any]:
    """Measure all there is; memory first, while this process is small."""
    has_voids = find_voids(job.dem)
    contenders = [VPFX] if has_voids else [VPFX, GREEDY, RTIN]
    if has_voids:
        print("peers: left out: the DEM has voids, which they do not know", file=sys.stderr)
    memory = measure_memory(job, contenders)
    seconds = measure_times(job, contenders, folder)
    grid, store = read_grid(job.dem), folder / STORE
    levels = judge_levels(store, grid)
    judged = {VPFX: (levels[-1]["faces"], levels[-1]["max_error"])}
    judged |= {} if has_voids else judge_peers(grid, job.bounds[-1])
    n_face, n_byte = sum(level["faces"] for level in levels), store.stat().st_size
    return {
        "dem": job.dem.name,
        "posts": grid.heights.shape,
        "bounds": job.bounds,
        "repeat": job.repeat,
        "processors": os.cpu_count(),
        "posts_alone_peak_mb": memory[NOTHING],
        "contenders": contender_lines(grid, seconds, judged, memory),
        "levels": levels,
        "store": {"bytes": n_byte, "faces": n_face, "bytes_per_face": n_byte / n_face},
        "replay": measure_rows(store, job.repeat, folder),
    }


def contenders_text(result: dict[str, Any]) -> str:
    heading = (
        "contender, seconds,, x pydelatin, processor s, x pydelatin, million posts/s, triangles, max error, peak MB"
    )
    rows = [heading.replace(", ", ",").split(",")]
    for line in result["contenders"]:
        spread = f"({min(line['all_seconds']):.2f} … {max(line['all_seconds']):.2f})"
        ratios = ["-" if line[key] is None else f"{line[key]:.2f}" for key in ("ratio", "processor_ratio")]
        cells = [line["contender"], f"{line['seconds']:.2f}", spread, ratios[0]]
        cells += [f"{line['processor_seconds']:.2f}", ratios[1]]
        cells += [f"{line['posts_per_s'] / 1e6:.2f}", f"{line['triangles']}", f"{line['max_error']:.3f}"]
        rows.append([*cells, f"{line['peak_mb']:.0f}"])
    return table_text([*rows, ["posts alone", *["-"] * 8, f"{result['posts_alone_peak_mb']:.0f}"]], left=(0, 2))


def result_text(result: dict[str, Any]) -> str:
    n_row, n_col = result["posts"]
    levels = [["level", "bound", "faces", "max error", "recorded"]]
    for line in result["levels"]:
        errors = [f"{line['max_error']:.3f}{' ' if line['is_held'] else '*'}", f"{line['recorded_max_error']:.3f}"]
        levels.append([f"{line['level']}", f"{line['bound']:g}", f"{line['faces']}", *errors])
    size, replay = result["store"], result["replay"]
    speeds = ", ".join(f"{name} {speed / 1e6:.2f} million rows/s" for name, speed in replay["rows_per_s"].items())
    bounds = ", ".join(f"{bound:g}" for bound in result["bounds"])
    return "\n".join(
        [
            f"{result['dem']}, {n_row} × {n_col} posts, bounds {bounds} m, {result['processors']} processors\n",
            f"{contenders_text(result)}\n\n{table_text(levels, left=())}\n",
            f"store: {size['bytes'] / 1e6:.1f} MB, {size['bytes_per_face']:.1f} bytes per face of {size['faces']}",
            f"rows: {sum(replay['rows'].values())}; {speeds}; ratio {replay['ratio']:.2f}, "
            f"of processor seconds {replay['processor_ratio']:.2f}",
        ]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dem", type=Path, metavar="DEM", help="elevation file")
    bounds_help = "bounds of the levels, metres (default: 40,20,10)"
    parser.add_argument("--max-error", type=parse_bounds, default=(40.0, 20.0, 10.0), help=bounds_help)
    parser.add_argument("--repeat", type=int, default=3, help="runs of each contender (default: %(default)s)")
    parser.add_argument("--json", action="store_true", help="print JSON in place of tables")
    parser.add_argument("--alone", choices=(VPFX, GREEDY, RTIN, NOTHING), help=argparse.SUPPRESS)
    options = parser.parse_args()
    job = Job(options.dem, options.max_error, options.repeat)
    if options.alone:
        print(run_alone(job, options.alone))
        return
    with tempfile.TemporaryDirectory() as folder:
        result = measure(job, Path(folder))
    print(json.dumps(result, indent=2) if options.json else result_text(result))
    sys.exit(not all(line["is_held"] for line in result["levels"]))


if __name__ == "__main__":
    main()
