"""Every exception and warning that vpfx raises on purpose.

A message reads ``file: place: found X, expected Y (R-nnn)``, then what to do if there is something to do.
"""

from __future__ import annotations

__all__ = [
    "DemFormatError",
    "FeatureFormatError",
    "FormatError",
    "InputError",
    "InvariantError",
    "NotFoundError",
    "StoreError",
    "StoreFormatError",
    "UnknownNameError",
    "VpfFormatError",
    "VpfxError",
    "VpfxWarning",
]


class VpfxError(Exception):
    """Base of all errors that vpfx raises on purpose."""


class InputError(VpfxError, ValueError):
    """A value that the caller passed cannot be used."""


class UnknownNameError(InputError):
    """A name is not in a table; the message lists the known names."""


class FormatError(VpfxError):
    """Bytes or rows break a specification.

    Parameters
    ----------
    path : str
        The file that is wrong.
    where : str
        The place in it, such as ``row 12`` or ``post (3, 4)``; may be empty.
    message : str
        What was found and what was expected.
    requirement : str
        The requirement broken, such as ``R-101``; may be empty.

    Examples
    --------
    >>> print(FormatError("a.dt1", "record 7", "found 10 bytes, expected 2414", "R-120"))
    a.dt1: record 7: found 10 bytes, expected 2414 (R-120)
    """

    def __init__(self, path: str, where: str, message: str, requirement: str = "") -> None:
        self.path = path
        self.where = where
        self.requirement = requirement
        text = ": ".join(part for part in (path, where, message) if part)
        super().__init__(f"{text} ({requirement})" if requirement else text)


class DemFormatError(FormatError):
    """An elevation file cannot be read as a grid of posts."""


class FeatureFormatError(FormatError):
    """A file cannot be read as surveyed points, lines and areas."""


class StoreFormatError(FormatError):
    """A store breaks ``specs/format.md``."""


class VpfFormatError(FormatError):
    """A VPF table or directory breaks MIL-STD-2407."""


class NotFoundError(VpfxError, LookupError):
    """No such level, tile, face or file."""


class StoreError(VpfxError):
    """The store cannot be opened or written: it exists, is locked, or the medium refused."""


class InvariantError(VpfxError):
    """A method broke a rule of TINs: a bug of vpfx, not of the input."""


class VpfxWarning(UserWarning):
    """Legal, but something is lost: a void was filled, a precision was cut."""
