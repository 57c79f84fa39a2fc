"""Measures of faces: pure functions on arrays."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["face_shapes", "face_slopes"]

Floats = NDArray[np.float64]


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
    corner = nodes[:, :2][face_nodes]
    ahead = np.roll(corner, -1, axis=1) - corner
    length = np.hypot(ahead[..., 0], ahead[..., 1])
    back = -np.roll(ahead, 1, axis=1)
    cross = ahead[..., 0] * back[..., 1] - ahead[..., 1] * back[..., 0]
    dot = (ahead * back).sum(axis=-1)
    return length.sum(axis=1) ** 2 / (cross[:, 0] / 2), np.degrees(np.arctan2(cross, dot)).min(axis=1)
