"""Rows given as numpy columns turned into cells of SQLite B-tree leaves.

Source: "SQLite file format", sqlite.org/fileformat2.html, §1.6 (cells, varints), §2.1 (record format). The cells of all
rows make one stream, one behind the other; `vpfx.store.page_cells` cuts it into pages.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["BLOB", "FLOAT", "INT", "NULL_INT", "REAL", "ROWID", "RowBlock", "find_disorder", "put_rows"]

Column = NDArray[Any]

NULL_INT = np.iinfo(np.int64).min
"""The integer that stands for NULL."""

ROWID, INT, FLOAT, REAL, BLOB = range(5)
"""Kinds of column; REAL is a float that may be stored as an integer, as SQLite does for columns of REAL affinity."""

BLOCK_BYTES = 1 << 19
"""Size aimed at for one block of encoded rows: large against the cost of a call, small enough for the L2 cache."""

WORD = 8
"""Bytes written at once."""

INT48 = 1 << 47
"""Integers below this have at most 6 bytes; larger integral floats are kept as floats, which costs no more."""

helper = njit(no_cpython_wrapper=True, no_cfunc_wrapper=True)
"""Decorates what only kernels call: without a door to Python it compiles sooner."""


class RowBlock:
    """Room for a block of rows of one tree, and their cells; made once, filled again and again.

    Parameters
    ----------
    kinds : sequence of int
        ROWID (only first), INT, FLOAT, REAL or BLOB, for each column.
    lengths : sequence of int
        Bytes of each blob column, 0 for others.
    n_key : int
        Columns that make the key, from the first.
    room : int
        Bytes to keep free in front of the cells, for a rest of cells written before.
    """

    def __init__(self, kinds: Sequence[int], lengths: Sequence[int], n_key: int, room: int) -> None:
        codes = [to_varint(12 + 2 * length if kind == BLOB else 0) for kind, length in zip(kinds, lengths, strict=True)]
        n_head = sum(map(len, codes)) + 1
        n_head += n_head > 127  # its own size is in it
        head = to_varint(n_head)
        layout, runs = [], [[0, 0, len(head), 0, 0]]
        place = 0
        for column, (kind, length, code) in enumerate(zip(kinds, lengths, codes, strict=True)):
            layout.append((kind, place, length))
            head += code
            if kind == BLOB:
                runs[-1][3:] = place, length
                runs.append([column + 1, 0, len(head), place, 0])
            else:
                runs[-1][1] += 1
            place += length
        self.layout = np.array(layout, np.int64)
        self.runs = np.array(runs, np.uint64)
        self.head = np.frombuffer(head.ljust(-(-len(head) // WORD) * WORD, b"\0"), ">u8").astype(np.uint64)
        self.n_fixed = len(head), place
        self.n_key = n_key
        worst = 12 + 3 + len(head) + 8 * len(kinds) + place  # sizes and rowid, filling up, the record
        self.n_row = max(BLOCK_BYTES // worst, 1)
        self.values = np.zeros((len(kinds), self.n_row), np.int64)
        self.reals = self.values.view(np.float64)
        self.codes = np.zeros((len(kinds), self.n_row), np.uint8)
        self.blobs = np.zeros((self.n_row, place + WORD), np.uint8)  # read in words
        self.cells = np.zeros(room + worst * self.n_row + WORD, np.uint8)  # `put_rows` writes words, then steps back

    def load(self, columns: Sequence[Column], start: int) -> int:
        """Copy rows from `start` on into the block and return how many."""
        n_row = min(self.n_row, len(columns[0]) - start)
        for values, reals, (kind, place, length), column in zip(
            self.values, self.reals, self.layout.tolist(), columns, strict=True
        ):
            part = column[start : start + n_row]
            if kind == BLOB:
                self.blobs[:n_row, place : place + length] = part
            elif kind in (FLOAT, REAL):
                reals[:n_row] = part
            else:
                values[:n_row] = part
        return n_row

    def find_disorder(self, n_row: int) -> int:
        """Return the first row whose key is not above the one before, or -1."""
        return int(find_disorder(n_row, self.n_key, self.layout, self.values, self.reals, self.blobs))

    def put_rows(self, n_row: int, at: int) -> tuple[int, int]:
        """Write the cells of the first rows of the block to `cells` from byte `at` on.

        Returns the end of the cells and the size of the largest payload.
        """
        put_codes(n_row, self.layout, self.values, self.reals, self.codes)
        end, largest = put_rows(
            n_row, self.layout[0, 0] == ROWID, self.runs, self.head, self.n_fixed, self.codes, self.values, self.blobs,
            self.cells, at,
        )  # fmt: skip
        return int(end), int(largest)


def to_varint(value: int) -> bytes:
    """Return a small number as variable-length integer (§1.6).

    Examples
    --------
    >>> to_varint(127).hex(), to_varint(128).hex()
    ('7f', '8100')
    """
    high = b"" if value < 128 else bytes(byte | 128 for byte in to_varint(value >> 7))
    return high + bytes([value & 127])


@njit(nogil=True, cache=True)
def find_disorder(n_row, n_key, layout, values, reals, blobs):  # type: ignore[no-untyped-def]
    """Return the first row whose key is not above that of the row before, or -1.

    NULL is below everything, blobs compare byte by byte (§2.4, "Record Sort Order"). Arguments as in `put_codes`.
    """
    for i in range(1, n_row):
        order = 0
        for c in range(n_key):
            kind = layout[c, 0]
            if kind == BLOB:
                for b in range(layout[c, 1], layout[c, 1] + layout[c, 2]):
                    order = 0 + blobs[i, b] - blobs[i - 1, b]
                    if order != 0:
                        break
            elif kind in (FLOAT, REAL):
                x, y = reals[c, i - 1], reals[c, i]
                order = (y > x) - (y < x) + np.isnan(x) - np.isnan(y)  # a comparison with NaN is false
            else:
                order = (values[c, i] > values[c, i - 1]) - (values[c, i] < values[c, i - 1])
            if order != 0:
                break
        if order <= 0:
            return i
    return -1


@helper
def put_varint(cells, at, rest):  # type: ignore[no-untyped-def]
    """Write a variable-length integer (§1.6), uint64, and return its end; a negative one takes nine bytes."""
    if rest < 128:
        cells[at] = rest
        return at + np.uint64(1)
    n_byte = np.uint64(2)
    while n_byte < 9 and rest >> np.uint64(7) * n_byte > 0:
        n_byte += np.uint64(1)
    last = at + n_byte - np.uint64(1)
    n_bit = np.uint64(8 if n_byte == 9 else 7)  # the ninth byte is a whole one
    cells[last] = rest & (np.uint64(1) << n_bit) - np.uint64(1)
    rest >>= n_bit
    while last > at:
        last -= np.uint64(1)
        cells[last] = rest & np.uint64(127) | np.uint64(128)
        rest >>= np.uint64(7)
    return at + n_byte


@njit(nogil=True, cache=True)
def put_codes(n_row, layout, values, reals, codes):  # type: ignore[no-untyped-def]
    """Find the serial type of each number (§2.1); integral numbers of REAL columns become integers in `values`.

    Arguments as in `put_rows`, `reals` is the memory of `values` as float64. Rowids are NULL in the record, blobs are
    left out. The chain of conditions becomes vector instructions.
    """
    for c in range(layout.shape[0]):
        kind = layout[c, 0]
        if kind in (FLOAT, REAL):
            for i in range(n_row):
                codes[c, i] = 0 if np.isnan(reals[c, i]) else 7
        elif kind != BLOB:
            for i in range(n_row):
                codes[c, i] = 0 if kind == ROWID else int_code(values[c, i])
        if kind == REAL:
            for i in range(n_row):
                if -INT48 < reals[c, i] < INT48:
                    whole = np.int64(reals[c, i])
                    if whole == reals[c, i] and (whole != 0 or values[c, i] == 0):  # -0.0 stays a float
                        values[c, i] = whole
                        codes[c, i] = int_code(whole)


@helper
def int_code(value):  # type: ignore[no-untyped-def]
    """Return the serial type of the shortest form of an integer (§2.1)."""
    size = value ^ (value >> 63)
    code = 1
    if size >= 1 << 7:
        code = 2
    if size >= 1 << 15:
        code = 3
    if size >= 1 << 23:
        code = 4
    if size >= 1 << 31:
        code = 5
    if size >= 1 << 47:
        code = 6
    if value == 0:
        code = 8
    if value == 1:
        code = 9
    if value == NULL_INT:
        code = 0
    return code


@helper
def put_word(cells, at, word):  # type: ignore[no-untyped-def]
    """Write eight bytes, the most significant first; unrolled, so that it becomes one instruction."""
    cells[at] = word >> np.uint64(56)
    cells[at + np.uint64(1)] = word >> np.uint64(48)
    cells[at + np.uint64(2)] = word >> np.uint64(40)
    cells[at + np.uint64(3)] = word >> np.uint64(32)
    cells[at + np.uint64(4)] = word >> np.uint64(24)
    cells[at + np.uint64(5)] = word >> np.uint64(16)
    cells[at + np.uint64(6)] = word >> np.uint64(8)
    cells[at + np.uint64(7)] = word


@helper
def get_word(row, at):  # type: ignore[no-untyped-def]
    """Read eight bytes, the most significant first."""
    word = np.uint64(row[at])
    for b in range(1, WORD):
        word = word << np.uint64(8) | np.uint64(row[at + np.uint64(b)])
    return word


@njit(nogil=True, cache=True)
def put_rows(n_row, is_table, runs, head, n_fixed, codes, values, blobs, cells, at):  # type: ignore[no-untyped-def]
    """Write one leaf cell per row; return the end of the last cell and the size of the largest payload.

    ::

        cell     | payload size | rowid | head size | code 0 | code 1 | … | body 0 | body 1 | … |
                                 table   <------------- head -------------> <------ body ------>
        code     NULL 0   1, 2, 3, 4, 6, 8 bytes 1…6   float 7   zero 8   one 9   blob 12 + 2 × length

    Parameters
    ----------
    n_row : int
        Rows to write.
    is_table : bool
        Whether column 0 is the rowid.
    runs : uint64 (n_run, 5)
        Numbers that stand side by side, and the blob behind them: first column, number of columns, place of the first
        code in the head; first byte in `blobs` and length, 0 if there is none.
    head : uint64 (n,)
        Head of the record in words, with the codes of blobs.
    n_fixed : (int, int)
        Bytes of the head, and of all blobs.
    codes : uint8 (n_col, ≥ n_row)
        Serial types of numbers, from `put_codes`.
    values : int64 (n_col, ≥ n_row)
        Integers, and the bits of floats.
    blobs : uint8 (≥ n_row, n)
        All blob columns side by side, and a word behind them.
    cells : uint8 (n,)
        Written from byte `at` on; must have room for the largest cells and a word more.

    Notes
    -----
    Source: §1.6, §2.1. A number is written as the word that starts with its bytes, big-endian; what is too much is
    overwritten by the next one. Offsets are unsigned, which spares numba the handling of negative ones.
    """
    width_of = np.array([0, 1, 2, 3, 4, 6, 8, 8, 0, 0], np.uint64)
    one, word = np.uint64(1), np.uint64(WORD)
    n_head = np.uint64(n_fixed[0])
    end = np.uint64(at)
    largest = np.uint64(0)
    for i in range(n_row):
        payload = n_head + np.uint64(n_fixed[1])
        for r in range(runs.shape[0]):
            c = runs[r, 0]
            for _ in range(np.int64(runs[r, 1])):
                payload += width_of[codes[c, i]]
                c += one
        largest = max(largest, payload)
        least_end = end + np.uint64(4)
        end = put_varint(cells, end, payload)
        if is_table:
            end = put_varint(cells, end, np.uint64(values[0, i]))
        for w in range(head.shape[0]):
            put_word(cells, end + np.uint64(w) * word, head[w])
        body = end + n_head
        for r in range(runs.shape[0]):
            c = runs[r, 0]
            code_at = end + runs[r, 2]
            for _ in range(np.int64(runs[r, 1])):
                code = codes[c, i]
                width = width_of[code]
                number = np.uint64(values[c, i]) << (np.uint64(64) - (width << np.uint64(3)) & np.uint64(63))
                cells[code_at] = code
                put_word(cells, body, number)
                code_at += one
                body += width
                c += one
            from_byte = runs[r, 3]
            for w in range((runs[r, 4] + word - one) // word):
                put_word(cells, body + np.uint64(w) * word, get_word(blobs[i], from_byte + np.uint64(w) * word))
            body += runs[r, 4]
        end = body
        while end < least_end:
            cells[end] = 0
            end += one
    return end, largest
