"""`vpfx validate` from outside: what it prints, how it ends, and that nothing in a file makes it fall over."""

from __future__ import annotations

import json
import os
import random
import re
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import invariants
import pytest
from pyproj import CRS
from rule_fixtures import BASES, FIXTURES, base_of, build_base, damage
from surfaces import SURFACES, hills, write_dem

import vpfx
from vpfx.cli import main
from vpfx.errors import StoreError
from vpfx.methods import METHODS
from vpfx.validate import RULES, STORE_RULES, store_data, validate

DEMS = Path(__file__).resolve().parents[1] / "fixtures" / "dem"
CODES = {rule.code for rule in STORE_RULES.values()}
SEEN_BY_THE_JUDGE = (
    "V216", "V220", "V221", "V301", "V302", "V303", "V304", "V305", "V307", "V308", "V309", "V310", "V401", "V402", "V403",
    "V501", "V502", "V503", "V504", "V508", "V509", "V510", "V514", "V521", "V522", "V603", "V609",
)  # fmt: skip
"""Rules about what tests/invariants.py judges too."""
PLACE = re.compile(r"(\w+=\S.*)?")


@pytest.fixture(scope="module")
def plane(tmp_path_factory):
    """The worked store of specs/format.md."""
    return build_base("plane", tmp_path_factory.mktemp("plane"))


@pytest.fixture
def run(capsys):
    """Run the command inside this process; return exit code, stdout and stderr."""

    def call(*arguments):
        with pytest.raises(SystemExit) as ended:
            main(["validate", *map(str, arguments)])
        return ended.value.code, *capsys.readouterr()

    return call


def test_a_clean_store_is_told_in_one_line(run, plane):
    assert run(plane) == (0, f"{plane}: nothing found\n", "")
    assert run(plane, "--dem", plane.with_suffix(".tif"))[0] == 0


def test_findings_are_told_line_by_line(run, plane, tmp_path):
    path = damage(plane, FIXTURES["V404"], tmp_path / "a.gpkg")
    code, out, err = run(path)
    assert (code, err) == (1, "")
    assert out.splitlines() == [
        f"{path}: level=0 tile=1 face=1: error V404 slope: slope: found 572, measured 571.06 (R-171)",
        f"{path}: not checked everywhere: V405 (needs V404)",
        f"{path}: 1 error",
    ]


def test_warnings_alone_are_no_error(run, plane, tmp_path):
    path = damage(plane, FIXTURES["V106"], tmp_path / "a.gpkg")
    code, out, _ = run(path)
    assert code == 0
    assert out.splitlines()[-1] == f"{path}: 1 warning"


def test_names_in_a_file_steer_no_terminal(run, plane, tmp_path):
    path = tmp_path / "a.gpkg"
    trigger = '"a\nb.gpkg: nothing found\x1b[2J"'
    assert spoil(path, plane, [f"CREATE TRIGGER {trigger} AFTER UPDATE ON node BEGIN DELETE FROM level; END"])
    lines = run(path)[1].split("\n")
    assert lines[0].startswith(f"{path}: trigger=a\\nb.gpkg: nothing found\\x1b[2J: warning V106")
    assert lines[1:] == [f"{path}: 1 warning", ""]


