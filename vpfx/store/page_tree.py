"""B-trees of a SQLite file, written leaf by leaf as rows arrive.

Leaves lie in the file in the order of the calls. Rows between which no others have come are a segment::

    segment   | leaf | divider | leaf | divider | … | tail: cells that do not fill a leaf yet |
                `ups`: page number and divider of each leaf, as cells for the parent page

A divider of a table is the last rowid of the leaf; of an index it is an entry that stands nowhere else. At the end the
segments are joined in the order of keys and the interior pages put above the leaves. Source: "SQLite file format",
sqlite.org/fileformat2.html, §1.6. The bytes are in `vpfx.store.records` and `vpfx.store.page_cells`.
"""

from __future__ import annotations

from array import array
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import InputError, InvariantError
from vpfx.store.page_cells import (
    INNER_INDEX,
    INNER_TABLE,
    LAST,
    LEAF_INDEX,
    LEAF_TABLE,
    SEAL,
    STREAM,
    cells_end,
    lay_pages,
)
from vpfx.store.page_file import PageFile, Spool
from vpfx.store.records import BLOB, FLOAT, INT, NULL_INT, REAL, ROWID, RowBlock

__all__ = ["Shape", "Tree", "find_kinds"]

Bytes = NDArray[np.uint8]
Column = NDArray[Any]
Key = tuple[Any, ...]


class Shape(NamedTuple):
    """What the schema says of one B-tree.

    Attributes
    ----------
    name : str
        Table or index.
    root : int
        Its page; never changes.
    is_rowid : bool
        Rows are found by rowid; else by the first columns of the record, as in an index.
    affinities : tuple of str
        REAL, TEXT or nothing, for each column of the record.
    n_key : int
        Columns that make the key, from the first.
    problem : str
        Why rows cannot be appended; empty if they can.
    """

    name: str
    root: int
    is_rowid: bool
    affinities: tuple[str, ...]
    n_key: int
    problem: str


class Segment:
    """Rows between which no others have come; see the drawing at the top.

    Attributes
    ----------
    first, last : tuple
        Keys.
    ups : bytearray
        Finished leaves, as cells for the parent page.
    row_ends : array of int64
        Rows up to the end of each leaf, the divider behind it included.
    tail : bytearray
        Cells that do not fill a leaf yet; empty while it is in the spool.
    n_row : int
        Rows in all.
    gaps : list of (tuple, tuple, int)
        Where other calls may still come in: last key of a call, first key of the next, rows up to there.
    place, n_spooled : int
        Place of the tail in the spool, -1 if it never was there; its bytes while it is there, else 0.
    """

    def __init__(self, first: Key, last: Key) -> None:
        self.first = first
        self.last = last
        self.ups = bytearray()
        self.row_ends = array("q")
        self.tail = bytearray()
        self.n_row = 0
        self.gaps: list[tuple[Key, Key, int]] = []
        self.place = -1
        self.n_spooled = 0

    def spool(self, spool: Spool) -> None:
        """Put the tail away while rows go to another segment."""
        self.place = spool.write(self.place, self.tail)
        self.n_spooled = len(self.tail)
        self.tail = bytearray()

    def unspool(self, spool: Spool) -> None:
        """Get the tail back if it was put away."""
        if self.n_spooled:
            self.tail = spool.read(self.place, self.n_spooled)
            self.n_spooled = 0


