"""What can be seen over the surface of a level: along one line, to many targets, and of every face."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.dem.reference import unit_metres
from vpfx.errors import InputError
from vpfx.model import Tin
from vpfx.query.lines import profile
from vpfx.query.location import bins_of, locate
from vpfx.query.rays import first_blocks
from vpfx.query.region import part_of, region
from vpfx.store.reader import StoreReader
from vpfx.topology import NONE

__all__ = ["Sight", "Viewshed", "line_of_sight", "shown", "viewshed", "walk"]

Floats = NDArray[np.float64]

GRAZE = 1e-9
"""Of the greatest height there is: so far a ray may run below the surface and not be blocked. Heights on a ray and on an edge
are each off by some rounding of places and heights, and a target on the ground lies on its own face."""

BENT_RADIUS = 6_371_000.0 * 7 / 6
"""Metres: the earth's radius, longer by a sixth because the air bends rays down (7/6, as is usual for light)."""


class Sight(NamedTuple):
    """What is seen of some targets.

    Attributes
    ----------
    is_visible : bool (n,)
    blocked_at : float64 (n, 3)
        Where the ray first meets the surface: x and y in CRS units, height of the ray in metres; NaN where it does not.
    """

    is_visible: NDArray[np.bool_]
    blocked_at: Floats


class Viewshed(NamedTuple):
    """What is seen of some faces.

    Attributes
    ----------
    face_ids : int64 (n,)
        Ascending.
    is_visible : bool (n,)
        Whether the face's middle, the mean of its corners, is seen.
    """

    face_ids: NDArray[np.int64]
    is_visible: NDArray[np.bool_]


def walk(store: StoreReader, level: int, start: Any, end: Any) -> NDArray[np.int64]:
    """Faces along a straight line, in order.

    Parameters
    ----------
    store : StoreReader
    level : int
    start, end : float64 (2,)
        x and y in CRS units.

    Returns
    -------
    int64 (n,)
        Ids, as of `vpfx.query.lines.profile`: along an edge that of least id, nothing where there is no ground.

    Raises
    ------
    InputError
        A place is no two finite numbers.
    NotFoundError
        There is no such level.
    """
    line = np.array([_places(start, 2, "start")[0], _places(end, 2, "end")[0]])
    if np.array_equal(line[0], line[1]):
        at = locate(store, line[:1], level).face_ids
        return at[at != NONE]
    return profile(store, line, level).face_ids


def line_of_sight(
    store: StoreReader, level: int, observer: Any, targets: Any, *, is_absolute: bool = False, curvature: bool = False
) -> Sight:
    """Tell which targets are seen from a place.

    Parameters
    ----------
    store : StoreReader
    level : int
    observer : float64 (3,)
        x and y in CRS units, and height above the ground in metres.
    targets : float64 (n, 3)
        The same; or (3,) for one.
    is_absolute : bool
        Whether heights are those of the store instead, above its vertical datum.
    curvature : bool
        Whether the ground falls away with the distance squared, as on a sphere of `BENT_RADIUS`.

    Raises
    ------
    InputError
        They are no finite numbers, or a height above ground is told where there is no ground.
    NotFoundError
        There is no such level.

    Notes
    -----
    Source: specs/query.md Q-180. A ray is blocked where the surface lies above it by more than `GRAZE`, strictly between its
    ends; ground without faces blocks nothing, a ray goes on to the next face beyond. Rays are straight in the CRS. Cost:
    O(faces of the rectangle round all places), then the faces under each ray up to where it is blocked.
    """
    origin = _raised(store, level, _places(observer, 3, "observer"), "observer", is_absolute)
    ends = _raised(store, level, _places(targets, 3, "targets"), "targets", is_absolute)
    xy = np.concatenate([origin, ends])[:, :2]
    tin = store.tin(level, (*xy.min(axis=0), *xy.max(axis=0)))
    share = _blocked(tin, origin[0], ends, _metres(store, curvature), is_first=True)
    is_visible = np.isinf(share)
    blocked_at = np.where(
        is_visible[:, None], np.nan, origin + np.where(is_visible, 0.0, share)[:, None] * (ends - origin)
    )
    return Sight(is_visible, blocked_at)


