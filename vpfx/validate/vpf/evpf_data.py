"""Coverages that are the levels of a TIN (specs/evpf.md) as the rules see them.

::

    EvpfData ─ levels ─► LevelTables ─ tile(id) ─► EvpfTile: primitives and rows of one tile, and of the level before
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import InputError, VpfFormatError
from vpfx.evpf.texts import from_vpf
from vpfx.store.tiles import Tiling
from vpfx.validate.vpf.folders import TableData, numbers, text_values
from vpfx.validate.vpf.parts import CoverageData, LibraryData
from vpfx.validate.vpf.tile import TileData
from vpfx.validate.vpf.tiling import Borders
from vpfx.vpf.table import Table, open_table

__all__ = ["BESIDE", "MOST_TILES", "EvpfData", "EvpfTile", "Lattice", "LevelTables", "Sums", "TileRows", "spacing_of"]

Ids = NDArray[np.int64]
Floats = NDArray[np.float64]

MOST_LEVELS = 1000
MOST_TILES = 1 << 20
"""Tiles that a lattice may have to be compared with those of the library."""
MOST_ROWS = 1_000_000
"""Rows of a table of names that are looked at."""
BESIDE = 2.0
"""Spacings of numbers by which a corner of a child may lie beside its parent, or a node beside its edge (R-181)."""
BY_TILE = ("tinface.aft", "tinnode.pft", "parent.rat", "own.rat", "tjunct.rat")


class Lattice(NamedTuple):
    """Posts of the store: post (row, col) lies at x0 + dx · col, y0 + dy · row."""

    n_row: int
    n_col: int
    x0: float
    y0: float
    dx: float
    dy: float


class TileRows:
    """A table whose rows are in the order of tiles, to read those of one tile."""

    def __init__(self, table: TableData) -> None:
        self.table = table

    @cached_property
    def tiles(self) -> Ids:
        """Tile of each row; none if rows cannot be read, which V701 tells."""
        try:
            parts = [numbers(rows, "tile_id") for _, rows in self.table.batches()]
        except VpfFormatError:
            parts = []
        known = [part for part in parts if part is not None]
        return np.concatenate(known).astype(np.int32) if known else np.empty(0, np.int32)

    @cached_property
    def is_sorted(self) -> bool:
        """Whether all rows can be read, and their tiles rise."""
        is_whole = self.table.head is not None and len(self.tiles) == self.table.n_row
        return is_whole and bool(np.all(self.tiles[1:] >= self.tiles[:-1]))

    def range(self, tile_id: int) -> tuple[int, int]:
        """Index of the first row of a tile, and behind its last."""
        first, last = np.searchsorted(self.tiles, [tile_id, tile_id + 1])
        return int(first), int(last)

    def read(self, tile_id: int) -> Table:
        """Rows of a tile, of a table that `is_sorted`."""
        with open_table(self.table.path) as file:
            return file.read(*self.range(tile_id))


class Sums:
    """What is counted of a level, tile by tile."""

    def __init__(self) -> None:
        self.n_face = self.n_edge = self.n_node = self.n_long = self.n_shared_side = 0
        self.shared_places: list[Floats] = []


class LevelTables:
    """The coverage of one level."""

    def __init__(self, evpf: EvpfData, number: int, coverage: CoverageData) -> None:
        self.evpf, self.number, self.coverage = evpf, number, coverage
        self.sums, self.borders = Sums(), Borders(coverage)
        self.n_face: dict[int, int] = {}
        tables = ((name, coverage.folder.table(name)) for name in BY_TILE)
        self.rows = {name: TileRows(table) for name, table in tables if table is not None}

    @property
    def where(self) -> str:
        """What findings call the coverage."""
        return self.coverage.folder.where

    def place(self, name: str) -> str:
        """What findings call a table of the coverage."""
        return f"table={self.coverage.folder.place(name)}"

    def first_row(self, name: str, tile_id: int) -> int:
        """Index of the first row of a tile."""
        return self.rows[name].range(tile_id)[0]

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The row of ``level.rat``; empty if there is none."""
        table = self.coverage.folder.table("level.rat")
        rows = None if table is None else table.rows
        if rows is None or rows.n_row == 0:
            return {}
        columns = {name: column for name, column in rows.columns.items() if isinstance(column, np.ndarray)}
        return {name: column[0].item() for name, column in columns.items() if column.ndim == 1}


