"""Stores in formats of others: one exporter a file, all in the table `EXPORTERS`."""

from vpfx.export import vpf
from vpfx.export.base import Exported, Exporter
from vpfx.registry import table

__all__ = ["EXPORTERS", "Exported", "Exporter"]

EXPORTERS = table(vpf.EXPORTER)
"""Exporters by name."""
