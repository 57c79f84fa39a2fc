"""The lattice on which the posts of a DEM lie (pure arithmetic).

Post (row, col) lies at ``x0 + col * dx``, ``y0 + row * dy``; row 0 is the southernmost.

A file states its transform with 12 to 17 digits, so the same posts come out a hair apart from an HGT, an ASCII grid
and a GeoTIFF. `Lattice.tidied` takes that noise away, and nothing else: a spacing within 1e-9 of itself of p / q
arc-seconds (CRS in degrees) or CRS units (any other), q up to 100, becomes that number; then an origin within 1e-6 of
a spacing of a whole number of half spacings becomes that number. Everything else stays as the file has it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import NamedTuple

from vpfx.model import Extent

__all__ = ["Lattice", "Window"]

SPACING_TOLERANCE = 1e-9  # of a spacing: what 12 printed digits leave open
ORIGIN_TOLERANCE = 1e-6  # of a spacing: 0.03 mm at one arc-second
MAX_DENOMINATOR = 100  # finest fraction of an arc-second or CRS unit that is taken for meant
ARCSECONDS = 3600  # per degree


class Window(NamedTuple):
    """A block of posts by index, stops not included.

    Examples
    --------
    >>> Window(0, 4, 0, 4).common(Window(3, 9, 1, 2))
    Window(row_start=3, row_stop=4, col_start=1, col_stop=2)
    """

    row_start: int
    row_stop: int
    col_start: int
    col_stop: int

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of rows and columns, 0 if there are none."""
        return max(0, self.row_stop - self.row_start), max(0, self.col_stop - self.col_start)

    def common(self, other: Window) -> Window:
        """Return the posts in both, perhaps none."""
        return Window(
            max(self.row_start, other.row_start),
            min(self.row_stop, other.row_stop),
            max(self.col_start, other.col_start),
            min(self.col_stop, other.col_stop),
        )

    def moved(self, rows: int, cols: int) -> Window:
        """Return the same posts counted from an origin that lies so many rows and columns to the south-west."""
        return Window(self.row_start + rows, self.row_stop + rows, self.col_start + cols, self.col_stop + cols)


@dataclass(frozen=True)
class Lattice:
    """Places of the posts of a DEM.

    Attributes
    ----------
    n_row, n_col : int
        Numbers of posts.
    x0, y0 : float
        Place of the south-western post in CRS units.
    dx, dy : float
        Spacing in CRS units, positive.
    unit_parts : int
        Into how many parts a CRS unit is cut before simple fractions are looked for: 3600 for degrees, else 1.

    Examples
    --------
    An HGT tile as its transform tells it, and as it is meant:

    >>> noisy = Lattice(1201, 1201, 10.999999999999998, 49.0, 0.00083333333333, 0.00083333333333, ARCSECONDS)
    >>> tidy = noisy.tidied()
    >>> tidy.x0, tidy.dx == 3 / 3600, tidy.extent
    (11.0, True, Extent(min_x=11.0, min_y=49.0, max_x=12.0, max_y=50.0))
    """

    n_row: int
    n_col: int
    x0: float
    y0: float
    dx: float
    dy: float
    unit_parts: int = 1

    @property
    def extent(self) -> Extent:
        """The rectangle spanned by the posts."""
        x1, y1 = self.place(self.n_row - 1, self.n_col - 1)
        return Extent(self.x0, self.y0, x1, y1)

    @property
    def window(self) -> Window:
        """All posts."""
        return Window(0, self.n_row, 0, self.n_col)

    def place(self, row: float, col: float) -> tuple[float, float]:
        """Return x and y of a post, in CRS units."""
        return self.x0 + col * self.dx, self.y0 + row * self.dy

    def tidied(self) -> Lattice:
        """Return the lattice without the noise of printed and added numbers (see the top of this file)."""
        dx, x0 = _tidied(self.dx, self.x0, self.unit_parts)
        dy, y0 = _tidied(self.dy, self.y0, self.unit_parts)
        return replace(self, x0=x0, y0=y0, dx=dx, dy=dy)

    def part(self, window: Window) -> Lattice:
        """Return the lattice of a block of posts; the block may reach beyond this one."""
        x0, y0 = self.place(window.row_start, window.col_start)
        n_row, n_col = window.shape
        return replace(self, n_row=n_row, n_col=n_col, x0=x0, y0=y0).tidied()

    def offset(self, other: Lattice) -> tuple[float, float]:
        """Return how many rows and columns the first post of `other` lies north and east of ours."""
        return (other.y0 - self.y0) / self.dy, (other.x0 - self.x0) / self.dx

    def posts_in(self, extent: Extent) -> Window:
        """Return the posts inside an extent, borders included, perhaps none."""
        cols = _indices(extent.min_x, extent.max_x, self.x0, self.dx, self.n_col)
        rows = _indices(extent.min_y, extent.max_y, self.y0, self.dy, self.n_row)
        return Window(*rows, *cols)


def _tidied(spacing: float, origin: float, unit_parts: int) -> tuple[float, float]:
    """Return spacing and origin of one axis as simple fractions where they are so but for noise."""
    step = Fraction(spacing * unit_parts).limit_denominator(MAX_DENOMINATOR) / unit_parts
    if abs(step - Fraction(spacing)) > SPACING_TOLERANCE * spacing:
        return spacing, origin
    tidy_origin = round(Fraction(origin) / (step / 2)) * (step / 2)
    if abs(tidy_origin - Fraction(origin)) > ORIGIN_TOLERANCE * spacing:
        return float(step), origin
    return float(step), float(tidy_origin)


def _indices(low: float, high: float, origin: float, spacing: float, count: int) -> tuple[int, int]:
    """Return start and stop of the indices whose places lie between `low` and `high`."""
    start = math.ceil((low - origin) / spacing - ORIGIN_TOLERANCE)
    stop = math.floor((high - origin) / spacing + ORIGIN_TOLERANCE) + 1
    return min(max(start, 0), count), max(min(stop, count), 0)
