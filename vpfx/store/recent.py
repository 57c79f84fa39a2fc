"""What was made of tiles lately, kept for the next question."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any

import numpy as np

__all__ = ["MOST_BYTES", "Recent"]

MOST_BYTES = 256 << 20
"""Of all that is kept: the tiles of a window of two million faces or so, on a machine with a few GB."""


class Recent:
    """Tuples with arrays by key, those used last, up to a number of bytes.

    Examples
    --------
    >>> recent = Recent(most_bytes=1000)
    >>> recent.get("a", 0, lambda: (np.zeros(100),))[0].nbytes
    800
    >>> recent.get("b", 0, lambda: (np.ones(100),))[0].nbytes, list(recent.keys)
    (800, ['b'])
    """

    def __init__(self, most_bytes: int = MOST_BYTES) -> None:
        self._most, self._bytes, self._version = most_bytes, 0, 0
        self._kept: OrderedDict[Hashable, tuple[int, tuple[Any, ...]]] = OrderedDict()

    @property
    def keys(self) -> list[Hashable]:
        """Keys of what is kept, the last used last."""
        return list(self._kept)

    def get(self, key: Hashable, version: int, make: Callable[[], tuple[Any, ...]]) -> tuple[Any, ...]:
        """Return what is kept under a key, or make it; all is forgotten when the version is another."""
        if version != self._version:
            self._kept.clear()
            self._bytes, self._version = 0, version
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key][1]
        made = make()
        size = sum(part.nbytes for part in made if isinstance(part, np.ndarray))
        self._kept[key] = size, made
        self._bytes += size
        while self._bytes > self._most and len(self._kept) > 1:
            self._bytes -= self._kept.popitem(last=False)[1][0]
        return made
