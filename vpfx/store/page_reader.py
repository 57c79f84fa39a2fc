"""Rows of a store as arrays, taken from its pages: the layout of SQLite B-trees, read.

SQLite gives a row at a time, each value a Python object; here a kernel decodes the records of whole leaves. Nothing in the
file is trusted: every page, pointer and length is checked against the file before it is followed.

Source: "SQLite file format", sqlite.org/fileformat2.html, §1.5, §1.6, §2.1.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from vpfx.store.page_cells import INNER_INDEX, INNER_TABLE, LEAF_TABLE

__all__ = [
    "IS_BROKEN",
    "PAGE",
    "cell_at",
    "child_at",
    "find_leaves",
    "grown",
    "head_of",
    "meets",
    "read_records",
    "size_of",
    "varint",
    "whole",
]

PAGE = 4096
FILE_HEADER = 100  # bytes, on the first page
IS_BROKEN = -1
NULL_INT = -1

OTHER, WHOLE, REAL = range(3)
"""What a column gives: nothing, int64 (NULL is -1), float64 (NULL is NaN)."""


@njit(nogil=True, cache=True)
def varint(data, at, stop):
    """Return the variable-length integer at a byte and its end; the end is negative if it runs over."""
    value = np.int64(0)
    for i in range(9):
        if at >= stop:
            return value, IS_BROKEN
        byte = np.int64(data[at])
        at += 1
        if i == 8:
            return value << 8 | byte, at
        value = value << 7 | (byte & 127)
        if byte < 128:
            return value, at
    return value, IS_BROKEN


@njit(nogil=True, cache=True)
def _big_endian(data, at, n):
    """Return n bytes as a signed integer."""
    value = np.int64(data[at])
    if value > 127:
        value -= 256
    for i in range(1, n):
        value = value << 8 | np.int64(data[at + i])
    return value


@njit(nogil=True, cache=True)
def head_of(data, page):
    """Return kind, number of cells, and the place of the pointers of a page."""
    base = (page - 1) * PAGE + (FILE_HEADER if page == 1 else 0)
    kind = data[base]
    n_cell = np.int64(data[base + 3]) << 8 | np.int64(data[base + 4])
    pointers = base + (12 if kind in (INNER_TABLE, INNER_INDEX) else 8)
    if pointers + 2 * n_cell > page * PAGE:
        return 0, 0, 0
    return kind, n_cell, pointers


@njit(nogil=True, cache=True)
def cell_at(data, page, pointers, n_cell, i):
    """Return the place of a cell of a page; -1 if it does not lie behind the pointers."""
    at = (page - 1) * PAGE + (np.int64(data[pointers + 2 * i]) << 8 | np.int64(data[pointers + 2 * i + 1]))
    return at if pointers + 2 * n_cell <= at < page * PAGE else IS_BROKEN


@njit(nogil=True, cache=True)
def child_at(data, at):
    """Return the number of a page that four bytes give."""
    child = np.int64(0)
    for b in range(4):
        child = child << 8 | np.int64(data[at + b])
    return child


@njit(nogil=True, cache=True)
def meets(lows, highs, low, high):
    """Tell whether any of some ascending runs holds a number from low to high."""
    run = np.searchsorted(highs, low)
    return run < len(highs) and lows[run] <= high


@njit(nogil=True, cache=True)
def grown(values):
    """Return an array with room for twice as many rows, and its values."""
    larger = np.empty((2 * len(values), *values.shape[1:]), values.dtype)
    larger[: len(values)] = values
    return larger


@njit(nogil=True, cache=True)
def find_leaves(data, root, lows, highs):
    """List the leaves of a table that may hold rows of some runs of ids, in order.

    Parameters
    ----------
    data : uint8 (n_page * PAGE,)
    root : int
        Page of the table.
    lows, highs : int64 (n_run,)
        First and last id of each run, ascending.

    Returns
    -------
    int64 (n,), int
        Pages, and how many rows they have; -1 rows if the tree is broken.

    Notes
    -----
    Cost: O(pages listed · log n_run + depth of the tree).
    """
    n_page = len(data) // PAGE
    leaves, stack, n_left = np.empty(16, np.int64), np.empty(1024, np.int64), 1
    stack[0], count, n_row, seen = root, 0, 0, 0
    while n_left > 0:
        n_left -= 1
        page = stack[n_left]
        seen += 1
        if page < 1 or page > n_page or seen > n_page:
            return leaves[:0], IS_BROKEN
        kind, n_cell, pointers = head_of(data, page)
        if kind == LEAF_TABLE:
            if count == len(leaves):
                leaves = grown(leaves)
            leaves[count] = page
            count += 1
            n_row += n_cell
            continue
        if kind != INNER_TABLE:
            return leaves[:0], IS_BROKEN
        first = n_left
        previous = np.iinfo(np.int64).min
        for i in range(n_cell + 1):
            last = np.iinfo(np.int64).max
            if i < n_cell:
                at = cell_at(data, page, pointers, n_cell, i)
                if at < 0 or at + 4 > page * PAGE:
                    return leaves[:0], IS_BROKEN
                last, end = varint(data, at + 4, page * PAGE)
                if end < 0 or last <= previous:
                    return leaves[:0], IS_BROKEN
            else:
                at = pointers - 4
            if meets(lows, highs, previous, last):
                if n_left > n_page:
                    return leaves[:0], IS_BROKEN
                if n_left == len(stack):
                    stack = grown(stack)
                stack[n_left] = child_at(data, at)
                n_left += 1
            previous = last
        stack[first:n_left] = stack[first:n_left][::-1].copy()  # the first child is looked at first
    return leaves[:count], n_row


@njit(nogil=True, cache=True)
def read_records(data, leaves, lows, highs, kinds, wholes, reals, ids):
    """Decode the rows of some leaves whose ids lie in runs.

    Parameters
    ----------
    data : uint8 (n_page * PAGE,)
    leaves : int64 (n_leaf,)
        By `find_leaves`.
    lows, highs : int64 (n_run,)
    kinds : int64 (n_column,)
        What each column gives: OTHER, WHOLE or REAL.
    wholes : int64 (n_whole, ≥ n), reals : float64 (n_real, ≥ n), ids : int64 (≥ n,)
        Take the values; a column that stands for the id is taken as the id.

    Returns
    -------
    int
        Number of rows, -1 if a record is broken.

    Notes
    -----
    Cost: O(bytes of the leaves).
    """
    count = run = 0
    previous = np.iinfo(np.int64).min
    for page in leaves:
        kind, n_cell, pointers = head_of(data, page)
        stop = page * PAGE
        if kind != LEAF_TABLE:
            return IS_BROKEN
        for i in range(n_cell):
            at = cell_at(data, page, pointers, n_cell, i)
            if at < 0:
                return IS_BROKEN
            n_byte, at = varint(data, at, stop)
            if at < 0:
                return IS_BROKEN
            row, at = varint(data, at, stop)
            if at < 0 or n_byte < 1 or n_byte > stop - at or row <= previous:
                return IS_BROKEN
            previous = row
            while run < len(highs) and highs[run] < row:
                run += 1
            if run == len(highs) or row < lows[run]:
                continue
            end = at + n_byte
            n_head, types = varint(data, at, end)
            if types < 0 or n_head < 1 or n_head > end - at or count >= len(ids):
                return IS_BROKEN
            body = at + n_head
            ids[count] = row
            n_whole = n_real = 0
            for column in range(len(kinds)):
                if types >= at + n_head:
                    return IS_BROKEN
                code, types = varint(data, types, at + n_head)
                if types < 0 or code < 0:
                    return IS_BROKEN
                size = size_of(code)
                if size > end - body:
                    return IS_BROKEN
                if kinds[column] == WHOLE:
                    if code > 9 or code == 7:
                        return IS_BROKEN
                    wholes[n_whole, count] = NULL_INT if code == 0 else whole(data, body, code)
                    n_whole += 1
                elif kinds[column] == REAL:
                    if code > 9:
                        return IS_BROKEN
                    value = np.nan
                    if code == 7:
                        bits = np.empty(1, np.int64)
                        bits[0] = _big_endian(data, body, 8)
                        value = bits.view(np.float64)[0]
                    elif code > 0:
                        value = float(whole(data, body, code))
                    reals[n_real, count] = value
                    n_real += 1
                body += size
            count += 1
    return count


@njit(nogil=True, cache=True)
def size_of(code):
    """Return the bytes of a value by its serial type."""
    if code >= 12:
        return (code - 12) // 2
    if code >= 8:
        return 0
    if code >= 6:
        return 8
    return 6 if code == 5 else code


@njit(nogil=True, cache=True)
def whole(data, at, code):
    """Return the whole number of a serial type."""
    if code >= 8:
        return np.int64(code - 8)
    return _big_endian(data, at, size_of(code))
