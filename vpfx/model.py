"""The types that cross every arrow: `Extent`, `Grid`, `Tin`, `Hierarchy`.

All are frozen and checked once, when made; inside vpfx they are trusted. Arrays are named ``<from>_<to>``; -1 means none.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import InputError

__all__ = ["CUTS", "Extent", "Grid", "Hierarchy", "Progress", "Tin"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

Progress = Callable[[int, int], None]
"""Who is told how far work is: parts done, and parts in all."""

CUTS = ("one edge", "two edges", "three edges", "centre", "centre and one edge")
"""The kinds of cut; the first four are the paper's rules 1 to 4."""


class Extent(NamedTuple):
    """A rectangle in CRS units, borders included.

    Examples
    --------
    >>> Extent(0.0, 0.0, 2.0, 1.0).intersects(Extent(2.0, 1.0, 3.0, 3.0))
    True
    """

    min_x: float
    min_y: float
    max_x: float
    max_y: float

    def intersects(self, other: Extent) -> bool:
        """Tell whether the two rectangles share at least a point."""
        return (
            self.min_x <= other.max_x
            and other.min_x <= self.max_x
            and self.min_y <= other.max_y
            and other.min_y <= self.max_y
        )


@dataclass(frozen=True, eq=False)
class Grid:
    """Elevation posts on a regular lattice.

    Attributes
    ----------
    heights : float64 (n_row, n_col)
        Metres. Row 0 is the southernmost, column 0 the westernmost; NaN is a void.
    x0, y0 : float
        Place of post (row 0, column 0) in CRS units.
    dx, dy : float
        Spacing of columns and of rows in CRS units, both positive.
    crs : str
        WKT2 of the horizontal CRS; empty if unknown.
    post_metres : tuple of float
        Width and height of one post spacing in metres, for measures of shape.

    Raises
    ------
    InputError
        Fewer than 2 × 2 posts, a spacing that is not positive, or an infinite height.

    Examples
    --------
    >>> Grid(np.zeros((3, 4)), x0=10.0, y0=20.0, dx=1.0, dy=0.5).extent
    Extent(min_x=10.0, min_y=20.0, max_x=13.0, max_y=21.0)
    """

    heights: Floats
    x0: float = 0.0
    y0: float = 0.0
    dx: float = 1.0
    dy: float = 1.0
    crs: str = ""
    post_metres: tuple[float, float] = (1.0, 1.0)

    def __post_init__(self) -> None:
        heights = np.ascontiguousarray(self.heights, dtype=np.float64)
        if heights.ndim != 2 or min(heights.shape) < 2:
            raise InputError(f"grid: found {heights.shape} posts, expected at least 2 rows and 2 columns")
        if not (self.dx > 0 and self.dy > 0 and min(self.post_metres) > 0):
            raise InputError(f"grid: found spacing {self.dx} × {self.dy}, expected positive numbers")
        if np.isinf(heights).any():
            row, col = np.argwhere(np.isinf(heights))[0]
            raise InputError(
                f"grid: post ({row}, {col}): found an infinite height, expected a number or NaN for a void"
            )
        heights.setflags(write=False)
        object.__setattr__(self, "heights", heights)

    @property
    def extent(self) -> Extent:
        """The rectangle spanned by the posts."""
        n_row, n_col = self.heights.shape
        return Extent(self.x0, self.y0, self.x0 + (n_col - 1) * self.dx, self.y0 + (n_row - 1) * self.dy)


