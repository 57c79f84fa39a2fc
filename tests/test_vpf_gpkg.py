"""VPF as a GeoPackage, by Python and from the command line; VPF as features of a build."""

from __future__ import annotations

import hashlib
import json
import re
import shutil

import fiona
import numpy as np
import pyogrio
import pytest
import shapely
from conftest import shared_dem, shared_vpf
from invariants import judge_store
from rasters import write_tiff
from surfaces import query
from test_cli import FAILURE, GOOD, USAGE, run  # noqa: F401  # the fixture
from vpf_bytes import ID, Style, col, write
from vpf_databases import expected_lines, write_database
from vpf_maps import Map

import vpfx
from vpfx.errors import FeatureFormatError, InputError, NotFoundError, VpfxWarning
from vpfx.features import read_area, read_areas, read_features
from vpfx.model import Extent
from vpfx.vpf.gpkg import write_gpkg
from vpfx.vpf.layers import layer_names, layer_source

LABELS = np.random.default_rng(5).integers(0, 3, (5, 6))
EXTENT = Extent(9.5, 49.5, 16.5, 55.5)


@pytest.fixture
def ground():
    return Map(LABELS, 5, tile=3, n_spur=3)


@pytest.fixture
def database(ground, tmp_path):
    return write_database(tmp_path / "db", ground, Style(coordinate="Z", has_heights=True))


def layers(path):
    return dict(pyogrio.list_layers(path))


def test_layers_hold_the_features(database, ground, tmp_path):
    path = tmp_path / "a.gpkg"
    written = write_gpkg(database, path)
    assert layers(path) == {
        "land_area": "Polygon Z", "land_line": "LineString Z", "land_point": "Point Z", "land_node": "Point Z",
        "land_text": "Point Z", "tileref_tileref": None,
    } | {line.layer: line.geometry for line in written.layers}  # fmt: skip
    with fiona.open(path, layer="land_area") as source:
        assert source.crs.to_string() == "EPSG:4326"
        fields = dict(source.schema["properties"])
        rows = [dict(row["properties"]) for row in source]
        areas = [shapely.geometry.shape(row["geometry"]) for row in source]
    assert fields["kind"].startswith("int32")
    assert fields["seen"].startswith("str")
    assert rows[1]["few"] == 2
    assert rows[0]["few"] is None
    assert rows[0]["kind_description"] == "Two"
    assert rows[4]["name"] == "Ålborg"
    numbers = sorted({own for cell, own in ground.areas.items() if LABELS[cell]})
    assert all(area.equals(ground.polygon(own)) for area, own in zip(areas, numbers, strict=True))
    expected, _ = expected_lines(ground)
    lines = pyogrio.raw.read(path, layer="land_line")[2]
    assert all(line.equals(other) for line, other in zip(shapely.from_wkb(lines), expected, strict=True))
    assert [re.sub(".*: ", "", line) for line in written.problems[:2]] == ["gone", "absent"]


def test_the_same_input_gives_the_same_bytes(database, tmp_path):
    digests = set()
    for name in ("a.gpkg", "b.gpkg"):
        write_gpkg(database, tmp_path / name, primitives=True)
        digests.add(hashlib.sha256((tmp_path / name).read_bytes()).hexdigest())
    assert len(digests) == 1


def test_primitives_are_layers_too(database, ground, tmp_path):
    path = tmp_path / "a.gpkg"
    write_gpkg(database, path, coverages=["LAND"], primitives=True)
    assert list(layers(path))[5:] == ["land_edg", "land_fac", "land_end", "land_cnd", "land_txt"]
    assert pyogrio.read_info(path, layer="land_edg")["features"] == sum(len(tile.edges) for tile in ground.tiles)
    assert pyogrio.read_info(path, layer="land_fac")["features"] == sum(tile.n_face - 1 for tile in ground.tiles)


