"""Features of VPF: geometry, merging, decoded values; deviations of producers and damage; real data, beside another reader."""

from __future__ import annotations

import random
import shutil
import struct
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from small_stores import build_kind
from vpf_bytes import ID, Style, col, index_name, write
from vpf_databases import expected_lines, write_database
from vpf_maps import Map

import vpfx
from vpfx.errors import NotFoundError, VpfFormatError, VpfxError
from vpfx.export import EXPORTERS
from vpfx.registry import pick
from vpfx.vpf import reader
from vpfx.vpf.fields import iso_date
from vpfx.vpf.geometry import face_polygons
from vpfx.vpf.merge import merge_parts
from vpfx.vpf.opening import feature_classes, open_coverages
from vpfx.vpf.reader import read_class, read_primitives
from vpfx.vpf.table import read_table

STYLES = {
    "plain": Style(),
    "big-endian, upper case, I": Style(order=">", is_upper=True, link="I", coordinate="Z"),
    "dots, no index, doubles": Style(dot=".", has_index=False, coordinate="B", tile_kind="I"),
    "1992, no rings": Style(is_old=True, has_rings=False, coordinate="Y", has_heights=True),
    "no letter, stray byte": Style(has_order=False, stray=b"\n", coordinate="Z", has_heights=True),
}


def ground_of(seed=1, tile=3, size=(6, 7), n_spur=5):
    return Map(np.random.default_rng(seed).integers(0, 3, size), seed, tile, n_spur)


def land(path):
    """The coverage with everything."""
    (coverage,) = (found for found in open_coverages(path).coverages if found.name.lower() == "land")
    return coverage


def read(path, name):
    coverage = land(path)
    return read_class(coverage, feature_classes(coverage)[0][name])


def areas_of(ground):
    """Oracle: areas of the features, in their order."""
    return [ground.polygon(own) for own in sorted({own for cell, own in ground.areas.items() if ground.labels[cell]})]


def check_areas(found, ground):
    assert len(found) == len(areas_of(ground))
    assert all(area.equals(expected) for area, expected in zip(found, areas_of(ground), strict=True))


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("tile", [0, 3])
def test_features_come_back(style, tile, tmp_path):
    """In whatever way a producer writes, tiled and not."""
    ground = ground_of(tile=tile)
    path = write_database(tmp_path / "db", ground, STYLES[style])
    areas, lines, points, nodes, texts = (read(path, name) for name in ("area", "line", "point", "node", "text"))
    check_areas(areas.geometry, ground)
    expected, _ = expected_lines(ground)
    assert all(line.equals(other) for line, other in zip(lines.geometry, expected, strict=True))
    assert set(shapely.get_type_id(lines.geometry)) == {1}
    at = [ground.square(cell).centroid.coords[0] for part in ground.tiles for cell in sorted(part.face_at)]
    assert np.allclose(shapely.get_coordinates(points.geometry), at, rtol=1e-6)
    ends = [place for part in ground.tiles for place in part.nodes]
    assert np.array_equal(shapely.get_coordinates(nodes.geometry), ends)
    assert texts.fields["string"].to_list() == [f"Ort {part.name}" for part in ground.tiles]
    assert np.array_equal(shapely.get_coordinates(texts.geometry), [part.nodes[0] for part in ground.tiles])
    has_z = STYLES[style].has_heights
    for rows in (areas, lines, points, nodes, texts):
        assert rows.problems == ()
        assert (shapely.has_z(rows.geometry) == has_z).all()
        places = shapely.get_coordinates(rows.geometry, include_z=True)
        assert not has_z or np.allclose(places[:, 2], 100.0 + places[:, 0], rtol=1e-6)


@settings(max_examples=12, deadline=None)
@given(
    st.lists(st.lists(st.integers(0, 2), min_size=5, max_size=5), min_size=2, max_size=4),
    st.integers(0, 9), st.sampled_from([0, 2, 3]), st.sampled_from(sorted(STYLES)),
)  # fmt: skip
def test_any_map_comes_back(tmp_path_factory, labels, seed, tile, style):
    ground = Map(labels, seed, tile, n_spur=seed)
    path = write_database(tmp_path_factory.mktemp("any") / "db", ground, STYLES[style])
    check_areas(read(path, "area").geometry, ground)
    lines, _ = expected_lines(ground)
    found = read(path, "line").geometry
    assert all(line.equals(other) for line, other in zip(found, lines, strict=True))


