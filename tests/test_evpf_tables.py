"""Exported features, hierarchy and headers, judged by a slow reader against the rows of the store."""

from __future__ import annotations

import json
import math
import sqlite3
import struct
from collections import defaultdict
from contextlib import closing
from types import SimpleNamespace

import pytest
from pyproj import CRS
from slow_vpf import head_of, read, rows_of
from surfaces import SOLID, VOIDS, hills, query, write_dem

import vpfx
from vpfx.evpf.headers import map_scale, reference_row
from vpfx.evpf.writing import export_vpf
from vpfx.model import Extent
from vpfx.store.classes import Column
from vpfx.store.edit import edit_store

STORES = {
    "tiles": (hills(30, 25), {"max_error": (30, 12), "tile_size": 12}),
    "voids": (VOIDS["ring with island"].heights, {"passes": 2, "tile_size": 8}),
    "pyramid": (hills(20, 20, 3), {"method": "delaunay_pyramid", "max_error": (20, 8), "tile_size": 10}),
    "T-junctions": (SOLID["cliff"].heights, {"method": "scarlatos", "passes": 3}),
    "no class": (hills(20, 20), {"max_error": (20, 10, 5)}),
}
SOIL = {
    "kind": Column("text", "", "Kind; as sampled"), "depth_of_the_water_table": Column("real", "m"),
    "depth_of_the_water_level": "real", "code": Column("integer", "", "What: a code"), "serial": "integer",
    "surveyed": Column("date"), "name": "text", "remark": "text", "store_id": "text",
}  # fmt: skip
FEATURES = {
    "kind": ["Löß", "clay", None, "", "a\\b"], "depth_of_the_water_table": [1.5, None, 0.1, -2.0, 1e300],
    "depth_of_the_water_level": [None] * 5, "code": [1, 2, None, 1, -7], "serial": [2**40, None, 1, -(2**31), 5],
    "surveyed": ["1998-12-01", None, "0001-01-01", "9999-12-31", "2000-02-29"],
    "name": ["Δ", "ö", "🏔", "e\\", "\\u0394"], "remark": ["x"] * 5, "store_id": ["1", "2", "3", "4", "5"],
}  # fmt: skip


def add_classes(path):
    """Give faces of several levels features, with shares, by two classes, and leave a third one without any."""
    levels = defaultdict(list)
    for face, level in query(path, "SELECT face_id, level FROM face ORDER BY face_id"):
        levels[level].append(face)
    with edit_store(path) as editor:
        editor.create_class("dropped", {"a": "text"})
        editor.add_features("dropped", {"a": ["x"]})
        editor.create_class("soil_of_the_land", SOIL, "What, where: the “soil” is")
        editor.create_class("soil_of_the_lake", {"a": "integer"})
        editor.create_class("level_1", {"b": "text"}, "Empty")
        editor.drop_class("dropped")
        soils = editor.add_features("soil_of_the_land", FEATURES)
        lakes = editor.add_features("soil_of_the_lake", {"a": [5, 6]})
        editor.describe_values("soil_of_the_land", "code", {1: "One; two", 2: "Zwölf", 99: "x" * 60})
        editor.describe_values("soil_of_the_land", "kind", {"clay": "Clay", "Löß": "Loess"})
        editor.describe_values("soil_of_the_land", "name", {"ö": "A vowel", "Δ": ""})
        editor.describe_values("soil_of_the_land", "serial", {2**40: "Much"})
        coarse, fine = levels[0], levels[max(levels)]
        editor.set_faces("soil_of_the_land", coarse[::2], soils[0])
        some = fine[1::3]
        editor.set_faces(
            "soil_of_the_land", [*some, *some], [soils[1]] * len(some) + [soils[4]] * len(some), [0.25] * 2 * len(some)
        )
        editor.set_faces("soil_of_the_lake", fine[::5], lakes[1])


@pytest.fixture(scope="module", params=STORES)
def exported(request, tmp_path_factory):
    """Export a store; return its path, the database and whether precision is double."""
    folder = tmp_path_factory.mktemp("exported")
    heights, options = STORES[request.param]
    path = vpfx.build(write_dem(folder / "a.tif", heights), folder / "a.gpkg", **options).path
    if request.param != "no class":
        add_classes(path)
    is_double = request.param in ("voids", "no class")
    export_vpf(path, folder / "vpf", is_double=is_double)
    return path, folder / "vpf" / "terrain", is_double


