"""Rows of a join table, gathered tile by tile and written by feature, in little memory."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import StoreError
from vpfx.vpf.table import TableWriter

__all__ = ["Joins"]

Ints = NDArray[np.int64]

ROW = np.dtype([("feature", "<i4"), ("share", "<f8"), ("tile_id", "<i2"), ("fac_id", "<i4")])
BATCH = 1 << 18
"""Rows in memory at once."""


class Joins:
    """Faces of the features of one class: a file of rows by tile, and then one by feature, tile and face.

    Parameters
    ----------
    path : Path
        Of the file; it and the other one are deleted at the end of the block.
    n_feature : int

    Raises
    ------
    StoreError
        The medium refuses; so do all methods.
    """

    def __init__(self, path: Path, n_feature: int) -> None:
        self._path, self._counts = path, np.zeros(n_feature, np.int64)
        self._sorted = path.with_name(f"{path.name}.sorted")
        with self._on_medium():
            self._file = open(path, "w+b")  # noqa: SIM115  # closed at the end of the block

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with suppress(OSError):  # rows not written yet are of no use any more
            self._file.close()
        self._path.unlink(missing_ok=True)
        self._sorted.unlink(missing_ok=True)

    @contextmanager
    def _on_medium(self) -> Iterator[None]:
        """Surround what reads or writes the files."""
        try:
            yield
        except OSError as error:
            raise StoreError(f"{self._path}: cannot be written: {error.strerror}") from error

    def append(self, feature: Ints, share: NDArray[np.float64], tile_id: int, fac_id: Ints) -> None:
        """Add the rows of one tile, features as indices, by face."""
        rows = np.empty(len(feature), ROW)
        rows["feature"], rows["share"], rows["tile_id"], rows["fac_id"] = feature, share, tile_id, fac_id
        with self._on_medium():
            self._file.write(rows.tobytes())
        self._counts += np.bincount(feature, minlength=len(self._counts))

    def write(self, table: TableWriter, key: str) -> None:
        """Write the rows in the order of features.

        Parameters
        ----------
        table : TableWriter
            The join table, open.
        key : str
            Its column that names the feature.
        """
        n_row = int(self._counts.sum())
        if n_row == 0:
            return
        with self._on_medium():
            self._make_room(n_row)
            in_order = np.memmap(self._sorted, ROW, "r+", shape=(n_row,))
            self._sort_into(in_order)
        for first in range(0, n_row, BATCH):
            rows = in_order[first : first + BATCH]
            ids = np.arange(first + 1, first + len(rows) + 1)
            columns = {name: rows[name] for name in ("share", "tile_id", "fac_id")}
            table.append({"id": ids, key: rows["feature"] + 1, **columns})

    def _make_room(self, n_row: int) -> None:
        """Fill the other file: where a file is mapped, a full medium ends the process instead of raising an error."""
        with open(self._sorted, "wb") as file:
            for first in range(0, n_row, BATCH):
                file.write(bytes(min(BATCH, n_row - first) * ROW.itemsize))

    def _sort_into(self, in_order: NDArray[np.void]) -> None:
        """Put rows in the order of features; those of one stay in theirs."""
        following = np.cumsum(self._counts) - self._counts
        self._file.seek(0)
        while data := self._file.read(BATCH * ROW.itemsize):
            rows = np.frombuffer(data, ROW)
            rows = rows[np.argsort(rows["feature"], kind="stable")]
            count = np.bincount(rows["feature"], minlength=len(following))
            rank = np.arange(len(rows)) - np.repeat(np.cumsum(count) - count, count)
            in_order[following[rows["feature"]] + rank] = rows
            following += count
