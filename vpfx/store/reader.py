"""Reading a store: levels, tiles, rows as arrays, and `Tin` objects of a level and region.

A store from a stranger is read safely: read-only, with untrusted schema, and only if its tables are those of the schema.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import InputError, NotFoundError, StoreError, StoreFormatError
from vpfx.model import CUTS, Extent, Tin
from vpfx.store.arrays import NONE_ID, TableReader, runs_of, to_array
from vpfx.store.classes import FeatureClass, read_classes
from vpfx.store.connection import open_reading
from vpfx.store.contents import check_schema, read_extent, read_levels, read_metadata
from vpfx.store.descent import descend, mesh_of
from vpfx.store.digest import REALS
from vpfx.store.mapping import key_of
from vpfx.store.recent import Recent

__all__ = ["StoreReader", "open_reader"]

_RANGED = ("node", "edge", "face")


def open_reader(path: str | Path) -> StoreReader:
    """Open a store for reading as `vpfx.open_store` does, without the questions as methods."""
    return StoreReader(Path(path))


class StoreReader:
    """A store open for reading; made by `open_reader`.

    Attributes
    ----------
    path : Path
        The file.
    metadata : dict
        What was built, from what and how; values that were not text are decoded from JSON.
    levels : tuple of LevelSummary
        Counts, bounds and measured errors, coarse to fine.
    crs : str
        CRS as WKT2; empty if unknown.
    extent : Extent
        Rectangle spanned by the posts.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        if not path.is_file():
            raise NotFoundError(
                f"{path}: found {'a folder' if path.is_dir() else 'no such file'}, expected a store made by vpfx build"
            )
        try:
            key = key_of(path)
        except OSError as error:
            raise StoreError(f"{path}: cannot be opened: {error}") from error
        self._connection = open_reading(path)
        try:
            if key_of(path) != key:
                raise StoreError(f"{path}: was replaced while it was opened; try again")
            self._connection.execute("BEGIN")  # all that is read from here on is of one state of the file
            check_schema(self._connection, path)
            self.metadata = read_metadata(self._connection, str(path))
            self.levels = read_levels(self._connection, str(path))
            self.extent = read_extent(self._connection, str(path))
            self.crs = str(self.metadata["crs_wkt2"])
            self._connection.execute("COMMIT")
            self._reader = TableReader(self._connection, path, key)
            self._recent = Recent()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.path} with {len(self.levels)} levels>"

    @cached_property
    def is_nested(self) -> bool:
        """Whether each face has at most one parent."""
        return self._connection.execute("SELECT 1 FROM shared_area LIMIT 1").fetchone() is None

    @property
    def sources(self) -> list[dict[str, Any]]:
        """The files of posts and features: name, sha256, byte_count, driver."""
        names = ("name", "sha256", "byte_count", "driver")
        rows = self.raw(f"SELECT {', '.join(names)} FROM source ORDER BY source_id")
        return [dict(zip(names, row, strict=True)) for row in rows]

    @property
    def classes(self) -> dict[str, FeatureClass]:
        """Feature classes by name, checked: their names may stand in SQL.

        Raises
        ------
        StoreFormatError
            The table of a class is not the one its columns make.
        """
        return read_classes(self._connection, self.path)

    @property
    def cuts(self) -> NDArray[np.int64]:
        """Cuts made on the way to each level, by kind, (n_level, 5): see `vpfx.model.CUTS`."""
        found = np.zeros((len(self.levels), len(CUTS)), np.int64)
        for level, kind, count in self._connection.execute("SELECT level, kind, cut_count FROM level_cut"):
            if not (level in range(len(self.levels)) and kind in CUTS and isinstance(count, int)):
                message = f"found cuts {(level, kind, count)}, expected a level and a kind of cut"
                raise StoreFormatError(str(self.path), "table level_cut", message, "R-122")
            found[level, CUTS.index(kind)] = count
        return found

    def tiles(self, bbox: Sequence[float] | None = None) -> dict[str, NDArray[Any]]:
        """Tiles, all or those that touch a rectangle, as columns of the table `tile`."""
        query = "SELECT * FROM tile"
        if bbox is not None:
            min_x, min_y, max_x, max_y = _checked_box(bbox)
            touching = "SELECT tile_id FROM tile_index WHERE xmax >= ? AND xmin <= ? AND ymax >= ? AND ymin <= ?"
            query += f" WHERE tile_id IN ({touching})"
            return self.select(f"{query} ORDER BY tile_id", (min_x, max_x, min_y, max_y))
        return self.select(f"{query} ORDER BY tile_id")

    def rows(self, table: str, level: int, tile_id: int | None = None) -> dict[str, NDArray[Any]]:
        """Rows of one level as arrays.

        Parameters
        ----------
        table : str
            ``node`` (those new at the level), ``edge`` or ``face``.
        level : int
        tile_id : int, optional
            Only the rows of one tile.

        Returns
        -------
        dict of str to array
            One int64 or float64 array a column, in the order of ids; NULL is -1.

        Raises
        ------
        InputError, NotFoundError
            No such table, level or tile.
        """
        if table not in _RANGED:
            raise InputError(f"table: found {table!r}, expected one of: {', '.join(_RANGED)}")
        self.check_level(level)
        where, values = "level = ?", [level]
        if tile_id is not None:
            if not self._connection.execute("SELECT 1 FROM tile WHERE tile_id = ?", (tile_id,)).fetchone():
                raise NotFoundError(f"{self.path}: found no tile {tile_id}")
            where, values = f"{where} AND tile_id = ?", [level, tile_id]
        columns = [row[1] for row in self._connection.execute(f"PRAGMA table_info({table})") if row[1] != "xyz"]
        return self.select(f"SELECT {', '.join(columns)} FROM {table} WHERE {where} ORDER BY {table}_id", values)

    def fetch(self, table: str, ids: Any) -> dict[str, NDArray[Any]]:
        """Rows with given ids as arrays.

        Parameters
        ----------
        table : str
            ``node``, ``edge`` or ``face``.
        ids : integers (n,)
            In any order, also more than once.

        Returns
        -------
        dict of str to array
            One int64 or float64 array of n a column that holds numbers, in the order asked; NULL is -1, or NaN in columns
            of reals.

        Raises
        ------
        InputError, NotFoundError
            There is no such table, or no row with one of the ids.

        Notes
        -----
        Cost: O(pages with such rows, ids · log ids).
        """
        if table not in _RANGED:
            raise InputError(f"table: found {table!r}, expected one of: {', '.join(_RANGED)}")
        wanted, index = np.asarray(ids, np.int64).ravel(), None
        if (wanted[1:] <= wanted[:-1]).any():
            wanted, index = np.unique(wanted, return_inverse=True)
        rows = self._reader.rows(table, runs_of(wanted))
        if len(rows[f"{table}_id"]) < len(wanted):
            raise NotFoundError(f"{self.path}: found no {table} {np.setdiff1d(wanted, rows[f'{table}_id'])[0]}")
        return rows if index is None else {name: values[index] for name, values in rows.items()}

    def links(self, level: int) -> NDArray[np.int64]:
        """Pairs (parent_face, child_face) from the level before to this one, in the order of children."""
        self.check_level(level)
        query = (
            "SELECT p.parent_face, p.child_face FROM tile_level r CROSS JOIN parent_child p "
            "ON p.child_face BETWEEN r.first_face AND r.last_face WHERE r.level = ? ORDER BY p.child_face, p.parent_face"
        )
        columns = self.select(query, (level,))
        return np.stack([columns["parent_face"], columns["child_face"]], axis=1)

    def tin(self, level: int, bbox: Sequence[float] | None = None) -> Tin:
        """Return one level as a `Tin`, whole or the faces that touch a rectangle.

        Parameters
        ----------
        level : int
            From 0, the coarsest.
        bbox : four numbers, optional
            min_x, min_y, max_x, max_y in CRS units; a face counts if its own bounding box touches it.

        Returns
        -------
        Tin
            With face attributes face_id, tile_id, is_filled, slope and aspect (degrees, NaN for level ground) and node
            attributes node_id, level and z_parent (metres, NaN on level 0).

        Raises
        ------
        InputError, NotFoundError
            The rectangle is none, or there is no such level.

        Notes
        -----
        Reads only the tiles that touch the rectangle, and of nested levels only what lies there: see `vpfx.store.descent`.
        """
        self.check_level(level)
        if bbox is None:
            mesh = mesh_of(self, self.faces_of_tiles(level, self.tiles()["tile_id"]))
        else:
            mesh = descend(self, level, _checked_box(bbox))
        faces, nodes = mesh.faces, mesh.nodes
        aspect = faces["aspect_centidegrees"]
        attributes = {
            "face_id": faces["face_id"], "tile_id": faces["tile_id"], "is_filled": faces["is_filled"].astype(bool),
            "slope": faces["slope_centidegrees"] / 100.0, "aspect": np.where(aspect == NONE_ID, np.nan, aspect / 100.0),
        }  # fmt: skip
        known = {"node_id": nodes["node_id"], "level": nodes["level"].astype(np.int32), "z_parent": nodes["z_parent"]}
        return Tin(mesh.xyz, mesh.face_nodes, attributes, known, crs=self.crs)

    def faces_of_tiles(self, level: int, tile_ids: Any) -> dict[str, NDArray[Any]]:
        """Rows of the faces of one level and some tiles, as of `fetch`."""
        parts = [self.tile_faces(level, tile_id) for tile_id in tile_ids.tolist()] or [self.fetch("face", [])]
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    def tile_faces(self, level: int, tile_id: int) -> dict[str, NDArray[Any]]:
        """Rows of the faces of one level and tile, as of `fetch`."""
        query = "SELECT first_face, last_face FROM tile_level WHERE tile_id = ? AND level = ?"
        limits = self._connection.execute(query, (tile_id, level)).fetchone()
        if limits == (None, None):
            return self.fetch("face", [])
        where = f"table tile_level: tile {tile_id}, level {level}"
        if limits is None or not all(isinstance(limit, int) for limit in limits):
            raise StoreFormatError(str(self.path), where, f"found {limits}, expected a range of faces", "R-132")
        rows = self._reader.rows("face", [limits])
        if (rows["level"] != level).any() or (rows["tile_id"] != tile_id).any():
            raise StoreFormatError(str(self.path), where, "found faces of another tile or level", "R-132")
        return rows

    @contextmanager
    def snapshot(self) -> Iterator[None]:
        """Surround questions that are to see one state of the file, whatever others write meanwhile.

        Raises
        ------
        StoreError
            Somebody is writing.

        Notes
        -----
        A writer in another process or with `vpfx.store.edit` waits with the end of its transaction until this one is over.
        """
        with self._reader.held():
            yield

    def keep(self, key: Hashable, make: Callable[[], tuple[Any, ...]]) -> tuple[Any, ...]:
        """Return what was made under a key, or make it; what was used last is kept until somebody changes the file.

        Parameters
        ----------
        key : hashable
        make : callable
            Gives a tuple of arrays and other values; nobody may change them.
        """
        (version,) = self._connection.execute("PRAGMA data_version").fetchone()
        return self._recent.get(key, version, make)

    def linked(self, own: str, ids: Any) -> NDArray[np.int64]:
        """Pairs of the ids of some faces and those of their parents or children.

        Parameters
        ----------
        own : str
            ``child_face`` to find the parents of the faces, ``parent_face`` to find their children.
        ids : int64 (n,)
            Ascending, each once.

        Returns
        -------
        int64 (n_pair, 2)
            Ascending.
        """
        return self._reader.links(own, runs_of(ids))

    def level_or_finest(self, level: int | None) -> int:
        """Return a level, the finest if none is given.

        Raises
        ------
        NotFoundError
            There is no such level.
        """
        number = len(self.levels) - 1 if level is None else level
        self.check_level(number)
        return number

    def check_level(self, level: int) -> None:
        """Refuse a level that is not there.

        Raises
        ------
        NotFoundError
        """
        if not 0 <= level < len(self.levels):
            raise NotFoundError(f"{self.path}: found no level {level}, expected 0…{len(self.levels) - 1}")

    def feature_values(self, found: FeatureClass, low: int, high: int) -> dict[int, tuple[Any, ...]]:
        """Values of the features of a class with ids from low to high, by id, as SQLite gives them."""
        names = ", ".join(found.columns)
        query = f"SELECT feature_id, {names} FROM {found.name} WHERE feature_id BETWEEN ? AND ?"
        return {row[0]: row[1:] for row in self._connection.execute(query, (low, high))}

    def raw(self, query: str, values: Sequence[Any] = ()) -> list[tuple[Any, ...]]:
        """Run a query and return its rows as SQLite gives them."""
        return self._connection.execute(query, values).fetchall()

    def select(self, query: str, values: Sequence[Any] = ()) -> dict[str, NDArray[Any]]:
        """Run a query and return its columns as arrays; NULL is -1, or NaN in columns of reals.

        Raises
        ------
        StoreFormatError
            A value is not of the kind of its column, as far as the first one tells.
        """
        cursor = self._connection.execute(query, values)
        names = [column[0] for column in cursor.description]
        rows = cursor.fetchall()
        columns = zip(*rows, strict=True) if rows else ([] for _ in names)
        try:
            return {name: to_array(column, name in REALS) for name, column in zip(names, columns, strict=True)}
        except (TypeError, ValueError, OverflowError) as error:
            raise StoreFormatError(
                str(self.path), ", ".join(names), "found a value of another kind", "R-102"
            ) from error


def _checked_box(bbox: Any) -> Extent:
    """Return a rectangle."""
    try:
        box = Extent(*map(float, bbox))
    except (TypeError, ValueError):
        box = Extent(*[np.nan] * 4)
    if not np.isfinite(box).all() or box.min_x > box.max_x or box.min_y > box.max_y:
        raise InputError(f"bbox: found {bbox}, expected min_x, min_y, max_x, max_y")
    return box
