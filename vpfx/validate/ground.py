"""Rules V52x: levels against the posts of the DEM they were built from (R-121, R-151, R-170)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import InputError
from vpfx.validate.kernels import measure_posts
from vpfx.validate.level_data import LevelData
from vpfx.validate.report import ERROR, Defects, Rule, one, some
from vpfx.validate.store_data import StoreData

__all__ = ["RULES"]

SAME_PLACE = 1e-6
"""Of a post spacing, by which two accounts of a lattice may differ."""
SAME_ERROR = 1e-6
"""Metres, and part of itself, by which a measured error may differ: faces as thin as a hair are steep."""
SAME_HEIGHT = 1e-8
"""Part of the greatest height by which it may differ besides: those faces are as steep as the relief allows."""
MOST_MOVED = 2.0
"""Slacks of places by which a face may lie elsewhere: each corner by one, against a post that stays."""
ON_LINE = 16.0
"""Units in the last place of the extent within which a post lies on an edge."""
AT_POST = 4.0
"""Units in the last place of the extent from a post within which a node lies at it."""


def check_lattice(data: StoreData) -> Iterator[Defects]:
    """The posts of the elevation files are those of the store."""
    if not data.dem:
        return
    lattice, metadata = data.metadata["lattice"], data.metadata
    try:
        grid = data.grid
    except InputError as error:
        yield one("table=metadata name=lattice", f"found an elevation file without these posts: {error}")
        return
    if grid.heights.shape != (lattice["n_row"], lattice["n_col"]):
        expected = f"{lattice['n_row']} rows × {lattice['n_col']} columns"
        yield one("table=metadata name=lattice", f"found {grid.heights.shape} posts in the extent, expected {expected}")
        return
    off = max(
        abs(grid.x0 - lattice["x0"]) / lattice["dx"], abs(grid.y0 - lattice["y0"]) / lattice["dy"],
        abs(grid.dx / lattice["dx"] - 1) * lattice["n_col"], abs(grid.dy / lattice["dy"] - 1) * lattice["n_row"],
    )  # fmt: skip
    if off > SAME_PLACE:
        yield one("table=metadata name=lattice", f"found posts {off:.3g} spacings off, expected the same places")
    n_void = int(np.isnan(grid.heights).sum())
    if n_void != metadata["void_posts"]:
        yield one(
            "table=metadata name=void_posts", f"found {metadata['void_posts']}, the elevation files have {n_void}"
        )


class _Measured:
    """What posts say of a level."""

    def __init__(self, level: LevelData) -> None:
        grid = level.data.grid
        self.error = np.full(grid.heights.shape, np.nan)
        self.void_of = np.full(len(level.face_nodes), -1, np.int64)
        places = np.column_stack([level.data.places, level.data.xyz[:, 2]])
        is_filled = level.faces["is_filled"] == 1
        on_line = ON_LINE * float(level.data.place_ulp.max())
        measure_posts(places, level.face_nodes, is_filled, grid.heights, on_line, self.error, self.void_of)
        found = self.error[~np.isnan(self.error)]
        self.n_post = len(found)
        self.max_error = float(found.max(initial=0.0))
        self.rmse = float(np.sqrt(np.mean(found * found))) if len(found) else 0.0


def _differs(told: float, found: float, level: LevelData) -> bool:
    height = float(np.abs(level.data.xyz[:, 2]).max(initial=0.0))
    slack = _surface_slack(level) if level.data.is_single else 0.0
    return abs(told - found) > SAME_ERROR * (1.0 + found) + SAME_HEIGHT * height + slack


def _surface_slack(level: LevelData) -> float:
    """How far rounding of places may have moved the surface up or down, metres: by the steepest face, within its relief."""
    xyz = level.data.xyz
    one_side, other_side = (xyz[level.face_nodes[:, i]] - xyz[level.face_nodes[:, 0]] for i in (1, 2))
    normal = np.cross(one_side, other_side)
    relief = np.ptp(xyz[level.face_nodes, 2], axis=1)
    moved = MOST_MOVED * level.data.place_slack * np.hypot(normal[:, 0], normal[:, 1]) / normal[:, 2]
    return float(np.minimum(moved, relief).max(initial=0.0)) + 2 * level.data.height_slack


def check_error(level: LevelData) -> Iterator[Defects]:
    """The greatest error is that at the posts."""
    if level.data.dem and _differs(level.row.max_error, found := level.once(_Measured).max_error, level):
        yield one(f"level={level.level}", f"max_error: found {level.row.max_error}, measured {found}")


def check_rmse(level: LevelData) -> Iterator[Defects]:
    """The root mean square is that of the errors at the posts."""
    if level.data.dem and _differs(level.row.rmse, found := level.once(_Measured).rmse, level):
        yield one(f"level={level.level}", f"rmse: found {level.row.rmse}, measured {found}")


def check_posts(level: LevelData) -> Iterator[Defects]:
    """Faces on ground with data touch as many valid posts as were counted."""
    if level.data.dem and level.row.post_count != level.once(_Measured).n_post:
        found = level.once(_Measured).n_post
        yield one(f"level={level.level}", f"post_count: found {level.row.post_count}, faces touch {found} valid posts")


def check_voids(level: LevelData) -> Iterator[Defects]:
    """No face has a void inside, unless it is filled."""
    if not level.data.dem:
        return
    void, n_col = level.once(_Measured).void_of, level.data.grid.heights.shape[1]

    def text(i: int) -> tuple[str, str]:
        return level.place("face", i), f"found the void of post ({void[i] // n_col}, {void[i] % n_col}) inside"

    yield from some(np.flatnonzero(void >= 0), text)


def _nodes_at_posts(data: StoreData) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Nodes at valid posts, and the heights of those."""
    post = np.rint(data.places).astype(np.int64)
    at = np.flatnonzero((np.abs(data.places - post) <= AT_POST * data.place_ulp).all(axis=1))
    heights = data.grid.heights[post[at, 1], post[at, 0]]
    return at[~np.isnan(heights)], heights[~np.isnan(heights)]


