"""The file below the B-trees: pages by number, and a spool for unfinished leaves.

Source: "SQLite file format", sqlite.org/fileformat2.html, §1.3 (header), §1.4 (lock-byte page), §1.5 (freelist).
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

__all__ = ["PageFile", "Spool"]

Bytes = NDArray[np.uint8]

BUFFER_BYTES = 1 << 21
"""Pages are appended to the file in pieces of this size."""

PENDING_BYTE = 1 << 30
"""SQLite locks this byte; the page that holds it is never used (§1.4)."""


class PageFile:
    """The pages of one file by number, from 1; new ones are collected and appended in large pieces.

    Parameters
    ----------
    path : Path
        The file.
    page_size : int
        Bytes of a page.
    n_page : int
        Pages that belong to the file; new ones come behind them.

    Attributes
    ----------
    spare : list of int
        Pages that were written and are not needed any more; taken again before new ones.
    """

    def __init__(self, path: Path, page_size: int, n_page: int) -> None:
        self.handle = path.open("r+b")
        self.page_size = page_size
        self.spare: list[int] = []
        self._single = np.zeros((1, page_size), np.uint8)
        self._buffer = np.zeros((max(BUFFER_BYTES // page_size, 1), page_size), np.uint8)
        self._first = n_page + 1  # number of the first page in the buffer
        self._n_used = 0
        self._lock_page = PENDING_BYTE // page_size + 1

    @property
    def n_page(self) -> int:
        """Pages of the file, those in the buffer included; the last one is never the lock page."""
        n_page = self._first + self._n_used - 1
        return n_page - (n_page == self._lock_page)

    def take(self) -> tuple[int, Bytes]:
        """Return the number of a free page, and room for it and those behind it, uint8 (≥ 1, page_size).

        Only what `keep` is told of becomes part of the file.
        """
        if self.spare:
            return self.spare[-1], self._single
        if self._n_used == len(self._buffer) or self._first + self._n_used == self._lock_page:
            self.flush()
        self._first += self._first == self._lock_page
        stop = len(self._buffer)
        if self._first < self._lock_page:
            stop = min(stop, self._lock_page - self._first)
        return self._first + self._n_used, self._buffer[self._n_used : stop]

    def keep(self, n_page: int) -> None:
        """Make the first pages of those taken last a part of the file."""
        if self.spare and n_page:
            self.write(self.spare.pop(), self._single[0])
        else:
            self._n_used += n_page

    def read(self, number: int) -> bytes:
        """Return the bytes of a page."""
        if number >= self._first:
            return self._buffer[number - self._first].tobytes()
        self.handle.seek((number - 1) * self.page_size)
        return self.handle.read(self.page_size)

    def write(self, number: int, page: Bytes) -> None:
        """Overwrite a page."""
        if number >= self._first:
            self._buffer[number - self._first] = page
        else:
            self.handle.seek((number - 1) * self.page_size)
            self.handle.write(page.tobytes())

    def flush(self) -> None:
        """Append the pages in the buffer to the file."""
        self.handle.seek((self._first - 1) * self.page_size)
        self.handle.write(self._buffer[: self._n_used].data)
        self._first += self._n_used
        self._n_used = 0

    def finish(self) -> None:
        """Write what is left and the header, so that SQLite sees the new pages; source §1.3, §1.5."""
        self.handle.seek(24)
        counter, _, free, n_free = np.frombuffer(self.handle.read(16), ">u4").tolist()
        for number in self.spare:  # each a trunk page without leaves, in front of the others
            page = free.to_bytes(4, "big").ljust(self.page_size, b"\0")
            self.write(number, np.frombuffer(page, np.uint8))
            free, n_free = number, n_free + 1
        self.flush()
        counter = (counter + 1) % 2**32
        self.handle.seek(24)
        self.handle.write(np.array([counter, self.n_page, free, n_free], ">u4").tobytes())
        self.handle.seek(92)
        self.handle.write(counter.to_bytes(4, "big"))  # says that the number of pages is up to date
        self.handle.truncate(self.n_page * self.page_size)
        self.handle.flush()
        os.fsync(self.handle.fileno())

    def close(self) -> None:
        """Close the file as it is; a second call does nothing."""
        self.handle.close()


class Spool:
    """A nameless file of small pieces that can be overwritten in place.

    Parameters
    ----------
    folder : Path
        Where the medium has room.
    room : int
        Greatest size of a piece.
    """

    def __init__(self, folder: Path, room: int) -> None:
        self._handle = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 (open until `close`)
        self._room = room
        self._n_place = 0

    def write(self, place: int, piece: bytearray) -> int:
        """Keep a piece at a place, at a new one if -1, and return the place."""
        if place < 0:
            place = self._n_place
            self._n_place += 1
        self._handle.seek(place * self._room)
        self._handle.write(piece)
        return place

    def read(self, place: int, n_byte: int) -> bytearray:
        """Return the first bytes of the piece at a place."""
        self._handle.seek(place * self._room)
        return bytearray(self._handle.read(n_byte))

    def close(self) -> None:
        """Delete the file; a second call does nothing."""
        self._handle.close()
