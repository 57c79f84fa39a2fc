"""The pipeline in one page: DEM → patches → method → store."""

from __future__ import annotations

import dataclasses
import os
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from vpfx import __version__
from vpfx.checks import whole_number, whole_numbers
from vpfx.dem import Dem, open_dem
from vpfx.errors import InputError
from vpfx.features import Features, lines_in_posts, read_features
from vpfx.methods import METHODS, Method, Patch, check_features, checked_options
from vpfx.model import CUTS, Grid, Hierarchy, Progress
from vpfx.patches import Ground, PatchReader
from vpfx.registry import pick
from vpfx.store.mesh import TileMesh, tile_mesh
from vpfx.store.summary import LevelSummary, LevelTotals
from vpfx.store.tiles import DEFAULT_TILE_SIZE, Place, Tile, Tiling
from vpfx.store.writer import StoreWriter, check_target

__all__ = ["BuildReport", "build", "build_hierarchy"]
Result = TypeVar("Result")
LEAST_BOUND, MOST_BOUND = 1e-3, 1e5  # metres: where that search starts
BUDGET_SHARE = 1e-3  # it ends when the bound is known to this share of itself
NO_FEATURES = Features((), ())
MOST_SEED = (1 << 31) - 1  # times the number of tiles it still fits into 64 bits


@dataclass(frozen=True)
class BuildReport:
    """What was built.

    Attributes
    ----------
    path : Path
        The store.
    levels : tuple of LevelSummary
        Counts, bounds and measured errors, coarse to fine.
    ground : Ground
        Posts, voids and areas.
    tiles : int
        Number of tiles.
    seconds : float
        Wall-clock time from opening the DEM to the finished file.
    """

    path: Path
    levels: tuple[LevelSummary, ...]
    ground: Ground
    tiles: int
    seconds: float


def build(
    paths: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    output: str | os.PathLike[str],
    *,
    method: str = "wynne",
    max_faces: Sequence[int] | None = None,
    tile_size: int = DEFAULT_TILE_SIZE,
    workers: int | None = None,
    fill: bool = False,
    seed: int = 0,
    overwrite: bool = False,
    progress: Progress | None = None,
    dem_options: Mapping[str, Any] | None = None,
    features: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] = (),
    feature_options: Mapping[str, Any] | None = None,
    **options: Any,
) -> BuildReport:
    """Turn elevation files into a store.

    Parameters
    ----------
    paths : path or sequence of paths
        Elevation files, as for `vpfx.dem.open_dem`.
    output : path
        The store to make, normally ``*.gpkg``.
    method : str
        Name in `vpfx.methods.METHODS`.
    max_faces : sequence of int, optional
        Budget of faces of each level, instead of the option max_error: the smallest bound that fits is found.
    tile_size : int
        Greatest number of post spacings along a side of a tile.
    workers : int, optional
        Threads that triangulate; the processors if not given. The rows are the same for any number.
    fill : bool
        Whether voids are filled by interpolation; the faces there are marked.
    seed : int
        Start of all random choices.
    overwrite : bool
        Whether an existing store is replaced, once the new one is complete.
    progress : callable, optional
        Called with the tiles done and the tiles in all.
    dem_options : mapping, optional
        Options of `vpfx.dem.open_dem`: crs, bbox, band, nodata, vertical_unit, vertical_datum.
    features : path or sequence of paths
        Surveyed points, lines and areas, as for `vpfx.features.read_features`, of which some methods make nodes or edges.
    feature_options : mapping, optional
        Options of `read_features`: layer, use_z.
    **options
        Options of the method.

    Returns
    -------
    BuildReport

    Raises
    ------
    InputError, NotFoundError, DemFormatError, FeatureFormatError, StoreError
        What was passed, the files, or the place of the store do not do; nothing is left behind.

    Notes
    -----
    Source: design.md §2. Memory is bounded by a few tiles, not by the DEM.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     report = build("fixtures/dem/new_mexico_n36_w108.dt2", f"{folder}/nm.gpkg", max_error=(40, 20))
    ...     [level.max_error <= level.max_error_bound for level in report.levels]
    [True, True]
    """
    start = time.perf_counter()
    part = pick(METHODS, method, "method")
    chosen = checked_options(part, options)
    budgets = None if max_faces is None else _checked_budgets(max_faces, part, chosen)
    n_worker = (os.cpu_count() or 1) if workers is None else whole_number(workers, "workers", 1)
    seed = whole_number(seed, "seed", 0, MOST_SEED)
    if features:
        check_features(part, chosen)
    elif feature_options:
        raise InputError(f"features: found {', '.join(sorted(feature_options))}, but no file; give features")
    check_target(Path(output), overwrite)
    with open_dem(paths, **(dem_options or {})) as dem:
        found = read_features(features, dem.crs, dem.extent, **(feature_options or {})) if features else NO_FEATURES
        every = sorted((*dem.sources, *found.sources), key=lambda source: source.name)
        if Path(output).exists() and any(os.path.samefile(source.path, output) for source in every):
            raise InputError(f"output: found {output}, which is one of the files read; give another name")
        lines = lines_in_posts(found.lines, dem.x0, dem.y0, dem.dx, dem.dy)
        if budgets is not None:
            chosen["max_error"] = _fit_budget(dem, part, chosen, budgets, tile_size, n_worker, fill, seed, lines)
        tiling = _tiling(dem, part, tile_size, len(part.levels(chosen)))
        place = Place(dem.x0, dem.y0, dem.dx, dem.dy)
        with StoreWriter(Path(output), tiling, place, dem.crs, overwrite) as writer:
            reader = PatchReader(dem, tiling, part, chosen, fill, seed, lines=lines)
            measured = _Measured(tiling.n_level)
            work = partial(_build_tile, part, chosen, place)
            for done, (hierarchy, mesh) in enumerate(_each_tile(reader, tiling, n_worker, work), 1):
                writer.add(mesh)
                measured.add(hierarchy)
                if progress:
                    progress(done, tiling.n_tile)
            _check_ground(reader.ground, fill)
            names = [source.name for source in found.sources] or None
            given = {"max_faces": budgets, "features": names, "feature_options": dict(feature_options or {}) or None}
            metadata = _metadata(dem, part, chosen | given, tiling.tile_size, fill, seed, reader.ground)
            sources = [(source.name, source.sha256, source.n_byte, source.driver) for source in every]
            levels = writer.finish(measured.totals(chosen.get("max_error")), metadata, sources)
    return BuildReport(Path(output), tuple(levels), reader.ground, tiling.n_tile, time.perf_counter() - start)


