"""Names of feature classes and columns in the widths of VPF (specs/evpf.md E-310)."""

from __future__ import annotations

from collections.abc import Iterable

from vpfx.errors import InputError

__all__ = ["COLUMN_NAMES", "DEVICES", "OWN_CLASSES", "cut_names"]

DEVICES = ("aux", "con", "nul", "prn", *(f"{port}{i}" for port in ("com", "lpt") for i in range(10)))
"""Names that Windows keeps for devices, whatever the suffix."""


OWN_CLASSES = (
    "tinface", "tinnode", "libref", "tileref", "level", "parent", "own", "evpf", "source", "class", "column", "value",
    "tjunct", "tile1", "tile2", "cnd", "edg", "fac", "rng", "ebr", "fbr", "fcs", "fca", "int", "char",
    *DEVICES,
)  # fmt: skip
"""Names of `specs/evpf.md`, and of devices, that no class of a store may have."""

COLUMN_NAMES = ("id", "tile_id", "fac_id", "store_id")
"""The same of columns."""


def cut_names(names: Iterable[str], width: int, taken: Iterable[str]) -> list[str]:
    """Cut names to a width, each to another name; where one is taken, its last two characters are a number.

    Raises
    ------
    InputError
        More than 99 names begin alike.

    Examples
    --------
    >>> cut_names(["soil", "vegetation", "vegetation_cover", "level"], 8, OWN_CLASSES)
    ['soil', 'vegetati', 'vegeta01', 'level01']
    """
    used, found = set(taken), []
    for name in names:
        choices = [name[:width], *(f"{name[: width - 2]}{i:02}" for i in range(1, 100))]
        free = next((choice for choice in choices if choice not in used), None)
        if free is None:
            raise InputError(
                f"found more than 99 names that begin with {name[: width - 2]!r}; rename some in the store"
            )
        used.add(free)
        found.append(free)
    return found
