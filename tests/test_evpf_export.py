"""Exported databases, judged by a slow reader and exact arithmetic against the rows of the store."""

from __future__ import annotations

import sqlite3
import struct
from collections import Counter, defaultdict
from fractions import Fraction
from functools import cmp_to_key
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from slow_vpf import bins, read, rows_of
from small_stores import KINDS
from surfaces import SOLID, VOIDS, hills, write_dem

import vpfx
from vpfx.evpf.writing import export_vpf

STORES = {
    "one tile": (hills(20, 17), {"max_error": (20, 4)}),
    "tiles": (hills(25, 18), {"max_error": (20, 8), "tile_size": 9}),
    "pyramid": (hills(15, 15, 3), {"method": "delaunay_pyramid", "max_error": (20, 8, 4)}),
    "voids in tiles": KINDS["voids in tiles"],
    "T-junctions": KINDS["T-junctions"],
    "one face": (VOIDS["one triangle"].heights, {"passes": 2}),
    "touching voids": (VOIDS["diagonal voids"].heights, {"max_error": (20, 5)}),
    "ragged": (VOIDS["ragged"].heights, {"max_error": (20, 5), "tile_size": 8}),
    "ground that meets in a post": (VOIDS["almost all void"].heights, {"max_error": (20, 5), "tile_size": 8}),
    "T-junctions and voids": (VOIDS["ring with island"].heights, {"method": "quaternary", "passes": 3}),
    "thirds": (SOLID["cone"].heights, {"method": "quadtree", "max_error": (20, 2), "split": 3}),
    "pyramid in tiles": (hills(20, 20, 3), {"method": "delaunay_pyramid", "max_error": (20, 8), "tile_size": 10}),
}
FIXTURES = Path(__file__).resolve().parents[1] / "fixtures"
WINDOW = (-107.66, 36.35, -107.64, 36.37)
STREAMS = {"features": [FIXTURES / "features" / "new_mexico_streams.geojson"], "dem_options": {"bbox": WINDOW}}
REAL = {
    "real voids": ("new_mexico_voids.tif", {"max_error": (80, 40), "tile_size": 50}),
    "prescribed edges": (
        "new_mexico_cell_5min_1arcsec.tif",
        {"max_error": (80, 60), "method": "constrained_delaunay_pyramid", **STREAMS},
    ),
}


class Store:
    """Rows of a store."""

    def __init__(self, path):
        self.db = sqlite3.connect(path)
        self.nodes = {row[0]: row[1:] for row in self.db.execute("SELECT node_id, x, y, z, z_parent, level FROM node")}
        self.faces = {row[0]: row[1:] for row in self.db.execute("SELECT * FROM face")}
        self.edges = {row[0]: row[1:] for row in self.db.execute("SELECT * FROM edge")}
        self.levels = [row[0] for row in self.db.execute("SELECT level FROM level ORDER BY level")]
        self.tiles = {row[0]: row[1:] for row in self.db.execute("SELECT * FROM tile")}
        (self.set_aside,) = self.db.execute("SELECT coalesce(max(last_border_edge), 0) FROM level").fetchone()
        self.junctions = defaultdict(set)
        for edge, node in self.db.execute("SELECT edge_id, node_id FROM t_junction"):
            self.junctions[edge].add(node)
        self.fac = {}  # of a face: tile and row
        counts = Counter()
        for face in sorted(self.faces):
            key = self.faces[face][:2]
            counts[key] += 1
            self.fac[face] = (key[0], counts[key] + 1)

    def faces_of(self, level, tile):
        """Return the ids of faces."""
        return [face for face in sorted(self.faces) if self.faces[face][:2] == (tile, level)]


