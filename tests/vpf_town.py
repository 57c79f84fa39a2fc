"""A whole VPF database that breaks no rule, written with `struct` alone: areas with an island, lines, points, texts, two tiles.

::

    +-----------+-----------+     tile 1 | tile 2: squares of labels, jittered; the square of label 2 is an island in the
    | 1   1   1 | 1   3   3 |     area of label 1 and so an inner ring of its face
    | 1  (2)  1 | 1   3   3 |
    | 1   1   1 | 3   3   3 |
    +-----------+-----------+
"""

from __future__ import annotations

import math
import struct

from vpf_bytes import ID, NULL_INT, Style, col, write
from vpf_maps import Map

__all__ = ["write_town"]

LABELS = [[1, 1, 1, 1, 3, 3], [1, 2, 1, 1, 3, 3], [1, 1, 1, 3, 3, 3]]
STYLE = Style()
BOX = [col(name, "F") for name in ("xmin", "ymin", "xmax", "ymax")]
OUTSIDE = (9.0, 49.0, 17.0, 54.0)
CODES = ("BA010", "BH000")
TILE_BOXES = ((10.0, 50.0, 13.0, 53.0), (13.0, 50.0, 16.0, 53.0))


def put(folder, name, columns, rows):
    """Write a table whose ids count from 1."""
    write(folder, STYLE, name, [ID, *columns], [(i, *row) for i, row in enumerate(rows, 1)])


def box_of(places):
    xs, ys = zip(*places, strict=True)
    return min(xs), min(ys), max(xs), max(ys)


def spatial_index(boxes, extent):
    """A spatial index with one bin."""
    data = struct.pack("<i4fi2i", len(boxes), *extent, 1, 0, len(boxes))
    for i, (x0, y0, x1, y1) in enumerate(boxes, 1):
        steps = [
            255 * (value - extent[k % 2]) / (extent[k % 2 + 2] - extent[k % 2])
            for k, value in enumerate((x0, y0, x1, y1))
        ]
        low, high = map(math.floor, steps[:2]), map(math.ceil, steps[2:])
        data += struct.pack("<4Bi", *(min(255, max(0, step)) for step in (*low, *high)), i)
    return data


def thematic_index(values, table, column, kind, count):
    """A thematic index with lists of rows, ids of type S."""
    rows = {value: [i for i, other in enumerate(values, 1) if other == value] for value in sorted(set(values))}
    form = f"<{count}sii" if kind == "T" else {"I": "<iii", "S": "<hii"}[kind]
    first = 60 + len(rows) * struct.calcsize(form)
    directory, lists = b"", b""
    for value, own in rows.items():
        raw = value.encode() if kind == "T" else value
        directory += struct.pack(
            form, raw, own[0] if len(own) == 1 else first + len(lists), 0 if len(own) == 1 else len(own)
        )
        lists += struct.pack(f"<{len(own)}h", *own) if len(own) > 1 else b""
    names = table.encode().ljust(12), column.encode().ljust(25)
    head = struct.pack(
        "<iiiccic12s25sc3x", first, len(rows), len(values), b"I", kind.encode(), count, b"S", *names, b"S"
    )
    return head + directory + lists


def write_town(root):
    """Write the database; return its path."""
    ground = Map(LABELS, seed=0, tile=3, n_spur=1)
    put(root, "dht", [col("database_name", "T", 8)], [(root.name[:8],)])
    put(root, "lat", [col("library_name", "T", 8), *BOX], [("lib", *OUTSIDE)])
    library = root / "lib"
    put(
        library,
        "lht",
        [col("library_name", "T", 12), col("product_type", "T", 12), col("scale", "I")],
        [("lib", "TOWN", 5000)],
    )
    texts = [
        col("data_type", "T", 3),
        col("units", "T", 3),
        col("ellipsoid_detail", "T", 50),
        col("geo_datum_code", "T", 3),
    ]
    put(library, "grt", texts, [("GEO", "M", "A=6378137.0 B=6356752.3 Meters", "WGE")])
    coverages = [("tileref", "Tiles", 3), ("land", "Land", 3)]
    put(library, "cat", [col("coverage_name", "T", 8), col("description", "T", 50), col("level", "I")], coverages)
    _write_tiles(library / "tileref")
    land = library / "land"
    for tile, box in zip(ground.tiles, TILE_BOXES, strict=True):
        _write_primitives(land.joinpath(*tile.name.split("\\")), ground, tile, box)
    _write_schema(land)
    _write_features(land, ground)
    return root


