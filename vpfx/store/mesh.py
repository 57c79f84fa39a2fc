"""One tile in the store's terms: what its rows are made of, whoever has it.

A method leaves nodes in posts and the importer has them in CRS units; `TileMesh` holds both, and all else as it is stored.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.geometry import face_slopes
from vpfx.model import Hierarchy
from vpfx.store.records import NULL_INT
from vpfx.store.tiles import Place, Tile
from vpfx.topology import find_t_junctions, find_twins

__all__ = ["LevelMesh", "TJunctions", "TileMesh", "tile_mesh"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Longs = NDArray[np.int64]


class TJunctions(NamedTuple):
    """Nodes inside edges (specs/format.md R-190); side 3·face + i is `edge_<i + 1>` of the face.

    `side` and `node` are int64 (n,), `gap` is float64 (n,), metres.
    """

    side: Longs
    node: Longs
    gap: Floats


@dataclass(frozen=True, eq=False)
class LevelMesh:
    """One level of one tile.

    Attributes
    ----------
    faces : int32 (n_face, 3)
        Nodes of the tile, counter-clockwise; edge_1 joins the first two.
    is_filled : bool (n_face,)
        Faces on ground without data.
    slope, aspect : int64 (n_face,)
        Centidegrees as R-171 has them; NULL_INT where there is no aspect.
    links : int32 (n_link, 2)
        Pairs (face of the level before, face), sorted by face; none on level 0.
    link_area : float64 (n_link,) or None
        What each pair shares, squared CRS units; None where levels are nested, and on level 0.
    t_junctions : TJunctions
    """

    faces: Ints
    is_filled: NDArray[np.bool_]
    slope: Longs
    aspect: Longs
    links: Ints
    link_area: Floats | None
    t_junctions: TJunctions


@dataclass(frozen=True, eq=False)
class TileMesh:
    """All levels of one tile.

    Attributes
    ----------
    tile : Tile
    xyz : float64 (n_node, 3)
        As stored: x and y in CRS units, z in metres; those of level 0 first. Running ids follow this order (R-152).
    uv : float64 (n_node, 2)
        The same places in posts from the tile's south-west corner; exactly whole on the tile's sides. Ids on borders and the
        order of edges round a node come from them.
    node_level : int64 (n_node,)
        The level at which each node first appears; rises.
    z_parent : float64 (n_node,)
        R-150; NaN for NULL.
    levels : tuple of LevelMesh
        Coarse to fine.
    """

    tile: Tile
    xyz: Floats
    uv: Floats
    node_level: Longs
    z_parent: Floats
    levels: tuple[LevelMesh, ...]


def tile_mesh(hierarchy: Hierarchy, tile: Tile, place: Place, post_metres: tuple[float, float]) -> TileMesh:
    """Put what a method has built in the store's terms.

    Parameters
    ----------
    hierarchy : Hierarchy
        Its nodes are in posts from the tile's south-west corner.
    tile : Tile
    place : Place
        Where the posts lie.
    post_metres : tuple of float
        Width and height of a post spacing, metres: for slope and aspect.

    Returns
    -------
    TileMesh
    """
    uv = np.ascontiguousarray(hierarchy.nodes[:, :2])
    x, y = place.at(tile.first_col + uv[:, 0], tile.first_row + uv[:, 1])
    metric = hierarchy.nodes * np.array([*post_metres, 1.0])
    levels = []
    for level, faces in enumerate(hierarchy.level_faces):
        faces = np.ascontiguousarray(faces, np.int32)
        links = hierarchy.links[level - 1] if level else np.empty((0, 2), np.int32)
        area = hierarchy.link_area[level - 1] * (place.dx * place.dy) if level and hierarchy.link_area else None
        t_junctions = find_t_junctions(hierarchy.nodes, faces, find_twins(faces, len(uv)))
        slope, aspect = _centidegrees(*face_slopes(metric, faces))
        filled = hierarchy.face_is_filled[level]
        levels.append(LevelMesh(faces, filled, slope, aspect, links, area, TJunctions(*t_junctions)))
    xyz = np.stack([x, y, hierarchy.nodes[:, 2]], axis=1)
    return TileMesh(tile, xyz, uv, hierarchy.node_level.astype(np.int64), hierarchy.node_z_parent, tuple(levels))


def _centidegrees(slope: Floats, aspect: Floats) -> tuple[Longs, Longs]:
    """Round slope and aspect from degrees to hundredths; level ground has no aspect."""
    steepness = np.rint(slope * 100.0).astype(np.int64)
    is_level = (steepness == 0) | np.isnan(aspect)
    direction = np.rint(np.where(is_level, 0.0, aspect) * 100.0).astype(np.int64) % 36000
    return steepness, np.where(is_level, NULL_INT, direction)
