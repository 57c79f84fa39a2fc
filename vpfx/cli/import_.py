"""`vpfx import`."""

from __future__ import annotations

import click

from vpfx.cli.common import app, print_json, print_levels, progress

__all__ = ["import_"]


@app.command("import")
@click.argument("directory", metavar="DIR")
@click.option("-o", "--output", required=True, metavar="STORE.gpkg", help="The store to make.")
@click.option("--overwrite", is_flag=True, help="Replace an existing store, once the new one is complete.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
@click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors.")
def import_(directory: str, output: str, overwrite: bool, as_json: bool, quiet: bool) -> None:
    """Make a store from a VPF directory that vpfx export wrote; byte for byte the same, if it did so with --double.

    Example: vpfx import n36 -o back.gpkg
    """
    from vpfx.evpf.reading import import_vpf

    with progress(quiet or as_json) as show:
        report = import_vpf(directory, output, overwrite=overwrite, progress=show)
    if as_json:
        facts = {"store": str(report.path), "tiles": report.tiles, "precision": report.precision}
        print_json(report.levels, report.seconds, facts)
    elif not quiet:
        print_levels(report.levels)
        size = report.path.stat().st_size
        tiles = f"{report.tiles} tile{'s' if report.tiles > 1 else ''}"
        print(f"{report.path}: {size:,} bytes, from {report.precision} precision, {tiles}, {report.seconds:.1f} s")
