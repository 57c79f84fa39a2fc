"""Rules V10x and V9xx: what the file is at all, and whether it is sound as a database of SQLite (R-100, R-101, R-110)."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from itertools import chain

from vpfx.store.connection import error_kind
from vpfx.store.contents import FORMAT_VERSION
from vpfx.store.geopackage import APPLICATION_ID
from vpfx.validate.report import ERROR, WARNING, Defects, Rule, one
from vpfx.validate.store_data import HEADER, StoreData

__all__ = ["RULES"]

MAGIC = b"SQLite format 3\0"
KNOWN = (
    (b"II*\0", "a TIFF"), (b"MM\0*", "a TIFF"), (b"PK\3\4", "a ZIP archive"), (b"\x1f\x8b", "a file packed by gzip"),
    (b"UHL1", "a DTED cell"), (b"glTF", "a glTF mesh"), (b"%PDF", "a PDF"), (b"\x89PNG", "a PNG picture"),
)  # fmt: skip
"""What files of other kinds begin with."""
OWN_TABLES = {"metadata", "level", "tile", "tile_level", "node", "edge", "face"}
PAGE_SIZE = 4096
FIELDS = (
    (16, 2, "page size", PAGE_SIZE), (18, 1, "write version", 1), (19, 1, "read version", 1),
    (20, 1, "reserved bytes of a page", 0), (52, 4, "largest root page (auto-vacuum)", 0), (56, 4, "encoding", 1),
)  # fmt: skip
"""Offset, bytes, name and value of what the header of the file must hold."""
SIDE_FILES = ("-journal", "-wal")
COMPUTING = """
SELECT name FROM pragma_index_list(?) AS of_table
WHERE partial OR EXISTS (SELECT 1 FROM pragma_index_xinfo(of_table.name) WHERE cid = -2)
"""  # -2: an expression


def _kind_of(head: bytes) -> str:
    """Say what a file looks like by its first bytes."""
    if not head:
        return "an empty file"
    for magic, name in KNOWN:
        if head.startswith(magic):
            return name
    if len(head) < len(MAGIC) and MAGIC.startswith(head):
        return f"{len(head)} bytes"
    is_text = all(byte in b"\t\n\r" or byte >= 32 for byte in head)
    return "a text" if is_text else f"bytes {head[:8].hex(' ')} …"


def check_database(data: StoreData) -> Iterator[Defects]:
    """The file begins as a database of SQLite does."""
    if not data.head.startswith(MAGIC) or len(data.head) < HEADER:
        yield one("byte=0", f"found {_kind_of(data.head)}, expected a store: a database of SQLite")


def check_readable(data: StoreData) -> Iterator[Defects]:
    """SQLite opens the file and reads its table of contents; what it refuses further on is told by the same code."""
    if data.interrupted:
        yield one("", data.interrupted)
        return
    for name in data.objects:
        if not isinstance(name, str):
            yield one("table=sqlite_schema", f"found the name {str(name)[:40]!r}, expected a text")


def check_store(data: StoreData) -> Iterator[Defects]:
    """The database is a store, not some other one."""
    if OWN_TABLES - set(data.objects):
        is_package = int.from_bytes(data.head[68:72], "big") == APPLICATION_ID
        what = "a GeoPackage" if is_package else "a database of SQLite"
        missing = ", ".join(sorted(OWN_TABLES - set(data.objects)))
        yield one("", f"found {what} without tables {missing}, expected a store made by vpfx build")


def check_version(data: StoreData) -> Iterator[Defects]:
    """The version of the format is the one these rules are about."""
    rows = data.select("SELECT value FROM metadata WHERE name = 'format_version'")
    found = rows[0][0] if rows else None
    if found != FORMAT_VERSION:
        yield one("table=metadata name=format_version", f"found {str(found)[:40]!r}, expected {FORMAT_VERSION!r}")


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


def _tables(data: StoreData) -> list[str]:
    return [name for name, found in data.expected_objects.items() if found.kind == "table"]


def _computing(data: StoreData, table: str) -> list[str]:
    """Indexes of a table for which SQLite computes something whenever it checks or writes the table."""
    return [str(name) for (name,) in data.select(COMPUTING, (table,))]


def _class_tables(data: StoreData) -> list[str]:
    """Tables of classes in which nothing of a stranger is; none if classes cannot be read."""
    try:
        tables = [found.name for found in data.classes if not found.table_problem]
    except (sqlite3.DatabaseError, UnicodeDecodeError):
        return []
    return [table for table in tables if not _computing(data, table)]


def check_schema(data: StoreData) -> Iterator[Defects]:
    """Tables, indexes and views are those of the schema, letter by letter, and no index of them computes anything."""
    wrong = [name for name, expected in data.expected_objects.items() if data.objects.get(name) != expected]
    for name in wrong:
        found = data.objects.get(name)
        told = "none" if found is None else f"another {found.kind}"
        yield one(f"{data.expected_objects[name].kind}={name}", f"found {told}, expected that of schema/")
    if wrong:
        return
    for table in _tables(data):
        for name in _computing(data, table):
            message = f"found an index of table {table} with an expression or a condition, expected one of columns"
            yield one(f"index={name[:60]}", message)


def check_integrity(data: StoreData) -> Iterator[Defects]:
    """SQLite finds its own structures whole: of the tables of the format, and of the file where it has no others.

    Expressions in indexes and constraints of a stranger's tables are never run.
    """
    known = [*_tables(data), *_class_tables(data)]
    is_all_known = all(
        found.kind not in ("table", "index") or name in known or found == data.expected_objects.get(name)
        for name, found in data.objects.items()
    )
    for table in [""] if is_all_known else [f"({name})" for name in known]:
        texts: list[str] = []
        try:
            texts.extend(row[0] for row in data.each(f"PRAGMA integrity_check{table}"))
        except sqlite3.DatabaseError as error:  # what it has told before stays
            if error_kind(error) != sqlite3.SQLITE_CORRUPT:
                raise
            texts.append(str(error))
        for line in chain(*(text.splitlines() for text in texts)):
            if line != "ok" and not line.startswith("***"):  # the name of the database
                yield one("", f"found: {line}")


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
    Rule("V901", "no_database", ERROR, "R-100", "the file is no database of SQLite", check_database),
    Rule("V902", "unreadable", ERROR, "R-100", "SQLite cannot read the file", check_readable,
         needs=("no_database", "file_size")),
    Rule("V903", "no_store", ERROR, "R-101", "the database is no store", check_store, needs=("unreadable",)),
    Rule("V904", "unknown_version", ERROR, "R-110", "the store is of a version that is not known", check_version,
         needs=("schema",)),
)  # fmt: skip
