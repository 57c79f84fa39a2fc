"""What the rules about VPF look at, one after the other."""

from __future__ import annotations

from collections.abc import Iterator

from vpfx.validate.run import Stage
from vpfx.validate.vpf.folders import Folder
from vpfx.validate.vpf.parts import CoverageData, LibraryData, Target
from vpfx.validate.vpf.scan import ScannedTable
from vpfx.validate.vpf.tile import TileData

__all__ = ["vpf_stages"]


def vpf_stages(target: Target) -> Iterator[Stage]:
    """Yield the stages of a directory: tables, then what they make, from tiles upwards."""
    if target.database is not None:
        yield from _table_stages(target.database.folder)
    for library in target.libraries:
        yield from _library_stages(library)
    for coverage in target.coverages:
        yield from _coverage_stages(coverage)


def _table_stages(folder: Folder) -> Iterator[Stage]:
    for table in folder.tables.values():
        yield Stage("table", ScannedTable(table), (table.where,))


def _library_stages(library: LibraryData) -> Iterator[Stage]:
    yield from _table_stages(library.folder)
    for coverage in library.coverages.values():
        yield from _coverage_stages(coverage)


def _coverage_stages(coverage: CoverageData) -> Iterator[Stage]:
    for table in coverage.tables():
        yield Stage("table", ScannedTable(table), (table.where,))
    for tile_id in coverage.tile_ids:
        folder = coverage.tile_folder(tile_id)
        if folder is not None and {"edg", "end"} & set(folder.files):
            tile = TileData(coverage, tile_id, folder)
            yield Stage("tile", tile, tile.keys)
