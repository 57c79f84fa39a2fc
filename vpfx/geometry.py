"""Measures of faces: pure functions on arrays."""

from __future__ import annotations

import numpy as np
import shapely
from numba import njit
from numpy.typing import NDArray

__all__ = ["LEAST_SHARED", "ON_EDGE", "barycentric", "face_shapes", "face_slopes", "heights_on_faces", "shared_areas"]

Floats = NDArray[np.float64]

ON_EDGE = 1e-9
"""Least share of a corner in a place inside a face; with less, the place lies on the edge across."""

LEAST_SHARED = 1e-9
"""Of the smaller of two faces: what they share at least if they do not only touch."""


@njit(nogil=True, cache=True)
def _slopes(nodes, face_nodes, slope, aspect):
    """Fill slope and aspect, degrees, of every face; NaN aspect for level ground."""
    for face in range(len(face_nodes)):
        a, b, c = face_nodes[face]
        x1, y1, z1 = nodes[b, 0] - nodes[a, 0], nodes[b, 1] - nodes[a, 1], nodes[b, 2] - nodes[a, 2]
        x2, y2, z2 = nodes[c, 0] - nodes[a, 0], nodes[c, 1] - nodes[a, 1], nodes[c, 2] - nodes[a, 2]
        area = x1 * y2 - x2 * y1
        east, north = (z1 * y2 - z2 * y1) / area, (z2 * x1 - z1 * x2) / area
        steepness = np.sqrt(east * east + north * north)
        slope[face] = np.degrees(np.arctan(steepness))
        direction = np.degrees(np.arctan2(-east, -north)) if steepness > 0.0 else np.nan
        aspect[face] = direction + 360.0 if direction < 0.0 else direction


def face_slopes(nodes: Floats, face_nodes: NDArray[np.int32]) -> tuple[Floats, Floats]:
    """Slope and aspect of each face.

    Parameters
    ----------
    nodes : float64 (n_node, 3)
        x, y and z in metres.
    face_nodes : int32 (n_face, 3)
        Node indices, counter-clockwise seen from above.

    Returns
    -------
    slope : float64 (n_face,)
        Degrees in [0, 90); 0 is level ground.
    aspect : float64 (n_face,)
        Direction of steepest descent, degrees clockwise from grid north in [0, 360); NaN for level ground.

    Examples
    --------
    A plane that rises one metre per metre eastward, so falls to the west:

    >>> face_slopes(np.array([[0, 0, 0], [1, 0, 1], [0, 1, 0.0]]), np.array([[0, 1, 2]]))
    (array([45.]), array([270.]))
    """
    slope, aspect = np.empty(len(face_nodes)), np.empty(len(face_nodes))
    _slopes(np.ascontiguousarray(nodes, np.float64), np.ascontiguousarray(face_nodes, np.int32), slope, aspect)
    return slope, aspect


@njit(nogil=True, cache=True, error_model="numpy")
def _shapes(nodes, face_nodes, sliveriness, smallest):
    """Fill perimeter² / area and the smallest angle, degrees, of every face."""
    for face in range(len(face_nodes)):
        perimeter, least, area = 0.0, np.inf, 0.0
        for i in range(3):
            a, b, c = face_nodes[face, i], face_nodes[face, (i + 1) % 3], face_nodes[face, (i + 2) % 3]
            x1, y1 = nodes[b, 0] - nodes[a, 0], nodes[b, 1] - nodes[a, 1]
            x2, y2 = nodes[c, 0] - nodes[a, 0], nodes[c, 1] - nodes[a, 1]
            area = x1 * y2 - y1 * x2
            perimeter += np.hypot(x1, y1)
            least = min(least, np.arctan2(area, x1 * x2 + y1 * y2))
        sliveriness[face] = perimeter * perimeter / (area / 2.0)
        smallest[face] = np.degrees(least)


def face_shapes(nodes: Floats, face_nodes: NDArray[np.int32]) -> tuple[Floats, Floats]:
    """Sliveriness and smallest angle of each face, seen from above.

    Parameters
    ----------
    nodes : float64 (n_node, 2 or 3)
        x and y in metres.
    face_nodes : int32 (n_face, 3)

    Returns
    -------
    sliveriness : float64 (n_face,)
        Perimeter² / area; 12√3 = 20.785 for an equilateral triangle. Source: paper-facts §4.
    smallest_angle : float64 (n_face,)
        Degrees.

    Examples
    --------
    >>> face_shapes(np.array([[0, 0], [1, 0], [0, 1.0]]), np.array([[0, 1, 2]]))
    (array([23.3137085]), array([45.]))
    """
    sliveriness, smallest = np.empty(len(face_nodes)), np.empty(len(face_nodes))
    _shapes(np.ascontiguousarray(nodes, np.float64), np.ascontiguousarray(face_nodes, np.int32), sliveriness, smallest)
    return sliveriness, smallest


