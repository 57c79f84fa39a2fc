"""Profiles: what lies under a line, face by face, with every edge crossed."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import InputError
from vpfx.geometry import heights_on_faces
from vpfx.query.location import locate, mesh_of
from vpfx.store.store import Store
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


def profile(store: Store, line: Any, level: int) -> Profile:
    """Follow a line over a level.

    Parameters
    ----------
    store : Store
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
    Reads the tiles that the line touches. Cost: O(their faces) for each stretch of the line.
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


def _stretch(store: Store, start: Floats, end: Floats, level: int, done: float) -> Profile:
    """Follow one straight stretch."""
    cuts = _crossings(store, start, end, level)
    middles = start + ((cuts[:-1] + cuts[1:]) / 2)[:, None] * (end - start)
    face_ids = locate(store, middles, level).face_ids
    first = np.flatnonzero(np.append(True, face_ids[1:] != face_ids[:-1]))
    last = np.append(first[1:], len(face_ids)) - 1
    is_face = face_ids[first] != NONE
    first, last = first[is_face], last[is_face]
    ids, along = face_ids[first], np.stack([cuts[first], cuts[last + 1]], axis=1)
    nodes, face_nodes = mesh_of(store, store.fetch("face", ids))
    places = start + along[:, :, None] * (end - start)
    height = [heights_on_faces(nodes, face_nodes, np.arange(len(ids)), places[:, i]) for i in (0, 1)]
    ends = [np.column_stack([places[:, i], height[i]]) for i in (0, 1)]
    return Profile(ids, ends[0], ends[1], done + along * float(np.hypot(*(end - start))))


def _crossings(store: Store, start: Floats, end: Floats, level: int) -> Floats:
    """Shares of a stretch at which it crosses edges of a level, 0 and 1 among them, ascending."""
    low, high = np.minimum(start, end), np.maximum(start, end)
    ahead = end - start
    found = [np.array([0.0, 1.0])]
    for tile_id in store.tiles((*low, *high))["tile_id"].tolist():
        faces = store.tile_faces(level, tile_id)
        if len(faces["face_id"]) == 0:
            continue
        nodes, corner = mesh_of(store, faces)
        place = nodes[:, :2] - start
        side = place[:, 0] * ahead[1] - place[:, 1] * ahead[0]  # which side of the line each node lies on
        a, b = corner.ravel(), np.roll(corner, -1, axis=1).ravel()
        crosses = np.sign(side[a]) != np.sign(side[b])  # also where a node lies on the line
        a, b = a[crosses], b[crosses]
        share = side[a] / (side[a] - side[b])
        at = place[a] + share[:, None] * (place[b] - place[a])
        found.append((at @ ahead) / (ahead @ ahead))
    cuts = np.unique(np.concatenate(found))
    inner = cuts[(cuts > LEAST_PIECE) & (cuts < 1.0 - LEAST_PIECE)]
    return np.concatenate([[0.0], inner[np.diff(inner, prepend=0.0) > LEAST_PIECE], [1.0]])
