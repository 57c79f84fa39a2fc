"""The primitives of one tile, or of a coverage without tiles, as arrays."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.validate.vpf.folders import Folder, Places, TableData, numbers, places, triplets
from vpfx.validate.vpf.parts import CoverageData
from vpfx.validate.vpf.stars import find_inner_rings, find_rings, find_targets, label_parts, sort_stars
from vpfx.validate.vpf.strips import Segments, Strips, find_clashes, make_segments, make_strips

__all__ = ["Edges", "Graph", "Plane", "TileData"]

Ids = NDArray[np.int64]

GREATEST = 1e100
"""Coordinates beyond are no places: products of them would overflow."""


class Edges(NamedTuple):
    """Rows of ``edg``: ids from 1, 0 is none; triplets are (id, tile, id there).

    Attributes
    ----------
    nodes : int64 (n_edge, 2)
        Start and end; none at topology level 0.
    faces, links : int64 (n_edge, 2, 3) or None
        Right and left face, right and left edge; None where the topology level has none.
    places : Places
    """

    nodes: Ids | None
    faces: Ids | None
    links: Ids | None
    places: Places


class Graph(NamedTuple):
    """Edges round nodes, as indices from 0; sides of edges as in `vpfx.validate.vpf.stars`.

    Attributes
    ----------
    nodes : int64 (n_edge, 2)
    starts : int64 (n_edge + 1,)
    xy : float64 (n_place, 2)
    target : int64 (2 * n_edge,)
    bucket, star : int64
    is_beside : bool
    """

    nodes: Ids
    starts: Ids
    xy: NDArray[np.float64]
    target: Ids
    bucket: Ids
    star: Ids
    is_beside: NDArray[np.bool_]


class Plane(NamedTuple):
    """What the graph makes of the plane.

    Attributes
    ----------
    follower, ring : int64 (2 * n_edge,)
        The side that follows each in its ring, and the number of the ring.
    n_ring : int
    side_face : int64 (2 * n_edge,)
        Index of the face on the right of each side, 0 for the universe.
    ring_side : int64 (n_ring,)
        Least side of each ring.
    node_part : int64 (n_node,)
    west_place, inner_side : int64 (n_part,)
        From `find_inner_rings`.
    is_inner : bool (n_ring,)
        Whether the ring goes round a part from outside.
    """

    follower: Ids
    ring: Ids
    n_ring: int
    side_face: Ids
    ring_side: Ids
    node_part: Ids
    west_place: Ids
    inner_side: Ids
    is_inner: NDArray[np.bool_]


class TileData:
    """Primitives of one tile; each array is read or made when it is first asked for, and is None where that cannot be.

    Attributes
    ----------
    coverage : CoverageData
    tile_id : int
        0 if the coverage has no tiles.
    folder : Folder
    where : str
        What findings call the tile.
    """

    def __init__(self, coverage: CoverageData, tile_id: int, folder: Folder) -> None:
        self.coverage, self.tile_id, self.folder, self.where = coverage, tile_id, folder, folder.where

    @property
    def keys(self) -> tuple[str, ...]:
        """The tables whose defects keep rules about the tile back."""
        return tuple(self.folder.place(name) for name in ("cnd", "edg", "fac", "rng"))

    def table(self, name: str) -> TableData | None:
        """A table of the tile."""
        return self.folder.table(name)

    def place(self, name: str) -> str:
        """What findings call a table of the tile."""
        table = self.folder.table(name)
        return f"table={self.folder.place(name) if table is None else table.where}"

    @cached_property
    def level(self) -> int:
        """Topology level: that of the coverage, but not more than the columns of the edges allow."""
        table = self.table("edg")
        layout = None if table is None or table.head is None else table.head.layout
        columns = set() if layout is None else {column.name.lower() for column in layout.columns}
        most = 3 if "right_face" in columns else 2 if "start_node" in columns else 0
        known = self.coverage.level
        return min(most, 1 if known is None and most == 2 else 3 if known is None else known)

    def column(self, table: str, name: str) -> Ids | None:
        """Whole numbers of a column; None if there is none."""
        found = self.table(table)
        return None if found is None else numbers(found.rows, name)

    def triplets(self, table: str, name: str) -> Ids | None:
        """Triplets of a column; None if there is none."""
        found = self.table(table)
        return None if found is None else triplets(found.rows, name)

    @cached_property
    def node_places(self) -> NDArray[np.float64] | None:
        """Places of connected nodes, float64 (n_node, 3)."""
        return self._places_of("cnd")

    @cached_property
    def entity_places(self) -> NDArray[np.float64] | None:
        """Places of entity nodes, float64 (n, 3)."""
        return self._places_of("end")

    def _places_of(self, name: str) -> NDArray[np.float64] | None:
        table = self.table(name)
        found = None if table is None else places(table.rows, "coordinate")
        return None if found is None or len(found.xyz) != len(found.starts) - 1 else found.xyz

    @cached_property
    def edges(self) -> Edges | None:
        """Rows of ``edg``."""
        table = self.table("edg")
        found = None if table is None else places(table.rows, "coordinates")
        if found is None:
            return None
        nodes = [self.column("edg", name) for name in ("start_node", "end_node")]
        faces = [self.triplets("edg", name) for name in ("right_face", "left_face")]
        links = [self.triplets("edg", name) for name in ("right_edge", "left_edge")]
        return Edges(
            _stack(nodes) if self.level >= 1 else None,
            _stack(faces) if self.level >= 3 else None,
            _stack(links) if self.level >= 1 else None,
            found,
        )

    @cached_property
    def all_places(self) -> NDArray[np.float64]:
        """Places of all nodes and edges, float64 (n, 2); those that are numbers."""
        parts = [part[:, :2] for part in (self.node_places, self.entity_places) if part is not None]
        if self.edges is not None:
            parts.append(self.edges.places.xyz[:, :2])
        xy = np.concatenate(parts) if parts else np.zeros((0, 2))
        found: NDArray[np.float64] = xy[np.isfinite(xy).all(axis=1)]
        return found

    @cached_property
    def edge_boxes(self) -> NDArray[np.float64] | None:
        """Box of each edge, float64 (n_edge, 4); NaN where it has no place."""
        return None if self.edges is None else self.edges.places.boxes()

    @cached_property
    def face_boxes(self) -> NDArray[np.float64] | None:
        """Box of each face by the edges that name it, float64 (n_face, 4); NaN for the universe, and without edges."""
        if self.plane is None or self.edge_boxes is None or self.n_face is None:
            return None
        edge_boxes = np.repeat(self.edge_boxes, 2, axis=0)
        order = np.argsort(self.plane.side_face, kind="stable")
        of_side, boxes = self.plane.side_face[order], np.full((self.n_face, 4), np.nan)
        if len(of_side):
            first = np.flatnonzero(np.concatenate([[True], of_side[1:] != of_side[:-1]]))
            faces = of_side[first]
            boxes[faces, :2] = np.minimum.reduceat(edge_boxes[order, :2], first)
            boxes[faces, 2:] = np.maximum.reduceat(edge_boxes[order, 2:], first)
        boxes[:1] = np.nan
        return boxes

    @property
    def n_face(self) -> int | None:
        """Rows of ``fac``; None if there is no such table, or it is broken."""
        table = self.table("fac")
        return None if table is None or table.head is None else table.n_row

    @cached_property
    def bad_edges(self) -> Ids:
        """Indices of edges that are no lines: no two different places, or one that is no number."""
        if self.edges is None:
            return np.empty(0, np.int64)
        starts, xyz = self.edges.places
        is_bad = (np.diff(starts) < 2) | (self._targets[::2] < 0)
        wrong = np.flatnonzero(~(np.abs(xyz[:, :2]) <= GREATEST).all(axis=1))
        is_bad[np.searchsorted(starts, wrong, side="right") - 1] = True
        return np.flatnonzero(is_bad)

    @cached_property
    def _targets(self) -> Ids:
        """The places that sides of edges go to first: `find_targets`."""
        if self.edges is None:
            return np.empty(0, np.int64)
        starts, xyz = self.edges.places
        targets: Ids = find_targets(starts, np.ascontiguousarray(xyz[:, :2]))
        return targets

    @cached_property
    def graph(self) -> Graph | None:
        """Edges round nodes; None where ids of nodes are out of range or edges are no lines."""
        if self.edges is None or self.edges.nodes is None or self.node_places is None or len(self.bad_edges):
            return None
        nodes, n_node = self.edges.nodes - 1, len(self.node_places)
        if nodes.size and not (nodes.min() >= 0 and nodes.max() < n_node):
            return None
        starts, xy = self.edges.places.starts, np.ascontiguousarray(self.edges.places.xyz[:, :2])
        stars = sort_stars(nodes.ravel(), n_node, starts, xy, self._targets)
        return Graph(nodes, starts, xy, self._targets, *stars)

    @cached_property
    def segments(self) -> tuple[Segments, Strips] | None:
        """The edges in straight pieces."""
        if self.graph is None:
            return None
        segments = make_segments(self.graph.starts, self.graph.xy)
        return segments, make_strips(segments)

    @cached_property
    def clashes(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Pairs of segments that clash, and their numbers by kind: `find_clashes`."""
        if self.segments is None:
            return np.empty((0, 3), np.int64), np.zeros(3, np.int64)
        return find_clashes(*self.segments)

    @cached_property
    def plane(self) -> Plane | None:
        """Rings and parts; None below topology level 3, or where the graph or its faces are not known."""
        graph, edges, n_face = self.graph, self.edges, self.n_face
        if graph is None or edges is None or edges.faces is None or n_face is None or self.node_places is None:
            return None
        side_face = edges.faces[:, :, 0].ravel() - 1
        if side_face.size and not (side_face.min() >= 0 and side_face.max() < n_face):
            return None
        follower, ring, n_ring = find_rings(graph.bucket, graph.star)
        ring_side = np.full(n_ring, -1, np.int64)
        ring_side[ring[::-1]] = np.arange(len(ring))[::-1]
        ends = np.ascontiguousarray(graph.nodes.T)
        node_part, n_part = label_parts(ends[0], ends[1], len(self.node_places))
        place, side = find_inner_rings(
            ends[0], ends[1], node_part, n_part, graph.starts, graph.xy, graph.target, graph.bucket, graph.star
        )
        is_inner = np.zeros(n_ring, bool)
        is_inner[ring[side[side >= 0]]] = True
        return Plane(follower, ring, n_ring, side_face, ring_side, node_part, place, side, is_inner)


def _stack(columns: list[Ids | None]) -> Ids | None:
    """Columns side by side, if all are there."""
    known = [column for column in columns if column is not None]
    return np.stack(known, axis=1) if len(known) == len(columns) else None
