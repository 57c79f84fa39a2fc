"""What the rules of stores look at: the file, its table of contents, its small tables; read when first asked for.

Nothing here is checked: the rules do that. What cannot be read raises `sqlite3.Error` or `StoreFormatError`.
"""

from __future__ import annotations

import json
import math
import os
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from vpfx.dem import read_grid
from vpfx.errors import StoreError, StoreFormatError
from vpfx.methods import METHODS
from vpfx.model import Extent, Grid
from vpfx.store.arrays import NO_IDS, TableReader
from vpfx.store.connection import INTERRUPTED, error_code
from vpfx.store.contents import METADATA, MOST_CHARACTERS
from vpfx.store.ddl import schema_sql
from vpfx.store.geopackage import find_srs
from vpfx.store.tiles import Tiling
from vpfx.validate.class_data import ClassData, read_class_data
from vpfx.validate.values import OBJECTS, LevelRow, Object, objects_made_by

__all__ = ["HEADER", "RANGED", "StoreData", "open_store_data"]

HEADER = 100  # bytes
READ_VERSION, WAL = 19, b"\2"  # byte of the header, and what it is where newest pages may lie in a write-ahead log
XYZ_SIZE = 24  # bytes
FLOAT_BITS, LEAST_EXPONENT = 24, -125  # of single precision, with the first bit behind the point
BUSY_SECONDS = 5.0  # that a writer is waited for
BESIDE = 1e-3
"""Post spacings around the extent in which posts are looked for: those on its sides may lie a hair outside."""
LOOK = "SELECT 1 FROM sqlite_schema LIMIT 1"  # opens the file, and takes SQLite's shared lock
SOME_ROWS = 1 << 16  # read at a time
ALL_IDS = (1, 2**63 - 1)
RANGED = ("node", "edge", "face")
"""Tables whose rows lie in ranges of ids, tile by tile and level by level."""
KEYED_BY_PAIRS = {
    "t_junction": ("edge_id", "node_id", "tile_id", "level", "gap"),
    "shared_area": ("child_face", "parent_face", "area"),
}
"""Columns of tables whose first two are the key; the last is a real number, the others are whole ones."""
Rows = list[tuple[Any, ...]]


@contextmanager
def open_store_data(path: Path, dem: Sequence[str | Path] = ()) -> Iterator[StoreData]:
    """Open a file that may be a store, and the elevation files it was built from.

    Raises
    ------
    StoreError
        The system refuses to read it.
    """
    try:
        with path.open("rb") as file:
            head, size = file.read(HEADER), os.fstat(file.fileno()).st_size
    except OSError as error:
        raise StoreError(f"{path}: cannot be read: {error.strerror}") from error
    data = StoreData(path, head, size, dem)
    try:
        yield data
    finally:
        data.close()


def _float_spacing(value: float) -> float:
    """Spacing of floats at a value, also at one that no float holds."""
    return math.ldexp(1.0, max(math.frexp(value)[1], LEAST_EXPONENT) - FLOAT_BITS)


