"""One elevation file, read as posts; all calls to GDAL are here."""

from __future__ import annotations

import math
import os
import re
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import rasterio
from numpy.typing import NDArray
from pyproj import CRS
from rasterio.enums import ColorInterp, MaskFlags
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.windows import Window as RasterWindow

from vpfx.checks import whole_number
from vpfx.dem.lattice import ARCSECONDS, Lattice, Window
from vpfx.dem.paths import Source, gdal, gdal_name, source_of
from vpfx.dem.reference import METRES, Reference, Unit, find_reference, find_unit, parse_crs, split_crs
from vpfx.errors import DemFormatError, InputError

__all__ = ["Options", "Raster"]

Floats = NDArray[np.float64]

SHEAR_TOLERANCE = 1e-6  # of a spacing, over the whole raster
MAX_PLACE = 1e15  # CRS units
MIN_SPACING = 1e-12  # of a coordinate, some thousand times what float64 tells apart
GDAL_LINE = re.compile(r"In file \S+, at line \d+, ")
MAX_REASON = 200  # characters of GDAL's own words in a message


@dataclass(frozen=True)
class Options:
    """How a file is to be understood, as the user says; checked once when made.

    Attributes
    ----------
    band : int
        Band to read, from 1.
    nodata : float, optional
        Value of voids, instead of the file's.
    crs : CRS, optional
        For files that have none.
    declared : Reference
        Unit and vertical datum that go before the file's.

    Examples
    --------
    >>> Options.parse(band=1, nodata=None, crs=None, vertical_unit="fathom", vertical_datum=None)
    Traceback (most recent call last):
    vpfx.errors.InputError: vertical_unit: found 'fathom', expected one of metre, ...
    """

    band: int
    nodata: float | None
    crs: CRS | None
    declared: Reference

    @classmethod
    def parse(
        cls, *, band: int, nodata: float | None, crs: Any, vertical_unit: str | None, vertical_datum: str | None
    ) -> Options:
        """Return the options of `open_dem`.

        Raises
        ------
        InputError
            One of them has no meaning.
        """
        unit = find_unit(vertical_unit) if vertical_unit is not None else Unit("", 1.0)
        if unit is None:
            raise InputError(f"vertical_unit: found {vertical_unit!r}, expected one of {', '.join(METRES)}")
        return cls(
            band=whole_number(band, "band"),
            nodata=None if nodata is None else float(nodata),
            crs=None if crs is None else parse_crs(crs),
            declared=Reference("", unit, vertical_datum or "", False),
        )


