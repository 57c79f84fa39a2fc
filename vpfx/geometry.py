"""Measures of faces: pure functions on arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["face_shapes", "face_slopes"]

Floats = NDArray[np.float64]


def _gradients(nodes: Floats, face_nodes: NDArray[np.int32]) -> tuple[Floats, Floats]:
    a, b, c = (nodes[face_nodes[:, i]] for i in range(3))
    p, q = b - a, c - a
    area = p[:, 0] * q[:, 1] - q[:, 0] * p[:, 1]
    east = (p[:, 2] * q[:, 1] - q[:, 2] * p[:, 1]) / area
    north = (q[:, 2] * p[:, 0] - p[:, 2] * q[:, 0]) / area
    return east, north


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
    east, north = _gradients(nodes, face_nodes)
    steepness = np.hypot(east, north)
    aspect = np.degrees(np.arctan2(-east, -north)) % 360.0
    return np.degrees(np.arctan(steepness)), np.where(steepness > 0, aspect, np.nan)


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
