"""Attributes from a raster of classes, such as land cover."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.enums import Resampling
from rasterio.errors import RasterioError
from rasterio.vrt import WarpedVRT
from rasterio.windows import Window

from vpfx.attach.common import Attached, check_if_there, write_features
from vpfx.dem.paths import gdal, gdal_name
from vpfx.errors import DemFormatError, InputError
from vpfx.query.attributes import added_up
from vpfx.query.location import locate
from vpfx.store.classes import Column, check_name
from vpfx.store.descent import mesh_of
from vpfx.store.edit import recover
from vpfx.store.reader import StoreReader, open_reader

__all__ = ["attach_raster"]

Ids = NDArray[np.int64]
Floats = NDArray[np.float64]

EXACT = 2.0**53  # rasters in another CRS go through doubles
MOST_CELLS = 1 << 22
"""Read at a time."""


def attach_raster(
    path: str | Path, class_name: str, source: str | Path, *, band: int = 1, level: int | None = None,
    column: str = "value", if_there: str = "refuse",
) -> Attached:  # fmt: skip
    """Attach a raster of classes to the faces of a level: each value becomes a feature.

    A face has the value of most of the cells whose centres lie in it, of equally many the least value; a face without such a
    cell has the value of the cell at its centroid. Cells without data do not count.

    Parameters
    ----------
    path : path
        The store.
    class_name : str
        Made if it is not there.
    source : path
        A local raster of whole numbers. In another CRS than the store's it is brought into that one by nearest neighbour.
    band : int
        From 1.
    level : int, optional
        The finest if left out.
    column : str
        Name of the column that keeps the value.
    if_there : str
        What to do if the class is there: ``refuse``, ``append`` or ``replace``.

    Raises
    ------
    InputError
        A name or choice is none, the raster or the store has no CRS, the values are no whole numbers, or none lies on a face.
    NotFoundError, DemFormatError, StoreFormatError, StoreError
        A file is missing, broken or locked.
    """
    check_if_there(if_there)
    check_name(class_name, "class")
    recover(Path(path))
    check_name(column, "column")
    with open_reader(path) as store, gdal():
        number = store.level_or_finest(level)
        try:
            with rasterio.open(gdal_name(os.fspath(source))) as raster:
                _check_raster(str(source), raster, band, store)
                with WarpedVRT(raster, crs=store.crs, resampling=Resampling.nearest) as warped:
                    face_ids, values = _on_faces(store, number, warped, band)
        except RasterioError as error:
            raise DemFormatError(str(source), "", f"cannot be read: {' '.join(str(error).split())}") from error
    if len(face_ids) == 0:
        raise InputError(f"{source}: found no cell with data on level {number}, expected some")
    known, index = np.unique(values, return_inverse=True)
    faces = face_ids, index.astype(np.int64), np.ones(len(face_ids))
    described = {column: Column("integer")}
    return write_features(Path(path), class_name, described, {column: known.tolist()}, faces, if_there)


def _check_raster(name: str, raster: Any, band: int, store: StoreReader) -> None:
    """Refuse what is no raster of classes with a place."""
    if not 1 <= band <= raster.count:
        raise InputError(f"{name}: found no band {band}, expected 1 … {raster.count}")
    if not raster.crs or not store.crs:
        raise InputError(f"{name}: found {'a store' if raster.crs else 'a raster'} without CRS, expected one")
    if np.dtype(raster.dtypes[band - 1]).kind == "c":
        raise InputError(f"{name}: found complex numbers, expected whole ones")


def _on_faces(store: StoreReader, level: int, raster: Any, band: int) -> tuple[Ids, Ids]:
    """Faces that have a value, ascending, and the values."""
    keys, counts = np.empty((2, 0), np.int64), np.empty(0)
    for xy, values in _cells(store, raster, band):
        face = locate(store, xy, level).face_ids
        pairs = np.stack([face, values])[:, face >= 0]
        ones = np.ones(pairs.shape[1])
        keys, counts = added_up(np.concatenate([keys, pairs], axis=1), np.append(counts, ones))
    row = np.lexsort((keys[1], -counts, keys[0]))
    face_ids, first = np.unique(keys[0][row], return_index=True)
    value = keys[1][row][first]
    rest, at_centroid = _at_centroids(store, level, raster, band, face_ids)
    return np.concatenate([face_ids, rest]), np.concatenate([value, at_centroid])


def _cells(store: StoreReader, raster: Any, band: int) -> Any:
    """Centres of cells with data, and their values, a piece of a tile at a time; a cell on a border comes once."""
    tiles, extent, place = store.tiles(), store.extent, raster.transform
    for xmin, ymin, xmax, ymax in zip(*(tiles[name] for name in ("xmin", "ymin", "xmax", "ymax")), strict=True):
        west, east = _range(xmin, xmax, xmax == extent.max_x, place.c, place.a, raster.width)
        south, north = _range(-ymax, -ymin, ymin == extent.min_y, -place.f, -place.e, raster.height)
        step = max(1, MOST_CELLS // max(east - west, 1))
        for row in range(south, north, step):
            window = Window(west, row, east - west, min(step, north - row))
            if window.width <= 0:
                continue
            values = raster.read(band, window=window, masked=True)
            line, column = np.nonzero(~np.ma.getmaskarray(values))
            x, y = place.c + place.a * (west + column + 0.5), place.f + place.e * (row + line + 0.5)
            yield np.column_stack([x, y]), _whole(values.data[line, column])


def _range(low: float, high: float, is_last: bool, start: float, step: float, n: int) -> tuple[int, int]:
    """First cell whose centre is not below low, and first one that is not below high, or above it at the last tile."""
    first = np.ceil((low - start) / step - 0.5)
    end = np.floor((high - start) / step - 0.5) + 1 if is_last else np.ceil((high - start) / step - 0.5)
    return int(np.clip(first, 0, n)), int(np.clip(end, 0, n))


def _at_centroids(store: StoreReader, level: int, raster: Any, band: int, known: Ids) -> tuple[Ids, Ids]:
    """Faces that hold no centre of a cell, and the values of the cells at their centroids, where these have data."""
    found: list[tuple[Ids, Ids]] = [(np.empty(0, np.int64), np.empty(0, np.int64))]
    for tile_id in store.tiles()["tile_id"].tolist():
        faces = store.tile_faces(level, tile_id)
        rest = ~np.isin(faces["face_id"], known)
        if not rest.any():
            continue
        faces = {name: values[rest] for name, values in faces.items()}
        mesh = mesh_of(store, faces)
        xy = mesh.xyz[mesh.face_nodes, :2].mean(axis=1)
        column = np.floor((xy[:, 0] - raster.transform.c) / raster.transform.a).astype(np.int64)
        row = np.floor((xy[:, 1] - raster.transform.f) / raster.transform.e).astype(np.int64)
        is_on = (column >= 0) & (column < raster.width) & (row >= 0) & (row < raster.height)
        if not is_on.any():
            continue
        column, row = column[is_on], row[is_on]
        corner = column.min(), row.min()
        window = Window(*map(int, (*corner, np.ptp(column) + 1, np.ptp(row) + 1)))
        values = raster.read(band, window=window, masked=True)[row - corner[1], column - corner[0]]
        has_data = ~np.ma.getmaskarray(values)
        found.append((faces["face_id"][is_on][has_data], _whole(values.data[has_data])))
    face_ids, value = (np.concatenate(columns) for columns in zip(*found, strict=True))
    return face_ids, value


def _whole(values: NDArray[Any]) -> Ids:
    """Values as whole numbers."""
    wrong = (values != np.floor(values)) | (np.abs(values.astype(np.float64)) >= EXACT)
    if wrong.any():
        raise InputError(f"raster: found {values[wrong][0]:g}, expected classes: whole numbers below 2^53")
    whole: Ids = values.astype(np.int64)
    return whole
