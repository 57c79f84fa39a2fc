"""One tile of a directory, over all levels, in the store's terms (specs/evpf.md E-501)."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import VpfFormatError
from vpfx.evpf.checked import Run, TileRuns, check, open_checked
from vpfx.evpf.numbering import FIRST_FACE
from vpfx.evpf.places import NodeTable, TileNodes
from vpfx.evpf.tile_rings import TileRings, face_corners, read_rings
from vpfx.exact import face_turns
from vpfx.store.mesh import LevelMesh, TileMesh, TJunctions
from vpfx.store.records import NULL_INT
from vpfx.store.tiles import Place, Tile, Tiling
from vpfx.vpf.catalog import Coverage
from vpfx.vpf.values import is_null

__all__ = ["TileReader"]

Ints = NDArray[np.int64]

FACES = {"id": "I", "slope": "F", "aspect": "F", "filled": "S", "parent": "I", "tile_id": "S", "fac_id": "I"}
NODES = {"id": "I", "z": "R", "z_parent": "R", "first_level": "S", "tile_id": "S", "cnd_id": "I"}
PARENTS = {"id": "I", "tile_id": "S", "parent_id": "I", "child_id": "I"}
JUNCTIONS = {"id": "I", "tile_id": "S", "fac_id": "I", "cnd_id": "I", "gap": "R"}
AREA = {"area": "R"}


class _Level(NamedTuple):
    """A coverage, and its tables by tile; no table of links on level 0, none of junctions where there are none."""

    coverage: Coverage
    faces: TileRuns
    nodes: TileRuns
    parents: TileRuns | None
    junctions: TileRuns | None


class TileReader:
    """Reads tile by tile, in the order of their ids; a context manager.

    Parameters
    ----------
    coverages : list of Coverage
        The levels, coarse to fine.
    tiling : Tiling
    place : Place
    is_double : bool
        Whether coordinates are doubles.

    Attributes
    ----------
    n_face : int64 (n_tile, n_level)
        Faces of the store, of the tiles read.

    Raises
    ------
    VpfFormatError
        A table is missing or broken.
    """

    def __init__(self, coverages: list[Coverage], tiling: Tiling, place: Place, is_double: bool) -> None:
        self._tiling, self._place, self._is_double = tiling, place, is_double
        self.n_face = np.zeros((tiling.n_tile, len(coverages)), np.int64)
        self._stack = ExitStack()
        with ExitStack() as stack:
            self._is_nested = len(coverages) == 1 or _is_nested(coverages[1])
            self._levels = [self._open(coverage, level, stack) for level, coverage in enumerate(coverages)]
            self._stack = stack.pop_all()

    def __enter__(self) -> TileReader:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _open(self, coverage: Coverage, level: int, stack: ExitStack) -> _Level:
        def runs(name: str, wanted: dict[str, str]) -> TileRuns:
            return TileRuns(stack.enter_context(open_checked(coverage, name, wanted)))

        parents = runs("parent.rat", PARENTS if self._is_nested else PARENTS | AREA) if level else None
        has_junctions = coverage.find("tjunct.rat") is not None
        junctions = runs("tjunct.rat", JUNCTIONS) if has_junctions else None
        return _Level(coverage, runs("tinface.aft", FACES), runs("tinnode.pft", NODES), parents, junctions)

    def read(self, tile: Tile) -> TileMesh:
        """Read the next tile.

        Raises
        ------
        VpfFormatError
            A table is missing or broken, or tables contradict each other.
        """
        nodes = TileNodes(tile, self._tiling, self._place, self._is_double)
        levels: list[LevelMesh] = []
        paths = []
        before: Run | None = None
        for number, level in enumerate(self._levels):
            faces = level.faces.take(tile.number + 1)
            self.n_face[tile.number, number] = faces.n_row
            found = read_rings(level.coverage, tile.number + 1, faces.n_row, self._is_double)
            index = nodes.add(number, self._node_table(level.nodes.take(tile.number + 1), found))
            mesh = self._level_mesh(level, tile, found, faces, index)
            if before is None or level.parents is None:
                _check_none(faces, "is on the first level")
            else:
                mesh = self._linked(mesh, level.parents.take(tile.number + 1), faces, before)
            levels.append(mesh)
            paths.append(found.face_path)
            before = faces
        for mesh, path in zip(levels, paths, strict=True):
            _check_faces(mesh.faces, nodes.xyz, path)
        return TileMesh(tile, nodes.xyz, nodes.uv, nodes.node_level, nodes.z_parent, tuple(levels))

    def finish(self) -> None:
        """Refuse rows of tiles that the library does not have."""
        for level in self._levels:
            for runs in level[1:]:
                if runs is not None:
                    runs.finish()

    def _node_table(self, rows: Run, found: TileRings) -> NodeTable:
        """Nodes of a coverage with their features."""
        _check_each(rows, "cnd_id", len(found.xyz), 1)
        z, z_parent = rows["z"], rows["z_parent"]
        height = found.xyz[:, 2]
        check(z == height, rows.path, "found z {}, expected {}, as in cnd", "E-300", z, height, start=rows.start)
        first = rows["first_level"].astype(np.int64)
        has_parent = self._is_nested & (first > 0)
        is_good = np.where(has_parent, np.isfinite(z_parent), np.isnan(z_parent))
        message = (
            "found z_parent {}, expected one for nodes of the levels after the first where levels are nested, else none"
        )
        check(is_good, rows.path, message, "E-300", z_parent, start=rows.start)
        return NodeTable(found.node_path, found.xyz, z_parent, first)

    def _level_mesh(self, level: _Level, tile: Tile, found: TileRings, rows: Run, index: Ints) -> LevelMesh:
        """Faces of a level without links."""
        _check_each(rows, "fac_id", rows.n_row, FIRST_FACE)
        filled = rows["filled"]
        is_flag = (filled == 0) | (filled == 1)
        check(is_flag, rows.path, "found filled {}, expected 0 or 1", "E-300", filled, start=rows.start)
        slope, aspect = _slopes(rows)
        junctions = None if level.junctions is None else level.junctions.take(tile.number + 1)
        faces, inside = _corners(found, junctions)
        inside = inside._replace(node=index[inside.node])
        nothing = np.empty((0, 2), np.int32)
        corners = np.ascontiguousarray(index[faces], np.int32)
        return LevelMesh(corners, filled.astype(bool), slope, aspect, nothing, None, inside)

    def _linked(self, mesh: LevelMesh, rows: Run, faces: Run, before: Run) -> LevelMesh:
        """Return a level with the links to the one before."""
        link = []
        for name, count in (("parent_id", before.n_row), ("child_id", faces.n_row)):
            at = rows[name].astype(np.int64) - FIRST_FACE
            message = f"found {name} {{}}, expected {FIRST_FACE} … {FIRST_FACE + count - 1}"
            check((at >= 0) & (at < count), rows.path, message, "E-420", rows[name], start=rows.start)
            link.append(at)
        parent, child = link
        rises = (np.diff(child) > 0) | ((np.diff(child) == 0) & (np.diff(parent) > 0))
        message = "found a link out of order, expected them by child, then parent"
        check(rises, rows.path, message, "E-420", start=rows.start + 1)
        n_parent = np.bincount(child, minlength=faces.n_row)
        is_good = n_parent == 1 if self._is_nested else n_parent >= 1
        message = f"found {{}} parents in parent.rat, expected {'one' if self._is_nested else 'some'}"
        check(is_good, faces.path, message, "E-420", n_parent, start=faces.start)
        n_child = np.bincount(parent, minlength=before.n_row)
        message = "found no child in parent.rat of the next coverage, expected some"
        check(n_child >= 1, before.path, message, "E-420", start=before.start)
        area = None
        if self._is_nested:
            given, expected = faces["parent"], before.start + 1 + parent
            message = "found parent {}, expected {}, as in parent.rat"
            check(given == expected, faces.path, message, "E-300", given, expected, start=faces.start)
        else:
            _check_none(faces, "may have several")
            area = rows["area"]
            is_area = np.isfinite(area) & (area > 0)
            check(is_area, rows.path, "found area {}, expected one above 0", "E-420", area, start=rows.start)
        return replace(mesh, links=np.stack(link, axis=1).astype(np.int32), link_area=area)


def _is_nested(coverage: Coverage) -> bool:
    """Tell whether levels are nested: the links of the second one have no areas then."""
    with open_checked(coverage, "parent.rat", PARENTS) as file:
        return file.layout.find("area") is None


def _check_none(faces: Run, why: str) -> None:
    """Refuse faces that name a parent in `tinface`."""
    given = faces["parent"]
    message = f"found parent {{}}, expected none: the face {why}"
    check(is_null(given, "I"), faces.path, message, "E-300", given, start=faces.start)


def _check_each(rows: Run, name: str, count: int, first: int) -> None:
    """Refuse features that are not one a primitive, in order."""
    if rows.n_row != count:
        message = f"found {rows.n_row} features of the tile, expected one for each of {count} primitives"
        raise VpfFormatError(rows.path, f"row {rows.start + 1}", message, "E-300")
    ids = rows[name]
    expected = first + np.arange(count)
    check(ids == expected, rows.path, f"found {name} {{}}, expected {{}}", "E-300", ids, expected, start=rows.start)


def _slopes(rows: Run) -> tuple[Ints, Ints]:
    """Slope and aspect in centidegrees."""
    given = {name: rows[name].astype(np.float64) for name in ("slope", "aspect")}
    slope = np.rint(given["slope"] * 100)
    is_slope = (slope >= 0) & (slope <= 9000)
    is_aspect = np.where(slope == 0, np.isnan(given["aspect"]), (given["aspect"] >= 0) & (given["aspect"] < 360))
    tell = {"slope": "0 to 90 degrees", "aspect": "0 to below 360 degrees, or none for level ground"}
    for name, is_good in (("slope", is_slope), ("aspect", is_aspect)):
        check(is_good, rows.path, f"found {name} {{}}, expected {tell[name]}", "E-300", given[name], start=rows.start)
    is_level = np.isnan(given["aspect"])
    aspect = np.rint(np.where(is_level, 0.0, given["aspect"]) * 100).astype(np.int64) % 36000
    return slope.astype(np.int64), np.where(is_level, NULL_INT, aspect)


def _corners(found: TileRings, junctions: Run | None) -> tuple[Ints, TJunctions]:
    """Corners of the faces as rows of `cnd`, from 0, and the nodes inside their sides."""
    n_face, n_node = len(found.rings.first) - 1, len(found.xyz)
    none = np.empty(0, np.int64)
    face, node, gap = none, none, np.empty(0)
    if junctions is not None:
        face, node = junctions["fac_id"].astype(np.int64) - FIRST_FACE, junctions["cnd_id"].astype(np.int64) - 1
        gap = junctions["gap"]
        is_good = (face >= 0) & (face < n_face) & (node >= 0) & (node < n_node) & np.isfinite(gap)
        message = "found a face, node or gap out of range, expected those of the tile"
        check(is_good, junctions.path, message, "E-222", start=junctions.start)
    order = np.lexsort((node, face))
    corners = face_corners(found.rings, face, node)
    if corners.broken >= 0:
        n_edge = int(np.diff(found.rings.first)[corners.broken])
        message = f"found a ring of {n_edge} edges, expected three, and one more for each row of tjunct.rat"
        raise VpfFormatError(found.face_path, f"row {corners.broken + FIRST_FACE}", message, "E-222")
    by_place = np.lexsort((corners.node, corners.side // 3))
    side, inside = corners.side[by_place], corners.node[by_place]
    is_same = len(side) == len(order) and (side // 3 == face[order]).all() and (inside == node[order]).all()
    if junctions is not None and not is_same:
        message = "found nodes that are not in the rings of their faces, or twice, expected each once"
        raise VpfFormatError(junctions.path, f"row {junctions.start + 1}", message, "E-222")
    return corners.faces, TJunctions(side, inside, gap[order])


def _check_faces(faces: NDArray[Any], xyz: NDArray[np.float64], path: str) -> None:
    """Refuse faces that are not counter-clockwise, and sides that run the same way between the same nodes."""
    turn = face_turns(xyz, faces)
    start = FIRST_FACE - 1
    message = "found a face that turns clockwise or has no area, expected a counter-clockwise one"
    check(turn > 0, path, message, "E-201", start=start)
    key = (faces.astype(np.int64) * len(xyz) + np.roll(faces, -1, axis=1)).ravel()
    order = np.argsort(key, kind="stable")
    is_first = np.ones(len(key), bool)
    is_first[order[1:]] = key[order][1:] != key[order][:-1]
    message = "found a side that another face has too, expected it once"
    check(is_first.reshape(-1, 3).all(axis=1), path, message, "E-210", start=start)
