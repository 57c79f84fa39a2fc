"""Single precision: rounding, and the exact check that it leaves every face as it is (specs/evpf.md E-201)."""

from __future__ import annotations

from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from vpfx.evpf.numbering import TileNumbers
from vpfx.evpf.planar import Sides, by_direction
from vpfx.exact import orientations
from vpfx.model import Extent

__all__ = ["find_broken", "rounded"]

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]


def rounded(places: Floats) -> Floats:
    """Round numbers to the nearest ones of single precision; infinite where they have none.

    Examples
    --------
    >>> rounded(np.array([0.1, 4e6, 1e39])).tolist()
    [0.10000000149011612, 4000000.0, inf]
    """
    with np.errstate(over="ignore"):
        return places.astype(np.float32).astype(np.float64)


def find_broken(
    xyz: Floats, numbers: TileNumbers, edge_nodes: Ints, borders: Extent, exact: Floats
) -> tuple[int, str] | None:
    """Find the first face of a tile that rounding breaks.

    Parameters
    ----------
    xyz : float64 (n_node, 3)
        Rounded places.
    numbers : TileNumbers
    edge_nodes : int64 (n_edge, 2)
    borders : Extent
        Sides of the tile that are borders to other tiles, not rounded; NaN where there is none.
    exact : float64 (n_node, 3)
        Places before.

    Returns
    -------
    tuple of int and str, or None
        Index of the face, and what becomes of it.

    Notes
    -----
    What is checked makes the rounded mesh a planar graph again: every face is counter-clockwise, no two nodes have one place,
    no two edges of the outline meet but in their nodes, and no node comes to lie on a border. Rounding keeps order, so no
    node crosses one.
    """
    xy, sides = xyz[:, :2], numbers.sides
    lost = _faces_at(sides, ~np.isfinite(xyz).all(axis=1))
    if len(lost):
        return int(lost[0]), "has no place"
    found = [
        (_faces_at(sides, _merged(xy)), "has a node in the place of another node"),
        (_turned(xy, numbers), "has no area, or turns over"),
        (_faces_at(sides, _on_border(xy, exact, borders)), "comes to lie on the border of the tile"),
    ]
    if not any(len(faces) for faces, _ in found):
        found.append((_crossed(xy, numbers, edge_nodes), "meets another edge of the outline"))
    broken = [(int(faces[0]), what) for faces, what in found if len(faces)]
    return min(broken, key=lambda one: one[0]) if broken else None


def _faces_at(sides: Sides, is_bad: Any) -> Ints:
    """Faces with a bad node, ascending."""
    side = np.flatnonzero(is_bad[sides.start])
    return np.unique(np.searchsorted(sides.first, side, side="right") - 1)


def _merged(xy: Floats) -> NDArray[np.bool_]:
    """Nodes in the place of another one."""
    places = np.ascontiguousarray(xy + 0.0).view([("x", "f8"), ("y", "f8")]).ravel()  # no negative zero
    _, index, count = np.unique(places, return_inverse=True, return_counts=True)
    return count[index.ravel()] > 1


def _turned(xy: Floats, numbers: TileNumbers) -> Ints:
    """Faces that are not counter-clockwise; one with nodes inside its sides is to be seen whole from its middle."""
    sides = numbers.sides
    n_side = np.diff(sides.first)
    plain = np.flatnonzero(n_side == 3)
    a, b, c = (xy[sides.start[sides.first[plain] + i]] for i in range(3))
    turned = plain[orientations(a, b, c) <= 0]
    several = np.flatnonzero(n_side > 3)
    corners = np.stack([numbers.faces[f"node_{i}"][several] for i in (1, 2, 3)], axis=1)
    middle = xy[np.searchsorted(numbers.node_ids, corners)].sum(axis=1)  # three times; if rounded, a place as good
    side = np.flatnonzero(np.repeat(n_side > 3, n_side))
    of = np.repeat(np.arange(len(several)), n_side[several])
    start, end = 3.0 * xy[sides.start[side]], 3.0 * xy[numbers.side_end[side]]
    hidden = several[of[orientations(start, end, middle[of]) <= 0]]
    return np.unique(np.concatenate([turned, hidden]))


def _on_border(xy: Floats, exact: Floats, borders: Extent) -> NDArray[np.bool_]:
    """Nodes that come to lie on a border."""
    lines = np.array(borders)
    x_y = [0, 1, 0, 1]
    return ((xy[:, x_y] == rounded(lines)) & (exact[:, x_y] != lines)).any(axis=1)


def _crossed(xy: Floats, numbers: TileNumbers, edge_nodes: Ints) -> Ints:
    """Faces whose edges on the outline meet others but in nodes, or lie on them."""
    edge, side, count = np.unique(numbers.sides.edge, return_index=True, return_counts=True)
    edge, side = edge[count == 1], side[count == 1]
    nodes = edge_nodes[edge]
    lines = shapely.linestrings(xy[nodes])
    one, other = shapely.STRtree(lines).query(lines, predicate="intersects")
    shares_node = (nodes[one][:, :, None] == nodes[other][:, None, :]).any(axis=(1, 2))
    order, same = by_direction(xy, nodes.T.ravel(), nodes[:, ::-1].T.ravel())
    bad = np.concatenate([one[~shares_node], order[same] % max(len(edge), 1)])
    return np.unique(np.searchsorted(numbers.sides.first, side[bad], side="right") - 1)
