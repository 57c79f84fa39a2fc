"""Rules V20x: the small tables: what was built, levels, tiles, where their rows lie (R-110 to R-132)."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from vpfx.model import CUTS
from vpfx.store.contents import METADATA, is_horizontal
from vpfx.store.tiles import LEAST_TILE_SIZE
from vpfx.validate.report import ERROR, Defects, Rule, one
from vpfx.validate.store_data import RANGED, StoreData
from vpfx.validate.values import LevelRow, is_number, is_whole

__all__ = ["RULES"]

DIGEST_SIZE = 16  # bytes
SHA256 = re.compile(r"[0-9a-f]{64}")
SOUND = ("integrity", "unknown_version")
"""Of other rules: what must hold before anything is read."""


def _short(value: Any) -> str:
    """A value as a text that is not too long."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:59]}…"


def check_metadata(data: StoreData) -> Iterator[Defects]:
    """All names are there, and their values of their kind."""
    for name, kind in METADATA.items():
        where = f"table=metadata name={name}"
        value = data.metadata.get(name)
        if name not in data.metadata:
            yield one(where, "found none, expected a value")
        elif not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            yield one(where, "found a value of another kind")
        elif kind is not bool and isinstance(value, int | float) and not is_number(value):
            yield one(where, "found no finite number")
    yield from _check_parts(data.metadata)


def _check_parts(metadata: dict[str, Any]) -> Iterator[Defects]:
    """What values are made of."""
    if isinstance(lattice := metadata.get("lattice"), dict):
        is_sound = all(is_whole(lattice.get(name), 2) and lattice[name] < 2**31 for name in ("n_row", "n_col"))
        is_sound &= all(is_number(lattice.get(name)) for name in ("x0", "y0", "dx", "dy"))
        if not is_sound or min(lattice["dx"], lattice["dy"]) <= 0:
            yield one("table=metadata name=lattice", f"found {_short(lattice)}, expected posts, a place and spacings")
    if isinstance(options := metadata.get("options"), dict) and not is_whole(options.get("tile_size"), LEAST_TILE_SIZE):
        found = _short(options.get("tile_size"))
        yield one("table=metadata name=options", f"tile_size: found {found}, expected at least {LEAST_TILE_SIZE}")
    if (precision := metadata.get("coordinate_precision", "single")) != "single":
        yield one(
            "table=metadata name=coordinate_precision", f"found {_short(precision)}, expected 'single', or no row"
        )
    if isinstance(unit := metadata.get("vertical_unit"), str) and unit != "metre":
        yield one("table=metadata name=vertical_unit", f"found {_short(unit)}, expected 'metre'")
    if isinstance(wkt := metadata.get("crs_wkt2"), str) and wkt and not is_horizontal(wkt):
        yield one("table=metadata name=crs_wkt2", "found no horizontal CRS as WKT, expected one, or nothing")


def check_posts(data: StoreData) -> Iterator[Defects]:
    """Posts are those of the lattice, and those measured are the valid ones that faces touch."""
    metadata, where = data.metadata, "table=metadata name="
    posts, void, isolated = (metadata[name] for name in ("posts", "void_posts", "isolated_posts"))
    in_lattice = metadata["lattice"]["n_row"] * metadata["lattice"]["n_col"]
    if posts != in_lattice:
        yield one(f"{where}posts", f"found {posts}, expected {in_lattice}, those of the lattice")
    if min(void, isolated) < 0 or void + isolated > posts:
        yield one(f"{where}void_posts", f"found {void} void and {isolated} isolated posts of {posts}")
    if not 0 <= metadata["void_area_m2"] <= metadata["area_m2"]:
        yield one(f"{where}void_area_m2", f"found {metadata['void_area_m2']} of {metadata['area_m2']}")
    for row in data.level_rows:
        if row.post_count != posts - void - isolated:
            expected = f"expected {posts - void - isolated}, those that are neither void nor isolated"
            yield one(f"level={row.level}", f"post_count: found {row.post_count}, {expected}")


