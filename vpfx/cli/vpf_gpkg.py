"""`vpfx vpf to-gpkg`."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import click

from vpfx.cli.output import check_output
from vpfx.cli.vpf import vpf

__all__ = ["to_gpkg"]


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

    check_output(output, overwrite)
    written = write_gpkg(directory, output, coverages=coverages, primitives=primitives, crs=crs)
    for problem in written.problems if not as_json else ():
        print(f"vpfx: warning: {problem}", file=sys.stderr)
    if as_json:
        layers = [layer._asdict() for layer in written.layers]
        print(
            json.dumps(
                {"file": str(output), "layers": layers, "problems": written.problems}, indent=2, ensure_ascii=False
            )
        )
    elif not quiet:
        width = max(len(layer.layer) for layer in written.layers)
        for layer in written.layers:
            lost = f", {layer.without_geometry:,} without geometry" if layer.without_geometry else ""
            print(f"{layer.layer:<{width}}  {layer.features:,} features, {layer.geometry}{lost}")
        print(f"{output}: {output.stat().st_size:,} bytes, {len(written.layers)} layers")
