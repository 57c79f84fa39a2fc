"""`vpfx vpf`: directories and tables of VPF, and VPF as a GeoPackage."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import click

from vpfx.cli.common import app
from vpfx.cli.output import check_output
from vpfx.errors import InputError

__all__ = ["dump", "ls", "to_gpkg", "vpf"]

FORMS = ("table", "csv", "json")


@app.group(no_args_is_help=True)
def vpf() -> None:
    """Look into VPF directories (MIL-STD-2407); nothing is ever written to them."""


@vpf.command()
@click.argument("directory", metavar="DIR", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def ls(directory: Path, as_json: bool) -> None:
    """List libraries, coverages and feature classes of a database, or of one library.

    Names and kinds of classes, their tables and rows, primitives and join tables. What the tables list and the directory
    lacks is marked as missing, what is broken as a problem.

    Example: vpfx vpf ls vmap
    """
    from vpfx.vpf.catalog import open_database
    from vpfx.vpf.listing import list_database, list_lines

    document = list_database(open_database(directory))
    print(json.dumps(document, indent=2, ensure_ascii=False) if as_json else "\n".join(list_lines(document)))


@vpf.command()
@click.argument("table", type=click.Path(path_type=Path))
@click.option("--rows", metavar="A:B", help="First and last row, from 1; either may be left out.  [default: all]")
@click.option("--format", "form", default="table", show_default=True, help="table, csv or json.")
def dump(table: Path, rows: str | None, form: str) -> None:
    """Print the rows of a VPF table.

    Coordinates come as x y z, …; triplets as id, tile and id there. JSON has both as lists.

    Example: vpfx vpf dump vmap/north/cat --rows 1:3
    """
    from vpfx.query.sql import FORMATS, Answer
    from vpfx.vpf.listing import table_problems, table_rows
    from vpfx.vpf.table import open_table

    if form not in FORMS:
        raise InputError(f"--format: found {form!r}, expected one of: {', '.join(FORMS)}")
    first, last = _row_range(rows)
    with open_table(table) as file:
        names, found = table_rows(file.read(first - 1, last), is_nested=form == "json")
        for problem in table_problems(file):
            print(f"vpfx: {table}: {problem}", file=sys.stderr)
    sys.stdout.write(FORMATS[form](Answer(names, found)).decode("utf-8", "replace"))


def _row_range(text: str | None) -> tuple[int, int | None]:
    """First and last row of `--rows`."""
    found = re.fullmatch(r"([0-9]{0,10}):([0-9]{0,10})", ":" if text is None else text)
    if not found or found[1] == "0" or found[2] == "0":
        raise InputError(f"--rows: found {text!r}, expected first:last, from 1, such as 1:20")
    first, last = int(found[1] or 1), int(found[2]) if found[2] else None
    if last is not None and last < first:
        raise InputError(f"--rows: found {text!r}, expected first:last, from 1, such as 1:20")
    return first, last


@vpf.command()
@click.argument("directory", metavar="DIR", type=click.Path(path_type=Path))
@click.option(
    "-o", "--output", required=True, metavar="FILE.gpkg", type=click.Path(path_type=Path), help="File to make."
)
@click.option("--coverage", "coverages", multiple=True, metavar="NAME", help="Only this one; may be given again.")
@click.option("--primitives", is_flag=True, help="Edges, faces, nodes and texts as layers too.")
@click.option("--crs", metavar="EPSG:4326", help="CRS of the places, whatever grt says.")
@click.option("--overwrite", is_flag=True, help="Replace an existing file, once the new one is complete.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
@click.option("-q", "--quiet", is_flag=True, help="Print nothing but warnings and errors.")
def to_gpkg(
    directory: Path, output: Path, coverages: tuple[str, ...], primitives: bool, crs: str | None, overwrite: bool,
    as_json: bool, quiet: bool,
) -> None:  # fmt: skip
    """Write the feature classes of a database, a library or a coverage into a GeoPackage, a layer each.

    Tiles are merged, coded values explained in fields of their own. What the tables list and the directory lacks, or what is
    broken, is left out and told on stderr.

    Example: vpfx vpf to-gpkg vmap -o vmap.gpkg
    """
    from vpfx.vpf.gpkg import write_gpkg
    from vpfx.vpf.listing import counted

    check_output(output, overwrite)
    written = write_gpkg(directory, output, coverages=coverages, primitives=primitives, crs=crs)
    for problem in written.problems if not as_json else ():
        print(f"vpfx: warning: {problem}", file=sys.stderr)
    if as_json:
        layers = [layer._asdict() for layer in written.layers]
        document = {"file": str(output), "layers": layers, "problems": written.problems}
        print(json.dumps(document, indent=2, ensure_ascii=False))
    elif not quiet:
        width = max(len(layer.layer) for layer in written.layers)
        for layer in written.layers:
            lost = f", {layer.without_geometry:,} without geometry" if layer.without_geometry else ""
            print(f"{layer.layer:<{width}}  {counted(layer.features, 'feature')}, {layer.geometry}{lost}")
        print(f"{output}: {output.stat().st_size:,} bytes, {counted(len(written.layers), 'layer')}")
