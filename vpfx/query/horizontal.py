"""Horizontal navigation: from faces, edges and nodes of a level to those beside them, across tiles as if there were none.

All functions take and return arrays of ids; -1 is the outside. They follow the winged-edge links of the table `edge`
(specs/format.md R-161), so they read the rows they need and nothing else.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import InputError, NotFoundError, StoreFormatError
from vpfx.store.arrays import look_up
from vpfx.store.descent import faces_near
from vpfx.store.reader import StoreReader
from vpfx.topology import NONE

__all__ = ["Groups", "Rings", "components", "edge_neighbours", "flood", "k_ring", "node_neighbours", "rings"]

Ids = NDArray[np.int64]
MOST_DEGREE = 4096
"""Edges at a node; more than any mesh of vpfx has."""


class Groups(NamedTuple):
    """Ids that belong to each of several things: those of thing i are ``ids[offsets[i]:offsets[i + 1]]``.

    Attributes
    ----------
    offsets : int64 (n + 1,)
    ids : int64 (n_id,)
    """

    offsets: Ids
    ids: Ids


class Rings(NamedTuple):
    """Edges and faces round nodes, counter-clockwise: those of node i are ``edge_ids[offsets[i]:offsets[i + 1]]``.

    Attributes
    ----------
    offsets : int64 (n + 1,)
    edge_ids : int64 (n_edge,)
        The first is the one of least id.
    face_ids : int64 (n_edge,)
        The face to the left of each edge as seen from the node, -1 outside.
    """

    offsets: Ids
    edge_ids: Ids
    face_ids: Ids


def edge_neighbours(store: StoreReader, face_ids: Any) -> Ids:
    """Faces across the edges of faces.

    Parameters
    ----------
    store : StoreReader
    face_ids : integers (n,)

    Returns
    -------
    int64 (n, 3)
        Beyond edge_1, edge_2 and edge_3; -1 outside, and where the face across has a T-junction in its edge.

    Raises
    ------
    NotFoundError
        There is no such face.
    """
    faces = store.fetch("face", face_ids)
    edge_ids = np.stack([faces[f"edge_{i}"] for i in (1, 2, 3)], axis=1)
    edges = store.fetch("edge", edge_ids)
    own = np.repeat(faces["face_id"], 3)
    other = np.where(edges["left_face"] == own, edges["right_face"], edges["left_face"])
    return other.reshape(-1, 3)


def rings(store: StoreReader, node_ids: Any, level: int) -> Rings:
    """Edges and faces of a level round nodes, in order.

    Parameters
    ----------
    store : StoreReader
    node_ids : integers (n,)
    level : int

    Raises
    ------
    NotFoundError
        There is no such level, or a node that no face of the level has.
    """
    nodes = np.asarray(node_ids, np.int64).ravel()
    wanted, index = np.unique(nodes, return_inverse=True)
    first = _edges_at(store, wanted, level)
    found = [first]
    faces: list[Ids] = []
    at, is_open = first.copy(), np.ones(len(wanted), bool)
    for _ in range(MOST_DEGREE):
        edges = store.fetch("edge", at[is_open])
        leaves = edges["start_node"] == wanted[is_open]
        if not (leaves | (edges["end_node"] == wanted[is_open])).all():
            raise StoreFormatError(
                str(store.path), "table edge", "found a winged link to an edge of another node", "R-161"
            )
        face, following = np.full(len(wanted), NONE, np.int64), first.copy()
        face[is_open] = np.where(leaves, edges["left_face"], edges["right_face"])
        following[is_open] = np.where(leaves, edges["left_edge"], edges["right_edge"])
        faces.append(np.where(is_open, face, NONE))
        is_open = is_open & (following != first)
        if not is_open.any():
            break
        at = following
        found.append(np.where(is_open, at, NONE))
    else:
        raise StoreFormatError(str(store.path), "table edge", "found winged links that do not close", "R-161")
    edge_ids = np.stack(found, axis=1)
    face_ids = np.stack(faces, axis=1)
    edge_ids, face_ids = _from_least(edge_ids, face_ids)
    edge_ids, face_ids = edge_ids[index], face_ids[index]
    offsets = np.concatenate([[0], np.cumsum((edge_ids != NONE).sum(axis=1))])
    return Rings(offsets, edge_ids[edge_ids != NONE], face_ids[edge_ids != NONE])


def _from_least(edge_ids: Ids, face_ids: Ids) -> tuple[Ids, Ids]:
    """Turn rings, filled up with -1 behind, so that each begins with its least edge."""
    degree = (edge_ids != NONE).sum(axis=1)[:, None]
    first = np.where(edge_ids == NONE, np.iinfo(np.int64).max, edge_ids).argmin(axis=1)[:, None]
    place = np.arange(edge_ids.shape[1])
    turned = np.where(place < degree, (first + place) % degree, place)
    return np.take_along_axis(edge_ids, turned, axis=1), np.take_along_axis(face_ids, turned, axis=1)


def _edges_at(store: StoreReader, node_ids: Ids, level: int) -> Ids:
    """One edge of a level at each node, the nodes ascending."""
    if len(node_ids) == 0:
        return node_ids
    nodes = store.fetch("node", node_ids)
    faces = faces_near(store, level, np.stack([nodes["x"], nodes["y"]], axis=1)).faces
    found = np.full(len(node_ids), NONE, np.int64)
    for i in (1, 2, 3):
        at, is_there = look_up(node_ids, faces[f"node_{i}"])
        found[at[is_there]] = faces[f"edge_{i}"][is_there]
    if (found == NONE).any():
        raise NotFoundError(f"{store.path}: level {level}: found no face at node {node_ids[found == NONE][0]}")
    return found


def node_neighbours(store: StoreReader, face_ids: Any) -> Groups:
    """Faces that share at least a corner with each of some faces of one level, ascending.

    Raises
    ------
    InputError
        The faces are of several levels.
    NotFoundError
        There is no such face.
    """
    faces = store.fetch("face", face_ids)
    own = faces["face_id"]
    if len(own) == 0:
        return Groups(np.zeros(1, np.int64), np.empty(0, np.int64))
    corners = np.stack([faces[f"node_{i}"] for i in (1, 2, 3)], axis=1)
    round_ = rings(store, corners, _one_level(faces))
    owner = np.repeat(np.arange(len(own)), 3)[np.repeat(np.arange(corners.size), np.diff(round_.offsets))]
    keep = (round_.face_ids != NONE) & (round_.face_ids != own[owner])
    pairs = np.unique(np.stack([owner[keep], round_.face_ids[keep]], axis=1), axis=0)
    offsets = np.searchsorted(pairs[:, 0], np.arange(len(own) + 1))
    return Groups(offsets.astype(np.int64), pairs[:, 1])


def _one_level(faces: dict[str, NDArray[Any]]) -> int:
    """Return the level of some faces."""
    levels = np.unique(faces["level"])
    if len(levels) > 1:
        raise InputError(f"faces: found levels {levels[0]} and {levels[1]}, expected faces of one level")
    return int(levels[0])


def k_ring(store: StoreReader, face_ids: Any, k: int, *, over: str = "edge") -> Ids:
    """Faces within k steps of some faces, these included, ascending.

    Parameters
    ----------
    k : int
        0 gives the faces themselves.
    over : str
        Whether a step leads over an ``edge`` or over a ``node``.

    Raises
    ------
    InputError
        `k` is negative, or `over` is another word.
    """
    if k < 0 or over not in ("edge", "node"):
        raise InputError(f"k_ring: found {k} steps over {over!r}, expected none or more over edge or node")
    known = newest = np.unique(store.fetch("face", face_ids)["face_id"])
    for _ in range(k):
        beside = edge_neighbours(store, newest) if over == "edge" else node_neighbours(store, newest).ids
        newest = np.setdiff1d(beside, np.append(known, NONE))
        known = np.union1d(known, newest)
        if len(newest) == 0:
            break
    return known


def flood(store: StoreReader, face_ids: Any, is_wanted: Callable[[dict[str, NDArray[Any]]], NDArray[np.bool_]]) -> Ids:
    """Faces that can be reached over edges from some faces through wanted faces, ascending.

    Parameters
    ----------
    is_wanted : callable
        Rows of the table `face`, as of `Store.fetch` → bool (n,).
    """
    start = store.fetch("face", np.unique(np.asarray(face_ids, np.int64)))
    known = newest = start["face_id"][np.asarray(is_wanted(start), bool)]
    seen = start["face_id"]
    while len(newest):
        beside = np.setdiff1d(edge_neighbours(store, newest), np.append(seen, NONE))
        seen = np.union1d(seen, beside)
        rows = store.fetch("face", beside)
        newest = beside[np.asarray(is_wanted(rows), bool)] if len(beside) else beside
        known = np.union1d(known, newest)
    return known


def components(store: StoreReader, face_ids: Any) -> NDArray[np.int64]:
    """Number the pieces that some faces make, which hang together over edges.

    Returns
    -------
    int64 (n,)
        Piece of each face, counted from 0 in the order of their least faces.
    """
    faces, index = np.unique(np.asarray(face_ids, np.int64).ravel(), return_inverse=True)
    beside = edge_neighbours(store, faces)
    at, is_there = look_up(faces, beside)
    row, side = np.nonzero(is_there)
    label = np.arange(len(faces))
    while True:
        least = label.copy()
        np.minimum.at(least, label[row], label[at[row, side]])
        least = np.minimum(least, least[label])
        while not np.array_equal(least, least[least]):
            least = least[least]
        if np.array_equal(least, label):
            break
        label = least
    return np.unique(label, return_inverse=True)[1][index]
