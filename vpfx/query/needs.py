"""How much vertical error is allowed where: by the distance from an eye, or from a focus (specs/query.md Q-310)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import shapely
from numba import njit
from numpy.typing import NDArray

from vpfx.errors import InputError

__all__ = ["Eye", "Focus", "Need", "checked_errors", "checked_eye", "checked_focus", "screen_share"]

Floats = NDArray[np.float64]
NOWHERE = -1.0  # less than any distance


class Need(Protocol):
    """A tolerance that does not fall with distance."""

    def distance(self, corner: Floats) -> Floats:
        """Least distance of faces, float64 (n,), metres; never less for a part of a face."""

    def tolerance(self, distance: Floats) -> Floats:
        """Vertical error allowed at distances, metres."""

    def reach(self, error: Floats) -> Floats:
        """Greatest distance at which an error is too great, metres; -1 if it is nowhere."""


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
    >>> eye = Eye((0.0, 0.0, 130.0), (1.0, 1.0), (0.0, 100.0), 0.01)
    >>> eye.distance(np.array([[[40, 0, 0], [50, 0, 0], [40, 10, 0.0]]]))
    array([50.])
    >>> eye.tolerance(np.array([50.0])), eye.reach(np.array([2.0]))
    (array([0.5]), array([200.]))
    """

    place: tuple[float, float, float]
    metres: tuple[float, float]
    slab: tuple[float, float]
    share: float

    def distance(self, corner: Floats) -> Floats:
        """Least distance from the eye to faces, no more than the true one: in plan to the face, in height to the slab."""
        x, y, z = self.place
        plan = (corner[..., :2] - (x, y)) * self.metres
        above = max(0.0, z - self.slab[1], self.slab[0] - z)
        return np.hypot(_to_origin(np.ascontiguousarray(plan)), above)

    def tolerance(self, distance: Floats) -> Floats:
        """Vertical error allowed at distances, metres."""
        return self.share * distance

    def reach(self, error: Floats) -> Floats:
        """Distance at which an error is just allowed, metres."""
        return error / self.share


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
    >>> focus = Focus(shapely.box(0, 0, 10, 10), (1.0, 1.0), 2.0, 0.1)
    >>> focus.distance(np.array([[[40, 0, 0], [50, 0, 0], [40, 10, 0.0]]]))
    array([30.])
    >>> focus.tolerance(np.array([0.0, 30.0])), focus.reach(np.array([1.0, 5.0]))
    (array([2., 5.]), array([-1., 30.]))
    """

    area: Any
    metres: tuple[float, float]
    error: float
    growth: float = math.inf

    def distance(self, corner: Floats) -> Floats:
        """Least distance in plan from the polygon to faces."""
        faces = shapely.polygons(corner[:, [0, 1, 2, 0], :2] * self.metres)
        shapely.prepare(self.area)
        return shapely.distance(self.area, faces)

    def tolerance(self, distance: Floats) -> Floats:
        """Vertical error allowed at distances, metres."""
        return self.error + np.where(distance > 0.0, self.growth, 0.0) * np.maximum(distance, 1e-300)

    def reach(self, error: Floats) -> Floats:
        """Greatest distance at which an error is too great, metres; -1 if it is nowhere."""
        return np.where(error > self.error, (error - self.error) / self.growth, NOWHERE)


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
            along = min(1.0, max(0.0, -(ax * wx + ay * wy) / (wx * wx + wy * wy)))
            least = min(least, np.hypot(ax + along * wx, ay + along * wy))
        found[face] = 0.0 if is_inside else least
    return found


def screen_share(screen_error: float, fov: float, screen_height: int) -> float:
    """Error allowed per distance."""
    if not (0.0 < screen_error < math.inf and 0.0 < fov < 180.0 and screen_height >= 1):
        found = f"{screen_error} pixels, {fov}° and {screen_height} pixels"
        raise InputError(
            f"cut: found {found}, expected a screen error above 0, a field of view below 180°, a height of 1 or more"
        )
    return screen_error * 2.0 * math.tan(math.radians(fov) / 2.0) / screen_height


def checked_eye(eye: Any) -> tuple[float, float, float]:
    """Return the place of an eye."""
    place = np.asarray(eye, np.float64)
    if place.shape != (3,) or not np.isfinite(place).all():
        raise InputError(f"eye: found {eye}, expected x, y and z")
    x, y, z = place.tolist()
    return x, y, z


def checked_errors(error: float, growth: float) -> tuple[float, float]:
    """Return what is allowed in the focus, and how it grows."""
    if not (0.0 <= error < math.inf and growth > 0.0):
        raise InputError(
            f"cut: found an error of {error} m that grows by {growth}, expected 0 or more and a growth above 0"
        )
    return error, growth


def checked_focus(area: Any, metres: tuple[float, float]) -> Any:
    """Return a focus, scaled to metres."""
    if not isinstance(area, shapely.Polygon | shapely.MultiPolygon) or area.is_empty or not area.is_valid:
        raise InputError(f"focus: found {str(area)[:60]}, expected a valid polygon that is not empty")
    return shapely.transform(area, lambda places: places * metres)
