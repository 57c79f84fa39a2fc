"""What `vpfx import` says of directories that are damaged, or of another kind: one line, and nothing left behind."""

from __future__ import annotations

import json
import random
import re
import shutil
import sqlite3
import struct
from contextlib import closing

import numpy as np
import pytest
from conftest import shared_vpf, slow_apart
from hypothesis import given
from hypothesis import strategies as st
from invariants_store import judge_edges, read_level, read_tables
from surfaces import SOLID, hills, write_dem

import vpfx
from vpfx.cli import main
from vpfx.errors import InputError, NotFoundError, StoreError, VpfFormatError
from vpfx.evpf.reading import import_vpf
from vpfx.evpf.tile_rings import Edges, Rings, face_corners, walk_rings
from vpfx.evpf.writing import export_vpf
from vpfx.store.edit import edit_store
from vpfx.vpf.table import Ragged, read_table, write_table
from vpfx.vpf.values import texts

BUILDS = {
    "tiles": (hills(12, 10), {"max_error": (20, 9), "tile_size": 8}),
    "pyramid": (hills(12, 10), {"method": "delaunay_pyramid", "max_error": (20, 9), "tile_size": 8}),
    "T-junctions": (SOLID["cliff"].heights, {"method": "scarlatos", "passes": 2}),
}


@pytest.fixture(scope="module", params=BUILDS)
def exported(request, tmp_path_factory):
    """Return a store with attributes and its directory, with double precision."""
    folder = tmp_path_factory.mktemp("exported")
    heights, options = BUILDS[request.param]
    store = vpfx.build(write_dem(folder / "a.tif", heights), folder / "a.gpkg", **options).path
    with edit_store(store) as editor:
        columns = {"name": "text", "depth": "real", "code": "integer", "day": "date"}
        editor.create_class("soil", columns, "what grows on it")
        rows = {"name": ["clay", None], "depth": [0.5, 2], "code": [1, None], "day": [None, "1998-12-01"]}
        ids = editor.add_features("soil", rows)
        editor.describe_values("soil", "code", {1: "deep"})
        editor.set_faces("soil", [1, 2], ids)
    return store, export_vpf(store, folder / "vpf", is_double=True).path


@pytest.fixture
def copy(exported, tmp_path):
    """Return a copy of the directory, in a folder of its own."""
    return shutil.copytree(exported[1], tmp_path / "vpf")


def refusal(directory, error=VpfFormatError):
    """Import, expect an error of one line and that nothing is left; return the line."""
    store = directory.parent / "b.gpkg"
    with pytest.raises(error) as failure:
        import_vpf(directory, store)
    assert sorted(path.name for path in directory.parent.iterdir()) == [directory.name]
    assert "\n" not in str(failure.value)
    return str(failure.value)


def put(path, row, column, value):
    """Overwrite a number in a row, from 0 or from the end, of a table of fixed length; the types come from its header."""
    data = bytearray(path.read_bytes())
    head = 4 + struct.unpack("<i", data[:4])[0]
    columns = [part.split("=") for part in data[4:head].decode("latin-1").split(";", 3)[3].split(":")[:-1]]
    codes = {"I": "i", "S": "h", "F": "f", "R": "d"}
    layout = {name.strip(): codes[form.split(",")[0]] for name, form in columns}
    names = list(layout)
    size = struct.calcsize("<" + "".join(layout.values()))
    row %= (len(data) - head) // size
    place = struct.calcsize("<" + "".join(layout[name] for name in names[: names.index(column)]))
    struct.pack_into("<" + layout[column], data, head + row * size + place, value)
    path.write_bytes(data)


# --- tables that are missing, or cut, or changed --------------------------------------------------------------------------

OF_COVERAGE, OF_TILE = {"fcs", "tinface.aft", "tinnode.pft"}, {"cnd", "edg", "fac", "rng"}
NEEDED = {
    "vpf": {"lat"}, "terrain": {"cat"}, "tileref": {"tileref.aft"}, "tin0": {*OF_COVERAGE, "soil.aft"},
    "tin1": OF_COVERAGE, "tin2": OF_COVERAGE,
}  # fmt: skip
"""Tables that cannot be done without, by directory; besides those of tiles, and of the hierarchy (``.rat``)."""


