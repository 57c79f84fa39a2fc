"""Rules V74x: the tiles of a library and its extent, and what lies across borders, as external parts of triplets name it.

::

    tile 1             | tile 2           edge 7 of tile 1 and edge 3 of tile 2 are the same line. Its right face is here the
        face 5   edge 7|edge 3  face 2    universe, there face 2: (1, 2, 2); its left face there is (1, 1, 5)
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.model import Extent
from vpfx.validate.report import ERROR, WARNING, Defects, Rule, one, some
from vpfx.validate.vpf.folders import rounded
from vpfx.validate.vpf.parts import CoverageData, LibraryData
from vpfx.validate.vpf.tile import TileData

__all__ = ["RULES", "BorderEdges", "Borders", "library_box"]

Ids = NDArray[np.int64]

COLUMNS = ("right_face", "left_face", "right_edge", "left_edge", "first_edge")
RIGHT_FACE, LEFT_FACE, RIGHT_EDGE, LEFT_EDGE, FIRST_EDGE = range(5)
TABLES = ("edg", "edg", "edg", "edg", "cnd")


def check_rows(library: LibraryData) -> Iterator[Defects]:
    """Each tile has a path of its own, a face and a rectangle."""
    table, _ = library.tile_table
    tileref = library.tileref
    if table is None or tileref is None:
        return
    n_face, seen = tileref.count("fac", 0), dict[str, int]()
    for i, row in enumerate(library.tile_rows):
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
        elif path and library.tile_boxes is not None and library.tile_box(row.tile_id) is None:
            yield one(where, f"found no rectangle for face {row.face} in fbr, expected one")


def _outside(tile: TileData, box: NDArray[np.float64], what: str) -> Iterator[Defects]:
    xy = tile.all_places
    is_out = (xy < box[:2]).any(axis=1) | (xy > box[2:]).any(axis=1)
    if is_out.any():
        found = f"found {is_out.sum()} of {len(xy)} places outside {what} {rounded(box)}"
        yield one(f"tile={tile.where}", f"{found}, such as {rounded(xy[np.argmax(is_out)])}")


def check_tile_extent(tile: TileData) -> Iterator[Defects]:
    """What is in a tile lies in its rectangle."""
    library = tile.coverage.library
    box = None if library is None or tile.tile_id == 0 else library.tile_box(tile.tile_id)
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


class External(NamedTuple):
    """External parts of triplets, one a row.

    Attributes
    ----------
    tile, row : int64 (n,)
        Where the triplet stands; rows from 1.
    column : int64 (n,)
        Number in `COLUMNS`.
    other_tile, other_row : int64 (n,)
        What the external part names.
    xy : float64 (n, 2)
        The node that a link turns round; NaN of faces.
    """

    tile: Ids
    row: Ids
    column: Ids
    other_tile: Ids
    other_row: Ids
    xy: NDArray[np.float64]


class BorderEdges(NamedTuple):
    """Edges that touch nodes on borders.

    Attributes
    ----------
    tile, row : int64 (n,)
    nodes : int64 (n, 2)
        Start and end, rows of ``cnd``.
    is_border : bool (n, 2)
        Whether they are nodes on borders.
    ends : float64 (n, 4)
        Places of start and end.
    faces : int64 (n, 2, 3)
        Right and left face.
    """

    tile: Ids
    row: Ids
    nodes: Ids
    is_border: NDArray[np.bool_]
    ends: NDArray[np.float64]
    faces: Ids


class Borders:
    """What the tiles of a coverage say about each other, gathered tile by tile."""

    def __init__(self, coverage: CoverageData) -> None:
        self.coverage = coverage
        self._external: list[External] = []
        self._edges: list[BorderEdges] = []

    def add(self, tile: TileData, known: NDArray[np.bool_] | None = None) -> None:
        """Add what a tile says, nothing if its edges are broken; `known` tells which nodes lie on borders."""
        graph, edges = tile.graph, tile.edges
        if graph is None or edges is None or edges.links is None or tile.node_places is None:
            return
        xy, ends = tile.node_places[:, :2], tile.node_places[:, :2][graph.nodes]
        none = np.full((len(graph.nodes), 2), np.nan)
        parts = []
        if edges.faces is not None:
            parts += [(RIGHT_FACE, edges.faces[:, 0], none), (LEFT_FACE, edges.faces[:, 1], none)]
        parts += [(RIGHT_EDGE, edges.links[:, 0], ends[:, 1]), (LEFT_EDGE, edges.links[:, 1], ends[:, 0])]
        first = tile.triplets("cnd", "first_edge")
        if first is not None:
            parts.append((FIRST_EDGE, first, xy))
        on_border = np.zeros(len(xy), bool) if known is None else known.copy()
        for column, triplet, at in parts:
            row = np.flatnonzero(triplet[:, 1:].any(axis=1))
            same = np.full(len(row), tile.tile_id), row + 1, np.full(len(row), column)
            self._external.append(External(*same, triplet[row, 1], triplet[row, 2], at[row]))
            if column == FIRST_EDGE:
                on_border[row] = True
            elif column in (RIGHT_EDGE, LEFT_EDGE):
                on_border[graph.nodes[row, 1 if column == RIGHT_EDGE else 0]] = True
            else:
                on_border[graph.nodes[row].ravel()] = True
        row = np.flatnonzero(on_border[graph.nodes].any(axis=1))
        faces = np.zeros((len(row), 2, 3), np.int64) if edges.faces is None else edges.faces[row]
        own = np.full(len(row), tile.tile_id)
        nodes = graph.nodes[row]
        self._edges.append(BorderEdges(own, row + 1, nodes + 1, on_border[nodes], ends[row].reshape(-1, 4), faces))

    @cached_property
    def external(self) -> External:
        """All external parts."""
        return (
            External(*(np.concatenate(parts) for parts in zip(*self._external, strict=True)))
            if self._external
            else (External(*(np.empty(0, np.int64),) * 5, np.empty((0, 2))))
        )

    @cached_property
    def edges(self) -> BorderEdges:
        """All edges at borders, by tile and row."""
        if not self._edges:
            none = np.empty((0, 2), np.int64)
            return BorderEdges(none[:, 0], none[:, 0], none, none > 0, np.empty((0, 4)), np.empty((0, 2, 3), np.int64))
        return BorderEdges(*(np.concatenate(parts) for parts in zip(*self._edges, strict=True)))

    def place(self, tile: int, table: str) -> str:
        """What findings call a table of a tile."""
        folder = self.coverage.tile_folder(tile)
        return f"table={table}" if folder is None else f"table={folder.place(table)}"

    def locate(self, tile: int, row: int, column: int) -> str:
        """Place of an external part."""
        return f"{self.place(tile, TABLES[column])} column={COLUMNS[column]} row={row}"

    def locate_one(self, external: External, i: int) -> str:
        """Place of one of some external parts."""
        return self.locate(int(external.tile[i]), int(external.row[i]), int(external.column[i]))


def _find(edges: BorderEdges, tile: Ids, row: Ids) -> Ids:
    """Index of edges of tiles among those at borders; -1 of those that touch none."""
    most = int(max(edges.row.max(initial=0), row.max(initial=0))) + 1
    keys, wanted = edges.tile * most + edges.row, tile * most + row
    order = np.argsort(keys, kind="stable")
    if not len(keys):
        return np.full(len(wanted), -1)
    at = order[np.minimum(np.searchsorted(keys[order], wanted), len(keys) - 1)]
    return np.where(keys[at] == wanted, at, -1)


def check_range(borders: Borders) -> Iterator[Defects]:
    """External parts name rows that exist, in another tile."""
    external, coverage = borders.external, borders.coverage
    target = external.other_tile * 2 + (external.column > LEFT_FACE)
    different, inverse = np.unique(target, return_inverse=True)
    tiles = set(coverage.tile_ids) - {0}
    counts = [
        coverage.count("edg" if key % 2 else "fac", key // 2) if key // 2 in tiles else None
        for key in different.tolist()
    ]
    count = np.array([-1 if known is None else known for known in counts], np.int64)[inverse]
    is_wrong = (external.other_row < 1) | (external.other_row > count) | (external.other_tile == external.tile)

    def describe(i: int) -> tuple[str, str]:
        found = f"found row {external.other_row[i]} of tile {external.other_tile[i]}"
        if external.other_tile[i] == external.tile[i]:
            return borders.locate_one(external, i), f"{found} named, which is this tile, expected another one"
        there = f"one of its {count[i]} rows" if count[i] >= 0 else "a tile that is there"
        return borders.locate_one(external, i), f"{found} named, expected {there}"

    yield from some(np.flatnonzero(is_wrong), describe)


def check_back(borders: Borders) -> Iterator[Defects]:
    """Where a face lies in another tile, the same line there has it on that side, and this tile's face on the other."""
    external, edges = borders.external, borders.edges
    ask = np.flatnonzero(external.column <= LEFT_FACE)
    own = _find(edges, external.tile[ask], external.row[ask])
    ask, own = ask[own >= 0], own[own >= 0]
    side, here = external.column[ask], edges.faces[own, external.column[ask] ^ 1, 0]
    asked = np.column_stack(
        [external.other_tile[ask], edges.ends[own], side, external.other_row[ask], external.tile[ask], here]
    )
    known = np.concatenate([_sides(edges, way) for way in (0, 1)])
    is_found = np.zeros(len(ask), bool)
    for ends, turned in (((1, 2, 3, 4), 0), ((3, 4, 1, 2), 1)):  # the line runs the same way there, or the other
        wanted = asked[:, (0, *ends, 5, 6, 7, 8)]
        wanted[:, 5] = side ^ turned
        is_found |= _has_rows(known, wanted) | ((here == 1) & _has_rows(known[:, :7], wanted[:, :7]))

    def describe(i: int) -> tuple[str, str]:
        where, other = borders.locate_one(external, int(ask[i])), external.other_tile[ask[i]]
        message = f"found face {external.other_row[ask[i]]} of tile {other} named, expected the same line there with it"
        return where, f"{message}, and this tile's face on its other side"

    yield from some(np.flatnonzero(~is_found), describe)


