"""Rules V774 to V780, V786: faces and nodes of the levels, parents and children, tile by tile."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vpfx.validate.report import ERROR, Defects, Rule, one, some
from vpfx.validate.vpf.evpf_data import BESIDE, EvpfTile, LevelTables, spacing_of
from vpfx.validate.vpf.planes import FACES
from vpfx.validate.vpf.tile import Plane

__all__ = ["RULES", "TILE", "add_sums", "face_shapes"]

Ids = NDArray[np.int64]
Floats = NDArray[np.float64]

STEEPEST, TURN = 90.0, 360.0  # degrees
SLIVERS = 4.0
"""Spacings of numbers times the perimeter by which areas may differ (R-181)."""
NESTED_AREA, SHARED_AREA = 1e-12, 1e-8
"""Part of an area by which the areas of nested children may differ from it, and those shared with pairs (R-181, R-182)."""


def check_features(tile: EvpfTile) -> Iterator[Defects]:
    """Features follow the faces and nodes of the tile: one each, in their order; other tables are by tile, too."""
    for name, table in tile.level.rows.items():
        if not table.is_sorted:
            yield one(tile.level.place(name), "found tiles in disorder, expected rows by tile")
            return
    for name, key, first, primitive in (("tinface.aft", "fac_id", 2, "fac"), ("tinnode.pft", "cnd_id", 1, "cnd")):
        ids = tile.column(name, key)
        wrong = np.flatnonzero(ids != np.arange(first, first + len(ids)))
        yield from some(wrong, tile.tell(name, _found(ids, first), key))
        most = (tile.tile.coverage.count(primitive, tile.tile_id) or 0) - first + 1
        if len(ids) > most or (primitive == "cnd" and len(ids) < most):
            message = f"found {len(ids)} rows, expected {most}, one for each of {primitive}"
            yield one(f"{tile.level.place(name)} tile={tile.tile_id}", message)


def _found(ids: Ids, first: int) -> Callable[[int], str]:
    return lambda i: f"found {ids[i]}, expected {first + i}: one row for each, in order"


def check_rings(tile: EvpfTile) -> Iterator[Defects]:
    """A face of the store has one ring of three edges, one more for each node inside them; others begin with their lowest."""
    plane, pointer = tile.tile.plane, tile.tile.column("fac", "ring_ptr")
    start = tile.tile.column("rng", "start_edge")
    if plane is None or pointer is None or start is None:
        return
    n_face, faces = tile.n_face, plane.side_face[plane.ring_side]
    length = np.bincount(plane.ring, minlength=plane.n_ring)
    count = np.bincount(faces, minlength=n_face + 1)[1 : n_face + 1]
    n_side = np.zeros(max(n_face + 1, int(faces.max(initial=0)) + 1), np.int64)
    np.add.at(n_side, faces, length)
    inside = tile.junctions[0]
    n_inside = np.bincount(inside[(inside > 0) & (inside <= n_face)], minlength=n_face + 1)[1 : n_face + 1]
    n_side, fac = n_side[1 : n_face + 1], tile.tile.place("fac")
    wrong = np.flatnonzero((count != 1) | (n_side != 3 + n_inside))

    message = "found {} rings with {} edges, expected one with {}".format
    yield from some(wrong, lambda i: (f"{fac} row={i + 2}", message(count[i], n_side[i], 3 + n_inside[i])))
    yield from _check_other_rings(tile, plane)


def _check_other_rings(tile: EvpfTile, plane: Plane) -> Iterator[Defects]:
    """Rings of the universe and of void faces: each begins with its lowest edge, and they follow in that order."""
    face, start = tile.tile.column("rng", "face_id"), tile.tile.column("rng", "start_edge")
    if face is None or start is None:
        return
    row = np.flatnonzero((start > 0) & ((face == 1) | (face > tile.n_face + 1)))
    edge = start[row] - 1
    side = np.where(plane.side_face[2 * edge] == face[row] - 1, 2 * edge, 2 * edge + 1)
    lowest = plane.ring_side[plane.ring[side]] // 2
    where = tile.tile.place("rng")
    expected = "expected the lowest edge of the ring"
    lost = np.flatnonzero(edge != lowest)
    yield from some(
        lost, lambda i: (f"{where} row={row[i] + 1}", f"found edge {edge[i] + 1} first, {expected}, {lowest[i] + 1}")
    )
    is_inner = plane.is_inner[plane.ring[side]]
    is_pair = (face[row[1:]] == face[row[:-1]]) & is_inner[1:] & is_inner[:-1]
    outer = row[~is_inner & (face[row] > 1)]
    late = [row[1:][is_pair & (edge[1:] <= edge[:-1])], outer[1:][start[outer[1:]] <= start[outer[:-1]]]]
    message = "found an edge below that of the ring before, expected rings and void faces by their lowest edges"
    yield from some(np.concatenate(late), lambda i: (f"{where} row={i + 1}", message))


def check_junctions(tile: EvpfTile) -> Iterator[Defects]:
    """``tjunct.rat`` names nodes on rings of faces, by face and node, and leaves each three corners."""
    name = "tjunct.rat"
    if name not in tile.level.rows:
        return
    face, node = tile.junctions
    n_node = tile.tile.coverage.count("cnd", tile.tile_id) or 0
    is_wrong = (face < 1) | (face > tile.n_face) | (node < 0) | (node >= n_node)
    is_wrong[1:] |= (face[1:] < face[:-1]) | ((face[1:] == face[:-1]) & (node[1:] <= node[:-1]))
    if not is_wrong.any():
        starts, nodes = tile.ring_nodes
        known = np.repeat(np.arange(1, len(starts)), np.diff(starts)) * (n_node + 1) + nodes
        is_wrong = ~np.isin(face * (n_node + 1) + node, known)
        if not is_wrong.any() and tile.has_three_corners:
            is_wrong = _beside_sides(tile, face, node) > BESIDE * spacing_of(tile.level.evpf)
    message = "found node {} in a side of face {}, expected one that lies there, by face and node".format
    yield from some(np.flatnonzero(is_wrong), tile.tell(name, lambda i: message(node[i] + 1, face[i] + 1)))


def _beside_sides(tile: EvpfTile, face: Ids, node: Ids) -> NDArray[np.float64]:
    """How far nodes lie from the nearest side between corners of their faces, float64 (n,)."""
    places = tile.tile.node_places
    assert places is not None
    start = places[tile.corners[face - 1], :2]
    way, to_node = np.roll(start, -1, axis=1) - start, places[node, None, :2] - start
    along = np.clip((to_node * way).sum(axis=2) / (way**2).sum(axis=2), 0.0, 1.0)
    rest = to_node - along[..., None] * way
    nearest: NDArray[np.float64] = np.hypot(rest[..., 0], rest[..., 1]).min(axis=1)
    return nearest


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


def check_nodes(tile: EvpfTile) -> Iterator[Defects]:
    """A node is in all levels from its first on, with the same place, height and height on the level before."""
    xyz, rows, name = tile.tile.node_places, tile.rows("tinnode.pft"), "tinnode.pft"
    if xyz is None or rows is None or rows.n_row != len(xyz):
        return
    level, first = tile.level.number, tile.column(name, "first_level")
    z, z_parent, before = rows["z"], rows["z_parent"], _rows_before(tile, xyz)
    expected = "found height {}, expected {} as in cnd".format
    yield from some(np.flatnonzero(z != xyz[:, 2]), tile.tell(name, lambda i: expected(z[i], xyz[i, 2]), "z"))
    wrong = np.flatnonzero(np.isnan(z_parent) == ((first > 0) & tile.level.evpf.is_nested))
    message = "found {} for a node that is there from level {} on".format
    yield from some(wrong, tile.tell(name, lambda i: message(z_parent[i], first[i]), "z_parent"))
    is_new = before < 0
    wrong = np.flatnonzero(np.where(is_new, first != level, (first < 0) | (first >= level)))
    text = "found {}, expected {} as the level before has {} node there".format
    told = {True: (level, "no"), False: (f"less than {level}", "a")}
    yield from some(wrong, tile.tell(name, lambda i: text(first[i], *told[bool(is_new[i])]), "first_level"))
    if tile.before is not None and not len(wrong):
        yield from _compare_nodes(tile, tile.before, np.flatnonzero(~is_new), before)


def _compare_nodes(tile: EvpfTile, older: EvpfTile, same: Ids, before: Ids) -> Iterator[Defects]:
    """Compare nodes with what they are on the level before."""
    name = "tinnode.pft"
    mine, theirs = tile.rows(name), older.rows(name)
    if mine is None or theirs is None or theirs.n_row <= before.max(initial=-1):
        return
    is_other = np.zeros(len(same), bool)
    for column in ("z", "z_parent", "first_level"):
        is_other |= _differ(mine[column][same], theirs[column][before[same]])
    message = "found another height or first level than the node has on the level before"
    yield from some(same[is_other], tile.tell(name, lambda _: message))
    if theirs.n_row > len(same):
        message = f"found {theirs.n_row - len(same)} nodes of the level before no more, expected all of them"
        yield one(f"{tile.level.place(name)} tile={tile.tile_id}", message)


def _differ(a: NDArray[Any], b: NDArray[Any]) -> NDArray[np.bool_]:
    """Tell which numbers differ; NaN equals NaN."""
    is_other: NDArray[np.bool_] = (a != b) & ~((a != a) & (b != b))
    return is_other


def _rows_before(tile: EvpfTile, xyz: NDArray[np.float64]) -> Ids:
    """Index of each node among those of the level before; -1 if it is new."""
    older = None if tile.before is None else tile.before.tile.node_places
    if older is None or not len(older):
        return np.full(len(xyz), -1)
    known, asked = (part[:, 0] + 1j * part[:, 1] for part in (older, xyz))  # complex numbers are sorted by x, then y
    order = np.argsort(known)
    at = order[np.minimum(np.searchsorted(known, asked, sorter=order), len(known) - 1)]
    return np.where(known[at] == asked, at, -1)


def check_faces(tile: EvpfTile) -> Iterator[Defects]:
    """Slope, aspect and whether heights are made up have values that can be; the parent is that of ``parent.rat``."""
    name = "tinface.aft"
    rows = tile.rows(name)
    if rows is None:
        return
    slope, aspect, filled = rows["slope"], rows["aspect"], rows["filled"]
    with np.errstate(invalid="ignore"):
        is_slope = (slope >= 0) & (slope <= STEEPEST)
        is_aspect = np.where(slope == 0, np.isnan(aspect), (aspect >= 0) & (aspect < TURN))
    wrong = np.flatnonzero(~is_slope)
    yield from some(wrong, tile.tell(name, lambda i: f"found {slope[i]}, expected 0 … {STEEPEST:g}", "slope"))
    wrong = np.flatnonzero(is_slope & ~is_aspect)
    message = "found {} with slope {}, expected 0 … 360, or none on level ground".format
    yield from some(wrong, tile.tell(name, lambda i: message(aspect[i], slope[i]), "aspect"))
    wrong = np.flatnonzero((filled != 0) & (filled != 1))
    yield from some(wrong, tile.tell(name, lambda i: f"found {filled[i]}, expected 0 or 1", "filled"))
    parent, known = tile.column(name, "parent"), _parents(tile)
    if known is not None:
        text = "found {}, expected {} by parent.rat".format
        wrong = np.flatnonzero(parent != known)
        yield from some(wrong, tile.tell(name, lambda i: text(parent[i], known[i]), "parent"))


def _parents(tile: EvpfTile) -> Ids | None:
    """Row of each face's parent in ``tinface.aft`` of the level before; 0 for none; None if that cannot be told."""
    parents = np.zeros(tile.n_face, np.int64)
    if tile.level.number == 0 or not tile.level.evpf.is_nested:
        return parents
    child, parent = tile.column("parent.rat", "child_id"), tile.column("parent.rat", "parent_id")
    if tile.before is None or not np.array_equal(child, np.arange(2, tile.n_face + 2)):
        return None
    return tile.before.level.first_row("tinface.aft", tile.tile_id) + parent - 1


