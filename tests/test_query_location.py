"""Faces and heights at places, against a look at every face."""

from __future__ import annotations

import io
import itertools
import json
import math

import numpy as np
import pytest
from rasters import CELL
from small_stores import build_kind

import vpfx
from vpfx.cli import main
from vpfx.dem import read_grid
from vpfx.errors import InputError, NotFoundError
from vpfx.query.location import locate


@pytest.fixture(scope="module", params=["one tile", "tiles", "voids in tiles", "T-junctions"])
def store(request, tmp_path_factory):
    with vpfx.open_store(build_kind(request.param, tmp_path_factory.mktemp("locate"))) as opened:
        yield opened


def by_looking(tin, x, y):
    """Least id of the faces that have a place, and the height there; -1 and None outside."""
    found = []
    for face, nodes in zip(tin.face_attributes["face_id"].tolist(), tin.face_nodes, strict=True):
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = tin.nodes[nodes].tolist()
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        share_b = ((x - ax) * (cy - ay) - (y - ay) * (cx - ax)) / area
        share_c = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / area
        if min(share_b, share_c, 1 - share_b - share_c) >= -1e-9:
            found.append((face, az + share_b * (bz - az) + share_c * (cz - az)))
    return min(found) if found else (-1, None)


def test_places_anywhere(store):
    rng = np.random.default_rng(7)
    x0, y0, x1, y1 = store.extent
    for level in range(len(store.levels)):
        tin = store.tin(level)
        anywhere = rng.uniform((x0 - 50, y0 - 50), (x1 + 50, y1 + 50), (150, 2))
        nodes = tin.nodes[rng.choice(len(tin.nodes), 25), :2]
        sides = [tin.nodes[[face[0], face[1]], :2].mean(axis=0) for face in tin.face_nodes[:25]]
        corners = list(itertools.product((x0, x1), (y0, y1)))
        places = np.concatenate([anywhere, nodes, sides, corners])
        found = locate(store, places, level)
        for (x, y), face, z in zip(places.tolist(), found.face_ids.tolist(), found.z.tolist(), strict=True):
            expected, height = by_looking(tin, x, y)
            assert face == expected
            assert (np.isnan(z) and height is None) or z == pytest.approx(height, abs=1e-6)


def test_few_and_many_places_agree(store):
    """On lines between tiles and beyond them by less than counts, one by one, some and all at once."""
    tiles = store.tiles()
    x0, y0, x1, y1 = store.extent
    rng = np.random.default_rng(9)
    near = np.array([-1e-9, -1e-12, 0.0, 1e-12, 1e-9])
    lines = np.concatenate([tiles["xmin"], tiles["xmax"]])
    across = np.stack([rng.choice(lines, 40) + rng.choice(near, 40), rng.uniform(y0, y1, 40)], axis=1)
    lines = np.concatenate([tiles["ymin"], tiles["ymax"]])
    along = np.stack([rng.uniform(x0, x1, 40), rng.choice(lines, 40) + rng.choice(near, 40)], axis=1)
    places = np.concatenate([across, along, rng.uniform((x0, y0), (x1, y1), (20, 2))])
    for level in range(len(store.levels)):
        tin = store.tin(level)
        every = locate(store, places, level)
        assert every.face_ids.tolist() == [by_looking(tin, *place)[0] for place in places.tolist()]
        for size in (1, 32):
            parts = [locate(store, places[k : k + size], level).face_ids for k in range(0, len(places), size)]
            np.testing.assert_array_equal(np.concatenate(parts), every.face_ids)


def test_slopes_and_normals(store):
    level = len(store.levels) - 1
    tin = store.tin(level)
    middle = tin.nodes[tin.face_nodes].mean(axis=1)[:, :2]
    found = locate(store, middle, level)
    np.testing.assert_array_equal(found.face_ids, tin.face_attributes["face_id"])
    np.testing.assert_array_equal(found.slope, tin.face_attributes["slope"])
    np.testing.assert_array_equal(found.aspect, tin.face_attributes["aspect"])
    a, b, c = (tin.nodes[tin.face_nodes[:, i]] for i in range(3))  # metres
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    np.testing.assert_allclose(found.normal, normal, atol=3e-4)  # hundredths of a degree


