"""From a DEM to patches: the posts of one tile with everything a method needs, read with one post more on every side.

What happens on a border between tiles is settled here, from the posts of the border and from which ground beside it has
data; both tiles settle it alike (specs/methods.md M-200).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from rasterio.fill import fillnodata

from vpfx.errors import InputError
from vpfx.methods.base import Border, Method, Patch
from vpfx.methods.borders import border_nodes
from vpfx.methods.ground import corners_on_ground, outline_nodes, square_codes
from vpfx.methods.start import grid_posts
from vpfx.store.tiles import EAST, NORTH, SOUTH, WEST, Tile, Tiling

__all__ = ["FilledLines", "Ground", "PatchReader"]

Floats = NDArray[np.float64]
NOTHING_TO_FILL = "fill: found no valid post in the DEM, expected some"
FREE = Border(np.empty(0, np.int32), 0, np.empty(0, np.int32), False)


class Ground(NamedTuple):
    """How much ground has data.

    Attributes
    ----------
    posts, void_posts : int
        Posts of the DEM, and those that are void.
    isolated_posts : int
        Valid posts that no face touches, because no two valid neighbours make a lattice triangle with them.
    area_m2, void_area_m2 : float
        Area of the extent, and of what has no data.
    """

    posts: int
    void_posts: int
    isolated_posts: int
    area_m2: float
    void_area_m2: float

    def plus(self, other: Ground) -> Ground:
        """Sum of two grounds."""
        return Ground(*(a + b for a, b in zip(self, other, strict=True)))  # type: ignore[arg-type]


class Posts(Protocol):
    """What patches are read from: a `vpfx.dem.Dem`, or a grid in memory."""

    @property
    def n_row(self) -> int:
        """Rows of posts."""

    @property
    def n_col(self) -> int:
        """Columns of posts."""

    def read(self, row_start: int, row_stop: int, col_start: int, col_stop: int) -> Floats:
        """Heights of a window, metres, row 0 in the south, NaN for voids."""

    def post_metres(self, row_start: int, row_stop: int, col_start: int, col_stop: int) -> tuple[float, float]:
        """Width and height of a post spacing in the middle of a window, metres."""


class FilledLines:
    """Heights of the border lines of a tiling with voids filled, the same for both neighbours.

    Lines that run from west to east are filled first, by straight lines between valid posts; one without any takes the
    heights of the nearest line that has some. Lines that run north take the posts they share with those as given.
    """

    def __init__(self, dem: Posts, tiling: Tiling) -> None:
        rows = [dem.read(row, row + 1, 0, dem.n_col)[0] for row in tiling.row_lines.tolist()]
        has_data = np.flatnonzero([not np.isnan(row).all() for row in rows])
        if len(has_data) == 0:
            if all(np.isnan(dem.read(row, row + 1, 0, dem.n_col)).all() for row in range(dem.n_row)):
                raise InputError(NOTHING_TO_FILL)
            raise InputError(
                "fill: found no valid post on rows of tile borders, expected some; try another --tile-size"
            )
        nearest = [has_data[np.argmin(np.abs(has_data - i))] for i in range(len(rows))]
        self.across = {line: _filled(rows[i]) for line, i in zip(tiling.row_lines.tolist(), nearest, strict=True)}
        self.along: dict[int, Floats] = {}
        for col in tiling.col_lines.tolist():
            heights = dem.read(0, dem.n_row, col, col + 1)[:, 0]
            for row, line in self.across.items():
                heights[row] = line[col]
            self.along[col] = _filled(heights)


def _filled(heights: Floats) -> Floats:
    index = np.arange(len(heights))
    valid = ~np.isnan(heights)
    return np.interp(index, index[valid], heights[valid])


class PatchReader:
    """Reads the patches of a DEM; from one thread.

    Parameters
    ----------
    dem : Posts
    tiling : Tiling
    method : Method
    options : mapping
        All options of the method.
    fill : bool
        Whether ground without data is covered too.
    seed : int
        Start of all random choices.
    has_more : bool
        As in `Patch`.
    lines : tuple of float64 (n, 3)
        Surveyed lines: u, v in posts of the DEM, heights in metres or NaN.
    """

    def __init__(
        self, dem: Posts, tiling: Tiling, method: Method, options: Mapping[str, Any], fill: bool = False, seed: int = 0,
        has_more: bool = False, lines: tuple[Floats, ...] = (),
    ) -> None:  # fmt: skip
        self._lines = lines
        self._bounds = np.array([[*line[:, :2].min(axis=0), *line[:, :2].max(axis=0)] for line in lines]).reshape(-1, 4)
        self._dem, self._tiling, self._seed, self._has_more = dem, tiling, seed, has_more
        self._rules = method.levels(options)
        width, height = dem.post_metres(0, dem.n_row, 0, dem.n_col)
        self._aspect = width / height
        self._method, self._options = method, options
        self.ground = Ground(0, 0, 0, 0.0, 0.0)
        self._filled_lines = FilledLines(dem, tiling) if fill and tiling.n_tile > 1 else None
        self._fill = fill

    def read(self, tile: Tile) -> Patch:
        """Read the patch of a tile."""
        halo = np.full((tile.shape[0] + 2, tile.shape[1] + 2), np.nan)
        rows = max(tile.first_row - 1, 0), min(tile.last_row + 2, self._dem.n_row)
        cols = max(tile.first_col - 1, 0), min(tile.last_col + 2, self._dem.n_col)
        at_row, at_col = rows[0] - tile.first_row + 1, cols[0] - tile.first_col + 1
        halo[at_row : at_row + rows[1] - rows[0], at_col : at_col + cols[1] - cols[0]] = self._dem.read(*rows, *cols)
        squares = square_codes(~np.isnan(halo))
        valid = ~np.isnan(halo[1:-1, 1:-1])
        heights = np.ascontiguousarray(halo[1:-1, 1:-1])
        if self._fill:
            heights = self._fill_voids(tile, heights)
        metres = self._dem.post_metres(tile.first_row, tile.last_row + 1, tile.first_col, tile.last_col + 1)
        self._count(tile, squares, valid, metres)
        borders = tuple(self._border(tile, side, squares, heights) for side in (SOUTH, EAST, NORTH, WEST))
        return Patch(
            heights=heights,
            squares=np.ascontiguousarray(squares[1:-1, 1:-1]),
            borders=borders,  # type: ignore[arg-type]
            post_metres=metres,
            is_owned=valid & corners_on_ground(squares[1:-1, 1:-1]) & ~self._is_counted_before(squares),
            keeps_voids=self._fill,
            seed=self._seed * self._tiling.n_tile + tile.number,
            n_square=self._method.squares(self._options, len(heights), heights.shape[1], self._aspect),
            has_more=self._has_more,
            lines=self._lines_on(tile),
        )

    def _lines_on(self, tile: Tile) -> tuple[Floats, ...]:
        """Lines whose bounds touch a tile, in its posts."""
        west, south, east, north = self._bounds.T
        touches = (
            (west <= tile.last_col) & (east >= tile.first_col) & (south <= tile.last_row) & (north >= tile.first_row)
        )
        corner = np.array([tile.first_col, tile.first_row, 0.0])
        return tuple(self._lines[i] - corner for i in np.flatnonzero(touches))

    def _count(
        self, tile: Tile, squares: NDArray[np.uint8], valid: NDArray[np.bool_], metres: tuple[float, float]
    ) -> None:
        """Add the ground of a tile; posts on a border count for the tile to the east or north."""
        row_stop = tile.shape[0] - (tile.row + 1 < self._tiling.n_tile_row)
        col_stop = tile.shape[1] - (tile.col + 1 < self._tiling.n_tile_col)
        own = valid[:row_stop, :col_stop]
        is_isolated = own & ~corners_on_ground(squares)[1:-1, 1:-1][:row_stop, :col_stop]
        codes = squares[1:-1, 1:-1]
        covered = np.where(codes == 15, 1.0, np.where(codes > 0, 0.5, 0.0))
        square = metres[0] * metres[1]
        found = own.size, int(own.size - own.sum()), int(is_isolated.sum()), codes.size * square
        self.ground = self.ground.plus(Ground(*found, float(codes.size - covered.sum()) * square))

    def _fill_voids(self, tile: Tile, heights: Floats) -> Floats:
        heights = heights.copy()
        if self._filled_lines:
            rows, cols = slice(tile.first_row, tile.last_row + 1), slice(tile.first_col, tile.last_col + 1)
            for line, row in ((0, tile.first_row), (-1, tile.last_row)):
                heights[line] = self._filled_lines.across[row][cols]
            for line, col in ((0, tile.first_col), (-1, tile.last_col)):
                heights[:, line] = self._filled_lines.along[col][rows]
        valid = ~np.isnan(heights)
        if not valid.any():
            raise InputError(NOTHING_TO_FILL)
        if not valid.all():
            filled = fillnodata(np.nan_to_num(heights), valid, max_search_distance=float(sum(heights.shape)))
            heights = np.where(valid, heights, filled)
        return heights

    def _border(self, tile: Tile, side: int, squares: NDArray[np.uint8], heights: Floats) -> Border:
        """Nodes of one side; `squares` has one square more than the tile on every side."""
        if self._tiling.border(tile, side) < 0:
            return FREE
        inner = squares[1:-1, 1:-1]
        line, inside, outside = {
            SOUTH: (heights[0], inner[:1], squares[:1, 1:-1]),
            NORTH: (heights[-1], inner[-1:], squares[-1:, 1:-1]),
            WEST: (heights[:, 0], inner[:, :1], squares[1:-1, :1]),
            EAST: (heights[:, -1], inner[:, -1:], squares[1:-1, -1:]),
        }[side]
        is_across = side in (SOUTH, NORTH)
        before = side in (SOUTH, WEST)  # the border is the first line of the inside strip, the last of the outside one
        forced = np.zeros(len(line), bool)
        for strip, at in ((inside, 0 if before else -1), (outside, -1 if before else 0)):
            nodes = outline_nodes(strip)
            forced |= nodes[at] if is_across else nodes[:, at]
        n_square = self._method.squares(self._options, len(line), len(line), self._aspect)[1 if is_across else 0]
        forced[grid_posts(len(line), n_square)] = True
        row = {SOUTH: tile.first_row, NORTH: tile.last_row}.get(side)
        col = {WEST: tile.first_col, EAST: tile.last_col}.get(side)
        rows = (tile.first_row, tile.last_row + 1) if row is None else (row, row + 1)
        cols = (tile.first_col, tile.last_col + 1) if col is None else (col, col + 1)
        metres = self._dem.post_metres(*rows, *cols)[0 if is_across else 1]
        return border_nodes(np.ascontiguousarray(line), forced, self._rules, metres)

    def _is_counted_before(self, squares: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Posts that a tile of lower number covers too: those to the west, and those to the south."""
        before = np.zeros_like(squares)
        before[0] = squares[0]
        before[1:-1, 0] = squares[1:-1, 0]
        return corners_on_ground(before)[1:-1, 1:-1]
