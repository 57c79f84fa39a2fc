"""What a store says of itself, read without trust: metadata, levels, extent (specs/format.md R-110, R-120, R-130)."""

from __future__ import annotations

import json
import math
import sqlite3
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

from pyproj import CRS
from pyproj.exceptions import ProjError

from vpfx.errors import StoreFormatError
from vpfx.model import Extent
from vpfx.store.ddl import schema_sql
from vpfx.store.geopackage import APPLICATION_ID
from vpfx.store.summary import LevelSummary

__all__ = [
    "FORMAT_VERSION",
    "METADATA",
    "MOST_CHARACTERS",
    "check_schema",
    "decode_metadata",
    "is_horizontal",
    "read_extent",
    "read_levels",
    "read_metadata",
]

FORMAT_VERSION = "0.1"

MOST_CHARACTERS = 1 << 20  # of one metadata value

_NUMBER = (int, float)
METADATA: dict[str, type | tuple[type, ...]] = {
    "format_version": str, "software": str, "crs_wkt2": str, "vertical_datum": str, "vertical_unit": str,
    "source_vertical_unit": str, "source_vertical_unit_is_assumed": bool, "method": str, "method_source": str,
    "options": dict, "seed": int, "lattice": dict, "posts": int, "void_posts": int, "isolated_posts": int,
    "area_m2": _NUMBER, "void_area_m2": _NUMBER,
}  # fmt: skip
"""Names of the table `metadata`, and of which type their values are; those that are not text are JSON."""


def check_schema(connection: sqlite3.Connection, path: Path) -> None:
    """Compare tables and views with those of the format, so that nothing stands in for one, and the size with the header's.

    Parameters
    ----------
    connection : sqlite3.Connection
        In a transaction: else a writer may come between.
    path : Path
        The same file.

    Raises
    ------
    StoreFormatError
        The file is no GeoPackage, lacks a table or view or has another of that name, or is cut off.
    """
    facts = {
        name: connection.execute(f"PRAGMA {name}").fetchone()[0]
        for name in ("application_id", "page_count", "page_size", "journal_mode")
    }
    if facts["application_id"] != APPLICATION_ID:
        raise StoreFormatError(str(path), "", "found no GeoPackage, expected a store made by vpfx build", "R-200")
    query = "SELECT name, type, sql FROM sqlite_schema"
    found = {name: (kind, sql) for name, kind, sql in connection.execute(query)}
    with closing(sqlite3.connect(":memory:")) as model:
        model.executescript(schema_sql("vpfx.sql") + schema_sql("views.sql"))
        for name, *definition in model.execute(query):
            if found.get(name) != tuple(definition):
                message = "found another definition or none, expected that of schema/"
                raise StoreFormatError(str(path), f"{definition[0]} {name}", message, "R-101")
    n_byte = facts["page_count"] * facts["page_size"]
    if facts["journal_mode"] != "wal" and path.stat().st_size != n_byte:  # else the newest pages lie in another file
        raise StoreFormatError(str(path), "", f"found {path.stat().st_size} bytes, expected {n_byte}", "R-101")


def read_metadata(connection: sqlite3.Connection, path: str) -> dict[str, Any]:
    """Read the table `metadata`; values that are not text by their name are decoded from JSON.

    Raises
    ------
    StoreFormatError
        A name is missing, a value is not of its kind, or the format's version is not known.
    """
    rows = connection.execute("SELECT name, value FROM metadata ORDER BY name").fetchall()
    return decode_metadata(dict(rows), path)


def decode_metadata(found: Mapping[str, Any], path: str) -> dict[str, Any]:
    """Return values of `metadata` as what they are: text as it is, others from JSON.

    Raises
    ------
    StoreFormatError
        As `read_metadata`.
    """
    version = found.get("format_version")
    if version != FORMAT_VERSION:
        message = f"found format version {str(version)[:20]!r}, expected {FORMAT_VERSION!r}"
        raise StoreFormatError(path, "table metadata", message, "R-110")
    decoded = {}
    for name, value in found.items():
        kind = METADATA.get(name, str)
        try:
            if not isinstance(value, str) or len(value) > MOST_CHARACTERS:
                raise ValueError
            decoded[name] = value if kind is str else json.loads(value)
        except (ValueError, RecursionError):
            decoded[name] = None
        if not isinstance(decoded[name], kind):
            raise StoreFormatError(path, f"table metadata: {str(name)[:40]}", "found a value of another kind", "R-110")
    if decoded.get("crs_wkt2") and not is_horizontal(decoded["crs_wkt2"]):
        message = "found no horizontal CRS as WKT, expected one or none"
        raise StoreFormatError(path, "table metadata: crs_wkt2", message, "R-110")
    missing = sorted(set(METADATA) - set(found))
    if missing:
        raise StoreFormatError(path, "table metadata", f"found no {missing[0]}, expected one", "R-110")
    return decoded


def is_horizontal(wkt: str) -> bool:
    """Tell whether a text is a CRS of places on the ground, whose unit has a size there.

    Examples
    --------
    >>> is_horizontal(CRS("EPSG:26913").to_wkt()), is_horizontal(CRS("EPSG:4978").to_wkt())  # UTM, geocentric
    (True, False)
    """
    try:
        crs = CRS.from_wkt(wkt)
        if len(crs.axis_info) < 2 or crs.is_geocentric:
            return False
        geod = crs.get_geod()
        return geod is None or geod.inv(0.0, 0.0, 1.0, 0.0)[2] > 0.0
    except (ProjError, ArithmeticError):  # PROJ takes ellipsoids of any size
        return False


def read_levels(connection: sqlite3.Connection, path: str) -> tuple[LevelSummary, ...]:
    """Read the table `level`.

    Raises
    ------
    StoreFormatError
        The levels are not numbered 0 … n - 1, or a value is not a finite number.
    """
    columns = "level, max_error_bound, max_error, rmse, max_rise, post_count, node_count, edge_count, face_count"
    levels = []
    for number, row in enumerate(connection.execute(f"SELECT {columns} FROM level ORDER BY level")):
        counts = (row[0], *row[5:])
        reals = [*row[2:4], *(value for value in (row[1], row[4]) if value is not None)]
        is_good = all(isinstance(value, int) and value >= 0 for value in counts) and row[0] == number
        if not is_good or not all(isinstance(value, _NUMBER) and math.isfinite(value) for value in reals):
            message = "found levels out of order or values that are no finite numbers"
            raise StoreFormatError(path, f"table level: row {number + 1}", message, "R-120")
        levels.append(LevelSummary(*row))
    if not levels:
        raise StoreFormatError(path, "table level", "found no row, expected at least one", "R-120")
    return tuple(levels)


def read_extent(connection: sqlite3.Connection, path: str) -> Extent:
    """Read the rectangle of all tiles.

    Raises
    ------
    StoreFormatError
        There is no tile, or a corner is no finite number.
    """
    box = connection.execute("SELECT min(xmin), min(ymin), max(xmax), max(ymax) FROM tile").fetchone()
    if not all(isinstance(value, _NUMBER) and math.isfinite(value) for value in box):
        raise StoreFormatError(path, "table tile", "found no tile or a corner that is no finite number", "R-130")
    return Extent(*(float(value) for value in box))
