"""The judge of stores is judged: a small store made by plain SQL passes, and each defect in it is found."""

from __future__ import annotations

import math
import sqlite3
import struct

import invariants
import numpy as np
import pytest
import rasterio
from invariants_store import register
from test_invariants import LINKS, example, grid_of, to_nodes

TILES = {1: (0, 2), 2: (2, 4)}  # columns
DDL = """
CREATE TABLE level (level, max_error_bound, max_error, rmse, node_count, edge_count, face_count);
CREATE TABLE tile (tile_id, tile_name, xmin, ymin, xmax, ymax);
CREATE TABLE node (node_id, tile_id, level, x, y, z, xyz);
CREATE TABLE edge
    (edge_id, tile_id, level, start_node, end_node, right_face, left_face, right_edge, left_edge);
CREATE TABLE face (face_id, tile_id, level, node_1, node_2, node_3, edge_1, edge_2, edge_3, is_filled);
CREATE TABLE parent_child (parent_face, child_face);
"""


def write_store(path):
    """Write the example: nodes from 101, faces from 10 and 20, edges from 1000 and 2000; return its posts."""
    h, posts = example()
    store = sqlite3.connect(path)
    store.executescript(DDL)
    corners = (
        to_nodes(np.array([(0, 0), (2, 2), (2, 0), (4, 2)], float), np.zeros(4), posts)[:, :2].reshape(2, 4).tolist()
    )
    _insert(store, "tile", [(i, f"T{i}", *corners[i - 1]) for i in TILES])
    tile_of = [1, 2, 2, 1, 1, 1, 1]
    _insert(
        store,
        "node",
        [
            (101 + i, tile_of[i], int(h.node_level[i]), *p, struct.pack("<3d", *p))
            for i, p in enumerate(h.nodes.tolist())
        ],
    )
    for level, faces in enumerate(h.level_faces):
        edges, rows = winged_edges(h.nodes, faces.tolist()), []
        base, face_base = 1000 * (level + 1), 10 * (level + 1)
        tile = [1, 1, 1, 1, 2, 2][-len(faces) :]
        for i, (start, end, right, left, right_edge, left_edge) in enumerate(edges):
            sides = [None if side is None else face_base + side for side in (right, left)]
            home = min(tile[side] for side in (right, left) if side is not None)
            rows.append((base + i, home, level, 101 + start, 101 + end, *sides, base + right_edge, base + left_edge))
        _insert(store, "edge", rows)
        ends = [{start, end} for start, end, *_ in edges]
        for i, face in enumerate(faces.tolist()):
            joined = [base + ends.index({face[j], face[(j + 1) % 3]}) for j in range(3)]
            _insert(store, "face", [(face_base + i, tile[i], level, *(101 + n for n in face), *joined, 0)])
        rmse = math.sqrt(h.squared_error[level] / 15)
        counts = (6 + level, len(edges), len(faces))
        _insert(store, "level", [(level, h.max_error_bound[level], h.max_error[level], rmse, *counts)])
    _insert(store, "parent_child", [(10 + parent, 20 + child) for parent, child in LINKS.tolist()])
    store.commit()
    store.close()
    return posts


def _insert(store, table, rows):
    store.executemany(f"INSERT INTO {table} VALUES ({', '.join('?' * len(rows[0]))})", rows)


def winged_edges(nodes, faces):
    """Return start, end, right face, left face, right edge, left edge of each edge, found the slow way."""
    owner = {(face[i], face[(i + 1) % 3]): f for f, face in enumerate(faces) for i in range(3)}
    ends = sorted({(min(side), max(side)) if sum(side) % 2 else (max(side), min(side)) for side in owner})

    def turn(edge, node):
        there = sum(edge) - node
        return math.atan2(nodes[there][1] - nodes[node][1], nodes[there][0] - nodes[node][0])

    def following(edge, node):
        at_node = [other for other in ends if node in other and other != edge]
        return ends.index(
            min(at_node, key=lambda other: (turn(other, node) - turn(edge, node)) % (2 * math.pi), default=edge)
        )

    return [(s, e, owner.get((e, s)), owner.get((s, e)), following((s, e), e), following((s, e), s)) for s, e in ends]


