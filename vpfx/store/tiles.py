"""The cut of an extent into tiles, and the ids that follow from it.

A lattice of n_row × n_col posts is cut along lines of posts; neighbouring tiles share the posts of their border. Places on
borders get their ids from the border, so that both neighbours know them without talking (specs/format.md R-152).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.checks import whole_number
from vpfx.errors import InvariantError

__all__ = ["DEFAULT_TILE_SIZE", "Place", "Tile", "Tiling"]

DEFAULT_TILE_SIZE = 512  # post spacings; see specs/methods.md M-220 for the figures behind it
LEAST_TILE_SIZE = 8
SOUTH, EAST, NORTH, WEST = range(4)
# Outline edges of a tile that end on one of its four borders, for each post of a border: two in each half plane.
LATE_SHARE = 8


class Place(NamedTuple):
    """Where posts lie: post (row, col) at x0 + dx·col, y0 + dy·row, CRS units.

    Examples
    --------
    >>> Place(500000.0, 4000000.0, 10.0, 20.0).at(2, 0.5)
    (500020.0, 4000010.0)
    """

    x0: float
    y0: float
    dx: float
    dy: float

    def at(self, col: Any, row: Any) -> tuple[Any, Any]:
        """Return x and y of posts or of places between, numbers or arrays, computed as R-130 says, to the bit."""
        return self.x0 + self.dx * col, self.y0 + self.dy * row


class Tile(NamedTuple):
    """One tile: its number and the posts it spans, first and last included."""

    number: int
    row: int
    col: int
    first_row: int
    last_row: int
    first_col: int
    last_col: int

    @property
    def name(self) -> str:
        """Name in the store."""
        return f"r{self.row}c{self.col}"

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of posts."""
        return self.last_row - self.first_row + 1, self.last_col - self.first_col + 1