def _sides(edges: BorderEdges, way: int) -> NDArray[np.float64]:
    """One side of each edge, float64 (n, 9): tile, ends, 0 right or 1 left, its face; tile and face named on the other."""
    side = np.full(len(edges.tile), way)
    return np.column_stack([edges.tile, edges.ends, side, edges.faces[:, way, 0], edges.faces[:, way ^ 1, 1:]])


def _has_rows(known: NDArray[np.float64], asked: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell which rows are among known ones."""
    _, key = np.unique(np.concatenate([known, asked]), axis=0, return_inverse=True)
    return np.isin(key.ravel()[len(known) :], key.ravel()[: len(known)])


def check_place(borders: Borders) -> Iterator[Defects]:
    """An edge of another tile that a link or a node names touches the place of that node."""
    external, edges = borders.external, borders.edges
    ask = np.flatnonzero(external.column >= RIGHT_EDGE)
    at = _find(edges, external.other_tile[ask], external.other_row[ask])
    xy = external.xy[ask]
    ends = edges.ends[at].reshape(-1, 2, 2) if len(edges.ends) else np.full((len(ask), 2, 2), np.nan)
    is_wrong = (at < 0) | ~(ends == xy[:, None]).all(axis=2).any(axis=1)

    def describe(i: int) -> tuple[str, str]:
        found = f"found edge {external.other_row[ask[i]]} of tile {external.other_tile[ask[i]]} named"
        message = f"{found}, expected one that touches {rounded(xy[i])}"
        return borders.locate_one(external, int(ask[i])), message

    yield from some(np.flatnonzero(is_wrong), describe)


SOUND = ("table_header", "table_rows", "primitive_references", "edge_ends", "edge_places")

RULES = (
    Rule("V740", "tile_rows", ERROR, "V-206", "a tile has no path, face or rectangle of its own", check_rows, "library",
         needs=("table_header", "table_rows", "table_columns")),
    Rule("V741", "tile_rectangle", ERROR, "V-508", "a place lies outside the rectangle of its tile", check_tile_extent, "tile",
         needs=("table_rows", "edge_places", "tile_rows")),
    Rule("V742", "external_range", ERROR, "V-507", "a triplet names what another tile does not have", check_range, "borders",
         needs=SOUND),
    Rule("V743", "external_faces", ERROR, "V-507", "faces on the two sides of a border do not name each other", check_back,
         "borders", needs=(*SOUND, "external_range")),
    Rule("V744", "external_edges", ERROR, "V-507", "an edge named across a border does not touch the node", check_place,
         "borders", needs=(*SOUND, "external_range")),
    Rule("V745", "library_extent", WARNING, "V-508", "a place lies outside the extent of its library", check_library_extent,
         "tile", needs=("table_rows", "edge_places")),
)  # fmt: skip
