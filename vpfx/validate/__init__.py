"""Validation: rules with stable codes, what they find, and `validate`, which follows them.

A file of rules lists them in its ``RULES``; the tables here put them together. Each has its section in specs/rules.md and its
fixture in fixtures/invalid.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from vpfx.errors import InputError, NotFoundError
from vpfx.registry import table
from vpfx.validate import container, unreadable
from vpfx.validate.report import Finding, Report, Rule
from vpfx.validate.run import Stage, chosen_rules, run
from vpfx.validate.store_data import StoreData, open_store_data

__all__ = ["RULES", "STORE_RULES", "VPF_RULES", "Finding", "Report", "Rule", "validate"]

STORE_RULES: Mapping[str, Rule] = table(*container.RULES, *unreadable.RULES)
"""Rules about stores, by name."""
VPF_RULES: Mapping[str, Rule] = table()
"""Rules about directories of VPF, by name."""
RULES: Mapping[str, Rule] = table(*STORE_RULES.values(), *VPF_RULES.values())
"""All rules, by name."""


def validate(path: str | Path, *, only: Sequence[str] = (), skip: Sequence[str] = ()) -> Report:
    """Check a store against the rules.

    Parameters
    ----------
    path : path
        The file. Anything may be in it.
    only : sequence of str
        Beginnings of codes or names of the rules to follow, with all that those need; all if empty.
    skip : sequence of str
        Of the rules not to follow.

    Returns
    -------
    Report
        Ask it for `ok`.

    Raises
    ------
    InputError
        A pattern is about no rule.
    NotFoundError, StoreError
        There is no such file, the system refuses to read it, or somebody is writing.

    Examples
    --------
    >>> from tempfile import mkdtemp
    >>> path = Path(mkdtemp()) / "note.gpkg"
    >>> _ = path.write_text("Triangles are at home.")
    >>> report = validate(path)
    >>> report.ok, report.findings[0].code, report.findings[0].message
    (False, 'V901', 'found a text, expected a store: a database of SQLite')
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: found a folder, expected a store: directories of VPF are not checked")
    if not path.is_file():
        raise NotFoundError(f"{path}: found no such file, expected a store")
    rules = chosen_rules(STORE_RULES, only, skip)
    with open_store_data(path) as data:
        findings, left_out = run(rules, _store_stages(data), STORE_RULES["unreadable"])
    return Report(path, tuple(findings), tuple(left_out))


def _store_stages(data: StoreData) -> Iterator[Stage]:
    """What the rules of stores look at."""
    yield Stage("store", data)