def _write_fcs(folder, rows):
    keys = [("feature_class", 8), ("table1", 12), ("table1_key", 16), ("table2", 12), ("table2_key", 16)]
    put(folder, "fcs", [col(name, "T", width) for name, width in keys], rows)


def _write_tiles(folder):
    """Two tiles: edge 1 between them, 2 round the western, 3 round the eastern one, clockwise."""
    _write_fcs(
        folder, [("tileref", "tileref.aft", "fac_id", "fac", "id"), ("tileref", "fac", "id", "tileref.aft", "fac_id")]
    )
    put(folder, "tileref.aft", [col("tile_name", "T", "*"), col("fac_id", "I")], [(r"00\00", 2), (r"00\01", 3)])
    south, north = (13.0, 50.0), (13.0, 53.0)
    edges = [
        (1, 2, 3, 2, 3, 2, [south, north]),
        (1, 2, 2, 1, 1, 3, [south, (10.0, 50.0), (10.0, 53.0), north]),
        (2, 1, 3, 1, 1, 2, [north, (16.0, 53.0), (16.0, 50.0), south]),
    ]
    _write_graph(
        folder, edges, [south, north], [(1, 2), (2, 1), (3, 1)], [(10.0, 50.0, 16.0, 53.0), *TILE_BOXES], OUTSIDE
    )


def _write_graph(folder, edges, nodes, rings, face_boxes, extent):
    """Write nodes, edges, faces, rings, rectangles and spatial indexes."""
    links = [col(name, "K") for name in ("right_face", "left_face", "right_edge", "left_edge")]
    put(folder, "edg", [col("start_node", "I"), col("end_node", "I"), *links, col("coordinates", "C", "*")], edges)
    first = [min(i for i, edge in enumerate(edges, 1) if n in edge[:2]) for n in range(1, len(nodes) + 1)]
    rows = [(edge, [place]) for edge, place in zip(first, nodes, strict=True)]
    put(folder, "cnd", [col("first_edge", "K"), col("coordinate", "C")], rows)
    rows = [(1, NULL_INT), *rings]
    put(folder, "rng", [col("face_id", "I"), col("start_edge", "I")], rows)
    pointers = [next(i for i, row in enumerate(rows, 1) if row[0] == face) for face in range(1, len(face_boxes) + 1)]
    put(folder, "fac", [col("ring_ptr", "I")], [(pointer,) for pointer in pointers])
    boxes = [box_of(edge[-1]) for edge in edges]
    put(folder, "ebr", BOX, boxes)
    put(folder, "fbr", BOX, face_boxes)
    for name, of in (("csi", [box_of([place]) for place in nodes]), ("esi", boxes), ("fsi", face_boxes)):
        (folder / name).write_bytes(spatial_index(of, extent))


def _write_primitives(folder, ground, tile, extent):
    edges = [
        (e.start_node, e.end_node, e.right_face, e.left_face, e.right_edge, e.left_edge, e.places) for e in tile.edges
    ]
    rings = [(face, start) for face, _, start, _ in tile.rings]
    boxes = [box_of([place for e in edges if face in e[2:4] for place in e[-1]]) for face in range(2, tile.n_face + 1)]
    _write_graph(folder, edges, tile.nodes, rings, [extent, *boxes], extent)
    points = _points(ground, tile)
    rows = [(face, None, [place]) for place, face in points]
    put(folder, "end", [col("containing_face", "I"), col("first_edge", "X"), col("coordinate", "C")], rows)
    (folder / "nsi").write_bytes(spatial_index([box_of([place]) for place, _ in points], extent))
    text = [(f"Tile {tile.name[-1]}", [points[0][0], points[1][0]])]
    put(folder, "txt", [col("string", "T", "*"), col("shape_line", "C", "*")], text)
    (folder / "tsi").write_bytes(spatial_index([box_of(text[0][1])], extent))


