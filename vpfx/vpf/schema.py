"""Feature classes of a coverage, from the relations of ``fcs``; what ``fca`` and ``*.vdt`` say of them (V-204, V-205, V-207).

::

    roadl.lft edg_id ─► edg id                                     a feature has one primitive
    roadl.lft id ─► roadl.ljt roadl_id,  roadl.ljt edg_id ─► edg id   a feature has several: a join table
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from vpfx.errors import VpfFormatError
from vpfx.vpf.header import TEXT_KINDS
from vpfx.vpf.layouts import PRIMITIVES
from vpfx.vpf.paths import check_name
from vpfx.vpf.table import Table, open_table

__all__ = [
    "MOST_ROWS", "FeatureClass", "Join", "Relation", "classes_of", "read_bounded", "read_kinds", "read_relations",
    "value_descriptions",
]  # fmt: skip

MOST_ROWS = 100_000
"""Rows of a table of libraries, coverages, classes or tiles; the most seen are 5 000."""

FEATURE_TABLE = re.compile(r"(.+)\.([plact])ft\.?", re.IGNORECASE)
JOIN_TABLE = re.compile(r"(.+)\.[a-z]jt\.?", re.IGNORECASE)


class Relation(NamedTuple):
    """A row of ``fcs``: a column of one table names rows of another."""

    row: int  # of fcs, from 1
    feature_class: str
    table1: str
    key1: str
    table2: str
    key2: str


class Join(NamedTuple):
    """A table that says which primitives each feature has."""

    table: str
    feature_key: str  # its column that names the feature
    primitive_key: str  # its column that names the primitive


class FeatureClass(NamedTuple):
    """A feature class, and how its features find their primitives.

    Examples
    --------
    >>> FeatureClass("polbnda", "A", "polbnda.aft", "fac", "fac_id").join is None
    True
    """

    name: str
    kind: str  # P point, L line, A area, T text, C complex
    table: str
    primitive: str  # table of primitives in lower case; empty for complex features
    prim_key: str  # column that names the primitive, of the feature table or of the join table
    join: Join | None = None
    description: str = ""


def read_bounded(path: Path, most: int = MOST_ROWS) -> Table:
    """Read a table whose rows are gone through one by one.

    Raises
    ------
    VpfFormatError
        It is broken, or has more rows than such a table can have (V-203).
    """
    with open_table(path) as file:
        if file.n_row > most:
            raise VpfFormatError(str(path), "", f"found {file.n_row:,} rows, expected at most {most:,}", "V-203")
        return file.read()


def read_relations(path: Path) -> tuple[Relation, ...]:
    """Relations of ``fcs`` in their order; key columns may have the names of 1992.

    Raises
    ------
    VpfFormatError
        A column is missing or no text, a table has a name that no file can have, or a class has control characters in its.
    """
    table = read_bounded(path)
    key1 = "foreign_key" if "foreign_key" in table and "table1_key" not in table else "table1_key"
    key2 = "primary_key" if "primary_key" in table and "table2_key" not in table else "table2_key"
    names = [table.texts(name) for name in ("feature_class", "table1", key1, "table2", key2)]
    relations = []
    for row, fields in enumerate(zip(*names, strict=True), 1):
        name, table1, column1, table2, column2 = ((text or "").strip() for text in fields)
        for text in (table1, table2):
            check_name(text, str(path), f"row {row}")
        if not name.isprintable():
            found = f"found the class {name!r}, expected a name without control characters"
            raise VpfFormatError(str(path), f"row {row}", found, "V-204")
        relations.append(Relation(row, name or table1.split(".")[0], table1, column1, table2, column2))
    return tuple(relations)


def read_kinds(path: Path) -> dict[str, tuple[str, str, str]]:
    """Name, type and description of the classes of ``fca`` by their names in lower case.

    Raises
    ------
    VpfFormatError
        A column is missing or no text.
    """
    table = read_bounded(path)
    description = "descr" if "descr" in table else "description"
    rows = zip(*(table.texts(name) for name in ("fclass", "type", description)), strict=True)
    kinds: dict[str, tuple[str, str, str]] = {}
    for name, kind, text in rows:
        kinds.setdefault((name or "").strip().lower(), ((name or "").strip(), (kind or "").upper(), text or ""))
    return kinds


def classes_of(
    relations: Sequence[Relation], kinds: dict[str, tuple[str, str, str]], path: str = ""
) -> tuple[dict[str, FeatureClass], dict[str, str]]:
    """Feature classes by their names in lower case, and what hinders others.

    Returns
    -------
    classes : dict
        A class on two tables of primitives stands there twice, the second time as ``name:primitive``; one with two
        feature tables, as ``name:table``.
    problems : dict
        Lines on classes of ``fcs`` or ``fca`` that no relation leads to primitives, by their names in lower case.

    Examples
    --------
    >>> relation = Relation(1, "ROADL", "ROADL.LFT", "EDG_ID", "EDG", "ID")
    >>> classes_of([relation, relation._replace(row=2)], {})
    ({'roadl': FeatureClass(name='ROADL', kind='L', table='ROADL.LFT', primitive='edg', prim_key='EDG_ID', join=None,
    description='')}, {})
    """
    classes: dict[str, FeatureClass] = {}
    for found in _forward(relations):
        _, kind, description = kinds.get(found.name.lower(), ("", "", ""))
        found = found._replace(kind=kind if kind in tuple("PLATC") else found.kind, description=description)
        key = found.name.lower()
        for further in (key, f"{key}:{found.primitive}", f"{key}:{found.table.lower()}"):
            if further not in classes:
                classes[further] = found
                break
            if _same(classes[further]) == _same(found):
                break
    named = [relation.feature_class for relation in relations] + [name for name, _, _ in kinds.values()]
    lost = {name.lower(): name for name in named if name.lower() not in classes}
    message = "found no relation to primitives, expected one in fcs"
    return classes, {key: str(VpfFormatError(path, f"class {name!r}", message, "V-204")) for key, name in lost.items()}


def _same(feature_class: FeatureClass) -> tuple[str, ...]:
    join = feature_class.join or ("", "", "")
    return tuple(text.lower() for text in (feature_class.table, feature_class.primitive, feature_class.prim_key, *join))


def _forward(relations: Sequence[Relation]) -> Iterator[FeatureClass]:
    """Yield what relations lead from a feature table to primitives, whatever the order of the rows."""
    for relation in relations:
        feature = FEATURE_TABLE.fullmatch(relation.table1)
        if feature is None:
            continue
        first = FeatureClass(relation.feature_class, feature[2].upper(), relation.table1, "", "")
        if primitive := _primitive(relation.table2):
            yield first._replace(primitive=primitive, prim_key=relation.key1)
        elif JOIN_TABLE.fullmatch(relation.table2):
            for further in relations:
                is_next = _is_same_table(further.table1, relation.table2) and further.row != relation.row
                if is_next and (primitive := _primitive(further.table2)):
                    join = Join(relation.table2, relation.key2, further.key1)
                    yield first._replace(primitive=primitive, prim_key=further.key1, join=join)
        elif first.kind == "C":
            yield first


def _primitive(table: str) -> str:
    """Name of a table of primitives, or nothing."""
    name = table.rstrip(".").lower()
    return name if name in PRIMITIVES else ""


def _is_same_table(one: str, other: str) -> bool:
    return one.rstrip(".").lower() == other.rstrip(".").lower()


def value_descriptions(table: Table) -> dict[tuple[str, str], dict[int | str, str]]:
    """Return what coded values mean, by table and column, from ``int.vdt`` or ``char.vdt`` (V-116).

    Names come in lower case. Of a value that is described twice the first description counts.

    Raises
    ------
    VpfFormatError
        One of the columns `table`, `attribute`, `value`, `description` is missing or of another type.

    Examples
    --------
    >>> from vpfx.vpf.layouts import INT_VDT
    >>> from vpfx.vpf.table import decode, encode
    >>> row = {"id": [1], "table": ["road.lft"], "attribute": ["acc"], "value": [1], "description": ["Accurate"]}
    >>> value_descriptions(decode(*encode(INT_VDT, row)))
    {('road.lft', 'acc'): {1: 'Accurate'}}
    """
    coded = table.layout.find("value")
    is_text = coded is not None and coded.kind in TEXT_KINDS
    values: list[Any] = table.texts("value") if is_text else table.whole_numbers("value").tolist()
    found: dict[tuple[str, str], dict[int | str, str]] = {}
    rows = zip(*(table.texts(name) for name in ("table", "attribute", "description")), values, strict=True)
    for name, attribute, description, code in rows:
        described = found.setdefault(((name or "").lower(), (attribute or "").lower()), {})
        described.setdefault("" if code is None else code, description or "")
    return found
