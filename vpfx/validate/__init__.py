"""Validation: rules with stable codes, what they find, and `validate`, which follows them.

A file of rules lists them in its ``RULES``; the tables here put them together. Each has its section in specs/rules.md and its
fixture in fixtures/invalid.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from vpfx.errors import InputError, NotFoundError, StoreError
from vpfx.registry import table
from vpfx.validate import (
    attributes,
    container,
    digests,
    geopackage,
    ground,
    hierarchy,
    rows,
    surface,
    tables,
    tiles,
    topology,
    vpf,
)
from vpfx.validate.level_data import LevelData, StepData
from vpfx.validate.report import Finding, Report, Rule
from vpfx.validate.run import Stage, chosen_rules, run
from vpfx.validate.store_data import StoreData, open_store_data
from vpfx.validate.vpf.parts import find_target

__all__ = ["RULES", "STORE_RULES", "VPF_RULES", "Finding", "Report", "Rule", "validate"]

STORE_RULES: Mapping[str, Rule] = table(
    *container.RULES, *geopackage.RULES, *digests.RULES, *tables.RULES, *rows.RULES, *topology.RULES, *surface.RULES,
    *hierarchy.RULES, *ground.RULES, *tiles.RULES, *attributes.RULES,
)  # fmt: skip
"""Rules about stores, by name."""
VPF_RULES: Mapping[str, Rule] = vpf.RULES
"""Rules about directories of VPF, by name."""
RULES: Mapping[str, Rule] = table(*STORE_RULES.values(), *VPF_RULES.values())
"""All rules, by name."""


def validate(
    path: str | Path, *, dem: Sequence[str | Path] = (), only: Sequence[str] = (), skip: Sequence[str] = ()
) -> Report:
    """Check a store, or a directory of VPF, against the rules.

    Parameters
    ----------
    path : path
        A file: a store, or anything. Or a directory of VPF: a database, one of its libraries, or a coverage.
    dem : sequence of path
        Elevation files that the store was built from: errors are measured again, and compared.
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
    NotFoundError, StoreError, DemFormatError
        There is no such file, the system refuses to read it, somebody is writing; the directory has nothing of VPF; an
        elevation file cannot be read.

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
    try:
        is_folder, is_file = path.is_dir(), path.is_file()
    except OSError as error:
        raise StoreError(f"{path}: cannot be read: {error.strerror}") from error
    if is_folder:
        if dem:
            raise InputError(
                f"{path}: found a directory of VPF with elevation files, expected a store: only that is measured"
            )
        return _validate_vpf(path, only, skip)
    if not is_file:
        raise NotFoundError(f"{path}: found no such file, expected a store")
    rules = chosen_rules(STORE_RULES, only, skip)
    with open_store_data(path, dem) as data:
        findings, left_out = run(rules, _store_stages(data), STORE_RULES["unreadable"])
    return Report(path, tuple(findings), tuple(left_out))


def _validate_vpf(path: Path, only: Sequence[str], skip: Sequence[str]) -> Report:
    rules = chosen_rules(VPF_RULES, only, skip)
    target = find_target(path)
    if target is None:
        raise NotFoundError(f"{path}: found nothing of VPF, expected a database, a library or a coverage")
    findings, left_out = run(rules, vpf.vpf_stages(target), VPF_RULES["table_header"])
    return Report(path, tuple(findings), tuple(left_out))


def _store_stages(data: StoreData) -> Iterator[Stage]:
    """What the rules of stores look at: the file, then level by level, each with the one before."""
    yield Stage("store", data)
    coarse = None
    for number in range(data.n_level):
        fine = LevelData(data, number)
        yield Stage("level", fine, (f"level {number}",))
        if coarse is not None:
            yield Stage("step", StepData(coarse, fine), (f"level {number - 1}", f"level {number}"))
        coarse = fine
