"""Directories of VPF: made-up databases with every deviation, names that lead elsewhere, layouts, real data."""

from __future__ import annotations

import os
import re
import shutil

import numpy as np
import pytest
from conftest import shared_vpf
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from small_vpf import FORWARD, JOINED, make_database, put, put_cat, put_lat, put_tiles

from vpfx.errors import InputError, NotFoundError, VpfFormatError
from vpfx.vpf import layouts, schema
from vpfx.vpf.catalog import open_database
from vpfx.vpf.header import Column, Layout, check_layout
from vpfx.vpf.listing import list_database, list_lines
from vpfx.vpf.opening import open_coverages
from vpfx.vpf.paths import check_name, find, split
from vpfx.vpf.schema import FeatureClass, Join
from vpfx.vpf.table import open_table, read_table, write_table
from vpfx.vpf.values import texts

TEXASH = "vm2alv2_texash"


def renamed(layout, names):
    """A layout with other names of columns."""
    return layout._replace(columns=tuple(c._replace(name=names.get(c.name, c.name)) for c in layout.columns))


def typed(layout, kinds):
    """A layout with other types of columns."""
    return layout._replace(columns=tuple(c._replace(kind=kinds.get(c.name, c.kind)) for c in layout.columns))


def without(layout, *names):
    """A layout without some columns."""
    return layout._replace(columns=tuple(c for c in layout.columns if c.name not in names))


@pytest.fixture
def root(tmp_path):
    """A database of one library with two tiles and two classes."""
    return make_database(tmp_path / "base")


def test_made_up_database(root):
    database = open_database(root)
    assert (database.name, database.header, database.missing) == ("base", {}, ())
    library = database.libraries["north"]
    assert library.extent == (7, 46, 9, 48)
    assert (library.missing, library.reference) == ((), {})
    assert {i: (tile.path, tile.extent) for i, tile in library.tiles.items()} == {
        1: ("07/01", (8, 47, 9, 48)),
        2: ("07/02", (9, 48, 10, 49)),
    }
    coverage = library.coverages["road"]
    assert (coverage.description, coverage.level, coverage.problems) == ("About roads", 3, {})
    assert coverage.classes == {
        "roadl": FeatureClass("roadl", "L", "roadl.lft", "edg", "edg_id", None, "Roads"),
        "lakea": FeatureClass(
            "lakea", "A", "lakea.aft", "fac", "fac_id", Join("lakea.ajt", "lakea_id", "fac_id"), "Lakes"
        ),
    }
    assert coverage.table("FAC", 2) == root / "north" / "road" / "07" / "02" / "fac"
    assert coverage.find("lakea.aft") is None
    with pytest.raises(NotFoundError, match=r"found no table 'lakea\.aft'"):
        coverage.table("lakea.aft")
    with pytest.raises(NotFoundError, match=r"tile 1: found no table 'edg'"):
        coverage.table("edg", 1)
    with pytest.raises(NotFoundError, match="found no tile 3"):
        coverage.table("edg", 3)


def test_one_library_alone(root):
    put_lat(root, ("north", "south"))
    database = open_database(root / "north")
    assert list(database.libraries) == ["north"]
    assert database.libraries["north"].extent == (7, 46, 9, 48)
    assert database.path == root.resolve()
    (root / "lat").unlink()
    library = open_database(root / "north").libraries["north"]
    assert (library.name, library.extent) == ("north", None)
    assert "roadl" in library.coverages["road"].classes


@pytest.mark.parametrize("where", ["", "base/north/road"])
def test_no_database_there(root, where):
    with pytest.raises(NotFoundError, match="found neither lat nor cat"):
        open_database(root.parent / where)


