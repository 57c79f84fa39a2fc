"""Tables of VPF, read and written: the codec against the bytes alone, and against a loop with struct.

Two tables: nodes, whose rows have one length, and edges, with triplets and places, whose rows do not. Both are written and
read by vpfx, in either byte order, and as many bytes by np.tofile and np.fromfile in the same run; a sample of the rows is
read by a plain loop with struct. Compare ratios of one run only. Example::

    python bench/vpf_codec.py --rows 3000000 --json
"""

from __future__ import annotations

import argparse
import json
import struct
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from vpfx.vpf.table import Column, Layout, Ragged, read_table, write_table

LOOP_ROWS = 20_000
WIDTHS = (0, 1, 2, 4)
LINKS = ("right_face", "left_face", "right_edge", "left_edge")
NODES = Layout(
    "Nodes",
    (
        Column("id", "I", 1, "P"), Column("first_edge", "I"), Column("name", "T", 8), Column("kind", "S"),
        Column("error", "F"), Column("coordinate", "Z"),
    ),
)  # fmt: skip
EDGES = Layout(
    "Edges",
    (
        Column("id", "I", 1, "P"), Column("start_node", "I"), Column("end_node", "I"), *(Column(k, "K") for k in LINKS),
        Column("coordinates", "Z", -1),
    ),
)  # fmt: skip


def make_nodes(n_row: int) -> dict[str, Any]:
    """Return rows of one length."""
    rng = np.random.default_rng(2407)
    return {
        "id": np.arange(1, n_row + 1, dtype=np.int32),
        "first_edge": rng.integers(1, n_row + 1, n_row, np.int32),
        "name": np.full(n_row, b"BM 1234 "),
        "kind": rng.integers(0, 99, n_row, np.int16),
        "error": rng.random(n_row, np.float32),
        "coordinate": rng.random((n_row, 3), np.float32),
    }


def make_edges(n_row: int) -> dict[str, Any]:
    """Return rows of different lengths: 2 to 19 places each, one link of twenty across a border of tiles."""
    rng = np.random.default_rng(2407)
    starts = np.concatenate([[0], np.cumsum(rng.integers(2, 20, n_row))])
    columns: dict[str, Any] = {name: rng.integers(1, n_row + 1, n_row, np.int32) for name in ("start_node", "end_node")}
    for name in LINKS:
        columns[name] = np.zeros((n_row, 3), np.int64)
        columns[name][:, 0] = rng.integers(1, n_row + 1, n_row)
        columns[name][rng.random(n_row) < 0.05, 1:] = (12, 300)
    places = rng.random((int(starts[-1]), 3), np.float32)
    return {"id": np.arange(1, n_row + 1), **columns, "coordinates": Ragged(starts, places)}


def loop_nodes(data: bytes, at: int, order: str, n_row: int) -> None:
    """Read rows of one length, one at a time."""
    rows = []
    for i in range(n_row):
        rows.append(struct.unpack_from(order + "ii8shf3f", data, at + i * 34))


def loop_edges(data: bytes, at: int, order: str, n_row: int) -> None:
    """Read rows of different lengths, one value at a time."""
    rows = []
    for _ in range(n_row):
        row = list(struct.unpack_from(order + "iii", data, at))
        at += 12
        for _ in LINKS:
            code = data[at]
            at += 1
            for shift in (6, 4, 2):
                width = WIDTHS[code >> shift & 3]
                row.append(int.from_bytes(data[at : at + width], "little" if order == "<" else "big"))
                at += width
        (count,) = struct.unpack_from(order + "i", data, at)
        row.append(struct.unpack_from(f"{order}{3 * count}f", data, at + 4))
        at += 4 + 12 * count
        rows.append(row)


TABLES: dict[str, tuple[Layout, Callable[[int], dict[str, Any]], Callable[[bytes, int, str, int], None], int]] = {
    "nodes": (NODES, make_nodes, loop_nodes, 1),
    "edges": (EDGES, make_edges, loop_edges, 5),  # as many bytes in a fifth of the rows
}


def seconds_of(work: Callable[[], Any]) -> float:
    """Return how long something takes; what it returns is thrown away before the end."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def measure(name: str, order: str, n_row: int, repeat: int, folder: Path) -> dict[str, Any]:
    """Return the best times of one table in one byte order."""
    layout, make, loop, share = TABLES[name]
    layout, n_row = layout._replace(order=order), n_row // share
    columns, path, raw_path = make(n_row), folder / "edg", folder / "raw"
    write_table(path, layout, columns)
    raw = np.fromfile(path, np.uint8)
    ways: dict[str, Callable[[], Any]] = {
        "write": lambda: write_table(path, layout, columns),
        "tofile": lambda: raw.tofile(raw_path),
        "read": lambda: read_table(path),
        "fromfile": lambda: np.fromfile(raw_path, np.uint8),
    }
    best: dict[str, float] = {}
    for _ in range(repeat):
        for file in (path, folder / "edx", raw_path):
            file.unlink(missing_ok=True)  # the medium gives room to new files, for both alike
        for way, work in ways.items():
            best[way] = min(best.get(way, np.inf), seconds_of(work))
    (folder / "edx").unlink(missing_ok=True)
    best["read_without_index"] = min(seconds_of(lambda: read_table(path)) for _ in range(repeat))
    first = 4 + int.from_bytes(raw[:4].tobytes(), "little" if order == "<" else "big")
    n_loop = min(LOOP_ROWS, n_row)
    data = raw.tobytes()
    best["loop"] = min(seconds_of(lambda: loop(data, first, order, n_loop)) for _ in range(repeat))
    return {
        "table": name, "order": order, "rows": n_row, "bytes": raw.size,
        "read_million_rows_per_s": n_row / best["read"] / 1e6, "read_ratio_to_fromfile": best["read"] / best["fromfile"],
        "no_index_ratio_to_fromfile": best["read_without_index"] / best["fromfile"],
        "write_million_rows_per_s": n_row / best["write"] / 1e6, "write_ratio_to_tofile": best["write"] / best["tofile"],
        "loop_million_rows_per_s": n_loop / best["loop"] / 1e6,
        "read_ratio_to_loop": best["loop"] / n_loop * n_row / best["read"],
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=3_000_000, help="rows of one length (default: %(default)s)")
    parser.add_argument("--repeat", type=int, default=3, help="runs; the best of each counts (default: %(default)s)")
    parser.add_argument("--json", action="store_true", help="print JSON in place of a table")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        lines = [
            measure(name, order, options.rows, options.repeat, Path(folder)) for name in TABLES for order in ("<", ">")
        ]
    if options.json:
        print(json.dumps(lines, indent=2))
        return
    print(f"{'':8}{'MB':>8}{'read':>24}{'no index':>12}{'write':>22}{'struct loop':>14}")
    for line in lines:
        print(
            f"{line['table']} {line['order']} {line['bytes'] / 1e6:8.0f}{line['read_million_rows_per_s']:8.1f} M rows/s"
            f" x{line['read_ratio_to_fromfile']:5.1f}      x{line['no_index_ratio_to_fromfile']:5.1f}"
            f"{line['write_million_rows_per_s']:7.1f} M rows/s x{line['write_ratio_to_tofile']:5.1f}"
            f"{line['loop_million_rows_per_s']:8.2f} M rows/s"
        )
    print("x: times as long as np.fromfile or np.tofile of as many bytes")


if __name__ == "__main__":
    main()
