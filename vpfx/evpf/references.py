"""The coverages `libref` and `tileref`: where the library lies, and its tiles (specs/evpf.md E-104)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import InputError
from vpfx.evpf.folder import Folder
from vpfx.evpf.planar import Planar, Sides, planar_graph
from vpfx.evpf.precision import rounded
from vpfx.evpf.primitives import Primitives, straight, write_primitives
from vpfx.model import Extent
from vpfx.store.tiles import Tiling
from vpfx.vpf import layouts
from vpfx.vpf.table import Ragged

__all__ = ["tile_paths", "write_libref", "write_tileref"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

LEAST_DIGITS = 2


def tile_paths(tiling: Tiling) -> list[tuple[str, str]]:
    """Directories of tiles: row and column in digits, from the south-west.

    Examples
    --------
    >>> tile_paths(Tiling(17, 21, 10, 1))
    [('00', '00'), ('00', '01'), ('01', '00'), ('01', '01')]
    """
    n_digit = max(LEAST_DIGITS, len(str(max(tiling.n_tile_row, tiling.n_tile_col) - 1)))
    return [
        (f"{row:0{n_digit}}", f"{col:0{n_digit}}")
        for row in range(tiling.n_tile_row)
        for col in range(tiling.n_tile_col)
    ]


def write_libref(coverage: Folder, extent: Extent, *, is_double: bool) -> None:
    """Write the outline of the extent: one closed edge, its inside to the left, and a line feature on it."""
    min_x, min_y, max_x, max_y = extent
    corners = np.array([[min_x, min_y], [max_x, min_y], [max_x, max_y], [min_x, max_y], [min_x, min_y]])
    places = corners if is_double else rounded(corners)
    rings = Planar(np.array([1, 0]), np.array([0, 0]), np.array([0, 0, 1]), np.array([-1, 0, 0]), 1, 0)
    tables = Primitives(
        "B" if is_double else "C", places[:1], np.zeros((1, 2), np.int64), Ragged(np.array([0, 5]), places),
        _inner([0]), _inner([[1, 0]]), _inner([[0, 0]]), rings, np.array([extent, extent]),
    )  # fmt: skip
    write_primitives(coverage, tables, extent, is_tiled=False)
    layout = layouts.feature("Library Reference Line Feature Table", (), "edg", is_tiled=False)
    coverage.write("libref.lft", layout, {"id": [1], "edg_id": [1]})
    _write_schema(coverage, "libref", "libref.lft", "edg")


def write_tileref(coverage: Folder, tiling: Tiling, extents: Floats, *, is_double: bool) -> None:
    """Write the tiles as faces, and an area feature on each.

    Parameters
    ----------
    coverage : Folder
    tiling : Tiling
    extents : float64 (n_tile, 4)
        Min x, min y, max x, max y of each tile.
    is_double : bool

    Raises
    ------
    InputError
        Corners of tiles come to lie in one place in single precision.
    """
    n_row, n_col = tiling.n_tile_row, tiling.n_tile_col
    xs = np.append(extents[:n_col, 0], extents[n_col - 1, 2])
    ys = np.append(extents[::n_col, 1], extents[-1, 3])
    corners = np.stack(np.meshgrid(xs, ys), axis=2).reshape(-1, 2)
    places = corners if is_double else rounded(corners)
    if not is_double and ((np.diff(rounded(xs)) <= 0).any() or (np.diff(rounded(ys)) <= 0).any()):
        raise InputError("single precision: found corners of tiles that come to lie in one place; give --double")
    edge_nodes, sides = _tile_edges(n_row, n_col)
    planar = planar_graph(places, edge_nodes, sides)
    boxes = np.concatenate([[[xs[0], ys[0], xs[-1], ys[-1]]], extents])
    first_edge = np.full(len(places), len(edge_nodes), np.int64)
    np.minimum.at(first_edge, edge_nodes.ravel(), np.repeat(np.arange(len(edge_nodes)), 2))
    tables = Primitives(
        "B" if is_double else "C", places, edge_nodes, straight(places, edge_nodes), _inner(first_edge),
        _inner(planar.way_face.reshape(-1, 2)), _inner(planar.way_next.reshape(-1, 2)), planar, boxes,
    )  # fmt: skip
    write_primitives(coverage, tables, boxes[0].tolist(), is_tiled=False)
    ids = np.arange(1, tiling.n_tile + 1)
    names = ["\\".join(path) for path in tile_paths(tiling)]
    coverage.write("tileref.aft", layouts.TILEREF, {"id": ids, "tile_name": names, "fac_id": ids + 1})
    _write_schema(coverage, "tileref", "tileref.aft", "fac")


def _tile_edges(n_row: int, n_col: int) -> tuple[Ints, Sides]:
    """Edges between corners, those that run east first, and the sides of the tiles; both by row, then column."""
    corner = np.arange((n_row + 1) * (n_col + 1)).reshape(n_row + 1, n_col + 1)
    east = np.stack([corner[:, :-1], corner[:, 1:]], axis=2).reshape(-1, 2)
    north = np.stack([corner[:-1], corner[1:]], axis=2).reshape(-1, 2)
    of_east = np.arange(len(east)).reshape(n_row + 1, n_col)
    of_north = len(east) + np.arange(len(north)).reshape(n_row, n_col + 1)
    start = np.stack([corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]], axis=2)
    edge = np.stack([of_east[:-1], of_north[:, 1:], of_east[1:], of_north[:, :-1]], axis=2)
    return np.concatenate([east, north]), Sides(start.ravel(), edge.ravel(), np.arange(0, start.size + 1, 4))


def _inner(index: Sequence[object] | Ints) -> Ints:
    """Triplets without external parts, of indices."""
    row = np.asarray(index, np.int64)[..., None] + 1
    return np.concatenate([row, np.zeros_like(row), np.zeros_like(row)], axis=-1)


def _write_schema(coverage: Folder, name: str, table: str, primitive: str) -> None:
    """Write the relations of the only feature class, forwards and backwards."""
    one, other = coverage.named(table), coverage.named(primitive)
    key = f"{primitive}_id"
    relations = {
        "id": [1, 2], "feature_class": [coverage.named(name)] * 2, "table1": [one, other], "table1_key": [key, "id"],
        "table2": [other, one], "table2_key": ["id", key],
    }  # fmt: skip
    coverage.write("fcs", layouts.FCS, relations)