def levels_of(path):
    return [level for (level,) in query(path, "SELECT level FROM level ORDER BY level")]


def fac_of(path):
    """Return tile and row in `fac` of each face, and its row in `tinface.aft`."""
    fac, row, counts, totals = {}, {}, defaultdict(lambda: 1), defaultdict(int)
    for face, tile, level in query(path, "SELECT face_id, tile_id, level FROM face ORDER BY level, tile_id, face_id"):
        counts[tile, level] += 1
        totals[level] += 1
        fac[face], row[face] = (tile, counts[tile, level]), totals[level]
    return fac, row


def rounded(number):
    return None if number is None else struct.unpack("<f", struct.pack("<f", number))[0]


def test_faces_are_features(exported):
    path, library, _ = exported
    fac, row = fac_of(path)
    for level in levels_of(path):
        parents = dict(query(path, "SELECT child_face, parent_face FROM parent_child"))
        is_nested = not query(path, "SELECT 1 FROM shared_area LIMIT 1")
        wanted = []
        rows = query(path, "SELECT face_id, slope_centidegrees, aspect_centidegrees, is_filled FROM face WHERE level = ? "
                           "ORDER BY tile_id, face_id", level)  # fmt: skip
        for face, slope, aspect, filled in rows:
            parent = row[parents[face]] if level and is_nested else None
            wanted.append(
                (rounded(slope / 100), rounded(None if aspect is None else aspect / 100), filled, parent, *fac[face])
            )
        table = library / f"tin{level}" / "tinface.aft"
        assert rows_of(table, "slope", "aspect", "filled", "parent", "tile_id", "fac_id") == wanted


def test_nodes_are_features(exported):
    path, library, is_double = exported
    for level in levels_of(path):
        wanted, last, n = [], 0, 0
        rows = query(
            path, "SELECT DISTINCT f.tile_id, n.node_id, n.z, n.z_parent, n.level FROM face f JOIN node n ON n.node_id IN "
                  "(f.node_1, f.node_2, f.node_3) WHERE f.level = ? ORDER BY f.tile_id, n.node_id", level
        )  # fmt: skip
        for tile, _, z, z_parent, first in rows:
            n = n + 1 if tile == last else 1
            last = tile
            heights = (z, z_parent) if is_double else (rounded(z), rounded(z_parent))
            wanted.append((*heights, first, tile, n))
        assert (
            rows_of(library / f"tin{level}" / "tinnode.pft", "z", "z_parent", "first_level", "tile_id", "cnd_id")
            == wanted
        )
        index = [(n, tile, 2, i) for i, (*_, tile, n) in enumerate(wanted, 1)]
        assert rows_of(library / f"tin{level}" / "cnd.fit", "prim_id", "tile_id", "fc_id", "feature_id") == index


def test_links_to_parents(exported):
    path, library, _ = exported
    fac, _ = fac_of(path)
    assert not (library / "tin0" / "parent.rat").exists()
    for level in levels_of(path)[1:]:
        rows = query(
            path, "SELECT p.parent_face, p.child_face, s.area FROM parent_child p JOIN face f ON f.face_id = p.child_face "
                  "LEFT JOIN shared_area s USING (child_face, parent_face) WHERE f.level = ? ORDER BY f.tile_id, 2, 1", level
        )  # fmt: skip
        wanted = [(fac[child][0], fac[parent][1], fac[child][1], area) for parent, child, area in rows]
        table = rows_of(library / f"tin{level}" / "parent.rat")
        assert table == (wanted if wanted[0][3] is not None else [row[:3] for row in wanted])


def classes_of(path):
    return query(path, "SELECT class_id, class_name FROM feature_class ORDER BY class_id")


NAMES = {"soil_of_the_land": "soil_of_", "soil_of_the_lake": "soil_o01", "level_1": "level_1"}


