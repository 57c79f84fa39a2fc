"""Defective stores for the tests of rules: a valid base, and a fixture of `fixtures/invalid` that breaks one thing in it.

A fixture ``V105_schema.sql`` is SQL, ``V101_header.bytes`` changes bytes: a line ``18 02`` puts the byte 02 at offset 18,
``append 00`` adds bytes, ``cut 4096`` takes some off the end, ``beside -journal 00`` writes a file of that suffix. The first
line of either names the base: ``-- plane``. After SQL of the hundreds 2 to 8 the blobs of places and the digests are made right
again, by the words of R-140 and no code of vpfx: else every change would be found by them.
"""

from __future__ import annotations

import hashlib
import shutil
import sqlite3
import struct
import tomllib
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from surfaces import SOLID, VOIDS, hills, write_dem

import vpfx
from vpfx.store.edit import edit_store

__all__ = ["BASES", "FIXTURES", "INDEX", "base_of", "build_base", "damage", "refresh_blobs", "refresh_digests"]

FOLDER = Path(__file__).resolve().parents[1] / "fixtures" / "invalid"
FIXTURES = {path.stem.split("_")[0]: path for path in sorted(FOLDER.glob("V*.*"))}
"""Fixtures by the code of the rule that they break."""
INDEX = tomllib.loads((FOLDER / "INDEX.toml").read_text(encoding="utf-8"))

BASES: dict[str, tuple[Any, dict[str, Any]]] = {
    "plane": (np.tile(np.arange(100.0, 121.0), (17, 1)), {"max_error": (2, 1), "tile_size": 10}),
    "hills": (hills(30, 26), {"max_error": (20, 8, 4)}),
    "voids": (VOIDS["ring with island"].heights, {"passes": 2, "tile_size": 8}),
    "pyramid": (hills(20, 20, 3), {"method": "delaunay_pyramid", "max_error": (20, 8, 4)}),
    "junctions": (SOLID["cliff"].heights, {"method": "scarlatos", "passes": 3}),
    "flat": (np.full((10, 10), 7.0), {"passes": 0, "grid": (3, 3)}),
    "filled": (np.where(np.hypot(*np.mgrid[-8:9, -8:9]) > 5, 7.0, np.nan), {"max_error": (2, 1), "fill": True}),
    "soil": (np.tile(np.arange(100.0, 121.0), (17, 1)), {"max_error": (2, 1), "tile_size": 10}),
}
"""Heights and options of `vpfx.build`. The plane is the worked store of specs/format.md, whose ids stand there."""

ORDERED = (
    ("node", "node_id, tile_id, level, x, y, z, z_parent, xyz", "node_id", "first_node", "last_node"),
    ("edge", "edge_id, tile_id, level, start_node, end_node, right_face, left_face, right_edge, left_edge", "edge_id",
     "first_edge", "last_edge"),
    ("face", "face_id, tile_id, level, node_1, node_2, node_3, edge_1, edge_2, edge_3, is_filled, slope_centidegrees, "
     "aspect_centidegrees", "face_id", "first_face", "last_face"),
    ("parent_child", "child_face, parent_face", "child_face", "first_face", "last_face"),
    ("t_junction", "edge_id, node_id, tile_id, level, gap", "edge_id", "first_edge", "last_edge"),
    ("shared_area", "child_face, parent_face, area", "child_face", "first_face", "last_face"),
)  # fmt: skip
"""What R-140 digests of a tile and level."""
REALS = {"x", "y", "z", "z_parent", "gap", "area"}


def build_base(name: str, folder: Path) -> Path:
    """Build a base, and the DEM beside it; return its path."""
    heights, options = BASES[name]
    dem = write_dem(folder / f"{name}.tif", heights, step=10.0, crs="EPSG:32611")
    path = vpfx.build(dem, folder / f"{name}.gpkg", **options).path
    if name == "soil":
        _attach_soil(path)
    return path


def _attach_soil(path: Path) -> None:
    """Attach two features of a class to some faces."""
    with edit_store(path) as editor:
        editor.create_class("soil", {"name": "text", "depth": "real"})
        clay, sand = editor.add_features("soil", {"name": ["clay", "sand"], "depth": [0.5, None]})
        editor.set_faces("soil", [3, 4, 4], [clay, clay, sand], [1.0, 0.5, 0.5])


