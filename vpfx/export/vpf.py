"""Genuine VPF: a database with a coverage a level (specs/evpf.md)."""

from __future__ import annotations

from pathlib import Path
from types import MappingProxyType

from vpfx.evpf.writing import export_vpf
from vpfx.export.base import Exported, Exporter
from vpfx.model import Progress

__all__ = ["EXPORTER", "write"]


def write(
    store: Path, output: Path, *, overwrite: bool = False, progress: Progress | None = None, double: bool = False,
    upper: bool = False, product: str = "TIN", library: str = "terrain",
) -> Exported:  # fmt: skip
    """Write a store as a VPF database; see `vpfx.evpf.writing.export_vpf`."""
    done = export_vpf(
        store, output, library=library, product=product, is_double=double, is_upper=upper, overwrite=overwrite,
        progress=progress,
    )  # fmt: skip
    levels = f"{done.levels} level{'s' if done.levels > 1 else ''}"
    tiles = f"{done.tiles} tile{'s' if done.tiles > 1 else ''}"
    told = f"{done.bytes:,} bytes, {levels}, {tiles}, {'double' if double else 'single'} precision"
    return Exported(done.path, told, done.warnings)


EXPORTER = Exporter(
    "vpf",
    "a VPF database (MIL-STD-2407), a coverage with level-3 topology for each level",
    MappingProxyType({"double": False, "upper": False, "product": "TIN", "library": "terrain"}),
    write,
)
