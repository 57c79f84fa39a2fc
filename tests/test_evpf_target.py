"""Where exported databases go: precision, names, what is replaced, what is left after a failure, the command."""

from __future__ import annotations

import errno
import os
import re
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from slow_vpf import rows_of
from surfaces import hills, write_dem
from test_cli import COMPILING, FAILURE, GOOD, INTERRUPTED, USAGE, VPFX

import vpfx
from vpfx.cli import main
from vpfx.errors import InputError, NotFoundError, StoreError, StoreFormatError
from vpfx.evpf import target as targets
from vpfx.evpf import writing
from vpfx.evpf.classes import OWN_CLASSES, cut_names
from vpfx.evpf.joins import Joins
from vpfx.evpf.numbering import EdgeRows, TileNumbers
from vpfx.evpf.planar import Sides
from vpfx.evpf.precision import find_broken
from vpfx.evpf.writing import export_vpf
from vpfx.model import Extent
from vpfx.store.edit import edit_store

NOWHERE = Extent(*[np.nan] * 4)


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    """A store of two levels and four tiles."""
    folder = tmp_path_factory.mktemp("store")
    dem = write_dem(folder / "a.tif", hills(30, 30))
    return vpfx.build(dem, folder / "a.gpkg", max_error=(30, 15), tile_size=15).path


