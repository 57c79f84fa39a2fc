"""Rules V783, V784: classes of attributes, and which faces have their features."""

from __future__ import annotations

import filecmp
from collections.abc import Iterator
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.validate.report import ERROR, Defects, Rule, one, some
from vpfx.validate.vpf.evpf_data import EvpfData, EvpfTile, LevelTables, spacing_of
from vpfx.validate.vpf.evpf_tables import check_layout
from vpfx.validate.vpf.evpf_tiles import TILE, face_shapes
from vpfx.validate.vpf.folders import TableData, numbers
from vpfx.validate.vpf.parts import MOST_LISTED, names_of
from vpfx.validate.vpf.shares import Pairs, Step, inherited
from vpfx.vpf.header import Layout

__all__ = ["RULES", "Inheritance"]

Ids = NDArray[np.int64]
Floats = NDArray[np.float64]

KINDS = {"text": "TL", "integer": "ITL", "real": "R", "date": "D"}
"""Kinds of columns (R-221), and the types they are written in."""
ROUNDING = 1e-9
"""By which shares of a face may be more than 1 in all (R-224)."""
SHARE_ERROR = 1e-6
"""By which a share may differ from that found again from rounded areas, beside what the rounding of coordinates does."""


class Classes(NamedTuple):
    """Rows of ``class.rat`` that are of use."""

    table: TableData
    names: list[str]  # of feature classes, by row


def _classes(data: EvpfData) -> Classes | None:
    table = data.levels[0].coverage.folder.table("class.rat")
    return None if table is None or table.head is None else Classes(table, names_of(table, "fclass"))


def check_classes(data: EvpfData) -> Iterator[Defects]:
    """Each class has its tables in every coverage, with the columns that ``column.rat`` names."""
    classes = _classes(data)
    if classes is None:
        return
    for i, name in enumerate(classes.names):
        first: TableData | None = None
        for level in data.levels:
            features, joins = (level.coverage.folder.table(f"{name}.{suffix}") for suffix in ("aft", "ajt"))
            if features is None or joins is None or level.coverage.kinds.get(name, ("", "", ""))[1] != "A":
                expected = f"expected {name}.aft and .ajt in {level.where}, and a row A in its fca"
                yield one(f"table={classes.table.where} row={i + 1}", f"found class {name!r}, {expected}")
                return
            yield from check_layout(joins, f"{name}_id I share R tile_id S fac_id I")
            first = first or features
            if not filecmp.cmp(first.path, features.path, shallow=False):
                yield one(
                    f"table={features.where}", f"found another table than {first.where}, expected the same features"
                )
    yield from _check_columns(data, classes)
    columns, values = (data.levels[0].coverage.folder.table(name) for name in ("column.rat", "value.rat"))
    if columns is not None and values is not None:
        of_value = numbers(values.rows, "column_id")
        if of_value is not None:
            wrong = np.flatnonzero((of_value < 1) | (of_value > columns.n_row))
            message = "found column {}, expected a row of column.rat".format
            yield from some(wrong, lambda i: (f"table={values.where} row={i + 1}", message(of_value[i])))


def _check_columns(data: EvpfData, classes: Classes) -> Iterator[Defects]:
    table = data.levels[0].coverage.folder.table("column.rat")
    rows = None if table is None else table.rows
    class_id = numbers(rows, "class_id")
    if table is None or class_id is None:
        return
    if table.n_row > MOST_LISTED:
        yield one(f"table={table.where}", f"found {table.n_row} rows, expected at most {MOST_LISTED}")
        return
    named: dict[int, list[str]] = {}
    for i, (own, name, kind) in enumerate(
        zip(class_id.tolist(), names_of(table, "vpf_name"), names_of(table, "kind"), strict=True)
    ):
        where = f"table={table.where} row={i + 1}"
        if not 1 <= own <= len(classes.names):
            yield one(where, f"found class {own}, expected a row of class.rat")
            continue
        features = data.levels[0].coverage.folder.table(f"{classes.names[own - 1]}.aft")
        column = None if features is None or features.head is None else features.head.layout.find(name)
        if column is None:
            yield one(where, f"found column {name!r}, expected one of {classes.names[own - 1]}.aft")
        elif column.kind not in KINDS.get(kind, ""):
            yield one(where, f"found kind {kind!r} of a column of type {column.kind}, expected one that goes with it")
        named.setdefault(own, []).append(name)
    for i, class_name in enumerate(classes.names, 1):
        features = data.levels[0].coverage.folder.table(f"{class_name}.aft")
        if features is not None and features.head is not None:
            found, expected = _names(features.head.layout), ["id", *named.get(i, []), "store_id"]
            if found != expected:
                yield one(f"table={features.where}", f"found columns {found}, expected {expected}"[:300])