def is_needed(path):
    of_tile = OF_TILE if path.parent.name.isdigit() else ()
    return path.name in NEEDED.get(path.parent.name, of_tile) or path.suffix == ".rat"


@pytest.mark.parametrize("exported", ["tiles"], indirect=True)
def test_every_table_missing_in_turn(exported, copy):
    paths = sorted(path for path in copy.rglob("*") if path.is_file())
    for path in filter(is_needed, paths):
        if "01" not in path.parts:  # one tile shows it
            data = path.read_bytes()
            path.unlink()
            refusal(copy, (VpfFormatError, NotFoundError))
            path.write_bytes(data)


def test_what_others_say_too_may_be_missing(exported, copy):
    """The same goes for what only other readers need."""
    with_all = import_vpf(copy, copy.parent / "b.gpkg").path.read_bytes()
    for path in copy.rglob("*"):
        if path.is_file() and not is_needed(path):
            path.unlink()
    assert import_vpf(copy, copy.parent / "b.gpkg", overwrite=True).path.read_bytes() == with_all


def judge_rows(path):
    """Judge the rows of a store as far as no DEM is needed: winged edges, faces, links, places."""
    with closing(sqlite3.connect(path)) as store:
        assert store.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        assert store.execute("PRAGMA foreign_key_check").fetchall() == []
    tables = read_tables(path)
    for level in range(len(tables.levels)):
        judge_edges(read_level(tables, level))
    tables.connection.close()
    with vpfx.open_store(path) as store:
        assert store.tin(0).n_face > 0


def damaged(data, chance):
    """Cut bytes, or change some, behind the header as a rule."""
    changed = bytearray(data)
    if not changed or chance.random() < 0.15:
        return changed[: chance.randrange(len(changed) + 1)]
    head = min(4 + int.from_bytes(data[:4], "little"), len(data) - 1) if chance.random() < 0.8 else 0
    for _ in range(chance.choice([1, 1, 2, 5])):
        changed[chance.randrange(head, len(changed))] = chance.choice([0, 1, 127, 128, 255, chance.randrange(256)])
    return changed


@pytest.mark.parametrize("n", slow_apart([12, 200], [200]))
def test_damage(exported, copy, n):
    """Whatever bytes are changed there is an error, the same store, or one that is whole."""
    chance = random.Random(n)
    paths = sorted(path for path in copy.rglob("*") if path.is_file() and is_needed(path))
    store = copy.parent / "b.gpkg"
    seen = set()
    for _ in range(n):
        path = chance.choice(paths)
        data = path.read_bytes()
        path.write_bytes(damaged(data, chance))
        try:
            import_vpf(copy, store)
        except (VpfFormatError, NotFoundError, StoreError):
            seen.add("refused")
        else:
            if path.name in ("cnd", "edg", "fac", "rng", "parent.rat", "evpf.rat") or path.suffix in (".aft", ".pft"):
                judge_rows(store)
            store.unlink()
            seen.add("read")
        assert sorted(path.name for path in copy.parent.iterdir()) == ["vpf"]
        path.write_bytes(data)
    assert seen == {"refused", "read"}


# --- what is told ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """Return a directory of four tiles and two levels."""
    dem = write_dem(tmp_path_factory.mktemp("small") / "a.tif", hills(12, 10))
    store = vpfx.build(dem, dem.with_name("a.gpkg"), max_error=(20, 9), tile_size=8).path
    return export_vpf(store, dem.with_name("vpf"), is_double=True).path