def _points(ground, tile):
    """Places inside squares, single precision, and the faces they lie in."""
    centres = [(ground.square(cell).centroid, face) for cell, face in sorted(tile.face_at.items())]
    return [(struct.unpack("<2f", struct.pack("<2f", c.x, c.y)), face) for c, face in centres]


def _write_schema(land):
    rows = [
        ("area", "area.aft", "id", "area.ajt", "area_id"), ("area", "area.ajt", "area_id", "area.aft", "id"),
        ("area", "area.ajt", "fac_id", "fac", "id"), ("area", "fac", "id", "area.ajt", "fac_id"),
    ]  # fmt: skip
    for name, table, primitive in (
        ("line", "line.lft", "edg"),
        ("point", "point.pft", "end"),
        ("text", "text.tft", "txt"),
    ):
        key = f"{primitive}_id"
        rows += [(name, table, key, primitive, "id"), (name, primitive, "id", table, key)]
    _write_fcs(land, rows)
    classes = [("area", "A", "Areas"), ("line", "L", "Lines"), ("point", "P", "Points"), ("text", "T", "Texts")]
    put(land, "fca", [col("fclass", "T", 8), col("type", "T", 1), col("descr", "T", 10)], classes)
    described = [col("table", "T", 12), col("attribute", "T", 16)]
    values = [("area.aft", "kind", 1, "One"), ("area.aft", "kind", 2, "Two")]
    put(land, "int.vdt", [*described, col("value", "I"), col("description", "T", 50)], values)
    values = [("point.pft", "f_code", "BA010", "Coast"), ("point.pft", "f_code", "BH000", "Water")]
    put(land, "char.vdt", [*described, col("value", "T", 5), col("description", "T", "*")], values)


def _write_features(land, ground):
    labels = {}
    for number, tile in enumerate(ground.tiles, 1):
        for cell, face in tile.face_at.items():
            labels.setdefault(int(ground.labels[cell]), set()).add((number, face))
    areas = [(1 + i % 2, f"Area {i}", "19991105123000.00000") for i in range(len(labels))]
    put(land, "area.aft", [col("kind", "I", 1, "int.vdt"), col("name", "T", "*"), col("seen", "D")], areas)
    tile_id = col("tile_id", "S")
    joins = [(i, number, face) for i, own in enumerate(labels.values(), 1) for number, face in sorted(own)]
    put(land, "area.ajt", [col("area_id", "I"), tile_id, col("fac_id", "I")], joins)
    lines = [(number, i) for number, tile in enumerate(ground.tiles, 1) for i in range(1, len(tile.edges) + 1)]
    put(land, "line.lft", [tile_id, col("edg_id", "I")], lines)
    points = [
        (number, i) for number, tile in enumerate(ground.tiles, 1) for i in range(1, len(_points(ground, tile)) + 1)
    ]
    codes = [CODES[i % 3 == 0] for i in range(len(points))]
    rows = [(code, *point) for code, point in zip(codes, points, strict=True)]
    put(land, "point.pft", [col("f_code", "T", 5, "char.vdt"), tile_id, col("end_id", "I")], rows)
    put(land, "text.tft", [tile_id, col("txt_id", "I")], [(1, 1), (2, 1)])
    (land / "f_code.pti").write_bytes(thematic_index(codes, "point.pft", "f_code", "T", 5))
    (land / "tile.lti").write_bytes(thematic_index([tile for tile, _ in lines], "line.lft", "tile_id", "S", 1))
    fit = [col("prim_id", "I"), tile_id, col("fc_id", "I"), col("feature_id", "I")]
    put(land, "fac.fit", fit, [(face, number, 1, own) for own, number, face in joins])
    put(land, "edg.fit", fit, [(edge, number, 2, i) for i, (number, edge) in enumerate(lines, 1)])
    put(land, "end.fit", fit, [(point, number, 3, i) for i, (number, point) in enumerate(points, 1)])
