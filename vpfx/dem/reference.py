"""What the numbers of a DEM refer to: horizontal CRS, vertical datum and vertical unit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

from pyproj import CRS
from pyproj.exceptions import CRSError

from vpfx.errors import DemFormatError, InputError
from vpfx.model import Extent

__all__ = [
    "Reference",
    "Unit",
    "Vertical",
    "find_reference",
    "find_unit",
    "ground_size",
    "parse_crs",
    "split_crs",
    "unit_metres",
]

METRES = {
    "metre": 1.0,
    "decimetre": 0.1,
    "centimetre": 0.01,
    "foot": 0.3048,
    "us_survey_foot": 1200 / 3937,
}
ALIASES = {
    "metre": "m metres meter meters",
    "decimetre": "dm decimetres decimeter decimeters",
    "centimetre": "cm centimetres centimeter centimeters",
    "foot": "ft feet international_foot foot_(international)",
    "us_survey_foot": "us_ft ftus us_foot foot_us us_survey_feet survey_foot u.s._foot u.s._survey_foot",
}
UNIT_SHARE = 1.0 / 1024  # of a unit: what is measured on the ground to tell the size of a unit
UNIT_NAMES = {alias: name for name, aliases in ALIASES.items() for alias in [name, *aliases.split()]}


class Unit(NamedTuple):
    """A unit of heights and its length in metres."""

    name: str
    metres: float


class Vertical(NamedTuple):
    """The vertical part of a CRS."""

    datum: str
    unit: Unit
    is_depth: bool


@dataclass(frozen=True)
class Reference:
    """What the posts of one file refer to.

    Attributes
    ----------
    crs : str
        WKT2 of the horizontal CRS; empty if unknown.
    unit : Unit
        Unit of the heights as stored in the file.
    vertical_datum : str
        Such as ``EPSG:5773``; ``unknown`` if nobody said.
    unit_is_assumed : bool
        The file names no unit and neither did the user.
    """

    crs: str
    unit: Unit
    vertical_datum: str
    unit_is_assumed: bool


def find_unit(name: str) -> Unit | None:
    """Return a unit by one of its usual names.

    Examples
    --------
    >>> find_unit("US survey foot")
    Unit(name='us_survey_foot', metres=0.3048006096012192)
    >>> find_unit("fathom") is None
    True
    """
    known = UNIT_NAMES.get(name.strip().casefold().replace(" ", "_").replace("-", "_"))
    return Unit(known, METRES[known]) if known else None


def parse_crs(crs: Any) -> CRS:
    """Return what the user gave as a CRS.

    Raises
    ------
    InputError
        pyproj does not know it, or it has no horizontal part.
    """
    try:
        parsed = CRS.from_user_input(crs)
    except CRSError as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"crs: found {crs!r}, expected a CRS such as EPSG:4326 ({reason})") from error
    if (parsed.is_vertical and not parsed.is_compound) or parsed.is_geocentric:
        raise InputError(f"crs: found {parsed.name}, expected a geographic or projected CRS")
    return parsed


def ground_size(crs: CRS | None, x: float, y: float, dx: float, dy: float) -> tuple[float, float]:
    """Width and height in metres of dx × dy about a place.

    Parameters
    ----------
    crs : CRS, optional
        None takes units for metres.
    x, y, dx, dy : float
        In units of the CRS.

    Returns
    -------
    tuple of float
        Geographic CRS: along the ellipsoid. Projected CRS: by the unit of the axes, scale errors of the projection left in.

    Examples
    --------
    >>> width, height = ground_size(CRS("EPSG:4326"), 10.0, 60.0, 1 / 3600, 1 / 3600)
    >>> round(width, 2), round(height, 2)
    (15.5, 30.95)
    """
    if crs is None:
        return dx, dy
    factor, geod = crs.axis_info[0].unit_conversion_factor, crs.get_geod()  # to metres or to radians
    if not crs.is_geographic or geod is None:
        return dx * factor, dy * factor
    lon, lat, dlon, dlat = (math.degrees(number * factor) for number in (x, y, dx, dy))
    lat = min(max(lat, dlat / 2 - 90), 90 - dlat / 2)  # keeps a width at the poles
    _, _, width = geod.inv(lon - dlon / 2, lat, lon + dlon / 2, lat)
    _, _, height = geod.inv(lon, lat - dlat / 2, lon, lat + dlat / 2)
    return float(width), float(height)


def unit_metres(wkt: str, extent: Extent) -> tuple[float, float]:
    """Size of a unit of x and of y in the middle of an extent, metres.

    Parameters
    ----------
    wkt : str
        CRS; empty if unknown, which takes units for metres.

    Examples
    --------
    >>> width, height = unit_metres("EPSG:4326", Extent(10.0, 59.0, 11.0, 61.0))
    >>> round(width), round(height)
    (55800, 111412)
    """
    crs = CRS.from_user_input(wkt) if wkt else None
    x, y = (extent.min_x + extent.max_x) / 2, (extent.min_y + extent.max_y) / 2
    width, height = ground_size(crs, x, y, UNIT_SHARE, UNIT_SHARE)
    return width / UNIT_SHARE, height / UNIT_SHARE


@lru_cache(maxsize=256)  # a mosaic says the same thing a thousand times
def split_crs(wkt: str) -> tuple[CRS | None, Vertical | None]:
    """Split a CRS into its horizontal and its vertical part.

    Raises
    ------
    pyproj.exceptions.CRSError
        The text is no CRS.

    Examples
    --------
    >>> horizontal, vertical = split_crs(CRS("EPSG:9707").to_wkt())
    >>> horizontal.name, vertical.datum, vertical.unit.name
    ('WGS 84', 'EPSG:5773', 'metre')
    """
    crs = _unbound(CRS.from_wkt(wkt))
    if crs.is_compound:
        return _canonical(_unbound(crs.sub_crs_list[0])), _vertical(_unbound(crs.sub_crs_list[1]))
    if crs.is_vertical:
        return None, _vertical(crs)
    if len(crs.axis_info) == 3 and crs.ellipsoid is not None and not crs.is_geocentric:
        unit = find_unit(crs.axis_info[2].unit_name) or Unit("metre", 1.0)
        return _canonical(crs.to_2d()), Vertical(f"{crs.ellipsoid.name} ellipsoid", unit, False)
    return _canonical(crs), None


def find_reference(path: str, file_wkt: str, unit_tag: str, crs: CRS | None, declared: Reference) -> Reference:
    """Put together what a file says and what the user declared.

    Parameters
    ----------
    path : str
        The file, for messages.
    file_wkt : str
        CRS found in the file; may be empty.
    unit_tag : str
        Unit found at the band; may be empty.
    crs : CRS, optional
        The user's CRS; it fills gaps and contradicts nothing.
    declared : Reference
        The user's unit and vertical datum, which go before the file's. An empty name declares nothing.

    Raises
    ------
    InputError
        The file and `crs` contradict each other.
    DemFormatError
        The file contradicts itself, or has a CRS, a unit or an axis that cannot be used.
    """
    try:
        horizontal, vertical = split_crs(file_wkt) if file_wkt else (None, None)
    except CRSError as error:
        reason = str(error).splitlines()[0]
        raise DemFormatError(path, "", f"found a CRS that is none ({reason}), expected WKT") from error
    if crs is not None:
        horizontal, vertical = _completed(path, (horizontal, vertical), split_crs(crs.to_wkt()))
    if vertical is not None and vertical.is_depth and not declared.vertical_datum:
        advice = "turn the sign, or give vertical_datum if these are heights"
        raise DemFormatError(path, "vertical CRS", f"found depths ({vertical.datum}), expected heights; {advice}")
    unit = declared.unit if declared.unit.name else _file_unit(path, vertical, unit_tag)
    return Reference(
        crs=horizontal.to_wkt("WKT2_2019") if horizontal is not None else "",
        unit=unit or Unit("metre", 1.0),
        vertical_datum=declared.vertical_datum or (vertical.datum if vertical else "unknown"),
        unit_is_assumed=unit is None,
    )


def _unbound(crs: CRS) -> CRS:
    """Return a CRS without the transformation to WGS 84 that old files attach to it."""
    return crs.source_crs if crs.is_bound and crs.source_crs is not None else crs


def _canonical(crs: CRS) -> CRS:
    """Return a registered CRS as pyproj's registry spells it, so that equal CRS have equal texts."""
    authority = crs.to_authority(min_confidence=100)
    return CRS.from_authority(*authority) if authority else crs