DEFECTS = {
    "ring that starts elsewhere": (
        "tin1/00/00/rng",
        3,
        "start_edge",
        1,
        r"edg: face 3: found an edge that has another face.*E-220",
    ),
    "ring of another face": ("tin1/00/00/rng", 1, "face_id", 9, r"rng: row 3: found a ring out of order.*E-220"),
    "ring pointer": ("tin1/00/00/fac", 1, "ring_ptr", 1, r"fac: row 2: found ring_ptr 1, expected 3 \(E-220\)"),
    "link out of range": (
        "tin1/parent.rat",
        0,
        "child_id",
        1,
        r"parent.rat: row 1: found child_id 1, expected 2 … \d+ \(E-420\)",
    ),
    "link out of order": (
        "tin1/parent.rat",
        1,
        "child_id",
        2,
        r"parent.rat: row 2: found a link out of order.*E-420",
    ),
    "parent of the features": (
        "tin1/tinface.aft",
        0,
        "parent",
        2,
        r"tinface.aft: row 1: found parent 2, expected 1.*E-300",
    ),
    "parent on level 0": (
        "tin0/tinface.aft",
        1,
        "parent",
        1,
        r"tinface.aft: row 2: found parent 1, expected none.*E-300",
    ),
    "tile out of order": (
        "tin0/tinface.aft",
        -1,
        "tile_id",
        1,
        r"tinface.aft: row \d+: found tile 1 where tile 4 .*E-101",
    ),
    "tile that is none": ("tin1/parent.rat", -1, "tile_id", 9, r"tinface.aft: row \d+: found 0 parents in .*E-420"),
    "row id": ("tin0/tinnode.pft", 2, "id", 7, r"tinnode.pft: row 3: found id 7, expected 3 \(E-101\)"),
    "height": ("tin0/tinnode.pft", 0, "z", 1e3, r"tinnode.pft: row 1: found z 1000.0, expected .*as in cnd \(E-300\)"),
    "level of a node": (
        "tin1/tinnode.pft",
        0,
        "first_level",
        1,
        r"tinnode.pft: row 1: found z_parent nan, expected one",
    ),
    "slope": (
        "tin0/tinface.aft",
        0,
        "slope",
        91,
        r"tinface.aft: row 1: found slope 91.0, expected 0 to 90 degrees \(E-300\)",
    ),
    "filled": ("tin0/tinface.aft", 0, "filled", 2, r"tinface.aft: row 1: found filled 2, expected 0 or 1 \(E-300\)"),
}


@pytest.mark.parametrize("name", DEFECTS)
def test_defects_are_told(name, small, tmp_path):
    """File, row, what was found and expected, and the requirement."""
    where, row, column, value, message = DEFECTS[name]
    folder = shutil.copytree(small, tmp_path / "vpf")
    put(folder / "terrain" / where, row, column, value)
    assert re.search(message, refusal(folder))


