"""`vpfx vpf`: what it prints, and what it refuses."""

from __future__ import annotations

import csv
import io
import json

import pytest
from conftest import shared_vpf
from small_vpf import make_database, put

from vpfx.cli import main
from vpfx.vpf import layouts
from vpfx.vpf.header import Column, Layout
from vpfx.vpf.table import write_table

GOOD, USAGE, FAILURE = 0, 2, 3


@pytest.fixture
def run(capsys):
    """Run a command; return its code and what it printed."""

    def call(*arguments):
        with pytest.raises(SystemExit) as exit_:
            main(["vpf", *map(str, arguments)])
        return exit_.value.code, *capsys.readouterr()

    return call


def test_listing(run, tmp_path):
    root = make_database(tmp_path / "base")
    (root / "north" / "road" / "roadl.lft").rename(root / "north" / "road" / "other.lft")
    put(root / "lat", layouts.LAT, [("north", 7, 46, 9, 48), ("south", 7, 44, 9, 46)])
    code, out, err = run("ls", root)
    assert (code, err) == (GOOD, "")
    assert [line.split() for line in out.splitlines()] == [
        ["base", str(root)],
        ["north", "7", "46", "9", "48,", "2", "tiles"],
        ["tileref", "topology", "level", "3", "About", "roads"],
        ["tileref", "A", "tileref.aft", "2", "rows", "fac"],
        ["road", "topology", "level", "3", "About", "roads"],
        ["roadl", "L", "roadl.lft", "missing", "edg", "Roads"],
        ["lakea", "A", "lakea.aft", "missing", "fac", "by", "lakea.ajt", "Lakes"],
        ["south", "missing"],
    ]
    code, out, err = run("ls", root / "north", "--json")
    (library,) = json.loads(out)["libraries"]
    assert (library["extent"], library["tiles"], library["problems"]) == ([7, 46, 9, 48], 2, [])
    assert [found["rows"] for found in library["coverages"][1]["classes"]] == [None, None]


def test_listing_goes_on_behind_what_is_broken(run, tmp_path):
    root = make_database(tmp_path / "base")
    (root / "north" / "road" / "fcs").write_bytes(b"rubbish")
    (root / "north" / "tileref" / "fbr").write_bytes(b"rubbish")
    (root / "north" / "tileref" / "tileref.aft").write_bytes(b"rubbish")
    code, out, err = run("ls", root, "--json")
    assert (code, err) == (GOOD, "")
    (library,) = json.loads(out)["libraries"]
    tileref, road = library["coverages"]
    assert len(library["problems"]) == len(tileref["problems"]) == len(road["problems"]) == 1
    assert "tileref.aft" in library["problems"][0]
    assert tileref["classes"][0]["rows"] is None
    assert road["classes"] == []


def test_dump_of_every_type(run, tmp_path):
    kinds = [Column(f"c_{kind}", kind) for kind in "TLFRSICBZYDKX"]
    several = [Column("c_line", "Z", -1), Column("c_text", "T", -1), Column("c_two", "C", 2)]
    columns = {"id": [1, 2]}
    values = [
        "a",
        "ß",
        0.1,
        0.1,
        7,
        8,
        (0.1, 2),
        (0.1, 2),
        (1, 2, float("nan")),
        (1, 2, 3),
        "20010203040506.00000",
        (5, 12, 7),
        None,
    ]
    columns |= {column.name: [value, None] for column, value in zip(kinds, values, strict=True)}
    columns |= {
        "c_line": [[(0, 0, 1), (1, 0.5, 2)], None],
        "c_text": ["x\x1b[0m", None],
        "c_two": [[(1, 2), (3, 4)], None],
    }
    path = tmp_path / "all.rat"
    write_table(path, Layout("All", (Column("id", "I", 1, "P"), *kinds, *several)), columns)
    code, out, err = run("dump", path, "--format", "csv")
    assert (code, err) == (GOOD, "")
    first, second = csv.DictReader(io.StringIO(out))
    assert first == {
        "id": "1", "c_T": "a", "c_L": "ß", "c_F": "0.1", "c_R": "0.1", "c_S": "7", "c_I": "8", "c_C": "0.1 2.0",
        "c_B": "0.1 2.0", "c_Z": "1.0 2.0 –", "c_Y": "1.0 2.0 3.0", "c_D": "20010203040506.00000", "c_K": "5 12 7",
        "c_X": "", "c_line": "0.0 0.0 1.0, 1.0 0.5 2.0", "c_text": "x\\x1b[0m", "c_two": "1.0 2.0, 3.0 4.0",
    }  # fmt: skip
    assert second == {name: "2" if name == "id" else "" for name in second}
    path.write_bytes(path.read_bytes().replace(b"c_text", b"c_\x1bext"))
    assert "c_\\x1bext" in run("dump", path)[1]
    path.write_bytes(path.read_bytes().replace(b"c_\x1bext", b"c_text"))
    code, out, err = run("dump", path, "--format", "json", "--rows", "1:1")
    (row,) = json.loads(out)
    assert row["c_line"] == [[0, 0, 1], [1, 0.5, 2]]
    assert (row["c_K"], row["c_Z"], row["c_text"]) == ([5, 12, 7], [1, 2, None], "x\x1b[0m")


@pytest.mark.parametrize(
    ("rows", "ids"),
    [("2:3", [2, 3]), (":2", [1, 2]), ("3:", [3, 4]), (":", [1, 2, 3, 4]), ("4:9", [4]), ("9:", [])],
)
def test_dump_of_some_rows(run, tmp_path, rows, ids):
    put(tmp_path / "rng", layouts.RNG, [(1, 1)] * 4)
    code, out, err = run("dump", tmp_path / "rng", "--rows", rows, "--format", "json")
    assert (code, err) == (GOOD, "")
    assert [row["id"] for row in json.loads(out)] == ids


@pytest.mark.parametrize("rows", ["0:1", "1", "a:b", "-1:2", "1:0", "1:2:3", "5:2"])
def test_rows_that_are_none(run, tmp_path, rows):
    put(tmp_path / "rng", layouts.RNG, [(1, 1)])
    code, out, err = run("dump", tmp_path / "rng", f"--rows={rows}")
    assert (code, out) == (USAGE, "")
    assert "expected first:last" in err


def test_what_is_refused(run, tmp_path):
    (tmp_path / "rng").write_bytes(b"rubbish")
    for arguments, code in (
        (("ls", tmp_path), FAILURE),
        (("ls", tmp_path / "none"), FAILURE),
        (("dump", tmp_path / "rng"), FAILURE),
        (("dump", tmp_path / "none"), FAILURE),
        (("dump", tmp_path / "rng", "--format", "arrow"), USAGE),
    ):
        found, out, err = run(*arguments)
        assert (found, out) == (code, "")
        assert err.startswith("vpfx: ")
        assert err.count("\n") == 1


def test_real_directory(run):
    root = shared_vpf("vm2alv2_texash")
    code, out, _ = run("ls", root)
    assert code == GOOD
    assert ["polbnda", "A", "polbnda.aft", "6", "rows", "fac", "Administrative", "Areas"] in [
        line.split() for line in out.splitlines()
    ]
    code, out, err = run("dump", root / "texash" / "tileref" / "tileref.aft")
    assert [line.split() for line in out.splitlines()] == [["id", "tile_name", "fac_id"], ["1", "F/J/HB/1500", "2"]]
    assert "found 1 bytes behind the last row" in err
