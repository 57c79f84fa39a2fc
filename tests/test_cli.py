"""The command line from outside: exit codes, what stands on stdout and stderr, and what is left on the disk."""

from __future__ import annotations

import csv
import json
import os
import re
import shlex
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

import click
import pytest
from pyproj import CRS
from small_vpf import make_database

from vpfx import __version__
from vpfx.cli import app, main
from vpfx.methods import METHODS

FIXTURES = Path(__file__).resolve().parents[1] / "fixtures" / "dem"
DEM = str(FIXTURES / "new_mexico_utm13_30m.tif")
DTED = FIXTURES / "new_mexico_n36_w108.dt2"
GOOD, USAGE, FAILURE, INTERRUPTED = 0, 2, 3, 130
VPFX = (sys.executable, "-m", "vpfx")
SMALL = ("--max-error", "40,20", "--tile-size", "60")
LEVEL_KEYS = {"level", "faces", "nodes", "edges", "max_error_bound", "max_error", "rmse"}
COMPILING = "vpfx: compiling kernels, once; later runs start at once\n"  # may come first, in a fresh checkout


class Outcome(NamedTuple):
    """What a command did."""

    code: int
    out: str
    err: str


@pytest.fixture
def run(capsys, monkeypatch, tmp_path):
    """Run a command in an empty folder, inside this process."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        with pytest.raises(SystemExit) as exit_:
            main([str(argument) for argument in arguments])
        return Outcome(exit_.value.code, *capsys.readouterr())

    return call


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    """A small store of two levels and four tiles."""
    path = tmp_path_factory.mktemp("store") / "small.gpkg"
    with pytest.raises(SystemExit) as exit_:
        main(["build", DEM, "-o", str(path), "--quiet", *SMALL])
    assert exit_.value.code == GOOD
    return path


def one_json(text):
    """Decode a text that is just one JSON document, by the letter of the standard: no NaN."""
    return json.loads(text, parse_constant=lambda name: pytest.fail(f"found {name}, expected JSON"))


def assert_refused(outcome, code, message):
    """Hold that a command ended with a code and one line that says why."""
    assert outcome.code == code, outcome
    assert outcome.out == ""
    err = outcome.err.removeprefix(COMPILING)
    assert re.fullmatch(r"vpfx[^\n]*\n", err), err
    assert re.search(message, err), err
    assert "Traceback" not in err


def change(path, sql):
    """Run SQL on a file."""
    connection = sqlite3.connect(path)
    connection.executescript(sql)
    connection.close()


BAD_BUILDS = {
    "no such file": (["no.tif"], FAILURE, r"no\.tif: .*no such file"),
    "folder as DEM": (["folder"], FAILURE, r"folder: found a directory"),
    "text as DEM": (["text.txt"], FAILURE, r"text\.txt: cannot be opened: .*expected a raster"),
    "empty file as DEM": (["empty.tif"], FAILURE, r"empty\.tif: cannot be opened"),
    "remote DEM": (["https://example.org/n36.dt2"], USAGE, r"expected a local file"),
    "no DEM": ([], USAGE, r"build: Missing argument 'DEM\.\.\.'"),
    "text as number": ([DEM, "--max-error", "ten"], USAGE, r"--max-error: found 'ten', expected numbers"),
    "no number": ([DEM, "--max-error", ""], USAGE, r"--max-error: found ''"),
    "rising bounds": ([DEM, "--max-error", "10,20"], USAGE, r"expected each smaller than the one before"),
    "negative bound": ([DEM, "--max-error", "-1"], USAGE, r"positive numbers of metres"),
    "zero bound": ([DEM, "--max-error", "0"], USAGE, r"positive numbers of metres"),
    "bound not a number": ([DEM, "--max-error", "nan"], USAGE, r"positive numbers of metres"),
    "bounds and passes": ([DEM, "--max-error", "9", "--passes", "1"], USAGE, r"max_error and passes"),
    "bounds and budgets": ([DEM, "--max-error", "9", "--max-faces", "9"], USAGE, r"only one of the three"),
    "falling budgets": ([DEM, "--max-faces", "200,100"], USAGE, r"expected rising numbers"),
    "tiny budget": ([DEM, "--max-faces", "2"], USAGE, r"found a budget of 2, expected at least \d+"),
    "negative passes": ([DEM, "--passes", "-1"], USAGE, r"passes: found -1, expected 0 … 31"),
    "tolerance not a number": ([DEM, "--passes", "1", "--tolerance", "nan"], USAGE, r"tolerance"),
    "share of half": ([DEM, "--passes", "1", "--xy-ratio", "0.5"], USAGE, r"xy_ratio: .* below 0\.5"),
    "grid of one number": ([DEM, "--grid", "9"], USAGE, r"--grid: found '9', expected columns x rows"),
    "grid of none": ([DEM, "--grid", "0x3"], USAGE, r"--grid: found '0x3'"),
    "grid of odd digits": ([DEM, "--grid", "²x3"], USAGE, r"--grid: found '²x3'"),
    "unknown method": ([DEM, "--method", "quadric"], USAGE, r"unknown method 'quadric'; known: .*wynne"),
    "unknown option": ([DEM, "--sharp"], USAGE, r"build: No such option '--sharp'"),
    "unknown diagonal": ([DEM, "--diagonal", "longer"], USAGE, r"found diagonal 'longer', expected one of"),
    "unknown fit": ([DEM, "--fit", "median"], USAGE, r"found fit 'median', expected one of: max-error, rmse"),
    "fit without a bound": ([DEM, "--passes", "1", "--fit"], USAGE, r"found fit without max_error"),
    "unknown start": ([DEM, "--start", "hexagon"], USAGE, r"found start 'hexagon', expected one of: grid, delaunay"),
    "negative start posts": ([DEM, "--start", "delaunay", "--start-posts", "-5"], USAGE, r"start.posts"),
    "huge seed": ([DEM, "--seed", "9" * 30], USAGE, r"seed"),
    "bbox outside": ([DEM, "--bbox", "0,0,1,1"], USAGE, r"found 0 × 0 posts inside .*expected at least 2 × 2"),
    "bbox turned round": ([DEM, "--bbox", "9,9,1,1"], USAGE, r"bbox: .*expected min_x, min_y, max_x, max_y"),
    "negative workers": ([DEM, "--workers", "-1"], USAGE, r"workers: found -1, expected at least 1"),
    "no workers": ([DEM, "--workers", "0"], USAGE, r"workers: found 0, expected at least 1"),
    "negative tile": ([DEM, "--tile-size", "-1"], USAGE, r"tile size: found -1"),
    "unknown CRS": ([DEM, "--crs", "EPSG:0"], USAGE, r"crs: found 'EPSG:0', expected a CRS"),
    "other CRS": ([DEM, "--crs", "EPSG:4326"], USAGE, r"found CRS NAD83 / UTM zone 13N, but crs says WGS 84"),
    "no such band": ([DEM, "--band", "7"], USAGE, r"found no band 7"),
    "unknown unit": ([DEM, "--vertical-unit", "fathom"], USAGE, r"vertical_unit: found 'fathom'"),
}


@pytest.mark.parametrize("case", BAD_BUILDS)
def test_bad_build_is_refused(case, run, tmp_path):
    """One line says why, and no file is left, hidden ones included."""
    arguments, code, message = BAD_BUILDS[case]
    (tmp_path / "folder").mkdir()
    (tmp_path / "text.txt").write_text("no heights\n")
    (tmp_path / "empty.tif").write_bytes(b"")
    assert_refused(run("build", *arguments, "-o", "new.gpkg"), code, message)
    assert sorted(os.listdir()) == ["empty.tif", "folder", "text.txt"]


BAD_OUTPUTS = {
    "no output": ([], USAGE, r"build: Missing option '-o'"),
    "existing file": (["-o", "there.gpkg"], FAILURE, r"there\.gpkg: found an existing file; .*--overwrite"),
    "folder": (["-o", "folder"], FAILURE, r"folder: found a folder, expected a file name"),
    "folder, overwritten": (["-o", "folder", "--overwrite"], FAILURE, r"folder: found a folder"),
    "folder missing": (["-o", "missing/new.gpkg"], FAILURE, r"missing/new\.gpkg: found no folder"),
    "file as folder": (["-o", "there.gpkg/new.gpkg"], FAILURE, r"there\.gpkg/new\.gpkg: "),
    "empty name": (["-o", ""], FAILURE, r"expected a file name"),
}


@pytest.mark.parametrize("case", BAD_OUTPUTS)
def test_bad_output_is_refused(case, run, tmp_path):
    arguments, code, message = BAD_OUTPUTS[case]
    (tmp_path / "folder").mkdir()
    (tmp_path / "there.gpkg").write_text("mine")
    assert_refused(run("build", DEM, *arguments, *SMALL), code, message)
    assert sorted(os.listdir()) == ["folder", "there.gpkg"]
    assert (tmp_path / "there.gpkg").read_text() == "mine"


def test_a_failed_overwrite_keeps_the_old_file(run, tmp_path):
    (tmp_path / "there.gpkg").write_text("mine")
    (tmp_path / "cut.dt2").write_bytes(DTED.read_bytes()[:90_000])
    assert_refused(run("build", "cut.dt2", "-o", "there.gpkg", "--overwrite"), FAILURE, r"cut\.dt2: ")
    assert (tmp_path / "there.gpkg").read_text() == "mine"
    assert sorted(os.listdir()) == ["cut.dt2", "there.gpkg"]
    assert run("build", DEM, "-o", "there.gpkg", "--overwrite", "--quiet", *SMALL).code == GOOD
    assert run("info", "there.gpkg").code == GOOD


BAD_ARGUMENTS = {
    "unknown command": (["triangulate"], r"No such command 'triangulate'"),
    "no store": (["info"], r"info: Missing argument 'STORE'"),
    "two stores": (["info", "a.gpkg", "b.gpkg"], r"info: .*unexpected extra argument"),
    "text as whole number": (["build", DEM, "-o", "a.gpkg", "--workers", "two"], r"'two' is not a valid integer"),
}


@pytest.mark.parametrize("case", BAD_ARGUMENTS)
def test_bad_arguments_point_to_the_help(case, run):
    arguments, message = BAD_ARGUMENTS[case]
    outcome = run(*arguments)
    assert_refused(outcome, USAGE, message)
    assert re.search(r" See: vpfx( build| info)? --help\n$", outcome.err)


def test_no_command_shows_the_help(run):
    outcome = run()
    assert (outcome.code, outcome.out) == (USAGE, "")
    assert outcome.err.startswith("Usage: vpfx")


SIZELESS = CRS("EPSG:4326").to_wkt().replace("6378137,298.257223563", "1e-300,0")
VIEW = "PRAGMA legacy_alter_table = ON; ALTER TABLE {0} RENAME TO hidden; CREATE VIEW {0} AS SELECT * FROM hidden"
DAMAGES = {
    "view for table level": VIEW.format("level"),
    "view for table metadata": VIEW.format("metadata"),
    "view for table tile": VIEW.format("tile"),
    "table gone": "DROP TABLE source",
    "column more": "ALTER TABLE level ADD COLUMN resolution",
    "no levels": "DELETE FROM level",
    "no tiles": "DELETE FROM tile",
    "no GeoPackage": "PRAGMA application_id = 1",
    "no metadata": "DELETE FROM metadata",
    "options that are none": "UPDATE metadata SET value = '3' WHERE name = 'options'",
    "CRS that is none": "UPDATE metadata SET value = '5' WHERE name = 'crs_wkt2'",
    "CRS without size": f"UPDATE metadata SET value = '{SIZELESS}' WHERE name = 'crs_wkt2'",
    "bytes as text": "UPDATE metadata SET value = X'FF00' WHERE name = 'method'",
    "bottomless JSON": f"UPDATE metadata SET value = '{'[' * 100_000}' WHERE name = 'options'",
    "text as error": "UPDATE level SET max_error = 'small'",
    "text as bound": "UPDATE level SET max_error_bound = 'small'",
    "text as count": "UPDATE level SET node_count = 'many'",
    "infinite error": "UPDATE level SET rmse = 9e999",
    "level left out": "UPDATE level SET level = 7 WHERE level = 0",
    "text as place": "UPDATE tile SET xmin = 'west'",
    "later format": "UPDATE metadata SET value = '9.9' WHERE name = 'format_version'",
}


@pytest.mark.parametrize("case", DAMAGES)
@pytest.mark.parametrize("form", [[], ["--json"]], ids=["table", "json"])
def test_info_refuses_a_damaged_store(case, form, run, store):
    """What a stranger did to a store ends in one line, whatever it was."""
    shutil.copy(store, "damaged.gpkg")
    change("damaged.gpkg", DAMAGES[case])
    outcome = run("info", "damaged.gpkg", *form)
    assert_refused(outcome, FAILURE, r"damaged\.gpkg: ")


@pytest.mark.parametrize("form", [[], ["--json"]], ids=["table", "json"])
@pytest.mark.parametrize("name", ["levels", "seconds", "store", "sources"])
def test_metadata_of_any_name_hide_nothing(name, form, run, store):
    """More metadata are welcome (R-110); what `info` says of the file itself stays."""
    shutil.copy(store, "more.gpkg")
    change("more.gpkg", f"INSERT INTO metadata VALUES ('{name}', 'surprise')")
    outcome = run("info", "more.gpkg", *form)
    assert (outcome.code, outcome.err) == (GOOD, "")
    if form:
        document = one_json(outcome.out)
        assert document["levels"][0].keys() >= LEVEL_KEYS
        assert document["store"] == "more.gpkg"


@pytest.mark.parametrize("n_byte", [0, 10, 100, 4096, 20_000, -4096, -1])
def test_info_refuses_a_truncated_store(n_byte, run, store):
    Path("cut.gpkg").write_bytes(store.read_bytes()[: n_byte or None if n_byte < 0 else n_byte])
    assert_refused(run("info", "cut.gpkg"), FAILURE, r"cut\.gpkg: found .*, expected")


READING = {
    "export": "export broken.gpkg --to vpf -o broken --overwrite",
    "info": "info broken.gpkg",
    "measure": "measure broken.gpkg",
    "volume": "query volume broken.gpkg --plane 2000",
}


@pytest.mark.parametrize("command", READING)
def test_a_broken_page_is_told_in_one_line(command, run, store):
    """Whatever table it belongs to; commands that do not read it work."""
    connection = sqlite3.connect(store)
    roots = connection.execute("SELECT name, rootpage FROM sqlite_schema WHERE rootpage > 0").fetchall()
    (size,) = connection.execute("PRAGMA page_size").fetchone()
    connection.close()
    refused = set()
    for name, root in roots:
        data = bytearray(store.read_bytes())
        data[(root - 1) * size : root * size] = b"\xff" * size
        Path("broken.gpkg").write_bytes(data)
        outcome = run(*READING[command].split())
        if outcome.code != GOOD:
            assert_refused(outcome, FAILURE, r"broken\.gpkg: ")
            refused.add(name)
    assert refused >= {"metadata", "level"}


def test_info_refuses_what_is_no_store(run, tmp_path):
    fiona = pytest.importorskip("fiona")
    schema = {"geometry": "Point", "properties": {"name": "str"}}
    with fiona.open("foreign.gpkg", "w", driver="GPKG", layer="level", schema=schema, crs="EPSG:4326") as layer:
        layer.write({"geometry": {"type": "Point", "coordinates": (1, 2)}, "properties": {"name": "a"}})
    change("plain.gpkg", "CREATE TABLE level (level)")
    Path("text.gpkg").write_text("no store\n" * 100)
    Path("folder.gpkg").mkdir()
    assert_refused(run("info", "foreign.gpkg"), FAILURE, r"foreign\.gpkg: table \w+: found another definition or none")
    assert_refused(run("info", "plain.gpkg"), FAILURE, r"plain\.gpkg: found no GeoPackage")
    assert_refused(run("info", "text.gpkg"), FAILURE, r"text\.gpkg: found no SQLite database")
    assert_refused(run("info", "folder.gpkg"), FAILURE, r"folder\.gpkg: found ")
    assert_refused(run("info", "missing.gpkg"), FAILURE, r"missing\.gpkg: found no such file")


def test_a_newline_in_a_name_stays_in_one_line(run):
    assert_refused(run("info", "two\nlines.gpkg"), FAILURE, r"two lines\.gpkg: found no such file")


def test_info_changes_nothing(run, store):
    before = store.read_bytes()
    assert run("info", store).code == GOOD
    assert store.read_bytes() == before
    assert os.listdir(store.parent) == [store.name]


def test_build_prints_one_json_document(run):
    outcome = run("build", DEM, "-o", "new.gpkg", "--json", *SMALL)
    assert (outcome.code, outcome.err.removeprefix(COMPILING)) == (GOOD, "")
    assert_document(one_json(outcome.out), "new.gpkg")
    pass_mode = run("build", DEM, "-o", "pass.gpkg", "--json", "--passes", "1")
    assert [level["max_error_bound"] for level in one_json(pass_mode.out)["levels"]] == [None, None]


def test_info_prints_one_json_document(run, store):
    outcome = run("info", store, "--json")
    assert (outcome.code, outcome.err) == (GOOD, "")
    document = one_json(outcome.out)
    assert_document(document, str(store))
    assert document["format_version"] == "0.1", "a version is a text: 0.10 is not 0.1"
    assert document["bytes"] == store.stat().st_size


def assert_document(document, path):
    """Hold what every JSON document says of the small store."""
    assert document["store"] == path
    assert (document["posts"], document["tiles"]) == (12_000, 4)
    assert document["seconds"] >= 0
    assert [level["level"] for level in document["levels"]] == [0, 1]
    for level, bound in zip(document["levels"], (40, 20), strict=True):
        assert level.keys() >= LEVEL_KEYS
        assert level["max_error_bound"] == bound
        assert 0 < level["rmse"] < level["max_error"] <= bound
        assert level["nodes"] - level["edges"] + level["faces"] == 1


def test_tables_say_the_same(run, store):
    built = run("build", DEM, "-o", "new.gpkg", *SMALL)
    told = run("info", "new.gpkg")
    assert (built.code, built.err.removeprefix(COMPILING), told.code, told.err) == (GOOD, "", GOOD, "")
    assert built.out.splitlines()[:3] == told.out.splitlines()[:3]
    assert built.out.startswith("level  bound m  max error m  rmse m")
    assert re.search(r"^new\.gpkg: [\d,]+ bytes, 12,000 posts, 4 tiles, [\d.]+ s$", built.out, re.MULTILINE)
    assert Path("new.gpkg").read_bytes() == store.read_bytes(), "the same input gives the same bytes"


def test_quiet_prints_nothing(run):
    assert run("build", DEM, "-o", "new.gpkg", "--quiet", *SMALL) == (GOOD, "", "")
    assert os.listdir() == ["new.gpkg"]
    assert_refused(run("build", DEM, "-o", "new.gpkg", "-q", *SMALL), FAILURE, r"found an existing file")


def test_version(run):
    assert run("--version") == (GOOD, f"vpfx {__version__}\n", "")


def commands(group=app, prefix=""):
    """Return every command by its name, those of groups by both."""
    found = {}
    for name, command in group.commands.items():
        found |= commands(command, f"{name} ") if isinstance(command, click.Group) else {prefix + name: command}
    return found


@pytest.mark.parametrize("name", [None, *commands()])
def test_help(name, run):
    outcome = run(*(name.split() if name else []), "--help")
    assert (outcome.code, outcome.err) == (GOOD, "")
    assert outcome.out.startswith(f"Usage: vpfx {name or ''}".rstrip())
    if name:
        assert len(examples(name)) == 1
        assert "\n  Example: vpfx " in outcome.out
    else:
        assert all(f"\n  {command} " in outcome.out for command in app.commands)


def examples(name):
    """Return the example lines in the help of a command."""
    return re.findall(r"^\s*Example: (vpfx .*)$", commands()[name].help, re.MULTILINE)


def test_examples_run(run):
    """The examples of all commands, one after the other, with a fixture as the elevation file they name."""
    shutil.copy(DTED, "n36.dt2")
    Path("places.txt").write_text("-107.62 36.37\n")
    ring = [[-108, 36], [-107, 36], [-107, 37], [-108, 36]]
    soil = {"properties": {"kind": "clay", "depth": 1.5}, "geometry": {"type": "Polygon", "coordinates": [ring]}}
    make_database(Path("vmap"))
    Path("soils.geojson").write_text(json.dumps({"type": "Feature", **soil}))
    for name in sorted(commands(), key=lambda name: name != "build"):
        for example in examples(name):
            program, *arguments = shlex.split(example)
            outcome = run(*arguments)
            told = outcome.err.removeprefix(COMPILING).splitlines()
            told = [line for line in told if not line.startswith("vpfx: warning: vmap/")]  # its tables lead to none
            assert (program, outcome.code, told) == ("vpfx", GOOD, [])
            assert outcome.out


def test_the_module_is_the_command(tmp_path, store):
    told, refused = (
        subprocess.run([*VPFX, *arguments], cwd=tmp_path, capture_output=True, text=True, timeout=120)
        for arguments in (("info", str(store), "--json"), ("info", "missing.gpkg"))
    )
    assert (told.returncode, told.stderr) == (GOOD, "")
    assert one_json(told.stdout)["tiles"] == 4
    assert_refused(Outcome(refused.returncode, refused.stdout, refused.stderr), FAILURE, "found no such file")


def test_progress_goes_to_the_terminal_alone(tmp_path):
    """On a terminal a bar shows the tiles done; stdout holds the table and nothing else."""
    pty = pytest.importorskip("pty")
    terminal, its_end = pty.openpty()
    command = [*VPFX, "build", DEM, "-o", "new.gpkg", *SMALL]
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "80"}
    process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=its_end, env=environment)
    os.close(its_end)
    shown = b""
    while True:
        try:
            piece = os.read(terminal, 1 << 16)
        except OSError:  # Linux: the other end is closed
            break
        if not piece:
            break
        shown += piece
    out, _ = process.communicate(timeout=120)
    os.close(terminal)
    assert process.returncode == GOOD
    assert b"4/4" in shown
    lines = out.decode().splitlines()
    assert [line.split()[0] for line in lines] == ["level", "0", "1", "new.gpkg:"]


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT for another process")
@pytest.mark.parametrize("pause", [0.0, 0.7], ids=["at once", "in the middle"])
def test_an_interrupted_build_leaves_nothing(pause, tmp_path):
    command = [*VPFX, "build", str(DTED), "-o", "new.gpkg", "--tile-size", "40"]
    bounds = ["--max-error", "40,20,10,5,2,1,0.5,0.1,0.01"]  # some seconds of work
    process = subprocess.Popen(
        [*command, *bounds], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    while not os.listdir(tmp_path) and process.poll() is None:
        time.sleep(0.005)
    time.sleep(pause)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=120)
    assert (process.returncode, out) == (INTERRUPTED, "")
    assert err.removeprefix(COMPILING).strip() == "vpfx: interrupted; nothing was changed"
    assert os.listdir(tmp_path) == []


# --- compare ----------------------------------------------------------------------------------------------------------------


def test_compare_prints_the_papers_table(run):
    outcome = run("compare", DEM, "--passes", "2", "--bbox", "261000,4024000,263000,4026000", "--grid", "2x2")
    assert outcome.code == GOOD
    heading, *rows = outcome.out.splitlines()
    assert all(re.search(rf"\b{method}\b", heading) for method in METHODS)
    assert sum("the paper says" in row for row in rows) == 6
    junctions = next(row.split()[2:] for row in rows if "T-junctions" in row)
    assert len(junctions) == sum(len(method.variants) for method in METHODS.values())
    assert junctions[0] == junctions[-1] == "0"


@pytest.mark.parametrize("form", ["markdown", "csv", "json"])
def test_compare_in_other_forms(form, run):
    window = ("--bbox", "261000,4024000,263000,4026000")
    outcome = run("compare", DEM, "--max-error", "40,20", *window, "--methods", "wynne,scarlatos", "--format", form)
    assert outcome.code == GOOD
    if form == "json":
        found = json.loads(outcome.out)
        assert [(one["method"], one["variant"]) for one in found] == [
            ("wynne", ""), ("wynne", "over Delaunay"), ("scarlatos", "by itself"), ("scarlatos", "shared edges")
        ]  # fmt: skip
        assert [
            level["accuracy"]["max_error"] <= bound
            for one in found
            for level, bound in zip(one["levels"], (40, 20), strict=True)
        ] == [True] * 8
        return
    lines = outcome.out.splitlines()
    rows = [*csv.reader(lines)] if form == "csv" else [line[1:-1].split("|") for line in lines]
    assert len({len(row) for row in rows}) == 1
    assert any("max error m" in cell for row in rows for cell in row)


BAD_COMPARISONS = {
    "unknown method": (["--methods", "octree"], USAGE, r"unknown method 'octree'"),
    "unknown format": (
        ["--format", "xml"],
        USAGE,
        r"--format: found 'xml', expected one of: text, markdown, csv, json",
    ),
    "no such level": (["--passes", "1", "--level", "2"], USAGE, r"--level: found 2, expected 0 … 1"),
    "no bound": (["--methods", "ternary", "--max-error", "9"], USAGE, r"no method that can hold a bound; give passes"),
    "both modes": (["--passes", "1", "--max-error", "9"], USAGE, r"max_error and passes"),
    "no file": (["missing.tif"], FAILURE, r"missing\.tif"),
}


@pytest.mark.parametrize("case", BAD_COMPARISONS)
def test_bad_comparison_is_refused(case, run):
    arguments, code, message = BAD_COMPARISONS[case]
    window = ("--bbox", "261000,4024000,262000,4025000")
    assert_refused(run("compare", *([] if "missing.tif" in arguments else [DEM]), *arguments, *window), code, message)
