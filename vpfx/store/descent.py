"""Finding faces of a level from the coarsest down, so that what is read grows with what is found."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import NotFoundError, StoreFormatError
from vpfx.model import Extent

if TYPE_CHECKING:
    from vpfx.store.reader import StoreReader

__all__ = ["Mesh", "descend", "faces_near", "mesh_of"]

Floats = NDArray[np.float64]
Rows = dict[str, NDArray[Any]]
Test = Callable[[Floats], NDArray[np.bool_]]

MOST_OF_TILES = 0.25
"""Share of the tiles' area from which on they are read whole: the way down reads about a third more, in smaller pieces."""

MOST_PLACES = 32
"""Places that faces are compared with one by one; more are taken by the rectangle they span."""

SLACK = 64
"""Units in the last place by which a face may lie outside its parent (specs/format.md R-181 has 2), over all levels."""


class Mesh(NamedTuple):
    """Rows of the table `face` with their nodes.

    Attributes
    ----------
    faces : dict of str to array (n_face,)
        As of `Store.fetch`.
    nodes : dict of str to array (n_node,)
        Of the table `node`, each once, by ascending ids.
    face_nodes : int32 (n_face, 3)
    """

    faces: Rows
    nodes: Rows
    face_nodes: NDArray[np.int32]

    @property
    def xyz(self) -> Floats:
        """Places of the nodes, (n_node, 3)."""
        return np.stack([self.nodes[axis] for axis in "xyz"], axis=1)

    def part(self, keep: NDArray[np.bool_]) -> Mesh:
        """Some of the faces, and their nodes."""
        used, index = np.unique(self.face_nodes[keep], return_inverse=True)
        return Mesh(
            {name: values[keep] for name, values in self.faces.items()},
            {name: values[used] for name, values in self.nodes.items()},
            index.reshape(-1, 3).astype(np.int32),
        )


def mesh_of(store: StoreReader, faces: Rows) -> Mesh:
    """Read the nodes of faces.

    Raises
    ------
    StoreFormatError
        A corner is no node.
    """
    corners = np.stack([faces[f"node_{i}"] for i in (1, 2, 3)], axis=1)
    node_ids, index = np.unique(corners, return_inverse=True)
    try:
        nodes = store.fetch("node", node_ids)
    except NotFoundError as error:
        message = f"found faces with corners that are no nodes ({error})"
        raise StoreFormatError(str(store.path), "table face", message, "R-170") from None
    return Mesh(faces, nodes, index.reshape(-1, 3).astype(np.int32))


def _touches_box(box: Extent, slack: float) -> Test:
    """Return a test: whether the bounding box of a face touches a rectangle."""

    def touches(corner: Floats) -> NDArray[np.bool_]:
        low, high = corner.min(axis=1), corner.max(axis=1)
        found: NDArray[np.bool_] = (low[:, 0] <= box.max_x + slack) & (high[:, 0] >= box.min_x - slack)
        return found & (low[:, 1] <= box.max_y + slack) & (high[:, 1] >= box.min_y - slack)

    return touches


def faces_near(store: StoreReader, level: int, places: Floats, away: float = 0.0) -> Mesh:
    """Find faces of a level among which are all that places lie in or on.

    Parameters
    ----------
    store : StoreReader
    level : int
    places : float64 (n, 2), n at least 1
    away : float
        How far a place may lie from a face and still be on it, CRS units.
    """
    low, high = (places.min(axis=0) - away).tolist(), (places.max(axis=0) + away).tolist()
    slack = away + _slack(store)

    def touches(corner: Floats) -> NDArray[np.bool_]:
        least, most = corner[:, :, :2].min(axis=1) - slack, corner[:, :, :2].max(axis=1) + slack
        found: NDArray[np.bool_] = ((least[:, None] <= places) & (places <= most[:, None])).all(axis=2).any(axis=1)
        return found

    return descend(store, level, Extent(*low, *high), touches if len(places) <= MOST_PLACES else None)


def _slack(store: StoreReader) -> float:
    """How far a face may lie outside its ancestors, CRS units."""
    return SLACK * float(np.spacing(max(map(abs, store.extent))))


def descend(store: StoreReader, level: int, box: Extent, test: Test | None = None) -> Mesh:
    """Find the faces of a level whose bounding boxes touch a rectangle, and that pass a test.

    Parameters
    ----------
    store : StoreReader
    level : int
    box : Extent
    test : callable, optional
        Corners of faces, float64 (n, 3, 3) → bool (n,). What passes must have an ancestor on each level that passes.

    Notes
    -----
    Where levels are nested and the rectangle is a small part of the tiles it touches, reads level 0 of these tiles, and of the
    others the children of faces that touch and pass; else the tiles whole. Cost: O(faces found + level 0), or O(tiles).
    """
    tiles = store.tiles(box)
    area = float(((tiles["xmax"] - tiles["xmin"]) * (tiles["ymax"] - tiles["ymin"])).sum())
    share = (box.max_x - box.min_x) * (box.max_y - box.min_y) if test is None else 0.0
    is_direct = level == 0 or not store.is_nested or share >= MOST_OF_TILES * area
    slack = _slack(store)
    mesh = mesh_of(store, store.faces_of_tiles(level if is_direct else 0, tiles["tile_id"]))
    for step in range(0 if is_direct else level):
        ids = _passing(mesh, _touches_box(box, slack), test).faces["face_id"]
        links = store.linked("parent_face", ids)
        if len(np.unique(links[:, 0])) < len(ids):
            raise StoreFormatError(str(store.path), f"level {step}", "found a face without children", "R-180")
        mesh = mesh_of(store, store.fetch("face", np.sort(links[:, 1])))
    return _passing(mesh, _touches_box(box, 0.0), test)


def _passing(mesh: Mesh, touches: Test, test: Test | None) -> Mesh:
    """Return the part of a mesh that passes."""
    corner = mesh.xyz[mesh.face_nodes]
    keep = touches(corner)
    if test is not None:
        keep[keep] = test(corner[keep])
    return mesh.part(keep)