class EvpfTile:
    """One tile of a level, with its features; and the same tile of the level before."""

    def __init__(self, level: LevelTables, tile_id: int, before: EvpfTile | None) -> None:
        folder = level.coverage.tile_folder(tile_id)
        assert folder is not None
        self.level, self.tile_id, self.before = level, tile_id, before
        self.tile = TileData(level.coverage, tile_id, folder)
        self._rows: dict[str, Table | None] = {}

    @property
    def keys(self) -> tuple[str, ...]:
        """The tables that the rules read."""
        own = tuple(self.level.coverage.folder.place(name) for name in self.level.rows)
        return self.tile.keys + own + (() if self.before is None else self.before.keys)

    def rows(self, name: str) -> Table | None:
        """Rows of the tile in a table of the coverage; None if there is no such table, or it is broken."""
        if name not in self._rows:
            table = self.level.rows.get(name)
            self._rows[name] = None if table is None or not table.is_sorted else table.read(self.tile_id)
        return self._rows[name]

    def column(self, name: str, column: str) -> Ids:
        """Whole numbers of a column for the tile; none if there is no such table."""
        found = numbers(self.rows(name), column)
        return np.empty(0, np.int64) if found is None else found

    def tell(self, name: str, message: Callable[[int], str], column: str = "") -> Callable[[int], tuple[str, str]]:
        """Place and message of the rows that the tile has in a table, by their index in `rows`."""
        start = self.level.first_row(name, self.tile_id)
        where = self.level.place(name) + (f" column={column}" if column else "")
        return lambda i: (f"{where} row={start + i + 1}", message(i))

    @property
    def n_face(self) -> int:
        """Faces of the store in the tile; they are faces 1 … of the plane, counted from 0."""
        return len(self.column("tinface.aft", "fac_id"))

    @cached_property
    def junctions(self) -> tuple[Ids, Ids]:
        """Faces and nodes of ``tjunct.rat``, as indices."""
        return self.column("tjunct.rat", "fac_id") - 1, self.column("tjunct.rat", "cnd_id") - 1

    @cached_property
    def _ring_sides(self) -> Ids | None:
        """The side of the start edge of each face of the store; None if not each has one."""
        plane, pointer, edge = (
            self.tile.plane,
            self.tile.column("fac", "ring_ptr"),
            self.tile.column("rng", "start_edge"),
        )
        if plane is None or pointer is None or edge is None or self.n_face >= len(pointer):
            return None
        face = np.arange(1, self.n_face + 1)
        row = pointer[face] - 1
        if not np.all((row >= 0) & (row < len(edge))):
            return None
        start = edge[row] - 1
        if not np.all((start >= 0) & (2 * start < len(plane.side_face))):
            return None
        side = np.where(plane.side_face[2 * start] == face, 2 * start, 2 * start + 1)
        return side if np.array_equal(plane.side_face[side], face) else None

    @property
    def is_sound(self) -> bool:
        """Whether rings and features are such that the tile can be counted."""
        return self._ring_sides is not None and all(table.is_sorted for table in self.level.rows.values())

    @cached_property
    def ring_nodes(self) -> tuple[Ids, Ids]:
        """Nodes round the faces of the store, clockwise: starts int64 (n_face + 1,), and nodes as indices.

        Each ring begins with the node that its start edge leaves.
        """
        plane, graph, side = self.tile.plane, self.tile.graph, self._ring_sides
        if plane is None or graph is None or side is None:
            return np.zeros(1, np.int64), np.empty(0, np.int64)
        side = side.copy()
        length = np.bincount(plane.ring, minlength=plane.n_ring)[plane.ring[side]]
        starts = np.concatenate([[0], np.cumsum(length)])
        nodes = np.empty(starts[-1], np.int64)
        leaves = graph.nodes.ravel()
        going = np.arange(len(length))
        for step in range(int(length.max(initial=0))):
            going = going[length[going] > step]
            nodes[starts[going] + step] = leaves[side[going]]
            side[going] = plane.follower[side[going]]
        return starts, nodes

    @cached_property
    def is_junction(self) -> NDArray[np.bool_]:
        """Of the nodes of `ring_nodes`: whether ``tjunct.rat`` has them as no corners of the face."""
        starts, nodes = self.ring_nodes
        face = np.repeat(np.arange(1, len(starts)), np.diff(starts))
        most = int(nodes.max(initial=0)) + 1
        faces, inside = self.junctions
        found: NDArray[np.bool_] = np.isin(face * most + nodes, faces * most + np.minimum(inside, most))
        return found

    @cached_property
    def corners(self) -> Ids:
        """Corners of the faces, counter-clockwise, indices of nodes (n_face, 3); all faces have three."""
        nodes: Ids = self.ring_nodes[1][~self.is_junction].reshape(-1, 3)[:, ::-1]
        return nodes

    @cached_property
    def has_three_corners(self) -> bool:
        """Whether each face has."""
        starts = self.ring_nodes[0]
        if len(starts) != self.n_face + 1:
            return False
        count = (
            np.add.reduceat(np.concatenate([~self.is_junction, [False]]), starts[:-1])
            if len(starts) > 1
            else np.empty(0)
        )
        return bool(np.all(count == 3)) and bool(np.all(np.diff(starts) >= 3))


