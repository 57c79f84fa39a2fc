"""`vpfx attach`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from vpfx.cli.common import app
from vpfx.errors import InputError

__all__ = ["attach"]


@app.command()
@click.argument("store", type=click.Path(path_type=Path))
@click.option("--class", "class_name", required=True, metavar="NAME", help="Feature class to make, and its table.")
@click.option("--from", "source", metavar="FILE", help="Areas: GeoPackage, Shapefile, FlatGeobuf or GeoJSON.")
@click.option("--raster", metavar="FILE", help="Instead: a raster of classes, whole numbers; most of the cells decide.")
@click.option("--sql", "question", metavar="SQL", help="Instead: a question that gives face_id and values.")
@click.option(
    "--by", default="centroid", show_default=True,
    help="Of areas: centroid, majority, or share: all that cover some of a face.",
)  # fmt: skip
@click.option("--columns", metavar="A,B,…", help="Fields of areas to keep, FIELD or name=FIELD.  [default: all]")
@click.option("--layer", metavar="NAME", help="Layer of a file of areas with several.")
@click.option("--band", default=1, show_default=True, help="Band of the raster.")
@click.option("--level", type=int, help="Level of the faces; coarser ones get shares.  [default: the finest]")
@click.option("--append", is_flag=True, help="Add to a class that is there.")
@click.option("--overwrite", is_flag=True, help="Replace a class that is there.")
def attach(
    store: Path, class_name: str, source: str | None, raster: str | None, question: str | None, append: bool,
    overwrite: bool, **values: Any,
) -> None:  # fmt: skip
    """Give faces attributes: of areas they lie in, of a raster of classes, or of an SQL question.

    What a face has holds for all finer faces in it; coarser ones have the shares of what lies below.

    Example: vpfx attach n36.gpkg --class soil --from soils.geojson --columns kind,depth --by share
    """
    from vpfx.attach import attach_areas, attach_raster, attach_sql

    if sum(given is not None for given in (source, raster, question)) != 1:
        raise InputError("attach: found none or several of --from, --raster and --sql, expected one")
    if append and overwrite:
        raise InputError("attach: found both --append and --overwrite, expected one at most")
    _check_options(source, raster)
    if_there = "append" if append else "replace" if overwrite else "refuse"
    level = values["level"]
    if source is not None:
        columns = values["columns"].split(",") if values["columns"] else None
        done = attach_areas(
            store, class_name, source, by=values["by"], level=level, columns=columns, layer=values["layer"], if_there=if_there
        )  # fmt: skip
    elif raster is not None:
        done = attach_raster(store, class_name, raster, band=values["band"], level=level, if_there=if_there)
    else:
        done = attach_sql(store, class_name, question or "", if_there=if_there)
    print(f"{store}: class {class_name}: {done.features} features on {done.faces} faces")


def _check_options(source: str | None, raster: str | None) -> None:
    """Refuse options that say nothing of what is attached."""
    context = click.get_current_context()
    allowed = {"by", "columns", "layer", "level"} if source else {"band", "level"} if raster else set()
    for name in ("by", "columns", "layer", "band", "level"):
        given = context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE
        if given and name not in allowed:
            raise InputError(f"attach: found --{name}, which says nothing here; leave it out")
