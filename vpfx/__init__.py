"""Hierarchical TINs from elevation grids, kept as VPF-style primitive tables in one tiled GeoPackage."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from vpfx.dem import open_dem, read_grid
    from vpfx.evpf.reading import import_vpf
    from vpfx.evpf.writing import export_vpf
    from vpfx.model import Extent, Grid, Hierarchy, Tin
    from vpfx.pipeline import BuildReport, build, build_hierarchy
    from vpfx.query.store import Store, open_store

__version__ = "0.1.0"

_HOMES = {
    "BuildReport": "vpfx.pipeline",
    "Extent": "vpfx.model",
    "Grid": "vpfx.model",
    "Hierarchy": "vpfx.model",
    "Store": "vpfx.query.store",
    "Tin": "vpfx.model",
    "build": "vpfx.pipeline",
    "build_hierarchy": "vpfx.pipeline",
    "export_vpf": "vpfx.evpf.writing",
    "import_vpf": "vpfx.evpf.reading",
    "open_dem": "vpfx.dem",
    "open_store": "vpfx.query.store",
    "read_grid": "vpfx.dem",
}
__all__ = [
    "BuildReport",
    "Extent",
    "Grid",
    "Hierarchy",
    "Store",
    "Tin",
    "build",
    "build_hierarchy",
    "export_vpf",
    "import_vpf",
    "open_dem",
    "open_store",
    "read_grid",
]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used: numba and GDAL take a while to start."""
    if name not in _HOMES:
        raise AttributeError(f"module 'vpfx' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
