"""Rows of different lengths: where they start, and their values, taken from bytes and put there.

A row of columns id (I), right_face (K), coordinates (C,*)::

    at ─► id          at ─► K            at ─► count       pairs
          01 00 00 00       40 02              02 00 00 00 xx xx xx xx yy yy yy yy xx xx xx xx yy yy yy yy
          ────────────      ─────              ────────────────────────────────────────────────────────────
    advances by 4           by 1 + widths      by 4 + count · 8                                            = start of the next

All rows do one column, then the next: `at` is an array with the place of each row. Whatever a count or a type byte says is
checked against the end of its row before it is followed. Source: specs/vpf.md, V-115, V-120.
"""

from __future__ import annotations

import numpy as np
from numba import njit

__all__ = [
    "COUNT",
    "FITS",
    "OUT_OF_BYTES",
    "RUNS_OVER",
    "SKIP",
    "TRIPLET",
    "pad_texts",
    "put_bytes",
    "put_runs",
    "put_triplets",
    "scan_rows",
    "take_bytes",
    "take_counts",
    "take_runs",
    "take_triplets",
    "triplet_sizes",
]

SKIP, COUNT, TRIPLET = range(3)
"""Steps of a row: so many bytes; a count and so many bytes for each; a triplet."""

FITS, OUT_OF_BYTES, RUNS_OVER = range(3)
"""How a scan ended: at the end of the file, at the end of its bytes, with a row that runs over the end of the file."""

MOST_INT = 2**31 - 1


@njit(nogil=True, cache=True)
def _word(data, at, width, is_big):
    """Return the unsigned integer of so many bytes at a place."""
    word, place = np.uint64(0), np.uint64(at)  # unsigned: no index counts from the end
    for b in range(np.uint64(width)):
        byte = np.uint64(data[place + b])
        word |= byte << np.uint64(8) * (np.uint64(width - 1) - b if is_big else b)
    return word


@njit(nogil=True, cache=True)
def _put_word(data, at, width, is_big, word):
    """Put an unsigned integer of so many bytes at a place."""
    place = np.uint64(at)
    for b in range(np.uint64(width)):
        shift = np.uint64(8) * (np.uint64(width - 1) - b if is_big else b)
        data[place + b] = np.uint8((word >> shift) & np.uint64(255))


@njit(nogil=True, cache=True)
def _copy(source, start, target, to, n):
    """Copy bytes."""
    start, to = np.uint64(start), np.uint64(to)
    for j in range(np.uint64(n)):
        target[to + j] = source[start + j]


@njit(nogil=True, cache=True)
def _width(code):
    """Return the bytes that a width code of a triplet stands for."""
    return 4 if code == 3 else code


@njit(nogil=True, cache=True)
def scan_rows(data, base, state, end, steps, is_big, starts):
    """Find where rows start, as far as the bytes go.

    Parameters
    ----------
    data : uint8 (n_byte,)
        Bytes of the file from offset `base`.
    state : int64 (3,)
        Offset of the next step, number of that step, start of its row; brought up to date.
    end : int
        Bytes of the file.
    steps : int64 (n_step, 2)
        What a row consists of, and bytes: those skipped, those of each element.
    starts : int64 (n,)
        Room for the starts of rows; the scan pauses where it is full.

    Returns
    -------
    int, int
        Rows found, and how the scan ended.
    """
    at, step, row = state
    limit = base + len(data)
    n_found, ended = 0, FITS
    while at < end or step > 0:
        if n_found == len(starts):
            ended = OUT_OF_BYTES
            break
        kind, size = steps[step]
        head = 4 if kind == COUNT else (1 if kind == TRIPLET else 0)
        if at + head > end:
            ended = RUNS_OVER
            break
        if at + head > limit:
            ended = OUT_OF_BYTES
            break
        if kind == COUNT:
            size = 4 + size * np.int64(_word(data, at - base, 4, is_big))
        elif kind == TRIPLET:
            code = np.int64(data[at - base])
            size = 1 + _width(code >> 6) + _width(code >> 4 & 3) + _width(code >> 2 & 3) + _width(code & 3)
        if size > end - at:
            ended = RUNS_OVER
            break
        at += size
        step += 1
        if step == len(steps):
            starts[n_found] = row
            n_found += 1
            step, row = 0, at
    state[0], state[1], state[2] = at, step, row
    return n_found, ended


