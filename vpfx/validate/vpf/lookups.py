"""Rules V754 to V757: thematic indexes, and the tables that lead from primitives back to features."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vpfx.validate.report import ERROR, WARNING, Defects, Rule, Tally, one, some
from vpfx.validate.vpf.folders import TableData, numbers, read_index
from vpfx.validate.vpf.parts import CoverageData
from vpfx.vpf import thematic_index
from vpfx.vpf.layouts import PRIMITIVES
from vpfx.vpf.schema import FeatureClass
from vpfx.vpf.table import Ragged, Table

__all__ = ["RULES"]

Ids = NDArray[np.int64]

THEMATIC = re.compile(r".+\.[placjtf]ti")
MIX = (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB)
"""Odd numbers that spread bits. Source: SplitMix64."""


def _indexes(coverage: CoverageData) -> Iterator[tuple[str, thematic_index.ThematicIndex | None, str]]:
    """Thematic indexes of a coverage, each with its place and what is wrong with its bytes."""
    for name, path in sorted(coverage.folder.files.items()):
        if THEMATIC.fullmatch(name):
            yield f"index={coverage.folder.place(path.name)}", *read_index(path, thematic_index.read)


def _indexed(coverage: CoverageData, index: thematic_index.ThematicIndex) -> tuple[TableData | None, str]:
    """The table and the column that an index is about."""
    return coverage.folder.table(index.table_name), index.column_name.split("\\")[0]


def check_thematic(coverage: CoverageData) -> Iterator[Defects]:
    """A thematic index is about a table and column that are there, and knows their rows."""
    for where, index, problem in _indexes(coverage):
        if index is None:
            yield one(where, problem)
            continue
        table, column = _indexed(coverage, index)
        if table is None or table.head is None:
            yield one(where, f"found table {index.table_name!r} named, expected one that is there")
        elif table.head.layout.find(column) is None:
            yield one(where, f"found column {column!r} of {table.name} named, expected one that it has")
        elif index.n_row != table.n_row:
            yield one(where, f"found {index.n_row} rows, expected {table.n_row} as {table.name} has")
        elif index.is_sorted and not index.is_rising:
            yield one(where, "found values in disorder, expected them sorted as the header says")


def check_thematic_rows(coverage: CoverageData) -> Iterator[Defects]:
    """A thematic index has each row once, at the value that the row has."""
    for where, index, _ in _indexes(coverage):
        table, column = (None, "") if index is None else _indexed(coverage, index)
        if index is None or table is None or table.head is None or index.index_type not in "IT":
            continue
        of_row = np.full(table.n_row + 1, -1, np.int64)
        value = np.repeat(np.arange(len(index.values)), np.diff(index.starts))
        if len(index.ids) and index.ids.max() > table.n_row:
            continue
        of_row[index.ids] = value
        tally = Tally()
        again = int((np.bincount(index.ids, minlength=1) > 1).sum())
        if again:
            tally.tell(where, f"found {again} rows twice, expected each once")
        for start, rows in table.batches():
            if column in rows:
                _compare_values(tally, where, index, of_row[start + 1 : start + rows.n_row + 1], rows[column], start)
        yield from tally.defects()


def _compare_values(
    tally: Tally, where: str, index: thematic_index.ThematicIndex, value: Ids, column: Any, start: int
) -> None:
    """Compare the values of rows with those at which an index has them."""
    if isinstance(column, Ragged) or len(index.values) == 0:
        return
    own = column[:, 0] if column.dtype.kind == "i" and column.shape[1:] == (3,) else column  # of triplets the ids
    if own.ndim > 1:
        return
    if (own.dtype.kind == "S") != (index.values.dtype.kind == "S"):
        return
    known = index.values[np.maximum(value, 0)]
    own = np.char.rstrip(own) if own.dtype.kind == "S" else own
    is_same = own == known
    if own.dtype.kind == "f":
        is_same |= np.isnan(own) & np.isnan(known)
    wrong = np.flatnonzero((value >= 0) & ~is_same)
    tally.add(
        wrong, lambda i: (f"{where} row={start + i + 1}", f"found the row at value {known[i]!r}, expected {own[i]!r}")
    )
    lost = np.flatnonzero(value < 0)
    tally.add(
        lost, lambda i: (f"{where} row={start + i + 1}", f"found no entry for the row, expected one at {own[i]!r}")
    )


def _mixed(*columns: Ids) -> NDArray[np.uint64]:
    """One number for the numbers of each row; different rows have different ones, for all that matters."""
    mixed = np.zeros(len(columns[0]), np.uint64)
    for column in columns:
        mixed = (mixed ^ column.astype(np.uint64)) * np.uint64(MIX[0])
        mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(MIX[1])
        mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(MIX[2])
        mixed ^= mixed >> np.uint64(31)
    return mixed


def _tiles(rows: Table, count: int) -> Ids:
    tiles = numbers(rows, "tile_id")
    return np.zeros(count, np.int64) if tiles is None else tiles


def _features(coverage: CoverageData, feature_class: FeatureClass) -> Iterator[tuple[int, Ids, Ids, Ids]]:
    """Primitives of the features of a class, in parts: index of the first row, tile, primitive, feature."""
    join = feature_class.join
    table = coverage.folder.table(feature_class.table if join is None else join.table)
    if table is None:
        return
    for start, rows in table.batches():
        ids = numbers(rows, feature_class.prim_key)
        own = np.arange(start + 1, start + rows.n_row + 1) if join is None else numbers(rows, join.feature_key)
        if ids is not None and own is not None:
            yield start, _tiles(rows, rows.n_row), ids, own


def _fits(coverage: CoverageData) -> Iterator[tuple[TableData, dict[int, FeatureClass]]]:
    """Feature indexes of a coverage, each with the classes on its primitive by their rows in ``fca``."""
    fca = coverage.folder.table("fca")
    names = [] if fca is None or fca.head is None else list(coverage.kinds)
    for primitive in PRIMITIVES:
        table = coverage.folder.table(f"{primitive}.fit")
        if table is not None and table.head is not None:
            rows = {i: coverage.classes.get(name) for i, name in enumerate(names, 1)}
            yield table, {i: known for i, known in rows.items() if known is not None and known.primitive == primitive}


def _of_classes(coverage: CoverageData, classes: dict[int, FeatureClass]) -> NDArray[np.uint64]:
    """All primitives of features of some classes, as numbers of `_mixed`, rising."""
    parts = [
        _mixed(np.full(len(ids), row), tile, ids, own)
        for row, feature_class in classes.items()
        for _, tile, ids, own in _features(coverage, feature_class)
    ]
    return np.sort(np.concatenate(parts)) if parts else np.empty(0, np.uint64)


def _has(known: NDArray[np.uint64], asked: NDArray[np.uint64]) -> NDArray[np.bool_]:
    """Tell which numbers are among known ones that rise."""
    at = np.searchsorted(known, asked)
    found: NDArray[np.bool_] = (
        np.zeros(len(asked), bool) if not len(known) else known[np.minimum(at, len(known) - 1)] == asked
    )
    return found


def _fit_columns(rows: Table) -> tuple[Ids, Ids, Ids, Ids] | None:
    """Class, tile, primitive and feature of the rows of a feature index."""
    class_id = numbers(rows, "fc_id" if "fc_id" in rows else "fca_id")
    ids, own = numbers(rows, "prim_id"), numbers(rows, "feature_id")
    return None if class_id is None or ids is None or own is None else (class_id, _tiles(rows, rows.n_row), ids, own)


def _of_rows(table: TableData) -> NDArray[np.uint64]:
    """All rows of a feature index, as numbers of `_mixed`, rising."""
    parts = [_mixed(*columns) for _, rows in table.batches() if (columns := _fit_columns(rows)) is not None]
    return np.sort(np.concatenate(parts)) if parts else np.empty(0, np.uint64)


def check_fit(coverage: CoverageData) -> Iterator[Defects]:
    """A row of a feature index names a feature that has the primitive."""
    for table, classes in _fits(coverage):
        known, tally = _of_classes(coverage, classes), Tally()
        if np.array_equal(known, _of_rows(table)):
            continue
        for start, rows in table.batches():
            columns = _fit_columns(rows)
            if columns is None:
                break
            wrong = np.flatnonzero(~_has(known, _mixed(*columns)))
            tally.add(wrong, _describe_fit(table, start, columns))
        yield from tally.defects()


def _describe_fit(table: TableData, start: int, columns: tuple[Ids, ...]) -> Callable[[int], tuple[str, str]]:
    def describe(i: int) -> tuple[str, str]:
        class_id, tile, ids, own = (column[i] for column in columns)
        message = (
            f"found feature {own} of class {class_id} for primitive {ids} of tile {tile}, expected one that has it"
        )
        return f"table={table.where} row={start + i + 1}", message

    return describe


def check_fit_gaps(coverage: CoverageData) -> Iterator[Defects]:
    """A feature index has a row for each feature and primitive of its classes."""
    for table, classes in _fits(coverage):
        known = _of_rows(table)
        if np.array_equal(known, _of_classes(coverage, classes)):
            continue
        for row, feature_class in classes.items():
            for _, tile, ids, own in _features(coverage, feature_class):
                lost = np.flatnonzero(~_has(known, _mixed(np.full(len(ids), row), tile, ids, own)))
                yield from some(lost, _describe_gap(table, feature_class, own, ids))


def _describe_gap(
    table: TableData, feature_class: FeatureClass, own: Ids, ids: Ids
) -> Callable[[int], tuple[str, str]]:
    return lambda i: (
        f"table={table.where}",
        f"found no row for feature {own[i]} of {feature_class.name} on primitive {ids[i]}, expected one",
    )


SOUND = ("table_header", "table_rows", "table_columns")

RULES = (
    Rule("V754", "thematic_index", ERROR, "V-350", "a thematic index does not fit its table", check_thematic, "lookups",
         needs=SOUND),
    Rule("V755", "thematic_rows", ERROR, "V-351", "a thematic index has a row at another value", check_thematic_rows, "lookups",
         needs=(*SOUND, "thematic_index")),
    Rule("V756", "feature_index", ERROR, "V-253", "a feature index names a feature that does not have the primitive", check_fit,
         "lookups", needs=(*SOUND, "relations", "feature_references")),
    Rule("V757", "feature_index_gaps", WARNING, "V-253", "a feature index leaves features out", check_fit_gaps, "lookups",
         needs=(*SOUND, "relations", "feature_references", "feature_index")),
)  # fmt: skip
