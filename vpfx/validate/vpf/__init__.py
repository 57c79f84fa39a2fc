"""Rules V7xx: VPF directories, and our own extension of VPF.

`vpf_stages` says what is looked at and in which order; `folders`, `parts`, `tile` and `evpf_data` read it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from vpfx.registry import table
from vpfx.validate.report import Rule
from vpfx.validate.run import Stage
from vpfx.validate.vpf import (
    boxes,
    edges,
    evpf_classes,
    evpf_edges,
    evpf_tables,
    evpf_tiles,
    features,
    lookups,
    names,
    planes,
    readers,
    tables,
    tiling,
)
from vpfx.validate.vpf.evpf_classes import Inheritance
from vpfx.validate.vpf.evpf_data import EvpfData
from vpfx.validate.vpf.evpf_edges import add_border
from vpfx.validate.vpf.evpf_tables import check_tables
from vpfx.validate.vpf.evpf_tiles import add_sums
from vpfx.validate.vpf.features import ClassData
from vpfx.validate.vpf.folders import TableData
from vpfx.validate.vpf.names import FolderData, database_folder, library_folder
from vpfx.validate.vpf.parts import CoverageData, LibraryData, Target
from vpfx.validate.vpf.tables import ScannedTable
from vpfx.validate.vpf.tile import TileData
from vpfx.validate.vpf.tiling import Borders

__all__ = ["RULES", "vpf_stages"]

RULES: Mapping[str, Rule] = table(
    *tables.RULES,
    *names.RULES,
    *features.RULES,
    *edges.RULES,
    *planes.RULES,
    *tiling.RULES,
    *boxes.RULES,
    *lookups.RULES,
    *readers.RULES,
    *evpf_tables.RULES,
    *evpf_tiles.RULES,
    *evpf_edges.RULES,
    *evpf_classes.RULES,
)
"""Rules about directories of VPF, by name."""


def vpf_stages(target: Target) -> Iterator[Stage]:
    """Yield the stages of a directory: tables, then what they make, tile by tile."""
    if target.database is not None:
        folder = target.database.folder
        yield from _tables(folder.tables.values())
        yield Stage("folder", database_folder(target.database), (folder.place("lat"), folder.place("dht")))
    for library in target.libraries:
        yield from _library_stages(library)
    for coverage in target.coverages:
        yield from _coverage_stages(coverage)


def _tables(tables: Iterable[TableData]) -> Iterator[Stage]:
    for found in tables:
        yield Stage("table", ScannedTable(found), (found.where,))


def _library_stages(library: LibraryData) -> Iterator[Stage]:
    yield from _tables(library.folder.tables.values())
    keys = tuple(library.folder.place(name) for name in ("cat", "grt", "lht"))
    yield Stage("folder", library_folder(library), keys)
    if library.tileref is not None:
        yield Stage("library", library, (library.folder.where,))
    for name in library.coverage_paths:
        yield from _coverage_stages(library.coverage(name))
    evpf = EvpfData.find(library)
    if evpf is not None:
        yield from _evpf_stages(evpf)


def _coverage_stages(coverage: CoverageData) -> Iterator[Stage]:
    keys = tuple(coverage.folder.place(name) for name in ("fcs", "fca"))
    yield from _tables(coverage.tables())
    own = None if coverage.is_tiled else TileData(coverage, 0, coverage.folder)
    yield Stage("folder", FolderData(coverage.folder, "coverage", tile=own), keys)
    yield Stage("coverage", coverage, keys)
    borders = Borders(coverage)
    for tile_id in coverage.tile_ids:
        folder = coverage.tile_folder(tile_id)
        if folder is not None:
            tile = TileData(coverage, tile_id, folder)
            if coverage.is_tiled:
                yield from _tables(coverage.tables(tile_id))
                yield Stage("folder", FolderData(folder, "tile", tile=tile), tile.keys)
            if {"edg", "end"} & set(folder.files):
                yield Stage("tile", tile, tile.keys)
                borders.add(tile)
    if coverage.library is not None:
        yield Stage("borders", borders, (coverage.folder.where,))
    for feature_class in coverage.classes.values():
        data = ClassData(coverage, feature_class)
        yield Stage("class", data, data.keys)
    yield Stage("lookups", coverage, tuple(table.where for table in coverage.folder.tables.values()))


def _evpf_stages(evpf: EvpfData) -> Iterator[Stage]:
    """Yield the levels of a TIN: as a whole, then tile by tile from coarse to fine, then level by level."""
    whole = (evpf.library.folder.where,)
    yield Stage("evpf", evpf, whole)
    if any(True for _ in check_tables(evpf)):
        for scope in ("evpf tile", "evpf level", "evpf shares"):
            yield Stage(scope, None, whole)  # all rules there need those tables: the report says so
        return
    inheritance = Inheritance(evpf)
    for tile in evpf.tiles():
        yield Stage("evpf tile", tile, tile.keys)
        if tile.is_sound:
            add_border(tile, tile.level.borders)
            add_sums(tile)
            inheritance.add(tile)
    for level in evpf.levels:
        yield Stage("evpf level", level, (level.where,))
    yield Stage("evpf shares", inheritance, whole)
