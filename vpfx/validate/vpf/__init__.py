"""Rules V7xx: VPF directories, and our own extension of VPF.

`vpfx.validate.vpf.stages` says what is looked at and in which order; `folders`, `parts`, `tile` and `hierarchy` read it.
"""

from __future__ import annotations

from collections.abc import Mapping

from vpfx.registry import table
from vpfx.validate.report import Rule
from vpfx.validate.vpf import (
    borders,
    boxes,
    edges,
    evpf_borders,
    evpf_classes,
    evpf_links,
    evpf_tables,
    evpf_tiles,
    features,
    lookups,
    names,
    planes,
    readers,
    tables,
    tiling,
)

__all__ = ["RULES"]

RULES: Mapping[str, Rule] = table(
    *tables.RULES,
    *names.RULES,
    *features.RULES,
    *edges.RULES,
    *planes.RULES,
    *tiling.RULES,
    *borders.RULES,
    *boxes.RULES,
    *lookups.RULES,
    *readers.RULES,
    *evpf_tables.RULES,
    *evpf_tiles.RULES,
    *evpf_links.RULES,
    *evpf_borders.RULES,
    *evpf_classes.RULES,
)
"""Rules about directories of VPF, by name."""
