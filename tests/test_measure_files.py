"""Measures of stores and of mesh files: the same as of the hierarchy they came from; and pictures of comparisons."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest
import trimesh
from rasters import CELL, DT2
from surfaces import SOLID, VOIDS, write_dem

import vpfx
from vpfx.cli import main
from vpfx.compare import choose_methods, compare
from vpfx.dem import read_grid
from vpfx.errors import FormatError, InputError, NotFoundError
from vpfx.gallery import draw_curves, draw_methods, greedy_curve
from vpfx.measures import measure_hierarchy, measure_mesh, measure_store
from vpfx.mesh_files import SUFFIXES, read_mesh
from vpfx.methods import METHODS
from vpfx.pipeline import build_hierarchy
from vpfx.report import plain

TIN = build_hierarchy(SOLID["noise"], passes=2, grid=(3, 2)).tin(2)


def agree(one, other, path=""):
    """All figures of two measures are equal but for rounding."""
    assert type(one) is type(other), path
    if isinstance(one, dict):
        for name in one:
            agree(one[name], other[name], f"{path}/{name}")
    elif isinstance(one, float):
        assert one == pytest.approx(other, rel=1e-6, abs=1e-9), path
    else:
        assert one == other, path


# --- stores -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
def test_a_store_measures_as_its_hierarchy(method, tmp_path):
    grid = read_grid(CELL, bbox=(-107.65, 36.35, -107.63, 36.37))
    options = {"passes": 2, "tolerance": 2.0, "grid": (3, 2)}
    report = vpfx.build(CELL, tmp_path / "a.gpkg", method=method, dem_options={"bbox": grid.extent}, **options)
    expected = measure_hierarchy(build_hierarchy(grid, method=method, **options), grid, tolerance=2.0)
    with vpfx.open_store(report.path) as store:
        found = measure_store(store, grid=grid)
    for one, other in zip(found, expected, strict=True):
        one, other = plain(one), plain(other)
        if one["step"] and method not in ("delaunay_pyramid", "constrained_delaunay_pyramid"):
            assert one["step"].pop("area_error") < 1e-6  # places in degrees are rounded
            other["step"].pop("area_error")
        agree(one, other)


def test_a_store_in_tiles_is_measured_whole(tmp_path):
    options = {"max_error": (40.0, 20.0)}
    report = vpfx.build(CELL, tmp_path / "a.gpkg", tile_size=64, **options)
    with vpfx.open_store(report.path) as store:
        found = measure_store(store, [1], grid=read_grid(CELL))
        assert measure_store(store, [1])[0].accuracy is None
    (level,) = found
    assert (level.level, level.faces, level.shape.t_junctions) == (1, report.levels[1].faces, 0)
    assert level.accuracy.max_error == pytest.approx(report.levels[1].max_error, rel=1e-9)
    assert level.accuracy.rmse == pytest.approx(report.levels[1].rmse, rel=1e-9)
    assert level.step.one_parent == 1.0


# --- mesh files -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_mesh_file_measures_as_its_level(suffix, tmp_path):
    path = tmp_path / f"a{suffix}"
    trimesh.Trimesh(TIN.nodes, TIN.face_nodes, process=False).export(path)
    found = measure_mesh(read_mesh(path), grid=SOLID["noise"])
    expected = measure_mesh(TIN, grid=SOLID["noise"])
    rounding = 1e-4 if suffix in (".stl", ".ply", ".glb") else 1e-6  # single precision
    assert (found.nodes, found.faces) == (expected.nodes, expected.faces)
    assert found.shape == pytest.approx(expected.shape, rel=rounding)
    assert found.accuracy == pytest.approx(expected.accuracy, rel=rounding, abs=1e-5)
    assert math.isnan(found.streakiness)
    assert found.step is None


def test_faces_seen_from_below_are_turned(tmp_path):
    turned = TIN.face_nodes.copy()
    turned[::2] = turned[::2, [0, 2, 1]]
    path = tmp_path / "a.off"
    trimesh.Trimesh(TIN.nodes, turned, process=False).export(path)
    tin = read_mesh(path)
    a, b, c = (tin.nodes[tin.face_nodes[:, i], :2] for i in range(3))
    assert ((b - a)[:, 0] * (c - a)[:, 1] > (b - a)[:, 1] * (c - a)[:, 0]).all()


def test_mesh_files_that_do_not_do_are_refused(tmp_path):
    with pytest.raises(NotFoundError, match="there is no such file"):
        read_mesh(tmp_path / "none.ply")
    with pytest.raises(InputError, match=r"found suffix '.xyz', expected one of"):
        read_mesh(tmp_path / "a.xyz")
    upright = tmp_path / "upright.off"
    upright.write_text("OFF\n3 1 0\n0 0 0\n1 1 0\n1 1 5\n3 0 1 2\n")
    with pytest.raises(FormatError, match="triangle 0: found no area from above"):
        read_mesh(upright)
    nothing = tmp_path / "nothing.obj"
    nothing.write_text("v 0 0 0\n")
    with pytest.raises(FormatError, match=r"expected a mesh|cannot be read"):
        read_mesh(nothing)


@pytest.mark.slow
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_broken_mesh_files_give_one_clear_error(suffix, tmp_path):
    path = tmp_path / f"a{suffix}"
    trimesh.Trimesh(TIN.nodes[:40], TIN.face_nodes[(TIN.face_nodes < 40).all(axis=1)], process=False).export(path)
    whole, rng = path.read_bytes(), np.random.default_rng(2)
    outcomes = set()
    for cut in rng.integers(0, len(whole), 60).tolist():
        changed = bytearray(whole)
        changed[cut] ^= 0xFF
        for content in (whole[:cut], bytes(changed)):
            path.write_bytes(content)
            try:
                read_mesh(path)
            except FormatError as error:
                assert "\n" not in str(error)  # noqa: PT017 (either outcome is right)
                outcomes.add("refused")
            else:
                outcomes.add("read")
    assert "refused" in outcomes


# --- the command ------------------------------------------------------------------------------------------------------


def run(capsys, *arguments):
    """Run the command line; return exit code, stdout and stderr."""
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    out, err = capsys.readouterr()
    return ended.value.code, out, err


def test_the_command_measures_stores_and_meshes(capsys, tmp_path):
    report = vpfx.build(DT2, tmp_path / "a.gpkg", max_error=(40, 20))
    code, out, _ = run(capsys, "measure", report.path, "--dem", DT2, "--format", "json")
    levels = json.loads(out)
    assert code == 0
    assert [level["faces"] for level in levels] == [line.faces for line in report.levels]
    assert [level["accuracy"]["max_error"] for level in levels] == pytest.approx([x.max_error for x in report.levels])
    code, out, _ = run(capsys, "measure", report.path, "--level", 1)
    assert code == 0
    assert "level 1" in out
    assert "level 0" not in out
    with vpfx.open_store(report.path) as store:
        tin = store.tin(1)
    mesh = tmp_path / "a.obj"
    trimesh.Trimesh(tin.nodes, tin.face_nodes, process=False).export(mesh, digits=12)
    code, out, _ = run(capsys, "measure", mesh, "--dem", DT2, "--format", "json")
    assert code == 0
    (level,) = json.loads(out)
    assert level["shape"]["mean_sliveriness"] == pytest.approx(levels[1]["shape"]["mean_sliveriness"], rel=1e-4)
    assert level["accuracy"]["max_error"] == pytest.approx(levels[1]["accuracy"]["max_error"], rel=1e-4)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["a.ply", "--level", "1"], "a mesh, which has none"),
        (["a.gpkg", "--crs", "EPSG:4326"], "a store, which names its own"),
        (["a.gpkg", "--format", "xml"], "--format: found 'xml', expected one of: text, markdown, csv, json"),
        (["a.gpkg"], "expected a store made by vpfx build"),
    ],
)
def test_the_command_refuses(arguments, message, capsys):
    code, out, err = run(capsys, "measure", *arguments)
    assert code in (2, 3)
    assert out == ""
    assert message in err
    assert err.count("\n") == 1


# --- comparisons ------------------------------------------------------------------------------------------------------


def test_methods_that_cannot_are_left_out():
    def names(grid, methods=(), **options):
        chosen, left_out = choose_methods(grid, methods, options)
        return {part.name for part in chosen}, {part.name for part in left_out}

    solid, void = SOLID["noise"], VOIDS["one void"]
    assert names(solid, passes=1) == (set(METHODS), set())
    assert names(solid, max_error=(1,))[1] == {"ternary"}
    assert names(void, passes=1)[1] == {"quadtree", "restricted_quadtree"}
    with pytest.raises(InputError, match="no method that can hold a bound"):
        names(solid, ["ternary"], max_error=(1,))
    with pytest.raises(InputError, match="no method that can follow voids"):
        names(void, ["quadtree"], passes=1)


@pytest.mark.slow
def test_pictures_of_a_comparison(tmp_path):
    grid = dataclasses.replace(SOLID["cone"])
    found = compare(grid, passes=2, grid=(3, 2), lines=[[(3.5, 3.5), (9.5, 12.5)]])
    draw_methods(found, tmp_path / "methods.png")
    curve = greedy_curve(grid, found)
    faces, errors, rmse = zip(*curve, strict=True)
    assert list(faces) == sorted(faces)
    assert list(errors) == sorted(errors, reverse=True)
    assert max(rmse) <= max(errors)
    draw_curves(found, curve, tmp_path / "curves.pdf")
    assert (tmp_path / "methods.png").read_bytes()[:4] == b"\x89PNG"
    assert (tmp_path / "curves.pdf").read_bytes()[:4] == b"%PDF"


def test_the_command_draws_comparisons(capsys, tmp_path):
    dem = write_dem(tmp_path / "a.tif", SOLID["noise"].heights)
    draw, curves = tmp_path / "methods.svg", tmp_path / "curves.png"
    code, out, _ = run(
        capsys, "compare", dem, "--passes", 1, "--methods", "ternary,wynne", "--draw", draw, "--curves", curves
    )
    assert code == 0
    assert "wynne over Delaunay" in out
    assert "wynne over Delaunay" in draw.read_text(encoding="utf-8")
    code, _, err = run(capsys, "compare", dem, "--passes", 1, "--methods", "ternary", "--draw", draw)
    assert (code, "found an existing file" in err) == (3, True)