def check_counts(level: LevelTables) -> Iterator[Defects]:
    """``level.rat`` counts nodes, edges and faces of all tiles, each once."""
    sums, row = level.sums, level.summary
    places = np.concatenate(sums.shared_places) if sums.shared_places else np.empty((0, 2))
    again = len(places) - len(np.unique(places, axis=0)) if len(places) else 0
    counts = {
        "node_count": sums.n_node - again,
        "edge_count": sums.n_edge - sums.n_shared_side // 2 + sums.n_long,
        "face_count": sums.n_face,
    }
    for name, expected in counts.items():
        if row.get(name) != expected:
            yield one(f"{level.place('level.rat')} column={name}", f"found {row.get(name)}, expected {expected}")


def add_sums(tile: EvpfTile) -> None:
    """Count what a tile adds to its level; nothing where its graph is broken."""
    plane, edges, xyz = tile.tile.plane, tile.tile.edges, tile.tile.node_places
    first = tile.tile.triplets("cnd", "first_edge")
    if plane is None or edges is None or edges.faces is None or xyz is None or first is None:
        return
    sums = tile.level.sums
    sums.n_face += tile.n_face
    sums.n_edge += len(edges.faces)
    sums.n_node += len(xyz)
    sums.n_shared_side += int((edges.faces[:, :, 1] > 0).any(axis=1).sum())
    sums.shared_places.append(xyz[first[:, 1] > 0, :2])
    if len(tile.junctions[0]):
        starts, inside = tile.ring_nodes[0], tile.is_junction
        ring_starts = starts[:-1]
        before = np.roll(inside, 1)
        before[ring_starts] = inside[starts[1:] - 1]
        sums.n_long += int((inside & ~before).sum())


