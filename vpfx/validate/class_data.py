"""Feature classes of a file that is not trusted: what they are, and what is wrong with each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from vpfx.errors import InputError
from vpfx.store.classes import KINDS, Column, check_name, class_sql

__all__ = ["ClassData", "read_class_data"]

Select = Callable[..., list[tuple[Any, ...]]]


class ClassData(NamedTuple):
    """A feature class as it stands in a file.

    Attributes
    ----------
    class_id, name : object
        Anything, until `name_problem` is empty.
    columns : dict of str to Column
        Those without problem.
    name_problem : str
        Why the name cannot be one; empty if it can.
    column_problems : tuple of (str, str)
        Names of columns, and what is wrong with them.
    table_problem : str
        Why the table is not the one that the columns make; empty if it is, so that both names may stand in SQL.
    """

    class_id: Any
    name: Any
    columns: dict[str, Column]
    name_problem: str
    column_problems: tuple[tuple[str, str], ...]
    table_problem: str


def read_class_data(select: Select, objects: Mapping[str, Any], taken: Mapping[str, Any]) -> list[ClassData]:
    """Read the classes of a file.

    Parameters
    ----------
    select : callable
        Runs SQL.
    objects : mapping
        Tables and views of the file by name.
    taken : mapping
        Names that no class may have.
    """
    query = "SELECT class_id, class_name, description FROM feature_class ORDER BY class_id"
    return [_read_class(select, objects, taken, *row) for row in select(query)]


def _read_class(
    select: Select, objects: Mapping[str, Any], taken: Mapping[str, Any], class_id: Any, name: Any, description: Any
) -> ClassData:
    """One class."""
    name_problem = _problem_of(name, "class", taken)
    if not name_problem and not isinstance(description, str):
        name_problem = "found a description that is no text"
    query = "SELECT column_name, kind, unit, description FROM feature_column WHERE class_id = ? ORDER BY column_name"
    columns, problems = {}, []
    for column, *facts in select(query, (class_id,)):
        problem = _problem_of(column, "column", {"feature_id": None})
        if not problem and (facts[0] not in KINDS or not all(isinstance(fact, str) for fact in facts)):
            problem = f"found {facts}, expected a kind, a unit and a description"
        if problem:
            problems.append((str(column)[:40], problem))
        else:
            columns[column] = Column(*facts)
    table_problem = "" if not (name_problem or problems) else "found names that cannot be"
    if not table_problem:
        order = [row[1] for row in select(f"PRAGMA table_info({name})") if row[1] in columns]
        found = objects.get(name)
        expected = class_sql(name, {column: columns[column] for column in order})
        if len(order) != len(columns) or found is None or (found.kind, found.sql) != ("table", expected):
            table_problem = "found another table or none, expected the one its columns make"
    return ClassData(class_id, name, columns, name_problem, tuple(problems), table_problem)


def _problem_of(name: Any, what: str, taken: Mapping[str, Any]) -> str:
    """Say why a name cannot be one; nothing if it can."""
    try:
        check_name(name, what)
    except InputError as error:
        return str(error)
    return f"{what}: found {name!r}, which is taken" if name in taken else ""