def test_what_the_disc_lacks_is_missing(root):
    """Deviations 11 and 7: libraries and coverages listed, but not there; a file is no directory."""
    put_lat(root, ("south", "north", "NORTH", "west"))
    put_cat(root / "north", ("hydro", "road", "veg", "road"))
    (root / "west").write_bytes(b"")
    database = open_database(root)
    assert database.missing == ("south", "west")
    assert list(database.libraries) == ["north"]
    assert database.libraries["north"].missing == ("hydro", "veg")
    assert list(database.libraries["north"].coverages) == ["road"]


def test_library_without_cat(root):
    (root / "north" / "cat").unlink()
    library = open_database(root).libraries["north"]
    with pytest.raises(NotFoundError, match="found no table cat"):
        _ = library.coverages
    assert len(library.tiles) == 2


def test_names_in_capitals_with_dots(root, tmp_path):
    """Deviation 9, mixed: every directory and every second table in capitals, some with a dot behind."""
    other = tmp_path / "CAPITALS"
    shutil.copytree(root, other)
    for i, path in enumerate(sorted(other.rglob("*"), reverse=True)):
        name = path.name if path.is_file() and i % 2 else path.name.upper()
        dot = "." if path.is_file() and "." not in name and not name.lower().endswith("x") and i % 3 else ""
        path.rename(path.with_name(name + dot))
    assert {path.name for path in other.iterdir()} & {"LAT", "LAT.", "lat."}
    plain, capital = (open_database(path).libraries["north"] for path in (root, other))
    assert capital.tiles == plain.tiles
    for name, coverage in capital.coverages.items():
        assert coverage.classes == plain.coverages[name].classes
    path = capital.coverages["road"].table("fac", 2)
    assert read_table(path).n_row == 1
    assert path.relative_to(other).as_posix().upper().rstrip(".") == "NORTH/ROAD/07/02/FAC"


@pytest.mark.parametrize(
    "rows", [FORWARD + JOINED, (FORWARD + JOINED)[::-1], JOINED[::-1] + FORWARD, 2 * JOINED + 2 * FORWARD]
)
def test_order_of_relations(root, rows):
    """Reverse relations first, and classes that stand there twice (deviation 7)."""
    path = root / "north" / "road" / "fcs"
    put(path, layouts.FCS, rows)
    classes, problems = schema.classes_of(schema.read_relations(path), {})
    assert problems == {}
    assert sorted(classes) == ["lakea", "roadl"]
    assert classes["roadl"][1:5] == ("L", "roadl.lft", "edg", "edg_id")
    assert classes["lakea"].join == Join("lakea.ajt", "lakea_id", "fac_id")


def test_class_on_two_tables_of_primitives(root):
    rows = [
        ("towerp", "towerp.pft", "end_id", "end", "id"),
        ("towerp", "towerp.pft", "cnd_id", "cnd", "id"),
        ("towerp", "other.pft", "end_id", "end", "id"),
    ]
    path = root / "north" / "road" / "fcs"
    put(path, layouts.FCS, rows)
    classes, _ = schema.classes_of(schema.read_relations(path), {})
    assert {key: (found.table, found.primitive) for key, found in classes.items()} == {
        "towerp": ("towerp.pft", "end"),
        "towerp:cnd": ("towerp.pft", "cnd"),
        "towerp:end": ("other.pft", "end"),
    }


def test_relations_that_lead_nowhere(root):
    """Related tables and complex features; a class of which only the way back is told."""
    rows = [
        *FORWARD,
        ("roadl", "roadl.lft", "sym", "symbol.rat", "id"),
        ("netc", "netc.cft", "id", "roadl.lft", "net_id"),
        ("lostp", "end", "id", "lostp.pft", "end_id"),
    ]
    put(root / "north" / "road" / "fcs", layouts.FCS, rows)
    coverage = open_database(root).libraries["north"].coverages["road"]
    assert sorted(coverage.classes) == ["netc", "roadl"]
    assert coverage.classes["netc"][1:4] == ("C", "netc.cft", "")
    assert list(coverage.problems) == ["lostp", "lakea"]
    assert "class 'lostp': found no relation to primitives" in coverage.problems["lostp"]


