"""`vpfx validate`."""

from __future__ import annotations

from pathlib import Path

import click

from vpfx.cli.common import app
from vpfx.errors import InputError

__all__ = ["validate"]

FINDINGS = 1  # exit code


@app.command()
@click.argument("path", required=False, type=click.Path(path_type=Path), metavar="PATH")
@click.option(
    "--dem", multiple=True, metavar="DEM", help="Elevation file it was built from: errors are measured again."
)
@click.option("--only", multiple=True, metavar="V4|NAME", help="Only rules whose code begins so, or of that name (*).")
@click.option("--skip", multiple=True, metavar="V4|NAME", help="Not these rules, nor those that need them.")
@click.option("--list-rules", is_flag=True, help="Print all rules instead.")
@click.option("--format", "form", default="text", show_default=True, help="text, json or sarif.")
def validate(
    path: Path | None, dem: tuple[str, ...], only: tuple[str, ...], skip: tuple[str, ...], list_rules: bool, form: str
) -> int | None:
    """Check a store, or a directory of VPF, against every rule: specs/rules.md.

    Exit code 0: no error; 1: errors; 2: wrong use; 3: there is nothing to check.

    Example: vpfx validate n36.gpkg --format sarif
    """
    from vpfx import validate as validating
    from vpfx.validate.forms import FORMS, rules_json, rules_text
    from vpfx.validate.run import chosen_rules

    if form not in FORMS:
        raise InputError(f"--format: found {form!r}, expected one of: {', '.join(FORMS)}")
    if list_rules:
        if form == "sarif":
            raise InputError("--format: found 'sarif' for a list of rules, expected one of: text, json")
        chosen = chosen_rules(validating.RULES, only, skip).values()
        print(rules_json(chosen) if form == "json" else rules_text(chosen))
        return None
    if path is None:
        raise click.UsageError("Missing argument 'PATH'", click.get_current_context())
    report = validating.validate(path, dem=dem, only=only, skip=skip)
    print(FORMS[form](report, validating.RULES))
    return None if report.ok else FINDINGS
