"""What makes the store a GeoPackage: identity, spatial reference, contents, extension rows (specs/format.md R-200)."""

from __future__ import annotations

import sqlite3

from pyproj import CRS
from pyproj.exceptions import CRSError

from vpfx.model import Extent
from vpfx.store.ddl import layer_names, layers_sql

__all__ = [
    "APPLICATION_ID",
    "ATTRIBUTE_TABLES",
    "DEFINITION",
    "EXTENSION",
    "LAST_CHANGE",
    "OTHER_TABLES",
    "USER_VERSION",
    "find_srs",
    "register",
    "register_class",
    "unregister_class",
]

APPLICATION_ID = 0x47504B47  # "GPKG"
USER_VERSION = 10400  # GeoPackage 1.4
LAST_CHANGE = "1970-01-01T00:00:00.000Z"  # fixed: the same input gives the same bytes
OWN_SRS_ID = 200000  # for a CRS without number of its own
UNDEFINED_SRS_ID = -1
EXTENSION = "vpfx_hierarchical_tin"
DEFINITION = "urn:x-vpfx:hierarchical-tin:0.1"  # described in specs/format.md

ATTRIBUTE_TABLES = {
    "level": "levels with bounds and measured errors",
    "tile": "tiles",
    "tile_level": "rows and digest of each tile and level",
    "node": "nodes of all levels",
    "edge": "winged edges of all levels",
    "face": "faces of all levels",
    "source": "files of posts and features",
    "feature_class": "feature classes, whose tables describe what faces are part of",
}
"""Tables that GeoPackage lists as attributes, and their titles."""
OTHER_TABLES = (
    "metadata", "level_cut", "parent_child", "shared_area", "t_junction", "tile_index", "face_layer", "feature_column",
    "value_description", "feature", "face_feature",
)  # fmt: skip
"""The other ones beyond the norm."""


def find_srs(wkt: str) -> tuple[int, str, str, int, str]:
    """Row of gpkg_spatial_ref_sys for a CRS: srs_id, name, organization, number there, definition.

    Examples
    --------
    >>> find_srs(CRS.from_epsg(32611).to_wkt())[:4]
    (32611, 'WGS 84 / UTM zone 11N', 'EPSG', 32611)
    """
    if not wkt:
        return UNDEFINED_SRS_ID, "Undefined Cartesian SRS", "NONE", -1, "undefined"
    crs = CRS.from_wkt(wkt)
    try:
        definition = crs.to_wkt("WKT1_GDAL")
    except CRSError:
        definition = wkt
    authority = crs.to_authority(min_confidence=100)
    if authority and authority[1].isdigit():
        return int(authority[1]), crs.name, authority[0], int(authority[1]), definition
    return OWN_SRS_ID, crs.name, "NONE", OWN_SRS_ID, definition


def register(connection: sqlite3.Connection, wkt: str, extent: Extent, n_level: int) -> None:
    """Enter the CRS, the layers of every level and the extra tables, and make the views."""
    srs = find_srs(wkt)
    wgs84 = CRS.from_epsg(4326)
    rows = {
        -1: (-1, "Undefined Cartesian SRS", "NONE", -1, "undefined"),
        0: (0, "Undefined geographic SRS", "NONE", 0, "undefined"),
        4326: (4326, wgs84.name, "EPSG", 4326, wgs84.to_wkt("WKT1_GDAL")),
    }
    rows[srs[0]] = srs
    insert = "INSERT INTO gpkg_spatial_ref_sys (srs_id, srs_name, organization, organization_coordsys_id, definition)"
    connection.executemany(f"{insert} VALUES (?, ?, ?, ?, ?)", rows.values())
    content = "INSERT INTO gpkg_contents VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)"
    for level in range(n_level):
        for statement in layers_sql(level, srs[0]).split(";\n"):
            connection.execute(statement)
        for name, kind in layer_names(level).items():
            title = f"{name.split('_')[0]}s of level {level}"
            connection.execute(content, (name, "features", name, title, LAST_CHANGE, *extent, srs[0]))
            connection.execute("INSERT INTO gpkg_geometry_columns VALUES (?, 'geom', ?, ?, 1, 0)", (name, kind, srs[0]))
    for name, title in ATTRIBUTE_TABLES.items():
        connection.execute(content, (name, "attributes", name, title, LAST_CHANGE, None, None, None, None, None))
    for extended in (*ATTRIBUTE_TABLES, *OTHER_TABLES):
        row = (extended, None, EXTENSION, DEFINITION, "write-only")
        connection.execute("INSERT INTO gpkg_extensions VALUES (?, ?, ?, ?, ?)", row)


def register_class(connection: sqlite3.Connection, name: str, description: str) -> None:
    """Enter the table of a feature class."""
    row = (name, "attributes", name, description, LAST_CHANGE, None, None, None, None, None)
    connection.execute("INSERT INTO gpkg_contents VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)", row)
    extended = (name, None, EXTENSION, DEFINITION, "write-only")
    connection.execute("INSERT INTO gpkg_extensions VALUES (?, ?, ?, ?, ?)", extended)


def unregister_class(connection: sqlite3.Connection, name: str) -> None:
    """Take the table of a feature class out."""
    for table in ("gpkg_extensions", "gpkg_contents"):
        connection.execute(f"DELETE FROM {table} WHERE table_name = ?", (name,))