def test_values_are_decoded(tmp_path):
    fields = read(write_database(tmp_path / "db", ground_of(size=(6, 8))), "area").fields
    assert list(fields) == [
        "id", "f_code", "f_code_description", "kind", "kind_description", "name", "height", "deep", "few", "seen",
    ]  # fmt: skip
    rows = {name: field.to_list()[:5] for name, field in fields.items()}
    assert rows["id"] == [1, 2, 3, 4, 5]
    assert rows["f_code"] == ["BH000", None, "ZZ999", "BA010", "BH000"]
    assert rows["f_code_description"] == ["Inland Water", None, None, "Coastline", "Inland Water"]
    assert rows["kind"] == [2, None, None, 7, 1]
    assert rows["kind_description"] == ["Two", None, None, None, "One"]
    assert rows["name"] == ["?ód??", None, "N/A", "Ab; c, d", "Ålborg"]  # a text of no fixed length may be N/A
    assert rows["height"] == [0.5, 1.0, None, 2.0, 2.5]
    assert rows["few"] == [None, 2, None, 4, None]
    assert rows["seen"] == ["1999-11-05T12:30:00", None, "1999-11-05T12:30:00", None, "1999-11-05T12:30:00"]
    assert fields["few"].values.dtype == np.int16
    assert fields["height"].values.dtype == np.float32


@pytest.mark.parametrize(
    ("text", "date"),
    [
        ("19991105000000.00000", "1999-11-05"),
        ("19991105123000.+0130", "1999-11-05T12:30:00+01:30"),
        ("19890700000000.00000", "1989-07"),
        ("1989            ", "1989"),
        ("19990230000000.00000", "19990230000000.00000"),
        ("00000000000000.00000", None),
    ],
)
def test_dates(text, date):
    assert iso_date(text) == date


def test_fields_beside_numbers_and_texts(tmp_path):
    """Triplets, places and names that are taken."""
    ground = ground_of(tile=0)
    path = write_database(tmp_path / "db", ground)
    columns = [
        ID,
        col("link", "K"),
        col("kind", "I"),
        col("kind_description", "T", 3),
        col("at", "C"),
        col("edg_id", "I"),
    ]
    rows = [(1, (3, 2, 9), 1, "own", [(1.5, 2.0)], 1), (2, 4, 2, "-", [(float("nan"),) * 2], 2)]
    write(path / "lib/land", Style(), "line.lft", columns, rows)
    write(path / "lib/land", Style(), "int.vdt", *described("line.lft", "kind", 1, "One"))
    fields = {name: field.to_list() for name, field in read(path, "line").fields.items()}
    assert fields == {
        "id": [1, 2], "link": [3, 4], "link_tile_id": [2, None], "link_ext_id": [9, None], "kind": [1, 2],
        "kind_description": ["own", None], "kind_description_": ["One", None], "at": ["1.5 2.0", None], "edg_id": [1, 2],
    }  # fmt: skip


def described(table, column, value, text):
    columns = [ID, col("table", "T", 12), col("attribute", "T", 16), col("value", "I"), col("description", "T", 50)]
    return columns, [(1, table, column, value, text), (2, table, column, value, "Twice")]


@pytest.mark.parametrize("style", [Style(), Style(order=">", link="I")])
def test_loops_of_links_are_mended_and_told(style, tmp_path):
    """Links that never return to the start; the areas are those of the map all the same."""
    ground = ground_of()
    for tile in ground.tiles[:2]:
        for edge in tile.edges:
            edge.right_edge = tile.edges.index(edge) + 1
    found = read(write_database(tmp_path / "db", ground, style), "area")
    check_areas(found.geometry, ground)
    assert len(found.problems) == 2
    assert "db/lib/land: area: tile 1: " in found.problems[0]
    assert "faces were joined without the links of edges, which are wrong: " in found.problems[0]


def test_missing_links_and_nodes_are_done_without(tmp_path):
    """Edges with faces and places only, as their order in the file tells no ring."""
    ground = ground_of(tile=0)
    path = write_database(tmp_path / "db", ground)
    (tile,) = ground.tiles
    columns = [ID, col("right_face", "I"), col("left_face", "I"), col("coordinates", "C", "*")]
    rows = [(i, edge.right_face, edge.left_face, edge.places) for i, edge in enumerate(tile.edges, 1)]
    write(path / "lib/land", Style(), "edg", columns, rows)
    check_areas(read(path, "area").geometry, ground)