class Tree:
    """One B-tree while its rows arrive.

    Parameters
    ----------
    shape : Shape
        What the schema says of it.
    file, spool : PageFile, Spool
        Where pages and unfinished leaves go; a piece of the spool has room for two pages.
    columns : sequence of array
        The first rows; all others have the same kinds of columns.

    Raises
    ------
    InputError
        The columns do not fit the schema, or make records too large for the pages.
    """

    def __init__(self, shape: Shape, file: PageFile, spool: Spool, columns: Sequence[Column]) -> None:
        page_size = file.page_size
        self.shape = shape
        self.kinds, self.lengths = find_kinds(shape, columns)
        self._file = file
        self._spool = spool
        self._leaf, self._inner = (LEAF_TABLE, INNER_TABLE) if shape.is_rowid else (LEAF_INDEX, INNER_INDEX)
        self._limit = page_size - 35 if shape.is_rowid else (page_size - 12) * 64 // 255 - 23  # §1.6: no overflow
        self._check_payload(1 + len(self.lengths) + sum(self.lengths))
        self._block = RowBlock(self.kinds, self.lengths, shape.n_key, 2 * page_size)
        self._segments: list[Segment] = []
        self._open: Segment | None = None

    def append(self, columns: Sequence[Column]) -> None:
        """Write rows; see `PageWriter.append`."""
        n_row = len(columns[0])
        segment = self._find_segment(self._key(columns, 0), self._key(columns, n_row - 1))
        if segment is not self._open:
            if self._open is not None:
                self._open.spool(self._spool)
            segment.unspool(self._spool)
            self._open = segment
        cells = self._block.cells
        end = len(segment.tail)
        cells[:end] = segment.tail
        start = 0
        while start < n_row:
            n_block = self._block.load(columns, start)
            self._check_order(columns, start, n_block)
            end, largest = self._block.put_rows(n_block, end)
            self._check_payload(largest)
            at, ups, page_rows, _ = self._lay(self._leaf, STREAM, cells[:end])
            segment.ups += ups
            n_before = segment.row_ends[-1] if segment.row_ends else 0
            segment.row_ends.frombytes((n_before + np.cumsum(page_rows)).tobytes())
            end -= at
            cells[:end] = cells[at : at + end]
            start += n_block
        segment.tail = bytearray(cells[:end])
        segment.n_row += n_row

    def finish(self) -> None:
        """Join the segments, write the interior pages, and put the top of the tree on the root page."""
        whole = Segment((), ())
        for segment in self._segments:
            segment.unspool(self._spool)
            if segment.ups:
                self._seal(whole, segment)
                whole.ups += segment.ups
            cells = whole.tail + segment.tail
            at, ups, _, _ = self._lay(self._leaf, STREAM, cells)
            whole.ups += ups
            whole.tail = cells[at:]
        kind, cells, child = self._leaf, whole.tail, 0
        if whole.ups:
            _, ups, _, child = self._lay(kind, LAST, cells)
            kind, cells = self._inner, whole.ups + ups
        while cells and not self._put_page(kind, cells, self.shape.root, child):
            _, cells, _, child = self._lay(kind, LAST, cells, child)
            kind = self._inner

    def _key(self, columns: Sequence[Column], row: int) -> Key:
        """Return the key of a row as a tuple that sorts as SQLite does, NULL first."""
        key: list[Any] = []
        for kind, column in zip(self.kinds[: self.shape.n_key], columns, strict=False):
            value = column[row]
            if kind == BLOB:
                key.append(value.tobytes())
            elif kind in (ROWID, INT):
                key.append(int(value))
            else:
                key.append((0, 0.0) if np.isnan(value) else (1, float(value)))
        return tuple(key)

    def _check_order(self, columns: Sequence[Column], start: int, n_row: int) -> None:
        row = self._block.find_disorder(n_row) + start
        if row < start:
            row = start
            if start == 0 or self._key(columns, start - 1) < self._key(columns, start):
                return
        keys = f"{self._key(columns, row)} behind {self._key(columns, row - 1)}"
        raise InvariantError(f"{self.shape.name}: row {row} of a call: found key {keys}, expected ascending keys")

    def _check_payload(self, largest: int) -> None:
        if largest > self._limit:
            found = f"found a record of {largest} bytes, expected at most {self._limit} for this page size"
            raise InputError(f"{self.shape.name}: {found}")

    def _find_segment(self, first: Key, last: Key) -> Segment:
        """Return the segment that rows from `first` to `last` continue; cut one in two if they come in between."""
        place = bisect_right(self._segments, first, key=lambda segment: segment.first)
        if place < len(self._segments) and last >= self._segments[place].first:
            raise self._overlap(first, last, self._segments[place])
        if place == 0:
            self._segments.insert(0, Segment(first, last))
            return self._segments[0]
        segment = self._segments[place - 1]
        if first <= segment.last:
            gap = bisect_left(segment.gaps, first, key=lambda gap: gap[0]) - 1
            if gap < 0 or last >= segment.gaps[gap][1]:
                raise self._overlap(first, last, segment)
            self._segments.insert(place, self._cut(segment, gap))
        if not self.shape.is_rowid or first[0] > segment.last[0] + 1:
            segment.gaps.append((segment.last, first, segment.n_row))
        segment.last = last
        return segment

    def _overlap(self, first: Key, last: Key, segment: Segment) -> InvariantError:
        others = f"others from {segment.first} to {segment.last}"
        found = f"found keys from {first} to {last} in one call, overlapping those of {others}"
        return InvariantError(f"{self.shape.name}: {found}, expected calls side by side")

    def _cut(self, segment: Segment, gap: int) -> Segment:
        """Take the rows behind a gap off a segment and return them as one of their own.

        The leaf with the gap keeps the cells behind it; those before it become the tail of `segment`.
        """
        last, right_first, n_row = segment.gaps[gap]
        segment.unspool(self._spool)
        right = Segment(right_first, segment.last)
        n_leaf = bisect_right(segment.row_ends, n_row)
        n_cell = n_row - (segment.row_ends[n_leaf - 1] if n_leaf else 0)
        at = find_end(self._inner, segment.ups, n_leaf)
        right.ups = segment.ups[at:]
        right.row_ends = array("q", [end - n_row for end in segment.row_ends[n_leaf:]])
        cells = self._read_cells(right.ups) if right.ups else segment.tail
        end = find_end(self._leaf, cells, n_cell)
        right.tail = segment.tail if right.ups else cells[end:]
        if right.ups and end < len(cells):
            self._put_page(self._leaf, cells[end:], page_number(right.ups))
        elif right.ups:  # only the divider of an index is behind the gap: nothing is left on the leaf
            self._file.spare.append(page_number(right.ups))
            up_end = find_end(self._inner, right.ups, 1)
            divider = right.ups[4:up_end].ljust(4, b"\0")
            del right.ups[:up_end], right.row_ends[0]
            self._prepend(right, divider)
        right.n_row = segment.n_row - n_row
        right.gaps = [(low, high, n - n_row) for low, high, n in segment.gaps[gap + 1 :]]
        right.spool(self._spool)
        segment.last, segment.n_row, segment.tail = last, n_row, cells[:end]
        del segment.ups[at:], segment.row_ends[n_leaf:], segment.gaps[gap:]
        return right

    def _seal(self, segment: Segment, following: Segment) -> None:
        """Make a leaf of the tail, with a divider that separates it from the first leaf of the next segment."""
        at, ups, _, _ = self._lay(self._leaf, SEAL, segment.tail)
        segment.ups += ups
        if at < len(segment.tail):  # one entry of an index, not enough for a leaf and a divider
            self._prepend(following, segment.tail[at:])
        segment.tail = bytearray()

    def _prepend(self, segment: Segment, cell: bytearray) -> None:
        """Put one entry of an index before those of a segment."""
        if not segment.ups:
            segment.tail = cell + segment.tail
            return
        cells = cell + self._read_cells(segment.ups)
        number = page_number(segment.ups)
        if not self._put_page(self._leaf, cells, number):
            end = find_end(self._leaf, cells, 2)  # a leaf of its own, and the next entry as divider
            _, ups, _, _ = self._lay(self._leaf, SEAL, cells[:end])
            segment.ups[:0] = ups
            segment.row_ends.insert(0, 2)
            self._put_page(self._leaf, cells[end:], number)

    def _read_cells(self, ups: bytearray) -> bytearray:
        """Return the cells of the first leaf, which stand at the end of its page."""
        page = self._file.read(page_number(ups))
        return bytearray(page[int.from_bytes(page[5:7], "big") :])

    def _put_page(self, kind: int, cells: bytearray, number: int, child: int = 0) -> bool:
        """Write all cells to one page; return False if they do not fit."""
        page = np.zeros((1, self._file.page_size), np.uint8)
        ups = np.empty(2 * len(cells), np.uint8)
        stream = np.frombuffer(cells, np.uint8)
        at, _, _ = lay_pages(kind, LAST, stream, 0, child, number, page, ups, np.empty(1, np.int64))
        if at < len(cells):
            return False
        self._file.write(number, page[0])
        return True

    def _lay(
        self, kind: int, mode: int, cells: bytearray | Bytes, child: int = 0
    ) -> tuple[int, bytearray, NDArray[np.int64], int]:
        """Write cells to new pages; return the bytes used, cells for the parent, rows of each page, and last page."""
        stream = np.frombuffer(cells, np.uint8) if len(cells) else np.empty(0, np.uint8)
        ups = np.empty(2 * len(cells), np.uint8)  # a page number is as long as the shortest cell
        all_ups = bytearray()
        all_rows = [np.empty(0, np.int64)]
        at, n_page, last_page = 0, 1, 0
        while at < len(stream) and n_page:
            number, pages = self._file.take()
            page_rows = np.empty(len(pages), np.int64)
            at, n_page, n_up = lay_pages(kind, mode, stream, at, child, number, pages, ups, page_rows)
            self._file.keep(n_page)
            last_page = number + n_page - 1
            all_ups += ups[:n_up].tobytes()
            all_rows.append(page_rows[:n_page])
        return at, all_ups, np.concatenate(all_rows), last_page


