"""Rules V76x: what the standard allows, or does not speak of, and some readers do not take (vpf-facts §12, §15)."""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np

from vpfx.validate.report import NOTE, WARNING, Defects, Rule, one
from vpfx.validate.vpf.folders import TableData, rounded
from vpfx.validate.vpf.names import INDEX_FILE, FolderData
from vpfx.validate.vpf.parts import CoverageData
from vpfx.validate.vpf.tables import ScannedTable
from vpfx.validate.vpf.tile import TileData
from vpfx.validate.vpf.tiling import library_box
from vpfx.vpf.index_file import index_name
from vpfx.vpf.layouts import PRIMITIVES

__all__ = ["RULES"]

MOST_PATH = 255
"""Bytes of a path that OGDI takes."""
MOST_PRIMITIVES = 65_535
"""Rows of a table of primitives whose ids have room in 16 bits."""
MOST_TILES = 32_767
"""Tiles whose ids have room in type S."""
DCW = "dcw"
"""OGDI takes what has this in its path for the Digital Chart of the World, and leaves out the first area feature."""
LINKS = ("right_face", "left_face", "right_edge", "left_edge")
DOUBLE = "BY"


def _heads(data: FolderData) -> list[TableData]:
    """Tables of a folder that can be read."""
    return [table for table in data.folder.tables.values() if table.head is not None]


def _some(data: FolderData, names: list[str], found: str, expected: str) -> Iterator[Defects]:
    """One defect for all files of a folder that are alike."""
    if names:
        shown = names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more"
        yield one(data.place, f"found {shown} {found}, expected {expected}")


def check_order(data: FolderData) -> Iterator[Defects]:
    """Least significant byte first."""
    names = [table.name for table in _heads(data) if table.head is not None and table.head.layout.order == ">"]
    yield from _some(
        data, names, "in big-endian", "little-endian: WorldWind, and OGDI's search by place, read nothing else"
    )


def check_case(data: FolderData) -> Iterator[Defects]:
    """Names in lower case without dots behind them."""
    known = {*data.folder.tables, *data.listed, *data.there}
    paths = [*data.folder.files.items(), *data.folder.folders.items()]
    names = [path.name for name, path in paths if name in known or INDEX_FILE.fullmatch(name)]
    wrong = [name for name in names if name != name.lower() or name.endswith(".")]
    yield from _some(data, wrong, "in capitals or with a dot behind", "lower case: most readers open no other spelling")


def check_companions(data: FolderData) -> Iterator[Defects]:
    """The files beside a table that readers look for are there."""
    files, wanted = data.folder.files, []
    for table in _heads(data):
        if table.head is not None and table.head.layout.is_variable:
            wanted += ["fcz", "fcx"] if table.name == "fcs" else [index_name(table.name)]
    wanted += [box for primitive, box in (("edg", "ebr"), ("fac", "fbr")) if primitive in files]
    missing = [name for name in dict.fromkeys(wanted) if name not in files]
    found = "not there"
    yield from _some(
        data, missing, found, "it beside its table: OpenMap and WorldWind, of rectangles OGDI too, read nothing without"
    )


def check_double(coverage: CoverageData) -> Iterator[Defects]:
    """Coordinates in single precision; the first tile tells."""
    folder = coverage.tile_folder(coverage.tile_ids[0]) if coverage.tile_ids else None
    for name in PRIMITIVES if folder is not None else ():
        table = folder.table(name) if folder is not None else None
        if table is not None and table.head is not None and any(c.kind in DOUBLE for c in table.head.layout.columns):
            message = "found coordinates in double precision, expected single precision, where OpenMap is to draw it"
            yield one(f"table={table.where}", message)
            return


def check_plain_links(data: FolderData) -> Iterator[Defects]:
    """Links of edges are triplets."""
    table = data.folder.table("edg")
    if table is not None and table.head is not None:
        columns = [table.head.layout.find(name) for name in LINKS]
        plain = [column.name for column in columns if column is not None and column.kind != "K"]
        yield from _some(
            data, plain, "of edg without triplets", "type K, also without tiles: TerraGear reads nothing else"
        )