def test_rows_that_are_not_numbered_from_one(tmp_path):
    """Primitives are found by their ids, whatever their row."""
    ground = ground_of(tile=0)
    path = write_database(tmp_path / "db", ground)
    (tile,) = ground.tiles
    names = ("start_node", "end_node", "right_face", "left_face")
    columns = [ID, *(col(name, "I") for name in (*names, "right_edge", "left_edge")), col("coordinates", "C", "*")]
    rows = [
        (10 * i, *(getattr(edge, name) for name in names), 10 * edge.right_edge, 10 * edge.left_edge, edge.places)
        for i, edge in enumerate(tile.edges, 1)
    ]
    write(path / "lib/land", Style(), "edg", columns, rows[::-1])
    found = read(path, "area")
    assert found.problems == ()
    check_areas(found.geometry, ground)
    assert all(line is None for line in read(path, "line").geometry[:8])  # they name 1, 2, 3 …
    assert "primitives of edg are missing, or have no shape: 1, 2, 3, 4, 5, …" in read(path, "line").problems[0]


def test_tiles_that_are_not_there(tmp_path):
    ground = ground_of()
    path = write_database(tmp_path / "db", ground)
    shutil.rmtree(path / "lib/land/00/01")
    found, whole = read(path, "area"), areas_of(ground)
    assert "lie in tiles that are missing: tiles 2" in found.problems[0]
    lost = shapely.union_all([ground.square(cell) for cell in ground.tiles[1].face_at])
    for area, expected in zip(found.geometry, whole, strict=True):
        left = expected.difference(lost)
        assert left.is_empty if area is None else area.equals(left)
    tileref = path / "lib/tileref/tileref.aft"
    tileref.write_bytes(tileref.read_bytes().replace(rb"01\00", rb"   \\"))  # a blank name is no tile
    assert "tiles 2, 4" in read(path, "area").problems[0]


def test_broken_tiles_leave_coverages_without_tiles(tmp_path):
    store = build_kind("tiles", tmp_path)
    pick(EXPORTERS, "vpf", "format").write(store, tmp_path / "hills")
    table = tmp_path / "hills/terrain/tileref/tileref.aft"
    table.write_bytes(table.read_bytes().replace(rb"00\00", rb"..\00"))
    coverages = {found.name: found for found in open_coverages(tmp_path / "hills").coverages}
    outline = read_class(coverages["libref"], feature_classes(coverages["libref"])[0]["libref"])
    assert (outline.problems, len(outline.geometry[0].coords)) == ((), 5)
    faces = read_class(coverages["tin0"], feature_classes(coverages["tin0"])[0]["tinface"])
    assert "V-202" in faces.problems[0]


def test_a_broken_tile_leaves_the_others(tmp_path):
    ground = ground_of()
    path = write_database(tmp_path / "db", ground)
    edges = path / "lib/land/00/01/edg"
    edges.write_bytes(edges.read_bytes()[:20])
    found = read(path, "area")
    assert "00/01/edg" in found.problems[0]
    assert sum(area is not None for area in found.geometry) > 3


def test_what_fca_says_of_a_class_changes_no_geometry(tmp_path):
    """A class of lines that is said to be one of points, of areas, of texts, or complex."""
    path = write_database(tmp_path / "db", ground_of())
    before = read(path, "line").geometry
    table = path / "lib/land/fca"
    data = table.read_bytes()
    for kind in (b"P", b"A", b"T", b"C"):
        table.write_bytes(data.replace(b"line    L", b"line    " + kind))
        assert table.read_bytes() != data
        assert all(line.equals(other) for line, other in zip(read(path, "line").geometry, before, strict=True))


def test_many_tiles_that_are_not_there(tmp_path, monkeypatch):
    """Each row in a tile of its own that no library has: the edges of the coverage are read once, or nothing is."""
    ground = ground_of(tile=0)
    path = write_database(tmp_path / "db", ground)
    joins = [(i, 1, i, 1 + i % 3) for i in range(1, 2001)]
    write(path / "lib/land", Style(), "line.ljt", [ID, *(col(n, "I") for n in ("line_id", "tile_id", "edg_id"))], joins)
    opened = []
    monkeypatch.setattr(reader, "read_table", lambda table: opened.append(table.name) or read_table(table))
    found = read(path, "line")
    assert opened.count("edg") == 1
    assert found.geometry[0].equals(shapely.union_all([shapely.LineString(e.places) for e in ground.whole.edges[:3]]))
    (path / "lib/land/edg").unlink()
    found = read(path, "line")
    assert "2,000 primitives of edg lie in tiles that are missing: tiles 1, 2, 3, 4, 5, …" in found.problems[0]


