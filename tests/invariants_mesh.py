"""Judge of one level as a mesh, and of the links between two levels; it shares no code with the builder.

Signs and areas are exact: floats with a forward error bound decide what they can, fractions decide the rest.
"""

from __future__ import annotations

import itertools
import math
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

ULPS = 16
"""Coordinates are trusted to this many units in the last place of the greatest |x| or |y| of the level. A coordinate is
``x0 + dx * u``: the rounding of u, of the product and of the sum by the builder, of the difference from x0 and of the
quotient here are each at most an ulp of the extent, which is at most twice the greatest |x|: 10, rounded up to 16."""

INSIDE = 1e-9
"""A corner of a child lies inside its parent to this part of the parent's size (design, section 4: Exactness)."""

AREA = 1e-12
"""The areas of the children agree with that of their parent to this part of it (design, section 4: Exactness)."""

UNIT = 2.0**-53
"""Half an ulp of 1: the relative error of one float64 operation."""

FILTER = (3 + 16 * UNIT) * UNIT
"""Shewchuk's first bound: a 2 × 2 determinant of differences is off by at most this × the sum of its two products."""

CHUNK = 1 << 19
"""Entries worked on at a time: temporary arrays of 4 MB stay near the processor."""


class Label(NamedTuple):
    """What to call nodes and faces in messages: by index, or by the ids of a store."""

    level: int = 0
    node_ids: Any = None
    face_ids: Any = None

    def node(self, index: int) -> str:
        """Name a node."""
        return f"node {index if self.node_ids is None else self.node_ids[index]}"

    def face(self, index: int) -> str:
        """Name a face."""
        return f"face {index if self.face_ids is None else self.face_ids[index]}"

    def accuse(self, is_wrong: Any, text: Any) -> None:
        """Raise if any entry is true; `text` says what is wrong with the first one."""
        if np.any(is_wrong):
            raise AssertionError(f"level {self.level}: {text(int(np.argmax(is_wrong)))}")


def require(is_right: Any, text: str) -> None:
    """Raise if not; unlike the statement, also under ``python -O``."""
    if not is_right:
        raise AssertionError(text)


PLAIN = Label()
"""Faces and nodes by index, level 0."""


def coordinate_tolerance(*arrays: Any) -> float:
    """Distance within which two places are the same up to rounding, in CRS units."""
    return ULPS * float(np.spacing(max(float(np.abs(array).max(initial=0.0)) for array in arrays)))


def ragged(start: Any, count: Any) -> tuple[Any, Any]:
    """Write out ``arange(start, start + count)`` for each entry: the entry each value belongs to, and the values."""
    owner = np.repeat(np.arange(len(count)), count)
    return owner, np.arange(len(owner)) + np.repeat(start - (np.cumsum(count) - count), count)


def chunks(count: Any, limit: int = CHUNK) -> Any:
    """Cut the entries into slices whose counts sum to about `limit`."""
    total = np.cumsum(count)
    begin = 0
    while begin < len(total):
        done = total[begin - 1] if begin else 0
        end = max(begin + 1, int(np.searchsorted(total, done + limit, side="right")))
        yield slice(begin, end)
        begin = end


def doubled_areas(xy: Any, faces: Any) -> tuple[Any, Any]:
    """Twice the signed area of each face and a bound of its error."""
    side_1, side_2 = xy[faces[:, 1]] - xy[faces[:, 0]], xy[faces[:, 2]] - xy[faces[:, 0]]
    left, right = side_1[:, 0] * side_2[:, 1], side_1[:, 1] * side_2[:, 0]
    return left - right, FILTER * (np.abs(left) + np.abs(right))


def exact_doubled_area(xy: Any, face: Any) -> Fraction:
    """Twice the signed area of one face, without error."""
    (ax, ay), (bx, by), (cx, cy) = ((Fraction(float(x)), Fraction(float(y))) for x, y in xy[face])
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


def total_area(xy: Any, faces: Any) -> float:
    """Sum of the signed areas, rounded once: products as exact pairs (Dekker), summed exactly."""
    parts = []
    for corner in range(3):
        a, b = xy[faces[:, corner]], xy[faces[:, (corner + 1) % 3]]
        for sign, one, other in ((1, a[:, 0], b[:, 1]), (-1, a[:, 1], b[:, 0])):
            product = one * other
            one_high, other_high = (value * 134217729.0 - (value * 134217729.0 - value) for value in (one, other))
            one_low, other_low = one - one_high, other - other_high
            cross = one_high * other_high - product + one_high * other_low + one_low * other_high
            parts += [sign * product, sign * (cross + one_low * other_low)]
    return math.fsum(np.concatenate(parts).tolist()) / 2


