"""Tables of the hierarchy and of what the store knows beyond VPF (specs/evpf.md chapter 4, E-222)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vpfx.evpf.classes import ClassTable, text_column
from vpfx.evpf.folder import Folder
from vpfx.store.reader import StoreReader
from vpfx.vpf.table import Column, Layout

__all__ = [
    "COUNTS",
    "CUTS",
    "EVPF_VERSION",
    "HEAD",
    "METRES",
    "junction_layout",
    "own_layout",
    "parent_layout",
    "write_level",
    "write_whole",
]

EVPF_VERSION = "1.0"
HEAD = ("evpf_version", "precision", "level_count", "tile_size")
"""First rows of `evpf.rat`; those of the store's `metadata` follow."""

METRES = ("max_error_bound", "max_error", "rmse", "max_rise")
COUNTS = ("node_count", "edge_count", "face_count")
CUTS = ("one_edge", "two_edges", "three_edges", "centre", "centre_edge")
"""Columns of `level.rat`; cuts in the order of `vpfx.model.CUTS`."""

Ints = NDArray[np.int64]

ID = Column("id", "I", 1, "P", "Row id")
TILE = Column("tile_id", "S", 1, "N", "Tile as row of tileref.aft")
FACE = Column("fac_id", "I", 1, "N", "Face as row of fac")


def parent_layout(is_nested: bool) -> Layout:
    """Layout of `parent.rat`."""
    columns = [
        ID, TILE, Column("parent_id", "I", 1, "N", "Face as row of fac of the coverage before"),
        Column("child_id", "I", 1, "N", "Face as row of fac of this coverage"),
    ]  # fmt: skip
    if not is_nested:
        columns.append(Column("area", "R", 1, "N", "Area that both share in squared units of x and y"))
    return Layout("Parents of Faces", tuple(columns))


def own_layout() -> Layout:
    """Layout of `own.rat`."""
    further = (
        Column("class_id", "I", 1, "N", "Class as row of class.rat"),
        Column("feature_id", "I", 1, "N", "Feature as row of the table of the class"),
        Column("share", "R", 1, "N", "Share of the area of the face"),
    )
    return Layout("Features That Faces Have by Themselves", (ID, TILE, FACE, *further))


def junction_layout() -> Layout:
    """Layout of `tjunct.rat`."""
    further = (
        Column("cnd_id", "I", 1, "N", "Node that is no corner of the face"),
        Column("gap", "R", 1, "N", "Height of the node above the edge in metres"),
    )
    return Layout("Nodes Inside Edges of Faces", (ID, TILE, FACE, *further))


def write_level(coverage: Folder, store: StoreReader, level: int) -> None:
    """Write `level.rat`."""
    line = store.levels[level]
    columns = (
        ID, Column("level", "S", 1, "N", "Level from 0 the coarsest"),
        *(Column(name, "R", 1, "N", f"{name.replace('_', ' ').capitalize()} in metres") for name in METRES),
        Column("post_count", "T", -1, "N", "Posts measured"),
        *(Column(name, "I", 1, "N", f"Number of {name.split('_')[0]}s of all tiles") for name in COUNTS),
        *(Column(name, "I", 1, "N", f"Cuts of kind {name.replace('_', ' ')}") for name in CUTS),
    )  # fmt: skip
    values: list[Any] = [
        1, level, *(np.nan if value is None else value for value in line[1:5]), str(line.posts),
        line.nodes, line.edges, line.faces, *store.cuts[level].tolist(),
    ]  # fmt: skip
    rows = {column.name: [value] for column, value in zip(columns, values, strict=True)}
    coverage.write("level.rat", Layout("Level of the Hierarchy", columns), rows)


def write_whole(coverage: Folder, store: StoreReader, tables: Sequence[ClassTable], *, is_double: bool) -> None:
    """Write what is said once, in `tin0`: `evpf.rat`, `source.rat`, and where there are classes their definitions."""
    kept = "" if is_double else "WHERE name <> 'coordinate_precision' "  # the precision of the directory says it
    metadata = store.raw(f"SELECT name, value FROM metadata {kept}ORDER BY name")
    tile_size = store.metadata["options"]["tile_size"]
    own = EVPF_VERSION, "double" if is_double else "single", str(len(store.levels)), str(tile_size)
    names, values = zip(*zip(HEAD, own, strict=True), *metadata, strict=True)
    _write(coverage, "evpf.rat", "What the Store Knows", {"name": list(names), "value": list(values)}, {})
    sources = store.sources
    fixed = {"sha256": Column("sha256", "T", 64, "N", "Digest of the file")}
    columns = {name: [str(source[name]) for source in sources] for name in ("name", "sha256", "byte_count", "driver")}
    _write(coverage, "source.rat", "Files the Store Is Made Of", columns, fixed)
    if tables:
        _write_classes(coverage, tables)


def _write_classes(coverage: Folder, tables: Sequence[ClassTable]) -> None:
    """Write `class.rat`, `column.rat` and `value.rat`."""
    classes: dict[str, list[Any]] = {
        "name": [table.stored.name for table in tables],
        "description": [table.stored.description for table in tables],
        "fclass": [coverage.named(table.name) for table in tables],
        "store_id": [table.stored.class_id for table in tables],
    }
    fixed = {
        "fclass": Column("fclass", "T", 8, "U", "Feature class"),
        "store_id": Column("store_id", "I", 1, "U", "Class in the store"),
    }
    _write(coverage, "class.rat", "Feature Classes of the Store", classes, fixed)
    rows = [
        (i + 1, name, table.column_names[name], column.kind, column.unit, column.description)
        for i, table in enumerate(tables)
        for name, column in table.stored.columns.items()
    ]
    names = ("class_id", "name", "vpf_name", "kind", "unit", "description")
    fixed = {
        "class_id": Column("class_id", "I", 1, "N", "Class as row of class.rat"),
        "vpf_name": Column("vpf_name", "T", 16, "N", "Column in the table of the class"),
        "kind": Column("kind", "T", 7, "N", "Kind of the values"),
    }
    _write(coverage, "column.rat", "Columns of Feature Classes", _columns(names, rows), fixed)
    row_of = {(row[0], row[1]): i + 1 for i, row in enumerate(rows)}
    values = [
        (row_of[i + 1, column], value, description)
        for i, table in enumerate(tables)
        for column, value, description in table.values
    ]
    fixed = {"column_id": Column("column_id", "I", 1, "N", "Column as row of column.rat")}
    columns = _columns(("column_id", "value", "description"), sorted(values))
    _write(coverage, "value.rat", "Descriptions of Values", columns, fixed)


def _columns(names: Sequence[str], rows: Sequence[Sequence[Any]]) -> dict[str, list[Any]]:
    return {name: [row[i] for row in rows] for i, name in enumerate(names)}


def _write(
    coverage: Folder, name: str, description: str, values: Mapping[str, list[Any]], fixed: Mapping[str, Column]
) -> None:  # fmt: skip
    """Write a table whose columns are texts of any length, but for those given."""
    n_row = len(next(iter(values.values())))
    columns, written = [ID], dict[str, Any](id=list(range(1, n_row + 1)))
    for column_name, given in values.items():
        column, data = (fixed[column_name], given) if column_name in fixed else text_column(column_name, given)
        columns.append(column._replace(description=column.description or column_name.replace("_", " ").capitalize()))
        written[column_name] = data
    coverage.write(name, Layout(description, tuple(columns)), written)
