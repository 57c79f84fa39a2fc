"""Layers of vector files, read by GDAL through pyogrio, and of directories of VPF."""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Iterator
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
from vpfx.vpf import layers as vpf_layers
from vpfx.vpf.opening import is_vpf

__all__ = ["FORMATS", "VPF", "Layer", "plain_file", "read_layer", "readable", "source_of_layer"]

FORMATS = {"GPKG": b"SQLite format 3\0", "ESRI Shapefile": b"\0\0\x27\x0a", "FlatGeobuf": b"fgb", "GeoJSON": b"{"}
"""GDAL's names of the formats that are read, and how their files begin. They name no other files."""

VPF = "VPF"
"""The format of a directory."""

MARGIN = 0.01
"""Of the DEM's size: so much beyond it lines are read, so that what is cut off later is cut in the DEM's CRS."""

GEOJSON_HEAD = 1 << 16  # bytes in which a CRS is looked for
WANTED_CRS = "expected one; write it into the file, or a .prj beside it"


class Layer(NamedTuple):
    """Geometries of a file near a DEM, in its own CRS."""

    geometries: NDArray[Any]
    fields: dict[str, tuple[str, NDArray[Any]]]
    to_dem: Transformer
    near: tuple[float, float, float, float]
    unit: float  # of z, metres
    driver: str
    problems: tuple[str, ...] = ()


def plain_file(name: str) -> str:
    """Full name of a local file that is not packed, or of a directory of VPF.

    Raises
    ------
    InputError, NotFoundError
        As `vpfx.dem.paths.gdal_name`.
    FeatureFormatError
        It is another directory, a device or an archive.
    """
    if os.path.isdir(name):
        if is_vpf(name):
            return os.path.abspath(name)
        raise FeatureFormatError(name, "", "found a directory without tables of VPF, expected VPF or a file")
    with suppress(DemFormatError):
        full = gdal_name(name)
        if not full.startswith("/vsi"):
            return full
    raise FeatureFormatError(name, "", "found a device or an archive, expected a file; unpack it first")


def read_layer(name: str, full: str, crs: CRS, extent: Extent, layer: str | None, columns: list[str] | None) -> Layer:
    """Read what is near a DEM of one layer of a file, with some fields, or all.

    Parameters
    ----------
    name, full : str
        The file as the user calls it, and as `plain_file` does.
    crs : CRS
        Of the DEM.
    extent : Extent
        Of the DEM.
    layer : str or None
        None for the only one; of VPF ``coverage/class``.
    columns : list of str or None
        Fields; None for all.

    Raises
    ------
    InputError
        The file has several layers or not that one, or lacks a field.
    FeatureFormatError
        It is of no such format, broken, or tells no CRS.
    """
    if os.path.isdir(full):
        return _read_vpf(name, full, crs, extent, layer, columns)
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
    _check_columns(name, columns, list(kinds))
    to_dem = Transformer.from_crs(horizontal, crs, always_xy=True)
    near = _bounds_near(name, to_dem, extent)
    meta, _, geometries, values = pyogrio.raw.read(full, layer=layer, columns=columns, bbox=near)
    fields = {field: (kinds[field], value) for field, value in zip(meta["fields"].tolist(), values, strict=True)}
    return Layer(shapely.from_wkb(geometries), fields, to_dem, near, unit, driver)


@contextmanager
def readable(name: str, what: str) -> Iterator[None]:
    """Tell errors of GDAL, GEOS and PROJ as errors of the file."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # GDAL's, of files that can be read all the same
            yield
    except (pyogrio.errors.DataSourceError, pyogrio.errors.DataLayerError, pyogrio.errors.GeometryError,
            pyogrio.errors.FeatureError, shapely.errors.ShapelyError, ProjError, UnicodeDecodeError) as error:  # fmt: skip
        reason = " ".join(str(error).split())
        raise FeatureFormatError(name, "", f"cannot be read as {what}: {reason}") from error


def _read_vpf(name: str, full: str, crs: CRS, extent: Extent, layer: str | None, columns: list[str] | None) -> Layer:
    """As `read_layer`, of a directory of VPF."""
    names = vpf_layers.layer_names(full)
    layer = None if layer is None else layer.lower()
    _check_layer(name, names, layer)
    found = vpf_layers.read_layer(full, layer or names[0])
    if found.crs is None:
        raise FeatureFormatError(name, "grt", "found no CRS that is known, expected GEO; convert it, with a CRS, first")
    to_dem = Transformer.from_crs(CRS.from_user_input(found.crs), crs, always_xy=True)
    near = _bounds_near(name, to_dem, extent)
    is_near = shapely.intersects(found.geometry, shapely.box(*near))
    _check_columns(name, columns, list(found.fields))
    fields = {}
    for field in found.fields if columns is None else columns:
        values, is_null = found.fields[field]
        gone = np.where(is_null, np.nan, values) if values.dtype != object and is_null.any() else values
        fields[field] = (str(values.dtype), gone[is_near])
    return Layer(found.geometry[is_near], fields, to_dem, near, 1.0, VPF, found.problems)


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
        if head.startswith(start):
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


def source_of_layer(name: str, full: str, layer: str | None, driver: str) -> Source:
    """What features were read from: a file, or the tables of VPF that make the layer.

    Raises
    ------
    DemFormatError, VpfFormatError
        A file cannot be read.
    """
    if driver != VPF:
        return source_of(name, driver)
    return Source(name, *vpf_layers.layer_source(full, layer or vpf_layers.layer_names(full)[0]), VPF)


def _check_columns(name: str, columns: list[str] | None, known: list[str]) -> None:
    """Refuse fields that are not there."""
    for column in columns or ():
        if column not in known:
            raise InputError(f"{name}: found no field {column!r}, expected some of: {', '.join(known)}")


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
