"""Profiles against single places and against every edge."""

from __future__ import annotations

import json

import numpy as np
import pytest
import shapely
from small_stores import build_kind

import vpfx
from vpfx.cli import main
from vpfx.errors import InputError, NotFoundError
from vpfx.query.lines import profile
from vpfx.query.location import locate


@pytest.fixture(scope="module", params=["tiles", "voids in tiles", "T-junctions"])
def store(request, tmp_path_factory):
    with vpfx.open_store(build_kind(request.param, tmp_path_factory.mktemp("lines"))) as opened:
        yield opened


def lines(store):
    """Lines of one stretch and of several, through nodes, along edges and beyond the extent."""
    rng = np.random.default_rng(8)
    x0, y0, x1, y1 = store.extent
    size = np.array([x1 - x0, y1 - y0])
    free = [rng.uniform(-0.1, 1.1, (n, 2)) * size + (x0, y0) for n in (2, 2, 2, 3, 5)]
    tin = store.tin(1)
    through = [tin.nodes[rng.choice(len(tin.nodes), 2, replace=False), :2] for _ in range(4)]
    edges = [tin.nodes[face[:2], :2] for face in tin.face_nodes[:: max(1, tin.n_face // 4)]]
    return [*free, *through, *edges, np.array([[x0, y0], [x1, y0]]), np.array([[x0, y0], [x0, y1]])]


def test_pieces_lie_on_their_faces(store):
    for level in range(2):
        tin = store.tin(level)
        row_of = {face: row for row, face in enumerate(tin.face_attributes["face_id"].tolist())}
        for line in lines(store):
            found = profile(store, line, level)
            middle = (found.start + found.end) / 2
            there = locate(store, middle[:, :2], level)
            np.testing.assert_array_equal(found.face_ids, there.face_ids)
            np.testing.assert_allclose(middle[:, 2], there.z, atol=1e-6)
            length = np.hypot(*(found.end - found.start)[:, :2].T)
            np.testing.assert_allclose(np.diff(found.distance, axis=1)[:, 0], length, rtol=1e-6, atol=1e-9)
            assert (found.distance[1:, 0] >= found.distance[:-1, 1] - 1e-6).all()
            for face, start, end in zip(found.face_ids.tolist(), found.start, found.end, strict=True):
                corners = tin.nodes[tin.face_nodes[row_of[face]], :2]
                piece = shapely.linestrings([start[:2], end[:2]])
                assert (
                    shapely.hausdorff_distance(piece, piece.intersection(shapely.polygons(corners).buffer(1e-6))) < 1e-5
                )


def test_every_edge_is_met(store):
    """As many pieces as faces that share a length with a line in general position."""
    rng = np.random.default_rng(9)
    x0, y0, x1, y1 = store.extent
    for level in range(2):
        tin = store.tin(level)
        faces = shapely.polygons(tin.nodes[tin.face_nodes, :2])
        for _ in range(10):
            line = rng.uniform((x0, y0), (x1, y1), (2, 2))
            found = profile(store, line, level)
            shared = shapely.length(shapely.intersection(faces, shapely.linestrings(line)))
            expected = tin.face_attributes["face_id"][shared > 1e-6]
            assert sorted(found.face_ids.tolist()) == sorted(expected.tolist())
            assert np.diff(found.distance, axis=1).sum() == pytest.approx(shared.sum(), rel=1e-6)


def test_what_cannot_be_asked_is_told(store):
    assert len(profile(store, [(0, 0), (0, 0)], 0).face_ids) == 0
    with pytest.raises(NotFoundError, match="found no level 7"):
        profile(store, [(0, 0), (1, 1)], 7)
    for line in ([(1, 2)], [1, 2], [(0, 0), (np.inf, 1)], [(0, 0, 0), (1, 1, 1)]):
        with pytest.raises(InputError, match="line: found an array"):
            profile(store, line, 0)


def test_the_command_follows_a_line(store, capsys):
    x0, y0, x1, y1 = store.extent
    line = f"{x0},{y0},{x1},{y1}"
    expected = profile(store, [(x0, y0), (x1, y1)], 1)
    with pytest.raises(SystemExit) as ended:
        main(["query", "profile", str(store.path), "--line", line, "--level", "1", "--json"])
    pieces = json.loads(capsys.readouterr().out)["pieces"]
    assert ended.value.code == 0
    assert [piece["face"] for piece in pieces] == expected.face_ids.tolist()
    assert [piece["distance"] for piece in pieces] == expected.distance.tolist()
    assert [piece["z"][1] for piece in pieces] == expected.end[:, 2].tolist()
    with pytest.raises(SystemExit):
        main(["query", "profile", str(store.path), "--line", line])
    finest = profile(store, [(x0, y0), (x1, y1)], len(store.levels) - 1)
    assert [int(row.split()[0]) for row in capsys.readouterr().out.splitlines()] == finest.face_ids.tolist()
    for wrong in ("1,2,3", "1,2", "a,b"):
        with pytest.raises(SystemExit) as ended:
            main(["query", "profile", str(store.path), "--line", wrong])
        assert ended.value.code == 2
        assert "--line: found" in capsys.readouterr().err