def test_a_face_of_several_areas(tmp_path):
    """Islands that are given one id come out together, and the faces beside them as they are."""
    labels = np.zeros((3, 5), int)
    labels[1, 1], labels[1, 3] = 1, 2
    ground = Map(labels)
    (tile,) = ground.tiles
    first, second = (ground.whole.face_at[cell] for cell in ((1, 1), (1, 3)))
    for edge in tile.edges:
        edge.right_face, edge.left_face = (first if x == second else x for x in (edge.right_face, edge.left_face))
    path = write_database(tmp_path / "db", ground)
    faces = face_polygons(read_table(path / "lib/land/edg"))
    found = dict(zip(faces.ids.tolist(), faces.polygons, strict=True))
    assert second not in found
    assert found[first].equals(shapely.union_all([ground.square((1, 1)), ground.square((1, 3))]))


def test_what_has_no_shape(tmp_path):
    """Face 1, an edge of one place, places that are no numbers, ids that are not there, a feature in no row of the join."""
    ground = ground_of(tile=0)
    path = write_database(tmp_path / "db", ground)
    (tile,) = ground.tiles
    tile.edges[0].places, tile.edges[1].places = tile.edges[0].places[:1], [(float("nan"), 1.0), (2.0, 2.0)]
    write_database(path, ground)
    joins = [(1, 1, 1), (2, 2, 9999), (3, 77, 2), (4, 3, 2), (5, 3, 2), (6, 4, 0)]
    write(path / "lib/land", Style(), "area.ajt", [ID, col("area_id", "I"), col("fac_id", "I")], joins)
    found = read(path, "area")
    assert [area is None for area in found.geometry[:2]] == [True, True]
    assert all(area is None for area in found.geometry[3:])
    assert "rows of area.ajt name features that are missing: 77" in found.problems[0]
    assert "primitives of fac are missing, or have no shape: 1, 2, 9999" in found.problems[-1]
    lines = read(path, "line")
    assert "primitives of edg are missing, or have no shape: 1, 2" in lines.problems[0]


def test_classes_that_the_schema_leaves_out(tmp_path):
    """Without `fcs` the columns tell the primitives, also through a join table."""
    ground = ground_of()
    path = write_database(tmp_path / "db", ground)
    for name in ("fcs", "fcz"):
        (path / "lib/land" / name).unlink(missing_ok=True)
    classes, problems = feature_classes(land(path))
    assert {name: (one.kind, one.primitive, one.join is not None) for name, one in classes.items()} == {
        "area": ("A", "fac", True), "line": ("L", "edg", True), "node": ("P", "cnd", False),
        "point": ("P", "end", False), "text": ("T", "txt", False),
    }  # fmt: skip
    assert "found no table fcs" in problems[0]
    assert len(problems) == 6
    check_areas(read(path, "area").geometry, ground)
    (path / "lib/land/area.ajt").unlink()
    (path / "lib/land/point.pft").write_bytes(b"nothing")
    classes, problems = feature_classes(land(path))
    assert sorted(classes) == ["line", "node", "text"]
    assert any("point.pft" in line for line in problems)


def test_a_key_that_names_the_feature_itself(tmp_path):
    """Some relations give `id` for the column that names the primitive."""
    ground = ground_of()
    path = write_database(tmp_path / "db", ground)
    schema = path / "lib/land/fcs"
    schema.write_bytes(schema.read_bytes().replace(b"point.pft   end_id", b"point.pft   id    "))
    (path / "lib/land/fcz").unlink(missing_ok=True)
    assert read(path, "point").problems == ()
    assert not shapely.is_missing(read(path, "point").geometry).any()


