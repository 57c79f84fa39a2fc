"""Primitives of a tile as geometries of shapely: points, lines, polygons of faces, places of texts.

z is kept where all heights of a primitive are numbers; else the primitive has x and y only. What is no geometry (an edge of one
place, a place that is no number) is None. Source: specs/vpf.md, V-402, V-414, V-415.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from vpfx.errors import VpfFormatError
from vpfx.vpf.rings import Rings, WingedEdges, find_rings, rings_of
from vpfx.vpf.table import Table
from vpfx.vpf.values import Ragged

__all__ = [
    "Faces",
    "Geometries",
    "edge_lines",
    "face_polygons",
    "find_rows",
    "ids_of",
    "node_points",
    "text_places",
    "winged_edges",
]

Geometries = NDArray[np.object_]
Ids = NDArray[np.int64]


class Faces(NamedTuple):
    """Faces of a tile as polygons.

    Attributes
    ----------
    ids : int64 (n,)
        Ascending. The universe is not among them: it has no outer ring.
    polygons : object (n,)
    mended, lost : int64
        Ids of faces whose rings the links alone do not give, and of those that have none (`vpfx.vpf.rings.FoundRings`).
    """

    ids: Ids
    polygons: Geometries
    mended: Ids
    lost: Ids


def ids_of(table: Table, name: str) -> Ids:
    """Ids in a column of whole numbers or triplets, int64 (n_row,); 0 is none.

    Raises
    ------
    VpfFormatError
        There is no such column, or it is of another type.
    """
    return np.maximum(table.whole_numbers(name), 0)


def winged_edges(table: Table) -> WingedEdges:
    """Links of a table of edges, as indices.

    Raises
    ------
    VpfFormatError
        The edges name no faces: their topology level is below 3.

    Notes
    -----
    Nodes that the table does not name are told by the places where edges end; links that it does not name are none.
    """
    if "right_face" not in table or "left_face" not in table:
        raise VpfFormatError(table.path, "", "found edges without faces, expected right_face and left_face", "V-410")
    n_edge = table.n_row
    none = np.zeros(n_edge, np.int64)
    if "start_node" in table and "end_node" in table:
        start, end = ids_of(table, "start_node") - 1, ids_of(table, "end_node") - 1
    else:
        start, end = _ends(_places(table, "coordinates"))
    links = [
        _rows_of(table, ids_of(table, name)) if name in table else none - 1 for name in ("right_edge", "left_edge")
    ]
    return WingedEdges(start, end, ids_of(table, "right_face") - 1, ids_of(table, "left_face") - 1, links[0], links[1])


def _rows_of(table: Table, ids: Ids) -> Ids:
    """Rows with some ids; -1 where there is none."""
    own = ids_of(table, "id") if "id" in table else np.arange(1, table.n_row + 1)
    if np.array_equal(own, np.arange(1, table.n_row + 1)):
        return np.where(ids <= table.n_row, ids, 0) - 1
    return find_rows(own, ids)


def find_rows(known: Ids, ids: Ids) -> Ids:
    """Index at which each id stands first among known ones; -1 where it does not.

    Examples
    --------
    >>> find_rows(np.array([7, 2, 7]), np.array([2, 7, 3])).tolist()
    [1, 0, -1]
    """
    if len(known) == 0:
        return np.full(len(ids), -1)
    order = np.argsort(known, kind="stable")
    at = order[np.minimum(np.searchsorted(known[order], ids), len(known) - 1)]
    return np.where(known[at] == ids, at, -1)


def _places(table: Table, name: str) -> Ragged:
    """Coordinates of a column, however it stores them."""
    column = table[name]
    if not isinstance(column, Ragged):
        is_place = column.dtype.kind == "f" and column.ndim in (2, 3) and column.shape[-1] in (2, 3)
        if is_place:
            count = column.shape[1] if column.ndim == 3 else 1
            starts = np.arange(table.n_row + 1, dtype=np.int64) * count
            return Ragged(starts, column.reshape(-1, column.shape[-1]))
    elif column.values.ndim == 2:
        return column
    raise VpfFormatError(table.path, f"column {name}", "found another type, expected coordinates", "V-402")


def _ends(places: Ragged) -> tuple[Ids, Ids]:
    """Nodes at the ends of edges, told by their places; -1 of edges without places."""
    has_ends = places.counts > 0
    first, last = places.starts[:-1][has_ends], places.starts[1:][has_ends] - 1
    _, number = np.unique(places.values[np.concatenate([first, last]), :2], axis=0, return_inverse=True)
    start, end = np.full(len(has_ends), -1), np.full(len(has_ends), -1)
    start[has_ends], end[has_ends] = np.split(number.ravel(), 2)
    return start, end


def edge_lines(table: Table) -> Geometries:
    """Lines of the edges of a table, object (n_row,)."""
    return _lines(_places(table, "coordinates"))


def node_points(table: Table) -> Geometries:
    """Points of the nodes of a table, object (n_row,)."""
    places = _places(table, "coordinate" if "coordinate" in table else "coordinates")
    return _points(places, places.counts > 0)


def text_places(table: Table) -> tuple[list[str | None], Geometries]:
    """Texts of a table, and the points or lines along which they are written."""
    places = _places(table, "shape_line")
    found = _lines(places)
    is_point = places.counts == 1
    found[is_point] = _points(places, is_point)[is_point]
    return table.texts("string"), found


def _sound(places: Ragged) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Tell which rows have nothing but numbers for x and y, and which for z."""
    row = np.repeat(np.arange(places.n_row), places.counts)
    is_wrong = ~np.isfinite(places.values)
    wrong = np.bincount(row[is_wrong[:, :2].any(axis=1)], minlength=places.n_row)
    if places.values.shape[1] == 2:
        return wrong == 0, np.zeros(places.n_row, bool)
    wrong_z = np.bincount(row[is_wrong[:, 2]], minlength=places.n_row)
    return wrong == 0, wrong_z == 0


