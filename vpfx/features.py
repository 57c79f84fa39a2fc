"""Surveyed points, lines and outlines of areas, read by GDAL through pyogrio and brought into the CRS of a DEM or store."""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any, NamedTuple

import numpy as np
import pyogrio
import pyogrio.errors
import shapely
import shapely.errors
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError, ProjError

from vpfx.dem.paths import Source, gdal_name, source_of
from vpfx.dem.reference import split_crs
from vpfx.errors import DemFormatError, FeatureFormatError, InputError
from vpfx.model import Extent

__all__ = ["Areas", "Features", "lines_in_posts", "read_area", "read_areas", "read_features"]

Floats = NDArray[np.float64]
Paths = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]

FORMATS = {"GPKG": b"SQLite format 3\0", "ESRI Shapefile": b"\0\0\x27\x0a", "FlatGeobuf": b"fgb", "GeoJSON": b"{"}
"""GDAL's names of the formats that are read, and how their files begin. They name no other files."""

MARGIN = 0.01
"""Of the DEM's size: so much beyond it lines are read, so that what is cut off later is cut in the DEM's CRS."""

GEOJSON_HEAD = 1 << 16  # bytes in which a CRS is looked for
WANTED_CRS = "expected one; write it into the file, or a .prj beside it"
MOST_VERTICES = 1 << 26
MOST_HEIGHT = 1e5  # metres
LINES = [shapely.GeometryType[kind] for kind in ("POINT", "MULTIPOINT", "LINESTRING", "LINEARRING", "MULTILINESTRING")]
AREAS = [shapely.GeometryType[kind] for kind in ("POLYGON", "MULTIPOLYGON")]


class Features(NamedTuple):
    """Surveyed points, lines and outlines of areas.

    Attributes
    ----------
    lines : tuple of float64 (n, 3)
        x and y in units of the DEM's CRS, z in metres or NaN; a point is a line of one vertex, an outline ends where it began.
    sources : tuple of Source
        The files.
    """

    lines: tuple[Floats, ...]
    sources: tuple[Source, ...]


def read_features(paths: Paths, crs: str, extent: Extent, *, layer: str | None = None, use_z: bool = False) -> Features:
    """Read what lies on a DEM of some vector files.

    Parameters
    ----------
    paths : path or sequence of paths
        Local files of the formats `FORMATS`.
    crs : str
        CRS of the DEM, WKT2.
    extent : Extent
        Of the DEM. Lines may reach a little beyond.
    layer : str, optional
        The layer to read, of files with several.
    use_z : bool
        Whether vertices keep their own z, metres; else heights are left to the DEM.

    Returns
    -------
    Features
        In the order of the files and of their features.

    Raises
    ------
    InputError
        The DEM has no CRS, a path is not local, the file has several layers or not that one, or nothing lies on the DEM.
    NotFoundError
        There is no such file.
    FeatureFormatError
        A file is of no such format, broken, or tells no CRS.

    Examples
    --------
    >>> extent = Extent(-107.68, 36.32, -107.6, 36.4)
    >>> found = read_features("fixtures/features/new_mexico_streams.geojson", "EPSG:4269", extent)
    >>> len(found.lines), found.lines[0].shape[1]
    (6, 3)
    """
    if not crs:
        raise InputError("features: found a DEM without CRS, expected one; give crs")
    names = [os.fspath(paths)] if isinstance(paths, str | os.PathLike) else [os.fspath(path) for path in paths]
    lines: list[Floats] = []
    sources = []
    for name in names:
        found, driver = _read_file(name, _plain_file(name), CRS.from_user_input(crs), extent, layer)
        on_dem = shapely.box(*extent)
        if not any(on_dem.intersects(shapely.linestrings(np.vstack([line, line[-1:]])[:, :2])) for line in found):
            message = f"found no point, line or outline on the DEM, expected some within {tuple(extent)}"
            raise InputError(f"{name}: {message}; leave the file out")
        _check_heights(name, found, use_z)
        lines += found
        sources.append(source_of(name, driver))
    return Features(tuple(lines), tuple(sources))


