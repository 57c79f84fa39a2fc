"""Surveyed points, lines and outlines of areas, of vector files (by pyogrio) or VPF, brought into the CRS of a DEM or store."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any, NamedTuple
from warnings import warn

import numpy as np
import shapely
from numpy.typing import NDArray
from pyproj import CRS, Transformer

from vpfx.dem.paths import Source
from vpfx.errors import FeatureFormatError, InputError, VpfxWarning
from vpfx.features.layers import FORMATS, Layer, plain_file, read_layer, readable, source_of_layer
from vpfx.model import Extent

__all__ = ["FORMATS", "Areas", "Features", "lines_in_posts", "read_area", "read_areas", "read_features"]

Floats = NDArray[np.float64]
Paths = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]

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
        Local files of the formats `FORMATS`, and directories of VPF.
    crs : str
        CRS of the DEM, WKT2.
    extent : Extent
        Of the DEM. Lines may reach a little beyond.
    layer : str, optional
        The layer to read, of files with several; of VPF ``coverage/class``.
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
        found, source = _read_file(name, plain_file(name), CRS.from_user_input(crs), extent, layer)
        on_dem = shapely.box(*extent)
        if not any(on_dem.intersects(shapely.linestrings(np.vstack([line, line[-1:]])[:, :2])) for line in found):
            message = f"found no point, line or outline on the DEM, expected some within {tuple(extent)}"
            raise InputError(f"{name}: {message}; leave the file out")
        _check_heights(name, found, use_z)
        lines += found
        sources.append(source)
    return Features(tuple(lines), tuple(sources))


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


def _read_file(name: str, full: str, crs: CRS, extent: Extent, layer: str | None) -> tuple[list[Floats], Source]:
    """Read one file; return its lines, and what they come from."""
    with readable(name, "lines or areas"):
        found = read_layer(name, full, crs, extent, layer, [])
        lines = _to_lines(name, found.geometries, found.to_dem, found.near)
    for line in lines:
        line[:, 2] *= found.unit
    _tell(found)
    return lines, source_of_layer(name, full, layer, found.driver)


def _tell(found: Layer) -> None:
    """Warn of what could not be read."""
    for problem in found.problems:
        warn(problem, VpfxWarning, stacklevel=3)


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
    with readable(name, "areas"):
        found = read_layer(name, plain_file(name), CRS.from_user_input(crs), extent, layer, columns)
        is_there = ~shapely.is_missing(found.geometries)
        if not np.isin(shapely.get_type_id(found.geometries[is_there]), AREAS).all():
            raise FeatureFormatError(name, "geometry", "found points or lines, expected areas")
        cut = shapely.intersection(shapely.make_valid(found.geometries), shapely.box(*found.near))
        polygons = shapely.transform(cut, found.to_dem.transform, interleaved=False)
        polygons = shapely.make_valid(polygons)
        is_there = is_there & shapely.intersects(polygons, shapely.box(*extent))
    _tell(found)
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
