"""Defective VPF directories for the tests of rules: a valid base, and what a fixture of `fixtures/invalid` changes in it.

A fixture ``V722_edge_links.toml`` names its base and has `edits`, one after the other; paths are below the database:

| keys | what is done |
|---|---|
| table, row, column, value | a value is replaced; rows count from 1, a triplet is three numbers, a place two or three |
| table, add | a row is put behind the last: the values of all columns |
| table, drop | a row is taken out; those behind it count on |
| table, swap | two rows change places, their ids stay |
| table, header, by | a text in the header is replaced by another; its length and the index file follow |
| file, offset, bytes | bytes, hexadecimal, are put over those at an offset, counted from the end if it is negative |
| file, append; file, cut | bytes are put behind the last; so many are taken off the end |
| delete; rename, to; copy, to | a file or folder is taken away, gets another name, or is there twice |

Index files of tables that are written anew are written too, of those that have one. Nothing here is shared with vpfx.
"""

from __future__ import annotations

import json
import shutil
import sqlite3
import struct
import tomllib
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from rule_fixtures import build_base
from vpf_oracle import TEXTS, Field, fields_of, put_field, rows_of, split
from vpf_town import write_town

from vpfx.cli import main

__all__ = ["VPF_BASES", "build_vpf_base", "damage_vpf", "edit", "read_rows", "write_rows"]

VPF_BASES = ("town", "plane", "hills", "voids", "pyramid", "junction", "soils")
"""The town is made up by `vpf_town`, the others are exported stores of `rule_fixtures`; soils are the hills with attributes."""
COVER = (
    "SELECT face_id, 'wood' AS kind FROM face WHERE level = 0 AND face_id % 2 = 0",
    "SELECT face_id, 'rock' AS kind FROM face WHERE level = 2 AND face_id % 5 = 0",
)


def build_vpf_base(name: str, folder: Path) -> Path:
    """Make a base; return its path."""
    target = folder / name
    if name == "town":
        return write_town(target)
    store = build_base({"junction": "junctions", "soils": "hills"}.get(name, name), folder)
    if name == "soils":
        _attach(store)
    run("export", str(store), "--to", "vpf", "-o", str(target), "--quiet")
    return target


def run(*arguments: str) -> None:
    """Run a command of vpfx that must succeed."""
    with pytest.raises(SystemExit) as ended:
        main(list(arguments))
    assert not ended.value.code, arguments


def _attach(store: Path) -> None:
    """Give faces two classes, the values of one described."""
    with closing(sqlite3.connect(store)) as connection:
        x0, y0, x1, y1 = connection.execute("SELECT min(xmin), min(ymin), max(xmax), max(ymax) FROM tile").fetchone()
    features = []
    for kind, depth, (a, b, c, d) in (
        ("sand", 1.5, (0, 0, 0.4, 0.6)),
        ("clay", 2.0, (0.4, 0, 1, 0.5)),
        ("Löß", 3.0, (0.3, 0.6, 0.9, 1)),
    ):
        ring = [[x0 + u * (x1 - x0), y0 + v * (y1 - y0)] for u, v in ((a, b), (c, b), (c, d), (a, d), (a, b))]
        geometry = {"type": "Polygon", "coordinates": [ring]}
        features.append({"type": "Feature", "properties": {"kind": kind, "depth": depth}, "geometry": geometry})
    crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::32611"}}
    path = store.with_suffix(".geojson")
    path.write_text(json.dumps({"type": "FeatureCollection", "crs": crs, "features": features}), encoding="utf-8")
    run("attach", str(store), "--class", "soil", "--from", str(path), "--by", "share")
    for question, further in zip(COVER, ([], ["--append"]), strict=True):
        run("attach", str(store), "--class", "cover", "--sql", question, *further)
    with closing(sqlite3.connect(store)) as connection:
        (own,) = connection.execute("SELECT class_id FROM feature_class WHERE class_name = 'cover'").fetchone()
        rows = [(own, "kind", "wood", "Trees"), (own, "kind", "rock", "Rock"), (own, "kind", "land", "Anything")]
        connection.executemany(
            "INSERT INTO value_description (class_id, column_name, value, description) VALUES (?, ?, ?, ?)", rows
        )
        connection.commit()