class Primitives:
    """Tables of one tile, and what they are rows of."""

    def __init__(self, store, folder, level, tile):
        self.store, self.level, self.tile = store, level, tile
        self.cnd, self.edg = read(folder / "cnd"), read(folder / "edg")
        self.fac, self.rng = read(folder / "fac"), read(folder / "rng")
        self.ebr, self.fbr = rows_of(folder / "ebr"), rows_of(folder / "fbr")
        self.indexes = {name: bins(folder / name) for name in ("csi", "esi", "fsi")}
        self.files = sorted(path.name for path in folder.iterdir())
        self.faces = store.faces_of(level, tile)
        corners = {node for face in self.faces for node in store.faces[face][2:5]}
        edges = {edge for face in self.faces for edge in store.faces[face][5:8]} - set(store.junctions)
        self.nodes = sorted(corners)
        self.edges = sorted(edges, key=lambda edge: (edge <= store.set_aside, edge))
        self.node_row = {node: i for i, node in enumerate(self.nodes, 1)}
        self.edge_row = {edge: i for i, edge in enumerate(self.edges, 1)}
        self.touching = defaultdict(set)
        for edge, *ends in zip(self.edg["id"], self.edg["start_node"], self.edg["end_node"], strict=True):
            for node in ends:
                self.touching[node].add(edge)
        self.stars = {node: self.star(node) for node in self.cnd["id"]}

    def edge(self, row, column):
        """Return a value of an edge."""
        return self.edg[column][row - 1]

    def place(self, row):
        """Return x and y of a node, exact."""
        return tuple(map(Fraction, self.cnd["coordinate"][row - 1][:2]))

    def star(self, row):
        """Return the edges at a node, counter-clockwise from east."""
        x, y = self.place(row)

        def way(edge):
            other = (
                self.edge(edge, "end_node") if self.edge(edge, "start_node") == row else self.edge(edge, "start_node")
            )
            to_x, to_y = self.place(other)
            return to_x - x, to_y - y

        def compare(one, other):
            (ax, ay), (bx, by) = way(one), way(other)
            of_a, of_b = ((vx, vy) < (0, 0) if vy == 0 else vy < 0 for vx, vy in ((ax, ay), (bx, by)))
            cross = ax * by - ay * bx
            assert of_a != of_b or cross != 0, "two edges in one direction"
            return of_a - of_b if of_a != of_b else (-1 if cross > 0 else 1)

        return sorted(self.touching[row], key=cmp_to_key(compare))

    def walk(self, face, start):
        """Return a ring: (edge, is forward), with the face on the right."""
        ring, edge, is_forward = [], start, self.edge(start, "right_face")[0] == face
        while True:
            side = "right" if is_forward else "left"
            assert self.edge(edge, f"{side}_face")[0] == face
            ring.append((edge, is_forward))
            assert len(ring) <= 2 * len(self.edges)
            at = self.edge(edge, "end_node" if is_forward else "start_node")
            edge = self.edge(edge, f"{side}_edge")[0]
            is_forward = self.edge(edge, "start_node") == at
            if edge == start and (edge, is_forward) == ring[0]:
                return ring

    def nodes_round(self, ring):
        """Return the nodes of a ring, the start of each edge as walked."""
        return [self.edge(edge, "start_node" if is_forward else "end_node") for edge, is_forward in ring]

    def area(self, ring):
        """Return the signed area, counter-clockwise positive."""
        nodes = [self.place(node) for node in self.nodes_round(ring)]
        return sum(ax * by - ay * bx for (ax, ay), (bx, by) in zip(nodes, [*nodes[1:], nodes[0]], strict=True)) / 2


def single(numbers):
    """Round to single precision."""
    return struct.unpack(f"<{len(numbers)}f", struct.pack(f"<{len(numbers)}f", *numbers))


@pytest.fixture(scope="module", params=[*STORES, *REAL])
def exported(request, tmp_path_factory):
    """Export a store; return its rows, the library and whether precision is double."""
    folder = tmp_path_factory.mktemp("exported")
    if request.param in REAL:
        name, options = REAL[request.param]
        dem = FIXTURES / "dem" / name
    else:
        heights, options = STORES[request.param]
        dem = write_dem(folder / "a.tif", heights)
    path = vpfx.build(dem, folder / "a.gpkg", **options).path
    is_double = request.param in ("tiles", "T-junctions", "ragged", "prescribed edges")
    export_vpf(path, folder / "vpf", is_double=is_double)
    store = Store(path)
    yield store, folder / "vpf" / "terrain", is_double
    store.db.close()


def tiles_of(exported):
    """Return the primitives of every tile of every level."""
    store, library, _ = exported
    paths = dict(
        enumerate((row[0].split("\\") for row in rows_of(library / "tileref" / "tileref.aft", "tile_name")), 1)
    )
    return {
        (level, tile): Primitives(store, library.joinpath(f"tin{level}", *paths[tile]), level, tile)
        for level in store.levels
        for tile in store.tiles
    }


@pytest.fixture(scope="module")
def tiles(exported):
    return tiles_of(exported)


PRIMITIVES = ["cnd", "cnx", "csi", "ebr", "edg", "edx", "esi", "fac", "fbr", "fsi", "rng"]


def test_nodes(exported, tiles):
    store, _, is_double = exported
    for tile in tiles.values():
        assert tile.files == PRIMITIVES
        places = [store.nodes[node][:3] for node in tile.nodes]
        assert tile.cnd["coordinate"] == (places if is_double else [single(place) for place in places])
        for row in tile.cnd["id"]:
            assert tile.cnd["first_edge"][row - 1][0] == min(tile.stars[row])


