"""Rules V5xx: how levels hang together: links, nesting, areas, errors and bounds (R-121, R-151, R-180 to R-182)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vpfx.store.arrays import look_up
from vpfx.validate.kernels import judge_corners, measure_rises, walk_chains
from vpfx.validate.level_data import LevelData, StepData
from vpfx.validate.report import ERROR, Defects, Rule, one, some
from vpfx.validate.store_data import StoreData

__all__ = ["RULES"]

MOST_OUTSIDE = 2.0
"""Slacks of places by which a child may lie outside its parent (R-181)."""
AREA_PART, AREA_SLACKS = 1e-12, 4.0
"""Part of the area of a parent, and slacks of places along its perimeter, by which areas of its children may differ (R-181)."""
SHARED_PART = 1e-7
"""Of the area of a face, by which its shares may differ: those below 1e-9 of a face are left out (R-182)."""
SAME = 1e-9
"""Part by which two numbers measured in two ways may differ."""


def check_parents(step: StepData) -> Iterator[Defects]:
    """Every face but those of level 0 has a parent."""
    count = np.bincount(step.pairs[:, 1], minlength=len(step.fine.faces["face_id"]))
    yield from some(np.flatnonzero(count == 0), lambda i: (step.fine.place("face", i), "found no parent, expected one"))


def check_children(step: StepData) -> Iterator[Defects]:
    """Every face but those of the finest level has a child."""
    count = np.bincount(step.pairs[:, 0], minlength=len(step.coarse.faces["face_id"]))
    yield from some(
        np.flatnonzero(count == 0), lambda i: (step.coarse.place("face", i), "found no child, expected one")
    )


def check_single_parents(step: StepData) -> Iterator[Defects]:
    """Where levels are nested a face has one parent."""
    if step.data.is_nested:
        count = np.bincount(step.pairs[:, 1], minlength=len(step.fine.faces["face_id"]))
        many = np.flatnonzero(count > 1)
        yield from some(many, lambda i: (step.fine.place("face", i), f"found {count[i]} parents, expected one"))


def check_filled(step: StepData) -> Iterator[Defects]:
    """Where levels are nested, children are filled if their parent is."""
    if step.data.is_nested:
        parent, child = step.pairs.T
        flags = step.coarse.faces["is_filled"][parent], step.fine.faces["is_filled"][child]
        yield from some(
            np.flatnonzero(flags[0] != flags[1]),
            lambda i: (
                step.fine.place("face", child[i]),
                f"is_filled: found {flags[1][i]}, its parent has {flags[0][i]}",
            ),
        )


def _parents(step: StepData) -> NDArray[np.int32]:
    """The parent of each face of the fine level."""
    parent = np.empty(len(step.fine.faces["face_id"]), np.int32)
    parent[step.pairs[:, 1]] = step.pairs[:, 0]
    return parent


def _inner_slits(level: LevelData, owner: NDArray[np.int32]) -> NDArray[np.int64]:
    """Edges of slits between children of one parent, given the parent of the only face of each edge."""
    long, short, *_ = level.slits
    is_other = np.zeros(len(owner), np.bool_)
    is_other[long[owner[long] != owner[short]]] = True
    return np.concatenate([long[~is_other[long]], short[~is_other[long]]])


def check_chains(step: StepData) -> Iterator[Defects]:
    """The outer sides of a parent's children form one chain through its corners, in their order."""
    if not step.data.is_nested:
        return
    fine, parent = step.fine, _parents(step)
    left, right = fine.edge_faces.T
    of_left, of_right = (np.where(face >= 0, parent[face], -1) for face in (left, right))
    is_outer = of_left != of_right
    is_outer[_inner_slits(fine, np.maximum(of_left, of_right))] = False
    start, end = fine.edge_nodes.T
    owner = np.concatenate([of_left[is_outer], of_right[is_outer]]).astype(np.int64)
    first = np.concatenate([start[is_outer], end[is_outer]]).astype(np.int64)
    last = np.concatenate([end[is_outer], start[is_outer]]).astype(np.int64)
    first, last, owner = first[owner >= 0], last[owner >= 0], owner[owner >= 0]
    n_node = len(step.data.xyz)
    key = owner * n_node + first
    order = np.argsort(key)
    key, last, owner = key[order], last[order], owner[order]
    following, is_there = look_up(key, owner * n_node + last)
    following[~is_there] = -1
    corners = step.coarse.face_nodes
    begin = np.searchsorted(key, np.arange(len(corners)) * n_node + corners[:, 0])
    is_good = np.zeros(len(corners), np.bool_)
    walk_chains(key, last, following, begin, corners.astype(np.int64), n_node, is_good)
    message = "found children whose outer sides are no chain through its corners"
    yield from some(np.flatnonzero(~is_good), lambda i: (step.coarse.place("face", i), message))