def test_classes_inherit(exported):
    path, library, _ = exported
    fac, _ = fac_of(path)
    for level in levels_of(path):
        coverage = library / f"tin{level}"
        index = [
            (face[1], face[0], 1, i) for i, face in enumerate(rows_of(coverage / "tinface.aft", "tile_id", "fac_id"), 1)
        ]
        for number, (class_id, name) in enumerate(classes_of(path), 3):
            features = [
                row[0] for row in query(path, "SELECT feature_id FROM feature WHERE class_id = ? ORDER BY 1", class_id)
            ]
            given = query(path, "SELECT feature_id, face_id, share FROM face_attribute WHERE level = ? AND class_name = ?",
                          level, name)  # fmt: skip
            wanted = sorted((features.index(feature) + 1, *fac[face], share) for feature, face, share in given)
            table = coverage / f"{NAMES[name]}.ajt"
            found = rows_of(table, f"{NAMES[name]}_id", "tile_id", "fac_id", "share")
            assert [row[:3] for row in found] == [row[:3] for row in wanted]
            assert all(math.isclose(a[3], b[3], rel_tol=1e-9) for a, b in zip(found, wanted, strict=True))
            index += [(face, tile, number, feature) for feature, tile, face, _ in wanted]
        in_order = sorted(index, key=lambda row: (row[1], row[0], row[2], row[3]))
        assert rows_of(coverage / "fac.fit", "prim_id", "tile_id", "fc_id", "feature_id") == in_order


def test_features_of_classes(exported):
    path, library, _ = exported
    if not classes_of(path):
        return
    names = [
        "kind",
        "depth_of_the_wat",
        "depth_of_the_w01",
        "code",
        "serial",
        "surveyed",
        "name",
        "remark",
        "store_id01",
    ]
    for level in levels_of(path):
        data = (library / f"tin{level}" / "soil_of_.aft").read_bytes()
        _, fields = head_of(data)
        assert list(fields) == ["id", *names, "store_id"]
        assert [fields[name][:2] for name in fields] == [
            ["I", "1"], ["L", "*"], ["R", "1"], ["R", "1"], ["I", "1"], ["T", "*"], ["D", "1"], ["T", "*"], ["T", "*"],
            ["T", "*"], ["I", "1"],
        ]  # fmt: skip
        assert fields["kind"][3:5] == ["Kind as sampled", "char.vdt"]
        assert fields["code"][3:5] == ["What a code", "int.vdt"]
        assert fields["serial"][4:5] == ["char.vdt"]
        table = read(library / f"tin{level}" / "soil_of_.aft")
        assert table["kind"] == ["Löß", "clay", None, "\\e", "a\\\\b"]
        assert table["name"] == ["\\u0394", "\\u00f6", "\\ud83c\\udfd4", "e\\\\", "\\\\u0394"]
        assert table["depth_of_the_wat"] == FEATURES["depth_of_the_water_table"]
        assert table["code"] == FEATURES["code"]
        assert table["serial"] == [None if n is None else str(n) for n in FEATURES["serial"]]
        days = [None if day is None else f"{day.replace('-', '')}000000.00000" for day in FEATURES["surveyed"]]
        assert table["surveyed"] == days
        assert table["store_id"] == [
            row[0] for row in query(path, "SELECT feature_id FROM soil_of_the_land ORDER BY 1")
        ]
        values = rows_of(library / f"tin{level}" / "int.vdt")
        assert values == [
            ("tinface.aft", "filled", 0, "Ground with data"), ("tinface.aft", "filled", 1, "Heights interpolated"),
            ("soil_of_.aft", "code", 1, "One; two"), ("soil_of_.aft", "code", 2, "Zw?lf"),
            ("soil_of_.aft", "code", 99, "x" * 50),
        ]  # fmt: skip
        texts = rows_of(library / f"tin{level}" / "char.vdt")
        assert texts == [
            ("soil_of_.aft", "kind", "Löß", "Loess"), ("soil_of_.aft", "kind", "clay", "Clay"),
            ("soil_of_.aft", "name", "\\u00f6", "A vowel"), ("soil_of_.aft", "serial", str(2**40), "Much"),
        ]  # fmt: skip


def spelled(texts):
    """Return texts of one column as the page says they are written."""
    plain = [text.replace("\\", "\\\\") or "\\e" for text in texts]
    try:
        "".join(plain).encode("latin-1")
    except UnicodeEncodeError:
        return ["".join(c if c < "\x80" else "".join(f"\\u{n:04x}" for n in units(c)) for c in text) for text in plain]
    return plain


def units(character):
    """Return the numbers of UTF-16 for a character."""
    data = character.encode("utf-16-le")
    return struct.unpack(f"<{len(data) // 2}H", data)


