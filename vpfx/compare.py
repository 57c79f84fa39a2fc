"""The paper's table 1, measured: every method side by side on the same posts (specs/methods.md M-660)."""

from __future__ import annotations

import csv
import io
import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from vpfx.errors import InputError
from vpfx.measures import LevelMeasures, measure_hierarchy
from vpfx.methods import METHODS
from vpfx.model import Grid
from vpfx.pipeline import build_hierarchy
from vpfx.registry import pick

__all__ = ["FORMATS", "Comparison", "Table", "compare", "table_1", "to_csv", "to_dict", "to_markdown", "to_text"]

Table = list[list[str]]

PAPER: Mapping[str, tuple[str, ...]] = {
    "ternary": ("low (1 SP)", "none", "yes", "high", "yes", "high"),
    "quaternary": ("very low (3 IP)", "high", "no", "no", "yes", "no"),
    "delaunay_pyramid": ("low (≤ 1 SP)", "none", "yes", "no", "no", "possible"),
    "quadtree": ("variable", "high", "yes", "no", "yes", "no"),
    "restricted_quadtree": ("variable", "high", "yes", "no", "yes", "no"),
    "scarlatos": ("medium (1–3 SP)", "none", "yes", "medium", "yes", "medium"),
    "wynne": ("medium (1–3 SP)", "none", "yes", "low", "yes", "low"),
}
"""Words of table 1: accuracy, unnecessary triangulations, adjacency, sliveriness, nested, streaks. Source: paper-facts §3."""


def _text(value: float | None, form: str) -> str:
    """A figure as text; a dash where there is none."""
    return "–" if value is None or math.isnan(value) else f"{value:{form}}"


MEASURES: tuple[tuple[str, tuple[tuple[str, Callable[[LevelMeasures], str]], ...]], ...] = (
    ("accuracy", (
        ("max error m", lambda m: f"{m.accuracy.max_error:.3f}"),
        ("rmse m", lambda m: f"{m.accuracy.rmse:.3f}"),
        ("99th percentile m", lambda m: f"{m.accuracy.percentile_99:.3f}"),
        ("bias m", lambda m: f"{m.accuracy.bias:.3f}"),
        ("points per cut", lambda m: _text(m.step and m.step.points_per_cut, ".2f")),
    )),
    ("needless cuts", (("of all %", lambda m: _text(m.step and 100 * m.step.needless, ".1f")),)),
    ("adjacency", (
        ("T-junctions", lambda m: f"{m.shape.t_junctions}"),
        ("greatest gap m", lambda m: f"{m.shape.max_gap:.2f}"),
    )),
    ("sliveriness", (
        ("mean p²/area", lambda m: f"{m.shape.mean_sliveriness:.1f}"),
        ("mean − 19.78", lambda m: f"{m.shape.normal_sliveriness:.1f}"),
        ("greatest", lambda m: f"{m.shape.max_sliveriness:.0f}"),
        ("5 % angle °", lambda m: f"{m.shape.angle_5:.1f}"),
    )),
    ("nested", (
        ("one parent %", lambda m: _text(m.step and 100 * m.step.one_parent, ".1f")),
        ("area error", lambda m: _text(m.step and m.step.area_error, ".0e")),
    )),
    ("streaks", (
        ("streakiness", lambda m: _text(m.streakiness, ".2f")),
        ("greatest degree", lambda m: f"{m.shape.max_degree}"),
    )),
)  # fmt: skip
"""Rows of the table, grouped by the columns of the paper's."""


class Comparison(NamedTuple):
    """One method, built and measured.

    Attributes
    ----------
    method, variant : str
        The variant is empty for a method that has one form only.
    seconds : float
        Wall-clock time of the build.
    levels : list of LevelMeasures
    """

    method: str
    variant: str
    seconds: float
    levels: list[LevelMeasures]

    @property
    def title(self) -> str:
        """Method and variant."""
        return f"{self.method} {self.variant}".strip()