def test_single_and_multiple_geometries_make_a_layer_of_multiple_ones(ground, database, tmp_path):
    """One feature gets faces apart; without a shape a feature stays, as the summary says."""
    joins = [(1, 1, 1, 2), (2, 1, ground.tiles.index(ground.tiles[-1]) + 1, 2), (3, 2, 1, 3)]
    columns = [ID, col("area_id", "I"), col("tile_id", "S"), col("fac_id", "I")]
    write(database / "lib/land", Style(), "area.ajt", columns, joins)
    written = write_gpkg(database, tmp_path / "a.gpkg")
    (line,) = (line for line in written.layers if line.layer == "land_area")
    assert (line.geometry, line.without_geometry) == ("MultiPolygon Z", line.features - 2)
    found = shapely.from_wkb(pyogrio.raw.read(tmp_path / "a.gpkg", layer="land_area")[2])
    assert [shapely.get_num_geometries(area) for area in found[:2]] == [2, 1]


@pytest.mark.parametrize(
    ("kind", "datum", "crs", "said"),
    [
        ("GEO", "WGE", "EPSG:4326", ""),
        ("GEO", "NAS", "EPSG:4267", ""),
        ("GEO", "N/A", "EPSG:4326", "found no datum, took WGS 84"),
        ("GEO", "ZZ", "EPSG:4326", "found datum 'ZZ', took WGS 84"),
        ("MAP", "WGE", None, "found data type MAP, whose CRS is not told"),
    ],
)
def test_the_crs(kind, datum, crs, said, database, tmp_path):
    columns = [ID, col("data_type", "T", 3), col("geo_datum_code", "T", 3)]
    write(database / "lib", Style(), "grt", columns, [(1, kind, datum)])
    written = write_gpkg(database, tmp_path / "a.gpkg")
    assert pyogrio.read_info(tmp_path / "a.gpkg", layer="land_area")["crs"] == crs
    assert (said in written.problems[0]) if said else not any("grt" in line for line in written.problems)
    write_gpkg(database, tmp_path / "b.gpkg", crs="EPSG:4258")
    assert pyogrio.read_info(tmp_path / "b.gpkg", layer="land_area")["crs"] == "EPSG:4258"
    if crs is None:
        with pytest.raises(FeatureFormatError, match="grt: found no CRS that is known"):
            read_features(database, "EPSG:4326", EXTENT, layer="land/line")


def test_several_libraries_and_odd_names(database, tmp_path):
    """Names of layers are told apart, and are none that SQLite or GeoPackage keep for themselves."""
    shutil.copytree(database / "lib", database / "gone")
    names = [line.layer for line in write_gpkg(database, tmp_path / "a.gpkg").layers]
    assert "lib_land_area" in names
    assert "gone_land_area" in names
    lone = tmp_path / "gpkg"
    shutil.copytree(database / "lib" / "land", lone)
    for name in ("area.aft", "area.afx"):
        (lone / name).rename(lone / name.replace("area", "contents"))
    (lone / "area.ajt").rename(lone / "contents.ajt")
    for name in ("fcs", "fca", "fcx"):
        (lone / name).unlink(missing_ok=True)
    join = (lone / "contents.ajt").read_bytes().replace(b"area_id", b"face_id")
    (lone / "contents.ajt").write_bytes(join)
    names = [line.layer for line in write_gpkg(lone, tmp_path / "b.gpkg").layers]
    assert names == ["vpf_gpkg_line", "vpf_gpkg_node", "vpf_gpkg_point", "vpf_gpkg_text"]


def test_fields_whose_names_a_geopackage_has_itself(database, tmp_path):
    columns = [ID, col("fid", "I"), col("geom", "T", 3), col("tile_id", "S"), col("end_id", "I")]
    write(database / "lib/land", Style(), "point.pft", columns, [(1, 7, "abc", 1, 1)])
    write_gpkg(database, tmp_path / "a.gpkg")
    with fiona.open(tmp_path / "a.gpkg", layer="land_point") as source:
        assert dict(next(iter(source))["properties"]) == {"id": 1, "fid": 7, "geom": "abc", "tile_id": 1, "end_id": 1}


