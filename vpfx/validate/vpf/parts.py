"""Database, libraries and coverages as the rules see them: what is on the disk, and what tables say should be.

::

    DatabaseData ─ libraries ─► LibraryData ─ coverages ─► CoverageData ─ tiles ─► TileFolder
                                    └ tiles: rows of tileref, the same for each coverage
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import VpfFormatError
from vpfx.model import Extent
from vpfx.validate.vpf.columns import missing_columns, wanted_columns, wrong_types
from vpfx.validate.vpf.folders import Folder, TableData, numbers, rectangles, text_values
from vpfx.vpf.layouts import PRIMITIVES
from vpfx.vpf.paths import split
from vpfx.vpf.schema import FeatureClass, Relation, classes_of, read_kinds, read_relations

__all__ = [
    "MOST_LISTED",
    "CoverageData",
    "DatabaseData",
    "LibraryData",
    "Target",
    "TileRow",
    "find_target",
    "is_sound",
    "names_of",
]

MOST_LISTED = 100_000
"""Rows of a list of libraries, coverages, classes or tiles that are looked at; the most seen are 5 000."""
UNKNOWN = 2**62
"""Number of rows of a table that cannot be read: whatever names one of them is not judged."""
LIBRARY_TABLES = {"cat", "lht", "grt"}
REFERENCES = ("libref", "tileref", "gazette")
"""Coverages that are never cut into tiles."""


class Target(NamedTuple):
    """What is to be checked: a database with its libraries, libraries alone, or coverages alone."""

    database: DatabaseData | None
    libraries: tuple[LibraryData, ...]
    coverages: tuple[CoverageData, ...]


class TileRow(NamedTuple):
    """A row of ``tileref.aft``."""

    tile_id: int
    name: str
    parts: tuple[str, ...]  # of the path; empty if the name is none
    face: int
    problem: str


class DatabaseData:
    """A database."""

    def __init__(self, folder: Folder) -> None:
        self.folder = folder

    @cached_property
    def listed(self) -> dict[str, Extent]:
        """Libraries of ``lat`` by their names in lower case."""
        table = self.folder.table("lat")
        boxes = rectangles(table)
        if boxes is None:
            return {}
        return {name: Extent(*box) for name, box in zip(names_of(table, "library_name"), boxes.tolist(), strict=False)}

    @cached_property
    def libraries(self) -> dict[str, LibraryData]:
        """Libraries on the disk: those of ``lat``, and folders that look like one."""
        found = {}
        for name, path in self.folder.folders.items():
            folder = Folder(self.folder.root, path, self.folder.place(path.name))
            if name in self.listed or LIBRARY_TABLES & set(folder.files):
                found[name] = LibraryData(self, folder, name)
        return found


class LibraryData:
    """A library."""

    def __init__(self, database: DatabaseData | None, folder: Folder, name: str) -> None:
        self.database, self.folder, self.name = database, folder, name

    @property
    def extent(self) -> Extent | None:
        """As ``lat`` has it."""
        return None if self.database is None else self.database.listed.get(self.name)

    @cached_property
    def listed(self) -> dict[str, int | None]:
        """Coverages of ``cat``, with their topology levels."""
        table = self.folder.table("cat")
        names = names_of(table, "coverage_name")
        levels = None if table is None else numbers(table.rows, "level")
        known = [None] * len(names) if levels is None else levels.tolist()
        return {name: level if level in range(4) else None for name, level in zip(names, known, strict=False)}

    @cached_property
    def data_type(self) -> str:
        """What coordinates are, as ``grt`` has it: GEO, MAP or TAB; empty if it says nothing."""
        table = self.folder.table("grt")
        values = None if table is None else text_values(table.rows, "data_type")
        return (values[0] or "") if values else ""

    @cached_property
    def coverage_paths(self) -> dict[str, Path]:
        """Folders of coverages on the disk: those of ``cat``, and those with a schema."""
        found = {}
        for name, path in self.folder.folders.items():
            if name in self.listed or "fcs" in Folder(self.folder.root, path, "").files:
                found[name] = path
        return found

    def coverage(self, name: str) -> CoverageData:
        """A coverage, read anew: what is read of it is kept no longer than it."""
        path = self.coverage_paths[name]
        return CoverageData(self, Folder(self.folder.root, path, self.folder.place(path.name)), name)

    @cached_property
    def tileref(self) -> CoverageData | None:
        """The coverage of tiles."""
        folder = self.folder.below("tileref")
        return None if folder is None else CoverageData(self, folder, "tileref")

    @cached_property
    def tile_table(self) -> tuple[TableData | None, str]:
        """The feature table of tiles, and its column of faces."""
        if self.tileref is None:
            return None, ""
        for feature_class in self.tileref.classes.values():
            if feature_class.primitive == "fac":
                return self.tileref.folder.table(feature_class.table), feature_class.prim_key
        return self.tileref.folder.table("tileref.aft"), "fac_id"

    @cached_property
    def tile_rows(self) -> list[TileRow]:
        """Rows of the feature table of tiles."""
        table, key = self.tile_table
        rows = None if table is None or table.n_row > MOST_LISTED else table.rows
        ids, faces, names = numbers(rows, "id"), numbers(rows, key), text_values(rows, "tile_name")
        found = []
        for i, name in enumerate(names or []):
            parts, problem = _split(name or "")
            face = i + 1 if faces is None else int(faces[i])
            found.append(TileRow(i + 1 if ids is None else int(ids[i]), name or "", parts, face, problem))
        return found

    @cached_property
    def tiles(self) -> dict[int, TileRow]:
        """Tiles with a path, by their ids."""
        return {row.tile_id: row for row in reversed(self.tile_rows) if row.parts}

    @cached_property
    def tile_boxes(self) -> NDArray[np.float64] | None:
        """Rectangles of ``tileref/fbr``, float64 (n_face, 4); None if they cannot be read."""
        boxes = None if self.tileref is None else rectangles(self.tileref.folder.table("fbr"))
        return None if boxes is None else boxes.astype(np.float64)

    def tile_box(self, tile_id: int) -> NDArray[np.float64] | None:
        """Rectangle of a tile; None if it has none."""
        row = self.tiles.get(tile_id)
        if row is None or self.tile_boxes is None or not 2 <= row.face <= len(self.tile_boxes):
            return None
        box: NDArray[np.float64] = self.tile_boxes[row.face - 1]
        return box if np.isfinite(box).all() else None


class CoverageData:
    """A coverage."""

    def __init__(self, library: LibraryData | None, folder: Folder, name: str) -> None:
        self.library, self.folder, self.name = library, folder, name
        self._counts: dict[tuple[str, int], int | None] = {}
        self._recent: tuple[int, Folder | None] = (0, None)

    @property
    def level(self) -> int | None:
        """Topology level, as ``cat`` has it."""
        return self.library.listed.get(self.name) if self.library else None

    @cached_property
    def _relations(self) -> tuple[tuple[Relation, ...], str]:
        table = self.folder.table("fcs")
        if table is None or not is_sound(table):
            return (), ""
        try:
            return read_relations(table.path), ""
        except VpfFormatError as error:
            return (), str(error).removeprefix(f"{error.path}: ")

    @property
    def relations(self) -> tuple[Relation, ...]:
        """Rows of ``fcs``; none if it is broken."""
        return self._relations[0]

    @property
    def schema_problem(self) -> str:
        """What is wrong with ``fcs``."""
        return self._relations[1]

    @cached_property
    def kinds(self) -> dict[str, tuple[str, str, str]]:
        """Name, type and description of the classes of ``fca``."""
        table = self.folder.table("fca")
        try:
            return {} if table is None or not is_sound(table) else read_kinds(table.path)
        except VpfFormatError:
            return {}

    @cached_property
    def classes(self) -> dict[str, FeatureClass]:
        """Feature classes that lead to primitives, or are complex."""
        return classes_of(self.relations, self.kinds)[0]

    @cached_property
    def is_tiled(self) -> bool:
        """Whether primitives lie in tiles: the library has some, and none of the primitives are here."""
        if self.library is None or self.name in REFERENCES or not self.library.tiles:
            return False
        return not any(name in self.folder.files for name in PRIMITIVES)

    @cached_property
    def tile_ids(self) -> list[int]:
        """Ids of the tiles that have a folder here; 0 stands for the coverage itself."""
        if not self.is_tiled or self.library is None:
            return [0]
        return [tile_id for tile_id in sorted(self.library.tiles) if self.tile_folder(tile_id) is not None]

    def tile_folder(self, tile_id: int) -> Folder | None:
        """Where the primitives of a tile lie; None if there is no such tile or folder. The last one is kept, no other."""
        if tile_id == 0 or not self.is_tiled:
            return self.folder if tile_id == 0 else None
        if self._recent[0] != tile_id:
            row = None if self.library is None else self.library.tiles.get(tile_id)
            self._recent = tile_id, None if row is None else self.folder.below(*row.parts)
        return self._recent[1]

    def count(self, primitive: str, tile_id: int) -> int | None:
        """Rows of a table of primitives of a tile; None if there is no such table, `UNKNOWN` if it is broken."""
        key = primitive, tile_id
        if key not in self._counts:
            folder = self.tile_folder(tile_id)
            table = None if folder is None else folder.table(primitive)
            self._counts[key] = None if table is None else UNKNOWN if table.head is None else table.n_row
        return self._counts[key]

    def tables(self, tile_id: int = 0) -> Iterator[TableData]:
        """Yield the tables of the coverage, or of one of its tiles."""
        folder = self.tile_folder(tile_id)
        for table in [] if folder is None else folder.tables.values():
            table.level = self.level
            table.above = self.folder if tile_id else None
            yield table


def names_of(table: TableData | None, column: str) -> list[str]:
    """Names in a column, in lower case without blanks; none if the table is broken or too long."""
    values = None if table is None or table.n_row > MOST_LISTED else text_values(table.rows, column)
    return [(name or "").strip().lower() for name in values or []]


def is_sound(table: TableData) -> bool:
    """Whether a table has the columns of its kind, in their types."""
    if table.head is None:
        return False
    wanted = wanted_columns(table.kind, table.name, 0)
    return not missing_columns(table.head.layout, wanted) and not wrong_types(table.head.layout, wanted)


def _split(name: str) -> tuple[tuple[str, ...], str]:
    try:
        return tuple(split(name)), ""
    except VpfFormatError as error:
        return (), str(error)


def find_target(path: Path) -> Target | None:
    """What a directory is: a database, a library of one, or a coverage; None if it is nothing of VPF."""
    path = path.resolve()
    here, above = Folder(path, path, ""), _listing(path.parent)
    if {"lat", "dht"} & set(here.files):
        database = DatabaseData(here)
        return Target(database, tuple(database.libraries.values()), ())
    name = path.name.rstrip(".").lower()
    if LIBRARY_TABLES & set(here.files):
        return Target(None, (_library(path, name, "lat" in above),), ())
    if "fcs" in here.files or any(primitive in here.files for primitive in PRIMITIVES):
        if not above & LIBRARY_TABLES:
            return Target(None, (), (CoverageData(None, here, name),))
        library = _library(path.parent, path.parent.name.lower(), "lat" in _listing(path.parent.parent))
        folder = Folder(library.folder.root, path, library.folder.place(path.name))
        return Target(None, (), (CoverageData(library, folder, name),))
    return None


def _library(path: Path, name: str, has_database: bool) -> LibraryData:
    root = path.parent if has_database else path
    database = DatabaseData(Folder(root, root, "")) if has_database else None
    return LibraryData(database, Folder(root, path, path.name if has_database else ""), name)


def _listing(path: Path) -> set[str]:
    """Names in a directory above, in lower case; none if it cannot be read."""
    try:
        return {name.rstrip(".").lower() for name in os.listdir(path)}
    except OSError:
        return set()
