"""Tables of the database and of the library: dht, lat, lht, grt, cat, dqt (specs/evpf.md E-102, E-103)."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from pyproj import CRS

from vpfx.dem.reference import unit_metres
from vpfx.evpf.folder import Folder
from vpfx.model import Extent
from vpfx.store.reader import StoreReader
from vpfx.vpf import layouts
from vpfx.vpf.spatial_index import outward

__all__ = ["Library", "map_scale", "reference_row", "write_database", "write_library"]

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


def _row(layout: Any, **values: Any) -> dict[str, list[Any]]:
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
