"""Time questions to stores beside the obvious alternatives, and how they grow: ``python bench/queries.py SMALL LARGE``.

Questions are about a window in the middle of the last level, of the same size in each store, so the answers are alike and what
grows is the store. Each is asked of a store newly opened (the first answer), and again (the better of two). The last table fits
the growth: seconds ~ faces of the store to the power of the exponent, 0 if the store does not count, 1 if all of it is read.

Example::

    python bench/fractal.py 513 -o small.tif && python bench/fractal.py 4097 -o large.tif
    vpfx build small.tif -o small.gpkg --max-error 160,80,40,20,10,6
    vpfx build large.tif -o large.gpkg --max-error 160,80,40,20,10,6
    python bench/queries.py small.gpkg large.gpkg
"""

from __future__ import annotations

import argparse
import math
import sqlite3
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import fiona
import numpy as np
from matplotlib.tri import LinearTriInterpolator, Triangulation
from scipy.interpolate import LinearNDInterpolator

import vpfx
from vpfx.model import Tin
from vpfx.query.contours import contours
from vpfx.query.cut import cut
from vpfx.query.horizontal import edge_neighbours, k_ring
from vpfx.query.lines import profile
from vpfx.query.location import locate
from vpfx.query.region import region
from vpfx.query.vertical import parents
from vpfx.report import to_text

N_PLACE = 1_000_000
WINDOW = 200  # post spacings: sides of the window
CUT_FACES = 100_000
JOIN = (
    "SELECT f.face_id, a.x, a.y, a.z, b.x, b.y, b.z, c.x, c.y, c.z FROM face f JOIN node a ON a.node_id = f.node_1 "
    "JOIN node b ON b.node_id = f.node_2 JOIN node c ON c.node_id = f.node_3 WHERE f.level = ? AND max(a.x, b.x, c.x) >= ? "
    "AND max(a.y, b.y, c.y) >= ? AND min(a.x, b.x, c.x) <= ? AND min(a.y, b.y, c.y) <= ?"
)


class Question(NamedTuple):
    """What is asked, how, and how others would answer it."""

    name: str
    ask: Callable[[Any], Any]
    beside: dict[str, Callable[[], Any]]


def seconds(task: Callable[[], Any], n: int = 2) -> float:
    """Return the wall-clock time of a task, the best of some."""
    found = []
    for _ in range(n):
        start = time.perf_counter()
        task()
        found.append(time.perf_counter() - start)
    return min(found)


def select(path: Path, query: str, values: tuple[Any, ...]) -> list[Any]:
    """Ask in plain SQL."""
    with closing(sqlite3.connect(path)) as connection:
        return connection.execute(query, values).fetchall()


def read_rows(path: Path, low: int, high: int) -> list[np.ndarray]:
    """Read rows of faces as sqlite3 gives them, and make arrays of them."""
    rows = select(path, "SELECT * FROM face WHERE face_id BETWEEN ? AND ?", (low, high))
    return [np.array([-1 if value is None else value for value in column]) for column in zip(*rows, strict=True)]


def read_by_fiona(path: Path, level: int, box: tuple[float, ...]) -> list[Any]:
    """Read the faces of a window as a GIS does."""
    with fiona.open(path, layer=f"face_{level}") as faces:
        return list(faces.filter(bbox=box))


def window_rows(store: Any, path: Path, level: int, n_row: int) -> Tin:
    """Read a window of at least so many faces round the middle."""
    x, y = (store.extent[0] + store.extent[2]) / 2, (store.extent[1] + store.extent[3]) / 2
    half = (store.extent[2] - store.extent[0]) / 2 * math.sqrt(n_row / store.levels[level].faces)
    return store.tin(level, (x - half, y - half, x + half, y + half))


def eye_of_cut(store: Any, wanted: int) -> tuple[tuple[float, float, float], float]:
    """Find an eye over the middle and the screen error at which a cut has about so many faces."""
    x, y = (store.extent[0] + store.extent[2]) / 2, (store.extent[1] + store.extent[3]) / 2
    eye = x, y, float(locate(store, [(x, y)], 0).z[0]) + 300.0
    low, high = 0.05, 500.0
    for _ in range(12):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if cut(store, eye, screen_error=middle).n_face > wanted else (low, middle)
    return eye, high


