"""Features of several primitives: their points, lines and areas put together, across tiles too.

Source: specs/vpf.md, V-420 to V-423.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from vpfx.vpf.geometry import Geometries

__all__ = ["merge_parts"]

Ids = NDArray[np.int64]


def merge_parts(kind: str, owner: Ids, tile: Ids, parts: Geometries, n_feature: int) -> Geometries:
    """Geometry of each feature, from those of its primitives.

    Parameters
    ----------
    kind : str
        P, L, A or T.
    owner, tile : int64 (n_part,)
        Feature that each part belongs to, from 0, and the tile that it is in.
    parts : object (n_part,)
        Geometries of shapely, of areas valid within a tile: faces do not overlap. None is left out.
    n_feature : int

    Returns
    -------
    object (n_feature,)
        None for a feature without parts. Points in one place are one; lines are joined where two of them meet; areas are
        united, so that borders of tiles go; of texts the first place is taken. What is apart makes a multi-geometry. Of
        parts with and without heights none keeps them.

    Examples
    --------
    >>> parts = shapely.from_wkt(["LINESTRING (0 0, 1 0)", "LINESTRING (5 5, 6 6)", "LINESTRING (2 0, 1 0)"])
    >>> merge_parts("L", np.array([0, 1, 0]), np.array([1, 1, 2]), parts, 3).tolist()
    [<LINESTRING (0 0, 1 0, 2 0)>, <LINESTRING (5 5, 6 6)>, None]
    """
    is_there = ~(shapely.is_missing(parts) | shapely.is_empty(parts))
    order = np.flatnonzero(is_there)[np.argsort(owner[is_there], kind="stable")]
    owner, tile, parts = owner[order], tile[order], parts[order]
    merged: Geometries = np.full(n_feature, None, object)
    first = np.flatnonzero(np.diff(owner, prepend=-1))
    merged[owner[first]] = parts[first]
    n_part = np.bincount(owner, minlength=n_feature)
    if kind == "T" or not (n_part > 1).any():
        return merged
    several = n_part[owner] > 1
    owner, tile, parts = owner[several], tile[several], _of_one_dimension(owner[several], parts[several])
    owners, index = np.unique(owner, return_inverse=True)
    if kind == "A":
        merged[owners] = _united(index.ravel(), tile, parts)
    else:
        merged[owners] = _joined(index.ravel(), parts, kind)
    return merged


def _of_one_dimension(owner: Ids, parts: Geometries) -> Geometries:
    """Parts without heights where another part of the same feature has none."""
    is_flat = np.isin(owner, owner[~shapely.has_z(parts)])
    parts = parts.copy()
    parts[is_flat] = shapely.force_2d(parts[is_flat])
    return parts


def _joined(index: Ids, parts: Geometries, kind: str) -> Geometries:
    """Points or lines of each feature, equal ones once."""
    _, shape = np.unique(shapely.to_wkb(shapely.normalize(parts)), return_inverse=True)
    _, first = np.unique(np.stack([index, shape.ravel()]), axis=1, return_index=True)
    kept = np.sort(first)
    index, parts = index[kept], parts[kept]
    if kind == "L":
        return shapely.line_merge(shapely.multilinestrings(parts, indices=index))
    is_one = np.bincount(index)[index] == 1
    points = shapely.multipoints(parts, indices=index)
    points[index[is_one]] = parts[is_one]
    return points


def _united(index: Ids, tile: Ids, parts: Geometries) -> Geometries:
    """Areas of each feature: the faces of a tile share their edges exactly, those of two tiles nearly."""
    is_broken = ~shapely.is_valid(parts)
    parts[is_broken] = shapely.make_valid(parts[is_broken])
    broken = set(index[is_broken].tolist())
    order = np.lexsort([tile, index])
    index, tile, parts = index[order], tile[order], parts[order]
    starts = np.concatenate([np.flatnonzero(np.diff(index, prepend=-1)), [len(index)]])
    united: Geometries = np.full(len(starts) - 1, None, object)
    for i, (low, high) in enumerate(pairwise(starts)):
        own = parts[low:high]
        if i not in broken:
            own = np.array(
                [_cover(part) for part in np.split(own, np.flatnonzero(np.diff(tile[low:high])) + 1)], object
            )
        united[i] = own[0] if len(own) == 1 else shapely.union_all(own)
    return united


def _cover(faces: Geometries) -> Any:
    """Union of faces that do not overlap."""
    return faces[0] if len(faces) == 1 else shapely.coverage_union_all(faces)
