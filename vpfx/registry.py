"""Tables of named parts (methods, exporters, rules) and the one way to pick from them."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Protocol, TypeVar

from vpfx.errors import InvariantError, UnknownNameError

__all__ = ["Named", "pick", "table"]


class Named(Protocol):
    """A part that has a name."""

    @property
    def name(self) -> str:
        """The name under which the part stands in its table."""


Part = TypeVar("Part", bound=Named)


def table(*parts: Part) -> Mapping[str, Part]:
    """Return a read-only table of parts by name, in the order given.

    Raises
    ------
    InvariantError
        Two parts have the same name.
    """
    names = [part.name for part in parts]
    if len(set(names)) != len(names):
        raise InvariantError(f"table: found names {names}, expected each once")
    return MappingProxyType(dict(zip(names, parts, strict=True)))


def pick(parts: Mapping[str, Part], name: str, kind: str) -> Part:
    """Return the part called `name`.

    Parameters
    ----------
    parts : mapping
        A table made by `table`.
    name : str
        The name asked for.
    kind : str
        What the parts are, for the message.

    Raises
    ------
    UnknownNameError
        No part has that name; the message lists the known names.

    Examples
    --------
    >>> from vpfx.methods import METHODS
    >>> pick(METHODS, "quadric", "method")
    Traceback (most recent call last):
    vpfx.errors.UnknownNameError: unknown method 'quadric'; known: ...wynne
    """
    try:
        return parts[name]
    except KeyError:
        raise UnknownNameError(f"unknown {kind} {name!r}; known: {', '.join(sorted(parts))}") from None
