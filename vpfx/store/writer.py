"""Writing a store in one ordered pass: tiles as they come, borders and tables of contents at the end.

The file grows under a temporary name beside the target and gets its name when it is complete and on the disk; whatever
happens before leaves the old file, or none (specs/format.md R-100).
"""

from __future__ import annotations

import json
import os
import sqlite3
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from vpfx.errors import InvariantError, StoreError
from vpfx.model import CUTS, Extent
from vpfx.store.contents import FORMAT_VERSION
from vpfx.store.ddl import schema_sql
from vpfx.store.digest import Digest
from vpfx.store.geopackage import APPLICATION_ID, USER_VERSION, register
from vpfx.store.mesh import TileMesh
from vpfx.store.pages import PageWriter, reason_of
from vpfx.store.rows import FirstIds, NodeRows, OpenSides, Table, TileRows, border_rows, tile_rows
from vpfx.store.summary import LevelSummary, LevelTotals
from vpfx.store.tiles import Place, Tile, Tiling

__all__ = ["StoreWriter", "check_target"]

Tables = dict[str, Table]
PAGE_SIZE = 4096  # bytes; SQLite's own default: what a region query reads grows in small steps


def check_target(path: Path, overwrite: bool) -> None:
    """Check that a store can be put at a path.

    Raises
    ------
    StoreError
        There is a file or link that may not be replaced, or a folder, or no folder to put it in.
    """
    try:
        os.lstat(path)
    except FileNotFoundError:
        pass
    except (OSError, ValueError) as error:  # too long, or with a zero byte
        name = str(path).replace("\0", "\\0")
        raise StoreError(f"{name}: cannot be written: {reason_of(error)}") from error
    if path.is_dir():
        raise StoreError(f"{path}: found a folder, expected a file name")
    if not path.parent.is_dir():
        raise StoreError(f"{path}: found no folder {path.parent}, expected one to put the store in")
    if os.path.lexists(path) and not overwrite:
        found = "an existing file" if os.path.exists(path) else "a link that leads nowhere"
        raise StoreError(f"{path}: found {found}; give another name or --overwrite")