class Raster:
    """One elevation file as a lattice of posts.

    Parameters
    ----------
    path : str
        A local file.
    options : Options
        How it is to be understood.

    Raises
    ------
    InputError, NotFoundError, DemFormatError
        See `vpfx.dem.open_dem`.

    Notes
    -----
    The dataset is closed by `close` and opened anew by the next `read`, so that a great mosaic keeps few files open.
    """

    lattice: Lattice
    reference: Reference
    source: Source

    def __init__(self, path: str, options: Options) -> None:
        self.path = path
        self.options = options
        self._name = gdal_name(path)
        self._dataset: Any = None
        try:
            with gdal():
                dataset = self._opened()
                _check_band(path, dataset, options.band)
                self.reference = self._find_reference(dataset)
                self.lattice, self._is_flipped = self._find_lattice(dataset)
            self.source = source_of(path, dataset.driver)
        except BaseException:
            self.close()
            raise

    @property
    def is_open(self) -> bool:
        """Whether the dataset is open at the moment."""
        return self._dataset is not None

    def close(self) -> None:
        """Close the dataset; the raster stays usable."""
        if self._dataset is not None:
            self._dataset.close()
            self._dataset = None

    def read(self, window: Window) -> Floats:
        """Return the heights of a block of posts in metres, southernmost row first, NaN where void.

        Raises
        ------
        DemFormatError
            The file cannot be read there, or holds an infinite height.
        """
        n_row, n_col = window.shape
        top, left = window.row_start, window.col_start
        if self._is_flipped[0]:
            top = self.lattice.n_row - window.row_stop
        if self._is_flipped[1]:
            left = self.lattice.n_col - window.col_stop
        heights = self._heights(RasterWindow(left, top, n_col, n_row))
        heights = heights[:: -1 if self._is_flipped[0] else 1, :: -1 if self._is_flipped[1] else 1]
        if np.isinf(heights).any():
            row, col = (int(index) for index in np.argwhere(np.isinf(heights))[0])
            x, y = self.lattice.place(window.row_start + row, window.col_start + col)
            message = "found an infinite height, expected a number; give nodata=inf if these are voids"
            raise DemFormatError(self.path, f"post at ({x:.10g}, {y:.10g})", message)
        return np.ascontiguousarray(heights)

    def _heights(self, window: RasterWindow) -> Floats:
        """Return heights in metres in the order of the file."""
        band = self.options.band
        try:
            with gdal():
                dataset = self._opened()
                values = dataset.read(band, window=window)
                is_void = self._is_void(dataset, values, window)
        except (RasterioError, OSError, ValueError) as error:
            where = f"raster rows {window.row_off}…{window.row_off + window.height - 1}"
            raise DemFormatError(self.path, where, f"cannot be read: {self._reason(error)}") from error
        with np.errstate(invalid="ignore"):  # signalling NaN in broken files
            heights: Floats = values.astype(np.float64)
        scale, offset = dataset.scales[band - 1], dataset.offsets[band - 1]
        if (scale, offset) != (1.0, 0.0):
            heights = heights * scale + offset
        if self.reference.unit.metres != 1.0:
            heights = heights * self.reference.unit.metres
        heights[is_void] = np.nan
        return heights

    def _is_void(self, dataset: Any, values: NDArray[Any], window: RasterWindow) -> NDArray[np.bool_]:
        """Tell which posts are void by nodata value, mask or NaN."""
        band = self.options.band
        flags = dataset.mask_flag_enums[band - 1]
        is_void = np.isnan(values) if values.dtype.kind == "f" else np.zeros(values.shape, dtype=bool)
        nodata = self.options.nodata if self.options.nodata is not None else dataset.nodatavals[band - 1]
        if nodata is not None:
            is_void |= _equals(values, nodata)
        is_replaced = self.options.nodata is not None and MaskFlags.nodata in flags  # the mask tells the file's nodata
        if MaskFlags.all_valid not in flags and not is_replaced:
            is_void |= dataset.read_masks(band, window=window) == 0
        if ColorInterp.alpha in dataset.colorinterp and band - 1 != dataset.colorinterp.index(ColorInterp.alpha):
            # GDAL's mask forgets an alpha band beside a nodata value, and one of floats
            is_void |= dataset.read(dataset.colorinterp.index(ColorInterp.alpha) + 1, window=window) == 0
        return is_void

    def _opened(self) -> Any:
        """Return the dataset, opened if it was closed."""
        if self._dataset is None:
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", NotGeoreferencedWarning)  # `_find_lattice` says it better
                    self._dataset = rasterio.open(self._name)
            except (RasterioError, OSError, ValueError) as error:
                message = f"cannot be opened: {self._reason(error)}"
                advice = "expected a raster that GDAL knows, such as GeoTIFF, DTED or HGT"
                raise DemFormatError(self.path, "", f"{message}; {advice}") from error
        return self._dataset

    def _reason(self, error: BaseException) -> str:
        """Return the first cause of an error in one short line, in the user's own file names."""
        while error.__cause__ is not None:
            error = error.__cause__
        if isinstance(error, UnicodeDecodeError):
            return "its text is no text"
        text = str(error.args[-1] if error.args else error).replace(self._name, os.path.basename(self.path))
        text = GDAL_LINE.sub("", " ".join(text.split())).rstrip(".")
        return text if len(text) <= MAX_REASON else f"{text[: MAX_REASON - 1]}…"

    def _find_reference(self, dataset: Any) -> Reference:
        """Return CRS, datum and unit."""
        try:
            wkt = dataset.crs.to_wkt(version="WKT2_2019") if dataset.crs else ""
            unit_tag = dataset.units[self.options.band - 1] or ""
        except (RasterioError, ValueError) as error:
            reason = self._reason(error)
            raise DemFormatError(self.path, "", f"found a CRS or unit that is none ({reason})") from error
        return find_reference(self.path, wkt, unit_tag, self.options.crs, self.options.declared)

    def _find_lattice(self, dataset: Any) -> tuple[Lattice, tuple[bool, bool]]:
        """Return the lattice of pixel centres, and whether rows and columns run against it.

        AREA_OR_POINT is not read: GDAL's transform leads to the corners of pixels whatever that tag says.
        """
        _check_transform(self.path, dataset)
        transform, n_row, n_col = dataset.transform, dataset.height, dataset.width
        is_flipped = (transform.e < 0, transform.a < 0)
        crs = split_crs(self.reference.crs)[0] if self.reference.crs else None
        is_degrees = crs is not None and crs.is_geographic and crs.axis_info[0].unit_name.casefold() == "degree"
        lattice = Lattice(
            n_row,
            n_col,
            x0=transform.c + transform.a * (n_col - 0.5 if is_flipped[1] else 0.5),
            y0=transform.f + transform.e * (n_row - 0.5 if is_flipped[0] else 0.5),
            dx=abs(transform.a),
            dy=abs(transform.e),
            unit_parts=ARCSECONDS if is_degrees else 1,
        )
        _check_places(self.path, lattice)
        return lattice.tidied(), is_flipped


