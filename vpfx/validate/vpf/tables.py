"""Rules V70x: single tables, whatever they are about."""

from __future__ import annotations

from collections.abc import Iterator

from vpfx.validate.report import ERROR, WARNING, Defects, Rule, one
from vpfx.validate.vpf.columns import missing_columns, wanted_columns, wrong_types
from vpfx.validate.vpf.scan import ScannedTable

__all__ = ["RULES"]

NOT_REFERRED_TO = {"dht", "lat", "lht", "grt", "cat", "dqt", "fcs", "fit", "vdt", "doc"}
"""Tables whose rows no other table names by number."""


def _is_list(data: ScannedTable) -> bool:
    return data.table.kind in NOT_REFERRED_TO or data.table.kind[1:] == "jt"


def check_readable(data: ScannedTable) -> Iterator[Defects]:
    """The header says what the rows are."""
    if data.head is None:
        yield one(f"table={data.where}", data.table.problem)


def check_rows(data: ScannedTable) -> Iterator[Defects]:
    """All rows follow the header."""
    if data.scan.problem:
        yield one(f"table={data.where}", data.scan.problem)


def check_stray(data: ScannedTable) -> Iterator[Defects]:
    """No byte follows the last row."""
    if data.head is not None and data.head.stray:
        yield one(
            f"table={data.where}",
            f"found {data.head.stray} bytes behind the last of {data.head.n_row} rows, expected none",
        )


def check_index(data: ScannedTable) -> Iterator[Defects]:
    """The index file says where the rows are."""
    head = data.head
    if head is not None and head.has_index and head.index_problem and not _is_harmless(head.index_problem):
        yield one(f"table={data.where}", f"index file: {head.index_problem}")


def check_index_header(data: ScannedTable) -> Iterator[Defects]:
    """The index file is in the byte order of its table, and names its first row."""
    head = data.head
    if head is not None and head.has_index and head.index_problem and _is_harmless(head.index_problem):
        yield one(f"table={data.where}", f"index file: {head.index_problem}")


def _is_harmless(problem: str) -> bool:
    """Whether the places of rows are right all the same."""
    return problem.startswith("word 2") or "byte order" in problem


def check_ids(data: ScannedTable) -> Iterator[Defects]:
    """Rows that others name by number have that number as id."""
    if not _is_list(data):
        yield from data.scan.ids.defects()


def check_list_ids(data: ScannedTable) -> Iterator[Defects]:
    """The same of tables whose rows nobody names."""
    for ids in data.scan.ids.defects() if _is_list(data) else ():
        where, message = ids.describe(0)
        yield one(where, message if ids.n_defect == 1 else f"{message}; {ids.n_defect} rows are so")


def check_columns(data: ScannedTable) -> Iterator[Defects]:
    """A table of the standard has the columns that readers look for, in types that they read."""
    head = data.head
    if head is None:
        return
    where = f"table={data.where}"
    first = head.layout.columns[0].name
    if first.lower() != "id":
        yield one(f"{where} column={first}", f"found column {first!r} first, expected 'id'")
    wanted = wanted_columns(data.table.kind, data.table.name, 0 if data.table.level is None else data.table.level)
    for name in missing_columns(head.layout, wanted):
        yield one(where, f"found no column {name!r}, expected one")
    for name, kind, expected in wrong_types(head.layout, wanted):
        yield one(f"{where} column={name}", f"found type {kind}, expected one of {expected}")


def check_keys(data: ScannedTable) -> Iterator[Defects]:
    """Columns marked as primary or unique have a value in each row, another in each."""
    yield from data.scan.keys.defects()


def check_texts(data: ScannedTable) -> Iterator[Defects]:
    """Texts have printable characters of their type, and dates are dates."""
    yield from data.scan.texts.defects()


RULES = (
    Rule("V700", "table_header", ERROR, "V-102", "the header of a table cannot be read", check_readable, "table"),
    Rule("V701", "table_rows", ERROR, "V-121", "the rows of a table do not follow its header", check_rows, "table",
         needs=("table_header",)),
    Rule("V702", "stray_bytes", ERROR, "V-122", "bytes follow the last row of a table", check_stray, "table",
         needs=("table_header", "table_rows")),
    Rule("V703", "table_index", ERROR, "V-130", "an index file does not fit its table", check_index, "table",
         needs=("table_header", "table_rows")),
    Rule("V704", "table_index_header", WARNING, "V-130", "an index file says another place or byte order than its table",
         check_index_header, "table", needs=("table_header", "table_index")),
    Rule("V705", "row_ids", ERROR, "V-105", "the ids of a table are not its row numbers", check_ids, "table",
         needs=("table_rows",)),
    Rule("V706", "list_ids", WARNING, "V-105", "the ids of a list are not its row numbers", check_list_ids, "table",
         needs=("table_rows",)),
    Rule("V707", "table_columns", ERROR, "V-250", "a table of the standard lacks a column, or has it in another type",
         check_columns, "table", needs=("table_header",)),
    Rule("V708", "key_values", ERROR, "V-250", "a key has no value, or one that is not unique", check_keys, "table",
         needs=("table_rows",)),
    Rule("V709", "text_values", WARNING, "V-113", "a text has other characters than its type, or a date is none", check_texts,
         "table", needs=("table_rows",)),
)  # fmt: skip
