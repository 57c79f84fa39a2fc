"""`Dem`: elevation files of any size, read block by block; `open_dem` and `read_grid`."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from vpfx.dem.lattice import Lattice, Window
from vpfx.dem.mosaic import MAX_OPEN_FILES, Part, check_overlap, close_some, join, merge, overlaps
from vpfx.dem.paths import Source
from vpfx.dem.raster import Options, Raster
from vpfx.dem.reference import ground_size
from vpfx.errors import DemFormatError, InputError
from vpfx.model import Extent, Grid

__all__ = ["Dem", "open_dem", "read_grid"]

Paths = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]

MAX_GRID_POSTS = 1 << 27  # 1 GiB of heights


class Dem:
    """Elevation posts of one file, or of several on one lattice, read block by block.

    Made by `open_dem`. A context manager; use it from one thread only, since GDAL datasets are not shared.

    Attributes
    ----------
    n_row, n_col : int
        Numbers of posts.
    x0, y0 : float
        Place of post (row 0, column 0), the south-western one, in CRS units. Post (row, col) lies at
        ``x0 + col * dx``, ``y0 + row * dy``.
    dx, dy : float
        Spacing of columns and rows in CRS units, positive.
    crs : str
        WKT2 of the horizontal CRS; empty if unknown.
    vertical_unit : str
        Unit of the heights as stored: ``metre``, ``foot``, ``us_survey_foot`` … `read` gives metres in any case.
    vertical_unit_is_assumed : bool
        Neither the files nor the user named the unit; metres were taken.
    vertical_datum : str
        Such as ``EPSG:5773`` (EGM96 height), a name if it has no code, or ``unknown``.
    sources : tuple of Source
        The files, sorted by place (south to north, west to east).
    """

    def __init__(self, lattice: Lattice, parts: Sequence[Part]) -> None:
        self.n_row, self.n_col = lattice.n_row, lattice.n_col
        self.x0, self.y0, self.dx, self.dy = lattice.x0, lattice.y0, lattice.dx, lattice.dy
        reference = parts[0].raster.reference
        self.crs = reference.crs
        self.vertical_unit = reference.unit.name
        self.vertical_unit_is_assumed = all(part.raster.reference.unit_is_assumed for part in parts)
        self.vertical_datum = reference.vertical_datum
        self.sources: tuple[Source, ...] = tuple(part.raster.source for part in parts)
        self._lattice = lattice
        self._parts = tuple(parts)
        self._is_closed = False
        self._crs = CRS.from_wkt(self.crs) if self.crs else None
        if self._crs is not None and self._crs.is_geographic:
            self._check_latitudes(self._crs)

    def __enter__(self) -> Dem:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close all files; the DEM cannot be read any more."""
        self._is_closed = True
        for part in self._parts:
            part.raster.close()

    @property
    def extent(self) -> Extent:
        """The rectangle spanned by the posts, in CRS units."""
        return self._lattice.extent

    def read(self, row_start: int, row_stop: int, col_start: int, col_stop: int) -> NDArray[np.float64]:
        """Return the heights of a block of posts.

        Parameters
        ----------
        row_start, row_stop, col_start, col_stop : int
            Indices of posts, stops not included; row 0 is the southernmost, column 0 the westernmost.

        Returns
        -------
        float64 (row_stop - row_start, col_stop - col_start)
            Metres, southernmost row first; NaN is a void.

        Raises
        ------
        InputError
            The block is empty or reaches beyond the posts, or the DEM is closed.
        DemFormatError
            A file cannot be read there, holds an infinite height, or two files disagree about a post.

        Notes
        -----
        Memory: the block, and one file's share of it; GDAL caches some blocks of the files besides (GDAL_CACHEMAX).

        Examples
        --------
        >>> with open_dem("fixtures/dem/new_mexico_cell_5min_1arcsec.tif") as dem:
        ...     dem.read(0, 2, 0, 3).round(1).tolist()
        [[2164.8, 2172.0, 2172.7], [2168.7, 2171.2, 2174.7]]
        """
        window = self._checked(row_start, row_stop, col_start, col_stop)
        return merge(self._parts, self._lattice, window)

    def post_metres(self, row_start: int, row_stop: int, col_start: int, col_stop: int) -> tuple[float, float]:
        """Return width and height of one post spacing in metres, at the middle of a block.

        Parameters
        ----------
        row_start, row_stop, col_start, col_stop : int
            As for `read`.

        Returns
        -------
        tuple of float
            Geographic CRS: along the ellipsoid. Projected CRS: the spacing by the unit of the axes, scale errors of
            the projection left in. No CRS: the spacing as it is.

        Raises
        ------
        InputError
            The block is empty or reaches beyond the posts, or the DEM is closed.

        Examples
        --------
        >>> with open_dem("fixtures/dem/new_mexico_cell_5min_1arcsec.tif") as dem:
        ...     width, height = dem.post_metres(0, 300, 0, 300)
        >>> round(width, 2), round(height, 2)
        (24.93, 30.82)
        """
        window = self._checked(row_start, row_stop, col_start, col_stop)
        x, y = self._lattice.place((window.row_start + row_stop - 1) / 2, (col_start + col_stop - 1) / 2)
        return ground_size(self._crs, x, y, self.dx, self.dy)

    def check_overlaps(self) -> None:
        """Compare all posts that two files share; only those are read. `open_dem` does this for several files.

        Raises
        ------
        DemFormatError
            Two files disagree; the message names both, the first post with both heights, and counts the others.
        """
        window = self._lattice.window
        for one, other in overlaps(self._parts, window):
            check_overlap(one, other, self._lattice, window)
            close_some(self._parts)

    def _check_latitudes(self, crs: CRS) -> None:
        """Refuse degrees that are none; posts may lie a spacing behind a pole, as of rasters whose pixels end there."""
        factor = math.degrees(crs.axis_info[0].unit_conversion_factor)
        south, north = self.extent.min_y * factor, self.extent.max_y * factor
        if max(-south, north) > 90.0 + self.dy * factor:
            found = f"found latitudes from {south:g}° to {north:g}°, expected -90° … 90°"
            raise DemFormatError(self.sources[0].path, "georeference", f"{found}; the CRS cannot be {crs.name}")

    def _checked(self, row_start: int, row_stop: int, col_start: int, col_stop: int) -> Window:
        """Return a block of posts that exists."""
        if self._is_closed:
            raise InputError("dem: found a closed DEM, expected an open one; read inside the with block")
        window = Window(row_start, row_stop, col_start, col_stop)
        if not (0 <= row_start < row_stop <= self.n_row and 0 <= col_start < col_stop <= self.n_col):
            raise InputError(f"dem: found {window}, expected posts of 0…{self.n_row} rows and 0…{self.n_col} columns")
        return window