def test_broken_classes_are_left_out(database, tmp_path):
    (database / "lib/land/area.aft").write_bytes(b"\x00\x01")
    written = write_gpkg(database, tmp_path / "a.gpkg")
    assert "land_area" not in layers(tmp_path / "a.gpkg")
    assert any("area.aft" in line and "layer land_area is left out" in line for line in written.problems)


def test_without_its_tiles_a_class_keeps_its_values(database, tmp_path):
    (database / "lib/tileref/tileref.aft").write_bytes(b"\x00\x01")
    written = write_gpkg(database, tmp_path / "a.gpkg", coverages=["land"], primitives=True)
    assert [(line.layer, line.without_geometry == line.features) for line in written.layers] == [
        (f"land_{name}", True) for name in ("area", "line", "point", "node", "text")
    ]
    assert sum("tileref.aft" in line for line in written.problems) == 1


def test_a_tile_that_leads_elsewhere_hides_no_other(database, tmp_path):
    before = write_gpkg(database, tmp_path / "a.gpkg", coverages=["land"], primitives=True)
    path = database / "lib/tileref/tileref.aft"
    data = path.read_bytes()
    at = re.search(rb"0\d[\\/]0\d", data).start()
    path.write_bytes(data[:at] + b"..\\.." + data[at + 5 :])
    written = write_gpkg(database, tmp_path / "b.gpkg", coverages=["land"], primitives=True)
    assert sum(bool(re.search(r"tileref\.aft: row \d: found .*V-202", line)) for line in written.problems) == 1
    kept = {line.layer: line.features - line.without_geometry for line in written.layers}
    for line in before.layers:
        assert 0 < kept[line.layer] <= line.features - line.without_geometry


def test_the_command(run, database, tmp_path):  # noqa: F811
    outcome = run("vpf", "to-gpkg", "db", "-o", "a.gpkg")
    assert outcome.code == GOOD
    assert re.search(r"^land_area +\d+ features, Polygon Z$", outcome.out, re.MULTILINE)
    assert re.search(r"^a\.gpkg: [\d,]+ bytes, \d+ layers$", outcome.out.splitlines()[-1])
    assert outcome.err.splitlines()[0] == "vpfx: warning: db: libraries of lat are missing: gone"
    before = (tmp_path / "a.gpkg").read_bytes()
    outcome = run("vpf", "to-gpkg", "db", "-o", "a.gpkg")
    assert (outcome.code, outcome.out) == (FAILURE, "")
    outcome = run("vpf", "to-gpkg", "db", "-o", "a.gpkg", "--overwrite", "--json", "--coverage", "land", "--primitives")
    document = json.loads(outcome.out)
    assert (outcome.code, outcome.err, document["file"]) == (GOOD, "", "a.gpkg")
    assert document["layers"][0]["layer"] == "land_area"
    assert len(document["problems"]) == 2
    assert (tmp_path / "a.gpkg").read_bytes() != before
    quiet = run("vpf", "to-gpkg", "db", "-o", "b.gpkg", "-q")
    assert (quiet.code, quiet.out, quiet.err.count("vpfx: warning: ")) == (GOOD, "", 3)


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("nowhere",), FAILURE, "nowhere: found no directory"),
        ((".",), FAILURE, ".: found none of lat, cat, fcs, edg, end, cnd, txt, expected a directory of VPF"),
        (("db", "--coverage", "sea"), USAGE, "coverage: found 'sea', expected one of: land, tileref"),
        (("db", "--crs", "Atlantis"), USAGE, "crs: found 'Atlantis', expected one that PROJ knows"),
        (("db/lib/land/00/00",), FAILURE, "found no feature class that can be read; --primitives writes edges"),
    ],
)
def test_what_cannot_be_written_leaves_nothing(arguments, code, message, run, database, tmp_path):  # noqa: F811
    outcome = run("vpf", "to-gpkg", *arguments, "-o", "a.gpkg")
    assert (outcome.code, outcome.out) == (code, "")
    assert message in outcome.err
    assert outcome.err.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["db"]