def test_old_names_of_columns(root):
    """Deviations 7, 8: fcs of 1992, fca with a description; 4: an index called fcx."""
    folder = root / "north" / "road"
    put(folder / "fcs", renamed(layouts.FCS, {"table1_key": "foreign_key", "table2_key": "primary_key"}), FORWARD)
    fca = renamed(layouts.fca(), {"descr": "description"})
    put(folder / "fca", fca, [("ROADL", "l", "Old roads")])
    coverage = open_database(root).libraries["north"].coverages["road"]
    assert coverage.classes["roadl"][:5] == ("roadl", "L", "roadl.lft", "edg", "edg_id")
    assert coverage.classes["roadl"].description == "Old roads"


def test_missing_schema(root):
    """Deviation 7: a coverage of cat that has no fcs."""
    (root / "north" / "road" / "fcs").unlink()
    coverage = open_database(root).libraries["north"].coverages["road"]
    assert coverage.classes == {}
    assert "found no table fcs" in coverage.problems[""]
    assert len(coverage.problems) == 3


def test_broken_schema_hides_no_other(root):
    (root / "north" / "road" / "fcs").write_bytes(b"rubbish")
    library = open_database(root).libraries["north"]
    with pytest.raises(VpfFormatError, match="fcs"):
        _ = library.coverages["road"].classes
    assert "tileref" in library.coverages["tileref"].classes


@pytest.mark.parametrize(
    ("layout", "level"),
    [
        (typed(layouts.CAT, {"level": "S"}), 3),
        (without(layouts.CAT, "level"), None),
        (typed(layouts.CAT, {"description": "L"}), 3),
    ],
)
def test_other_columns_of_cat(root, layout, level):
    """Deviation 6."""
    names = [column.name for column in layout.columns]
    rows = [("road", "Straßen" if layout.columns[2].kind == "L" else "Roads", 3)[: len(names) - 1]]
    put(root / "north" / "cat", layout, rows)
    coverage = open_database(root).libraries["north"].coverages["road"]
    assert (coverage.level, coverage.description) == (level, rows[0][1])


def test_levels_that_are_null(root):
    put(root / "north" / "cat", layouts.CAT, [("road", None, None)])
    coverage = open_database(root).libraries["north"].coverages["road"]
    assert (coverage.level, coverage.description) == (None, "")


def test_rectangles_in_double_precision(root):
    """Deviation 5, and LAT alike."""
    double = dict.fromkeys(("xmin", "ymin", "xmax", "ymax"), "R")
    put_lat(root, layout=typed(layouts.LAT, double))
    put(root / "north" / "tileref" / "fbr", typed(layouts.FBR, double), [(0.1, 0.2, 0.3, 0.4)] * 3)
    library = open_database(root).libraries["north"]
    assert library.tiles[2].extent == (0.1, 0.2, 0.3, 0.4)
    assert library.extent == (7, 46, 9, 48)


def test_key_column_that_is_not_the_id(root):
    """As real data have it; nothing hangs on the key letter or on the place of columns."""
    key = [column._replace(key="P" if column.name == "library_name" else "N") for column in layouts.LAT.columns]
    put_lat(root, layout=layouts.LAT._replace(columns=tuple(key)))
    assert open_database(root).libraries["north"].extent == (7, 46, 9, 48)


@pytest.mark.parametrize(
    ("names", "layout", "tiles"),
    [
        (["F/J/1", r"\ ".strip(), None, r"A\B "], layouts.TILEREF, {1: ("F/J/1", 8), 4: ("A/B", 11)}),
        ([r"A\1", r"A\2"], without(layouts.TILEREF, "fac_id"), {1: ("A/1", 7), 2: ("A/2", 8)}),
        ([r"\A\1".strip("\\"), "A/2/"], typed(layouts.TILEREF, {"fac_id": "S"}), {1: ("A/1", 8), 2: ("A/2", 9)}),
    ],
)
def test_odd_tile_references(root, names, layout, tiles):
    """Deviation 10: slashes, blank names, no column of faces."""
    put_tiles(root / "north", names, layout)
    path = root / "north" / "tileref" / "tileref.aft"
    path.write_bytes(path.read_bytes() + b"\n")
    found = open_database(root).libraries["north"].tiles
    assert {i: (tile.path, tile.extent.min_x) for i, tile in found.items()} == tiles