def test_attributes_as_given(exported):
    path, library, _ = exported
    fac, _ = fac_of(path)
    classes = classes_of(path)
    tin0 = library / "tin0"
    if not classes:
        assert not any((tin0 / f"{name}.rat").exists() for name in ("class", "column", "value", "own"))
        return
    texts = query(path, "SELECT class_name, description, class_id FROM feature_class ORDER BY class_id")
    described = spelled([row[1] for row in texts])
    wanted = [(name, text, NAMES[name], class_id) for (name, _, class_id), text in zip(texts, described, strict=True)]
    assert rows_of(tin0 / "class.rat") == wanted
    columns = rows_of(tin0 / "column.rat", "class_id", "name", "vpf_name", "kind", "unit", "description")
    wanted = [(1, name, Column(*([kind] if isinstance(kind, str) else kind))) for name, kind in SOIL.items()]
    wanted += [(2, "a", Column("integer")), (3, "b", Column("text"))]
    assert [row[:2] for row in columns] == [row[:2] for row in wanted]
    assert [row[3:] for row in columns] == [(c.kind, c.unit or "\\e", c.description or "\\e") for *_, c in wanted]
    assert columns[8][2] == "store_id01"
    values = query(path, "SELECT column_name, value, description FROM value_description")
    number = {row[1]: i for i, row in enumerate(columns, 1) if row[0] == 1}
    written = rows_of(tin0 / "value.rat")
    values.sort(key=lambda row: (number[row[0]], row[1]))
    spellings = (spelled([row[i] for row in values]) for i in (1, 2))
    assert written == list(zip([number[row[0]] for row in values], *spellings, strict=True))
    ids = {class_id: i for i, (class_id, _) in enumerate(classes, 1)}
    for level in levels_of(path):
        rows = query(path, "SELECT face_id, class_id, feature_id, share FROM face_feature JOIN face USING (face_id) "
                           "WHERE level = ? ORDER BY tile_id, face_id, class_id, feature_id", level)  # fmt: skip
        features = defaultdict(list)
        for class_id, feature in query(path, "SELECT class_id, feature_id FROM feature ORDER BY 2"):
            features[class_id].append(feature)
        wanted = [(*fac[face], ids[c], features[c].index(feature) + 1, share) for face, c, feature, share in rows]
        assert rows_of(library / f"tin{level}" / "own.rat") == wanted


def test_levels_and_what_the_store_knows(exported):
    path, library, is_double = exported
    kinds = ("one edge", "two edges", "three edges", "centre", "centre and one edge")
    for level, *known in query(
        path, "SELECT level, max_error_bound, max_error, rmse, max_rise, post_count, node_count, edge_count, face_count "
              "FROM level"
    ):  # fmt: skip
        cuts = dict(query(path, "SELECT kind, cut_count FROM level_cut WHERE level = ?", level))
        known[4] = str(known[4])
        (row,) = rows_of(library / f"tin{level}" / "level.rat")
        assert row == (level, *known, *(cuts[kind] for kind in kinds))
        junctions = query(path, "SELECT node_id FROM t_junction WHERE level = ?", level)
        assert (library / f"tin{level}" / "tjunct.rat").exists() == bool(junctions)
        if junctions:
            assert len(read(library / f"tin{level}" / "tjunct.rat")["id"]) == len(junctions)
    metadata = query(path, "SELECT name, value FROM metadata ORDER BY name")
    options = json.loads(dict(metadata)["options"])
    own = [("evpf_version", "1.0"), ("precision", "double" if is_double else "single"),
           ("level_count", str(len(levels_of(path)))), ("tile_size", str(options["tile_size"]))]  # fmt: skip
    names, values = zip(*own, *metadata, strict=True)
    assert rows_of(library / "tin0" / "evpf.rat") == list(zip(names, spelled(values), strict=True))
    sources = query(path, "SELECT name, sha256, cast(byte_count AS TEXT), driver FROM source ORDER BY source_id")
    assert rows_of(library / "tin0" / "source.rat") == sources


