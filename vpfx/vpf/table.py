"""Tables: files whose header says which columns the rows have, read into arrays and written from them.

    file ─ open_table ─► TableFile ─ read, batches ─► Table (arrays) ─ write_table, TableWriter ─► file and its index

Source: specs/vpf.md, V-100 to V-141.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from vpfx.checks import whole_number
from vpfx.errors import NotFoundError, VpfFormatError
from vpfx.vpf import kernels
from vpfx.vpf.header import COUNTED, TEXT_KINDS, Column, Layout, header_size, parse_header
from vpfx.vpf.index_file import IndexFile, find_index, index_name
from vpfx.vpf.rows import (
    decode_rows,
    empty_column,
    iter_blocks,
    iter_uneven_blocks,
    join_ragged,
    record_type,
    scan_steps,
    step_of,
)
from vpfx.vpf.values import Ragged, texts
from vpfx.vpf.writer import TableWriter, encode, write_table

__all__ = [
    "Column",
    "Layout",
    "Ragged",
    "Table",
    "TableFile",
    "TableWriter",
    "decode",
    "encode",
    "index_name",
    "open_table",
    "read_table",
    "write_table",
]

_SCAN_BYTES = 1 << 20
_CORNERS = ("xmin", "ymin", "xmax", "ymax")


@dataclass(frozen=True, eq=False)
class Table:
    """Rows of one table.

    Examples
    --------
    >>> layout = Layout("Rings", (Column("id", "I", 1, "P"), Column("face_id", "I")))
    >>> table = decode(*encode(layout, {"id": [1, 2], "face_id": [7, None]}))
    >>> table.n_row, table["FACE_ID"]
    (2, array([          7, -2147483648], dtype=int32))
    """

    layout: Layout
    columns: dict[str, Any]  # arrays and Raggeds by lower-case name, in the order of the layout
    n_row: int
    path: str = ""

    def __getitem__(self, name: str) -> Any:
        """Return a column by its name, whatever its case; VpfFormatError if there is none."""
        try:
            return self.columns[name.lower()]
        except KeyError:
            known = ", ".join(self.columns)
            raise VpfFormatError(self.path, f"column {name!r}", f"found none, expected one beside {known}") from None

    def __contains__(self, name: str) -> bool:
        return name.lower() in self.columns

    def texts(self, name: str) -> list[str | None]:
        """Return a column of text as strings, None for nulls; VpfFormatError if it is missing or of another type."""
        return texts(self._of_types(name, TEXT_KINDS))

    def whole_numbers(self, name: str) -> NDArray[np.int64]:
        """Return a column of whole numbers, or the ids of triplets, int64 (n_row,); VpfFormatError as `texts`."""
        values = self._of_types(name, "ISK")
        return (values[:, 0] if values.ndim == 2 else values).astype(np.int64)

    def rectangles(self) -> NDArray[np.float64]:
        """Return columns xmin, ymin, xmax and ymax, float64 (n_row, 4); VpfFormatError as `texts`."""
        return np.stack([self._of_types(name, "FR").astype(np.float64) for name in _CORNERS], axis=1)

    def _of_types(self, name: str, kinds: str) -> Any:
        values, column = self[name], self.layout.find(name)
        assert column is not None
        if column.kind not in kinds or (column.count != 1 and kinds != TEXT_KINDS):
            found = f"found type {column.kind},{'*' if column.count == COUNTED else column.count}"
            raise VpfFormatError(self.path, f"column {name!r}", f"{found}, expected {' or '.join(kinds)}", "V-250")
        return values


class TableFile:
    """A table that is open, to read parts of it; memory is that of the rows asked for.

    Without a right index file 8 bytes a row are held for a table whose rows differ in length.

    Parameters
    ----------
    file : BinaryIO
        The table; closed in the end.
    index : BinaryIO or None
        Its index file, if there is one.
    path : str
        What messages call the table.

    Attributes
    ----------
    layout : Layout
        What the header says.
    n_row : int
        Number of rows.
    stray : int
        Bytes behind the last row, fewer than a row has (V-122).
    index_problem : str
        What is wrong with the index file, or that there is none; empty if all is right or none is needed.

    Raises
    ------
    VpfFormatError
        The header breaks the grammar, or rows cannot be told from each other.
    """

    def __init__(self, file: BinaryIO, index: BinaryIO | None, path: str) -> None:
        self._file, self._index_file, self.path = file, index, path
        self._size = file.seek(0, 2)
        file.seek(0)
        start = file.read(5)
        order, self._first = header_size(start, self._size, path)
        self.layout = parse_header(start[4:] + file.read(self._first - 5), order, path)
        self.index_problem = ""
        self._index: IndexFile | None = None
        self._bounds: NDArray[np.int64] | None = None
        if not self.layout.is_variable:
            self.n_row, self.stray = divmod(self._size - self._first, self.layout.row_size)
            return
        if index is None:
            self.index_problem = "found no index file, expected one (V-130)"
        else:
            self._index = IndexFile(index, order, self._first, self._size, self.layout.row_size)
            self.index_problem = self._index.problem
        if self._index is not None and self._index.is_usable:
            self.n_row, end = self._index.n_row, self._index.end
        else:
            self._bounds = self._scan()
            self.n_row, end = len(self._bounds) - 1, int(self._bounds[-1])
        self.stray = self._size - end

    def __enter__(self) -> TableFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file and its index."""
        self._file.close()
        if self._index_file is not None:
            self._index_file.close()

    def read(self, start: int = 0, stop: int | None = None) -> Table:
        """Return the rows from start to before stop, or to the end, as arrays.

        Raises
        ------
        VpfFormatError
            A row breaks the layout; the message names it.
        """
        start, stop, _ = slice(start, stop).indices(self.n_row)
        stop = max(start, stop)
        columns = self._read_variable(start, stop) if self.layout.is_variable else self._read_fixed(start, stop)
        return Table(self.layout, columns, stop - start, self.path)

    def batches(self, n_row: int) -> Iterator[Table]:
        """Return all rows, so many at a time.

        Raises
        ------
        InputError
            The number is not at least 1.
        VpfFormatError
            As `read`.
        """
        step = whole_number(n_row, "rows of a batch", 1)
        return (self.read(start, start + step) for start in range(0, self.n_row, step))

    def _read_fixed(self, start: int, stop: int) -> dict[str, Any]:
        n_row, size = stop - start, self.layout.row_size
        columns = {column.name.lower(): empty_column(column, n_row) for column in self.layout.columns}
        records = np.empty(min(n_row, step_of(size)), record_type(self.layout))
        self._file.seek(self._first + start * size)
        for rows in iter_blocks(n_row, size):
            part = records[: rows.stop - rows.start]
            self._fill(part.view(np.uint8))
            for name in records.dtype.names:
                columns[name][rows] = part[name]
        return columns

    def _read_variable(self, start: int, stop: int) -> dict[str, Any]:
        if self._bounds is not None:
            bounds = self._bounds[start : stop + 1]
        else:
            assert self._index is not None
            bounds = self._index.bounds(start, stop)
        self._file.seek(int(bounds[0]))
        arrays = {c.name.lower(): empty_column(c, stop - start) for c in self.layout.columns if c.count != COUNTED}
        parts = []
        for rows in iter_uneven_blocks(bounds):
            part: dict[str, Any] = {name: values[rows] for name, values in arrays.items()}
            places = bounds[rows.start : rows.stop + 1]
            data = np.empty(int(places[-1] - places[0]), np.uint8)
            self._fill(data)
            decode_rows(self.layout, data, places - places[0], part, path=self.path, first=start + rows.start)
            parts.append(part)
        names = {column.name.lower(): column for column in self.layout.columns}
        return {
            name: arrays[name] if name in arrays else join_ragged(column, [part[name] for part in parts])
            for name, column in names.items()
        }

    def _fill(self, data: NDArray[np.uint8]) -> None:
        """Read bytes from where the file stands."""
        if self._file.readinto(data.data) != len(data):  # type: ignore[attr-defined]
            raise self._shrunk()

    def _shrunk(self) -> VpfFormatError:
        message = f"found fewer bytes than the {self._size} there were when it was opened, expected as many"
        return VpfFormatError(self.path, "", message, "V-100")

    def _scan(self) -> NDArray[np.int64]:
        """Return where rows start, and where the last ends, int64 (n_row + 1,), found from row to row."""
        steps = scan_steps(self.layout)
        state = np.array([self._first, 0, self._first], np.int64)
        room = np.empty(min(_SCAN_BYTES, self._size) // self.layout.row_size + 1, np.int64)
        found, ended, n_row = [], kernels.OUT_OF_BYTES, 0
        while ended == kernels.OUT_OF_BYTES:
            base, before = int(state[0]), state.copy()
            self._file.seek(base)
            data = np.frombuffer(self._file.read(_SCAN_BYTES), np.uint8)
            n, ended = kernels.scan_rows(data, base, state, self._size, steps, self.layout.order == ">", room)
            found.append(room[:n].copy())
            n_row += n
            if ended == kernels.OUT_OF_BYTES and (state == before).all():
                raise self._shrunk()
        row_start = int(state[2])
        if ended == kernels.RUNS_OVER and self._size - row_start >= self.layout.row_size:
            message = f"found a row at offset {row_start} that runs over the end of the file at {self._size}"
            raise VpfFormatError(self.path, f"row {n_row + 1}", f"{message}, expected it to end before", "V-121")
        return np.concatenate([*found, [row_start]])


def open_table(path: Path | str, *, name: str = "") -> TableFile:
    """Open a table, and its index file if there is one; a context manager.

    Parameters
    ----------
    path : Path or str
        The table.
    name : str, optional
        What messages call it; the path if empty.

    Raises
    ------
    NotFoundError
        There is no such file.
    VpfFormatError
        It is no table, or cannot be read.
    """
    path = Path(path)
    name = name or str(path)
    if not os.path.isfile(path):
        raise NotFoundError(f"{name}: found no file, expected a table")
    with ExitStack() as opened:
        try:
            file = opened.enter_context(open(path, "rb"))
            found = find_index(path)
            index = None if found is None else opened.enter_context(open(found, "rb"))
            table = TableFile(file, index, name)
        except OSError as error:
            raise VpfFormatError(name, "", f"cannot be read: {error.strerror}") from error
        opened.pop_all()
        return table


def read_table(path: Path | str, *, name: str = "") -> Table:
    """Return a whole table.

    Raises
    ------
    NotFoundError, VpfFormatError
        As `open_table` and `TableFile.read`.

    Examples
    --------
    >>> from tempfile import mkdtemp
    >>> path = Path(mkdtemp()) / "cnd"
    >>> layout = Layout("Nodes", (Column("id", "I", 1, "P"), Column("first_edge", "I"), Column("coordinate", "C")))
    >>> write_table(path, layout, {"id": [1], "first_edge": [4], "coordinate": [(10.5, 51.75)]})
    >>> read_table(path)["coordinate"]
    array([[10.5 , 51.75]], dtype=float32)
    """
    with open_table(path, name=name) as file:
        return file.read()


def decode(data: bytes, index: bytes | None = None, path: str = "") -> Table:
    """Return the table that the bytes of a file, and of its index file, are.

    Raises
    ------
    VpfFormatError
        As `open_table` and `TableFile.read`.
    """
    with TableFile(io.BytesIO(data), None if index is None else io.BytesIO(index), path) as file:
        return file.read()
