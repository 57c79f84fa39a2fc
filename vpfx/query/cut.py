"""A cut: one crack-free TIN of mixed levels, coarse where that is enough (specs/query.md Q-300 to Q-340).

Level by level from the coarsest, faces that are near enough to need it are replaced by their children. A node that is new at a
level has a weight: at 0 it lies on the surface of the level before, at 1 at its own height. Weights hang on distance alone and
are 0 wherever refined faces meet others, so there is no crack, and heights follow a moving eye without a jump.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from vpfx.dem.reference import unit_metres
from vpfx.errors import InputError, StoreFormatError
from vpfx.model import Tin
from vpfx.query.needs import Eye, Focus, Need, checked_errors, checked_eye, checked_focus, screen_share
from vpfx.query.stitch import stitch
from vpfx.query.vertical import follow
from vpfx.store.arrays import look_up
from vpfx.store.reader import StoreReader
from vpfx.topology import find_twins

__all__ = ["MORPH", "cut"]

Floats = NDArray[np.float64]
Ids = NDArray[np.int64]

MORPH = 0.25
"""Share of a distance over which a level fades in: wide enough for a steady eye, narrow enough to cost few faces."""

BLENDS = np.linspace(0.0, 1.0, 5)
"""Blends of two levels that a face is compared with to bound its error."""


class _Nodes:
    """Nodes met so far, those of level 0 first.

    Attributes
    ----------
    ids : int64 (n_node,)
    rows : dict of str to array
        Columns of the table `node`.
    height : float64 (n_node,)
        In the cut, metres.
    weight : float64 (n_node,)
    """

    def __init__(self, store: StoreReader) -> None:
        self._store = store
        self.ids = np.empty(0, np.int64)
        self.rows = store.fetch("node", self.ids)
        self.height, self.weight = np.empty(0), np.empty(0)
        self._order = np.empty(0, np.int64)

    def index(self, corners: Ids) -> NDArray[np.int32]:
        """Places of nodes; those that are not known yet are read."""
        at, is_known = look_up(self.ids[self._order], corners)
        if not is_known.all():
            rows = self._store.fetch("node", np.unique(corners[~is_known]))
            self.rows = {name: np.concatenate([self.rows[name], rows[name]]) for name in rows}
            self.ids = self.rows["node_id"]
            self._order = np.argsort(self.ids, kind="stable")
            at, _ = look_up(self.ids[self._order], corners)
        return self._order[at].astype(np.int32)

    def xyz(self, z: Floats | None = None) -> Floats:
        """Places, float64 (n_node, 3), with the heights of the store or others."""
        return np.stack([self.rows["x"], self.rows["y"], self.rows["z"] if z is None else z], axis=1)


class _Faces(NamedTuple):
    """Faces of one level that the cut has come to.

    Attributes
    ----------
    ids, tile_ids : int64 (n,)
    nodes : int32 (n, 3)
        Indices into `_Nodes`.
    is_filled : bool (n,)
    tolerance : float64 (n,)
        Vertical error allowed, at least that of the parent, metres.
    max_error : float64 (n,)
        No post in the face is off by more, with the heights of the cut, metres.
    """

    ids: Ids
    tile_ids: Ids
    nodes: NDArray[np.int32]
    is_filled: NDArray[np.bool_]
    tolerance: Floats
    max_error: Floats

    def part(self, which: Any) -> _Faces:
        """Some of the faces."""
        return _Faces(*(column[which] for column in self))


class _Ladder(NamedTuple):
    """Errors that decide where a level will do (Q-320), metres.

    Attributes
    ----------
    error : float64 (n_level,)
        No post of a level is off by more.
    floor, most : float64 (n_level - 1,)
        Of each step to the next level: least and greatest error of faces while new nodes are on their way.
    morph : float
        Part of an error over which they are.
    """

    error: Floats
    floor: Floats
    most: Floats
    morph: float

    def need(self, step: int, rise: Floats) -> Floats:
        """Error above which faces need no refinement, by the greatest rise of their new nodes."""
        mixed = (self.error[step] + self.error[step + 1] + rise) / 2.0
        return np.minimum(np.maximum(mixed, self.floor[step]), self.most[step])


def cut(
    store: StoreReader, eye: Any = None, *, screen_error: float = 2.0, fov: float = 60.0, screen_height: int = 1080,
    error: float | None = None, focus: Any = None, growth: float = math.inf, bbox: Any = None, morph: float = MORPH,
) -> Tin:  # fmt: skip
    """Cover the extent once with faces of mixed levels, without cracks: for an eye, or for an error and a focus.

    Parameters
    ----------
    store : StoreReader
        Of nested levels without T-junctions.
    eye : three numbers, optional
        x and y in CRS units, z in metres above the datum of the heights.
    screen_error : float
        Vertical error allowed on the screen, pixels.
    fov : float
        Vertical field of view, degrees.
    screen_height : int
        Pixels of the screen from top to bottom.
    error : float, optional
        Without an eye: vertical error allowed, metres.
    focus : shapely polygon or multipolygon, optional
        Where `error` holds, in CRS units; everywhere by default.
    growth : float
        Metres that the error may grow by for each metre away from the focus; by default it may be any there.
    bbox : four numbers, optional
        min_x, min_y, max_x, max_y: only tiles that touch it.
    morph : float
        Share of a distance over which a level fades in, 0 to 1; with 0 levels change at once.

    Returns
    -------
    Tin
        Of faces: ``face_id`` (the face of the store that each is or is a piece of), ``level``, ``tile_id``, ``is_stitched``
        (it is a piece), ``is_filled``, ``max_error`` (no post in it is off by more) and ``tolerance`` (what is allowed there),
        metres. Of nodes: ``node_id``, ``level``, ``z`` as stored, ``z_parent``, ``weight``; their heights are those of the cut.

    Raises
    ------
    InputError
        There is neither an eye nor an error, or both; a number is out of range; levels are not nested or have T-junctions.

    Notes
    -----
    ``max_error`` is at most the tolerance, or what the last level has. Reads level 0, and of the other levels faces that may be
    needed by the greatest rise of the level: one to five for each face returned. Cost: O(faces returned + level 0).

    Examples
    --------
    ``cut(store, (500_000, 4_000_000, 900.0), screen_error=1.5)``; ``cut(store, error=5.0, focus=shapely.box(*bbox))``
    """
    share = morph if isinstance(morph, int | float) else math.nan
    if not 0.0 <= share <= 1.0:
        raise InputError(f"morph: found {morph}, expected a number from 0 to 1")
    if (eye is None) == (error is None):
        raise InputError("cut: found an eye and an error or neither of them, expected one of the two")
    if eye is not None and (focus is not None or growth != math.inf):
        raise InputError("cut: found an eye and a focus or growth, expected these with an error")
    metres = unit_metres(store.crs, store.extent)
    need: Need
    if error is None:
        need = Eye(checked_eye(eye), metres, (math.nan, math.nan), screen_share(screen_error, fov, screen_height))
    else:
        area = shapely.box(*store.extent) if focus is None else focus
        need = Focus(checked_focus(area, metres), metres, *checked_errors(error, growth))
    _check_nested(store)
    nodes = _Nodes(store)
    faces = _first_level(store, nodes, bbox)
    if isinstance(need, Eye):
        need = replace(need, slab=_slab(store, nodes))
    faces = faces._replace(tolerance=need.tolerance(nodes.xyz()[faces.nodes]))
    ladder = _ladder(store, share, is_sudden=error is not None and growth == math.inf)
    found = []
    for level in range(len(store.levels) - 1):
        is_refined, refined = _refine(store, nodes, faces, level, need, ladder)
        found.append(faces.part(~is_refined))
        faces = refined
    return _joined(store, nodes, [*found, faces])


def _check_nested(store: StoreReader) -> None:
    """Refuse stores in which a face is not covered by its children, edge by edge."""
    has_junctions = len(store.select("SELECT 1 AS row FROM t_junction LIMIT 1")["row"]) > 0
    if has_junctions or not store.is_nested:
        found = "T-junctions in its levels" if has_junctions else "levels that are not nested"
        method = store.metadata["method"]
        raise InputError(
            f"{store.path}: found {found} (method {method}), expected a nested method that keeps faces adjacent"
        )


def _first_level(store: StoreReader, nodes: _Nodes, bbox: Any) -> _Faces:
    """Read level 0."""
    faces = _faces_of(store.faces_of_tiles(0, store.tiles(bbox)["tile_id"]), nodes)
    nodes.height, nodes.weight = nodes.rows["z"].copy(), np.ones(len(nodes.ids))
    return faces._replace(max_error=np.full(len(faces.ids), store.levels[0].max_error))


def _faces_of(rows: dict[str, NDArray[Any]], nodes: _Nodes) -> _Faces:
    """Faces of rows of the table `face`, whose nodes become known; of errors nothing is known yet."""
    corners = np.stack([rows[f"node_{i}"] for i in (1, 2, 3)], axis=1)
    nothing = np.zeros(len(corners))
    return _Faces(
        rows["face_id"], rows["tile_id"], nodes.index(corners), rows["is_filled"].astype(bool), nothing, nothing
    )


def _slab(store: StoreReader, nodes: _Nodes) -> tuple[float, float]:
    """Least and greatest height of the surface: that of level 0, and as far beyond as nodes of the others rise."""
    rise = sum(line.max_rise or 0.0 for line in store.levels)
    z = nodes.rows["z"]
    return float(z.min(initial=np.inf)) - rise, float(z.max(initial=-np.inf)) + rise


def _ladder(store: StoreReader, morph: float, is_sudden: bool) -> _Ladder:
    """Errors of the steps, last step first: no step begins before the one before is done.

    Sudden tolerances have one value and no other but infinity, so no new node is ever on its way where it holds.
    """
    error = np.array([line.max_error for line in store.levels])
    if is_sudden:
        return _Ladder(error, error[:-1], error[:-1], 0.0)
    floor, most = np.zeros((2, len(error) - 1))
    for step in reversed(range(len(error) - 1)):
        rise = store.levels[step + 1].max_rise or 0.0
        floor[step] = max(error[step], (1.0 + morph) * most[step + 1]) if step + 1 < len(floor) else error[step]
        most[step] = max(floor[step], (error[step] + error[step + 1] + rise) / 2.0)
    return _Ladder(error, floor, most, morph)


def _refine(
    store: StoreReader, nodes: _Nodes, faces: _Faces, level: int, need: Need, ladder: _Ladder
) -> tuple[NDArray[np.bool_], _Faces]:
    """Replace faces of a level by their children where that is needed.

    Returns
    -------
    is_refined : bool (n,)
        Of the faces.
    refined : _Faces
        The children of those.
    """
    twins = find_twins(faces.nodes, len(nodes.ids))
    beside = np.where(twins < 0, len(faces.ids), twins // 3).reshape(-1, 3)
    near = faces.tolerance
    for _ in range(len(store.levels) - 2 - level):
        near = _spread(near, beside)
    candidates = np.flatnonzero(_spread(near, beside) < (1.0 + ladder.morph) * ladder.most[level])
    links, _ = follow(store, faces.ids[candidates], "down")
    parent = candidates[links.of]
    n_child = np.bincount(parent, minlength=len(faces.ids))
    if (n_child[candidates] == 0).any():
        raise StoreFormatError(str(store.path), f"level {level}", "found a face without children", "R-180")
    known = len(nodes.ids)
    kids = _faces_of(store.fetch("face", links.face_ids), nodes)
    _weigh(store, nodes, kids.nodes, parent, known, level, near, ladder)
    is_wanted = (kids.nodes >= known) & (nodes.weight[kids.nodes] > 0.0)
    is_refined = np.zeros(len(faces.ids), bool)
    is_refined[parent] = n_child[parent] == 1
    np.logical_or.at(is_refined, parent, is_wanted.any(axis=1))
    bound = _bound(nodes, kids.nodes, level + 1, ladder.error, faces.max_error[parent])
    tolerance = np.maximum(need.tolerance(nodes.xyz()[kids.nodes]), faces.tolerance[parent])
    return is_refined, kids._replace(max_error=bound, tolerance=tolerance).part(is_refined[parent])


def _spread(values: Floats, beside: Ids) -> Floats:
    """Least value of each face and of those across its edges."""
    return np.minimum(values, np.append(values, np.inf)[beside].min(axis=1))


def _weigh(
    store: StoreReader, nodes: _Nodes, kid_nodes: NDArray[np.int32], parent: Ids, known: int, level: int, near: Floats,
    ladder: _Ladder,
) -> None:  # fmt: skip
    """Give weights and heights to nodes that are new at the next level."""
    rows = {name: nodes.rows[name][known:] for name in ("z", "z_parent", "level")}
    if not ((rows["level"] == level + 1) & np.isfinite(rows["z_parent"])).all():
        message = "found children with corners that are none of their parent and not new at their level"
        raise StoreFormatError(str(store.path), f"level {level + 1}", message, "R-181")
    rise = rows["z"] - rows["z_parent"]
    kid, corner = np.nonzero(kid_nodes >= known)
    node, owner = kid_nodes[kid, corner] - known, parent[kid]
    rise_of_face = np.zeros(len(near))
    np.maximum.at(rise_of_face, owner, np.abs(rise[node]))
    need, tolerance = np.zeros(len(rise)), np.full(len(rise), np.inf)
    np.maximum.at(need, node, ladder.need(level, rise_of_face)[owner])
    np.minimum.at(tolerance, node, near[owner])
    weight = (tolerance < need).astype(np.float64)
    fades = (tolerance >= need) & (tolerance < (1.0 + ladder.morph) * need)
    weight[fades] = (1.0 + ladder.morph - tolerance[fades] / need[fades]) / ladder.morph
    weight = np.clip(weight, 0.0, 1.0)
    own = np.where(weight == 1.0, rows["z"], rows["z_parent"] + weight * rise)  # as stored, to the bit, at both ends
    nodes.weight = np.concatenate([nodes.weight, weight])
    nodes.height = np.concatenate([nodes.height, own])


def _bound(nodes: _Nodes, face_nodes: NDArray[np.int32], level: int, error: Floats, of_parent: Floats) -> Floats:
    """Bound the errors of faces of a level: by blends of it and the level before, or by the parent and what new nodes add."""
    is_new = (nodes.rows["level"] == level)[face_nodes]
    height, z = nodes.height[face_nodes], nodes.rows["z"][face_nodes]
    before = np.where(is_new, nodes.rows["z_parent"][face_nodes], z)
    added = np.where(is_new, nodes.weight[face_nodes] * np.abs(z - before), 0.0).max(axis=1, initial=0.0)
    least = of_parent + added
    for blend in BLENDS:
        away = np.abs((height - before) - blend * (z - before)).max(axis=1, initial=0.0)
        least = np.minimum(least, (1.0 - blend) * error[level - 1] + blend * error[level] + away)
    return least


def _joined(store: StoreReader, nodes: _Nodes, parts: list[_Faces]) -> Tin:
    """Put the faces of all levels together and cut those that have nodes of finer ones in their edges."""
    level = np.repeat(np.arange(len(parts)), [len(part.ids) for part in parts])
    faces = _Faces(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
    used, index = np.unique(faces.nodes, return_inverse=True)
    xyz = nodes.xyz(nodes.height)[used]
    face_nodes, source = stitch(xyz, index.reshape(-1, 3).astype(np.int32))
    of_face = {
        "face_id": faces.ids, "tile_id": faces.tile_ids, "level": level, "is_filled": faces.is_filled,
        "is_stitched": np.bincount(source) > 1, "max_error": faces.max_error, "tolerance": faces.tolerance,
    }  # fmt: skip
    attributes = {name: values[source] for name, values in of_face.items()}
    known = {name: nodes.rows[name][used] for name in ("node_id", "level", "z", "z_parent")}
    return Tin(xyz, face_nodes, attributes, {**known, "weight": nodes.weight[used]}, crs=store.crs)
