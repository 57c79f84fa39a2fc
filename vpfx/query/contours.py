"""Contours: where the surface of a level crosses given heights, as joined lines across tiles as if there were none."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from vpfx.errors import InputError
from vpfx.model import Tin
from vpfx.query.region import area_of, region, to_degrees
from vpfx.store.reader import StoreReader

__all__ = ["Contour", "contours", "contours_of", "even_heights", "to_geojson"]

Floats = NDArray[np.float64]

MOST_HEIGHTS = 10_000
"""Heights that are drawn at once: more are a slip of the interval."""


class Contour(NamedTuple):
    """What lies at one height.

    Attributes
    ----------
    height : float
        Metres.
    lines : shapely MultiLineString
        With z, places in CRS units; empty where the surface does not cross the height. Higher ground lies to the left.
    """

    height: float
    lines: Any


def contours(store: StoreReader, level: int, heights: Any, *, bbox: Sequence[float] | None = None) -> list[Contour]:
    """Contours of a level.

    Parameters
    ----------
    store : StoreReader
    level : int
    heights : float64 (n,)
        Metres.
    bbox : four numbers, optional
        min_x, min_y, max_x, max_y in CRS units; lines are cut off at its sides.

    Returns
    -------
    list of Contour
        One a height, in the order asked.

    Raises
    ------
    InputError
        The heights are not finite numbers, or the rectangle is none or has no area.
    NotFoundError
        There is no such level.

    Notes
    -----
    Source: specs/query.md Q-160. Reads the tiles that touch the rectangle. Cost: O(faces) a height.
    """
    if bbox is not None and area_of(bbox, None).area == 0.0:
        raise InputError(f"bbox: found {tuple(bbox)}, expected a rectangle with area")
    return contours_of(region(store, level, bbox=bbox), heights, bbox=bbox)


def contours_of(tin: Tin, heights: Any, *, bbox: Sequence[float] | None = None) -> list[Contour]:
    """Contours of a mesh, as of `contours`.

    Raises
    ------
    InputError
        The heights are not finite numbers.

    Examples
    --------
    A slope that rises to the east, so that the line runs south:

    >>> tin = Tin(np.array([[0, 0, 0], [2, 0, 2], [2, 2, 2], [0, 2, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))
    >>> contours_of(tin, [1])[0].lines.wkt
    'MULTILINESTRING Z ((1 2 1, 1 1 1, 1 0 1))'
    """
    values = np.atleast_1d(np.asarray(heights, np.float64))
    if values.ndim != 1 or not np.isfinite(values).all():
        raise InputError(f"heights: found {heights}, expected finite numbers")
    low, high = (bound(tin.nodes[tin.face_nodes, 2], axis=1) for bound in (np.min, np.max))
    found = []
    for height in values.tolist():
        faces = tin.face_nodes[(low < height) & (high >= height)]
        pieces = _pieces(tin.nodes, faces, height)
        found.append(Contour(height, _joined(pieces if bbox is None else _cut_off(pieces, bbox), height)))
    return found


def even_heights(tin: Tin, interval: float) -> Floats:
    """Multiples of an interval that lie on a mesh, ascending, (n,).

    Raises
    ------
    InputError
        The interval is not positive, or gives more than `MOST_HEIGHTS`.

    Examples
    --------
    >>> even_heights(Tin(np.array([[0, 0, 5], [1, 0, 5], [0, 1, 31]]), np.array([[0, 1, 2]])), 10).tolist()
    [10.0, 20.0, 30.0]
    """
    if not (np.isfinite(interval) and interval > 0):
        raise InputError(f"interval: found {interval}, expected a positive number of metres")
    if tin.n_node == 0:
        return np.empty(0)
    first, last = np.ceil(tin.nodes[:, 2].min() / interval), np.floor(tin.nodes[:, 2].max() / interval)
    if last - first >= MOST_HEIGHTS:
        raise InputError(f"interval: found {interval}, expected one that gives at most {MOST_HEIGHTS} heights")
    return np.asarray(np.arange(first, last + 1) * interval)


def to_geojson(found: Sequence[Contour], crs: str) -> dict[str, Any]:
    """Contours as a GeoJSON FeatureCollection (RFC 7946), a feature each height with property `height`.

    Parameters
    ----------
    crs : str
        Of the contours; empty if unknown, which leaves places as they are instead of longitude and latitude on WGS 84.

    Raises
    ------
    InputError
        Places have no longitude and latitude.

    Examples
    --------
    >>> lines = shapely.from_wkt("MULTILINESTRING Z ((0 0 7, 1 1 7))")
    >>> to_geojson([Contour(7.0, lines)], "")["features"][0]["geometry"]["coordinates"]
    [[[0.0, 0.0, 7.0], [1.0, 1.0, 7.0]]]
    """
    parts = [shapely.get_parts(contour.lines) for contour in found]
    every = np.concatenate([np.empty(0, object), *parts])
    places, line = shapely.get_coordinates(every, include_z=True, return_index=True)
    moved = np.column_stack([*to_degrees(places[:, 0], places[:, 1], crs), places[:, 2]])
    lines = iter(np.split(moved, np.flatnonzero(np.diff(line)) + 1))
    features = []
    for contour, own in zip(found, parts, strict=True):
        geometry = {"type": "MultiLineString", "coordinates": [next(lines).tolist() for _ in own]}
        features.append({"type": "Feature", "properties": {"height": contour.height}, "geometry": geometry})
    return {"type": "FeatureCollection", "features": features}


def _pieces(nodes: Floats, face_nodes: NDArray[np.int32], height: float) -> Floats:
    r"""Pieces of a contour over single faces, from start to end, (n, 2, 2).

    A node at the height counts as above it, by nothing, so a face is crossed at two of its sides. Walking round it
    counter-clockwise, the ground falls below the height at one and comes up again at the other:

              a              a is above, b and c are below: the line runs from the side where the ground falls to
             / \             that where it rises, with the higher ground to its left
     falls  *-->*  rises
           /     \
          b-------c
    """
    is_above = nodes[face_nodes, 2] >= height
    ahead = np.roll(is_above, -1, axis=1)
    falls, rises = (is_above & ~ahead).argmax(axis=1), (~is_above & ahead).argmax(axis=1)
    row = np.arange(len(face_nodes))
    sides = [(face_nodes[row, i], face_nodes[row, (i + 1) % 3]) for i in (falls, rises)]
    pieces = np.stack([_crossing(nodes, *side, height) for side in sides], axis=1)
    pieces = pieces[(pieces[:, 0] != pieces[:, 1]).any(axis=1)]  # else only a node is met
    return _without_pairs(pieces)


def _crossing(nodes: Floats, start: NDArray[np.int32], end: NDArray[np.int32], height: float) -> Floats:
    """Places on edges at a height, (n, 2), the same from whichever end an edge is seen."""
    is_turned = (nodes[start, 0] > nodes[end, 0]) | (
        (nodes[start, 0] == nodes[end, 0]) & (nodes[start, 1] > nodes[end, 1])
    )
    a, b = nodes[np.where(is_turned, end, start)], nodes[np.where(is_turned, start, end)]
    share = ((height - a[:, 2]) / (b[:, 2] - a[:, 2]))[:, None]
    place = a[:, :2] + share * (b[:, :2] - a[:, :2])
    at_a, at_b = (a[:, 2] == height)[:, None], (b[:, 2] == height)[:, None]
    found: Floats = np.where(at_a, a[:, :2], np.where(at_b, b[:, :2], place))
    return found


def _without_pairs(pieces: Floats) -> Floats:
    """Leave out pieces that run to and fro between the same places: a ridge just at the height bounds nothing."""
    if len(pieces) == 0:
        return pieces
    _, name = np.unique(pieces.reshape(-1, 2), axis=0, return_inverse=True)
    start, end = name.reshape(-1, 2).astype(np.int64).T
    count = int(name.max()) + 1
    is_paired = np.isin(start * count + end, end * count + start)
    return pieces[~is_paired]


def _cut_off(pieces: Floats, bbox: Sequence[float]) -> Floats:
    """Cut pieces off at the sides of a rectangle; ends inside stay as they are."""
    first, last = np.zeros(len(pieces)), np.ones(len(pieces))
    start, way = pieces[:, 0], pieces[:, 1] - pieces[:, 0]
    for axis in (0, 1):
        is_level = way[:, axis] == 0.0
        step = np.where(is_level, 1.0, way[:, axis])
        low, high = ((bbox[axis + k] - start[:, axis]) / step for k in (0, 2))
        is_out = is_level & ((start[:, axis] < bbox[axis]) | (start[:, axis] > bbox[axis + 2]))
        enters, leaves = np.minimum(low, high), np.maximum(low, high)
        first = np.maximum(first, np.where(is_level, -np.inf, enters))
        last = np.where(is_out, -np.inf, np.minimum(last, np.where(is_level, np.inf, leaves)))
    keep = first < last
    start, way, first, last = start[keep], way[keep], first[keep][:, None], last[keep][:, None]
    return np.stack([start + first * way, np.where(last == 1.0, pieces[keep, 1], start + last * way)], axis=1)


def _joined(pieces: Floats, height: float) -> Any:
    """Join pieces end to start, where two meet, into lines in an order that hangs on their places alone."""
    if len(pieces) == 0:
        return shapely.force_3d(shapely.MultiLineString(), height)
    start, end = pieces[:, 0], pieces[:, 1]
    order = np.lexsort((end[:, 1], end[:, 0], start[:, 1], start[:, 0]))
    merged = shapely.line_merge(shapely.multilinestrings(shapely.linestrings(pieces[order])), directed=True)
    lines = [_from_least(shapely.get_coordinates(line)) for line in shapely.get_parts(merged)]
    lines.sort(key=lambda line: (*line[0], *line[1], len(line)))
    return shapely.force_3d(shapely.multilinestrings([shapely.linestrings(line) for line in lines]), height)


def _from_least(line: Floats) -> Floats:
    """Turn a closed line so that it begins at its westernmost, else southernmost place."""
    if not np.array_equal(line[0], line[-1]):
        return line
    ring = line[:-1]
    first = int(np.lexsort((ring[:, 1], ring[:, 0]))[0])
    return np.concatenate([ring[first:], ring[: first + 1]])