STORE_MUTATIONS = {
    "UPDATE edge SET left_face = right_face, right_face = left_face WHERE edge_id = 1003": "left_face is .*, expected",
    "UPDATE edge SET start_node = end_node, end_node = start_node WHERE edge_id = 2003": "left_face is .*, expected",
    "UPDATE edge SET left_face = NULL WHERE left_face = 21": "level 1: edge .*: left_face is NULL, expected face 21",
    "UPDATE edge SET left_face = 13 WHERE left_face = 21": "edge 20..: left_face 13 of this level does not exist",
    "UPDATE edge SET left_face = 22 WHERE left_face IS NULL AND level = 1": "left_face is face 22, expected NULL",
    "UPDATE edge SET left_face = 0 WHERE left_face IS NULL": "table edge: found .*'left_face': 0.*, expected pos",
    "UPDATE edge SET right_edge = left_edge WHERE edge_id = 2005": "right_edge is edge 20.., expected edge 20..",
    "UPDATE edge SET left_edge = edge_id WHERE edge_id = 1000": "left_edge is edge 1000, expected edge 10..",
    "UPDATE edge SET left_edge = 2000 WHERE edge_id = 1000": "edge 1000: left_edge 2000 of this level does not exist",
    "UPDATE edge SET end_node = 199 WHERE edge_id = 1000": "edge 1000: end_node 199 of this level does not exist",
    "UPDATE edge SET end_node = 107 WHERE edge_id = 1000": "edge 1000: node 107 is of level 1",
    "UPDATE edge SET edge_id = 2001 WHERE edge_id = 2000": "edge 2001: its id is not unique",
    "UPDATE edge SET tile_id = 1, (end_node, start_node) = (SELECT start_node, end_node FROM edge "
    "WHERE edge_id = 2000) WHERE edge_id = 2001": "edge 2000 .* and edge 2001 .* join the same nodes",
    "UPDATE edge SET level = 7 WHERE edge_id = 2003": "edge 2003: its level does not exist",
    "UPDATE edge SET tile_id = 2 WHERE start_node IN (101, 104)": "edge .*: not within the extent of its tile 2",
    "DELETE FROM edge WHERE edge_id = 2003": "face .*: edge_. 2003 of this level does not exist",
    "UPDATE face SET edge_1 = edge_2, edge_2 = edge_1 WHERE face_id = 22": "face 22: edge_1 is edge .*, expected one",
    "UPDATE face SET node_1 = node_2, node_2 = node_1 WHERE face_id = 22": "level 1: face 22: not counter-clockwise",
    "UPDATE face SET node_1 = 107 WHERE face_id = 10": "level 0: face 10: node 107 is of level 1",
    "UPDATE face SET tile_id = 1 WHERE face_id = 12": "face 12: not within the extent of its tile 1",
    "UPDATE face SET tile_id = 3 WHERE face_id = 12": "face 12: tile 3 does not exist",
    "UPDATE face SET is_filled = 1 WHERE face_id = 24": "level 1: .*(the outline|no edge lies on it)",
    "UPDATE face SET is_filled = NULL WHERE face_id = 24": "level 1: face 24: is_filled is None",
    "UPDATE face SET face_id = '10' WHERE face_id = 10": "table face: found .*, expected positive integers",
    "UPDATE node SET level = 0 WHERE node_id = 107": "level 0: found .*nodes|counted",
    "UPDATE node SET level = 1 WHERE node_id = 106": "level 0: face 10: node 106 is of level 1",
    "UPDATE node SET z = z + 1e-9 WHERE node_id = 103": "node 103: xyz holds .*, the columns",
    "UPDATE node SET xyz = zeroblob(23) WHERE node_id = 103": "node 103: xyz is not a blob of 24 bytes",
    "UPDATE node SET z = NULL WHERE node_id = 103": "node 103: one of x, y, z is not a finite number",
    "UPDATE node SET tile_id = 2 WHERE node_id = 101": "node 101: not within the extent of its tile 2",
    "UPDATE node SET node_id = -1 WHERE node_id = 107": "table node: found .*'node_id': -1.*, expected pos",
    "DELETE FROM node WHERE node_id = 107": "level 1: face 2.: node_. 107 of this level does not exist",
    "UPDATE tile SET xmax = xmin": "tile 1: its extent .* is empty",
    "UPDATE level SET edge_count = edge_count + 1 WHERE level = 1": "level 1: table level: found .*, counted",
    "UPDATE level SET max_error = max_error - 1e-3 WHERE level = 1": "level 1: max_error is .*, measured",
    "UPDATE level SET max_error_bound = 5 WHERE level = 0": r"level 0: post \(1, 1\): 5.5 m off face 1., the bound",
    "UPDATE level SET rmse = rmse * 1.00001 WHERE level = 1": "level 1: rmse is .*, measured",
    "UPDATE level SET level = 2 WHERE level = 1": "table level: found .*, expected levels 0, 1",
    "UPDATE level SET rmse = NULL": "table level: found None, expected a number",
    "UPDATE parent_child SET parent_face = 10 WHERE child_face = 22": "face 2.: (node .* outside|only child)",
    "UPDATE parent_child SET child_face = 13 WHERE child_face = 25": "link .* faces of levels 0 and 0",
    "UPDATE parent_child SET child_face = 99 WHERE child_face = 25": "child_face 99 does not exist",
    "DELETE FROM parent_child WHERE child_face = 25": "level 1: face 25: 0 parents, expected one",
    "ALTER TABLE edge RENAME COLUMN left_edge TO next_edge": "table edge: found columns .*, missing .*left_edge",
    "UPDATE edge SET start_node = 104, end_node = 105, left_face = NULL, right_face = NULL WHERE edge_id = 2000": (
        "level 1: edge 2000 .*: no face uses it"
    ),
    "UPDATE level SET edge_count = 13 WHERE level = 1; "
    "INSERT INTO edge VALUES (2999, 1, 1, 104, 105, NULL, NULL, 2000, 2000)": "found 13 edges, the faces have 12",
    "DROP TABLE parent_child": "table parent_child: found columns .*missing",
}