def test_heights_at_posts_hold_the_bound(tmp_path):
    """Every post of a real DEM, in a store of many tiles."""
    path = vpfx.build(CELL, tmp_path / "a.gpkg", max_error=(20,), tile_size=100).path
    grid = read_grid(CELL)
    row, col = np.indices(grid.heights.shape)
    places = np.stack([grid.x0 + col.ravel() * grid.dx, grid.y0 + row.ravel() * grid.dy], axis=1)
    inside = ((places >= grid.extent[:2]) & (places <= grid.extent[2:])).all(axis=1)
    with vpfx.open_store(path) as opened:
        found = locate(opened, places, 0)
    assert (found.face_ids[inside] > 0).all()
    assert np.nanmax(np.abs(found.z - grid.heights.ravel())) <= 20.0


def test_what_cannot_be_asked_is_told(store):
    assert locate(store, [], 0).z.tolist() == []
    with pytest.raises(NotFoundError, match="found no level 7"):
        locate(store, [(0, 0)], 7)
    for places in ([1, 2], [[1, 2, 3]], [[np.nan, 1]]):
        with pytest.raises(InputError, match="expected \\(n, 2\\) finite numbers"):
            locate(store, places, 0)


def run(capsys, monkeypatch, *arguments, stdin=""):
    """Run the command line; return exit code, stdout and stderr."""
    monkeypatch.setattr("sys.stdin", io.StringIO(stdin))
    with pytest.raises(SystemExit) as ended:
        main(["query", "at", *map(str, arguments)])
    out, err = capsys.readouterr()
    return ended.value.code, out, err


def test_the_command_answers_in_the_order_asked(store, capsys, monkeypatch, tmp_path):
    x0, y0, x1, y1 = store.extent
    places = [(x0 + 3.5, y0 + 4.25), (x1 + 1.0, y0), (x1, y1)]
    expected = locate(store, places, 1)
    file = tmp_path / "places.txt"
    file.write_text("".join(f"{x!r}, {y!r}\n" for x, y in places))
    code, out, _ = run(capsys, monkeypatch, store.path, "--level", 1, "--points", file, "--json")
    document = json.loads(out)
    assert (code, document["level"]) == (0, 1)
    assert [(point["x"], point["y"]) for point in document["points"]] == places
    assert [point["face"] or -1 for point in document["points"]] == expected.face_ids.tolist()
    assert [math.nan if point["z"] is None else point["z"] for point in document["points"]] == pytest.approx(
        expected.z.tolist(), nan_ok=True
    )
    for point, normal in zip(document["points"], expected.normal.tolist(), strict=True):
        assert point["normal"] == (None if point["face"] is None else normal)
    code, out, _ = run(capsys, monkeypatch, store.path, "--points", "-", stdin=f"{x1 + 1} {y0}\n\n")
    assert (code, out.split()[2:]) == (0, ["–"] * 4)


@pytest.mark.parametrize(
    ("stdin", "arguments", "code", "message"),
    [
        ("1 2 3\n", [], 2, "-: line 1: found '1 2 3', expected two numbers"),
        ("1 2\nhere\n", [], 2, "line 2: found 'here'"),
        ("1 inf\n", [], 2, "finite numbers"),
        ("1 2\n", ["--level", "9"], 3, "found no level 9"),
    ],
)
def test_the_command_refuses(stdin, arguments, code, message, store, capsys, monkeypatch):
    found = run(capsys, monkeypatch, store.path, "--points", "-", *arguments, stdin=stdin)
    assert found[0] == code
    assert message in found[2]
    assert found[2].count("\n") == 1