@pytest.fixture
def run(capsys, monkeypatch, tmp_path):
    """Run `vpfx export --to vpf` in an empty folder; return exit code, stdout and stderr."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        with pytest.raises(SystemExit) as ended:
            main(["export", *map(str, arguments), "--to", "vpf"])
        return ended.value.code, *capsys.readouterr()

    return call


def refused(outcome, code, message):
    """Hold that a command ended with a code and one line that says why."""
    found, out, err = outcome
    assert (found, out) == (code, ""), err
    err = err.removeprefix(COMPILING)
    assert re.fullmatch(r"vpfx[^\n]*\n", err), err
    assert re.search(message, err), err


def files_of(folder):
    """Return the bytes of all files in a folder, hidden ones too."""
    return {p.relative_to(folder): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


# --- precision --------------------------------------------------------------------------------------------------------------


def build_at(folder, step, x0=5e5, y0=4e6, heights=None, **options):
    """Build a store of posts so far from each other, metres."""
    dem = write_dem(folder / "a.tif", hills(12, 12) if heights is None else heights, x0=x0, y0=y0, step=step)
    return vpfx.build(dem, folder / "a.gpkg", **{"max_error": (20, 4), **options}).path


def test_posts_nearer_than_single_precision_tells_are_refused(tmp_path):
    path = build_at(tmp_path, 0.1)
    message = r"a\.gpkg: level \d, tile 1: face \d+ at \(50000\d.*, 400000\d.*\) .* precision \(E-201\); give --double"
    with pytest.raises(InputError, match=message):
        export_vpf(path, tmp_path / "vpf")
    assert sorted(os.listdir(tmp_path)) == ["a.gpkg", "a.tif"]
    export_vpf(path, tmp_path / "vpf", is_double=True)
    assert (tmp_path / "vpf" / "dht").is_file()


@pytest.mark.parametrize(("y0", "is_good"), [(4e6, True), (4e6 + 0.25, True), (4e6 + 0.125, False)])
def test_the_edge_of_single_precision(y0, is_good, tmp_path):
    """At 4 000 km north floats lie a quarter of a metre apart: posts on them are kept, posts between them meet."""
    heights = np.random.default_rng(3).integers(0, 9, (9, 9)).astype(float)
    path = build_at(tmp_path, 0.25, y0=y0, heights=heights, method="delaunay_pyramid", max_error=(0.01,))
    if is_good:
        export_vpf(path, tmp_path / "vpf")
        return
    with pytest.raises(InputError, match="has a node in the place of another node in single precision"):
        export_vpf(path, tmp_path / "vpf", overwrite=True)


def test_faces_that_turn_over_are_refused(tmp_path):
    """Breaks between posts make thin faces that rounding turns over though no two nodes meet, where posts lie near."""
    heights = np.random.default_rng(1).uniform(0, 99, (20, 20))
    path = build_at(tmp_path, 0.5, heights=heights, max_error=(30, 10))
    with pytest.raises(InputError, match=r"face \d+ at .* has no area, or turns over in single precision"):
        export_vpf(path, tmp_path / "vpf")
    path = build_at(tmp_path, 30.0, heights=heights, max_error=(30, 10), overwrite=True)
    export_vpf(path, tmp_path / "vpf")


def numbers_of(triangles):
    """Number the edges of some triangles."""
    edges, start, edge = {}, [], []
    for corners in triangles:
        for p, q in zip(corners, (*corners[1:], corners[0]), strict=True):
            start.append(p)
            edge.append(edges.setdefault((min(p, q), max(p, q)), len(edges)))
    sides = Sides(np.array(start), np.array(edge), np.arange(0, len(start) + 1, 3))
    faces = {f"node_{i + 1}": np.array([corners[i] for corners in triangles]) for i in range(3)}
    n_node = 1 + max(start)
    none = np.zeros(0, int)
    rows = EdgeRows(0, 1, len(edges), none, none)
    numbers = TileNumbers(np.arange(n_node), np.arange(len(edges)), rows, faces, sides, (none, none, np.zeros(0)))
    return numbers, np.array(list(edges))


TWO = [(0, 1, 2), (3, 4, 5)]
PLACES = [(0, 0), (4, 0), (0, 4), (8, 8), (4, 8), (8, 4)]
WRONG = {
    "merged": ({3: (4, 0)}, NOWHERE, (0, "has a node in the place of another node")),
    "turned": ({5: (0, 9)}, NOWHERE, (1, "has no area, or turns over")),
    "no area": ({5: (0, 8)}, NOWHERE, (1, "has no area, or turns over")),
    "crossed": ({5: (1, 1)}, NOWHERE, (0, "meets another edge of the outline")),
    "touched": ({5: (2, 2)}, NOWHERE, (0, "meets another edge of the outline")),
    "infinite": ({3: (np.inf, 8)}, NOWHERE, (1, "has no place")),
    "on a border": ({}, Extent(np.nan, np.nan, 8, np.nan), (1, "comes to lie on the border of the tile")),
    "right": ({5: (8, 3.5)}, Extent(np.nan, np.nan, 9, np.nan), None),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_rounding_breaks_is_found(case):
    moved, borders, wanted = WRONG[case]
    numbers, edges = numbers_of(TWO)
    exact = np.array([(x - 0.001, y, 0) for x, y in PLACES], float)
    xyz = np.array([(*moved.get(i, place), 0) for i, place in enumerate(PLACES)], float)
    assert find_broken(xyz, numbers, edges, borders, exact) == wanted


def test_edges_that_come_to_lie_on_each_other_are_found():
    numbers, edges = numbers_of([(0, 1, 2), (0, 3, 4)])
    places = np.array([(0, 0, 0), (4, 0, 0), (4, 4, 0), (3, 3, 0), (0, 4, 0.0)])
    assert find_broken(places, numbers, edges, NOWHERE, places) == (0, "meets another edge of the outline")
    places[3] = (3, 3.5, 0)
    assert find_broken(places, numbers, edges, NOWHERE, places) is None


# --- names ------------------------------------------------------------------------------------------------------------------

BAD = {
    "long name": (["-o", "new_mexico"], USAGE, r"name 'new_mexico', expected 1 to 8 lower-case letters, digits"),
    "upper case": (["-o", "NM"], USAGE, r"name 'NM', expected 1 to 8 lower-case"),
    "lower case": (["-o", "nm", "--upper"], USAGE, r"name 'nm', expected 1 to 8 upper-case"),
    "dots": (["-o", "nm.vpf"], USAGE, r"name 'nm.vpf'"),
    "dcw": (["-o", "mydcw1"], USAGE, r"found 'dcw' in a name"),
    "library": (["-o", "nm", "--library", "my library"], USAGE, r"library: found 'my library', expected 1 to 8"),
    "reserved library": (["-o", "nm", "--library", "lat"], USAGE, r"library: found 'lat'.*none of dht, lat"),
    "product": (["-o", "nm", "--product", "x" * 13], USAGE, r"product: found 'x+', expected 1 to 12"),
    "product that is none": (["-o", "nm", "--product", "N/A"], USAGE, r"product: found 'N/A', which VPF reads as none"),
    "blank product": (["-o", "nm", "--product", " x"], USAGE, r"product: found ' x'"),
    "no folder": (["-o", "nowhere/nm"], FAILURE, r"nowhere/nm: found no folder"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_names_are_refused(case, run, store, tmp_path):
    arguments, code, message = BAD[case]
    refused(run(store, *arguments), code, message)
    assert os.listdir(tmp_path) == []


def test_no_store_no_database(run, tmp_path):
    refused(run("none.gpkg", "-o", "nm"), FAILURE, r"none\.gpkg: found no such file")
    (tmp_path / "a.gpkg").write_text("no database")
    refused(run("a.gpkg", "-o", "nm"), FAILURE, r"a\.gpkg: found no SQLite database")
    assert os.listdir(tmp_path) == ["a.gpkg"]


def test_unknown_format_is_refused(store, tmp_path, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["export", str(store), "--to", "dxf", "-o", str(tmp_path / "nm")])
    assert ended.value.code == USAGE
    assert capsys.readouterr().err == "vpfx: unknown format 'dxf'; known: vpf\n"


def test_paths_longer_than_readers_take_are_refused(store, tmp_path):
    room = 255 - len(os.fsencode(tmp_path / "nm" / "terrain" / "tileref" / "tileref.afx"))
    deep = tmp_path
    for length in (100, room - 101 - 1):
        deep = deep / ("d" * length)
    deep.mkdir(parents=True)
    export_vpf(store, deep / "nm")
    with pytest.raises(InputError, match=r"full paths of 256 bytes, expected up to 255"):
        export_vpf(store, deep / "nm1")
    assert os.listdir(deep) == ["nm"]


def test_names_asked_for_are_written(run, store, tmp_path):
    code, out, err = run(store, "-o", "nm", "--library", "alps", "--product", "Terrain 1")
    assert (code, err.removeprefix(COMPILING)) == (GOOD, "")
    assert re.fullmatch(r"nm: [\d,]+ bytes, 2 levels, 4 tiles, single precision\n", out)
    size = sum(len(data) for data in files_of(tmp_path / "nm").values())
    assert f"{size:,} bytes" in out
    assert rows_of(tmp_path / "nm" / "lat", "library_name") == [("alps",)]
    assert rows_of(tmp_path / "nm" / "alps" / "lht", "product_type", "library_name") == [("Terrain 1", "alps")]
    assert run(store, "-o", "nm2", "--double", "-q")[:2] == (GOOD, "")


def test_readers_are_warned_of(run, store, tmp_path, monkeypatch):
    (tmp_path / "dcw_data").mkdir()
    monkeypatch.setattr(writing, "MOST_SMALL", 10)
    code, out, err = run(store, "-o", "dcw_data/nm")
    assert code == GOOD
    assert out.startswith("dcw_data/nm: ")
    one, other = err.removeprefix(COMPILING).splitlines()
    assert re.fullmatch(r"vpfx: warning: dcw_data/nm: found 'dcw' in the path: OGDI .*", one)
    assert re.fullmatch(r"vpfx: warning: tin\d/0\d/0\d has \d+ primitives of a kind, and \d more tiles; .*", other)


def test_errors_of_a_medium_name_what_was_asked_for(store, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def refuse(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("vpfx.vpf.writer.open", refuse, raising=False)
    with pytest.raises(StoreError, match=r"^nm/dht: cannot be written: No space left"):
        export_vpf(store, "nm")
    assert not [name for name in os.listdir(tmp_path) if "nm" in name]


# --- what is replaced -------------------------------------------------------------------------------------------------------


def test_nothing_is_replaced_unasked(run, store, tmp_path):
    assert run(store, "-o", "nm")[0] == GOOD
    before = files_of(tmp_path)
    refused(run(store, "-o", "nm"), FAILURE, r"nm: found an existing file or folder; give another name or --overwrite")
    assert files_of(tmp_path) == before


def test_a_database_of_vpfx_is_replaced(run, store, tmp_path):
    assert run(store, "-o", "nm", "--double", "--library", "old")[0] == GOOD
    assert run(store, "-o", "nm", "--overwrite")[0] == GOOD
    assert run(store, "-o", "nm2")[0] == GOOD
    new, wanted = (files_of(tmp_path / name) for name in ("nm", "nm2"))
    assert new.keys() == wanted.keys()
    assert {path for path in new if new[path] != wanted[path]} == {Path("dht")}  # has its own name
    assert sorted(os.listdir(tmp_path)) == ["nm", "nm2"]


def test_with_classes_and_upper_case_too(store, tmp_path):
    path = tmp_path / "a.gpkg"
    path.write_bytes(store.read_bytes())
    with edit_store(path) as editor:
        editor.create_class("soil", {"kind": "text"})
        editor.set_faces("soil", [1], editor.add_features("soil", {"kind": ["clay"]}))
        editor.describe_values("soil", "kind", {"clay": "Clay"})
    export_vpf(path, tmp_path / "NM", is_upper=True)
    export_vpf(path, tmp_path / "NM", is_upper=True, overwrite=True)
    assert targets.find_foreign(tmp_path / "NM") is None


def make_file(path):
    path.write_text("mine")


def make_folder(path):
    path.mkdir()
    (path / "letter.txt").write_text("mine")


FOREIGN = {
    "a file": (make_file, "something that is no directory"),
    "an empty folder": (Path.mkdir, "no database that vpfx wrote"),
    "a folder of files": (make_folder, "no database that vpfx wrote"),
    "a link": (lambda path: path.symlink_to(path.parent), "something that is no directory"),
    "a link that leads nowhere": (lambda path: path.symlink_to("gone"), "something that is no directory"),
}


@pytest.mark.parametrize("case", FOREIGN)
def test_nothing_else_is_replaced(case, store, tmp_path):
    make, found = FOREIGN[case]
    make(tmp_path / "nm")
    names = sorted(os.listdir(tmp_path))
    with pytest.raises(StoreError, match=f"nm: found {found}, expected a VPF database of vpfx and nothing else"):
        export_vpf(store, tmp_path / "nm", overwrite=True)
    assert sorted(os.listdir(tmp_path)) == names
    assert os.path.lexists(tmp_path / "nm")


@pytest.mark.parametrize(
    "place",
    ["letter.txt", "terrain/letter.txt", "terrain/tin0/letter.txt", "terrain/tin0/00/letter.txt", "terrain/tin0/00/00/letter",
     "other/dht", "terrain/tin0/00/00/sub/cnd", "terrain/libref/00/00/cnd"],
)  # fmt: skip
def test_what_people_put_beside_stays(place, store, tmp_path):
    export_vpf(store, tmp_path / "nm")
    file = tmp_path / "nm" / place
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text("mine")
    before = files_of(tmp_path)
    with pytest.raises(StoreError, match=r"nm: found [\w/.]+, expected a VPF database of vpfx and nothing else"):
        export_vpf(store, tmp_path / "nm", overwrite=True)
    assert files_of(tmp_path) == before


def test_a_database_of_others_stays(store, tmp_path):
    export_vpf(store, tmp_path / "nm")
    dht = tmp_path / "nm" / "dht"
    dht.write_bytes(dht.read_bytes().replace(b"vpfx ", b"them "))
    with pytest.raises(StoreError, match="a database of another producer"):
        export_vpf(store, tmp_path / "nm", overwrite=True)
    dht.write_bytes(dht.read_bytes()[:50])
    with pytest.raises(StoreError, match="no database that vpfx wrote"):
        export_vpf(store, tmp_path / "nm", overwrite=True)


@pytest.mark.parametrize("place", [".", "terrain/tin0"])
def test_what_cannot_be_read_stays(place, store, tmp_path, monkeypatch):
    export_vpf(store, tmp_path / "nm")
    closed, scan, names_of = str(tmp_path / "nm" / place), os.scandir, os.listdir

    def refuse(read):
        def call(path="."):
            if str(path) == closed:
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), closed)
            return read(path)

        return call

    monkeypatch.setattr(os, "scandir", refuse(scan))
    monkeypatch.setattr(os, "listdir", refuse(names_of))
    with pytest.raises(StoreError, match=r"nm: found something that cannot be read \(Permission denied\), expected"):
        export_vpf(store, tmp_path / "nm", overwrite=True)
    monkeypatch.undo()
    assert sorted(os.listdir(tmp_path)) == ["nm"]


# --- failures ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("error", [KeyboardInterrupt, StoreFormatError("a", "b", "c"), MemoryError])
def test_a_failure_leaves_what_was_there(error, store, tmp_path, monkeypatch):
    export_vpf(store, tmp_path / "nm")
    before = files_of(tmp_path)

    def fail(*_):
        raise error

    monkeypatch.setattr(writing._Writer, "_write_related", fail)
    with pytest.raises(error if isinstance(error, type) else type(error)):
        export_vpf(store, tmp_path / "nm", overwrite=True, is_double=True)
    assert files_of(tmp_path) == before
    assert os.listdir(tmp_path) == ["nm"]


def test_a_place_that_is_taken_meanwhile_stays(store, tmp_path, monkeypatch):
    original = writing._Writer.write_levels

    def and_take(self, *arguments):
        original(self, *arguments)
        (tmp_path / "nm").mkdir()

    monkeypatch.setattr(writing._Writer, "write_levels", and_take)
    with pytest.raises(StoreError, match="found an existing file or folder"):
        export_vpf(store, tmp_path / "nm")
    assert os.listdir(tmp_path) == ["nm"]
    assert os.listdir(tmp_path / "nm") == []


def test_a_medium_that_refuses_is_told(store, tmp_path):
    (tmp_path / "closed").mkdir(mode=0o500)
    if os.access(tmp_path / "closed", os.W_OK):
        pytest.skip("nothing is closed to this user")
    with pytest.raises(StoreError, match="cannot be made"):
        export_vpf(store, tmp_path / "closed" / "nm")


def test_joins_find_room_before_they_are_sorted(tmp_path, monkeypatch):
    """A file that is mapped before it has room on the medium ends the process where there is none."""
    sizes, memmap = [], np.memmap
    monkeypatch.setattr(
        np, "memmap", lambda path, *rest, **given: sizes.append(os.path.getsize(path)) or memmap(path, *rest, **given)
    )
    with Joins(tmp_path / "joins", 3) as joins:
        joins.append(np.array([2, 0, 2]), np.array([0.25, 1.0, 0.5]), 7, np.array([2, 3, 3]))
        rows = []
        joins.write(SimpleNamespace(append=rows.append), "soil_id")
    assert sizes == [3 * (4 + 8 + 2 + 4)]
    assert [rows[0][name].tolist() for name in rows[0]] == [[1, 2, 3], [1, 3, 3], [1.0, 0.25, 0.5], [7] * 3, [3, 2, 3]]
    assert os.listdir(tmp_path) == []


def test_joins_without_room_are_told(tmp_path):
    resource = pytest.importorskip("resource", reason="this system has no limits for files")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        with Joins(tmp_path / "joins", 1) as joins:
            joins.append(np.zeros(100, int), np.ones(100), 1, np.arange(100))
            with pytest.raises(StoreError, match="joins: cannot be written"):
                joins.write(SimpleNamespace(), "soil_id")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert os.listdir(tmp_path) == []


BROKEN = {
    "UPDATE edge SET left_face = CASE left_face WHEN 1 THEN 2 ELSE 1 END WHERE edge_id = (SELECT max(edge_2) FROM face "
    "WHERE face_id < 4)": "R-160",
    "UPDATE edge SET left_face = NULL WHERE edge_id = (SELECT max(edge_id) FROM edge)": "R-160",
    "UPDATE face SET node_2 = node_3, node_3 = node_2 WHERE face_id = 1": "R-1[67]0",
    "UPDATE face SET edge_1 = edge_2 WHERE face_id = 1": "R-1[37][02]",
    "UPDATE metadata SET value = json_set(value, '$.n_row', 1000000000000) WHERE name = 'lattice'": "found 4 rows, expected",
    "UPDATE metadata SET value = json_set(value, '$.n_row', 1.5) WHERE name = 'lattice'": "no lattice of posts.*R-110",
    "UPDATE metadata SET value = '{}' WHERE name = 'options'": "no lattice of posts.*R-110",
    "UPDATE metadata SET value = json_remove(value, '$.dx') WHERE name = 'lattice'": "no lattice of posts.*R-110",
    "UPDATE metadata SET value = json_set(value, '$.dy', 'wide') WHERE name = 'lattice'": "no lattice of posts.*R-110",
    "UPDATE tile_level SET first_face = 900 WHERE tile_id = 2 AND level = 1": "R-132",
    "UPDATE tile_level SET last_edge = 4000000000000000000 WHERE tile_id = 2 AND level = 1": "R-132",
    "UPDATE tile_level SET last_edge = 0 WHERE tile_id = 2 AND level = 1": "range of edges of level 1 that is none.*R-132",
    "UPDATE tile_level SET last_edge = x'00' WHERE tile_id = 2 AND level = 1": "R-1[03]2",
    "UPDATE tile SET xmin = '' WHERE tile_id = 1": "R-1[03][02]",
    "DELETE FROM parent_child WHERE child_face = (SELECT max(face_id) FROM face)": "R-180",
    "UPDATE edge SET right_edge = 999999999 WHERE edge_id = (SELECT max(edge_id) FROM edge)": "R-132",
    "DELETE FROM node WHERE node_id = (SELECT max(node_id) FROM node)": "node",
}


def assert_told(path, change, errors, message, **options):
    """Hold that the export of a store in its own folder is refused after a change, and leaves nothing behind."""
    with closing(sqlite3.connect(path)) as database:
        database.execute("PRAGMA ignore_check_constraints = ON")
        database.execute(change)
        database.commit()
    with pytest.raises(errors, match=message):
        export_vpf(path, path.with_name("nm"), **options)
    assert os.listdir(path.parent) == ["a.gpkg"]


@pytest.mark.parametrize("change", BROKEN)
def test_a_store_that_is_broken_is_told(change, store, tmp_path):
    path = shutil.copyfile(store, tmp_path / "a.gpkg")
    assert_told(path, change, (StoreFormatError, NotFoundError), BROKEN[change], is_double=True)


BROKEN_CLASS = {
    "UPDATE soil SET code = 'many'": "table soil: column code: found 'many', expected an integer.*R-221",
    "UPDATE soil SET depth = x'00'": "table soil: column depth: .*R-221",
    "UPDATE soil SET day = 3": "table soil: column day: found '3', expected a date.*R-221",
    "UPDATE value_description SET column_name = 'height'": "table value_description: .*R-222",
    "UPDATE feature_class SET description = x'00'": "class soil: found a description that is no text.*R-220",
    "UPDATE feature_column SET unit = x'00'": "class soil: found a description that is no text.*R-220",
    "UPDATE value_description SET value = x'00'": "table value_description: .*R-222",
}


@pytest.mark.parametrize("change", BROKEN_CLASS)
def test_attributes_that_are_broken_are_told(change, store, tmp_path):
    path = tmp_path / "a.gpkg"
    path.write_bytes(store.read_bytes())
    with edit_store(path) as editor:
        editor.create_class("soil", {"code": "integer", "depth": "real", "day": "date"})
        editor.add_features("soil", {"code": [1], "depth": [0.5], "day": ["1998-12-01"]})
        editor.describe_values("soil", "code", {1: "deep"})
    assert_told(path, change, StoreFormatError, BROKEN_CLASS[change])


@pytest.mark.parametrize("level", [0, 1])
def test_features_that_are_not_there_are_told(level, store, tmp_path):
    path = tmp_path / "a.gpkg"
    path.write_bytes(store.read_bytes())
    with edit_store(path) as editor:
        editor.create_class("soil", {"kind": "text"})
    with closing(sqlite3.connect(path)) as database:
        (face,) = database.execute("SELECT min(face_id) FROM face WHERE level = ?", (level,)).fetchone()
        database.execute(
            "INSERT INTO face_feature VALUES (?, ?, 5, 0.5)", (face, 1 + level)
        )  # no such feature, or class
        database.commit()
    with pytest.raises(StoreFormatError, match="R-224"):
        export_vpf(path, tmp_path / "nm", is_double=True)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT for another process")
def test_an_interrupted_export_leaves_nothing(tmp_path):
    dem = write_dem(tmp_path / "a.tif", hills(80, 80))
    path = vpfx.build(dem, tmp_path / "a.gpkg", max_error=(30, 15), tile_size=8).path  # 200 tiles
    (tmp_path / "out").mkdir()
    command = [*VPFX, "export", str(path), "--to", "vpf", "-o", "nm"]
    process = subprocess.Popen(command, cwd=tmp_path / "out", stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while not os.listdir(tmp_path / "out") and process.poll() is None:
        time.sleep(0.005)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=120)
    assert (process.returncode, out) == (INTERRUPTED, ""), err
    assert err.removeprefix(COMPILING).strip() == "vpfx: interrupted; nothing was changed"
    assert os.listdir(tmp_path / "out") == []


def test_progress_counts_tiles_of_all_levels(store, tmp_path):
    seen = []
    export_vpf(store, tmp_path / "nm", progress=lambda done, total: seen.append((done, total)))
    assert seen == [(i, 8) for i in range(1, 9)]


def test_names_of_devices_are_taken():
    """Windows makes no `aux.aft`."""
    names = ["aux", "Con".lower(), "com1", "lpt9", "auxiliary", "common"]
    assert cut_names(names, 8, OWN_CLASSES) == ["aux01", "con01", "com101", "lpt901", "auxiliar", "common"]
