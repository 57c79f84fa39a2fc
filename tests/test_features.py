"""Surveyed points, lines and areas: reading them, edges of constrained pyramids, further points of pass mode."""

from __future__ import annotations

import gzip
import hashlib
import itertools
import json
import tomllib
from fractions import Fraction
from pathlib import Path

import fiona
import fiona.transform
import numpy as np
import pytest
import shapely
from conftest import shared_dem, shared_feature
from fiona.crs import CRS as FionaCRS
from hypothesis import given, settings
from hypothesis import strategies as st
from invariants import judge_hierarchy, judge_store
from rasters import CELL
from surfaces import SOLID, SURFACES, VOIDS, bounds_of, hills, noise, query

import vpfx
from vpfx.dem import read_grid
from vpfx.errors import FeatureFormatError, InputError, NotFoundError
from vpfx.features import FORMATS, read_features
from vpfx.methods import METHODS
from vpfx.methods.lines import STEP
from vpfx.model import Extent, Grid
from vpfx.pipeline import build_hierarchy

FIXTURES = Path(__file__).resolve().parents[1] / "fixtures/features"
STREAMS = FIXTURES / "new_mexico_streams.geojson"
PYRAMID = "constrained_delaunay_pyramid"
EXTENT = Extent(0.0, 0.0, 10.0, 10.0)
LOCAL = "EPSG:32613"


def write(path, geometries, driver="GeoJSON", crs="EPSG:32613", layer=None):
    """Write geometries, of one kind, into a vector file."""
    geometries = [shapely.from_wkt(text) for text in geometries]
    kind = geometries[0].geom_type if len({g.geom_type for g in geometries}) == 1 else "Unknown"
    schema = {"geometry": ("3D " if geometries[0].has_z else "") + kind, "properties": {}}
    with fiona.open(
        path, "w", driver=driver, schema=schema, crs=FionaCRS.from_string(crs) if crs else None, layer=layer
    ) as sink:
        sink.writerecords({"geometry": shapely.geometry.mapping(g), "properties": {}} for g in geometries)
    return path


def read(path, **options):
    return read_features(path, LOCAL, EXTENT, **options)


def flat(found):
    """Lines as lists of (x, y)."""
    return [line[:, :2].round(9).tolist() for line in found.lines]


# --- reading ----------------------------------------------------------------------------------------------------------


def test_index_lists_every_fixture_and_nothing_else():
    index = tomllib.loads((FIXTURES / "INDEX.toml").read_text(encoding="utf-8"))
    assert {"package", "member", "licence", "script"} <= set(index.pop("source"))
    assert set(index) == {path.name for path in FIXTURES.iterdir()} - {"INDEX.toml"}
    for name, entry in index.items():
        assert hashlib.sha256((FIXTURES / name).read_bytes()).hexdigest() == entry["sha256"], name


def places_in(path):
    """Inner vertices of the lines of a GeoJSON file, (n, 2)."""
    features = json.loads(path.read_text(encoding="utf-8"))["features"]
    return np.concatenate([np.array(feature["geometry"]["coordinates"])[1:-1, :2] for feature in features])


def test_streams_fixture_is_taken_from_the_shared_file():
    shared = shapely.STRtree(shapely.points(places_in(shared_feature("new_mexico_nhd_flowlines.geojson"))))
    ours = places_in(STREAMS)
    assert len(ours) > 600
    assert shared.query_nearest(shapely.points(ours), return_distance=True)[1].max() < 1e-6


@pytest.mark.parametrize(
    ("driver", "suffix"), [("GeoJSON", "geojson"), ("ESRI Shapefile", "shp"), ("GPKG", "gpkg"), ("FlatGeobuf", "fgb")]
)
def test_formats(driver, suffix, tmp_path):
    path = write(tmp_path / f"a.{suffix}", ["LINESTRING (1 2, 3 4, 5 4)"], driver)
    found = read(path)
    assert flat(found) == [[[1, 2], [3, 4], [5, 4]]]
    assert np.isnan(found.lines[0][:, 2]).all()
    (source,) = found.sources
    assert (source.name, source.driver) == (path.name, driver)
    assert source.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