def test_counts_are_compared(small, tmp_path):
    folder = shutil.copytree(small, tmp_path / "vpf")
    path = folder / "terrain" / "tin1" / "level.rat"
    table = read_table(path)
    write_table(path, table.layout, {**table.columns, "edge_count": table["edge_count"] + 1})
    assert re.search(r"tin1/level.rat: row 1: found .* edges.*expected .* as in the tiles \(E-410\)", refusal(folder))


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("evpf_version", "2.0", r"row 1: found evpf_version '2.0', expected 1.0 \(E-400\)"),
        ("precision", "half", r"row 2: found precision 'half', expected single or double \(E-400\)"),
        ("precision", "single", r"header: found column 'coordinate' of type Y,1, expected Z \(E-100\)"),
        ("level_count", "9", r"row 3: found '9', expected a whole number, 1 … \d+ \(E-400\)"),
        ("tile_size", "5", r"row 4: found '5', expected a whole number, 8 …"),
        ("tile_size", "20", r"tileref.aft: found tiles 1, 2, 3, 4, expected 1 … 1, .*\(E-104\)"),
        ("lattice", "{}", r"lattice: found \[\], expected dx, dy, n_col, n_row, x0, y0 \(E-400\)"),
        ("lattice", '{"dx": 1e999, "dy": 1, "n_col": 10, "n_row": 12, "x0": 0, "y0": 0}', r"lattice: found .*\(E-400\)"),
        ("lattice", '{"dx": 30, "dy": 30, "n_col": 1e9, "n_row": 12, "x0": 0, "y0": 0}', r"lattice: found .*\(E-400\)"),
        ("lattice", '{"dx": 30, "dy": 30, "n_col": 2000000000, "n_row": 12, "x0": 0, "y0": 0}', r"expected at most 32767"),
        ("lattice", '{"dx": 30, "dy": 30, "n_col": 10, "n_row": 12, "x0": 0, "y0": 0}', r"cnd: row 1: found x .*\(E-104\)"),
        ("lattice", '{"dx": 1e308, "dy": 30, "n_col": 10, "n_row": 12, "x0": 0, "y0": 0}', r"expected a finite extent"),
        ("crs_wkt2", "PROJCRS[", r"found no horizontal CRS as WKT, expected one or none"),
        ("format_version", "9", r"found format version '9', expected '0.1'"),
        ("posts", "many", r"posts: found a value of another kind"),
    ],
)  # fmt: skip
def test_metadata_is_checked(name, value, message, small, tmp_path):
    folder = shutil.copytree(small, tmp_path / "vpf")
    path = folder / "terrain" / "tin0" / "evpf.rat"
    table = read_table(path)
    rows = dict(zip(texts(table["name"]), texts(table["value"]), strict=True)) | {name: value}
    write_table(path, table.layout, {"id": range(1, len(rows) + 1), "name": list(rows), "value": list(rows.values())})
    assert re.search(message, refusal(folder))


def test_tiles_that_differ_on_their_border(small, tmp_path):
    """Each tile is good by itself; together they make no TIN."""
    folder = shutil.copytree(small, tmp_path / "vpf")
    level = folder / "terrain" / "tin1"
    paths = level / "00" / "00" / "cnd", level / "00" / "00" / "edg", level / "tinnode.pft"
    nodes, edges, features = map(read_table, paths)
    border = nodes["coordinate"][:, 0] == nodes["coordinate"][:, 0].max()
    shift = np.zeros(nodes.n_row)
    shift[np.flatnonzero(border)[-1]] = 0.5
    coordinate = nodes["coordinate"] + np.array([0, 0, 1]) * shift[:, None]
    ends = np.stack([edges["start_node"], edges["end_node"]], axis=1).ravel() - 1
    lines = Ragged(edges["coordinates"].starts, coordinate[ends])
    z = features["z"] + np.append(shift, np.zeros(features.n_row - nodes.n_row))
    write_table(paths[0], nodes.layout, {**nodes.columns, "coordinate": coordinate})
    write_table(paths[1], edges.layout, {**edges.columns, "coordinates": lines})
    write_table(paths[2], features.layout, {**features.columns, "z": z})
    assert re.search(
        r"terrain: found tables that make no TIN: node \d+: ",
        refusal(folder),
    )


def test_attributes_that_no_store_has(exported, copy):
    path = copy / "terrain" / "tin0" / "column.rat"
    table = read_table(path)
    kinds = [b"integer" for _ in range(table.n_row)]
    write_table(path, table.layout, {**table.columns, "kind": kinds})
    assert "soil.aft" in refusal(copy)
    write_table(path, table.layout, {**table.columns, "name": ["order"] * table.n_row})
    assert "a word of SQL" in refusal(copy)


# --- other directories, and the command -----------------------------------------------------------------------------------


def test_other_vpf_is_told(tmp_path):
    """Who has features of somebody else is told which commands read them."""
    store = tmp_path / "b.gpkg"
    with pytest.raises(
        VpfFormatError, match=r"found VPF without tin0/evpf\.rat.*vpfx vpf to-gpkg.*vpfx build --features"
    ):
        import_vpf(shared_vpf("vm2alv2_texash"), store)
    with pytest.raises(NotFoundError, match="found neither lat nor cat"):
        import_vpf(tmp_path, store)
    with pytest.raises(NotFoundError, match="found no directory"):
        import_vpf(tmp_path / "none", store)
    assert list(tmp_path.iterdir()) == []


