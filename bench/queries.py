"""Time questions to a store beside the obvious alternatives in the same run: ``python bench/queries.py STORE [STORE…]``.

Give a small and a large store, such as those of::

    vpfx build fixtures/dem/new_mexico_cell_5min_1arcsec.tif -o small.gpkg
    vpfx build big_tujunga_utm11_30m.tif -o large.gpkg --method quaternary --total --max-error 80,40
"""

from __future__ import annotations

import argparse
import sqlite3
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.tri import LinearTriInterpolator, Triangulation

import vpfx
from vpfx.query.horizontal import edge_neighbours
from vpfx.query.location import locate
from vpfx.query.vertical import parents
from vpfx.report import to_text
from vpfx.store.arrays import TableReader

N_PLACE = 1_000_000
N_FACE = 100_000


def seconds(task: Callable[[], Any]) -> float:
    """Return the wall-clock time of a task, the better of two."""
    found = []
    for _ in range(2):
        start = time.perf_counter()
        task()
        found.append(time.perf_counter() - start)
    return min(found)


def read_by_sqlite3(path: Path) -> list[np.ndarray]:
    """Read the table `face` as sqlite3 gives it."""
    with closing(sqlite3.connect(path)) as connection:
        rows = connection.execute("SELECT * FROM face").fetchall()
    return [np.array([-1 if value is None else value for value in column]) for column in zip(*rows, strict=True)]


def read_by_pages(path: Path) -> dict[str, np.ndarray]:
    """Read the table `face` from its pages."""
    with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, isolation_level=None)) as connection:
        return TableReader(connection, path).rows("face", [(1, 2**62)])


def neighbours_by_join(path: Path, faces: np.ndarray) -> list[Any]:
    """Find the faces across edges by a join."""
    query = (
        "SELECT f.face_id, e.left_face, e.right_face FROM face f "
        "JOIN edge e ON e.edge_id IN (f.edge_1, f.edge_2, f.edge_3) WHERE f.face_id BETWEEN ? AND ?"
    )
    with closing(sqlite3.connect(path)) as connection:
        return connection.execute(query, (int(faces[0]), int(faces[-1]))).fetchall()


def parents_by_join(path: Path, faces: np.ndarray) -> list[Any]:
    """Find parents by SQL."""
    with closing(sqlite3.connect(path)) as connection:
        query = "SELECT child_face, parent_face FROM parent_child WHERE child_face BETWEEN ? AND ?"
        return connection.execute(query, (int(faces[0]), int(faces[-1]))).fetchall()


def compare(path: Path) -> list[list[str]]:
    """Rows of texts: what is asked, our seconds, those of an alternative, and their ratio."""
    with vpfx.open_store(path) as store:
        level = len(store.levels) - 1
        tin = store.tin(level)
        faces = tin.face_attributes["face_id"][:N_FACE]
        places = np.random.default_rng(1).uniform(store.extent[:2], store.extent[2:], (N_PLACE, 2))
        mesh = Triangulation(tin.nodes[:, 0], tin.nodes[:, 1], tin.face_nodes)
        read_by_pages(path), locate(store, places[:10], level)  # compile
        tasks: dict[str, tuple[Callable[[], Any], str, Callable[[], Any]]] = {
            "table face as arrays": (lambda: read_by_pages(path), "sqlite3, numpy", lambda: read_by_sqlite3(path)),
            f"heights at {N_PLACE:,} places": (
                lambda: locate(store, places, level),
                "matplotlib's interpolator",
                lambda: LinearTriInterpolator(mesh, tin.nodes[:, 2])(*places.T),
            ),
            f"neighbours of {len(faces):,} faces": (
                lambda: edge_neighbours(store, faces), "a join", lambda: neighbours_by_join(path, faces),
            ),
            f"parents of {len(faces):,} faces": (
                lambda: parents(store, faces), "SQL", lambda: parents_by_join(path, faces),
            ),
        }  # fmt: skip
        rows = []
        for name, (ours, other, theirs) in tasks.items():
            own, alternative = seconds(ours), seconds(theirs)
            row = [f"{tin.n_face:,}", name, f"{own:.3f}", other, f"{alternative:.3f}", f"{alternative / own:.1f}"]
            rows.append(row)
    return rows


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("stores", nargs="+", type=Path)
    rows = [["faces", "", "seconds", "beside", "seconds", "times as fast"]]
    for path in parser.parse_args().stores:
        rows += compare(path)
    print(to_text(rows))


if __name__ == "__main__":
    main()
