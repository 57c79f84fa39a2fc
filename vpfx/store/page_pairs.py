"""Pairs of ids as arrays, taken from the pages of an index: `parent_child` by child and by parent.

The tables and indexes of links are B-trees of records with two integers and nothing else. As in `vpfx.store.page_reader`, every
page, pointer and length is checked before it is followed.

Source: "SQLite file format", sqlite.org/fileformat2.html, §1.6, §2.1.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from vpfx.store.page_cells import INNER_INDEX, LEAF_INDEX
from vpfx.store.page_reader import IS_BROKEN, PAGE, cell_at, child_at, grown, head_of, meets, size_of, varint, whole

__all__ = ["read_pairs"]

MOST_DEEP = 64  # pages from the root to a leaf; SQLite has 20 at most


@njit(nogil=True, cache=True)
def read_pairs(data, root, lows, highs):
    """Decode the pairs of an index whose first number lies in runs.

    Parameters
    ----------
    data : uint8 (n_page * PAGE,)
    root : int
        Page of the index.
    lows, highs : int64 (n_run,)
        First and last number of each run, ascending.

    Returns
    -------
    int64 (room, 2), int
        Pairs, ascending, and how many of them count; -1 if the tree or a record is broken.

    Notes
    -----
    Cost: O(pages that hold the runs · log n_run + depth of the tree).
    """
    n_page = len(data) // PAGE
    found, count = np.empty((64, 2), np.int64), np.int64(0)
    pages, states = np.empty(MOST_DEEP, np.int64), np.empty(MOST_DEEP, np.int64)
    pages[0], states[0], depth, seen = root, 0, 1, 0
    while depth > 0:
        page, state = pages[depth - 1], states[depth - 1]
        if page < 1 or page > n_page:
            return found, IS_BROKEN
        kind, n_cell, pointers = head_of(data, page)
        stop = page * PAGE
        if kind == LEAF_INDEX:
            for i in range(n_cell):
                first, second, is_sound = _pair_at(data, cell_at(data, page, pointers, n_cell, i), 0, stop)
                if not is_sound:
                    return found, IS_BROKEN
                if meets(lows, highs, first, first):
                    found, count = _put(found, count, first, second)
                    if count == IS_BROKEN:
                        return found, IS_BROKEN
            depth -= 1
            continue
        if kind != INNER_INDEX:
            return found, IS_BROKEN
        i = state // 2  # state 2 i: before child i, 2 i + 1: before the record between children i and i + 1
        at = pointers - 4
        previous, first, second = np.iinfo(np.int64).min, np.iinfo(np.int64).max, np.int64(0)
        if i > 0:
            previous, _, _ = _pair_at(data, cell_at(data, page, pointers, n_cell, i - 1), 4, stop)  # was sound
        if i < n_cell:
            at = cell_at(data, page, pointers, n_cell, i)
            first, second, is_sound = _pair_at(data, at, 4, stop)
            if not is_sound:
                return found, IS_BROKEN
        states[depth - 1] += 1
        if state % 2 == 1:
            if i == n_cell or first > highs[-1]:
                depth -= 1
            elif meets(lows, highs, first, first):
                found, count = _put(found, count, first, second)
                if count == IS_BROKEN:
                    return found, IS_BROKEN
        elif meets(lows, highs, previous, first):
            seen += 1
            if depth == MOST_DEEP or seen > n_page:
                return found, IS_BROKEN
            pages[depth], states[depth] = child_at(data, at), 0
            depth += 1
    return found, count


@njit(nogil=True, cache=True)
def _pair_at(data, cell, skipped, stop):
    """Return the two integers of the record of a cell behind some bytes, and whether it is one."""
    broken = np.int64(0), np.int64(0), False
    if cell < 0:
        return broken
    n_byte, at = varint(data, cell + skipped, stop)
    if at < 0 or n_byte < 3 or n_byte > stop - at:
        return broken
    end = at + n_byte
    n_head, types = varint(data, at, end)
    body = at + n_head
    if types < 0 or n_head != 3 or body > end:
        return broken
    code, other = np.int64(data[types]), np.int64(data[types + 1])
    for one in (code, other):
        if one == 0 or one == 7 or one > 9:
            return broken
    if body + size_of(code) + size_of(other) > end:
        return broken
    return whole(data, body, code), whole(data, body + size_of(code), other), True


@njit(nogil=True, cache=True)
def _put(found, count, first, second):
    """Append a pair; return the array, grown if it was full, and the count; -1 if the pair does not follow the last one."""
    if count > 0 and (first, second) <= (found[count - 1, 0], found[count - 1, 1]):
        return found, IS_BROKEN
    if count == len(found):
        found = grown(found)
    found[count] = first, second
    return found, count + 1
