"""Rules V777, V778, V781: parents and children, and edges as the store has them."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from vpfx.validate.report import ERROR, Defects, Rule, some
from vpfx.validate.vpf.evpf_tiles import TILE
from vpfx.validate.vpf.hierarchy import BESIDE, EvpfTile, spacing_of

__all__ = ["RULES", "border_lines", "face_shapes"]

Ids = NDArray[np.int64]
Floats = NDArray[np.float64]

SLIVERS = 4.0
"""Spacings of numbers times the perimeter by which areas may differ (R-181)."""
NESTED_AREA, SHARED_AREA = 1e-12, 1e-8
"""Part of an area by which the areas of nested children may differ from it, and those shared with pairs (R-181, R-182)."""


def check_links(tile: EvpfTile) -> Iterator[Defects]:
    """Each face has parents and children, one parent where levels are nested; rows are by child and parent."""
    name, older = "parent.rat", tile.before
    if older is None or name not in tile.level.rows:
        return
    child, parent = tile.column(name, "child_id"), tile.column(name, "parent_id")
    is_wrong = (child < 2) | (child > tile.n_face + 1) | (parent < 2) | (parent > older.n_face + 1)
    is_wrong[1:] |= (child[1:] < child[:-1]) | ((child[1:] == child[:-1]) & (parent[1:] <= parent[:-1]))
    if tile.level.evpf.is_nested:
        is_wrong[1:] |= child[1:] == child[:-1]
    message = "found parent {} of face {}, expected faces that are there, by child and parent, {} of each".format
    count = "one" if tile.level.evpf.is_nested else "each once"
    yield from some(np.flatnonzero(is_wrong), tile.tell(name, lambda i: message(parent[i], child[i], count)))
    if is_wrong.any():
        return
    where = tile.level.place(name)
    for n_face, ids, what, own in ((tile.n_face, child, "parent", tile), (older.n_face, parent, "child", older)):
        lost = np.flatnonzero(np.bincount(ids, minlength=n_face + 2)[2:] == 0) + 2
        place = own.tile.place("fac")
        yield from some(lost, _describe_lost(where, what, place))


def _describe_lost(where: str, what: str, place: str) -> Callable[[int], tuple[str, str]]:
    return lambda i: (where, f"found no {what} of row {i} of {place}, expected one")


def face_shapes(tile: EvpfTile) -> tuple[Floats, Floats, Floats]:
    """Corners of the faces, float64 (n_face, 3, 2), from the first node of the tile; areas and perimeters."""
    places = tile.tile.node_places
    assert places is not None
    corners = places[tile.corners, :2]
    first = corners[:, :1]
    to_b, to_c = (corners[:, 1:] - first).transpose(1, 0, 2)
    area = (to_b[:, 0] * to_c[:, 1] - to_b[:, 1] * to_c[:, 0]) / 2
    sides = corners - np.roll(corners, -1, axis=1)
    return corners, area, np.hypot(sides[..., 0], sides[..., 1]).sum(axis=1)


def check_nesting(tile: EvpfTile) -> Iterator[Defects]:
    """Children tile their parents; where levels are not nested, the areas shared with others are those of the faces."""
    name, older = "parent.rat", tile.before
    rows = tile.rows(name)
    if older is None or rows is None or not (tile.has_three_corners and older.has_three_corners):
        return
    child, parent = tile.column(name, "child_id") - 2, tile.column(name, "parent_id") - 2
    corners, area, perimeter = face_shapes(tile)
    older_corners, older_area, older_perimeter = face_shapes(older)
    ulp = spacing_of(tile.level.evpf)
    if not tile.level.evpf.is_nested:
        shared, limit = rows["area"], SHARED_AREA
        sums = [(tile, child, area, perimeter, shared), (older, parent, older_area, older_perimeter, shared)]
    else:
        limit, sums = NESTED_AREA, [(older, parent, older_area, older_perimeter, area[child])]
        beside = _greatest_distance(corners[child], older_corners[parent])
        wrong = np.flatnonzero(beside > BESIDE * ulp)
        message = "found face {} up to {:.3g} beside its parent {}, expected it inside".format
        yield from some(wrong, tile.tell(name, lambda i: message(child[i] + 2, beside[i], parent[i] + 2)))
        if len(wrong):
            return
    for own, face, expected, around, part in sums:
        found = np.bincount(face, part, minlength=len(expected)).astype(np.float64)
        far = np.flatnonzero(~(np.abs(found - expected) <= limit * expected + SLIVERS * around * ulp))
        where = own.tile.place("fac")
        yield from some(far, _describe_area(where, found, expected))


def _describe_area(where: str, found: Floats, expected: Floats) -> Callable[[int], tuple[str, str]]:
    message = "found {:.12g} as the area of what it is linked to, expected {:.12g}".format
    return lambda i: (f"{where} row={i + 2}", message(found[i], expected[i]))


def _greatest_distance(corners: Floats, around: Floats) -> Floats:
    """How far corners of faces lie outside others, at most, float64 (n,); corners float64 (n, 3, 2), counter-clockwise."""
    side = np.roll(around, -1, axis=1) - around
    to_corner = corners[:, None] - around[:, :, None]  # face, side, corner
    cross = side[:, :, None, 1] * to_corner[..., 0] - side[:, :, None, 0] * to_corner[..., 1]
    greatest: Floats = (cross / np.hypot(side[..., 0], side[..., 1])[:, :, None]).max(axis=(1, 2), initial=0.0)
    return greatest


def border_lines(tile: EvpfTile) -> tuple[Floats, Floats]:
    """X and y of the borders of a tile with others, as coordinates are written; sides of the extent are none."""
    evpf = tile.level.evpf
    tiling = evpf.tiling
    lattice = evpf.lattice
    assert tiling is not None
    assert lattice is not None
    own = tiling.tile(tile.tile_id - 1)
    cols = [line for line in (own.first_col, own.last_col) if 0 < line < lattice.n_col - 1]
    rows = [line for line in (own.first_row, own.last_row) if 0 < line < lattice.n_row - 1]
    x, y = lattice.x0 + lattice.dx * np.array(cols, np.float64), lattice.y0 + lattice.dy * np.array(rows, np.float64)
    return (
        (x, y) if evpf.is_double else (x.astype(np.float32).astype(np.float64), y.astype(np.float32).astype(np.float64))
    )


def check_edges(tile: EvpfTile) -> Iterator[Defects]:
    """Edges are straight; on borders they run east or north, else so that the only, or the lesser, face lies to the left."""
    edges = tile.tile.edges
    if edges is None or edges.faces is None or tile.tile.plane is None:
        return
    starts, xyz = edges.places
    where = tile.tile.place("edg")
    bent = np.flatnonzero(np.diff(starts) != 2)
    yield from some(bent, lambda i: (f"{where} row={i + 1}", f"found {starts[i + 1] - starts[i]} places, expected two"))
    if len(bent):
        return
    start, end = xyz[0::2, :2], xyz[1::2, :2]
    x, y = border_lines(tile)
    is_east = (start[:, 1] == end[:, 1]) & np.isin(start[:, 1], y)
    is_north = (start[:, 0] == end[:, 0]) & np.isin(start[:, 0], x)
    right, left = edges.faces[:, 0, 0], edges.faces[:, 1, 0]
    is_face = [(face > 1) & (face <= tile.n_face + 1) for face in (right, left)]
    is_turned = np.where(is_face[0] & is_face[1], right < left, ~is_face[1]) & ~_is_at_junction(tile)
    is_turned = np.where(is_east, end[:, 0] < start[:, 0], np.where(is_north, end[:, 1] < start[:, 1], is_turned))
    message = "found face {} to the right and {} to the left, expected the edge to run the other way".format
    yield from some(np.flatnonzero(is_turned), lambda i: (f"{where} row={i + 1}", message(right[i], left[i])))


def _is_at_junction(tile: EvpfTile) -> NDArray[np.bool_]:
    """Tell which edges are parts of longer ones: in the store these have no face on one side."""
    plane, graph = tile.tile.plane, tile.tile.graph
    face, node = tile.junctions
    assert plane is not None
    assert graph is not None
    if not len(face):
        return np.zeros(len(graph.nodes), bool)
    most = int(graph.nodes.max(initial=0)) + 1
    known = face * most + node
    found = np.zeros(len(graph.nodes), bool)
    for way in (0, 1):
        own = plane.side_face.reshape(-1, 2)[:, way]
        found |= np.isin(own[:, None] * most + graph.nodes, known).any(axis=1)
    return found


RULES = (
    Rule("V777", "evpf_links", ERROR, "E-420", "a face has no parent or child, or one that is not there", check_links,
         "evpf tile", needs=("evpf_metadata", "evpf_features")),
    Rule("V778", "evpf_nesting", ERROR, "E-420", "children do not tile their parent", check_nesting, "evpf tile",
         needs=(*TILE, "evpf_rings", "evpf_junctions", "evpf_links")),
    Rule("V781", "evpf_edges", ERROR, "E-210", "an edge does not run as in the store", check_edges, "evpf tile",
         needs=(*TILE, "evpf_rings", "evpf_junctions", "evpf_tiles")),
)  # fmt: skip
