"""Rules V11x: the store as a GeoPackage (R-200 to R-212)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from vpfx.store.ddl import layer_names, layers_sql
from vpfx.store.geopackage import (
    APPLICATION_ID,
    ATTRIBUTE_TABLES,
    DEFINITION,
    EXTENSION,
    LAST_CHANGE,
    OTHER_TABLES,
    USER_VERSION,
)
from vpfx.validate.report import ERROR, WARNING, Defects, Rule, one
from vpfx.validate.store_data import StoreData
from vpfx.validate.values import objects_made_by

__all__ = ["RULES"]

IDENTITY = ((60, "user version", USER_VERSION), (68, "application id", APPLICATION_ID))
SYSTEMS = {-1: ("NONE", -1), 0: ("NONE", 0), 4326: ("EPSG", 4326)}
"""Organization and number of the reference systems that every GeoPackage has."""


def check_identity(data: StoreData) -> Iterator[Defects]:
    """The header says that the file is a GeoPackage, and of which version."""
    for offset, name, expected in IDENTITY:
        found = int.from_bytes(data.head[offset : offset + 4], "big")
        if found != expected:
            yield one(f"byte={offset}", f"{name}: found {found:#x}, expected {expected:#x}")


def check_systems(data: StoreData) -> Iterator[Defects]:
    """The reference systems of the norm and that of the store are there."""
    query = "SELECT srs_id, organization, organization_coordsys_id, definition FROM gpkg_spatial_ref_sys"
    rows = {row[0]: row[1:] for row in data.select(query)}
    srs_id, _, organization, number, _ = data.srs
    for wanted, expected in {**SYSTEMS, srs_id: (organization, number)}.items():
        where = f"table=gpkg_spatial_ref_sys srs={wanted}"
        found = rows.get(wanted)
        if found is None:
            yield one(where, "found no row, expected one")
        elif found[:2] != expected or not (isinstance(found[2], str) and found[2]):
            yield one(where, f"found {found[0]!r} {found[1]!r} and its definition, expected {expected} and one")


def _layers(data: StoreData) -> dict[str, str]:
    """Names of all layers, and their types of geometry."""
    return {name: kind for row in data.level_rows for name, kind in layer_names(row.level).items()}


def check_contents(data: StoreData) -> Iterator[Defects]:
    """Layers and tables are listed."""
    rows = _rows_of(data, "gpkg_contents", "data_type, srs_id, min_x, min_y, max_x, max_y")
    expected: dict[str, tuple[Any, ...]] = dict.fromkeys(_layers(data), ("features", data.srs[0], *data.extent))
    names = [*ATTRIBUTE_TABLES, *(found.name for found in data.classes if not found.table_problem)]
    expected.update(dict.fromkeys(names, ("attributes", None, None, None, None, None)))
    yield from _compare("gpkg_contents", rows, expected)


def check_geometry_columns(data: StoreData) -> Iterator[Defects]:
    """Layers have a geometry with z."""
    rows = _rows_of(data, "gpkg_geometry_columns", "column_name, geometry_type_name, srs_id, z, m")
    srs_id = data.srs[0]
    yield from _compare(
        "gpkg_geometry_columns", rows, {name: ("geom", kind, srs_id, 1, 0) for name, kind in _layers(data).items()}
    )


def check_extensions(data: StoreData) -> Iterator[Defects]:
    """The tables beyond the norm are said to be such."""
    rows = _rows_of(data, "gpkg_extensions", "column_name, extension_name, definition, scope")
    names = [*ATTRIBUTE_TABLES, *OTHER_TABLES, *(found.name for found in data.classes if not found.table_problem)]
    yield from _compare("gpkg_extensions", rows, dict.fromkeys(names, (None, EXTENSION, DEFINITION, "write-only")))


def _rows_of(data: StoreData, table: str, columns: str) -> dict[Any, tuple[Any, ...]]:
    """Rows of a table of GeoPackage by the table they are about."""
    return {row[0]: row[1:] for row in data.select(f"SELECT table_name, {columns} FROM {table}")}


def _compare(table: str, rows: dict[Any, tuple[Any, ...]], expected: dict[str, tuple[Any, ...]]) -> Iterator[Defects]:
    """Tell which rows are missing or others; more may be there."""
    for name, wanted in expected.items():
        found = rows.get(name)
        if found != wanted:
            told = "no row" if found is None else str(found)[:200]
            yield one(f"table={table} name={name}", f"found {told}, expected {wanted}")


def check_layers(data: StoreData) -> Iterator[Defects]:
    """The views that show the levels are those of the format, letter by letter."""
    model = objects_made_by("".join(layers_sql(row.level, data.srs[0]) for row in data.level_rows))
    for name, expected in model.items():
        found = data.objects.get(name)
        if found != expected:
            told = "none" if found is None else f"another {found.kind}"
            yield one(f"view={name}", f"found {told}, expected that of schema/layers.sql")


def check_face_layer(data: StoreData) -> Iterator[Defects]:
    """The table that gives layers of faces their types is empty."""
    (count,) = data.select("SELECT count(*) FROM face_layer")[0]
    if count:
        yield one("table=face_layer", f"found {count} rows, expected none: each layer of faces would show them")


def check_last_change(data: StoreData) -> Iterator[Defects]:
    """No clock shows in the file."""
    for name, found in data.select("SELECT table_name, last_change FROM gpkg_contents"):
        if found != LAST_CHANGE:
            yield one(
                f"table=gpkg_contents name={str(name)[:60]}", f"found {str(found)[:40]!r}, expected {LAST_CHANGE!r}"
            )


DESCRIBED = ("metadata", "levels")
RULES = (
    Rule("V110", "identity", ERROR, "R-200", "the header does not say GeoPackage 1.4", check_identity,
         needs=("no_store",)),
    Rule("V111", "spatial_reference", ERROR, "R-201", "a reference system is not there", check_systems,
         needs=DESCRIBED),
    Rule("V112", "contents", ERROR, "R-201", "a layer or table is not listed as it should be", check_contents,
         needs=(*DESCRIBED, "tile_extent")),
    Rule("V113", "geometry_columns", ERROR, "R-201", "the geometry of a layer is not listed as it should be",
         check_geometry_columns, needs=DESCRIBED),
    Rule("V114", "extension_row", ERROR, "R-202", "a table beyond the norm is not said to be one", check_extensions,
         needs=("integrity", "unknown_version")),
    Rule("V115", "layer_view", ERROR, "R-210", "a layer is not that of the format", check_layers, needs=DESCRIBED),
    Rule("V116", "face_layer", ERROR, "R-211", "the table that types the layers has rows", check_face_layer,
         needs=("integrity", "unknown_version")),
    Rule("V117", "last_change", WARNING, "R-203", "a time of change is told", check_last_change,
         needs=("integrity", "unknown_version")),
)  # fmt: skip
