"""Tables written: rows stream to a file beside the target, and their places to one beside its index.

Source: specs/vpf.md, V-140, V-141.
"""

from __future__ import annotations

import io
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

import numpy as np

from vpfx.errors import InputError, StoreError
from vpfx.vpf.given_columns import as_columns
from vpfx.vpf.header import Layout, check_layout, header_bytes
from vpfx.vpf.index_file import MOST_OFFSET, index_entries, index_head, index_names
from vpfx.vpf.rows import encode_rows, iter_blocks, iter_uneven_blocks, record_type, row_sizes, step_of
from vpfx.vpf.values import Ragged

__all__ = ["TableWriter", "encode", "write_table"]


class _Rows:
    """Writes header and rows to one open file, and the entries of an index to another."""

    def __init__(self, layout: Layout, file: BinaryIO, index: BinaryIO | None, path: str) -> None:
        self._layout, self._file, self._index, self._path = layout, file, index, path
        header = header_bytes(layout)
        self._first = self._at = len(header)
        self.n_row = 0
        file.write(header)
        if index is not None:
            index.write(index_head(layout.order, 0, self._first))

    def append(self, given: Mapping[str, Any]) -> None:
        columns, n_row = as_columns(self._layout, given, self._path)
        if self._index is None:
            self._append_fixed(columns, n_row)
        else:
            self._append_variable(columns, n_row, self._index)
        self.n_row += n_row

    def _append_fixed(self, columns: Mapping[str, Any], n_row: int) -> None:
        size = self._layout.row_size
        records = np.empty(min(n_row, step_of(size)), record_type(self._layout))
        for rows in iter_blocks(n_row, size):
            part = records[: rows.stop - rows.start]
            for name in records.dtype.names:
                part[name] = columns[name][rows]
            self._file.write(part.view(np.uint8).data)

    def _append_variable(self, columns: Mapping[str, Any], n_row: int, index: BinaryIO) -> None:
        sizes = row_sizes(self._layout, columns, n_row)
        bounds = np.concatenate([[0], np.cumsum(sizes)])
        end = self._at + int(bounds[-1])
        if end > MOST_OFFSET:
            found = f"found rows up to offset {end}, expected up to {MOST_OFFSET}, what an index file can hold"
            raise InputError(f"{self._path}: {found} (V-141); use smaller tiles")
        for rows in iter_uneven_blocks(bounds):
            part = {
                name: values.rows(rows.start, rows.stop) if isinstance(values, Ragged) else values[rows]
                for name, values in columns.items()
            }
            places = bounds[rows.start : rows.stop + 1]
            self._file.write(encode_rows(self._layout, part, places - places[0]).data)
            index.write(index_entries(self._layout.order, places + self._at))
        self._at = end

    def finish(self) -> None:
        """Write the number of rows into the index."""
        if self._index is not None:
            self._index.seek(0)
            self._index.write(index_head(self._layout.order, self.n_row, self._first))


class TableWriter:
    """Writes a table, and its index file where rows differ in length, in parts; a context manager.

    Rows go to files of other names beside the target, which get their names at the end of the block, the index first. After
    an exception in the block nothing is left of them.

    Parameters
    ----------
    path : Path or str
        The table; one that exists is replaced.
    layout : Layout
        What it has.

    Raises
    ------
    InputError
        The layout, or what is appended, is not what V-104 and V-117 ask for; the table has more than 4 GiB (V-141).
    StoreError
        The medium refuses.

    Examples
    --------
    >>> from tempfile import mkdtemp
    >>> from vpfx.vpf.header import Column
    >>> path = Path(mkdtemp()) / "txt"
    >>> with TableWriter(path, Layout("Texts", (Column("id", "I", 1, "P"), Column("string", "T", -1)))) as writer:
    ...     writer.append({"id": [1], "string": ["Brocken"]})
    ...     writer.append({"id": [2, 3], "string": ["Wurmberg", None]})
    >>> sorted(file.name for file in path.parent.iterdir())
    ['txt', 'txx']
    """

    def __init__(self, path: Path | str, layout: Layout) -> None:
        self.path = Path(path)
        check_layout(layout, str(path))
        names = index_names(self.path.name)  # refuses names of index files for any table
        self._targets = [self.path]
        if layout.is_variable:
            self._targets += [self.path.with_name(name) for name in names]
        self._files: list[BinaryIO] = []
        self._is_open = True
        try:
            for target in self._targets[:2]:
                self._files.append(open(_temporary(target), "w+b"))  # noqa: SIM115  # closed in `close`
            self._rows = _Rows(layout, self._files[0], self._files[1] if layout.is_variable else None, str(path))
        except OSError as error:
            self._discard()
            raise StoreError(f"{path}: cannot be written: {error.strerror}") from error

    def __enter__(self) -> TableWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.close()
        else:
            self._discard()

    @property
    def n_row(self) -> int:
        """Rows appended so far."""
        return self._rows.n_row

    def append(self, columns: Mapping[str, Any]) -> None:
        """Append rows, given by columns as a table has them; lists are taken too, and None is null.

        After an exception nothing is left of the table, and the writer takes no more.
        """
        with self._step():
            self._rows.append(columns)

    def close(self) -> None:
        """Give the files their names."""
        placed: list[Path] = []
        with self._step():
            self._rows.finish()
            for target in self._targets[2:]:
                self._copy_index(target)
            for file in self._files:
                file.close()
            try:
                for target in reversed(self._targets):  # the table last: it is whole only with its index
                    os.replace(_temporary(target), target)
                    placed.append(target)
            except BaseException:
                for target in placed:
                    target.unlink(missing_ok=True)
                raise
            self._is_open = False

    @contextmanager
    def _step(self) -> Iterator[None]:
        """Surround what may fail: then nothing is left."""
        if not self._is_open:
            raise InputError(f"{self.path}: found a writer that is closed, or whose rows were refused before")
        try:
            yield
        except OSError as error:
            self._discard()
            raise StoreError(f"{self.path}: cannot be written: {error.strerror}") from error
        except BaseException:
            self._discard()
            raise

    def _copy_index(self, target: Path) -> None:
        self._files[1].seek(0)
        with open(_temporary(target), "wb") as file:
            shutil.copyfileobj(self._files[1], file)

    def _discard(self) -> None:
        self._is_open = False
        for file in self._files:
            with suppress(OSError):
                file.close()
        for target in self._targets:
            with suppress(OSError):  # the error that led here is the one to tell
                _temporary(target).unlink(missing_ok=True)


def _temporary(target: Path) -> Path:
    return target.with_name(f".{target.name}.{os.getpid()}.tmp")


def write_table(path: Path | str, layout: Layout, columns: Mapping[str, Any]) -> None:
    """Write a table and, where rows differ in length, its index file; of fcs both fcz and fcx.

    Raises
    ------
    InputError, StoreError
        As `TableWriter`.
    """
    with TableWriter(path, layout) as writer:
        writer.append(columns)


def encode(layout: Layout, columns: Mapping[str, Any]) -> tuple[bytes, bytes | None]:
    """Return the bytes of a table and of its index file, None where all rows have one length.

    Raises
    ------
    InputError
        As `TableWriter`.
    """
    file = io.BytesIO()
    index = io.BytesIO() if layout.is_variable else None
    rows = _Rows(layout, file, index, "table")
    rows.append(columns)
    rows.finish()
    return file.getvalue(), None if index is None else index.getvalue()