@njit(nogil=True, cache=True)
def take_bytes(data, at, out):
    """Copy as many bytes as a row of `out`, uint8 (n_row, n), has from each row's place; the caller has checked the ends."""
    for i in range(len(at)):
        _copy(data, at[i], out[i], 0, out.shape[1])


@njit(nogil=True, cache=True)
def take_counts(data, at, ends, is_big, size, starts):
    """Take counts of elements of so many bytes; add them up in `starts` (n_row + 1,); return the first bad row or -1."""
    starts[0] = 0
    for i in range(len(at)):
        room = ends[i] - at[i] - 4
        if room < 0:
            return i
        count = np.int64(_word(data, at[i], 4, is_big))
        if count > MOST_INT or count > room // size:
            return i
        starts[i + 1] = starts[i] + count
    return -1


@njit(nogil=True, cache=True)
def take_runs(data, at, starts, size, out):
    """Copy the elements behind each row's count, of so many bytes, to `out`, uint8 (starts[-1] * size,)."""
    for i in range(len(at)):
        _copy(data, at[i] + 4, out, starts[i] * size, (starts[i + 1] - starts[i]) * size)


@njit(nogil=True, cache=True)
def take_triplets(data, at, ends, is_big, out):
    """Take triplets to `out`, int64 (n_row, 3), and move each place behind its own; return the first bad row or -1."""
    for i in range(len(at)):
        place = at[i]
        if place >= ends[i]:
            return i
        code = np.int64(data[place])
        widths = _width(code >> 6), _width(code >> 4 & 3), _width(code >> 2 & 3), _width(code & 3)
        if place + 1 + widths[0] + widths[1] + widths[2] + widths[3] > ends[i]:
            return i
        place += 1
        for j in range(3):
            out[i, j] = np.int64(_word(data, place, widths[j], is_big))
            place += widths[j]
        at[i] = place + widths[3]  # the reserved field (V-115)
    return -1


@njit(nogil=True, cache=True)
def _code(value):
    """Return the width code of the fewest bytes that hold a value."""
    return 0 if value == 0 else (1 if value < 256 else (2 if value < 65536 else 3))


@njit(nogil=True, cache=True)
def triplet_sizes(triplets):
    """Return the bytes of each of some triplets, int64 (n_row, 3), written as short as can be; int64 (n_row,)."""
    sizes = np.empty(len(triplets), np.int64)
    for i in range(len(triplets)):
        size = 1
        for j in range(3):
            size += _width(_code(triplets[i, j]))
        sizes[i] = size
    return sizes


@njit(nogil=True, cache=True)
def put_triplets(data, at, is_big, triplets):
    """Put triplets at their places, and move each place behind its own."""
    for i in range(len(at)):
        place = at[i]
        codes = _code(triplets[i, 0]), _code(triplets[i, 1]), _code(triplets[i, 2])
        data[place] = np.uint8(codes[0] << 6 | codes[1] << 4 | codes[2] << 2)
        place += 1
        for j in range(3):
            width = _width(codes[j])
            _put_word(data, place, width, is_big, np.uint64(triplets[i, j]))
            place += width
        at[i] = place


@njit(nogil=True, cache=True)
def pad_texts(texts, most, out):
    """Copy texts, uint8 (n_row, n), to `out` (n_row, width), NULs behind them made blanks.

    Returns the first row with a text that is longer, or with a character greater than `most`, or -1.
    """
    width = out.shape[1]
    for i in range(len(texts)):
        n = texts.shape[1]
        while n > 0 and texts[i, n - 1] == 0:
            n -= 1
        if n > width:
            return i
        for j in range(n):
            if texts[i, j] > most:
                return i
            out[i, j] = texts[i, j]
        out[i, n:] = 32
    return -1


@njit(nogil=True, cache=True)
def put_bytes(data, at, values):
    """Copy rows of bytes, uint8 (n_row, n), to their places."""
    for i in range(len(at)):
        _copy(values[i], 0, data, at[i], values.shape[1])


@njit(nogil=True, cache=True)
def put_runs(data, at, is_big, starts, size, values):
    """Put a count and that many elements of so many bytes, from uint8 (starts[-1] * size,), at each row's place."""
    for i in range(len(at)):
        count = starts[i + 1] - starts[i]
        _put_word(data, at[i], 4, is_big, np.uint64(count))
        _copy(values, starts[i] * size, data, at[i] + 4, count * size)