KINDS = {
    "points": (["POINT (1 2)", "POINT (3 4)"], [[[1, 2]], [[3, 4]]]),
    "multipoint": (["MULTIPOINT ((1 2), (3 4))"], [[[1, 2]], [[3, 4]]]),
    "multiline": (["MULTILINESTRING ((1 1, 2 2), (5 5, 6 6))"], [[[1, 1], [2, 2]], [[5, 5], [6, 6]]]),
    "area": (["POLYGON ((1 1, 4 1, 4 4, 1 1))"], [[[1, 1], [4, 1], [4, 4], [1, 1]]]),
    "area with a hole": (
        ["POLYGON ((1 1, 8 1, 8 8, 1 1), (5 3, 6 3, 6 4, 5 3))"],
        [[[1, 1], [8, 1], [8, 8], [1, 1]], [[5, 3], [6, 3], [6, 4], [5, 3]]],
    ),
    "multipolygon": (["MULTIPOLYGON (((1 1, 4 1, 4 4, 1 1)))"], [[[1, 1], [4, 1], [4, 4], [1, 1]]]),
    "outside": (["LINESTRING (1 2, 3 4)", "LINESTRING (50 50, 60 60)"], [[[1, 2], [3, 4]]]),
}


@pytest.mark.parametrize("kind", KINDS)
def test_kinds_of_geometry(kind, tmp_path):
    geometries, expected = KINDS[kind]
    assert flat(read(write(tmp_path / "a.gpkg", geometries, "GPKG"))) == expected


def test_z_is_kept_only_if_asked_for(tmp_path):
    path = write(tmp_path / "a.geojson", ["LINESTRING Z (1 2 7, 3 4 8)"])
    assert np.isnan(read(path).lines[0][:, 2]).all()
    assert read(path, use_z=True).lines[0][:, 2].tolist() == [7, 8]


def test_lines_come_into_the_crs_of_the_dem(tmp_path):
    """The same line in three CRS; what lies far away is cut off before it is brought over."""
    extent = Extent(500_000.0, 4_000_000.0, 501_000.0, 4_001_000.0)
    line = "LINESTRING (500100 4000200, 500700 4000600)"
    degrees = "LINESTRING (-179 -89, -105 36.1)"
    here = write(tmp_path / "here.geojson", [line])
    for crs in ("EPSG:4326", "EPSG:3857", "EPSG:4269"):
        away = fiona.transform.transform_geom(LOCAL, crs, shapely.geometry.mapping(shapely.from_wkt(line)))
        path = write(tmp_path / f"{crs[5:]}.geojson", [shapely.geometry.shape(away).wkt], crs=crs)
        one, other = (read_features(p, LOCAL, extent).lines[0] for p in (here, path))
        np.testing.assert_allclose(one[:, :2], other[:, :2], atol=1e-3)
    far = write(tmp_path / "far.geojson", [degrees], crs="EPSG:4326")
    with pytest.raises(InputError, match="found no point, line or outline on the DEM"):
        read_features(far, LOCAL, Extent(400_000.0, 6_000_000.0, 401_000.0, 6_001_000.0))


def test_several_files_and_layers(tmp_path):
    one = write(tmp_path / "a.gpkg", ["LINESTRING (1 2, 3 4)"], "GPKG", layer="roads")
    write(one, ["LINESTRING (5 5, 6 6)"], "GPKG", layer="rivers")
    other = write(tmp_path / "b.geojson", ["POINT (7 7)"])
    with pytest.raises(InputError, match=r"a.gpkg: found 2 layers, .*roads, rivers"):
        read(one)
    with pytest.raises(InputError, match="found no layer 'paths', expected one of: roads, rivers"):
        read(one, layer="paths")
    assert flat(read(one, layer="rivers")) == [[[5, 5], [6, 6]]]
    assert flat(read([other, write(tmp_path / "c.geojson", ["POINT (8 8)"])])) == [[[7, 7]], [[8, 8]]]