def check_sources(data: StoreData) -> Iterator[Defects]:
    """Files are numbered in the order of names, and described by what can be compared."""
    before = ""
    query = "SELECT source_id, name, sha256, byte_count, driver FROM source ORDER BY source_id"
    rows = data.select(query)
    if not rows:
        yield one("table=source", "found no row, expected one a file")
    for number, (source_id, name, sha256, byte_count, driver) in enumerate(rows, 1):
        where = f"table=source source={source_id}"
        if source_id != number:
            yield one(where, f"found {source_id}, expected {number}")
        if not (isinstance(name, str) and name and not set(name) & set("/\\\0")):
            yield one(where, f"name: found {_short(name)}, expected a name without folder")
        elif name < before:
            yield one(where, f"found {_short(name)} behind {_short(before)}, expected the order of names")
        before = name if isinstance(name, str) else before
        if not (isinstance(sha256, str) and SHA256.fullmatch(sha256)):
            yield one(where, f"sha256: found {_short(sha256)}, expected 64 hexadecimal digits")
        if not is_whole(byte_count) or not (isinstance(driver, str) and driver):
            yield one(where, f"found {_short(byte_count)} bytes, driver {_short(driver)}, expected a number and a name")


def check_levels(data: StoreData) -> Iterator[Defects]:
    """Levels count from 0, none left out, and have finite numbers."""
    if not data.level_rows:
        yield one("table=level", "found no row, expected at least one")
    for number, row in enumerate(data.level_rows):
        where = f"level={row.level}"
        if row.level != number:
            yield one(where, f"found {row.level}, expected {number}")
        for name in ("max_error", "rmse", "max_error_bound", "max_rise"):
            value = getattr(row, name)
            is_null = value is None and name in ("max_error_bound", "max_rise")
            if not is_null and not (is_number(value) and value >= 0):
                yield one(where, f"{name}: found {_short(value)}, expected a finite number, not negative")
        for name in ("post_count", "node_count", "edge_count", "face_count"):
            if not is_whole(getattr(row, name)):
                yield one(where, f"{name}: found {_short(getattr(row, name))}, expected a whole number")
        if not (isinstance(row.border_digest, bytes) and len(row.border_digest) == DIGEST_SIZE):
            yield one(where, f"border_digest: found {_short(row.border_digest)}, expected {DIGEST_SIZE} bytes")
        yield from _check_border_range(row, where)


def _check_border_range(row: LevelRow, where: str) -> Iterator[Defects]:
    first, last = row.first_border_edge, row.last_border_edge
    if not (first is None and last is None) and not (is_whole(first, 1) and is_whole(last, first)):
        yield one(where, f"border edges: found {_short(first)} … {_short(last)}, expected a range, or NULL")


def check_cuts(data: StoreData) -> Iterator[Defects]:
    """There is a row a level and kind of cut."""
    rows = data.select("SELECT level, kind, cut_count FROM level_cut ORDER BY level, kind")
    expected = {(row.level, kind) for row in data.level_rows for kind in CUTS}
    for level, kind, count in rows:
        where = f"table=level_cut level={level} kind={_short(kind)}"
        if (level, kind) not in expected:
            yield one(where, "found a row, expected only levels and kinds of cut that exist")
        elif not is_whole(count):
            yield one(where, f"found {_short(count)} cuts, expected a whole number")
    for level, kind in sorted(expected - {row[:2] for row in rows}):
        yield one(f"table=level_cut level={level} kind={kind!r}", "found no row, expected one")


