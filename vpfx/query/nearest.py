"""Nodes nearest to places, for many places at once, across tiles as if there were none."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from vpfx.query.location import checked_places
from vpfx.store.reader import StoreReader
from vpfx.topology import NONE

__all__ = ["Nearest", "nearest_nodes"]

Floats = NDArray[np.float64]


class Nearest(NamedTuple):
    """The nodes nearest to places; -1 and NaN on a level without faces.

    Attributes
    ----------
    node_ids : int64 (n,)
        Of several the least.
    distance : float64 (n,)
        Seen from above, CRS units: degrees where places are longitude and latitude.
    places : float64 (n, 3)
        x and y in CRS units, height in metres.
    """

    node_ids: NDArray[np.int64]
    distance: Floats
    places: Floats


def nearest_nodes(store: StoreReader, places: Any, level: int) -> Nearest:
    """Nodes of a level that lie nearest to places, seen from above.

    Parameters
    ----------
    store : StoreReader
    places : float64 (n, 2)
        x and y in CRS units.
    level : int

    Raises
    ------
    InputError
        The places are no (n, 2) array of finite numbers.
    NotFoundError
        There is no such level.

    Notes
    -----
    Source: specs/query.md Q-152. Asks the tile nearest to each place, then the tiles that may hold a node no farther than
    the one found. Cost: O(places × tiles), and the faces of the tiles asked.
    """
    store.check_level(level)
    xy = checked_places(places)
    found = Nearest(np.full(len(xy), NONE, np.int64), np.full(len(xy), np.inf), np.full((len(xy), 3), np.nan))
    tiles = store.tiles()
    first, least = np.zeros(len(xy), np.int64), np.full(len(xy), np.inf)
    for k in range(len(tiles["tile_id"])):
        away = _away(xy, tiles, k)
        first[away < least], least = k, np.minimum(least, away)
    for is_first in (True, False):
        for k, tile_id in enumerate(tiles["tile_id"].tolist()):
            some = np.flatnonzero(first == k if is_first else (first != k) & (_away(xy, tiles, k) <= found.distance))
            if len(some):
                _ask_tile(store, level, tile_id, xy, some, found)
    found.distance[found.node_ids == NONE] = np.nan
    return found


def _away(xy: Floats, tiles: dict[str, NDArray[Any]], k: int) -> Floats:
    """Distance of places from a tile, less what rounding may add."""
    dx = np.maximum(0.0, np.maximum(tiles["xmin"][k] - xy[:, 0], xy[:, 0] - tiles["xmax"][k]))
    dy = np.maximum(0.0, np.maximum(tiles["ymin"][k] - xy[:, 1], xy[:, 1] - tiles["ymax"][k]))
    away: Floats = np.hypot(dx, dy) * (1.0 - 4.0 * np.finfo(float).eps)
    return away


def _ask_tile(
    store: StoreReader, level: int, tile_id: int, xy: Floats, some: NDArray[np.int64], found: Nearest
) -> None:
    """Put the nodes of a tile in where they are nearer than those found, or as near and of less id."""
    faces = store.tile_faces(level, tile_id)
    node_ids = np.unique(np.stack([faces[f"node_{i}"] for i in (1, 2, 3)]))
    if len(node_ids) == 0:
        return
    rows = store.fetch("node", node_ids)
    nodes = np.stack([rows[axis] for axis in "xyz"], axis=1)
    at, node = shapely.STRtree(shapely.points(nodes[:, :2])).query_nearest(shapely.points(xy[some]), all_matches=True)
    at, away = some[at], nodes[node, :2] - xy[some[at]]
    distance = np.hypot(away[:, 0], away[:, 1])
    order = np.lexsort((node_ids[node], distance, at))
    order = order[np.append(np.ones(min(1, len(order)), bool), np.diff(at[order]) > 0)]
    at, node, distance = at[order], node[order], distance[order]
    is_as_near = (distance == found.distance[at]) & (node_ids[node] < found.node_ids[at])
    better = (distance < found.distance[at]) | is_as_near
    at, node = at[better], node[better]
    found.node_ids[at], found.distance[at], found.places[at] = node_ids[node], distance[better], nodes[node]