def base_of(fixture: Path) -> str:
    """Return the name of the base of a fixture."""
    return fixture.read_text(encoding="utf-8").splitlines()[0].removeprefix("-- ").strip()


def damage(base: Path, fixture: Path, target: Path) -> Path:
    """Write the base with what a fixture breaks; return its path."""
    shutil.copyfile(base, target)
    text = fixture.read_text(encoding="utf-8").split("\n", 1)[1]
    if fixture.suffix == ".bytes":
        _change_bytes(target, text)
        return target
    with closing(sqlite3.connect(target)) as connection:
        connection.executescript(text)
        if fixture.stem[1] not in "19" and fixture.stem[:4] not in ("V210", "V216"):
            refresh_blobs(connection)
        if fixture.stem[1] not in "19":
            refresh_digests(connection)
        connection.commit()
    return target


def _change_bytes(path: Path, text: str) -> None:
    data = bytearray(path.read_bytes())
    for line in filter(None, text.splitlines()):
        verb, *rest = line.split()
        if verb == "append":
            data += bytes.fromhex("".join(rest))
        elif verb == "cut":
            del data[len(data) - int(rest[0]) :]
        elif verb == "beside":
            path.with_name(path.name + rest[0]).write_bytes(bytes.fromhex("".join(rest[1:])))
        else:
            new = bytes.fromhex("".join(rest))
            data[int(verb) : int(verb) + len(new)] = new
    path.write_bytes(data)


def refresh_blobs(connection: sqlite3.Connection) -> None:
    """Put the places of nodes into their blobs again (R-150)."""
    rows = connection.execute("SELECT x, y, z, node_id, xyz FROM node").fetchall()
    changed = [(struct.pack("<3d", *row[:3]), row[3]) for row in rows if struct.pack("<3d", *row[:3]) != row[4]]
    connection.executemany("UPDATE node SET xyz = ? WHERE node_id = ?", changed)


def refresh_digests(connection: sqlite3.Connection) -> None:
    """Compute all digests again (R-140, R-141)."""
    names = [name for table in ORDERED[:3] for name in table[3:]]
    for row in connection.execute(f"SELECT tile_level_id, {', '.join(names)} FROM tile_level").fetchall():
        limits = dict(zip(names, row[1:], strict=True))
        digest = hashlib.blake2b(digest_size=16)
        for table, columns, key, first, last in ORDERED:
            order = columns if table in ("parent_child", "shared_area", "t_junction") else key
            query = f"SELECT {columns} FROM {table} WHERE {key} BETWEEN ? AND ? ORDER BY {order}"
            _digest(digest, columns, connection.execute(query, (limits[first], limits[last])))
        connection.execute("UPDATE tile_level SET digest = ? WHERE tile_level_id = ?", (digest.digest(), row[0]))
    levels = connection.execute("SELECT level, first_border_edge, last_border_edge FROM level").fetchall()
    running = "SELECT 1 FROM tile_level WHERE node_id BETWEEN first_node AND last_node"
    for level, first, last in levels:
        digest = hashlib.blake2b(digest_size=16)
        if first is not None:
            query = f"SELECT {ORDERED[0][1]} FROM node WHERE level = ? AND NOT EXISTS ({running}) ORDER BY node_id"
            _digest(digest, ORDERED[0][1], connection.execute(query, (level,)))
            query = f"SELECT {ORDERED[1][1]} FROM edge WHERE edge_id BETWEEN ? AND ? ORDER BY edge_id"
            _digest(digest, ORDERED[1][1], connection.execute(query, (first, last)))
        connection.execute("UPDATE level SET border_digest = ? WHERE level = ?", (digest.digest(), level))


def _digest(digest: Any, columns: str, rows: Any) -> None:
    """Take rows column by column."""
    for name, values in zip(columns.split(", "), zip(*rows.fetchall(), strict=True), strict=False):
        if name == "xyz":
            digest.update(b"".join(values))
        elif name in REALS:
            digest.update(struct.pack(f"<{len(values)}d", *(float("nan") if v is None else v for v in values)))
        else:
            is_short = all(v is None or abs(v) < 2**31 for v in values)
            null, form = (-(2**31), "i") if is_short else (-(2**63), "q")
            digest.update(struct.pack(f"<{len(values)}{form}", *(null if v is None else v for v in values)))
