"""Rules V10x: the file as a database of SQLite (R-100, R-101)."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator

from vpfx.store.contents import error_kind
from vpfx.validate.report import ERROR, MOST_SHOWN, WARNING, Defects, Rule, one
from vpfx.validate.store_data import StoreData

__all__ = ["RULES"]

PAGE_SIZE = 4096
FIELDS = (
    (16, 2, "page size", PAGE_SIZE), (18, 1, "write version", 1), (19, 1, "read version", 1),
    (20, 1, "reserved bytes of a page", 0), (52, 4, "largest root page (auto-vacuum)", 0), (56, 4, "encoding", 1),
)  # fmt: skip
"""Offset, bytes, name and value of what the header of the file must hold."""
SIDE_FILES = ("-journal", "-wal")


def _field(head: bytes, offset: int, n_byte: int) -> int:
    return int.from_bytes(head[offset : offset + n_byte], "big")


def check_header(data: StoreData) -> Iterator[Defects]:
    """Every field of the header that the format fixes has its value."""
    for offset, n_byte, name, expected in FIELDS:
        found = _field(data.head, offset, n_byte)
        if found != expected:
            yield one(f"byte={offset}", f"{name}: found {found}, expected {expected}")


def check_file_size(data: StoreData) -> Iterator[Defects]:
    """The file has as many bytes as its header says."""
    page_size, n_page = _field(data.head, 16, 2), _field(data.head, 28, 4)
    page_size = 65536 if page_size == 1 else page_size  # as SQLite has it
    if data.size != page_size * n_page:
        yield one("byte=28", f"found {data.size:,} bytes, expected {n_page:,} pages of {page_size:,}")


def check_side_files(data: StoreData) -> Iterator[Defects]:
    """Nothing that belongs into the file waits beside it."""
    for suffix in SIDE_FILES:
        beside = data.path.with_name(data.path.name + suffix)
        if beside.is_file() and beside.stat().st_size > 0:
            yield one("", f"found {beside.name}, of a change that goes on or was interrupted, expected none")


def check_integrity(data: StoreData) -> Iterator[Defects]:
    """SQLite finds its own structures whole: of the tables of the format, and of the file where it has no others.

    Expressions in indexes and constraints of a stranger's tables are never run.
    """
    tables = [f"({name})" for name in data.known_tables] if data.has_strange_tables else [""]
    for table in tables:
        try:
            lines = data.first(f"PRAGMA integrity_check{table}", MOST_SHOWN)
        except sqlite3.DatabaseError as error:
            if error_kind(error) != sqlite3.SQLITE_CORRUPT:
                raise
            lines = [(str(error),)]
        for (line,) in lines:
            if line != "ok":
                yield one("", f"found: {line}")


def check_schema(data: StoreData) -> Iterator[Defects]:
    """Tables, indexes and views are those of the schema, letter by letter."""
    for name, expected in data.expected_objects.items():
        found = data.objects.get(name)
        if found is None:
            yield one(f"{expected.kind}={name}", "found none, expected that of schema/")
        elif found != expected:
            yield one(f"{expected.kind}={name}", f"found another {found.kind}, expected that of schema/")


def check_triggers(data: StoreData) -> Iterator[Defects]:
    """Nothing changes when something else is changed."""
    for name, found in data.objects.items():
        if found.kind == "trigger":
            yield one(f"trigger={name[:60]}", f"found a trigger of table {str(found.table)[:60]}, expected none")


RULES = (
    Rule("V101", "header", ERROR, "R-100", "a field of the header has another value", check_header,
         needs=("no_database",)),
    Rule("V102", "file_size", ERROR, "R-100", "the file has more or fewer bytes than its header says", check_file_size,
         needs=("no_database",)),
    Rule("V103", "side_file", WARNING, "R-100", "a part of the file may lie in another one", check_side_files,
         needs=("no_database",)),
    Rule("V104", "integrity", ERROR, "R-100", "SQLite finds the file damaged", check_integrity, needs=("schema",)),
    Rule("V105", "schema", ERROR, "R-101", "a table, index or view is not that of the schema", check_schema,
         needs=("no_store",)),
    Rule("V106", "trigger", WARNING, "R-101", "the file has a trigger", check_triggers, needs=("no_store",)),
)  # fmt: skip
