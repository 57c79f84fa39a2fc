"""A VPF database of a `vpf_maps.Map`: areas, lines, points, nodes and texts of one coverage, tiled or not."""

from __future__ import annotations

from vpf_bytes import ID, NULL_INT, Style, col, write

__all__ = ["NAMES", "expected_lines", "write_database"]

NAMES = ("Ålborg", "Łódź?", "", "N/A", "Ab; c, d")  # the second is cut to Latin-1
CODES = ("BA010", "BH000", "N/A", "ZZ999")
KINDS = (1, 2, NULL_INT, NULL_INT + 1, 7)
DATE = "19991105123000.00000"
PLAIN = Style()
EXTENT = (9.0, 49.0, 99.0, 99.0)


def write_database(root, ground, style=PLAIN):
    """Write database `root`, library `lib`, coverages `land` and, if there are tiles, `tileref`."""
    is_tiled = ground.tile > 0
    write(root, style, "dht", [ID, col("database_name", "T", 8)], [(1, root.name[:8])])
    box = [col(name, "F") for name in ("xmin", "ymin", "xmax", "ymax")]
    write(root, style, "lat", [ID, col("library_name", "T", 8), *box], [(1, "lib", *EXTENT), (2, "gone", *EXTENT)])
    library = root / style.named("lib.").rstrip(".")
    write(library, style, "lht", [ID, col("library_name", "T", 12), col("scale", "I")], [(1, "lib", 50000)])
    texts = [
        col("data_type", "T", 3),
        col("units", "T", 3),
        col("geo_datum_name", "T", 15),
        col("geo_datum_code", "T", 3),
    ]
    write(library, style, "grt", [ID, *texts], [(1, "GEO", "M", "WGS 84", "WGE")])
    coverages = [("land", "Land", 3), ("absent", "Not here", 3)] + [("tileref", "Tiles", 3)] * is_tiled
    columns = [ID, col("coverage_name", "T", 8), col("description", "T", 50), col("level", "I")]
    write(library, style, "cat", columns, [(i, *row) for i, row in enumerate(coverages, 1)])
    land = library / style.named("land.").rstrip(".")
    _write_schema(land, style, is_tiled)
    _write_features(land, style, ground)
    for tile in ground.tiles:
        parts = style.named(tile.name.replace("\\", "/") + "/.").rstrip("/.").split("/") if is_tiled else []
        _write_primitives(land.joinpath(*parts), style, ground, tile)
    if is_tiled:
        _write_tiles(library / style.named("tileref.").rstrip("."), style, ground)
    return root


def _write_schema(land, style, is_tiled):
    """Write `fcs`, `fca` and the value tables."""
    keys = ("foreign_key", "primary_key") if style.is_old else ("table1_key", "table2_key")
    columns = [ID, col("feature_class", "T", 8), col("table1", "T", 12), col(keys[0], "T", 16), col("table2", "T", 12)]
    rows = []
    for name, table, join, primitive in (
        ("area", "area.aft", "area.ajt", "fac"), ("line", "line.lft", "line.ljt", "edg"),
        ("point", "point.pft", "", "end"), ("node", "node.pft", "", "cnd"), ("text", "text.tft", "", "txt"),
    ):  # fmt: skip
        if join:
            steps = [(table, "id", join, f"{name}_id"), (join, f"{primitive}_id", primitive, "id")]
        else:
            steps = [(table, f"{primitive}_id", primitive, "id")]
        for a, a_key, b, b_key in steps:
            rows += [(name, a, a_key, b, b_key), (name, b, b_key, a, a_key)]
    write(land, style, "fcs", [*columns, col(keys[1], "T", 16)], [(i, *row) for i, row in enumerate(rows, 1)])
    about = "description" if style.is_old else "descr"
    classes = [("area", "A", "Areas"), ("line", "L", "Lines"), ("point", "P", "Points"), ("text", "T", "Texts")]
    columns = [ID, col("fclass", "T", 8), col("type", "T", 1), col(about, "T", "*")]
    write(land, style, "fca", columns, [(i, *row) for i, row in enumerate(classes, 1)])
    described = [ID, col("table", "T", 12), col("attribute", "T", 16)]
    rows = [(1, "area.aft", "kind", 1, "One"), (2, "AREA.AFT", "KIND", 2, "Two"), (3, "area.aft", "other", 7, "No")]
    write(land, style, "int.vdt", [*described, col("value", "I"), col("description", "T", 50)], rows)
    rows = [(1, "area.aft", "f_code", "BA010", "Coastline"), (2, "area.aft", "f_code", "BH000", "Inland Water")]
    write(land, style, "char.vdt", [*described, col("value", "T", 5), col("description", "T", "*")], rows)


