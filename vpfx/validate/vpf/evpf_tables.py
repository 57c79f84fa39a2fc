"""Rules V770 to V773, V785: tables of the hierarchy, and what they say of it as a whole."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from vpfx.errors import StoreFormatError
from vpfx.store.contents import decode_metadata
from vpfx.store.tiles import Tiling
from vpfx.validate.report import ERROR, Defects, Rule, Tally, one, some
from vpfx.validate.vpf.evpf_data import MOST_TILES, EvpfData, EvpfTile, LevelTables
from vpfx.validate.vpf.folders import TableData, rectangles
from vpfx.vpf.spatial_index import outward

__all__ = ["RULES", "TABLES", "check_layout", "check_tables"]

TEXT = "TL"
TABLES = {
    "tinface.aft": "slope F aspect F filled S parent I tile_id S fac_id I",
    "tinnode.pft": "z R z_parent R first_level S tile_id S cnd_id I",
    "level.rat": "level S max_error_bound R max_error R rmse R max_rise R post_count T node_count I edge_count I face_count I "
    "one_edge I two_edges I three_edges I centre I centre_edge I",
    "parent.rat": "tile_id S parent_id I child_id I",
    "own.rat": "tile_id S fac_id I class_id I feature_id I share R",
    "tjunct.rat": "tile_id S fac_id I cnd_id I gap R",
    "evpf.rat": "name TL value TL",
    "source.rat": "name TL sha256 TL byte_count TL driver TL",
    "class.rat": "name TL description TL fclass TL store_id I",
    "column.rat": "class_id I name TL vpf_name TL kind TL unit TL description TL",
    "value.rat": "column_id I value TL description TL",
}
"""Columns and types of the tables of specs/evpf.md, chapters 3 and 4, behind `id`."""
OWN_NAMES = ("evpf_version", "precision", "level_count", "tile_size")
KNOWN_VERSION = "1.0"
CUTS = ("one_edge", "two_edges", "three_edges", "centre", "centre_edge")


def _wanted(data: EvpfData, level: LevelTables) -> list[str]:
    """Tables that a coverage must have."""
    names = ["tinface.aft", "fac.fit", "tinnode.pft", "cnd.fit", "level.rat"] + (["parent.rat"] if level.number else [])
    has_classes = "class.rat" in data.levels[0].coverage.folder.files
    if level.number == 0:
        names += ["evpf.rat", "source.rat"] + (["column.rat", "value.rat"] if has_classes else [])
    return names + (["own.rat"] if has_classes else [])


def check_tables(data: EvpfData) -> Iterator[Defects]:
    """All tables of the hierarchy are there, with their columns."""
    for i, name in enumerate(data.names):
        if name != f"tin{i}":
            yield one(f"folder={data.library.folder.place(name)}", f"found no coverage tin{i} before it, expected one")
            return
    for level in data.levels:
        for name in _wanted(data, level):
            if name not in level.coverage.folder.files:
                yield one(f"folder={level.where}", f"found no table {name!r}, expected it")
        for name, columns in TABLES.items():
            table = level.coverage.folder.table(name)
            if table is not None and table.head is not None:
                has_areas = name == "parent.rat" and not data.is_nested
                yield from check_layout(table, f"{columns} area R" if has_areas else columns)


def check_layout(table: TableData, columns: str) -> Iterator[Defects]:
    """A table has some columns, told as names and types in turn."""
    if table.head is None:
        return
    fields = columns.split()
    for name, kinds in zip(fields[::2], fields[1::2], strict=True):
        column = table.head.layout.find(name)
        if column is None:
            yield one(f"table={table.where}", f"found no column {name!r}, expected one")
        elif column.kind not in kinds or (kinds not in ("T", TEXT) and column.count != 1):
            yield one(
                f"table={table.where} column={column.name}", f"found type {column.kind}, expected {' or '.join(kinds)}"
            )


def check_metadata(data: EvpfData) -> Iterator[Defects]:
    """What ``evpf.rat`` says can be read, and is about these coverages."""
    where = f"table={data.levels[0].coverage.folder.place('evpf.rat')}"
    missing = [name for name in OWN_NAMES if name not in data.metadata]
    if missing:
        yield one(where, f"found no row {missing[0]!r}, expected one")
        return
    try:
        decode_metadata({name: text for name, text in data.metadata.items() if name not in OWN_NAMES}, "")
    except StoreFormatError as error:
        yield one(where, str(error))
    if data.metadata["evpf_version"] != KNOWN_VERSION:
        yield one(
            f"{where} name=evpf_version", f"found {data.metadata['evpf_version'][:20]!r}, expected {KNOWN_VERSION!r}"
        )
    if data.metadata["precision"] not in ("single", "double"):
        yield one(
            f"{where} name=precision", f"found {data.metadata['precision'][:20]!r}, expected 'single' or 'double'"
        )
    if data.number("level_count") != len(data.levels):
        found = data.metadata["level_count"][:20]
        yield one(
            f"{where} name=level_count", f"found {found!r}, expected {len(data.levels)}, the coverages tin0, tin1 …"
        )
    if data.lattice is None:
        yield one(f"{where} name=lattice", "found no lattice of posts, expected n_row, n_col, x0, y0, dx, dy")


def check_precision(tile: EvpfTile) -> Iterator[Defects]:
    """Coordinates have the precision that ``evpf.rat`` tells."""
    wanted = "Y" if tile.level.evpf.is_double else "Z"
    for name, column_name in (("cnd", "coordinate"), ("edg", "coordinates")):
        table = tile.tile.table(name)
        column = None if table is None or table.head is None else table.head.layout.find(column_name)
        if table is not None and column is not None and column.kind != wanted:
            said = tile.level.evpf.metadata["precision"]
            message = f"found type {column.kind}, expected {wanted}: precision in evpf.rat is {said}"
            yield one(f"table={table.where} column={column.name}", message)


def check_boxes(tile: EvpfTile) -> Iterator[Defects]:
    """Rectangles are those of edges and faces, rounded outwards; that of the universe is the one round all of them."""
    edges, faces = tile.tile.edge_boxes, tile.tile.face_boxes
    if edges is None or faces is None or len(faces) < 2:
        return
    if (np.abs(edges) > np.finfo(np.float32).max).any():
        yield one(
            tile.tile.place("edg"), "found a place beyond single precision, expected one that rectangles can hold"
        )
        return
    universe = [*faces[1:, :2].min(axis=0), *faces[1:, 2:].max(axis=0)]
    for name, expected in (("ebr", outward(edges)), ("fbr", outward(np.vstack([universe, faces[1:]])))):
        table = tile.tile.table(name)
        found = rectangles(table)
        if table is not None and found is not None and found.shape == expected.shape:
            yield from some(np.flatnonzero((found != expected).any(axis=1)), _describe_box(table, found, expected))


def _describe_box(table: TableData, found: Any, expected: Any) -> Callable[[int], tuple[str, str]]:
    return lambda i: (f"table={table.where} row={i + 1}", f"found {found[i].tolist()}, expected {expected[i].tolist()}")


def check_grid(data: EvpfData) -> Iterator[Defects]:
    """The tiles are those that lattice and tile size make, by number, name and rectangle."""
    lattice, tiling, tileref = data.lattice, data.tiling, data.library.tileref
    table, _ = data.library.tile_table
    if lattice is None or tileref is None or table is None:
        return
    if tiling is None:
        found = data.metadata["tile_size"][:20]
        yield one(
            f"table={data.levels[0].coverage.folder.place('evpf.rat')} name=tile_size",
            f"found {found!r}, expected 8 or more, and no more than {MOST_TILES} tiles",
        )
        return
    where = f"table={table.where}"
    if tiling.n_tile != len(data.library.tile_rows):
        yield one(where, f"found {len(data.library.tile_rows)} rows, expected {tiling.n_tile}: {_grid(tiling)}")
        return
    width = max(2, len(str(max(tiling.n_tile_row, tiling.n_tile_col) - 1)))
    fbr, tally = tileref.folder.table("fbr"), Tally()
    for row in data.library.tile_rows:
        tile = tiling.tile(row.tile_id - 1) if 1 <= row.tile_id <= tiling.n_tile else None
        names = None if tile is None else (f"{tile.row:0{width}}", f"{tile.col:0{width}}")
        if tile is None or row.parts != names or row.face != row.tile_id + 1:
            expected = "" if names is None else f", expected {'/'.join(names)!r} and face {row.tile_id + 1}"
            tally.tell(f"{where} row={row.tile_id}", f"found tile {row.name!r} with face {row.face}{expected}")
    yield from tally.defects()
    if not tally.count and fbr is not None:
        yield from _check_rectangles(fbr, lattice, tiling)


def _grid(tiling: Tiling) -> str:
    return f"{tiling.n_tile_row} by {tiling.n_tile_col} tiles of up to {tiling.tile_size} posts"


def _check_rectangles(fbr: TableData, lattice: Any, tiling: Tiling) -> Iterator[Defects]:
    x, y = lattice.x0 + lattice.dx * tiling.col_lines, lattice.y0 + lattice.dy * tiling.row_lines
    row, col = np.divmod(np.arange(tiling.n_tile), tiling.n_tile_col)
    expected = outward(np.stack([x[col], y[row], x[col + 1], y[row + 1]], axis=1))
    found = rectangles(fbr)
    if found is None or found[1:].shape != expected.shape:
        return
    found = found[1:]
    wrong = np.flatnonzero((found != expected).any(axis=1))
    message = "found {}, expected {}".format
    yield from some(
        wrong, lambda i: (f"table={fbr.where} row={i + 2}", message(found[i].tolist(), expected[i].tolist()))
    )


def check_errors(data: EvpfData) -> Iterator[Defects]:
    """``level.rat`` has one row, of its level; errors keep the bounds, and bounds fall."""
    before = math.inf
    for level in data.levels:
        where, row = level.place("level.rat"), level.summary
        table = level.coverage.folder.table("level.rat")
        if table is None or table.n_row != 1 or not row:
            yield one(where, f"found {0 if table is None else table.n_row} rows, expected one")
            continue
        if row["level"] != level.number:
            yield one(f"{where} column=level", f"found {row['level']}, expected {level.number}")
        bound, error, rmse = row["max_error_bound"], row["max_error"], row["rmse"]
        if not 0 <= rmse <= error < math.inf:
            yield one(f"{where} column=max_error", f"found {error} with rmse {rmse}, expected at least that, and 0")
        if error > bound:
            yield one(f"{where} column=max_error", f"found {error}, expected at most the bound {bound}")
        if bound >= before:
            yield one(
                f"{where} column=max_error_bound",
                f"found {bound}, expected less than {before}, that of the level before",
            )
        before = before if math.isnan(bound) else bound
        negative = [name for name in CUTS if row[name] < 0]
        if negative:
            yield one(f"{where} column={negative[0]}", f"found {row[negative[0]]}, expected 0 or more")


WHOLE = ("table_header", "table_rows", "table_columns", "tables_missing")

RULES = (
    Rule("V770", "evpf_tables", ERROR, "E-400", "a table of the hierarchy is not there, or lacks a column", check_tables,
         "evpf", needs=WHOLE),
    Rule("V771", "evpf_metadata", ERROR, "E-400", "what is said of the whole cannot be read, or is about something else",
         check_metadata, "evpf", needs=("evpf_tables", "key_values")),
    Rule("V772", "evpf_tiles", ERROR, "E-104", "the tiles are not those of the lattice", check_grid, "evpf",
         needs=("evpf_metadata", "tile_rows")),
    Rule("V773", "evpf_precision", ERROR, "E-201", "coordinates are in another precision", check_precision, "evpf tile",
         needs=("evpf_metadata",)),
    Rule("V788", "evpf_boxes", ERROR, "E-230", "a rectangle is not that of its edge or face", check_boxes, "evpf tile",
         needs=("evpf_metadata", "primitive_references", "edge_ends", "edge_places", "edges_cross", "edges_overlap",
                "ring_faces", "face_count", "edge_boxes", "face_boxes")),
    Rule("V785", "evpf_errors", ERROR, "E-410", "a level says what cannot be of its errors", check_errors, "evpf",
         needs=("evpf_tables",)),
)  # fmt: skip