def test_files_that_do_not_do_are_refused(tmp_path):
    no_crs = write(tmp_path / "a.shp", ["POINT (1 2)"], "ESRI Shapefile", crs=None)
    with pytest.raises(FeatureFormatError, match="found no CRS that is known, expected one"):
        read(no_crs)
    with pytest.raises(NotFoundError, match="there is no such file"):
        read(tmp_path / "none.shp")
    with pytest.raises(FeatureFormatError, match="expected GPKG, ESRI Shapefile"):
        read(CELL)
    with pytest.raises(FeatureFormatError, match="found a directory"):
        read(tmp_path)
    packed = tmp_path / "a.geojson.gz"
    packed.write_bytes(gzip.compress(STREAMS.read_bytes()))
    with pytest.raises(FeatureFormatError, match="an archive, expected a file; unpack it first"):
        read(packed)
    with pytest.raises(InputError, match="remote or virtual path"):
        read("/vsicurl/http://127.0.0.1:9/a.geojson")
    with pytest.raises(InputError, match="found no point, line or outline on the DEM"):
        read(write(tmp_path / "far.geojson", ["POINT (99 99)"]))
    with pytest.raises(FeatureFormatError, match="GeometryCollection"):
        read(write(tmp_path / "mixed.gpkg", ["GEOMETRYCOLLECTION (POINT (1 1))"], "GPKG"))
    with pytest.raises(InputError, match="DEM without CRS"):
        read_features(STREAMS, "", EXTENT)


def test_other_formats_are_not_opened(tmp_path):
    """A file that names other files is not followed, whatever it is called."""
    write(tmp_path / "secret.geojson", ["POINT (1 2)"])
    vrt = tmp_path / "a.geojson"
    vrt.write_text(
        '<OGRVRTDataSource><OGRVRTLayer name="secret"><SrcDataSource relativeToVRT="1">secret.geojson</SrcDataSource>'
        "</OGRVRTLayer></OGRVRTDataSource>"
    )
    assert "OGR_VRT" not in FORMATS
    with pytest.raises(FeatureFormatError, match="found another format"):
        read(vrt)


@pytest.mark.parametrize("suffix", ["geojson", "gpkg", "shp", "fgb"])
def test_broken_files_give_one_clear_error(suffix, tmp_path):
    driver = {"geojson": "GeoJSON", "gpkg": "GPKG", "shp": "ESRI Shapefile", "fgb": "FlatGeobuf"}[suffix]
    path = write(tmp_path / f"a.{suffix}", ["LINESTRING (1 2, 3 4, 5 4)", "LINESTRING (1 1, 3 3, 5 4)"], driver)
    whole, rng = path.read_bytes(), np.random.default_rng(1)
    outcomes = set()
    for cut in [*range(0, min(len(whole), 400), 7), *rng.integers(0, len(whole), 40).tolist()]:
        changed = bytearray(whole)
        changed[cut] ^= 0xFF
        for content in (whole[:cut], bytes(changed)):
            path.write_bytes(content)
            try:
                found = read(path)
            except (FeatureFormatError, InputError) as error:
                assert "\n" not in str(error)  # noqa: PT017 (either outcome is right)
                outcomes.add("refused")
            else:
                assert all(np.isfinite(line[:, :2]).all() for line in found.lines)
                outcomes.add("read")
    assert "refused" in outcomes


# --- prescribed edges -------------------------------------------------------------------------------------------------


def edges_of(h, level):
    faces = h.level_faces[level]
    return {tuple(sorted(pair)) for face in faces.tolist() for pair in itertools.combinations(face, 2)}


