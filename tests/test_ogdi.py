"""Exported VPF as GDAL with OGDI reads it: a reader of which no line is ours.

OGDI puts every face together by walking its winged edges, so faces that come out as they went in mean that its walks close.
It keeps the coordinates of edges in single precision whatever they were, and drops z; the point class `tinnode` has heights
as a column.
"""

from __future__ import annotations

import shutil
import sqlite3
import subprocess
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyogrio
import pytest
import shapely
from conftest import shared_vpf, slow_apart
from numpy.typing import NDArray

import vpfx
from vpfx.cli import main
from vpfx.store.edit import edit_store

FIXTURES = Path(__file__).parent.parent / "fixtures" / "dem"


def _has_ogdi() -> bool:
    if not (shutil.which("ogrinfo") and shutil.which("ogr2ogr")):
        return False
    return "OGDI" in subprocess.run(["ogrinfo", "--formats"], capture_output=True, text=True, check=True).stdout


pytestmark = pytest.mark.skipif(
    not _has_ogdi(), reason="GDAL with OGDI is not installed (Debian: gdal-bin, libogdi4.1)"
)


class Layer(NamedTuple):
    """A layer as OGDI reads it."""

    shapes: NDArray[np.object_]
    columns: dict[str, NDArray[Any]]


def run(*arguments: str) -> str:
    """Run a program of GDAL and return what it prints; it may not complain."""
    done = subprocess.run(arguments, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return done.stdout


def vpfx_command(*arguments: str | Path) -> None:
    """Run a command of vpfx, which has to end well."""
    with pytest.raises(SystemExit) as end:
        main([str(argument) for argument in arguments])
    assert end.value.code == 0


def read_all(library: Path, folder: Path, *options: str) -> dict[str, Layer]:
    """Every layer of a library by the name OGDI gives it."""
    copy = folder / "read.gpkg"
    copy.unlink(missing_ok=True)
    run("ogr2ogr", "-f", "GPKG", *options, str(copy), f"gltp:/vrf{library}")
    layers = {}
    for name in pyogrio.list_layers(copy)[:, 0]:
        meta, _, shapes, columns = pyogrio.raw.read(copy, layer=name)
        layers[name] = Layer(shapely.from_wkb(shapes), dict(zip(meta["fields"], columns, strict=True)))
    return layers


def attach_soil(path: Path) -> None:
    """Put soils on every second and every third of the finest faces, with shares, and one on a coarse face."""
    with vpfx.open_store(path) as store:
        finest = store.rows("face", len(store.levels) - 1)["face_id"]
    with edit_store(path) as editor:
        editor.create_class("soil", {"name": "text", "code": "integer", "depth": "real"})
        editor.describe_values("soil", "code", {7: "loam"})
        columns = {"name": ["loess", "till", "rock"], "code": [7, 9, 11], "depth": [1.5, None, 0.25]}
        loess, till, rock = editor.add_features("soil", columns).tolist()
        faces = np.concatenate([finest[::2], finest[::3]])
        kinds = np.repeat([loess, till], [len(finest[::2]), len(finest[::3])])
        editor.set_faces("soil", faces, kinds, np.where(np.isin(faces, finest[::6]), 0.5, 1.0))
        editor.set_faces("soil", [1], [rock])


@pytest.fixture(
    scope="module",
    params=slow_apart(["cell", "voids", "cell, double", "one tile"], ["cell, double", "one tile"]),
)
def exported(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, bool]:
    """Return a store, the library it was exported to, and whether its coordinates are doubles."""
    folder = tmp_path_factory.mktemp("ogdi")
    dem, bounds, size = {
        "cell": ("new_mexico_cell_5min_1arcsec.tif", (60, 30, 15, 8), 128),
        "cell, double": ("new_mexico_cell_5min_1arcsec.tif", (40, 20), 128),
        "voids": ("new_mexico_voids.tif", (40, 20, 10), 50),
        "one tile": ("new_mexico_cell_5min_1arcsec.tif", (60, 30), 512),
    }[request.param]
    is_double = request.param.endswith("double")
    vpfx.build(FIXTURES / dem, folder / "store.gpkg", max_error=bounds, tile_size=size)
    attach_soil(folder / "store.gpkg")
    options = ["--double"] if is_double else []
    vpfx_command("export", folder / "store.gpkg", "--to", "vpf", "-o", folder / "nm", *options)
    return folder / "store.gpkg", folder / "nm" / "terrain", is_double


@pytest.fixture(scope="module")
def layers(exported: tuple[Path, Path, bool], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Layer]:
    return read_all(exported[1], tmp_path_factory.mktemp("read"))


def query(path: Path, sql: str) -> list[tuple[Any, ...]]:
    database = sqlite3.connect(path)
    try:
        return database.execute(sql).fetchall()
    finally:
        database.close()


def rounded(values: Any, is_double: bool) -> NDArray[np.float64]:
    array = np.asarray(values, np.float64)
    return array if is_double else array.astype(np.float32).astype(np.float64)


def corners(shapes: Any) -> NDArray[np.float64]:
    """Three places of each polygon, in its order."""
    assert shapely.get_num_interior_rings(shapes).max() == 0
    places, face = shapely.get_coordinates(shapes, return_index=True)
    is_new = np.r_[
        True, (np.diff(face) > 0) | (np.diff(places, axis=0) != 0).any(axis=1)
    ]  # where edges meet it stands twice
    assert (np.bincount(face[is_new]) == 4).all()
    rings = places[is_new].reshape(-1, 4, 2)
    assert np.array_equal(rings[:, 0], rings[:, 3])
    return rings[:, :3]


def test_every_coverage_is_there(exported: Any, layers: dict[str, Layer]) -> None:
    n_level = query(exported[0], "SELECT count(*) FROM level")[0][0]
    expected = {"libref@libref(*)_line", "tileref@tileref(*)_area"}
    for level in range(n_level):
        expected |= {f"{name}@tin{level}(*)_{kind}" for name, kind in
                     (("tinface", "area"), ("tinnode", "point"), ("soil", "area"))}  # fmt: skip
    assert set(layers) == expected


def test_tiles(exported: Any, layers: dict[str, Layer]) -> None:
    found = layers["tileref@tileref(*)_area"]
    expected = query(exported[0], "SELECT xmin, ymin, xmax, ymax FROM tile ORDER BY tile_id")
    assert np.array_equal(shapely.bounds(found.shapes), rounded(expected, False))
    assert found.columns["id"].tolist() == list(range(1, len(expected) + 1))
    (outline,) = layers["libref@libref(*)_line"].shapes
    assert outline.is_closed
    assert np.allclose(outline.bounds, shapely.total_bounds(found.shapes), rtol=0, atol=1e-5)


def test_every_face_comes_out_as_it_went_in(exported: Any, layers: dict[str, Layer]) -> None:
    path = exported[0]
    place = {row[0]: row[1:] for row in query(path, "SELECT node_id, x, y FROM node")}
    for (level,) in query(path, "SELECT level FROM level"):
        found = layers[f"tinface@tin{level}(*)_area"]
        rows = query(path, f"SELECT tile_id, node_1, node_2, node_3 FROM face WHERE level = {level} ORDER BY face_id")
        assert len(found.shapes) == len(rows)
        assert found.columns["tile_id"].tolist() == [row[0] for row in rows]
        expected = rounded([[place[node] for node in row[1:]] for row in rows], False)
        clockwise, found_corners = expected[:, ::-1], corners(found.shapes)
        turns = [(np.roll(clockwise, turn, axis=1) == found_corners).all(axis=(1, 2)) for turn in range(3)]
        assert np.any(turns, axis=0).all()
        a, b, c = expected.transpose(1, 0, 2)
        area = ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
        assert np.allclose(shapely.area(found.shapes), area, rtol=1e-6, atol=1e-15)


def test_attributes_of_faces(exported: Any, layers: dict[str, Layer]) -> None:
    path = exported[0]
    for (level,) in query(path, "SELECT level FROM level"):
        columns = layers[f"tinface@tin{level}(*)_area"].columns
        stored = "slope_centidegrees, aspect_centidegrees, is_filled"
        slope, aspect, filled = zip(
            *query(path, f"SELECT {stored} FROM face WHERE level = {level} ORDER BY face_id"),
            strict=True,
        )  # fmt: skip
        assert np.allclose(columns["slope"], np.array(slope) / 100, atol=1e-5)
        assert np.allclose(columns["aspect"].astype(float), np.array(aspect, float) / 100, atol=1e-4, equal_nan=True)
        assert columns["filled"].tolist() == list(filled)
        if level:
            first = query(path, f"SELECT face_id FROM face WHERE level = {level - 1} ORDER BY face_id")
            number = {face: i + 1 for i, (face,) in enumerate(first)}
            links = query(
                path, "SELECT parent_face FROM parent_child JOIN face ON face_id = child_face "
                f"WHERE level = {level} ORDER BY face_id",
            )  # fmt: skip
            assert columns["parent"].tolist() == [number[face] for (face,) in links]


def test_nodes(exported: Any, layers: dict[str, Layer]) -> None:
    path, _, is_double = exported
    for (level,) in query(path, "SELECT level FROM level"):
        found = layers[f"tinnode@tin{level}(*)_point"]
        expected = query(
            path, "SELECT DISTINCT tile, node_id, x, y, z, n.level FROM node n JOIN ("
            + " UNION ".join(f"SELECT tile_id AS tile, node_{i} AS node FROM face WHERE level = {level}" for i in (1, 2, 3))
            + ") ON node = node_id ORDER BY tile, node_id",
        )  # fmt: skip
        assert found.columns["tile_id"].tolist() == [row[0] for row in expected]
        assert np.array_equal(shapely.get_coordinates(found.shapes), rounded([row[2:4] for row in expected], is_double))
        z = rounded([row[4] for row in expected], is_double)
        assert np.allclose(found.columns["z"], z, rtol=0, atol=5.1e-7)  # OGDI prints six decimals
        assert found.columns["first_level"].tolist() == [row[5] for row in expected]


def test_inherited_attributes(exported: Any, layers: dict[str, Layer]) -> None:
    path = exported[0]
    names = {row[0]: row[1:] for row in query(path, "SELECT feature_id, name, code, depth FROM soil")}
    for (level,) in query(path, "SELECT level FROM level"):
        found = layers[f"soil@tin{level}(*)_area"]
        expected = query(
            path, "SELECT a.feature_id, f.face_id FROM face f JOIN face_attribute a ON a.face_id = f.face_id "
            f"WHERE f.level = {level} ORDER BY a.feature_id, f.face_id",
        )  # fmt: skip
        assert found.columns["name"].tolist() == [names[feature][0] for feature, _ in expected]
        assert found.columns["code"].tolist() == [names[feature][1] for feature, _ in expected]
        depth = np.array([names[feature][2] for feature, _ in expected], float)
        assert np.array_equal(found.columns["depth"].astype(float), depth, equal_nan=True)
        faces = query(path, f"SELECT face_id FROM face WHERE level = {level} ORDER BY face_id")
        index = {face: i for i, (face,) in enumerate(faces)}
        shapes = layers[f"tinface@tin{level}(*)_area"].shapes[[index[face] for _, face in expected]]
        assert shapely.equals(found.shapes, shapes).all()


def test_a_region_reads_the_same(exported: Any, layers: dict[str, Layer], tmp_path: Path) -> None:
    _, library, _ = exported
    whole = layers["tinface@tin1(*)_area"]
    min_x, min_y, max_x, max_y = shapely.total_bounds(whole.shapes)
    window = (min_x + (max_x - min_x) * 0.2, min_y + (max_y - min_y) * 0.3, min_x + (max_x - min_x) * 0.6, max_y)
    found = read_all(library, tmp_path, "-spat", *map(str, window))["tinface@tin1(*)_area"]
    touching = shapely.intersects(whole.shapes, shapely.box(*window))
    assert 0 < touching.sum() < len(touching)
    assert set(whole.columns["id"][touching]) == set(found.columns["id"])


def test_upper_case_names(tmp_path: Path) -> None:
    vpfx.build(FIXTURES / "new_mexico_n36_w108.dt2", tmp_path / "a.gpkg", max_error=(40, 20))
    vpfx_command("export", tmp_path / "a.gpkg", "--to", "vpf", "-o", tmp_path / "NM", "--upper")
    (library,) = (path for path in (tmp_path / "NM").iterdir() if path.is_dir())
    counts = [len(layer.shapes) for name, layer in read_all(library, tmp_path).items() if "FACE" in name.upper()]
    assert counts == [row[0] for row in query(tmp_path / "a.gpkg", "SELECT face_count FROM level ORDER BY level")]


def test_real_vpf_reads_as_ogdi_reads_it(tmp_path: Path) -> None:
    library = shared_vpf("vm2alv2_texash") / "texash"
    text = subprocess.run(
        ["ogrinfo", "-so", "-al", f"gltp:/vrf{library}"], capture_output=True, text=True, check=True
    ).stdout
    names = [line.split(": ")[1] for line in text.splitlines() if line.startswith("Layer name: ")]
    counts = [int(line.split(": ")[1]) for line in text.splitlines() if line.startswith("Feature Count: ")]
    theirs = {name.split("(")[0]: count for name, count in zip(names, counts, strict=True)}
    vpfx_command("vpf", "to-gpkg", library, "-o", tmp_path / "texash.gpkg")
    ours = {}
    for name in pyogrio.list_layers(tmp_path / "texash.gpkg")[:, 0]:
        coverage, kind = name.split("_")[-2:]
        ours[f"{kind}@{coverage}"] = pyogrio.read_info(tmp_path / "texash.gpkg", layer=name)["features"]
    assert ours == theirs