def _plain_file(name: str) -> str:
    """Full name of a local file that is neither packed nor a directory."""
    with suppress(DemFormatError):
        full = gdal_name(name)
        if not full.startswith("/vsi"):
            return full
    raise FeatureFormatError(name, "", "found a directory, a device or an archive, expected a file; unpack it first")


def _check_heights(name: str, lines: list[Floats], use_z: bool) -> None:
    """Take z away if it is not asked for, and refuse what is no height."""
    for line in lines:
        if not use_z:
            line[:, 2] = np.nan
        wrong = np.abs(line[:, 2]) > MOST_HEIGHT  # never for NaN
        if wrong.any():
            x, y, z = line[wrong][0]
            message = f"found z = {z:g} m, expected at most {MOST_HEIGHT:g} m; mend the file, or leave z out"
            raise FeatureFormatError(name, f"vertex ({x:.10g}, {y:.10g})", message)


class _Layer(NamedTuple):
    """Geometries of a file near a DEM, in its own CRS."""

    geometries: NDArray[Any]
    fields: dict[str, tuple[str, NDArray[Any]]]
    to_dem: Transformer
    near: tuple[float, float, float, float]
    unit: float  # of z, metres
    driver: str


def _read_file(name: str, full: str, crs: CRS, extent: Extent, layer: str | None) -> tuple[list[Floats], str]:
    """Read one file; return its lines, and the format."""
    with _readable(name, "lines or areas"):
        found = _read_layer(name, full, crs, extent, layer, [])
        lines = _to_lines(name, found.geometries, found.to_dem, found.near)
    for line in lines:
        line[:, 2] *= found.unit
    return lines, found.driver