class StoreData:
    """A file that may be a store; made by `open_store_data`.

    Attributes
    ----------
    path : Path
    head : bytes
        The first 100, or fewer if there are no more.
    size : int
        Bytes.
    dem : sequence of path
        Elevation files that the store was built from; may be empty.
    """

    def __init__(self, path: Path, head: bytes, size: int, dem: Sequence[str | Path] = ()) -> None:
        self.path, self.head, self.size, self.dem = path, head, size, dem
        self._connection: sqlite3.Connection | None = None

    def close(self) -> None:
        """Close the file."""
        if self._connection is not None:
            self._connection.close()

    @cached_property
    def interrupted(self) -> str:
        """What to say of a change that was interrupted; empty if none was."""
        try:
            self._open()
        except sqlite3.Error as error:
            if error_code(error) != sqlite3.SQLITE_READONLY_ROLLBACK:
                raise
            return INTERRUPTED
        return ""

    def _open(self) -> sqlite3.Connection:
        """Open the database for reading, safely; from here on one state of it is seen."""
        if self._connection is None:
            uri = f"{self.path.absolute().as_uri()}?mode=ro"
            if self.head[READ_VERSION : READ_VERSION + 1] == WAL and not os.path.exists(f"{self.path}-wal"):
                uri += "&immutable=1"  # SQLite would make a write-ahead log and leave it behind
            connection = sqlite3.connect(uri, BUSY_SECONDS, uri=True, isolation_level=None)
            connection.text_factory = lambda text: text.decode("utf-8", "replace")
            try:
                connection.execute("PRAGMA trusted_schema = OFF")
                connection.execute(
                    "PRAGMA cell_size_check = ON"
                )  # else a broken page gives what lies behind it in memory
                connection.execute("PRAGMA ignore_check_constraints = ON")  # integrity_check: rules say it better
                connection.execute(LOOK).fetchone()
                reader = TableReader(connection, self.path)
                with suppress(StoreFormatError):  # whoever asks for rows is told; here the pages are mapped, no more
                    reader.rows("level", [])
                connection.execute("BEGIN")
                connection.execute(LOOK).fetchone()
            except BaseException:
                connection.close()
                raise
            self._connection, self._reader = connection, reader
        return self._connection

    @property
    def reader(self) -> TableReader:
        """What reads rows as arrays."""
        self._open()
        return self._reader

    def select(self, query: str, values: Sequence[Any] = ()) -> Rows:
        """Rows that SQLite gives for a query."""
        return self._open().execute(query, values).fetchall()

    def each(self, query: str) -> Iterator[tuple[Any, ...]]:
        """Rows that SQLite gives for a query, one by one as it finds them."""
        return self._open().execute(query)

    def first(self, query: str, most: int) -> Rows:
        """Return the first rows that SQLite gives for a query."""
        return self._open().execute(query).fetchmany(most)

    @cached_property
    def objects(self) -> dict[str, Object]:
        """Tables, views, indexes and triggers by name."""
        return {row[0]: Object(*row[1:]) for row in self.select(OBJECTS)}

    @cached_property
    def expected_objects(self) -> dict[str, Object]:
        """Those of the schema of the format (R-101)."""
        return objects_made_by("".join(map(schema_sql, ("vpfx.sql", "gpkg.sql", "views.sql"))))

    @cached_property
    def classes(self) -> list[ClassData]:
        """Feature classes, and what is wrong with them."""
        return read_class_data(self.select, self.objects, self.expected_objects)

    @cached_property
    def metadata(self) -> dict[str, Any]:
        """Values of the table `metadata`; what cannot be decoded is None."""
        found: dict[str, Any] = {}
        for name, value in self.select("SELECT name, value FROM metadata"):
            try:
                if not isinstance(value, str) or len(value) > MOST_CHARACTERS:
                    raise ValueError
                found[name] = value if METADATA.get(name, str) is str else json.loads(value)
            except (ValueError, RecursionError):
                found[name] = None
        return found

    @cached_property
    def level_rows(self) -> list[LevelRow]:
        """Rows of the table `level`, coarse to fine."""
        return [
            LevelRow(*row) for row in self.select(f"SELECT {', '.join(LevelRow._fields)} FROM level ORDER BY level")
        ]

    @property
    def n_level(self) -> int:
        """Number of rows of the table `level`, 0 if they cannot be read, or no rule has come so far as to open the file."""
        try:
            return len(self.level_rows) if self._connection is not None else 0
        except (sqlite3.Error, UnicodeDecodeError):  # a message of SQLite may quote bytes that are no text
            return 0

    @cached_property
    def tiles(self) -> Rows:
        """Rows of the table `tile`."""
        return self.select("SELECT tile_id, tile_name, xmin, ymin, xmax, ymax FROM tile ORDER BY tile_id")

    @cached_property
    def boxes(self) -> NDArray[np.float64]:
        """Extents of the tiles, (n_tile, 4): xmin, ymin, xmax, ymax."""
        return np.array([row[2:] for row in self.tiles], np.float64).reshape(-1, 4)

    @cached_property
    def extent(self) -> Extent:
        """Rectangle of all tiles."""
        low, high = self.boxes[:, :2].min(axis=0), self.boxes[:, 2:].max(axis=0)
        return Extent(float(low[0]), float(low[1]), float(high[0]), float(high[1]))

    @cached_property
    def tiling(self) -> Tiling:
        """The cut of the lattice into tiles, and the ids that follow from it."""
        lattice = self.metadata["lattice"]
        n_row, n_col, tile_size = lattice["n_row"], lattice["n_col"], self.metadata["options"]["tile_size"]
        return Tiling(n_row, n_col, tile_size, len(self.level_rows))

    @cached_property
    def tile_levels(self) -> Rows:
        """Rows of the table `tile_level`."""
        limits = ", ".join(f"first_{table}, last_{table}" for table in RANGED)
        return self.select(
            f"SELECT tile_level_id, tile_id, level, {limits}, digest FROM tile_level ORDER BY tile_level_id"
        )

    @cached_property
    def ranges(self) -> NDArray[np.int64]:
        """First and last ids of each tile and level, (n_tile, n_level, 3, 2), tables as in `RANGED`; 1, 0 where none."""
        limits = [self._limits(row) for row in self.tile_levels]
        return np.array(limits, np.int64).reshape(len(self.tiles), len(self.level_rows), 3, 2)

    @staticmethod
    def _limits(row: tuple[Any, ...]) -> list[int]:
        """The six limits of a row, 1 and 0 for NULL."""
        return [NO_IDS[i % 2] if value is None else value for i, value in enumerate(row[3:9])]

    @cached_property
    def nodes(self) -> dict[str, NDArray[Any]]:
        """Rows of the table `node` as columns, in the order of ids; NULL is -1, or NaN."""
        return self.columns("node", [ALL_IDS])

    @cached_property
    def xyz(self) -> NDArray[np.float64]:
        """Places of the nodes, (n_node, 3)."""
        return np.stack([self.nodes[name] for name in "xyz"], axis=1)

    @cached_property
    def places(self) -> NDArray[np.float64]:
        """Places of the nodes in post spacings, (n_node, 2)."""
        lattice = self.metadata["lattice"]
        return (self.xyz[:, :2] - (lattice["x0"], lattice["y0"])) / (lattice["dx"], lattice["dy"])

    @cached_property
    def ulp(self) -> float:
        """Spacing of doubles at the largest coordinate of the extent, CRS units."""
        return float(np.spacing(np.abs(self.boxes).max()))

    @cached_property
    def is_single(self) -> bool:
        """Whether places and heights were rounded to single precision, as those of some VPF are."""
        return self.metadata.get("coordinate_precision") == "single"

    @cached_property
    def place_slack(self) -> float:
        """How far rounding may have moved a place, CRS units: the one measure of all rules that allow for it.

        An ulp; in single precision √2 times the spacing of floats at the largest coordinate: x and y may both be off by it.
        """
        if not self.is_single:
            return self.ulp
        return math.sqrt(2.0) * _float_spacing(np.abs(self.boxes).max())

    @cached_property
    def height_slack(self) -> float:
        """How far heights may have been rounded, metres: 0, or half the spacing of floats at the greatest."""
        if not self.is_single:
            return 0.0
        greatest = np.nanmax(np.abs([self.nodes["z"], self.nodes["z_parent"]]), initial=0.0)
        return _float_spacing(greatest) / 2

    @cached_property
    def place_ulp(self) -> NDArray[np.float64]:
        """An ulp in post spacings, (2,)."""
        lattice = self.metadata["lattice"]
        return self.ulp / np.array([lattice["dx"], lattice["dy"]], np.float64)

    @cached_property
    def tile_lines(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """X of the lines between tile columns and y of those between tile rows, sides of the extent included."""
        lattice, tiling = self.metadata["lattice"], self.tiling
        return lattice["x0"] + lattice["dx"] * tiling.col_lines, lattice["y0"] + lattice["dy"] * tiling.row_lines

    @cached_property
    def lines_of_nodes(self) -> NDArray[np.int64]:
        """Which line between tile columns, and which between tile rows, each node lies on, bit for bit, (n_node, 2); -1: none.

        The sides of the extent are lines too, the first and the last.
        """
        found = np.empty((len(self.xyz), 2), np.int64)
        for axis, lines in enumerate(self.tile_lines):
            values = self.xyz[:, axis]
            at = np.minimum(np.searchsorted(lines, values), len(lines) - 1)
            found[:, axis] = np.where(lines[at] == values, at, -1)
        return found

    @cached_property
    def crs(self) -> CRS | None:
        """The CRS; None if it is unknown."""
        wkt = self.metadata["crs_wkt2"]
        return CRS.from_wkt(wkt) if wkt else None

    @cached_property
    def srs(self) -> tuple[int, str, str, int, str]:
        """The CRS as GeoPackage has it: see `vpfx.store.geopackage.find_srs`."""
        return find_srs(self.metadata["crs_wkt2"])

    @cached_property
    def blobs(self) -> NDArray[np.uint8]:
        """Column `xyz` of the nodes, (n_node, 24); no rows if one of them is no blob of 24 bytes."""
        blobs = np.empty((len(self.nodes["node_id"]), XYZ_SIZE), np.uint8)
        cursor, at = self._open().execute("SELECT xyz FROM node WHERE node_id >= 1 ORDER BY node_id"), 0
        while rows := [row[0] for row in cursor.fetchmany(SOME_ROWS)]:
            if set(map(type, rows)) != {bytes} or set(map(len, rows)) != {XYZ_SIZE}:
                return blobs[:0]
            blobs[at : at + len(rows)] = np.frombuffer(b"".join(rows), np.uint8).reshape(-1, XYZ_SIZE)
            at += len(rows)
        return blobs

    def columns(self, table: str, runs: list[tuple[int, int]]) -> dict[str, NDArray[Any]]:
        """Rows of a table with ids in ascending runs, as columns.

        Raises
        ------
        StoreFormatError
            A value is of another kind.
        """
        found = self.reader.rows(table, runs)
        for name, values in found.items():
            if values.dtype not in (np.int64, np.float64):
                raise self._strange(table, name)
        return found

    def _strange(self, table: str, column: str) -> StoreFormatError:
        return StoreFormatError(str(self.path), f"table {table}", f"found {column} of another kind", "R-102")

    def pair_columns(self, table: str, runs: list[tuple[int, int]]) -> dict[str, NDArray[Any]]:
        """Rows of a table of `KEYED_BY_PAIRS` whose first numbers lie in ascending runs, as columns, by its key.

        Raises
        ------
        StoreFormatError
            A value is of another kind.
        """
        names = KEYED_BY_PAIRS[table]
        first, second, *_, real = names
        query = f"SELECT {', '.join(names)} FROM {table} WHERE {first} BETWEEN ? AND ? ORDER BY {first}, {second}"
        parts = {name: [np.empty(0, np.float64 if name == real else np.int64)] for name in names}
        for run in runs:
            cursor = self._open().execute(query, run)
            while rows := cursor.fetchmany(SOME_ROWS):
                for (name, found), values in zip(parts.items(), zip(*rows, strict=True), strict=True):
                    if set(map(type, values)) != {float if name == real else int}:
                        raise self._strange(table, name)
                    found.append(np.array(values, found[0].dtype))
        return {name: np.concatenate(found) for name, found in parts.items()}

    @cached_property
    def is_nested(self) -> bool:
        """Whether each face has one parent: as the method says, or if it is not known, the store."""
        method = METHODS.get(self.metadata.get("method") or "")
        if method is not None:
            return method.nested
        return not self.select("SELECT 1 FROM shared_area LIMIT 1")

    @cached_property
    def grid(self) -> Grid:
        """Posts of the elevation files in the extent.

        Raises
        ------
        InputError, DemFormatError
            They have none there, or cannot be read.
        """
        lattice, metadata = self.metadata["lattice"], self.metadata
        x, y = lattice["dx"] * BESIDE, lattice["dy"] * BESIDE
        box = (self.extent.min_x - x, self.extent.min_y - y, self.extent.max_x + x, self.extent.max_y + y)
        unit = None if metadata["source_vertical_unit_is_assumed"] else metadata["source_vertical_unit"]
        return read_grid([str(path) for path in self.dem], bbox=box, vertical_unit=unit)
