"""Several elevation files as one lattice: whether they fit, and agree where they overlap.

Nothing here depends on the order in which the user names the files: they are sorted by place, then by content.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from vpfx.dem.lattice import Lattice, Window
from vpfx.dem.raster import Raster
from vpfx.errors import DemFormatError

__all__ = ["MAX_OPEN_FILES", "Part", "check_overlap", "close_some", "join", "merge", "overlaps"]

Floats = NDArray[np.float64]

SPACING_TOLERANCE = 1e-6  # of a spacing
OFFSET_TOLERANCE = 1e-3  # of a spacing
STRIP_POSTS = 1 << 20  # posts compared at a time
MAX_OPEN_FILES = 64  # far below the usual limit of 1024 per process


class Part(NamedTuple):
    """A raster and the posts of the DEM that it holds, by their index in the DEM; some may lie outside the DEM."""

    raster: Raster
    window: Window

    def read(self, window: Window) -> Floats:
        """Return heights; `window` counts in the DEM and lies in the part."""
        return self.raster.read(window.moved(-self.window.row_start, -self.window.col_start))


def join(rasters: Sequence[Raster]) -> tuple[Lattice, tuple[Part, ...]]:
    """Lay rasters on one lattice that spans them all.

    Raises
    ------
    DemFormatError
        Two rasters differ in CRS, vertical datum, unit or spacing, or their posts lie beside each other.
    """
    ordered = sorted(rasters, key=_order)
    first = ordered[0]
    windows = []
    for raster in ordered:
        if raster is not first:
            _check_same_reference(first, raster)
        rows, cols = _offset(first, raster)
        windows.append(raster.lattice.window.moved(rows, cols))
    row, col = min(window.row_start for window in windows), min(window.col_start for window in windows)
    union = Window(row, max(window.row_stop for window in windows), col, max(window.col_stop for window in windows))
    parts = (Part(raster, window.moved(-row, -col)) for raster, window in zip(ordered, windows, strict=True))
    return first.lattice.part(union), tuple(parts)


def merge(parts: Sequence[Part], lattice: Lattice, window: Window) -> Floats:
    """Return the heights of a block of posts: of each post the one that any part has, NaN if none has.

    Raises
    ------
    DemFormatError
        Two parts disagree about a post.
    """
    heights = np.full(window.shape, np.nan)
    seen: list[Part] = []
    for part in parts:
        common = part.window.common(window)
        if 0 in common.shape:
            continue
        block = part.read(common)
        rows, cols = common.row_start - window.row_start, common.col_start - window.col_start
        target = heights[rows : rows + block.shape[0], cols : cols + block.shape[1]]
        if _disagree(target, block).any():
            for other in seen:
                check_overlap(other, part, lattice, window)
        np.copyto(target, block, where=~np.isnan(block))
        seen.append(part)
        close_some(parts)
    return heights


def check_overlap(one: Part, other: Part, lattice: Lattice, window: Window) -> None:
    """Compare the posts in `window` that two parts share, strip by strip.

    Raises
    ------
    DemFormatError
        Both have a height for a post, and not the same; the message names the first such post, counts all.
    """
    common = one.window.common(other.window).common(window)
    first, n_bad, n_shared = None, 0, common.shape[0] * common.shape[1]
    for strip in _strips(common):
        heights = one.read(strip), other.read(strip)
        is_bad = _disagree(*heights)
        if first is None and is_bad.any():
            row, col = np.argwhere(is_bad)[0]
            place = lattice.place(strip.row_start + int(row), strip.col_start + int(col))
            first = (*place, heights[0][row, col], heights[1][row, col])
        n_bad += int(is_bad.sum())
    if first is not None:
        x, y, expected, found = first
        message = f"found {found:.10g} m, expected {expected:.10g} m as in {one.raster.path}"
        message += f"; {n_bad} of {n_shared} shared posts disagree; leave one file out, or make them agree"
        raise DemFormatError(other.raster.path, f"post at ({x:.10g}, {y:.10g})", message)


def overlaps(parts: Sequence[Part], window: Window) -> Iterator[tuple[Part, Part]]:
    """Iterate over the pairs of parts that share posts in `window`."""
    for index, one in enumerate(parts):
        for other in parts[index + 1 :]:
            if other.window.row_start >= one.window.row_stop:
                break  # parts come from south to north
            if 0 not in one.window.common(other.window).common(window).shape:
                yield one, other


def close_some(parts: Sequence[Part]) -> None:
    """Close the southernmost files if too many are open; a closed one is opened anew when it is read."""
    is_open = [part.raster for part in parts if part.raster.is_open]
    for raster in is_open[: max(0, len(is_open) - MAX_OPEN_FILES)]:
        raster.close()


def _order(raster: Raster) -> tuple[float, float, int, int, str, str]:
    """Return what rasters are sorted by: south to north, west to east, then anything that tells them apart."""
    lattice = raster.lattice
    return lattice.y0, lattice.x0, lattice.n_row, lattice.n_col, raster.source.sha256, raster.path


def _check_same_reference(first: Raster, raster: Raster) -> None:
    """Raise unless two rasters have the same CRS, vertical datum and unit."""
    here, there = raster.reference, first.reference
    if here.crs != there.crs and not _are_same_crs(here.crs, there.crs):
        found, expected = _crs_name(here.crs), _crs_name(there.crs)
        message = f"found CRS {found}, expected {expected} as in {first.path}; reproject one of them"
        raise DemFormatError(raster.path, "", message)
    if here.vertical_datum != there.vertical_datum:
        found, expected = here.vertical_datum, there.vertical_datum
        message = f"found vertical datum {found}, expected {expected} as in {first.path}; give vertical_datum"
        raise DemFormatError(raster.path, "", message)
    if here.unit.name != there.unit.name:
        message = f"found heights in {here.unit.name}, expected {there.unit.name} as in {first.path}"
        raise DemFormatError(raster.path, "", f"{message}; convert one of them, or give vertical_unit")


def _offset(first: Raster, raster: Raster) -> tuple[int, int]:
    """Return how many rows and columns a raster lies north and east of the first."""
    a, b = first.lattice, raster.lattice
    if abs(b.dx - a.dx) > SPACING_TOLERANCE * a.dx or abs(b.dy - a.dy) > SPACING_TOLERANCE * a.dy:
        message = f"found spacing {b.dx:.12g} × {b.dy:.12g}, expected {a.dx:.12g} × {a.dy:.12g} as in {first.path}"
        raise DemFormatError(raster.path, "", f"{message}; resample one of them")
    rows, cols = a.offset(b)
    odd_row, odd_col = rows - round(rows), cols - round(cols)
    if max(abs(odd_row), abs(odd_col)) > OFFSET_TOLERANCE:
        found = f"found posts {odd_col:+.4g} columns and {odd_row:+.4g} rows beside those of {first.path}"
        raise DemFormatError(raster.path, "", f"{found}, expected posts on one lattice; resample one of them")
    return round(rows), round(cols)


def _are_same_crs(one: str, other: str) -> bool:
    """Tell whether two WKT texts mean the same CRS."""
    return bool(one and other and CRS.from_wkt(one).equals(CRS.from_wkt(other), ignore_axis_order=True))


def _crs_name(wkt: str) -> str:
    """Return the name of a CRS for messages."""
    return str(CRS.from_wkt(wkt).name) if wkt else "none"


def _disagree(one: Floats, other: Floats) -> NDArray[np.bool_]:
    """Tell which posts have two different heights; a void agrees with everything."""
    return (one != other) & ~np.isnan(one) & ~np.isnan(other)


def _strips(window: Window) -> Iterator[Window]:
    """Cut a window into strips of rows that fit in memory."""
    step = max(1, STRIP_POSTS // max(1, window.shape[1]))
    for row in range(window.row_start, window.row_stop, step):
        yield window._replace(row_start=row, row_stop=min(row + step, window.row_stop))
