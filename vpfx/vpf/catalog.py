"""Directories of VPF: database, libraries, coverages, feature classes, tiles (specs/vpf.md, V-200 to V-207).

::

    Database ─ lat ─► Library ─ cat ─► Coverage ─ fcs, fca ─► FeatureClass
                         └─ tileref ─► TilePath, the same below every coverage

What a table names but the directory lacks is told by `missing` and `problems`: discs hold parts of databases. What is
broken raises when it is asked for, so one bad coverage does not hide the others.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import NotFoundError, VpfFormatError
from vpfx.model import Extent
from vpfx.vpf import schema
from vpfx.vpf.header import TEXT_KINDS
from vpfx.vpf.paths import check_name, find, split
from vpfx.vpf.schema import FeatureClass, Relation, read_bounded
from vpfx.vpf.table import Table, open_table
from vpfx.vpf.values import texts

__all__ = ["Coverage", "Database", "Library", "TilePath", "open_database", "open_library"]

MOST_VALUES = 1_000_000
"""Rows of a table of value descriptions."""

MOST_TILE_ID = 2**31 - 1  # 0 is the coverage itself


class TilePath(NamedTuple):
    """A tile of a library."""

    name: str  # as in tileref.aft
    path: str  # below each coverage, with slashes, in the case of the table
    extent: Extent | None  # None if tileref has no rectangle for it


@dataclass(frozen=True, eq=False)
class Coverage:
    """A coverage: feature tables, and primitives of each tile.

    Attributes
    ----------
    library : Library
        Of which it is a part.
    path : Path
        Its directory.
    name, description : str
        As ``cat`` has them.
    level : int or None
        Topology level, 0 to 3; None if ``cat`` has none.
    """

    library: Library
    path: Path
    name: str
    description: str = ""
    level: int | None = None

    @cached_property
    def relations(self) -> tuple[Relation, ...]:
        """Rows of ``fcs``; none if there is no such table.

        Raises
        ------
        VpfFormatError
            The table is broken or names what no file can be called.
        """
        path = self.find("fcs")
        return () if path is None else schema.read_relations(path)

    @property
    def classes(self) -> dict[str, FeatureClass]:
        """Feature classes by their names in lower case.

        Raises
        ------
        VpfFormatError
            ``fcs`` or ``fca`` is broken.
        """
        return self._schema[0]

    @property
    def problems(self) -> dict[str, str]:
        """Lines on classes that the schema names but does not explain, by their names in lower case; of itself by ``""``."""
        return self._schema[1]

    @cached_property
    def _schema(self) -> tuple[dict[str, FeatureClass], dict[str, str]]:
        path = self.find("fca")
        kinds = {} if path is None else schema.read_kinds(path)
        classes, problems = schema.classes_of(self.relations, kinds, str(self.path))
        if self.find("fcs") is None:
            message = "found no table fcs, expected the feature class schema"
            problems = {"": str(VpfFormatError(str(self.path), "", message, "V-204")), **problems}
        return classes, problems

    def find(self, name: str, tile_id: int = 0) -> Path | None:
        """Path of a table of the coverage, or of one of its tiles; None if it is not there.

        Raises
        ------
        VpfFormatError
            The name leads elsewhere (V-202).
        NotFoundError
            The library has no such tile.
        """
        folder = ""
        if tile_id != 0:
            tile = self.library.tiles.get(tile_id)
            if tile is None:
                raise NotFoundError(f"{self.library.path}: found no tile {tile_id}, expected one in tileref.aft")
            folder = tile.path
        return find(self.path, folder, check_name(name, str(self.path)), within=self.library.root)

    def table(self, name: str, tile_id: int = 0) -> Path:
        """Path of a table, as `find`.

        Raises
        ------
        NotFoundError
            It is not there.
        VpfFormatError
            The name leads elsewhere (V-202).
        """
        path = self.find(name, tile_id)
        if path is None:
            tile = f"tile {tile_id}: " if tile_id else ""
            raise NotFoundError(f"{self.path}: {tile}found no table {name!r}")
        return path

    @cached_property
    def value_descriptions(self) -> dict[tuple[str, str], dict[int | str, str]]:
        """What coded values mean, by table and column in lower case; of what is described twice the first counts.

        Raises
        ------
        VpfFormatError
            ``int.vdt`` or ``char.vdt`` is broken.
        """
        found: dict[tuple[str, str], dict[int | str, str]] = {}
        for name in ("int.vdt", "char.vdt"):
            path = self.find(name)
            if path is not None:
                for key, described in schema.value_descriptions(read_bounded(path, MOST_VALUES)).items():
                    found[key] = described | found.get(key, {})
        return found


@dataclass(frozen=True, eq=False)
class Library:
    """A library: coverages of one area, cut into the same tiles.

    Attributes
    ----------
    path : Path
        Its directory.
    name : str
        As ``lat`` has it.
    extent : Extent or None
        As ``lat`` has it, in degrees as a rule; min_x is greater than max_x across the date line.
    root : Path
        Directory that no name leads out of: the database.
    """

    path: Path
    name: str
    extent: Extent | None
    root: Path

    @cached_property
    def _listed(self) -> tuple[dict[str, Coverage], tuple[str, ...]]:
        path = find(self.path, "cat", within=self.root)
        if path is None:
            raise NotFoundError(f"{self.path}: found no table cat, expected the list of coverages")
        table = read_bounded(path)
        descriptions = table.texts("description") if "description" in table else [None] * table.n_row
        levels = table.whole_numbers("level") if "level" in table else None
        coverages: dict[str, Coverage] = {}
        missing = []
        for i, name in enumerate(_names(table, "coverage_name")):
            folder = find(self.path, name, within=self.root)
            level = None if levels is None or levels[i] < 0 else int(levels[i])  # nulls are below 0
            if folder is None or not folder.is_dir():
                missing.append(name)
            else:
                coverages.setdefault(name.lower(), Coverage(self, folder, name, descriptions[i] or "", level))
        return coverages, tuple(missing)

    @property
    def coverages(self) -> dict[str, Coverage]:
        """Coverages that are there, by their names in lower case.

        Raises
        ------
        NotFoundError
            There is no ``cat``.
        VpfFormatError
            It is broken, or a name in it leads elsewhere (V-202).
        """
        return self._listed[0]

    @property
    def missing(self) -> tuple[str, ...]:
        """Names of coverages in ``cat`` that have no directory."""
        return self._listed[1]

    @cached_property
    def reference(self) -> dict[str, Any]:
        """The row of ``grt`` by its columns in lower case: str, int, float or None; empty if there is none."""
        return _first_row(find(self.path, "grt", within=self.root))

    @cached_property
    def header(self) -> dict[str, Any]:
        """The row of ``lht``, as `reference`."""
        return _first_row(find(self.path, "lht", within=self.root))

    @property
    def tiles(self) -> dict[int, TilePath]:
        """Tiles by their ids; none if the library is not tiled. Rows of ``tileref.aft`` without a name are no tiles.

        Raises
        ------
        VpfFormatError
            The tile reference coverage is broken.
        """
        return self._tile_rows[0]

    @property
    def problems(self) -> tuple[str, ...]:
        """Rows of ``tileref.aft`` that are no tiles: names lead elsewhere (V-202), or ids are none; lines as of errors.

        Raises
        ------
        VpfFormatError
            As `tiles`.
        """
        return self._tile_rows[1]

    @cached_property
    def _tile_rows(self) -> tuple[dict[int, TilePath], tuple[str, ...]]:
        folder = find(self.path, "tileref", within=self.root)
        if folder is None or not folder.is_dir():
            return {}, ()
        coverage = Coverage(self, folder, "tileref")
        listed = [found for found in coverage.classes.values() if found.primitive == "fac"]
        path = coverage.find(listed[0].table if listed else "tileref.aft")
        if path is None:
            return {}, ()
        table = read_bounded(path)
        face = listed[0].prim_key if listed else "fac_id"
        ids, faces = (
            table.whole_numbers(name) if name in table else np.arange(1, table.n_row + 1) for name in ("id", face)
        )
        extents = _extents(coverage, faces)
        tiles: dict[int, TilePath] = {}
        problems = []
        for row, (tile_id, name, extent) in enumerate(
            zip(ids.tolist(), table.texts("tile_name"), extents, strict=True), 1
        ):
            if name is None or not name.strip("\\/ "):
                continue
            try:
                parts = split(name, f"{path}: row {row}")
                if not 1 <= tile_id <= MOST_TILE_ID:
                    found = f"found the id {tile_id}, expected 1 to {MOST_TILE_ID}"
                    raise VpfFormatError(str(path), f"row {row}", found, "V-206")
            except VpfFormatError as error:
                problems.append(f"{error}; it is no tile")
                continue
            tiles.setdefault(tile_id, TilePath(name, "/".join(parts), extent))
        return tiles, tuple(problems)


@dataclass(frozen=True, eq=False)
class Database:
    """A VPF database.

    Attributes
    ----------
    path : Path
        Its directory.
    libraries : dict
        Libraries that are there, by their names in lower case.
    missing : tuple of str
        Names in ``lat`` that have no directory.
    """

    path: Path
    libraries: dict[str, Library]
    missing: tuple[str, ...] = ()

    @cached_property
    def header(self) -> dict[str, Any]:
        """The row of ``dht`` by its columns in lower case: str, int, float or None; empty if there is none."""
        return _first_row(find(self.path, "dht"))

    @property
    def name(self) -> str:
        """As ``dht`` has it, else as the directory is called."""
        return self.header.get("database_name") or self.path.resolve().name


def open_database(path: Path | str) -> Database:
    """Open a directory of VPF: a database, or one library of it.

    Parameters
    ----------
    path : path
        A directory with ``lat``; or one with ``cat``, whose ``lat`` may stand in the directory above: then the database
        has this library alone.

    Raises
    ------
    NotFoundError
        There is no such directory, or neither table in it.
    VpfFormatError
        ``lat`` is broken, or a name in it leads elsewhere (V-202).

    Examples
    --------
    >>> open_database("nowhere")
    Traceback (most recent call last):
    vpfx.errors.NotFoundError: nowhere: found no directory, expected a VPF database or a library of one
    """
    root = Path(path)
    if not os.path.isdir(root):
        raise NotFoundError(f"{path}: found no directory, expected a VPF database or a library of one")
    lat = find(root, "lat")
    if lat is not None:
        libraries, missing = _libraries(root, lat)
        return Database(root, libraries, missing)
    if find(root, "cat") is None:
        raise NotFoundError(f"{path}: found neither lat nor cat, expected a VPF database or a library of one")
    library = open_library(root)
    return Database(library.root, {library.name.lower(): library})


def open_library(path: Path) -> Library:
    """Open a directory with ``cat`` as `open_database` does, also where it has a ``lat`` as well."""
    path = path.resolve()
    lat = find(path.parent, "lat")
    known = {} if lat is None else _libraries(path.parent, lat)[0]
    return known.get(path.name.lower(), Library(path, path.name, None, path.parent))


def _libraries(root: Path, lat: Path) -> tuple[dict[str, Library], tuple[str, ...]]:
    table = read_bounded(lat)
    libraries: dict[str, Library] = {}
    missing = []
    for name, corner in zip(_names(table, "library_name"), table.rectangles().tolist(), strict=True):
        folder = find(root, name)
        if folder is None or not folder.is_dir():
            missing.append(name)
        else:
            libraries.setdefault(name.lower(), Library(folder, name, Extent(*corner), root))
    return libraries, tuple(missing)


def _names(table: Table, column: str) -> list[str]:
    """Names of directories in a column, checked."""
    names = [(name or "").strip() for name in table.texts(column)]
    return [check_name(name, table.path, f"row {i}") for i, name in enumerate(names, 1)]


def _extents(coverage: Coverage, faces: NDArray[Any]) -> list[Extent | None]:
    """Rectangles of faces."""
    path = coverage.find("fbr")
    if path is None:
        return [None] * len(faces)
    corners = read_bounded(path).rectangles()
    return [Extent(*corners[face - 1].tolist()) if 1 <= face <= len(corners) else None for face in faces.tolist()]


def _first_row(path: Path | None) -> dict[str, Any]:
    if path is None:
        return {}
    with open_table(path) as file:
        table = file.read(0, 1)
    row: dict[str, Any] = {}
    for column in table.layout.columns if table.n_row else ():
        values = table[column.name]
        if column.kind in TEXT_KINDS + "D":
            row[column.name.lower()] = texts(values)[0]
        else:
            row[column.name.lower()] = values.tolist()[0] if column.count == 1 and column.kind in "SIFR" else None
    return row
