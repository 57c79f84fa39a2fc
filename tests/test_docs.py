"""The pages and the code say the same: names, numbers, examples, schema."""

from __future__ import annotations

import ast
import doctest
import re
import sqlite3
import subprocess
import sys
from pathlib import Path

import click
import pytest
from test_cli import commands

import vpfx
from vpfx.cli import app
from vpfx.store.writer import FORMAT_VERSION

ROOT = Path(__file__).resolve().parents[1]
FIXTURES = ROOT / "fixtures" / "dem"
NUMBER = re.compile(r"\b[EMQRV]-\d{3}\b")
NAMES = {"R": "format", "M": "methods", "Q": "query", "V": "vpf", "E": "evpf"}
PAGES = {kind: ROOT / "specs" / f"{name}.md" for kind, name in NAMES.items()}
CITING = [
    *sorted(path for folder in ("vpfx", "tests", "bench") for path in (ROOT / folder).rglob("*.py")),
    *sorted((ROOT / "schema").glob("*.sql")),
    *sorted((ROOT / "specs").glob("*.md")),
    ROOT / "README.md",
]
SCHEMAS = sorted(path.name for path in (ROOT / "schema").glob("*.sql"))


def read(path):
    """Return the text of a file."""
    return path.read_text(encoding="utf-8")


def headings(kind):
    """Return the numbers that head a section of their page, in its order."""
    return re.findall(rf"^#+ ({kind}-\d{{3}})\b", read(PAGES[kind]), re.MULTILINE)


@pytest.fixture(scope="module")
def worked(tmp_path_factory):
    """Run the page of the format as a doctest, once; return its folder."""
    folder = tmp_path_factory.mktemp("worked")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        result = doctest.testfile(
            str(PAGES["R"]), module_relative=False, globs={"FIXTURES": str(FIXTURES)}, encoding="utf-8"
        )
    return folder, result


def test_worked_values_are_right(worked):
    """Every worked value of the page comes out of the code; what differs is printed."""
    _, result = worked
    assert result.attempted > 50
    assert result.failed == 0


def test_worked_values_of_vpf_are_right():
    result = doctest.testfile(str(PAGES["V"]), module_relative=False, encoding="utf-8")
    assert result.attempted > 8
    assert result.failed == 0


def test_worked_directory_is_right(tmp_path, monkeypatch):
    """The same of the page of the VPF extension."""
    monkeypatch.chdir(tmp_path)
    result = doctest.testfile(str(PAGES["E"]), module_relative=False, encoding="utf-8")
    assert result.attempted > 30
    assert result.failed == 0


def test_sql_on_the_page_runs(worked):
    """The queries that show how to read a store find the tile and its two faces."""
    folder, _ = worked
    (block,) = re.findall(r"```sql\n(.*?)```", read(PAGES["R"]), re.DOTALL)
    tiles, faces = block.strip().removesuffix(";").split(";\n")
    connection = sqlite3.connect(folder / "plane.gpkg")
    box = {"min_x": 500110, "min_y": 4000010, "max_x": 500120, "max_y": 4000020}
    assert connection.execute(tiles, box).fetchall() == [(2,)]
    assert [row[0] for row in connection.execute(faces, {"tile": 2})] == [7, 8]
    connection.close()


def test_metadata_are_those_of_the_page(worked):
    folder, _ = worked
    connection = sqlite3.connect(folder / "plane.gpkg")
    stored = {name for (name,) in connection.execute("SELECT name FROM metadata")}
    connection.close()
    section = re.search(r"^### R-110.*?(?=^### )", read(PAGES["R"]), re.DOTALL | re.MULTILINE)
    assert set(re.findall(r"^\| `(\w+)` \|", section[0], re.MULTILINE)) == stored


@pytest.mark.parametrize("kind", PAGES)
def test_numbers_are_given_once_and_rise(kind):
    numbers = headings(kind)
    assert numbers
    assert numbers == sorted(set(numbers))


@pytest.mark.parametrize("path", CITING, ids=lambda path: str(path.relative_to(ROOT)))
def test_cited_numbers_exist(path):
    known = {number for kind in PAGES for number in headings(kind)}
    lines = read(path).splitlines()
    wrong = [f"line {n}: {cited}" for n, line in enumerate(lines, 1) for cited in NUMBER.findall(line)]
    assert [line for line in wrong if line.split(": ")[1] not in known] == []


def test_every_table_of_the_schema_cites_its_requirement():
    for text in re.findall(r"^CREATE (?:VIRTUAL )?TABLE .*$", read(ROOT / "schema" / "vpfx.sql"), re.MULTILINE):
        assert re.search(r"-- R-\d{3}: ", text), text


def columns(name):
    """Return table, columns and comment of each line of a schema file that defines columns."""
    found = []
    for table, body in re.findall(
        r"^CREATE (?:VIRTUAL )?TABLE (\w+)[^\n]*\n(.*?)^\)", read(ROOT / "schema" / name), re.DOTALL | re.MULTILINE
    ):
        for line in body.splitlines():
            code, _, comment = line.partition("--")
            names = re.findall(r"(?:^|,)\s*(\w+)", re.sub(r"\([^)]*\)+", "", code))
            if names and names[0] not in ("CONSTRAINT", "PRIMARY"):
                found.append((table, names, comment.strip()))
    return found