def build_hierarchy(
    grid: Grid,
    /,
    *,
    method: str = "wynne",
    fill: bool = False,
    seed: int = 0,
    lines: Sequence[Any] = (),
    **options: Any,
) -> Hierarchy:
    """Build the levels of one grid in memory, as one tile.

    Parameters
    ----------
    grid : Grid
    method, fill, seed, **options
        As for `build`.
    lines : sequence of float64 (n, 2 or 3)
        Surveyed lines: x and y in CRS units, z in metres; a line of one vertex is a point.

    Returns
    -------
    Hierarchy
        Nodes in CRS units.

    Examples
    --------
    >>> grid = Grid(np.add.outer(np.zeros(9), np.abs(np.arange(9.0) - 4)))
    >>> build_hierarchy(grid, max_error=(0.5,)).max_error[0] <= 0.5
    True
    """
    part = pick(METHODS, method, "method")
    chosen = checked_options(part, options)
    seed = whole_number(seed, "seed", 0, MOST_SEED)
    if len(lines):
        check_features(part, chosen)
    lines = lines_in_posts(lines, grid.x0, grid.y0, grid.dx, grid.dy)
    n_row, n_col = grid.heights.shape
    tiling = Tiling(n_row, n_col, max(n_row, n_col, 8), len(part.levels(chosen)))
    patch = PatchReader(_GridDem(grid), tiling, part, chosen, fill, seed, lines=lines).read(tiling.tile(0))
    local = part.build(patch, chosen)
    nodes = local.nodes * np.array([grid.dx, grid.dy, 1.0]) + np.array([grid.x0, grid.y0, 0.0])
    link_area = tuple(area * grid.dx * grid.dy for area in local.link_area)
    return dataclasses.replace(local, nodes=nodes, link_area=link_area, crs=grid.crs)


class _GridDem:
    """A grid in memory where a DEM is read."""

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        self.n_row: int = grid.heights.shape[0]
        self.n_col: int = grid.heights.shape[1]

    def read(self, row_start: int, row_stop: int, col_start: int, col_stop: int) -> Any:
        return self._grid.heights[row_start:row_stop, col_start:col_stop]

    def post_metres(self, *_: int) -> tuple[float, float]:
        return self._grid.post_metres


class _Measured:
    """What methods have measured on each level, summed up over tiles."""

    def __init__(self, n_level: int) -> None:
        self._worst = np.zeros(n_level)
        self._squares = np.zeros(n_level)
        self._posts = np.zeros(n_level, np.int64)
        self._rise = np.full(n_level, np.nan)  # greatest distance of a new node from the level before
        self._cuts = np.zeros((n_level, len(CUTS)), np.int64)

    def add(self, hierarchy: Hierarchy) -> None:
        """Take one more tile."""
        np.maximum(self._worst, hierarchy.max_error, out=self._worst)
        self._squares += hierarchy.squared_error
        self._posts += hierarchy.n_post
        self._cuts += hierarchy.cuts
        np.fmax.at(self._rise, hierarchy.node_level, np.abs(hierarchy.nodes[:, 2] - hierarchy.node_z_parent))

    def totals(self, bounds: Sequence[float] | None) -> list[LevelTotals]:
        """Return the totals of each level, whose bounds are given if there are any."""
        rmse = (self._squares / np.maximum(self._posts, 1)) ** 0.5
        columns = zip(self._worst.tolist(), rmse.tolist(), self._rise.tolist(), self._posts.tolist(), strict=True)
        return [
            LevelTotals(bounds[level] if bounds is not None else None, worst, root, None if rise != rise else rise, n,
                        tuple(self._cuts[level].tolist()))
            for level, (worst, root, rise, n) in enumerate(columns)
        ]  # fmt: skip


