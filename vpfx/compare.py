"""The paper's table 1, measured: every method side by side on the same posts (specs/methods.md M-660)."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from vpfx.errors import InputError
from vpfx.measures import LevelMeasures, measure_hierarchy
from vpfx.methods import METHODS, Method, takes_features
from vpfx.model import Grid, Hierarchy
from vpfx.pipeline import build_hierarchy
from vpfx.registry import pick
from vpfx.report import MEASURES, SIZES, Table, plain

__all__ = ["Comparison", "choose_methods", "compare", "table_1", "to_dict"]

PAPER: Mapping[str, tuple[str, ...]] = {
    "ternary": ("low (1 SP)", "none", "yes", "high", "yes", "high"),
    "quaternary": ("very low (3 IP)", "high", "no", "no", "yes", "no"),
    "delaunay_pyramid": ("low (≤ 1 SP)", "none", "yes", "no", "no", "possible"),
    "constrained_delaunay_pyramid": ("low (≤ 1 SP)", "none", "yes", "no", "no", "possible"),
    "quadtree": ("variable", "high", "yes", "no", "yes", "no"),
    "restricted_quadtree": ("variable", "high", "yes", "no", "yes", "no"),
    "scarlatos": ("medium (1–3 SP)", "none", "yes", "medium", "yes", "medium"),
    "wynne": ("medium (1–3 SP)", "none", "yes", "low", "yes", "low"),
}
"""Words of table 1: accuracy, unnecessary triangulations, adjacency, sliveriness, nested, streaks. Source: paper-facts §3."""


class Comparison(NamedTuple):
    """One method, built and measured.

    Attributes
    ----------
    method, variant : str
        The variant is empty for a method that has one form only.
    seconds : float
        Wall-clock time of the build.
    levels : list of LevelMeasures
    hierarchy : Hierarchy
    """

    method: str
    variant: str
    seconds: float
    levels: list[LevelMeasures]
    hierarchy: Hierarchy

    @property
    def title(self) -> str:
        """Method and variant."""
        return f"{self.method} {self.variant}".strip()


def choose_methods(grid: Grid, methods: Sequence[str], options: Mapping[str, Any]) -> tuple[list[Method], list[Method]]:
    """Return the methods to compare, and those left out: they hold no bound, or follow no voids, where there are such.

    Raises
    ------
    InputError, UnknownNameError
        An option is none of any method, or no method is left.
    """
    parts = [pick(METHODS, name, "method") for name in methods] or list(METHODS.values())
    unknown = sorted(set(options) - {name for part in parts for name in (*part.defaults, "max_error")})
    if unknown:
        raise InputError(f"compare: found option {unknown[0]!r}, expected one of a method")
    is_bounded, has_voids = options.get("max_error") is not None, bool(np.isnan(grid.heights).any())
    chosen = [part for part in parts if (part.bounded or not is_bounded) and (part.voids or not has_voids)]
    if not chosen:
        lack = "hold a bound; give passes" if is_bounded and not any(part.bounded for part in parts) else "follow voids"
        raise InputError(f"compare: found no method that can {lack}")
    return chosen, [part for part in parts if part not in chosen]


def compare(grid: Grid, methods: Sequence[str] = (), /, lines: Sequence[Any] = (), **options: Any) -> list[Comparison]:
    """Build every variant of some methods over the same posts and measure every level.

    Parameters
    ----------
    grid : Grid
    methods : sequence of str
        Names in `vpfx.methods.METHODS`; all if empty, without those that `choose_methods` leaves out.
    lines : sequence of float64 (n, 2 or 3)
        Surveyed lines, as for `vpfx.pipeline.build_hierarchy`, for the methods that make something of them.
    **options
        Of the methods, such as ``passes=3`` or ``max_error=(40, 20)``; each method takes those it has.

    Raises
    ------
    InputError, UnknownNameError
        An option is none of any method, or no method is left.

    Examples
    --------
    >>> grid = Grid(np.add.outer(np.zeros(9), np.abs(np.arange(9.0) - 4)))
    >>> [found.title for found in compare(grid, ["ternary", "quaternary"], passes=1)]
    ['ternary', 'quaternary selective', 'quaternary total']
    """
    found = []
    chosen = choose_methods(grid, methods, options)[0]
    if len(lines) and not any(takes_features(part, options) for part in chosen):
        raise InputError("compare: found lines, but no method that makes something of them; leave them out")
    for part in chosen:
        own = {name: value for name, value in options.items() if name in part.defaults}
        own_lines = lines if takes_features(part, own) else ()
        for variant, of_variant in part.variants.items():
            start = time.perf_counter()
            hierarchy = build_hierarchy(grid, method=part.name, lines=own_lines, **own, **of_variant)
            seconds = time.perf_counter() - start
            levels = measure_hierarchy(hierarchy, grid, options.get("tolerance", 0.0))
            found.append(Comparison(part.name, variant, seconds, levels, hierarchy))
    return found


def table_1(comparisons: Sequence[Comparison], level: int = -1) -> Table:
    """Rows of texts, the first the heading: measures of one level, a column each method, the paper's words below each group."""
    rows = [["", "", *(one.title for one in comparisons)]]
    chosen = [one.levels[level] for one in comparisons]
    for i, (group, lines) in enumerate((("size", SIZES), *MEASURES)):
        rows += [[group if j == 0 else "", title, *map(text, chosen)] for j, (title, text) in enumerate(lines)]
        if i:
            words = [PAPER[one.method][i - 1] if one.method in PAPER else "–" for one in comparisons]
            rows.append(["", "the paper says", *words])
    return rows


def to_dict(comparison: Comparison) -> dict[str, Any]:
    """Return a comparison as plain dictionaries, for JSON; what is not a number is None."""
    facts = {"method": comparison.method, "variant": comparison.variant, "seconds": round(comparison.seconds, 3)}
    return {**facts, "paper": PAPER.get(comparison.method), "levels": plain(comparison.levels)}
