"""The command line: one function a command, no logic. Data go to stdout, messages to stderr."""

from vpfx.cli.attributes import attach
from vpfx.cli.build import build
from vpfx.cli.common import app, main
from vpfx.cli.compare import compare, measure
from vpfx.cli.export import export
from vpfx.cli.import_ import import_
from vpfx.cli.query import at, nearest, profile, query
from vpfx.cli.query_areas import contours, height_range, region, volume
from vpfx.cli.query_cut import cut
from vpfx.cli.query_sight import sight, viewshed
from vpfx.cli.sql import sql
from vpfx.cli.store import info, plot
from vpfx.cli.validate import validate
from vpfx.cli.vpf import dump, ls, to_gpkg, vpf

__all__ = [
    "app",
    "at",
    "attach",
    "build",
    "compare",
    "contours",
    "cut",
    "dump",
    "export",
    "height_range",
    "import_",
    "info",
    "ls",
    "main",
    "measure",
    "nearest",
    "plot",
    "profile",
    "query",
    "region",
    "sight",
    "sql",
    "to_gpkg",
    "validate",
    "viewshed",
    "volume",
    "vpf",
]