@contextmanager
def _readable(name: str, what: str) -> Iterator[None]:
    """Tell errors of GDAL, GEOS and PROJ as errors of the file."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # GDAL's, of files that can be read all the same
            yield
    except (pyogrio.errors.DataSourceError, pyogrio.errors.DataLayerError, pyogrio.errors.GeometryError,
            pyogrio.errors.FeatureError, shapely.errors.ShapelyError, ProjError, UnicodeDecodeError) as error:  # fmt: skip
        reason = " ".join(str(error).split())
        raise FeatureFormatError(name, "", f"cannot be read as {what}: {reason}") from error


def _read_layer(name: str, full: str, crs: CRS, extent: Extent, layer: str | None, columns: list[str] | None) -> _Layer:
    """Read what is near a DEM of one layer of a file, with some fields, or all."""
    driver = _format_of(name, full)
    if driver == "GeoJSON":
        _check_member(name, full)
    layers = pyogrio.list_layers(full)[:, 0].tolist()
    _check_layer(name, layers, layer)
    information = pyogrio.read_info(full, layer=layer)
    if information["geometry_type"] is None:
        raise FeatureFormatError(name, "", "found a table without geometry, expected points, lines or areas")
    if not information["crs"]:
        raise FeatureFormatError(name, "", f"found no CRS that is known, {WANTED_CRS}")
    horizontal, unit = _split(name, information["crs"])
    kinds = dict(zip(information["fields"].tolist(), map(str, information["dtypes"]), strict=True))
    for column in columns or ():
        if column not in kinds:
            raise InputError(f"{name}: found no field {column!r}, expected some of: {', '.join(kinds)}")
    to_dem = Transformer.from_crs(horizontal, crs, always_xy=True)
    near = _bounds_near(name, to_dem, extent)
    meta, _, geometries, values = pyogrio.raw.read(full, layer=layer, columns=columns, bbox=near)
    fields = {field: (kinds[field], value) for field, value in zip(meta["fields"].tolist(), values, strict=True)}
    return _Layer(shapely.from_wkb(geometries), fields, to_dem, near, unit, driver)


class Areas(NamedTuple):
    """Areas with fields.

    Attributes
    ----------
    polygons : object (n,)
        Polygons and multipolygons of shapely in the CRS asked for, valid, cut off a little beyond the extent.
    fields : dict of str to (str, array (n,))
        GDAL's type of each field, as numpy names it, and its values.
    """

    polygons: NDArray[Any]
    fields: dict[str, tuple[str, NDArray[Any]]]


def read_areas(
    path: str | os.PathLike[str], crs: str, extent: Extent, *, layer: str | None = None, columns: list[str] | None = None
) -> Areas:  # fmt: skip
    """Read the areas of a vector file that lie on an extent, with their fields.

    Parameters
    ----------
    path : path
        A local file of the formats `FORMATS`.
    crs : str
        CRS to bring them into, WKT2.
    extent : Extent
        In that CRS.
    layer : str, optional
        The layer to read, of files with several.
    columns : list of str, optional
        Fields to read; all if left out.

    Raises
    ------
    InputError
        There is no CRS, the path is not local, a layer or field is missing, or no area lies on the extent.
    NotFoundError
        There is no such file.
    FeatureFormatError
        The file is of no such format, broken, tells no CRS, or holds something else than areas.
    """
    name = os.fspath(path)
    if not crs:
        raise InputError(f"{name}: found a store without CRS, expected one: areas cannot be brought into it")
    with _readable(name, "areas"):
        found = _read_layer(name, _plain_file(name), CRS.from_user_input(crs), extent, layer, columns)
        is_there = ~shapely.is_missing(found.geometries)
        if not np.isin(shapely.get_type_id(found.geometries[is_there]), AREAS).all():
            raise FeatureFormatError(name, "geometry", "found points or lines, expected areas")
        cut = shapely.intersection(shapely.make_valid(found.geometries), shapely.box(*found.near))
        polygons = shapely.transform(cut, found.to_dem.transform, interleaved=False)
        polygons = shapely.make_valid(polygons)
        is_there = is_there & shapely.intersects(polygons, shapely.box(*extent))
    if not is_there.any():
        raise InputError(f"{name}: found no area on the store, expected some within {tuple(extent)}")
    return Areas(polygons[is_there], {field: (kind, v[is_there]) for field, (kind, v) in found.fields.items()})


def read_area(path: str | os.PathLike[str], crs: str, extent: Extent, *, layer: str | None = None) -> Any:
    """Read the areas of a vector file that lie on an extent, as one.

    Parameters
    ----------
    path, crs, extent, layer
        As of `read_areas`. Edges are straight in the CRS between the vertices of the file.

    Returns
    -------
    shapely Polygon or MultiPolygon

    Raises
    ------
    InputError, NotFoundError, FeatureFormatError
        As for `read_areas`.
    """
    parts = shapely.get_parts(read_areas(path, crs, extent, layer=layer, columns=[]).polygons)
    return shapely.union_all(parts[np.isin(shapely.get_type_id(parts), AREAS)])


def _split(name: str, crs: str) -> tuple[CRS, float]:
    """Horizontal CRS of a file, and its unit of z in metres; metres if it states none."""
    horizontal, vertical = split_crs(CRS.from_user_input(crs).to_wkt())
    if horizontal is None or (vertical is not None and vertical.is_depth):
        raise FeatureFormatError(
            name, "CRS", "found depths, or no horizontal part, expected places with or without heights"
        )
    return horizontal, vertical.unit.metres if vertical is not None else 1.0


def _format_of(name: str, full: str) -> str:
    """Tell the format of a file by how it begins."""
    try:
        with open(full, "rb") as file:
            head = file.read(64).removeprefix(b"\xef\xbb\xbf").lstrip(b" \t\r\n")
    except OSError as error:
        raise FeatureFormatError(name, "", f"cannot be read: {error.strerror}") from error
    for driver, start in FORMATS.items():
        if head.startswith(start.lstrip(b" \t\r\n")):
            return driver
    raise FeatureFormatError(name, "", f"found another format, or a broken file; expected {', '.join(FORMATS)}")


def _check_member(name: str, full: str) -> None:
    """Refuse a GeoJSON file that names a CRS nobody knows: GDAL takes it for WGS 84."""
    with open(full, "rb") as file:
        head = file.read(GEOJSON_HEAD).decode("utf-8", "replace")
    named = re.search(r'"crs"\s*:\s*\{[^}]*"name"\s*:\s*"([^"]+)"', head)
    try:
        CRS.from_user_input(named[1] if named else "EPSG:4326")
    except CRSError as error:
        raise FeatureFormatError(name, "crs", f"found no CRS that is known, {WANTED_CRS}") from error


def _check_layer(name: str, layers: list[str], layer: str | None) -> None:
    """Refuse a layer that is not there, and a choice that is not made."""
    if layer is None and len(layers) != 1:
        raise InputError(f"{name}: found {len(layers)} layers, expected one; choose of: {', '.join(layers)}")
    if layer is not None and layer not in layers:
        raise InputError(f"{name}: found no layer {layer!r}, expected one of: {', '.join(layers)}")


def _bounds_near(name: str, to_dem: Transformer, extent: Extent) -> tuple[float, float, float, float]:
    """Bounds of the DEM, and a little more, in the CRS of a file."""
    wide, high = MARGIN * (extent.max_x - extent.min_x), MARGIN * (extent.max_y - extent.min_y)
    bounds = extent.min_x - wide, extent.min_y - high, extent.max_x + wide, extent.max_y + high
    near = to_dem.transform_bounds(*bounds, densify_pts=21, direction="INVERSE")
    if np.isfinite(near).all() and near[0] > near[2]:
        message = "found one in which the DEM crosses the antimeridian; bring the file into the CRS of the DEM first"
        raise FeatureFormatError(name, "CRS", message)
    if not np.isfinite(near).all():
        raise FeatureFormatError(
            name, "CRS", "found one that does not reach the DEM, expected another; reproject the file"
        )
    return near


def _to_lines(name: str, geometries: NDArray[Any], to_dem: Transformer, near: tuple[float, ...]) -> list[Floats]:
    """Cut geometries off near the DEM and bring them into its CRS, as vertices in order."""
    kind = shapely.get_type_id(geometries)
    is_area = np.isin(kind, AREAS)
    if not (is_area | np.isin(kind, LINES)).all():
        other = geometries[~(is_area | np.isin(kind, LINES))][0].geom_type
        raise FeatureFormatError(name, "geometry", f"found a {other}, expected points, lines or areas")
    geometries[is_area] = shapely.boundary(geometries[is_area])
    parts = shapely.get_parts(shapely.get_parts(shapely.intersection(geometries, shapely.box(*near))))
    parts = parts[~shapely.is_empty(parts)]
    vertices, part = shapely.get_coordinates(parts, include_z=True, return_index=True)
    if len(vertices) > MOST_VERTICES:
        raise InputError(f"{name}: found {len(vertices)} vertices on the DEM, expected at most {MOST_VERTICES}")
    x, y = to_dem.transform(vertices[:, 0], vertices[:, 1])
    if not (np.isfinite(x) & np.isfinite(y)).all():
        raise FeatureFormatError(
            name, "CRS", "found vertices that cannot be brought into the DEM's; reproject the file"
        )
    places = np.column_stack([x, y, vertices[:, 2]])
    return (
        [np.ascontiguousarray(line) for line in np.split(places, np.flatnonzero(np.diff(part)) + 1)]
        if len(part)
        else []
    )


def lines_in_posts(lines: Sequence[Any], x0: float, y0: float, dx: float, dy: float) -> tuple[Floats, ...]:
    """Turn lines in CRS units into lines in posts of a lattice; lines of two columns get a height of NaN.

    Raises
    ------
    InputError
        A line is no (n, 2 or 3) array of finite places.

    Examples
    --------
    >>> lines_in_posts([[(10, 20), (12, 21)]], 10.0, 20.0, 2.0, 1.0)[0].tolist()
    [[0.0, 0.0, nan], [1.0, 1.0, nan]]
    """
    found = []
    for line in lines:
        vertices = np.asarray(line, np.float64)
        is_plain = vertices.ndim == 2 and vertices.shape[1] in (2, 3) and len(vertices) > 0
        if not is_plain or not np.isfinite(vertices[:, :2]).all() or (np.abs(vertices[:, 2:]) > MOST_HEIGHT).any():
            raise InputError(f"lines: found an array of shape {vertices.shape}, expected (n, 2 or 3) finite numbers")
        z = vertices[:, 2] if vertices.shape[1] == 3 else np.full(len(vertices), np.nan)
        found.append(np.column_stack([(vertices[:, 0] - x0) / dx, (vertices[:, 1] - y0) / dy, z]))
    return tuple(found)
