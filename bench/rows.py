"""Rows into a new SQLite file: PageWriter against prepared statements from Python and from C.

All ways write the same rows of ten integer columns, shaped like the store's table `face`, into a file with one table;
journal and synchronous are off for the two that go through SQLite, while PageWriter flushes to the medium. Compare the
ratios of one run only; on a machine with other work to do, those of processor time. Example::

    python bench/rows.py --rows 2000000 --json
"""

from __future__ import annotations

import argparse
import ctypes.util
import json
import shutil
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vpfx.store.pages import PageWriter

COLUMNS = ["face_id", "tile_id", "level", "node_1", "node_2", "node_3", "edge_1", "edge_2", "edge_3", "parent_face"]
CALL_ROWS = 20_000
"""Rows of one call, as of one tile and level."""

C_SOURCE = r"""
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
typedef struct sqlite3 sqlite3;
typedef struct sqlite3_stmt sqlite3_stmt;
int sqlite3_open(const char *, sqlite3 **);
int sqlite3_exec(sqlite3 *, const char *, int (*)(void *, int, char **, char **), void *, char **);
int sqlite3_prepare_v2(sqlite3 *, const char *, int, sqlite3_stmt **, const char **);
int sqlite3_bind_int64(sqlite3_stmt *, int, long long);
int sqlite3_step(sqlite3_stmt *);
int sqlite3_reset(sqlite3_stmt *);
int sqlite3_finalize(sqlite3_stmt *);
int sqlite3_close(sqlite3 *);

/* usage: rows FILE ROWS N_ROW N_COL INSERT, where ROWS holds N_ROW x N_COL native 64-bit integers */
int main(int n_arg, char **args) {
    long n_row = atol(args[3]), n_col = atol(args[4]);
    long long *rows = malloc(8 * n_row * n_col);
    FILE *file = fopen(args[2], "rb");
    sqlite3 *db;
    sqlite3_stmt *insert;
    struct timespec start, end, cpu_start, cpu_end;
    if (n_arg != 6 || !file || fread(rows, 8 * n_col, n_row, file) != n_row) return 1;
    clock_gettime(CLOCK_MONOTONIC, &start);
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &cpu_start);
    if (sqlite3_open(args[1], &db)) return 2;
    sqlite3_exec(db, "PRAGMA journal_mode = OFF; PRAGMA synchronous = OFF; BEGIN", 0, 0, 0);
    if (sqlite3_prepare_v2(db, args[5], -1, &insert, 0)) return 3;
    for (long i = 0; i < n_row; i++) {
        for (long c = 0; c < n_col; c++) sqlite3_bind_int64(insert, c + 1, rows[i * n_col + c]);
        if (sqlite3_step(insert) != 101) return 4;
        sqlite3_reset(insert);
    }
    sqlite3_finalize(insert);
    if (sqlite3_exec(db, "COMMIT", 0, 0, 0) || sqlite3_close(db)) return 5;
    clock_gettime(CLOCK_MONOTONIC, &end);
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &cpu_end);
    printf("%.9f %.9f\n", (end.tv_sec - start.tv_sec) + 1e-9 * (end.tv_nsec - start.tv_nsec),
           (cpu_end.tv_sec - cpu_start.tv_sec) + 1e-9 * (cpu_end.tv_nsec - cpu_start.tv_nsec));
    return 0;
}
"""

INSERT = f"INSERT INTO face VALUES ({', '.join('?' * len(COLUMNS))})"

Rows = NDArray[np.int64]
Seconds = NDArray[np.float64]
"""Wall and processor time."""
Way = Callable[[Path, Rows], Seconds]


def clock() -> Seconds:
    return np.array([time.perf_counter(), time.process_time()])