def _write_features(land, style, ground):
    """Write the feature tables and the joins."""
    tiled = [col("tile_id", style.tile_kind)] if ground.tile else []

    def refer(tile, primitive):
        return (tile, primitive) if ground.tile else (primitive,)

    areas = sorted({own for cell, own in ground.areas.items() if ground.labels[cell]})
    columns = [
        ID, col("f_code", "T", 5, "char.vdt"), col("kind", "I", 1, "int.vdt"), col("name", "T", "*"), col("height", "F"),
        col("deep", "R"), col("few", "S"), col("seen", "D"), col("nothing", "X"),
    ]  # fmt: skip
    rows = [
        (i, CODES[i % 4], KINDS[i % 5], NAMES[i % 5].encode("latin-1", "replace").decode("latin-1"),
         float("nan") if i % 3 == 0 else i / 2, i / 7, -32768 if i % 2 else i, DATE if i % 2 else " " * 20, None)
        for i in range(1, len(areas) + 1)
    ]  # fmt: skip
    write(land, style, "area.aft", columns, rows)
    joins = []
    for number, tile in enumerate(ground.tiles, 1):
        for own, face in sorted(
            {(ground.areas[cell], face) for cell, face in tile.face_at.items() if cell in ground.areas}
        ):
            if own in areas:
                joins.append((areas.index(own) + 1, *refer(number, face)))
    _write_joins(land, style, "area", [*tiled, col("fac_id", "I")], joins)
    lines, joins = expected_lines(ground)
    write(land, style, "line.lft", [ID, col("length", "F")], [(i, line.length) for i, line in enumerate(lines, 1)])
    _write_joins(land, style, "line", [*tiled, col("edg_id", "I")], [(own, *refer(*rest)) for own, *rest in joins])
    rows = [(number, i) for number, tile in enumerate(ground.tiles, 1) for i in range(1, len(tile.face_at) + 1)]
    rows = [(i, f"p{i}", *refer(*row)) for i, row in enumerate(rows, 1)]
    write(land, style, "point.pft", [ID, col("label", "T", 8), *tiled, col("end_id", "I")], rows)
    rows = [(number, i) for number, tile in enumerate(ground.tiles, 1) for i in range(1, len(tile.nodes) + 1)]
    rows = [(i, *refer(*row)) for i, row in enumerate(rows, 1)]
    write(land, style, "node.pft", [ID, *tiled, col("cnd_id", "I")], rows)
    rows = [(i, *refer(number, 1)) for i, number in enumerate(range(1, len(ground.tiles) + 1), 1)]
    write(land, style, "text.tft", [ID, *tiled, col("txt_id", "I")], rows)


def _write_joins(land, style, name, columns, rows):
    write(
        land,
        style,
        f"{name}.{name[0]}jt",
        [ID, col(f"{name}_id", "I"), *columns],
        [(i, *r) for i, r in enumerate(rows, 1)],
    )


def expected_lines(ground):
    """Edges of the map as a whole, as lines; and rows (line, tile, edge) of the edges of tiles along them, in disorder."""
    import shapely

    lines, joins = [], []
    for edge in ground.whole.edges:
        lines.append(shapely.LineString(edge.places))
        left = set(edge.key)
        for number, tile in enumerate(ground.tiles, 1):
            for i, part in enumerate(tile.edges, 1):
                if part.key <= left:
                    left -= part.key
                    joins.append((len(lines), number, i))
        assert not left
    return lines, joins[::2] + joins[1::2]