def test_gaps_of_t_junctions(exported):
    path, library, _ = exported
    fac, _ = fac_of(path)
    for (level,) in query(path, "SELECT DISTINCT level FROM t_junction"):
        rows = query(
            path, "SELECT f.face_id, j.node_id, j.gap FROM t_junction j JOIN face f ON j.edge_id IN "
                  "(f.edge_1, f.edge_2, f.edge_3) WHERE j.level = ? ORDER BY f.tile_id, f.face_id, j.node_id", level
        )  # fmt: skip
        nodes = sorted(
            {n for row in query(path, "SELECT node_1, node_2, node_3 FROM face WHERE level = ?", level) for n in row}
        )
        wanted = [(*fac[face], nodes.index(node) + 1, gap) for face, node, gap in rows]
        assert rows_of(library / f"tin{level}" / "tjunct.rat") == wanted


def test_schema(exported):
    path, library, _ = exported
    names = [NAMES[name] for _, name in classes_of(path)]
    for level in levels_of(path):
        coverage = library / f"tin{level}"
        rows = rows_of(coverage / "fcs")
        ways = [("tinface", "tinface.aft", "fac_id", "fac", "id"), ("tinnode", "tinnode.pft", "cnd_id", "cnd", "id")]
        for name in names:
            ways.append((name, f"{name}.aft", "id", f"{name}.ajt", f"{name}_id"))
            ways.append((name, f"{name}.ajt", "fac_id", "fac", "id"))
        both = [row for c, a, x, b, y in ways for row in ((c, a, x, b, y), (c, b, y, a, x))]
        assert rows[: len(both)] == both
        related = [row[3] for row in rows[len(both) :]]
        assert sorted(related) == sorted(path.name for path in coverage.glob("*.rat"))
        assert all(row == ("tinface", "tinface.aft", "id", row[3], "id") for row in rows[len(both) :])
        assert [row[:2] for row in rows_of(coverage / "fca")] == [
            ("tinface", "A"),
            ("tinnode", "P"),
            *((n, "A") for n in names),
        ]
        known = {"fcs", "fca", "int.vdt", "fac.fit", "cnd.fit", "tile1.ati", "tile2.pti", *related}
        known |= {row[i] for row in both for i in (1, 3)} - {"fac", "cnd"}
        columns = {
            name: head_of((coverage / name).read_bytes())[1] for name in known if name[:5] not in ("tile1", "tile2")
        }
        variable = {
            name for name, fields in columns.items() if any(f[0] == "K" or f[1] == "*" for f in fields.values())
        }
        known |= {f"{name[:-1]}x" for name in variable} | ({"char.vdt"} if names else set())
        tiles = {row[0].split("\\")[0] for row in rows_of(library / "tileref" / "tileref.aft", "tile_name")}
        assert {path.name for path in coverage.iterdir()} == known | tiles


def test_tiles_are_indexed(exported):
    path, library, _ = exported
    for level in levels_of(path):
        for name, table in (("tile1.ati", "tinface.aft"), ("tile2.pti", "tinnode.pft")):
            data = (library / f"tin{level}" / name).read_bytes()
            of_tile = defaultdict(list)
            for i, (tile,) in enumerate(rows_of(library / f"tin{level}" / table, "tile_id"), 1):
                of_tile[tile].append(i)
            first, n_value, n_row, kind, value_kind, count, row_kind, of, column = struct.unpack_from(
                "<3i2ci c12s25s".replace(" ", ""), data
            )
            assert (n_value, n_row, kind, value_kind, count) == (
                len(of_tile),
                sum(map(len, of_tile.values())),
                b"I",
                b"S",
                1,
            )
            assert (of.rstrip(), column.rstrip(b"\0 ")) == (table.encode(), b"tile_id")
            found, width = {}, {b"S": "h", b"I": "i"}[row_kind]
            for i in range(n_value):
                tile, offset, size = struct.unpack_from("<hii", data, 60 + 10 * i)
                found[tile] = list(struct.unpack_from(f"<{size}{width}", data, offset)) if size else [offset]
            assert found == of_tile
            assert first == 60 + 10 * n_value
            _, fields = head_of((library / f"tin{level}" / table).read_bytes())
            assert fields["tile_id"][5] == name


