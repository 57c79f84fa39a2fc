"""The pages of a store mapped into memory, without harm to SQLite's locks.

POSIX drops all locks of a process on a file as soon as it closes any handle of it, so mapping a file, or letting a mapping go,
would take the lock of an editor in the same process. So while a file is edited here it is not mapped, and mappings that are
there are kept. See "How to corrupt an SQLite database file", sqlite.org/howtocorrupt.html, §2.2.
"""

from __future__ import annotations

import mmap
import os
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from weakref import WeakSet

import numpy as np
from numpy.typing import NDArray

from vpfx.store.page_reader import PAGE

__all__ = ["Pages", "key_of", "map_pages", "unmapped"]

_guard = threading.Lock()
_edited: Counter[tuple[int, int]] = Counter()  # files that this process edits: device and inode
_alive: WeakSet[Pages] = WeakSet()


class Pages:
    """The pages of a file, mapped into memory; made by `map_pages`."""

    def __init__(self, path: Path) -> None:
        with path.open("rb") as file:
            self.key = _key(os.fstat(file.fileno()))
            self._map = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        self.bytes: NDArray[np.uint8] = np.frombuffer(self._map, np.uint8)

    @property
    def count(self) -> int:
        """Number of whole pages."""
        return len(self.bytes) // PAGE


def map_pages(path: Path) -> Pages | None:
    """Map the pages of a file, or not, while this process edits it; the caller holds no lock on it."""
    with _guard:
        if _edited[key_of(path)]:
            return None
        pages = Pages(path)
        _alive.add(pages)
        return pages


@contextmanager
def unmapped(path: Path) -> Iterator[None]:
    """Surround the editing of a file: it is not mapped, and mappings that are there stay."""
    with _guard:
        key = key_of(path)
        kept = [pages for pages in _alive if pages.key == key]
        _edited[key] += 1
    try:
        yield
    finally:
        with _guard:
            _edited[key] -= 1
            kept.clear()


def key_of(path: Path) -> tuple[int, int]:
    """Return what tells the file of a path from others: device and inode."""
    return _key(path.stat())


def _key(status: os.stat_result) -> tuple[int, int]:
    return status.st_dev, status.st_ino
