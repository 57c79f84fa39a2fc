"""A directory of VPF as vector layers, one a feature class: their names, one of them, its CRS, and what it was read from.

Source: specs/vpf.md, V-404, V-450, V-451.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import InputError, VpfFormatError
from vpfx.vpf.catalog import Coverage
from vpfx.vpf.fields import Field
from vpfx.vpf.opening import feature_classes, open_coverages
from vpfx.vpf.reader import class_tables, read_class
from vpfx.vpf.schema import FeatureClass

__all__ = ["VpfLayer", "crs_of", "layer_names", "layer_source", "read_layer"]

DATUMS = {"WGE": 4326, "WGC": 4322, "NAR": 4269, "NAS": 4267, "EUR": 4230}
"""EPSG codes of geographic CRSs by the code of their geodetic datum in ``grt``."""

DIGEST_CHUNK = 1 << 20  # bytes read at a time


class VpfLayer(NamedTuple):
    """A feature class.

    Attributes
    ----------
    geometry : object (n,)
        Of shapely; None where there is none.
    fields : dict of str to Field
    crs : str or None
        None if it is not known.
    problems : tuple of str
        What could not be read, or not as it stands there.
    """

    geometry: NDArray[np.object_]
    fields: dict[str, Field]
    crs: str | None
    problems: tuple[str, ...]


def layer_names(path: Path | str) -> list[str]:
    """Names of the feature classes below a directory: ``coverage/class``.

    Of a database with several libraries ``library/coverage/class``, of a coverage the class alone.

    Raises
    ------
    NotFoundError, VpfFormatError
        As `vpfx.vpf.opening.open_coverages`; or a schema is broken.
    """
    return list(_classes(path))


def _classes(path: Path | str) -> dict[str, tuple[Coverage, FeatureClass]]:
    coverages = open_coverages(path).coverages
    is_lone = len(coverages) == 1 and coverages[0].path.resolve() == Path(path).resolve()
    has_several = len({coverage.library.path for coverage in coverages}) > 1
    found: dict[str, tuple[Coverage, FeatureClass]] = {}
    for coverage in coverages:
        parts = [] if is_lone else [coverage.library.name, coverage.name] if has_several else [coverage.name]
        for name, one in feature_classes(coverage)[0].items():
            found["/".join([*parts, name]).lower()] = coverage, one
    return found


def _one(path: Path | str, layer: str) -> tuple[Coverage, FeatureClass]:
    classes = _classes(path)
    if layer.lower() not in classes:
        raise InputError(f"{path}: found no layer {layer!r}, expected one of: {', '.join(classes)}")
    return classes[layer.lower()]


def read_layer(path: Path | str, layer: str) -> VpfLayer:
    """Read a feature class by its name among `layer_names`.

    Raises
    ------
    InputError
        There is none of that name.
    NotFoundError, VpfFormatError
        As `vpfx.vpf.reader.read_class`.
    """
    coverage, found = _one(path, layer)
    rows = read_class(coverage, found)
    crs, guess = crs_of(coverage)
    return VpfLayer(rows.geometry, rows.fields, crs, (guess, *rows.problems) if guess and crs else rows.problems)


def crs_of(coverage: Coverage) -> tuple[str | None, str]:
    """CRS of a coverage, and what is to be said of it.

    Parameters
    ----------
    coverage : Coverage
        Of a library with ``grt``; without, its places are taken for degrees.

    Returns
    -------
    str or None
        Such as ``EPSG:4326``; None if it is not known: the library is projected, or in units of a table.
    str
        A line on a guess; empty if there is none.
    """
    reference = coverage.library.reference
    kind, datum = (str(reference.get(name) or "").upper() for name in ("data_type", "geo_datum_code"))
    where = f"{coverage.library.path}: grt"
    if kind not in ("", "GEO"):
        return None, f"{where}: found data type {kind}, whose CRS is not told"
    if datum in DATUMS:
        return f"EPSG:{DATUMS[datum]}", ""
    found = f"found datum {datum!r}" if datum else "found no datum"
    return "EPSG:4326", f"{where}: {found}, took WGS 84"


def layer_source(path: Path | str, layer: str) -> tuple[str, int]:
    """Digest of the tables that a feature class is read from, and their bytes.

    Returns
    -------
    str
        SHA-256 in hexadecimal, over the tables in the order of their paths below the library: path in lower case with
        slashes, a zero byte, size in decimal digits, a zero byte, content.
    int
        Bytes of all of them.

    Raises
    ------
    InputError, NotFoundError, VpfFormatError
        As `read_layer`; or a table cannot be read.
    """
    coverage, found = _one(path, layer)
    root = coverage.library.path
    tables = {table.relative_to(root).as_posix().lower().rstrip("."): table for table in class_tables(coverage, found)}
    digest, n_byte = hashlib.sha256(), 0
    for name in sorted(tables):
        try:
            size = tables[name].stat().st_size
            digest.update(f"{name}\0{size}\0".encode())
            with open(tables[name], "rb") as file:
                while chunk := file.read(DIGEST_CHUNK):
                    digest.update(chunk)
        except OSError as error:
            raise VpfFormatError(str(tables[name]), "", f"cannot be read: {error.strerror}") from error
        n_byte += size
    return digest.hexdigest(), n_byte
