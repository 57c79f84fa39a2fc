"""Areas and volumes between the surface of a level and a plane, or the surface of another level, within a polygon."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from vpfx.dem.reference import unit_metres
from vpfx.errors import InputError
from vpfx.model import Tin
from vpfx.query.region import check_polygon, face_polygons, region
from vpfx.query.vertical import related
from vpfx.store.arrays import look_up
from vpfx.store.reader import StoreReader

__all__ = ["Volume", "positive_part", "volume"]

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]


class Volume(NamedTuple):
    """What lies within a polygon, by integration over flat faces.

    Attributes
    ----------
    area_m2 : float
        Ground covered, seen from above; of both levels where another level is the reference.
    surface_area_m2 : float
        Of the surface over that ground.
    cut_m3, fill_m3 : float
        Between surface and reference, where the surface lies above it, and below it.
    net_m3 : float
        Cut less fill.
    """

    area_m2: float
    surface_area_m2: float
    cut_m3: float
    fill_m3: float
    net_m3: float


class _Pieces(NamedTuple):
    """Triangles with signs that make up parts of faces: a part of any form is the sum of fans round one place of its face.

    Attributes
    ----------
    corners : float64 (n, 3, 2)
        x and y, CRS units.
    face, other : int64 (n,)
        Face that each is part of, and face of the reference.
    area : float64 (n,)
        Squared CRS units; below 0 where a triangle is clockwise.
    """

    corners: Floats
    face: Indices
    other: Indices
    area: Floats


def volume(
    store: StoreReader, level: int, polygon: Any = None, *, plane: Any = None, other_level: int | None = None
) -> Volume:
    """Areas and volumes of a level within a polygon.

    Parameters
    ----------
    store : StoreReader
    level : int
    polygon : shapely Polygon or MultiPolygon, optional
        In CRS units; without it, all ground.
    plane : float or three floats, optional
        Height z of the reference in metres, or (a, b, c) of the plane z = a + b·x + c·y with x and y in CRS units.
    other_level : int, optional
        Level whose surface is the reference. One of the two is given.

    Raises
    ------
    InputError
        The polygon is none, the plane is no finite number or three, or not one of plane and other_level is given.
    NotFoundError
        There is no such level.

    Notes
    -----
    Source: specs/query.md Q-170. Exact but for rounding: the difference is linear over each piece of a face, and its part
    above 0 has a closed form. A unit of x and of y has the size of the middle of the extent, in metres. Cost: O(faces), an
    intersection for each face across the rim, and where levels are not nested for each pair of faces that touch.
    """
    if (plane is None) == (other_level is None):
        raise InputError("volume: found a plane and another level, or neither, expected one of them")
    polygon = check_polygon(polygon)
    tin = region(store, level, polygon=polygon)
    if other_level is None:
        pieces = _clipped(tin, polygon)
        gap = _heights(tin, pieces.face, pieces.corners) - _plane_heights(plane, pieces.corners)
    else:
        other = region(store, other_level, polygon=polygon)
        pieces = _shared(store, tin, other, polygon, level >= other_level)
        gap = _heights(tin, pieces.face, pieces.corners) - _heights(other, pieces.other, pieces.corners)
    metres = unit_metres(store.crs, store.extent)
    area = pieces.area * metres[0] * metres[1]
    slope = _gradients(tin, pieces.face) / metres
    cut, fill = float(positive_part(gap) @ area), float(positive_part(-gap) @ area)
    surface = float(np.sqrt(1.0 + (slope * slope).sum(axis=1)) @ area)
    return Volume(float(area.sum()), surface, cut, fill, cut - fill)


def positive_part(values: Floats) -> Floats:
    """Mean, over a triangle, of a linear function where it is above 0, counting 0 elsewhere.

    Parameters
    ----------
    values : float64 (n, 3)
        Of the function at the corners.

    Returns
    -------
    float64 (n,)

    Notes
    -----
    With values a ≤ b ≤ c: where c alone is above 0, the part above is a triangle of c²/((c − a)(c − b)) of the area and of
    mean c/3. Where a alone is below 0, the part below is taken off from the whole in the same way.

    Examples
    --------
    >>> positive_part(np.array([[1.0, 1, 1], [-1, -1, 1], [-1, 1, 1], [-3, -2, 0]])).round(4).tolist()
    [1.0, 0.0833, 0.4167, 0.0]
    """
    a, b, c = np.sort(values, axis=1).T
    whole = (a + b + c) / 3.0
    with np.errstate(divide="ignore", invalid="ignore"):
        top = c * (c / (c - a)) * (c / (c - b)) / 3.0
        bottom = -a * (a / (a - b)) * (a / (a - c)) / 3.0
    found: Floats = np.select([c <= 0.0, a >= 0.0, b <= 0.0], [np.zeros_like(a), whole, top], whole + bottom)
    return found


def _plane_heights(plane: Any, places: Floats) -> Floats:
    """Heights of a plane at places."""
    try:
        a, b, c = (plane, 0.0, 0.0) if np.ndim(plane) == 0 else plane
        a, b, c = float(a), float(b), float(c)
    except (TypeError, ValueError):
        a = b = c = np.nan
    if not np.isfinite([a, b, c]).all():
        raise InputError(f"plane: found {plane}, expected a height, or a, b, c of a + b·x + c·y")
    heights: Floats = a + b * places[..., 0] + c * places[..., 1]
    return heights


def _gradients(tin: Tin, face: Indices) -> Floats:
    """Rise of faces to the east and to the north, metres a CRS unit, (n, 2)."""
    corner = tin.nodes[tin.face_nodes[face]]
    (x1, y1, z1), (x2, y2, z2) = (corner[:, 1] - corner[:, 0]).T, (corner[:, 2] - corner[:, 0]).T
    area = x1 * y2 - x2 * y1
    return np.stack([(z1 * y2 - z2 * y1) / area, (x1 * z2 - x2 * z1) / area], axis=1)


def _heights(tin: Tin, face: Indices, places: Floats) -> Floats:
    """Heights of the planes of faces at places (n, 3, 2)."""
    corner = tin.nodes[tin.face_nodes[face, 0]]
    rise = ((places - corner[:, None, :2]) * _gradients(tin, face)[:, None]).sum(axis=2)
    heights: Floats = corner[:, None, 2] + rise
    return heights


def _clipped(tin: Tin, polygon: Any) -> _Pieces:
    """Parts of faces within a polygon; whole faces where they lie in it."""
    all_faces = np.arange(tin.n_face)
    if polygon is None:
        return _of_faces(tin, all_faces, all_faces)
    faces = face_polygons(tin)
    shapely.prepare(polygon)
    is_whole = shapely.covers(polygon, faces)
    cut = np.flatnonzero(~is_whole)
    whole, rest = np.flatnonzero(is_whole), _of_parts(tin, shapely.intersection(faces[cut], polygon), cut, cut)
    return _together(_of_faces(tin, whole, whole), rest)


def _shared(store: StoreReader, tin: Tin, other: Tin, polygon: Any, is_finer: bool) -> _Pieces:
    """Parts of faces of two levels that both have, within a polygon."""
    if tin.n_face == 0 or other.n_face == 0:
        return _of_faces(tin, np.empty(0, np.int64), np.empty(0, np.int64))
    fine, coarse = (tin, other) if is_finer else (other, tin)
    own = coarse.face_attributes["face_id"]
    level = int(store.fetch("face", own[:1])["level"][0])
    pairs = related(store, fine.face_attributes["face_id"], level)
    if np.array_equal(pairs.of, np.arange(fine.n_face)):  # nested: each face lies in one
        at = np.minimum(look_up(own, pairs.face_ids)[0], coarse.n_face - 1)  # beyond: one that only touches the polygon
        pieces = _clipped(fine, polygon)
        pieces = pieces._replace(other=at[pieces.face])
    else:
        pieces = _overlaid(fine, coarse, polygon)
    return pieces if is_finer else pieces._replace(face=pieces.other, other=pieces.face)


def _overlaid(fine: Tin, coarse: Tin, polygon: Any) -> _Pieces:
    """Parts that faces of two levels share, found by laying one over the other."""
    faces, others = face_polygons(fine), face_polygons(coarse)
    face, other = shapely.STRtree(others).query(faces, predicate="intersects")
    order = np.lexsort((other, face))
    face, other = face[order], other[order]
    corners, around = fine.nodes[fine.face_nodes[face], :2], coarse.nodes[coarse.face_nodes[other], :2]
    left, right = _sides(around, corners), _sides(corners, around)
    shares = ~np.any((left <= 0.0).all(axis=2) | (right <= 0.0).all(axis=2), axis=1)  # else an edge lies between them
    face, other, left = face[shares], other[shares], left[shares]
    parts, is_cut = faces[face], (left < 0.0).any(axis=(1, 2))
    parts[is_cut] = shapely.intersection(parts[is_cut], others[other[is_cut]])
    if polygon is not None:
        shapely.prepare(polygon)
        cut = ~shapely.covers(polygon, parts)
        parts[cut] = shapely.intersection(parts[cut], polygon)
    return _of_parts(fine, parts, face, other)


def _sides(triangles: Floats, others: Floats) -> Floats:
    """On which side of each edge of triangles each corner of others lies, (n, 3 edges, 3 corners): above 0 to the left."""
    ahead = np.roll(triangles, -1, axis=1) - triangles
    away = others[:, None] - triangles[:, :, None]
    side: Floats = ahead[:, :, None, 0] * away[..., 1] - ahead[:, :, None, 1] * away[..., 0]
    return side


def _of_faces(tin: Tin, face: Indices, other: Indices) -> _Pieces:
    """Whole faces."""
    corners = tin.nodes[tin.face_nodes[face], :2]
    return _Pieces(corners, face, other, _areas(corners))


def _of_parts(tin: Tin, parts: NDArray[np.object_], face: Indices, other: Indices) -> _Pieces:
    """Fans of the rings of parts of faces round the first corner of their faces: holes count with the other sign."""
    pieces, of_part = _parts_of(parts)
    pieces = shapely.normalize(pieces)  # outer rings clockwise, inner ones counter-clockwise
    rings, of_ring = shapely.get_rings(pieces, return_index=True)
    places, of_place = shapely.get_coordinates(rings, return_index=True)
    start = np.flatnonzero(of_place[1:] == of_place[:-1])
    row = of_part[of_ring[of_place[start]]]
    apex = tin.nodes[tin.face_nodes[face[row], 0], :2]
    corners = np.stack([apex, places[start + 1], places[start]], axis=1)  # turned: outer rings count as they are
    return _Pieces(corners, face[row], other[row], _areas(corners))


def _parts_of(geometries: NDArray[np.object_]) -> tuple[NDArray[np.object_], Indices]:
    """Polygons of geometries, collections among them, and the place of each one's geometry."""
    index = np.arange(len(geometries))
    while len(geometries) and (shapely.get_type_id(geometries) > shapely.GeometryType.POLYGON).any():
        geometries, of = shapely.get_parts(geometries, return_index=True)
        index = index[of]
    is_area = shapely.get_type_id(geometries) == shapely.GeometryType.POLYGON
    return geometries[is_area], index[is_area]


def _areas(corners: Floats) -> Floats:
    """Areas of triangles, below 0 for those that are clockwise."""
    (x1, y1), (x2, y2) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
    area: Floats = (x1 * y2 - x2 * y1) / 2.0
    return area


def _together(*pieces: _Pieces) -> _Pieces:
    return _Pieces(*map(np.concatenate, zip(*pieces, strict=True)))