def test_tiles_without_rectangles_and_beyond_them(root):
    folder = root / "north" / "tileref"
    put(folder / "fbr", layouts.FBR, [(0, 0, 1, 1)] * 2)
    assert [tile.extent for tile in open_database(root).libraries["north"].tiles.values()] == [(0, 0, 1, 1), None]
    (folder / "fbr").unlink()
    (folder / "fcs").unlink()
    assert [tile.extent for tile in open_database(root).libraries["north"].tiles.values()] == [None, None]
    (folder / "tileref.aft").unlink()
    assert open_database(root).libraries["north"].tiles == {}
    shutil.rmtree(folder)
    assert open_database(root).libraries["north"].tiles == {}


def test_tiles_that_are_not_on_the_disc(root):
    shutil.rmtree(root / "north" / "road" / "07" / "02")
    coverage = open_database(root).libraries["north"].coverages["road"]
    assert coverage.find("fac", 2) is None
    assert coverage.find("fac", 1) is not None


def test_empty_tables(root):
    """Deviation 12."""
    put(root / "lat", layouts.LAT, [])
    assert open_database(root).libraries == {}
    put_lat(root)
    put(root / "north" / "cat", layouts.CAT, [])
    put(root / "north" / "grt", layouts.GRT, [])
    library = open_database(root).libraries["north"]
    assert (library.coverages, library.missing, library.reference) == ({}, (), {})


def test_headers_are_dictionaries(root):
    """Deviation 20: columns of other widths."""
    dht = layouts.DHT._replace(
        columns=tuple(c._replace(count=4) if c.name == "media_volumes" else c for c in layouts.DHT.columns)
    )
    row = [None] * (len(dht.columns) - 1)
    row[1], row[6] = "base_1", "0001"
    put(root / "dht", dht, [tuple(row)])
    database = open_database(root)
    assert database.name == "base_1"
    assert database.header["media_volumes"] == "0001"
    assert database.header["originator"] is None


def test_value_descriptions(root):
    folder = root / "north" / "road"
    short = typed(layouts.INT_VDT, {"value": "S"})
    put(
        folder / "int.vdt",
        short,
        [("ROADL.LFT", "ACC", 1, "Good"), ("roadl.lft", "acc", 1, "Again"), ("roadl.lft", "acc", 2, "Bad")],
    )
    put(
        folder / "char.vdt",
        layouts.char_vdt(5),
        [("roadl.lft", "f_code", "AP030", "Road"), ("roadl.lft", "acc", "x", "Odd")],
    )
    assert open_database(root).libraries["north"].coverages["road"].value_descriptions == {
        ("roadl.lft", "acc"): {1: "Good", 2: "Bad", "x": "Odd"},
        ("roadl.lft", "f_code"): {"AP030": "Road"},
    }
    put(folder / "int.vdt", without(layouts.INT_VDT, "value"), [("a", "b", "c")])
    with pytest.raises(VpfFormatError, match=r"int\.vdt: column 'value'"):
        _ = open_database(root).libraries["north"].coverages["road"].value_descriptions


def test_number_of_rows_is_bounded(root, monkeypatch):
    monkeypatch.setattr(schema, "MOST_ROWS", 3)
    monkeypatch.setattr(schema.read_bounded, "__defaults__", (3,))
    with pytest.raises(VpfFormatError, match="found 6 rows, expected at most 3"):
        _ = open_database(root).libraries["north"].coverages["road"].classes


