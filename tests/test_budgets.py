"""Budgets of faces: the smallest bounds that fit, and what does not make sense."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from invariants import judge_store
from surfaces import hills, query, write_dem

from vpfx.dem import read_grid
from vpfx.errors import InputError
from vpfx.pipeline import build

CELL = Path(__file__).resolve().parents[1] / "fixtures" / "dem" / "new_mexico_cell_5min_1arcsec.tif"


def level_rows(path):
    return query(path, "SELECT * FROM level ORDER BY level")


@pytest.mark.parametrize(("tile_size", "fit"), [(100, None), (20, None), (100, "max-error")])
def test_budgets_of_faces(tile_size, fit, tmp_path):
    grid = read_grid(CELL)
    dem = write_dem(tmp_path / "nm.tif", grid.heights[:41, :51])
    budgets = (100, 400)
    report = build(dem, tmp_path / "a.gpkg", max_faces=budgets, tile_size=tile_size, fit=fit)
    judge_store(tmp_path / "a.gpkg", dem)
    bounds = [line.max_error_bound for line in report.levels]
    assert [row[1] for row in level_rows(tmp_path / "a.gpkg")] == bounds
    assert all(line.faces <= budget for line, budget in zip(report.levels, budgets, strict=True))
    build(dem, tmp_path / "b.gpkg", max_error=bounds, tile_size=tile_size, fit=fit)
    assert level_rows(tmp_path / "a.gpkg") == level_rows(tmp_path / "b.gpkg")
    for level, budget in enumerate(budgets):
        tighter = [*bounds[:level], 0.98 * bounds[level], *bounds[level + 1 :]]
        report = build(dem, tmp_path / f"{level}.gpkg", max_error=tighter, tile_size=tile_size, fit=fit)
        faces = report.levels[level].faces
        assert faces > budget, f"level {level}: {faces} faces hold {tighter[level]} m, found {bounds[level]} m"


REFUSED = [
    *((budgets, "rising") for budgets in ((), (1,), (200, 100), (100, 100))),
    *((budgets, "whole number") for budgets in (100, (100.0,), (True, 100), "100")),
    ((3,), "start grid"),
]


@pytest.mark.parametrize(("budgets", "message"), REFUSED)
def test_senseless_budgets_are_refused(budgets, message, tmp_path):
    dem = write_dem(tmp_path / "a.tif", hills(20, 20))
    with pytest.raises(InputError, match=message):
        build(dem, tmp_path / "a.gpkg", max_faces=budgets, tile_size=10)
    with pytest.raises(InputError, match="only one"):
        build(dem, tmp_path / "a.gpkg", max_faces=(100,), passes=1)
    assert [path.name for path in tmp_path.iterdir()] == ["a.tif"]


def test_budget_that_no_smaller_bound_fits_is_refused(tmp_path):
    dem = write_dem(tmp_path / "a.tif", np.zeros((20, 20)))
    with pytest.raises(InputError, match=r"a budget of 200, which no bound below 0\.001\d* m fits; leave it out"):
        build(dem, tmp_path / "a.gpkg", max_faces=(100, 200))