def check_corners(step: StepData) -> Iterator[Defects]:
    """The corners of a child do not lie outside its parent, but for rounding."""
    if not step.data.is_nested:
        return
    parent, child = step.pairs.T
    away = np.empty(len(parent))
    judge_corners(step.data.xyz, step.coarse.face_nodes[parent], step.fine.face_nodes[child], away)
    wrong = np.flatnonzero(~(away <= MOST_OUTSIDE * step.data.place_slack * (1.0 + SAME)))

    def text(i: int) -> tuple[str, str]:
        face = step.coarse.faces["face_id"][parent[i]]
        return step.fine.place("face", child[i]), f"found a corner {away[i]:.3g} outside its parent {face} (CRS units)"

    yield from some(wrong, text)


def _areas(level: LevelData) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Areas and perimeters of the faces, and by how much an area may be off by rounding here."""
    a, b, c = (level.data.xyz[level.face_nodes[:, i], :2] for i in range(3))
    one_side, other_side = b - a, c - a
    left, right = one_side[:, 0] * other_side[:, 1], one_side[:, 1] * other_side[:, 0]
    perimeter = sum(np.hypot(*side.T) for side in (one_side, other_side, c - b))
    return (left - right) / 2, perimeter, 2e-16 * (np.abs(left) + np.abs(right))


def check_areas(step: StepData) -> Iterator[Defects]:
    """The areas of the children add up to that of their parent, but for rounding."""
    if not step.data.is_nested:
        return
    parent, child = step.pairs.T
    area, perimeter, off = _areas(step.coarse)
    parts, _, parts_off = _areas(step.fine)
    total = np.bincount(parent, parts[child], len(area))
    off = off + np.bincount(parent, parts_off[child], len(area))
    allowed = AREA_PART * np.abs(area) + AREA_SLACKS * perimeter * step.data.place_slack + off
    yield from some(
        np.flatnonzero(~(np.abs(total - area) <= allowed)),
        lambda i: (
            step.coarse.place("face", i),
            f"found children with an area of {total[i]:.12g}, it has {area[i]:.12g}",
        ),
    )


def _only_in(pairs: NDArray[np.int64], others: NDArray[np.int64]) -> NDArray[np.int64]:
    """Pairs, int64 (n, 2), that are not among some others."""
    wanted, known = (np.ascontiguousarray(array).view("i8,i8").ravel() for array in (pairs, others))
    return pairs[~np.isin(wanted, known)]


def check_shared_pairs(level: LevelData) -> Iterator[Defects]:
    """Links of levels that are not nested have an area each, those of nested ones have none."""
    links = level.links[:0] if level.data.is_nested else level.links
    rows = np.stack([level.shared_areas[name] for name in ("child_face", "parent_face")], axis=1)
    if np.array_equal(rows, links):
        return
    expected = "none where levels are nested" if level.data.is_nested else "only areas of links"
    for pairs, others, message in (
        (links, rows, "found no area shared with face {}, expected one: it is a parent"),
        (rows, links, f"found an area shared with face {{}}, expected {expected}"),
    ):
        only = _only_in(pairs, others)

        def text(i: int, only: Any = only, message: str = message) -> tuple[str, str]:
            return f"level={level.level} face={only[i, 0]}", message.format(only[i, 1])

        yield from some(np.arange(len(only)), text)


def check_shares(step: StepData) -> Iterator[Defects]:
    """The areas that a face shares with those of the next level, or of the one before, add up to its own."""
    if step.data.is_nested:
        return
    for i, level in enumerate((step.coarse, step.fine)):
        area, perimeter, off = _areas(level)
        total = np.bincount(step.pairs[:, i], step.fine.shared_areas["area"], len(area))
        allowed = SHARED_PART * area + 2 * AREA_SLACKS * perimeter * step.data.place_slack + off

        def text(face: int, level: LevelData = level, total: Any = total, area: Any = area) -> tuple[str, str]:
            return level.place("face", face), f"found shares of {total[face]:.12g} in all, it has {area[face]:.12g}"

        yield from some(np.flatnonzero(~(np.abs(total - area) <= allowed)), text)


def check_bounds(data: StoreData) -> Iterator[Defects]:
    """Errors are within their bounds, and bounds fall from level to level."""
    before = np.inf
    for row in data.level_rows:
        bound = row.max_error_bound
        if bound is None:
            continue
        if row.max_error > bound:
            yield one(f"level={row.level}", f"max_error: found {row.max_error}, above its bound {bound}")
        if bound >= before:
            yield one(
                f"level={row.level}", f"max_error_bound: found {bound}, expected less than {before} of the one before"
            )
        before = bound


def check_errors(data: StoreData) -> Iterator[Defects]:
    """The root mean square is not above the greatest error; without posts both are 0."""
    for row in data.level_rows:
        if row.rmse > row.max_error * (1.0 + SAME):
            yield one(f"level={row.level}", f"rmse: found {row.rmse}, above the greatest error {row.max_error}")
        if row.post_count == 0 and (row.rmse or row.max_error):
            yield one(f"level={row.level}", f"found errors {row.max_error} and {row.rmse} without a post, expected 0")


def check_parent_heights(level: LevelData) -> Iterator[Defects]:
    """Nodes that are new at a level behind the first have a height of the level before; others, and un-nested ones, none."""
    nodes = level.data.nodes
    is_told = ~np.isnan(nodes["z_parent"])
    is_due = level.level > 0 and level.data.is_nested
    wrong = np.flatnonzero(level.is_new & (is_told != is_due))
    expected = "a height" if is_due else "NULL"
    yield from some(
        wrong, lambda i: (level.node(i), f"z_parent: found {nodes['z_parent'][i]} (nan is NULL), expected {expected}")
    )


def check_rise(level: LevelData) -> Iterator[Defects]:
    """The greatest rise of a level is that of its new nodes."""
    nodes, told, slack = level.data.nodes, level.row.max_rise, 2 * level.data.height_slack
    if level.level == 0 or not level.data.is_nested:
        if told is not None:
            yield one(f"level={level.level}", f"max_rise: found {told}, expected NULL")
        return
    rises = np.abs(nodes["z"] - nodes["z_parent"])[level.is_new]
    rise = float(rises.max()) if len(rises) else None
    if (told is None) != (rise is None) or (rise is not None and abs(told - rise) > SAME * max(rise, told) + slack):
        yield one(f"level={level.level}", f"max_rise: found {told}, measured {rise}")


def check_surface_before(step: StepData) -> Iterator[Defects]:
    """The height of the level before at a new node is that of its faces there."""
    if not step.data.is_nested:
        return
    nodes, parent = step.data.nodes, _parents(step)
    off, slack = np.full(len(nodes["z"]), np.inf), np.zeros(len(nodes["z"]))
    corners = step.coarse.face_nodes[parent]
    measure_rises(step.data.xyz, corners, step.fine.face_nodes, nodes["z_parent"], step.data.place_slack, off, slack)
    slack += SAME * (1.0 + np.abs(nodes["z"]).max(initial=0.0)) + 2 * step.data.height_slack
    wrong = np.flatnonzero(step.fine.is_new & ~(off <= slack))

    def text(i: int) -> tuple[str, str]:
        return step.fine.node(
            i
        ), f"z_parent: found {nodes['z_parent'][i]}, the level before is off by {off[i]:.6g} there"

    yield from some(wrong, text)


LINKED = ("link_reference", "edge_reference", "face_reference")
NESTED = (*LINKED, "single_parent", "parent_missing", "child_missing", "face_clockwise", "face_area")
RULES = (
    Rule("V501", "parent_missing", ERROR, "R-180", "a face has no parent", check_parents, "step", LINKED),
    Rule("V502", "child_missing", ERROR, "R-180", "a face has no child", check_children, "step", LINKED),
    Rule("V503", "single_parent", ERROR, "R-180", "a face has several parents, though levels are nested",
         check_single_parents, "step", LINKED),
    Rule("V504", "nested_chain", ERROR, "R-181", "children do not fill their parent, by their edges", check_chains, "step",
         (*NESTED, "edge_faces", "edge_alone", "t_junction")),
    Rule("V505", "child_outside", ERROR, "R-181", "a child lies outside its parent", check_corners, "step",
         (*NESTED, "nested_chain")),
    Rule("V506", "children_area", ERROR, "R-181", "areas of children do not add up to their parent's", check_areas, "step",
         (*NESTED, "nested_chain", "child_outside")),
    Rule("V507", "shared_pairs", ERROR, "R-182", "shared areas are not those of the links", check_shared_pairs, "level",
         ("row_values", "stray_row")),
    Rule("V508", "shared_area", ERROR, "R-182", "areas that a face shares do not add up to its own", check_shares, "step",
         (*LINKED, "shared_pairs", "parent_missing", "child_missing", "face_clockwise", "face_area")),
    Rule("V509", "filled_family", ERROR, "R-170", "a face is filled and its parent is not, or the other way round",
         check_filled, "step", (*LINKED, "filled_face")),
    Rule("V510", "bound", ERROR, "R-121", "a level does not hold its bound, or bounds do not fall", check_bounds,
         needs=("levels",)),
    Rule("V511", "error_figures", ERROR, "R-121", "errors of a level do not fit each other", check_errors,
         needs=("levels",)),
    Rule("V512", "z_parent_given", ERROR, "R-151", "a height of the level before is missing, or should be",
         check_parent_heights, "level", ("node_range", "levels", "metadata")),
    Rule("V513", "max_rise", ERROR, "R-121", "the greatest rise of a level is another", check_rise, "level",
         ("z_parent_given",)),
    Rule("V514", "z_parent", ERROR, "R-151", "the surface of the level before has another height at a node",
         check_surface_before, "step",
         (*NESTED, "nested_chain", "child_outside", "children_area", "z_parent_given", "node_unused")),
)  # fmt: skip