TILE = (*FACES, "ring_rows", "rings_listed", "ring_order", "evpf_metadata", "evpf_features")

RULES = (
    Rule("V774", "evpf_features", ERROR, "E-300", "features do not follow faces and nodes", check_features, "evpf tile",
         needs=("table_header", "table_rows", "evpf_metadata", "feature_references")),
    Rule("V775", "evpf_rings", ERROR, "E-220", "the ring of a face does not have three edges, or not in order", check_rings,
         "evpf tile", needs=TILE),
    Rule("V776", "evpf_junctions", ERROR, "E-222", "a node in a side of a face is none", check_junctions, "evpf tile",
         needs=(*TILE, "evpf_rings")),
    Rule("V777", "evpf_links", ERROR, "E-420", "a face has no parent or child, or one that is not there", check_links,
         "evpf tile", needs=("evpf_metadata", "evpf_features")),
    Rule("V778", "evpf_nesting", ERROR, "E-420", "children do not tile their parent", check_nesting, "evpf tile",
         needs=(*TILE, "evpf_rings", "evpf_junctions", "evpf_links")),
    Rule("V779", "evpf_nodes", ERROR, "E-300", "a node is not the same on all levels", check_nodes, "evpf tile",
         needs=("primitive_references", "edge_ends", "nodes_together", "evpf_metadata", "evpf_features")),
    Rule("V780", "evpf_faces", ERROR, "E-300", "a face has a value that cannot be", check_faces, "evpf tile",
         needs=("evpf_metadata", "evpf_features", "evpf_links")),
    Rule("V786", "evpf_counts", ERROR, "E-410", "a level counts other nodes, edges or faces than it has", check_counts,
         "evpf level", needs=(*TILE, "evpf_rings", "evpf_junctions", "external_range", "external_faces", "evpf_borders")),
)  # fmt: skip
