"""What a VPF directory holds, and rows of tables, as plain values to print (`vpfx vpf ls`, `vpfx vpf dump`)."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import VpfxError
from vpfx.vpf.catalog import Coverage, Database, Library
from vpfx.vpf.header import TEXT_KINDS
from vpfx.vpf.schema import FeatureClass
from vpfx.vpf.table import Ragged, Table, TableFile, open_table
from vpfx.vpf.values import is_null, texts

__all__ = ["counted", "list_database", "list_lines", "table_problems", "table_rows"]

CONTROLS = {code: f"\\x{code:02x}" for code in (*range(32), *range(127, 160))}
"""Characters that would steer a terminal, and how they are shown."""


def list_database(database: Database) -> dict[str, Any]:
    """Libraries, coverages and feature classes as a document for JSON.

    What is listed but not there is named under ``missing``; a class whose table is not there has null rows. What is broken
    is told under ``problems`` of its coverage or library, and the rest is listed all the same.
    """
    return {
        "name": database.name,
        "path": str(database.path),
        "libraries": [_library(library) for library in database.libraries.values()],
        "missing": list(database.missing),
    }


def _library(library: Library) -> dict[str, Any]:
    told: dict[str, Any] = {"name": library.name, "extent": library.extent and list(library.extent)}
    told |= {"tiles": 0, "coverages": [], "missing": [], "problems": []}
    parts: dict[str, Callable[[], Any]] = {
        "tiles": lambda: len(library.tiles),
        "coverages": lambda: [_coverage(coverage) for coverage in library.coverages.values()],
        "missing": lambda: list(library.missing),
    }
    for name, part in parts.items():
        try:
            told[name] = part()
        except VpfxError as error:
            told["problems"].append(str(error))
    with suppress(VpfxError):  # the same as that of the tiles
        told["problems"] += library.problems
    told["problems"] = list(dict.fromkeys(told["problems"]))
    return told


def _coverage(coverage: Coverage) -> dict[str, Any]:
    told = {"name": coverage.name, "description": coverage.description, "level": coverage.level}
    try:
        problems = list(coverage.problems.values())
        classes = [_class(coverage, found, problems) for found in coverage.classes.values()]
    except VpfxError as error:
        classes, problems = [], [str(error)]
    return {**told, "classes": classes, "problems": problems}


def _class(coverage: Coverage, found: FeatureClass, problems: list[str]) -> dict[str, Any]:
    rows = None
    try:
        path = coverage.find(found.table)
        if path is not None:
            with open_table(path) as file:
                rows = file.n_row
    except VpfxError as error:
        problems.append(str(error))
    join = found.join and found.join.table
    return {
        "name": found.name, "kind": found.kind, "table": found.table, "rows": rows, "primitive": found.primitive,
        "join": join, "description": found.description,
    }  # fmt: skip


def list_lines(document: dict[str, Any]) -> list[str]:
    """A document of `list_database` as lines.

    Examples
    --------
    >>> list_lines({"name": "base", "path": "/d/base", "libraries": [], "missing": ["north"]})
    ['base  /d/base', '  north  missing']
    """
    lines = [f"{document['name']}  {document['path']}"]
    for library in document["libraries"]:
        extent = library["extent"]
        where = "no extent" if extent is None else " ".join(f"{value:.10g}" for value in extent)
        lines.append(f"  {library['name']}  {where}, {counted(library['tiles'], 'tile')}")
        for coverage in library["coverages"]:
            level = "–" if coverage["level"] is None else coverage["level"]
            lines.append(f"    {coverage['name']}  topology level {level}  {coverage['description']}".rstrip())
            lines += _class_lines(coverage["classes"])
            lines += [f"      problem: {problem}" for problem in coverage["problems"]]
        lines += [f"    {name}  missing" for name in library["missing"]]
        lines += [f"    problem: {problem}" for problem in library["problems"]]
    lines += [f"  {name}  missing" for name in document["missing"]]
    return [line.translate(CONTROLS) for line in lines]


def counted(n: int, name: str) -> str:
    """Say how many there are of what a name names.

    Examples
    --------
    >>> counted(1, "row"), counted(1200, "feature")
    ('1 row', '1,200 features')
    """
    return f"{n:,} {name}" if n == 1 else f"{n:,} {name}s"


def _class_lines(classes: list[dict[str, Any]]) -> list[str]:
    rows = []
    for found in classes:
        count = "missing" if found["rows"] is None else counted(found["rows"], "row")
        way = " by ".join(filter(None, (found["primitive"] or "–", found["join"])))
        rows.append((found["name"], found["kind"], found["table"], count, way, found["description"]))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["      " + "  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]


def table_rows(table: Table, *, is_nested: bool) -> tuple[tuple[str, ...], list[tuple[Any, ...]]]:
    """Names of columns and rows of plain values: str, int, float, None.

    Parameters
    ----------
    table : Table
        Held whole.
    is_nested : bool
        Coordinates and triplets as lists; else as text: members between blanks, places between commas, and what would
        steer a terminal in hexadecimal.

    Returns
    -------
    names : tuple of str
    rows : list of tuple
        Nulls are None. Numbers of single precision come with as few digits as tell them apart.
    """
    columns = []
    for column in table.layout.columns:
        values = _cells(table[column.name], column.kind)
        columns.append(values if is_nested else [_flat(value, column.kind) for value in values])
    names = tuple(column.name if is_nested else column.name.translate(CONTROLS) for column in table.layout.columns)
    return names, list(zip(*columns, strict=True))


def table_problems(file: TableFile) -> list[str]:
    """What is odd about a table that can be read all the same."""
    problems = [file.index_problem] if file.index_problem else []
    return [*problems, f"found {file.stray} bytes behind the last row, expected none"] if file.stray else problems


def _cells(values: NDArray[Any] | Ragged, kind: str) -> list[Any]:
    if kind == "X":
        return [None] * len(values)
    if kind in TEXT_KINDS + "D":
        return list(texts(values))
    if isinstance(values, Ragged):
        places, bounds = _plain(values.values), values.starts.tolist()
        return [places[a:b] or None for a, b in pairwise(bounds)]
    if kind == "K":
        return [[part or None for part in value] if any(value) else None for value in values.tolist()]
    nulls = is_null(values, kind).tolist()
    return [None if null else value for value, null in zip(_plain(values), nulls, strict=True)]


def _plain(values: NDArray[Any]) -> list[Any]:
    """Nested lists of Python's numbers; None for NaN."""
    if values.dtype.kind != "f":
        return values.tolist()
    shortest = [None if value != value else float(str(value)) for value in values.ravel()]
    return np.array(shortest, object).reshape(values.shape).tolist()


def _flat(value: Any, kind: str) -> Any:
    """Lists as text, and text without what would steer a terminal."""
    if isinstance(value, str):
        return value.translate(CONTROLS)
    if not isinstance(value, list):
        return value
    if isinstance(value[0], list):
        return ", ".join(_flat(part, kind) for part in value)
    if kind == "K" and not any(value[1:]):
        return f"{value[0]}"
    return " ".join("–" if part is None else f"{part!r}" for part in value)