def _names(layout: Layout) -> list[str]:
    return [column.name.lower() for column in layout.columns]


class Inheritance:
    """Faces of all levels with their areas and links, gathered tile by tile, where the store has classes."""

    def __init__(self, data: EvpfData) -> None:
        self.data = data
        self.classes = _classes(data)
        self._areas: list[tuple[Floats, Floats]] = []
        self._links: dict[int, list[tuple[Ids, Ids, Floats]]] = {}

    def add(self, tile: EvpfTile) -> None:
        """Add the faces of a tile of the finest level, or links from a level to the one before."""
        if self.classes is None:
            return
        level, first = tile.level.number, tile.level.first_row("tinface.aft", tile.tile_id)
        rows = tile.rows("parent.rat")
        if tile.before is not None and rows is not None:
            before = tile.before.level.first_row("tinface.aft", tile.tile_id)
            child, parent = tile.column("parent.rat", "child_id"), tile.column("parent.rat", "parent_id")
            shared = rows["area"] if "area" in rows else np.ones(len(child))
            self._links.setdefault(level, []).append((before + parent - 2, first + child - 2, shared))
        if level == len(self.data.levels) - 1 and tile.has_three_corners:
            _, area, perimeter = face_shapes(tile)
            self._areas.append((area, perimeter))

    @cached_property
    def steps(self) -> list[Step]:
        """Links of each level to the one before, from coarse to fine; the share of the child in each."""
        steps = []
        for level in range(1, len(self.data.levels)):
            parts = self._links.get(level, [(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0))])
            parent, child, shared = (np.concatenate(column) for column in zip(*parts, strict=True))
            steps.append(Step(parent, child, shared / np.bincount(child, shared)[child]))
        return steps

    @cached_property
    def areas(self) -> tuple[Floats, Floats]:
        """Area and perimeter of the faces of the finest level."""
        if not self._areas:
            return np.empty(0), np.empty(0)
        area, perimeter = (np.concatenate(parts) for parts in zip(*self._areas, strict=True))
        return area, perimeter


def _faces_of(level: LevelTables, tile: Ids, face: Ids) -> Ids:
    """Row of faces in ``tinface.aft``, from 0; -1 where there is no such row."""
    tiles = level.rows["tinface.aft"].tiles
    first, last = np.searchsorted(tiles, tile, side="left"), np.searchsorted(tiles, tile, side="right")
    row = first + face - 2
    return np.where((face >= 2) & (row < last), row, -1)


def check_own(level: LevelTables) -> Iterator[Defects]:
    """``own.rat`` names faces, classes and features that are there; shares are parts of a face."""
    classes = _classes(level.evpf)
    table = level.coverage.folder.table("own.rat")
    rows = None if table is None else table.rows
    columns = [numbers(rows, name) for name in ("tile_id", "fac_id", "class_id", "feature_id")]
    if classes is None or table is None or rows is None or any(column is None for column in columns):
        return
    tile, face, class_id, feature = (column for column in columns if column is not None)
    share = rows["share"]
    counts = [0] + [_count(level, f"{name}.aft") for name in classes.names]
    is_class = (class_id >= 1) & (class_id < len(counts))
    count = np.array(counts)[np.where(is_class, class_id, 0)]
    is_wrong = ~is_class | (feature < 1) | (feature > count) | (_faces_of(level, tile, face) < 0)
    is_wrong |= ~((share > 0) & (share <= 1 + ROUNDING))
    keys = np.column_stack([tile, face, class_id, feature])
    step = np.sign(keys[1:] - keys[:-1])
    first = np.argmax(step != 0, axis=1) if len(step) else np.empty(0, np.int64)
    is_wrong[1:] |= step[np.arange(len(step)), first] <= 0
    where = f"table={table.where}"
    message = "found feature {} of class {} on face {} of tile {} with share {}, expected rows that are there, in order".format
    wrong = np.flatnonzero(is_wrong)
    yield from some(
        wrong, lambda i: (f"{where} row={i + 1}", message(feature[i], class_id[i], face[i], tile[i], share[i]))
    )
    if not len(wrong) and len(keys):
        different, at, group = np.unique(keys[:, :3], axis=0, return_index=True, return_inverse=True)
        total = np.bincount(group.ravel(), share)
        text = "found shares of {} in all on face {} of tile {}, expected at most 1".format
        far = np.flatnonzero(total > 1 + ROUNDING)
        yield from some(far, lambda i: (f"{where} row={at[i] + 1}", text(total[i], different[i, 1], different[i, 0])))