def open_dem(
    paths: Paths,
    *,
    crs: Any = None,
    bbox: Sequence[float] | None = None,
    band: int = 1,
    nodata: float | None = None,
    vertical_unit: str | None = None,
    vertical_datum: str | None = None,
) -> Dem:
    """Open elevation files that GDAL can read as one lattice of posts.

    Parameters
    ----------
    paths : path or sequence of paths
        Local files, also inside ``.gz`` or, one to each, ``.zip``. Several files must lie on one lattice.
    crs : anything pyproj accepts, optional
        For files that state none. A compound CRS also gives vertical datum and unit.
    bbox : Extent or four numbers, optional
        Only the posts inside, borders included; min_x, min_y, max_x, max_y in CRS units.
    band : int
        Band to read, from 1.
    nodata : float, optional
        Value that marks voids, instead of the one in the file. NaN and masked posts are voids in any case.
    vertical_unit : str, optional
        ``metre``, ``foot``, ``us_survey_foot``, ``decimetre`` or ``centimetre``, whatever the file says.
    vertical_datum : str, optional
        Such as ``EPSG:5773``, whatever the file says.

    Returns
    -------
    Dem
        To be closed, or used in a ``with`` statement.

    Raises
    ------
    InputError
        An option has no meaning or contradicts a file, a path is not local, or fewer than 2 × 2 posts are left.
    NotFoundError
        There is no such file.
    DemFormatError
        A file is no raster, has no place or a rotated one, or the files do not fit or agree.

    Notes
    -----
    A post is the centre of a pixel. Spacing and origin are rid of rounding noise: see `vpfx.dem.lattice`.
    Cost: each file is read once for its digest, and what files share once more.

    Examples
    --------
    >>> with open_dem("fixtures/dem/new_mexico_n36_w108.dt2") as dem:
    ...     dem.n_row, dem.n_col, dem.vertical_unit, dem.vertical_datum
    (300, 300, 'metre', 'EPSG:5773')
    """
    options = Options.parse(
        band=band, nodata=nodata, crs=crs, vertical_unit=vertical_unit, vertical_datum=vertical_datum
    )
    names = [os.fspath(paths)] if isinstance(paths, str | os.PathLike) else [os.fspath(path) for path in paths]
    if not names:
        raise InputError("paths: found no file, expected at least one")
    rasters: list[Raster] = []
    try:
        for name in names:
            rasters.append(Raster(name, options))
            if len(names) > MAX_OPEN_FILES:
                rasters[-1].close()
        lattice, parts = join(rasters)
        dem = Dem(*_inside(lattice, parts, bbox))
        dem.check_overlaps()
    except BaseException:
        for raster in rasters:
            raster.close()
        raise
    return dem


