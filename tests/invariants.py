"""The judge of everything that vpfx builds: exact where it matters, and sharing no code with the builder.

``python tests/invariants.py STORE DEM...`` judges a store against the elevation files it was built from: one line per
level on stdout, the first defect on stderr, exit status 0 or 1 (2: usage, 3: a file cannot be read).

The parts: `invariants_mesh` (one level as a mesh, links), `invariants_ground` (a level against the posts),
`invariants_store` (tables and winged edges), `invariants_levels` (T-junctions, heights of the level before).
"""

from __future__ import annotations

import itertools
import math
import sqlite3
import sys
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import rasterio.errors
from invariants_ground import Measured, Posts, find_ground, judge_bound, judge_cover
from invariants_levels import judge_junctions, judge_shared_areas, judge_z_parent
from invariants_mesh import (
    PLAIN,
    UNIT,
    Border,
    Label,
    border_length,
    coordinate_tolerance,
    judge_links,
    judge_mesh,
    require,
    total_area,
)
from invariants_store import (
    Level,
    Tables,
    judge_edges,
    read_level,
    read_posts,
    read_shared_areas,
    read_tables,
    register,
)

__all__ = [
    "Figures",
    "Label",
    "Posts",
    "judge_bound",
    "judge_hierarchy",
    "judge_links",
    "judge_store",
    "judge_tin",
    "read_posts",
]

RMSE = 1e-6
"""Part by which two sums of the same squared errors may differ: far above the rounding of 10⁹ additions."""


class Figures(NamedTuple):
    """What was counted and measured at one level; errors are NaN where no posts were given to measure at."""

    level: int
    bound: float
    max_error: float
    rmse: float
    n_post: int
    n_node: int
    n_edge: int
    n_face: int


def judge_tin(
    nodes: Any,
    face_nodes: Any,
    *,
    is_filled: Any = None,
    posts: Any = None,
    expected_area: float | None = None,
    is_adjacent: bool = True,
    label: Label = PLAIN,
) -> Border:
    """Judge one level as a mesh and, given `posts`, that it tiles their ground; return its edges.

    Parameters
    ----------
    nodes : float64 (n_node, 3)
        The nodes of this level only.
    face_nodes : int (n_face, 3)
        Node indices.
    is_filled : bool (n_face,), optional
        Faces on ground without data; if there is any, all faces together must tile the rectangle.
    posts : Posts or Grid, optional
        The lattice; without it, outline, area and Euler characteristic are not judged.
    expected_area : float, optional
        Area in squared CRS units, for callers without a lattice.
    is_adjacent : bool
        Whether T-junctions are a defect.

    Raises
    ------
    AssertionError
        Something is wrong; the message names level, face and node.
    """
    faces = np.asarray(face_nodes, np.int64)
    border = judge_mesh(nodes, faces, is_adjacent=is_adjacent, label=label)
    if expected_area is not None:
        xy = np.asarray(nodes, np.float64)[:, :2]
        slack = coordinate_tolerance(xy) * border_length(xy, faces, border.half) + 4 * UNIT * abs(expected_area)
        area = total_area(xy, faces)
        label.accuse(abs(area - expected_area) > slack, lambda _: f"faces cover {area!r}, expected {expected_area!r}")
    if posts is not None:
        filled = np.zeros(len(faces), bool) if is_filled is None else np.asarray(is_filled, bool)
        if filled.any():
            whole = find_ground(np.zeros(posts.heights.shape))
            judge_cover(nodes, faces, posts, whole, border=border, label=label)
            label = label._replace(face_ids=np.arange(len(faces)) if label.face_ids is None else label.face_ids)
            label = label._replace(face_ids=label.face_ids[~filled])
        if is_adjacent or not filled.any():
            own = border if not filled.any() else None
            judge_cover(nodes, faces[~filled], posts, find_ground(posts.heights), border=own, label=label)
    return border