def viewshed(
    store: StoreReader, level: int, observer: Any, *, observer_height: float = 1.7, target_height: float = 0.0,
    reach: float | None = None, bbox: Sequence[float] | None = None, curvature: bool = False,
) -> Viewshed:  # fmt: skip
    """Tell which faces are seen from a place.

    Parameters
    ----------
    store : StoreReader
    level : int
    observer : float64 (2,)
        x and y in CRS units.
    observer_height, target_height : float
        Of the observer above the ground, and of what is looked for above the middle of each face, metres.
    reach : float, optional
        Only faces whose middle is no farther away, metres.
    bbox : four numbers, optional
        Only faces that touch it: min_x, min_y, max_x, max_y in CRS units.
    curvature : bool
        As for `line_of_sight`.

    Raises
    ------
    InputError
        They are no finite numbers, the reach is not positive, or there is no ground at the observer.
    NotFoundError
        There is no such level.

    Notes
    -----
    Source: specs/query.md Q-181. As `line_of_sight` to every face.
    """
    if not np.isfinite([observer_height, target_height]).all():
        raise InputError(f"height: found {observer_height} and {target_height}, expected finite numbers of metres")
    if reach is not None and not (np.isfinite(reach) and reach > 0):
        raise InputError(f"reach: found {reach}, expected a positive number of metres")
    place = _places(observer, 2, "observer")
    origin = _raised(store, level, np.column_stack([place, [float(observer_height)]]), "observer", False)[0]
    metres = unit_metres(store.crs, store.extent)
    around = (
        None if reach is None else (*(origin[:2] - np.divide(reach, metres)), *(origin[:2] + np.divide(reach, metres)))
    )
    wanted = region(store, level, bbox=around if bbox is None else bbox)
    middle = wanted.nodes[wanted.face_nodes].mean(axis=1) + np.array([0.0, 0.0, target_height])
    keep = np.ones(len(middle), bool)
    if reach is not None:
        keep = np.hypot(*((middle - origin)[:, :2] * metres).T) <= reach
    if not keep.any():
        return Viewshed(np.empty(0, np.int64), np.empty(0, bool))
    ends = middle[keep]
    xy = np.concatenate([origin[None], ends])[:, :2]
    tin = store.tin(level, (*xy.min(axis=0), *xy.max(axis=0)))
    share = _blocked(tin, origin, ends, _metres(store, curvature), is_first=False)
    order = np.argsort(wanted.face_attributes["face_id"][keep])
    return Viewshed(wanted.face_attributes["face_id"][keep][order], np.isinf(share)[order])


def shown(store: StoreReader, level: int, found: Viewshed) -> Tin:
    """The faces of a viewshed as a mesh, with the attribute `is_visible`."""
    tin = store.tin(level)
    if tin.n_face == 0:
        return tin
    ids = tin.face_attributes["face_id"]
    part = part_of(tin, np.isin(ids, found.face_ids))
    at = np.searchsorted(found.face_ids, part.face_attributes["face_id"])
    return replace(part, face_attributes={**part.face_attributes, "is_visible": found.is_visible[at]})


def _places(given: Any, n: int, name: str) -> Floats:
    """Places as an array, (n_place, n)."""
    try:
        places = np.atleast_2d(np.asarray(given, np.float64))
    except (TypeError, ValueError):
        places = np.empty((0, 0))
    if places.ndim != 2 or places.shape[1] != n or not np.isfinite(places).all():
        raise InputError(f"{name}: found {str(given)[:60]}, expected {n} finite numbers")
    if name != "targets" and len(places) != 1:
        raise InputError(f"{name}: found {len(places)} places, expected one")
    return places


def _raised(store: StoreReader, level: int, places: Floats, name: str, is_absolute: bool) -> Floats:
    """Places with heights above the vertical datum."""
    store.check_level(level)
    if is_absolute:
        return places
    ground = locate(store, places[:, :2], level).z
    if np.isnan(ground).any():
        x, y = places[np.isnan(ground)][0, :2].tolist()
        raise InputError(f"{name}: found no ground at ({x:.10g}, {y:.10g}), expected some, or an absolute height")
    return places + np.column_stack([np.zeros((len(places), 2)), ground])


def _metres(store: StoreReader, curvature: bool) -> tuple[float, float]:
    """Size of a CRS unit, metres, where curvature counts; else 0, with which nothing bends."""
    return unit_metres(store.crs, store.extent) if curvature else (0.0, 0.0)


def _blocked(tin: Tin, origin: Floats, ends: Floats, metres: tuple[float, float], *, is_first: bool) -> Floats:
    """Share of each ray at which it is blocked; infinite where it is not; anywhere past the first unless `is_first`."""
    if tin.n_face == 0 or len(ends) == 0:
        return np.full(len(ends), np.inf)
    nodes = tin.nodes - (origin[0], origin[1], 0.0)  # from the observer: small numbers keep their digits
    ways = ends - (origin[0], origin[1], 0.0)
    bulge = ((ways[:, :2] * metres) ** 2).sum(axis=1) / (2.0 * BENT_RADIUS)
    graze = GRAZE * float(max(np.abs(nodes[:, 2]).max(), np.abs(ways[:, 2]).max(), abs(origin[2])))
    bins = bins_of(nodes, tin.face_nodes, nodes[:, :2].min(axis=0), nodes[:, :2].max(axis=0))
    found: Floats = first_blocks(nodes, tin.face_nodes, float(origin[2]), ways, bulge, graze, is_first, *bins)
    return found
