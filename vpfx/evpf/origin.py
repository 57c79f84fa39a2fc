"""What a directory says of the store it was made from: metadata, sources, levels (specs/evpf.md E-400, E-410)."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from vpfx.errors import StoreFormatError, VpfFormatError
from vpfx.evpf.checked import check, given_texts, read_checked
from vpfx.evpf.hierarchy import COUNTS, CUTS, EVPF_VERSION, HEAD, METRES
from vpfx.evpf.numbering import MOST_TILES
from vpfx.store.contents import decode_metadata
from vpfx.store.summary import LevelSummary, LevelTotals
from vpfx.store.tiles import Place, Tiling
from vpfx.vpf.catalog import Coverage, Library
from vpfx.vpf.values import is_null

__all__ = ["Origin", "read_origin"]

PRECISIONS = ("single", "double")
MOST_POSTS = 1 << 31  # along a side: ids by place stay below 2⁶³
OPTIONAL = ("class.rat", "tjunct.rat")  # where the store has classes, or the level T-junctions


class Origin(NamedTuple):
    """What the tiles hang on.

    Attributes
    ----------
    path : str
        Of the table of metadata, for messages.
    coverages : list of Coverage
        The levels, coarse to fine.
    is_double : bool
        Whether coordinates are the store's own.
    tiling : Tiling
    place : Place
        Where the posts lie.
    metadata : dict of str to str
        As the store has it.
    sources : list of (name, sha256, byte_count, driver)
    totals : list of LevelTotals
    counts : list of (nodes, edges, faces)
        Of each level.
    has_classes : bool
        Whether the store had feature classes.
    """

    path: str
    coverages: list[Coverage]
    is_double: bool
    tiling: Tiling
    place: Place
    metadata: dict[str, str]
    sources: list[tuple[str, str, int, str]]
    totals: list[LevelTotals]
    counts: list[tuple[int, int, int]]
    has_classes: bool

    def check_counts(self, summary: Sequence[LevelSummary]) -> None:
        """Compare the counts of the rows with those told.

        Raises
        ------
        VpfFormatError
        """
        for line, counts, coverage in zip(summary, self.counts, self.coverages, strict=True):
            found = (line.nodes, line.edges, line.faces)
            if found != counts:
                told = "{} nodes, {} edges, {} faces"
                message = f"found {told.format(*counts)}, expected {told.format(*found)} as in the tiles"
                raise VpfFormatError(str(coverage.table("level.rat")), "row 1", message, "E-410")


def read_origin(library: Library) -> Origin:
    """Read what a library says of its store.

    Raises
    ------
    VpfFormatError
        A table is missing or broken, or a number is out of bounds.
    """
    first = _coverage(library, 0)
    table = read_checked(first, "evpf.rat", {"id": "I", "name": "TL*", "value": "TL*"})
    names, values = given_texts(table, "name"), given_texts(table, "value")
    if tuple(names[: len(HEAD)]) != HEAD:
        raise VpfFormatError(table.path, "row 1", f"found {names[:4]}, expected {', '.join(HEAD)}", "E-400")
    version, precision = values[:2]
    for row, (value, known) in enumerate(((version, (EVPF_VERSION,)), (precision, PRECISIONS)), 1):
        if value not in known:
            message = f"found {HEAD[row - 1]} {value[:20]!r}, expected {' or '.join(known)}"
            raise VpfFormatError(table.path, f"row {row}", message, "E-400")
    n_level = _whole(values[2], table.path, "row 3", 1, len(library.coverages))
    tile_size = _whole(values[3], table.path, "row 4", 8, MOST_POSTS)
    metadata = dict(zip(names[len(HEAD) :], values[len(HEAD) :], strict=True))
    if len(metadata) < len(names) - len(HEAD):
        raise VpfFormatError(table.path, "", "found a name twice, expected it once", "E-400")
    try:
        decoded = decode_metadata(metadata, table.path)
    except StoreFormatError as error:
        raise VpfFormatError("", "", str(error), "E-400") from None
    if precision == "single":
        metadata["coordinate_precision"] = precision
    place, tiling = _lattice(decoded["lattice"], tile_size, n_level, table.path)
    missing = set(range(1, tiling.n_tile + 1)) - set(library.tiles)
    if missing or len(library.tiles) > tiling.n_tile:
        message = f"found tiles {_some(library.tiles)}, expected 1 … {tiling.n_tile}, as {table.path} has the lattice"
        raise VpfFormatError(str(library.path / "tileref"), "tileref.aft", message, "E-104")
    is_double = precision == "double"
    if not is_double:
        _check_floats(place, tiling, table.path)
    coverages = [_coverage(library, level) for level in range(n_level)]
    related = [_related(coverage) for coverage in coverages]
    levels = [_read_level(coverage, level) for level, coverage in enumerate(coverages)]
    totals, counts = [line[0] for line in levels], [line[1] for line in levels]
    sources = _read_sources(first)
    has_classes = "class.rat" in related[0]
    return Origin(table.path, coverages, is_double, tiling, place, metadata, sources, totals, counts, has_classes)


def _related(coverage: Coverage) -> set[str]:
    """Tables of the hierarchy that the schema of a coverage names; they are there, and no other."""
    if coverage.find("fcs") is None:
        raise VpfFormatError(str(coverage.path), "", "found no table fcs, expected one", "E-320")
    named = {relation.table2.lower() for relation in coverage.relations if relation.table2.lower().endswith(".rat")}
    for name in sorted(named | set(OPTIONAL)):
        is_there = coverage.find(name) is not None
        if is_there != (name in named):
            message = f"found {'a' if is_there else 'no'} table {name}, expected {'none, ' * is_there}as fcs has it"
            raise VpfFormatError(str(coverage.path), "", message, "E-320")
    return named


def _some(ids: Iterable[int]) -> str:
    """Ids as text, the first of many."""
    listed = sorted(ids)
    return ", ".join(map(str, listed[:9])) + (" …" if len(listed) > 9 else "")


def _coverage(library: Library, level: int) -> Coverage:
    name = f"tin{level}"
    if name not in library.coverages:
        raise VpfFormatError(str(library.path), "", f"found no coverage {name}, expected one a level", "E-100")
    return library.coverages[name]


def _whole(text: Any, path: str, where: str, least: int, most: int) -> int:
    """Return a whole number told in decimal digits."""
    is_number = isinstance(text, str) and text.isascii() and text.isdigit() and len(text) <= 19
    if not is_number or not least <= int(text) <= most:
        message = f"found {str(text)[:20]!r}, expected a whole number, {least} … {most}"
        raise VpfFormatError(path, where, message, "E-400")
    return int(text)


def _lattice(lattice: dict[str, Any], tile_size: int, n_level: int, path: str) -> tuple[Place, Tiling]:
    """Place and tiles of the posts."""
    where = "lattice"
    names = (*Place._fields, "n_row", "n_col")
    if set(lattice) != set(names):
        raise VpfFormatError(path, where, f"found {sorted(lattice)}, expected {', '.join(sorted(names))}", "E-400")
    numbers = [lattice[name] for name in Place._fields]
    counts = [lattice["n_row"], lattice["n_col"]]
    is_good = all(type(n) in (int, float) and math.isfinite(n) for n in numbers) and numbers[2] > 0 and numbers[3] > 0
    if not is_good or not all(type(n) is int and 2 <= n < MOST_POSTS for n in counts):
        message = (
            f"found {json.dumps(lattice)[:200]}, expected finite places, spacings above 0 and at least 2 × 2 posts"
        )
        raise VpfFormatError(path, where, message, "E-400")
    n_tile = math.prod(-(-(n - 1) // tile_size) for n in counts)
    if n_tile > MOST_TILES:
        raise VpfFormatError(path, where, f"found {n_tile} tiles, expected at most {MOST_TILES}", "E-101")
    place = Place(*map(float, numbers))
    if not all(map(math.isfinite, place.at(counts[1] - 1, counts[0] - 1))):
        raise VpfFormatError(path, where, f"found {json.dumps(lattice)[:200]}, expected a finite extent", "E-400")
    return place, Tiling(counts[0], counts[1], tile_size, n_level)


def _check_floats(place: Place, tiling: Tiling, path: str) -> None:
    """Refuse a lattice whose posts are nearer to each other than floats: places do not tell which post they are."""
    far = place.at(tiling.col_lines[-1], tiling.row_lines[-1])
    for axis in range(2):
        ends = np.abs(np.array([place[axis], far[axis]], np.float32))
        if not np.spacing(ends.max()) <= place[2 + axis]:
            message = f"found posts {place[2 + axis]} apart, nearer than single precision tells; export with --double"
            raise VpfFormatError(path, "lattice", message, "E-500")


def _read_level(coverage: Coverage, level: int) -> tuple[LevelTotals, tuple[int, int, int]]:
    """Totals of a level, and its counts of nodes, edges and faces."""
    wanted = {"id": "I", "level": "S", "post_count": "TL*"}
    wanted |= dict.fromkeys(METRES, "R") | dict.fromkeys((*COUNTS, *CUTS), "I")
    table = read_checked(coverage, "level.rat", wanted)
    if table.n_row != 1 or table["level"][0] != level:
        raise VpfFormatError(table.path, "", f"found another row or none, expected one, of level {level}", "E-410")
    for name in METRES:
        is_optional = name in ("max_error_bound", "max_rise")
        value = table[name]
        is_good = (np.isfinite(value) & (value >= 0)) | (is_optional & is_null(value, "R"))
        check(is_good, table.path, f"found {name} {{}}, expected metres", "E-410", value)
    for name in (*COUNTS, *CUTS):
        check(table[name] >= 0, table.path, f"found {name} {{}}, expected a count", "E-410", table[name])
    bound, worst, rmse, rise = (float(table[name][0]) for name in METRES)
    posts = _whole(given_texts(table, "post_count")[0], table.path, "post_count", 0, MOST_POSTS**2 - 1)
    cuts = tuple(int(table[name][0]) for name in CUTS)
    totals = LevelTotals(_or_none(bound), worst, rmse, _or_none(rise), posts, cuts)
    nodes, edges, faces = (int(table[name][0]) for name in COUNTS)
    return totals, (nodes, edges, faces)


def _or_none(value: float) -> float | None:
    return None if math.isnan(value) else value


def _read_sources(coverage: Coverage) -> list[tuple[str, str, int, str]]:
    texts = {"name": "TL*", "sha256": "TL", "byte_count": "TL*", "driver": "TL*"}
    table = read_checked(coverage, "source.rat", {"id": "I", **texts})
    names, sums, sizes, drivers = (given_texts(table, name) for name in texts)
    sizes = [_whole(size, table.path, f"row {row}", 0, 2**63 - 1) for row, size in enumerate(sizes, 1)]
    return list(zip(names, sums, sizes, drivers, strict=True))
