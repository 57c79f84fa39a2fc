"""Streams of cells cut into pages: the layout of SQLite B-trees.

Source: "SQLite file format", sqlite.org/fileformat2.html, §1.6. A stream is cells, one behind the other::

    cells   | cell 0 | cell 1 | cell 2 | cell 3 | cell 4 | cell 5 | …

    leaf of a table            payload size, rowid, payload           (varint, varint, bytes)
    leaf of an index           payload size, payload                  (at least 4 bytes, filled up with zeros)
    interior page of a table   child page, last rowid of the child    (4 bytes, varint)
    interior page of an index  child page, payload size, payload

A cell says itself how long it is, so a stream can be cut and joined as bytes and needs no offsets beside it.
"""

from __future__ import annotations

import numpy as np
from numba import njit

__all__ = ["INNER_INDEX", "INNER_TABLE", "LAST", "LEAF_INDEX", "LEAF_TABLE", "SEAL", "STREAM", "cells_end", "lay_pages"]

INNER_INDEX, INNER_TABLE, LEAF_INDEX, LEAF_TABLE = 2, 5, 10, 13
"""Kinds of page, as in the first byte of each."""

STREAM, SEAL, LAST = range(3)
"""What follows the cells given to `lay_pages`: unknown, another leaf, nothing."""


@njit(nogil=True, cache=True)
def varint_at(cells, at):  # type: ignore[no-untyped-def]
    """Return the value and the end of the variable-length integer at a byte; of nine bytes only the end is right."""
    value = np.int64(0)
    for b in range(8):
        value = value << 7 | np.int64(cells[at + b] & 127)
        if cells[at + b] < 128:
            return value, at + b + 1
    return value, at + 9


@njit(nogil=True, cache=True)
def cell_end(kind, cells, at):  # type: ignore[no-untyped-def]
    """Return the end of the cell at a byte, by the kind of page it is for."""
    start = at
    if kind == INNER_TABLE:
        return varint_at(cells, at + 4)[1]
    payload, at = varint_at(cells, at + 4 if kind == INNER_INDEX else at)
    if kind == LEAF_TABLE:
        at = varint_at(cells, at)[1]
    return max(at + payload, start + 4)


@njit(nogil=True, cache=True)
def cells_end(kind, cells, n_cell):  # type: ignore[no-untyped-def]
    """Return the end of the first cells of a stream; source §1.6."""
    at = 0
    for _ in range(n_cell):
        at = cell_end(kind, cells, at)
    return at


@njit(nogil=True, cache=True)
def put_word(page, at, value, n_byte):  # type: ignore[no-untyped-def]
    """Write the last bytes of a number, big-endian, and return their end."""
    for b in range(n_byte):
        page[at + b] = value >> 8 * (n_byte - 1 - b) & 255
    return at + n_byte


@njit(nogil=True, cache=True)
def put_page(kind, cells, starts, n_cell, stop, right_child, page):  # type: ignore[no-untyped-def]
    """Write one page: header, pointers to the cells, zeros, and the cells as they stand in the stream.

    ::

        page   | kind | 0 | n_cell | content | 0 | right_child | pointer 0 … | zeros | cell 0 | cell 1 | … |
                  1     2     2        2       1   4, interior    2 each               ↑ content

    Source: §1.6. `starts` is int64 (≥ n_cell,), the place of each cell in the stream; `stop` is the end of the last.
    """
    content = page.shape[0] - (stop - starts[0])
    at = put_word(page, 0, kind << 16, 3)
    at = put_word(page, at, n_cell, 2)
    at = put_word(page, at, content, 2)
    at = put_word(page, at, 0, 1)
    if kind in (INNER_INDEX, INNER_TABLE):
        at = put_word(page, at, right_child, 4)
    for j in range(n_cell):
        at = put_word(page, at, content + starts[j] - starts[0], 2)
    for b in range(at, content):
        page[b] = 0
    for b in range(content, page.shape[0]):
        page[b] = cells[starts[0] - content + b]


