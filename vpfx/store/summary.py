"""Totals of a level, as they are stored, reported and printed."""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["LevelSummary", "LevelTotals"]


class LevelTotals(NamedTuple):
    """What is known of a level beyond its rows.

    Attributes
    ----------
    max_error_bound : float or None
        Bound asked for, metres.
    max_error, rmse : float
        Vertical errors measured at the valid posts, metres.
    max_rise : float or None
        As in `LevelSummary`.
    posts : int
        Valid posts measured.
    cuts : tuple of int
        Faces cut on the way to the level, by the kinds of `vpfx.model.CUTS`.
    """

    max_error_bound: float | None
    max_error: float
    rmse: float
    max_rise: float | None
    posts: int
    cuts: tuple[int, ...]


class LevelSummary(NamedTuple):
    """Totals of one level.

    Attributes
    ----------
    level : int
        0 is the coarsest.
    max_error_bound : float or None
        Bound asked for, metres.
    max_error, rmse : float
        Vertical errors measured at the valid posts, metres.
    max_rise : float or None
        Greatest distance in z of a node new at the level from the surface of the level before, metres; None on level 0, and
        where levels are not nested.
    posts : int
        Valid posts measured.
    nodes, edges, faces : int
        Counts; nodes of coarser levels included.
    """

    level: int
    max_error_bound: float | None
    max_error: float
    rmse: float
    max_rise: float | None
    posts: int
    nodes: int
    edges: int
    faces: int
