"""Vertical navigation: parents, children, ancestors, descendants and siblings of faces, many at once.

Links are pairs. Where levels are nested a face has one parent; in the pyramids it may share area with several.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from vpfx.errors import InputError, StoreFormatError
from vpfx.geometry import LEAST_SHARED
from vpfx.store.arrays import NO_IDS, SWEEP, look_up, runs_of
from vpfx.store.descent import mesh_of
from vpfx.store.reader import StoreReader

__all__ = ["Related", "children", "descendants", "follow", "parents", "related", "siblings"]

Ids = NDArray[np.int64]
Floats = NDArray[np.float64]


class Related(NamedTuple):
    """Pairs of a face asked for and a face related to it, in the order asked, then ascending.

    Attributes
    ----------
    of : int64 (n_pair,)
        Place of the first in what was asked.
    face_ids : int64 (n_pair,)
        The second.
    area : float64 (n_pair,), optional
        What the two share, squared CRS units; only if asked for.
    """

    of: Ids
    face_ids: Ids
    area: Floats | None = None


def parents(store: StoreReader, face_ids: Any, *, with_area: bool = False) -> Related:
    """Faces of the level before that share area with each face; none on level 0.

    Parameters
    ----------
    face_ids : integers (n,)
    with_area : bool
        Tell how much area they share.

    Raises
    ------
    NotFoundError
        There is no such face.
    """
    ids = _checked(store, face_ids)
    found = _step(store, ids, "up")
    return _measured(store, ids, found) if with_area else found


def children(store: StoreReader, face_ids: Any, *, with_area: bool = False) -> Related:
    """Faces of the next level that share area with each face; none on the last level.

    Parameters
    ----------
    face_ids : integers (n,)
    with_area : bool
        Tell how much area they share.

    Raises
    ------
    NotFoundError
        There is no such face.
    """
    ids = _checked(store, face_ids)
    found = _step(store, ids, "down")
    return _measured(store, ids, found) if with_area else found


def related(store: StoreReader, face_ids: Any, level: int, *, with_area: bool = False) -> Related:
    """Ancestors, or descendants, of each face at a level; the face itself at its own.

    Parameters
    ----------
    face_ids : integers (n,)
        Of one level or several.
    level : int
    with_area : bool
        Tell how much area they share.

    Raises
    ------
    NotFoundError
        There is no such face or level.

    Notes
    -----
    In a pyramid these are the faces reached over links, level by level; over more than one they need not share area. With
    `with_area` those that share none are left out.
    """
    store.check_level(level)
    ids = _checked(store, face_ids)
    at = store.fetch("face", ids)["level"]
    index, current = np.arange(len(ids)), ids
    done = []
    while True:
        is_there = at == level
        done.append((index[is_there], current[is_there]))
        index, current, at = index[~is_there], current[~is_there], at[~is_there]
        if len(index) == 0:
            break
        moved = [(_step(store, current[way], name), way, change) for way, name, change in (
            (np.flatnonzero(at > level), "up", -1), (np.flatnonzero(at < level), "down", 1))]  # fmt: skip
        at = np.concatenate([at[way][step.of] + change for step, way, change in moved])
        index, current = (
            np.concatenate([index[way][step.of] for step, way, _ in moved]),
            np.concatenate([step.face_ids for step, _, _ in moved]),
        )
        index, current, at = np.unique(np.stack([index, current, at], axis=1), axis=0).T
    pairs = np.unique(np.concatenate([np.stack(pair, axis=1) for pair in done]), axis=0)
    found = Related(pairs[:, 0], pairs[:, 1])
    return _measured(store, ids, found) if with_area else found


def descendants(store: StoreReader, face_ids: Any, level: int) -> Ids:
    """Faces of a level that come from some faces, or from which these come, each once, ascending: zoom in or out."""
    return np.unique(related(store, face_ids, level).face_ids)


def siblings(store: StoreReader, face_ids: Any) -> Related:
    """Other faces that share a parent with each face; none on level 0."""
    up = parents(store, face_ids)
    down = children(store, up.face_ids)
    ids = _checked(store, face_ids)
    index = up.of[down.of]
    keep = down.face_ids != ids[index]
    pairs = np.unique(np.stack([index[keep], down.face_ids[keep]], axis=1), axis=0)
    return Related(pairs[:, 0], pairs[:, 1])


def _checked(store: StoreReader, face_ids: Any) -> Ids:
    """Ids as an array, checked to be faces."""
    ids = np.asarray(face_ids)
    if ids.size and ids.dtype.kind not in "iu":
        raise InputError(f"faces: found {str(face_ids)[:40]}, expected whole numbers")
    return store.fetch("face", ids)["face_id"]


def _step(store: StoreReader, ids: Ids, way: str) -> Related:
    """Follow links one level up or down."""
    wanted, index = np.unique(ids, return_inverse=True)
    pairs = store.linked("child_face" if way == "up" else "parent_face", wanted)
    low, high = (np.searchsorted(pairs[:, 0], wanted, side=side) for side in ("left", "right"))
    count = (high - low)[index]
    owner = np.repeat(np.arange(len(ids)), count)
    first = np.cumsum(count) - count
    place = low[index][owner] + np.arange(len(owner)) - first[owner]
    return Related(owner, pairs[place, 1])


def follow(store: StoreReader, face_ids: Ids, way: str) -> tuple[Related, Floats]:
    """Follow links of faces one level ``up`` or ``down``, with the areas stored (R-182); the ids are not checked.

    Where levels are nested areas are NaN: a child shares all of its own.
    """
    found = _step(store, face_ids, way)
    if store.is_nested:
        return found, np.full(len(found.of), np.nan)
    ends = face_ids[found.of], found.face_ids
    child, parent = ends if way == "up" else ends[::-1]
    query = "SELECT child_face, parent_face, area FROM shared_area WHERE child_face BETWEEN ? AND ? ORDER BY 1, 2"
    parts = [store.select(query, run) for run in runs_of(np.unique(child), SWEEP) or [NO_IDS]]
    rows = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    known, wanted = _keys((rows["child_face"], rows["parent_face"]), (child, parent))
    at, is_there = look_up(known, wanted)
    if not is_there.all():
        raise StoreFormatError(str(store.path), "table shared_area", "found links without an area", "R-182")
    return found, rows["area"][at]


def _keys(*pairs: tuple[Ids, Ids]) -> list[Ids]:
    """Name pairs of numbers by one number each, in the order of the first, then the second."""
    first, second = (np.unique(np.concatenate(column), return_inverse=True)[1] for column in zip(*pairs, strict=True))
    keys = first * (int(second.max(initial=0)) + 1) + second
    return np.split(keys, np.cumsum([len(pair[0]) for pair in pairs[:-1]]))


def _measured(store: StoreReader, ids: Ids, found: Related) -> Related:
    """Add the areas that pairs share, by GEOS; pairs that only touch are left out."""
    each, place = np.unique(np.concatenate([ids[found.of], found.face_ids]), return_inverse=True)
    mesh = mesh_of(store, store.fetch("face", each))
    one, other = shapely.polygons(mesh.xyz[:, :2][mesh.face_nodes[:, [0, 1, 2, 0]]])[place.reshape(2, -1)]
    area = shapely.area(shapely.intersection(one, other))
    is_shared = area > LEAST_SHARED * np.minimum(shapely.area(one), shapely.area(other))
    return Related(found.of[is_shared], found.face_ids[is_shared], area[is_shared])
