"""Fuzzing of the codec of VPF: tables of the corpus, changed at random, are tables or are refused, and nothing else.

    python tests/fuzz_vpf.py --seconds 60 --seed 7 --keep FOLDER

What fails is written to FOLDER, from where ``fixtures/make_vpf.py add`` takes it into the corpus.
"""

from __future__ import annotations

import argparse
import random
import sys
import time
import traceback
from collections.abc import Iterator
from pathlib import Path

import vpf_oracle as oracle
from vpf_made import as_rows

from vpfx.errors import InputError, VpfFormatError
from vpfx.vpf.header import Layout, header_size, parse_header
from vpfx.vpf.table import Ragged, Table, decode, encode
from vpfx.vpf.values import is_null, texts

CORPUS = Path(__file__).resolve().parents[1] / "fixtures/vpf/corpus"
BYTES = b"\0\1\2\x40\x54\x7f\x80\xff*,:;=\\-09 LMlmTKXCI"
"""Bytes that mean something somewhere in a table."""

Case = tuple[bytes, bytes | None]
"""A table and its index, if it has one."""


def seeds() -> dict[str, Case]:
    """Return the tables of the corpus, by name."""
    found = {}
    for path in sorted(CORPUS.iterdir()):
        if path.suffix != ".toml" and not path.name.endswith("x"):
            index = path.with_name(path.name[:-1] + "x")
            found[path.name] = path.read_bytes(), index.read_bytes() if index.exists() else None
    return found


def header_of(data: bytes) -> tuple[Layout, int] | None:
    """Return what a header says and where the first row is, or None if it is refused."""
    try:
        order, first = header_size(data[:5], len(data))
        return parse_header(data[4:first], order), first
    except VpfFormatError:
        return None


def rows_by_the_book(data: bytes, layout: Layout, first: int) -> tuple[str, int] | None:
    """Return the rows as the oracle reads them, and stray bytes, or None if it cannot."""
    fields = [oracle.Field(column.name, column.kind, column.count) for column in layout.columns]
    try:
        rows, n_stray = oracle.rows_of(data, fields, layout.order, first)
    except oracle.Broken:
        return None
    return repr(rows), n_stray


def judge(case: Case) -> Table | None:
    """Read a table; return it, or None if it is refused; anything else is an error here."""
    data, index = case
    header = header_of(data)
    book = None if header is None else rows_by_the_book(data, *header)
    table = _read(data, index)
    if book is None or header is None:
        assert table is None or header is not None, "a table without a header"
        assert table is None, "rows that are none"
        return None
    assert table is not None or index is not None, "a table refused that is none the worse"
    if table is not None:
        fields = [oracle.Field(column.name, column.kind, column.count) for column in header[0].columns]
        assert as_rows(table, fields) == book[0], "other rows than by the book"
        _use(table)
    return table


def _read(data: bytes, index: bytes | None) -> Table | None:
    try:
        return decode(data, index, "fuzz")
    except VpfFormatError as error:
        refusal = error
    assert str(refusal).startswith("fuzz: ")
    assert refusal.requirement.startswith("V-")
    return None


def _use(table: Table) -> None:
    """Do with a table what else can be done."""
    for column in table.layout.columns:
        values = table[column.name]
        n_row = values.n_row if isinstance(values, Ragged) else len(values)
        assert n_row == table.n_row
        assert len(is_null(values, column.kind)) == n_row
        if column.kind in "TLNM":
            assert len(texts(values)) == n_row
    try:
        data, index = encode(table.layout, table.columns)
    except InputError:
        return
    again = decode(data, index)
    assert again.n_row == table.n_row
    assert encode(again.layout, again.columns) == (data, index)


def changed(data: bytes, chance: random.Random) -> bytes:
    """Return bytes with one to four changes: bytes set, put in, taken out, repeated, words set, the end cut off."""
    found = bytearray(data)
    for _ in range(chance.randint(1, 4)):
        at = chance.randrange(len(found) + 1)
        n = chance.choice((1, 1, 1, 2, 4, 8))
        some = bytes(chance.choice(BYTES) if chance.random() < 0.7 else chance.randrange(256) for _ in range(n))
        what = chance.randrange(6)
        if what <= 1:
            found[at : at + n] = some
        elif what == 2:
            found[at:at] = some
        elif what == 3:
            del found[at : at + n]
        elif what == 4:
            found[at:at] = found[at : at + chance.randint(1, 40)]
        elif len(found) > 4:
            number = chance.choice((0, 1, 2**31 - 1, -1, -(2**31), len(found), chance.randrange(300)))
            found[at : at + 4] = number.to_bytes(4, chance.choice(("little", "big")), signed=True)
        if chance.random() < 0.1:
            del found[at:]
    return bytes(found)


def with_length(data: bytes) -> bytes:
    """Return a table whose length of the header is right again, if its end is to be seen."""
    end = data.find(b":;", 4)
    order = "big" if data[4:5] in (b"M", b"m") else "little"
    return data if end < 0 else (end - 2).to_bytes(4, order) + data[4:]


def cases(seed: int) -> Iterator[Case]:
    """Yield changed tables without end, the same ones for a seed."""
    chance = random.Random(seed)
    all_seeds = list(seeds().values())
    while True:
        data, index = chance.choice(all_seeds)
        if chance.random() < 0.8:
            data = changed(data, chance)
        if chance.random() < 0.5:
            data = with_length(data)
        if index is not None and chance.random() < 0.5:
            index = changed(index, chance)
        yield data, None if chance.random() < 0.3 else index


def main() -> None:
    """Judge changed tables until the time is over."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60, help="how long (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the changes (default: %(default)s)")
    parser.add_argument("--keep", type=Path, default=Path("."), help="where failures go (default: here)")
    options = parser.parse_args()
    stop, n_case, n_table = time.monotonic() + options.seconds, 0, 0
    for case in cases(options.seed):
        if time.monotonic() > stop:
            break
        n_case += 1
        try:
            n_table += judge(case) is not None
        except Exception:
            traceback.print_exc()
            name = options.keep / f"seed_{options.seed}_{n_case}.aft"
            for path, data in zip((name, name.with_suffix(".afx")), case, strict=True):
                if data is not None:
                    path.write_bytes(data)
            sys.exit(f"failed: {name}")
    print(f"{n_case} cases, {n_table} of them tables")


if __name__ == "__main__":
    main()
