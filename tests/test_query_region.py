"""Parts of levels, ranges of heights and nearest nodes, against a look at every face and node."""

from __future__ import annotations

import json
import math
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pyogrio
import pytest
import shapely
from pyproj import Transformer
from rasters import CELL
from small_stores import MOST, ask, build_kind, clipped

import vpfx
from vpfx.errors import InputError, NotFoundError
from vpfx.query.nearest import nearest_nodes
from vpfx.query.region import elevation_range, region, region_rows, to_geojson


@pytest.fixture(scope="module", params=MOST)
def store(request, tmp_path_factory):
    with vpfx.open_store(build_kind(request.param, tmp_path_factory.mktemp("region"))) as opened:
        yield opened


def exact(places):
    """Places as exact numbers."""
    return [(Fraction(float(x)), Fraction(float(y))) for x, y in places]


def turn(a, b, c):
    """Which way the corner at b turns: the sign is exact."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def is_between(a, b, c):
    """Tell whether c, on the line through a and b, lies on the piece between them."""
    return min(a[0], b[0]) <= c[0] <= max(a[0], b[0]) and min(a[1], b[1]) <= c[1] <= max(a[1], b[1])


def meet(a, b, c, d):
    """Tell whether two pieces of lines share a place."""
    one, two, three, four = turn(a, b, c), turn(a, b, d), turn(c, d, a), turn(c, d, b)
    if one * two < 0 and three * four < 0:
        return True
    ends = ((one, a, b, c), (two, a, b, d), (three, c, d, a), (four, c, d, b))
    return any(value == 0 and is_between(*three_places) for value, *three_places in ends)


def holds(rings, place):
    """Tell whether a place lies inside closed rings, by the times that a ray from it crosses them."""
    inside = False
    for a, b in (side for ring in rings for side in pairwise(ring)):
        if (a[1] > place[1]) != (b[1] > place[1]):
            inside ^= (turn(a, b, place) > 0) == (b[1] > a[1])
    return inside


def apart(some, others):
    """Tell whether the upright rectangles round some places do not touch."""
    spans = [
        (min(p[axis] for p in places), max(p[axis] for p in places)) for axis in (0, 1) for places in (some, others)
    ]
    return any(a[1] < b[0] or b[1] < a[0] for a, b in (spans[:2], spans[2:]))


def touches(triangle, rings):
    """Tell whether a triangle and an area share a place, exactly."""
    closed = [*triangle, triangle[0]]
    sides = [pair for ring in rings for pair in pairwise(ring) if not apart(triangle, pair)]
    if any(meet(a, b, c, d) for a, b in sides for c, d in pairwise(closed)):
        return True
    if apart(triangle, [place for ring in rings for place in ring]):
        return False
    return holds(rings, triangle[0]) or holds([closed], rings[0][0]) or any(holds([closed], r[0]) for r in rings)


def expected(tin, geometries, tile_id=None):
    """Ids of the faces that touch all geometries, by looking at each."""
    found = []
    rings = [
        [exact(ring.coords) for part in getattr(g, "geoms", [g]) for ring in (part.exterior, *part.interiors)]
        for g in geometries
    ]
    for k, corners in enumerate(tin.nodes[tin.face_nodes, :2]):
        triangle = exact(corners)
        if all(touches(triangle, r) for r in rings) and tile_id in (None, tin.face_attributes["tile_id"][k]):
            found.append(int(tin.face_attributes["face_id"][k]))
    return found


def polygons(store, rng):
    """Areas of all sorts: thin, with a hole, of two parts, with corners on nodes, all over and beside the extent."""
    x0, y0, x1, y1 = store.extent
    wide, high = x1 - x0, y1 - y0

    def at(*shares):
        return [(x0 + u * wide, y0 + v * high) for u, v in shares]

    nodes = store.tin(0).nodes[:, :2]
    corners = nodes[rng.choice(len(nodes), 3, replace=False)]
    hole = shapely.Polygon(at((0.1, 0.1), (0.9, 0.15), (0.8, 0.9)), [at((0.5, 0.3), (0.7, 0.35), (0.7, 0.5))])
    star = shapely.Polygon(at((0.0, 0.5), (0.4, 0.4), (0.5, -0.1), (0.6, 0.4), (1.1, 0.5), (0.5, 0.55)))
    parts = shapely.MultiPolygon([shapely.box(*at((0.1, 0.1))[0], *at((0.15, 0.3))[0]), star.buffer(0).difference(hole)
                                  .convex_hull.intersection(shapely.box(*at((0.6, 0.6))[0], *at((0.9, 0.8))[0]))])  # fmt: skip
    thin = shapely.Polygon(at((0.2, 0.2), (0.8, 0.7), (0.8, 0.7001)))
    found = [hole, star, parts, thin, shapely.box(x0 - 1, y0 - 1, x1 + 1, y1 + 1), shapely.box(x1 + 1, y0, x1 + 9, y1)]
    return found + ([shapely.Polygon(corners)] if shapely.Polygon(corners).area else [])


def boxes(store, rng):
    """Rectangles anywhere, and such as end at nodes."""
    x0, y0, x1, y1 = store.extent
    low = rng.uniform((x0 - 30, y0 - 30), (x1, y1), (5, 2))
    found = [(*place, *(place + rng.uniform(1, (x1 - x0) / 3, 2))) for place in low]
    ends = store.tin(1).nodes[rng.choice(len(store.tin(1).nodes), (3, 2)), :2]
    return found + [(*pair.min(axis=0), *pair.max(axis=0)) for pair in ends] + [(x1, y0, x1 + 5, y1), (x0, y0, x0, y0)]


def ids(tin):
    return tin.face_attributes["face_id"].tolist() if tin.n_face else []


def test_faces_that_touch_a_rectangle(store):
    rng = np.random.default_rng(1)
    for box in boxes(store, rng)[::2]:
        rectangle = shapely.Polygon([(box[0], box[1]), (box[2], box[1]), (box[2], box[3]), (box[0], box[3])])
        for level in (0, len(store.levels) - 1):
            tin = region(store, level, bbox=box)
            assert ids(tin) == expected(store.tin(level), [rectangle])
            assert len(np.unique(tin.face_nodes)) == tin.n_node


def test_faces_that_touch_a_polygon(store):
    rng = np.random.default_rng(2)
    for k, polygon in enumerate(polygons(store, rng)):
        for level in (k % 2, len(store.levels) - 1)[: 2 if k < 1 else 1]:
            assert ids(region(store, level, polygon=polygon)) == expected(store.tin(level), [polygon])


def test_conditions_join(store):
    rng = np.random.default_rng(3)
    star = polygons(store, rng)[1]
    box = boxes(store, rng)[0]
    rectangle = shapely.box(*box)
    whole = store.tin(1)
    for tile_id in store.tiles()["tile_id"][::6].tolist():
        assert ids(region(store, 1, tile_id=tile_id)) == expected(whole, [], tile_id)
        assert ids(region(store, 1, tile_id=tile_id, polygon=star)) == expected(whole, [star], tile_id)
        found = region(store, 1, bbox=box, tile_id=tile_id, polygon=star)
        assert ids(found) == expected(whole, [rectangle, star], tile_id)
    assert ids(region(store, 1)) == ids(whole)


def test_rows_are_those_of_the_table(store):
    star = polygons(store, np.random.default_rng(3))[1]
    rows = region_rows(store, 1, polygon=star)
    tin = region(store, 1, polygon=star)
    assert rows["face_id"].tolist() == ids(tin)
    assert set(rows["level"]) <= {1}
    np.testing.assert_array_equal(rows["slope_centidegrees"] / 100, tin.face_attributes["slope"])
    x1 = store.extent.max_x
    assert len(region_rows(store, 1, bbox=(x1 + 1, 0, x1 + 2, 1e7))["face_id"]) == 0


def test_what_is_no_region_is_told(store):
    for polygon, message in (
        (shapely.Polygon(), "found an empty one"),
        (shapely.Point(1, 2), "found a Point"),
        ("POLYGON", "found a str"),
        (shapely.from_wkt("POLYGON ((0 0, 1 1, 1 0, 0 1, 0 0))"), "Self-intersection"),
        (shapely.Polygon([(0, 0), (1, np.inf), (1, 0)]), "not finite"),
    ):
        with pytest.raises(InputError, match=message) as told:
            region(store, 0, polygon=polygon)
        assert "\n" not in str(told.value)
        with pytest.raises(InputError, match=message):
            elevation_range(store, 0, polygon=polygon)
    for box in ((1, 2, 3), (3, 0, 1, 1), (0, 0, np.nan, 1), "abcd", 5):
        with pytest.raises(InputError, match="bbox: found"):
            region(store, 0, bbox=box)
    with pytest.raises(NotFoundError, match="no tile 99"):
        region(store, 0, tile_id=99)
    with pytest.raises(NotFoundError, match="no level 9"):
        region(store, 9)
    with pytest.raises(NotFoundError, match="no level 9"):
        elevation_range(store, 9, bbox=(0, 0, 1, 1))


def test_range_of_heights(store):
    rng = np.random.default_rng(4)
    x0, y0, x1, y1 = store.extent
    windows = [[(b[0], b[1]), (b[2], b[1]), (b[2], b[3]), (b[0], b[3])] for b in boxes(store, rng) if b[0] < b[2]]
    windows += [[(x0, y0), (x1, y0 + 20), (x0 + 60, y1)], [(x0 + 40, y0 + 40), (x0 + 55, y0 + 41), (x0 + 42, y0 + 70)]]
    for level in (0, len(store.levels) - 1):
        tin = store.tin(level)
        for window in windows:
            if shapely.Polygon(window).area == 0:
                continue
            places = [place for corners in tin.nodes[tin.face_nodes].tolist() for place in clipped(corners, window)]
            found = elevation_range(store, level, polygon=shapely.Polygon(window))
            if not places:
                assert np.isnan([*found.lowest, *found.highest]).all()
                continue
            heights = [z for _, _, z in places]
            assert found.lowest[2] == pytest.approx(min(heights), abs=1e-6)
            assert found.highest[2] == pytest.approx(max(heights), abs=1e-6)
            for x, y, z in found:
                assert shapely.Polygon(window).distance(shapely.Point(x, y)) < 1e-6
                assert any(math.dist((x, y, z), place) < 1e-5 for place in places)


def test_range_of_a_level_and_of_two_areas(store):
    nodes = store.tin(0).nodes
    found = elevation_range(store, 0)
    assert (found.lowest[2], found.highest[2]) == (nodes[:, 2].min(), nodes[:, 2].max())
    x, y, z = nodes[len(nodes) // 2].tolist()
    np.testing.assert_allclose(elevation_range(store, 0, bbox=(x, y, x, y)), [(x, y, z)] * 2, rtol=1e-12)
    x0, y0, x1, y1 = store.extent
    middle = (x0 + x1) / 2
    one = elevation_range(store, 0, bbox=(x0, y0, middle, y1), polygon=shapely.box(x0 + 31, y0, x1, y1))
    other = elevation_range(store, 0, bbox=(x0 + 31, y0, middle, y1))
    np.testing.assert_allclose(one, other)
    assert np.isnan(elevation_range(store, 0, bbox=(x0, y0, x0 + 9, y1), polygon=shapely.box(x1 - 9, y0, x1, y1))).all()


def test_nearest_nodes(store):
    rng = np.random.default_rng(5)
    x0, y0, x1, y1 = store.extent
    for level in (0, len(store.levels) - 1):
        tin = store.tin(level)
        node_ids = tin.node_attributes["node_id"]
        middles = tin.nodes[tin.face_nodes[:, :2], :2].mean(axis=1)
        anywhere = rng.uniform((x0 - 200, y0 - 200), (x1 + 200, y1 + 200), (60, 2))
        places = np.concatenate([anywhere, tin.nodes[:9, :2], middles[::9], [(x0, y0 - 1e5)]])
        found = nearest_nodes(store, places, level)
        for k, place in enumerate(places):
            away = [math.sqrt((x - place[0]) ** 2 + (y - place[1]) ** 2) for x, y in tin.nodes[:, :2]]
            least = min(away)
            assert found.distance[k] == pytest.approx(least, abs=1e-9)
            ties = [int(i) for i, d in zip(node_ids, away, strict=True) if d == least]
            assert found.node_ids[k] == min(ties)
            np.testing.assert_array_equal(found.places[k], tin.nodes[node_ids == found.node_ids[k]][0])
    assert nearest_nodes(store, [], 0).node_ids.tolist() == []
    with pytest.raises(InputError, match="finite numbers"):
        nearest_nodes(store, [[1, np.nan]], 0)


def test_geojson_is_that_of_the_standard(store):
    tin = region(store, 1, tile_id=int(store.tiles()["tile_id"][0]))
    document = json.loads(json.dumps(to_geojson(tin), allow_nan=False))
    assert document["type"] == "FeatureCollection"
    assert [feature["id"] for feature in document["features"]] == ids(tin)
    for feature, corners in zip(document["features"], tin.nodes[tin.face_nodes], strict=True):
        (ring,) = feature["geometry"]["coordinates"]
        assert ring[0] == ring[-1]
        assert len(ring) == 4
        assert shapely.LinearRing(ring).is_ccw
        assert sorted(z for _, _, z in ring[:3]) == sorted(corners[:, 2].tolist())
        assert all(-106 < x < -104 and 36 < y < 37 for x, y, _ in ring)  # UTM 13: x0 is its middle, 105° west
        assert set(feature["properties"]) == {"tile_id", "is_filled", "slope", "aspect"}
    aspects = [feature["properties"]["aspect"] for feature in document["features"]]
    assert [a is None for a in aspects] == np.isnan(tin.face_attributes["aspect"]).tolist()


def test_a_real_store(tmp_path):
    """A cell of New Mexico in longitude and latitude, nine tiles: one answer, whichever way it is asked."""
    path = vpfx.build(CELL, tmp_path / "a.gpkg", max_error=(40, 20), tile_size=100).path
    with vpfx.open_store(path) as opened:
        x0, y0, x1, y1 = opened.extent
        circle = shapely.Point((x0 + x1) / 2, (y0 + y1) / 2).buffer((x1 - x0) / 3)
        tin, whole = region(opened, 1, polygon=circle), opened.tin(1)
        looked = [g.intersects(circle) for g in map(shapely.Polygon, whole.nodes[whole.face_nodes, :2].tolist())]
        assert ids(tin) == whole.face_attributes["face_id"][looked].tolist()
        inside = [circle.contains(shapely.Point(place)) for place in whole.nodes[:, :2].tolist()]
        found = elevation_range(opened, 1, polygon=circle)
        assert found.lowest[2] <= whole.nodes[inside, 2].min() + 1e-9
        assert found.highest[2] >= whole.nodes[inside, 2].max() - 1e-9
        assert abs(circle.exterior.distance(shapely.Point(found.lowest[:2]))) < 1e-9 or found.lowest[
            2
        ] == pytest.approx(whole.nodes[inside, 2].min())


@pytest.fixture(scope="module")
def tiles(tmp_path_factory):
    with vpfx.open_store(build_kind("tiles", tmp_path_factory.mktemp("tiles"))) as opened:
        yield opened


TRIANGLE = "POLYGON ((500100 4000100, 500500 4000150, 500300 4000800, 500100 4000100))"


def write_areas(path, geometries, crs="EPSG:4326", **options):
    """Write geometries, given in the CRS of the small stores, as a vector file."""
    move = Transformer.from_crs("EPSG:32613", crs, always_xy=True)
    moved = [shapely.transform(g, lambda xy: np.column_stack(move.transform(*xy.T))) for g in geometries]
    kind = options.pop("geometry_type", "Polygon")
    pyogrio.raw.write(path, shapely.to_wkb(np.array(moved, object)), [], [], geometry_type=kind, crs=crs, **options)
    return path


def test_the_command_gives_faces(tiles, capsys, tmp_path):
    area = shapely.from_wkt(TRIANGLE)
    expected = region(tiles, 1, polygon=area)
    code, out, _ = ask(capsys, "region", tiles.path, "--level", 1, "--polygon", TRIANGLE, "--format", "geojson")
    assert code == 0
    assert json.loads(out) == to_geojson(expected)
    code, out, _ = ask(capsys, "region", tiles.path, "--level", 1, "--polygon", TRIANGLE)
    assert [int(line.split()[0]) for line in out.splitlines()[1:]] == ids(expected)
    code, out, _ = ask(capsys, "region", tiles.path, "--polygon", TRIANGLE, "--tile", 2, "--format", "json")
    document, finest = json.loads(out), len(tiles.levels) - 1
    rows = region_rows(tiles, finest, polygon=area, tile_id=2)
    assert document["level"] == finest
    assert [row["face"] for row in document["faces"]] == rows["face_id"].tolist()
    assert [row["nodes"][2] for row in document["faces"]] == rows["node_3"].tolist()
    target = tmp_path / "a.json"
    box = "500100,4000100,500200,4000200"
    code, out, _ = ask(capsys, "region", tiles.path, "--bbox", box, "--format", "geojson", "-o", target)
    assert (code, out.startswith(f"{target}: ")) == (0, True)
    found = [feature["id"] for feature in json.loads(target.read_text())["features"]]
    assert found == ids(region(tiles, finest, bbox=(500100, 4000100, 500200, 4000200)))
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]


def test_polygons_come_from_files(tiles, capsys, tmp_path):
    halves = [shapely.box(500100, 4000100, 500300, 4000700), shapely.box(500300, 4000100, 500500, 4000700)]
    expected = ids(region(tiles, 1, polygon=shapely.box(500100, 4000100, 500500, 4000700)))
    for name, crs in (("a.gpkg", "EPSG:32613"), ("b.geojson", "EPSG:4326"), ("c.shp", "EPSG:32613")):
        file = write_areas(tmp_path / name, halves, crs)
        code, out, _ = ask(capsys, "region", tiles.path, "--level", 1, "--polygon", file)
        found = [int(line.split()[0]) for line in out.splitlines()[1:]]
        assert code == 0
        assert len(set(found) ^ set(expected)) <= (0 if crs == "EPSG:32613" else 0.05 * len(expected))


def test_places_far_away_and_polygons_of_curves(tiles, capsys, tmp_path):
    (tmp_path / "far.txt").write_text("1e155 0\n1e300 -1e300\n")
    code, out, _ = ask(capsys, "nearest", tiles.path, "--points", tmp_path / "far.txt")
    assert (code, len(out.splitlines())) == (0, 2)
    code, _, err = ask(capsys, "region", tiles.path, "--polygon", "CURVEPOLYGON((0 0,1 0,1 1,0 0))")
    assert (code, err.count("\n")) == (2, 1)


def test_areas_of_files_are_made_valid(tiles, capsys, tmp_path):
    bow = shapely.from_wkt("POLYGON ((500100 4000100, 500300 4000700, 500300 4000100, 500100 4000700, 500100 4000100))")
    code, out, _ = ask(
        capsys, "region", tiles.path, "--polygon", write_areas(tmp_path / "bow.gpkg", [bow], "EPSG:32613")
    )
    assert code == 0
    expected = ids(region(tiles, len(tiles.levels) - 1, polygon=shapely.make_valid(bow)))
    assert [int(line.split()[0]) for line in out.splitlines()[1:]] == expected


def test_bad_files_are_refused(tiles, capsys, tmp_path):
    box = shapely.box(500100, 4000100, 500300, 4000700)
    far = shapely.box(400100, 4000100, 400300, 4000700)
    file = tmp_path / "two.gpkg"
    write_areas(file, [box], layer="one"), write_areas(file, [box], layer="other", append=True)
    (tmp_path / "text.txt").write_text("hello")
    (tmp_path / "broken.geojson").write_text('{"type": "FeatureCollection", "features": [{')
    for name, code, message in (
        (write_areas(tmp_path / "far.gpkg", [far]), 2, "found no area on the store"),
        (
            write_areas(tmp_path / "p.gpkg", [box.centroid], geometry_type="Point"),
            3,
            "found points or lines, expected areas",
        ),
        (file, 2, "found 2 layers, expected one; choose of: one, other"),
        (tmp_path / "text.txt", 3, "found another format"),
        (tmp_path / "broken.geojson", 3, "broken.geojson: "),
        (tmp_path, 3, "found a directory"),
        (tmp_path / "none.gpkg", 3, "expected WKT or a file"),
        ("x" * 400, 3, "expected WKT or a file"),
        ("a\0b", 3, "expected WKT or a file"),
    ):
        for command in (["region"], ["range"], ["volume", "--plane", 0]):
            found = ask(capsys, *command, tiles.path, "--polygon", name)
            assert (found[0], found[1], found[2].count("\n")) == (code, "", 1), found
            assert message in found[2]
    code, out, _ = ask(capsys, "region", tiles.path, "--polygon", file, "--polygon-layer", "other")
    assert code == 0
    assert out


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["--format", "xml"], 2, "--format: found 'xml'"),
        (["--bbox", "1,2,3"], 2, "bbox: found"),
        (["--bbox", "1,a"], 2, "--bbox: found '1,a'"),
        (["--tile", "99"], 3, "found no tile 99"),
        (["--level", "9"], 3, "found no level 9"),
        (["--polygon", "POLYGON ((0 0, 1"], 2, "expected WKT"),
        (["--polygon", "POINT (0 0)"], 2, "found a Point"),
        (["--polygon", "POLYGON EMPTY"], 2, "found an empty one"),
        (["--polygon", "POLYGON ((0 0, 1 1, 1 0, 0 1, 0 0))"], 2, "Self-intersection"),
        (["-o", "nowhere/a.json"], 3, "found no folder nowhere"),
        (["-o", "."], 3, "found a folder"),
    ],
)
def test_the_command_refuses(arguments, code, message, tiles, capsys):
    found = ask(capsys, "region", tiles.path, *arguments)
    assert (found[0], found[1], found[2].count("\n")) == (code, "", 1)
    assert message in found[2]


def test_files_are_not_overwritten(tiles, capsys, tmp_path):
    target = tmp_path / "a.txt"
    target.write_text("mine")
    assert ask(capsys, "region", tiles.path, "-o", target)[0] == 3
    assert target.read_text() == "mine"
    before = tiles.path.read_bytes()
    assert ask(capsys, "region", tiles.path, "-o", tiles.path, "--overwrite")[0] == 2
    assert ask(capsys, "contours", tiles.path, "--interval", 5, "-o", tiles.path, "--overwrite")[0] == 2
    assert tiles.path.read_bytes() == before
    long = shapely.Point(500300, 4000300).buffer(100).wkt  # no name of a file is so long
    assert ask(capsys, "region", tiles.path, "--polygon", long, "-o", target, "--overwrite")[0] == 0
    assert target.read_text() != "mine"


def test_the_commands_tell_range_and_nearest_nodes(tiles, capsys, tmp_path):
    area = shapely.from_wkt(TRIANGLE)
    expected = elevation_range(tiles, 1, polygon=area)
    code, out, _ = ask(capsys, "range", tiles.path, "--level", 1, "--polygon", TRIANGLE, "--json")
    document = json.loads(out)
    assert (code, document["level"]) == (0, 1)
    assert list(document["lowest"].values()) == expected.lowest.tolist()
    assert list(document["highest"].values()) == expected.highest.tolist()
    _, out, _ = ask(capsys, "range", tiles.path, "--bbox", "0,0,1,1")
    assert out.split() == ["lowest", "–", "–", "–", "highest", "–", "–", "–"]
    file = tmp_path / "places.txt"
    file.write_text("500100 4000100\n500333,4000222\n")
    found = nearest_nodes(tiles, [(500100, 4000100), (500333, 4000222)], len(tiles.levels) - 1)
    _, out, _ = ask(capsys, "nearest", tiles.path, "--points", file)
    assert [int(line.split()[0]) for line in out.splitlines()] == found.node_ids.tolist()
    _, out, _ = ask(capsys, "nearest", tiles.path, "--points", file, "--json")
    assert [point["distance"] for point in json.loads(out)["points"]] == found.distance.tolist()