def _vertical(crs: CRS) -> Vertical:
    """Return name, unit and direction of a vertical CRS."""
    axis = crs.axis_info[0]
    authority = crs.to_authority()
    unit = find_unit(axis.unit_name) or Unit(axis.unit_name, axis.unit_conversion_factor)
    return Vertical(":".join(authority) if authority else crs.name, unit, axis.direction == "down")


def _completed(
    path: str, found: tuple[CRS | None, Vertical | None], given: tuple[CRS | None, Vertical | None]
) -> tuple[CRS | None, Vertical | None]:
    """Fill what a file does not say from the user's CRS."""
    if found[0] is not None and given[0] is not None and not found[0].equals(given[0], ignore_axis_order=True):
        message = f"found CRS {found[0].name}, but crs says {given[0].name}; leave crs out, or reproject the file"
        raise InputError(f"{path}: {message}")
    if found[1] is not None and given[1] is not None and found[1] != given[1]:
        message = f"found vertical datum {found[1].datum} in {found[1].unit.name}, but crs says {given[1].datum}"
        raise InputError(f"{path}: {message} in {given[1].unit.name}; leave it out of crs, or give vertical_datum")
    return found[0] or given[0], found[1] or given[1]


def _file_unit(path: str, vertical: Vertical | None, unit_tag: str) -> Unit | None:
    """Return the unit that the file names."""
    tagged = find_unit(unit_tag)
    if unit_tag.strip() and tagged is None and vertical is None:
        known = ", ".join(METRES)
        raise DemFormatError(path, "unit", f"found {unit_tag!r}, expected one of {known}; give vertical_unit")
    if tagged is not None and vertical is not None and tagged.name != vertical.unit.name:
        message = f"found {tagged.name} at the band and {vertical.unit.name} in the CRS, expected one unit"
        raise DemFormatError(path, "unit", f"{message}; give vertical_unit")
    return vertical.unit if vertical is not None else tagged