@njit(nogil=True, cache=True)
def lay_pages(kind, mode, cells, at, last_child, first_page, pages, ups, page_rows):  # type: ignore[no-untyped-def]
    """Cut a stream of cells into full pages, and make the cell that the parent holds for each.

    ::

        cells, index    | 0 | 1 | 2 | 3 | 4 | 5 | 6 | …       cells, table    | 0 | 1 | 2 | 3 | 4 | 5 | 6 | …
        page p, p + 1    <--------->     <------->            page p, p + 1    <--------->|<--------->
        ups             | p, 3          | p + 1, 6 |          ups             | p, rowid 2 | p + 1, rowid 5 |

    In an index, and on interior pages of both, the cell after a full page becomes the divider and stands in the parent
    only; of an interior cell the child becomes the page's right child. A divider always has a cell behind it, or the
    next page would be empty.

    Parameters
    ----------
    kind : int
        Kind of page and of cells.
    mode : int
        STREAM: leave what does not fill a page. SEAL: another leaf follows, so the last cells end with a divider too;
        a single cell of an index is left. LAST: the last page has no divider.
    cells : uint8 (n,)
        The stream, from byte `at` on.
    last_child : int
        Right child of the last page of mode LAST, if interior.
    first_page : int
        Number of the first page; the others follow.
    pages : uint8 (n_page, page_size)
        Filled from the first on, as far as there are cells.
    ups : uint8 (n,)
        Filled with cells for the parent page: page number, then divider.
    page_rows : int64 (n_page,)
        Filled with the cells used up by each page, divider included.

    Returns
    -------
    at, n_page, n_up : int
        Where the rest of the stream begins; pages and bytes of `ups` filled.
    """
    n_page = 0
    n_up = 0
    end = cells.shape[0]
    has_divider = kind != LEAF_TABLE
    head = 12 if kind in (INNER_INDEX, INNER_TABLE) else 8
    starts = np.empty(pages.shape[1] // 6 + 2, np.int64)  # a cell takes at least 4 bytes and 2 for its pointer
    while n_page < pages.shape[0] and at < end:
        starts[0] = at
        n_cell = 0
        room = pages.shape[1] - head
        stop = at
        while stop < end:
            stop = cell_end(kind, cells, stop)
            room -= stop - starts[n_cell] + 2
            if room < 0:
                break
            n_cell += 1
            starts[n_cell] = stop
        is_all = room >= 0
        is_short = has_divider and stop == end and not is_all  # no cell behind the divider
        if mode == STREAM and (is_all or is_short):
            break
        if (mode == LAST and is_short) or (mode == SEAL and is_all and has_divider):
            n_cell -= 1  # the last cell that fits becomes the divider
        stop = starts[n_cell]
        if n_cell == 0:
            break
        number = first_page + n_page
        is_last = is_all and mode == LAST
        next_at = stop if is_last or not has_divider else cell_end(kind, cells, stop)
        right_child = last_child if is_last else 0
        if not is_last:
            n_up = put_word(ups, n_up, number, 4)
            from_byte, to_byte = stop, next_at
            if kind == LEAF_TABLE:
                from_byte = varint_at(cells, starts[n_cell - 1])[1]
                to_byte = varint_at(cells, from_byte)[1]
            elif kind == LEAF_INDEX:
                payload, from_payload = varint_at(cells, stop)
                to_byte = from_payload + payload  # without the zeros that filled up a leaf cell
            else:
                for b in range(4):
                    right_child = right_child << 8 | np.int64(cells[stop + b])
                from_byte = stop + 4
            for b in range(from_byte, to_byte):
                ups[n_up] = cells[b]
                n_up += 1
        put_page(kind, cells, starts, n_cell, stop, right_child, pages[n_page])
        page_rows[n_page] = n_cell + (0 if is_last or not has_divider else 1)
        n_page += 1
        at = next_at
    return at, n_page, n_up