def find_end(kind: int, cells: bytearray, n_cell: int) -> int:
    """Return the end of the first cells of a stream."""
    return int(cells_end(kind, np.frombuffer(cells, np.uint8), n_cell)) if n_cell else 0


def page_number(ups: bytearray) -> int:
    """Return the number of the first page in cells for a parent page."""
    return int.from_bytes(ups[:4], "big")


def find_kinds(shape: Shape, columns: Sequence[Column]) -> tuple[list[int], list[int]]:
    """Return the kind of each column, and the bytes of each blob column.

    Raises
    ------
    InputError
        The number of columns, a type or a shape is wrong.
    """
    if len(columns) != len(shape.affinities):
        raise InputError(f"{shape.name}: found {len(columns)} columns, expected {len(shape.affinities)}")
    kinds = []
    for i, (column, affinity) in enumerate(zip(columns, shape.affinities, strict=True)):
        is_number = column.ndim == 1 and affinity != "TEXT"
        if column.ndim == 2 and column.dtype == np.uint8:
            kinds.append(BLOB)
        elif is_number and column.dtype.kind in "iub":
            kinds.append(INT)
        elif is_number and column.dtype.kind == "f":
            kinds.append(REAL if affinity == "REAL" else FLOAT)
        else:
            found = f"found {column.dtype} {column.shape} for affinity {affinity or 'other'}"
            raise InputError(f"{shape.name}: column {i}: {found}, expected integers, floats or uint8 (n, length)")
        if len(column) != len(columns[0]):
            raise InputError(f"{shape.name}: column {i}: found {len(column)} rows, expected {len(columns[0])}")
        if column.dtype == np.uint64 and column.size and column.max() > np.iinfo(np.int64).max:
            raise InputError(f"{shape.name}: column {i}: found {column.max()}, expected at most 2**63 - 1")
    if shape.is_rowid:
        if kinds[0] != INT or (len(columns[0]) and columns[0][0] == NULL_INT):
            raise InputError(f"{shape.name}: column 0: expected integers that are not NULL, as they are rowids")
        kinds[0] = ROWID
    return kinds, [column.shape[1] if kind == BLOB else 0 for kind, column in zip(kinds, columns, strict=True)]
