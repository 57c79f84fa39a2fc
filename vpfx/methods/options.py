"""Options that methods share: checked in one place, and turned into levels and start grids.

A method's own options stand in its file; `SHARED` are those of every method that cuts a start mesh again and again.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from vpfx.checks import number, whole_number, whole_numbers
from vpfx.errors import InputError

__all__ = ["SHARED", "bounds_of", "checked", "chosen", "free_levels", "n_level", "squares"]

MOST_LEVELS = 32
SQUARE = 72  # posts to a side of a start square if nothing is asked; as many in all where posts are not square
SHARED: dict[str, Any] = {
    "max_error": None,
    "passes": None,
    "grid": None,
    "tolerance": 0.0,
    "start": "grid",
    "start_posts": 200,
}
NOT_NEGATIVE = {"tolerance": np.inf, "xy_tolerance": np.inf, "xy_ratio": 0.5}  # and below this
OF_PASSES = ("tolerance", "xy_tolerance", "xy_ratio")


def checked(method: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Options as plain Python values, those that methods share each checked by itself; the mode may still be open.

    Parameters
    ----------
    method : str
        Its name, for messages.

    Raises
    ------
    InputError
        A value makes no sense.
    """
    found = dict(options)
    if options.get("max_error") is not None:
        found["max_error"] = bounds_of(method, options)
    if options["passes"] is not None:
        found["passes"] = whole_number(options["passes"], f"{method}: passes", 0, MOST_LEVELS - 1)
    for name, most in NOT_NEGATIVE.items():
        if name in options:
            found[name] = number(options[name], f"{method}: {name}", 0, most)
    if "start" in options:
        chosen(method, options, "start", ("grid", "delaunay"))
        found["start_posts"] = whole_number(options["start_posts"], f"{method}: start_posts", 1)
    if options["grid"] is not None:
        found["grid"] = whole_numbers(options["grid"], f"{method}: grid", 1)
        if len(found["grid"]) != 2:
            raise InputError(f"{method}: grid: found {found['grid']}, expected columns and rows of squares")
    return found


def chosen(method: str, options: Mapping[str, Any], name: str, known: tuple[str, ...]) -> None:
    """Check that an option has one of the values known."""
    if options[name] not in known:
        raise InputError(f"{method}: found {name} {options[name]!r}, expected one of: {', '.join(known)}")


def bounds_of(method: str, options: Mapping[str, Any]) -> list[float]:
    """Bounds as numbers, checked to be positive and falling."""
    given = options["max_error"]
    try:
        bounds = [] if isinstance(given, str) else [float(bound) for bound in given]
    except (TypeError, ValueError):
        bounds = []
    if not 0 < len(bounds) <= MOST_LEVELS or any(not 0 < bound < np.inf for bound in bounds):
        raise InputError(f"{method}: found max_error {given}, expected 1 … {MOST_LEVELS} positive numbers of metres")
    if any(fine >= coarse for coarse, fine in pairwise(bounds)):
        raise InputError(f"{method}: found max_error {given}, expected each smaller than the one before")
    return bounds


def n_level(method: str, options: Mapping[str, Any], defaults: Mapping[str, Any]) -> int:
    """Levels that are asked for: one a bound, or the start mesh and one a pass.

    Raises
    ------
    InputError
        Neither or both of max_error and passes are given, or a tolerance of pass mode without passes.
    """
    bounds = options.get("max_error")
    if "max_error" not in defaults and options["passes"] is None:
        raise InputError(f"{method}: found no passes, expected a number of them")
    if "max_error" in defaults and (bounds is None) == (options["passes"] is None):
        raise InputError(f"{method}: found neither or both of max_error and passes, expected one of them")
    if options["passes"] is None and any(options[name] != defaults[name] for name in OF_PASSES if name in defaults):
        raise InputError(f"{method}: found a tolerance of pass mode without passes, expected both or none")
    return len(bounds) if bounds is not None else 1 + int(options["passes"])


def free_levels(method: str, options: Mapping[str, Any], defaults: Mapping[str, Any]) -> list[None]:
    """Rules of all levels for the borders of a method that breaks none: None for each level."""
    return [None] * n_level(method, options, defaults)


def squares(options: Mapping[str, Any], n_row: int, n_col: int, aspect: float) -> tuple[int, int]:
    """Rows and columns of the start grid over n_row × n_col posts: as asked, or squares on the ground (`SQUARE`)."""
    if options["grid"]:
        return options["grid"][1], options["grid"][0]
    side = SQUARE * np.sqrt(aspect)
    n_south, n_east = round((n_row - 1) / side), round((n_col - 1) * aspect / side)
    return min(max(1, n_south), n_row - 1), min(max(1, n_east), n_col - 1)
