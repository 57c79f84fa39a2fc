"""`vpfx sql`."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from vpfx.cli.common import app, read_stdin
from vpfx.cli.output import check_output, write_file
from vpfx.errors import InputError

__all__ = ["sql"]


@app.command()
@click.argument("store", type=click.Path(path_type=Path))
@click.argument("question", metavar="SQL|-")
@click.option(
    "--format", "form", default="table", show_default=True, help="table, csv, json or arrow (a Feather file)."
)
@click.option("-o", "--output", metavar="FILE", type=click.Path(path_type=Path), help="Write there.  [default: stdout]")
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
@click.option("--write", is_flag=True, help="Let the statement change rows of attributes: all of it, or nothing.")
def sql(store: Path, question: str, form: str, output: Path | None, overwrite: bool, write: bool) -> None:
    """Put one SQL statement to a store; - reads it from stdin.

    Nothing is changed without --write. Tables and views: specs/format.md; questions with answers: specs/sql.md.

    Example: vpfx sql n36.gpkg "SELECT level, face_count FROM level"
    """
    from vpfx.query.sql import FORMATS, Answer, answer_sql

    if form not in FORMATS:
        raise InputError(f"--format: found {form!r}, expected one of: {', '.join(FORMATS)}")
    check_output(output, overwrite, store)

    def deliver(answer: Answer) -> None:
        text = FORMATS[form](answer)
        if output is not None:
            write_file(output, text)
            return
        sys.stdout.flush()
        sys.stdout.buffer.write(text) if form == "arrow" else sys.stdout.write(text.decode("utf-8", "replace"))
        sys.stdout.flush()

    asked = read_stdin() if question == "-" else question
    answer = answer_sql(store, asked, write=write, deliver=deliver)
    if write:
        print(f"{store}: {answer.n_changed} rows changed", file=sys.stderr)
