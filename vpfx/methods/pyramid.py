"""Pyramids of Delaunay triangulations: each level that of a growing set of nodes, prescribed edges kept.

Posts are added where the error is greatest until the bound of the level holds. Levels are not nested: links are the pairs of
faces that share area.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import InvariantError
from vpfx.geometry import shared_areas
from vpfx.methods import options as shared
from vpfx.methods.base import Patch
from vpfx.methods.borders import LevelRule
from vpfx.methods.lines import Lines
from vpfx.methods.refine import BOUND_SLACK, MOST_PASSES, ROUNDING
from vpfx.methods.scan import measure, scan_mesh
from vpfx.methods.start import NOTHING, Start, border_nodes_of, fixed_sides_of, start_mesh, triangulate
from vpfx.model import CUTS, Hierarchy
from vpfx.topology import find_twins

__all__ = ["build_pyramid", "levels"]


class _Pyramid:
    """The triangulation in the making over one patch."""

    def __init__(self, patch: Patch, options: Mapping[str, Any], lines: Lines) -> None:
        significant = options["start_posts"] if options["start"] == "delaunay" else 0
        start = start_mesh(patch, *patch.n_square, significant)
        self.patch, self.lines = patch, lines
        self.is_node = np.zeros(patch.heights.shape, bool)
        self.is_node[_posts_of(start.nodes)] = True
        self.residual = np.full(patch.heights.shape, np.nan)
        self.is_fixed = fixed_sides_of(patch)

    def triangulate(self, level: int) -> Start:
        """Triangulate the nodes so far, those of fixed borders at a level among them."""
        if not self.patch.squares.any() and not self.patch.keeps_voids:
            return NOTHING
        self.is_node |= border_nodes_of(self.patch, level)
        return triangulate(self.patch, np.zeros_like(self.is_node), self.is_node, 1, self.lines)

    def scan(self, mesh: Start) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Find the greatest error of each face, and the post where it is."""
        return scan_mesh(mesh.nodes, mesh.face_nodes, self.patch.heights, self.residual)

    def add(self, posts: NDArray[np.int64]) -> bool:
        """Make posts nodes, but none on a fixed border; tell whether any was new."""
        row, col = np.divmod(posts, self.patch.heights.shape[1])
        is_new = ~self.is_fixed[row, col] & ~self.is_node[row, col]
        self.is_node[row[is_new], col[is_new]] = True
        return bool(is_new.any())

    def one_pass(self, level: int, tolerance: float) -> Start:
        """Add the worst post of every face that is off by more than a tolerance."""
        error, post = self.scan(self.triangulate(level))
        self.add(post[error > tolerance])
        return self.triangulate(level)

    def reach_bound(self, level: int, bound: float) -> Start:
        """Add the worst posts of faces that are off by more than their neighbours, until none is over the bound."""
        for _ in range(MOST_PASSES):
            mesh = self.triangulate(level)
            error, post = self.scan(mesh)
            is_over = error > bound
            if not is_over.any():
                return mesh
            twin = find_twins(mesh.face_nodes, len(mesh.nodes)).reshape(-1, 3)
            beside = np.where(twin >= 0, error[twin // 3], -1.0).max(axis=1)
            if not self.add(post[is_over & (error >= beside)]):
                raise InvariantError(f"pyramid: level {level}: found a post over the bound that cannot be added")
        raise InvariantError(f"pyramid: level {level}: found no end after {MOST_PASSES} rounds")


def _posts_of(nodes: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Row and column of nodes on posts."""
    return nodes[:, 1].astype(np.int64), nodes[:, 0].astype(np.int64)


def levels(method: str, options: Mapping[str, Any]) -> list[LevelRule | None]:
    """Rule of every level for the borders of a method with the options that all share."""
    n_level = shared.n_level(method, options, shared.SHARED)
    if options["max_error"] is not None:
        return [LevelRule(bound * (1.0 - BOUND_SLACK), 0.0, 0.0, 0.0, True) for bound in options["max_error"]]
    rule = LevelRule(options["tolerance"] + ROUNDING, 0.0, 0.0, 0.0, False)
    return [None, *[rule] * (n_level - 1)]


def build_pyramid(patch: Patch, options: Mapping[str, Any], lines: Lines) -> Hierarchy:
    """Build all levels over one patch.

    Parameters
    ----------
    patch : Patch
    options : mapping
        Those of `vpfx.methods.options.SHARED`.
    lines : Lines
        Nodes and edges of every level.

    Notes
    -----
    Cost: O(n log n) for each round, and some tens of rounds a level.
    """
    pyramid = _Pyramid(patch, options, lines)
    bounds, tolerance = options["max_error"], options["tolerance"] + ROUNDING
    meshes, measures = [], []
    for level in range(1 + options["passes"] if bounds is None else len(bounds)):
        if bounds is not None:
            mesh = pyramid.reach_bound(level, bounds[level] * (1.0 - BOUND_SLACK))
        else:
            mesh = pyramid.one_pass(level, tolerance) if level else pyramid.triangulate(0)
            pyramid.scan(mesh)
        meshes.append(mesh)
        measures.append(measure(pyramid.residual, patch.is_owned))
    n_line = int((~lines.is_post).sum())
    return _to_hierarchy(patch, meshes, n_line, measures, bounds if bounds is not None else [np.nan] * len(meshes))


def _to_hierarchy(
    patch: Patch, meshes: list[Start], n_line: int, measures: list[Any], bounds: list[float]
) -> Hierarchy:
    """Number the nodes by level, and link the faces of neighbouring levels; the last n_line of a level are no posts."""
    level_of = np.full(patch.heights.shape, len(meshes), np.int32)
    posts = [_posts_of(mesh.nodes[: len(mesh.nodes) - n_line]) for mesh in meshes]
    for level in reversed(range(len(meshes))):
        level_of[posts[level]] = level
    row, col = np.nonzero(level_of < len(meshes))
    order = np.argsort(level_of[row, col], kind="stable")
    row, col = row[order], col[order]
    of_lines = meshes[0].nodes[len(meshes[0].nodes) - n_line :]
    index = np.empty(patch.heights.shape, np.int32)
    index[row, col] = np.arange(n_line, n_line + len(row))
    nodes = np.concatenate([of_lines, np.stack([col, row, patch.heights[row, col]], axis=1)])
    faces = [
        np.append(index[place], np.arange(n_line, dtype=np.int32))[mesh.face_nodes]
        for place, mesh in zip(posts, meshes, strict=True)
    ]
    steps = [shared_areas(nodes, coarse, fine) for coarse, fine in pairwise(faces)]
    errors, squared, n_post = zip(*measures, strict=True)
    return Hierarchy(
        nodes, np.append(np.zeros(n_line, np.int32), level_of[row, col]), tuple(faces), tuple(pairs for pairs, _ in steps),
        tuple(mesh.is_filled for mesh in meshes), tuple(bounds), errors, squared, n_post,
        node_z_parent=np.full(len(nodes), np.nan), cuts=np.zeros((len(meshes), len(CUTS)), np.int64),
        link_area=tuple(area for _, area in steps),
    )  # fmt: skip