class Tiling:
    """Tiles of a lattice of posts.

    Parameters
    ----------
    n_row, n_col : int
        Posts.
    tile_size : int
        Greatest number of post spacings along a side of a tile.
    n_level : int
        Levels, for the ids of border edges.

    Raises
    ------
    InputError
        The tile size is too small or not whole.

    Examples
    --------
    >>> tiling = Tiling(601, 1201, 512, n_level=3)
    >>> tiling.n_tile, tiling.tile(1)
    (6, Tile(number=1, row=0, col=1, first_row=0, last_row=300, first_col=400, last_col=800))
    """

    def __init__(self, n_row: int, n_col: int, tile_size: int, n_level: int) -> None:
        self.tile_size = whole_number(tile_size, "tile size", LEAST_TILE_SIZE)
        self.row_lines = _lines(n_row, self.tile_size)
        self.col_lines = _lines(n_col, self.tile_size)
        self.n_tile_row, self.n_tile_col = len(self.row_lines) - 1, len(self.col_lines) - 1
        self.n_tile = self.n_tile_row * self.n_tile_col
        self.n_level = n_level
        self.border_width = int(max(np.diff(self.row_lines).max(), np.diff(self.col_lines).max()))
        self._n_across = (self.n_tile_row - 1) * self.n_tile_col  # borders that run from west to east
        self.n_border = self._n_across + self.n_tile_row * (self.n_tile_col - 1)
        self.n_corner = (self.n_tile_row + 1) * (self.n_tile_col + 1) if self.n_border else 0

    def tile(self, index: int) -> Tile:
        """Return the tile with that index, counted from 0 in the south-west, west to east."""
        row, col = divmod(index, self.n_tile_col)
        rows, cols = self.row_lines, self.col_lines
        return Tile(index, row, col, int(rows[row]), int(rows[row + 1]), int(cols[col]), int(cols[col + 1]))

    def border(self, tile: Tile, side: int) -> int:
        """Number of the border on a side of a tile; -1 where that is the outside of the extent."""
        if side in (SOUTH, NORTH):
            line = tile.row + (side == NORTH)
            return -1 if line in (0, self.n_tile_row) else (line - 1) * self.n_tile_col + tile.col
        line = tile.col + (side == EAST)
        if line in (0, self.n_tile_col):
            return -1
        return self._n_across + tile.row * (self.n_tile_col - 1) + line - 1

    @property
    def n_border_node_id(self) -> int:
        """Ids of nodes set aside for corners and borders: 1 … this."""
        return self.n_corner + self.n_border * self.border_width

    @property
    def _n_level_edge_id(self) -> int:
        """Ids of edges set aside for the borders of one level: those on borders, then those that end there."""
        return (self.n_border + self.n_tile * LATE_SHARE) * self.border_width if self.n_border else 0

    @property
    def n_border_edge_id(self) -> int:
        """Ids of edges set aside for borders: 1 … this."""
        return self.n_level * self._n_level_edge_id

    def border_edge_ids(self, level: int) -> tuple[int, int] | None:
        """First and last id set aside for the border edges of a level; None if there are no borders."""
        if not self.n_border:
            return None
        first = 1 + level * self._n_level_edge_id
        return first, first + self._n_level_edge_id - 1

    def shared_node_ids(self, tile: Tile, u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.int64]:
        """Ids of the nodes at (u, v), in posts from the tile's south-west; 0 for nodes of the tile alone."""
        ids = np.zeros(len(u), np.int64)
        if not self.n_border:
            return ids
        n_row, n_col = tile.shape
        lines = (v == 0, u == n_col - 1, v == n_row - 1, u == 0)
        along = (u, v, u, v)
        for side in range(4):
            border = self.border(tile, side)
            if border >= 0:
                on = lines[side]
                ids[on] = self.n_corner + border * self.border_width + along[side][on].astype(np.int64)
        corner = 1 + (tile.row + (v > 0)) * (self.n_tile_col + 1) + tile.col + (u > 0)
        return np.where((lines[SOUTH] | lines[NORTH]) & (lines[EAST] | lines[WEST]), corner, ids)

    def border_edge_id(self, border: int, level: int, offset: NDArray[np.int64]) -> NDArray[np.int64]:
        """Ids of border edges of a level that start `offset` posts from the border's west or south end."""
        ids: NDArray[np.int64] = 1 + level * self._n_level_edge_id + border * self.border_width + offset
        return ids

    def late_edge_id(self, tile: Tile, level: int, index: NDArray[np.int64]) -> NDArray[np.int64]:
        """Ids of the edges of one tile and level that lie on an outline and end on a border, counted from 0.

        Raises
        ------
        InvariantError
            There are more than the octants round the posts of a border allow.
        """
        room = LATE_SHARE * self.border_width
        if len(index) > room:
            raise InvariantError(
                f"tile {tile.name}: found {len(index)} outline edges on borders, expected at most {room}"
            )
        first = 1 + level * self._n_level_edge_id + self.n_border * self.border_width
        ids: NDArray[np.int64] = first + tile.number * room + index
        return ids

    def edge_owner(self, edge_id: NDArray[np.int64]) -> NDArray[np.int64]:
        """Index of the tile of each edge set aside for borders."""
        at = (edge_id - 1) % self._n_level_edge_id
        is_late = at >= self.n_border * self.border_width
        late = (at - self.n_border * self.border_width) // (LATE_SHARE * self.border_width)
        return np.where(is_late, late, self.border_owner(at // self.border_width))

    def border_owner(self, border: NDArray[np.int64]) -> NDArray[np.int64]:
        """Index of the tile of least id on each border."""
        row, col = np.divmod(border - self._n_across, max(1, self.n_tile_col - 1))
        return np.where(border < self._n_across, border, row * self.n_tile_col + col)

    def node_owner(self, node_id: NDArray[np.int64]) -> NDArray[np.int64]:
        """Index of the tile of least id at each border or corner node."""
        row, col = np.divmod(node_id - 1, self.n_tile_col + 1)
        corner = np.maximum(row - 1, 0) * self.n_tile_col + np.maximum(col - 1, 0)
        border = self.border_owner((node_id - 1 - self.n_corner) // self.border_width)
        return np.where(node_id <= self.n_corner, corner, border)


def _lines(n_post: int, tile_size: int) -> NDArray[np.int64]:
    """Posts at which a side is cut: as few tiles as the size allows, as even as whole posts allow."""
    n_tile = -(-(n_post - 1) // tile_size)
    return (2 * np.arange(n_tile + 1, dtype=np.int64) * (n_post - 1) + n_tile) // (2 * n_tile)
