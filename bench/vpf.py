"""A store to VPF and back, and both validated, beside plain exports of the same faces and nodes by GDAL.

The peer writes the polygons and points of every level from arrays into one GeoPackage, through pyogrio: no topology, no
links, no indexes of primitives. All run in turn in one process with kernels warm; seconds are of the wall clock, processor
seconds those of all threads. Compare ratios of one run only. Exit code 1 if the store that comes back from double precision
is not the same bytes, or something is found in it or in a directory.

Example: ``python bench/vpf.py store.gpkg --json``
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyogrio
import shapely
from quality import NEW_MEXICO, table_text

import vpfx
from vpfx.evpf.reading import import_vpf
from vpfx.export import EXPORTERS
from vpfx.validate import validate

COLUMNS = ("what", "seconds", "processor seconds", "of the peer", "MB")


def write_layers(store_path: Path, path: Path) -> None:
    """Write faces and nodes of all levels as polygons and points."""
    with vpfx.open_store(store_path) as store:
        for level in range(len(store.levels)):
            tin = store.tin(level)
            corners = tin.nodes[tin.face_nodes[:, (0, 1, 2, 0)]]
            shapes = {"face": shapely.polygons(corners), "node": shapely.points(tin.nodes)}
            fields = {
                "face": {name: tin.face_attributes[name] for name in ("slope", "aspect", "tile_id", "face_id")},
                "node": {name: tin.node_attributes[name] for name in ("level", "z_parent", "node_id")},
            }
            for kind, geometry in shapes.items():
                pyogrio.raw.write(
                    path, shapely.to_wkb(geometry), list(fields[kind].values()), list(fields[kind]), layer=f"{kind}_{level}",
                    geometry_type="Polygon Z" if kind == "face" else "Point Z", append=path.exists(), driver="GPKG",
                    crs=tin.crs or None,
                )  # fmt: skip


def size_of(path: Path) -> float:
    """Return the megabytes of a file, or of the files of a directory."""
    files = [path] if path.is_file() else [file for file in path.rglob("*") if file.is_file()]
    return sum(file.stat().st_size for file in files) / 1e6


def measure(store: Path, folder: Path) -> list[tuple[Any, ...]]:
    """Run everything once; return rows of the table."""
    single, double, back = folder / "single", folder / "double", folder / "back.gpkg"
    jobs: list[tuple[str, Callable[[], Any], Path]] = [
        ("peer: polygons and points", lambda: write_layers(store, folder / "layers.gpkg"), folder / "layers.gpkg"),
        ("export, single", lambda: EXPORTERS["vpf"].write(store, single), single),
        ("export, double", lambda: EXPORTERS["vpf"].write(store, double, double=True), double),
        ("import, double", lambda: import_vpf(double, back), back),
        ("validate the store", lambda: validate(store), store),
        ("validate the directory", lambda: validate(single), single),
    ]
    rows = []
    for name, job, made in jobs:
        wall, processor = time.perf_counter(), time.process_time()
        report = job()
        taken = time.perf_counter() - wall, time.process_time() - processor
        peer = rows[0][1] if rows else taken[0]
        rows.append((name, taken[0], taken[1], taken[0] / peer, size_of(made)))
        if name.startswith("validate") and report.findings:
            raise SystemExit(f"{name}: found {report.findings[0]}")
    if back.read_bytes() != store.read_bytes():
        raise SystemExit("import: found other bytes than those of the store")
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("store", type=Path, help="made by vpfx build; nothing attached")
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        vpfx.build(NEW_MEXICO, folder / "warm.gpkg", max_error=(60, 30), tile_size=128)
        (folder / "warm").mkdir()
        measure(folder / "warm.gpkg", folder / "warm")
        rows = measure(arguments.store, folder)
        with vpfx.open_store(arguments.store) as store:
            faces = sum(level.faces for level in store.levels)
    if arguments.json:
        print(json.dumps({"faces": faces, "rows": [dict(zip(COLUMNS, row, strict=True)) for row in rows]}))
        return 0
    texts = [[row[0], *(f"{value:.2f}" for value in row[1:4]), f"{row[4]:.1f}"] for row in rows]
    print(f"{faces:,} faces on all levels\n{table_text([COLUMNS, *texts], [0])}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