def compare(grid: Grid, methods: Sequence[str] = (), /, **options: Any) -> list[Comparison]:
    """Build every variant of some methods over the same posts and measure every level.

    Parameters
    ----------
    grid : Grid
    methods : sequence of str
        Names in `vpfx.methods.METHODS`; all if empty. Those are left out that cannot hold a bound, or follow voids, where
        there are such.
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
    parts = [pick(METHODS, name, "method") for name in methods] or list(METHODS.values())
    unknown = sorted(set(options) - {name for part in parts for name in (*part.defaults, "max_error")})
    if unknown:
        raise InputError(f"compare: found option {unknown[0]!r}, expected one of a method")
    if options.get("max_error") is not None:
        parts = [part for part in parts if part.bounded]
        if not parts:
            raise InputError("compare: found no method that can hold a bound; give passes")
    if np.isnan(grid.heights).any():
        parts = [part for part in parts if part.voids]
        if not parts:
            raise InputError("compare: found voids in the DEM, which none of the methods can follow")
    found = []
    for part in parts:
        own = {name: value for name, value in options.items() if name in part.defaults}
        for variant, of_variant in part.variants.items():
            start = time.perf_counter()
            hierarchy = build_hierarchy(grid, method=part.name, **own, **of_variant)
            seconds = time.perf_counter() - start
            levels = measure_hierarchy(hierarchy, grid, options.get("tolerance", 0.0))
            found.append(Comparison(part.name, variant, seconds, levels))
    return found


def table_1(comparisons: Sequence[Comparison], level: int = -1) -> Table:
    """Rows of texts, the first the heading: measures of one level, a column each method, the paper's words below each group."""
    rows = [["", "", *(one.title for one in comparisons)]]
    chosen = [one.levels[level] for one in comparisons]
    rows.append(["size", "nodes", *(f"{m.nodes}" for m in chosen)])
    rows.append(["", "faces", *(f"{m.faces}" for m in chosen)])
    for i, (group, lines) in enumerate(MEASURES):
        for j, (title, text) in enumerate(lines):
            rows.append([group if j == 0 else "", title, *(text(m) for m in chosen)])
        rows.append(
            ["", "the paper says", *(PAPER[one.method][i] if one.method in PAPER else "–" for one in comparisons)]
        )
    return rows


def to_dict(comparison: Comparison) -> dict[str, Any]:
    """Return a comparison as plain dictionaries, for JSON; what is not a number is None."""

    def plain(value: Any) -> Any:
        if hasattr(value, "_asdict"):
            return {name: plain(part) for name, part in value._asdict().items()}
        return None if isinstance(value, float) and not math.isfinite(value) else value

    facts = {"method": comparison.method, "variant": comparison.variant, "seconds": round(comparison.seconds, 3)}
    return {**facts, "paper": PAPER.get(comparison.method), "levels": [plain(level) for level in comparison.levels]}


def to_text(table: Table) -> str:
    """Return a table as aligned columns, the first two to the left.

    Examples
    --------
    >>> print(to_text([["", "", "ternary"], ["size", "nodes", "12"]]))
                 ternary
    size  nodes       12
    """
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    pads = [str.ljust, str.ljust, *[str.rjust] * (len(widths) - 2)]
    lines = ["  ".join(pad(text, w) for pad, text, w in zip(pads, row, widths, strict=True)) for row in table]
    return "\n".join(line.rstrip() for line in lines)


def to_markdown(table: Table) -> str:
    """Return a table as Markdown.

    Examples
    --------
    >>> print(to_markdown([["a", "b"], ["1", "2"]]))
    | a | b |
    |---|---|
    | 1 | 2 |
    """
    lines = [f"| {' | '.join(row)} |" for row in table]
    return "\n".join([lines[0], "|" + "---|" * len(table[0]), *lines[1:]])


def to_csv(table: Table) -> str:
    """Return a table as comma-separated values (RFC 4180), every row with its group."""
    text, group = io.StringIO(), ""
    writer = csv.writer(text)
    for i, row in enumerate(table):
        group = row[0] or group
        writer.writerow(["group", "measure", *row[2:]] if i == 0 else [group, *row[1:]])
    return text.getvalue()


FORMATS: Mapping[str, Callable[[Table], str]] = {"text": to_text, "markdown": to_markdown, "csv": to_csv}
"""Ways to write a table."""
