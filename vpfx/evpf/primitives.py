"""Tables of primitives, of one tile or of an untiled coverage, with their indexes (specs/evpf.md E-200 to E-230)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.evpf.folder import Folder
from vpfx.evpf.planar import Planar, Sides
from vpfx.vpf import layouts, spatial_index
from vpfx.vpf.table import Ragged
from vpfx.vpf.values import NULL_INT

__all__ = ["Primitives", "face_boxes", "straight", "write_primitives"]

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]


class Primitives(NamedTuple):
    """What the tables are made of.

    Attributes
    ----------
    kind : str
        Type of coordinates: C, B, Z or Y.
    places : float64 (n_node, 2 or 3)
    edge_nodes : int64 (n_edge, 2)
        Start and end, as indices.
    lines : Ragged
        Places along each edge, as those of nodes.
    first_edge : int64 (n_node, 3)
        Triplets.
    faces, links : int64 (n_edge, 2, 3)
        Triplets: left, right.
    rings : Planar
    boxes : float64 (n_face, 4)
        Rectangles of all faces, the universe first.
    """

    kind: str
    places: Floats
    edge_nodes: Ints
    lines: Ragged
    first_edge: Ints
    faces: Ints
    links: Ints
    rings: Planar
    boxes: Floats


def face_boxes(xy: Floats, edge_nodes: Ints, sides: Sides, planar: Planar, extent: Sequence[float]) -> Floats:
    """Rectangles of the faces of a planar graph; that of the universe is round all, or the extent where there is nothing.

    Returns
    -------
    float64 (n_face, 4)
        Min x, min y, max x, max y.
    """
    boxes = np.empty((1 + planar.n_face + planar.n_void, 4))
    if planar.n_face == 0:
        boxes[0] = extent
        return boxes
    boxes[1:, :2], boxes[1:, 2:] = np.inf, -np.inf
    given = slice(1, planar.n_face + 1)
    boxes[given, :2] = np.minimum.reduceat(xy[sides.start], sides.first[:-1])
    boxes[given, 2:] = np.maximum.reduceat(xy[sides.start], sides.first[:-1])
    half = np.flatnonzero(planar.way_face > planar.n_face)
    face, at = planar.way_face[half], xy[edge_nodes[half // 2, half % 2]]
    np.minimum.at(boxes[:, :2], face, at)
    np.maximum.at(boxes[:, 2:], face, at)
    boxes[0, :2], boxes[0, 2:] = boxes[1:, :2].min(axis=0), boxes[1:, 2:].max(axis=0)
    return boxes


def write_primitives(folder: Folder, tables: Primitives, extent: Sequence[float], *, is_tiled: bool) -> None:
    """Write the tables of a tile.

    Parameters
    ----------
    folder : Folder
    tables : Primitives
    extent : four numbers
        Of the tile; the spatial indexes have it, rounded outwards.
    is_tiled : bool
        Whether `first_edge` of nodes is a triplet.
    """
    real = np.float32 if tables.kind in "CZ" else np.float64
    places, lines = tables.places.astype(real), tables.lines._replace(values=tables.lines.values.astype(real))
    n_node, n_edge = len(places), len(tables.edge_nodes)
    first_edge = tables.first_edge if is_tiled else tables.first_edge[:, 0]
    nodes = {"id": _ids(n_node), "first_edge": first_edge, "coordinate": places}
    folder.write("cnd", layouts.cnd(tables.kind, is_tiled=is_tiled), nodes)
    start, end = tables.edge_nodes.T
    edges = {
        "id": _ids(n_edge), "start_node": start + 1, "end_node": end + 1,
        "right_face": tables.faces[:, 1], "left_face": tables.faces[:, 0],
        "right_edge": tables.links[:, 1], "left_edge": tables.links[:, 0],
        "coordinates": lines,
    }  # fmt: skip
    folder.write("edg", layouts.edg(tables.kind), edges)
    _write_rings(folder, tables.rings)
    edge_boxes = _edge_boxes(tables.lines)
    _write_boxes(folder, "ebr", edge_boxes)
    _write_boxes(folder, "fbr", tables.boxes)
    for name, boxes in (("csi", tables.places[:, [0, 1, 0, 1]]), ("esi", edge_boxes), ("fsi", tables.boxes)):
        folder.write_bytes(name, spatial_index.build(boxes, extent))


def straight(places: Floats, edge_nodes: Ints) -> Ragged:
    """Places along edges that run straight from node to node."""
    n_edge = len(edge_nodes)
    return Ragged(2 * np.arange(n_edge + 1), places[edge_nodes].reshape(2 * n_edge, places.shape[1]))


def _edge_boxes(lines: Ragged) -> Floats:
    """Rectangles of edges."""
    if lines.n_row == 0:
        return np.zeros((0, 4))
    xy, first = lines.values[:, :2].astype(np.float64), lines.starts[:-1]
    return np.concatenate([np.minimum.reduceat(xy, first), np.maximum.reduceat(xy, first)], axis=1)


def _ids(n: int) -> Ints:
    return np.arange(1, n + 1)


def _write_rings(folder: Folder, planar: Planar) -> None:
    """Write `fac` and `rng`."""
    n_face = 1 + planar.n_face + planar.n_void
    pointers = np.searchsorted(planar.ring_face, np.arange(n_face)) + 1
    folder.write("fac", layouts.FAC, {"id": _ids(n_face), "ring_ptr": pointers})
    start = np.where(planar.ring_start < 0, NULL_INT, planar.ring_start + 1)
    rings = {"id": _ids(len(start)), "face_id": planar.ring_face + 1, "start_edge": start}
    folder.write("rng", layouts.RNG, rings)


def _write_boxes(folder: Folder, name: str, boxes: Floats) -> None:
    """Write `ebr` or `fbr`."""
    columns = spatial_index.outward(boxes).reshape(-1, 4).T
    rows = dict(zip(("xmin", "ymin", "xmax", "ymax"), columns, strict=True))
    folder.write(name, layouts.EBR if name == "ebr" else layouts.FBR, {"id": _ids(len(boxes)), **rows})