def _places(style, places):
    """Places as the coordinates have them; a height is a hundred more than x."""
    if style.coordinate in "CB":
        return places
    return [(x, y, 100.0 + x if style.has_heights else float("nan")) for x, y in places]


def _write_primitives(folder, style, ground, tile):
    """Write the primitives of one tile."""
    link, kind = style.link, style.coordinate
    links = [col(name, link) for name in ("right_face", "left_face", "right_edge", "left_edge")]
    columns = [ID, col("start_node", "I"), col("end_node", "I"), *links, col("coordinates", kind, "*")]
    rows = [
        (i, e.start_node, e.end_node, *((x, 9, 9) if link == "K" and x == 1 else x for x in (e.right_face, e.left_face)),
         e.right_edge, e.left_edge, _places(style, e.places))
        for i, e in enumerate(tile.edges, 1)
    ]  # fmt: skip
    write(folder, style, "edg", columns, rows)
    columns = [ID, col("containing_face", "X"), col("first_edge", link), col("coordinate", kind)]
    first = [
        min(i for i, e in enumerate(tile.edges, 1) if n in (e.start_node, e.end_node))
        for n in range(1, len(tile.nodes) + 1)
    ]
    rows = [(i, None, first[i - 1], _places(style, [place])) for i, place in enumerate(tile.nodes, 1)]
    write(folder, style, "cnd", columns, rows)
    centres = [(ground.square(cell).centroid.coords[0], face) for cell, face in sorted(tile.face_at.items())]
    columns = [ID, col("containing_face", "I"), col("first_edge", "X"), col("coordinate", kind)]
    rows = [(i, face, None, _places(style, [place])) for i, (place, face) in enumerate(centres, 1)]
    write(folder, style, "end", columns, rows)
    place = tile.nodes[0] if tile.nodes else (10.0, 50.0)
    columns = [ID, col("string", "T", "*"), col("shape_line", kind, "*")]
    write(folder, style, "txt", columns, [(1, f"Ort {tile.name}", _places(style, [place]))])
    if style.has_rings:
        rings = [(1, 1, NULL_INT)] + [(i, ring[0], ring[2]) for i, ring in enumerate(tile.rings, 2)]
        write(folder, style, "rng", [ID, col("face_id", "I"), col("start_edge", "I")], rings)
        pointers = {face: number for number, face, _ in reversed(rings)}
        write(folder, style, "fac", [ID, col("ring_ptr", "I")], [(f, pointers[f]) for f in range(1, tile.n_face + 1)])


def _write_tiles(folder, style, ground):
    """Write the tile reference coverage."""
    keys = ("foreign_key", "primary_key") if style.is_old else ("table1_key", "table2_key")
    columns = [ID, col("feature_class", "T", 8), col("table1", "T", 12), col(keys[0], "T", 16), col("table2", "T", 12)]
    rows = [(1, "tileref", "tileref.aft", "fac_id", "fac", "id"), (2, "tileref", "fac", "id", "tileref.aft", "fac_id")]
    write(folder, style, "fcs", [*columns, col(keys[1], "T", 16)], rows)
    rows = [(i, tile.name.upper() if style.is_upper else tile.name, i + 1) for i, tile in enumerate(ground.tiles, 1)]
    write(folder, style, "tileref.aft", [ID, col("tile_name", "T", "*"), col("fac_id", "I")], rows)
    box = [col(name, "F") for name in ("xmin", "ymin", "xmax", "ymax")]
    rows = [(1, *EXTENT)] + [(i, *_bounds(ground, tile)) for i, tile in enumerate(ground.tiles, 2)]
    write(folder, style, "fbr", [ID, *box], rows)
    write(folder, style, "fac", [ID, col("ring_ptr", "I")], [(i, i) for i in range(1, len(rows) + 1)])


def _bounds(ground, tile):
    places = [place for edge in tile.edges for place in edge.places] or [(9.0, 49.0)]
    xs, ys = zip(*places, strict=True)
    return min(xs), min(ys), max(xs), max(ys)