def test_tiles_without_a_number(root):
    """Tile 0 is the coverage itself."""
    put_tiles(root / "north")
    path = root / "north" / "tileref" / "tileref.aft"
    first = read_table(path).columns["id"]
    assert first.tolist() == [1, 2]
    write_table(path, layouts.TILEREF, {"id": [0, 2], "tile_name": [r"07\01", r"07\02"], "fac_id": [2, 3]})
    library = open_database(root).libraries["north"]
    assert list(library.tiles) == [2]
    (line,) = library.problems
    assert line.endswith("tileref.aft: row 1: found the id 0, expected 1 to 2147483647 (V-206); it is no tile")


def test_classes_with_control_characters(root):
    path = root / "north" / "road" / "fcs"
    path.write_bytes(path.read_bytes().replace(b"roadl   ", b"ro\x1b[0m  ", 1))
    with pytest.raises(VpfFormatError, match=r"fcs: row 1: found the class 'ro\\x1b\[0m', expected a name without"):
        _ = open_database(root).libraries["north"].coverages["road"].classes


def test_a_library_in_its_database(root):
    """One directory with lat and cat: a coverage of it is opened all the same."""
    put(root / "cat", layouts.CAT, [("road", "Roads", 3)])
    shutil.copytree(root / "north" / "road", root / "road")
    (coverage,) = open_coverages(root / "road").coverages
    assert (coverage.level, coverage.library.path) == (3, root.resolve())


@pytest.mark.parametrize("read", [open_database, open_coverages, open_table])
def test_names_that_are_too_long(read):
    with pytest.raises(NotFoundError):
        read("a" * 300)


def test_columns_that_are_no_numbers(root):
    put_tiles(root / "north", layout=typed(layouts.TILEREF, {"fac_id": "F"}))
    with pytest.raises(VpfFormatError, match=r"tileref\.aft: column 'fac_id': found type F,1, expected I or S or K"):
        _ = open_database(root).libraries["north"].tiles
    put_cat(root / "north", layout=renamed(layouts.CAT, {"coverage_name": "name"}))
    with pytest.raises(VpfFormatError, match="cat: column 'coverage_name'"):
        _ = open_database(root).libraries["north"].coverages


# Names that lead elsewhere -------------------------------------------------------------------------------------------

ESCAPES = ["..", "../x", r"..\x", "/etc", "\\etc", "C:x", "a\0b", "a\nb", "a\x85b", "."]


@pytest.mark.parametrize("name", [name for name in ESCAPES if len(name) <= 8])
def test_libraries_and_coverages_that_lead_elsewhere(root, name):
    put_lat(root, ["north", name], typed(layouts.LAT, {"library_name": "L"}))
    with pytest.raises(VpfFormatError, match="lat: row 2: found the name"):
        open_database(root)
    put_lat(root)
    put_cat(root / "north", ["road", name], typed(layouts.CAT, {"coverage_name": "L"}))
    with pytest.raises(VpfFormatError, match="cat: row 2: found the name"):
        _ = open_database(root).libraries["north"].coverages


@pytest.mark.parametrize("name", ESCAPES)
@pytest.mark.parametrize("column", ["table1", "table2"])
def test_tables_that_lead_elsewhere(root, name, column):
    layout = typed(layouts.FCS, {column: "L"})
    row = ["roadl", "roadl.lft", "edg_id", "edg", "id"]
    row[1 if column == "table1" else 3] = name
    put(root / "north" / "road" / "fcs", layout, [*FORWARD, tuple(row)])
    coverage = open_database(root).libraries["north"].coverages["road"]
    with pytest.raises(VpfFormatError, match="fcs: row 3: found the name"):
        _ = coverage.classes
    for ask in (coverage.find, coverage.table):
        with pytest.raises(VpfFormatError, match="V-202"):
            ask(name)


