"""Parts of a level: the faces that touch a rectangle, a polygon or a tile, and their range of heights."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from pyproj import CRS, Transformer

from vpfx.errors import InputError, NotFoundError
from vpfx.geometry import heights_on_faces
from vpfx.model import Tin
from vpfx.store.reader import StoreReader
from vpfx.topology import NONE

__all__ = [
    "ElevationRange",
    "area_of",
    "check_polygon",
    "elevation_range",
    "face_polygons",
    "part_of",
    "region",
    "region_rows",
    "rows_as_dicts",
    "to_degrees",
    "to_geojson",
]

Floats = NDArray[np.float64]
Box = Sequence[float]

AREAS = ("Polygon", "MultiPolygon")
WGS84 = "OGC:CRS84"
"""What RFC 7946 wants: longitude and latitude on WGS 84, degrees."""


class ElevationRange(NamedTuple):
    """The lowest and the highest place of a surface; NaN where there is no ground.

    Attributes
    ----------
    lowest, highest : float64 (3,)
        x and y in CRS units, height in metres; of several the one of least x, then y.
    """

    lowest: Floats
    highest: Floats


def region(
    store: StoreReader, level: int, *, bbox: Box | None = None, polygon: Any = None, tile_id: int | None = None
) -> Tin:
    """Faces of a level that touch a rectangle, touch a polygon, and belong to a tile.

    Parameters
    ----------
    store : StoreReader
    level : int
    bbox : four numbers, optional
        min_x, min_y, max_x, max_y in CRS units.
    polygon : shapely Polygon or MultiPolygon, optional
        In CRS units.
    tile_id : int, optional

    Returns
    -------
    Tin
        With the attributes of `Store.tin`. A face touches if it shares at least a place, borders included.

    Raises
    ------
    InputError
        The rectangle is none; the polygon is none, empty, not finite or not valid.
    NotFoundError
        There is no such level or tile.

    Notes
    -----
    Source: specs/query.md Q-150. What is not given is no condition; all that is given must hold. Reads the tiles that touch
    the bounds. Cost: O(their faces).
    """
    conditions = [geometry for geometry in (_box(bbox), check_polygon(polygon)) if geometry is not None]
    bounds = [geometry.bounds for geometry in conditions]
    if tile_id is not None:
        tiles = store.tiles()
        at = np.flatnonzero(tiles["tile_id"] == tile_id)
        if len(at) == 0:
            raise NotFoundError(f"{store.path}: found no tile {tile_id}")
        bounds.append(tuple(float(tiles[name][at[0]]) for name in ("xmin", "ymin", "xmax", "ymax")))
    around = _common(bounds)
    tin = store.tin(level, around)
    if tin.n_face == 0 or around is None:
        return tin
    faces, touches = face_polygons(tin), np.ones(tin.n_face, bool)
    for geometry in conditions:
        shapely.prepare(geometry)
        touches &= shapely.intersects(geometry, faces)
    if tile_id is not None:
        touches &= tin.face_attributes["tile_id"] == tile_id
    return part_of(tin, touches)


def region_rows(
    store: StoreReader, level: int, *, bbox: Box | None = None, polygon: Any = None, tile_id: int | None = None
) -> dict[str, NDArray[Any]]:
    """Rows of the table `face` for the faces that `region` gives, as of `Store.fetch`.

    Raises
    ------
    InputError, NotFoundError
        As for `region`.
    """
    tin = region(store, level, bbox=bbox, polygon=polygon, tile_id=tile_id)
    return store.fetch("face", tin.face_attributes.get("face_id", []))


def rows_as_dicts(rows: dict[str, NDArray[Any]]) -> list[dict[str, Any]]:
    """Rows of the table `face`, as of `region_rows`, as one dict each, ready for JSON: ids, slope and aspect in degrees."""
    is_level = rows["aspect_centidegrees"] == NONE
    columns = {
        "face": rows["face_id"].tolist(),
        "tile": rows["tile_id"].tolist(),
        "is_filled": rows["is_filled"].astype(bool).tolist(),
        "slope": (rows["slope_centidegrees"] / 100.0).tolist(),
        "aspect": _plain(np.where(is_level, np.nan, rows["aspect_centidegrees"] / 100.0)),
        "nodes": np.stack([rows[f"node_{i}"] for i in (1, 2, 3)], axis=1).tolist(),
        "edges": np.stack([rows[f"edge_{i}"] for i in (1, 2, 3)], axis=1).tolist(),
    }
    return [dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)]


def face_polygons(tin: Tin) -> NDArray[np.object_]:
    """Faces seen from above as shapely polygons, (n_face,).

    Examples
    --------
    >>> face_polygons(Tin(np.array([[0, 0, 5], [1, 0, 5], [0, 1, 6]]), np.array([[0, 1, 2]])))[0].wkt
    'POLYGON ((0 0, 1 0, 0 1, 0 0))'
    """
    polygons: NDArray[np.object_] = shapely.polygons(tin.nodes[:, :2][tin.face_nodes[:, [0, 1, 2, 0]]])
    return polygons


def check_polygon(polygon: Any) -> Any:
    """Return a polygon of two dimensions, or None for None.

    Raises
    ------
    InputError
        It is none, empty, not finite or not valid; the message says why.

    Examples
    --------
    >>> check_polygon(shapely.from_wkt("POLYGON ((0 0, 1 1, 1 0, 0 1, 0 0))"))
    Traceback (most recent call last):
    vpfx.errors.InputError: polygon: found Self-intersection[0.5 0.5], expected a valid polygon
    """
    if polygon is None:
        return None
    kind = getattr(polygon, "geom_type", type(polygon).__name__)
    if kind not in AREAS:
        raise InputError(f"polygon: found a {kind}, expected a Polygon or MultiPolygon")
    if polygon.is_empty:
        raise InputError("polygon: found an empty one, expected some area")
    if not np.isfinite(shapely.get_coordinates(polygon)).all():
        raise InputError("polygon: found a place that is not finite, expected numbers")
    if not shapely.is_valid(polygon):
        raise InputError(f"polygon: found {shapely.is_valid_reason(polygon)}, expected a valid polygon")
    return shapely.force_2d(polygon)


def area_of(bbox: Box | None, polygon: Any) -> Any:
    """What a rectangle and a polygon share, as a shapely geometry; None if neither is given.

    Raises
    ------
    InputError
        As for `region`.

    Examples
    --------
    >>> area_of((0, 0, 2, 2), shapely.box(1, 1, 9, 9)).bounds
    (1.0, 1.0, 2.0, 2.0)
    """
    box, area = _box(bbox), check_polygon(polygon)
    if box is None or area is None:
        return area if box is None else box
    return shapely.intersection(box, area)


def _box(bbox: Box | None) -> Any:
    """Rectangle as a geometry: a line or a point if it has no area."""
    if bbox is None:
        return None
    try:
        x0, y0, x1, y1 = map(float, bbox)
        is_sound = x0 <= x1 and y0 <= y1 and bool(np.isfinite([x0, y0, x1, y1]).all())
    except (TypeError, ValueError):
        is_sound = False
    if not is_sound:
        raise InputError(f"bbox: found {bbox}, expected min_x, min_y, max_x, max_y")
    if x0 == x1 and y0 == y1:
        return shapely.Point(x0, y0)
    return shapely.LineString([(x0, y0), (x1, y1)]) if x0 == x1 or y0 == y1 else shapely.box(x0, y0, x1, y1)


def _common(bounds: list[tuple[float, ...]]) -> tuple[float, ...] | None:
    """Least of some rectangles: what touches all of several touches it, so it is enough to read."""
    return min(bounds, key=lambda box: (box[2] - box[0]) * (box[3] - box[1])) if bounds else None


def part_of(tin: Tin, keep: NDArray[np.bool_]) -> Tin:
    """Some faces of a mesh, with their nodes and attributes.

    Parameters
    ----------
    keep : bool (n_face,)
    """
    used, index = np.unique(tin.face_nodes[keep], return_inverse=True)
    return Tin(
        tin.nodes[used],
        index.reshape(-1, 3).astype(np.int32),
        {name: values[keep] for name, values in tin.face_attributes.items()},
        {name: values[used] for name, values in tin.node_attributes.items()},
        crs=tin.crs,
    )


def to_geojson(tin: Tin) -> dict[str, Any]:
    """Faces as a GeoJSON FeatureCollection (RFC 7946).

    Parameters
    ----------
    tin : Tin
        Faces are features; `face_id` is their id, the other attributes are properties.

    Returns
    -------
    dict
        Ready for `json.dumps`: rings closed and counter-clockwise, longitude and latitude on WGS 84, z in metres. Where the
        CRS is unknown, places stay as they are. NaN and infinity become None.

    Raises
    ------
    InputError
        Nodes cannot be brought to longitude and latitude.

    Examples
    --------
    >>> tin = Tin(np.array([[0, 0, 5], [1, 0, 5], [0, 1, 6]]), np.array([[0, 1, 2]]), {"face_id": np.array([7])})
    >>> feature = to_geojson(tin)["features"][0]
    >>> feature["id"], feature["geometry"]["coordinates"][0][2]
    (7, [0.0, 1.0, 6.0])
    """
    nodes = np.column_stack([*to_degrees(tin.nodes[:, 0], tin.nodes[:, 1], tin.crs), tin.nodes[:, 2]])
    rings = nodes[tin.face_nodes]
    ahead, aside = rings[:, 1, :2] - rings[:, 0, :2], rings[:, 2, :2] - rings[:, 0, :2]
    is_turned = ahead[:, 0] * aside[:, 1] < ahead[:, 1] * aside[:, 0]
    rings[is_turned] = rings[is_turned][:, [0, 2, 1]]
    columns = {name: _plain(values) for name, values in tin.face_attributes.items()}
    ids = columns.pop("face_id", list(range(tin.n_face)))
    features = [
        {
            "type": "Feature", "id": face_id, "properties": dict(zip(columns, values, strict=True)),
            "geometry": {"type": "Polygon", "coordinates": [ring]},
        }
        for face_id, ring, *values in zip(ids, rings[:, [0, 1, 2, 0]].tolist(), *columns.values(), strict=True)
    ]  # fmt: skip
    return {"type": "FeatureCollection", "features": features}


def to_degrees(x: Floats, y: Floats, crs: str) -> tuple[Floats, Floats]:
    """Longitude and latitude on WGS 84 of places; themselves if the CRS is unknown.

    Raises
    ------
    InputError
        There are none.
    """
    if not crs:
        return x, y
    found = Transformer.from_crs(CRS.from_user_input(crs), WGS84, always_xy=True).transform(x, y)
    if not np.isfinite(found).all():
        raise InputError("geojson: found places without longitude and latitude, expected others; leave GeoJSON out")
    return found[0], found[1]


def _plain(values: NDArray[Any]) -> list[Any]:
    """Values of JSON; None for what is no finite number."""
    plain = values.astype(object)
    if values.dtype.kind == "f":
        plain[~np.isfinite(values)] = None
    return list(plain.tolist())


def elevation_range(store: StoreReader, level: int, *, bbox: Box | None = None, polygon: Any = None) -> ElevationRange:
    """Lowest and highest place of the surface of a level within a rectangle and a polygon.

    Parameters
    ----------
    store : StoreReader
    level : int
    bbox, polygon
        As for `region`; what both share if both are given, the whole level if neither is.

    Raises
    ------
    InputError, NotFoundError
        As for `region`.

    Notes
    -----
    Source: specs/query.md Q-151. Faces are flat, so both lie at corners of the faces clipped to the area: exact but for
    rounding. Cost: O(faces of the tiles that touch the bounds), and an intersection for each face across the rim.
    """
    area = area_of(bbox, polygon)
    places = _corners(store, level, area)
    if len(places) == 0:
        return ElevationRange(np.full(3, np.nan), np.full(3, np.nan))
    x, y, z = places.T
    return ElevationRange(places[np.lexsort((y, x, z))[0]], places[np.lexsort((y, x, -z))[0]])


def _corners(store: StoreReader, level: int, area: Any) -> Floats:
    """Corners of the faces clipped to an area, (n, 3)."""
    if area is None:
        return store.tin(level).nodes
    store.check_level(level)
    if area.is_empty:
        return np.empty((0, 3))
    tin = store.tin(level, area.bounds)
    faces = face_polygons(tin)
    shapely.prepare(area)
    is_whole = shapely.covers(area, faces)
    cut = np.flatnonzero(~is_whole & shapely.intersects(area, faces))
    xy, index = shapely.get_coordinates(shapely.intersection(faces[cut], area), return_index=True)
    corner = tin.nodes[tin.face_nodes[cut[index]], 2]
    z = heights_on_faces(tin.nodes, tin.face_nodes, cut[index], xy).clip(corner.min(axis=1), corner.max(axis=1))
    return np.concatenate([tin.nodes[np.unique(tin.face_nodes[is_whole])], np.column_stack([xy, z])])