@dataclass(frozen=True, eq=False)
class Tin:
    """One level of triangles over one extent.

    Attributes
    ----------
    nodes : float64 (n_node, 3)
        x and y in CRS units, z in metres.
    face_nodes : int32 (n_face, 3)
        Node indices of each face, counter-clockwise seen from above.
    face_attributes : dict of str to array
        Columns of n_face values: ``is_filled``, ids of the store, and what users attach.
    node_attributes : dict of str to array
        Columns of n_node values.
    crs : str
        WKT2 of the horizontal CRS; empty if unknown.

    Raises
    ------
    InputError
        A shape, a node index or the length of an attribute column is wrong.

    Examples
    --------
    >>> tin = Tin(np.array([[0, 0, 5], [1, 0, 5], [0, 1, 6]]), np.array([[0, 1, 2]]))
    >>> tin.n_node, tin.n_face
    (3, 1)
    """

    nodes: Floats
    face_nodes: Ints
    face_attributes: dict[str, NDArray[Any]] = field(default_factory=dict)
    node_attributes: dict[str, NDArray[Any]] = field(default_factory=dict)
    crs: str = ""

    def __post_init__(self) -> None:
        nodes = np.ascontiguousarray(self.nodes, dtype=np.float64)
        faces = np.ascontiguousarray(self.face_nodes, dtype=np.int32)
        if nodes.ndim != 2 or nodes.shape[1] != 3:
            raise InputError(f"tin: found nodes of shape {nodes.shape}, expected (n_node, 3)")
        if faces.ndim != 2 or faces.shape[1] != 3:
            raise InputError(f"tin: found faces of shape {faces.shape}, expected (n_face, 3)")
        if faces.size and (faces.min() < 0 or faces.max() >= len(nodes)):
            raise InputError(f"tin: found a node index outside 0…{len(nodes) - 1}")
        for columns, count in ((self.face_attributes, len(faces)), (self.node_attributes, len(nodes))):
            for name, values in columns.items():
                if len(values) != count:
                    raise InputError(f"tin: attribute {name}: found {len(values)} values, expected {count}")
        object.__setattr__(self, "nodes", nodes)
        object.__setattr__(self, "face_nodes", faces)

    @property
    def n_node(self) -> int:
        """Number of nodes."""
        return len(self.nodes)

    @property
    def n_face(self) -> int:
        """Number of faces."""
        return len(self.face_nodes)


@dataclass(frozen=True, eq=False)
class Hierarchy:
    """Levels of one extent, coarse to fine, and the links between them.

    Attributes
    ----------
    nodes : float64 (n_node, 3)
        The nodes of all levels, those of level 0 first: level k uses a leading part of them.
    level_faces : tuple of int32 (n_face, 3)
        Per level the node indices of its faces, counter-clockwise.
    node_level : int32 (n_node,)
        The level at which each node first appears; it belongs to every finer level.
    links : tuple of int32 (n_link, 2)
        Per step from level k to k + 1 the pairs (parent face, child face), sorted by child.
    face_is_filled : tuple of bool (n_face,)
        Per level, faces on ground without data (only with ``fill``).
    max_error_bound : tuple of float
        Per level the bound in metres that was asked for; NaN where none was.
    squared_error, max_error, n_post : tuple
        Per level the sum of squared vertical errors (m²), the greatest one (m) and the posts they were taken at.
    node_z_parent : float64 (n_node,)
        Height of the surface of the level before the node's first at its place, metres; NaN for nodes of level 0, and where
        levels are not nested.
    link_area : tuple of float64 (n_link,)
        Per step the area that each pair shares, squared units of the nodes; empty where levels are nested.
    cuts : int64 (n_level, 5)
        Cuts made on the way to each level, by kind: see `CUTS`.

    Raises
    ------
    InputError
        The numbers of levels, links and measures do not fit.
    """

    nodes: Floats
    node_level: Ints
    level_faces: tuple[Ints, ...]
    links: tuple[Ints, ...]
    face_is_filled: tuple[NDArray[np.bool_], ...]
    max_error_bound: tuple[float, ...]
    max_error: tuple[float, ...]
    squared_error: tuple[float, ...]
    n_post: tuple[int, ...]
    node_z_parent: Floats
    cuts: NDArray[np.int64]
    link_area: tuple[Floats, ...] = ()
    crs: str = ""

    def __post_init__(self) -> None:
        n_level = len(self.level_faces)
        counts = [len(self.links) + 1, len(self.face_is_filled), len(self.max_error_bound), len(self.max_error)]
        if n_level == 0 or any(count != n_level for count in [*counts, len(self.squared_error), len(self.n_post)]):
            raise InputError(f"hierarchy: found {n_level} levels and {counts}, expected as many of each")

    @property
    def n_level(self) -> int:
        """Number of levels."""
        return len(self.level_faces)

    def tin(self, level: int) -> Tin:
        """Return one level as a `Tin`.

        Raises
        ------
        InputError
            There is no such level.
        """
        if not 0 <= level < self.n_level:
            raise InputError(f"hierarchy: found level {level}, expected 0…{self.n_level - 1}")
        n_node = int(np.searchsorted(self.node_level, level, side="right"))
        return Tin(
            self.nodes[:n_node],
            self.level_faces[level],
            face_attributes={"is_filled": self.face_is_filled[level]},
            node_attributes={"level": self.node_level[:n_node]},
            crs=self.crs,
        )