def judge_edges_of_lines(h, grid, lines):
    """Each piece of a line runs along edges of each level: exactly, its ends being on the lattice of lines."""
    scale = (grid.dx, grid.dy)
    nodes = (h.nodes[:, :2] - (grid.x0, grid.y0)) / scale
    for level in range(h.n_level):
        edges = edges_of(h, level)
        known = {n for edge in edges for n in edge}
        exact = {n: tuple(map(Fraction, nodes[n].tolist())) for n in known}
        for line in lines:
            for (ax, ay), (bx, by) in itertools.pairwise([tuple(map(Fraction, map(float, place))) for place in line]):
                on = [
                    (abs(x - ax) + abs(y - ay), n)
                    for n, (x, y) in exact.items()
                    if (bx - ax) * (y - ay) == (by - ay) * (x - ax)
                    and min(ax, bx) <= x <= max(ax, bx)
                    and min(ay, by) <= y <= max(ay, by)
                ]
                chain = [n for _, n in sorted(on)]
                assert len(chain) >= 2
                assert {exact[chain[0]], exact[chain[-1]]} == {(ax, ay), (bx, by)}, f"level {level}"
                for pair in itertools.pairwise(chain):
                    assert tuple(sorted(pair)) in edges, f"level {level}: {pair}"


LINES = {
    "between posts": [[(1.5, 1.25), (5.5, 6.75), (7.25, 2.5)]],
    "along posts": [[(1, 1), (6, 1), (6, 5)]],
    "through posts": [[(1, 1), (7, 4)]],
    "crossing": [[(1, 3), (7, 3)], [(4, 0.5), (4, 7.5)]],
    "closed": [[(2.5, 2.5), (6.5, 2.5), (4.5, 6.5), (2.5, 2.5)]],
    "twice the same": [[(1.5, 1.5), (5.5, 5.5)], [(5.5, 5.5), (1.5, 1.5)]],
    "overlapping": [[(1, 2), (6, 2)], [(3, 2), (7, 2)]],
    "from side to side": [[(0, 3.5), (8, 3.5)]],
    "along a side": [[(1.5, 0), (6.25, 0)]],
    "near a post": [[(3 + STEP, 3), (3 + STEP, 6)]],
}


@pytest.mark.parametrize("name", LINES)
@pytest.mark.parametrize(
    "options", [{"passes": 2, "tolerance": 1.0}, {"max_error": (8.0, 2.0)}], ids=["passes", "bounds"]
)
def test_lines_are_edges_of_every_level(name, options):
    grid = Grid(noise(9, 9))
    h = build_hierarchy(grid, method=PYRAMID, lines=LINES[name], **options)
    judge_hierarchy(h, grid, is_nested=False)
    judge_edges_of_lines(h, grid, LINES[name])


NOWHERE = ("ragged", "checkerboard", "almost all void", "one triangle", "void corner")
"""Surfaces with no square away from voids."""


@pytest.mark.parametrize("surface", SURFACES)
def test_lines_on_every_surface(surface):
    """Clipped at the sides, and a square short of voids."""
    grid = SURFACES[surface]
    x0, y0, x1, y1 = grid.extent
    across = [(x0 - (x1 - x0), y0 - (y1 - y0) / 3), (x1 + (x1 - x0), y1 + (y1 - y0) / 5)]
    for options in ({"passes": 2}, {"max_error": bounds_of(grid)}, {"passes": 1, "fill": True}):
        try:
            h = build_hierarchy(grid, method=PYRAMID, lines=[across, [((x0 + x1) / 2, (y0 + y1) / 2)]], **options)
        except InputError as error:
            assert surface in NOWHERE, error  # noqa: PT017 (either outcome is right)
            continue
        assert surface not in NOWHERE
        judge_hierarchy(h, grid, is_nested=False)
    if surface in VOIDS:
        return
    line, shares = shapely.linestrings(across), np.linspace(0.02, 0.98, 41)
    inside = shapely.intersection(line, shapely.box(x0, y0, x1, y1))
    edges = shapely.STRtree(shapely.linestrings([h.nodes[list(edge), :2] for edge in edges_of(h, 0)]))
    places = shapely.line_interpolate_point(inside, shares, normalized=True)
    _, away = edges.query_nearest(places, return_distance=True, all_matches=False)
    assert away.max() <= STEP * max(grid.dx, grid.dy)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(
        st.lists(st.tuples(st.integers(-8, 72), st.integers(-8, 72)), min_size=1, max_size=5), min_size=1, max_size=5
    )
)
def test_any_lines_give_a_mesh(lines):
    """Lines that cross, touch, overlap, run along sides or beyond them; on a lattice of eighths of a post."""
    grid = Grid(hills(9, 9))
    lines = [[(x / 8, y / 8) for x, y in line] for line in lines]
    ground = shapely.box(0, 0, 8, 8)
    shapes = [shapely.linestrings(line) if len(line) > 1 else shapely.points(line[0]) for line in lines]
    try:
        h = build_hierarchy(grid, method=PYRAMID, lines=lines, passes=1)
    except InputError as error:
        assert "none on ground" in str(error)  # noqa: PT017 (either outcome is right)
        assert all(shapely.intersection(shape, ground).length == 0 for shape in shapes)
        return
    judge_hierarchy(h, grid, is_nested=False)
    edges = shapely.STRtree(shapely.linestrings([h.nodes[list(edge), :2] for edge in edges_of(h, 1)]))
    inside = [shapely.clip_by_rect(shapely.linestrings(line), 0, 0, 8, 8) for line in lines if len(line) > 1]
    samples = [
        shapely.line_interpolate_point(line, np.linspace(0, 1, 21), normalized=True) for line in inside if line.length
    ]
    for places in samples:
        assert edges.query_nearest(places, return_distance=True, all_matches=False)[1].max() <= STEP