class StoreWriter:
    """Writes one store; use as a context manager.

    Parameters
    ----------
    path : Path
        The store to make.
    tiling : Tiling
    place : Place
        Where the posts lie.
    wkt : str
        CRS as WKT2; empty if unknown.
    overwrite : bool
        Whether an existing file may be replaced, at the end.

    Raises
    ------
    StoreError
        The file exists and may not be replaced, or the medium refuses.
    """

    def __init__(self, path: Path, tiling: Tiling, place: Place, wkt: str, overwrite: bool = False) -> None:
        self.path = Path(path)
        check_target(self.path, overwrite)
        self._overwrite = overwrite
        self._temporary = self.path.with_name(f".{self.path.name}.{os.getpid()}.tmp")
        self._tiling, self._place, self._wkt = tiling, place, wkt
        self._next = FirstIds(tiling.n_border_node_id + 1, tiling.n_border_edge_id + 1, 1)
        self._open: list[list[OpenSides]] = [[] for _ in range(tiling.n_level)]
        self._shared: list[NodeRows] = []
        self._border_digests = [Digest() for _ in range(tiling.n_level)]
        self._tile_levels: list[tuple[Any, ...]] = []
        self._behind = ThreadPoolExecutor(1)  # makes the rows of the next tile while those of this one are written
        self._waiting: deque[Future[tuple[Tile, TileRows, list[Tables], list[bytes]]]] = deque()
        self._counts = np.zeros((tiling.n_level, 3), np.int64)  # nodes first seen at the level, edges, faces
        try:
            self._create()
            self._pages = PageWriter(self._temporary, str(self.path))
        except BaseException as error:
            self._discard()
            if not isinstance(error, OSError | sqlite3.Error):
                raise
            raise StoreError(f"{self.path}: cannot be written: {reason_of(error)}") from error

    def _create(self) -> None:
        self._temporary.unlink(missing_ok=True)
        connection = sqlite3.connect(self._temporary)
        try:
            connection.execute(f"PRAGMA page_size = {PAGE_SIZE}")
            connection.execute("PRAGMA journal_mode = DELETE")
            connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
            connection.execute(f"PRAGMA user_version = {USER_VERSION}")
            connection.execute("PRAGMA synchronous = OFF")  # the finished file is synced as a whole
            schema = "".join(schema_sql(name) for name in ("gpkg.sql", "vpfx.sql", "views.sql"))
            connection.executescript(f"BEGIN;\n{schema}COMMIT;")
        finally:
            connection.close()

    def add(self, mesh: TileMesh) -> None:
        """Take the next tile, and write the rows of the one before; tiles come in the order of their numbers."""
        self._waiting.append(self._behind.submit(self._make_rows, mesh))
        if len(self._waiting) > 1:
            self._write_first()

    def _make_rows(self, mesh: TileMesh) -> tuple[Tile, TileRows, list[Tables], list[bytes]]:
        """Rows of the next tile, and tables and digests of its levels; in a thread of its own, tile by tile."""
        rows = tile_rows(mesh, self._tiling, self._next)
        self._next = rows.next_ids
        tables = [rows.tables(level) for level in range(len(rows.levels))]
        return mesh.tile, rows, tables, [_digest(level.values()) for level in tables]

    def _write_first(self) -> None:
        """Write the rows of the first tile that waits."""
        tile, rows, tables, digests = self._waiting.popleft().result()
        try:
            for level, digest in enumerate(digests):
                self._write_level(tile, level, tables[level], digest)
                self._open[level].append(rows.levels[level].open_sides)
        except (OSError, sqlite3.Error) as error:
            raise StoreError(f"{self.path}: cannot be written: {reason_of(error)}") from error
        self._shared.append(rows.shared_nodes)

    def _write_level(self, tile: Tile, level: int, tables: Tables, digest: bytes) -> None:
        """Write the rows of one tile and level that do not hang on other tiles."""
        limits: list[int | None] = []
        for name, table in tables.items():
            self._pages.append(name, table)
            if name in ("node", "edge", "face"):
                limits += [int(table[0][0]), int(table[0][-1])] if len(table[0]) else [None, None]
        children, parents = tables["parent_child"]
        by_parent = np.lexsort((children, parents))
        self._pages.append("parent_child_by_parent", (parents[by_parent], children[by_parent]))
        number = tile.number * self._tiling.n_level + level + 1
        self._tile_levels.append((number, tile.number + 1, level, *limits, digest))
        self._counts[level] += [len(tables[name][0]) for name in ("node", "edge", "face")]

    def finish(
        self,
        totals: Sequence[LevelTotals],
        metadata: Mapping[str, Any],
        sources: list[tuple[str, str, int, str]],
        then: Callable[[Path, Sequence[LevelSummary]], None] | None = None,
    ) -> list[LevelSummary]:
        """Write borders and contents, bring all to the disk and give the file its name.

        Parameters
        ----------
        totals : sequence of LevelTotals
            One a level.
        metadata : mapping
            Rows of `metadata`; values that are not text are kept as JSON.
        sources : list of (name, sha256, byte_count, driver)
        then : callable, optional
            Called with the path of the store when it is complete, before it has its name, and with what it holds: may refuse it
            by an exception, and may add attributes.
        """
        try:
            while self._waiting:
                self._write_first()
            self._write_borders()
            self._pages.close()
            summary = self._summary(totals)
            connection = sqlite3.connect(self._temporary)
            try:
                connection.execute("PRAGMA synchronous = OFF")
                self._write_origin(connection, metadata, sources)
                self._write_levels(connection, summary, totals)
                self._write_tiles(connection)
                connection.commit()
            finally:
                connection.close()
            if then:
                then(self._temporary, summary)
            self._publish()
        except (OSError, sqlite3.Error) as error:
            raise StoreError(f"{self.path}: cannot be written: {reason_of(error)}") from error
        return summary

    def _write_borders(self) -> None:
        """Write the nodes and edges on borders, and the edges whose links hang on them."""
        tiling = self._tiling
        if not tiling.n_border:
            return
        nodes = NodeRows(*(np.concatenate(columns) for columns in zip(*self._shared, strict=True)))
        node_id, first, place = np.unique(nodes.node_id, return_index=True, return_inverse=True)
        every, nodes = nodes, nodes.part(first)
        differs = (every.xyz != nodes.xyz[place]).any(axis=1) | (every.level != nodes.level[place])
        if differs.any():
            number = every.node_id[differs][0]
            raise InvariantError(f"node {number}: found a border that the tiles beside it have differently")
        nodes = nodes._replace(tile_id=tiling.node_owner(node_id) + 1)
        self._pages.append("node", nodes.table())
        self._counts[:, 0] += np.bincount(nodes.level, minlength=tiling.n_level)
        for level, digest in enumerate(self._border_digests):
            digest.add(nodes.part(nodes.level == level).table())
        for level, parts in enumerate(self._open):
            edges = border_rows(parts, level, tiling)
            self._pages.append("edge", edges)
            self._border_digests[level].add(edges)
            self._counts[level, 1] += len(edges[0])

    def _summary(self, totals: Sequence[LevelTotals]) -> list[LevelSummary]:
        """Totals of the levels with the counts of their rows; nodes belong to finer levels too."""
        counts = self._counts.copy()
        counts[:, 0] = np.cumsum(counts[:, 0])
        return [
            LevelSummary(level, *of_level[:-1], *count)
            for level, (of_level, count) in enumerate(zip(totals, counts.tolist(), strict=True))
        ]

    def _write_origin(
        self, connection: sqlite3.Connection, metadata: Mapping[str, Any], sources: list[tuple[str, str, int, str]]
    ) -> None:
        """Write what was built, from what."""
        lattice = {**self._place._asdict(), "n_row": int(self._tiling.row_lines[-1]) + 1}
        lattice["n_col"] = int(self._tiling.col_lines[-1]) + 1
        texts = {"format_version": FORMAT_VERSION, "crs_wkt2": self._wkt, "lattice": lattice, **metadata}
        rows = [(k, v if isinstance(v, str) else json.dumps(v, sort_keys=True)) for k, v in sorted(texts.items())]
        connection.executemany("INSERT INTO metadata VALUES (?, ?)", rows)
        connection.executemany(
            "INSERT INTO source VALUES (?, ?, ?, ?, ?)", [(i + 1, *s) for i, s in enumerate(sources)]
        )

    def _write_levels(
        self, connection: sqlite3.Connection, summary: Sequence[LevelSummary], totals: Sequence[LevelTotals]
    ) -> None:
        ranges = [self._tiling.border_edge_ids(line.level) or (None, None) for line in summary]
        digests = [digest.value() for digest in self._border_digests]
        levels = [(*line, *limits, digest) for line, limits, digest in zip(summary, ranges, digests, strict=True)]
        connection.executemany(f"INSERT INTO level VALUES ({', '.join('?' * 12)})", levels)
        cuts = [
            (level, kind, n)
            for level, of_level in enumerate(totals)
            for kind, n in zip(CUTS, of_level.cuts, strict=True)
        ]
        connection.executemany("INSERT INTO level_cut VALUES (?, ?, ?)", cuts)

    def _write_tiles(self, connection: sqlite3.Connection) -> None:
        """Write the tiles and where their rows lie, and register all as a GeoPackage."""
        tiles = [(tile.number + 1, tile.name, *self._extent(tile)) for tile in self._tiles()]
        connection.executemany("INSERT INTO tile VALUES (?, ?, ?, ?, ?, ?)", tiles)
        boxes = [(number, xmin, xmax, ymin, ymax) for number, _, xmin, ymin, xmax, ymax in tiles]
        connection.executemany("INSERT INTO tile_index VALUES (?, ?, ?, ?, ?)", boxes)
        connection.executemany(f"INSERT INTO tile_level VALUES ({', '.join('?' * 10)})", self._tile_levels)
        lines = self._tiling.row_lines[-1], self._tiling.col_lines[-1]
        whole = Tile(0, 0, 0, 0, int(lines[0]), 0, int(lines[1]))
        register(connection, self._wkt, self._extent(whole), self._tiling.n_level)

    def _tiles(self) -> list[Tile]:
        return [self._tiling.tile(index) for index in range(self._tiling.n_tile)]

    def _extent(self, tile: Tile) -> Extent:
        first = self._place.at(tile.first_col, tile.first_row)
        return Extent(*first, *self._place.at(tile.last_col, tile.last_row))

    def _publish(self) -> None:
        with open(self._temporary, "rb+") as file:
            os.fsync(file.fileno())
        if self._overwrite:
            os.replace(self._temporary, self.path)
        else:
            try:
                os.link(self._temporary, self.path)  # unlike a rename, never replaces a file that came meanwhile
            except FileExistsError:
                raise StoreError(f"{self.path}: found a file that came while the store was built") from None
            except OSError:  # a file system without links
                os.replace(self._temporary, self.path)
        folder = os.open(self.path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    def _discard(self) -> None:
        for suffix in ("", "-journal"):
            with suppress(OSError):  # the error that led here is the one to tell
                self._temporary.with_name(self._temporary.name + suffix).unlink(missing_ok=True)

    def __enter__(self) -> StoreWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._behind.shutdown(cancel_futures=True)  # waits for the rows under way
        finally:
            try:
                self._pages.__exit__(kind, error, trace)
            finally:
                self._discard()


def _digest(tables: Iterable[Table]) -> bytes:
    """Digest of the rows of some tables."""
    digest = Digest()
    for table in tables:
        digest.add(table)
    return digest.value()
