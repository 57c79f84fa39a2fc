"""Feature classes: their names, columns and tables, and how they are read without trust (specs/format.md R-220 to R-225)."""

from __future__ import annotations

import datetime
import math
import re
import sqlite3
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vpfx.errors import InputError, NotFoundError, StoreFormatError

__all__ = ["KINDS", "Column", "FeatureClass", "check_name", "class_sql", "find_class", "read_classes", "stored"]

IDENTIFIER = re.compile(r"[a-z][a-z0-9_]{0,30}", re.ASCII)
MOST_COLUMNS = 100

KINDS = {
    "text": ("TEXT", "typeof({0}) = 'text'"),
    "integer": ("INTEGER", "typeof({0}) = 'integer'"),
    "real": ("DOUBLE", "typeof({0}) = 'real'"),
    "date": ("DATE", "typeof({0}) = 'text' AND {0} IS date({0}, '+0 days')"),
}
"""Kinds of columns: declared type in SQLite, and what holds of a value that is not NULL."""


class Column(NamedTuple):
    """A column of a feature class.

    Attributes
    ----------
    kind : str
        One of `KINDS`; a date is the text ``yyyy-mm-dd``.
    unit : str
        Such as ``m``; empty if none.
    description : str
        For people; may be empty.
    """

    kind: str
    unit: str = ""
    description: str = ""


class FeatureClass(NamedTuple):
    """A kind of things that faces can be part of.

    Attributes
    ----------
    class_id : int
    name : str
        Also of its table.
    description : str
    columns : dict of str to Column
        Without ``feature_id``, the key.
    """

    class_id: int
    name: str
    description: str
    columns: dict[str, Column]


def check_name(name: Any, what: str) -> str:
    """Return a name that may stand in SQL as it is: of a class or a column.

    Raises
    ------
    InputError
        It is not a small letter with up to 30 small letters, digits or underscores behind it, or it is a word of SQL.

    Examples
    --------
    >>> check_name("soil", "class")
    'soil'
    >>> check_name("order", "class")
    Traceback (most recent call last):
    vpfx.errors.InputError: class: found 'order', a word of SQL; give another name
    """
    if not (isinstance(name, str) and IDENTIFIER.fullmatch(name)):
        message = "expected a small letter, then up to 30 small letters, digits or underscores"
        raise InputError(f"{what}: found {str(name)[:40]!r}, {message}")
    if name.startswith(("sqlite_", "gpkg_", "rtree_")):
        raise InputError(f"{what}: found {name!r}, which begins as tables of SQLite or GeoPackage; give another name")
    trial = sqlite3.connect(":memory:")
    try:
        trial.execute(f'CREATE TABLE {name} ("0" INTEGER PRIMARY KEY, {name} TEXT)')
        trial.execute(f"INSERT INTO {name} VALUES (1, 'x')")
        is_good = trial.execute(f"SELECT {name} FROM {name}").fetchone() == ("x",)  # current_date is no column
    except sqlite3.Error:
        is_good = False
    finally:
        trial.close()
    if not is_good:
        raise InputError(f"{what}: found {name!r}, a word of SQL; give another name")
    return name


def class_sql(name: str, columns: Mapping[str, Column]) -> str:
    """SQL that makes the table of a class (R-225); names are checked before.

    Examples
    --------
    >>> print(class_sql("soil", {"depth": Column("real", "m")}))
    CREATE TABLE soil (
      feature_id INTEGER PRIMARY KEY REFERENCES feature(feature_id) ON DELETE CASCADE,
      depth DOUBLE CHECK (depth IS NULL OR typeof(depth) = 'real')
    )
    """
    lines = ["feature_id INTEGER PRIMARY KEY REFERENCES feature(feature_id) ON DELETE CASCADE"]
    for column, (kind, _, _) in columns.items():
        declared, holds = KINDS[kind]
        lines.append(f"{column} {declared} CHECK ({column} IS NULL OR {holds.format(column)})")
    return f"CREATE TABLE {name} (\n  " + ",\n  ".join(lines) + "\n)"


def read_classes(connection: sqlite3.Connection, path: Path) -> dict[str, FeatureClass]:
    """Classes of a store by name, with their tables checked: names from a stranger's file are safe to use in SQL after that.

    Raises
    ------
    StoreFormatError
        A name is none, or the table of a class is not the one that `class_sql` makes.
    """
    found = {}
    query = "SELECT class_id, class_name, description FROM feature_class ORDER BY class_id"
    for class_id, name, description in connection.execute(query).fetchall():
        where = f"table feature_class: {str(name)[:40]}"
        query = "SELECT column_name, kind, unit, description FROM feature_column WHERE class_id = ?"
        rows = {row[0]: Column(*row[1:]) for row in connection.execute(query, (class_id,))}
        try:
            check_name(name, "class")
            definition = connection.execute("SELECT type, sql FROM sqlite_schema WHERE name = ?", (name,)).fetchone()
            # feature_column has no order of its own: the table's counts
            order = [row[1] for row in connection.execute(f"PRAGMA table_info({name})") if row[1] in rows]
            columns = {check_name(column, "column"): rows[column] for column in order}
            is_good = all(column.kind in KINDS for column in columns.values()) and len(columns) == len(rows)
            if not is_good or definition != ("table", class_sql(name, columns)):
                raise InputError("found another table or none, expected the one its columns make")
        except InputError as error:
            raise StoreFormatError(str(path), where, str(error), "R-225") from None
        found[name] = FeatureClass(class_id, name, description, columns)
    return found


def find_class(classes: Mapping[str, FeatureClass], name: str, path: Path) -> FeatureClass:
    """Return a class by its name.

    Raises
    ------
    NotFoundError
        There is none; the message lists those that are there.
    """
    if name not in classes:
        known = ", ".join(classes) or "none"
        raise NotFoundError(f"{path}: found no feature class {str(name)[:40]!r}; there are: {known}")
    return classes[name]


def stored(value: Any, column: Column, name: str) -> Any:
    """Return a value as SQLite keeps it in a column; None, NaN and NaT are NULL.

    Raises
    ------
    InputError
        It is not of the column's kind.

    Examples
    --------
    >>> stored(np.int32(3), Column("real"), "depth"), stored(datetime.date(1998, 12, 1), Column("date"), "surveyed")
    (3.0, '1998-12-01')
    >>> stored("deep", Column("real"), "depth")
    Traceback (most recent call last):
    vpfx.errors.InputError: column depth: found 'deep', expected a real
    """
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or value != value:
        return None
    if isinstance(value, datetime.datetime):
        value = value.date()
    kind = column.kind
    result: str | int | float | None = None
    if kind == "text" and isinstance(value, str):
        result = value
    elif kind == "integer" and isinstance(value, int | float) and value == value // 1 and -(2**63) <= value < 2**63:
        result = int(value)
    elif kind == "real" and isinstance(value, int | float) and math.isfinite(value):
        result = float(value)
    elif kind == "date" and isinstance(value, datetime.date):
        result = value.isoformat()
    elif kind == "date" and isinstance(value, str) and _is_date(value):
        result = value
    if result is None:
        raise InputError(f"column {name}: found {str(value)[:40]!r}, expected {'an' if kind[0] == 'i' else 'a'} {kind}")
    return result


def _is_date(text: str) -> bool:
    try:
        return len(text) == 10 and datetime.date.fromisoformat(text) is not None
    except ValueError:
        return False
