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

helper = njit(no_cpython_wrapper=True, no_cfunc_wrapper=True)
"""Decorates what only kernels call: without a door to Python it compiles sooner."""


@helper
def varint_end(cells, at):  # type: ignore[no-untyped-def]
    """Return the end of the variable-length integer at a byte; the ninth byte is the last, whatever it holds."""
    last = at + 8
    while cells[at] > 127 and at < last:
        at += 1
    return at + 1


@helper
def cell_end(kind, cells, at):  # type: ignore[no-untyped-def]
    """Return the end of the cell at a byte, by the kind of page it is for."""
    start = at
    if kind in (INNER_INDEX, INNER_TABLE):
        at += 4
    payload = 0
    if kind != INNER_TABLE:
        while cells[at] > 127:
            payload = payload << 7 | (cells[at] & 127)
            at += 1
        payload = payload << 7 | cells[at]
        at += 1
    if kind in (INNER_TABLE, LEAF_TABLE):
        at = varint_end(cells, at)
    return max(at + payload, start + 4)


@njit(nogil=True, cache=True)
def cells_end(kind, cells, n_cell):  # type: ignore[no-untyped-def]
    """Return the end of the first cells of a stream; source §1.6."""
    at = 0
    for _ in range(n_cell):
        at = cell_end(kind, cells, at)
    return at


@helper
def put_number(page, at, number):  # type: ignore[no-untyped-def]
    """Write the number of a page, four bytes, and return their end."""
    for b in range(4):
        page[at + b] = number >> 8 * (3 - b) & 255
    return at + 4


@helper
def put_page(kind, cells, starts, n_cell, stop, right_child, page):  # type: ignore[no-untyped-def]
    """Write one page: header, pointers to the cells, zeros, and the cells as they stand in the stream.

    ::

        page   | kind | 0 | n_cell | content | 0 | right_child | pointer 0 … | zeros | cell 0 | cell 1 | … |
                  1     2     2        2       1   4, interior    2 each               ↑ content

    Source: §1.6. `starts` is int64 (≥ n_cell,), the place of each cell in the stream; `stop` is the end of the last.
    """
    content = page.shape[0] - (stop - starts[0])
    page[0] = kind
    page[1] = page[2] = page[7] = 0
    page[3], page[4] = n_cell >> 8, n_cell & 255
    page[5], page[6] = content >> 8, content & 255
    at = 8
    if kind in (INNER_INDEX, INNER_TABLE):
        at = put_number(page, at, right_child)
    for j in range(n_cell):
        pointer = content + starts[j] - starts[0]
        page[at], page[at + 1] = pointer >> 8, pointer & 255
        at += 2
    for b in range(at, content):
        page[b] = 0
    source = cells[starts[0] : stop]
    target = page[content:]
    for b in range(source.shape[0]):
        target[b] = source[b]


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
    starts = np.empty(pages.shape[1] // 6 + 3, np.int64)  # a cell takes at least 4 bytes and 2 for its pointer
    while n_page < pages.shape[0] and at < end:
        starts[0] = at
        n_cell = 0
        room = pages.shape[1] - head
        stop = at
        while stop < end:
            stop = cell_end(kind, cells, stop)
            starts[n_cell + 1] = stop
            room -= stop - starts[n_cell] + 2
            if room < 0:
                break
            n_cell += 1
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
        next_at = starts[n_cell + 1] if has_divider and not is_last else stop
        right_child = last_child if is_last else 0
        if not is_last:
            n_up = put_number(ups, n_up, number)
            from_byte, to_byte = stop, next_at
            if kind == LEAF_TABLE:
                from_byte = varint_end(cells, starts[n_cell - 1])
                to_byte = varint_end(cells, from_byte)
            elif kind == LEAF_INDEX:
                if cells[stop] < 3:
                    to_byte = stop + 1 + cells[stop]  # without the zeros that filled up the cell
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