@pytest.mark.parametrize("name", SCHEMAS)
def test_every_column_has_a_comment(name):
    bare = [f"{table}.{names[0]}" for table, names, comment in columns(name) if not comment]
    assert bare == []


def test_every_column_is_seen():
    """The two tests beside this one look at all columns: SQLite counts the same ones."""
    connection = sqlite3.connect(":memory:")
    for name in SCHEMAS:
        if name == "layers.sql":
            continue
        connection.executescript(read(ROOT / "schema" / name))
        seen = {}
        for table, names, _ in columns(name):
            seen.setdefault(table, []).extend(names)
        for table, names in seen.items():
            assert [row[1] for row in connection.execute(f"PRAGMA table_info({table})")] == names
    tables = "SELECT count(*) FROM pragma_table_list WHERE schema = 'main' AND type IN ('table', 'virtual')"
    (n_table,) = connection.execute(f"{tables} AND name NOT LIKE 'sqlite_%'").fetchone()
    assert n_table == len({table for name in SCHEMAS for table, _, _ in columns(name)})


def test_page_names_every_table_and_column():
    page = read(PAGES["R"])
    for table, names, _ in columns("vpfx.sql"):
        assert f"`{table}`" in page, table
        missing = [name for name in names if not re.search(rf"\b{name}\b", page)]
        assert missing == [], table


def test_readme_names_every_command():
    readme = read(ROOT / "README.md")
    assert [name for name in app.commands if f"vpfx {name}" not in readme] == []


def test_readme_names_everything_public():
    readme = read(ROOT / "README.md")
    assert [name for name in vpfx.__all__ if not re.search(rf"\b{name}\b", readme)] == []


def options():
    """Return every option of every command."""
    return [
        (name, option)
        for name, command in commands().items()
        for option in command.params
        if isinstance(option, click.Option)
    ]


@pytest.mark.parametrize(("name", "option"), options(), ids=[f"{name} {option.opts[-1]}" for name, option in options()])
def test_every_option_is_in_the_help(name, option):
    command = commands()[name]
    shown = command.get_help(click.Context(command, info_name=f"vpfx {name}"))
    assert option.help
    assert not option.hidden
    assert all(re.search(rf"(?<![\w-]){re.escape(text)}(?![\w-])", shown) for text in option.opts)


def named_options(text):
    """Return what looks like long options of vpfx."""
    return set(re.findall(r"(?<![\w-])--[a-z][a-z-]+\b", text))


def test_named_options_exist():
    """Options in the README, the pages and the messages of vpfx are those of the commands."""
    known = {text for _, option in options() for text in (*option.opts, *option.secondary_opts)} | {
        "--help",
        "--version",
    }
    for path in (ROOT / "README.md", *sorted((ROOT / "specs").glob("*.md"))):
        assert named_options(read(path)) <= known, path.name
    for path in sorted((ROOT / "vpfx").rglob("*.py")):
        texts = [
            node.value
            for node in ast.walk(ast.parse(read(path)))
            if isinstance(node, ast.Constant) and isinstance(node.value, str)
        ]
        assert named_options(" ".join(texts)) <= known, path.name


def test_versions_have_their_entries():
    changes = read(ROOT / "specs" / "CHANGELOG.md")
    project = re.search(r'^version = "(.*)"$', read(ROOT / "pyproject.toml"), re.MULTILINE)
    assert project[1] == vpfx.__version__
    assert re.search(rf"^### Package {re.escape(vpfx.__version__)}\b", changes, re.MULTILINE)
    assert re.search(rf"^### Format {re.escape(FORMAT_VERSION)}\b", changes, re.MULTILINE)
    assert read(PAGES["R"]).startswith(f"# The store, format {FORMAT_VERSION}\n")
    assert f"`format_version` | text | version of this page: `{FORMAT_VERSION}`" in read(PAGES["R"])


def test_glossary_explains_no_term_twice():
    page = read(ROOT / "specs" / "glossary.md")
    cells = re.findall(r"^\| (?!term|-)(.*?) \|", page, re.MULTILINE)
    terms = [term.strip() for cell in cells for term in re.sub(r"\(.*?\)", "", cell).split(",")]
    assert len(cells) > 50
    assert sorted(terms) == sorted(set(terms))


def test_links_between_pages_lead_somewhere():
    for page in [ROOT / "README.md", *sorted((ROOT / "specs").glob("*.md"))]:
        text = read(page)
        anchors = {
            re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
            for heading in re.findall(r"^#+ (.*)$", text, re.MULTILINE)
        }
        for target in re.findall(r"\]\(([^)\s]+)\)", text):
            if target.startswith("#"):
                assert target[1:] in anchors, f"{page.name}: {target}"
            elif "://" not in target:
                assert (page.parent / target).exists(), f"{page.name}: {target}"
        for target in re.findall(r"`((?:specs|vpfx|schema|tests|fixtures|bench)/[\w./]*)`", text):
            assert (ROOT / target).exists(), f"{page.name}: {target}"


@pytest.mark.slow
def test_the_experiment_is_as_told(tmp_path):
    command = [sys.executable, "bench/experiment.py", "-o", str(tmp_path)]
    printed = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True, timeout=300).stdout
    told, _, _ = printed.rpartition("\n\n")
    assert told in read(ROOT / "specs" / "methods.md")
    figures = ["A1_source.png", *(f"A{level + 2}_level_{level}.png" for level in range(4))]
    assert sorted(path.name for path in tmp_path.iterdir()) == figures