def test_primitives(tmp_path):
    ground = ground_of()
    coverage = land(write_database(tmp_path / "db", ground))
    edges = read_primitives(coverage, "edg")
    expected = [shapely.LineString(edge.places) for tile in ground.tiles for edge in tile.edges]
    assert all(line.equals_exact(other) for line, other in zip(edges.geometry, expected, strict=True))
    tiles = [i for i, tile in enumerate(ground.tiles, 1) for _ in tile.edges]
    assert edges.fields["tile_id"].to_list() == tiles
    assert edges.fields["start_node"].to_list() == [edge.start_node for tile in ground.tiles for edge in tile.edges]
    assert "coordinates" not in edges.fields
    faces = read_primitives(coverage, "fac")
    names = zip(faces.fields["tile_id"].to_list(), faces.fields["id"].to_list(), strict=True)
    found = dict(zip(names, faces.geometry, strict=True))
    assert len(found) == sum(tile.n_face - 1 for tile in ground.tiles)
    for (tile, face), area in found.items():
        assert area.equals(ground.face_polygon(ground.tiles[tile - 1], face))
    assert len(read_primitives(coverage, "txt").geometry) == len(ground.tiles)


def test_parts_of_one_feature():
    """What touches is joined, what is apart stays so, what is there twice is there once."""

    def merged(kind, *texts, tile=None):
        parts = shapely.from_wkt(list(texts))
        tile = np.arange(len(texts)) if tile is None else np.array(tile)
        return merge_parts(kind, np.zeros(len(texts), int), tile, parts, 1)[0].wkt

    assert merged("P", "POINT (1 2)", "POINT (1 2)") == "POINT (1 2)"
    assert merged("P", "POINT (1 2)", "POINT (3 4)") == "MULTIPOINT ((1 2), (3 4))"
    assert merged("L", "LINESTRING (0 0, 1 1)", "LINESTRING (1 1, 0 0)") == "LINESTRING (0 0, 1 1)"
    assert merged("L", "LINESTRING (0 0, 1 1)", "LINESTRING (3 3, 4 4)").startswith("MULTILINESTRING")
    assert merged("L", "LINESTRING Z (0 0 5, 1 1 6)", "LINESTRING (1 1, 2 2)") == "LINESTRING (0 0, 1 1, 2 2)"
    left, right = "POLYGON ((0 0, 0 1, 1 1, 1 0, 0 0))", "POLYGON ((1 0, 1 1, 2 1, 2 0, 1 0))"
    for tile in ([1, 1], [1, 2]):
        area = shapely.from_wkt(merged("A", left, right, tile=tile))
        assert area.equals(shapely.box(0, 0, 2, 1))
    assert merged("A", "POLYGON ((0 0, 2 2, 2 0, 0 2, 0 0))", right).startswith("MULTIPOLYGON")  # a bow tie
    assert merged("T", "POINT (1 2)", "POINT (3 4)") == "POINT (1 2)"


def test_a_face_in_two_places_is_a_multipolygon(tmp_path):
    """Damaged: two islands bear one id."""
    ground = Map([[1, 0, 2]], 0)
    path = write_database(tmp_path / "db", ground)
    for edge in ground.tiles[0].edges:
        edge.right_face, edge.left_face = (2 if face == 3 else face for face in (edge.right_face, edge.left_face))
    write_database(path, ground)
    area = read(path, "area").geometry[0]
    assert area.geom_type == "MultiPolygon"
    assert area.equals(shapely.union_all(areas_of(ground)))


def test_nothing_of_vpf(tmp_path):
    with pytest.raises(NotFoundError, match="found no directory"):
        open_coverages(tmp_path / "nowhere")
    with pytest.raises(NotFoundError, match="found none of lat, cat, fcs"):
        open_coverages(tmp_path)


def test_a_library_and_a_coverage_are_opened_alone(tmp_path):
    ground = ground_of()
    path = write_database(tmp_path / "db", ground)
    for part in ("lib", "lib/land"):
        coverage = land(path / part)
        assert coverage.description == "Land"
        check_areas(read_class(coverage, coverage.classes["area"]).geometry, ground)
    problems = open_coverages(path).problems
    assert [line.split(": ")[1:] for line in problems] == [
        ["libraries of lat are missing", "gone"], ["coverages of cat are missing", "absent"],
    ]  # fmt: skip
    shutil.copytree(path / "lib/land", tmp_path / "bare" / "land")
    assert len(read_class(land(tmp_path / "bare/land"), coverage.classes["area"]).problems) == 1  # no tiles
    with pytest.raises(VpfFormatError):
        face_polygons(read_table(path / "lib/tileref/fac"))