def _check_band(path: str, dataset: Any, band: int) -> None:
    """Raise unless the band exists and holds real numbers."""
    if not 1 <= band <= dataset.count:
        raise InputError(f"{path}: found no band {band}, expected 1…{dataset.count}; number of bands: {dataset.count}")
    dtype = str(dataset.dtypes[band - 1])
    if dtype.startswith("complex"):
        raise DemFormatError(path, f"band {band}", f"found {dtype} values, expected integers or floats")
    scale, offset = dataset.scales[band - 1], dataset.offsets[band - 1]
    if not (math.isfinite(scale) and math.isfinite(offset) and scale != 0):
        raise DemFormatError(path, f"band {band}", f"found scale {scale} and offset {offset}, expected finite numbers")


def _check_transform(path: str, dataset: Any) -> None:
    """Raise unless rows run along x and columns along y."""
    transform = dataset.transform
    if transform.is_identity:
        advice = "write it into the file with gdal_edit -a_ullr west north east south"
        raise DemFormatError(path, "", f"found no georeference, expected a place for each post; {advice}")
    a, b, _, d, e, _ = transform[:6]
    if not all(math.isfinite(number) for number in transform[:6]) or a == 0 or e == 0:
        raise DemFormatError(path, "transform", f"found {tuple(transform[:6])}, expected finite numbers and a spacing")
    if abs(b) * dataset.height > SHEAR_TOLERANCE * abs(a) or abs(d) * dataset.width > SHEAR_TOLERANCE * abs(e):
        found = f"found a rotated or sheared grid (terms {b:.6g} and {d:.6g}), expected rows from west to east"
        raise DemFormatError(path, "transform", f"{found}; warp it first, as with gdalwarp")


def _check_places(path: str, lattice: Lattice) -> None:
    """Raise unless neighbouring posts have different places."""
    farthest = max(abs(number) for number in lattice.extent)
    if not farthest < MAX_PLACE or min(lattice.dx, lattice.dy) <= MIN_SPACING * farthest:
        found = f"found a spacing of {lattice.dx:.6g} × {lattice.dy:.6g} at places up to {farthest:.6g}"
        raise DemFormatError(path, "transform", f"{found}, expected posts that can be told apart")


def _equals(values: NDArray[Any], nodata: float) -> NDArray[np.bool_]:
    """Tell which values are `nodata`; a float32 band holds it rounded to float32."""
    if values.dtype != np.float32:
        return values == nodata
    with np.errstate(over="ignore"):
        rounded = np.float32(nodata)
    return (values == rounded) & (np.isinf(rounded) == np.isinf(nodata))