def test_headers(exported):
    path, library, _ = exported
    levels = levels_of(path)
    database = library.parent
    assert {p.name for p in database.iterdir()} == {"dht", "lat", "terrain"}
    coverages = ["libref", "tileref", *(f"tin{level}" for level in levels)]
    assert {p.name for p in library.iterdir()} == {"lht", "grt", "cat", "dqt", "dqx", *coverages}
    (dht,) = rows_of(database / "dht", "vpf_version", "database_name", "originator", "num_data_sets", "edition_date")
    assert dht == ("MILSTD2407", "vpf", "vpfx", "1", None)
    ((name, *box),) = rows_of(database / "lat")
    extent = query(path, "SELECT min(xmin), min(ymin), max(xmax), max(ymax) FROM tile")[0]
    margin = 0.01 * max(extent[2] - extent[0], extent[3] - extent[1])
    assert name == "terrain"
    assert all(0 <= step < 1 for step in (extent[0] - margin - box[0], extent[1] - margin - box[1]))
    assert all(0 <= step < 1 for step in (box[2] - extent[2] - margin, box[3] - extent[3] - margin))
    (lht,) = rows_of(library / "lht", "product_type", "library_name", "data_struct_code", "scale", "source_date")
    assert lht == ("TIN", "terrain", "8", 60000, None)
    grt = {name: values[0] for name, values in read(library / "grt").items()}
    assert grt == {
        "id": 1, "data_type": "MAP", "units": "M", "ellipsoid_name": "WGS 84",
        "ellipsoid_detail": "A=6378137.0 B=6356752.3 Meters", "vert_datum_name": None, "vert_datum_code": None,
        "sound_datum_name": None, "sound_datum_code": None, "geo_datum_name": "WGS 84", "geo_datum_code": "WGE",
        "projection_name": "UTM zone 13N",
    }  # fmt: skip
    assert rows_of(library / "cat", "coverage_name", "level") == [(name, 3) for name in coverages]
    assert len(read(library / "dqt")["id"]) == 1


WGS_84 = ("WGS 84", "A=6378137.0 B=6356752.3 Meters")
GRS_80 = ("GRS 1980", "A=6378137.0 B=6356752.3 Meters")
REFERENCES = {
    "EPSG:4326": ("GEO", *WGS_84, "WGS 84", "WGE", None),
    "EPSG:4322": ("GEO", "WGS 72", "A=6378135.0 B=6356750.5 Meters", "WGS 72", "WGC", None),
    "EPSG:4269": ("GEO", *GRS_80, "NAD83", "NAR", None),
    "EPSG:4267": ("GEO", "Clarke 1866", "A=6378206.4 B=6356583.8 Meters", "NAD27", "NAS", None),
    "EPSG:4230": ("GEO", "International 1", "A=6378388.0 B=6356911.9 Meters", "ED50", "EUR", None),
    "EPSG:26913": ("MAP", *GRS_80, "NAD83", "NAR", "UTM zone 13N"),
    "EPSG:31468": ("MAP", "Bessel 1841", "A=6377397.2 B=6356079.0 Meters", "Deutsches Haupt", "ZY", "3-degree Gauss-Kruge"),
    "": ("TAB", None, None, None, None, None),
}  # fmt: skip


@pytest.mark.parametrize("crs", REFERENCES)
def test_crs_by_name_and_code(crs):
    known = SimpleNamespace(crs=CRS(crs).to_wkt() if crs else "", metadata={"vertical_datum": "EPSG:5773"})
    row = reference_row(known)
    names = ("data_type", "ellipsoid_name", "ellipsoid_detail", "geo_datum_name", "geo_datum_code", "projection_name")
    assert tuple(row.get(name) for name in names) == REFERENCES[crs]
    assert (row["units"], row["vert_datum_name"], row["vert_datum_code"]) == ("M", "EPSG:5773", "ZY")


@pytest.mark.parametrize(
    ("crs", "extent", "step", "scale"),
    [
        ("EPSG:32613", (5e5, 4e6, 6e5, 4.1e6), 30.0, 60000), ("EPSG:32613", (5e5, 4e6, 6e5, 4.1e6), 0.1, 200),
        ("EPSG:4326", (10, 50, 11, 51), 1 / 3600, 62000), ("EPSG:2227", (6e6, 2e6, 6.1e6, 2.1e6), 100.0, 61000),
        ("", (0, 0, 9, 9), 1e-7, 1), ("", (0, 0, 9, 9), 1e9, 2**31 - 1),
    ],
)  # fmt: skip
def test_scale_is_that_of_half_a_millimetre(crs, extent, step, scale):
    metadata = {"lattice": {"dx": step, "dy": step}}
    known = SimpleNamespace(crs=CRS(crs).to_wkt() if crs else "", metadata=metadata, extent=Extent(*extent))
    assert map_scale(known) == scale


