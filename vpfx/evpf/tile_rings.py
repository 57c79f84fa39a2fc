"""Primitives of one tile and level, read and checked (specs/evpf.md chapter 2)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import VpfFormatError
from vpfx.evpf.checked import check, read_checked
from vpfx.evpf.corners import BROKEN, Edges, Rings, walk_rings
from vpfx.evpf.numbering import FIRST_FACE
from vpfx.vpf.catalog import Coverage
from vpfx.vpf.table import Ragged, Table

__all__ = ["Primitives", "read_primitives"]

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]


EDGES = {
    "id": "I", "start_node": "I", "end_node": "I", "right_face": "K", "left_face": "K", "right_edge": "K",
    "left_edge": "K",
}  # fmt: skip


class Primitives(NamedTuple):
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


def read_primitives(coverage: Coverage, tile_id: int, n_face: int, is_double: bool) -> Primitives:
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
    return Primitives(nodes.path, faces.path, xyz, rings)


def _is_stored(face: Ints, n_face: int) -> NDArray[np.bool_]:
    return (face >= FIRST_FACE) & (face < FIRST_FACE + n_face)


def _read_edges(coverage: Coverage, tile_id: int, nodes: Table, n_row: int, n_face: int) -> Edges:
    """Edges, what they name checked to be there; faces stay ids, of `n_row` in `fac`."""
    kind = next(column.kind for column in nodes.layout.columns if column.name.lower() == "coordinate")
    table = read_checked(coverage, "edg", EDGES | {"coordinates": f"{kind}*"}, tile_id)
    found = {name: table[name] for name in EDGES if name != "id"}
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