def test_a_path_that_is_no_text_is_told_as_sarif(run, plane, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = Path(os.fsdecode(b"\xff.gpkg"))
    shutil.copyfile(plane, path)
    code, out, _ = run(path, "--format", "sarif", "--only", "V106")
    assert (code, json.loads(out)["runs"][0]["results"]) == (0, [])


def test_json(run, plane, tmp_path):
    path = damage(plane, FIXTURES["V404"], tmp_path / "a.gpkg")
    code, out, _ = run(path, "--format", "json")
    found = json.loads(out)
    assert (code, found["ok"], found["path"]) == (1, False, str(path))
    assert found["findings"] == [
        {"code": "V404", "severity": "error", "where": "level=0 tile=1 face=1",
         "message": "slope: found 572, measured 571.06", "requirement": "R-171", "name": "slope"}
    ]  # fmt: skip
    assert found["left_out"] == [{"code": "V405", "reason": "needs V404"}]


def test_sarif(run, plane, tmp_path):
    """The fields that SARIF 2.1.0 requires, and that what is told refers to rules that are told."""
    path = damage(plane, FIXTURES["V401"], tmp_path / "a.gpkg")
    code, out, _ = run(path, "--format", "sarif")
    found = json.loads(out)
    assert code == 1
    assert found["version"] == "2.1.0"
    assert found["$schema"].endswith("sarif-2.1.0.json")
    (told,) = found["runs"]
    driver = told["tool"]["driver"]
    assert driver["name"] == "vpfx"
    assert [rule["id"] for rule in driver["rules"]] == sorted(rule.code for rule in RULES.values())
    for rule in driver["rules"]:
        assert rule["defaultConfiguration"]["level"] in ("error", "warning", "note")
        assert rule["shortDescription"]["text"]
    assert len(told["results"]) == 1
    for result in told["results"]:
        assert driver["rules"][result["ruleIndex"]]["id"] == result["ruleId"] == "V401"
        assert result["level"] == "error"
        assert result["message"]["text"]
        (location,) = result["locations"]
        assert location["physicalLocation"]["artifactLocation"]["uri"].startswith("file:///")
        assert location["logicalLocations"] == [{"fullyQualifiedName": "level=0 tile=1 face=1"}]
    (done,) = told["invocations"]
    assert done["executionSuccessful"] is True
    for note in done["toolExecutionNotifications"]:
        assert note["associatedRule"]["id"] in {rule.code for rule in RULES.values()}


def test_rules_are_listed(run):
    code, out, _ = run("--list-rules")
    lines = out.splitlines()
    assert code == 0
    assert [line.split()[0] for line in lines] == sorted(rule.code for rule in RULES.values())
    rule = RULES["face_clockwise"]
    assert next(line.split(maxsplit=4) for line in lines if line.startswith("V401")) == [
        "V401", "face_clockwise", "error", "R-170", rule.title,
    ]  # fmt: skip
    listed = json.loads(run("--list-rules", "--format", "json")[1])
    assert listed[0] == {
        "code": "V101", "name": "header", "severity": "error", "requirement": "R-100",
        "title": "a field of the header has another value", "needs": ["no_database"],
    }  # fmt: skip
    assert "V401" not in run("--list-rules", "--only", "V104")[1]


def test_rules_are_chosen(run, plane, tmp_path):
    path = damage(plane, FIXTURES["V404"], tmp_path / "a.gpkg")
    assert run(path, "--only", "V3")[0] == 0
    assert run(path, "--skip", "slope")[0] == 0
    assert run(path, "--only", "V4")[0] == 1


REFUSED = {
    "no file": (("none.gpkg",), 3, r"none\.gpkg: found no such file"),
    "a folder": ((".",), 3, r"found nothing of VPF, expected a database"),
    "no argument": ((), 2, r"Missing argument 'PATH'"),
    "unknown form": (("a.gpkg", "--format", "xml"), 2, r"--format: found 'xml', expected one of: text, json, sarif"),
    "unknown rule": (("a.gpkg", "--only", "V999"), 2, r"rules: found 'V999'"),
    "empty pattern": (("a.gpkg", "--skip", ""), 2, r"rules: found ''"),
    "rules as SARIF": (("--list-rules", "--format", "sarif"), 2, r"--format: found 'sarif' for a list of rules"),
    "too long a name": (("a" * 300,), 3, r"cannot be read: File name too long"),
    "no DEM": (("a.gpkg", "--dem", "none.tif"), 3, r"none\.tif"),
    "other DEM": (("a.gpkg", "--dem", "text.tif"), 3, r"text\.tif"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_checked_is_one_line(name, run, plane, tmp_path, monkeypatch):
    arguments, code, message = REFUSED[name]
    monkeypatch.chdir(tmp_path)
    shutil.copyfile(plane, "a.gpkg")
    Path("text.tif").write_text("no raster")
    found, out, err = run(*arguments)
    assert (found, out) == (code, "")
    assert re.fullmatch(r"vpfx[^\n]*\n", err)
    assert re.search(message, err)


def test_a_file_that_may_not_be_read(run, plane, tmp_path, monkeypatch):
    path = tmp_path / "a.gpkg"
    shutil.copyfile(plane, path)

    def refuse(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)
    code, out, err = run(path)
    assert (code, out, err) == (3, "", f"vpfx: {path}: cannot be read: Permission denied\n")


def test_a_write_ahead_log_is_read_and_none_is_left(plane, tmp_path):
    path = tmp_path / "a.gpkg"
    shutil.copyfile(plane, path)
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA journal_mode = WAL")
    assert [(found.code, found.where) for found in validate(path).findings] == [
        ("V101", "byte=18"),
        ("V101", "byte=19"),
    ]
    assert [file.name for file in tmp_path.iterdir()] == ["a.gpkg"]
    with closing(sqlite3.connect(path)) as writer:
        writer.execute("UPDATE face SET slope_centidegrees = 9 WHERE face_id = 1")
        writer.commit()
        codes = {found.code for found in validate(path).findings}
    assert codes == {"V101", "V103", "V120", "V404"}


def test_an_interrupted_change_is_told(plane, tmp_path):
    """A hot journal: SQLite would undo the change, and may not."""
    path = tmp_path / "a.gpkg"
    shutil.copyfile(plane, path)
    with closing(sqlite3.connect(path)) as writer:
        writer.execute("PRAGMA cache_spill = 1")
        writer.execute("PRAGMA cache_size = 1")
        writer.execute("BEGIN")
        writer.execute("UPDATE face SET slope_centidegrees = 9")
        writer.execute("UPDATE edge SET right_edge = left_edge")
        for file in list(tmp_path.iterdir()):
            shutil.copyfile(file, file.with_name(file.name.replace("a.gpkg", "b.gpkg")))
    report = validate(tmp_path / "b.gpkg")
    assert {found.code for found in report.findings} == {"V103", "V902"}
    assert "a change that was interrupted" in report.findings[-1].message


def test_somebody_is_writing(plane, tmp_path, monkeypatch):
    monkeypatch.setattr(store_data, "BUSY_SECONDS", 0.01)
    path = tmp_path / "a.gpkg"
    shutil.copyfile(plane, path)
    with closing(sqlite3.connect(path, isolation_level=None)) as writer:
        writer.execute("BEGIN EXCLUSIVE")
        with pytest.raises(StoreError, match="somebody is writing, try again"):
            validate(path)


OTHERS = {
    "a text": (b"Triangles are at home.\n", "V901", "found a text"),
    "an empty file": (b"", "V901", "found an empty file"),
    "a TIFF": (b"II*\0" + bytes(200), "V901", "found a TIFF"),
    "an archive": (b"PK\3\4" + bytes(200), "V901", "found a ZIP archive"),
    "noise": (random.Random(1998).randbytes(5000), "V901", "found bytes"),
    "half a magic": (b"SQLite for", "V901", "found 10 bytes"),
    "a header and no more": (b"SQLite format 3\0" + bytes(84), "V102", "found 100 bytes"),
}


@pytest.mark.parametrize("name", OTHERS)
def test_other_files_are_told_apart(name, tmp_path):
    content, code, message = OTHERS[name]
    path = tmp_path / "a.gpkg"
    path.write_bytes(content)
    (found,) = [finding for finding in validate(path).findings if finding.code not in ("V101",)]
    assert (found.code, found.message[: len(message)]) == (code, message)


def test_another_database(tmp_path):
    path = tmp_path / "a.gpkg"
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("CREATE TABLE post (z REAL)")
    (found,) = validate(path).findings
    assert (found.code, found.message[:35]) == ("V903", "found a database of SQLite without ")


@pytest.mark.parametrize("name", BASES)
def test_the_judge_finds_valid_stores_valid(name, tmp_path):
    path = build_base(name, tmp_path)
    invariants.judge_store(path, path.with_suffix(".tif"))


@pytest.mark.parametrize("code", SEEN_BY_THE_JUDGE)
def test_the_judge_finds_defects_too(code, tmp_path):
    """What rules and the judge of the tests have in common both see; they share no code."""
    fixture = FIXTURES[code]
    base = build_base(base_of(fixture), tmp_path)
    path = damage(base, fixture, tmp_path / "a.gpkg")
    with pytest.raises(AssertionError):
        invariants.judge_store(path, base.with_suffix(".tif"))


@pytest.mark.parametrize("method", METHODS)
def test_stores_of_every_method_are_clean(method, tmp_path):
    options = {"max_error": (20, 6)} if METHODS[method].bounded else {"passes": 3}
    dem = write_dem(tmp_path / "a.tif", hills(33, 28, 7))
    path = vpfx.build(dem, tmp_path / "a.gpkg", method=method, **options).path
    assert validate(path, dem=[dem]).findings == ()


@pytest.mark.parametrize("name", [name for name, grid in SURFACES.items() if max(grid.heights.shape) > 2])
def test_stores_of_every_surface_are_clean(name, tmp_path):
    grid = SURFACES[name]
    dem = write_dem(tmp_path / "a.tif", grid.heights, x0=grid.x0, y0=grid.y0, step=grid.dx, crs=None)
    path = vpfx.build(dem, tmp_path / "a.gpkg", max_error=(8, 2), tile_size=8).path
    assert validate(path, dem=[dem]).findings == ()


REAL = {
    "voids in tiles": ("new_mexico_voids.tif", {"max_error": (40, 20, 10), "tile_size": 50}),
    "voids filled": ("new_mexico_voids.tif", {"max_error": (40, 20, 10), "tile_size": 33, "fill": True}),
    "DTED": ("new_mexico_n36_w108.dt2", {"max_error": (40, 20), "tile_size": 100}),
    "fitted": ("new_mexico_utm13_30m.tif", {"max_error": (20, 5), "tile_size": 40, "fit": "max-error"}),
    "T-junctions": ("new_mexico_cell_5min_1arcsec.tif", {"method": "quadtree", "max_error": (40, 20)}),
}


@pytest.mark.parametrize("name", REAL)
def test_stores_of_real_terrain_are_clean(name, tmp_path):
    dem, options = REAL[name]
    path = vpfx.build(DEMS / dem, tmp_path / "a.gpkg", **options).path
    assert validate(path, dem=[DEMS / dem]).findings == ()


def test_a_larger_file_than_the_store(tmp_path):
    """A DEM of which only a part was built."""
    dem = write_dem(tmp_path / "a.tif", hills(40, 40, 2))
    path = vpfx.build(
        dem, tmp_path / "a.gpkg", max_error=(9,), dem_options={"bbox": (500100, 4000100, 500800, 4000700)}
    ).path
    assert validate(path, dem=[dem]).findings == ()
    other = write_dem(tmp_path / "b.tif", hills(40, 40, 3))
    assert {finding.code for finding in validate(path, dem=[other]).findings} == {"V524"}
    far = write_dem(tmp_path / "c.tif", hills(40, 40, 3), x0=0)
    assert {finding.code for finding in validate(path, dem=[far]).findings} == {"V520"}


def test_a_bound_that_is_not_kept_is_found_at_the_posts(tmp_path):
    """Figures that fit each other may be made up; the posts tell."""
    base, path = build_base("hills", tmp_path), tmp_path / "a.gpkg"
    shutil.copyfile(base, path)
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("UPDATE level SET max_error_bound = 1, max_error = 0.9, rmse = 0.5 WHERE level = 2")
        connection.commit()
    assert validate(path).ok
    report = validate(path, dem=[base.with_suffix(".tif")])
    (found,) = report.findings
    assert (found.code, found.where) == ("V521", "level=2")
    assert re.fullmatch(r"max_error: found 0\.9, measured 3\.9\d*", found.message)


def known(report):
    """Hold that a report has only findings of known codes with places that can be read; return the codes."""
    for finding in report.findings:
        assert finding.code in CODES
        assert PLACE.fullmatch(finding.where)
        assert finding.message
    return {finding.code for finding in report.findings}


def test_every_97th_byte_may_change(plane, tmp_path):
    """A changed byte gives findings, or lies where nothing is kept; no error comes through."""
    data, path = plane.read_bytes(), tmp_path / "a.gpkg"
    found = set()
    rng = random.Random(97)
    for at in range(rng.randrange(97), len(data), 97 * 40):
        path.write_bytes(data[:at] + bytes([data[at] ^ rng.randrange(1, 256)]) + data[at + 1 :])
        found |= known(validate(path))
    assert {"V104", "V902"} & found


@pytest.mark.slow
def test_every_97th_byte_may_change_everywhere(tmp_path):
    for name in BASES:
        base = build_base(name, tmp_path)
        data, path = base.read_bytes(), tmp_path / "a.gpkg"
        rng = random.Random(name)
        for at in range(rng.randrange(97), len(data), 97 * 60):
            path.write_bytes(data[:at] + bytes([data[at] ^ rng.randrange(1, 256)]) + data[at + 1 :])
            known(validate(path))


def test_files_that_are_cut_off(plane, tmp_path):
    data, path = plane.read_bytes(), tmp_path / "a.gpkg"
    for size in [0, 1, 16, 99, 100, 512, *range(4095, len(data), 4096 * 5), len(data) - 1]:
        path.write_bytes(data[:size])
        assert known(validate(path)) & {"V901", "V102"}


VALUES = (
    "NULL",
    "-1",
    "0",
    "1",
    "2147483648",
    "9223372036854775807",
    "-9223372036854775808",
    "1.5",
    "9e999",
    "'text'",
    "x'00'",
)


def columns_of(path):
    """Return all columns of all tables of a store."""
    with closing(sqlite3.connect(path)) as connection:
        tables = (
            "SELECT name FROM sqlite_schema WHERE type = 'table' AND name NOT LIKE 'tile_index%' AND sql IS NOT NULL"
        )
        return [
            (table, row[1])
            for (table,) in connection.execute(tables).fetchall()
            for row in connection.execute(f"PRAGMA table_info({table})")
        ]


def spoil(path, base, statements):
    """Copy a base and run statements on it, as far as SQLite lets them."""
    shutil.copyfile(base, path)
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA ignore_check_constraints = ON")
        for statement in statements:
            try:
                connection.execute(statement)
            except sqlite3.Error:
                return False
        connection.commit()
    return True


def test_any_value_may_stand_anywhere(tmp_path):
    """One column of one row takes a value of any kind: findings, or nothing where the value is right."""
    base, path = build_base("soil", tmp_path), tmp_path / "a.gpkg"
    rng = random.Random(3)
    for table, column in columns_of(base):
        for value in rng.sample(VALUES, 1):
            row = f"(SELECT {column} FROM {table} LIMIT 1 OFFSET {rng.randrange(3)})"
            if spoil(path, base, [f"UPDATE {table} SET {column} = {value} WHERE {column} IS {row}"]):
                known(validate(path))


@pytest.mark.parametrize(("name", "table"), [("junctions", "t_junction"), ("pyramid", "shared_area")])
def test_any_value_may_stand_in_tables_that_few_stores_fill(name, table, tmp_path):
    base, path = build_base(name, tmp_path), tmp_path / "a.gpkg"
    rng = random.Random(table)
    for column in [column for of, column in columns_of(base) if of == table]:
        for value in rng.sample(VALUES, 3):
            row = f"(SELECT {column} FROM {table} LIMIT 1 OFFSET 2)"
            if spoil(path, base, [f"UPDATE OR IGNORE {table} SET {column} = {value} WHERE {column} IS {row}"]):
                known(validate(path))


def test_tables_may_be_empty(tmp_path):
    """T-junctions, edges and faces without a node; then levels and tiles alone."""
    base, path = build_base("junctions", tmp_path), tmp_path / "a.gpkg"
    no_nodes = ["DELETE FROM node", "UPDATE tile_level SET first_node = NULL, last_node = NULL"]
    assert spoil(path, base, no_nodes)
    assert {"V220", "V221", "V223"} <= known(validate(path))
    no_rows = [f"DELETE FROM {table}" for table in ("edge", "face", "t_junction", "parent_child", "shared_area")]
    no_ids = ", ".join(f"{end}_{table} = NULL" for end in ("first", "last") for table in ("edge", "face"))
    no_counts = "UPDATE level SET node_count = 0, edge_count = 0, face_count = 0"
    assert spoil(path, base, [*no_nodes, *no_rows, f"UPDATE tile_level SET {no_ids}", no_counts])
    assert {"V523", "V609"} <= known(validate(path, dem=[base.with_suffix(".tif")]))


@pytest.mark.slow
@pytest.mark.parametrize("name", BASES)
def test_any_value_may_stand_anywhere_in_every_base(name, tmp_path):
    base, path = build_base(name, tmp_path), tmp_path / "a.gpkg"
    rng = random.Random(name)
    for table, column in list(columns_of(base))[rng.randrange(3) :: 3]:
        for value in rng.sample(VALUES, 1):
            for row in ("", f" WHERE {column} IS (SELECT {column} FROM {table} LIMIT 1 OFFSET 5)"):
                if spoil(path, base, [f"UPDATE {table} SET {column} = {value}{row}"]):
                    known(validate(path, dem=[base.with_suffix(".tif")] if row else []))


def test_a_strangers_tables_are_not_asked(plane, tmp_path):
    """Expressions of tables, indexes and views that the format does not know are never run."""
    path = tmp_path / "a.gpkg"
    endless = "(WITH RECURSIVE r (i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM r) SELECT max(i) FROM r)"
    assert spoil(path, plane, [
        "CREATE TABLE own (a INTEGER, b TEXT GENERATED ALWAYS AS (replace(hex(zeroblob(a)), '0', 'zero')) VIRTUAL NOT NULL)",
        "INSERT INTO own (a) VALUES (1)",
        "CREATE INDEX own_b ON own (length(b))",
        f"CREATE VIEW endless AS SELECT {endless}",
        "PRAGMA writable_schema = ON",
        "UPDATE sqlite_schema SET sql = replace(sql, 'length(b)', 'hex(zeroblob(400000000))') WHERE name = 'own_b'",
    ])  # fmt: skip
    assert validate(path).findings == ()


COMPUTING = {
    "an expression": "CREATE INDEX own ON node (hex(zeroblob(400000000)))",
    "a condition": "CREATE INDEX own ON node (x) WHERE length(hex(zeroblob(400000000))) < 9",
}


@pytest.mark.parametrize("name", COMPUTING)
def test_an_index_that_computes_is_told_and_not_run(name, plane, tmp_path):
    """On a table of the format it would be run by PRAGMA integrity_check, for each node."""
    path, harmless = tmp_path / "a.gpkg", COMPUTING[name].replace("400000000", "4")
    statements = [
        "PRAGMA writable_schema = ON",
        f"UPDATE sqlite_schema SET sql = '{COMPUTING[name]}' WHERE name = 'own'",
    ]
    assert spoil(path, plane, [harmless, *statements])
    (found,) = validate(path).findings
    assert (found.code, found.where) == ("V105", "index=own")


def test_an_index_of_columns_may_be_added(plane, tmp_path):
    path = tmp_path / "a.gpkg"
    assert spoil(path, plane, ["CREATE INDEX own ON node (z)"])
    assert validate(path) == (path, (), ())


def test_damage_is_told_line_by_line(plane, tmp_path):
    """What SQLite finds wrong with the trees of pages is one text of many lines."""
    path = tmp_path / "a.gpkg"
    page = "(SELECT rootpage FROM sqlite_schema WHERE name = 'face_feature_by_feature')"
    others = "('parent_child_by_parent', 'sqlite_autoindex_feature_1')"
    statements = ["PRAGMA writable_schema = ON", f"UPDATE sqlite_schema SET rootpage = {page} WHERE name IN {others}"]
    assert spoil(path, plane, statements)
    findings = validate(path).findings
    assert {found.code for found in findings} == {"V104"}
    assert [found.message.rsplit(" ", 1)[0] for found in findings[:2]] == ["found: 2nd reference to page"] * 2
    assert not any("\n" in found.message for found in findings)


SIZELESS = {
    "ellipsoid": CRS("EPSG:4326").to_wkt().replace("6378137,298.257223563", "1e-300,0"),
    "geocentric": CRS("EPSG:4978").to_wkt(),
    "vertical": CRS("EPSG:5773").to_wkt(),
}


@pytest.mark.parametrize("name", SIZELESS)
def test_a_crs_in_which_nothing_can_be_measured_is_told(name, plane, tmp_path):
    path = tmp_path / "a.gpkg"
    assert spoil(path, plane, [f"UPDATE metadata SET value = '{SIZELESS[name]}' WHERE name = 'crs_wkt2'"])
    assert ("V201", "table=metadata name=crs_wkt2") in [(found.code, found.where) for found in validate(path).findings]