class Border(NamedTuple):
    """Edges of a mesh that `judge_mesh` has passed.

    Sides are ``3 * face + corner`` of their first node.
    """

    n_edge: int
    half: Any  # sides with one face and nothing across: the outline
    long: Any  # sides with a node inside, and the shorter sides of other faces across
    junctions: Any  # (n, 2) node, and the long side it lies inside


def judge_mesh(nodes: Any, face_nodes: Any, *, is_adjacent: bool = True, label: Label = PLAIN) -> Border:
    """Judge turns, places, use, edges and T-junctions.

    Without `is_adjacent`, T-junctions may be: then the sides of other faces must run along each edge with a node inside, from
    end to end.
    """
    nodes, faces = np.asarray(nodes, np.float64), np.asarray(face_nodes, np.int64)
    label.accuse(len(faces) == 0, lambda _: "no faces")
    label.accuse(~np.isfinite(nodes).all(axis=1), lambda i: f"{label.node(i)}: a coordinate is not a finite number")
    is_wrong = ((faces < 0) | (faces >= len(nodes))).any(axis=1)
    label.accuse(is_wrong, lambda i: f"{label.face(i)}: a corner is not one of the {len(nodes)} nodes of the level")
    xy = nodes[:, :2]
    _judge_turns(xy, faces, label)
    _judge_places(xy, faces, label)
    half, n_edge = border_halves(faces, len(nodes), label)
    junctions = find_junctions(xy, faces, half)
    if is_adjacent:

        def text(i: int) -> str:
            node, side = junctions[i]
            start, end = faces[side // 3, side % 3], faces[side // 3, (side + 1) % 3]
            edge = f"edge {label.node(start)} – {label.node(end)} of {label.face(side // 3)}"
            return f"T-junction: {label.node(node)} lies within {edge}"

        label.accuse(np.ones(len(junctions), bool), text)
    long = np.unique(junctions[:, 1])
    return Border(n_edge, np.setdiff1d(half, _judge_slits(xy, faces, half, junctions, label)), long, junctions)


def _judge_slits(xy: Any, faces: Any, half: Any, junctions: Any, label: Label) -> Any:
    """Shorter sides run along each side with a node inside, the other way, from end to end; return all these sides."""
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    ways = {(int(start[h]), int(end[h])): int(h) for h in half} if len(junctions) else {}
    inside: dict[int, list[int]] = {}
    for node, side in junctions.tolist():
        inside.setdefault(side, []).append(node)
    found = []
    for side, nodes in inside.items():
        along = xy[end[side]] - xy[start[side]]
        nodes.sort(key=lambda node: float((xy[node] - xy[start[side]]) @ along))
        chain = [int(start[side]), *nodes, int(end[side])]
        across = [ways.get((b, a), -1) for a, b in itertools.pairwise(chain)]
        label.accuse(
            np.array(across) < 0,
            lambda i, chain=chain: f"no edge {label.node(chain[i + 1])} – {label.node(chain[i])} along a longer one",
        )
        found += [side, *across]
    label.accuse(np.diff(np.sort(found)) == 0, lambda _: "a side lies along two longer ones")
    return np.array(found, np.int64)


def _judge_turns(xy: Any, faces: Any, label: Label) -> None:
    """Every face is counter-clockwise and has an area: exact."""
    area, error = doubled_areas(xy, faces)
    is_wrong = area < -error
    for index in np.flatnonzero(np.abs(area) <= error):
        is_wrong[index] = exact_doubled_area(xy, faces[index]) <= 0
        if is_wrong[index]:
            break
    label.accuse(is_wrong, lambda i: f"{label.face(i)}: not counter-clockwise (doubled area {area[i]:.6g})")


def _judge_places(xy: Any, faces: Any, label: Label) -> None:
    """No two nodes share a place, and a face uses each node."""
    order = np.lexsort((xy[:, 1], xy[:, 0]))
    same = (xy[order[1:]] == xy[order[:-1]]).all(axis=1)
    label.accuse(same, lambda i: f"{label.node(order[i])} and {label.node(order[i + 1])} share a place")
    is_used = np.zeros(len(xy), bool)
    is_used[faces] = True
    label.accuse(~is_used, lambda i: f"{label.node(i)}: no face uses it")


def border_halves(faces: Any, n_node: int, label: Label) -> tuple[Any, int]:
    """Sides with one face, as ``3 * face + corner`` of their first node, and the number of edges.

    Raises if an edge is used by more than two faces, or by two in the same sense.
    """
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    edge = np.minimum(start, end) * n_node + np.maximum(start, end)
    order = np.argsort(edge, kind="stable")
    edge, is_up = edge[order], (start < end)[order]
    first = np.flatnonzero(np.r_[True, edge[1:] != edge[:-1]])
    count = np.diff(np.r_[first, len(edge)])

    def name(i: int) -> str:
        halves = order[first[i] : first[i] + count[i]]
        users = ", ".join(label.face(h // 3) for h in halves)
        return f"edge {label.node(start[halves[0]])} – {label.node(end[halves[0]])} of {users}"

    label.accuse(count > 2, lambda i: f"{name(i)}: more than two faces")
    second = np.minimum(first + 1, len(edge) - 1)
    label.accuse((count == 2) & (is_up[first] == is_up[second]), lambda i: f"{name(i)}: used twice in the same sense")
    return order[first[count == 1]], len(first)


def border_length(xy: Any, faces: Any, half: Any) -> float:
    """Length of the border."""
    start, end = faces.ravel()[half], np.roll(faces, -1, axis=1).ravel()[half]
    return float(np.hypot(*(xy[end] - xy[start]).T).sum())


def find_junctions(xy: Any, faces: Any, half: Any) -> Any:
    """Nodes that lie within an edge that has one face: (n, 2) node and side.

    Nodes are sorted into ``n × n`` cells, column by column; an edge meets in each column of cells a run of cells, whose
    nodes lie together.
    """
    tolerance = coordinate_tolerance(xy)
    start, end = faces.ravel()[half], np.roll(faces, -1, axis=1).ravel()[half]
    n = math.isqrt(len(xy)) + 1
    corner = xy.min(axis=0)
    cell = (xy.max(axis=0) - corner) / n

    def to_cell(values: Any, axis: int) -> Any:
        return np.clip(np.floor((values - corner[axis]) / cell[axis]), 0, n - 1).astype(np.int64)

    bucket = to_cell(xy[:, 0], 0) * n + to_cell(xy[:, 1], 1)
    order = np.argsort(bucket, kind="stable")
    begin = np.searchsorted(bucket[order], np.arange(n * n + 1))
    is_west = (xy[start, 0] <= xy[end, 0])[:, None]
    west, east = np.where(is_west, xy[start], xy[end]), np.where(is_west, xy[end], xy[start])
    column_1 = to_cell(west[:, 0] - 2 * tolerance, 0)
    edge, column = ragged(column_1, to_cell(east[:, 0] + 2 * tolerance, 0) - column_1 + 1)
    ends = [
        _cross_at(west[edge], east[edge], corner[0] + (column + i) * cell[0], sign * 2 * tolerance)
        for i, sign in ((0, -1), (1, 1))
    ]
    row_1 = to_cell(np.minimum(*ends) - 2 * tolerance, 1)
    row_2 = to_cell(np.maximum(*ends) + 2 * tolerance, 1)
    first, last = begin[column * n + row_1], begin[column * n + row_2 + 1]
    found = [np.empty((0, 2), np.int64)]
    for part in chunks(last - first):
        owner, at = ragged(first[part], (last - first)[part])
        node, side = order[at], edge[part][owner]
        is_other = (node != start[side]) & (node != end[side])
        node, side = node[is_other], side[is_other]
        along, to_node = xy[end[side]] - xy[start[side]], xy[node] - xy[start[side]]
        length2, dot = (along * along).sum(axis=1), (along * to_node).sum(axis=1)
        offset = np.abs(along[:, 0] * to_node[:, 1] - along[:, 1] * to_node[:, 0])
        is_inside = (offset <= tolerance * np.sqrt(length2)) & (dot > 0) & (dot < length2)
        found.append(np.stack([node, half[side]], axis=1)[is_inside])
    return np.unique(np.concatenate(found), axis=0)


def _cross_at(west: Any, east: Any, x: Any, shift: float) -> Any:
    """Find y where a segment meets x + shift, or its nearer end."""
    width = east[:, 0] - west[:, 0]
    part = np.divide(x + shift - west[:, 0], width, out=np.full(len(x), 0.0 if shift < 0 else 1.0), where=width > 0)
    return west[:, 1] + np.clip(part, 0.0, 1.0) * (east[:, 1] - west[:, 1])


def judge_links(
    nodes: Any,
    parent_faces: Any,
    child_faces: Any,
    links: Any,
    *,
    is_filled: tuple[Any, Any] | None = None,
    label: Label = PLAIN,
    parent_label: Label = PLAIN,
) -> None:
    """Judge the (parent, child) pairs from one level to the next: every child has one parent, and children tile it.

    Together with `judge_mesh` of the finer level, which proves that children do not overlap, corners inside and equal
    areas are enough for a tiling. `is_filled` holds the flags of the parents and of the children.
    """
    xy = np.asarray(nodes, np.float64)[:, :2]
    parents, children, links = (np.asarray(a, np.int64) for a in (parent_faces, child_faces, links))
    limits = np.array([len(parents), len(children)])
    label.accuse(((links < 0) | (links >= limits)).any(axis=1), lambda i: f"link {tuple(links[i])}: no such face")
    n_parent, n_child = np.bincount(links[:, 1], minlength=limits[1]), np.bincount(links[:, 0], minlength=limits[0])
    label.accuse(n_parent != 1, lambda i: f"{label.face(i)}: {n_parent[i]} parents, expected one")
    parent_label.accuse(n_child == 0, lambda i: f"{parent_label.face(i)}: no child")
    up, down = links.T
    if is_filled is not None:
        differs = np.asarray(is_filled[0], bool)[up] != np.asarray(is_filled[1], bool)[down]
        label.accuse(
            differs, lambda i: f"{label.face(down[i])}: is_filled differs from its parent {parent_label.face(up[i])}"
        )
    changed = (np.sort(parents[up], axis=1) != np.sort(children[down], axis=1)).any(axis=1) & (n_child[up] == 1)
    label.accuse(changed, lambda i: f"{label.face(down[i])}: only child of {parent_label.face(up[i])}, but other nodes")
    tolerance = coordinate_tolerance(xy)
    sides = [xy[parents[:, (i + 1) % 3]] - xy[parents[:, i]] for i in range(3)]
    lengths = [np.hypot(*side.T) for side in sides]
    reach = INSIDE * np.maximum.reduce(lengths) + tolerance
    for i, j in np.ndindex(3, 3):
        side, to_corner = sides[i][up], xy[children[down, j]] - xy[parents[up, i]]
        distance = (side[:, 0] * to_corner[:, 1] - side[:, 1] * to_corner[:, 0]) / lengths[i][up]
        label.accuse(
            distance < -reach[up],
            lambda k, j=j, distance=distance: (
                f"{label.face(down[k])}: {label.node(children[down[k], j])} lies {-distance[k]:.3g} outside its parent "
                f"{parent_label.face(up[k])}"
            ),
        )
    _judge_areas(xy, parents, children, links, tolerance * sum(lengths), parent_label)


def _judge_areas(xy: Any, parents: Any, children: Any, links: Any, rounding: Any, label: Label) -> None:
    """Areas of children sum to that of their parent within `AREA` of it and the rounding along its sides."""
    up, down = links.T
    area, error = doubled_areas(xy, parents)
    child_area, child_error = doubled_areas(xy, children)
    total = np.bincount(up, child_area[down], len(parents))
    count = np.bincount(up, minlength=len(parents))
    error = error + np.bincount(up, child_error[down], len(parents)) + (count + 2) * UNIT * np.abs(total)
    allowed = AREA * np.abs(area) + 2 * rounding
    is_wrong = np.abs(total - area) - error > allowed
    order = np.argsort(up, kind="stable")
    first = np.cumsum(count) - count
    for i in np.flatnonzero(~is_wrong & (np.abs(total - area) + error > allowed)):
        family = down[order[first[i] : first[i] + count[i]]]
        difference = sum((exact_doubled_area(xy, children[c]) for c in family), -exact_doubled_area(xy, parents[i]))
        is_wrong[i] = abs(difference) > Fraction(float(allowed[i]))
    label.accuse(is_wrong, lambda i: f"{label.face(i)}: children cover {total[i] / 2!r}, expected {area[i] / 2!r}")
