"""A store as a VPF database: levels and tiles one after the other, in the memory of a few tiles.

StoreReader ─ LevelTiles.numbers ─► TileNumbers ─ read_graph ─► TileGraph ─┬─ write_primitives ─► <tile path>/
                                                                           └─ LevelFeatures.add ─► *.aft *.pft *.fit *.rat
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import InputError, StoreFormatError
from vpfx.evpf.classes import read_class_tables
from vpfx.evpf.features import LevelFeatures
from vpfx.evpf.folder import Folder
from vpfx.evpf.graph import TileGraph, read_graph
from vpfx.evpf.headers import Library, tile_paths, write_database, write_library, write_libref, write_tileref
from vpfx.evpf.hierarchy import write_level, write_whole
from vpfx.evpf.numbering import MOST_TILES, LevelTiles, tiling_of
from vpfx.evpf.primitives import Primitives, face_boxes, straight, write_primitives
from vpfx.evpf.target import DatabaseTarget, check_names
from vpfx.model import Extent, Progress
from vpfx.store.reader import StoreReader, open_reader

__all__ = ["ExportReport", "export_vpf"]

MOST_SMALL = 2**16 - 1
"""Primitives of a tile that readers with ids of 16 bits can tell apart."""


class ExportReport(NamedTuple):
    """What was written.

    Attributes
    ----------
    path : Path
        The database.
    levels, tiles : int
    bytes : int
        Of all files.
    warnings : tuple of str
        What readers may not take.
    """

    path: Path
    levels: int
    tiles: int
    bytes: int
    warnings: tuple[str, ...]


def export_vpf(
    store_path: str | Path, path: str | Path, *, library: str = "terrain", product: str = "TIN", is_double: bool = False,
    is_upper: bool = False, overwrite: bool = False, progress: Progress | None = None,
) -> ExportReport:  # fmt: skip
    """Write a store as a VPF database (specs/evpf.md).

    Parameters
    ----------
    store_path : path
        A file made by `vpfx.build`.
    path : path
        The directory to make; its name is that of the database.
    library : str
        Name of the library.
    product : str
        `product_type` of its header.
    is_double : bool
        Write coordinates as they are; else rounded to single precision, which more readers draw.
    is_upper : bool
        Write names in upper case.
    overwrite : bool
        Whether a database made by vpfx may be replaced, at the end.
    progress : callable, optional
        Told tiles done, and tiles of all levels.

    Returns
    -------
    ExportReport

    Raises
    ------
    InputError
        A name does not fit, there are too many tiles, or single precision would break a face.
    NotFoundError, StoreFormatError
        There is no such store, or its rows do not fit.
    StoreError
        Something is in the way, or the medium refuses.

    Notes
    -----
    Source: specs/evpf.md. Nothing is left behind by a failure or an interruption. Cost: O(n log n).
    """
    names = Library(*check_names(Path(path), library, product, is_upper=is_upper), product)
    with open_reader(store_path) as store:
        store.fetch("face", [])  # maps the pages before the snapshot
        with store.snapshot(), DatabaseTarget(Path(path), overwrite=overwrite, is_upper=is_upper) as target:
            writer = _Writer(store, is_double)
            target.check_lengths(
                names.name, len(store.levels), writer.paths[-1], [table.name for table in writer.classes]
            )
            root = writer.write_headers(target.folder, names)
            writer.write_levels(root, progress)
            size = target.publish()
        return ExportReport(
            Path(path), len(store.levels), writer.tiling.n_tile, size, (*target.warnings(), *writer.warnings())
        )


def _tile_extents(store: StoreReader) -> NDArray[np.float64]:
    """Min x, min y, max x, max y of each tile."""
    columns = store.tiles()
    sides = [columns[name] for name in ("xmin", "ymin", "xmax", "ymax")]
    if any(side.dtype.kind != "f" or not np.isfinite(side).all() for side in sides):
        raise StoreFormatError(str(store.path), "table tile", "found an extent that is none", "R-130")
    return np.stack(sides, axis=1)


class _Writer:
    """Writes the parts of one database."""

    def __init__(self, store: StoreReader, is_double: bool) -> None:
        self.store, self.is_double = store, is_double
        self.tiling = tiling_of(store)
        if self.tiling.n_tile > MOST_TILES:
            raise InputError(f"{store.path}: found {self.tiling.n_tile} tiles, expected at most {MOST_TILES} (E-101)")
        self.classes = read_class_tables(store)
        self.extents = _tile_extents(store)
        self.paths = tile_paths(self.tiling)
        self._large: list[tuple[str, int]] = []

    def write_headers(self, database: Folder, names: Library) -> Folder:
        """Write what is not of a level; return the library."""
        write_database(database, names, self.store.extent)
        root = database.folder(names.name)
        write_library(root, names, self.store)
        write_libref(root.folder("libref"), self.store.extent, is_double=self.is_double)
        write_tileref(root.folder("tileref"), self.tiling, self.extents, is_double=self.is_double)
        return root

    def write_levels(self, root: Folder, progress: Progress | None) -> None:
        """Write the coverages of the levels, coarse to fine."""
        coarser, done, total = None, 0, len(self.store.levels) * self.tiling.n_tile
        for level in range(len(self.store.levels)):
            tiles = LevelTiles(self.store, self.tiling, level)
            coverage = root.folder(f"tin{level}")
            with LevelFeatures(coverage, tiles, coarser, self.classes, is_double=self.is_double) as features:
                for tile in range(self.tiling.n_tile):
                    features.add(self._write_tile(coverage, tiles, tile))
                    done += 1
                    if progress is not None:
                        progress(done, total)
                features.finish(self._write_related(coverage, tiles))
            coarser = tiles

    def _write_tile(self, coverage: Folder, tiles: LevelTiles, tile: int) -> TileGraph:
        """Write the primitives of a tile."""
        extent = Extent(*self.extents[tile].tolist())
        graph = read_graph(tiles, tile, extent, is_double=self.is_double)
        planar, edge_nodes = graph.planar, graph.edge_nodes
        boxes = face_boxes(graph.xyz[:, :2], edge_nodes, graph.numbers.sides, planar, extent)
        tables = Primitives(
            "Y" if self.is_double else "Z", graph.xyz, edge_nodes, straight(graph.xyz, edge_nodes), graph.first_edge,
            graph.faces, graph.links, planar, boxes,
        )  # fmt: skip
        write_primitives(coverage.folder(*self.paths[tile]), tables, extent, is_tiled=True)
        if graph.n_primitive > MOST_SMALL:
            self._large.append((f"{coverage.path.name}/{'/'.join(self.paths[tile])}", graph.n_primitive))
        return graph

    def _write_related(self, coverage: Folder, tiles: LevelTiles) -> list[str]:
        """Write tables of the hierarchy that do not hang on tiles; return which, besides `level.rat`."""
        write_level(coverage, self.store, tiles.level)
        if tiles.level > 0:
            return []
        write_whole(coverage, self.store, self.classes, is_double=self.is_double)
        return ["evpf", "source", *(["class", "column", "value"] if self.classes else [])]

    def warnings(self) -> tuple[str, ...]:
        """Say which tiles are larger than some readers take."""
        if not self._large:
            return ()
        place, count = self._large[0]
        others = f", and {len(self._large) - 1} more tiles" if len(self._large) > 1 else ""
        found = f"{place} has {count:,} primitives of a kind{others}"
        return (f"{found}; some readers take up to {MOST_SMALL:,} a tile: build with a smaller --tile-size for them",)
