"""Faces that are cut again and again: one tree for each start face, whose leaves are the mesh.

Flat arrays that only grow: children stand behind all faces made before, those of one face side by side, and a face that is
cut stays. So a pass costs what it cuts, not what there is. `vpfx.methods.undo` puts fewer children in the same places.
Side ``s = 3 * face + i`` runs from node i of a face to the next.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vpfx.methods.cut import MOST_CHILDREN, cut_faces
from vpfx.topology import NONE, find_twins

__all__ = ["Forest"]

Faces = NDArray[np.int32]


class Forest:
    """A mesh in the making.

    Parameters
    ----------
    nodes : float64 (n_node, 3)
        u, v in posts, height in metres.
    face_nodes : int32 (n_face, 3)
        Start faces, counter-clockwise.
    is_filled : bool (n_face,)
    is_joined : bool
        Whether faces know their neighbours; else side_twin is -1 throughout.

    Attributes
    ----------
    nodes : float64 (≥ n_node, 3)
    face_nodes : int32 (≥ n_face, 3)
    side_twin : int32 (≥ 3 * n_face,)
        The side of the neighbouring leaf that runs the other way, -1 where there is none; of a face that is cut: as it was.
    side_node : int32 (≥ 3 * n_face,)
        The node that breaks the side, -1 for none.
    side_state : int8 (≥ 3 * n_face,)
        What the method knows of the side, see `vpfx.methods.breaks`.
    face_error : float64 (≥ n_face,)
        Greatest error found at the posts of the face; infinite if it was not scanned since it was made.
    slot : int32 (≥ n_face,)
        Place of the face in a list of the pass, -1 for none.
    is_filled : bool (≥ n_face,)
    n_node, n_face : int
        Nodes and faces so far; behind them the arrays have room for more.

    Examples
    --------
    >>> forest = Forest(np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32), np.zeros(1, bool))
    >>> forest.side_node[1] = forest.add_nodes(np.array([[1.0, 1.0, 0.0]]))
    >>> forest.cut(np.array([0], np.int32), np.array([-1], np.int32), np.array([False]))
    array([1, 2], dtype=int32)
    >>> forest.leaves(np.array([0], np.int32))
    (array([1, 2], dtype=int32), array([0, 0], dtype=int32))
    """

    def __init__(
        self, nodes: NDArray[np.float64], face_nodes: Faces, is_filled: NDArray[np.bool_], is_joined: bool = True
    ) -> None:
        n_face = len(face_nodes)
        self.n_node, self.n_face = len(nodes), n_face
        self.nodes = nodes
        self.face_nodes = face_nodes
        self.is_joined = is_joined
        self.side_twin = find_twins(face_nodes, len(nodes)) if is_joined else np.full(3 * n_face, NONE, np.int32)
        self.side_node = np.full(3 * n_face, NONE, np.int32)
        self.side_state = np.zeros(3 * n_face, np.int8)
        self.face_error = np.full(n_face, np.inf)
        self.slot = np.full(n_face, NONE, np.int32)
        self.is_filled = is_filled
        self._first_child = np.full(n_face, NONE, np.int32)
        self._n_child = np.zeros(n_face, np.int8)

    @property
    def mesh(self) -> tuple[Any, Any, Any]:
        """Nodes, face_nodes and side_twin, as kernels take them."""
        return self.nodes, self.face_nodes, self.side_twin

    @property
    def tree(self) -> tuple[Any, Any, Any, Any, Any, Any]:
        """Nodes, face_nodes, side_twin, side_node, and first and number of the children of each face, as kernels take them."""
        return *self.mesh, self.side_node, self._first_child, self._n_child

    def reserve_nodes(self, n: int) -> None:
        """Make room for n more nodes."""
        self.nodes = _grown(self.nodes, self.n_node + n)

    def add_nodes(self, nodes: NDArray[np.float64]) -> int:
        """Add nodes and return the index of the first."""
        first = self.n_node
        self.reserve_nodes(len(nodes))
        self.n_node += len(nodes)
        self.nodes[first : self.n_node] = nodes
        return first

    def cut(self, faces: Faces, inner_node: Faces, is_flipped: NDArray[np.bool_]) -> Faces:
        """Cut leaves by rules 1 to 4 and return their children; arguments as in `vpfx.methods.cut.cut_faces`."""
        first = self.n_face
        most = first + MOST_CHILDREN * len(faces)
        for name, width in (("face_nodes", 1), ("side_twin", 3), ("side_node", 3), ("side_state", 3), ("face_error", 1),
                            ("slot", 1), ("is_filled", 1), ("_first_child", 1), ("_n_child", 1)):  # fmt: skip
            setattr(self, name, _grown(getattr(self, name), width * most))
        self.n_face = cut_faces(
            faces, inner_node, is_flipped, self.face_nodes, self.side_twin, self.side_node, self._first_child,
            self._n_child, self.slot, first,
        )  # fmt: skip
        if not self.is_joined:
            self.side_twin[3 * first : 3 * self.n_face] = NONE
        self.side_state[3 * first : 3 * self.n_face] = 0
        self.face_error[first : self.n_face] = np.inf
        self.is_filled[first : self.n_face] = np.repeat(self.is_filled[faces], self._n_child[faces])
        return np.arange(first, self.n_face, dtype=np.int32)

    def is_leaf(self, faces: Faces) -> NDArray[np.bool_]:
        """Tell which faces are not cut."""
        return self._n_child[faces] == 0

    def leaves(self, roots: Faces) -> tuple[Faces, Faces]:
        """Return the leaves under some faces, in the order of the tree, and for each the index of its face in `roots`."""
        return find_leaves(roots, self._first_child, self._n_child, self.n_face)


def _grown(array: NDArray[Any], n: int) -> NDArray[Any]:
    """Return an array with room for n entries: itself, or a copy at least half as large again."""
    if n <= len(array):
        return array
    larger = np.empty((max(n, len(array) * 3 // 2), *array.shape[1:]), array.dtype)
    larger[: len(array)] = array
    return larger


@njit(nogil=True, cache=True)
def find_leaves(roots, first_child, n_child, n_face):  # type: ignore[no-untyped-def]
    """Return the leaves under each root, those of a child before those of the next, and the index of their root.

    Cost: O(faces under the roots).
    """
    leaves, root_of = np.empty(n_face, np.int32), np.empty(n_face, np.int32)
    stack = np.empty(n_face, np.int32)
    n = 0
    for i in range(len(roots)):
        stack[0] = roots[i]
        top = 1
        while top > 0:
            top -= 1
            face = stack[top]
            if n_child[face] == 0:
                leaves[n], root_of[n] = face, i
                n += 1
            for j in range(n_child[face]):
                stack[top] = first_child[face] + n_child[face] - 1 - j
                top += 1
    return leaves[:n].copy(), root_of[:n].copy()
