"""What commands that answer questions share: the level asked, polygons, and where answers go."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from vpfx.cli.common import numbers
from vpfx.errors import InputError, NotFoundError, StoreError

__all__ = ["area_flags", "check_output", "give", "level_flag", "read_bbox", "read_polygon", "write_file"]

WKT = re.compile(r"\s*(?:SRID=\d+;)?\s*[A-Z]+(?:\s+(?:Z|M|ZM))?\s*(?:\(|EMPTY)", re.IGNORECASE)

level_flag = click.option("--level", type=int, help="Level to ask.  [default: the finest]")


def area_flags(bbox: str | None = None) -> Callable[[Any], Any]:
    """Add the options of areas to a command; without a text for `--bbox` only those of polygons."""
    options = [
        click.option("--polygon", metavar="WKT|FILE", help="A polygon as WKT in CRS units, or a vector file of areas."),
        click.option("--polygon-layer", metavar="NAME", help="Layer of such a file with several."),
    ]
    if bbox is not None:
        options.insert(0, click.option("--bbox", metavar="X,Y,X,Y", help=bbox))

    def add(command: Any) -> Any:
        for option in reversed(options):
            command = option(command)
        return command

    return add


def read_bbox(text: str | None) -> tuple[float, ...] | None:
    """Return the four numbers of `--bbox`.

    Raises
    ------
    InputError
        They are no numbers; whether they make a rectangle is told by those who use them.
    """
    return None if text is None else numbers(text, "bbox", float)


def read_polygon(store: Any, text: str | None, layer: str | None) -> Any:
    """Return the polygon of `--polygon` in the CRS of the store.

    Raises
    ------
    InputError, NotFoundError, FeatureFormatError
        The WKT cannot be read, or the file: see `vpfx.features.read_area`.
    """
    if text is None:
        return None
    import shapely

    from vpfx.features import read_area

    if WKT.match(text):
        try:
            return shapely.from_wkt(text)
        except (shapely.errors.ShapelyError, NotImplementedError) as error:
            reason = " ".join(str(error).split())
            raise InputError(f"--polygon: found {text[:40]!r}, expected WKT ({reason})") from error
    try:
        os.stat(text)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise NotFoundError(f"--polygon: found {text[:60]!r}, expected WKT or a file ({reason})") from error
    return read_area(text, store.crs, store.extent, layer=layer)


def check_output(output: Path | None, overwrite: bool, *read: str | Path | None) -> None:
    """Refuse a file that cannot be written, or that is read.

    Raises
    ------
    InputError, StoreError
    """
    if output is None:
        return
    if output.exists() and any(os.path.exists(path) and output.samefile(path) for path in read if path):
        raise InputError(f"{output}: found a file that is read, expected another to write")
    if output.is_dir():
        raise StoreError(f"{output}: found a folder, expected a file name")
    if os.path.lexists(output) and not overwrite:
        raise StoreError(f"{output}: found an existing file; give another name or --overwrite")
    if not output.absolute().parent.is_dir():
        raise StoreError(f"{output}: found no folder {output.parent}, expected one to write into")


def give(answer: Any, output: Path | None, told: str = "") -> None:
    """Print an answer, a text or a document of JSON; or write it to its file, and print what it is."""
    text = answer if isinstance(answer, str) else json.dumps(answer, ensure_ascii=False, allow_nan=False)
    if output is None:
        print(text)
        return
    write_file(output, f"{text}\n".encode())
    print(f"{output}: {output.stat().st_size:,} bytes, {told}")


def write_file(output: Path, content: bytes) -> None:
    """Write a file beside its place, and give it its name when it is whole.

    Raises
    ------
    StoreError
        The medium refuses.
    """
    under_way = output.with_name(f".{output.name}.{os.getpid()}.tmp")
    try:
        under_way.write_bytes(content)
        under_way.replace(output)
    except OSError as error:
        raise StoreError(f"{output}: cannot be written: {error.strerror}") from error
    finally:
        under_way.unlink(missing_ok=True)
