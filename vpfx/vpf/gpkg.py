"""Feature classes of VPF as layers of a GeoPackage.

Source: specs/vpf.md, V-440 to V-442.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyogrio
import pyogrio.errors
import shapely
from numpy.typing import NDArray
from pyproj import CRS
from pyproj.exceptions import CRSError

from vpfx.errors import InputError, NotFoundError, StoreError, VpfxError
from vpfx.vpf.catalog import Coverage
from vpfx.vpf.fields import free_name
from vpfx.vpf.layers import crs_of
from vpfx.vpf.layouts import PRIMITIVES
from vpfx.vpf.opening import feature_classes, open_coverages
from vpfx.vpf.reader import FeatureRows, has_faces, read_class, read_primitives, tiles_of

__all__ = ["LayerSummary", "Written", "write_gpkg"]

FAMILIES = (
    (0, 4, "Point", shapely.multipoints), (1, 5, "LineString", shapely.multilinestrings),
    (3, 6, "Polygon", shapely.multipolygons),
)  # fmt: skip
"""Numbers that shapely has for single and multiple geometries, the name, and how one becomes multiple."""

OF_KIND = {"P": "Point", "L": "LineString", "A": "Polygon", "T": "Point"}
GDAL_OPTIONS = {
    "OGR_CURRENT_DATE": "1970-01-01T00:00:00.000Z",  # of last change: the same input gives the same bytes
    "OGR_SQLITE_SYNCHRONOUS": "OFF",  # the file has its name only when it is on the disk
}
TAKEN = ("gpkg_", "rtree_", "sqlite_")  # beginnings of names that GeoPackage and SQLite keep for themselves


class LayerSummary(NamedTuple):
    """A layer that was written."""

    layer: str
    geometry: str
    features: int
    without_geometry: int


class Written(NamedTuple):
    """What was written, and what could not be read."""

    layers: tuple[LayerSummary, ...]
    problems: tuple[str, ...]


def write_gpkg(
    path: Path | str, output: Path | str, *, coverages: Sequence[str] = (), primitives: bool = False,
    crs: str | None = None,
) -> Written:  # fmt: skip
    """Write the feature classes of a directory of VPF into a new GeoPackage, a layer each.

    Parameters
    ----------
    path : path
        A database, a library or a coverage.
    output : path
        Replaced, once the new one is complete.
    coverages : sequence of str
        Only these; all if empty.
    primitives : bool
        Whether edges, faces, nodes and texts are written as layers too.
    crs : str, optional
        Instead of what ``grt`` tells.

    Returns
    -------
    Written
        Classes and tiles that are not there, or broken, are left out and stand in `problems`.

    Raises
    ------
    InputError
        There is no such coverage, or no such CRS.
    NotFoundError
        Nothing is there that could be written.
    VpfFormatError
        A table of libraries or coverages is broken.
    StoreError
        The file cannot be written.
    """
    opened = open_coverages(path)
    _check_crs(crs)
    chosen = _chosen(opened.coverages, coverages)
    problems, layers, said = list(opened.problems), [], set()
    output = Path(output)
    with _whole(output) as under_way, _quiet():
        for name, coverage, kind, read in _layers(chosen, primitives, problems):
            try:
                own_crs, line = (crs, "") if crs is not None else crs_of(coverage)
                said.add(f"{line}; --crs tells another" if line else "")
                rows = read()
            except VpfxError as error:
                problems.append(f"{error}; layer {name} is left out")
                continue
            problems += rows.problems
            layers.append(_write_layer(under_way, name, rows, kind, own_crs))
        if not layers:
            hint = "" if primitives else "; --primitives writes edges, faces and nodes"
            raise NotFoundError(" ".join([f"{path}: found no feature class that can be read{hint}.", *problems[:1]]))
    return Written(tuple(layers), tuple(dict.fromkeys([*sorted(said - {""}), *problems])))


def _check_crs(crs: str | None) -> None:
    """Refuse a CRS that nobody knows."""
    try:
        if crs is not None:
            CRS.from_user_input(crs)
    except CRSError as error:
        raise InputError(f"crs: found {crs!r}, expected one that PROJ knows, such as EPSG:4326") from error


def _chosen(coverages: Sequence[Coverage], names: Sequence[str]) -> list[Coverage]:
    """Coverages of some names, in their order; all if there are none."""
    known = {coverage.name.lower() for coverage in coverages}
    for name in names:
        if name.lower() not in known:
            raise InputError(f"coverage: found {name!r}, expected one of: {', '.join(sorted(known))}")
    wanted = {name.lower() for name in names} or known
    return [coverage for coverage in coverages if coverage.name.lower() in wanted]


def _layers(
    coverages: Sequence[Coverage], primitives: bool, problems: list[str]
) -> Iterator[tuple[str, Coverage, str, Callable[[], FeatureRows]]]:
    """Name, coverage and kind of each layer, and how it is read."""
    taken: set[str] = set()
    has_several = len({coverage.library.path for coverage in coverages}) > 1
    for coverage in coverages:
        start = f"{coverage.library.name}_{coverage.name}" if has_several else coverage.name
        try:
            classes, told = feature_classes(coverage)
        except VpfxError as error:
            classes, told = {}, (str(error),)
        problems += told
        for key, found in classes.items():
            kind = PRIMITIVES.get(found.primitive, "C")  # whatever fca says
            yield _free(f"{start}_{key}", taken), coverage, kind, partial(read_class, coverage, found)
        for primitive in _primitives(coverage, problems) if primitives else ():
            name = _free(f"{start}_{primitive}", taken)
            yield name, coverage, PRIMITIVES[primitive], partial(read_primitives, coverage, primitive)


def _primitives(coverage: Coverage, problems: list[str]) -> list[str]:
    """Kinds of primitives that a coverage has somewhere."""
    try:
        kinds = [name for name in PRIMITIVES if tiles_of(coverage, name)]
        return [name for name in kinds if name != "fac" or has_faces(coverage)]
    except VpfxError as error:
        problems.append(str(error))
        return []


def _free(name: str, taken: set[str]) -> str:
    """Name of a layer that is not taken yet, in lower case."""
    name = name.lower().replace(":", "_")
    name = f"vpf_{name}" if name.startswith(TAKEN) else name
    number, found = 1, name
    while found in taken:
        number += 1
        found = f"{name}_{number}"
    taken.add(found)
    return found


@contextmanager
def _whole(output: Path) -> Iterator[Path]:
    """Give a name to write under, and the file its own name when it is whole."""
    under_way = output.with_name(f".{output.stem}.{os.getpid()}.tmp.gpkg")
    try:
        yield under_way
        with open(under_way, "rb") as file:
            os.fsync(file.fileno())
        under_way.replace(output)
    except (OSError, pyogrio.errors.DataSourceError, pyogrio.errors.DataLayerError, pyogrio.errors.FeatureError,
            pyogrio.errors.FieldError, pyogrio.errors.GeometryError) as error:  # fmt: skip
        raise StoreError(f"{output}: cannot be written: {' '.join(str(error).split())}") from error
    finally:
        for suffix in ("", "-journal", "-wal", "-shm"):
            with suppress(OSError):
                Path(f"{under_way}{suffix}").unlink()


@contextmanager
def _quiet() -> Iterator[None]:
    """Let GDAL write one date, wait for the disk at the end only, and say nothing of layers without CRS."""
    before = {name: pyogrio.get_gdal_config_option(name) for name in GDAL_OPTIONS}
    pyogrio.set_gdal_config_options(GDAL_OPTIONS)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        pyogrio.set_gdal_config_options(before)


def _write_layer(path: Path, name: str, rows: FeatureRows, kind: str, crs: str | None) -> LayerSummary:
    """Add a layer to a GeoPackage."""
    geometry, geometry_type = _one_type(rows.geometry, kind)
    fields = list(rows.fields)
    taken = set(fields)
    options = {"FID": free_name("fid", taken), "GEOMETRY_NAME": free_name("geom", taken)}
    pyogrio.raw.write(
        str(path), None if kind == "C" else shapely.to_wkb(geometry),
        [rows.fields[field].values for field in fields], np.array(fields, object),
        field_mask=[rows.fields[field].is_null for field in fields], layer=name, driver="GPKG",
        geometry_type=geometry_type, crs=crs, layer_options=options,
    )  # fmt: skip
    n_lost = int(shapely.is_missing(geometry).sum()) if kind != "C" else 0
    return LayerSummary(name, geometry_type or "none", len(geometry), n_lost)


def _one_type(geometry: NDArray[np.object_], kind: str) -> tuple[NDArray[np.object_], str | None]:
    """Geometries with single ones made multiple where a layer has both, and the type of the layer."""
    if kind == "C":
        return geometry, None
    types = shapely.get_type_id(geometry)
    is_there = types >= 0
    name = ""
    for single, multi, title, make in FAMILIES:
        if np.isin(types[is_there], (single, multi)).all() and (is_there.any() or title == OF_KIND[kind]):
            name, alone = title, types == single
            if (types == multi).any():
                name, geometry = f"Multi{title}", geometry.copy()
                geometry[alone] = make(geometry[alone], indices=np.arange(alone.sum()))
    has_z = shapely.has_z(geometry[is_there])
    return geometry, (f"{name} Z" if has_z.any() and has_z.all() else name) if name else "Unknown"