def barycentric(corner: Floats, places: Floats) -> Floats:
    """Shares of the corners of faces in places, one face a place.

    Parameters
    ----------
    corner : float64 (n, 3, 2 or 3)
    places : float64 (n, 2)

    Returns
    -------
    float64 (n, 3)
        Each row sums up to 1; none is negative in the face.

    Examples
    --------
    >>> barycentric(np.array([[[0, 0], [4, 0], [0, 4.0]]]), np.array([[1, 1.0]])).tolist()
    [[0.5, 0.25, 0.25]]
    """
    to_b, to_c, to_place = (
        (corner[:, 1] - corner[:, 0])[:, :2],
        (corner[:, 2] - corner[:, 0])[:, :2],
        places - corner[:, 0, :2],
    )
    area = to_b[:, 0] * to_c[:, 1] - to_b[:, 1] * to_c[:, 0]
    share = np.empty((len(places), 3))
    share[:, 1] = (to_place[:, 0] * to_c[:, 1] - to_place[:, 1] * to_c[:, 0]) / area
    share[:, 2] = (to_b[:, 0] * to_place[:, 1] - to_b[:, 1] * to_place[:, 0]) / area
    share[:, 0] = 1.0 - share[:, 1] - share[:, 2]
    return share


def heights_on_faces(nodes: Floats, face_nodes: NDArray[np.int32], face: NDArray[np.integer], places: Floats) -> Floats:
    """Heights of faces at places in or on them.

    Parameters
    ----------
    nodes : float64 (n_node, 3)
    face_nodes : int32 (n_face, 3)
    face : integers (n,)
        The face to take for each place.
    places : float64 (n, 2)

    Returns
    -------
    float64 (n,)

    Notes
    -----
    Where a place lies on an edge, only the ends of the edge count, from west to east or else from south to north, so both
    faces of the edge give the same float.

    Examples
    --------
    >>> nodes = np.array([[0, 0, 0], [4, 0, 8], [0, 4, 0.0]])
    >>> heights_on_faces(nodes, np.array([[0, 1, 2]]), np.array([0, 0]), np.array([[1, 0], [1, 1.0]]))
    array([2., 2.])
    """
    corner = nodes[face_nodes[face]]
    share = barycentric(corner, places)
    height = (share * corner[..., 2]).sum(axis=1)
    off = share.argmin(axis=1)
    on = np.flatnonzero(share[np.arange(len(places)), off] < ON_EDGE)
    start, end = corner[on, (off[on] + 1) % 3], corner[on, (off[on] + 2) % 3]
    is_turned = (start[:, 0] > end[:, 0]) | ((start[:, 0] == end[:, 0]) & (start[:, 1] > end[:, 1]))
    start, end = np.where(is_turned[:, None], end, start), np.where(is_turned[:, None], start, end)
    axis = (np.abs(end[:, 1] - start[:, 1]) > np.abs(end[:, 0] - start[:, 0])).astype(np.int64)
    row = np.arange(len(on))
    along = (places[on, axis] - start[row, axis]) / (end[row, axis] - start[row, axis])
    height[on] = start[:, 2] + along * (end[:, 2] - start[:, 2])
    return height


def _name_faces(face_nodes: NDArray[np.int32]) -> NDArray[np.void]:
    """Return the nodes of each face, in order, as one value."""
    nodes = np.ascontiguousarray(np.sort(face_nodes, axis=1), dtype=">i4")  # bytes compare like numbers
    return nodes.view(np.dtype((np.void, 12))).ravel()


def shared_areas(
    nodes: Floats, parent_nodes: NDArray[np.int32], child_nodes: NDArray[np.int32]
) -> tuple[NDArray[np.int32], Floats]:
    """Pairs of faces of two levels that share area, and how much.

    Parameters
    ----------
    nodes : float64 (n_node, 2 or 3)
    parent_nodes, child_nodes : int32 (n, 3)
        Faces of the two levels.

    Returns
    -------
    pairs : int32 (n_pair, 2)
        Parent and child, sorted by child, then parent.
    area : float64 (n_pair,)
        In squared units of the nodes.

    Notes
    -----
    By GEOS, through shapely. Cost: O(n log n); faces with the same nodes cost nothing.

    Examples
    --------
    Two ways to cut a square:

    >>> square = np.array([[0, 0], [2, 0], [2, 2], [0, 2.0]])
    >>> one, other = np.array([[0, 1, 2], [0, 2, 3]], np.int32), np.array([[0, 1, 3], [1, 2, 3]], np.int32)
    >>> shared_areas(square, one, other)[1]
    array([1., 1., 1., 1.])
    """
    _, same_parent, same_child = np.intersect1d(
        _name_faces(parent_nodes), _name_faces(child_nodes), assume_unique=True, return_indices=True
    )
    sames = (parent_nodes, same_parent), (child_nodes, same_child)
    others = [np.setdiff1d(np.arange(len(faces)), same) for faces, same in sames]
    parents, children = (
        shapely.polygons(nodes[:, :2][faces[other][:, [0, 1, 2, 0]]])
        for faces, other in zip((parent_nodes, child_nodes), others, strict=True)
    )
    child, parent = shapely.STRtree(parents).query(children, predicate="intersects")
    area = shapely.area(shapely.intersection(parents[parent], children[child]))
    least = np.minimum(shapely.area(parents)[parent], shapely.area(children)[child])
    is_pair = area > LEAST_SHARED * least
    same_area = shapely.area(shapely.polygons(nodes[:, :2][child_nodes[same_child][:, [0, 1, 2, 0]]]))
    pairs = np.stack(
        [
            np.concatenate([others[0][parent[is_pair]], same_parent]),
            np.concatenate([others[1][child[is_pair]], same_child]),
        ],
        axis=1,
    ).astype(np.int32)
    area = np.concatenate([area[is_pair], same_area])
    order = np.lexsort(pairs.T)
    return pairs[order], area[order]