@pytest.mark.parametrize(
    "name", ["..", r"a\..\..\..\b", "/etc/passwd", r"\\host\share", "C:\\x", "a\0b", "a/" * 40 + "b", "x" * 300]
)
def test_tiles_that_lead_elsewhere(root, name):
    put_tiles(root / "north", [r"07\01", name], typed(layouts.TILEREF, {"tile_name": "L"}))
    library = open_database(root).libraries["north"]
    assert {number: tile.path for number, tile in library.tiles.items()} == {1: "07/01"}
    (problem,) = library.problems
    assert re.search(r"tileref\.aft: row 2: found the name .* \(V-202\); it is no tile$", problem)
    assert list_database(open_database(root))["libraries"][0]["problems"] == [problem]
    with pytest.raises(NotFoundError, match="found no tile 2"):
        library.coverages["road"].table("edg", 2)


def test_links_out_of_the_database(root, tmp_path):
    outside = tmp_path / "outside"
    shutil.copytree(root / "north", outside / "north")
    shutil.rmtree(root / "north" / "road")
    (root / "north" / "road").symlink_to(outside / "north" / "road")
    with pytest.raises(VpfFormatError, match="found a link out of the directory"):
        _ = open_database(root).libraries["north"].coverages
    (root / "north" / "road").unlink()
    shutil.copytree(outside / "north" / "road", root / "north" / "road")
    coverage = open_database(root).libraries["north"].coverages["road"]
    (coverage.path / "int.vdt").symlink_to(outside / "north" / "cat")
    (coverage.path / "edg").symlink_to(root / "north" / "cat")
    (coverage.path / "loop").symlink_to("loop")
    for name in ("int.vdt", "INT.VDT", "loop"):
        with pytest.raises(VpfFormatError):
            coverage.find(name)
    assert coverage.find("edg") is not None, "a link within the database is followed"


def test_pipes_are_not_opened(root):
    os.mkfifo(root / "north" / "road" / "int.vdt")
    with pytest.raises(VpfFormatError, match="found a device or a pipe"):
        _ = open_database(root).libraries["north"].coverages["road"].value_descriptions


@settings(max_examples=200, deadline=None)
@given(st.text(max_size=40) | st.text("./\\: aB\0", max_size=12))
def test_no_name_leaves_the_directory(name):
    """Whatever the text: refused, or names that stay below."""
    try:
        parts = split(name)
    except VpfFormatError:
        return
    depth = os.path.normpath(os.path.join("root", *parts)).split(os.sep)
    assert depth[0] == "root"
    assert len(depth) == len(parts) + 1
    assert all(check_name(part) == part for part in parts)


def test_spellings(tmp_path):
    for name in ("EDG", "edg.", "Fac.", "fac", "RNG.", "Txt", "TXT"):
        (tmp_path / name).write_bytes(b"")
    found = {name: find(tmp_path, name) for name in ("edg", "EDG.", "FAC", "rng", "txt", "Txt", "cnd", "edg/x")}
    assert {name: path and path.name for name, path in found.items()} == {
        "edg": "EDG", "EDG.": "EDG", "FAC": "fac", "rng": "RNG.", "txt": "TXT", "Txt": "Txt", "cnd": None, "edg/x": None,
    }  # fmt: skip
    (tmp_path / "cnd").write_bytes(b"")
    assert find(tmp_path, "CND").name == "cnd", "what was not there is looked for anew"
    assert find(tmp_path) == tmp_path
    assert find(tmp_path / "none", "cnd") is None


# Layouts -------------------------------------------------------------------------------------------------------------


def shape(layout):
    """Names, types and counts of the columns."""
    return [f"{c.name} {c.kind},{'*' if c.count == -1 else c.count}" for c in layout.columns]


