"""The CRS of a library, from its geographic reference table (specs/vpf.md, V-404)."""

from __future__ import annotations

from vpfx.vpf.catalog import Coverage

__all__ = ["crs_of"]

DATUMS = {"WGE": 4326, "WGC": 4322, "NAR": 4269, "NAS": 4267, "EUR": 4230}
"""EPSG codes of geographic CRSs by the code of their geodetic datum in ``grt``."""


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