def check_tiles(data: StoreData) -> Iterator[Defects]:
    """Tiles are as many as the lattice makes, numbered from 1, named by row and column, and have an extent."""
    lattice, tile_size = data.metadata["lattice"], data.metadata["options"]["tile_size"]
    n_row, n_col = (-(-(lattice[name] - 1) // tile_size) for name in ("n_row", "n_col"))
    if len(data.tiles) != n_row * n_col:
        yield one("table=tile", f"found {len(data.tiles)} tiles, expected {n_row} rows × {n_col} columns")
    for number, (tile_id, name, *box) in enumerate(data.tiles):
        where = f"tile={tile_id}"
        expected = f"r{number // n_col}c{number % n_col}"
        if (tile_id, name) != (number + 1, expected):
            yield one(where, f"found {tile_id} {_short(name)}, expected {number + 1} {expected!r}")
        if not all(is_number(value) for value in box) or not (box[0] < box[2] and box[1] < box[3]):
            yield one(where, f"found the extent {_short(box)}, expected four finite numbers of a rectangle")


def check_tile_levels(data: StoreData) -> Iterator[Defects]:
    """There is a row a tile and level, with ranges of ids or none."""
    n_level, expected = len(data.level_rows), len(data.tiles) * len(data.level_rows)
    if len(data.tile_levels) != expected:
        yield one("table=tile_level", f"found {len(data.tile_levels)} rows, expected {expected}")
        return
    for number, (tile_level_id, tile_id, level, *limits, digest) in enumerate(data.tile_levels):
        where = f"level={level} tile={tile_id}"
        found = (tile_level_id, tile_id, level)
        if found != (number + 1, number // n_level + 1, number % n_level):
            yield one(where, f"found tile_level_id, tile and level {found}, expected the order of tiles, then levels")
        for i, table in enumerate(RANGED):
            first, last = limits[2 * i : 2 * i + 2]
            if not (first is None and last is None) and not (is_whole(first, 1) and is_whole(last, first)):
                yield one(where, f"{table}: found {_short(first)} … {_short(last)}, expected a range, or NULL")
        if not (isinstance(digest, bytes) and len(digest) == DIGEST_SIZE):
            yield one(where, f"digest: found {_short(digest)}, expected {DIGEST_SIZE} bytes")


def check_order(data: StoreData) -> Iterator[Defects]:
    """Ranges follow each other without a gap: by tile, then by level, from the first id that is not set aside."""
    tiling = data.tiling
    first = {"node": tiling.n_border_node_id + 1, "edge": tiling.n_border_edge_id + 1, "face": 1}
    for i, table in enumerate(RANGED):
        following = first[table]
        for number, (low, high) in enumerate(data.ranges[:, :, i].reshape(-1, 2).tolist()):
            if low > high:
                continue
            if low != following:
                tile, level = divmod(number, len(data.level_rows))
                where = f"level={level} tile={tile + 1}"
                yield one(where, f"{table}: found a range from {low}, expected one from {following}")
            following = high + 1


RULES = (
    Rule("V201", "metadata", ERROR, "R-110", "a value of the metadata is missing or of another kind", check_metadata,
         needs=SOUND),
    Rule("V202", "post_counts", ERROR, "R-110", "posts do not add up", check_posts,
         needs=("metadata", "levels")),
    Rule("V203", "source", ERROR, "R-111", "a file of the source is not described as it should be", check_sources,
         needs=SOUND),
    Rule("V204", "levels", ERROR, "R-120", "levels are not numbered from 0, or a value is of another kind", check_levels,
         needs=SOUND),
    Rule("V205", "level_cut", ERROR, "R-122", "cuts are not told for each level and kind", check_cuts,
         needs=("levels",)),
    Rule("V206", "tiles", ERROR, "R-130", "tiles are not those that the lattice makes", check_tiles,
         needs=("metadata",)),
    Rule("V207", "tile_levels", ERROR, "R-132", "a tile and level has no row, or one that cannot be", check_tile_levels,
         needs=("tiles", "levels")),
    Rule("V208", "range_order", ERROR, "R-132", "ranges of ids do not follow each other", check_order,
         needs=("tile_levels",)),
)  # fmt: skip
