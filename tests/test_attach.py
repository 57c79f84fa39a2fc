"""Attaching: areas, rasters, functions and SQL against a search face by face."""

from __future__ import annotations

import json
import shutil
from collections import Counter
from pathlib import Path

import numpy as np
import pyproj
import pytest
import rasterio
import shapely
from rasterio.transform import from_origin
from surfaces import hills, query, write_dem

import vpfx
from vpfx.attach import attach_areas, attach_function, attach_raster, attach_sql
from vpfx.cli import main
from vpfx.errors import DemFormatError, FeatureFormatError, InputError, NotFoundError, StoreFormatError
from vpfx.query.attributes import attributes

CRS = "EPSG:32613"
SIDE = 39 * 30.0


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("attach")
    dem = write_dem(folder / "a.tif", hills(40, 40))
    return vpfx.build(dem, folder / "a.gpkg", max_error=(30, 15, 8), tile_size=20).path


@pytest.fixture
def path(made, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return Path(shutil.copy(made, tmp_path / "a.gpkg"))


def triangles(path, level):
    """Return the faces of a level as polygons, by id."""
    rows = query(path, "SELECT face_id, node_1, node_2, node_3 FROM face WHERE level = ?", level)
    place = {row[0]: row[1:] for row in query(path, "SELECT node_id, x, y FROM node")}
    return {face: shapely.Polygon([place[node] for node in nodes]) for face, *nodes in rows}


AREAS = {
    "west": [(-0.1, -0.1), (0.47, -0.1), (0.38, 1.1), (-0.1, 1.1)],
    "east": [(0.47, -0.1), (1.2, -0.1), (1.2, 0.7), (0.42, 0.7)],
    "overlap": [(0.3, 0.3), (0.6, 0.35), (0.5, 0.6)],
    "far": [(5, 5), (6, 5), (5, 6)],
}


def write_areas(name="areas.geojson", crs=CRS, areas=None):
    """Write areas given in parts of the extent; return them as polygons in the CRS of the store."""
    found = {kind: shapely.Polygon(np.array(ring) * SIDE + (5e5, 4e6)) for kind, ring in (areas or AREAS).items()}
    to_file = pyproj.Transformer.from_crs(CRS, crs, always_xy=True)
    features = [
        {
            "type": "Feature",
            "properties": {"Kind": kind, "depth": i + 0.5 if i else None, "code": i, "seen": f"1996-0{i + 1}-01"},
            "geometry": shapely.geometry.mapping(shapely.transform(area, to_file.transform, interleaved=False)),
        }
        for i, (kind, area) in enumerate(found.items())
    ]
    document = {"type": "FeatureCollection", "features": features}
    if crs != "EPSG:4326":
        document["crs"] = {"type": "name", "properties": {"name": f"urn:ogc:def:crs:{crs.replace(':', '::')}"}}
    Path(name).write_text(json.dumps(document), encoding="utf-8")
    return found


def attached(path, name, column, level):
    """Return what the faces of a level have by themselves: {face: {value: share}}."""
    rows = query(
        path,
        f"SELECT w.face_id, c.{column}, w.share FROM face_feature w JOIN {name} c USING (feature_id) "
        "JOIN face f USING (face_id) WHERE f.level = ?", level)  # fmt: skip
    found = {}
    for face, value, share in rows:
        found.setdefault(face, {})[value] = share
    return found


@pytest.mark.parametrize("level", [None, 0])
@pytest.mark.parametrize("by", ["centroid", "majority", "share"])
def test_areas(by, level, path):
    areas = write_areas()
    done = attach_areas(path, "soil", "areas.geojson", by=by, level=level)
    number = 2 if level is None else level
    expected = {}
    for face, triangle in triangles(path, number).items():
        shares = {kind: area.intersection(triangle).area / triangle.area for kind, area in areas.items()}
        shares = {kind: share for kind, share in shares.items() if share > 1e-9}
        covered = sum(shares.values())
        if by == "share":
            shares = {kind: share / max(1.0, covered) for kind, share in shares.items()}
        elif by == "majority":
            most = max(shares, key=shares.get, default=None)
            shares = {most: 1.0} if shares and shares[most] >= 1 - covered else {}
        else:
            shares = dict.fromkeys(
                [kind for kind, area in areas.items() if area.intersects(triangle.centroid)][:1], 1.0
            )
        if shares:
            expected[face] = shares
    found = attached(path, "soil", "kind", number)
    assert found.keys() == expected.keys()
    for face, shares in expected.items():
        assert found[face] == pytest.approx(shares, abs=1e-9)
    assert done == (len({kind for shares in expected.values() for kind in shares}), len(expected))
    rows = query(path, "SELECT kind, depth, code, seen FROM soil ORDER BY feature_id")
    assert rows[:2] == [("west", None, 0, "1996-01-01"), ("east", 1.5, 1, "1996-02-01")]
    assert query(path, "SELECT column_name, kind FROM feature_column ORDER BY 1") == [
        ("code", "integer"), ("depth", "real"), ("kind", "text"), ("seen", "date")
    ]  # fmt: skip


def test_areas_in_another_crs(path):
    write_areas()
    write_areas("lonlat.geojson", crs="EPSG:4326")
    attach_areas(path, "soil", "areas.geojson", by="share", columns=["Kind"])
    attach_areas(path, "other", "lonlat.geojson", by="share", columns=["kind=Kind"])
    one, other = attached(path, "soil", "kind", 2), attached(path, "other", "kind", 2)
    assert one.keys() == other.keys()
    for face, shares in one.items():
        assert {k: s for k, s in other[face].items() if s > 1e-3} == pytest.approx(
            {k: s for k, s in shares.items() if s > 1e-3}, abs=1e-3
        )


def test_coarser_levels_have_the_same_area(path):
    write_areas()
    attach_areas(path, "soil", "areas.geojson", by="share")
    sums = query(
        path,
        "SELECT v.level, v.feature_id, sum(v.share * a.area) FROM face_attribute v JOIN face_area a USING (face_id) "
        "GROUP BY 1, 2",
    )
    by_level = [[area for at, _, area in sums if at == level] for level in range(3)]
    assert by_level[0] == pytest.approx(by_level[2], rel=1e-9)
    assert by_level[1] == pytest.approx(by_level[2], rel=1e-9)


def write_raster(name, values, cell, crs=CRS, nodata=0, dtype="uint8", x0=5e5, top=4e6 + SIDE):
    profile = {"driver": "GTiff", "height": values.shape[0], "width": values.shape[1], "count": 1, "dtype": dtype,
               "crs": crs, "nodata": nodata, "transform": from_origin(x0, top, cell, cell)}  # fmt: skip
    with rasterio.open(name, "w", **profile) as raster:
        raster.write(values.astype(dtype), 1)


@pytest.mark.parametrize("cell", [13.37, 29.3, 91.1])
@pytest.mark.parametrize("level", [0, 2])
def test_raster(level, cell, path):
    """No cell has its centre on an edge."""
    n = int(SIDE // cell) + 1
    values = np.random.default_rng(1).integers(0, 4, (n, n))
    write_raster("cover.tif", values, cell)
    attach_raster(path, "cover", "cover.tif", level=level)
    shapes = triangles(path, level)
    faces, tree = sorted(shapes), shapely.STRtree([shapes[face] for face in sorted(shapes)])
    counts = {}
    for row, column in np.ndindex(n, n):
        x, y = 5e5 + (column + 0.5) * cell, 4e6 + SIDE - (row + 0.5) * cell
        hits = tree.query(shapely.Point(x, y), predicate="intersects")
        if len(hits) and values[row, column]:
            counts.setdefault(faces[min(hits)], Counter())[int(values[row, column])] += 1
    expected = {
        face: min(count, key=lambda value, count=count: (-count[value], value)) for face, count in counts.items()
    }
    for face, shape in shapes.items():
        column, row = int((shape.centroid.x - 5e5) // cell), int((4e6 + SIDE - shape.centroid.y) // cell)
        if face not in expected and values[row, column]:
            expected[face] = int(values[row, column])
    found = attached(path, "cover", "value", level)
    assert found == {face: {value: 1.0} for face, value in expected.items()}


def test_raster_in_another_crs(path):
    values = np.repeat([[1, 2]], 200, axis=0).repeat(100, axis=1)
    write_raster("utm.tif", values, SIDE / 200)
    with rasterio.open("utm.tif") as source:
        transform, width, height = rasterio.warp.calculate_default_transform(
            CRS, "EPSG:4326", source.width, source.height, *source.bounds
        )
        warped = np.zeros((height, width), np.uint8)
        rasterio.warp.reproject(rasterio.band(source, 1), warped, dst_transform=transform, dst_crs="EPSG:4326")
    profile = {"driver": "GTiff", "height": height, "width": width, "count": 1, "dtype": "uint8", "crs": "EPSG:4326",
               "nodata": 0, "transform": transform}  # fmt: skip
    with rasterio.open("lonlat.tif", "w", **profile) as raster:
        raster.write(warped, 1)
    attach_raster(path, "one", "utm.tif")
    attach_raster(path, "other", "lonlat.tif")
    one, other = attached(path, "one", "value", 2), attached(path, "other", "value", 2)
    same = [face for face in one if other.get(face) == one[face]]
    assert len(same) > 0.98 * len(one)


def test_function(path):
    def side(tin):
        x = tin.nodes[tin.face_nodes, 0].mean(axis=1)
        return np.where(x < 5e5 + SIDE / 2, "west", "east")

    assert attach_function(path, "side", side, level=1).features == 2
    for face, triangle in triangles(path, 1).items():
        assert attached(path, "side", "value", 1)[face] == {
            "west" if triangle.centroid.x < 5e5 + SIDE / 2 else "east": 1.0
        }
        break
    attach_function(path, "steep", lambda tin: np.where(tin.face_attributes["slope"] > 20, 1.0, np.nan))
    assert query(path, "SELECT value FROM steep") == [(1.0,)]
    with vpfx.open_store(path) as store:
        tin = store.tin(2)
        found = attributes(store, tin.face_attributes["face_id"], "steep")
    assert found.of.tolist() == np.flatnonzero(tin.face_attributes["slope"] > 20).tolist()
    days = np.array(["1998-12-01", "NaT"], "datetime64[D]")
    attach_function(path, "day", lambda tin: days[np.arange(tin.n_face) % 2], column="seen")
    assert query(path, "SELECT seen FROM day") == [("1998-12-01",)]


def test_sql(path):
    done = attach_sql(path, "steep", "SELECT face_id, slope > 20 AS is_steep, tile_id AS at FROM face_2")
    assert done.faces == len(triangles(path, 2))
    assert query(path, "SELECT count(*) FROM steep") == [(done.features,)]
    wrong = query(
        path,
        "SELECT count(*) FROM face_2 f JOIN face_feature USING (face_id) JOIN steep s USING (feature_id) "
        "WHERE s.is_steep <> (f.slope > 20) OR s.at <> f.tile_id",
    )
    assert wrong == [(0,)]
    attach_sql(path, "mixed", "SELECT face_id, CASE face_id WHEN 1 THEN 1 WHEN 2 THEN 2.5 END AS a FROM face")
    assert query(path, "SELECT a, typeof(a) FROM mixed") == [(1.0, "real"), (2.5, "real")]


def test_a_class_that_is_there(path):
    one, two = "SELECT 1 AS face_id, 'a' AS kind", "SELECT 2 AS face_id, 'b' AS kind UNION ALL SELECT 1, 'b'"
    attach_sql(path, "soil", one)
    with pytest.raises(InputError, match=r"found 'soil' in .*--append or --overwrite"):
        attach_sql(path, "soil", two)
    attach_sql(path, "soil", two, if_there="append")
    assert query(path, "SELECT kind FROM soil") == [("a",), ("b",)]
    assert query(path, "SELECT face_id, feature_id FROM face_feature") == [(1, 2), (2, 2)]
    attach_sql(path, "soil", "SELECT 3 AS face_id, 7 AS code", if_there="replace")
    assert query(path, "SELECT code FROM soil") == [(7,)]
    assert query(path, "SELECT face_id FROM face_feature") == [(3,)]


REFUSED = {
    "unknown way": (InputError, "by: found 'edge'", lambda p: attach_areas(p, "a", "areas.geojson", by="edge")),
    "unknown choice": (InputError, "if_there", lambda p: attach_areas(p, "a", "areas.geojson", if_there="x")),
    "bad name": (InputError, "small letter", lambda p: attach_areas(p, "A", "areas.geojson")),
    "no file": (NotFoundError, "no.geojson", lambda p: attach_areas(p, "a", "no.geojson")),
    "no store": (NotFoundError, "no.gpkg", lambda p: attach_areas("no.gpkg", "a", "areas.geojson")),
    "store of others": (StoreFormatError, "areas.geojson", lambda p: attach_areas("areas.geojson", "a", p)),
    "text as areas": (FeatureFormatError, "another format", lambda p: attach_areas(p, "a", "text.txt")),
    "remote": (InputError, "remote", lambda p: attach_areas(p, "a", "https://example.org/a.geojson")),
    "no field": (InputError, "found no field 'x'", lambda p: attach_areas(p, "a", "areas.geojson", columns=["x"])),
    "no level": (NotFoundError, "found no level 3", lambda p: attach_areas(p, "a", "areas.geojson", level=3)),
    "lines": (FeatureFormatError, "expected areas", lambda p: attach_areas(p, "a", "lines.geojson")),
    "elsewhere": (InputError, "no area on the store", lambda p: attach_areas(p, "a", "far.geojson")),
    "text as raster": (DemFormatError, "text.txt", lambda p: attach_raster(p, "a", "text.txt")),
    "no raster": (NotFoundError, "no.tif", lambda p: attach_raster(p, "a", "no.tif")),
    "no band": (InputError, "found no band 2", lambda p: attach_raster(p, "a", "half.tif", band=2)),
    "reals": (InputError, "found 0.5, expected classes", lambda p: attach_raster(p, "a", "half.tif")),
    "raster elsewhere": (InputError, "no cell with data", lambda p: attach_raster(p, "a", "far.tif")),
    "raster without CRS": (InputError, "without CRS", lambda p: attach_raster(p, "a", "nowhere.tif")),
    "wrong shape": (InputError, r"shape \(3,\)", lambda p: attach_function(p, "a", lambda tin: np.zeros(3))),
    "complex": (InputError, "complex128", lambda p: attach_function(p, "a", lambda tin: np.zeros(tin.n_face, complex))),
    "nothing": (InputError, "no value", lambda p: attach_function(p, "a", lambda tin: np.full(tin.n_face, np.nan))),
    "no SQL": (InputError, "syntax error", lambda p: attach_sql(p, "a", "select select")),
    "no face_id": (InputError, "expected face_id", lambda p: attach_sql(p, "a", "SELECT 1 AS a, 2 AS b")),
    "text as face_id": (InputError, "no whole number", lambda p: attach_sql(p, "a", "SELECT 'x' AS face_id, 2 AS b")),
    "no such face": (NotFoundError, "no face 99999", lambda p: attach_sql(p, "a", "SELECT 99999 AS face_id, 2 AS b")),
    "no row": (InputError, "no value", lambda p: attach_sql(p, "a", "SELECT 1 AS face_id, 2 AS b WHERE 0")),
    "blob": (InputError, "of one kind", lambda p: attach_sql(p, "a", "SELECT 1 AS face_id, x'00' AS b")),
    "bad column": (InputError, "small letter", lambda p: attach_sql(p, "a", "SELECT 1 AS face_id, 2 AS \"b'\"")),
    "change": (InputError, "not authorized", lambda p: attach_sql(p, "a", "DELETE FROM node")),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_refused(case, path):
    kind, message, step = REFUSED[case]
    write_areas()
    write_areas("far.geojson", areas={"far": AREAS["far"]})
    Path("text.txt").write_text("none")
    line = {
        "type": "Feature",
        "properties": {},
        "geometry": {"type": "LineString", "coordinates": [[-104.999, 36.14], [-104.99, 36.2]]},
    }
    Path("lines.geojson").write_text(json.dumps(line))
    write_raster("half.tif", np.full((50, 50), 0.5), 30.0, nodata=-1, dtype="float32")
    write_raster("far.tif", np.ones((5, 5)), 30.0, x0=9e5)
    write_raster("nowhere.tif", np.ones((50, 50)), 30.0, crs=None)
    before = path.read_bytes()
    with pytest.raises(kind, match=message):
        step(path)
    assert path.read_bytes() == before


def test_the_command(path, capsys):
    write_areas()
    write_raster("cover.tif", np.ones((40, 40)), 30.0)

    def call(*arguments):
        with pytest.raises(SystemExit) as exit_:
            main(["attach", "a.gpkg", *arguments])
        return exit_.value.code, *capsys.readouterr()

    from_file = ("--class", "soil", "--from", "areas.geojson")
    code, out, err = call(*from_file, "--columns", "kind=Kind,depth", "--by", "share", "--level", "1")
    assert (code, out[:40], err) == (0, "a.gpkg: class soil: 3 features on " + out[34:40], "")
    assert call(*from_file)[0] == 2
    assert call(*from_file, "--overwrite")[0] == 0
    assert call(*from_file, "--append")[0] == 0
    assert call("--class", "cover", "--raster", "cover.tif", "--band", "1")[0] == 0
    assert call("--class", "flat", "--sql", "SELECT face_id, 1 AS a FROM face_0")[0] == 0
    for wrong in (from_file[:2], (*from_file, "--raster", "cover.tif"), (*from_file, "--append", "--overwrite"),
                  (*from_file, "--band", "1"), ("--class", "a", "--raster", "cover.tif", "--by", "share"),
                  ("--class", "a", "--sql", "SELECT 1", "--level", "1")):  # fmt: skip
        code, out, err = call(*wrong)
        assert (code, out, err.startswith("vpfx: attach: found ")) == (2, "", True), wrong


def write_features(name, rows):
    """Write squares over the whole extent with given properties."""
    x, y = pyproj.Transformer.from_crs(CRS, "EPSG:4326", always_xy=True).transform(
        np.array([5e5, 5e5 + SIDE, 5e5 + SIDE, 5e5, 5e5]), np.array([4e6, 4e6, 4e6 + SIDE, 4e6 + SIDE, 4e6])
    )
    ring = [list(place) for place in zip(x.tolist(), y.tolist(), strict=True)]
    features = [
        {"type": "Feature", "properties": row, "geometry": {"type": "Polygon", "coordinates": [ring]}} for row in rows
    ]
    Path(name).write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return name


def test_fields_of_every_kind(path):
    attach_areas(path, "a", write_features("a.geojson", [{"tags": ["a", "b"], "n": 2**60 + 1}]))
    assert query(path, "SELECT tags, n FROM a") == [('["a", "b"]', 2**60 + 1)]
    with pytest.raises(InputError, match=r"field n: found whole numbers beyond 2\^53 beside NULL"):
        attach_areas(path, "b", write_features("b.geojson", [{"n": 2**53 + 1}, {"n": None}]))
    with pytest.raises(InputError, match="found fields 'Name' and 'name' for column name"):
        attach_areas(path, "c", write_features("c.geojson", [{"Name": "x", "name": "y"}]))
    with pytest.raises(InputError, match="face_id that is NULL"):
        attach_sql(path, "d", "SELECT NULL AS face_id, 2 AS v")


def test_areas_that_overlap_count_once_for_a_majority(path):
    """Two times the same area over less than half of the ground are no majority of the faces it cuts."""
    with vpfx.open_store(path) as store:
        x0, y0, x1, y1 = store.extent
        tin = store.tin(0)
    area = shapely.box(x0, y0, x0 + 0.41 * (x1 - x0), y1)
    corner = tin.nodes[tin.face_nodes[:, [0, 1, 2, 0]], :2]
    faces = shapely.polygons(corner)
    part = shapely.area(shapely.intersection(faces, area)) / shapely.area(faces)
    places = pyproj.Transformer.from_crs(CRS, "EPSG:4326", always_xy=True)
    ring = [list(places.transform(x, y)) for x, y in area.exterior.coords]
    features = [
        {"type": "Feature", "properties": {"i": i}, "geometry": {"type": "Polygon", "coordinates": [ring]}}
        for i in (1, 2)
    ]
    Path("twice.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    attach_areas(path, "twice", "twice.geojson", by="majority", level=0)
    found = {face for (face,) in query(path, "SELECT face_id FROM face_feature")}
    sure = np.abs(part - 0.5) > 0.01
    expected = set(tin.face_attributes["face_id"][sure & (part >= 0.5)].tolist())
    assert ((part > 0.34) & (part < 0.49)).any(), "a face that would be counted twice"
    assert found - set(tin.face_attributes["face_id"][~sure].tolist()) == expected


@pytest.mark.parametrize("value", [np.inf, 1e300, 0.5])
def test_values_that_are_no_classes(value, path):
    transform = from_origin(5e5 - 15, 4e6 + SIDE + 15, 30, 30)
    profile = {
        "driver": "GTiff",
        "width": 40,
        "height": 40,
        "count": 1,
        "dtype": "float64",
        "crs": CRS,
        "transform": transform,
    }
    with rasterio.open("c.tif", "w", **profile) as raster:
        raster.write(np.full((40, 40), value), 1)
    with pytest.raises(InputError, match="expected classes: whole numbers below"):
        attach_raster(path, "c", "c.tif")