def damage_vpf(base: Path, fixture: Path, target: Path) -> Path:
    """Write a base with what a fixture changes; return its path."""
    shutil.copytree(base, target)
    for change in tomllib.loads(fixture.read_text(encoding="utf-8"))["edits"]:
        edit(target, change)
    return target


def edit(root: Path, change: dict[str, Any]) -> None:
    """Make one change."""
    if "delete" in change:
        path = root / change["delete"]
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    elif "rename" in change:
        (root / change["rename"]).rename(root / change["to"])
    elif "copy" in change:
        path = root / change["copy"]
        (shutil.copytree if path.is_dir() else shutil.copyfile)(path, root / change["to"])
    elif "file" in change:
        _change_bytes(root / change["file"], change)
    else:
        _change_table(root / change["table"], change)


def _change_bytes(path: Path, change: dict[str, Any]) -> None:
    data = bytearray(path.read_bytes())
    if "append" in change:
        data += bytes.fromhex(change["append"])
    elif "cut" in change:
        del data[len(data) - change["cut"] :]
    else:
        new = bytes.fromhex(change["bytes"])
        offset = change["offset"] % len(data) if change["offset"] < 0 else change["offset"]
        data[offset : offset + len(new)] = new
    path.write_bytes(data)


def _change_table(path: Path, change: dict[str, Any]) -> None:
    header, fields, rows = read_rows(path)
    names = [field.name.lower() for field in fields]
    if "header" in change:
        assert header.count(change["header"]) >= 1, header
        header = header.replace(change["header"], change["by"], 1)
        plain = [
            i for i, (old, new) in enumerate(zip(fields, fields_of(header), strict=True)) if old.kind == "K" != new.kind
        ]
        for row in rows:
            for i in plain:
                row[i] = [row[i][:1]]
    elif "add" in change:
        rows.append([_value(field, value) for field, value in zip(fields, change["add"], strict=True)])
    elif "drop" in change:
        del rows[change["drop"] - 1]
        for i, row in enumerate(rows, 1):
            row[0] = [(i,)]
    elif "swap" in change:
        i, j = (number - 1 for number in change["swap"])
        rows[i][1:], rows[j][1:] = rows[j][1:], rows[i][1:]
    else:
        at = names.index(change["column"])
        rows[change["row"] - 1][at] = _value(fields[at], change["value"])
    write_rows(path, header, rows)


def _value(field: Field, value: Any) -> Any:
    """A value of a fixture as `put_field` wants it."""
    if field.kind in TEXTS + "D":
        raw = value.encode("latin-1")
        return raw.ljust(field.count * (20 if field.kind == "D" else 1)) if field.count >= 0 else raw
    if field.kind == "K":
        return tuple(value)
    if field.kind == "X":
        return []
    if field.kind in "CBZY":
        return [tuple(place) for place in (value if isinstance(value[0], list) else [value])]
    return [(value,)]


def read_rows(path: Path) -> tuple[str, list[Field], list[list[Any]]]:
    """Header, columns and rows of a table."""
    data = path.read_bytes()
    order, header, first = split(data)
    fields = fields_of(header)
    return header, fields, rows_of(data, fields, order, first)[0]


def write_rows(path: Path, header: str, rows: list[list[Any]]) -> None:
    """Write a table, and its index file if there is one, with the columns of a header."""
    order, fields = (">" if header[:1] == "M" else "<"), fields_of(header)
    text = header.encode("latin-1")
    data = struct.pack(f"{order}i", len(text)) + text
    index = struct.pack(f"{order}ii", len(rows), len(data))
    for row in rows:
        body = b"".join(put_field(order, field, value) for field, value in zip(fields, row, strict=True))
        index += struct.pack(f"{order}II", len(data), len(body))
        data += body
    path.write_bytes(data)
    beside = path.with_name("fcz" if path.name == "fcs" else f"{path.name[:-1]}x")
    if beside.is_file() and beside != path and (path.name != "fca" or not path.with_name("fcz").is_file()):
        beside.write_bytes(index)