def test_a_medium_that_refuses(run, database, tmp_path, monkeypatch):  # noqa: F811
    def refuse(*_, **__):
        raise pyogrio.errors.DataSourceError("disk full")

    (tmp_path / "a.gpkg").write_bytes(b"old")
    monkeypatch.setattr(pyogrio.raw, "write", refuse)
    outcome = run("vpf", "to-gpkg", "db", "-o", "a.gpkg", "--overwrite")
    assert (outcome.code, outcome.err) == (FAILURE, "vpfx: a.gpkg: cannot be written: disk full\n")
    assert (tmp_path / "a.gpkg").read_bytes() == b"old"
    assert len(list(tmp_path.iterdir())) == 2


def test_features_of_a_build(database, ground):
    """Lines, outlines and points, with or without their heights; one layer at a time."""
    names = ["land/area", "land/line", "land/point", "land/node", "land/text", "tileref/tileref"]
    assert layer_names(database) == names
    assert layer_names(database / "lib/land") == [name.split("/")[1] for name in names[:5]]
    expected, _ = expected_lines(ground)
    found = read_features(database, "EPSG:4326", EXTENT, layer="land/line", use_z=True)
    assert len(found.lines) == len(expected)
    for line, other in zip(found.lines, expected, strict=True):
        assert shapely.LineString(line).equals(other)
        assert np.allclose(line[:, 2], 100 + line[:, 0])
    (source,) = found.sources
    assert (source.name, source.driver) == ("db", "VPF")
    assert np.isnan(read_features(database, "EPSG:4326", EXTENT, layer="land/point").lines[0][0, 2])
    rings = read_features([database / "lib"], "EPSG:4326", EXTENT, layer="LAND/AREA").lines
    assert all(np.array_equal(ring[0], ring[-1], equal_nan=True) for ring in rings)
    with pytest.raises(InputError, match="found 6 layers, expected one; choose of: land/area"):
        read_features(database, "EPSG:4326", EXTENT)
    with pytest.raises(InputError, match="found no layer 'sea', expected one of"):
        read_features(database, "EPSG:4326", EXTENT, layer="sea")
    with pytest.raises(InputError, match="found no point, line or outline on the DEM"):
        read_features(database, "EPSG:4326", Extent(100, 0, 101, 1), layer="land/line")
    with pytest.raises(NotFoundError):
        read_features(database / "nowhere", "EPSG:4326", EXTENT)


def test_digest_of_what_was_read(database):
    """Over the tables of the class and the tiles it has edges in; what it is not read from does not count."""
    digest, n_byte = layer_source(database, "land/line")
    root = database / "lib"
    tiles = sorted(root.glob("land/0?/0?/edg"))
    tables = [root / name for name in ("grt", "tileref/tileref.aft")]
    tables += [root / "land" / name for name in ("fcs", "int.vdt", "char.vdt", "line.lft", "line.ljt")]
    content = hashlib.sha256()
    for name, table in sorted((table.relative_to(root).as_posix(), table) for table in [*tables, *tiles]):
        data = table.read_bytes()
        content.update(name.encode() + b"\0" + str(len(data)).encode() + b"\0" + data)
    assert (digest, n_byte) == (content.hexdigest(), sum(table.stat().st_size for table in [*tables, *tiles]))
    (root / "land/area.aft").write_bytes(b"")
    assert layer_source(database, "land/line") == (digest, n_byte)


def test_a_guess_of_the_crs_is_a_warning(database):
    (database / "lib/grt").unlink(missing_ok=True)
    with pytest.warns(VpfxWarning, match="grt: found no datum, took WGS 84"):
        read_features(database, "EPSG:4326", EXTENT, layer="land/line")


