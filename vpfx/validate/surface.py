"""Rules V4xx: each face as a piece of the surface, and no two nodes in one place (R-151, R-170, R-171)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from vpfx.dem.reference import ground_size
from vpfx.validate.kernels import measure_slopes
from vpfx.validate.level_data import LevelData
from vpfx.validate.report import ERROR, Defects, Rule, some
from vpfx.validate.store_data import StoreData

__all__ = ["RULES"]

HALF = 0.5
"""Of a hundredth of a degree, by which a rounded one may differ; `measure_slopes` says by how much more."""
CIRCLE = 36000  # hundredths of a degree


def check_clockwise(level: LevelData) -> Iterator[Defects]:
    """No face goes round clockwise: exact."""
    wrong = np.flatnonzero(level.turns < 0)
    yield from some(wrong, lambda i: (level.place("face", i), "found its nodes clockwise, expected counter-clockwise"))


def check_areas(level: LevelData) -> Iterator[Defects]:
    """No face has its nodes on one line: exact."""
    wrong = np.flatnonzero(level.turns == 0)
    yield from some(wrong, lambda i: (level.place("face", i), "found its nodes on one line, expected an area above 0"))


def check_places(data: StoreData) -> Iterator[Defects]:
    """No two nodes have the same x and y."""
    x, y = data.xyz[:, 0], data.xyz[:, 1]
    order = np.lexsort((y, x))
    same = np.flatnonzero((x[order[1:]] == x[order[:-1]]) & (y[order[1:]] == y[order[:-1]]))
    ids = data.nodes["node_id"]

    def text(i: int) -> tuple[str, str]:
        return f"node={ids[order[i + 1]]}", f"found it at the place of node {ids[order[i]]}, expected one node a place"

    yield from some(same, text)


def _slopes(level: LevelData) -> NDArray[np.float64]:
    """Slope, its slack, aspect and its slack of every face, hundredths of a degree, (n_face, 4); aspect NaN if level."""
    crs, boxes, lattice = level.data.crs, level.data.boxes, level.data.metadata["lattice"]
    middles = (boxes[:, :2] + boxes[:, 2:]) / 2
    metres = np.array([ground_size(crs, x, y, lattice["dx"], lattice["dy"]) for x, y in middles.tolist()])
    found = np.empty((len(level.face_nodes), 4))
    places = np.column_stack([level.data.places, level.data.xyz[:, 2]])
    slack = np.array([*level.data.place_slack / np.array([lattice["dx"], lattice["dy"]]), level.data.height_slack])
    measure_slopes(places, level.face_nodes, metres[level.faces["tile_id"] - 1], slack, found)
    return found


def check_slopes(level: LevelData) -> Iterator[Defects]:
    """The slope is that of the face, rounded."""
    slope, slack, _, _ = level.once(_slopes).T
    told = level.faces["slope_centidegrees"]
    wrong = np.flatnonzero(~(np.abs(told - slope) <= HALF + slack))
    yield from some(wrong, lambda i: (level.place("face", i), f"slope: found {told[i]}, measured {slope[i]:.2f}"))


def check_aspects(level: LevelData) -> Iterator[Defects]:
    """The aspect is that of the face, rounded, and NULL where the slope rounds to 0."""
    _, _, aspect, slack = level.once(_slopes).T
    told, slope = level.faces["aspect_centidegrees"], level.faces["slope_centidegrees"]
    off = np.abs(told - aspect)
    off = np.minimum(off, CIRCLE - off)
    is_wrong = np.where(slope == 0, told >= 0, (told < 0) | (off > HALF + slack))

    def text(i: int) -> tuple[str, str]:
        expected = "NULL for a level face" if slope[i] == 0 else f"{aspect[i]:.2f}"
        return level.place("face", i), f"aspect: found {told[i]} (-1 is NULL), expected {expected}"

    yield from some(np.flatnonzero(is_wrong), text)


def check_filled(level: LevelData) -> Iterator[Defects]:
    """Faces are filled only in a store that was built so."""
    if level.data.metadata["options"].get("fill") is False:
        wrong = np.flatnonzero(level.faces["is_filled"] == 1)
        yield from some(wrong, lambda i: (level.place("face", i), "found a filled face in a store built without fill"))


RULES = (
    Rule("V401", "face_clockwise", ERROR, "R-170", "a face is clockwise", check_clockwise, "level", ("face_reference",)),
    Rule("V402", "face_area", ERROR, "R-170", "a face has no area", check_areas, "level", ("face_reference",)),
    Rule("V403", "equal_places", ERROR, "R-151", "two nodes lie at one place", check_places, needs=("node_values",)),
    Rule("V404", "slope", ERROR, "R-171", "the slope of a face is another", check_slopes, "level",
         ("face_clockwise", "face_area", "row_range")),
    Rule("V405", "aspect", ERROR, "R-171", "the aspect of a face is another", check_aspects, "level", ("slope",)),
    Rule("V406", "filled_face", ERROR, "R-170", "a face is filled where nothing was to be filled", check_filled, "level",
         ("row_values", "metadata")),
)  # fmt: skip