def damaged(data, source):
    """Bytes cut off, changed, or written twice."""
    if not data:
        return data
    at = source.randrange(len(data))
    kind = source.randrange(4)
    if kind == 0:
        return data[:at]
    if kind == 1:
        return data[:at] + bytes([source.randrange(256)]) + data[at + 1 :]
    if kind == 2:
        number = struct.pack("<i", source.choice([0, -1, 1, 2**31 - 1, -(2**31), 255, 65536]))
        return data[:at] + number + data[at + 4 :]
    return data[:at] + data[max(at - 8, 0) :]


def test_damage_gives_an_error_or_features(tmp_path):
    """Bytes of every table, its index too, changed at random: nothing but our own errors, and in no time."""
    source = random.Random(17)
    outcomes = Counter()
    for tile in (0, 2):
        ground = Map([[1, 2, 2, 1], [1, 1, 0, 2]], 3, tile, n_spur=2)
        path = write_database(tmp_path / str(tile), ground, Style(coordinate="Z"))
        for file in sorted(file for file in path.rglob("*") if file.is_file()):
            before = file.read_bytes()
            file.write_bytes(damaged(before, source))
            try:
                for coverage in open_coverages(path).coverages:
                    for one in feature_classes(coverage)[0].values():
                        read_class(coverage, one)
                    for primitive in ("edg", "fac"):
                        read_primitives(coverage, primitive)
                outcomes["read"] += 1
            except VpfxError:
                outcomes["refused"] += 1
            file.write_bytes(before)
    assert min(outcomes.values()) > 10


def test_styles_differ(tmp_path):
    """The makers of test data do what they say: names, index files, byte order."""
    path = write_database(tmp_path / "db", ground_of(tile=0), replace(STYLES["plain"], is_upper=True, order=">"))
    names = sorted(file.name for file in (path / "LIB" / "LAND").iterdir())
    assert "EDG" in names
    assert index_name("edg").upper() in names
    assert (path / "LIB/LAND/EDG").read_bytes()[4:5] == b"M"


def test_a_broken_tile_of_primitives_leaves_the_others(tmp_path):
    ground = ground_of()
    path = write_database(tmp_path / "db", ground)
    edges = path / "lib/land/00/01/edg"
    edges.write_bytes(edges.read_bytes()[:20])
    for primitive in ("edg", "fac"):
        found = read_primitives(land(path), primitive)
        assert "00/01/edg" in found.problems[0]
        assert 2 not in found.fields["tile_id"].to_list()


def test_a_hierarchy_is_read_as_features(tmp_path):
    """What vpfx writes itself: each face of a level is an area with the places of its nodes, in the order of the store."""
    store = build_kind("tiles", tmp_path)
    pick(EXPORTERS, "vpf", "format").write(store, tmp_path / "terrain")
    coverages = {found.name: found for found in open_coverages(tmp_path / "terrain").coverages}
    with vpfx.open_store(store) as opened:
        for level in (0, 1):
            tin, coverage = opened.tin(level), coverages[f"tin{level}"]
            rows = read_class(coverage, feature_classes(coverage)[0]["tinface"])
            order = np.argsort(tin.face_attributes["face_id"])
            places = tin.nodes[tin.face_nodes[order]].astype(np.float32).astype(np.float64)
            assert rows.problems == ()
            assert len(rows.geometry) == len(places) > 2
            for area, corners in zip(rows.geometry, places, strict=True):
                assert sorted(area.exterior.coords[:-1]) == sorted(map(tuple, corners.tolist()))


def test_tables_without_rows(tmp_path):
    """Header-only tables of features, joins and primitives are legal."""
    ground = ground_of()
    path = write_database(tmp_path / "db", ground)
    folder = path / "lib/land"
    links = [col(name, "K") for name in ("right_face", "left_face", "right_edge", "left_edge")]
    columns = [ID, col("start_node", "I"), col("end_node", "I"), *links, col("coordinates", "C", "*")]
    write(folder / "00/01", Style(), "edg", columns, [])
    assert sum(area is None for area in read(path, "area").geometry) < len(areas_of(ground))
    write(folder, Style(), "area.ajt", [ID, col("area_id", "I"), col("tile_id", "S"), col("fac_id", "I")], [])
    write(folder, Style(), "line.lft", [ID, col("length", "F")], [])
    assert shapely.is_missing(read(path, "area").geometry).all()
    lines = read(path, "line")
    assert (len(lines.geometry), lines.fields["length"].to_list()) == (0, [])
    faces = read_primitives(land(path), "fac")
    assert 2 not in faces.fields["tile_id"].to_list()