def _count(level: LevelTables, name: str) -> int:
    table = level.coverage.folder.table(name)
    return 0 if table is None else table.n_row


def _own(level: LevelTables, class_id: int) -> Pairs:
    """Faces of a level with the features of a class that they have by themselves."""
    table = level.coverage.folder.table("own.rat")
    rows = None if table is None else table.rows
    if rows is None:
        return Pairs.none()
    tile, face, own, feature = (numbers(rows, name) for name in ("tile_id", "fac_id", "class_id", "feature_id"))
    if tile is None or face is None or own is None or feature is None:
        return Pairs.none()
    kept = own == class_id
    return Pairs(_faces_of(level, tile[kept], face[kept]), feature[kept], rows["share"][kept])


def check_inherited(data: Inheritance) -> Iterator[Defects]:
    """``<class>.ajt`` has what each face has by inheritance (R-234)."""
    if data.classes is None or len(data.areas[0]) != _count(data.data.levels[-1], "tinface.aft"):
        return
    area, perimeter = data.areas
    ulp = spacing_of(data.data)
    for class_id, name in enumerate(data.classes.names, 1):
        own = [_own(level, class_id) for level in data.data.levels]
        counts = [_count(level, "tinface.aft") for level in data.data.levels]
        for level, (expected, slack) in zip(
            data.data.levels, inherited(own, counts, data.steps, area, perimeter * ulp), strict=True
        ):
            table = level.coverage.folder.table(f"{name}.ajt")
            if table is not None and table.rows is not None:
                yield from _compare(level, table, f"{name}_id", expected, slack)


def _compare(level: LevelTables, table: TableData, key: str, expected: Pairs, slack: Floats) -> Iterator[Defects]:
    """Compare a join table with the features that faces should have; `slack` by face."""
    tile, face, feature = (numbers(table.rows, name) for name in ("tile_id", "fac_id", key))
    if tile is None or face is None or feature is None or table.rows is None:
        return
    found = Pairs(_faces_of(level, tile, face), feature, table.rows["share"])
    features = np.concatenate([found.feature, expected.feature])
    n_found, n_feature = len(found.face), int(features.max(initial=0)) + 1
    both = np.concatenate([found.face, expected.face]) * n_feature + features
    different, first, pair = np.unique(both, return_index=True, return_inverse=True)
    told = np.bincount(pair[:n_found], found.share, minlength=len(different))
    wanted = np.bincount(pair[n_found:], expected.share, minlength=len(different))
    of_face, of_feature = np.divmod(different, n_feature)
    far = np.abs(told - wanted) > SHARE_ERROR + slack[np.maximum(of_face, 0)]
    wrong = np.flatnonzero(far)
    message = "found share {:.9g} of feature {} on face {} of tinface.aft, expected {:.9g}".format

    def describe(i: int) -> tuple[str, str]:
        row = f" row={first[i] + 1}" if first[i] < n_found else ""
        return f"table={table.where}{row}", message(told[i], of_feature[i], of_face[i] + 1, wanted[i])

    yield from some(wrong, describe)


RULES = (
    Rule("V783", "evpf_classes", ERROR, "E-430", "a class of attributes is not described as it is", check_classes, "evpf",
         needs=("evpf_tables", "evpf_metadata")),
    Rule("V784", "evpf_own", ERROR, "E-430", "a face has by itself what is not there", check_own, "evpf level",
         needs=("evpf_classes", "evpf_features")),
    Rule("V787", "evpf_shares", ERROR, "E-310", "a face has another share of a feature than it inherits", check_inherited,
         "evpf shares", needs=(*TILE, "evpf_rings", "evpf_junctions", "evpf_links", "evpf_classes", "evpf_own")),
)  # fmt: skip