def questions(store: Any, path: Path) -> list[Question]:
    """Return what is asked of a store."""
    level = len(store.levels) - 1
    dx, dy = store.metadata["lattice"]["dx"], store.metadata["lattice"]["dy"]
    middle = np.array([(store.extent[i] + store.extent[i + 2]) / 2 for i in (0, 1)])
    half = WINDOW / 2 * np.array([dx, dy])
    low, high = middle - half, middle + half
    box = (*low.tolist(), *high.tolist())
    tin = store.tin(level, box)
    faces = tin.face_attributes["face_id"]
    places = np.random.default_rng(1).uniform(low, high, (N_PLACE, 2))
    heights = np.linspace(tin.nodes[:, 2].min(), tin.nodes[:, 2].max(), 12)[1:-1]
    mesh = Triangulation(tin.nodes[:, 0], tin.nodes[:, 1], tin.face_nodes)
    ids = int(faces[0]), int(faces[-1])
    links = "SELECT child_face, parent_face FROM parent_child WHERE child_face BETWEEN ? AND ?"
    across = (
        "SELECT f.face_id, e.left_face, e.right_face FROM face f JOIN edge e ON e.edge_id IN (edge_1, edge_2, edge_3)"
    )
    wanted = min(CUT_FACES, store.levels[-1].faces // 2)
    eye, screen_error = eye_of_cut(store, wanted)
    n_cut = cut(store, eye, screen_error=screen_error).n_face
    tile = int(store.tiles((*middle, *middle))["tile_id"][0])
    rows = store.tile_faces(level, tile)["face_id"]
    return [
        Question(f"{len(rows):,} rows of a tile as arrays", lambda s: s.tile_faces(level, tile), {
            "sqlite3, numpy": lambda: read_rows(path, int(rows[0]), int(rows[-1])),
        }),
        Question(f"heights at {N_PLACE:,} places on {len(faces):,} faces", lambda s: locate(s, places, level), {
            "matplotlib": lambda: LinearTriInterpolator(
                Triangulation(tin.nodes[:, 0], tin.nodes[:, 1], tin.face_nodes), tin.nodes[:, 2])(*places.T),
            "scipy": lambda: LinearNDInterpolator(tin.nodes[:, :2], tin.nodes[:, 2])(places),
        }),
        Question(f"region of {len(faces):,} faces", lambda s: region(s, level, bbox=box), {
            "fiona": lambda: read_by_fiona(path, level, box), "a join": lambda: select(path, JOIN, (level, *box)),
        }),
        Question("neighbours of its faces", lambda s: edge_neighbours(s, faces), {
            "a join": lambda: select(path, f"{across} WHERE f.face_id BETWEEN ? AND ?", ids),
        }),
        Question("parents of its faces", lambda s: parents(s, faces), {"SQL": lambda: select(path, links, ids)}),
        Question("5-ring of a face", lambda s: k_ring(s, faces[:1], 5), {}),
        Question("profile across it", lambda s: profile(s, [low, high], level), {}),
        Question(f"{len(heights)} contours", lambda s: contours(s, level, heights, bbox=box), {
            "matplotlib": lambda: tricontours(mesh, tin, heights),
        }),
        Question(f"cut of {n_cut:,} faces", lambda s: cut(s, eye, screen_error=screen_error), {
            "a window of as many": lambda: window_rows(store, path, level, n_cut),
        }),
    ]  # fmt: skip


def tricontours(mesh: Triangulation, tin: Tin, heights: np.ndarray) -> Any:
    """Draw contours without showing them."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots()
    axes.tricontour(mesh, tin.nodes[:, 2], heights)
    plt.close(figure)


def compare(path: Path) -> tuple[int, dict[str, tuple[str, float, float, dict[str, float]]]]:
    """Ask everything of a store: its faces, and by kind what was asked, seconds at first and again, and those of others."""
    found = {}
    with vpfx.open_store(path) as store:
        total = sum(line.faces for line in store.levels)
        for question in questions(store, path):
            question.ask(store)  # compiles
            with vpfx.open_store(path) as fresh:
                first = seconds(lambda fresh=fresh, question=question: question.ask(fresh), 1)
                again = seconds(lambda fresh=fresh, question=question: question.ask(fresh))
            others = {name: seconds(task, 1) for name, task in question.beside.items()}
            found["".join(c for c in question.name if not c.isdigit() and c != ",")] = (
                question.name,
                first,
                again,
                others,
            )
    return total, found


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("stores", nargs="+", type=Path)
    given = parser.parse_args()
    results = [compare(path) for path in given.stores]
    rows = [["faces of the store", "question", "first s", "again s", "beside", "s", "times as fast as it"]]
    for total, found in results:
        for name, first, again, others in found.values():
            for other, theirs in (others or {"–": math.nan}).items():
                beside = ["–", "–", "–"] if other == "–" else [other, f"{theirs:.3f}", f"{theirs / first:.1f}"]
                rows.append([f"{total:,}", name, f"{first:.3f}", f"{again:.3f}", *beside])
    print(to_text(rows))
    if len(results) > 1:
        (few, small), (many, large) = results[0], results[-1]
        rows = [["question", "exponent", "beside", "exponent"]]
        for kind, (_, first, _, others) in small.items():
            exponent = math.log(large[kind][1] / first) / math.log(many / few)
            for other, theirs in (others or {"–": math.nan}).items():
                grown = math.log(large[kind][3][other] / theirs) / math.log(many / few) if others else math.nan
                rows.append([kind, f"{exponent:.2f}", other, f"{grown:.2f}" if others else "–"])
        print(to_text(rows))


if __name__ == "__main__":
    main()