def test_nodes_of_lines_have_the_height_asked_for():
    grid = Grid(hills(9, 9))
    flat_line = [(1.5, 1.25), (5.5, 6.75)]
    h = build_hierarchy(grid, method=PYRAMID, lines=[flat_line], passes=0)
    at = {tuple(node[:2]): node[2] for node in h.nodes.tolist()}
    corners = grid.heights[1:3, 1:3]
    expected = np.array([0.75, 0.25]) @ corners @ np.array([0.5, 0.5])
    assert at[1.5, 1.25] == pytest.approx(expected)
    h = build_hierarchy(
        grid, method=PYRAMID, lines=[[(1.5, 1.25, 500.0), (5.5, 6.75, 600.0), (7.0, 7.0, 900.0)]], passes=0
    )
    at = {tuple(node[:2]): node[2] for node in h.nodes.tolist()}
    assert (at[1.5, 1.25], at[5.5, 6.75], at[7.0, 7.0]) == (500.0, 600.0, grid.heights[7, 7])  # the last on a post


def test_a_store_with_lines(tmp_path):
    report = vpfx.build(CELL, tmp_path / "a.gpkg", method=PYRAMID, max_error=(60, 30), features=STREAMS)
    figures = judge_store(report.path, CELL)
    assert [f.bound for f in figures] == [60, 30]
    assert query(report.path, "SELECT name FROM source ORDER BY source_id") == [(CELL.name,), (STREAMS.name,)]
    assert json.loads(query(report.path, "SELECT value FROM metadata WHERE name = 'options'")[0][0])["features"] == [
        STREAMS.name
    ]
    again = vpfx.build(CELL, tmp_path / "b.gpkg", method=PYRAMID, max_error=(60, 30), features=[STREAMS])
    assert report.path.read_bytes() == again.path.read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("dem", "lines"),
    [
        ("mark_twain_cell_5min_1arcsec.tif", "mark_twain_lake_shoreline.geojson"),
        ("killeen_cell_1arcsec_partial.tif", "killeen_cell_shoreline.geojson"),
        ("spearfish_utm13_30m.tif", "spearfish_roads.shp"),
        ("sao_tome_n00_e006.dt1", "gshhg_shore_n00_e006.geojson"),
        ("new_mexico_cell_5min_1arcsec.tif", "new_mexico_nhd_flowlines.geojson"),
    ],
)
def test_real_lines(dem, lines, tmp_path):
    dem, lines = shared_dem(dem), shared_feature(lines)
    report = vpfx.build(dem, tmp_path / "a.gpkg", method=PYRAMID, max_error=(40, 20), features=lines)
    judge_store(report.path, dem)
    report = vpfx.build(dem, tmp_path / "b.gpkg", passes=2, grid=(9, 9), tolerance=5, features=lines)
    judge_store(report.path, dem)


# --- further points ---------------------------------------------------------------------------------------------------


