"""Features of a class: the rows of its table with their geometry, read tile by tile and put together.

::

    feature table ─ or its join table ─► (feature, tile, primitive) ─ one tile at a time ─► parts ─ merge ─► features

Memory is that of one class and of the primitives of one tile. Source: specs/vpf.md, V-400 to V-424.
"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np
import shapely
import shapely.errors
from numpy.typing import NDArray

from vpfx.errors import NotFoundError, VpfFormatError
from vpfx.vpf.catalog import Coverage
from vpfx.vpf.fields import Field, decode_fields, free_name, text_field
from vpfx.vpf.geometry import Geometries, edge_lines, face_polygons, find_rows, ids_of, node_points, text_places
from vpfx.vpf.layouts import PRIMITIVES
from vpfx.vpf.merge import merge_parts
from vpfx.vpf.paths import find
from vpfx.vpf.schema import FeatureClass
from vpfx.vpf.table import Table, open_table, read_table

__all__ = ["FeatureRows", "class_tables", "has_faces", "read_class", "read_primitives", "tiles_of"]

Ids = NDArray[np.int64]

MOST_SHOWN = 5  # numbers in one message
MENDED = "faces were joined without the links of edges, which are wrong"


class FeatureRows(NamedTuple):
    """Features of a class, or primitives of a coverage, in the order of their tables.

    Attributes
    ----------
    fields : dict of str to Field
        By names in lower case.
    geometry : object (n,)
        Of shapely; None where there is none.
    problems : tuple of str
        What could not be read, or not as it stands there; lines as of errors.
    """

    fields: dict[str, Field]
    geometry: Geometries
    problems: tuple[str, ...]


class _References(NamedTuple):
    """Which primitives features have: rows of the feature table from 0, ids of tiles (0: none) and of primitives."""

    row: Ids
    tile: Ids
    primitive: Ids


class _Parts(NamedTuple):
    """Geometries of the primitives asked for, their texts if they have some, and what was wrong."""

    geometry: Geometries
    texts: NDArray[np.object_]
    problems: tuple[str, ...]


def read_class(coverage: Coverage, found: FeatureClass) -> FeatureRows:
    """Read the features of a class.

    Parameters
    ----------
    coverage : Coverage
    found : FeatureClass
        One of `vpfx.vpf.opening.feature_classes`.

    Returns
    -------
    FeatureRows
        Fields are those of the feature table; of texts also ``string``, the text itself. A feature whose tile or primitive
        is not there, or broken, has no geometry, and a problem says so.

    Raises
    ------
    NotFoundError
        The feature table or the join table is not there.
    VpfFormatError
        One of them is broken, or GEOS cannot unite areas.

    Notes
    -----
    Cost: O(rows) and O(n log n) in the primitives of each tile that the class has primitives in.
    """
    where = f"{coverage.path}: {found.name}"
    table = read_table(coverage.table(found.table))
    fields = decode_fields(table, coverage.value_descriptions, found.table)
    if not found.primitive:
        return FeatureRows(fields, np.full(table.n_row, None, object), ())
    references, problems = _references(coverage, found, table, where)
    parts = _read_parts(coverage, found.primitive, references, where)
    try:
        with np.errstate(all="ignore"):  # places may be as great as doubles are
            kind = PRIMITIVES[found.primitive]  # whatever fca says
            geometry = merge_parts(kind, references.row, references.tile, parts.geometry, table.n_row)
    except shapely.errors.ShapelyError as error:
        reason = " ".join(str(error).split())
        raise VpfFormatError(where, "", f"found primitives that cannot be put together: {reason}", "V-420") from error
    if found.primitive == "txt":
        strings: list[str | None] = [None] * table.n_row
        for row, text in zip(references.row[::-1].tolist(), parts.texts[::-1].tolist(), strict=True):
            strings[row] = text
        fields[free_name("string", set(fields))] = text_field(strings)
    return FeatureRows(fields, geometry, (*problems, *_row_problems(coverage, references), *parts.problems))


def _row_problems(coverage: Coverage, references: _References) -> tuple[str, ...]:
    """Rows that are no tiles, where tiles are asked for; a tile reference that is broken is told with them."""
    with suppress(VpfFormatError):
        return coverage.library.problems if references.tile.any() else ()
    return ()


def _references(
    coverage: Coverage, found: FeatureClass, table: Table, where: str
) -> tuple[_References, tuple[str, ...]]:
    """Primitives of each feature, each once."""
    source, key, rows = table, found.prim_key, np.arange(table.n_row, dtype=np.int64)
    problems: tuple[str, ...] = ()
    if found.join is not None:
        source, key = read_table(coverage.table(found.join.table)), found.join.primitive_key
        own = ids_of(table, "id") if "id" in table else rows + 1
        features = ids_of(source, found.join.feature_key)
        rows = find_rows(own, features)
        problems = _told(where, f"rows of {found.join.table} name features that are missing", features[rows < 0])
    elif key.lower() == "id" and f"{found.primitive}_id" in table:
        key = f"{found.primitive}_id"
    primitive = ids_of(source, key)
    tile = ids_of(source, "tile_id") if "tile_id" in source else np.zeros(source.n_row, np.int64)
    with suppress(VpfFormatError):  # of the tile reference: told where primitives are read
        if tile.any() and coverage.find(_table_of(found.primitive)) is not None:
            tile = np.where(_is_tile(coverage, tile), tile, 0)
    triples = np.stack([rows, tile, primitive], axis=1)[(rows >= 0) & (primitive > 0)]
    _, first = np.unique(triples, axis=0, return_index=True)
    return _References(*triples[np.sort(first)].T), problems


def _told(where: str, what: str, numbers: Ids, of: str = "") -> tuple[str, ...]:
    """One line on some numbers; none if there are none."""
    if len(numbers) == 0:
        return ()
    shown = ", ".join(map(str, np.unique(numbers)[:MOST_SHOWN].tolist()))
    more = ", …" if len(np.unique(numbers)) > MOST_SHOWN else ""
    return (f"{where}: {len(numbers):,} {what}: {of}{shown}{more}",)


def _read_parts(coverage: Coverage, primitive: str, references: _References, where: str) -> _Parts:
    """Geometries of primitives, one tile after the other."""
    n = len(references.row)
    geometry: Geometries = np.full(n, None, object)
    texts: NDArray[np.object_] = np.full(n, None, object)
    problems: list[str] = []
    is_missing = np.zeros(n, bool)
    try:
        is_missing = ~_is_tile(coverage, references.tile)
        asked = np.flatnonzero(~is_missing)
    except VpfFormatError as error:
        problems.append(str(error))
        asked = np.flatnonzero(references.tile == 0)
    asked = asked[np.argsort(references.tile[asked], kind="stable")]
    for rows in np.split(asked, np.flatnonzero(np.diff(references.tile[asked])) + 1) if len(asked) else ():
        tile = int(references.tile[rows[0]])
        try:
            part = _read_tile(coverage, primitive, tile, references.primitive[rows], where)
        except NotFoundError as error:
            is_missing[rows] = tile > 0
            problems += [] if tile else [str(error)]
        except VpfFormatError as error:
            problems.append(str(error))
        else:
            geometry[rows], texts[rows] = part.geometry, part.texts
            problems += part.problems
    what = f"primitives of {primitive} lie in tiles that are missing"
    problems += _told(where, what, references.tile[is_missing], "tiles ")
    return _Parts(geometry, texts, tuple(dict.fromkeys(problems)))


def _table_of(primitive: str) -> str:
    """Name of the table that primitives are made from."""
    return "edg" if primitive == "fac" else primitive


def _is_tile(coverage: Coverage, tile: Ids) -> NDArray[np.bool_]:
    """Tell which ids are those of tiles, or 0: the coverage itself."""
    return np.isin(tile, [0, *(coverage.library.tiles if tile.any() else ())])


def _read_tile(coverage: Coverage, primitive: str, tile: int, ids: Ids, where: str) -> _Parts:
    """Geometries of some primitives of a tile."""
    table = read_table(coverage.table(_table_of(primitive), tile))
    place = f"{where}: tile {tile}" if tile else where
    texts: NDArray[np.object_] = np.full(len(ids), None, object)
    problems: tuple[str, ...] = ()
    if primitive == "fac":
        faces = face_polygons(table, np.unique(ids))
        known, shapes = faces.ids, faces.polygons
        problems += _told(place, MENDED, np.intersect1d(faces.mended, ids))
    else:
        known = ids_of(table, "id") if "id" in table else np.arange(1, table.n_row + 1)
        if primitive == "txt":
            strings, shapes = text_places(table)
        else:
            shapes = edge_lines(table) if primitive == "edg" else node_points(table)
    at = find_rows(known, ids)
    geometry: Geometries = np.full(len(ids), None, object)
    geometry[at >= 0] = shapes[at[at >= 0]]
    if primitive == "txt":
        texts[at >= 0] = np.array([*strings, None], object)[at[at >= 0]]
    is_lost = shapely.is_missing(geometry)
    problems += _told(place, f"primitives of {primitive} are missing, or have no shape", ids[is_lost])
    return _Parts(geometry, texts, problems)


def class_tables(coverage: Coverage, found: FeatureClass) -> list[Path]:
    """Tables that the geometry and the fields of a class are read from, those that are there; index files are none.

    Raises
    ------
    NotFoundError, VpfFormatError
        As `read_class`.
    """
    library = coverage.library
    paths = [find(library.path, name, within=library.root) for name in ("grt", "tileref/tileref.aft")]
    names = ["fcs", "int.vdt", "char.vdt", found.table, *([found.join.table] if found.join else [])]
    paths += [coverage.find(name) for name in names]
    if found.primitive:
        table = read_table(coverage.table(found.table))
        references, _ = _references(coverage, found, table, "")
        for tile in np.unique(references.tile).tolist():
            with suppress(NotFoundError):
                paths.append(coverage.table(_table_of(found.primitive), tile))
    return [path for path in paths if path is not None]


def tiles_of(coverage: Coverage, primitive: str) -> list[int]:
    """Tiles in which a coverage has a table of primitives, ascending; 0 is the coverage itself."""
    name = _table_of(primitive)
    return [tile for tile in (0, *sorted(coverage.library.tiles)) if coverage.find(name, tile) is not None]


def has_faces(coverage: Coverage) -> bool:
    """Tell whether edges of a coverage name faces: its topology level is 3."""
    for tile in tiles_of(coverage, "fac"):
        with suppress(NotFoundError, VpfFormatError), open_table(coverage.table("edg", tile)) as file:
            return any(column.name.lower() == "right_face" for column in file.layout.columns)
    return False


def read_primitives(coverage: Coverage, primitive: str) -> FeatureRows:
    """Read all primitives of one kind of a coverage.

    Parameters
    ----------
    coverage : Coverage
    primitive : str
        edg, fac, end, cnd or txt. Faces are made from the edges; ``fac`` and ``rng`` are not needed.

    Returns
    -------
    FeatureRows
        Tile by tile. Fields are those of the table (of faces ``id`` alone) and ``tile_id``, 0 where there are no tiles.

    Raises
    ------
    VpfFormatError
        A name leads elsewhere. What is broken in a tile, or lacks, is told by `problems`.
    """
    tables: list[dict[str, Field]] = []
    shapes: list[Geometries] = []
    asked = tiles_of(coverage, primitive)
    problems = [*coverage.library.problems] if any(asked) else []
    for tile in asked:
        try:
            fields, geometry, told = _primitives_of_tile(coverage, primitive, tile)
        except (NotFoundError, VpfFormatError) as error:
            problems.append(str(error))
            continue
        tiles = np.full(len(geometry), tile, np.int32)
        tables.append(fields | {"tile_id": Field(tiles, np.zeros(len(tiles), bool))})
        shapes.append(geometry)
        problems += told
    return FeatureRows(_stacked(tables), np.concatenate([np.empty(0, object), *shapes]), tuple(problems))


def _primitives_of_tile(
    coverage: Coverage, primitive: str, tile: int
) -> tuple[dict[str, Field], Geometries, tuple[str, ...]]:
    """Fields and geometries of all primitives of a tile, and what was wrong."""
    table = read_table(coverage.table(_table_of(primitive), tile))
    if primitive != "fac":
        fields = decode_fields(table, without=("coordinate", "coordinates", "shape_line"))
        if primitive == "txt":
            return fields, text_places(table)[1], ()
        return fields, edge_lines(table) if primitive == "edg" else node_points(table), ()
    faces = face_polygons(table)
    place = f"{coverage.path}: tile {tile}" if tile else str(coverage.path)
    problems = _told(place, MENDED, faces.mended) + _told(place, "faces have edges that do not close up", faces.lost)
    return {"id": Field(faces.ids, np.zeros(len(faces.ids), bool))}, faces.polygons, problems


def _stacked(tables: list[dict[str, Field]]) -> dict[str, Field]:
    """Fields of all tables one below the other; null where a table lacks one."""
    names = list(dict.fromkeys(name for table in tables for name in table))
    return {name: _column(name, tables) for name in names}


def _column(name: str, tables: Iterable[dict[str, Field]]) -> Field:
    parts = []
    for table in tables:
        n_row = len(table["tile_id"].values)
        parts.append(table.get(name, Field(np.zeros(n_row, np.int16), np.ones(n_row, bool))))
    values = [part.values for part in parts]
    if any(value.dtype == object for value in values):
        return text_field([None if value is None else str(value) for part in parts for value in part.to_list()])
    return Field(np.concatenate(values), np.concatenate([part.is_null for part in parts]))