TEXT_CLASS = [Column("f_code", "T", 5), Column("symbol_id", "S")]
LAYOUTS = [getattr(layouts, name) for name in layouts.__all__ if isinstance(getattr(layouts, name), Layout)] + [
    layouts.char_vdt(5), layouts.fca(), layouts.fca(30), layouts.fit(is_tiled=True), layouts.fit(is_tiled=False),
    *(layouts.edg(kind) for kind in layouts.COORDINATES), layouts.cnd("C", is_tiled=False),
    layouts.cnd("Y", is_tiled=True), *(layouts.feature("A", [], name, is_tiled=True) for name in layouts.PRIMITIVES),
    layouts.join("A", "a_id", "fac", is_tiled=False),
]  # fmt: skip


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.description)
def test_layouts_are_taken_by_every_reader(layout):
    check_layout(layout)
    assert layout.columns[0][:4] == ("id", "I", 1, "P")
    assert all(column.description for column in layout.columns)
    assert all(column.name == column.name.lower() for column in layout.columns)


def test_layouts_of_primitives():
    assert shape(layouts.edg("Z")) == [
        "id I,1", "start_node I,1", "end_node I,1", "right_face K,1", "left_face K,1", "right_edge K,1", "left_edge K,1",
        "coordinates Z,*",
    ]  # fmt: skip
    assert shape(layouts.cnd("Y", is_tiled=True)) == ["id I,1", "first_edge K,1", "coordinate Y,1"]
    assert shape(layouts.cnd("C", is_tiled=False)) == ["id I,1", "first_edge I,1", "coordinate C,1"]
    assert shape(layouts.FBR) == ["id I,1", "xmin F,1", "ymin F,1", "xmax F,1", "ymax F,1"]
    assert shape(layouts.RNG) == ["id I,1", "face_id I,1", "start_edge I,1"]
    assert shape(layouts.TILEREF) == ["id I,1", "tile_name T,*", "fac_id I,1"]
    feature = layouts.feature("Faces", [Column("f_code", "T", 5)], "fac", is_tiled=True)
    assert shape(feature) == ["id I,1", "f_code T,5", "tile_id S,1", "fac_id I,1"]
    assert shape(layouts.feature("Lakes", [], "", is_tiled=True)) == ["id I,1"]


@pytest.mark.parametrize("kind", ["", "CZ", "F", "c"])
def test_coordinates_that_are_none(kind):
    with pytest.raises(InputError, match="found coordinates of type"):
        layouts.edg(kind)


def test_primitive_that_is_none():
    with pytest.raises(InputError, match="found the primitive 'nod'"):
        layouts.feature("Nodes", [], "nod", is_tiled=True)


@pytest.mark.parametrize(
    ("path", "layout", "narrower"),
    [
        ("dht", layouts.DHT, set()),
        ("lat", layouts.LAT, set()),
        ("texash/lht", layouts.LHT, set()),
        ("texash/grt", layouts.GRT, set()),
        ("texash/cat", layouts.CAT, {"description"}),
        ("texash/dqt", layouts.DQT, {"vpf_level_name", "spec_name"}),
        ("texash/bnd/fcs", layouts.FCS, {"table2_key"}),
        ("texash/bnd/fca", layouts.fca(), set()),
        ("texash/bnd/edg.fit", layouts.fit(is_tiled=True), set()),
        ("texash/bnd/int.vdt", typed(layouts.INT_VDT, {"value": "S"}), {"attribute", "description"}),
        ("texash/bnd/char.vdt", layouts.char_vdt(5), {"attribute", "description"}),
        ("texash/bnd/f/j/hb/1500/cnd", layouts.cnd("Z", is_tiled=False), set()),
        ("texash/bnd/f/j/hb/1500/edg", layouts.edg("Z"), set()),
        ("texash/bnd/f/j/hb/1500/fac", layouts.FAC, set()),
        ("texash/bnd/f/j/hb/1500/rng", layouts.RNG, set()),
        ("texash/bnd/f/j/hb/1500/ebr", layouts.EBR, set()),
        ("texash/bnd/f/j/hb/1500/fbr", layouts.FBR, set()),
        ("texash/tileref/tileref.aft", layouts.TILEREF, {"tile_name"}),
        ("texash/bnd/bndtxt.tft", layouts.feature("", TEXT_CLASS, "txt", is_tiled=True), set()),
    ],
)  # fmt: skip
def test_layouts_are_those_of_real_tables(path, layout, narrower):
    """Same columns in the same order and of the same types; real tables leave out optional ones and cut some widths."""
    real = [c for c in read_table(shared_vpf(TEXASH) / path).layout.columns if "." not in c.name]
    ours = [c for c in layout.columns if c.name in {column.name for column in real}]
    assert [c.name for c in ours] == [c.name for c in real]
    assert [c.kind for c in ours] == [c.kind for c in real]
    assert {c.name for c, other in zip(ours, real, strict=True) if c.count != other.count} == narrower


