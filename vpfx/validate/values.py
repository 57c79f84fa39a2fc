"""Values and rows of a file that is not trusted."""

from __future__ import annotations

import math
import sqlite3
from contextlib import closing
from typing import Any, NamedTuple

__all__ = ["OBJECTS", "LevelRow", "Object", "is_number", "is_whole", "objects_made_by"]

OBJECTS = "SELECT name, type, tbl_name, sql FROM sqlite_schema"
"""Asks SQLite for what makes an `Object`, by name."""


class LevelRow(NamedTuple):
    """A row of the table `level`, as it stands there."""

    level: Any
    max_error_bound: Any
    max_error: Any
    rmse: Any
    max_rise: Any
    post_count: Any
    node_count: Any
    edge_count: Any
    face_count: Any
    first_border_edge: Any
    last_border_edge: Any
    border_digest: Any


def is_whole(value: Any, least: int = 0) -> bool:
    """Tell whether a value is an integer, and not below some other one."""
    return isinstance(value, int) and not isinstance(value, bool) and value >= least


def is_number(value: Any) -> bool:
    """Tell whether a value is a finite number.

    Examples
    --------
    >>> [is_number(value) for value in (1, 2.5, float("inf"), 10**400, True, "1")]
    [True, True, False, False, False, False]
    """
    try:
        return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:
        return False


class Object(NamedTuple):
    """A row of the table of contents of SQLite.

    Attributes
    ----------
    kind : str
        ``table``, ``view``, ``index`` or ``trigger``.
    table : str
        That it belongs to.
    sql : str or None
    """

    kind: str
    table: str
    sql: str | None


def objects_made_by(sql: str) -> dict[str, Object]:
    """Return what some SQL makes in an empty database, by name.

    Examples
    --------
    >>> objects_made_by("CREATE VIEW one AS SELECT 1")
    {'one': Object(kind='view', table='one', sql='CREATE VIEW one AS SELECT 1')}
    """
    with closing(sqlite3.connect(":memory:")) as model:
        model.executescript(sql)
        return {name: Object(*facts) for name, *facts in model.execute(OBJECTS)}