def test_references(exported):
    path, library, is_double = exported
    tiles = query(path, "SELECT xmin, ymin, xmax, ymax FROM tile ORDER BY tile_id")
    table = rows_of(library / "tileref" / "tileref.aft")
    assert [row[1] for row in table] == list(range(2, len(tiles) + 2))
    rows = len({tile[1] for tile in tiles})
    cols = len(tiles) // rows
    assert [row[0] for row in table] == [f"{r:02}\\{c:02}" for r in range(rows) for c in range(cols)]
    boxes = rows_of(library / "tileref" / "fbr")
    for tile, box in zip(tiles, boxes[1:], strict=True):
        assert all(a <= b for a, b in zip(box[:2], tile[:2], strict=True))
        assert all(a >= b for a, b in zip(box[2:], tile[2:], strict=True))
        assert all(abs(a - b) <= 0.5 for a, b in zip(box, tile, strict=True))
    for name, kind in (("libref", "libref.lft"), ("tileref", "tileref.aft")):
        key = "edg" if name == "libref" else "fac"
        assert rows_of(library / name / "fcs") == [
            (name, kind, f"{key}_id", key, "id"),
            (name, key, "id", kind, f"{key}_id"),
        ]
        edges = read(library / name / "edg")
        fields = head_of((library / name / "edg").read_bytes())[1]
        assert fields["coordinates"][:2] == ["B" if is_double else "C", "*"]
        assert fields["right_face"][0] == "K"
        nodes = read(library / name / "cnd")["coordinate"]
        for start, end, line in zip(edges["start_node"], edges["end_node"], edges["coordinates"], strict=True):
            assert (line[0], line[-1]) == (nodes[start - 1], nodes[end - 1])
        faces = read(library / name / "fac")["ring_ptr"]
        n_node, n_edge, n_face = len(nodes), len(edges["id"]), len(faces)
        assert n_node - n_edge + n_face == 2
    assert rows_of(library / "libref" / "libref.lft") == [(1,)]
    assert read(library / "libref" / "edg")["left_face"] == [(2, 0, 0)]
    assert read(library / "libref" / "rng")["start_edge"] == [None, 1, 1]


def test_same_store_same_bytes(exported, tmp_path):
    path, library, is_double = exported
    export_vpf(path, tmp_path / "vpf", is_double=is_double)
    files = {p.relative_to(tmp_path): p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    root = library.parents[1]
    assert files == {p.relative_to(root): p.read_bytes() for p in (root / "vpf").rglob("*") if p.is_file()}


def test_upper_case(exported, tmp_path):
    """Names are upper case everywhere; what the tables say besides is the same."""
    path, library, is_double = exported
    export_vpf(path, tmp_path / "VPF", is_double=is_double, is_upper=True, library="Terrain")
    upper = tmp_path / "VPF" / "TERRAIN"
    names = {str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*")}
    assert names == {str(p.relative_to(library.parents[1])).upper() for p in library.parent.rglob("*")} | {"VPF"}
    for level in levels_of(path):
        lower = rows_of(library / f"tin{level}" / "fcs")
        assert rows_of(upper / f"TIN{level}" / "FCS") == [
            (c.upper(), a.upper(), x, b.upper(), y) for c, a, x, b, y in lower
        ]
        assert rows_of(upper / f"TIN{level}" / "INT.VDT", "table")[0] == ("TINFACE.AFT",)
        fields = head_of((upper / f"TIN{level}" / "TINFACE.AFT").read_bytes())[1]
        assert (fields["filled"][4], fields["tile_id"][5]) == ("INT.VDT", "TILE1.ATI")
        assert rows_of(upper / f"TIN{level}" / "TINFACE.AFT") == rows_of(library / f"tin{level}" / "tinface.aft")
    assert rows_of(upper / "CAT", "coverage_name")[:2] == [("LIBREF",), ("TILEREF",)]


def test_database_is_whole(exported):
    """SQLite finds nothing changed in the store: it is only read."""
    path, *_ = exported
    with closing(sqlite3.connect(path)) as store:
        assert store.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    assert [p.name for p in path.parent.iterdir() if p.name.startswith(".")] == []
