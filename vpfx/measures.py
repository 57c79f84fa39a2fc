"""Measures of levels: adjacency, nesting, streakiness, sliveriness, needless cuts, accuracy; on whole arrays.

The words are the paper's (paper-facts §1, §4); what is counted is said in specs/methods.md M-600 … M-650.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.dem.reference import unit_metres
from vpfx.errors import InputError
from vpfx.geometry import face_shapes
from vpfx.methods.scan import find_worst, scan_mesh
from vpfx.model import CUTS, Grid, Hierarchy, Tin
from vpfx.store.reader import StoreReader
from vpfx.topology import find_t_junctions, find_twins

__all__ = [
    "NORMAL",
    "Accuracy",
    "LevelMeasures",
    "Shape",
    "Step",
    "face_errors",
    "measure_accuracy",
    "measure_hierarchy",
    "measure_mesh",
    "measure_shape",
    "measure_step",
    "measure_store",
    "streakiness",
]

Floats = NDArray[np.float64]

NORMAL = 19.78
"""What the paper takes from perimeter² / area, so that 1 is the best (paper-facts §4)."""

VERTEX_BISECTIONS, EDGE_BISECTIONS = np.array([1, 1, 0, 3, 3]), np.array([1, 2, 3, 0, 1])
"""Of each kind of cut, as `vpfx.model.CUTS`. Source: paper-facts §4."""

NO_POST = "measure: found no valid post under the faces, expected some; is it the right DEM?"
ANGLES = (5, 50)
"""Percentiles of the smallest angles that are told."""


class Shape(NamedTuple):
    """How the faces of one level look from above (M-610, M-620).

    Attributes
    ----------
    t_junctions : int
        Nodes inside edges.
    max_gap, mean_gap : float
        Heights of the gaps there, metres; 0 without any.
    mean_sliveriness, max_sliveriness, min_sliveriness : float
        Perimeter² / area; 12√3 = 20.785 is the best.
    normal_sliveriness : float
        The mean in the paper's form, less `NORMAL`.
    angle_5, angle_50 : float
        Percentiles of the smallest angles, degrees.
    mean_degree, max_degree : float
        Edges at a node.
    """

    t_junctions: int
    max_gap: float
    mean_gap: float
    mean_sliveriness: float
    max_sliveriness: float
    min_sliveriness: float
    normal_sliveriness: float
    angle_5: float
    angle_50: float
    mean_degree: float
    max_degree: int


class Step(NamedTuple):
    """What the way from one level to the next brought (M-630, M-640); NaN and 0 where levels are not nested.

    Attributes
    ----------
    one_parent : float
        Share of the children that have one parent.
    area_error : float
        Greatest part by which the areas of children and parent differ.
    cuts : int
        Parents with more than one child.
    needless : float
        Share of them without a significant point.
    points_per_cut : float
        Significant points in or on a parent that is cut, on average.
    """

    one_parent: float
    area_error: float
    cuts: int
    needless: float
    points_per_cut: float


class Accuracy(NamedTuple):
    """Vertical errors at all valid posts, metres (M-650).

    Attributes
    ----------
    max_error, rmse, percentile_99 : float
        Greatest; root mean square; 99 % of the posts are off by no more.
    bias : float
        Mean of surface less post.
    posts : int
    """

    max_error: float
    rmse: float
    percentile_99: float
    bias: float
    posts: int


class LevelMeasures(NamedTuple):
    """All measures of one level.

    Attributes
    ----------
    level, nodes, faces : int
    shape : Shape
    accuracy : Accuracy or None
        None without posts to measure at.
    streakiness : float
        NaN where no cut was made, or none is known.
    step : Step or None
        None for level 0.
    """

    level: int
    nodes: int
    faces: int
    shape: Shape
    accuracy: Accuracy | None
    streakiness: float
    step: Step | None


def measure_shape(tin: Tin, metres: tuple[float, float] = (1.0, 1.0)) -> Shape:
    """Measure adjacency and shape of one level.

    Parameters
    ----------
    tin : Tin
    metres : tuple of float
        Size of a unit of x and of y, metres.

    Raises
    ------
    InputError
        There is no face.

    Examples
    --------
    >>> square = Tin(np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))
    >>> shape = measure_shape(square)
    >>> shape.t_junctions, round(shape.mean_sliveriness, 2), round(shape.angle_50), shape.max_degree
    (0, 23.31, 45, 3)
    """
    if tin.n_face == 0:
        raise InputError("measure: found no face, expected some")
    nodes = tin.nodes * np.array([*metres, 1.0])
    sliveriness, angle = face_shapes(nodes, tin.face_nodes)
    twin = find_twins(tin.face_nodes, tin.n_node)
    _, _, gap = find_t_junctions(nodes, tin.face_nodes, twin)
    open_sides = np.flatnonzero(twin < 0)
    degree = np.bincount(tin.face_nodes.ravel(), minlength=tin.n_node)
    degree += np.bincount(tin.face_nodes[open_sides // 3, (open_sides + 1) % 3], minlength=tin.n_node)
    degree = degree[degree > 0]
    angle_5, angle_50 = np.percentile(angle, ANGLES)
    height = np.abs(gap)
    return Shape(
        len(gap), float(height.max(initial=0.0)), float(height.mean()) if len(gap) else 0.0, float(sliveriness.mean()),
        float(sliveriness.max()), float(sliveriness.min()), float(sliveriness.mean()) - NORMAL,
        float(angle_5), float(angle_50), float(degree.mean()), int(degree.max()),
    )  # fmt: skip


def measure_accuracy(tin: Tin, grid: Grid) -> Accuracy:
    """Measure the vertical errors of one level at all valid posts that it covers.

    Raises
    ------
    InputError
        The level covers no valid post.
    """
    is_filled = tin.face_attributes.get("is_filled", np.zeros(tin.n_face, bool))
    faces = np.flatnonzero(~is_filled).astype(np.int32)
    error = np.empty(grid.heights.shape)
    find_worst(faces, _to_posts(tin, grid), tin.face_nodes, grid.heights, error)
    error = error[~np.isnan(error)]
    if len(error) == 0:
        raise InputError(NO_POST)
    size = np.abs(error)
    rmse = float(np.sqrt(np.mean(error * error)))
    return Accuracy(float(size.max()), rmse, float(np.percentile(size, 99)), float(error.mean()), len(error))


def _to_posts(tin: Tin, grid: Grid) -> Floats:
    """Nodes in posts of a grid; heights in metres."""
    nodes: Floats = (tin.nodes - np.array([grid.x0, grid.y0, 0.0])) / np.array([grid.dx, grid.dy, 1.0])
    return nodes


def face_errors(tin: Tin, grid: Grid) -> Floats:
    """Greatest vertical error at the valid posts in or on each face, metres, (n_face,); 0 for faces without any.

    Raises
    ------
    InputError
        No face has a valid post.
    """
    residual = np.full(grid.heights.shape, np.nan)
    error, _ = scan_mesh(_to_posts(tin, grid), tin.face_nodes, grid.heights, residual)
    if np.isnan(residual).all():
        raise InputError(NO_POST)
    return error


def measure_step(coarse: Tin, fine: Tin, links: NDArray[np.integer], rise: Floats, tolerance: float = 0.0) -> Step:
    """Measure what the way from one level to the next brought.

    Parameters
    ----------
    coarse, fine : Tin
    links : integers (n, 2)
        Pairs (parent, child).
    rise : float64 (fine.n_node,)
        Height of each node less that of the coarse surface at its place, metres; NaN for nodes of the coarse level.
    tolerance : float
        Nodes that rise or fall by no more are not significant, metres.
    """
    n_parent = np.bincount(links[:, 1], minlength=fine.n_face)
    n_child = np.bincount(links[:, 0], minlength=coarse.n_face)
    own, parts = _areas(coarse), _areas(fine)
    total = np.bincount(links[:, 0], parts[links[:, 1]], coarse.n_face)
    is_cut = n_child > 1
    pairs = links[is_cut[links[:, 0]]]
    node = fine.face_nodes[pairs[:, 1]]
    is_significant = np.abs(rise[node]) > tolerance  # never for NaN
    parent = np.repeat(pairs[:, 0], 3)[is_significant.ravel()].astype(np.int64)
    gained = np.unique(parent * fine.n_node + node[is_significant])
    points = np.bincount(gained // fine.n_node, minlength=coarse.n_face)[is_cut]
    if (n_parent > 1).any():
        return Step(float((n_parent == 1).mean()), float("nan"), 0, float("nan"), float("nan"))
    return Step(
        float((n_parent == 1).mean()), float(np.max(np.abs(total - own) / own, initial=0.0)), int(is_cut.sum()),
        float((points == 0).mean()) if len(points) else 0.0, float(points.mean()) if len(points) else 0.0,
    )  # fmt: skip


def _areas(tin: Tin) -> Floats:
    """Areas of faces, squared units of the CRS."""
    a, b, c = (tin.nodes[tin.face_nodes[:, i], :2] for i in range(3))
    area: Floats = ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
    return area


def streakiness(cuts: Sequence[int] | NDArray[np.integer]) -> float:
    """Share of vertex bisections among all bisections of some cuts; NaN without any.

    Parameters
    ----------
    cuts : integers (5,)
        How many of each kind, as `vpfx.model.CUTS`.

    Examples
    --------
    The paper's variant of Scarlatos, each of its four rules once:

    >>> round(streakiness([1, 1, 1, 1, 0]), 2)
    0.45
    """
    vertex, edge = np.dot(cuts, VERTEX_BISECTIONS), np.dot(cuts, EDGE_BISECTIONS)
    return float(vertex / (vertex + edge)) if vertex + edge else float("nan")


def measure_hierarchy(hierarchy: Hierarchy, grid: Grid, tolerance: float = 0.0) -> list[LevelMeasures]:
    """Measure every level of a hierarchy against the posts it was built from."""
    found = []
    metres = grid.post_metres[0] / grid.dx, grid.post_metres[1] / grid.dy
    for level in range(hierarchy.n_level):
        tin, step = hierarchy.tin(level), None
        if level:
            rise = _rise(tin, hierarchy.node_z_parent[: tin.n_node], level)
            step = measure_step(hierarchy.tin(level - 1), tin, hierarchy.links[level - 1], rise, tolerance)
        found.append(_measure_level(level, tin, metres, grid, hierarchy.cuts, step))
    return found


def measure_store(store: StoreReader, levels: Sequence[int] = (), grid: Grid | None = None) -> list[LevelMeasures]:
    """Measure levels of a store; a point is significant by the tolerance it was built with.

    Parameters
    ----------
    store : StoreReader
    levels : sequence of int
        All if empty.
    grid : Grid, optional
        Posts to measure accuracy at, in the CRS of the store.

    Raises
    ------
    InputError, NotFoundError
        There is no such level, or a level covers no valid post.
    """
    found = []
    metres, cuts = unit_metres(store.crs, store.extent), store.cuts
    tolerance = float(store.metadata["options"].get("tolerance", 0.0))
    for level in levels or range(len(store.levels)):
        tin, step = store.tin(level), None
        if level:
            coarse, links = store.tin(level - 1), store.links(level)
            pairs = [np.searchsorted(t.face_attributes["face_id"], links[:, i]) for i, t in enumerate((coarse, tin))]
            rise = _rise(tin, tin.node_attributes["z_parent"], level)
            step = measure_step(coarse, tin, np.stack(pairs, axis=1), rise, tolerance)
        found.append(_measure_level(level, tin, metres, grid, cuts, step))
    return found


def measure_mesh(tin: Tin, metres: tuple[float, float] = (1.0, 1.0), grid: Grid | None = None) -> LevelMeasures:
    """Measure a mesh of which nothing is known but its nodes and faces.

    Parameters
    ----------
    tin : Tin
    metres : tuple of float
        Size of a unit of x and of y, metres.
    grid : Grid, optional
        Posts to measure accuracy at, in the CRS of the mesh.

    Examples
    --------
    >>> square = Tin(np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))
    >>> measure_mesh(square, grid=Grid(np.full((2, 2), 3.0))).accuracy.max_error
    3.0
    """
    return _measure_level(0, tin, metres, grid, np.zeros((1, len(CUTS)), np.int64), None)


def _measure_level(
    level: int, tin: Tin, metres: tuple[float, float], grid: Grid | None, cuts: NDArray[np.int64], step: Step | None
) -> LevelMeasures:
    """Put the measures of a level together; cuts are those of all levels."""
    accuracy = measure_accuracy(tin, grid) if grid is not None else None
    shape, streaks = measure_shape(tin, metres), streakiness(cuts[: level + 1].sum(axis=0))
    return LevelMeasures(level, tin.n_node, tin.n_face, shape, accuracy, streaks, step)


def _rise(tin: Tin, z_parent: Floats, level: int) -> Floats:
    """Rise of the nodes that are new at a level over the level before, metres; NaN for the others."""
    return np.where(tin.node_attributes["level"] == level, tin.nodes[:, 2] - z_parent, np.nan)
