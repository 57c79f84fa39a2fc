"""Editing the attributes of a store: feature classes, features, and the faces they are on, in one transaction.

Nodes, edges, faces and links are never changed. Readers see the state before until the end of the transaction.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import InputError, NotFoundError, StoreError
from vpfx.store.arrays import SWEEP, runs_of
from vpfx.store.classes import (
    KINDS,
    MOST_COLUMNS,
    Column,
    FeatureClass,
    check_name,
    class_sql,
    find_class,
    read_classes,
    stored,
)
from vpfx.store.connection import error_code, error_kind, refusal
from vpfx.store.contents import check_schema
from vpfx.store.geopackage import register_class, unregister_class
from vpfx.store.mapping import unmapped

__all__ = ["Editor", "Savepoint", "edit_store", "recover", "told"]

Ids = NDArray[np.int64]

BUSY_SECONDS = 5.0
"""How long a writer waits for another one, or for readers at the end."""

ABOVE_ONE = 1e-9
"""By how much shares may add up to more than 1: they are sums of areas."""

MOST_CACHE = -(1 << 20)
"""KiB of pages held in memory, so that none is written before the end: SQLite would lock readers out from then on."""


@contextmanager
def edit_store(path: str | Path) -> Iterator[Editor]:
    """Open a store for editing its attributes: one transaction, kept at the end of the block, undone by an exception.

    Parameters
    ----------
    path : path
        A file made by `vpfx.build`.

    Yields
    ------
    Editor

    Raises
    ------
    NotFoundError
        There is no such file.
    StoreFormatError
        The file is not a store of vpfx.
    StoreError
        Somebody else is writing, or reading at the end for too long; or the file cannot be written.

    Notes
    -----
    The same process may read the file meanwhile, and sees the state before.

    Examples
    --------
    >>> with edit_store("README.md") as editor:
    ...     pass
    Traceback (most recent call last):
    vpfx.errors.StoreFormatError: README.md: found no SQLite database, expected a store made by vpfx build
    """
    path = Path(path)
    if not path.is_file():
        raise NotFoundError(f"{path}: found no such file, expected a store made by vpfx build")
    with unmapped(path):
        connection = sqlite3.connect(
            f"{path.absolute().as_uri()}?mode=rw", uri=True, isolation_level=None, timeout=BUSY_SECONDS
        )
        try:
            connection.execute("PRAGMA trusted_schema = OFF")
            connection.execute("PRAGMA foreign_keys = ON")
            connection.execute(f"PRAGMA cache_size = {MOST_CACHE}")
            connection.execute("PRAGMA cache_spill = OFF")
            connection.execute("BEGIN IMMEDIATE")
            check_schema(connection, path)
            yield Editor(connection, path)
            connection.execute("COMMIT")
        except sqlite3.DatabaseError as error:
            raise told(error, path) from error
        finally:
            connection.close()  # undoes what was not committed


def told(error: sqlite3.DatabaseError, path: Path) -> Exception:
    """Return what SQLite refused as an error of vpfx that says what to do."""
    text, kind = str(error), error_kind(error)
    if error_code(error) == sqlite3.SQLITE_READONLY_ROLLBACK or kind == sqlite3.SQLITE_NOTADB:
        return refusal(error, path)
    if kind in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
        return StoreError(f"{path}: is locked: somebody else writes or reads; nothing was changed, try again later")
    if kind in (sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN):
        return StoreError(f"{path}: cannot be written: {text}; allow writing to the file and its folder")
    if isinstance(error, sqlite3.IntegrityError):
        return InputError(f"{path}: {text}; nothing was changed")
    if isinstance(error, sqlite3.OperationalError):
        return StoreError(f"{path}: cannot be written: {text}")
    return refusal(error, path)


def recover(path: Path) -> None:
    """Undo what a writer that was killed left half done, if there is such; else do nothing.

    SQLite does so by itself when the file is opened for writing; one that only reads cannot.
    """
    if not path.with_name(f"{path.name}-journal").exists():
        return
    with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=rw", uri=True, isolation_level=None)) as connection:
        try:
            connection.execute("SELECT 1 FROM sqlite_schema LIMIT 1").fetchone()
        except sqlite3.DatabaseError as error:
            raise told(error, path) from error


class Savepoint:
    """A state that can be returned to; made by `Editor.savepoint`."""

    def __init__(self, connection: sqlite3.Connection, name: str, is_open: list[str]) -> None:
        self._connection, self._name, self._open = connection, name, is_open

    def undo(self) -> None:
        """Undo everything since the savepoint, those inside it too; it stays, so more can be done and undone.

        Raises
        ------
        InputError
            Its block is over.
        """
        if self._name not in self._open:
            raise InputError("savepoint: found one whose block is over, expected to undo within it")
        del self._open[self._open.index(self._name) + 1 :]
        self._connection.execute(f"ROLLBACK TO {self._name}")


class Editor:
    """Edits the attributes of a store; made by `edit_store`.

    Attributes
    ----------
    path : Path
        The file.
    connection : sqlite3.Connection
        In the transaction; for what `vpfx.query.sql` allows.
    """

    def __init__(self, connection: sqlite3.Connection, path: Path) -> None:
        self.path, self.connection = path, connection
        self._numbers, self._open = count(1), list[str]()

    @property
    def classes(self) -> dict[str, FeatureClass]:
        """Feature classes by name, as they are now."""
        return read_classes(self.connection, self.path)

    @contextmanager
    def savepoint(self) -> Iterator[Savepoint]:
        """Surround steps that are undone together, by `Savepoint.undo` or an exception; may stand inside another."""
        name = f"edit_{next(self._numbers)}"
        self.connection.execute(f"SAVEPOINT {name}")
        self._open.append(name)
        try:
            yield Savepoint(self.connection, name, self._open)
        except BaseException:
            if self.connection.in_transaction and name in self._open:  # else it is undone already
                self.connection.execute(f"ROLLBACK TO {name}")
            raise
        finally:
            if name in self._open:
                del self._open[self._open.index(name) :]
                if self.connection.in_transaction:
                    self.connection.execute(f"RELEASE {name}")

    def create_class(
        self, name: str, columns: Mapping[str, str | Column], description: str = "", class_id: int | None = None
    ) -> FeatureClass:
        """Make a feature class and its table.

        Parameters
        ----------
        name : str
            Also of the table: a small letter, then up to 30 small letters, digits or underscores.
        columns : mapping of str to Column, or to its kind
            One at least.
        description : str
        class_id : int, optional
            One that no class has; the next if left out.

        Raises
        ------
        InputError
            A name is none or taken, or a kind is unknown.
        """
        check_name(name, "class")
        described = {
            check_name(column, "column"): Column(kind) if isinstance(kind, str) else Column(*kind)
            for column, kind in columns.items()
        }
        if self.connection.execute("SELECT 1 FROM sqlite_schema WHERE name = ?", (name,)).fetchone():
            raise InputError(f"class: found {name!r}, a table or view of that name is there; give another name")
        if not 1 <= len(described) <= MOST_COLUMNS or "feature_id" in described:
            raise InputError(f"class {name}: found columns {', '.join(described)}, expected 1 … {MOST_COLUMNS}, "
                             "none of them feature_id")  # fmt: skip
        for column, (kind, _, _) in described.items():
            if kind not in KINDS:
                raise InputError(f"column {column}: found kind {kind!r}, expected one of: {', '.join(KINDS)}")
        with self.savepoint():
            insert = "INSERT INTO feature_class VALUES (?, ?, ?)"
            class_id = self.connection.execute(insert, (class_id, name, description)).lastrowid or 0
            rows = [(class_id, column, *parts) for column, parts in described.items()]
            self.connection.executemany("INSERT INTO feature_column VALUES (?, ?, ?, ?, ?)", rows)
            self.connection.execute(class_sql(name, described))
            register_class(self.connection, name, description)
        return FeatureClass(class_id, name, description, described)

    def drop_class(self, name: str) -> None:
        """Remove a class, its table, its features and what faces have of it.

        Raises
        ------
        NotFoundError
        """
        found = self._class(name)
        with self.savepoint():
            for table in ("face_feature", "feature", "value_description", "feature_column", "feature_class"):
                if table == "feature":
                    self.connection.execute(f"DROP TABLE {found.name}")
                self.connection.execute(f"DELETE FROM {table} WHERE class_id = ?", (found.class_id,))
            unregister_class(self.connection, found.name)

    def describe_values(self, name: str, column: str, descriptions: Mapping[Any, str]) -> None:
        """Say what values of a column mean, in the place of what was said of them before.

        Raises
        ------
        NotFoundError, InputError
            No such class or column, or a value is not of the column's kind.
        """
        found = self._class(name)
        if column not in found.columns:
            raise InputError(f"class {name}: found no column {column!r}, expected one of: {', '.join(found.columns)}")
        rows = [
            (found.class_id, column, str(stored(value, found.columns[column], column)), text)
            for value, text in descriptions.items()
        ]
        self.connection.executemany("INSERT OR REPLACE INTO value_description VALUES (?, ?, ?, ?)", rows)

    def add_features(self, name: str, columns: Mapping[str, Any], feature_ids: Any = None) -> Ids:
        """Add features to a class.

        Parameters
        ----------
        name : str
        columns : mapping of str to sequence (n,)
            Values of some or all columns; None and NaN are NULL.
        feature_ids : integers (n,), optional
            Ids that no feature has; the next ones if left out.

        Returns
        -------
        int64 (n,)
            Their ids.

        Raises
        ------
        NotFoundError, InputError
            No such class or column, columns of different lengths, or a value that is not of its column's kind.
        """
        found = self._class(name)
        unknown = [column for column in columns if column not in found.columns]
        lengths = {len(values) for values in columns.values()}
        if unknown or len(lengths) != 1:
            message = f"no column {unknown[0]!r}" if unknown else f"columns of {sorted(lengths)} values"
            raise InputError(f"class {name}: found {message}, expected as many of each of: {', '.join(found.columns)}")
        values = [[stored(value, found.columns[c], c) for value in given] for c, given in columns.items()]
        (last,) = self.connection.execute("SELECT coalesce(max(feature_id), 0) FROM feature").fetchone()
        n = lengths.pop()
        ids = list(range(last + 1, last + 1 + n)) if feature_ids is None else _whole(feature_ids, "features").tolist()
        if len(ids) != n:
            raise InputError(f"class {name}: found {len(ids)} ids and columns of {n} values, expected as many")
        with self.savepoint():
            rows: Any = ((feature, found.class_id) for feature in ids)
            self.connection.executemany("INSERT INTO feature VALUES (?, ?)", rows)
            places = ", ".join("?" * (1 + len(columns)))
            insert = f"INSERT INTO {name} (feature_id, {', '.join(columns)}) VALUES ({places})"
            self.connection.executemany(insert, zip(ids, *values, strict=True))
        return np.array(ids, np.int64)

    def set_faces(self, name: str, face_ids: Any, feature_ids: Any, shares: Any = None) -> None:
        """Put features on faces, in the place of what these faces had of the class; it holds for all faces below them.

        Parameters
        ----------
        name : str
        face_ids : integers (n,)
            Of any level; a face may stand more than once, with several features.
        feature_ids : integers (n,) or one
        shares : float64 (n,), optional
            Parts of the face's area, above 0, those of a face at most 1 together; 1 each if left out.

        Raises
        ------
        NotFoundError
            No such class or face, or no such feature in the class.
        InputError
            The numbers are of different lengths, a share is out of bounds, or a face has one feature twice.
        """
        found = self._class(name)
        faces, _ = np.unique(_whole(face_ids, "faces"), return_inverse=True)
        given, features = np.broadcast_arrays(_whole(face_ids, "faces"), _whole(feature_ids, "features"))
        parts = np.broadcast_to(np.asarray(1.0 if shares is None else shares, np.float64), given.shape)
        _check_shares(given, features, parts)
        self._check_ids("face", faces, "")
        self._check_ids("feature", np.unique(features), f" AND class_id = {found.class_id}")
        with self.savepoint():
            self.clear_faces(name, faces)
            rows = zip(given.tolist(), features.tolist(), np.minimum(parts, 1.0).tolist(), strict=True)
            insert = f"INSERT INTO face_feature VALUES (?, {found.class_id}, ?, ?)"
            self.connection.executemany(insert, rows)

    def clear_faces(self, name: str, face_ids: Any) -> None:
        """Take what faces have of a class by themselves; they inherit from then on.

        Raises
        ------
        NotFoundError
            No such class.
        """
        runs = runs_of(np.unique(_whole(face_ids, "faces")))
        query = f"DELETE FROM face_feature WHERE face_id BETWEEN ? AND ? AND class_id = {self._class(name).class_id}"
        self.connection.executemany(query, runs)

    def _class(self, name: str) -> FeatureClass:
        return find_class(self.classes, name, self.path)

    def _check_ids(self, table: str, ids: Ids, further: str) -> None:
        """Refuse ids, ascending and each once, that have no row."""
        key = f"{table}_id"
        query = f"SELECT {key} FROM {table} WHERE {key} BETWEEN ? AND ?{further} ORDER BY {key}"
        for low, high in runs_of(ids, SWEEP):
            known = np.array([row[0] for row in self.connection.execute(query, (low, high))], np.int64)
            first, end = np.searchsorted(ids, (low, high + 1))
            missing = np.setdiff1d(ids[first:end], known)
            if len(missing):
                raise NotFoundError(f"{self.path}: found no {table} {missing[0]}{' of the class' if further else ''}")


def _whole(ids: Any, what: str) -> Ids:
    """Ids as an array."""
    array = np.atleast_1d(np.asarray(ids))
    if array.size and array.dtype.kind not in "iu":
        raise InputError(f"{what}: found {str(ids)[:40]}, expected whole numbers")
    return array.ravel().astype(np.int64)


def _check_shares(faces: Ids, features: Ids, shares: NDArray[np.float64]) -> None:
    """Refuse shares out of bounds, and a face that has a feature twice."""
    wrong = ~((shares > 0) & (shares <= 1 + ABOVE_ONE))
    if wrong.any():
        face, share = faces[wrong][0], shares[wrong][0]
        raise InputError(f"face {face}: found share {share:g}, expected one above 0 and at most 1")
    pairs, count = np.unique(np.stack([faces, features], axis=1), axis=0, return_counts=True)
    if (count > 1).any():
        raise InputError("face {}: found feature {} twice, expected it once".format(*pairs[count > 1][0]))
    known, index = np.unique(faces, return_inverse=True)
    total = np.bincount(index, shares, len(known)) if len(known) else np.empty(0)
    if (total > 1 + ABOVE_ONE).any():
        face, most = known[total > 1 + ABOVE_ONE][0], total.max()
        raise InputError(f"face {face}: found shares that add up to {most:g}, expected at most 1")
