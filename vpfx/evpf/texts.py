r"""Texts of any kind in the text types of VPF, and back (specs/evpf.md E-101).

A backslash is written as two, an empty text as ``\e``; where a column has characters that neither ASCII nor Latin-1 has,
those beyond ASCII are written as ``\u`` and four hexadecimal digits of UTF-16.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from vpfx.errors import VpfFormatError

__all__ = ["as_written", "from_vpf", "to_vpf"]

_BEYOND = {"T": re.compile(r"[^\x00-\x7f]"), "L": re.compile(r"[^\x00-\xff]")}
_ESCAPE = re.compile(r"\\(u[0-9a-f]{4}|.|$)", re.DOTALL)


def to_vpf(texts: Sequence[str | None]) -> tuple[str, list[str | None]]:
    r"""Return the type of a column, T or L, and its texts as they are written.

    Examples
    --------
    >>> to_vpf(["Höhe", None, ""])
    ('L', ['Höhe', None, '\\e'])
    >>> to_vpf(["Δ", "a\\b", "ö"])
    ('T', ['\\u0394', 'a\\\\b', '\\u00f6'])
    """
    given = [text for text in texts if text is not None]
    is_latin = all(ord(max(text, default="\0")) < 0x100 for text in given)
    kind = "L" if is_latin and not all(text.isascii() for text in given) else "T"
    return kind, [None if text is None else as_written(text, kind) for text in texts]


def as_written(text: str, kind: str) -> str:
    r"""Return a text as a column of type T or L holds it.

    Examples
    --------
    >>> as_written("café", "L"), as_written("café", "T")
    ('café', 'caf\\u00e9')
    """
    escaped = text.replace("\\", "\\\\") or "\\e"
    return _BEYOND[kind].sub(_utf_16, escaped)


def _utf_16(found: re.Match[str]) -> str:
    units = found[0].encode("utf-16-be", "surrogatepass").hex()
    return "".join(f"\\u{units[i : i + 4]}" for i in range(0, len(units), 4))


def from_vpf(text: str) -> str:
    r"""Return the text that was written.

    Raises
    ------
    VpfFormatError
        A backslash means nothing.

    Examples
    --------
    >>> from_vpf("\\ud83d\\ude00 a\\\\b"), from_vpf("\\e")
    ('😀 a\\b', '')
    """
    if text == "\\e":
        return ""
    if "\\" not in text:
        return text

    def plain(found: re.Match[str]) -> str:
        code = found[1]
        if code == "\\":
            return code
        if len(code) == 5:
            return chr(int(code[1:], 16))
        expected = "expected a backslash before another one, or u and four digits"
        raise VpfFormatError("", "", f"found {text[:40]!r}, {expected}", "E-101")

    units = _ESCAPE.sub(plain, text)
    return units.encode("utf-16-le", "surrogatepass").decode("utf-16-le", "replace")