def read_grid(paths: Paths, **options: Any) -> Grid:
    """Read elevation files whole; for DEMs that fit in memory.

    Parameters
    ----------
    paths : path or sequence of paths
        As for `open_dem`.
    **options
        As for `open_dem`.

    Returns
    -------
    Grid
        Heights in metres; `post_metres` taken at the middle of the DEM.

    Raises
    ------
    InputError, NotFoundError, DemFormatError
        As for `open_dem`; also more than 2**27 posts (1 GiB).

    Examples
    --------
    >>> grid = read_grid("fixtures/dem/new_mexico_voids.tif")
    >>> grid.heights.shape, int(np.isnan(grid.heights).sum())
    ((100, 100), 1226)
    """
    with open_dem(paths, **options) as dem:
        if dem.n_row * dem.n_col > MAX_GRID_POSTS:
            advice = "give bbox, or read block by block with open_dem"
            message = f"found {dem.n_row} × {dem.n_col} posts, expected at most {MAX_GRID_POSTS} in one piece"
            raise InputError(f"dem: {message}; {advice}")
        whole = (0, dem.n_row, 0, dem.n_col)
        metres = dem.post_metres(*whole)
        return Grid(dem.read(*whole), dem.x0, dem.y0, dem.dx, dem.dy, crs=dem.crs, post_metres=metres)


def _inside(lattice: Lattice, parts: Sequence[Part], bbox: Sequence[float] | None) -> tuple[Lattice, tuple[Part, ...]]:
    """Return the lattice and the parts, counted from the first post inside `bbox`."""
    window = lattice.window
    if bbox is not None:
        is_extent = len(bbox) == 4 and all(math.isfinite(number) for number in bbox)
        if not is_extent or bbox[0] > bbox[2] or bbox[1] > bbox[3]:
            raise InputError(f"bbox: found {tuple(bbox)}, expected min_x, min_y, max_x, max_y in CRS units")
        window = lattice.posts_in(Extent(*bbox))
    n_row, n_col = window.shape
    if min(n_row, n_col) < 2:
        place = f"inside {tuple(bbox)}" if bbox is not None else "in all"
        message = f"found {n_row} × {n_col} posts {place}, expected at least 2 × 2"
        name = parts[0].raster.path if len(parts) == 1 else f"{len(parts)} files"
        raise InputError(f"{name}: {message}; the posts span {tuple(lattice.extent)}")
    moved = (Part(part.raster, part.window.moved(-window.row_start, -window.col_start)) for part in parts)
    return (lattice if window == lattice.window else lattice.part(window)), tuple(moved)
