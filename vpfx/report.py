"""Measures as tables of texts, and ways to write a table."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from vpfx.measures import LevelMeasures

__all__ = ["FORMATS", "MEASURES", "SIZES", "Table", "level_table", "plain", "to_csv", "to_markdown", "to_text"]

Table = list[list[str]]


def _text(value: float | None, form: str) -> str:
    """A figure as text; a dash where there is none."""
    return "–" if value is None or math.isnan(value) else f"{value:{form}}"


SIZES: tuple[tuple[str, Callable[[LevelMeasures], str]], ...] = (
    ("nodes", lambda m: f"{m.nodes}"),
    ("faces", lambda m: f"{m.faces}"),
)
"""Rows of how large a level is."""

MEASURES: tuple[tuple[str, tuple[tuple[str, Callable[[LevelMeasures], str]], ...]], ...] = (
    ("accuracy", (
        ("max error m", lambda m: _text(m.accuracy and m.accuracy.max_error, ".3f")),
        ("rmse m", lambda m: _text(m.accuracy and m.accuracy.rmse, ".3f")),
        ("99th percentile m", lambda m: _text(m.accuracy and m.accuracy.percentile_99, ".3f")),
        ("bias m", lambda m: _text(m.accuracy and m.accuracy.bias, ".3f")),
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
"""Rows of measures, grouped by the columns of the paper's table 1."""


def level_table(levels: Sequence[LevelMeasures]) -> Table:
    """Rows of texts, the first the heading: all measures, a column each level."""
    rows = [["", "", *(f"level {m.level}" for m in levels)]]
    for group, lines in (("size", SIZES), *MEASURES):
        rows += [[group if j == 0 else "", title, *map(text, levels)] for j, (title, text) in enumerate(lines)]
    return rows


def plain(value: Any) -> Any:
    """Return measures as plain dictionaries, for JSON; what is not a number is None.

    Examples
    --------
    >>> plain({"rmse": float("nan"), "posts": 3})
    {'rmse': None, 'posts': 3}
    """
    if hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, dict):
        return {name: plain(part) for name, part in value.items()}
    if isinstance(value, list):
        return [plain(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


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