def check_margin(tile: TileData) -> Iterator[Defects]:
    """The extent of a library is greater than what is in it, on all sides."""
    library = tile.coverage.library
    box = None if library is None else library_box(library.extent)
    if box is None:
        return
    xy = tile.all_places
    is_on = (xy == box[:2]).any(axis=1) | (xy == box[2:]).any(axis=1)
    if is_on.any():
        found = f"found {is_on.sum()} of {len(xy)} places on the sides of the extent in lat"
        message = f"{found}, such as {rounded(xy[np.argmax(is_on)])}"
        yield one(f"tile={tile.where}", f"{message}, expected a margin: OGDI leaves out what touches it")


def check_types(data: ScannedTable) -> Iterator[Defects]:
    """Columns are of the types that OGDI counts on, whatever the header says."""
    if data.head is None:
        return
    name = data.table.name
    for column in data.head.layout.columns:
        known = column.name.lower()
        if name == "lat" and known in ("xmin", "ymin", "xmax", "ymax") and column.kind != "F":
            wanted = "F"
        elif known == "tile_id" and data.table.kind[1:] in ("ft", "jt") and column.kind != "S":
            wanted = "S"
        elif known in {f"{primitive}_id" for primitive in PRIMITIVES} and column.kind != "I":
            wanted = "I"
        else:
            continue
        where = f"table={data.where} column={column.name}"
        yield one(
            where, f"found type {column.kind}, expected {wanted}: GDAL reads it as that, and crashes or reads nonsense"
        )


def check_limits(data: FolderData) -> Iterator[Defects]:
    """Paths and numbers of rows have room in what readers keep them in."""
    path = str(data.folder.path)
    if DCW in path.lower():
        yield one(
            data.place,
            f"found {DCW!r} in the path, expected none: OGDI leaves out the first area feature of each class",
        )
    long = [name for name in data.folder.files if len(os.fsencode(os.path.join(path, name))) > MOST_PATH]
    yield from _some(data, long, f"with a path of more than {MOST_PATH} bytes", "shorter ones: OGDI cuts them")
    many = [table.name for table in _heads(data) if table.name in PRIMITIVES and table.n_row > MOST_PRIMITIVES]
    found = f"with more than {MOST_PRIMITIVES} rows"
    yield from _some(data, many, found, "smaller tiles: GeoTools, for one, holds ids in 16 bits")


def check_key_letters(data: FolderData) -> Iterator[Defects]:
    """Keys are P, U or N."""
    names = [
        table.name
        for table in _heads(data)
        if table.head is not None
        and any(column.key.upper() not in ("P", "U", "N") for column in table.head.layout.columns)
    ]
    yield from _some(data, names, "with keys of 1992, such as F", "P, U or N: TerraGear reads no others")


def check_nulls(data: ScannedTable) -> Iterator[Defects]:
    """No value is told in the one way that all readers know."""
    for nulls in data.scan.nulls.defects():
        where, message = nulls.describe(0)
        yield one(where, message if nulls.n_defect == 1 else f"{message}; {nulls.n_defect} values are so")


RULES = (
    Rule("V760", "big_endian", WARNING, "V-101", "a table has its most significant byte first", check_order, "folder"),
    Rule("V761", "name_case", WARNING, "V-201", "a name is not in lower case", check_case, "folder"),
    Rule("V762", "companions", WARNING, "V-130", "a file that readers look for beside a table is not there", check_companions,
         "folder"),
    Rule("V763", "double_coordinates", NOTE, "V-254", "coordinates are in double precision", check_double,
         "coverage"),
    Rule("V764", "library_margin", WARNING, "V-251", "something touches the sides of the extent of its library", check_margin,
         "tile", needs=("table_rows", "edge_places", "library_extent")),
    Rule("V765", "reader_types", WARNING, "V-256", "a column has a type that GDAL does not look at", check_types, "table",
         needs=("table_header",)),
    Rule("V766", "plain_links", NOTE, "V-254", "links of edges are no triplets", check_plain_links, "folder"),
    Rule("V767", "reader_limits", WARNING, "V-201", "a path or a number of rows is greater than readers hold", check_limits,
         "folder"),
    Rule("V768", "key_letters", NOTE, "V-104", "a key is neither P, U nor N", check_key_letters, "folder"),
    Rule("V769", "null_forms", NOTE, "V-112", "no value is told in a way that not all readers know", check_nulls, "table",
         needs=("table_rows",)),
)  # fmt: skip
