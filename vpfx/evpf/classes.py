"""Feature classes of a store as tables of VPF: their features, and what their values mean (specs/evpf.md E-310, E-430)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import InputError, StoreFormatError
from vpfx.evpf.folder import Folder
from vpfx.evpf.texts import as_written, to_vpf
from vpfx.store.classes import Column as StoreColumn
from vpfx.store.classes import FeatureClass, stored
from vpfx.store.reader import StoreReader
from vpfx.vpf import layouts
from vpfx.vpf.table import Column, Layout
from vpfx.vpf.values import NULL_INT

__all__ = [
    "OWN_CLASSES",
    "ClassTable",
    "cut_names",
    "read_class_tables",
    "text_column",
    "write_class",
    "write_values",
]

Ints = NDArray[np.int64]

MOST_INT = 2**31 - 3
"""Greatest magnitude of an integer that no reader takes for null."""

MOST_DESCRIPTION = 80
SPECIAL = str.maketrans(dict.fromkeys(';:,=\\"#', " "))

DEVICES = ("aux", "con", "nul", "prn", *(f"{port}{i}" for port in ("com", "lpt") for i in range(10)))
"""Names that Windows keeps for devices, whatever the suffix."""

OWN_CLASSES = (
    "tinface", "tinnode", "libref", "tileref", "level", "parent", "own", "evpf", "source", "class", "column", "value",
    "tjunct", "tile1", "tile2", "cnd", "edg", "fac", "rng", "ebr", "fbr", "fcs", "fca", "int", "char",
    *DEVICES,
)  # fmt: skip
"""Names of `specs/evpf.md`, and of devices, that no class of a store may have."""

COLUMN_NAMES = ("id", "tile_id", "fac_id", "store_id")
"""The same of columns."""


class ClassTable(NamedTuple):
    """A feature class of a store, ready to be written.

    Attributes
    ----------
    stored : FeatureClass
        As in the store.
    name : str
        As a feature class of VPF.
    feature_ids : int64 (n_feature,)
        Ids in the store, ascending; row i of `<class>.aft` is feature i - 1.
    layout : Layout
        Of `<class>.aft`.
    columns : dict
        Of `<class>.aft`.
    values : list of (str, str, str)
        Rows of `value_description`: column of the store, value, description.
    """

    stored: FeatureClass
    name: str
    feature_ids: Ints
    layout: Layout
    columns: dict[str, Any]
    values: list[tuple[str, str, str]]

    @property
    def column_names(self) -> dict[str, str]:
        """Names as written, by those of the store."""
        return dict(zip(self.stored.columns, (column.name for column in self.layout.columns[1:-1]), strict=True))


def cut_names(names: Iterable[str], width: int, taken: Iterable[str]) -> list[str]:
    """Cut names to a width, each to another name; where one is taken, its last two characters are a number.

    Raises
    ------
    InputError
        More than 99 names begin alike.

    Examples
    --------
    >>> cut_names(["soil", "vegetation", "vegetation_cover", "level"], 8, OWN_CLASSES)
    ['soil', 'vegetati', 'vegeta01', 'level01']
    """
    used, found = set(taken), []
    for name in names:
        choices = [name[:width], *(f"{name[: width - 2]}{i:02}" for i in range(1, 100))]
        free = next((choice for choice in choices if choice not in used), None)
        if free is None:
            raise InputError(
                f"found more than 99 names that begin with {name[: width - 2]!r}; rename some in the store"
            )
        used.add(free)
        found.append(free)
    return found


def text_column(name: str, texts: list[str | None], description: str = "") -> tuple[Column, list[str | None]]:
    """Return a column of texts of any length (E-101), and what is written in it."""
    kind, written = to_vpf(texts)
    return Column(name, kind, -1, "N", description), written


def described(text: str) -> str:
    """Return a text for people as it may stand in a header.

    Examples
    --------
    >>> described("Depth; of water, m")
    'Depth of water m'
    """
    plain = text.encode("ascii", "ignore").decode().translate(SPECIAL)
    return " ".join("".join(c if c.isprintable() else " " for c in plain).split())[:MOST_DESCRIPTION].strip()


def read_class_tables(store: StoreReader) -> list[ClassTable]:
    """Read the feature classes of a store, in the order of their ids.

    Raises
    ------
    InputError
        A class or feature has an id that `store_id` cannot hold, or more than 99 names begin alike.
    StoreFormatError
        A value is not of the kind of its column, or what it means is no text.
    """
    classes = list(store.classes.values())
    names = cut_names((found.name for found in classes), 8, OWN_CLASSES)
    return [_read_class(store, found, name) for found, name in zip(classes, names, strict=True)]


def _read_class(store: StoreReader, found: FeatureClass, name: str) -> ClassTable:
    if not 1 <= found.class_id <= MOST_INT:
        raise InputError(f"{store.path}: found class {found.class_id}, expected ids up to {MOST_INT} (E-430)")
    texts = found.description, *(text for column in found.columns.values() for text in column)
    if not all(isinstance(text, str) for text in texts):
        raise StoreFormatError(str(store.path), f"class {found.name}", "found a description that is no text", "R-220")
    rows = store.raw("SELECT feature_id FROM feature WHERE class_id = ? ORDER BY feature_id", (found.class_id,))
    feature_ids = np.array(rows, np.int64).ravel()
    beyond = feature_ids[(feature_ids < 1) | (feature_ids > MOST_INT)]
    if len(beyond):
        raise InputError(f"{store.path}: found feature {beyond[0]}, expected ids up to {MOST_INT} (E-430)")
    known = store.feature_values(found, 0, MOST_INT)
    empty = (None,) * len(found.columns)
    given = [known.get(feature, empty) for feature in feature_ids.tolist()]
    values = _described_values(store, found)
    coded = {column for column, _, description in values if description}
    columns, written = [Column("id", "I", 1, "P", "Row id")], {"id": np.arange(1, len(feature_ids) + 1)}
    short_names = cut_names(found.columns, 16, COLUMN_NAMES)
    for i, (short_name, (of_store, kind)) in enumerate(zip(short_names, found.columns.items(), strict=True)):
        try:
            given_values = [stored(row[i], kind, of_store) for row in given]
        except InputError as error:
            raise StoreFormatError(str(store.path), f"table {found.name}", str(error), "R-221") from None
        column, written[short_name] = _column(short_name, kind, given_values)
        if of_store in coded and column.kind in "ITL":
            column = column._replace(value_table="int.vdt" if column.kind == "I" else "char.vdt")
        columns.append(column)
    columns.append(Column("store_id", "I", 1, "U", "Feature in the store"))
    written["store_id"] = feature_ids
    layout = Layout(described(found.description) or f"Feature class {found.name}", tuple(columns))
    return ClassTable(found, name, feature_ids, layout, written, values)


def _described_values(store: StoreReader, found: FeatureClass) -> list[tuple[str, str, str]]:
    """Columns of a class, values, and what they mean."""
    query = (
        "SELECT column_name, value, description FROM value_description WHERE class_id = ? ORDER BY column_name, value"
    )
    rows = store.raw(query, (found.class_id,))
    for row in rows:
        if row[0] not in found.columns or not all(isinstance(text, str) for text in row):
            message = f"found {str(row)[:80]}, expected a column of class {found.name} and texts"
            raise StoreFormatError(str(store.path), "table value_description", message, "R-222")
    return rows


def _column(name: str, column: StoreColumn, values: list[Any]) -> tuple[Column, Any]:
    """A column of a class, and its values as they are written."""
    unit = described(column.unit)
    plain = described(column.description) or name.replace("_", " ").strip()
    text = f"{plain} ({unit})" if unit else plain
    text = text[:MOST_DESCRIPTION].strip()
    if column.kind == "real":
        return Column(name, "R", 1, "N", text), np.array(values, np.float64)
    if column.kind == "date":
        days = [None if day is None else f"{day[:4]}{day[5:7]}{day[8:]}000000.00000" for day in values]
        return Column(name, "D", 1, "N", text), days
    if column.kind == "integer" and all(value is None or abs(value) <= MOST_INT for value in values):
        return Column(name, "I", 1, "N", text), np.array([NULL_INT if v is None else v for v in values], np.int64)
    return text_column(name, [None if value is None else str(value) for value in values], text)


def write_class(coverage: Folder, table: ClassTable) -> None:
    """Write `<class>.aft`."""
    coverage.write(f"{table.name}.aft", table.layout, table.columns)


def value_rows(coverage: Folder, tables: list[ClassTable], value_table: str) -> list[tuple[str, str, str, str]]:
    """Rows of `int.vdt` or `char.vdt`: table, attribute, value as its column writes it, description if it is not empty."""
    found = []
    for table in tables:
        columns = {column.name: column for column in table.layout.columns}
        names = table.column_names
        for name, value, description in table.values:
            column = columns[names[name]]
            if column.value_table == value_table and description:
                written = value if column.kind == "I" else as_written(value, column.kind)
                found.append((coverage.named(f"{table.name}.aft"), column.name, written, _short(description)))
    return found


def write_values(coverage: Folder, tables: list[ClassTable]) -> None:
    """Write `int.vdt`, and `char.vdt` where a column has it; descriptions are for people, and cut (value.rat has all)."""
    filled = coverage.named("tinface.aft")
    rows = [(filled, "filled", 0, "Ground with data"), (filled, "filled", 1, "Heights interpolated")]
    rows += [
        (table, attribute, int(value), description)
        for table, attribute, value, description in value_rows(coverage, tables, "int.vdt")
        if _is_int(value)
    ]
    coverage.write("int.vdt", layouts.INT_VDT, _numbered(layouts.INT_VDT, rows))
    texts = value_rows(coverage, tables, "char.vdt")
    if texts:
        values = [row[2] for row in texts]
        layout = layouts.char_vdt(max(map(len, values)), "T" if all(value.isascii() for value in values) else "L")
        coverage.write("char.vdt", layout, _numbered(layout, texts))


def _short(text: str) -> str:
    return text.encode("ascii", "replace").decode()[:50]


def _is_int(text: str) -> bool:
    try:
        return abs(int(text)) <= MOST_INT and str(int(text)) == text
    except ValueError:
        return False


def _numbered(layout: Layout, rows: list[Any]) -> dict[str, Any]:
    """Columns of rows without their ids."""
    columns = zip(*rows, strict=True) if rows else ([] for _ in layout.columns[1:])
    values = [list(range(1, len(rows) + 1)), *map(list, columns)]
    return dict(zip((column.name for column in layout.columns), values, strict=True))