def _points(places: Ragged, wanted: NDArray[np.bool_]) -> Geometries:
    """First place of each row that is wanted, as points."""
    is_sound, has_z = _sound(places)
    found: Geometries = np.full(places.n_row, None, object)
    for rows, width in ((wanted & is_sound & ~has_z, 2), (wanted & is_sound & has_z, 3)):
        found[rows] = shapely.points(places.values[places.starts[:-1][rows], :width].astype(np.float64))
    return found


def _lines(places: Ragged) -> Geometries:
    """Rows of places, as lines."""
    is_sound, has_z = _sound(places)
    is_sound &= places.counts > 1
    found: Geometries = np.full(places.n_row, None, object)
    for rows, width in ((is_sound & ~has_z, 2), (is_sound & has_z, 3)):
        counts = places.counts[rows]
        values = places.values[np.repeat(rows, places.counts), :width].astype(np.float64)
        found[rows] = shapely.linestrings(values, indices=np.repeat(np.arange(len(counts)), counts))
    return found


def face_polygons(table: Table, wanted: Ids | None = None) -> Faces:
    """Faces of a table of edges as polygons.

    Parameters
    ----------
    table : Table
        Edges with faces.
    wanted : int64, optional
        Ids of the faces to make; all if left out.

    Returns
    -------
    Faces
        A face whose edges go round several areas apart is a MultiPolygon.

    Raises
    ------
    VpfFormatError
        Edges have no faces or no places.

    Notes
    -----
    Cost: O(n log n) in the vertices.
    """
    places, edges = _places(table, "coordinates"), winged_edges(table)
    found = find_rings(edges)
    rings = found.rings if wanted is None else rings_of(found.rings, np.asarray(wanted) - 1)
    ring_places, is_whole = _ring_places(places, rings)
    area = _signed_areas(ring_places)
    is_used = is_whole & (area != 0)
    is_outer = area < 0
    ids, ring_face = np.unique(rings.faces, return_inverse=True)
    ring_face = ring_face.ravel()
    n_outer = np.bincount(ring_face[is_used & is_outer], minlength=len(ids))
    is_flat = np.bincount(ring_face[~_sound(ring_places)[1]], minlength=len(ids)) > 0
    polygons: Geometries = np.full(len(ids), None, object)
    for faces, width in (((n_outer > 0) & is_flat, 2), ((n_outer > 0) & ~is_flat, 3)):
        used = is_used & faces[ring_face]
        polygons[faces] = _polygons(ring_places, np.flatnonzero(used), ring_face, is_outer, width)
    has_area = n_outer > 0
    return Faces(ids[has_area] + 1, polygons[has_area], found.mended + 1, found.lost + 1)


def _ring_places(places: Ragged, rings: Rings) -> tuple[Ragged, NDArray[np.bool_]]:
    """Places along rings, each once, and whether they make a ring: all are numbers, and there are three."""
    edge, is_back = rings.sides // 2, rings.sides % 2 == 1
    count = np.maximum(places.counts[edge] - 1, 0)
    first = np.where(is_back, places.starts[edge + 1] - 1, places.starts[edge])
    along = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    at = np.repeat(first, count) + np.where(np.repeat(is_back, count), -along, along)
    ends = np.concatenate([[0], np.cumsum(count)])
    found = Ragged(ends[rings.starts], places.values[at].astype(np.float64))
    return found, _sound(found)[0] & (found.counts > 2)


def _signed_areas(rings: Ragged) -> NDArray[np.float64]:
    """Twice the area of each ring, positive where it runs counter-clockwise; any number where places are none."""
    row = np.repeat(np.arange(rings.n_row), rings.counts)
    follower = np.arange(1, len(row) + 1)
    is_last = follower == rings.starts[1:][row]
    follower[is_last] = rings.starts[row[is_last]]
    own = rings.values[:, :2] - rings.values[rings.starts[row], :2]
    with np.errstate(invalid="ignore", over="ignore"):
        cross = own[:, 0] * own[follower, 1] - own[follower, 0] * own[:, 1]
    return np.bincount(row, cross, rings.n_row).astype(np.float64)


def _polygons(rings: Ragged, used: Ids, ring_face: Ids, is_outer: NDArray[np.bool_], width: int) -> Geometries:
    """Polygons of faces, ascending, from those rings of them that are used."""
    counts = rings.counts[used]
    chosen = np.zeros(rings.n_row, bool)
    chosen[used] = True
    values = rings.values[np.repeat(chosen, rings.counts), :width]
    lines = shapely.linearrings(values, indices=np.repeat(np.arange(len(used)), counts))
    face, outer = ring_face[used], is_outer[used]
    faces, number = np.unique(face, return_inverse=True)
    n_outer = np.bincount(number[outer], minlength=len(faces))
    is_plain = n_outer == 1
    polygons: Geometries = np.full(len(faces), None, object)
    order = np.lexsort([~outer, number])  # of each face, the outer ring first
    several, order = order[~is_plain[number[order]]], order[is_plain[number[order]]]
    polygons[is_plain] = shapely.polygons(lines[order], indices=(np.cumsum(is_plain) - 1)[number[order]])
    if len(several):  # damaged: several areas apart have one id
        together = (np.cumsum(~is_plain) - 1)[number[several]]
        polygons[~is_plain] = shapely.build_area(shapely.multilinestrings(lines[several], indices=together))
    return polygons