def test_places_of_the_store(small, tmp_path):
    """A file is replaced if that is asked for; none is put into the directory that is read."""
    folder = shutil.copytree(small, tmp_path / "vpf")
    store = tmp_path / "b.gpkg"
    store.write_bytes(b"old")
    with pytest.raises(StoreError, match="--overwrite"):
        import_vpf(folder, store)
    assert store.read_bytes() == b"old"
    with pytest.raises(InputError, match="lies in the database that is read"):
        import_vpf(folder, folder / "terrain" / "cat", overwrite=True)
    (folder / "terrain" / "tin1" / "00" / "00" / "rng").unlink()
    with pytest.raises(VpfFormatError, match="found no table 'rng', expected one"):
        import_vpf(folder, store, overwrite=True)
    assert store.read_bytes() == b"old"
    import_vpf(small / "terrain", store, overwrite=True)
    assert store.read_bytes() == small.with_name("a.gpkg").read_bytes()


def test_upper_case(small, tmp_path):
    store = small.with_name("a.gpkg")
    folder = export_vpf(store, tmp_path / "VPF", is_double=True, is_upper=True).path
    assert import_vpf(folder, tmp_path / "b.gpkg").path.read_bytes() == store.read_bytes()


def test_command(small, tmp_path, capsys):
    store = tmp_path / "b.gpkg"

    def run(*arguments):
        with pytest.raises(SystemExit) as ended:
            main(["import", *map(str, arguments)])
        return ended.value.code, *capsys.readouterr()

    code, out, err = run(small, "-o", store, "--json")
    facts = json.loads(out)
    assert (code, err, facts["precision"], facts["tiles"], len(facts["levels"])) == (0, "", "double", 4, 2)
    code, out, err = run(small, "-o", store)
    assert (code, out, err.count("\n")) == (3, "", 1)
    code, out, err = run(small, "-o", store, "--overwrite")
    assert (code, err) == (0, "")
    assert "from double precision, 4 tiles" in out
    assert run(tmp_path / "none", "-o", store, "--overwrite")[0] == 3
    assert store.read_bytes() == small.with_name("a.gpkg").read_bytes()


# --- rings ----------------------------------------------------------------------------------------------------------------


@given(st.lists(st.integers(0, 4), min_size=30, max_size=30), st.integers(0, 4))
def test_walks_end(numbers, start):
    """Whatever links say a walk comes to an end, and a ring that closes has each edge on the right side of its face."""
    table = np.array(numbers).reshape(6, 5)
    table[2:4] = 1 + table[2:4] % 3
    edges = Edges(*table)
    rings = walk_rings(edges, np.array([2]), np.array([start]))
    if rings.broken < 0:
        assert 3 <= len(rings.node) <= 10
        assert (edges.right_face[start] == 2) or (edges.left_face[start] == 2)


@pytest.mark.parametrize("turn", range(5))
def test_corners_of_rings_with_more_edges(turn):
    """A ring 0 1 2 3 4, clockwise, whose nodes 1 and 4 lie inside sides; edge_1 is the side with the first edge of the walk."""
    walk = np.roll(np.arange(5), -turn)
    found = face_corners(Rings(np.array([0, 5]), walk, -1, 0), np.array([0, 0]), np.array([1, 4]))
    first = {0: 0, 1: 2, 2: 2, 3: 3, 4: 0}[turn]  # the first corner met is node_1
    clockwise = [0, 2, 3]
    at = clockwise.index(first)
    assert found.faces.tolist() == [[first, clockwise[at - 1], clockwise[at - 2]]]
    inside = dict(zip(found.node.tolist(), found.side.tolist(), strict=True))
    corners = found.faces[0].tolist()
    for node, ends in ((1, {0, 2}), (4, {3, 0})):
        side = inside[node]
        assert {corners[side], corners[(side + 1) % 3]} == ends
