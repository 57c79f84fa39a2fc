"""Attributes from areas: soils, parcels, land cover drawn as polygons."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from vpfx.attach.common import Attached, check_if_there, write_features
from vpfx.errors import InputError
from vpfx.features import read_areas
from vpfx.store.classes import Column, check_name
from vpfx.store.descent import mesh_of
from vpfx.store.edit import recover
from vpfx.store.reader import StoreReader, open_reader

__all__ = ["attach_areas"]

Ids = NDArray[np.int64]
Floats = NDArray[np.float64]

WAYS = ("centroid", "majority", "share")
EXACT = 2**53  # from here on reals do not have every whole number
LEAST_SHARE = 1e-9
"""Of a face: areas that share less only touch it."""


def attach_areas(
    path: str | Path, class_name: str, source: str | Path, *, by: str = "centroid", level: int | None = None,
    columns: Sequence[str] | None = None, layer: str | None = None, if_there: str = "refuse",
) -> Attached:  # fmt: skip
    """Attach the areas of a vector file to the faces of a level: each area that has a face becomes a feature.

    Parameters
    ----------
    path : path
        The store.
    class_name : str
        Made if it is not there.
    source : path
        A local file of areas, in any CRS.
    by : str
        ``centroid``: a face has the area in which its centroid lies, of several the first. ``majority``: the one that covers
        most of it, if that is more than what none covers. ``share``: all that cover some, by their shares of its area;
        where they overlap and add up to more than 1, scaled down to 1.
    level : int, optional
        The finest if left out.
    columns : sequence of str, optional
        Fields to keep as columns, ``FIELD`` or ``name=FIELD``; all if left out. Names become small letters.
    layer : str, optional
        Of a file with several.
    if_there : str
        What to do if the class is there: ``refuse``, ``append`` or ``replace``.

    Returns
    -------
    found : Attached

    Raises
    ------
    InputError
        A name or choice is none, or no area lies on a face.
    NotFoundError, FeatureFormatError, StoreFormatError, StoreError
        A file is missing, broken or locked.

    Notes
    -----
    Sides of areas are straight between their corners as brought into the store's CRS. Cost: the faces of the level, and the
    corners of the areas that lie on each tile.
    """
    if by not in WAYS:
        raise InputError(f"by: found {by!r}, expected one of: {', '.join(WAYS)}")
    check_if_there(if_there)
    check_name(class_name, "class")
    recover(Path(path))
    named = _distinct([_named(text) for text in columns or ()])
    with open_reader(path) as store:
        number = store.level_or_finest(level)
        areas = read_areas(source, store.crs, store.extent, layer=layer, columns=list(named.values()) or None)
        faces = _on_faces(store, number, areas.polygons, by)
    fields = named or _distinct([(re.sub(r"\W", "_", f.lower(), flags=re.ASCII), f) for f in areas.fields])
    described = {name: Column(_kind_of(areas.fields[field][0])) for name, field in fields.items()}
    values = {name: _values_of(field, *areas.fields[field]) for name, field in fields.items()}
    if len(faces[0]) == 0:
        raise InputError(f"{source}: found no area that a face of level {number} has {by}, expected some")
    if not described:
        raise InputError(f"{source}: found no field, expected one at least")
    return write_features(Path(path), class_name, described, values, faces, if_there)


def _named(text: str) -> tuple[str, str]:
    """Name of a column and field it comes from."""
    name, equals, field = text.partition("=")
    return (name, field) if equals else (text.lower(), text)


def _distinct(pairs: list[tuple[str, str]]) -> dict[str, str]:
    """Columns and their fields; refuse two of one name."""
    found: dict[str, str] = {}
    for name, field in pairs:
        if name in found:
            raise InputError(f"columns: found fields {found[name]!r} and {field!r} for column {name}; give name=FIELD")
        found[name] = field
    return found


def _kind_of(dtype: str) -> str:
    """Kind of the column for a type of GDAL."""
    if dtype == "datetime64[D]":
        return "date"
    return {"i": "integer", "u": "integer", "b": "integer", "f": "real"}.get(dtype[0], "text")


def _values_of(name: str, dtype: str, values: NDArray[Any]) -> list[Any]:
    """Values of a field; NULL is None, a point in time its text, a list JSON.

    Raises
    ------
    InputError
        Whole numbers come as reals, beside NULL, and are too large to be sure of.
    """
    kind = _kind_of(dtype)
    is_time = values.dtype.kind == "M" and dtype != "datetime64[D]"
    if is_time or (values.dtype.kind == "O" and kind == "text"):
        return [_text_of(value) for value in values]
    if values.dtype.kind == "M":
        values = values.astype("datetime64[D]")
    if kind == "integer" and values.dtype.kind == "f" and (np.abs(values) >= EXACT).any():
        raise InputError(f"field {name}: found whole numbers beyond 2^53 beside NULL, expected smaller ones or no NULL")
    return list(values.tolist())


def _text_of(value: Any) -> str | None:
    """Text of a value; None for NULL."""
    if isinstance(value, list | tuple | np.ndarray):
        return json.dumps(np.asarray(value, object).tolist(), default=str)
    return None if value is None or value != value else str(value)


def _on_faces(store: StoreReader, level: int, polygons: NDArray[Any], by: str) -> tuple[Ids, Ids, Floats]:
    """Faces, indices of polygons and shares."""
    parts = [(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0))]
    tree = shapely.STRtree(polygons)
    tiles = store.tiles()
    boxes = shapely.box(*(tiles[name] for name in ("xmin", "ymin", "xmax", "ymax")))
    for tile_id, box in zip(tiles["tile_id"].tolist(), boxes, strict=True):
        faces = store.tile_faces(level, tile_id)
        some = np.sort(tree.query(box))
        if len(some) == 0 or len(faces["face_id"]) == 0:
            continue
        mesh = mesh_of(store, faces)
        corners = mesh.xyz[mesh.face_nodes, :2]
        if by == "centroid":
            face, polygon, share = _by_centroid(corners, polygons[some])
        else:
            cut = shapely.intersection(polygons[some], shapely.buffer(box, shapely.length(box)))
            face, polygon, share = _by_area(corners, cut, by)
        parts.append((faces["face_id"][face], some[polygon], share))
    found, polygon, share = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return found, polygon, share


def _by_centroid(corners: Floats, polygons: NDArray[Any]) -> tuple[Ids, Ids, Floats]:
    """Give each face the first polygon that its centroid lies in or on."""
    face, polygon = shapely.STRtree(polygons).query(shapely.points(corners.mean(axis=1)), predicate="intersects")
    face, polygon = _first_of(face, polygon, polygon)
    return face, polygon, np.ones(len(face))


def _by_area(corners: Floats, polygons: NDArray[Any], by: str) -> tuple[Ids, Ids, Floats]:
    """Give each face the polygons that cover some of it, or the one that covers most."""
    triangles = shapely.polygons(corners)
    shapely.prepare(polygons)
    face, polygon = shapely.STRtree(polygons).query(triangles)
    share = np.ones(len(face))
    is_part = ~shapely.covers(polygons[polygon], triangles[face])
    common = shapely.area(shapely.intersection(polygons[polygon[is_part]], triangles[face[is_part]]))
    share[is_part] = common / shapely.area(triangles)[face[is_part]]
    is_some = share > LEAST_SHARE
    face, polygon, share = face[is_some], polygon[is_some], share[is_some]
    covered = np.bincount(face, share, len(triangles))[face]
    if by == "share":
        return face, polygon, share / np.maximum(covered, 1.0)
    free = 1.0 - covered
    for one in np.unique(face[(share >= free) & (share < 0.5)]):  # areas may overlap: what none covers may be more
        some = polygon[face == one]
        union = shapely.area(shapely.intersection(shapely.union_all(polygons[some]), triangles[one]))
        free[face == one] = 1.0 - union / shapely.area(triangles[one])
    is_most = share >= free
    face, polygon = _first_of(face[is_most], polygon[is_most], -share[is_most])
    return face, polygon, np.ones(len(face))


def _first_of(face: Ids, polygon: Ids, order: NDArray[Any]) -> tuple[Ids, Ids]:
    """Keep the pair that comes first of each face; of equals the one of the polygon that stands first."""
    row = np.lexsort((polygon, order, face))
    known, first = np.unique(face[row], return_index=True)
    return known, polygon[row][first]