def judge_figures(measured: Measured, bound: float, max_error: float, rmse: float, label: Label) -> None:
    """Judge that the errors a level claims are those measured, and the greatest is within its bound."""
    label.accuse(
        not measured.least_max <= max_error <= measured.greatest_max,
        lambda _: f"max_error is {max_error!r}, measured {measured.max_error!r}",
    )
    label.accuse(
        not abs(rmse - measured.rmse) <= RMSE * measured.rmse + measured.rmse_slack,
        lambda _: f"rmse is {rmse!r}, measured {measured.rmse!r}",
    )
    slack = measured.greatest_max - measured.max_error
    label.accuse(max_error > bound + slack, lambda _: f"max_error is {max_error!r}, its bound {bound!r}")


def judge_bounds_fall(bounds: list[float]) -> None:
    """Judge that no level has a wider bound than a coarser one."""
    for level, (coarse, fine) in enumerate(itertools.pairwise(bounds), start=1):
        require(not fine > coarse, f"level {level}: its bound {fine!r} is above the {coarse!r} of the level before")


def judge_hierarchy(hierarchy: Any, grid: Any, *, is_adjacent: bool = True, is_nested: bool = True) -> list[Figures]:
    """Judge a `Hierarchy` against the `Grid` it was built from; T-junctions, and links of many to many, may be allowed.

    Raises
    ------
    AssertionError
        Something is wrong; the message names level, face and node.
    """
    h, figures = hierarchy, []
    PLAIN.accuse(np.diff(h.node_level) < 0, lambda i: f"node {i + 1}: nodes are not sorted by level")
    judge_bounds_fall(list(h.max_error_bound))
    for k, faces in enumerate(h.level_faces):
        label = Label(k)
        nodes = h.nodes[: np.searchsorted(h.node_level, k, side="right")]
        border = judge_tin(
            nodes, faces, is_filled=h.face_is_filled[k], posts=grid, is_adjacent=is_adjacent, label=label
        )
        bound = h.max_error_bound[k]
        measured = judge_bound(
            nodes, faces, h.face_is_filled[k], grid, bound=bound, is_adjacent=is_adjacent, label=label
        )
        n_post = h.n_post[k]
        require(n_post == measured.n_post, f"level {k}: n_post is {n_post}, measured {measured.n_post}")
        judge_figures(measured, bound, h.max_error[k], math.sqrt(h.squared_error[k] / max(n_post, 1)), label)
        if k:
            links = np.asarray(h.links[k - 1])
            label.accuse(np.diff(links[:, 1]) < 0, lambda i: f"link {i + 1}: links are not sorted by child")
            flags = h.face_is_filled[k - 1], h.face_is_filled[k]
            if not is_nested:
                judge_shared_areas(nodes, h.level_faces[k - 1], faces, links, h.link_area[k - 1], label)
                require(np.isnan(h.node_z_parent).all(), "z_parent where levels are not nested")
                figures.append(
                    Figures(k, bound, measured.max_error, measured.rmse, n_post, len(nodes), border.n_edge, len(faces))
                )
                continue
            judge_links(
                nodes, h.level_faces[k - 1], faces, links, is_filled=flags, label=label, parent_label=Label(k - 1)
            )
            is_new = h.node_level[: len(nodes)] == k
            judge_z_parent(nodes, h.node_z_parent, faces, h.level_faces[k - 1], links, is_new, label)
        figures.append(
            Figures(k, bound, measured.max_error, measured.rmse, n_post, len(nodes), border.n_edge, len(faces))
        )
    return figures


def judge_store(path: Any, dem_path: Any = None, *, grid: Any = None) -> list[Figures]:
    """Judge a store, and against the posts if a DEM (a path or several) or a grid is given.

    Raises
    ------
    AssertionError
        Something is wrong; the message names level, face and node.
    """
    if dem_path is not None:
        grid = read_posts(*(dem_path if isinstance(dem_path, list | tuple) else [dem_path]))
    return list(iter_store(path, grid))


