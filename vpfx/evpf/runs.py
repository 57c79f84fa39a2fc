"""Rows of tables that lie by tile, handed out tile by tile: memory is that of a tile, and of a batch."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import VpfFormatError
from vpfx.evpf.checked import check_ids
from vpfx.vpf.table import Table, TableFile

__all__ = ["Run", "TileRuns"]

BATCH = 1 << 15  # rows read at once


class Run:
    """Rows of one tile.

    Attributes
    ----------
    path : str
        The table.
    start : int
        Row index of the first.
    n_row : int
    """

    def __init__(self, path: str, start: int, parts: list[dict[str, NDArray[Any]]]) -> None:
        self.path, self.start = path, start
        self._columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        self.n_row = len(self._columns["tile_id"])

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self._columns[name]

    def __contains__(self, name: str) -> bool:
        return name in self._columns


class TileRuns:
    """The rows of a table without counted columns, by tile.

    Parameters
    ----------
    file : TableFile
        With columns `id` and `tile_id`; stays open as long as rows are taken.
    """

    def __init__(self, file: TableFile) -> None:
        self._file = file
        self._at = 0  # row index of the next row to hand out
        self._batch: Table | None = None
        self._batch_start = 0

    def take(self, tile_id: int) -> Run:
        """Return the rows of a tile, the next in order.

        Raises
        ------
        VpfFormatError
            An id is not that of its row, or rows of other tiles come first.
        """
        start = self._at
        parts = []
        while True:
            part, is_end = self._leading(tile_id)
            parts.append(part)
            if is_end:
                return Run(self._file.path, start, parts)

    def finish(self) -> None:
        """Refuse rows that are left: they are of no tile."""
        if self._at < self._file.n_row:
            found = self._file.read(self._at, self._at + 1)["tile_id"][0]
            message = f"found tile {found}, expected one of the library, in order"
            raise VpfFormatError(self._file.path, f"row {self._at + 1}", message, "E-101")

    def _leading(self, tile_id: int) -> tuple[dict[str, NDArray[Any]], bool]:
        """Rows of the tile at the head of the batch, and whether no more may follow."""
        if self._batch is None or self._at == self._batch_start + self._batch.n_row:
            self._batch = self._file.read(self._at, self._at + BATCH)
            self._batch_start = self._at
            check_ids(self._batch, self._at)
        first = self._at - self._batch_start
        tiles = self._batch["tile_id"][first:]
        is_same = tiles == tile_id
        n_row = len(tiles) if is_same.all() else int(np.argmin(is_same))
        if n_row < len(tiles) and tiles[n_row] < tile_id:
            message = f"found tile {tiles[n_row]} where tile {tile_id} or a later one is due, expected rows by tile"
            raise VpfFormatError(self._file.path, f"row {self._at + n_row + 1}", message, "E-101")
        part = {name: values[first : first + n_row] for name, values in self._batch.columns.items()}
        self._at += n_row
        return part, n_row < len(tiles) or self._at == self._file.n_row
