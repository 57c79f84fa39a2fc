"""Spatial indexes of VPF: ``nsi``, ``csi``, ``esi``, ``fsi``, ``tsi`` (specs/vpf.md, V-300 to V-303).

The extent is cut into 255 × 255 steps, and each primitive is known by its box in whole steps. Boxes lie in the bins of a
tree (`vpfx.vpf.bins`).

    header   | bins: offset, count of each | entries: min x, min y, max x, max y, id of each, in the order of bins
    24 bytes   8 bytes each                  1, 1, 1, 1, 4 bytes
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vpfx.errors import InputError, VpfFormatError
from vpfx.vpf.bins import bin_boxes, is_placed, place_boxes, walk_bins

__all__ = ["SpatialIndex", "build", "outward", "read"]

STEPS = 255
"""Steps of the extent, each way: boxes are kept in bytes."""

BIN_SIZE = 8
"""Primitives that a bin of the lowest row should hold: what real indexes have (V-302)."""

MOST_CUTS = 14
"""Cuts above the lowest bins: seven each way, down to two steps."""

SLACK = 2.0**-42
"""Steps added to each side of a box before rounding: more than the rounding errors of `_steps`, at most 2**-43 steps."""

NARROW = 2.0**-16
"""Least width of an extent, relative to its places, at least 1: 256 roundings of single precision, 1.7 m in degrees."""

HEADER = 24
ENTRY = np.dtype([("box", "u1", 4), ("id", "<i4")])


@dataclass(frozen=True, eq=False)
class SpatialIndex:
    """A spatial index as read.

    Attributes
    ----------
    extent : tuple of float
        Min x, min y, max x, max y of what is indexed.
    boxes : uint8 (n_primitive, 4)
        Min x, min y, max x, max y in steps, in the order of bins.
    ids : int32 (n_primitive,)
        The primitive of each box.
    starts : int64 (n_bin + 1,)
        Bin k holds the boxes from ``starts[k - 1]`` to ``starts[k]``.
    order : str
        ``<`` or ``>``, the byte order found.
    stray : int
        Bytes after the last entry.

    Examples
    --------
    >>> import numpy as np
    >>> boxes = np.array([[0, 0, 1, 1], [8, 8, 9, 9], [2, 2, 7, 7]], float)
    >>> index = read(build(boxes, (0, 0, 10, 10)))
    >>> index.search((6, 6, 8.5, 8.5))
    array([2, 3], dtype=int32)
    """

    extent: tuple[float, float, float, float]
    boxes: NDArray[np.uint8]
    ids: NDArray[np.int32]
    starts: NDArray[np.int64]
    order: str = "<"
    stray: int = 0

    @cached_property
    def _bin_boxes(self) -> NDArray[np.uint8]:
        return bin_boxes(self.starts, self.boxes)

    @property
    def n_bin(self) -> int:
        """Bins of the tree, empty ones too."""
        return len(self.starts) - 1

    @property
    def misplaced(self) -> NDArray[np.int32]:
        """Ids whose box does not lie in the place of its bin: a reader that walks the tree by V-302 may miss them."""
        return self.ids[~is_placed(self.starts, self.boxes)]

    def search(self, box: Sequence[float]) -> NDArray[np.int32]:
        """Ids of the primitives that may touch a box, and of no others whose box is far away.

        Parameters
        ----------
        box : sequence of four floats
            Min x, min y, max x, max y, in the units of the extent.

        Returns
        -------
        int32 (n,)
            Rising. All that touch the box are among them, and some that come within a step of it.

        Raises
        ------
        InputError
            The box is not four numbers in order.

        Notes
        -----
        Bins are left out by the boxes they hold, not by their place, so it does not matter which half is which. Cost:
        the bins and boxes near the box asked for.
        """
        low, high = _checked_box(box)
        edges = np.array(self.extent)
        steps = np.concatenate([_steps(low, edges), _steps(high, edges)])
        query = np.floor(steps)
        query[2:] += 1  # producers differ in how they round: one step more finds all
        is_flat = np.tile(edges[:2] == edges[2:], 2)
        query[is_flat] = np.array([0, 0, STEPS, STEPS])[is_flat]
        found = np.empty(len(self.ids), np.int32)
        n = walk_bins(
            np.clip(query, 0, STEPS).astype(np.int64), self.starts, self._bin_boxes, self.boxes, self.ids, found
        )
        return np.sort(found[:n])


def outward(boxes: ArrayLike) -> NDArray[np.float32]:
    """Boxes in single precision that hold those given: minima are rounded down, maxima up.

    Parameters
    ----------
    boxes : float64 (..., 4)
        Min x, min y, max x, max y.

    Returns
    -------
    float32 (..., 4)

    Raises
    ------
    InputError
        A number does not fit float32.

    Examples
    --------
    >>> outward([0.1, 0.1, 0.1, 0.1]).astype(float)
    array([0.09999999, 0.09999999, 0.1       , 0.1       ])
    """
    exact = np.asarray(boxes, np.float64)
    if np.any(np.abs(exact) > np.finfo(np.float32).max):
        raise InputError(f"found a box of {np.abs(exact).max():g}, expected numbers that fit float32")
    rounded = exact.astype(np.float32)
    low, high = rounded[..., :2], rounded[..., 2:]
    low[low > exact[..., :2]] = np.nextafter(low[low > exact[..., :2]], np.float32(-np.inf))
    high[high < exact[..., 2:]] = np.nextafter(high[high < exact[..., 2:]], np.float32(np.inf))
    return rounded


def build(boxes: ArrayLike, extent: Sequence[float]) -> bytes:
    """Bytes of a spatial index; row i of the boxes is primitive i + 1.

    Parameters
    ----------
    boxes : float64 (n, 4)
        Min x, min y, max x, max y of each primitive, in the order of its table and as many: readers take the number of
        boxes for the number of rows.
    extent : sequence of four floats
        What the boxes lie in. It is written as float32, rounded outward, and widened where it has hardly any width.

    Returns
    -------
    bytes

    Raises
    ------
    InputError
        A box is not finite, is turned round, or does not lie in the extent; the message names the first.

    Notes
    -----
    The extent is cut until a bin holds about `BIN_SIZE` boxes. Source: specs/vpf.md, V-300 to V-302. Cost: O(n).

    Examples
    --------
    >>> data = build([[0, 0, 5, 5], [5, 0, 10, 5], [0, 5, 10, 10]], (0, 0, 10, 10))
    >>> len(data), data[24:40].hex(" ")
    (56, '00 00 00 00 03 00 00 00 00 00 80 80 01 00 00 00')
    """
    exact = np.asarray(boxes, np.float64).reshape(-1, 4)
    edges = _wide(outward(np.concatenate(_checked_box(extent)))).astype(np.float64)
    _check_boxes(exact, edges)
    low = np.floor(_steps(exact[:, :2], edges) - SLACK)
    high = np.ceil(_steps(exact[:, 2:], edges) + SLACK)
    entries = np.empty(len(exact), ENTRY)
    entries["box"] = np.clip(np.concatenate([low, high], axis=1), 0, STEPS)
    entries["id"] = np.arange(1, len(exact) + 1)
    n_cut = min(max(math.ceil(math.log2(max(len(exact), 1) / BIN_SIZE)), 0), MOST_CUTS)
    n_bin = (2 << n_cut) - 1
    bin_of = place_boxes(entries["box"], n_cut)
    counts = np.bincount(bin_of, minlength=n_bin + 1)[1:]
    bins = np.stack([(np.cumsum(counts) - counts) * ENTRY.itemsize, counts], axis=1)
    if len(exact) > (2**31 - HEADER) // ENTRY.itemsize - n_bin:
        raise InputError(f"found {len(exact):,} primitives, expected an index of less than 2 GB")
    header = struct.pack("<i4fi", len(exact), *edges, n_bin)
    return header + bins.astype("<i4").tobytes() + entries[np.argsort(bin_of, kind="stable")].tobytes()


def read(data: bytes, path: str = "") -> SpatialIndex:
    """Read a spatial index.

    Parameters
    ----------
    data : bytes
        The whole file.
    path : str
        Named in messages.

    Returns
    -------
    SpatialIndex

    Raises
    ------
    VpfFormatError
        The bytes break V-300 or V-303.

    Examples
    --------
    >>> read(build([[3, 3, 3, 3]], (3, 3, 3, 3))).search((0, 0, 9, 9))
    array([1], dtype=int32)
    """
    order, n_primitive, extent, n_bin = _read_header(data, path)
    first = HEADER + 8 * n_bin
    bins = np.frombuffer(data, np.dtype(f"{order}i4"), 2 * n_bin, HEADER).reshape(n_bin, 2).astype(np.int64)
    n_entry = (len(data) - first) // ENTRY.itemsize
    is_wrong = (bins[:, 1] < 0) | (bins[:, 1] > n_entry)
    is_used = bins[:, 1] > 0
    is_wrong |= is_used & ((bins[:, 0] < 0) | (bins[:, 0] % 8 != 0) | (bins[:, 0] // 8 + bins[:, 1] > n_entry))
    if is_wrong.any():
        k = int(np.argmax(is_wrong))
        message = (
            f"found {bins[k, 1]} entries at byte {bins[k, 0]}, expected a place among {n_entry} entries of 8 bytes"
        )
        raise VpfFormatError(path, f"bin {k + 1}", message, "V-303")
    counts = bins[:, 1]
    if counts.sum() != n_primitive:
        raise VpfFormatError(path, "", f"found {counts.sum()} entries in bins, expected {n_primitive}", "V-303")
    starts = np.concatenate([[0], np.cumsum(counts)])
    entries = np.frombuffer(data, np.dtype([("box", "u1", 4), ("id", f"{order}i4")]), n_entry, first)
    entries = entries[np.repeat(bins[:, 0] // 8 - starts[:-1], counts) + np.arange(n_primitive)]
    ids = entries["id"].astype(np.int32)
    if np.any(ids < 1):
        raise VpfFormatError(path, "", f"found the primitive {ids.min()}, expected ids from 1 on", "V-303")
    stray = len(data) - first - ENTRY.itemsize * n_primitive
    return SpatialIndex(extent, np.ascontiguousarray(entries["box"]), ids, starts, order, stray)


def _read_header(data: bytes, path: str) -> tuple[str, int, tuple[float, float, float, float], int]:
    """Byte order, number of primitives, extent and number of bins; the order is the one in which the size fits."""
    if len(data) < HEADER:
        raise VpfFormatError(path, "header", f"found {len(data)} bytes, expected at least {HEADER}", "V-300")
    for order in "<>":
        n_primitive, *edges, n_bin = struct.unpack_from(f"{order}i4fi", data)
        if n_primitive >= 0 and n_bin >= 0 and HEADER + 8 * (n_primitive + n_bin) <= len(data):
            break
    else:
        n_primitive, *_, n_bin = struct.unpack_from("<i4fi", data)
        message = f"found {n_primitive} primitives and {n_bin} bins in {len(data)} bytes"
        raise VpfFormatError(path, "header", f"{message}, expected 24 bytes and 8 for each", "V-300")
    if not (np.isfinite(edges).all() and edges[0] <= edges[2] and edges[1] <= edges[3]):
        raise VpfFormatError(path, "header", f"found the extent {edges}, expected minima below maxima", "V-300")
    return order, n_primitive, (edges[0], edges[1], edges[2], edges[3]), n_bin


def _checked_box(box: Sequence[float]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lower left and upper right corner of a box, both float64 (2,)."""
    numbers = np.asarray(box, np.float64)
    if numbers.shape != (4,) or not np.isfinite(numbers).all() or np.any(numbers[:2] > numbers[2:]):
        raise InputError(f"found the box {tuple(box)}, expected min x, min y, max x, max y")
    return numbers[:2], numbers[2:]


def _check_boxes(boxes: NDArray[np.float64], edges: NDArray[np.float64]) -> None:
    is_good = (boxes[:, :2] >= edges[:2]) & (boxes[:, :2] <= boxes[:, 2:]) & (boxes[:, 2:] <= edges[2:])
    if not is_good.all():
        i = int(np.argmin(is_good.all(axis=1)))
        raise InputError(f"primitive {i + 1}: found the box {boxes[i].tolist()}, expected it within {edges.tolist()}")


def _wide(edges: NDArray[np.float32]) -> NDArray[np.float32]:
    """An extent with a width each way: readers divide by it, in single precision (V-301)."""
    low, high = edges[:2].astype(np.float64), edges[2:].astype(np.float64)
    margin = NARROW * np.maximum(1, np.maximum(np.abs(low), np.abs(high)))
    margin[high - low >= margin] = 0
    return outward(np.concatenate([low - margin, high + margin]))


def _steps(places: NDArray[np.float64], edges: NDArray[np.float64]) -> NDArray[np.float64]:
    """Places (..., 2) in steps of the extent, unrounded; 0 where the extent has no width."""
    width = edges[2:] - edges[:2]
    return STEPS * ((places - edges[:2]) / np.where(width > 0, width, np.inf))
