"""Rules V8xx: attributes of faces: classes, their tables, features, shares (R-220 to R-225)."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from vpfx.store.classes import KINDS
from vpfx.validate.class_data import ClassData
from vpfx.validate.report import ERROR, MOST_SHOWN, Defects, Rule, one
from vpfx.validate.store_data import StoreData

__all__ = ["RULES"]

MOST_SHARE = 1.0 + 1e-9
"""What the shares of a face in a class add up to at most."""
REFERRING = ("feature_column", "value_description", "feature", "face_feature")
"""Tables of attributes with foreign keys."""


def _place(found: ClassData) -> str:
    return f"class={str(found.name)[:40]}"


def check_class_names(data: StoreData) -> Iterator[Defects]:
    """Names of classes may be names of tables."""
    for found in data.classes:
        if found.name_problem:
            yield one(_place(found), found.name_problem)


def check_class_columns(data: StoreData) -> Iterator[Defects]:
    """Columns of classes have a name, a kind, a unit and a description."""
    for found in data.classes:
        for column, problem in found.column_problems:
            yield one(f"{_place(found)} column={column}", problem)


def check_class_tables(data: StoreData) -> Iterator[Defects]:
    """The table of a class is the one that its columns make."""
    for found in data.classes:
        if found.table_problem and not (found.name_problem or found.column_problems):
            yield one(_place(found), found.table_problem)


def _rows(data: StoreData, query: str, place: str, key: str, message: str) -> Iterator[Defects]:
    """What is wrong with the rows that a query finds by their first column."""
    (count,) = data.select(f"SELECT count(*) FROM ({query})")[0]
    if count:
        ids = [row[0] for row in data.first(query, MOST_SHOWN)]
        yield Defects(count, partial(_row, place, key, message, ids))


def _row(place: str, key: str, message: str, ids: list[int], i: int) -> tuple[str, str]:
    return f"{place} {key}={ids[i]}", message


def check_class_values(data: StoreData) -> Iterator[Defects]:
    """Values are of the kind of their column."""
    for found in data.classes:
        if found.table_problem:
            continue
        for column, (kind, _, _) in found.columns.items():
            query = (
                f"SELECT feature_id FROM {found.name} WHERE NOT ({column} IS NULL OR {KINDS[kind][1].format(column)})"
            )
            message = f"{column}: found a value of another kind, expected {kind}"
            yield from _rows(data, query, _place(found), "feature", message)


def check_features(data: StoreData) -> Iterator[Defects]:
    """Each feature has a row in the table of its class, and each row is a feature of it."""
    for found in data.classes:
        if found.table_problem or not isinstance(found.class_id, int):
            continue
        here = f"SELECT feature_id FROM feature WHERE class_id = {found.class_id}"
        there = f"SELECT feature_id FROM {found.name}"
        message = f"found a feature without a row in table {found.name}, expected one"
        yield from _rows(data, f"{here} EXCEPT {there}", _place(found), "feature", message)
        message = f"found a row in table {found.name} that is no feature of the class"
        yield from _rows(data, f"{there} EXCEPT {here}", _place(found), "feature", message)


def check_references(data: StoreData) -> Iterator[Defects]:
    """What attributes refer to is there."""
    for table in REFERRING:
        rows = data.select(f"PRAGMA foreign_key_check({table})")
        parents = [str(row[2]) for row in rows]
        if rows:
            yield Defects(len(rows), partial(_lost, table, parents))


def _lost(table: str, parents: list[str], i: int) -> tuple[str, str]:
    return f"table={table}", f"found a row that refers to a row of table {parents[i]}, which is not there"


def check_shares(data: StoreData) -> Iterator[Defects]:
    """Shares are parts of the area of a face, and add up to all of it at most."""
    query = (
        "SELECT face_id, class_id FROM face_feature GROUP BY face_id, class_id "
        f"HAVING sum(share) > {MOST_SHARE!r} OR min(share) <= 0 OR max(typeof(share) <> 'real')"
    )
    (count,) = data.select(f"SELECT count(*) FROM ({query})")[0]
    if count:
        rows = data.first(query, MOST_SHOWN)
        places = [f"face={face} class_id={class_id}" for face, class_id in rows]
        yield Defects(count, lambda i: (places[i], "found shares that are no parts, or add up to more than the face"))


RULES = (
    Rule("V801", "class_name", ERROR, "R-220", "a feature class has a name that cannot be one of a table",
         check_class_names, needs=("integrity", "unknown_version")),
    Rule("V802", "class_column", ERROR, "R-221", "a column of a feature class is not described as it should be",
         check_class_columns, needs=("integrity", "unknown_version")),
    Rule("V803", "class_table", ERROR, "R-225", "the table of a feature class is another", check_class_tables,
         needs=("integrity", "unknown_version")),
    Rule("V804", "class_value", ERROR, "R-221", "a value of a feature is of another kind", check_class_values,
         needs=("class_name", "class_column", "class_table")),
    Rule("V805", "feature_row", ERROR, "R-223", "features and rows of class tables differ", check_features,
         needs=("class_name", "class_column", "class_table")),
    Rule("V806", "attribute_reference", ERROR, "R-224", "a row of attributes refers to nothing", check_references,
         needs=("integrity", "unknown_version")),
    Rule("V807", "share", ERROR, "R-224", "shares of a face are no parts of it", check_shares,
         needs=("integrity", "unknown_version")),
)  # fmt: skip