# Real data -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("start", [TEXASH, f"{TEXASH}/texash"])
def test_real_database(start):
    database = open_database(shared_vpf(start))
    assert database.name == "vmaplv2"
    assert database.missing == (("norfolk", "sarajevo", "rference") if start == TEXASH else ())
    library = database.libraries["texash"]
    assert library.extent == (-97.75, 31, -97.5, 31.25)
    assert library.reference["geo_datum_code"] == "WGE"
    assert library.header["scale"] == 50_000
    assert list(library.coverages) == ["tileref", "bnd"]
    assert len(library.missing) == 9
    assert list(library.tiles) == [1]
    np.testing.assert_allclose(library.tiles[1].extent, (-97.7503, 31.0002, -97.5003, 31.2502), atol=1e-4)
    coverage = library.coverages["bnd"]
    assert (coverage.level, coverage.description) == (3, "Boundaries")
    assert {name: found[1:5] for name, found in coverage.classes.items()} == {
        "markersp": ("P", "markersp.pft", "end", "end_id"),
        "polbndl": ("L", "polbndl.lft", "edg", "edg_id"),
        "polbnda": ("A", "polbnda.aft", "fac", "fac_id"),
        "bndtxt": ("T", "bndtxt.tft", "txt", "txt_id"),
    }
    assert coverage.classes["polbnda"].description == "Administrative Areas"
    counts = {name: read_table(coverage.table(found.table)).n_row for name, found in coverage.classes.items()}
    assert counts == {"markersp": 40, "polbndl": 2, "polbnda": 6, "bndtxt": 4}
    primitives = {name: read_table(coverage.table(name, 1)).n_row for name in ("edg", "cnd", "end", "fac", "txt")}
    assert primitives == {"edg": 23, "cnd": 18, "end": 40, "fac": 7, "txt": 4}
    descriptions = coverage.value_descriptions
    assert descriptions["polbnda.aft", "f_code"]["FA001"] == "Administrative Area"
    assert len(coverage.problems) == 2, "two classes of fca whose relations are not in this extract"


def test_every_real_text_is_read():
    """Every table that the directory names opens, and texts are texts."""
    library = open_database(shared_vpf(TEXASH)).libraries["texash"]
    for coverage in library.coverages.values():
        for found in coverage.classes.values():
            table = read_table(coverage.table(found.table))
            assert found.prim_key in table
            assert all(len(texts(table[c.name])) == table.n_row for c in table.layout.columns if c.kind == "T")


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_directories_with_changed_bytes(root, data):
    """Whatever stands in the tables: a listing, or an error that says where; and all that is found lies in the directory."""
    path = data.draw(st.sampled_from(sorted(path for path in root.rglob("*") if path.is_file())))
    whole = path.read_bytes()
    changed = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 3))):
        changed[data.draw(st.integers(0, len(changed) - 1))] = data.draw(st.integers(0, 255))
    try:
        path.write_bytes(changed[: data.draw(st.integers(0, len(changed)) | st.just(len(changed)))])
        document = list_database(open_database(root))
        assert list_lines(document)
        for library in open_database(root).libraries.values():
            assert library.path.parent == root
    except (VpfFormatError, NotFoundError):
        pass
    finally:
        path.write_bytes(whole)
