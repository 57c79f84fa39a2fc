"""Index files: where the rows of a table of different lengths start.

    rows N · header size + 4 │ offset, length of row 1 │ offset, length of row 2 │ …        all 32 bits

Source: specs/vpf.md, V-130 to V-132.
"""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import InputError

__all__ = ["MOST_OFFSET", "IndexFile", "find_index", "index_entries", "index_head", "index_name", "index_names"]

MOST_OFFSET = 2**32
"""Bytes of a table whose offsets an index can hold."""

_BLOCK = 1 << 17  # entries checked at a time


def index_name(name: str) -> str:
    """Return the name of the index file of a table: its last character becomes x; that of fcs is fcz (V-132).

    Raises
    ------
    InputError
        There is no such name: it ends in x already, or is empty.

    Examples
    --------
    >>> [index_name(name) for name in ("edg", "ROADL.LFT", "fcs", "end.")]
    ['edx', 'ROADL.LFX', 'fcz', 'enx.']
    """
    stem, dot = (name[:-1], ".") if name.endswith(".") else (name, "")
    if not stem or stem[-1] in "xX":
        raise InputError(f"{name!r}: found no index name for it, expected a table whose name does not end in x (V-132)")
    last = "z" if stem.lower() == "fcs" else "x"
    return stem[:-1] + (last.upper() if stem[-1].isupper() else last) + dot


def index_names(name: str) -> list[str]:
    """Return all names under which an index of a table is written and looked for: fcx is one of fcs too (V-132).

    Examples
    --------
    >>> index_names("fcs"), index_names("edg")
    (['fcz', 'fcx'], ['edx'])
    """
    first = index_name(name)
    if name.rstrip(".").lower() != "fcs":
        return [first]
    return [first, first.replace("z", "x").replace("Z", "X")]


def find_index(path: Path) -> Path | None:
    """Return the index file beside a table, whatever the case of its name and with or without a dot behind it, or None."""
    try:
        names = index_names(path.name)
    except InputError:
        return None
    for name in names:
        stem = name.removesuffix(".")
        for form in (name, stem, stem + ".", stem.lower(), stem.upper(), stem.lower() + ".", stem.upper() + "."):
            found = path.with_name(form)
            if found.is_file():
                return found
    return None


def index_head(order: str, n_row: int, first: int) -> bytes:
    """Return the first eight bytes of an index file: rows, and the offset of the first."""
    return np.array([n_row, first], f"{order}u4").tobytes()


def index_entries(order: str, bounds: NDArray[np.int64]) -> bytes:
    """Return the entries of rows that start and end at some offsets."""
    entries = np.empty((len(bounds) - 1, 2), f"{order}u4")
    entries[:, 0], entries[:, 1] = bounds[:-1], np.diff(bounds)
    return entries.tobytes()


class IndexFile:
    """An index file, checked against its table; only the entries asked for are held.

    Parameters
    ----------
    file : BinaryIO
        The index.
    order : str
        Byte order of the table.
    first, size : int
        Offset of the table's first row, and bytes of the table.
    least : int
        Bytes of the shortest row: fewer behind the last row are stray.

    Attributes
    ----------
    problem : str
        What is wrong with it; empty if nothing is.
    is_usable : bool
        Whether its offsets are right all the same.
    n_row, end : int
        Rows, and where the last of them ends.
    """

    def __init__(self, file: BinaryIO, order: str, first: int, size: int, least: int) -> None:
        self._file = file
        self._first = first
        self._least_end = size - least + 1
        self._most_end = size
        other = "<" if order == ">" else ">"
        self._order = order
        self.n_row, self.end, self.problem = self._check()
        if self.problem:
            self._order = other
            n_row, end, problem = self._check()
            if not problem:
                self.n_row, self.end = n_row, end
                self.problem = "found the other byte order than in its table (V-131)"
                self.is_usable = True
                return
        self.is_usable = not self.problem
        if self.is_usable and self._words()[1] not in (first, first - 4):
            self.problem = f"word 2: found {self._words()[1]}, expected {first} (V-130)"

    def _words(self) -> list[int]:
        """Return the first two words."""
        self._file.seek(0)
        return np.frombuffer(self._file.read(8), f"{self._order}u4").tolist()

    def _check(self) -> tuple[int, int, str]:
        """Return rows, the end of the last, and what is wrong with the offsets, if anything is."""
        n_byte = self._file.seek(0, 2)
        n_row = self._words()[0] if n_byte >= 8 else 0
        if n_byte != 8 + 8 * n_row:
            return 0, self._first, f"found {n_byte} bytes for {n_row} rows, expected {8 + 8 * n_row} (V-130)"
        end = self._first
        for start in range(0, n_row, _BLOCK):
            entries = self._entries(start, min(start + _BLOCK, n_row))
            ends = entries[:, 0] + entries[:, 1]
            starts = np.concatenate([[end], ends[:-1]])
            wrong = np.flatnonzero((entries[:, 0] != starts) | (ends > self._most_end))
            if len(wrong):
                offset, length = entries[wrong[0]].tolist()
                found = f"found offset {offset} and length {length}"
                expected = f"expected offset {starts[wrong[0]]} and an end up to {self._most_end}"
                return 0, self._first, f"row {start + wrong[0] + 1}: {found}, {expected} (V-130)"
            end = int(ends[-1])
        if end < self._least_end:
            return 0, self._first, f"found rows up to offset {end}, expected up to {self._most_end} (V-130)"
        return n_row, end, ""

    def _entries(self, start: int, stop: int) -> NDArray[np.int64]:
        """Return offsets and lengths of some rows, int64 (n, 2)."""
        self._file.seek(8 + 8 * start)
        data = self._file.read(8 * (stop - start))
        return np.frombuffer(data, f"{self._order}u4").astype(np.int64).reshape(-1, 2)

    def bounds(self, start: int, stop: int) -> NDArray[np.int64]:
        """Return where rows start, and where the last ends, int64 (stop - start + 1,)."""
        entries = self._entries(start, stop)
        return np.concatenate([entries[:, 0], entries[-1:].sum(axis=1) if stop > start else [self._first]])
