"""Rules V740, V741, V745: the tiles of a library and its extent, and what lies in them."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vpfx.model import Extent
from vpfx.validate.report import ERROR, WARNING, Defects, Rule, one
from vpfx.validate.vpf.folders import rectangles
from vpfx.validate.vpf.parts import LibraryData
from vpfx.validate.vpf.tile import TileData

__all__ = ["RULES", "LibraryTiles", "all_places", "library_box"]


class LibraryTiles:
    """The tiles of a library, with their rectangles."""

    def __init__(self, library: LibraryData) -> None:
        self.library = library

    @cached_property
    def boxes(self) -> NDArray[np.float64] | None:
        """Rectangles of ``tileref/fbr``, float64 (n_face, 4); None if they cannot be read."""
        tileref = self.library.tileref
        boxes = None if tileref is None else rectangles(tileref.folder.table("fbr"))
        return None if boxes is None else boxes.astype(np.float64)

    def box(self, tile_id: int) -> NDArray[np.float64] | None:
        """Rectangle of a tile; None if it has none."""
        row = self.library.tiles.get(tile_id)
        if row is None or self.boxes is None or not 2 <= row.face <= len(self.boxes):
            return None
        box: NDArray[np.float64] = self.boxes[row.face - 1]
        return box if np.isfinite(box).all() else None


def check_rows(data: LibraryTiles) -> Iterator[Defects]:
    """Each tile has a path of its own, a face and a rectangle."""
    table, _ = data.library.tile_table
    tileref = data.library.tileref
    if table is None or tileref is None:
        return
    n_face, seen = tileref.count("fac", 0), dict[str, int]()
    for i, row in enumerate(data.library.tile_rows):
        where = f"table={table.where} row={i + 1}"
        path = "/".join(row.parts).lower()
        if row.problem:
            yield one(where, row.problem)
        elif path and path in seen:
            yield one(where, f"found the path of row {seen[path]} again, expected one of its own")
        if path:
            seen.setdefault(path, i + 1)
        if n_face is not None and not 2 <= row.face <= n_face:
            yield one(where, f"found face {row.face} of fac named, expected one of 2 … {n_face}")
        elif path and data.boxes is not None and data.box(row.tile_id) is None:
            yield one(where, f"found no rectangle for face {row.face} in fbr, expected one")


def all_places(tile: TileData) -> NDArray[np.float64]:
    """Places of all nodes and edges of a tile, float64 (n, 2)."""
    parts = [part[:, :2] for part in (tile.node_places, tile.entity_places) if part is not None]
    if tile.edges is not None:
        parts.append(tile.edges.places.xyz[:, :2])
    xy = np.concatenate(parts) if parts else np.zeros((0, 2))
    return xy[np.isfinite(xy).all(axis=1)]


def _outside(tile: TileData, box: NDArray[np.float64], what: str) -> Iterator[Defects]:
    xy = all_places(tile)
    is_out = (xy < box[:2]).any(axis=1) | (xy > box[2:]).any(axis=1)
    if is_out.any():
        x, y = xy[np.argmax(is_out)].tolist()
        shown = ", ".join(f"{number:.9g}" for number in box)
        message = f"found {is_out.sum()} of {len(xy)} places outside {what} ({shown}), such as ({x:.9g}, {y:.9g})"
        yield one(f"tile={tile.where}", message)


def check_tile_extent(tile: TileData) -> Iterator[Defects]:
    """What is in a tile lies in its rectangle."""
    library = tile.coverage.library
    box = None if library is None or tile.tile_id == 0 else LibraryTiles(library).box(tile.tile_id)
    if box is not None:
        yield from _outside(tile, box, "the rectangle of the tile")


def library_box(extent: Extent | None) -> NDArray[np.float64] | None:
    """Rectangle of a library; None if it is not known. Across the date line it has no east and west."""
    if extent is None or not np.isfinite(extent).all():
        return None
    box = np.array(extent)
    if box[0] > box[2]:
        box[0], box[2] = -np.inf, np.inf
    return box


def check_library_extent(tile: TileData) -> Iterator[Defects]:
    """What is in a library lies in the rectangle that ``lat`` has for it."""
    library = tile.coverage.library
    box = None if library is None else library_box(library.extent)
    if box is not None:
        yield from _outside(tile, box, "the extent of the library in lat")


RULES = (
    Rule("V740", "tile_rows", ERROR, "V-206", "a tile has no path, face or rectangle of its own", check_rows, "library",
         needs=("table_header", "table_rows", "table_columns")),
    Rule("V741", "tile_rectangle", ERROR, "V-508", "a place lies outside the rectangle of its tile", check_tile_extent, "tile",
         needs=("table_rows", "edge_places", "tile_rows")),
    Rule("V745", "library_extent", WARNING, "V-508", "a place lies outside the extent of its library", check_library_extent,
         "tile", needs=("table_rows", "edge_places")),
)  # fmt: skip
