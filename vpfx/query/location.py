"""Which face lies at a place, and how high its surface is there: for many places at once."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vpfx.errors import InputError, StoreFormatError
from vpfx.geometry import ON_EDGE, heights_on_faces
from vpfx.store.descent import MOST_OF_TILES, MOST_PLACES, Mesh, faces_near, mesh_of
from vpfx.store.reader import StoreReader
from vpfx.topology import NONE

__all__ = ["Located", "bin_of", "bins_of", "checked_places", "find_faces", "locate"]

Floats = NDArray[np.float64]

FACES_PER_BIN = 2.0


class Located(NamedTuple):
    """What lies at places; -1 and NaN where there is no face.

    Attributes
    ----------
    face_ids : int64 (n,)
        On an edge or at a node the face of least id.
    z : float64 (n,)
        Height of the surface, metres.
    slope, aspect : float64 (n,)
        Of the face, degrees; aspect is NaN for level ground too.
    normal : float64 (n, 3)
        Of the face, upwards, of length 1: east, north, up.
    """

    face_ids: NDArray[np.int64]
    z: Floats
    slope: Floats
    aspect: Floats
    normal: Floats


def locate(store: StoreReader, places: Any, level: int) -> Located:
    """Find the faces of a level at places.

    Parameters
    ----------
    store : StoreReader
    places : float64 (n, 2)
        x and y in CRS units.
    level : int

    Raises
    ------
    InputError
        The places are no (n, 2) array of finite numbers.
    NotFoundError
        There is no such level.

    Notes
    -----
    Tile by tile: for few places, or places near each other, reads the faces there from the coarsest level down
    (`vpfx.store.descent`), else the tile. Cost: O(faces there + places).
    """
    store.check_level(level)
    xy = checked_places(places)
    face_ids, z = np.full(len(xy), NONE, np.int64), np.full(len(xy), np.nan)
    tiles = store.tiles()
    for tile_of_place in _tiles_at(store, tiles, xy):
        open_places = np.flatnonzero((face_ids == NONE) & (tile_of_place != NONE))
        open_places = open_places[np.argsort(tile_of_place[open_places], kind="stable")]
        touched, first = np.unique(tile_of_place[open_places], return_index=True)
        last = np.append(first, len(open_places))[1:]
        for tile, low, high in zip(touched.tolist(), first.tolist(), last.tolist(), strict=True):
            some = open_places[low:high]
            ids, nodes, face_nodes, *bins = _binned(store, level, tiles, tile, xy[some])
            found = _find(np.ascontiguousarray(xy[some]), nodes, face_nodes, *bins)
            is_found = found != NONE
            face_ids[some[is_found]] = ids[found[is_found]]
            z[some[is_found]] = heights_on_faces(nodes, face_nodes, found[is_found], xy[some[is_found]])
    return _described(store, face_ids, z)


def checked_places(places: Any) -> Floats:
    """Return places as an array, (n, 2).

    Raises
    ------
    InputError
        They are none.
    """
    try:
        xy = np.asarray(places, np.float64)
    except (TypeError, ValueError):
        raise InputError(f"places: found {str(places)[:40]}, expected (n, 2) finite numbers") from None
    xy = xy.reshape(-1, 2) if xy.size == 0 else xy
    if xy.ndim != 2 or xy.shape[1] != 2 or not np.isfinite(xy).all():
        raise InputError(f"places: found an array of shape {xy.shape}, expected (n, 2) finite numbers")
    return xy


def _tiles_at(store: StoreReader, tiles: dict[str, NDArray[Any]], xy: Floats) -> list[NDArray[np.int64]]:
    """Return the tiles that each place lies in or on, ascending: four numbers of tiles a place, -1 for none.

    Places on the line between two tiles, or nearly, have both, at a corner all four.
    """
    west, south = np.unique(tiles["xmin"]), np.unique(tiles["ymin"])
    if len(tiles["tile_id"]) != len(west) * len(south):
        raise StoreFormatError(str(store.path), "table tile", "found tiles that are no rows and columns", "R-130")
    away = _away(tiles)
    low: list[NDArray[np.int64]] = []
    high: list[NDArray[np.int64]] = []
    for axis, (lines, end) in enumerate(((west, store.extent.max_x), (south, store.extent.max_y))):
        is_there = (xy[:, axis] >= lines[0] - away) & (xy[:, axis] <= end + away)
        for found, side in ((low, -away), (high, away)):
            at = np.searchsorted(lines, xy[:, axis] + side, side="right") - 1
            found.append(np.where(is_there, at.clip(0), NONE))
    passes = []
    for row, is_row in ((low[1], True), (high[1], low[1] != high[1])):
        for col, is_col in ((low[0], True), (high[0], low[0] != high[0])):
            is_one = (row != NONE) & (col != NONE) & is_row & is_col
            passes.append(np.where(is_one, row * len(west) + col, NONE))
    return passes


def _away(tiles: dict[str, NDArray[Any]]) -> float:
    """How far a place may lie from a tile and still be on one of its faces: no face is larger than its tile."""
    sides = np.stack([tiles["xmax"] - tiles["xmin"], tiles["ymax"] - tiles["ymin"]])
    return ON_EDGE * float(sides.max(initial=0.0))


def _binned(store: StoreReader, level: int, tiles: dict[str, NDArray[Any]], tile: int, xy: Floats) -> tuple[Any, ...]:
    """Ids, nodes, face_nodes and bins of the faces near places of a tile, or of all its faces, kept for the next question."""
    low, high = (np.array([tiles[name][tile] for name in names]) for names in (("xmin", "ymin"), ("xmax", "ymax")))

    def make(mesh: Mesh, low: Floats, high: Floats) -> tuple[Any, ...]:
        return (mesh.faces["face_id"], mesh.xyz, mesh.face_nodes, *bins_of(mesh.xyz, mesh.face_nodes, low, high))

    span = np.ptp(xy, axis=0)
    if len(xy) <= MOST_PLACES or span.prod() < MOST_OF_TILES * (high - low).prod():
        near = faces_near(store, level, xy, _away(tiles))
        return make(near, np.maximum(xy.min(axis=0), low), np.minimum(xy.max(axis=0), high))
    tile_id = int(tiles["tile_id"][tile])
    return store.keep(
        ("bins", level, tile_id), lambda: make(mesh_of(store, store.tile_faces(level, tile_id)), low, high)
    )


def find_faces(nodes: Floats, face_nodes: NDArray[np.int32], places: Floats) -> NDArray[np.int64]:
    """Find the first face that each place lies in or on; -1 for none.

    Parameters
    ----------
    nodes : float64 (n_node, 3)
    face_nodes : int32 (n_face, 3)
    places : float64 (n, 2)

    Returns
    -------
    int64 (n,)

    Examples
    --------
    >>> find_faces(np.array([[0, 0, 5.0], [2, 0, 5], [0, 2, 6]]), np.array([[0, 1, 2]], np.int32), np.array([[1, 1], [2, 2.0]]))
    array([ 0, -1])
    """
    if len(face_nodes) == 0:
        return np.full(len(places), NONE, np.int64)
    low, high = nodes[:, :2].min(axis=0), nodes[:, :2].max(axis=0)
    return _find(np.ascontiguousarray(places), nodes, face_nodes, *bins_of(nodes, face_nodes, low, high))


def _described(store: StoreReader, face_ids: NDArray[np.int64], z: Floats) -> Located:
    """Add slopes, aspects and normals."""
    is_there = face_ids != NONE
    rows = store.fetch("face", face_ids[is_there])
    slope, aspect = np.full(len(z), np.nan), np.full(len(z), np.nan)
    slope[is_there] = rows["slope_centidegrees"] / 100.0
    aspect[is_there] = np.where(rows["aspect_centidegrees"] == NONE, np.nan, rows["aspect_centidegrees"] / 100.0)
    steep, towards = np.radians(slope), np.radians(np.where(is_there, np.nan_to_num(aspect), np.nan))
    normal = np.stack([np.sin(steep) * np.sin(towards), np.sin(steep) * np.cos(towards), np.cos(steep)], axis=1)
    return Located(face_ids, z, slope, aspect, normal)


def bins_of(nodes: Floats, face_nodes: NDArray[np.int32], low: Floats, high: Floats) -> tuple[Any, ...]:
    """Sort faces into bins of a rectangle: offsets, faces, corner and size of the bins."""
    size = np.maximum(high - low, 1e-6 * float((high - low).max()) or 1.0)  # places may lie on one line, or be one
    n_bin = max(1.0, len(face_nodes) / FACES_PER_BIN)
    n_col = int(np.clip(np.round(np.sqrt(n_bin * size[0] / size[1])), 1, n_bin))
    n_row = int(max(1, np.round(n_bin / n_col)))
    step = size / (n_col, n_row)
    return (*_sort_faces(nodes, face_nodes, low, step, n_col, n_row), low, step, n_col, n_row)


@njit(nogil=True, cache=True)
def bin_of(value, low, step, n):  # type: ignore[no-untyped-def]
    """Return the bin of a coordinate."""
    found = int(np.floor((value - low) / step))
    return min(max(found, 0), n - 1)


@njit(nogil=True, cache=True)
def _sort_faces(nodes, face_nodes, low, step, n_col, n_row):  # type: ignore[no-untyped-def]
    """List the faces whose bounding boxes touch each bin, ascending: offsets (n_bin + 1,) and faces."""
    n_face = len(face_nodes)
    pad_x, pad_y = ON_EDGE * step[0] * n_col, ON_EDGE * step[1] * n_row  # places nearly on a face are on it
    box = np.empty((n_face, 4), np.int64)
    offsets = np.zeros(n_col * n_row + 1, np.int64)
    for face in range(n_face):
        for axis in range(2):
            a, b, c = (
                nodes[face_nodes[face, 0], axis],
                nodes[face_nodes[face, 1], axis],
                nodes[face_nodes[face, 2], axis],
            )
            n = n_col if axis == 0 else n_row
            pad = pad_x if axis == 0 else pad_y
            box[face, axis] = bin_of(min(a, b, c) - pad, low[axis], step[axis], n)
            box[face, 2 + axis] = bin_of(max(a, b, c) + pad, low[axis], step[axis], n)
        for row in range(box[face, 1], box[face, 3] + 1):
            for col in range(box[face, 0], box[face, 2] + 1):
                offsets[row * n_col + col + 1] += 1
    offsets = np.cumsum(offsets)
    at, faces = offsets[:-1].copy(), np.empty(offsets[-1], np.int32)
    for face in range(n_face):
        for row in range(box[face, 1], box[face, 3] + 1):
            for col in range(box[face, 0], box[face, 2] + 1):
                faces[at[row * n_col + col]] = face
                at[row * n_col + col] += 1
    return offsets, faces


@njit(nogil=True, cache=True)
def _find(places, nodes, face_nodes, offsets, faces, low, step, n_col, n_row):  # type: ignore[no-untyped-def]
    """Return the first face that each place lies in or on, -1 for none, int64 (n,)."""
    found = np.full(len(places), NONE, np.int64)
    for k in range(len(places)):
        x, y = places[k, 0], places[k, 1]
        at = bin_of(y, low[1], step[1], n_row) * n_col + bin_of(x, low[0], step[0], n_col)
        for j in range(offsets[at], offsets[at + 1]):
            face = faces[j]
            a, b, c = face_nodes[face]
            ax, ay = nodes[a, 0] - x, nodes[a, 1] - y
            bx, by = nodes[b, 0] - x, nodes[b, 1] - y
            cx, cy = nodes[c, 0] - x, nodes[c, 1] - y
            of_a, of_b, of_c = bx * cy - by * cx, cx * ay - cy * ax, ax * by - ay * bx
            least = -ON_EDGE * (of_a + of_b + of_c)
            if of_a >= least and of_b >= least and of_c >= least:
                found[k] = face
                break
    return found