class EvpfData:
    """A library whose coverages ``tin0``, ``tin1`` … are the levels of a TIN."""

    def __init__(self, library: LibraryData) -> None:
        self.library = library
        names = [f"tin{number}" for number in range(MOST_LEVELS)]
        there = [name for name in names if name in library.coverage_paths]
        self.names = tuple(there)
        self.levels = [
            LevelTables(self, i, library.coverage(name)) for i, name in enumerate(names[: len(there)]) if name in there
        ]

    @staticmethod
    def find(library: LibraryData) -> EvpfData | None:
        """The levels of a library; None if it has none."""
        path = library.coverage_paths.get("tin0")
        if path is None or "evpf.rat" not in library.coverage("tin0").folder.files:
            return None
        return EvpfData(library)

    @property
    def where(self) -> str:
        """What findings call the first coverage."""
        return self.levels[0].where

    @cached_property
    def metadata(self) -> dict[str, str]:
        """Rows of ``evpf.rat``; names that come twice once."""
        table = self.levels[0].coverage.folder.table("evpf.rat")
        rows = None if table is None or table.n_row > MOST_ROWS else table.rows
        names, values = text_values(rows, "name"), text_values(rows, "value")
        if names is None or values is None:
            return {}
        try:
            pairs = zip(names, values, strict=True)
            return {from_vpf(name or ""): from_vpf(value or "") for name, value in pairs}
        except VpfFormatError:
            return {}

    @property
    def is_double(self) -> bool:
        """Whether coordinates are as in the store, not rounded to single precision."""
        return self.metadata.get("precision") == "double"

    @cached_property
    def lattice(self) -> Lattice | None:
        """The posts; None if ``evpf.rat`` does not tell them."""
        try:
            found = json.loads(self.metadata.get("lattice", ""))
            lattice = Lattice(*(found[name] for name in Lattice._fields))
        except (ValueError, TypeError, KeyError, RecursionError):
            return None
        is_whole = all(isinstance(number, int) and 0 < number < 2**31 for number in lattice[:2])
        is_real = all(isinstance(number, int | float) and abs(number) < 1e12 for number in lattice[2:])
        return lattice if is_whole and is_real and lattice.dx > 0 and lattice.dy > 0 else None

    @cached_property
    def tiling(self) -> Tiling | None:
        """The tiles that lattice and tile size make; None if these are not known, or the tiles are too many."""
        size = self.number("tile_size")
        if self.lattice is None or not size or _least_tiles(self.lattice, size) > MOST_TILES:
            return None
        try:
            return Tiling(self.lattice.n_row, self.lattice.n_col, size, 1)
        except InputError:
            return None

    def number(self, name: str) -> int | None:
        """A whole number of ``evpf.rat``; None if it is none."""
        text = self.metadata.get(name, "")
        return int(text) if text.isascii() and text.isdigit() and len(text) < 10 else None

    @cached_property
    def is_nested(self) -> bool:
        """Whether each face has one parent: no ``parent.rat`` has areas."""
        return not any(
            table.table.head is not None and table.table.head.layout.find("area") is not None
            for level in self.levels
            for name, table in level.rows.items()
            if name == "parent.rat"
        )

    def tiles(self) -> Iterator[EvpfTile]:
        """Yield the tiles of the levels: tile by tile, from coarse to fine."""
        for tile_id in sorted(self.library.tiles):
            before = None
            for level in self.levels:
                if level.coverage.tile_folder(tile_id) is None:
                    before = None
                    continue
                if before is not None:
                    before.before = None
                before = EvpfTile(level, tile_id, before)
                yield before


def _least_tiles(lattice: Lattice, size: int) -> int:
    """How many tiles of a size a lattice has, at least."""
    return max(1, lattice.n_row // size) * max(1, lattice.n_col // size)


def spacing_of(data: EvpfData) -> float:
    """Spacing of numbers, as coordinates are written, at the greatest of the extent."""
    lattice = data.lattice
    assert lattice is not None
    ends = (lattice.x0, lattice.x0 + lattice.dx * lattice.n_col, lattice.y0, lattice.y0 + lattice.dy * lattice.n_row)
    greatest = max(abs(number) for number in ends)
    return float(np.spacing(greatest if data.is_double else np.float32(greatest)))
