"""Primitives of one tile and level, read and checked, and from the rings of its faces their corners (specs/evpf.md chapter 2).

A ring is walked with its face to the right, so clockwise: from the start edge, edge_1, which arrives at node_1, over edge_3 to
node_3 and over edge_2 back to node_2.

```
             3                       along edge_1 from 2 to 1, then edge_3, then edge_2;
           ·   ·   edge_2            a side with nodes inside is in pieces, and the ring has as many more edges
   edge_3 ·  f   ·
         ·         ·
        1 --edge_1-- 2
```
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vpfx.errors import VpfFormatError
from vpfx.evpf.checked import check, read_checked
from vpfx.evpf.numbering import FIRST_FACE
from vpfx.vpf.catalog import Coverage
from vpfx.vpf.table import Ragged, Table

__all__ = ["Corners", "Edges", "Rings", "TileRings", "face_corners", "read_rings", "walk_rings"]

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

EDGE_COLUMNS = {
    "id": "I", "start_node": "I", "end_node": "I", "right_face": "K", "left_face": "K", "right_edge": "K",
    "left_edge": "K",
}  # fmt: skip

BROKEN = {
    1: "found an edge that has another face",
    2: "found an edge that does not go on where the one before ends",
    3: "found a ring that does not close",
    4: "found a ring of fewer than three edges",
}
"""What can be wrong with a ring, by code; 0 is right."""


class Edges(NamedTuple):
    """Edges of one tile; indices from 0, faces as ids in `fac`.

    Attributes
    ----------
    start_node, end_node, right_face, left_face, right_edge, left_edge : int64 (n_edge,)
    """

    start_node: Ints
    end_node: Ints
    right_face: Ints
    left_face: Ints
    right_edge: Ints
    left_edge: Ints


class Rings(NamedTuple):
    """Rings that have been walked.

    Attributes
    ----------
    first : int64 (n_ring + 1,)
        Where each ring starts in `node`.
    node : int64 (n,)
        Nodes at which edges arrive, in the order of the walk.
    broken : int
        First ring that is wrong, -1 if none is.
    code : int
        What is wrong with it: see `BROKEN`.
    """

    first: Ints
    node: Ints
    broken: int
    code: int


class Corners(NamedTuple):
    """Corners of faces.

    Attributes
    ----------
    faces : int64 (n_face, 3)
        Nodes, counter-clockwise; edge_1 joins the first two.
    side, node : int64 (n,)
        Nodes inside sides: side 3·face + i, and the node.
    broken : int
        First face that has not three corners, -1 if there is none.
    """

    faces: Ints
    side: Ints
    node: Ints
    broken: int


def walk_rings(edges: Edges, face_id: Ints, start_edge: Ints) -> Rings:
    """Walk rings, each edge with the face to its right.

    Parameters
    ----------
    edges : Edges
        Nodes and edges they name exist.
    face_id, start_edge : int64 (n_ring,)

    Returns
    -------
    Rings
        Complete if no ring is broken.

    Notes
    -----
    Every side of an edge is walked once at most, whatever the links say. Cost: O(n_edge).

    Examples
    --------
    A triangle, its edges counter-clockwise, face 2 to their left:

    >>> u, v = np.array([0, 1, 2]), np.array([1, 2, 0])
    >>> edges = Edges(u, v, np.array([1, 1, 1]), np.array([2, 2, 2]), np.array([1, 2, 0]), np.array([2, 0, 1]))
    >>> walk_rings(edges, np.array([2]), np.array([0])).node.tolist()
    [0, 2, 1]
    """
    first = np.zeros(len(face_id) + 1, np.int64)
    node = np.empty(2 * len(edges.start_node), np.int64)
    broken, code = _walk(*edges, face_id, start_edge, first, node)
    return Rings(first, node[: first[-1]], int(broken), int(code))


@njit(nogil=True, cache=True)
def _walk(start_node, end_node, right_face, left_face, right_edge, left_edge, face_id, start_edge, first, node):
    """Fill `first` and `node`; return the first ring that is broken and why, or (-1, 0)."""
    is_walked = np.zeros(2 * len(start_node), np.bool_)
    at = 0
    for ring in range(len(face_id)):
        edge, here, origin = start_edge[ring], -1, -1
        while True:
            if right_face[edge] == face_id[ring] and not is_walked[2 * edge + 1]:
                side, leaves, arrives, after = 2 * edge + 1, start_node[edge], end_node[edge], right_edge[edge]
            elif left_face[edge] == face_id[ring]:
                side, leaves, arrives, after = 2 * edge, end_node[edge], start_node[edge], left_edge[edge]
            else:
                return ring, 3 if right_face[edge] == face_id[ring] else 1
            if is_walked[side]:
                return ring, 3
            if here >= 0 and leaves != here:
                return ring, 2
            if here < 0:
                origin = leaves
            is_walked[side] = True
            here = arrives
            node[at] = arrives
            at += 1
            edge = after
            if here == origin and edge == start_edge[ring]:
                break
        first[ring + 1] = at
        if at - first[ring] < 3:
            return ring, 4
    return -1, 0


def face_corners(rings: Rings, junction_face: Ints, junction_node: Ints) -> Corners:
    """Take the corners of faces out of their rings.

    Parameters
    ----------
    rings : Rings
        One a face, none broken.
    junction_face, junction_node : int64 (n_junction,)
        Nodes that are no corners, by face.

    Returns
    -------
    Corners
        Junctions in the order of faces and of the walk; fewer than given where one is not in the ring of its face.

    Examples
    --------
    Node 3 lies in edge_3, between nodes 1 and 2 of the ring:

    >>> face_corners(Rings(np.array([0, 4]), np.array([1, 3, 2, 0]), -1, 0), np.array([0]), np.array([3]))
    Corners(faces=array([[1, 0, 2]]), side=array([2]), node=array([3]), broken=-1)
    """
    n_face = len(rings.first) - 1
    face = np.repeat(np.arange(n_face), np.diff(rings.first))
    width = int(max(rings.node.max(initial=-1), junction_node.max(initial=-1))) + 1
    is_inside = np.isin(face * width + rings.node, junction_face * width + junction_node)
    n_corner = np.bincount(face[~is_inside], minlength=n_face)
    broken = np.flatnonzero(n_corner != 3)
    if len(broken):
        return Corners(np.empty((0, 3), np.int64), np.empty(0, np.int64), np.empty(0, np.int64), int(broken[0]))
    corners = rings.node[~is_inside].reshape(n_face, 3)
    before = np.cumsum(~is_inside) - 3 * face  # corners of the face met so far: 0 and 3 on edge_1
    at = np.flatnonzero(is_inside)
    side = np.array([0, 2, 1, 0])[before[at]]
    return Corners(corners[:, [0, 2, 1]], 3 * face[at] + side, rings.node[at], -1)


class TileRings(NamedTuple):
    """Nodes, and the rings of the faces of the store.

    Attributes
    ----------
    node_path, face_path : str
        Of `cnd` and `fac`, for messages.
    xyz : float64 (n_node, 3)
        As written; finite.
    rings : Rings
        One a face of the store, in their order; none is broken.
    """

    node_path: str
    face_path: str
    xyz: Floats
    rings: Rings


def read_rings(coverage: Coverage, tile_id: int, n_face: int, is_double: bool) -> TileRings:
    """Read `cnd`, `edg`, `fac` and `rng` of a tile.

    Parameters
    ----------
    coverage : Coverage
    tile_id : int
    n_face : int
        Faces of the store in the tile; void faces follow them.
    is_double : bool
        Whether coordinates are doubles.

    Raises
    ------
    VpfFormatError
        A table is missing or broken, an edge joins other nodes than it says, or a ring does not close.
    """
    kind = "Y" if is_double else "Z"
    nodes = read_checked(coverage, "cnd", {"id": "I", "coordinate": kind}, tile_id)
    xyz = nodes["coordinate"].astype(np.float64)
    is_finite = np.isfinite(xyz).all(axis=1)
    check(is_finite, nodes.path, "found coordinate {}, expected finite numbers", "E-200", xyz)
    faces = read_checked(coverage, "fac", {"id": "I", "ring_ptr": "I"}, tile_id)
    if faces.n_row <= n_face:
        message = f"found {faces.n_row} rows, expected the universe and the {n_face} faces of tinface.aft"
        raise VpfFormatError(faces.path, "", message, "E-220")
    edges = _read_edges(coverage, tile_id, nodes, faces.n_row, n_face)
    start_edge = _start_edges(coverage, tile_id, faces, n_face, len(edges.start_node))
    rings = walk_rings(edges, FIRST_FACE + np.arange(n_face), start_edge)
    if rings.broken >= 0:
        where = f"face {rings.broken + FIRST_FACE}"
        message = f"{BROKEN[rings.code]}, expected the ring of the face"
        raise VpfFormatError(str(coverage.table("edg", tile_id)), where, message, "E-220")
    n_side = sum(int(_is_stored(side, n_face).sum()) for side in (edges.right_face, edges.left_face))
    if n_side != len(rings.node):
        message = f"found {n_side} sides of faces, expected the {len(rings.node)} of their rings"
        raise VpfFormatError(str(coverage.table("edg", tile_id)), "", message, "E-220")
    return TileRings(nodes.path, faces.path, xyz, rings)


def _is_stored(face: Ints, n_face: int) -> NDArray[np.bool_]:
    return (face >= FIRST_FACE) & (face < FIRST_FACE + n_face)


def _read_edges(coverage: Coverage, tile_id: int, nodes: Table, n_row: int, n_face: int) -> Edges:
    """Edges, what they name checked to be there; faces stay ids, of `n_row` in `fac`."""
    kind = next(column.kind for column in nodes.layout.columns if column.name.lower() == "coordinate")
    table = read_checked(coverage, "edg", EDGE_COLUMNS | {"coordinates": f"{kind}*"}, tile_id)
    found = {name: table[name] for name in EDGE_COLUMNS if name != "id"}
    found = {name: ids if ids.ndim == 1 else ids[:, 0] for name, ids in found.items()}  # of triplets this tile's part
    limits = {"node": nodes.n_row, "face": n_row, "edge": table.n_row}
    for name, ids in found.items():
        most = limits[name[-4:]]
        is_there = (ids >= 1) & (ids <= most)
        check(is_there, table.path, f"found {name} {{}}, expected 1 … {most}", "E-210", ids)
    is_side = _is_stored(found["right_face"], n_face) | _is_stored(found["left_face"], n_face)
    check(is_side, table.path, "found an edge of no face, expected a side of a face", "E-210")
    _check_coordinates(table, nodes["coordinate"], found)
    edges = {name: ids.astype(np.int64) - (0 if name.endswith("face") else 1) for name, ids in found.items()}
    return Edges(**edges)


def _check_coordinates(table: Table, coordinate: NDArray[Any], ends: dict[str, NDArray[Any]]) -> None:
    """Refuse edges whose two tuples are not those of their nodes, bit for bit."""
    lines: Ragged = table["coordinates"]
    check(lines.counts == 2, table.path, "found {} coordinates, expected 2", "E-210", lines.counts)
    expected = np.stack([coordinate[ends[name] - 1] for name in ("start_node", "end_node")], axis=1)
    bits = f"u{expected.itemsize}"
    is_same = (lines.values.view(bits).reshape(expected.shape) == expected.view(bits)).all(axis=(1, 2))
    check(is_same, table.path, "found coordinates that are not those of its nodes, expected the same", "E-210")


def _start_edges(coverage: Coverage, tile_id: int, faces: Table, n_face: int, n_edge: int) -> Ints:
    """Index of the edge with which the one ring of each face of the store starts."""
    rings = read_checked(coverage, "rng", {"id": "I", "face_id": "I", "start_edge": "I"}, tile_id)
    face_id, stored = rings["face_id"].astype(np.int64), FIRST_FACE + np.arange(n_face)
    message = "found a ring out of order, expected rings by face"
    check(np.diff(face_id) >= 0, rings.path, message, "E-220", start=1)
    is_there = (face_id >= 1) & (face_id <= faces.n_row)
    check(is_there, rings.path, f"found face_id {{}}, expected 1 … {faces.n_row}", "E-220", face_id)
    first, end = np.searchsorted(face_id, stored), np.searchsorted(face_id, stored, side="right")
    count, pointer = end - first, faces["ring_ptr"][stored - 1]
    check(count == 1, faces.path, "found {} rings, expected one", "E-220", count, start=FIRST_FACE - 1)
    message = "found ring_ptr {}, expected {}"
    check(pointer == first + 1, faces.path, message, "E-220", pointer, first + 1, start=FIRST_FACE - 1)
    start_edge = rings["start_edge"][first].astype(np.int64)
    is_there = (start_edge >= 1) & (start_edge <= n_edge)
    check(is_there, rings.path, f"found start_edge {{}}, expected 1 … {n_edge}", "E-220", start_edge, rows=first)
    return start_edge - 1