@pytest.mark.parametrize("sql", STORE_MUTATIONS)
def test_broken_store_is_found(sql, tmp_path):
    posts = write_store(tmp_path / "a store.gpkg")
    with sqlite3.connect(tmp_path / "a store.gpkg") as store:
        for statement in sql.split(";"):
            assert store.execute(statement).rowcount, "a mutation that changes nothing"
    with pytest.raises(AssertionError, match=STORE_MUTATIONS[sql]):
        invariants.judge_store(tmp_path / "a store.gpkg", grid=posts)


def write_dem(path, posts, rows=slice(None)):
    """Write some rows of the posts, north first, -9 for voids."""
    heights = np.nan_to_num(posts.heights[rows], nan=-9)[::-1]
    north = posts.y0 + (range(len(posts.heights))[rows][-1] + 0.5) * posts.dy
    transform = rasterio.Affine(posts.dx, 0, posts.x0 - posts.dx / 2, 0, -posts.dy, north)
    profile = {"driver": "GTiff", "height": heights.shape[0], "width": heights.shape[1], "count": 1, "nodata": -9}
    with rasterio.open(path, "w", **profile, dtype="float64", crs="EPSG:4326", transform=transform) as dataset:
        dataset.write(heights, 1)


def test_command_line_and_mosaic(tmp_path, capsys):
    posts = write_store(tmp_path / "s.gpkg")
    write_dem(tmp_path / "south.tif", posts, slice(0, 2))
    write_dem(tmp_path / "north.tif", posts, slice(1, 3))
    dems = [str(tmp_path / name) for name in ("north.tif", "south.tif")]
    read = invariants.read_posts(*dems)
    np.testing.assert_array_equal(read.heights, posts.heights)
    assert invariants.main([str(tmp_path / "s.gpkg"), *dems]) == 0
    assert capsys.readouterr().out.splitlines()[1].startswith("level 1: bound 3.5 m, max error 3.5 m, rmse 1.89")
    assert len(invariants.judge_store(tmp_path / "s.gpkg", dems)) == 2
    assert len(invariants.judge_store(tmp_path / "s.gpkg")) == 2
    assert invariants.main([str(tmp_path / "s.gpkg"), dems[0]]) == 1
    assert capsys.readouterr().err.startswith("level 0: ")
    assert invariants.main([]) == 2
    assert invariants.main([str(tmp_path / "none.gpkg")]) == 3
    assert invariants.main([str(tmp_path / "s.gpkg"), str(tmp_path / "none.tif")]) == 3


def test_files_on_no_lattice(tmp_path):
    posts = grid_of(np.ones((3, 4)))
    write_dem(tmp_path / "a.tif", posts)
    write_dem(tmp_path / "b.tif", posts._replace(x0=posts.x0 + posts.dx / 3))
    with pytest.raises(AssertionError, match=r"b.tif: its posts are 0.333 spacings off the lattice of .*a.tif"):
        invariants.read_posts(tmp_path / "a.tif", tmp_path / "b.tif")
    with rasterio.open(tmp_path / "b.tif", "r+") as dataset:
        dataset.transform = dataset.transform @ rasterio.Affine.rotation(3)
    with pytest.raises(AssertionError, match=r"b.tif: found transform .*, expected north up"):
        invariants.read_posts(tmp_path / "b.tif")


def test_lattice_is_taken_from_tiles_within_reason():
    """A spacing with fewer digits is the same lattice; a shift by a thousandth of a spacing is not."""
    posts = grid_of(np.zeros((1201, 1201)), x0=5.0, dx=1 / 1200)
    tiles = np.array([(5 + i, 32.3, 5.5 + i, 33.3) for i in (0, 0.5)])
    assert register(posts._replace(dx=0.0008333333333), tiles).dx == pytest.approx(1 / 1200, rel=1e-15)
    for other in (posts, posts._replace(x0=5.0 + 1e-6), posts._replace(dx=1 / 1199)):
        assert register(other, tiles) == other
