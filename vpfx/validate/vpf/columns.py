"""Which columns the tables of the standard must have, and of which types: what readers look for, not what to write.

Each line is a table, then its columns: names that may stand for each other, the types that do, and from which topology
level on. Source: vpf-facts §3; specs/vpf.md, V-250 to V-256.
"""

from __future__ import annotations

from typing import NamedTuple

from vpfx.vpf.header import Layout

__all__ = ["Wanted", "missing_columns", "wanted_columns", "wrong_types"]

TEXT, NUMBER, LINK, REAL, PLACE = "TLNM", "IS", "IKS", "FR", "CBZY"

_BOX = f"xmin {REAL}; ymin {REAL}; xmax {REAL}; ymax {REAL}"
_TABLES = f"""
    dht  database_name {TEXT}
    lat  library_name {TEXT}; {_BOX}
    lht  library_name {TEXT}; product_type {TEXT}; scale {NUMBER}
    grt  data_type {TEXT}; units {TEXT}; ellipsoid_detail {TEXT}; geo_datum_code {TEXT}
    cat  coverage_name {TEXT}; level {NUMBER}
    fcs  feature_class {TEXT}; table1 {TEXT}; table1_key|foreign_key {TEXT}; table2 {TEXT}; table2_key|primary_key {TEXT}
    fca  fclass {TEXT}; type {TEXT}; descr|description {TEXT}
    vdt  table {TEXT}; attribute {TEXT}; value {TEXT}{NUMBER}; description {TEXT}
    fit  prim_id {NUMBER}; fc_id|fca_id {NUMBER}; feature_id {NUMBER}
    edg  start_node {LINK} 1; end_node {LINK} 1; right_face {LINK} 3; left_face {LINK} 3; right_edge {LINK} 1;
         left_edge {LINK} 1; coordinates {PLACE}
    cnd  first_edge {LINK} 1; coordinate {PLACE}
    end  containing_face {LINK} 3; coordinate {PLACE}
    fac  ring_ptr {LINK}
    rng  face_id {LINK}; start_edge {LINK}
    txt  string {TEXT}; shape_line {PLACE}
    ebr  {_BOX}
    fbr  {_BOX}
"""


class Wanted(NamedTuple):
    """A column that a table must have."""

    names: tuple[str, ...]  # each will do
    kinds: str
    level: int  # least topology level


def _parse(text: str) -> dict[str, tuple[Wanted, ...]]:
    """Tables of the text above."""
    tables: dict[str, tuple[Wanted, ...]] = {}
    lines = text.replace(";\n         ", "; ").strip().splitlines()
    for line in lines:
        table, columns = line.split(None, 1)
        parts = [column.split() for column in columns.split(";")]
        tables[table] = tuple(Wanted(tuple(p[0].split("|")), p[1], int(p[2]) if len(p) > 2 else 0) for p in parts)
    return tables


TABLES = _parse(_TABLES)


def wanted_columns(kind: str, name: str, level: int) -> tuple[Wanted, ...]:
    """Columns that a table must have at a topology level.

    Examples
    --------
    >>> [column.names[0] for column in wanted_columns("edg", "edg", 1)]
    ['start_node', 'end_node', 'right_edge', 'left_edge', 'coordinates']
    """
    if name == "tileref.aft":
        return (Wanted(("tile_name",), TEXT, 0),)
    return tuple(wanted for wanted in TABLES.get(kind, ()) if wanted.level <= level)


def missing_columns(layout: Layout, wanted: tuple[Wanted, ...]) -> list[str]:
    """Names of wanted columns that a table lacks."""
    return [column.names[0] for column in wanted if all(layout.find(name) is None for name in column.names)]


def wrong_types(layout: Layout, wanted: tuple[Wanted, ...]) -> list[tuple[str, str, str]]:
    """Columns of types that nobody reads there: name, type, types expected."""
    found = []
    for column in wanted:
        for name in column.names:
            here = layout.find(name)
            if here is not None and (here.kind not in column.kinds or (here.kind in "IKSFR" and here.count != 1)):
                shown = here.kind if here.count == 1 else f"{here.kind},{'*' if here.count < 0 else here.count}"
                found.append((here.name, shown, " ".join(column.kinds)))
    return found
