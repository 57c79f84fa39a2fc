"""Vertical navigation: parents, children, ancestors, descendants and siblings of faces, many at once.

Links are pairs. Where levels are nested a face has one parent; in the pyramids it may share area with several.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import InputError
from vpfx.store.arrays import runs_of
from vpfx.store.store import NO_IDS, Store

__all__ = ["Linked", "Related", "children", "descendants", "follow", "parents", "related", "siblings"]

Ids = NDArray[np.int64]


class Related(NamedTuple):
    """Pairs of a face asked for and a face related to it, in the order asked, then ascending.

    Attributes
    ----------
    of : int64 (n_pair,)
        Place of the first in what was asked.
    face_ids : int64 (n_pair,)
        The second.
    """

    of: Ids
    face_ids: Ids


class Linked(NamedTuple):
    """Pairs of a face asked for and a face it is linked to, in the order asked, then ascending.

    Attributes
    ----------
    of : int64 (n_pair,)
        Place of the first in what was asked.
    face_ids : int64 (n_pair,)
        The second.
    area : float64 (n_pair,)
        What the two share, squared CRS units; NaN where levels are nested: all of the child.
    """

    of: Ids
    face_ids: Ids
    area: NDArray[np.float64]


def follow(store: Store, face_ids: Ids, way: str) -> Linked:
    """Follow links of faces one level ``up`` or ``down``, with the areas shared; the ids are not checked."""
    return Linked(*_step(store, face_ids, way))


def parents(store: Store, face_ids: Any) -> Related:
    """Faces of the level before that share area with each face; none on level 0.

    Raises
    ------
    NotFoundError
        There is no such face.
    """
    return Related(*_step(store, _checked(store, face_ids), "up")[:2])


def children(store: Store, face_ids: Any) -> Related:
    """Faces of the next level that share area with each face; none on the last level.

    Raises
    ------
    NotFoundError
        There is no such face.
    """
    return Related(*_step(store, _checked(store, face_ids), "down")[:2])


def related(store: Store, face_ids: Any, level: int) -> Related:
    """Ancestors, or descendants, of each face at a level; the face itself at its own.

    Parameters
    ----------
    face_ids : integers (n,)
        Of one level or several.
    level : int

    Raises
    ------
    NotFoundError
        There is no such face or level.

    Notes
    -----
    In a pyramid these are the faces reached over links, level by level; they need not share area over more than one.
    """
    store.check_level(level)
    ids = _checked(store, face_ids)
    at = store.fetch("face", ids)["level"]
    index, current = np.arange(len(ids)), ids
    done = []
    while len(index):
        is_there = at == level
        done.append((index[is_there], current[is_there]))
        index, current, at = index[~is_there], current[~is_there], at[~is_there]
        moved = [(follow(store, current[way], name), way, change) for way, name, change in (
            (np.flatnonzero(at > level), "up", -1), (np.flatnonzero(at < level), "down", 1))]  # fmt: skip
        at = np.concatenate([at[way][step.of] + change for step, way, change in moved])
        index, current = (
            np.concatenate([index[way][step.of] for step, way, _ in moved]),
            np.concatenate([step.face_ids for step, _, _ in moved]),
        )
        pairs = np.unique(np.stack([index, current, at], axis=1), axis=0) if len(index) else np.empty((0, 3), np.int64)
        index, current, at = pairs.T
    pairs = (
        np.unique(np.concatenate([np.stack(pair, axis=1) for pair in done]), axis=0)
        if done
        else np.empty((0, 2), np.int64)
    )
    return Related(pairs[:, 0], pairs[:, 1])


def descendants(store: Store, face_ids: Any, level: int) -> Ids:
    """Faces of a level that come from some faces, or from which these come, each once, ascending: zoom in or out."""
    return np.unique(related(store, face_ids, level).face_ids)


def siblings(store: Store, face_ids: Any) -> Related:
    """Other faces that share a parent with each face; none on level 0."""
    up = parents(store, face_ids)
    down = children(store, up.face_ids)
    ids = _checked(store, face_ids)
    index = up.of[down.of]
    keep = down.face_ids != ids[index]
    pairs = np.unique(np.stack([index[keep], down.face_ids[keep]], axis=1), axis=0)
    return Related(pairs[:, 0], pairs[:, 1])


def _checked(store: Store, face_ids: Any) -> Ids:
    """Ids as an array, checked to be faces."""
    ids = np.asarray(face_ids)
    if ids.size and ids.dtype.kind not in "iu":
        raise InputError(f"faces: found {str(face_ids)[:40]}, expected whole numbers")
    return store.fetch("face", ids)["face_id"]


def _step(store: Store, ids: Ids, way: str) -> tuple[Ids, Ids, NDArray[np.float64]]:
    """Follow links one level up or down."""
    wanted, index = np.unique(ids, return_inverse=True)
    own, other, area = _links(store, wanted, way)
    low, high = (np.searchsorted(own, wanted, side=side) for side in ("left", "right"))
    count = (high - low)[index]
    owner = np.repeat(np.arange(len(ids)), count)
    first = np.cumsum(count) - count
    place = low[index][owner] + np.arange(len(owner)) - first[owner]
    return owner, other[place], area[place]


def _links(store: Store, ids: Ids, way: str) -> tuple[Ids, Ids, NDArray[np.float64]]:
    """Ids, their parents or children, and the areas they share, sorted; ids ascending."""
    own, other = ("child_face", "parent_face") if way == "up" else ("parent_face", "child_face")
    query = (
        f"SELECT p.{own}, p.{other}, s.area FROM parent_child p "
        "LEFT JOIN shared_area s ON s.child_face = p.child_face AND s.parent_face = p.parent_face "
        f"WHERE p.{own} BETWEEN ? AND ? ORDER BY p.{own}, p.{other}"
    )
    found = [tuple(store.select(query, run).values()) for run in runs_of(ids) or [NO_IDS]]
    columns = [np.concatenate(parts) for parts in zip(*found, strict=True)]
    is_asked = np.isin(columns[0], ids)
    return columns[0][is_asked], columns[1][is_asked], columns[2][is_asked]
