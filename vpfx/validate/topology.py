"""Rules V3xx: how nodes, edges and faces of one level hang together (R-151, R-160, R-161, R-170, R-190)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from vpfx.methods import METHODS
from vpfx.validate.kernels import expected_links, judge_sides
from vpfx.validate.level_data import LevelData
from vpfx.validate.report import ERROR, Defects, Rule, one, some

__all__ = ["RULES"]

SAME_HEIGHT = 1e-9
"""Part of the greatest height by which two heights of one place may differ."""
HANDS = ("left", "right")


def check_repeated_edges(level: LevelData) -> Iterator[Defects]:
    """No two edges of a level join the same nodes."""
    low, high = level.edge_nodes.min(axis=1).astype(np.int64), level.edge_nodes.max(axis=1)
    key = low * len(level.data.xyz) + high
    order = np.argsort(key, kind="stable")
    same = np.flatnonzero(key[order[1:]] == key[order[:-1]])

    def text(i: int) -> tuple[str, str]:
        first, second = (level.edges["edge_id"][order[j]] for j in (i, i + 1))
        return level.place(
            "edge", order[i + 1]
        ), f"found edges {first} and {second} between the same nodes, expected one"

    yield from some(same, text)


def check_loops(level: LevelData) -> Iterator[Defects]:
    """An edge joins two nodes."""
    same = np.flatnonzero(level.edge_nodes[:, 0] == level.edge_nodes[:, 1])
    yield from some(same, lambda i: (level.place("edge", i), "found one node at both ends, expected two"))


def _sides(level: LevelData) -> tuple[np.ndarray, np.ndarray]:
    """Sides of faces whose edge joins other nodes, and those whose edge has not the face on its hand, (n_face, 3)."""
    wrong_side, wrong_face = (np.zeros(level.face_nodes.shape, np.bool_) for _ in range(2))
    judge_sides(
        level.face_nodes, level.face_edges, level.edge_nodes, level.edge_faces, level.turns, wrong_side, wrong_face
    )
    return wrong_side, wrong_face


def check_face_edges(level: LevelData) -> Iterator[Defects]:
    """Each edge of a face joins the nodes of its side."""
    index = np.flatnonzero(level.once(_sides)[0].ravel())

    def text(side: int) -> tuple[str, str]:
        face, i = divmod(side, 3)
        ids = [level.faces[f"node_{j + 1}"][face] for j in (i, (i + 1) % 3)]
        edge = level.faces[f"edge_{i + 1}"][face]
        return level.place(
            "face", face
        ), f"edge_{i + 1}: found {edge}, expected one that joins nodes {ids[0]} and {ids[1]}"

    yield from some(index, text)


def check_edge_faces(level: LevelData) -> Iterator[Defects]:
    """Faces and edges name each other, and the face lies on the hand that the edge says."""
    index = np.flatnonzero(level.once(_sides)[1].ravel())

    def of_face(side: int) -> tuple[str, str]:
        edge = level.face_edges.ravel()[side]
        found = ", ".join(f"{hand} {level.edges[f'{hand}_face'][edge]}" for hand in HANDS)
        face = level.faces["face_id"][side // 3]
        return level.place(
            "edge", edge
        ), f"found faces {found}, expected face {face} on the hand where it lies (-1 is NULL)"

    yield from some(index, of_face)
    index = np.flatnonzero(((level.edge_faces >= 0) & (level.edge_sides < 0)).ravel())

    def of_edge(i: int) -> tuple[str, str]:
        edge, hand = divmod(i, 2)
        face = level.edges[f"{HANDS[hand]}_face"][edge]
        return level.place("edge", edge), f"{HANDS[hand]}_face: found {face}, expected a face that names this edge"

    yield from some(index, of_edge)


def check_lone_edges(level: LevelData) -> Iterator[Defects]:
    """An edge has a face on at least one hand."""
    alone = np.flatnonzero((level.edge_faces < 0).all(axis=1))
    yield from some(alone, lambda i: (level.place("edge", i), "found no face on either hand, expected at least one"))


def check_directions(level: LevelData) -> Iterator[Defects]:
    """Edges on borders run east or north, others with their only face, or that of lesser id, on the left."""
    left, right = (level.edges[f"{hand}_face"] for hand in HANDS)
    is_good = (left >= 0) & ((right < 0) | (left < right))
    border, _ = level.borders
    on = np.flatnonzero(border >= 0)
    start, end = (level.data.xyz[level.edge_nodes[on, i], :2] for i in range(2))
    is_good[on] = (end >= start).all(axis=1)
    expected = "expected east or north on a border, else the only face or that of lesser id to the left"
    yield from some(
        np.flatnonzero(~is_good),
        lambda i: (level.place("edge", i), f"found faces left {left[i]}, right {right[i]}, {expected}"),
    )


def check_links(level: LevelData) -> Iterator[Defects]:
    """The links of an edge are the next ones counter-clockwise round its start and its end."""
    expected = np.full(level.edge_links.shape, -1, np.int32)
    expected_links(level.face_edges, level.edge_faces, level.edge_sides, expected)
    outside = level.outside
    expected[outside.edge, outside.hand] = np.where(outside.follower >= 0, outside.edge[outside.follower], outside.edge)
    index = np.flatnonzero((expected != level.edge_links).ravel())

    def text(i: int) -> tuple[str, str]:
        edge, hand = divmod(i, 2)
        name, ids = f"{HANDS[hand]}_edge", level.edges["edge_id"]
        found = ids[level.edge_links[edge, hand]]
        where = ("start", "end")[hand]
        return level.place(
            "edge", edge
        ), f"{name}: found {found}, the next round its {where} is {ids[expected[edge, hand]]}"

    yield from some(index, text)


def check_unused_nodes(level: LevelData) -> Iterator[Defects]:
    """Every node of a level, and of coarser ones, is a corner of one of its faces."""
    is_used = np.zeros(len(level.data.xyz), np.bool_)
    is_used[level.face_nodes.ravel()] = True
    unused = np.flatnonzero(~is_used & (level.data.nodes["level"] <= level.level))
    yield from some(unused, lambda i: (level.node(i), "found a node of no face, expected a corner of one"))


def check_junctions(level: LevelData) -> Iterator[Defects]:
    """The T-junctions told are those that are there."""
    n_node, (edge, node) = len(level.data.xyz), level.junctions
    inside = level.slits.node >= 0
    found = np.unique(level.slits.long[inside] * n_node + level.slits.node[inside])
    told = edge.astype(np.int64) * n_node + node

    def text(key: int, message: str) -> tuple[str, str]:
        at, inside = divmod(key, n_node)
        return f"{level.place('edge', at)} node={level.data.nodes['node_id'][inside]}", message

    yield from some(np.setdiff1d(found, told), lambda key: text(key, "found a node inside the edge, expected its row"))
    yield from some(
        np.setdiff1d(told, found), lambda key: text(key, "found a row, but the node is not inside the edge")
    )
    message = "found edges along it that do not lead from end to end"
    yield from some(level.slits.broken, lambda i: (level.place("edge", i), message))


def check_gaps(level: LevelData) -> Iterator[Defects]:
    """The gap of a T-junction is the height of its node less that of its edge there."""
    told, (edge, node) = level.t_junctions["gap"], level.junctions
    start, end, xyz = (level.data.xyz[i] for i in (*level.edge_nodes[edge].T, node))
    way, to_node = end - start, xyz - start
    along = (way[:, :2] * to_node[:, :2]).sum(axis=1) / (way[:, :2] ** 2).sum(axis=1)
    gap = to_node[:, 2] - along * way[:, 2]
    slack = SAME_HEIGHT * (1.0 + np.abs(level.data.xyz[:, 2]).max(initial=0.0))
    slack += 2 * level.data.height_slack
    if level.data.is_single:
        steepness = np.abs(way[:, 2]) / np.hypot(way[:, 0], way[:, 1])
        slack = slack + 4 * level.data.place_slack * steepness
    yield from some(
        np.flatnonzero(~(np.abs(gap - told) <= slack)),
        lambda i: (
            f"{level.place('edge', edge[i])} node={level.t_junctions['node_id'][i]}",
            f"found a gap of {told[i]}, measured {gap[i]}",
        ),
    )


def check_adjacent(level: LevelData) -> Iterator[Defects]:
    """Methods that keep faces adjacent leave no T-junction."""
    method, n_junction = METHODS.get(level.data.metadata["method"]), len(level.t_junctions["gap"])
    if method is not None and method.adjacent and n_junction:
        message = f"found {n_junction} T-junctions, expected none of method {method.name}"
        yield one(f"level={level.level}", message)


REFERENCES = ("edge_reference", "face_reference")
RULES = (
    Rule("V301", "edge_repeated", ERROR, "R-160", "two edges join the same nodes", check_repeated_edges, "level",
         REFERENCES),
    Rule("V302", "edge_loop", ERROR, "R-160", "an edge has one node at both ends", check_loops, "level", REFERENCES),
    Rule("V303", "face_edges", ERROR, "R-170", "an edge of a face does not join the nodes of that side",
         check_face_edges, "level", REFERENCES),
    Rule("V304", "edge_faces", ERROR, "R-160", "an edge does not have a face on the hand where it lies",
         check_edge_faces, "level", ("face_edges",)),
    Rule("V305", "edge_alone", ERROR, "R-160", "an edge has no face", check_lone_edges, "level",
         ("edge_repeated", "edge_loop")),
    Rule("V306", "edge_direction", ERROR, "R-160", "an edge runs the wrong way", check_directions, "level",
         ("edge_faces", "edge_alone")),
    Rule("V307", "winged_link", ERROR, "R-161", "a link does not lead to the next edge round a node", check_links, "level",
         ("edge_faces", "edge_alone", "face_clockwise", "equal_places", "junction_reference")),
    Rule("V308", "node_unused", ERROR, "R-151", "a node is a corner of no face", check_unused_nodes, "level",
         (*REFERENCES, "equal_places")),
    Rule("V309", "t_junction", ERROR, "R-190", "T-junctions told and found differ", check_junctions, "level",
         ("edge_faces", "edge_alone", "face_clockwise", "equal_places", "junction_reference", "junction_forbidden")),
    Rule("V310", "junction_gap", ERROR, "R-190", "the gap at a T-junction is another", check_gaps, "level",
         ("t_junction",)),
    Rule("V311", "junction_forbidden", ERROR, "R-190", "a method that keeps faces adjacent has left T-junctions",
         check_adjacent, "level", ("junction_reference",)),
)  # fmt: skip