def one_pass(points, **options):
    """Nodes that one pass adds to two faces over level ground, given points with heights."""
    grid = Grid(np.zeros((9, 9)))
    h = build_hierarchy(grid, passes=1, lines=[[point] for point in points], **options)
    judge_hierarchy(h, grid)
    return sorted(map(tuple, h.nodes[h.node_level == 1].round(12).tolist()))


def test_a_point_inside_a_face_is_its_node():
    """Faces: SW SE NE below the diagonal, SW NE NW above it."""
    assert one_pass([(5.75, 2.5, 3.0)]) == [(5.75, 2.5, 3.0)]
    assert one_pass([(5.75, 2.5, 3.0), (5.5, 2.25, -4.0)]) == [(5.5, 2.25, -4.0)]
    assert one_pass([(5.75, 2.5, 3.0), (2.5, 5.5, 1.0)]) == [(2.5, 5.5, 1.0), (5.75, 2.5, 3.0)]
    assert one_pass([(5.75, 2.5, 3.0)], tolerance=3.0) == []
    assert one_pass([(5.75, 2.5, 3.0)], xy_ratio=0.35) == []


def test_a_point_beside_an_edge_breaks_it_at_its_foot():
    assert one_pass([(3.25, 0.375, 2.0)]) == [(3.25, 0.0, 2.0)]
    assert one_pass([(3.0, 0.625, 2.0)], xy_ratio=0.05) == [(3.0, 0.625, 2.0)]  # too far from the edge
    assert one_pass([(4.25, 3.75, 2.0)]) == [(4.0, 4.0, 2.0)]
    assert one_pass([(4.25, 3.75, 2.0), (4.5, 5.0, -3.0)]) == [(4.75, 4.75, -3.0)]
    assert one_pass([(0.5, 0.25, 2.0)]) == []  # too near the end


def test_the_more_significant_of_post_and_point_is_taken():
    for post, point, foot in (((6, 2), (5.75, 2.5), (5.75, 2.5)), ((3, 0), (3.25, 0.25), (3.25, 0))):
        heights = np.zeros((9, 9))
        heights[post[1], post[0]] = 5.0
        for z, expected in ((4.0, (*post, 5)), (6.0, (*foot, 6))):
            h = build_hierarchy(Grid(heights), passes=1, lines=[[(*point, z)]])
            assert tuple(h.nodes[h.node_level == 1][0]) == expected


@pytest.mark.parametrize("surface", [name for name in SURFACES if name not in ("huge", "tiny")])
def test_points_on_every_surface(surface):
    grid, rng = SURFACES[surface], np.random.default_rng(3)
    x0, y0, x1, y1 = grid.extent
    points = [[(x0 + u * (x1 - x0), y0 + v * (y1 - y0), 50 * z)] for u, v, z in rng.uniform(-0.1, 1.1, (30, 3))]
    for options in ({"passes": 3}, {"passes": 2, "grid": (3, 2)}, {"passes": 2, "fill": True}):
        judge_hierarchy(build_hierarchy(grid, lines=points, **options), grid)


def test_points_in_tiles_make_a_store_without_cracks(tmp_path):
    paths = [
        vpfx.build(
            CELL, tmp_path / f"{n}.gpkg", passes=2, tolerance=5, tile_size=64, features=STREAMS, workers=n, grid=(3, 3)
        ).path
        for n in (1, 3)
    ]
    judge_store(paths[0], CELL)
    assert paths[0].read_bytes() == paths[1].read_bytes()


def test_posts_alone_are_as_without_points():
    grid = read_grid(CELL)
    one = build_hierarchy(grid, passes=2, grid=(9, 9))
    other = build_hierarchy(grid, passes=2, grid=(9, 9), lines=[[(0.0, 0.0)]])
    np.testing.assert_array_equal(one.nodes, other.nodes)


