"""The directory that a database is put in: which names it may have, what it may replace, how it comes there whole."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self

from vpfx.errors import InputError, StoreError, VpfxError
from vpfx.evpf.folder import Folder
from vpfx.evpf.headers import ORIGINATOR
from vpfx.vpf.table import read_table
from vpfx.vpf.values import NULL_TEXTS, texts

__all__ = ["MOST_PATH", "DatabaseTarget", "check_names"]

MOST_PATH = 255
"""Bytes of the full path of a table that readers take."""

RESERVED = ("dht", "lat", "rference")
"""Names that no library can have: tables beside it, and one that a reader passes over."""

DCW = "dcw"
"""What a path may not have in it: a reader takes it for another product."""

_TOP = re.compile(r"dht|lat")
_IN_LIBRARY = re.compile(r"lht|grt|cat|dq[tx]|libref|tileref|tin\d+")
_IN_COVERAGE = re.compile(
    r"\d+|fc[sa]|(int|char)\.vdt|[a-z]\w*\.([alp]f[tx]|aj[tx]|ra[tx])|(fac|cnd)\.fit|tile[12]\.[ap]ti"
)
_PRIMITIVE = re.compile(r"(cn|ed)[dgx]|fac|rng|[ef]br|[cef]si")
_IN_REFERENCE = re.compile(rf"{_PRIMITIVE.pattern}|fcs|libref\.lft|tileref\.af[tx]")


def check_names(path: Path, library: str, product: str, *, is_upper: bool) -> tuple[str, str]:
    """Return the names of a database and its library, if they can be written.

    Raises
    ------
    InputError
        One is too long, has other characters than letters of the case asked for, digits and underscores, or says "dcw".

    Examples
    --------
    >>> check_names(Path("out/alps"), "terrain", "TIN", is_upper=False)
    ('alps', 'terrain')
    >>> check_names(Path("my_terrain"), "terrain", "TIN", is_upper=False)
    Traceback (most recent call last):
    vpfx.errors.InputError: my_terrain: found name 'my_terrain', expected 1 to 8 lower-case letters, digits or underscores
    """
    name = Path(os.path.abspath(path)).name
    case, pattern = ("upper", r"[A-Z0-9_]{1,8}") if is_upper else ("lower", r"[a-z0-9_]{1,8}")
    expected = f"expected 1 to 8 {case}-case letters, digits or underscores"
    if not re.fullmatch(pattern, name):
        raise InputError(f"{path}: found name {name!r}, {expected}")
    if not re.fullmatch(r"[A-Za-z0-9_]{1,8}", library) or library.lower() in RESERVED:
        raise InputError(f"library: found {library!r}, {expected}, and none of {', '.join(RESERVED)}")
    if DCW in name.lower() or DCW in library.lower():
        raise InputError(f"{path}: found {DCW!r} in a name, expected another: readers take it for another product")
    if not re.fullmatch(r"[ -~]{1,12}", product) or product != product.strip():
        raise InputError(f"product: found {product!r}, expected 1 to 12 ASCII characters")
    if product in NULL_TEXTS:
        raise InputError(f"product: found {product!r}, which VPF reads as none, expected the name of a product")
    return name, library


class DatabaseTarget:
    """A directory under way beside its place, which it takes when it is whole; use as a context manager.

    Parameters
    ----------
    path : Path
    overwrite : bool
        Whether a database made by vpfx may be replaced; nothing else ever is.
    is_upper : bool

    Raises
    ------
    StoreError
        Something is in the way.
    """

    def __init__(self, path: Path, *, overwrite: bool, is_upper: bool) -> None:
        self.path, self._overwrite = Path(os.path.abspath(path)), overwrite
        self._shown = path
        self._under_way = self.path.with_name(f".{self.path.name}.{os.getpid()}.tmp")
        self.folder = Folder(self._under_way, is_upper=is_upper)
        self._check_place()

    def _check_place(self) -> None:
        if not self.path.parent.is_dir():
            raise StoreError(f"{self._shown}: found no folder {self.path.parent}, expected one to put the database in")
        if not os.path.lexists(self.path):
            return
        if not self._overwrite:
            raise StoreError(f"{self._shown}: found an existing file or folder; give another name or --overwrite")
        foreign = find_foreign(self.path)
        if foreign is not None:
            message = f"found {foreign}, expected a VPF database of vpfx and nothing else: only that is replaced"
            raise StoreError(f"{self._shown}: {message}; move it away, or give another name")

    def __enter__(self) -> Self:
        try:
            self._under_way.mkdir()
        except OSError as error:
            raise StoreError(f"{self._shown}: cannot be made: {error.strerror}") from error
        except BaseException:  # interrupted as soon as it was there
            self._discard()
            raise
        return self

    def _discard(self) -> None:
        shutil.rmtree(self._under_way, ignore_errors=True)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._discard()
        if isinstance(error, StoreError) and str(self._under_way) in str(error):
            message = str(error).replace(str(self._under_way), str(self._shown))
            raise StoreError(message) from error.__cause__

    def check_lengths(self, library: str, n_level: int, tile_path: Sequence[str], classes: Sequence[str]) -> None:
        """Refuse a place in which the full path of some table is longer than readers take.

        Raises
        ------
        InputError
        """
        names = "/".join((*tile_path, "cnd")), *(f"{name}.afx" for name in (*classes, "tinface"))
        longest = max("tileref/tileref.afx", *(f"tin{n_level - 1}/{name}" for name in names), key=len)
        length = len(os.fsencode(self.path.joinpath(library, longest)))
        if length > MOST_PATH:
            raise InputError(
                f"{self._shown}: found full paths of {length} bytes, expected up to {MOST_PATH}: readers fail"
            )

    def warnings(self) -> tuple[str, ...]:
        """Say what readers make of the place."""
        if DCW not in str(self.path).lower():
            return ()
        return (f"{self._shown}: found {DCW!r} in the path: OGDI reads databases there otherwise; move it before use",)

    def publish(self) -> int:
        """Give the directory its name; return the bytes of all its files."""
        old = self.path.with_name(f".{self.path.name}.{os.getpid()}.old")
        try:
            size = sum(file.stat().st_size for file in self._under_way.rglob("*") if file.is_file())
            self._check_place()
            if os.path.lexists(self.path):
                os.rename(self.path, old)
            try:
                os.rename(self._under_way, self.path)
            except BaseException:
                with suppress(OSError):  # the error that led here is the one to tell
                    os.rename(old, self.path)
                raise
        except OSError as error:
            raise StoreError(f"{self._shown}: cannot be put in its place: {error.strerror}") from error
        try:
            shutil.rmtree(old, ignore_errors=True)
        except BaseException:
            shutil.rmtree(old, ignore_errors=True)
            raise
        return size


def find_foreign(path: Path) -> str | None:
    """Say what in a directory is not of a database that vpfx wrote; None if there is nothing."""
    if path.is_symlink() or not path.is_dir():
        return "something that is no directory"
    try:
        names = {name.lower(): name for name in os.listdir(path)}
        originator = texts(read_table(path / names.get("dht", "dht"))["originator"])
        libraries = texts(read_table(path / names.get("lat", "lat"))["library_name"])
        own = [library.lower() for library in libraries if library]
        inside = list(os.walk(path, onerror=_fail))
    except VpfxError:
        return "no database that vpfx wrote"
    except OSError as error:
        return f"something that cannot be read ({error.strerror})"
    if originator != [ORIGINATOR]:
        return "a database of another producer"
    for folder, folders, files in inside:
        parts = Path(folder).relative_to(path).parts
        for name in (*folders, *files):
            if not _is_own(parts, name, own):
                return str(Path(*parts, name))
            if os.path.islink(os.path.join(folder, name)):
                return f"the link {Path(*parts, name)}"
    return None


def _fail(error: OSError) -> None:
    raise error


def _is_own(parts: tuple[str, ...], name: str, libraries: list[str]) -> bool:
    """Tell whether vpfx gives such a name to something in a folder of a database."""
    name = name.lower()
    if not parts:
        return name in libraries or _TOP.fullmatch(name) is not None
    if len(parts) == 1:
        return _IN_LIBRARY.fullmatch(name) is not None
    if len(parts) == 2:
        if parts[1].lower() in ("libref", "tileref"):
            return _IN_REFERENCE.fullmatch(name) is not None
        return _IN_COVERAGE.fullmatch(name) is not None
    return (re.fullmatch(r"\d+", name) if len(parts) == 3 else _PRIMITIVE.fullmatch(name)) is not None
