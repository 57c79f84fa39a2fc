"""What README.md prints is what the commands print; its Python is run as a doctest beside."""

from __future__ import annotations

import re
import shlex
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from conftest import slow_apart

from vpfx.pipeline import build
from vpfx.store.tiles import Tiling

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
CELL = "fixtures/dem/new_mexico_cell_5min_1arcsec.tif"
MODES = {
    "--max-error 40,20,10,5": {"max_error": (40, 20, 10, 5)},
    "--max-faces 1000,4000": {"max_faces": (1000, 4000)},
    "--max-error 5 --fit": {"max_error": (5,), "fit": "max-error"},
    "--max-error 5 --fit rmse": {"max_error": (5,), "fit": "rmse"},
    "--passes 3 --grid 9x9 --tolerance 5": {"passes": 3, "grid": (9, 9), "tolerance": 5},
}


def session(program):
    """Return the arguments of the command of a program that the page shows, and the lines it is said to print."""
    block = re.search(rf"^```\n\$ ({program} .*?)^```$", README, re.MULTILINE | re.DOTALL)[1]
    command = re.match(r'(?:[^"\n]|"[^"]*")*', block)[0]
    return shlex.split(command)[1:], block[len(command) :].strip().splitlines()


@pytest.fixture(scope="module")
def printed(tmp_path_factory):
    """Run the build that the page shows; return its store, what it printed, and what the page says."""
    arguments, expected = session("vpfx build")
    folder = tmp_path_factory.mktemp("readme")
    arguments = [str(ROOT / CELL) if text == CELL else text for text in arguments]
    command = [sys.executable, "-m", "vpfx", *arguments]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    return folder / "new_mexico.gpkg", done.stdout.splitlines(), expected


def test_build_prints_what_the_page_shows(printed):
    _, found, expected = printed
    assert [re.sub(r", [\d.]+ s$", "", line) for line in found] == [
        re.sub(r", [\d.]+ s$", "", line) for line in expected
    ]


def test_sqlite3_prints_what_the_page_shows(printed):
    arguments, (_, _, *expected) = session("sqlite3")
    with closing(sqlite3.connect(printed[0])) as store:
        rows = store.execute(arguments[-1]).fetchall()
    assert [[str(value) for value in row] for row in rows] == [line.split() for line in expected]


@pytest.mark.parametrize("options", slow_apart(MODES, ["--max-faces 1000,4000"]))
def test_worked_numbers_of_the_options(options, tmp_path):
    numbers = re.search(rf"^\| `{options}` \|.*\| (.*?) \|$", README, re.MULTILINE)[1].replace(",", "")
    report = build(ROOT / CELL, tmp_path / "a.gpkg", **MODES[options])
    faces = [line.faces for line in report.levels]
    faces = [faces[0], faces[-1]] if " to " in numbers else faces
    bounds = [f"{line.max_error_bound:.1f}" for line in report.levels] if " m" in numbers else []
    assert re.findall(r"[\d.]+", numbers) == [*map(str, faces), *bounds]


def test_worked_number_of_tiles():
    rows, cols, *tiles = re.findall(
        r"\d+", re.search(r"^\| `--tile-size 512` \|.*\| (.*?) \|$", README, re.MULTILINE)[1]
    )
    tiling = Tiling(int(rows), int(cols), 512, n_level=1)
    assert [tiling.n_tile_row, tiling.n_tile_col] == [int(number) for number in tiles]
