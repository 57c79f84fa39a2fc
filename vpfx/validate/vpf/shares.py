r"""Inheritance of features by faces (specs/format.md, R-234): sums over the whole hierarchy at once.

Each face has an area, that of the finest faces below it. Going up, a face gathers what the faces below own of it; going down,
what nobody below owns is given to the nearest face above with features of its own::

    level 0    A has grass           B
              /        \           /  \
    level 1  c          d has rock e    f         c: all grass    d: all rock    A: rock by the area of d, the rest grass
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Pairs", "Step", "inherited"]

Ids = NDArray[np.int64]
Floats = NDArray[np.float64]


class Pairs(NamedTuple):
    """Faces, each with a feature and its share; or a part of the area.

    Attributes
    ----------
    face, feature : int64 (n,)
    share : float64 (n,)
    """

    face: Ids
    feature: Ids
    share: Floats

    @staticmethod
    def none() -> Pairs:
        """No pairs."""
        return Pairs(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0))


class Step(NamedTuple):
    """Links between two levels: `part` is the part of the child's area that lies in the parent."""

    parent: Ids
    child: Ids
    part: Floats


def _summed(parts: Sequence[Pairs]) -> Pairs:
    """Pairs with shares of the same face and feature added up."""
    face, feature, share = (np.concatenate(column) for column in zip(*parts, strict=True))
    if not len(face):
        return Pairs.none()
    n_feature = int(feature.max()) + 1
    both, pair = np.unique(face * n_feature + feature, return_inverse=True)
    return Pairs(both // n_feature, both % n_feature, np.bincount(pair, share).astype(np.float64))


def _over(links: Step, pairs: Pairs, n_from: int, *, down: bool) -> Pairs:
    """Carry pairs over links, upwards or downwards: times the part of the child in each."""
    start, end = (links.parent, links.child) if down else (links.child, links.parent)
    order = np.argsort(start, kind="stable")
    bounds = np.searchsorted(start[order], np.arange(n_from + 1))
    first, count = bounds[pairs.face], np.diff(bounds)[pairs.face]
    pair = np.repeat(np.arange(len(count)), count)
    link = order[np.arange(len(pair)) - np.repeat(np.cumsum(count) - count, count) + first[pair]]
    return Pairs(end[link], pairs.feature[pair], pairs.share[pair] * links.part[link])


def _scaled(pairs: Pairs, by_face: Floats) -> Pairs:
    return pairs._replace(share=pairs.share * by_face[pairs.face])


def inherited(
    own: Sequence[Pairs], counts: Sequence[int], steps: Sequence[Step], area: Floats, blur: Floats
) -> list[tuple[Pairs, Floats]]:
    """What the faces of each level have, those of coarser and finer levels considered.

    Parameters
    ----------
    own : sequence of Pairs
        What faces have by themselves, level by level from the coarsest.
    counts : sequence of int
        Faces of each level.
    steps : sequence of Step
        Links of each level but the first to the one before.
    area, blur : float64 (n_face,)
        Of the faces of the finest level: area, and by how much rounding may have changed it.

    Returns
    -------
    list of (Pairs, float64 (n_face,))
        For each level the shares, and by how much these may be off for each face.

    Examples
    --------
    A face with feature 7 and two children of areas 1 and 3, of which the second has feature 9:

    >>> own = [Pairs(np.array([0]), np.array([7]), np.ones(1)), Pairs(np.array([1]), np.array([9]), np.ones(1))]
    >>> step = Step(np.array([0, 0]), np.array([0, 1]), np.ones(2))
    >>> [found.share.tolist() for found, _ in inherited(own, [1, 2], [step], np.array([1, 3.0]), np.zeros(2))]
    [[0.25, 0.75], [1.0, 1.0]]
    """
    has_own = [np.bincount(pairs.face, minlength=count) > 0 for pairs, count in zip(own, counts, strict=True)]
    total, blurs, free, owned = [area], [blur], [np.where(has_own[-1], 0.0, area)], [_scaled(own[-1], area)]
    for level in range(len(counts) - 2, -1, -1):  # upwards: areas, what nobody below owns, what somebody does
        step, count = steps[level], counts[level]
        carried = [
            np.bincount(step.parent, part[step.child] * step.part, minlength=count).astype(np.float64)
            for part in (total[0], blurs[0], free[0])
        ]
        below = _over(step, owned[0], counts[level + 1], down=False)
        owned.insert(0, _summed([below, _scaled(own[level], carried[2])]))
        total.insert(0, carried[0])
        blurs.insert(0, carried[1])
        free.insert(0, np.where(has_own[level], 0.0, carried[2]))
    found, above = [], Pairs.none()
    for level in range(len(counts)):  # downwards: what the nearest faces above have
        if level:
            step = steps[level - 1]
            above = _over(step, above, counts[level - 1], down=True)
            kept = ~has_own[level][above.face]
            above = Pairs(above.face[kept], above.feature[kept], above.share[kept])
        pairs = _summed([owned[level], _scaled(above, free[level])])
        with np.errstate(invalid="ignore", divide="ignore"):
            found.append((_scaled(pairs, 1.0 / total[level]), blurs[level] / total[level]))
        above = _summed([above, own[level]])
    return found