def test_edges_are_those_of_the_store(tiles, exported):
    store, *_ = exported
    for tile in tiles.values():
        assert len(tile.edg["id"]) == len(tile.edges)
        for edge, row in tile.edge_row.items():
            _, level, start, end, *_ = store.edges[edge]
            assert level == tile.level
            assert (tile.edge(row, "start_node"), tile.edge(row, "end_node")) == (
                tile.node_row[start],
                tile.node_row[end],
            )
            ends = [tile.cnd["coordinate"][tile.node_row[node] - 1] for node in (start, end)]
            assert tile.edge(row, "coordinates") == ends


def test_links_are_the_next_edges_counter_clockwise(tiles):
    for tile in tiles.values():
        for node in tile.cnd["id"]:
            star = tile.stars[node]
            after = dict(zip(star, [*star[1:], star[0]], strict=True))
            for edge in star:
                side = "left" if tile.edge(edge, "start_node") == node else "right"
                assert tile.edge(edge, f"{side}_edge")[0] == after[edge]


def test_links_agree_with_those_of_the_store(tiles, exported):
    store, *_ = exported
    n_link = 0
    for tile in tiles.values():
        for edge, row in tile.edge_row.items():
            for column, link, node in (("left_edge", 7, 2), ("right_edge", 6, 3)):
                there = store.edges[edge][link]
                internal, ext_tile, ext_id = tile.edge(row, column)
                is_cut = any(store.edges[edge][node] in nodes for nodes in store.junctions.values())
                if there in tile.edge_row or there in store.junctions:
                    assert (ext_tile, ext_id) == (0, 0)
                    assert internal == tile.edge_row.get(there, internal) or is_cut
                    n_link += not is_cut
                else:
                    having = [
                        other for other in tiles.values() if other.level == tile.level and there in other.edge_row
                    ]
                    least = min(having, key=lambda other: other.tile)
                    assert (ext_tile, ext_id) == (least.tile, least.edge_row[there])
    assert n_link


def test_faces_beside_edges(tiles, exported):
    store, *_ = exported
    for tile in tiles.values():
        for edge, row in tile.edge_row.items():
            for column, face in (("left_face", store.edges[edge][5]), ("right_face", store.edges[edge][4])):
                internal, ext_tile, ext_id = tile.edge(row, column)
                of_tile, fac_id = store.fac[face] if face is not None else (tile.tile, None)
                if of_tile != tile.tile:
                    assert (internal, ext_tile, ext_id) == (1, of_tile, fac_id)
                    there = tiles[tile.level, of_tile]
                    back = there.edge_row[edge]
                    own = "right_face" if column == "left_face" else "left_face"
                    assert there.edge(back, column) == (fac_id, 0, 0)
                    assert there.edge(back, own)[1:] == (tile.tile, tile.edge(row, own)[0])
                else:
                    assert (ext_tile, ext_id) == (0, 0)
                    n_given = 1 + len(tile.faces)
                    # beside a shorter edge lies the face whose edge is in pieces
                    is_free = internal == 1 or internal > n_given or bool(store.junctions)
                    assert internal == fac_id if face is not None else is_free


def test_rings(tiles):
    for tile in tiles.values():
        rings = defaultdict(list)
        for face, start in zip(tile.rng["face_id"], tile.rng["start_edge"], strict=True):
            rings[face].append(start)
        assert tile.rng["face_id"] == sorted(tile.rng["face_id"])
        assert tile.fac["id"] == list(rings)
        assert tile.fac["ring_ptr"] == [tile.rng["face_id"].index(face) + 1 for face in tile.fac["id"]]
        assert rings[1][0] is None
        sides, n_inner = Counter(), 0
        for face, (outer, *inner) in rings.items():
            walked = [tile.walk(face, start) for start in (inner if face == 1 else [outer, *inner])]
            if face != 1:
                assert tile.area(walked[0]) < 0
            for ring in walked[0 if face == 1 else 1 :]:
                assert tile.area(ring) > 0
                n_inner += 1
            assert inner == [min(edge for edge, _ in ring) for ring in (walked if face == 1 else walked[1:])]
            assert inner == sorted(inner)
            sides.update((edge, "right" if is_forward else "left") for ring in walked for edge, is_forward in ring)
        assert sides == Counter((edge, side) for edge in tile.edg["id"] for side in ("left", "right"))
        assert len(tile.nodes) - len(tile.edges) + len(tile.fac["id"]) == 1 + n_inner


