"""What every method is and takes: `Method`, `Patch`, `Border`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import InputError
from vpfx.model import Hierarchy

__all__ = ["NEVER", "Border", "Method", "Patch", "check_features", "checked_options", "takes_features"]

NEVER = np.iinfo(np.int32).max  # rank of a post that is a node at no level


class Border(NamedTuple):
    """Nodes of one side of a patch, decided from the posts of that side alone (specs/methods.md M-200).

    Attributes
    ----------
    rank : int32 (n_post,)
        Order in which the posts of the side become nodes, from west to east or south to north; `NEVER` for the others.
        An edge of the side is broken at the post of least rank between its ends.
    n_start : int
        Posts with a rank below this are nodes of the start mesh.
    limit : int32 (n_level,)
        Posts with a rank below ``limit[k]`` are nodes at level k.
    is_fixed : bool
        False where the side is the outside of the extent: there the patch decides alone.
    """

    rank: NDArray[np.int32]
    n_start: int
    limit: NDArray[np.int32]
    is_fixed: bool


@dataclass(frozen=True, eq=False)
class Patch:
    """The posts of one tile, ready to be triangulated; places are in posts from its south-west corner.

    Attributes
    ----------
    heights : float64 (n_row, n_col)
        Metres, row 0 in the south, NaN for voids.
    squares : uint8 (n_row - 1, n_col - 1)
        Ground with data in each square of four posts, see `vpfx.methods.ground.square_codes`.
    borders : tuple of Border
        South, east, north, west.
    post_metres : tuple of float
        Width and height of a post spacing in metres.
    is_owned : bool (n_row, n_col)
        Posts whose vertical errors this patch counts: each post belongs to one patch.
    keeps_voids : bool
        Whether ground without data is covered too, by faces marked as filled; then heights has no NaN.
    seed : int
        Start of the random choices of this patch.
    n_square : tuple of int
        Rows and columns of squares of the start grid.
    has_more : bool
        Whether finer levels than those asked for will follow: while bounds are looked for, level by level.
    lines : tuple of float64 (n, 3)
        Surveyed lines that touch the patch, those of one vertex being points: u, v, and heights in metres, NaN for none.
    """

    heights: NDArray[np.float64]
    squares: NDArray[np.uint8]
    borders: tuple[Border, Border, Border, Border]
    post_metres: tuple[float, float]
    is_owned: NDArray[np.bool_]
    keeps_voids: bool = False
    seed: int = 0
    n_square: tuple[int, int] = (1, 1)
    has_more: bool = False
    lines: tuple[NDArray[np.float64], ...] = ()

    @property
    def aspect(self) -> float:
        """Width of a post spacing divided by its height."""
        return self.post_metres[0] / self.post_metres[1]


@dataclass(frozen=True)
class Method:
    """A way to build a hierarchy.

    Attributes
    ----------
    name, title, source : str
        The name in commands, in words, and where it was published.
    adjacent : bool
        Whether no node ever lies inside an edge.
    nested : bool
        Whether each child lies inside one parent.
    bounded : bool
        Whether it can hold a bound: then max_error is one of its options.
    tiled : bool
        Whether tiles can be built one by one; else the whole DEM is one tile.
    voids : bool
        Whether it can follow the outline of voids.
    cuts : tuple of str
        Kinds of cut it makes, of `vpfx.model.CUTS`.
    defaults : mapping
        Its options and their values.
    checked : callable
        Options → the same as plain Python values, each checked by itself.
    levels : callable
        Options → the rule of each level, shared with the borders: a list of `vpfx.methods.borders.LevelRule`.
    squares : callable
        ``squares(options, n_row, n_col, aspect)`` → squares of the start grid (rows, columns) over so many posts; each
        number hangs on the posts along its side and on the width of a post spacing by its height in the middle of the DEM.
    build : callable
        ``build(patch, options) -> Hierarchy`` with nodes in posts of the patch.
    features : str
        What it makes of surveyed lines and areas: ``edges`` of every level, ``points`` that may become nodes, or "" nothing.
    variants : mapping
        Names of the forms in which it is compared, and their options.
    """

    name: str
    title: str
    source: str
    adjacent: bool
    nested: bool
    bounded: bool
    tiled: bool
    voids: bool
    cuts: tuple[str, ...]
    defaults: Mapping[str, Any]
    checked: Callable[[Mapping[str, Any]], dict[str, Any]]
    levels: Callable[[Mapping[str, Any]], list[Any]]
    squares: Callable[[Mapping[str, Any], int, int, float], tuple[int, int]]
    build: Callable[[Patch, Mapping[str, Any]], Hierarchy]
    features: str = ""
    variants: Mapping[str, Mapping[str, Any]] = field(default_factory=lambda: {"": {}})


def checked_options(method: Method, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the method's options, checked, with the given ones in place of its defaults.

    Raises
    ------
    InputError
        An option is not one of the method's, or its value makes no sense.
    """
    if not method.bounded and options.get("max_error") is not None:
        raise InputError(f"method {method.name}: found max_error, but it cannot hold a bound; give passes")
    unknown = sorted(set(options) - set(method.defaults))
    if unknown:
        known = ", ".join(sorted(method.defaults))
        raise InputError(f"method {method.name}: found option {unknown[0]!r}, expected one of: {known}")
    return method.checked({**method.defaults, **options})


def takes_features(method: Method, options: Mapping[str, Any]) -> bool:
    """Tell whether a method makes something of surveyed lines, with these options."""
    return bool(method.features) and (method.features != "points" or options.get("passes") is not None)


def check_features(method: Method, options: Mapping[str, Any]) -> None:
    """Refuse surveyed lines for a method that makes nothing of them, at least not with these options.

    Raises
    ------
    InputError
        It is such a method.
    """
    if not method.features:
        raise InputError(f"features: found method {method.name}, which makes nothing of lines; leave them out")
    if not takes_features(method, options):
        raise InputError(f"features: found method {method.name} with bounds, expected passes: no bound holds at points")