def test_problems_are_warnings(database):
    shutil.rmtree(database / "lib/land/00/01")
    with pytest.warns(VpfxWarning, match="lie in tiles that are missing: tiles 2"):
        read_features(database, "EPSG:4326", EXTENT, layer="land/line")


def test_areas_of_vpf(database, ground):
    found = read_areas(database, "EPSG:4326", EXTENT, layer="land/area", columns=["few", "name", "kind"])
    assert {name: kind for name, (kind, _) in found.fields.items()} == {
        "few": "int16",
        "name": "object",
        "kind": "int32",
    }
    assert np.isnan(found.fields["few"][1][0])
    assert found.fields["few"][1][1] == 2
    whole = read_area(database, "EPSG:4326", EXTENT, layer="land/area")
    assert whole.symmetric_difference(
        shapely.union_all([ground.square(cell) for cell in np.ndindex(LABELS.shape) if LABELS[cell]])
    ).area < 1e-9  # fmt: skip
    with pytest.raises(InputError, match="found no field 'deepness'"):
        read_areas(database, "EPSG:4326", EXTENT, layer="land/area", columns=["deepness"])


def test_a_store_with_lines_of_vpf(run, database, tmp_path):  # noqa: F811
    heights = np.add.outer(np.arange(41) % 7, np.arange(49) % 5).astype("int16") * 10
    dem = write_tiff(tmp_path / "dem.tif", heights, 9.5, 49.5, 0.125, 0.125)
    (database / "lib/land/00/01/edg").unlink()
    flags = ("--features", "db", "--features-layer", "land/line", "--method", "constrained_delaunay_pyramid")
    outcome = run("build", dem, "-o", "a.gpkg", *flags, "--max-error", "40", "-q")
    assert outcome.code == GOOD
    assert outcome.err.startswith("vpfx: warning: ")
    assert outcome.err.endswith("lie in tiles that are missing: tiles 2\n")
    judge_store(tmp_path / "a.gpkg", dem)
    rows = query(tmp_path / "a.gpkg", "SELECT name, sha256, byte_count, driver FROM source ORDER BY name")
    assert rows[0] == ("db", *layer_source(database, "land/line"), "VPF")


@pytest.mark.slow
def test_real_boundaries_in_a_store(tmp_path):
    dem = shared_dem("killeen_cell_1arcsec_partial.tif")
    report = vpfx.build(
        dem, tmp_path / "a.gpkg", method="constrained_delaunay_pyramid", max_error=(40,),
        features=shared_vpf("vm2alv2_texash"), feature_options={"layer": "bnd/polbnda"},
    )  # fmt: skip
    judge_store(report.path, dem)


def test_real_database(tmp_path):
    written = write_gpkg(shared_vpf("vm2alv2_texash"), tmp_path / "a.gpkg", primitives=True)
    assert {line.layer: (line.features, line.geometry, line.without_geometry) for line in written.layers} == {
        "tileref_tileref": (1, "Polygon", 0), "tileref_tilereft": (1, "LineString", 0), "tileref_edg": (12, "LineString", 0),
        "tileref_fac": (1, "Polygon", 0), "tileref_cnd": (12, "Point", 0), "tileref_txt": (1, "LineString", 0),
        "bnd_markersp": (40, "Point", 0), "bnd_polbndl": (2, "LineString", 0), "bnd_polbnda": (6, "Polygon", 0),
        "bnd_bndtxt": (4, "LineString", 0), "bnd_edg": (23, "LineString", 0), "bnd_fac": (6, "Polygon", 0),
        "bnd_end": (40, "Point", 0), "bnd_cnd": (18, "Point", 0), "bnd_txt": (4, "LineString", 0),
    }  # fmt: skip
    areas = shapely.from_wkb(pyogrio.raw.read(tmp_path / "a.gpkg", layer="bnd_polbnda")[2])
    assert shapely.get_num_coordinates(areas).sum() == 1751  # others have 30 nodes of the rings twice
