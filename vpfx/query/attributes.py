"""What faces of any level are part of: the features of a class, by inheritance, for many faces at once.

A feature on a face holds for all faces below until one of these has features of the class by itself. So a finer face has what
its nearest ancestor has, and a coarser one has what lies below it, by area. The view `face_attribute` (R-234) says the same.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import InputError
from vpfx.query.vertical import follow
from vpfx.store.arrays import NO_IDS, SWEEP, look_up, runs_of
from vpfx.store.classes import FeatureClass, find_class
from vpfx.store.descent import mesh_of
from vpfx.store.reader import StoreReader

__all__ = ["Attributes", "added_up", "areas_of", "attributes"]

Ids = NDArray[np.int64]
Floats = NDArray[np.float64]

NOBODY = -1
"""Stands for the owner of what no face below the one asked for owns."""


class Attributes(NamedTuple):
    """Features of faces, in the order asked, then of features; faces without any do not show.

    Attributes
    ----------
    of : int64 (n,)
        Place of the face in what was asked.
    feature_ids : int64 (n,)
    share : float64 (n,)
        Part of the area of the face, above 0; less than 1 together where a part has no feature.
    columns : dict of str to array (n,)
        Values of the features: text and dates as objects, None for NULL; integers as int64, or as objects where one is NULL;
        reals as float64, NaN for NULL.
    """

    of: Ids
    feature_ids: Ids
    share: Floats
    columns: dict[str, NDArray[Any]]


class _Parts(NamedTuple):
    """Parts of the faces asked for: whose, at which face, which share of its area, and who owns it."""

    of: Ids
    face_ids: Ids
    share: Floats
    owner: Ids

    def at(self, some: NDArray[Any]) -> _Parts:
        """Return some of them."""
        return _Parts(*(column[some] for column in self))

    def merged(self) -> _Parts:
        """Return them with those of one face asked, one face and one owner added up."""
        keys, share = added_up(np.stack([self.of, self.face_ids, self.owner]), self.share)
        return _Parts(keys[0], keys[1], share, keys[2])


def attributes(store: StoreReader, face_ids: Any, class_name: str) -> Attributes:
    """Features of a class that faces of any level are part of.

    Parameters
    ----------
    store : StoreReader
    face_ids : integers (n,)
        Of one level or several, also more than once.
    class_name : str

    Returns
    -------
    found : Attributes

    Raises
    ------
    NotFoundError
        There is no such class or face.
    StoreFormatError
        The table of the class is not the one its columns make.

    Notes
    -----
    Source: specs/format.md R-234. Cost: the faces asked, their ancestors and all their descendants, each level at once.

    Examples
    --------
    ``attributes(store, [3, 4], "soil").columns["kind"]``
    """
    with store.snapshot():
        return _attributes(store, face_ids, find_class(store.classes, class_name, store.path))


def _attributes(store: StoreReader, face_ids: Any, found: FeatureClass) -> Attributes:
    """Answer in one state of the file."""
    asked = np.asarray(face_ids)
    if asked.size and asked.dtype.kind not in "iu":
        raise InputError(f"faces: found {str(face_ids)[:40]}, expected whole numbers")
    faces, place = np.unique(asked.ravel().astype(np.int64), return_inverse=True)
    level = store.fetch("face", faces)["level"]
    above = _owners_above(store, found, faces)
    below = _owners_below(store, found, faces, level)
    owned = _joined(above, below, len(faces))
    of, features, share = _with_features(store, found, owned)
    low, high = (np.searchsorted(of, np.arange(len(faces)), side=side) for side in ("left", "right"))
    count = (high - low)[place]
    whose = np.repeat(np.arange(len(place)), count)
    row = low[place][whose] + np.arange(len(whose)) - (np.cumsum(count) - count)[whose]
    return Attributes(whose, features[row], share[row], _columns(store, found, features[row]))


def areas_of(store: StoreReader, face_ids: Ids) -> Floats:
    """Plan areas of faces, float64 (n,), squared CRS units."""
    mesh = mesh_of(store, store.fetch("face", face_ids))
    a, b, c = (mesh.xyz[mesh.face_nodes[:, i], :2] for i in range(3))
    area: Floats = ((b - a)[:, 0] * (c - a)[:, 1] - (c - a)[:, 0] * (b - a)[:, 1]) / 2
    return area


def _owners_above(store: StoreReader, found: FeatureClass, faces: Ids) -> _Parts:
    """Faces with features that are nearest to each face, itself or above, with their shares of it."""
    parts = _Parts(np.arange(len(faces)), faces, np.ones(len(faces)), np.full(len(faces), NOBODY))
    done = [parts.at(np.zeros(0, np.int64))]
    for _ in store.levels:
        has_own = _have_features(store, found, parts.face_ids)
        done.append(parts.at(has_own))
        parts = parts.at(~has_own)
        step, shared = follow(store, parts.face_ids, "up")
        known, index = np.unique(parts.face_ids, return_inverse=True)
        is_shared = not np.isnan(shared).all()
        weight = shared / areas_of(store, known)[index][step.of] if is_shared else np.ones(len(step.of))
        parts = _Parts(parts.of[step.of], step.face_ids, parts.share[step.of] * weight, parts.owner[step.of]).merged()
    merged = _Parts(*(np.concatenate(columns) for columns in zip(*done, strict=True)))
    return merged._replace(owner=merged.face_ids)


def _owners_below(store: StoreReader, found: FeatureClass, faces: Ids, level: Ids) -> _Parts:
    """Owners of the faces of the finest level below each face, with their shares of it; `NOBODY` where none is below."""
    waiting = _Parts(np.arange(len(faces)), faces, np.ones(len(faces)), np.full(len(faces), NOBODY))
    parts = waiting.at(np.zeros(0, np.int64))
    last = len(store.levels) - 1
    for at in range(int(level.min(initial=last)), last + 1):
        parts = _Parts(*(np.concatenate(pair) for pair in zip(parts, waiting.at(level == at), strict=True)))
        if at == last or len(parts.of) == 0:
            continue
        step, shared = follow(store, parts.face_ids, "down")
        known, index = np.unique(parts.face_ids, return_inverse=True)
        children, child = np.unique(step.face_ids, return_inverse=True)
        area = np.where(np.isnan(shared), areas_of(store, children)[child], shared)
        share = parts.share[step.of] * area / areas_of(store, known)[index][step.of]
        has_own = _have_features(store, found, children)[child]
        owner = np.where(has_own, step.face_ids, parts.owner[step.of])
        parts = _Parts(parts.of[step.of], step.face_ids, share, owner)
        parts = parts if np.isnan(shared).all() else parts.merged()
    keys, share = added_up(np.stack([parts.of, parts.owner]), parts.share)
    total = np.bincount(keys[0], share, len(faces))
    return _Parts(keys[0], keys[1], share / total[keys[0]], keys[1])


def _joined(above: _Parts, below: _Parts, n_face: int) -> _Parts:
    """Give what nobody below owns to the owners above."""
    is_free = below.owner == NOBODY
    free = np.bincount(below.of[is_free], below.share[is_free], n_face)
    above = above._replace(share=above.share * free[above.of])
    pairs = zip(below.at(~is_free), above.at(above.share > 0), strict=True)
    return _Parts(*(np.concatenate(pair) for pair in pairs))


def _have_features(store: StoreReader, found: FeatureClass, faces: Ids) -> NDArray[np.bool_]:
    """Tell which faces have features of the class by themselves; the plus keeps SQLite to the order of faces."""
    query = "SELECT DISTINCT face_id FROM face_feature WHERE face_id BETWEEN ? AND ? AND +class_id = ? ORDER BY face_id"
    known = [
        store.select(query, (*run, found.class_id))["face_id"] for run in runs_of(np.unique(faces), SWEEP) or [NO_IDS]
    ]
    return look_up(np.concatenate(known), faces)[1]


def _with_features(store: StoreReader, found: FeatureClass, owned: _Parts) -> tuple[Ids, Ids, Floats]:
    """Features of what owners own, added up: place of the face, feature, share."""
    owners, index = np.unique(owned.owner, return_inverse=True)
    query = (
        "SELECT face_id, feature_id, share FROM face_feature WHERE face_id BETWEEN ? AND ? AND +class_id = ? "
        "ORDER BY face_id, feature_id"
    )
    rows = [tuple(store.select(query, (*run, found.class_id)).values()) for run in runs_of(owners, SWEEP) or [NO_IDS]]
    face, feature, share = (np.concatenate(columns) for columns in zip(*rows, strict=True))
    low, high = (np.searchsorted(face, owners, side=side) for side in ("left", "right"))
    count = (high - low)[index]
    part = np.repeat(np.arange(len(index)), count)
    row = low[index][part] + np.arange(len(part)) - (np.cumsum(count) - count)[part]
    keys, total = added_up(np.stack([owned.of[part], feature[row]]), owned.share[part] * share[row])
    return keys[0], keys[1], total


def added_up(keys: Ids, share: Floats) -> tuple[Ids, Floats]:
    """Add up numbers (n,) of equal keys (n_key, n): the keys, each once and in order, and the sums.

    Examples
    --------
    >>> added_up(np.array([[5, 2, 5], [1, 1, 1]]), np.array([0.5, 1.0, 0.25]))
    (array([[2, 5],
           [1, 1]]), array([1.  , 0.75]))
    """
    row = np.lexsort(keys[::-1])
    ordered = keys[:, row]
    is_first = np.append(np.ones(min(1, len(row)), bool), (ordered[:, 1:] != ordered[:, :-1]).any(axis=0))
    sums: Floats = np.bincount(np.cumsum(is_first) - 1, share[row]).astype(np.float64)
    return ordered[:, is_first], sums


def _columns(store: StoreReader, found: FeatureClass, features: Ids) -> dict[str, NDArray[Any]]:
    """Values of features, in their order."""
    known, index = np.unique(features, return_inverse=True)
    rows: dict[int, tuple[Any, ...]] = {}
    for run in runs_of(known, SWEEP):
        rows.update(store.feature_values(found, *run))
    values = [rows.get(feature, (None,) * len(found.columns)) for feature in known.tolist()]
    columns: dict[str, NDArray[Any]] = {}
    for i, (name, column) in enumerate(found.columns.items()):
        given = [value[i] for value in values]
        if column.kind == "real":
            columns[name] = np.array(given, np.float64)[index]
        elif column.kind == "integer" and None not in given:
            columns[name] = np.array(given, np.int64)[index]
        else:
            columns[name] = np.array([*given, None], object)[:-1][index]  # None makes it objects
    return columns
