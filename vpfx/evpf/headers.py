"""What a directory has beside the levels: tables of database and library, libref and tileref (specs/evpf.md E-102 to E-104)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS

from vpfx.dem.reference import unit_metres
from vpfx.errors import InputError
from vpfx.evpf.folder import Folder
from vpfx.evpf.planar import Planar, Sides, planar_graph
from vpfx.evpf.precision import rounded
from vpfx.evpf.primitives import Primitives, straight, write_primitives
from vpfx.model import Extent
from vpfx.store.reader import StoreReader
from vpfx.store.tiles import Tiling
from vpfx.vpf import layouts
from vpfx.vpf.spatial_index import outward
from vpfx.vpf.table import Layout, Ragged

__all__ = [
    "Library",
    "map_scale",
    "reference_row",
    "tile_paths",
    "write_database",
    "write_library",
    "write_libref",
    "write_tileref",
]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

VERSION = "MILSTD2407"
ORIGINATOR = "vpfx"
MARGIN = 0.01
"""Of its greater side, by which the extent is widened: readers drop what touches its sides."""

MM_ON_PAPER = 0.5
"""What a post spacing is at the scale of the library."""

MOST_SCALE = 1e10
"""Greater ones become the greatest that the table holds."""

DATUMS = {
    "world geodetic system 1984": ("WGS 84", "WGE"),
    "world geodetic system 1972": ("WGS 72", "WGC"),
    "north american datum 1983": ("NAD83", "NAR"),
    "north american datum 1927": ("NAD27", "NAS"),
    "european datum 1950": ("ED50", "EUR"),
}
"""Names and codes of geodetic datums (DIGEST part 3), by their names in the EPSG registry."""
OTHER_DATUM = "ZY"

LEAST_DIGITS = 2  # of row and column in the path of a tile


class Library(NamedTuple):
    """How a library is called.

    Attributes
    ----------
    database, name : str
        Their directories.
    product : str
        `product_type` of `lht`.
    """

    database: str
    name: str
    product: str


def _row(layout: Layout, **values: Any) -> dict[str, list[Any]]:
    """One row of a table, null but for the values given."""
    return {column.name: [values.get(column.name, 1 if column.name == "id" else None)] for column in layout.columns}


def write_database(database: Folder, library: Library, extent: Extent) -> None:
    """Write `dht` and `lat`."""
    dht = _row(
        layouts.DHT, vpf_version=VERSION, database_name=database.named(library.database),
        database_desc="Hierarchical TIN", originator=ORIGINATOR, num_data_sets="1", security_class="U",
    )  # fmt: skip
    database.write("dht", layouts.DHT, dht)
    margin = MARGIN * max(extent.max_x - extent.min_x, extent.max_y - extent.min_y)
    wide = outward(np.array(extent) + np.array([-margin, -margin, margin, margin]))
    sides = dict(zip(("xmin", "ymin", "xmax", "ymax"), wide.tolist(), strict=True))
    database.write("lat", layouts.LAT, _row(layouts.LAT, library_name=database.named(library.name), **sides))


def write_library(folder: Folder, library: Library, store: StoreReader) -> None:
    """Write `lht`, `grt`, `cat` and `dqt`."""
    name = folder.named(library.name)
    lht = _row(
        layouts.LHT, product_type=library.product, library_name=name, description="Hierarchical TIN, a coverage a level",
        data_struct_code="8", scale=map_scale(store), security_class="U",
    )  # fmt: skip
    folder.write("lht", layouts.LHT, lht)
    folder.write("grt", layouts.GRT, _row(layouts.GRT, **reference_row(store)))
    folder.write("cat", layouts.CAT, _coverages(folder, store))
    finest = store.levels[-1]
    bound = finest.max_error if finest.max_error_bound is None else finest.max_error_bound
    accuracy = f"No post of the elevation model is off by more than {bound!r} m from the finest level"
    dqt = _row(
        layouts.DQT, vpf_level="LIBRARY", vpf_level_name=name, spec_name=VERSION, abs_vert_acc=accuracy,
        abs_vert_units="metres", comments="Error bounds of all levels stand in level.rat of each coverage",
    )  # fmt: skip
    folder.write("dqt", layouts.DQT, dqt)


def _coverages(folder: Folder, store: StoreReader) -> dict[str, list[Any]]:
    """Rows of `cat`."""
    rows = [("libref", "Library reference"), ("tileref", "Tile reference")]
    for line in store.levels:
        bound = "" if line.max_error_bound is None else f", error bound {line.max_error_bound:g} m"
        rows.append((f"tin{line.level}", f"TIN of level {line.level}{bound}"[:50]))
    names, descriptions = zip(*rows, strict=True)
    return {
        "id": list(range(1, len(rows) + 1)), "coverage_name": [folder.named(name) for name in names],
        "description": list(descriptions), "level": [3] * len(rows),
    }  # fmt: skip


def map_scale(store: StoreReader) -> int:
    """Denominator of the scale at which the greater post spacing is half a millimetre, to two digits."""
    lattice = store.metadata["lattice"]
    width, height = unit_metres(store.crs, store.extent)
    exact = min(max(lattice["dx"] * width, lattice["dy"] * height) * 1000 / MM_ON_PAPER, MOST_SCALE)
    step = 10 ** max(math.floor(math.log10(exact)) - 1, 0)
    return int(min(max(round(exact / step) * step, 1), 2**31 - 1))


def reference_row(store: StoreReader) -> dict[str, Any]:
    """Columns of `grt` for the CRS of a store; null where it does not say.

    Examples
    --------
    ``reference_row(store)["geo_datum_code"]``
    """
    vertical = str(store.metadata["vertical_datum"])
    known = {"vert_datum_name": vertical[:15], "vert_datum_code": OTHER_DATUM}
    row: dict[str, Any] = {"units": "M", **({} if vertical == "unknown" or not vertical.isascii() else known)}
    if not store.crs:
        return {"data_type": "TAB", **row}
    crs = CRS.from_wkt(store.crs)
    row["data_type"] = "GEO" if crs.is_geographic else "MAP"
    if crs.ellipsoid is not None:
        axes = crs.ellipsoid.semi_major_metre, crs.ellipsoid.semi_minor_metre
        row["ellipsoid_name"] = _ascii(crs.ellipsoid.name, 15)
        row["ellipsoid_detail"] = "A={:.1f} B={:.1f} Meters".format(*axes)
    if crs.datum is not None:
        plain = crs.datum.name.lower().replace("_", " ").removesuffix(" ensemble")
        row["geo_datum_name"], row["geo_datum_code"] = DATUMS.get(plain, (_ascii(crs.datum.name, 15), OTHER_DATUM))
    if not crs.is_geographic:
        name = crs.name if crs.coordinate_operation is None else crs.coordinate_operation.name
        row["projection_name"] = _ascii(name, 20)
    return row


def _ascii(text: str, most: int) -> str | None:
    """A text as its first ASCII characters; None if there are none."""
    return text.encode("ascii", "ignore").decode()[:most].strip() or None


def tile_paths(tiling: Tiling) -> list[tuple[str, str]]:
    """Directories of tiles: row and column in digits, from the south-west.

    Examples
    --------
    >>> tile_paths(Tiling(17, 21, 10, 1))
    [('00', '00'), ('00', '01'), ('01', '00'), ('01', '01')]
    """
    n_digit = max(LEAST_DIGITS, len(str(max(tiling.n_tile_row, tiling.n_tile_col) - 1)))
    return [
        (f"{row:0{n_digit}}", f"{col:0{n_digit}}")
        for row in range(tiling.n_tile_row)
        for col in range(tiling.n_tile_col)
    ]


def write_libref(coverage: Folder, extent: Extent, *, is_double: bool) -> None:
    """Write the outline of the extent: one closed edge, its inside to the left, and a line feature on it."""
    min_x, min_y, max_x, max_y = extent
    corners = np.array([[min_x, min_y], [max_x, min_y], [max_x, max_y], [min_x, max_y], [min_x, min_y]])
    places = corners if is_double else rounded(corners)
    rings = Planar(np.array([1, 0]), np.array([0, 0]), np.array([0, 0, 1]), np.array([-1, 0, 0]), 1, 0)
    tables = Primitives(
        "B" if is_double else "C", places[:1], np.zeros((1, 2), np.int64), Ragged(np.array([0, 5]), places),
        _inner([0]), _inner([[1, 0]]), _inner([[0, 0]]), rings, _boxes([extent, extent], is_double),
    )  # fmt: skip
    write_primitives(coverage, tables, extent, is_tiled=False)
    layout = layouts.feature("Library Reference Line Feature Table", (), "edg", is_tiled=False)
    coverage.write("libref.lft", layout, {"id": [1], "edg_id": [1]})
    _write_schema(coverage, "libref", "libref.lft", "edg")


def write_tileref(coverage: Folder, tiling: Tiling, extents: Floats, *, is_double: bool) -> None:
    """Write the tiles as faces, and an area feature on each.

    Parameters
    ----------
    coverage : Folder
    tiling : Tiling
    extents : float64 (n_tile, 4)
        Min x, min y, max x, max y of each tile.
    is_double : bool

    Raises
    ------
    InputError
        Corners of tiles come to lie in one place in single precision.
    """
    n_row, n_col = tiling.n_tile_row, tiling.n_tile_col
    xs = np.append(extents[:n_col, 0], extents[n_col - 1, 2])
    ys = np.append(extents[::n_col, 1], extents[-1, 3])
    corners = np.stack(np.meshgrid(xs, ys), axis=2).reshape(-1, 2)
    places = corners if is_double else rounded(corners)
    if not is_double and ((np.diff(rounded(xs)) <= 0).any() or (np.diff(rounded(ys)) <= 0).any()):
        raise InputError("single precision: found corners of tiles that come to lie in one place; give --double")
    edge_nodes, sides = _tile_edges(n_row, n_col)
    planar = planar_graph(places, edge_nodes, sides)
    boxes = _boxes(np.concatenate([[[xs[0], ys[0], xs[-1], ys[-1]]], extents]), is_double)
    first_edge = np.full(len(places), len(edge_nodes), np.int64)
    np.minimum.at(first_edge, edge_nodes.ravel(), np.repeat(np.arange(len(edge_nodes)), 2))
    tables = Primitives(
        "B" if is_double else "C", places, edge_nodes, straight(places, edge_nodes), _inner(first_edge),
        _inner(planar.way_face.reshape(-1, 2)), _inner(planar.way_next.reshape(-1, 2)), planar, boxes,
    )  # fmt: skip
    write_primitives(coverage, tables, boxes[0].tolist(), is_tiled=False)
    ids = np.arange(1, tiling.n_tile + 1)
    names = ["\\".join(path) for path in tile_paths(tiling)]
    coverage.write("tileref.aft", layouts.TILEREF, {"id": ids, "tile_name": names, "fac_id": ids + 1})
    _write_schema(coverage, "tileref", "tileref.aft", "fac")


def _boxes(extents: ArrayLike, is_double: bool) -> Floats:
    """Rectangles that hold extents, and their corners as written."""
    return np.asarray(extents if is_double else outward(extents), np.float64)


def _tile_edges(n_row: int, n_col: int) -> tuple[Ints, Sides]:
    """Edges between corners, those that run east first, and the sides of the tiles; both by row, then column."""
    corner = np.arange((n_row + 1) * (n_col + 1)).reshape(n_row + 1, n_col + 1)
    east = np.stack([corner[:, :-1], corner[:, 1:]], axis=2).reshape(-1, 2)
    north = np.stack([corner[:-1], corner[1:]], axis=2).reshape(-1, 2)
    of_east = np.arange(len(east)).reshape(n_row + 1, n_col)
    of_north = len(east) + np.arange(len(north)).reshape(n_row, n_col + 1)
    start = np.stack([corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]], axis=2)
    edge = np.stack([of_east[:-1], of_north[:, 1:], of_east[1:], of_north[:, :-1]], axis=2)
    return np.concatenate([east, north]), Sides(start.ravel(), edge.ravel(), np.arange(0, start.size + 1, 4))


def _inner(index: Sequence[object] | Ints) -> Ints:
    """Triplets without external parts, of indices."""
    row = np.asarray(index, np.int64)[..., None] + 1
    return np.concatenate([row, np.zeros_like(row), np.zeros_like(row)], axis=-1)


def _write_schema(coverage: Folder, name: str, table: str, primitive: str) -> None:
    """Write the relations of the only feature class, forwards and backwards."""
    one, other = coverage.named(table), coverage.named(primitive)
    key = f"{primitive}_id"
    relations = {
        "id": [1, 2], "feature_class": [coverage.named(name)] * 2, "table1": [one, other], "table1_key": [key, "id"],
        "table2": [other, one], "table2_key": ["id", key],
    }  # fmt: skip
    coverage.write("fcs", layouts.FCS, relations)
