"""Judges what a store tells of how levels and faces hang together: T-junctions, and heights of the level before."""

from __future__ import annotations

from typing import Any

import numpy as np
from invariants_mesh import Border, Label
from invariants_store import Level

SAME_HEIGHT = 1e-9
"""Part of the greatest height by which two heights of one place may differ: slivers make the most of rounding."""

SHARED = 1e-7
"""Part of a face's box by which a shared area may be off: pairs that share less than 1e-9 of a face are no links."""


def judge_junctions(level: Level, border: Border) -> None:
    """The T-junctions of a level are those that `judge_mesh` found, with their gaps."""
    label, n_edge = level.label, len(level.edge_ids)
    node, side = border.junctions.T
    edge = level.face_edges.ravel()[side]
    found, told = (np.sort(pair[0] * n_edge + pair[1]) for pair in ((node, edge), level.junctions.T))

    def name(key: int) -> str:
        return f"{label.node(key // n_edge)} inside edge {level.edge_ids[key % n_edge]}"

    missing, extra = np.setdiff1d(found, told), np.setdiff1d(told, found)
    label.accuse(missing > 0, lambda i: f"T-junction: {name(missing[i])}, not in table t_junction")
    label.accuse(extra >= 0, lambda i: f"table t_junction: {name(extra[i])}, which is none")
    node, edge = level.junctions.T
    start, way = level.nodes[level.ends[edge, 0]], level.nodes[level.ends[edge, 1]] - level.nodes[level.ends[edge, 0]]
    along = ((level.nodes[node] - start)[:, :2] * way[:, :2]).sum(axis=1) / (way[:, :2] ** 2).sum(axis=1)
    gap = level.nodes[node, 2] - start[:, 2] - along * way[:, 2]
    slack = SAME_HEIGHT * (1.0 + np.abs(level.nodes[:, 2]).max(initial=0.0))
    label.accuse(
        ~(np.abs(gap - level.gaps) <= slack),
        lambda i: (
            f"table t_junction: {name(node[i] * n_edge + edge[i])}: gap is {level.gaps[i]!r}, measured {gap[i]!r}"
        ),
    )


def judge_shared_areas(nodes: Any, parents: Any, children: Any, links: Any, areas: Any, label: Label) -> None:
    """Pairs of faces share the area told, and all pairs together are all that parents and children have.

    As both levels tile the same ground, nothing is missing if the shares of each face add up to it.
    """
    label.accuse(np.diff(links[:, 1] * len(parents) + links[:, 0]) <= 0, lambda i: f"links {i}, {i + 1}: not in order")
    label.accuse(~(areas > 0), lambda i: f"link {links[i].tolist()}: shares {areas[i]:.9g}")
    xy = nodes[:, :2] - nodes[:, :2].min(axis=0)
    for faces, column, kind in ((parents, 0, "parent"), (children, 1, "child")):
        a, b, c = (xy[faces[:, i]] for i in range(3))
        own = ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
        total = np.bincount(links[:, column], areas, len(faces))
        label.accuse(
            ~(np.abs(total - own) <= SHARED * own.max(initial=0.0)),
            lambda i, kind=kind, total=total, own=own: f"{kind} {i}: shares {total[i]:.9g} of its area {own[i]:.9g}",
        )
    for k, (up, down) in enumerate(links.tolist()):
        polygon = [tuple(p) for p in xy[children[down]].tolist()]
        corners = [tuple(p) for p in xy[parents[up]].tolist()]
        for i in range(3):
            polygon = _clip(polygon, corners[i], corners[(i + 1) % 3])
        area = abs(sum(p[0] * q[1] - q[0] * p[1] for p, q in zip(polygon, polygon[1:] + polygon[:1], strict=True))) / 2
        size = float(np.ptp(xy[children[down]], axis=0).prod())
        text = f"link {(up, down)}: shares {areas[k]:.9g}, found {area:.9g}"
        label.accuse([abs(area - areas[k]) > SHARED * size], lambda _, text=text: text)


def _clip(polygon: list[Any], start: Any, end: Any) -> list[Any]:
    """Part of a convex polygon to the left of a line."""
    kept = []
    side = [(end[0] - start[0]) * (y - start[1]) - (end[1] - start[1]) * (x - start[0]) for x, y in polygon]
    for i, point in enumerate(polygon):
        j = (i + 1) % len(polygon)
        if side[i] >= 0:
            kept.append(point)
        if (side[i] < 0) != (side[j] < 0):
            t = side[i] / (side[i] - side[j])
            kept.append(tuple(p + t * (q - p) for p, q in zip(point, polygon[j], strict=True)))
    return kept


def judge_z_parent(nodes: Any, z_parent: Any, faces: Any, parents: Any, links: Any, is_new: Any, label: Label) -> None:
    """Nodes new at a level have the height of the level before at their places; `links` are nested.

    Where the level before has a gap along an edge, either height will do.
    """
    slack = SAME_HEIGHT * (1.0 + np.abs(nodes[:, 2]).max(initial=0.0))
    parent_of = np.empty(len(faces), np.int64)
    parent_of[links[:, 1]] = links[:, 0]
    side = np.flatnonzero(is_new[faces.ravel()])
    node, corner = faces.ravel()[side], nodes[parents[parent_of[side // 3]]]
    to_b, to_c, to_p = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0], nodes[node] - corner[:, 0]
    normal = np.cross(to_b, to_c)
    height = corner[:, 0, 2] - (normal[:, 0] * to_p[:, 0] + normal[:, 1] * to_p[:, 1]) / normal[:, 2]
    off = np.full(len(nodes), np.inf)
    np.fmin.at(off, node, np.abs(height - z_parent[node]))
    label.accuse(
        is_new & ~(off <= slack),
        lambda i: f"{label.node(i)}: z_parent is {z_parent[i]!r}, the level before is {height[node == i]} there",
    )
