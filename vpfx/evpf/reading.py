"""From a VPF directory of the extension back to a store (specs/evpf.md chapter 5).

Library ─ read_origin ─► Origin ─ TileReader ─► TileMesh ─ StoreWriter ─► rows; Editor ◄─ read_classes ─ class tables
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from vpfx.errors import FormatError, InputError, InvariantError, NotFoundError, VpfFormatError
from vpfx.evpf.class_reading import read_classes
from vpfx.evpf.origin import Origin, read_origin
from vpfx.evpf.tile_reading import TileReader
from vpfx.model import Progress
from vpfx.store.edit import edit_store
from vpfx.store.summary import LevelSummary
from vpfx.store.writer import StoreWriter, check_target
from vpfx.vpf.catalog import Library, open_database

__all__ = ["ImportReport", "import_vpf"]


@dataclass(frozen=True)
class ImportReport:
    """What was imported.

    Attributes
    ----------
    path : Path
        The store.
    levels : tuple of LevelSummary
        Counts, bounds and errors, coarse to fine.
    precision : str
        ``double``: the store is the one that was exported; ``single``: places and heights are rounded.
    tiles : int
    seconds : float
        Wall-clock time.
    """

    path: Path
    levels: tuple[LevelSummary, ...]
    precision: str
    tiles: int
    seconds: float


def import_vpf(
    directory: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> ImportReport:
    """Make a store from a VPF directory that `vpfx export` wrote.

    Parameters
    ----------
    directory : path
        The database, or the library in it.
    output : path
        The store to make, normally ``*.gpkg``.
    overwrite : bool
        Whether an existing store is replaced, once the new one is complete.
    progress : callable, optional
        Called with the tiles done and the tiles in all.

    Returns
    -------
    ImportReport

    Raises
    ------
    InputError
        The store would lie in the database.
    NotFoundError
        There is no such directory, or it is no VPF.
    VpfFormatError
        It is not of the extension, or breaks it; nothing is left behind.
    StoreError
        The store cannot be put there, or the medium refuses.

    Notes
    -----
    Source: specs/evpf.md E-500, E-501. Memory is that of a tile over all its levels, and of all borders. Cost: O(n log n).

    Examples
    --------
    >>> import_vpf("fixtures", "a.gpkg")
    Traceback (most recent call last):
    vpfx.errors.NotFoundError: fixtures: found neither lat nor cat, expected a VPF database or a library of one
    """
    start = time.perf_counter()
    path = Path(output)
    check_target(path, overwrite)
    library = _find_library(Path(directory))
    if library.root.resolve() in path.resolve().parents:
        raise InputError(f"output: found {output}, which lies in the database that is read; give another place")
    origin = read_origin(library)
    try:
        levels = _write(origin, path, overwrite, progress)
    except InvariantError as error:  # what only rows of several tiles show
        raise VpfFormatError(str(library.path), "", f"found tables that make no TIN: {error}", "E-501") from error
    precision = "double" if origin.is_double else "single"
    return ImportReport(path, tuple(levels), precision, origin.tiling.n_tile, time.perf_counter() - start)


def _find_library(directory: Path) -> Library:
    """Return the one library of the extension."""
    database = open_database(directory)
    found = [library for library in database.libraries.values() if _is_extended(library)]
    if not found:
        advice = "`vpfx vpf to-gpkg` reads the features of others, and `vpfx build --features` takes them as lines"
        message = f"found VPF without tin0/evpf.rat, expected a directory that vpfx export wrote; {advice}"
        raise VpfFormatError(str(directory), "", message, "E-100")
    if len(found) > 1:
        names = ", ".join(library.name for library in found)
        raise VpfFormatError(str(directory), "", f"found the libraries {names}, expected one; give its directory")
    return found[0]


def _is_extended(library: Library) -> bool:
    coverage = library.coverages.get("tin0")
    return coverage is not None and coverage.find("evpf.rat") is not None


def _write(origin: Origin, path: Path, overwrite: bool, progress: Progress | None) -> list[LevelSummary]:
    """Write the store, tile by tile, then what faces are part of."""
    tiling = origin.tiling
    wkt = origin.metadata["crs_wkt2"]
    with (
        TileReader(origin.coverages, tiling, origin.place, origin.is_double) as reader,
        StoreWriter(path, tiling, origin.place, wkt, overwrite) as writer,
    ):
        for index in range(tiling.n_tile):
            writer.add(reader.read(tiling.tile(index)))
            if progress:
                progress(index + 1, tiling.n_tile)
        reader.finish()

        def then(written: Path, summary: Sequence[LevelSummary]) -> None:
            origin.check_counts(summary)
            if origin.has_classes:
                _write_classes(origin, written, reader)

        return writer.finish(origin.totals, origin.metadata, origin.sources, then)


def _write_classes(origin: Origin, path: Path, reader: TileReader) -> None:
    """Put the feature classes into a store that has no name yet."""
    try:
        with edit_store(path) as editor:
            read_classes(origin.coverages, editor, reader.n_face)
    except VpfFormatError:
        raise
    except (InputError, NotFoundError, FormatError) as error:
        where = str(origin.coverages[0].table("class.rat"))
        told = str(error).replace(str(path), "the store")
        raise VpfFormatError(where, "", f"found classes that make no attributes of a store: {told}", "E-430") from error
