"""Rules V73x: edges that meet at nodes only (topology level 2), and faces that tile the plane (level 3)."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from vpfx.validate.report import ERROR, WARNING, Defects, Rule, some
from vpfx.validate.vpf.folders import rounded
from vpfx.validate.vpf.strips import CROSS, OVERLAP, is_inside
from vpfx.validate.vpf.tile import Ids, Plane, TileData

__all__ = ["FACES", "RULES"]


def check_crossings(tile: TileData) -> Iterator[Defects]:
    """Edges meet at nodes only."""
    yield from _clashes(tile, CROSS, "expected them to meet at nodes only")


def check_overlaps(tile: TileData) -> Iterator[Defects]:
    """No two edges run along each other."""
    yield from _clashes(tile, OVERLAP, "where they run along each other, expected one of them")


def _clashes(tile: TileData, kind: int, expected: str) -> Iterator[Defects]:
    if tile.level < 2 or tile.segments is None:
        return
    pairs, count = tile.clashes
    segments, shown = tile.segments[0], pairs[pairs[:, 2] == kind]

    def describe(i: int) -> tuple[str, str]:
        own, other = segments.edge[shown[i, 0]] + 1, segments.edge[shown[i, 1]] + 1
        ends = segments.ends[shown[i, 0]].tolist()
        near = f"near {rounded([(ends[0] + ends[2]) / 2, (ends[1] + ends[3]) / 2])}"
        return f"{tile.place('edg')} row={own}", f"found edges {own} and {other} {near}, {expected}"

    if count[kind]:
        yield Defects(int(count[kind]), describe)


def check_places(tile: TileData) -> Iterator[Defects]:
    """No two connected nodes lie in one place."""
    xyz = tile.node_places
    if xyz is None or tile.level < 2:
        return
    order = np.lexsort(xyz[:, 1::-1].T)
    same = np.flatnonzero((xyz[order[1:], :2] == xyz[order[:-1], :2]).all(axis=1))

    def describe(i: int) -> tuple[str, str]:
        pair = np.sort(order[i : i + 2]) + 1
        return (
            f"{tile.place('cnd')} row={pair[1]}",
            f"found it in the place of node {pair[0]}, expected one node a place",
        )

    yield from some(same, describe)


def check_ring_faces(tile: TileData) -> Iterator[Defects]:
    """All sides of a ring have the same face."""
    plane = tile.plane
    if plane is None:
        return
    expected = plane.side_face[plane.ring_side[plane.ring]]
    wrong = np.flatnonzero(plane.side_face != expected)

    def describe(i: int) -> tuple[str, str]:
        column = "left_face" if i % 2 else "right_face"
        first = plane.ring_side[plane.ring[i]] // 2 + 1
        message = f"found face {plane.side_face[i] + 1}, expected {expected[i] + 1} as on edge {first} of the same ring"
        return f"{tile.place('edg')} column={column} row={i // 2 + 1}", message

    yield from some(wrong, describe)


def check_face_count(tile: TileData) -> Iterator[Defects]:
    """V − E + F = 1 + C."""
    plane, n_face = tile.plane, tile.n_face
    if plane is None or n_face is None:
        return
    n_part, n_edge = len(plane.inner_side), len(plane.ring) // 2
    expected = 1 + n_part - len(plane.node_part) + n_edge
    if n_face != expected:
        parts = f"{len(plane.node_part)} nodes and {n_edge} edges in {n_part} parts"
        message = f"found {n_face} faces, expected {expected} with {parts}, the universe included"
        yield Defects(1, lambda _: (tile.place("fac"), message))


def _sides_of_rows(tile: TileData, plane: Plane) -> tuple[Ids, Ids, Ids]:
    """Face of each row of ``rng``, its start edge, both indices, and the side of the edge with the face; -1 for none."""
    face, edge = tile.column("rng", "face_id"), tile.column("rng", "start_edge")
    if face is None or edge is None:
        none = np.empty(0, np.int64)
        return none, none, none
    face, edge = face - 1, edge - 1
    side = np.full(len(face), -1, np.int64)
    for way in (1, 0):
        row = np.flatnonzero((edge >= 0) & (2 * edge < len(plane.side_face)))
        row = row[plane.side_face[2 * edge[row] + way] == face[row]]
        side[row] = 2 * edge[row] + way
    return face, edge, side


def check_ring_rows(tile: TileData) -> Iterator[Defects]:
    """Rows of ``rng`` begin with an edge of their face, name a ring once, and lie together behind ``ring_ptr``."""
    plane, pointer = tile.plane, tile.column("fac", "ring_ptr")
    if plane is None or pointer is None or tile.column("rng", "start_edge") is None:
        return
    face, edge, side = _sides_of_rows(tile, plane)
    where = tile.place("rng")
    row = np.arange(len(face))
    is_first = np.ones(len(face), bool)
    is_first[1:] = face[1:] != face[:-1]
    is_universe = (edge < 0) & (face == 0) & is_first

    def describe_start(i: int) -> tuple[str, str]:
        found = f"edge {edge[i] + 1}" if edge[i] >= 0 else "no edge"
        return f"{where} column=start_edge row={i + 1}", f"found {found}, expected one of face {face[i] + 1}"

    yield from some(np.flatnonzero((side < 0) & ~is_universe), describe_start)
    known = row[side >= 0]
    ring = plane.ring[side[known]]
    again = np.flatnonzero(_first_of(ring, plane.n_ring) != np.arange(len(ring)))
    yield from some(
        known[again], lambda i: (f"{where} row={i + 1}", "found the ring of an earlier row, expected each once")
    )
    blocks = row[is_first]
    split = blocks[_first_of(face[blocks], len(pointer)) != np.arange(len(blocks))]
    message = "found rings of other faces between, expected all rings of a face together"
    yield from some(split, lambda i: (f"{where} column=face_id row={i + 1}", message))
    expected = np.full(len(pointer), -1, np.int64)
    expected[face[blocks][::-1]] = blocks[::-1]
    yield from some(np.flatnonzero(pointer - 1 != expected), _describe_pointer(tile, pointer, expected))


def _first_of(numbers: Ids, n: int) -> Ids:
    """Index at which each of some numbers below n stands first among them."""
    first = np.full(n, -1, np.int64)
    first[numbers[::-1]] = np.arange(len(numbers))[::-1]
    return first[numbers]


def _describe_pointer(tile: TileData, pointer: Ids, expected: Ids) -> Callable[[int], tuple[str, str]]:
    def describe(i: int) -> tuple[str, str]:
        wanted = f"{expected[i] + 1}, the first of face {i + 1}" if expected[i] >= 0 else f"a row of face {i + 1}"
        return f"{tile.place('fac')} column=ring_ptr row={i + 1}", f"found row {pointer[i]} of rng, expected {wanted}"

    return describe


def _unlisted(tile: TileData, is_universe: bool) -> Iterator[Defects]:
    """Rings that no row of ``rng`` names: those of the universe, or all others."""
    plane = tile.plane
    if plane is None or tile.column("rng", "start_edge") is None:
        return
    side = _sides_of_rows(tile, plane)[2]
    is_listed = np.zeros(plane.n_ring, bool)
    is_listed[plane.ring[side[side >= 0]]] = True
    face = plane.side_face[plane.ring_side]
    found = np.flatnonzero(~is_listed & ((face == 0) == is_universe))

    def describe(i: int) -> tuple[str, str]:
        message = (
            f"found no row for the ring of face {face[i] + 1} with edge {plane.ring_side[i] // 2 + 1}, expected one"
        )
        return f"{tile.place('rng')}", message

    yield from some(found, describe)


def check_listed(tile: TileData) -> Iterator[Defects]:
    """Each ring of a face has a row in ``rng``."""
    yield from _unlisted(tile, is_universe=False)


def check_universe_listed(tile: TileData) -> Iterator[Defects]:
    """Each ring of the universe has a row in ``rng``."""
    yield from _unlisted(tile, is_universe=True)


def check_ring_order(tile: TileData) -> Iterator[Defects]:
    """The first ring of a face is its outer one, clockwise; the others, and all of the universe, are inner ones."""
    plane = tile.plane
    if plane is None:
        return
    face, _, side = _sides_of_rows(tile, plane)
    is_first = np.ones(len(face), bool)
    is_first[1:] = face[1:] != face[:-1]
    is_inner = plane.is_inner[plane.ring[side]] if plane.n_ring else np.zeros(len(side), bool)
    wrong = np.flatnonzero((side >= 0) & (is_inner == (is_first & (face > 0))))

    def describe(i: int) -> tuple[str, str]:
        found, wanted = ("an inner ring", "the outer one first") if is_inner[i] else ("an outer ring", "an inner one")
        return f"{tile.place('rng')} row={i + 1}", f"found {found} of face {face[i] + 1}, expected {wanted}"

    yield from some(wrong, describe)


def check_contained(tile: TileData) -> Iterator[Defects]:
    """Inner rings go round what lies in their face, and entity nodes lie in the face that they name."""
    plane, graph = tile.plane, tile.graph
    if plane is None or graph is None or tile.segments is None:
        return
    part = np.flatnonzero(plane.inner_side >= 0)
    at, face = plane.west_place[part], plane.side_face[plane.inner_side[part]]
    faces, edge_part = plane.side_face.reshape(-1, 2), plane.node_part[graph.nodes[:, 0]]
    outside = np.flatnonzero(~is_inside(graph.xy[at], face, part, faces, edge_part, *tile.segments))

    def describe_ring(i: int) -> tuple[str, str]:
        where = f"{tile.place('edg')} row={plane.inner_side[part[i]] // 2 + 1}"
        return where, f"found face {face[i] + 1} round the edges at {rounded(graph.xy[at[i]])}, which lie outside it"

    yield from some(outside, describe_ring)
    xyz, named = tile.entity_places, tile.column("end", "containing_face")
    if xyz is None or named is None or len(outside):
        return
    places, none = np.ascontiguousarray(xyz[:, :2]), np.full(len(named), -1, np.int64)
    outside = np.flatnonzero(~is_inside(places, named - 1, none, faces, edge_part, *tile.segments))

    def describe_node(i: int) -> tuple[str, str]:
        where = f"{tile.place('end')} column=containing_face row={i + 1}"
        return where, f"found face {named[i]} for the node at {rounded(places[i])}, which lies outside it"

    yield from some(outside, describe_node)


PLANAR = ("primitive_references", "edge_ends", "edge_places", "edges_cross", "edges_overlap", "nodes_together")
FACES = (*PLANAR, "ring_faces", "face_count")
"""What must hold where faces are gone through."""

RULES = (
    Rule("V730", "edges_cross", ERROR, "V-503", "edges cross or touch away from nodes", check_crossings, "tile",
         needs=("primitive_references", "edge_ends", "edge_places")),
    Rule("V731", "edges_overlap", ERROR, "V-503", "edges run along each other", check_overlaps, "tile",
         needs=("primitive_references", "edge_ends", "edge_places")),
    Rule("V732", "nodes_together", ERROR, "V-503", "two connected nodes lie in one place", check_places, "tile",
         needs=("table_header", "table_rows")),
    Rule("V733", "ring_faces", ERROR, "V-504", "the sides of a ring have different faces", check_ring_faces, "tile",
         needs=PLANAR),
    Rule("V734", "face_count", ERROR, "V-504", "there are more or fewer faces than the edges make", check_face_count, "tile",
         needs=(*PLANAR, "ring_faces")),
    Rule("V735", "ring_rows", ERROR, "V-505", "a row of rings does not fit its face", check_ring_rows, "tile", needs=FACES),
    Rule("V736", "rings_listed", ERROR, "V-505", "a ring has no row", check_listed, "tile", needs=(*FACES, "ring_rows")),
    Rule("V737", "universe_rings", WARNING, "V-505", "a ring of the universe has no row", check_universe_listed, "tile",
         needs=(*FACES, "ring_rows")),
    Rule("V738", "ring_order", ERROR, "V-505", "an inner ring stands where the outer one belongs, or the other way round",
         check_ring_order, "tile", needs=(*FACES, "ring_rows", "rings_listed")),
    Rule("V739", "contained", ERROR, "V-504", "an inner ring or an entity node lies outside its face", check_contained, "tile",
         needs=(*FACES, "ring_rows", "rings_listed", "ring_order")),
)  # fmt: skip
