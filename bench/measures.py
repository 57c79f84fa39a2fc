"""Time the measures of a level on a large mesh, beside sorting its node indices: ``python bench/measures.py``."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from vpfx import Grid, Tin
from vpfx.measures import measure_accuracy, measure_shape
from vpfx.report import to_text


def lattice(n_face: int) -> tuple[Tin, Grid]:
    """Return hilly ground on about as many faces as asked for, and posts twice as dense."""
    side = round((n_face / 2) ** 0.5) + 1
    row, col = np.indices((2 * side - 1, 2 * side - 1), dtype=np.float64)
    grid = Grid(100.0 * np.sin(row / 50.0) * np.cos(col / 70.0))
    nodes = np.stack([col[::2, ::2], row[::2, ::2], grid.heights[::2, ::2]], axis=-1).reshape(-1, 3)
    a = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + side + 1], 1), np.stack([a, a + side + 1, a + side], 1)])
    return Tin(nodes, faces), grid


def seconds(task: Callable[[], Any]) -> float:
    """Return the wall-clock time of a task."""
    start = time.perf_counter()
    task()
    return time.perf_counter() - start


def main() -> None:
    """Print seconds and their ratios to sorting."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--faces", type=int, default=10_000_000)
    small, tin = lattice(1000), lattice(parser.parse_args().faces)
    tasks: dict[str, Callable[[Tin, Grid], Any]] = {
        "sorting node indices": lambda tin, _: np.sort(tin.face_nodes, axis=None),
        "adjacency, slivers, angles, degrees": lambda tin, _: measure_shape(tin),
        "errors at the posts": measure_accuracy,
    }
    took = []
    for task in tasks.values():
        task(*small)  # compiles
        took.append(seconds(lambda task=task: task(*tin)))
    rows = [["faces", "", "seconds", "ratio"]]
    rows += [
        [f"{tin[0].n_face:,}", name, f"{t:.2f}", f"{t / took[0]:.1f}"] for name, t in zip(tasks, took, strict=True)
    ]
    print(to_text(rows))


if __name__ == "__main__":
    main()
