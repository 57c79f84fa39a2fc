"""`vpfx export`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from vpfx.cli.common import app, given_options, progress
from vpfx.errors import InputError

__all__ = ["export"]


@app.command()
@click.argument("store", type=click.Path(path_type=Path))
@click.option("--to", "form", required=True, metavar="FORMAT", help="vpf: a VPF database (MIL-STD-2407).")
@click.option(
    "-o", "--output", required=True, metavar="DIR", type=click.Path(path_type=Path),
    help="The directory to make; its name is that of the database: at most 8 letters, digits or underscores.",
)  # fmt: skip
@click.option(
    "--double", is_flag=True, help="Coordinates as they are; else in single precision, which more readers draw."
)
@click.option("--upper", is_flag=True, help="Names of files and directories in upper case.")
@click.option("--product", metavar="TEXT", help="Product type of the library, at most 12 characters.  [default: TIN]")
@click.option("--library", metavar="NAME", help="Name of the library.  [default: terrain]")
@click.option("--overwrite", is_flag=True, help="Replace a database that vpfx made, once the new one is complete.")
@click.option("-q", "--quiet", is_flag=True, help="Print nothing but warnings and errors.")
def export(store: Path, form: str, output: Path, overwrite: bool, quiet: bool, **values: Any) -> None:
    """Write a store in another format.

    Example: vpfx export n36.gpkg --to vpf -o n36
    """
    from vpfx.export import EXPORTERS
    from vpfx.registry import pick

    exporter = pick(EXPORTERS, form, "format")
    given = given_options(values)
    for name in given:
        if name not in exporter.defaults:
            raise InputError(f"export: found --{name}, which says nothing for {form}; leave it out")
    with progress(quiet) as show:
        done = exporter.write(store, output, overwrite=overwrite, progress=show, **given)
    for warning in done.warnings:
        print(f"vpfx: warning: {warning}", file=sys.stderr)
    if not quiet:
        print(f"{done.path}: {done.told}")
