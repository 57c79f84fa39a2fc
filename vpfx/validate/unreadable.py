"""Rules V9xx: what the file is at all."""

from __future__ import annotations

from collections.abc import Iterator

from vpfx.store.contents import FORMAT_VERSION
from vpfx.store.geopackage import APPLICATION_ID
from vpfx.validate.report import ERROR, Defects, Rule, one
from vpfx.validate.store_data import StoreData

__all__ = ["RULES"]

MAGIC = b"SQLite format 3\0"
KNOWN = (
    (b"II*\0", "a TIFF"), (b"MM\0*", "a TIFF"), (b"PK\3\4", "a ZIP archive"), (b"\x1f\x8b", "a file packed by gzip"),
    (b"UHL1", "a DTED cell"), (b"glTF", "a glTF mesh"), (b"%PDF", "a PDF"), (b"\x89PNG", "a PNG picture"),
)  # fmt: skip
"""What files of other kinds begin with."""
OWN_TABLES = {"metadata", "level", "tile", "tile_level", "node", "edge", "face"}


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
    if not data.head.startswith(MAGIC) or len(data.head) < 100:
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


RULES = (
    Rule("V901", "no_database", ERROR, "R-100", "the file is no database of SQLite", check_database),
    Rule("V902", "unreadable", ERROR, "R-100", "SQLite cannot read the file", check_readable,
         needs=("no_database", "file_size")),
    Rule("V903", "no_store", ERROR, "R-101", "the database is no store", check_store, needs=("unreadable",)),
    Rule("V904", "unknown_version", ERROR, "R-110", "the store is of a version that is not known", check_version,
         needs=("schema",)),
)  # fmt: skip