def check_heights(data: StoreData) -> Iterator[Defects]:
    """A node at a post has its height, unless heights were fitted or come from surveyed lines."""
    options = data.metadata["options"]
    if not data.dem or options.get("fit") or options.get("features"):
        return
    node, height = _nodes_at_posts(data)
    z = data.xyz[node, 2]

    def text(i: int) -> tuple[str, str]:
        return f"node={data.nodes['node_id'][node[i]]}", f"z: found {z[i]}, its post has {height[i]}"

    slack = 1e-9 * (1.0 + np.abs(height)) + data.height_slack
    if data.is_single:  # a node that floats do not tell from a post has come there
        slack += data.place_slack * _steepest(data)
    yield from some(np.flatnonzero(np.abs(z - height) > slack), text)


def _steepest(data: StoreData) -> float:
    """Rise between posts beside each other, greatest in x plus greatest in y, metres a CRS unit."""
    lattice, heights = data.metadata["lattice"], data.grid.heights
    steps = zip((1, 0), (lattice["dx"], lattice["dy"]), strict=True)
    return sum(float(np.nanmax(np.abs(np.diff(heights, axis=axis)), initial=0.0)) / step for axis, step in steps)


MEASURED = ("dem_lattice", "node_height", "face_place", "face_clockwise", "face_area", "row_range")
RULES = (
    Rule("V520", "dem_lattice", ERROR, "R-110", "the elevation files have other posts", check_lattice,
         needs=("post_counts", "tile_extent")),
    Rule("V521", "measured_error", ERROR, "R-121", "the greatest error is another, measured at the posts", check_error,
         "level", (*MEASURED, "measured_posts")),
    Rule("V522", "measured_rmse", ERROR, "R-121", "the root mean square of the errors is another, measured at the posts",
         check_rmse, "level", (*MEASURED, "measured_error")),
    Rule("V523", "measured_posts", ERROR, "R-121", "faces do not touch as many posts as were counted", check_posts,
         "level", MEASURED),
    Rule("V524", "node_height", ERROR, "R-151", "a node at a post has another height", check_heights,
         needs=("dem_lattice", "node_place")),
    Rule("V525", "void_covered", ERROR, "R-170", "a face covers a void and is not filled", check_voids, "level",
         MEASURED),
)  # fmt: skip
