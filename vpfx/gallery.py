"""Pictures of a comparison: levels of all methods side by side, and error against faces."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from vpfx.compare import Comparison
from vpfx.measures import measure_accuracy
from vpfx.model import Grid
from vpfx.pipeline import build_hierarchy
from vpfx.plot import draw_tin, picture

__all__ = ["STYLES", "Curve", "draw_curves", "draw_methods", "greedy_curve"]

Curve = Sequence[tuple[int, float, float]]
"""Faces, greatest error and RMSE, metres, of some levels."""

STYLES = ("plan", "wireframe", "shaded", "relief", "slope", "level")
"""Of `vpfx.plot`, those that need nothing but the level."""

N_COLUMN = 4
SIZE = 3.6, 3.4  # of one drawing, inches
CURVE_SIZE = 6.0, 5.0
N_BOUND = 8  # of the curve for reference
BOUND_BY_RMSE = 3.0  # a greedy mesh is off by about three times its RMSE at most
LEAST_BOUND = 1e-3  # metres
MARKERS = "osv^D<>pP*Xhd"
ERRORS = ("greatest error, m", "RMSE, m")


def draw_methods(
    comparisons: Sequence[Comparison], path: str | Path, *, level: int = -1, style: str = "plan",
    metres: tuple[float, float] = (1.0, 1.0), overwrite: bool = False,
) -> None:  # fmt: skip
    """Draw one level of every method into one picture.

    Parameters
    ----------
    comparisons : sequence of Comparison
    path : path
        As for `vpfx.plot.picture`.
    level : int
    style, metres
        As for `vpfx.plot.draw_tin`; the styles error and attribute need more than there is.
    """
    columns = min(N_COLUMN, len(comparisons))
    rows = -(-len(comparisons) // columns)
    with picture(path, rows, columns, size=SIZE, overwrite=overwrite) as (_, axes):
        for axis in axes.flat[len(comparisons) :]:
            axis.set_axis_off()
        for axis, one in zip(axes.flat, comparisons, strict=False):
            tin = one.hierarchy.tin(level % one.hierarchy.n_level)
            draw_tin(axis, tin, style, metres=metres, title=f"{one.title}\n{tin.n_face:,} faces")


def greedy_curve(grid: Grid, comparisons: Sequence[Comparison]) -> Curve:
    """Measure greedy Delaunay insertion at bounds that span most errors of some methods, for reference.

    It is the Delaunay pyramid, which needs about as many faces as adding one post at a time (specs/methods.md M-540).
    """
    levels = [[level.accuracy for level in one.levels if level.accuracy] for one in comparisons]
    coarse = max(accuracy.max_error for of_one in levels for accuracy in of_one)
    error, rmse = (np.median([getattr(of_one[-1], name) for of_one in levels]) for name in ("max_error", "rmse"))
    fine = max(min(error, BOUND_BY_RMSE * rmse), LEAST_BOUND)
    bounds = np.geomspace(max(coarse, 2.0 * fine), fine, N_BOUND)
    hierarchy = build_hierarchy(grid, method="delaunay_pyramid", max_error=bounds)
    found = []
    for level in range(hierarchy.n_level):
        tin = hierarchy.tin(level)
        accuracy = measure_accuracy(tin, grid)
        found.append((tin.n_face, accuracy.max_error, accuracy.rmse))
    return found


def draw_curves(
    comparisons: Sequence[Comparison], reference: Curve, path: str | Path, *, overwrite: bool = False
) -> None:
    """Draw greatest error and RMSE of every method's levels against their faces, and a curve for reference.

    Parameters
    ----------
    comparisons : sequence of Comparison
    reference : Curve
        Such as that of `greedy_curve`.
    path : path
        As for `vpfx.plot.picture`.
    """
    curves = {
        one.title: [
            (level.faces, level.accuracy.max_error, level.accuracy.rmse) for level in one.levels if level.accuracy
        ]
        for one in comparisons
    }
    with picture(path, 1, 2, size=CURVE_SIZE, overwrite=overwrite) as (figure, axes):
        from matplotlib.ticker import LogLocator, NullFormatter  # picture tells if there is none

        for i, axis in enumerate(axes[0], start=1):
            faces, *errors = zip(*reference, strict=True)
            axis.plot(faces, errors[i - 1], color="black", linestyle="--", linewidth=2, label="greedy Delaunay")
            for n, (title, curve) in enumerate(curves.items()):
                faces, *errors = zip(*curve, strict=True)
                axis.plot(
                    faces,
                    errors[i - 1],
                    marker=MARKERS[n % len(MARKERS)],
                    markersize=4,
                    color=f"C{n % 10}",
                    label=title,
                )
            has_errors = any(max(line.get_ydata()) > 0.0 for line in axis.get_lines())
            axis.set(xscale="log", yscale="log" if has_errors else "linear", xlabel="faces", ylabel=ERRORS[i - 1])
            if has_errors:
                axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
                axis.yaxis.set_major_formatter("{x:g}")
                axis.yaxis.set_minor_formatter(NullFormatter())
            axis.grid(visible=True, which="both", alpha=0.3)
        handles, labels = axes[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8)
