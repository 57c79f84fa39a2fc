"""Folders and tables of a VPF directory, read so that whatever is wrong with one is told and nothing else fails.

::

    Folder ─ tables, folders ─► TableData ─ head, rows, batches ─► arrays, or None with a `problem`
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import NotFoundError, VpfFormatError
from vpfx.vpf.header import TEXT_KINDS, Layout
from vpfx.vpf.index_file import find_index
from vpfx.vpf.table import Ragged, Table, open_table
from vpfx.vpf.values import NULL_INT, NULL_SHORT, texts

__all__ = [
    "BATCH",
    "Folder",
    "Head",
    "Places",
    "TableData",
    "kind_of",
    "numbers",
    "places",
    "read_index",
    "rectangles",
    "rounded",
    "text_values",
    "triplets",
]

BATCH = 1 << 18
"""Rows that are in memory at a time where a table is gone through."""

FIXED = {
    "dht", "lat", "lht", "grt", "cat", "dqt", "fcs", "fca", "end", "cnd", "edg", "fac", "rng", "txt", "ebr", "fbr",
}  # fmt: skip
"""Tables without a suffix."""
SUFFIXES = {f"{kind}{form}" for kind in "aplct" for form in ("ft", "jt")} | {
    "fit", "vdt", "rat", "doc", "rjt", "njt", "dpt", "rpt", "abr", "lbr", "tbr", "pbr", "cbr",
}  # fmt: skip

MOST_INDEX = 1 << 31
"""Bytes of a spatial or thematic index that is read."""

CORNERS = ("xmin", "ymin", "xmax", "ymax")

Ids = NDArray[np.int64]
Index = TypeVar("Index")


class Head(NamedTuple):
    """What is known of a table before its rows are read."""

    layout: Layout
    n_row: int
    stray: int
    index_problem: str
    has_index: bool


class Places(NamedTuple):
    """Coordinates of rows: row i has ``xyz[starts[i]:starts[i + 1]]``; z is NaN where there is none."""

    starts: Ids
    xyz: NDArray[np.float64]

    def boxes(self) -> NDArray[np.float64]:
        """Box of each row, float64 (n_row, 4); NaN where a row has no place.

        Examples
        --------
        >>> Places(np.array([0, 2, 2]), np.array([[0, 5, 0], [3, 1, 0.0]])).boxes().tolist()
        [[0.0, 1.0, 3.0, 5.0], [nan, nan, nan, nan]]
        """
        boxes = np.full((len(self.starts) - 1, 4), np.nan)
        (row,) = np.nonzero(np.diff(self.starts))
        if len(row):
            xy, first = self.xyz[:, :2], self.starts[row]
            boxes[row, :2] = np.minimum.reduceat(xy, first)
            boxes[row, 2:] = np.maximum.reduceat(xy, first)
        return boxes


class Folder:
    """A directory and what is in it, by names in lower case without a dot behind them.

    Parameters
    ----------
    root : Path
        The directory that no link leads out of.
    path : Path
    where : str
        What findings call it: the path below the root, with slashes; empty if it is the root.

    Attributes
    ----------
    files, folders : dict of str to Path
    outside : tuple of str
        Names of links that lead out of the root, and of what is neither file nor directory.
    problem : str
        Why the directory cannot be listed; empty if it can.
    """

    def __init__(self, root: Path, path: Path, where: str) -> None:
        self.root, self.path, self.where = root, path, where
        self.files: dict[str, Path] = {}
        self.folders: dict[str, Path] = {}
        self.outside: tuple[str, ...] = ()
        self.problem = ""
        try:
            self._list(os.path.realpath(root))
        except OSError as error:
            self.problem = f"cannot be read: {error.strerror}"

    def _list(self, base: str) -> None:
        with os.scandir(self.path) as entries:
            for entry in sorted(entries, key=lambda entry: (entry.name.endswith("."), entry.name)):
                real = os.path.realpath(entry.path) if entry.is_symlink() else ""
                is_outside = bool(real) and real != base and not real.startswith(os.path.join(base, ""))
                if is_outside or not (entry.is_file() or entry.is_dir()):
                    self.outside = (*self.outside, entry.name)
                    continue
                kept = self.files if entry.is_file() else self.folders
                kept.setdefault(entry.name.rstrip(".").lower(), Path(entry.path))

    @cached_property
    def tables(self) -> dict[str, TableData]:
        """Files that are tables by their names."""
        return {name: TableData(self, name) for name in sorted(self.files) if kind_of(name)}

    def table(self, name: str) -> TableData | None:
        """The file of a name, as a table; None if there is no such file."""
        name = name.strip().rstrip(".").lower()
        found = self.tables.get(name)
        if found is None and name in self.files:
            found = self.tables[name] = TableData(self, name)
        return found

    def below(self, *names: str) -> Folder | None:
        """A directory further down; None if there is none."""
        folder = self
        for name in names:
            path = folder.folders.get(name.rstrip(".").lower())
            if path is None:
                return None
            folder = Folder(folder.root, path, folder.place(path.name))
        return folder

    def place(self, name: str) -> str:
        """What findings call something in the folder."""
        return f"{self.where}/{name}" if self.where else name


def kind_of(name: str) -> str:
    """What a file is by its name: a table of the standard, a suffix, or nothing of VPF's tables.

    Examples
    --------
    >>> kind_of("edg"), kind_of("roadl.lft"), kind_of("edx"), kind_of("readme.txt")
    ('edg', 'lft', '', '')
    """
    stem, dot, suffix = name.rpartition(".")
    if not dot:
        return name if name in FIXED else ""
    return suffix if stem and suffix in SUFFIXES else ""


class TableData:
    """One table.

    Attributes
    ----------
    path : Path
    name : str
        In lower case, without a dot behind it.
    where : str
        What findings call it.
    level : int or None
        Topology level of the coverage it is part of, if that is known.
    above : Folder or None
        The folder of the coverage, if the table lies in one of its tiles.
    """

    def __init__(self, folder: Folder, name: str) -> None:
        self.folder, self.name, self.path = folder, name, folder.files[name]
        self.level: int | None = None
        self.above: Folder | None = None
        self.kind = kind_of(name)
        self.where = folder.place(self.path.name)

    @cached_property
    def _opened(self) -> tuple[Head | None, str]:
        try:
            with open_table(self.path) as file:
                has_index = not file.layout.is_variable or find_index(self.path) is not None
                return Head(file.layout, file.n_row, file.stray, file.index_problem, has_index), ""
        except (VpfFormatError, NotFoundError) as error:
            return None, _message(error)

    @property
    def head(self) -> Head | None:
        """Layout and number of rows; None if the table is broken."""
        return self._opened[0]

    @property
    def problem(self) -> str:
        """Why there is no head."""
        return self._opened[1]

    @property
    def n_row(self) -> int:
        """Number of rows; 0 if the table is broken."""
        return 0 if self.head is None else self.head.n_row

    @cached_property
    def _read(self) -> tuple[Table | None, str]:
        try:
            if self.head is not None:
                with open_table(self.path) as file:
                    return file.read(), ""
        except (VpfFormatError, NotFoundError) as error:
            return None, _message(error)
        return None, self.problem

    @property
    def rows(self) -> Table | None:
        """All rows; None if they cannot be read."""
        return self._read[0]

    def batches(self) -> Iterator[tuple[int, Table]]:
        """Yield the rows in parts, each with the index of its first.

        Raises
        ------
        VpfFormatError
            A row breaks the layout.
        """
        if self.head is not None:
            with open_table(self.path) as file:
                for start in range(0, file.n_row, BATCH):
                    yield start, file.read(start, start + BATCH)

    def column(self, name: str) -> Any:
        """A column of all rows; None if there is none, or the rows cannot be read."""
        return self.rows[name] if self.rows is not None and name in self.rows else None


def _message(error: VpfFormatError | NotFoundError) -> str:
    """What an error says, without the path."""
    text = str(error)
    return text.removeprefix(f"{error.path}: ") if isinstance(error, VpfFormatError) and error.path else text


def rounded(numbers: Iterable[float]) -> str:
    """Places and rectangles in messages: nine digits a number.

    Examples
    --------
    >>> rounded([-97.75029754638672, 30])
    '(-97.7502975, 30)'
    """
    return "(" + ", ".join(f"{number:.9g}" for number in numbers) + ")"


def read_index(path: Path, decode: Callable[[bytes, str], Index]) -> tuple[Index | None, str]:
    """Return the index that the bytes of a file are; None, and what is wrong with them, if they are none."""
    try:
        size = path.stat().st_size
        if size > MOST_INDEX:
            return None, f"found {size} bytes, expected at most {MOST_INDEX}"
        return decode(path.read_bytes(), ""), ""
    except OSError as error:
        return None, f"cannot be read: {error.strerror}"
    except VpfFormatError as error:
        return None, str(error)


def numbers(table: Table | None, name: str) -> Ids | None:
    """Whole numbers of a column, those of triplets the ids in this tile; nulls are 0. None if there is no such column.

    Examples
    --------
    >>> from vpfx.vpf.table import Column, decode, encode
    >>> numbers(decode(*encode(Layout("", (Column("id", "I"),)), {"id": [7, None]})), "ID")
    array([7, 0])
    """
    if table is None or name not in table:
        return None
    column = table[name]
    if isinstance(column, Ragged) or column.dtype.kind not in "iu" or column.shape[1:] not in ((), (3,)):
        return None
    ids = (column[:, 0] if column.ndim == 2 else column).astype(np.int64)
    null = NULL_SHORT if column.dtype.itemsize == 2 else NULL_INT
    ids[(ids == null) | (ids == null + 1)] = 0
    return ids


def text_values(table: Table | None, name: str) -> list[str | None] | None:
    """Texts of a column, nulls None; None if there is no such column."""
    column = None if table is None else table.layout.find(name)
    return None if table is None or column is None or column.kind not in TEXT_KINDS else texts(table[name])


def rectangles(table: TableData | None) -> NDArray[np.floating[Any]] | None:
    """Columns xmin, ymin, xmax, ymax in the precision of the table (n_row, 4); None if they are not there."""
    rows = None if table is None else table.rows
    columns = [] if rows is None else [rows.layout.find(name) for name in CORNERS]
    if rows is None or any(column is None or column.kind not in "FR" or column.count != 1 for column in columns):
        return None
    return np.stack([rows[name] for name in CORNERS], axis=1)


def triplets(table: Table | None, name: str) -> Ids | None:
    """Triplets of a column, int64 (n_row, 3); plain numbers have no tile. None if there is no such column."""
    ids = numbers(table, name)
    if ids is None or table is None:
        return None
    if table[name].ndim == 2:
        return table[name].astype(np.int64)
    return np.stack([ids, np.zeros_like(ids), np.zeros_like(ids)], axis=1)


def places(table: Table | None, name: str) -> Places | None:
    """Coordinates of a column, in whatever type; None if there is no such column."""
    if table is None or name not in table:
        return None
    column = table[name]
    if isinstance(column, Ragged):
        starts, values = column.starts, column.values
    elif column.dtype.kind == "f" and column.ndim in (2, 3):
        starts = np.arange(table.n_row + 1, dtype=np.int64) * (column.shape[1] if column.ndim == 3 else 1)
        values = column.reshape(-1, column.shape[-1])
    else:
        return None
    if values.dtype.kind != "f" or values.ndim != 2 or values.shape[1] not in (2, 3):
        return None
    xyz = np.full((len(values), 3), np.nan)
    xyz[:, : values.shape[1]] = values
    return Places(np.asarray(starts, np.int64), xyz)
