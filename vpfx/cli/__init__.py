"""The command line: one function a command, no logic. Data go to stdout, messages to stderr."""

from vpfx.cli.attributes import attach
from vpfx.cli.build import build
from vpfx.cli.common import app, main
from vpfx.cli.compare import compare, measure
from vpfx.cli.query import at, profile, query
from vpfx.cli.sql import sql
from vpfx.cli.store import info, plot

__all__ = ["app", "at", "attach", "build", "compare", "info", "main", "measure", "plot", "profile", "query", "sql"]
