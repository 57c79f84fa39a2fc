"""Names in tables and on discs: how a name becomes a path, and never one outside the directory (specs/vpf.md, V-201, V-202)."""

from __future__ import annotations

import os
import stat
from functools import lru_cache
from pathlib import Path

from vpfx.errors import VpfFormatError

__all__ = ["MOST_NAME", "MOST_PARTS", "check_name", "find", "split"]

MOST_NAME = 255
"""Characters of one component: what file systems take."""

MOST_PARTS = 32
"""Components of one path; tiles lie four or five deep."""


def find(root: str | Path, *parts: str, within: str | Path | None = None) -> Path | None:
    r"""Find a file or directory below a root by its name, in whatever case it is written.

    Parameters
    ----------
    root : path
        Where to look.
    parts : str
        Names, each of which may hold several components parted by ``/`` or ``\``.
    within : path, optional
        Directory that links may not lead out of; the root, if it is not given.

    Returns
    -------
    Path or None
        None if there is none. Of several spellings the one asked for is taken, else the first in the order of characters; a
        name with a dot behind it counts if there is none without.

    Raises
    ------
    VpfFormatError
        A name leads elsewhere (V-202): ``..``, an absolute path, a drive, a link out of the directory; or it has a control
        character or is too long; or what it names is neither file nor directory.

    Examples
    --------
    >>> import tempfile
    >>> root = Path(tempfile.mkdtemp())
    >>> (root / "BND").mkdir()
    >>> _ = (root / "BND" / "EDG.").write_bytes(b"")
    >>> find(root, "bnd/edg").relative_to(root).as_posix(), find(root, "bnd", "fac")
    ('BND/EDG.', None)
    """
    path, base = str(root), str(root if within is None else within)
    for name in [name for part in parts for name in split(part, path)]:
        found = _find_one(path, name)
        if found is None:
            return None
        path = found
        if os.path.islink(path):
            _check_inside(base, path)
    _check_inside(base, path)
    return Path(path)


def split(text: str, where: str = "") -> list[str]:
    r"""Components of a name, such as the path of a tile; blank ones are left out.

    Raises
    ------
    VpfFormatError
        See `find`; `where` is the directory that the message names.

    Examples
    --------
    >>> split(r"M\K\23"), split("f/j/hb/1500"), split(" ")
    (['M', 'K', '23'], ['f', 'j', 'hb', '1500'], [])
    """
    text = text.strip()
    names = [name.strip() for name in text.replace("\\", "/").split("/")]
    if len(names) > 1 and not names[0]:
        raise _outside(where, text, "a name below the directory, not an absolute one")
    names = [name for name in names if name not in ("", ".")]
    if len(names) > MOST_PARTS:
        raise _outside(where, text, f"at most {MOST_PARTS} components")
    for name in names:
        check_name(name, where)
    return names


def check_name(name: str, where: str = "", place: str = "") -> str:
    """Return the name of one file or directory, if it is one.

    Raises
    ------
    VpfFormatError
        It is blank, leads elsewhere, or no file can have it; see `find`.

    Examples
    --------
    >>> check_name("roadl.lft")
    'roadl.lft'
    >>> check_name("../../etc/passwd", "bnd/fcs", "row 3")
    Traceback (most recent call last):
    vpfx.errors.VpfFormatError: bnd/fcs: row 3: found the name '../../etc/passwd', expected one component (V-202)
    """
    if not name.strip(" .") or "/" in name or "\\" in name or ":" in name:
        raise _outside(where, name, "one component", place)
    if len(name.encode("utf-8", "replace")) > MOST_NAME:
        raise _outside(where, name, f"at most {MOST_NAME} bytes", place)
    if any(ord(character) < 32 or 127 <= ord(character) < 160 for character in name):
        raise _outside(where, name, "no control characters", place)
    return name


def _outside(where: str, name: str, expected: str, place: str = "") -> VpfFormatError:
    shown = name if len(name) <= 60 else f"{name[:60]}…"
    return VpfFormatError(where, place, f"found the name {shown!r}, expected {expected}", "V-202")


def _find_one(folder: str, name: str) -> str | None:
    """Path of an entry of a directory."""
    exact = os.path.join(folder, name)
    if os.path.lexists(exact):
        return exact
    wanted = name.rstrip(".").casefold()
    try:
        for listing in (_listing(folder, os.stat(folder).st_mtime_ns), None):
            # a listing kept may be older than the clock of the file system can tell: what is not in it is looked for anew
            names = _list(folder) if listing is None else listing
            if wanted in names:
                return os.path.join(folder, names[wanted])
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise VpfFormatError(folder, "", f"cannot be read: {error.strerror}") from error
    return None


@lru_cache(maxsize=64)
def _listing(folder: str, changed_ns: int) -> dict[str, str]:
    """As `_list`, kept while the directory does not change."""
    return _list(folder)


def _list(folder: str) -> dict[str, str]:
    """Entries of a directory by their names without case and trailing dot; without the dot and of capitals comes first."""
    with os.scandir(folder) as entries:
        names = sorted((entry.name for entry in entries), key=lambda name: (name.endswith("."), name), reverse=True)
    return {name.rstrip(".").casefold(): name for name in names}


def _check_inside(folder: str, path: str) -> None:
    """Refuse what links lead out of the folder, and what would block or never end when it is read."""
    base, real = os.path.realpath(folder), os.path.realpath(path)
    if real != base and not real.startswith(os.path.join(base, "")):
        raise VpfFormatError(path, "", "found a link out of the directory, expected a file or directory in it", "V-202")
    try:
        mode = os.stat(path).st_mode
    except OSError as error:
        raise VpfFormatError(path, "", f"cannot be read: {error.strerror}", "V-202") from error
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise VpfFormatError(path, "", "found a device or a pipe, expected a file or a directory", "V-202")
