"""What an exporter is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

__all__ = ["Exported", "Exporter"]


class Exported(NamedTuple):
    """What was written.

    Attributes
    ----------
    path : Path
    told : str
        What it is, for people.
    warnings : tuple of str
        What readers may not take, for people.
    """

    path: Path
    told: str
    warnings: tuple[str, ...] = ()


class Exporter(NamedTuple):
    """A format that stores are written in.

    Attributes
    ----------
    name : str
        As `vpfx export --to` takes it.
    title : str
        What it is.
    defaults : mapping
        Its options and their values where none are given.
    write : callable
        Store and output, then ``overwrite``, ``progress`` and the options by name.
    """

    name: str
    title: str
    defaults: Mapping[str, Any]
    write: Callable[..., Exported]
