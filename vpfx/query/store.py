"""A store with all questions as methods: what users open."""

from __future__ import annotations

from pathlib import Path

from vpfx.query.attributes import attributes
from vpfx.query.contours import contours
from vpfx.query.cut import cut
from vpfx.query.horizontal import components, edge_neighbours, flood, k_ring, node_neighbours, rings
from vpfx.query.lines import profile
from vpfx.query.location import locate
from vpfx.query.nearest import nearest_nodes
from vpfx.query.region import elevation_range, region, region_rows
from vpfx.query.sight import line_of_sight, viewshed, walk
from vpfx.query.vertical import children, descendants, parents, related, siblings
from vpfx.query.volumes import volume
from vpfx.store.reader import StoreReader

__all__ = ["Store", "open_store"]


class Store(StoreReader):
    """A store open for reading; made by `open_store`.

    Every question of `vpfx.query` is a method: ``store.locate(places, level)`` is ``locate(store, places, level)``.

    Attributes
    ----------
    path, metadata, levels, crs, extent
        As of `vpfx.store.reader.StoreReader`.
    """

    attributes = attributes
    children = children
    components = components
    contours = contours
    cut = cut
    descendants = descendants
    edge_neighbours = edge_neighbours
    elevation_range = elevation_range
    flood = flood
    k_ring = k_ring
    line_of_sight = line_of_sight
    locate = locate
    nearest_nodes = nearest_nodes
    node_neighbours = node_neighbours
    parents = parents
    profile = profile
    region = region
    region_rows = region_rows
    related = related
    rings = rings
    siblings = siblings
    viewshed = viewshed
    volume = volume
    walk = walk


def open_store(path: str | Path) -> Store:
    """Open a store for reading.

    Parameters
    ----------
    path : path
        A file made by `vpfx.build`.

    Returns
    -------
    Store
        Use it in a ``with`` statement.

    Raises
    ------
    NotFoundError
        There is no such file.
    StoreError
        Somebody is writing.
    StoreFormatError
        The file is not a store of vpfx, or its tables are not those of the format.

    Examples
    --------
    >>> open_store("README.md")
    Traceback (most recent call last):
    vpfx.errors.StoreFormatError: README.md: found no SQLite database, expected a store made by vpfx build
    """
    return Store(Path(path))
