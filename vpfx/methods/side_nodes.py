"""Nodes on sides of faces that are cut each by itself: faces that break the same side one after the other share its node."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from vpfx.methods.forest import Forest

__all__ = ["SideNodes"]

Sides = NDArray[np.int64]


class SideNodes:
    """The node that breaks the side between two nodes, whichever face asked first.

    Parameters
    ----------
    forest : Forest
        Its faces do not know their neighbours; it gets the nodes.

    Examples
    --------
    >>> forest = Forest(np.eye(3), np.array([[0, 1, 2], [2, 1, 0]], np.int32), np.zeros(2, bool), is_joined=False)
    >>> def middles(sides):
    ...     ends = forest.face_nodes[sides // 3, sides % 3], forest.face_nodes[sides // 3, (sides + 1) % 3]
    ...     return (forest.nodes[ends[0]] + forest.nodes[ends[1]]) / 2
    >>> SideNodes(forest).break_sides(np.arange(6), middles)
    >>> forest.side_node.tolist()
    [3, 5, 4, 5, 3, 4]
    """

    def __init__(self, forest: Forest) -> None:
        self._forest = forest
        self._keys = np.empty(0, np.int64)
        self._nodes = np.empty(0, np.int32)

    def break_sides(self, sides: Sides, place: Callable[[Sides], NDArray[np.float64]]) -> None:
        """Break sides by the nodes known, and by new ones.

        Parameters
        ----------
        sides : int64 (n,)
        place : callable
            Sides → places of new nodes, (n, 3).
        """
        forest = self._forest
        start, end = forest.face_nodes[sides // 3, sides % 3], forest.face_nodes[sides // 3, (sides % 3 + 1) % 3]
        keys = (np.minimum(start, end).astype(np.int64) << 32) + np.maximum(start, end)
        is_new = ~np.isin(keys, self._keys)
        new_keys, first = np.unique(keys[is_new], return_index=True)
        first_node = forest.add_nodes(place(sides[is_new][first]))
        keys_known = np.concatenate([self._keys, new_keys])
        nodes = np.concatenate([self._nodes, np.arange(first_node, forest.n_node, dtype=np.int32)])
        order = np.argsort(keys_known)
        self._keys, self._nodes = keys_known[order], nodes[order]
        forest.side_node[sides] = self._nodes[np.searchsorted(self._keys, keys)]
