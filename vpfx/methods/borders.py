"""Nodes on tile borders, decided from the posts of the border alone, so that both neighbours decide the same.

A border is walked from west to east or from south to north, whoever asks; all sums are then the same floats on both
sides, and ties go to the first post (specs/methods.md M-200).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vpfx.methods.base import NEVER, Border

__all__ = ["LevelRule", "border_nodes"]


class LevelRule(NamedTuple):
    """When and where a border edge is broken on the way to one level.

    Attributes
    ----------
    bound : float
        An edge is broken when a post of it is off by more than this, metres.
    middle : float
        The break keeps this share of the edge's length from both ends.
    away : float
        Posts nearer than this to an end are not looked at, metres.
    share : float
        The same as a share of the edge's length.
    repeats : bool
        Whether the halves are looked at again for the same level.
    """

    bound: float
    middle: float
    away: float
    share: float
    repeats: bool


def border_nodes(
    heights: NDArray[np.float64], is_forced: NDArray[np.bool_], rules: Sequence[LevelRule | None], metres: float
) -> Border:
    """Decide which posts of a border are nodes, and from which level on.

    Parameters
    ----------
    heights : float64 (n_post,)
        From west to east or from south to north, NaN for voids.
    is_forced : bool (n_post,)
        Nodes of level 0 before any rule is applied; first and last post are always nodes.
    rules : sequence of LevelRule or None
        One per level; None where the level takes no new nodes.
    metres : float
        Distance from post to post along the border.

    Examples
    --------
    >>> rule = LevelRule(bound=1.0, middle=0.35, away=0.0, share=0.0, repeats=True)
    >>> border_nodes(np.array([0.0, 0.0, 9.0, 0.0, 0.0]), np.zeros(5, bool), [rule], 30.0).rank.tolist()
    [0, 3, 2, 4, 1]
    """
    rank = np.full(len(heights), NEVER, np.int32)
    forced = is_forced.copy()
    forced[[0, -1]] = True
    start = np.flatnonzero(forced)
    rank[start] = np.arange(len(start))
    limit = np.empty(len(rules), np.int32)
    count = len(start)
    for level, rule in enumerate(rules):
        if rule is not None:
            count = _refine(heights, rank, count, rule.bound, rule.middle, rule.away / metres, rule.share, rule.repeats)
        limit[level] = count
    return Border(rank, len(start), limit, True)


@njit(nogil=True, cache=True)
def _refine(heights, rank, count, bound, middle, away, share, repeats):
    """Break the edges between the ranked posts, round by round; return the number of ranked posts."""
    n_post = len(heights)
    while True:
        found = 0
        start = 0
        for end in range(1, n_post):
            if rank[end] >= count:
                continue
            length = end - start
            least = max(away, share * length)
            best, at = bound, -1
            for post in range(start + 1, end):
                if min(post - start, end - post) < least:
                    continue
                along = (post - start) / length
                error = abs(heights[post] - (heights[start] + along * (heights[end] - heights[start])))
                if error > best:
                    best, at = error, post
            if at >= 0:
                low = start + max(1, int(np.floor(middle * length)))
                high = end - max(1, int(np.floor(middle * length)))
                rank[min(max(at, low), high)] = count + found
                found += 1
            start = end
        count += found
        if found == 0 or not repeats:
            return count