def test_faces_have_the_corners_of_the_store(tiles, exported):
    store, *_ = exported
    for tile in tiles.values():
        for row, face in enumerate(tile.faces, 2):
            start = tile.rng["start_edge"][tile.fac["ring_ptr"][row - 1] - 1]
            ring = tile.walk(row, start)
            nodes = [tile.nodes[node - 1] for node in tile.nodes_round(ring)]
            first, *corners = store.faces[face][2:5]
            assert nodes[1] == first  # the node between edge_1 and edge_3
            inside = {n for edge in store.faces[face][5:8] for n in store.junctions.get(edge, ())}
            walked = [node for node in nodes[1:] + nodes[:1] if node not in inside]
            assert walked == [first, *reversed(corners)]
            assert set(nodes) == {first, *corners} | inside
            if not inside:
                assert [tile.edges[edge - 1] for edge, _ in ring] == [store.faces[face][i] for i in (5, 7, 6)]


def test_void_faces(tiles):
    for tile in tiles.values():
        n_given = 1 + len(tile.faces)
        starts = [tile.rng["start_edge"][tile.fac["ring_ptr"][row - 1] - 1] for row in tile.fac["id"]]
        assert starts[n_given:] == sorted(starts[n_given:])
        for row, start in zip(tile.fac["id"][n_given:], starts[n_given:], strict=True):
            assert min(edge for edge, _ in tile.walk(row, start)) == start
        ground = sum((-tile.area(tile.walk(row, starts[row - 1])) for row in tile.fac["id"][1:n_given]), Fraction(0))
        rings = [(row, start) for row, start in zip(tile.rng["face_id"], tile.rng["start_edge"], strict=True) if start]
        round_it = [tile.area(tile.walk(row, start)) for row, start in rings if row == 1 or row > n_given]
        assert sum(round_it, Fraction(0)) == ground  # rims less voids


def test_nodes_lead_round_their_tiles(tiles):
    for tile in tiles.values():
        for node, row in tile.node_row.items():
            having = {other.tile for other in tiles.values() if other.level == tile.level and node in other.node_row}
            at, seen = tile, []
            while True:
                edge, ext_tile, ext_id = at.cnd["first_edge"][at.node_row[node] - 1]
                assert edge == min(at.stars[at.node_row[node]])
                seen.append(at.tile)
                if ext_tile == 0:
                    break
                at = tiles[tile.level, ext_tile]
                assert ext_id == min(at.stars[at.node_row[node]])
                if at is tile:
                    break
            assert row
            assert set(seen) == having
            assert len(seen) == len(having)
            assert sum(b < a for a, b in pairwise([*seen, seen[0]])) <= 1


def test_rectangles_and_indexes_hold_their_primitives(tiles, exported):
    store, *_ = exported
    for tile in tiles.values():
        tight = []
        for edge in tile.edg["id"]:
            (ax, ay, _), (bx, by, _) = tile.edge(edge, "coordinates")
            tight.append((min(ax, bx), min(ay, by), max(ax, bx), max(ay, by)))
        assert all(round_box(box) == row for box, row in zip(tight, tile.ebr, strict=True))
        faces = [tile.fbr[0]]
        for row in tile.fac["id"][1:]:
            start = tile.rng["start_edge"][tile.fac["ring_ptr"][row - 1] - 1]
            nodes = [tile.cnd["coordinate"][node - 1] for node in tile.nodes_round(tile.walk(row, start))]
            xs, ys = [x for x, _, _ in nodes], [y for _, y, _ in nodes]
            faces.append((min(xs), min(ys), max(xs), max(ys)))
            assert round_box(faces[-1]) == tile.fbr[row - 1]
        west, south, east, north = zip(*tile.fbr[1:], strict=True) if len(tile.fbr) > 1 else ([n] for n in tile.fbr[0])
        assert tile.fbr[0] == (min(west), min(south), max(east), max(north))
        if len(tile.fbr) == 1:
            assert tile.fbr[0] == round_box(store.tiles[tile.tile][1:])
        points = [(x, y, x, y) for x, y, _ in tile.cnd["coordinate"]]
        for name, boxes in (("csi", points), ("esi", tight), ("fsi", faces)):
            extent, entries = tile.indexes[name]
            assert extent == round_box(store.tiles[tile.tile][1:])
            by_id = {entry[4]: entry[:4] for entry_list in entries.values() for entry in entry_list}
            assert sorted(by_id) == list(range(1, len(boxes) + 1))
            for i, box in enumerate(boxes, 1):
                for axis in range(4):
                    low, high = extent[axis % 2], extent[axis % 2 + 2]
                    step = 255 * (Fraction(box[axis]) - Fraction(low)) / (Fraction(high) - Fraction(low))
                    assert by_id[i][axis] <= step if axis < 2 else by_id[i][axis] >= step


def round_box(box):
    """Return a rectangle in single precision, rounded outwards."""
    found = []
    for axis, number in enumerate(box):
        near = np.float32(number)
        wrong = float(near) > number if axis < 2 else float(near) < number
        found.append(float(np.nextafter(near, np.float32(-np.inf if axis < 2 else np.inf)) if wrong else near))
    return tuple(found)