def iter_store(path: Any, posts: Any) -> Iterator[Figures]:
    """Judge a store level by level; `posts` may be None."""
    tables = read_tables(path)
    try:
        judge_bounds_fall([_number(row[1], math.nan) for row in tables.levels])
        posts = None if posts is None else register(posts, tables.tiles)
        coarser = None
        for row in tables.levels:
            level = read_level(tables, row[0])
            yield _judge_level(level, row, posts)
            if coarser is not None:
                _judge_step(tables, coarser, level)
            coarser = level
    finally:
        tables.connection.close()


def _number(value: Any, null: float | None = None) -> float:
    """Return a number of the table `level`; NULL only where there is a stand-in."""
    if value is None and null is not None:
        return null
    require(isinstance(value, int | float), f"table level: found {value!r}, expected a number")
    return float(value)


def _judge_level(level: Level, row: tuple[Any, ...], posts: Any) -> Figures:
    """Judge mesh, edges, errors and the row of the table `level`."""
    label, counts = level.label, (len(level.nodes), len(level.edge_ids), len(level.faces))
    bound, max_error, rmse = _number(row[1], math.nan), _number(row[2]), _number(row[3])
    label.accuse(row[4:] != counts, lambda _: f"table level: found {row[4:]} nodes, edges and faces, counted {counts}")
    is_adjacent = len(level.junctions) == 0
    border = judge_tin(
        level.nodes, level.faces, is_filled=level.is_filled, posts=posts, is_adjacent=is_adjacent, label=label
    )
    label.accuse(
        border.n_edge != counts[1], lambda _: f"table edge: found {counts[1]} edges, the faces have {border.n_edge}"
    )
    judge_junctions(level, border)
    judge_edges(level)
    if posts is None:
        return Figures(row[0], bound, math.nan, math.nan, 0, *counts)
    measured = judge_bound(
        level.nodes, level.faces, level.is_filled, posts, bound=bound, is_adjacent=is_adjacent, label=label
    )
    judge_figures(measured, bound, max_error, rmse, label)
    return Figures(row[0], bound, measured.max_error, measured.rmse, measured.n_post, *counts)


def _judge_step(tables: Tables, parent: Level, child: Level) -> None:
    """Judge the links between two levels of a store."""
    is_step = tables.face_level[np.searchsorted(tables.face_ids, tables.links[:, 1])] == child.label.level
    links = [np.searchsorted(level.label.face_ids, tables.links[is_step, i]) for i, level in enumerate((parent, child))]
    areas = read_shared_areas(tables, is_step)
    if areas is not None:
        judge_shared_areas(child.nodes, parent.faces, child.faces, np.stack(links, axis=1), areas, child.label)
        return
    judge_links(
        child.nodes,
        parent.faces,
        child.faces,
        np.stack(links, axis=1),
        is_filled=(parent.is_filled, child.is_filled),
        label=child.label,
        parent_label=parent.label,
    )
    if child.z_parent is not None:
        is_new = tables.node_level[: len(child.nodes)] == child.label.level
        judge_z_parent(
            child.nodes, child.z_parent, child.faces, parent.faces, np.stack(links, axis=1), is_new, child.label
        )


def main(arguments: list[str]) -> int:
    """Judge a store from the command line."""
    if not arguments:
        print("usage: python tests/invariants.py STORE [DEM...]", file=sys.stderr)
        return 2
    store, *dems = arguments
    try:
        for f in iter_store(store, read_posts(*dems) if dems else None):
            print(
                f"level {f.level}: bound {f.bound:g} m, max error {f.max_error:.6g} m, rmse {f.rmse:.6g} m, "
                f"{f.n_post} posts, {f.n_node} nodes, {f.n_edge} edges, {f.n_face} faces",
                flush=True,
            )
    except AssertionError as defect:
        print(defect, file=sys.stderr)
        return 1
    except (OSError, sqlite3.Error, rasterio.errors.RasterioError) as failure:
        print(f"cannot judge: {failure}", file=sys.stderr)
        return 3
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