def make_rows(n_row: int, first_id: int) -> Rows:
    """Return rows (n_col, n_row) whose references point to ids near their own, as those of a mesh do."""
    rng = np.random.default_rng(1998)
    face_id = np.arange(n_row) + first_id
    nodes = face_id // 2 + rng.integers(0, 500, (3, n_row))
    edges = face_id * 3 // 2 + rng.integers(0, 500, (3, n_row))
    index = np.arange(n_row)
    return np.stack([face_id, index // CALL_ROWS + 1, index // CALL_ROWS % 4, *nodes, *edges, face_id // 4])


def make_file(path: Path, page_size: int) -> Path:
    """Make a database with an empty table, in the place of an old one, and return its path."""
    path.unlink(missing_ok=True)
    with closing(sqlite3.connect(path)) as connection:
        connection.execute(f"PRAGMA page_size = {page_size}")
        columns = ", ".join(f"{name} INTEGER{' PRIMARY KEY' if i == 0 else ''}" for i, name in enumerate(COLUMNS))
        connection.execute(f"CREATE TABLE face ({columns})")
    return path


def write_python(path: Path, rows: Rows) -> Seconds:
    """Write with `executemany` and return the seconds it took; the tuples are made beforehand."""
    connection = sqlite3.connect(path, isolation_level=None)
    connection.executescript("PRAGMA journal_mode = OFF; PRAGMA synchronous = OFF; BEGIN")
    seconds = np.zeros(2)
    for at in range(0, rows.shape[1], CALL_ROWS):
        tuples = list(zip(*rows[:, at : at + CALL_ROWS].tolist(), strict=True))
        start = clock()
        connection.executemany(INSERT, tuples)
        seconds += clock() - start
    start = clock()
    connection.execute("COMMIT")
    connection.close()
    return seconds + clock() - start


def write_pages(path: Path, rows: Rows) -> Seconds:
    """Write with PageWriter and return the seconds it took."""
    start = clock()
    with PageWriter(path) as writer:
        for at in range(0, rows.shape[1], CALL_ROWS):
            writer.append("face", list(rows[:, at : at + CALL_ROWS]))
    return clock() - start


def make_c_writer(folder: Path, rows: Rows) -> Way | str:
    """Return a function that writes the rows with a C program, or the reason why there is none."""
    compiler, library = shutil.which("cc"), ctypes.util.find_library("sqlite3")
    if not compiler or not library:
        return "no C compiler" if not compiler else "no SQLite library"
    source, program, data = folder / "rows.c", folder / "rows", folder / "rows.i64"
    source.write_text(C_SOURCE)
    command = [compiler, "-O2", str(source), f"-l:{library}", "-o", str(program)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        return f"the C program does not compile: {done.stderr.strip().splitlines()[-1]}"
    data.write_bytes(np.ascontiguousarray(rows.T).tobytes())

    def write(path: Path, rows: Rows) -> Seconds:
        arguments = [program, path, data, rows.shape[1], rows.shape[0], INSERT]
        done = subprocess.run([str(word) for word in arguments], capture_output=True, text=True, check=True)
        return np.array(done.stdout.split(), float)

    return write


def measure(n_row: int, first_id: int, page_size: int, repeat: int, folder: Path) -> list[dict[str, object]]:
    """Run all ways in turn, several times, and return the best of each."""
    rows = make_rows(n_row, first_id)
    ways: dict[str, Way] = {"sqlite3 executemany": write_python, "PageWriter": write_pages}
    c_writer = make_c_writer(folder, rows)
    if isinstance(c_writer, str):
        print(f"C, prepared statement: left out: {c_writer}", file=sys.stderr)
    else:
        ways["C, prepared statement"] = c_writer
    path = folder / "rows.db"
    write_pages(make_file(path, page_size), rows[:, :1000])  # compiles the kernels or loads them
    seconds: dict[str, list[Seconds]] = {name: [] for name in ways}
    sizes = {}
    for _ in range(repeat):
        for name, write in ways.items():
            seconds[name].append(write(make_file(path, page_size), rows))
            sizes[name] = path.stat().st_size
    best = {name: np.min(values, axis=0) for name, values in seconds.items()}
    lines: list[dict[str, object]] = []
    for name in ways:
        line: dict[str, object] = {"way": name, "bytes_per_row": sizes[name] / n_row}
        for i, clock_name in enumerate(("wall", "cpu")):
            line[f"million_rows_per_{clock_name}_s"] = n_row / best[name][i] / 1e6
            for peer, key in (("sqlite3 executemany", "python"), ("C, prepared statement", "c")):
                line[f"{clock_name}_ratio_to_{key}"] = best[peer][i] / best[name][i] if peer in best else None
        lines.append(line)
    return lines


def print_table(lines: list[dict[str, object]]) -> None:
    keys = [f"{clock}_ratio_to_{peer}" for clock in ("wall", "cpu") for peer in ("python", "c")]
    keys[2:2] = ["million_rows_per_cpu_s"]
    keys[:0] = ["bytes_per_row", "million_rows_per_wall_s"]
    heads = ["bytes/row", "M rows/wall s", "x Python", "x C", "M rows/cpu s", "x Python", "x C"]
    print(f"{'way':22}" + "".join(f"{head:>14}" for head in heads))
    for line in lines:
        cells = ["-" if line[key] is None else f"{line[key]:.2f}" for key in keys]
        print(f"{line['way']:22}" + "".join(f"{cell:>14}" for cell in cells))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=2_000_000, help="number of rows (default: %(default)s)")
    parser.add_argument("--first-id", type=int, default=1 << 33, help="lowest id (default: %(default)s)")
    parser.add_argument("--page-size", type=int, default=4096, help="bytes of a page (default: %(default)s)")
    parser.add_argument(
        "--repeat", type=int, default=3, help="runs of each way; the best counts (default: %(default)s)"
    )
    parser.add_argument("--json", action="store_true", help="print JSON in place of a table")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        lines = measure(options.rows, options.first_id, options.page_size, options.repeat, Path(folder))
    if options.json:
        print(json.dumps({"rows": options.rows, "page_size": options.page_size, "ways": lines}, indent=2))
        return
    print_table(lines)


if __name__ == "__main__":
    main()
