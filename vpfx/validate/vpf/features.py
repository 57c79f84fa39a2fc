"""Rules V713, V718, V719: features, the primitives they name, and the values they have."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import VpfFormatError
from vpfx.validate.report import ERROR, NOTE, Defects, Rule, Tally, one
from vpfx.validate.vpf.folders import TableData, numbers
from vpfx.validate.vpf.parts import CoverageData, is_sound
from vpfx.vpf.header import Column
from vpfx.vpf.schema import FeatureClass, value_descriptions
from vpfx.vpf.table import Ragged, Table
from vpfx.vpf.values import is_null, texts

__all__ = ["RULES", "ClassData"]

Ids = NDArray[np.int64]

CODED = 0.5
"""Of the different values of a column: where that many are described, the column is one of codes."""
MOST_VALUES = 10_000
"""Different values of a column beyond which it is none of codes."""


class ClassData:
    """A feature class of a coverage, and what one pass over its tables found."""

    def __init__(self, coverage: CoverageData, feature_class: FeatureClass) -> None:
        self.coverage, self.feature_class = coverage, feature_class
        self.table = coverage.folder.table(feature_class.table)
        join = feature_class.join
        self.join = None if join is None else coverage.folder.table(join.table)

    @property
    def keys(self) -> tuple[str, ...]:
        """The tables that defects are about."""
        return tuple(table.where for table in (self.table, self.join) if table is not None)

    @property
    def primitives(self) -> TableData | None:
        """The table that names primitives."""
        return self.table if self.feature_class.join is None else self.join

    @cached_property
    def found(self) -> tuple[Tally, Tally]:
        """References that lead nowhere, and features on the universe."""
        wrong, universe = Tally(), Tally()
        table, name = self.primitives, self.feature_class
        if table is None or table.head is None or not name.primitive:
            return wrong, universe
        layout = table.head.layout
        if self.coverage.is_tiled and layout.find("tile_id") is None:
            wrong.tell(f"table={table.where}", "found no column 'tile_id', expected it in a library of tiles")
            return wrong, universe
        for start, rows in table.batches():
            self._check_primitives(rows, start, wrong, universe)
            if name.join is not None and self.table is not None:
                self._check_features(rows, start, wrong)
        return wrong, universe

    def _check_primitives(self, rows: Table, start: int, wrong: Tally, universe: Tally) -> None:
        table, name = self.primitives, self.feature_class
        ids, tiles = numbers(rows, name.prim_key), numbers(rows, "tile_id") if self.coverage.is_tiled else None
        if ids is None or table is None:
            return
        tiles = np.zeros_like(ids) if tiles is None else tiles
        count = self._counts(tiles)
        where = f"table={table.where} column={name.prim_key}"

        def describe(i: int) -> tuple[str, str]:
            tile = f" of tile {tiles[i]}" if self.coverage.is_tiled else ""
            found = f"row {ids[i]}" if ids[i] else "no row"
            expected = f"expected one of its {count[i]} rows" if count[i] >= 0 else "which is not there"
            return f"{where} row={start + i + 1}", f"found {found} of {name.primitive}{tile} named, {expected}"

        wrong.add(np.flatnonzero((ids < 1) | (ids > count)), describe)
        if name.primitive == "fac":
            on = np.flatnonzero(ids == 1)
            universe.add(
                on, lambda i: (f"{where} row={start + i + 1}", "found face 1, the universe, expected another face")
            )

    def _counts(self, tiles: Ids) -> Ids:
        """Rows of the primitives in each tile; -1 where there are none."""
        different, inverse = np.unique(tiles, return_inverse=True)
        counts = [self.coverage.count(self.feature_class.primitive, tile) for tile in different.tolist()]
        return np.array([-1 if count is None else count for count in counts], np.int64)[inverse]

    def _check_features(self, rows: Table, start: int, wrong: Tally) -> None:
        join, table = self.feature_class.join, self.join
        ids = None if join is None else numbers(rows, join.feature_key)
        if ids is None or join is None or table is None or self.table is None or self.table.head is None:
            return
        n_row = self.table.n_row
        where = f"table={table.where} column={join.feature_key}"
        expected = f"of {self.feature_class.table} named, expected one of its {n_row} rows"
        wrong.add(
            np.flatnonzero((ids < 1) | (ids > n_row)),
            lambda i: (f"{where} row={start + i + 1}", f"found row {ids[i]} {expected}"),
        )


def check_references(data: ClassData) -> Iterator[Defects]:
    """Features name primitives that exist, and joins name features that do."""
    yield from data.found[0].defects()


def check_universe(data: ClassData) -> Iterator[Defects]:
    """The universe is no feature."""
    yield from data.found[1].defects()


def check_values(data: ClassData) -> Iterator[Defects]:
    """Codes are described in the table of values that their column names."""
    table = data.table
    if table is None or table.head is None:
        return
    for column in table.head.layout.columns:
        if column.value_table.strip("- ") and column.kind in "TLIS" and column.name.lower() != "id":
            yield from _check_codes(data, table, column)


def _check_codes(data: ClassData, table: TableData, column: Column) -> Iterator[Defects]:
    described = _described(data.coverage, column.value_table, table.name, column.name)
    if not described:
        return
    seen: set[Any] = set()
    for _, rows in table.batches():
        seen.update(_different(rows[column.name], column))
        if len(seen) > MOST_VALUES:
            return
    unknown = sorted(seen - described, key=str)
    if unknown and len(unknown) <= CODED * len(seen):
        where = f"table={table.where} column={column.name}"
        found = f"found {len(unknown)} values that {column.value_table} does not describe, such as {unknown[0]!r}"
        yield one(where, f"{found}, expected each of the {len(seen)} described")


def _different(values: Any, column: Column) -> list[Any]:
    """The different values of a column, nulls left out."""
    if column.kind in "TL":
        texts_of = texts(values if isinstance(values, Ragged) else np.unique(values))
        return [text for text in set(texts_of) if text]
    numbers_of = values.values if isinstance(values, Ragged) else values.ravel()
    found: list[Any] = np.unique(numbers_of[~is_null(numbers_of, column.kind)]).tolist()
    return found


def _described(coverage: CoverageData, value_table: str, table: str, column: str) -> set[Any]:
    """Values of a column that are described."""
    found = coverage.folder.table(value_table)
    rows = None if found is None or not is_sound(found) else found.rows
    if rows is None:
        return set()
    try:
        described = value_descriptions(rows)
    except VpfFormatError:
        return set()
    return set(described.get((table, column.lower()), {}))


RULES = (
    Rule("V713", "universe_feature", ERROR, "V-504", "a feature is the universe", check_universe, "class",
         needs=("table_header", "table_rows")),
    Rule("V718", "feature_references", ERROR, "V-401", "a feature names a primitive that does not exist", check_references,
         "class", needs=("table_header", "table_rows")),
    Rule("V719", "values_described", NOTE, "V-207", "a code is not described", check_values, "class",
         needs=("table_header", "table_rows")),
)  # fmt: skip