# --- who takes them ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
def test_methods_refuse_what_they_make_nothing_of(method):
    grid, part = SOLID["noise"], METHODS[method]
    if not part.features:
        with pytest.raises(InputError, match="makes nothing of lines"):
            build_hierarchy(grid, method=method, passes=1, lines=[[(1, 1)]])
    else:
        build_hierarchy(grid, method=method, passes=1, lines=[[(1, 1)]])
    if part.features == "points":
        with pytest.raises(InputError, match="expected passes"):
            build_hierarchy(grid, method=method, max_error=(1,), lines=[[(1, 1)]])


@pytest.mark.parametrize("lines", [[[1, 2]], [[(1, 2, 3, 4)]], [[(1, np.nan)]], [[(np.inf, 1)]]], ids=str)
def test_lines_of_other_shapes_are_refused(lines):
    with pytest.raises(InputError, match="lines: found an array"):
        build_hierarchy(SOLID["noise"], method=PYRAMID, passes=1, lines=lines)


def test_options_without_a_file_are_refused(tmp_path):
    with pytest.raises(InputError, match="found use_z, but no file"):
        vpfx.build(CELL, tmp_path / "a.gpkg", passes=1, feature_options={"use_z": True})


# --- what a second look found -----------------------------------------------------------------------------------------


def test_features_are_not_overwritten(tmp_path):
    own = write(tmp_path / "own.gpkg", ["LINESTRING (-107.65 36.35, -107.62 36.38)"], "GPKG", crs="EPSG:4269")
    before = own.read_bytes()
    with pytest.raises(InputError, match="which is one of the files read"):
        vpfx.build(CELL, own, method=PYRAMID, max_error=(60,), features=own, overwrite=True)
    assert own.read_bytes() == before


def test_lines_without_heights_take_none_from_others():
    grid = Grid(np.full((41, 41), 100.0))
    lines = [[(5.5, 5.5, 500.0), (10.5, 10.5, 500.0)], [(25.5, 25.5), (30.5, 30.25)]]
    h = build_hierarchy(grid, method=PYRAMID, passes=0, lines=lines)
    at = {tuple(node[:2]): node[2] for node in h.nodes.tolist()}
    assert (at[5.5, 5.5], at[25.5, 25.5], at[30.5, 30.25]) == (500.0, 100.0, 100.0)


def test_heights_that_are_none_are_refused(tmp_path):
    for z in ("1e300", "-3.4e38"):
        path = write(tmp_path / "a.gpkg", [f"LINESTRING Z (1 2 5, 3 4 {z})"], "GPKG", layer=f"l{z[:2]}")
        with pytest.raises(FeatureFormatError, match=r"vertex \(3, 4\): found z"):
            read(path, use_z=True, layer=f"l{z[:2]}")
        assert len(read(path, layer=f"l{z[:2]}").lines) == 1
    with pytest.raises(InputError, match="lines: found an array"):
        build_hierarchy(SOLID["noise"], method=PYRAMID, passes=1, lines=[[(1, 1, np.inf)]])


def test_heights_in_feet_become_metres(tmp_path):
    path = write(tmp_path / "a.gpkg", ["LINESTRING Z (1 2 100, 3 4 200)"], "GPKG", crs="EPSG:32613+6360")
    z = read(path, use_z=True).lines[0][:, 2]
    np.testing.assert_allclose(z, [100 * 1200 / 3937, 200 * 1200 / 3937])


def test_every_file_has_to_give_something(tmp_path):
    near = write(tmp_path / "near.geojson", ["POINT (3 3)"])
    beside = write(tmp_path / "beside.geojson", ["POINT (10.05 3)"])
    with pytest.raises(InputError, match=r"beside.geojson: found no point, line or outline on the DEM"):
        read([near, beside])
    with pytest.raises(InputError, match="none on ground with data"):
        build_hierarchy(VOIDS["ring with island"], method=PYRAMID, passes=1, lines=[[(8, 4.0), (8.5, 4.5)]])


def test_a_crs_that_nobody_knows_is_refused(tmp_path):
    path = write(tmp_path / "a.geojson", ["POINT (3 3)"])
    path.write_text(path.read_text().replace("EPSG::32613", "EPSG::999999"))
    with pytest.raises(FeatureFormatError, match="found no CRS that is known"):
        read(path)
