"""What commands share: the group they belong to, how they end, options as values, what they print."""

from __future__ import annotations

import io
import json
import re
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from vpfx import __version__
from vpfx.errors import InputError, VpfxError, VpfxWarning
from vpfx.store.summary import LevelSummary

__all__ = [
    "PASSES",
    "announce_compilation",
    "app",
    "check_form",
    "feature_flags",
    "feature_options",
    "given_options",
    "main",
    "numbers",
    "print_json",
    "print_levels",
    "print_table",
    "progress",
    "read_stdin",
]

USAGE, FAILURE, INTERRUPTED = 2, 3, 130  # exit codes; 0 is good, 1 is for findings

PASSES = 3  # of methods that hold no bound
OF_FEATURES = {"features_layer": "layer", "features_z": "use_z"}  # options of `vpfx.features.read_features`


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a command; every error is one line on stderr and an exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        with _warnings_in_one_line():
            code = app.main(arguments, prog_name="vpfx", standalone_mode=False)
    except click.exceptions.NoArgsIsHelpError as error:
        print(error.format_message(), file=sys.stderr)
        sys.exit(USAGE)
    except click.UsageError as error:
        command = error.ctx.command_path if error.ctx else "vpfx"
        _fail(f"{command}: {error.format_message().rstrip('.')}. See: {command} --help", USAGE)
    except InputError as error:
        _fail(f"vpfx: {error}", USAGE)
    except VpfxError as error:
        _fail(f"vpfx: {error}", FAILURE)
    except OSError as error:
        _fail(f"vpfx: cannot write the output: {error}", FAILURE)
    except MemoryError:
        _fail("vpfx: found too little memory; try a smaller --tile-size or fewer --workers", FAILURE)
    except (KeyboardInterrupt, click.Abort):
        _fail("vpfx: interrupted; nothing was changed", INTERRUPTED)
    sys.exit(code or 0)


@contextmanager
def _warnings_in_one_line() -> Iterator[None]:
    """Print our own warnings as errors are, without their place in the code."""
    with warnings.catch_warnings():
        before = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
            if issubclass(category, VpfxWarning):
                print("vpfx: warning: " + " ".join(str(message).split("\n")), file=sys.stderr)
            else:
                before(message, category, *place, **more)

        warnings.simplefilter("always", VpfxWarning)
        warnings.showwarning = show
        yield


def _fail(message: str, code: int) -> None:
    print(" ".join(message.split("\n")), file=sys.stderr)
    sys.exit(code)


def numbers(text: str, name: str, kind: type) -> tuple[Any, ...]:
    """Numbers between commas."""
    try:
        return tuple(kind(part) for part in text.split(","))
    except ValueError:
        wanted = "whole numbers" if kind is int else "numbers"
        raise InputError(f"--{name}: found {text!r}, expected {wanted} between commas") from None


def read_stdin() -> str:
    """Text of stdin.

    Raises
    ------
    InputError
        It is no text.
    """
    try:
        return sys.stdin.read()
    except UnicodeDecodeError as error:
        raise InputError(f"-: found bytes that are no text ({error.reason}), expected UTF-8") from None


def given_options(values: Mapping[str, Any]) -> dict[str, Any]:
    """Options that stand on the command line, as Python values."""
    context = click.get_current_context()
    given = {
        name: value
        for name, value in values.items()
        if context.get_parameter_source(name) is ParameterSource.COMMANDLINE
    }
    for name, kind in (("max_error", float), ("max_faces", int), ("bbox", float)):
        if name in given:
            given[name] = numbers(given[name], name.replace("_", "-"), kind)
    if "grid" in given:
        given["grid"] = _grid(given["grid"])
    return given


def _grid(text: str) -> tuple[int, int]:
    """Squares of the start grid as COLUMNSxROWS."""
    found = re.fullmatch(r"([1-9][0-9]{0,5})[xX×]([1-9][0-9]{0,5})", text)
    if not found:
        raise InputError(f"--grid: found {text!r}, expected columns x rows, such as 9x9")
    return int(found[1]), int(found[2])


def feature_flags(what: str) -> Callable[[Any], Any]:
    """Add the options of features to a command."""
    options = (
        click.option("--features", multiple=True, metavar="FILE|DIR", help=what),
        click.option(
            "--features-layer", metavar="NAME", help="Layer of such a file with several; of VPF COVERAGE/CLASS."
        ),
        click.option(
            "--features-z", is_flag=True, help="Their vertices keep their own z, metres, instead of the DEM's heights."
        ),
    )

    def add(command: Any) -> Any:
        for option in reversed(options):
            command = option(command)
        return command

    return add


def feature_options(given: dict[str, Any]) -> dict[str, Any]:
    """Take the options of `vpfx.features.read_features` out of those given."""
    return {to: given.pop(name) for name, to in OF_FEATURES.items() if name in given}


def print_table(table: list[list[str]], form: str) -> None:
    """Print a table of `vpfx.report` in one of its forms."""
    from vpfx.report import FORMATS

    print(FORMATS[form](table).rstrip())


def check_form(form: str) -> None:
    """Refuse a form in which nothing is printed."""
    from vpfx.report import FORMATS

    if form not in (*FORMATS, "json"):
        raise InputError(f"--format: found {form!r}, expected one of: {', '.join(FORMATS)}, json")


@click.group(no_args_is_help=True)
@click.version_option(__version__, prog_name="vpfx", message="%(prog)s %(version)s")
def app() -> None:
    """Hierarchical TINs from elevation grids, kept as VPF-style primitive tables in one tiled GeoPackage."""


def print_json(levels: Sequence[LevelSummary], seconds: float, facts: dict[str, Any]) -> None:
    """Print levels and facts as one JSON document."""
    document = {**facts, "levels": [line._asdict() for line in levels], "seconds": round(seconds, 3)}
    print(json.dumps(document, indent=2, ensure_ascii=False))


def print_levels(levels: Sequence[LevelSummary]) -> None:
    """Print counts and errors of levels as a table."""
    table = Table(box=None, pad_edge=False)
    for title in ("level", "bound m", "max error m", "rmse m", "nodes", "edges", "faces"):
        table.add_column(title, justify="right", no_wrap=True)
    for line in levels:
        bound = "–" if line.max_error_bound is None else f"{line.max_error_bound:g}"
        table.add_row(
            str(line.level), bound, f"{line.max_error:.3f}", f"{line.rmse:.3f}", f"{line.nodes:,}", f"{line.edges:,}",
            f"{line.faces:,}",
        )  # fmt: skip
    Console(width=100, highlight=False).print(table)


@contextmanager
def progress(is_quiet: bool) -> Iterator[Any]:
    """Yield a function that shows tiles done of tiles in all: a bar on a terminal, nothing elsewhere."""
    console = Console(stderr=True)
    if is_quiet or not console.is_terminal:
        yield None
        return
    columns = TextColumn("tiles"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("tiles", total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def announce_compilation(is_quiet: bool) -> None:
    """Say that the first run compiles the kernels, if it will."""
    from vpfx.methods.scan import scan_faces

    cache = Path(scan_faces.stats.cache_path)
    if not is_quiet and not any(cache.glob("scan.scan_faces*.nbi")):
        print("vpfx: compiling kernels, once; later runs start at once", file=sys.stderr)
