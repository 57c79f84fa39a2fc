"""The SQL of the store, read from ``schema/``: in a checkout beside the package, in a wheel inside it."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from vpfx.errors import NotFoundError

__all__ = ["layer_names", "layers_sql", "schema_sql"]


def schema_sql(name: str) -> str:
    """Return the text of one file of the schema.

    Raises
    ------
    NotFoundError
        The installation lacks it.

    Examples
    --------
    >>> schema_sql("gpkg.sql").splitlines()[2]
    'CREATE TABLE gpkg_spatial_ref_sys ('
    """
    packaged = resources.files("vpfx") / "schema" / name
    if packaged.is_file():
        return packaged.read_text(encoding="utf-8")
    beside = Path(__file__).resolve().parents[2] / "schema" / name
    if not beside.is_file():
        raise NotFoundError(f"schema/{name}: found no such file, expected it in the package; install vpfx again")
    return beside.read_text(encoding="utf-8")


def layers_sql(level: int, srs_id: int) -> str:
    """SQL of the views that show one level as layers."""
    srs = srs_id.to_bytes(4, "little", signed=True).hex().upper()
    return schema_sql("layers.sql").replace("{level}", str(level)).replace("{srs}", srs)


def layer_names(level: int) -> dict[str, str]:
    """Names of the layers of a level and their geometry types."""
    return {f"node_{level}": "POINT", f"edge_{level}": "LINESTRING", f"face_{level}": "POLYGON"}
