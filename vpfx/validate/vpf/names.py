"""Rules V71x: what there is and what should be, and what names lead to."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

from vpfx.validate.report import ERROR, WARNING, Defects, Rule, one, some
from vpfx.validate.vpf.folders import Folder, TableData, kind_of
from vpfx.validate.vpf.parts import CoverageData, DatabaseData, LibraryData, names_of
from vpfx.validate.vpf.tables import ScannedTable
from vpfx.validate.vpf.tile import TileData
from vpfx.vpf.header import Layout
from vpfx.vpf.layouts import PRIMITIVES
from vpfx.vpf.schema import FEATURE_TABLE, JOIN_TABLE, Relation

__all__ = ["RULES", "FolderData"]

ISO_NAME = re.compile(r"[A-Za-z0-9_]{1,8}(\.[A-Za-z0-9_]{1,3})?\.?")
INDEX_FILE = re.compile(
    r"(cnx|edx|enx|fax|rnx|txx|ebx|fbx|fcx|fcz|dqx|[ncefts]si|.*\.([plact]ti|[a-z]{2}x))\.?", re.IGNORECASE
)
MOST_NAMED = 12
"""Names that a message tells."""
MANDATORY = {"database": ("dht", "lat"), "library": ("lht", "grt", "cat"), "coverage": ("fcs",), "tile": ()}


class FolderData(NamedTuple):
    """A folder and what it is.

    Attributes
    ----------
    folder : Folder
    kind : str
        database, library, coverage or tile.
    listed, there : dict
        Of a database its libraries, of a library its coverages: by the list in it, and on the disk.
    tile : TileData or None
        The primitives in it, if there are any.
    """

    folder: Folder
    kind: str
    listed: tuple[str, ...] = ()
    there: tuple[str, ...] = ()
    tile: TileData | None = None

    @property
    def place(self) -> str:
        """What findings call it."""
        return f"folder={self.folder.where or '.'}"


def check_names(data: FolderData) -> Iterator[Defects]:
    """Files and folders of VPF have short names that every file system takes."""
    names = [path.name for name, path in data.folder.files.items() if kind_of(name) or INDEX_FILE.fullmatch(name)]
    names += [path.name for name, path in data.folder.folders.items() if name in {*data.listed, *data.there}]
    long = [name for name in names if not ISO_NAME.fullmatch(name)]
    expected = "expected up to 8 letters, digits or underscores, and 3 behind a dot"
    yield from some(range(len(long)), lambda i: (data.place, f"found the name {long[i][:60]!r}, {expected}"))
    for name in data.folder.outside:
        yield one(data.place, f"found {name[:60]!r}, a link that leads out of the database, or no file: it is not read")


def check_missing(data: FolderData) -> Iterator[Defects]:
    """Tables that no reader does without are there."""
    if data.folder.problem:
        yield one(data.place, data.folder.problem)
        return
    wanted = list(MANDATORY[data.kind])
    files, tile = data.folder.files, data.tile
    level = None if tile is None else tile.level if "edg" in files else tile.coverage.level
    if level is not None:
        wanted += ["edg", "cnd"] if level >= 1 and {"edg", "cnd", "fac", "rng"} & set(files) else []
        wanted += ["fac", "rng"] if level >= 3 and {"edg", "fac", "rng"} & set(files) else []
    if data.kind == "coverage" and not any(FEATURE_TABLE.fullmatch(name) for name in files):
        wanted.remove("fcs")
    if "tileref" in data.there and data.folder.below("tileref"):
        tileref = data.folder.below("tileref")
        if tileref is not None and not any(name.endswith(".aft") for name in tileref.files):
            yield one(f"folder={tileref.where}", "found no feature table of tiles, expected tileref.aft")
    missing = [name for name in wanted if name not in files]
    yield from some(range(len(missing)), lambda i: (data.place, f"found no table {missing[i]!r}, expected it"))


def check_listed(data: FolderData) -> Iterator[Defects]:
    """Libraries of ``lat`` and coverages of ``cat`` are on the disk, and those on the disk are in the list."""
    name, what = ("lat", "libraries") if data.kind == "database" else ("cat", "coverages")
    if data.kind not in ("database", "library") or name not in data.folder.files:
        return
    gone = [entry for entry in data.listed if entry not in data.there]
    if gone:
        message = f"found no folder for {len(gone)} of its {len(data.listed)} {what}: {_names(gone)}"
        yield one(f"table={data.folder.place(name)}", message)
    header, column = ("dht", "database_name") if data.kind == "database" else ("lht", "library_name")
    told = names_of(data.folder.table(header), column)[:1]
    if told and told[0] != data.folder.path.name.lower():
        message = f"found name {told[0]!r}, expected {data.folder.path.name!r} as the folder is called"
        yield one(f"table={data.folder.place(header)} column={column}", message)
    more = [entry for entry in data.there if entry not in data.listed]
    if more:
        yield one(
            f"table={data.folder.place(name)}", f"found no row for {len(more)} {what} on the disk: {_names(more)}"
        )


def _names(names: list[str]) -> str:
    shown = ", ".join(name[:30] for name in names[:MOST_NAMED])
    return shown if len(names) <= MOST_NAMED else f"{shown} …"


def _layout_of(coverage: CoverageData, name: str) -> tuple[Layout | None, bool]:
    """Layout of a table of a coverage, of primitives in the first tile that has it; and whether there is such a file."""
    is_in_tiles = name.strip(".").lower() in PRIMITIVES and coverage.is_tiled
    for folder in map(coverage.tile_folder, coverage.tile_ids if is_in_tiles else [0]):
        table = None if folder is None else folder.table(name)
        if table is not None:
            return None if table.head is None else table.head.layout, True
    return None, False


def check_relations(coverage: CoverageData) -> Iterator[Defects]:
    """Tables and columns that ``fcs`` names are there."""
    table = coverage.folder.table("fcs")
    if table is None or table.head is None:
        return
    if coverage.schema_problem:
        yield one(f"table={table.where}", coverage.schema_problem)
    layouts: dict[str, tuple[Layout | None, bool]] = {}
    for relation in coverage.relations:
        for name, key in ((relation.table1, relation.key1), (relation.table2, relation.key2)):
            if name not in layouts:
                layouts[name] = _layout_of(coverage, name)
            layout, is_there = layouts[name]
            where = f"table={table.where} row={relation.row}"
            if not is_there:
                yield one(where, f"found table {name!r} named, expected one that is there")
            elif layout is not None and layout.find(key) is None:
                yield one(where, f"found column {key!r} of {name} named, expected one that it has")


def check_order(coverage: CoverageData) -> Iterator[Defects]:
    """In ``fcs`` the way from a class to its primitives comes first, step by step."""
    table = coverage.folder.table("fcs")
    if table is None:
        return
    by_class: dict[str, list[Relation]] = {}
    for relation in coverage.relations:
        by_class.setdefault(relation.feature_class.lower(), []).append(relation)
    for name, relations in by_class.items():
        where = f"table={table.where} row={relations[0].row}"
        joins = [relation for relation in relations if JOIN_TABLE.fullmatch(relation.table1)]
        forward = [relation for relation in joins if _is_primitive(relation.table2)]
        if not FEATURE_TABLE.fullmatch(relations[0].table1):
            yield one(where, f"found {relations[0].table1} first of class {name}, expected its feature table")
        elif forward and any(relation.row < forward[0].row for relation in relations if _is_primitive(relation.table1)):
            yield one(where, f"found a way back before {forward[0].table1} leads on, expected it behind")
        elif name not in coverage.classes:
            yield one(where, f"found no way from class {name} to primitives, expected one")


def _is_primitive(name: str) -> bool:
    return name.rstrip(".").lower() in PRIMITIVES


def check_classes(coverage: CoverageData) -> Iterator[Defects]:
    """``fca`` lists the classes of ``fcs``, with the types of their tables."""
    table = coverage.folder.table("fca")
    if table is None or table.head is None or coverage.folder.table("fcs") is None:
        return
    where = f"table={table.where}"
    classes = {name for name in coverage.classes if ":" not in name}
    gone = sorted(set(coverage.kinds) - classes)
    if gone:
        yield one(where, f"found classes that fcs does not lead from: {_names(gone)}")
    new = sorted(classes - set(coverage.kinds))
    if new:
        yield one(where, f"found no row for classes of fcs: {_names(new)}")
    for name in sorted(classes & set(coverage.kinds)):
        kind, form = coverage.kinds[name][1], FEATURE_TABLE.fullmatch(coverage.classes[name].table)
        if form is not None and kind != form[2].upper():
            yield one(where, f"found type {kind!r} for class {name}, expected {form[2].upper()!r} as its table has")


def check_files(data: ScannedTable) -> Iterator[Defects]:
    """Tables of values, thematic indexes and narratives that a header names are there."""
    if data.head is None:
        return
    layout = data.head.layout
    named = {layout.narrative: ""}
    for column in layout.columns:
        named |= dict.fromkeys((column.value_table, column.index, column.narrative), column.name)
    for name, column_name in named.items():
        if name.strip("- ") and not _is_there(data.table, name):
            where = f"table={data.where}" + (f" column={column_name}" if column_name else "")
            yield one(where, f"found file {name[:40]!r} named, expected one that is there")


def _is_there(table: TableData, name: str) -> bool:
    key = name.strip().rstrip(".").lower()
    return key in table.folder.files or (table.above is not None and key in table.above.files)


def database_folder(data: DatabaseData) -> FolderData:
    """What the rules look at of a database."""
    return FolderData(data.folder, "database", tuple(data.listed), tuple(data.libraries))


def library_folder(data: LibraryData) -> FolderData:
    """What the rules look at of a library."""
    return FolderData(data.folder, "library", tuple(data.listed), tuple(data.coverage_paths))


RULES = (
    Rule("V710", "file_names", WARNING, "V-201", "a file or folder has a name that not every medium takes", check_names,
         "folder"),
    Rule("V711", "tables_missing", ERROR, "V-200", "a table that readers need is not there", check_missing, "folder"),
    Rule("V712", "parts_listed", WARNING, "V-203", "libraries or coverages are listed and not there, or there and not listed",
         check_listed, "folder", needs=("table_header", "table_rows", "table_columns")),
    Rule("V714", "relations", ERROR, "V-204", "the feature class schema names a table or column that is not there",
         check_relations, "coverage", needs=("table_header", "table_rows", "table_columns")),
    Rule("V715", "relation_order", ERROR, "V-204", "the feature class schema does not lead to primitives at once", check_order,
         "coverage", needs=("table_header", "table_rows", "table_columns", "relations")),
    Rule("V716", "class_lists", WARNING, "V-205", "the lists of feature classes differ", check_classes, "coverage",
         needs=("table_header", "table_rows", "table_columns", "relations", "relation_order")),
    Rule("V717", "files_named", WARNING, "V-250", "a header names a file that is not there", check_files, "table",
         needs=("table_header",)),
)  # fmt: skip
