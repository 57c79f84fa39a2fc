"""The questions of specs/sql.md: their answers, their plans, what they read; and what `vpfx sql` allows."""

from __future__ import annotations

import csv
import io
import json
import os
import re
import shlex
import shutil
import signal
import sqlite3
import stat
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import pytest
from surfaces import hills, write_dem

import vpfx
from vpfx.attach import attach_sql
from vpfx.cli import main
from vpfx.errors import InputError, NotFoundError, StoreError
from vpfx.query.sql import Answer, answer_sql, to_arrow, to_csv, to_json, to_table

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "specs" / "sql.md").read_text(encoding="utf-8")
QUESTIONS = dict(re.findall(r"^## (\d+) .*?^```sql\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL))
ANSWERS = dict(re.findall(r"^## (\d+) .*?^```sql\n.*?^```$\s*^```\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL))
OF_ALL_FACES = "2"  # the question that is about all faces
LARGE = ("node", "edge", "face", "parent_child", "shared_area", "face_feature", "feature", "parent_child_by_parent")
SHELL = shutil.which("sqlite3")


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    """The store of the page, made by the commands of the page."""
    folder = tmp_path_factory.mktemp("sql")
    soils = re.search(r"^```json\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)[1]
    (folder / "soils.geojson").write_text(soils, encoding="utf-8")
    (folder / "fixtures").symlink_to(ROOT / "fixtures")
    commands = re.findall(r"^\$ vpfx (.*)$", PAGE, re.MULTILINE)
    assert [command.split()[0] for command in commands] == ["build", "attach", "attach"]
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for command in commands:
            with pytest.raises(SystemExit) as exit_:
                main([*shlex.split(command), *(["--quiet"] if command.startswith("build") else [])])
            assert exit_.value.code == 0
    return folder / "cell.gpkg"


def cells(table):
    """Return the cells of a table as the page prints it; a dash is nothing."""
    return [["" if text == "–" else text for text in line.split()] for line in table.splitlines()]


def test_the_page_asks_ten_questions():
    assert [*QUESTIONS] == [*ANSWERS] == [str(number) for number in range(1, 11)]


@pytest.mark.parametrize("number", QUESTIONS)
def test_vpfx_sql_answers_as_printed(number, cell, capsys):
    with pytest.raises(SystemExit) as exit_:
        main(["sql", str(cell), QUESTIONS[number]])
    assert exit_.value.code == 0
    assert capsys.readouterr().out == ANSWERS[number]


@pytest.mark.parametrize("number", QUESTIONS)
@pytest.mark.parametrize("trusted", ["ON", "OFF"])
def test_sqlite3_answers_as_printed(trusted, number, cell):
    with closing(sqlite3.connect(cell)) as connection:
        connection.execute(f"PRAGMA trusted_schema = {trusted}")
        cursor = connection.execute(QUESTIONS[number])
        rows = [[column[0] for column in cursor.description], *cursor]
    assert [["" if value is None else str(value) for value in row] for row in rows] == cells(ANSWERS[number])


@pytest.mark.skipif(SHELL is None, reason="the sqlite3 shell is not installed")
@pytest.mark.parametrize("number", QUESTIONS)
def test_the_shell_answers_as_printed(number, cell):
    command = [SHELL, "-batch", "-init", os.devnull, "-csv", "-header", f"file:{cell}?mode=ro", QUESTIONS[number]]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert [*csv.reader(io.StringIO(done.stdout))] == cells(ANSWERS[number])


@pytest.mark.parametrize("number", QUESTIONS)
def test_plans_use_indexes(number, cell):
    """No loop runs through a whole large table, and none makes an index of its own."""
    with closing(sqlite3.connect(cell)) as connection:
        steps = [row[3] for row in connection.execute(f"EXPLAIN QUERY PLAN {QUESTIONS[number]}")]
        roots = dict(connection.execute("SELECT rootpage, name FROM sqlite_schema WHERE rootpage > 0"))
        program = connection.execute(f"EXPLAIN {QUESTIONS[number]}").fetchall()
    assert any("USING INTEGER PRIMARY KEY" in step for step in steps)
    assert [step for step in steps if "AUTOMATIC" in step] == []
    cursors = {row[2]: roots.get(row[3]) for row in program if row[1] == "OpenRead"}
    from_the_start = {cursors.get(row[2]) for row in program if row[1] in ("Rewind", "Last")}
    assert from_the_start & {*LARGE} == set()


def test_a_whole_scan_is_found(cell):
    """The test above sees a loop through a whole table."""
    with closing(sqlite3.connect(cell)) as connection:
        (root,) = connection.execute("SELECT rootpage FROM sqlite_schema WHERE name = 'face'").fetchone()
        program = connection.execute("EXPLAIN SELECT face_id FROM face WHERE slope_centidegrees > 3000").fetchall()
    opened = [row[2] for row in program if row[1] == "OpenRead" and row[3] == root]
    assert [row for row in program if row[1] == "Rewind" and row[2] in opened]


@pytest.fixture(scope="module")
def extents(tmp_path_factory):
    """Two stores of the same ground, the second with four times the extent."""
    folder = tmp_path_factory.mktemp("pages")
    heights = hills(201, 201)
    made = []
    for name, n in (("small", 101), ("large", 201)):
        dem = write_dem(folder / f"{name}.tif", heights[:n, :n], step=8.0)
        path = vpfx.build(dem, folder / f"{name}.gpkg", max_error=(30, 20, 12, 6), tile_size=50).path
        attach_sql(path, "soil", "SELECT face_id, face_id % 3 AS kind, 1.0 AS depth, NULL AS surveyed FROM face_3")
        attach_sql(
            path, "cover", "SELECT face_id, CASE WHEN face_id % 2 THEN 'forest' ELSE 'x' END AS kind FROM face_1"
        )
        made.append(path)
    return made


def pages_read(path, question):
    """Return how many pages SQLite reads for a question, and the answer."""
    apsw = pytest.importorskip("apsw", reason="apsw, which counts pages, is not installed")
    connection = apsw.Connection(str(path), flags=apsw.SQLITE_OPEN_READONLY)
    [*connection.execute("SELECT count(*) FROM sqlite_schema")]
    before = connection.status(apsw.SQLITE_DBSTATUS_CACHE_MISS)[0]
    rows = [*connection.execute(question)]
    return connection.status(apsw.SQLITE_DBSTATUS_CACHE_MISS)[0] - before, rows


@pytest.mark.parametrize("number", [number for number in QUESTIONS if number != OF_ALL_FACES])
def test_pages_read_grow_with_the_answer(number, extents):
    """About the same ground as many pages are read of a store of four times the extent, and a few of deeper trees."""
    question = QUESTIONS[number]
    for there, here in (("-107.6375", "500160"), ("36.3625", "4000190"), ("-107.64", "500130"), ("-107.63", "500230"),
                        ("36.36", "4000130"), ("36.37", "4000230")):  # fmt: skip
        question = re.sub(rf"(?<![\d.]){there}(?!\d)", here, question)
    level = 0 if "24087" in question else 3
    question = re.sub(r"\b(26012|24087)\b", ":face", question)
    counts, sizes = [], []
    for path in extents:
        with closing(sqlite3.connect(path)) as connection:
            query = "SELECT face_id FROM region WHERE level = ? AND tile_id = 1 LIMIT 1"
            (face,) = connection.execute(query, (level,)).fetchone()
        count, rows = pages_read(path, question.replace(":face", str(face)))
        assert number == "3" or rows
        counts.append(count)
        sizes.append(path.stat().st_size // 4096)
    assert sizes[1] > 3 * sizes[0]
    assert counts[1] <= 1.25 * counts[0] + 8
    assert counts[1] < sizes[1] / 4


def test_a_question_about_all_reads_all(extents):
    counts = [pages_read(path, QUESTIONS[OF_ALL_FACES])[0] for path in extents]
    assert counts[1] > 2 * counts[0]


# --- what may be asked ------------------------------------------------------------------------------------------------------

FORBIDDEN = {
    "delete": "DELETE FROM soil",
    "insert": "INSERT INTO feature VALUES (999, 1)",
    "attach": "ATTACH 'other.db' AS other",
    "detach": "DETACH main",
    "create": "CREATE TABLE mine (a)",
    "temporary table": "CREATE TEMP TABLE mine (a)",
    "drop": "DROP TABLE soil",
    "journal": "PRAGMA journal_mode = WAL",
    "writable schema": "PRAGMA writable_schema = ON",
    "trust": "PRAGMA trusted_schema = ON",
    "vacuum": "VACUUM INTO 'other.db'",
    "extension": "SELECT load_extension('other')",
    "transaction": "COMMIT",
    "savepoint": "SAVEPOINT a",
    "two statements": "SELECT 1; DELETE FROM soil",
    "no SQL": "tell me",
    "no such table": "SELECT * FROM forest",
    "a parameter": "SELECT ?",
    "zero byte": "SELECT 1\0",
    "half a character": "SELECT '\udc80'",
    "too large": "SELECT zeroblob(1 << 40)",
}


@pytest.mark.parametrize("case", FORBIDDEN)
@pytest.mark.parametrize("is_writing", [False, True])
def test_what_is_forbidden_changes_nothing(is_writing, case, extents, tmp_path, monkeypatch):
    if is_writing and case in ("delete", "insert"):
        pytest.skip("this is what writing is for")
    path = shutil.copy(extents[0], tmp_path / "a.gpkg")
    before = path.read_bytes()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=r"^SQL: [^\n]*$"):
        answer_sql(path, FORBIDDEN[case], write=is_writing)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["a.gpkg"]


@pytest.mark.parametrize(
    "change",
    [
        "DELETE FROM node", "UPDATE face SET level = 1", "DELETE FROM metadata", "DELETE FROM feature_class",
        "UPDATE feature_column SET kind = 'real'", "INSERT INTO gpkg_contents (table_name, data_type) VALUES ('a', 'b')",
        "DELETE FROM sqlite_schema", "UPDATE soil SET depth = 'deep'", "INSERT INTO face_feature VALUES (1, 1, 1, 2)",
        "INSERT INTO face_feature VALUES (99999999, 1, 1, 1)", "INSERT INTO soil VALUES (99999999, 1, 1, NULL)",
        "INSERT INTO face_feature VALUES (1, 2, 1, 0.5)",
    ],
)  # fmt: skip
def test_writing_keeps_to_attributes_and_their_rules(change, extents, tmp_path):
    path = shutil.copy(extents[0], tmp_path / "a.gpkg")
    before = path.read_bytes()
    with pytest.raises(InputError, match=r"^SQL: "):
        answer_sql(path, change, write=True)
    assert path.read_bytes() == before


def test_writing_changes_rows(extents, tmp_path):
    path = shutil.copy(extents[0], tmp_path / "a.gpkg")
    answer = answer_sql(path, "UPDATE soil SET depth = 7 WHERE kind = 1 RETURNING kind, depth", write=True)
    assert answer.rows == [(1, 7.0)]
    (one,) = answer_sql(path, "SELECT feature_id FROM soil WHERE kind = 2").rows[0]
    assert answer_sql(path, f"DELETE FROM feature WHERE feature_id = {one}", write=True).n_changed == 1
    assert answer_sql(path, "SELECT kind, depth FROM soil ORDER BY kind").rows == [(0, 1.0), (1, 7.0)]
    assert answer_sql(path, f"SELECT count(*) FROM face_feature WHERE feature_id = {one}").rows == [(0,)]
    assert answer_sql(path, "PRAGMA foreign_key_check").rows == []


def test_a_store_that_is_read_only_is_asked(extents, tmp_path):
    path = shutil.copy(extents[0], tmp_path / "a.gpkg")
    before = path.read_bytes(), path.stat().st_mtime_ns
    path.chmod(stat.S_IRUSR)
    tmp_path.chmod(stat.S_IRUSR | stat.S_IXUSR)
    try:
        assert answer_sql(path, "SELECT count(*) FROM level").rows == [(4,)]
        if os.geteuid():  # root may write everywhere
            with pytest.raises(StoreError, match="cannot be written"):
                answer_sql(path, "DELETE FROM face_feature", write=True)
        assert (path.read_bytes(), path.stat().st_mtime_ns) == before
    finally:
        tmp_path.chmod(stat.S_IRWXU)


def test_a_view_that_stands_in_is_refused(extents, tmp_path):
    path = shutil.copy(extents[0], tmp_path / "a.gpkg")
    with closing(sqlite3.connect(path)) as connection:
        connection.executescript(
            "DROP VIEW face_area; CREATE VIEW face_area AS SELECT 1 AS face_id, 0 AS level, 9 AS area"
        )
    with pytest.raises(vpfx.errors.StoreFormatError, match="view face_area: found another definition"):
        answer_sql(path, "SELECT * FROM face_area")
    with pytest.raises(NotFoundError, match="found no such file"):
        answer_sql(tmp_path / "b.gpkg", "SELECT 1")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT for another process")
def test_an_endless_question_is_interrupted(extents):
    endless = "WITH RECURSIVE c(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM c) SELECT max(n) FROM c"
    command = [sys.executable, "-m", "vpfx", "sql", str(extents[0]), endless]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    time.sleep(2.5)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out, err.strip()) == (130, "", "vpfx: interrupted; nothing was changed")


# --- forms of answers -------------------------------------------------------------------------------------------------------

MIXED = Answer(("a", "b", "a", "c"), [(1, "x,\ny", 2.5, b"\x00\xff"), (None, "é", 3.0, None)])


def test_forms():
    assert to_table(MIXED).decode().splitlines() == ["a  b        a  c", "1  x,\\ny  2.5  00ff", "–  é      3.0  –"]
    assert [*csv.reader(io.StringIO(to_csv(MIXED).decode(), newline=""))] == [
        ["a", "b", "a", "c"], ["1", "x,\ny", "2.5", "00ff"], ["", "é", "3.0", ""]
    ]  # fmt: skip
    assert json.loads(to_json(MIXED)) == [
        {"a": 1, "b": "x,\ny", "a_2": 2.5, "c": "00ff"},
        {"a": None, "b": "é", "a_2": 3.0, "c": None},
    ]
    assert json.loads(to_json(Answer(("a",), [(float("inf"),)]))) == [{"a": None}]
    assert to_table(Answer((), [])) == to_csv(Answer((), [])) == b""
    assert to_table(Answer(("a",), [])) == b"a\n"


def test_arrow():
    pyarrow = pytest.importorskip("pyarrow", reason="pyarrow is not installed")
    table = pyarrow.ipc.open_file(to_arrow(MIXED)).read_all()
    assert [str(field.type) for field in table.schema] == ["int64", "string", "double", "binary"]
    assert table.column(3).to_pylist() == [b"\x00\xff", None]
    with pytest.raises(InputError, match="column a: found values of several kinds"):
        to_arrow(Answer(("a",), [(1,), ("x",)]))


def test_arrow_is_an_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(NotFoundError, match=r"pip install 'vpfx\[arrow\]'"):
        to_arrow(MIXED)


def test_output_goes_to_a_file(extents, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    shutil.copy(extents[0], "a.gpkg")

    def call(*arguments):
        with pytest.raises(SystemExit) as exit_:
            main(["sql", "a.gpkg", *arguments])
        return exit_.value.code, *capsys.readouterr()

    assert call("SELECT level FROM level", "--format", "csv", "-o", "a.csv") == (0, "", "")
    assert Path("a.csv").read_text().split() == ["level", "0", "1", "2", "3"]
    assert call("SELECT 1", "-o", "a.csv") == (
        3,
        "",
        "vpfx: a.csv: found an existing file; give another name or --overwrite\n",
    )
    assert call("SELECT 1", "-o", "a.csv", "--overwrite")[0] == 0
    code, _, err = call("SELECT 1", "-o", "a.gpkg", "--overwrite")
    assert (code, "a file that is read" in err) == (2, True)
    code, _, err = call("SELECT 1", "--format", "xml")
    assert (code, err) == (2, "vpfx: --format: found 'xml', expected one of: table, csv, json, arrow\n")
    code, out, err = call("DELETE FROM face_feature WHERE face_id = -1", "--write")
    assert (code, out, err) == (0, "", "a.gpkg: 0 rows changed\n")
    monkeypatch.setattr("sys.stdin", io.StringIO("SELECT 5 AS five"))
    assert call("-") == (0, "five\n   5\n", "")
    assert sorted(os.listdir()) == ["a.csv", "a.gpkg"]


@pytest.mark.parametrize("column", ["locked", "readonly", "malformed"])
def test_words_of_errors_in_questions(column, extents):
    with pytest.raises(InputError, match=f"SQL: no such column: {column}"):
        answer_sql(extents[0], f"SELECT {column} FROM face")


def test_changes_are_undone_if_the_answer_cannot_be_given(extents, tmp_path, capsys):
    path = shutil.copy(extents[0], tmp_path / "a.gpkg")
    (before,) = answer_sql(path, "SELECT count(*) FROM feature").rows
    question = "INSERT INTO feature SELECT max(feature_id) + 1, 1 FROM feature"
    with pytest.raises(SystemExit, match="3"):
        main(["sql", str(path), question, "--write", "-o", "/proc/x"])
    assert capsys.readouterr().err.count("\n") == 1
    assert answer_sql(path, "SELECT count(*) FROM feature").rows == [before]
