"""The paper's table 2: shapes and streaks of the kinds of cut of each method, on one equilateral triangle."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vpfx.geometry import face_shapes
from vpfx.measures import NORMAL, streakiness
from vpfx.methods import METHODS
from vpfx.methods.forest import Forest
from vpfx.model import CUTS

__all__ = ["cut_equilateral", "table_2"]

Floats = NDArray[np.float64]


def cut_equilateral(kind: str) -> Floats:
    """Sliveriness of the children of an equilateral triangle, cut by the kernel that cuts terrain.

    Edges are broken at their middles, the centre is the centroid.

    Examples
    --------
    >>> cut_equilateral("three edges").round(3).tolist()
    [20.785, 20.785, 20.785, 20.785]
    """
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, np.sqrt(0.75), 0.0]])
    forest = Forest(corners.copy(), np.array([[0, 1, 2]], np.int32), np.zeros(1, bool))
    n_broken = {"one edge": 1, "two edges": 2, "three edges": 3, "centre": 0, "centre and one edge": 1}[kind]
    first = forest.add_nodes((corners[:n_broken] + corners[(np.arange(n_broken) + 1) % 3]) / 2)
    forest.side_node[:n_broken] = np.arange(first, forest.n_node)
    centre = forest.add_nodes(corners.mean(axis=0)[None]) if kind.startswith("centre") else -1
    children = forest.cut(np.zeros(1, np.int32), np.array([centre], np.int32), np.zeros(1, bool))
    return face_shapes(forest.nodes, forest.face_nodes[children])[0]


def table_2() -> dict[str, tuple[float, float, float, float]]:
    """The paper's table 2, made by cutting: streakiness, and average, greatest and least sliveriness of each method.

    Each kind of cut of a method counts the same; averages are over the children of a cut, then over the kinds.

    Examples
    --------
    >>> [round(value, 2) for value in table_2()["wynne"]]
    [0.45, 6.49, 12.39, 1.0]
    """
    found = {}
    for name, method in METHODS.items():
        if method.cuts:
            shapes = [cut_equilateral(kind) - NORMAL for kind in method.cuts]
            every = np.concatenate(shapes)
            average = float(np.mean([shape.mean() for shape in shapes]))
            share = streakiness([kind in method.cuts for kind in CUTS])
            found[name] = (share, average, float(every.max()), float(every.min()))
    return found
