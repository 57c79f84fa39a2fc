"""A made-up VPF database of one library with two tiles and two classes, written table by table."""

from __future__ import annotations

from vpfx.vpf import layouts
from vpfx.vpf.table import write_table

FORWARD = [
    ("roadl", "roadl.lft", "edg_id", "edg", "id"),
    ("roadl", "edg", "id", "roadl.lft", "edg_id"),
]
JOINED = [
    ("lakea", "lakea.aft", "id", "lakea.ajt", "lakea_id"),
    ("lakea", "lakea.ajt", "lakea_id", "lakea.aft", "id"),
    ("lakea", "lakea.ajt", "fac_id", "fac", "id"),
    ("lakea", "fac", "id", "lakea.ajt", "fac_id"),
]


def put(path, layout, rows):
    """Write a table whose ids count from 1."""
    path.parent.mkdir(parents=True, exist_ok=True)
    names = [column.name for column in layout.columns if column.name != "id"]
    columns = {name: [row[i] for row in rows] for i, name in enumerate(names)}
    write_table(path, layout, {"id": list(range(1, len(rows) + 1)), **columns})


def put_lat(root, names=("north",), layout=layouts.LAT):
    put(root / "lat", layout, [(name, 7.0, 46.0, 9.0, 48.0) for name in names])


def put_cat(library, names=("tileref", "road"), layout=layouts.CAT):
    put(library / "cat", layout, [(name, "About roads", 3) for name in names])


def put_tiles(library, names=(r"07\01", r"07\02"), layout=layouts.TILEREF):
    folder = library / "tileref"
    rows = [(name, i + 2)[: len(layout.columns) - 1] for i, name in enumerate(names)]
    put(folder / "tileref.aft", layout, rows)
    put(folder / "fcs", layouts.FCS, [("tileref", "tileref.aft", "fac_id", "fac", "id")])
    put(folder / "fbr", layouts.FBR, [(7 + i, 46 + i, 8 + i, 47 + i) for i in range(len(names) + 1)])


def make_database(root):
    """Write the database into a directory that is not there yet; return it."""
    put_lat(root)
    library = root / "north"
    put_cat(library)
    put_tiles(library)
    put(library / "road" / "fcs", layouts.FCS, [*FORWARD, *JOINED])
    put(library / "road" / "fca", layouts.fca(), [("roadl", "L", "Roads"), ("lakea", "A", "Lakes")])
    road = layouts.feature("Roads", [], "edg", is_tiled=True)
    put(library / "road" / "roadl.lft", road, [(1, 5)])
    for tile in ("01", "02"):
        put(library / "road" / "07" / tile / "fac", layouts.FAC, [(1,)])
    return root
