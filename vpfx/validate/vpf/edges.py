"""Rules V72x: nodes and edges of a tile, from topology level 1 on; references between its primitives."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from vpfx.validate.report import ERROR, WARNING, Defects, Rule, some
from vpfx.validate.vpf.stars import wrong_links
from vpfx.validate.vpf.tile import Ids, TileData

__all__ = ["RULES"]

MOST_DEGREES = (360.0, 90.0)
"""Greatest longitude and latitude. A library over the antimeridian may go on beyond 180."""

REFERENCES = (
    ("edg", "start_node", "cnd", 1), ("edg", "end_node", "cnd", 1), ("edg", "right_face", "fac", 3),
    ("edg", "left_face", "fac", 3), ("edg", "right_edge", "edg", 1), ("edg", "left_edge", "edg", 1),
    ("cnd", "first_edge", "edg", 1), ("end", "containing_face", "fac", 3), ("fac", "ring_ptr", "rng", 3),
    ("rng", "face_id", "fac", 3), ("rng", "start_edge", "edg", 3),
)  # fmt: skip
"""Columns that name rows: table, column, table of the rows, least topology level."""
MAY_BE_NONE = {"first_edge", "ring_ptr", "start_edge"}
"""Columns in which no row may be named: other rules look at where."""


def check_references(tile: TileData) -> Iterator[Defects]:
    """Primitives name rows that exist."""
    for table, column, other, level in REFERENCES:
        ids, count = tile.column(table, column), tile.coverage.count(other, tile.tile_id)
        if ids is None or count is None or tile.level < level:
            continue
        least = 0 if column in MAY_BE_NONE else 1
        wrong = np.flatnonzero((ids < least) | (ids > count))
        yield from some(wrong, _describe_reference(f"{tile.place(table)} column={column}", ids, other, count))


def _describe_reference(where: str, ids: Ids, other: str, count: int) -> Callable[[int], tuple[str, str]]:
    def describe(i: int) -> tuple[str, str]:
        found = f"row {ids[i]}" if ids[i] else "no row"
        return f"{where} row={i + 1}", f"found {found} of {other}, expected one of its {count} rows"

    return describe


def check_ends(tile: TileData) -> Iterator[Defects]:
    """Edges begin and end where their nodes are, bit for bit."""
    edges, nodes = tile.edges, tile.node_places
    if edges is None or edges.nodes is None or nodes is None:
        return
    starts, xyz = edges.places
    (has_places,) = np.nonzero(np.diff(starts))
    for end, (column, at) in enumerate((("start_node", starts[:-1]), ("end_node", starts[1:] - 1))):
        node = edges.nodes[:, end] - 1
        row = has_places[(node[has_places] >= 0) & (node[has_places] < len(nodes))]
        here, there = xyz[at[row]], nodes[node[row]]
        is_wrong = ((here != there) & ~(np.isnan(here) & np.isnan(there))).any(axis=1)

        def describe(i: int, at: Ids = at, node: Ids = node, column: str = column) -> tuple[str, str]:
            found = f"found {_shown(xyz[at[i]])}, expected {_shown(nodes[node[i]])}, the place of node {node[i] + 1}"
            return f"{tile.place('edg')} column={column} row={i + 1}", found

        yield from some(row[is_wrong], describe)


def _shown(place: np.ndarray) -> str:
    """A place in a message; z only if it is a number."""
    return "(" + ", ".join(repr(float(number)) for number in place if number == number) + ")"


def check_links(tile: TileData) -> Iterator[Defects]:
    """``right_edge`` is the next edge counter-clockwise round the end node, ``left_edge`` round the start node."""
    graph, edges = tile.graph, tile.edges
    if graph is None or edges is None or edges.links is None:
        return
    link = np.ascontiguousarray(edges.links[:, ::-1, 0]).ravel() - 1
    wrong, expected = wrong_links(graph.bucket, graph.star, graph.is_beside, link)

    def describe(i: int) -> tuple[str, str]:
        side = int(wrong[i])
        column, end = ("right_edge", "end_node") if side % 2 else ("left_edge", "start_node")
        node = graph.nodes.ravel()[side] + 1
        message = (
            f"found edge {link[side] + 1}, expected {expected[i] + 1}, the next counter-clockwise round {end} {node}"
        )
        return f"{tile.place('edg')} column={column} row={side // 2 + 1}", message

    yield from some(np.arange(len(wrong)), describe)


def check_first_edges(tile: TileData) -> Iterator[Defects]:
    """The first edge of a node touches it."""
    graph, first = tile.graph, tile.column("cnd", "first_edge")
    if graph is None or first is None:
        return
    edge = first - 1
    is_known = (edge >= 0) & (edge < len(graph.nodes))
    is_touched = np.zeros(len(edge), bool)
    own = np.arange(len(edge))
    is_touched[is_known] = (graph.nodes[edge[is_known]] == own[is_known, None]).any(axis=1)
    is_wrong = ~is_touched & (np.diff(graph.bucket) > 0)

    def describe(i: int) -> tuple[str, str]:
        found = f"edge {first[i]}, which joins nodes {_pair(graph.nodes[edge[i]] + 1)}" if is_known[i] else "no edge"
        expected = f"expected one that touches it, such as {graph.star[graph.bucket[i]] // 2 + 1}"
        return f"{tile.place('cnd')} column=first_edge row={i + 1}", f"found {found}, {expected}"

    yield from some(np.flatnonzero(is_wrong), describe)


def _pair(pair: Ids) -> str:
    return f"{pair[0]} and {pair[1]}"


def check_lone_nodes(tile: TileData) -> Iterator[Defects]:
    """Connected nodes are ends of edges."""
    if tile.graph is not None:
        lone = np.flatnonzero(np.diff(tile.graph.bucket) == 0)
        yield from some(
            lone, lambda i: (f"{tile.place('cnd')} row={i + 1}", "found no edge that ends there, expected one")
        )


def check_edge_places(tile: TileData) -> Iterator[Defects]:
    """An edge has two different places at least, and all its places are numbers."""
    edges = tile.edges
    if edges is None:
        return
    starts, xyz = edges.places

    def describe(i: int) -> tuple[str, str]:
        own = xyz[starts[i] : starts[i + 1], :2]
        found = (
            f"found {len(own)} places, all the same" if np.isfinite(own).all() else "found a place that is no number"
        )
        return f"{tile.place('edg')} column=coordinates row={i + 1}", f"{found}, expected two that differ"

    yield from some(tile.bad_edges, describe)


def check_degrees(tile: TileData) -> Iterator[Defects]:
    """Geographic coordinates are degrees."""
    library = tile.coverage.library
    if library is None or library.data_type != "GEO":
        return
    for table, xyz in (("cnd", tile.node_places), ("end", tile.entity_places)):
        if xyz is not None:
            wrong = np.flatnonzero((np.abs(xyz[:, :2]) > MOST_DEGREES).any(axis=1))
            yield from some(wrong, _describe_degrees(f"{tile.place(table)} column=coordinate", xyz))


def _describe_degrees(where: str, xyz: np.ndarray) -> Callable[[int], tuple[str, str]]:
    expected = f"expected degrees up to ±{MOST_DEGREES[0]:g} and ±{MOST_DEGREES[1]:g}: data_type in grt is GEO"
    return lambda i: (f"{where} row={i + 1}", f"found {_shown(xyz[i, :2])}, {expected}")


GRAPH = ("primitive_references", "edge_ends", "edge_places")

RULES = (
    Rule("V720", "primitive_references", ERROR, "V-500", "a primitive names a row that does not exist", check_references,
         "tile", needs=("table_header", "table_rows", "table_columns")),
    Rule("V721", "edge_ends", ERROR, "V-501", "an edge does not begin or end where its node is", check_ends, "tile",
         needs=("primitive_references",)),
    Rule("V722", "edge_links", ERROR, "V-502", "a link is not the next edge counter-clockwise", check_links, "tile",
         needs=GRAPH),
    Rule("V723", "first_edges", ERROR, "V-502", "the first edge of a node does not touch it", check_first_edges, "tile",
         needs=GRAPH),
    Rule("V724", "lone_nodes", WARNING, "V-502", "a connected node ends no edge", check_lone_nodes, "tile", needs=GRAPH),
    Rule("V725", "edge_places", ERROR, "V-501", "an edge is no line", check_edge_places, "tile",
         needs=("table_header", "table_rows")),
    Rule("V726", "degrees", WARNING, "V-501", "geographic coordinates are no degrees", check_degrees, "tile",
         needs=("table_header", "table_rows")),
)  # fmt: skip