def _build_tile(
    method: Method, options: Mapping[str, Any], place: Place, tile: Tile, patch: Patch
) -> tuple[Hierarchy, TileMesh]:
    """Build one tile."""
    hierarchy = method.build(patch, options)
    return hierarchy, tile_mesh(hierarchy, tile, place, patch.post_metres)


def _each_tile(
    reader: PatchReader, tiling: Tiling, n_worker: int, work: Callable[[Tile, Patch], Result]
) -> Iterator[Result]:
    """Yield what threads have made of the tiles, in order; a few are under way at once."""
    with ThreadPoolExecutor(n_worker) as pool:
        under_way: deque[Future[Result]] = deque()
        for tile in map(tiling.tile, range(tiling.n_tile)):
            under_way.append(pool.submit(work, tile, reader.read(tile)))
            if len(under_way) > n_worker:
                yield under_way.popleft().result()
        for result in under_way:
            yield result.result()


def _check_ground(ground: Ground, fill: bool) -> None:
    """Refuse a DEM that gives no faces."""
    if ground.area_m2 <= ground.void_area_m2 and not fill:
        raise InputError("dem: found no ground with data, expected at least three neighbouring valid posts")


def _tiling(dem: Dem, method: Method, tile_size: int, n_level: int) -> Tiling:
    """Tiles as asked for; one, if the method cannot build them one by one."""
    return Tiling(dem.n_row, dem.n_col, tile_size if method.tiled else max(dem.n_row, dem.n_col, tile_size), n_level)


def _checked_budgets(max_faces: Any, method: Method, options: Mapping[str, Any]) -> list[int]:
    """Budgets as whole numbers, checked to rise and to be the only mode chosen."""
    if not method.bounded:
        raise InputError(f"max_faces: found method {method.name}, which cannot hold a bound; give passes")
    if options.get("max_error") is not None or options.get("passes") is not None:
        raise InputError("max_faces: found max_error or passes too, expected only one of the three")
    budgets = whole_numbers(max_faces, "max_faces")
    if not budgets or budgets[0] < 2 or budgets != sorted(set(budgets)):
        raise InputError(f"max_faces: found {budgets}, expected rising numbers of at least 2 faces")
    return budgets


def _fit_budget(
    dem: Dem, method: Method, options: Mapping[str, Any], budgets: list[int], tile_size: int, n_worker: int,
    fill: bool, seed: int, lines: tuple[Any, ...],
) -> list[float]:  # fmt: skip
    """Smallest bound of each level that needs no more faces than its budget, level by level from the coarsest."""

    def n_face(bounds: list[float], has_more: bool) -> int:
        chosen = {**options, "max_error": bounds}
        tiling = _tiling(dem, method, tile_size, len(bounds))
        reader = PatchReader(dem, tiling, method, chosen, fill, seed, has_more, lines)

        def work(_: Tile, patch: Patch) -> int:
            return len(method.build(patch, chosen).level_faces[-1])

        count = sum(_each_tile(reader, tiling, n_worker, work))
        _check_ground(reader.ground, fill)
        return count

    bounds: list[float] = []
    for budget in budgets:
        coarse, fine = (bounds[-1] if bounds else MOST_BOUND), LEAST_BOUND
        has_more = budget != budgets[-1]
        least = n_face(bounds, True) if bounds else n_face([coarse], has_more)
        if least > budget:
            raise InputError(
                f"max_faces: found a budget of {budget}, expected at least {least}, "
                f"the start {'mesh with its lines' if lines else 'grid; use --grid'}"
            )
        while coarse > fine * (1.0 + BUDGET_SHARE):
            middle = (coarse * fine) ** 0.5
            coarse, fine = (middle, fine) if n_face([*bounds, middle], has_more) <= budget else (coarse, middle)
        if bounds and coarse == bounds[-1]:
            raise InputError(
                f"max_faces: found a budget of {budget}, which no bound below {coarse:g} m fits; leave it out"
            )
        bounds.append(coarse)
    return bounds


def _metadata(
    dem: Dem, method: Method, options: Mapping[str, Any], tile_size: int, fill: bool, seed: int, ground: Ground,
) -> dict[str, Any]:  # fmt: skip
    """Rows of the table `metadata`."""
    return {
        "software": f"vpfx {__version__}",
        "method": method.name,
        "method_source": method.source,
        "options": {**options, "tile_size": tile_size, "fill": bool(fill)},
        "seed": seed,
        "vertical_unit": "metre",
        "source_vertical_unit": dem.vertical_unit,
        "source_vertical_unit_is_assumed": dem.vertical_unit_is_assumed,
        "vertical_datum": dem.vertical_datum,
        "posts": ground.posts,
        "void_posts": ground.void_posts,
        "isolated_posts": ground.isolated_posts,
        "area_m2": ground.area_m2,
        "void_area_m2": ground.void_area_m2,
    }
