"""Profiles: what lies under a line, face by face, with every edge crossed."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import InputError
from vpfx.geometry import ON_EDGE, heights_on_faces
from vpfx.model import Extent
from vpfx.query.location import find_faces
from vpfx.store.descent import Mesh, descend
from vpfx.store.reader import StoreReader
from vpfx.topology import NONE

__all__ = ["Profile", "profile"]

Floats = NDArray[np.float64]

LEAST_PIECE = 1e-9
"""Of a stretch of the line: crossings nearer to each other are one."""


class Profile(NamedTuple):
    """Pieces of a line, each under or over one face, in the order of the line; where there is no face there is none.

    Attributes
    ----------
    face_ids : int64 (n,)
        Along an edge the face of least id.
    start, end : float64 (n, 3)
        x and y in CRS units, height of the surface in metres.
    distance : float64 (n, 2)
        Of start and end from the begin of the line, CRS units.
    """

    face_ids: NDArray[np.int64]
    start: Floats
    end: Floats
    distance: Floats


def profile(store: StoreReader, line: Any, level: int) -> Profile:
    """Follow a line over a level.

    Parameters
    ----------
    store : StoreReader
    line : float64 (n, 2)
        x and y in CRS units of at least two places.
    level : int

    Raises
    ------
    InputError
        The line is no (n, 2) array of finite numbers with n ≥ 2.
    NotFoundError
        There is no such level.

    Notes
    -----
    Reads the faces along the line, from the coarsest level down (`vpfx.store.descent`). Cost: O(pieces + faces of level 0).
    """
    store.check_level(level)
    vertices = np.asarray(line, np.float64)
    if vertices.ndim != 2 or vertices.shape[1] != 2 or len(vertices) < 2 or not np.isfinite(vertices).all():
        raise InputError(
            f"line: found an array of shape {vertices.shape}, expected (n, 2) finite numbers, n at least 2"
        )
    found, done = [], 0.0
    for start, end in pairwise(vertices):
        length = float(np.hypot(*(end - start)))
        if length > 0.0:
            found.append(_stretch(store, start, end, level, done))
        done += length
    if not found:
        return Profile(np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 2)))
    return Profile(*map(np.concatenate, zip(*found, strict=True)))


def _stretch(store: StoreReader, start: Floats, end: Floats, level: int, done: float) -> Profile:
    """Follow one straight stretch."""
    mesh = _faces_along(store, start, end, level)
    nodes, face_nodes = mesh.xyz, mesh.face_nodes
    cuts = _crossings(nodes, face_nodes, start, end)
    middles = start + ((cuts[:-1] + cuts[1:]) / 2)[:, None] * (end - start)
    face = find_faces(nodes, face_nodes, middles)
    first = np.flatnonzero(np.append(True, face[1:] != face[:-1]))
    last = np.append(first[1:], len(face)) - 1
    is_face = face[first] != NONE
    first, last = first[is_face], last[is_face]
    face, along = face[first], np.stack([cuts[first], cuts[last + 1]], axis=1)
    places = start + along[:, :, None] * (end - start)
    height = [heights_on_faces(nodes, face_nodes, face, places[:, i]) for i in (0, 1)]
    ends = [np.column_stack([places[:, i], height[i]]) for i in (0, 1)]
    length = float(np.hypot(*(end - start)))
    return Profile(mesh.faces["face_id"][face], ends[0], ends[1], done + along * length)


def _faces_along(store: StoreReader, start: Floats, end: Floats, level: int) -> Mesh:
    """Return the faces of a level that a stretch touches, and some beside it."""
    ahead = end - start
    slack = ON_EDGE * float(np.abs(ahead).sum())
    slack *= float(np.abs(np.subtract(store.extent[2:], store.extent[:2])).sum())

    def touches(corner: Floats) -> NDArray[np.bool_]:
        side = (corner[:, :, 0] - start[0]) * ahead[1] - (corner[:, :, 1] - start[1]) * ahead[0]
        found: NDArray[np.bool_] = (side.min(axis=1) <= slack) & (side.max(axis=1) >= -slack)
        return found

    low, high = np.minimum(start, end), np.maximum(start, end)
    return descend(store, level, Extent(*low.tolist(), *high.tolist()), touches)


def _crossings(nodes: Floats, face_nodes: NDArray[np.int32], start: Floats, end: Floats) -> Floats:
    """Shares of a stretch at which it crosses edges, 0 and 1 among them, ascending."""
    ahead = end - start
    place = nodes[:, :2] - start
    side = place[:, 0] * ahead[1] - place[:, 1] * ahead[0]  # which side of the line each node lies on
    a, b = face_nodes.ravel(), np.roll(face_nodes, -1, axis=1).ravel()
    crosses = np.sign(side[a]) != np.sign(side[b])  # also where a node lies on the line
    a, b = a[crosses], b[crosses]
    share = side[a] / (side[a] - side[b])
    at = place[a] + share[:, None] * (place[b] - place[a])
    cuts = np.unique((at @ ahead) / (ahead @ ahead))
    inner = cuts[(cuts > LEAST_PIECE) & (cuts < 1.0 - LEAST_PIECE)]
    return np.concatenate([[0.0], inner[np.diff(inner, prepend=0.0) > LEAST_PIECE], [1.0]])
