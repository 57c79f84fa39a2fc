"""What a directory holds that features can be read from: a database, one library, or one coverage.

Source: specs/vpf.md, V-400, V-403.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from vpfx.errors import NotFoundError, VpfFormatError, VpfxError
from vpfx.vpf.catalog import Coverage, Library, open_database, open_library
from vpfx.vpf.layouts import PRIMITIVES
from vpfx.vpf.paths import find
from vpfx.vpf.schema import FEATURE_TABLE, FeatureClass, Join
from vpfx.vpf.table import open_table

__all__ = ["Opened", "feature_classes", "is_vpf", "open_coverages"]

MARKS = ("lat", "cat", "fcs", "edg", "end", "cnd", "txt")
"""Tables of which a directory of VPF has one: a database the first, a library the second, a coverage another or features."""


class Opened(NamedTuple):
    """Coverages of a directory.

    Attributes
    ----------
    coverages : tuple of Coverage
        By library, in the order of their tables.
    problems : tuple of str
        Libraries and coverages that are listed but not there; lines as of errors.
    """

    coverages: tuple[Coverage, ...]
    problems: tuple[str, ...]


def open_coverages(path: Path | str) -> Opened:
    """Open a directory of VPF, and tell its coverages.

    Parameters
    ----------
    path : path
        A database (with ``lat``), a library (with ``cat``), or a coverage: with ``fcs``, features or primitives.

    Raises
    ------
    NotFoundError
        There is no such directory, or nothing of VPF in it.
    VpfFormatError
        A table of libraries or coverages is broken.

    Examples
    --------
    >>> open_coverages("nowhere")
    Traceback (most recent call last):
    vpfx.errors.NotFoundError: nowhere: found no directory, expected a VPF database, a library or a coverage of one
    """
    root = Path(path)
    if not os.path.isdir(root):
        raise NotFoundError(f"{path}: found no directory, expected a VPF database, a library or a coverage of one")
    if not is_vpf(root):
        raise NotFoundError(f"{path}: found none of {', '.join(MARKS)}, expected a directory of VPF")
    if not any(find(root, name) for name in MARKS[:2]):
        return Opened((_lone_coverage(root),), ())
    database = open_database(root)
    problems = _missing(f"{database.path}: libraries of lat", database.missing)
    coverages: list[Coverage] = []
    for library in database.libraries.values():
        try:
            coverages += library.coverages.values()
            problems += _missing(f"{library.path}: coverages of cat", library.missing)
        except NotFoundError as error:
            problems.append(str(error))
    return Opened(tuple(coverages), tuple(problems))


def is_vpf(path: Path | str) -> bool:
    """Tell whether a directory looks like a database, a library or a coverage of VPF.

    Raises
    ------
    VpfFormatError
        It cannot be read.
    """
    return any(find(path, name) for name in MARKS) or bool(_feature_tables(Path(path)))


def _missing(what: str, names: Sequence[str]) -> list[str]:
    """One line on what is not there; none if all is."""
    return [f"{what} are missing: {', '.join(names)}"] if names else []


def _lone_coverage(root: Path) -> Coverage:
    """A directory as the coverage of the library that it lies in, or seems to."""
    full = root.resolve()
    if find(full.parent, "cat"):
        library = open_library(full.parent)
        return library.coverages.get(full.name.lower(), Coverage(library, full, full.name))
    return Coverage(Library(full.parent, full.parent.name, None, full.parent), full, full.name)


def feature_classes(coverage: Coverage) -> tuple[dict[str, FeatureClass], tuple[str, ...]]:
    """Feature classes of a coverage, those too that its schema leaves out, and what is wrong with others.

    A feature table that no relation leads to primitives is read by its columns: ``edg_id`` and so on, or those of a join table
    that bears its name.

    Returns
    -------
    dict of str to FeatureClass
        By names in lower case.
    tuple of str
        Lines as of errors.

    Raises
    ------
    VpfFormatError
        ``fcs`` or ``fca`` is broken, or the directory cannot be read.
    """
    classes = dict(coverage.classes)
    known = {found.table.lower().rstrip(".") for found in classes.values()}
    told, problems = dict(coverage.problems), []
    for name in _feature_tables(coverage.path):
        if name in known:
            continue
        try:
            found = _guessed(coverage, name)
        except VpfxError as error:
            problems.append(str(error))
            continue
        if found is not None and found.name not in classes:
            classes[found.name] = found
            told.pop(found.name, None)
            what = f"found no relation of {name} in fcs; its features are found by column {found.prim_key}"
            problems.append(str(VpfFormatError(str(coverage.path), "", what, "V-403")))
    return classes, (*told.values(), *problems)


def _feature_tables(folder: Path) -> list[str]:
    """Names of feature tables in a directory, in lower case, without dots behind."""
    try:
        names = os.listdir(folder)
    except OSError as error:
        raise VpfFormatError(str(folder), "", f"cannot be read: {error.strerror}") from error
    return sorted({name.lower().rstrip(".") for name in names if FEATURE_TABLE.fullmatch(name)})


def _guessed(coverage: Coverage, table: str) -> FeatureClass | None:
    """Feature class of a table, told by its columns."""
    match = FEATURE_TABLE.fullmatch(table)
    assert match is not None
    name, kind = match[1], match[2].upper()
    keys = [f"{primitive}_id" for primitive, own in PRIMITIVES.items() if own == kind]
    columns = _columns(coverage, table)
    for key in keys:
        if key in columns:
            return FeatureClass(name, kind, table, key[:3], key)
    join = f"{name}.{kind.lower()}jt"
    columns = _columns(coverage, join) if coverage.find(join) else []
    for key in keys:
        if key in columns and f"{name}_id" in columns:
            return FeatureClass(name, kind, table, key[:3], key, Join(join, f"{name}_id", key))
    return None


def _columns(coverage: Coverage, table: str) -> list[str]:
    with open_table(coverage.table(table)) as file:
        return [column.name.lower() for column in file.layout.columns]
