"""How much vertical error is allowed where: by the distance from an eye, or from a focus (specs/query.md Q-310)."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import shapely
from numba import njit
from numpy.typing import NDArray

from vpfx.errors import InputError

__all__ = ["Eye", "Focus", "Need", "checked_errors", "checked_eye", "checked_focus", "screen_share"]

Floats = NDArray[np.float64]
POLYGONS = shapely.Polygon | shapely.MultiPolygon


class Need(Protocol):
    """How much vertical error is allowed on faces."""

    def tolerance(self, corner: Floats) -> Floats:
        """Vertical error allowed at the nearest place of faces, float64 (n,), metres; never less for a part of a face."""


@dataclass(frozen=True)
class Eye:
    """A tolerance that grows with the distance from an eye.

    Attributes
    ----------
    place : tuple of float
        x and y in CRS units, z in metres.
    metres : tuple of float
        Size of a unit of x and of y, metres.
    slab : tuple of float
        Least and greatest height that the surface has anywhere, metres.
    share : float
        Error allowed per distance.

    Examples
    --------
    The face is 40 m away and 30 m below:

    >>> eye = Eye((0.0, 0.0, 130.0), (1.0, 1.0), (0.0, 100.0), 0.01)
    >>> eye.tolerance(np.array([[[40, 0, 0], [50, 0, 0], [40, 10, 0.0]]]))
    array([0.5])
    """

    place: tuple[float, float, float]
    metres: tuple[float, float]
    slab: tuple[float, float]
    share: float

    def tolerance(self, corner: Floats) -> Floats:
        """Error allowed at a distance no more than the true one: in plan to the face, in height to the slab."""
        x, y, z = self.place
        plan = (corner[..., :2] - (x, y)) * self.metres
        above = max(0.0, z - self.slab[1], self.slab[0] - z)
        return self.share * np.hypot(_to_origin(np.ascontiguousarray(plan)), above)


@dataclass(frozen=True)
class Focus:
    """A tolerance that holds in a polygon and grows beyond it.

    Attributes
    ----------
    area : shapely polygon or multipolygon
        Scaled to metres.
    metres : tuple of float
        Size of a unit of x and of y, metres.
    error : float
        Error allowed in the polygon, metres.
    growth : float
        Error allowed more for each metre away from it; infinite: any.

    Examples
    --------
    >>> face = np.array([[[40, 0, 0], [50, 0, 0], [40, 10, 0.0]]])
    >>> Focus(shapely.box(0, 0, 10, 10), (1.0, 1.0), 2.0, 0.1).tolerance(face)
    array([5.])
    >>> Focus(shapely.box(0, 0, 45, 10), (1.0, 1.0), 2.0).tolerance(face)
    array([2.])
    """

    area: Any
    metres: tuple[float, float]
    error: float
    growth: float = math.inf

    def tolerance(self, corner: Floats) -> Floats:
        """Error allowed by the least distance in plan from the polygon."""
        faces = shapely.polygons(corner[:, [0, 1, 2, 0], :2] * self.metres)
        shapely.prepare(self.area)
        distance = shapely.distance(self.area, faces)
        beyond = distance > 0.0
        more = np.zeros(len(faces))
        more[beyond] = self.growth * distance[beyond]
        return self.error + more


@njit(nogil=True, cache=True)
def _to_origin(corner):  # type: ignore[no-untyped-def]
    """Distance of triangles (n, 3, 2), counter-clockwise, from the origin; 0 in and on them."""
    found = np.empty(len(corner))
    for face in range(len(corner)):
        is_inside, least = True, np.inf
        for i in range(3):
            ax, ay = corner[face, i]
            bx, by = corner[face, (i + 1) % 3]
            wx, wy = bx - ax, by - ay
            is_inside = is_inside and ax * by - ay * bx >= 0.0
            size = wx * wx + wy * wy  # 0 where the origin is so far away that corners fall together
            along = min(1.0, max(0.0, -(ax * wx + ay * wy) / size)) if size > 0.0 else 0.0
            least = min(least, np.hypot(ax + along * wx, ay + along * wy))
        found[face] = 0.0 if is_inside else least
    return found


def screen_share(screen_error: float, fov: float, screen_height: float) -> float:
    """Error allowed per distance.

    Raises
    ------
    InputError
        A number is out of range.
    """
    given = np.asarray([_number(screen_error), _number(fov), _number(screen_height)])
    if not (np.isfinite(given).all() and (given > 0.0).all() and given[1] < 180.0):
        found = f"{screen_error} pixels, {fov}° and {screen_height} pixels"
        raise InputError(
            f"cut: found {found}, expected a screen error and a height above 0, a field of view below 180°"
        )
    share = float(given[0] * 2.0 * math.tan(math.radians(given[1]) / 2.0) / given[2])
    return max(share, sys.float_info.min)


def checked_eye(eye: Any) -> tuple[float, float, float]:
    """Return the place of an eye.

    Raises
    ------
    InputError
        It is no three finite numbers.
    """
    try:
        x, y, z = (float(value) for value in eye)
    except (TypeError, ValueError):
        x = y = z = math.nan
    if not all(map(math.isfinite, (x, y, z))):
        raise InputError(f"eye: found {str(eye)[:60]}, expected x, y and z")
    return x, y, z


def checked_errors(error: Any, growth: Any) -> tuple[float, float]:
    """Return what is allowed in the focus, and how it grows.

    Raises
    ------
    InputError
        A number is out of range.
    """
    allowed, more = _number(error), _number(growth)
    if not (0.0 <= allowed < math.inf and more > 0.0):
        raise InputError(
            f"cut: found an error of {error} m that grows by {growth}, expected 0 or more and a growth above 0"
        )
    return allowed, more


def checked_focus(area: Any, metres: tuple[float, float]) -> Any:
    """Return a focus, scaled to metres.

    Raises
    ------
    InputError
        It is no valid polygon.
    """
    scaled = shapely.transform(area, lambda places: places * metres) if isinstance(area, POLYGONS) else None
    if scaled is None or scaled.is_empty or not scaled.is_valid:
        raise InputError(f"focus: found {str(area)[:60]}, expected a valid polygon that is not empty")
    return scaled


def _number(value: Any) -> float:
    """Return a value as a number, NaN if it is none."""
    try:
        return float(value)
    except (TypeError, ValueError):
        return math.nan
