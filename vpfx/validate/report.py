"""What a validation says: `Rule`, `Defects`, `Tally`, `Finding`, `Report`; plain data.

A rule's check yields `Defects`: how many there are, and how to name each. Only the first ones are named, so a million defects
cost an array, not a million texts::

    check(context) ─► Defects(n_defect, describe) ─► Finding … Finding, "and 999,900 more"
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "ERROR",
    "MOST_SHOWN",
    "NOTE",
    "SEVERITIES",
    "WARNING",
    "Defects",
    "Finding",
    "Report",
    "Rule",
    "Tally",
    "one",
    "some",
]

ERROR, WARNING, NOTE = "error", "warning", "note"
SEVERITIES = (ERROR, WARNING, NOTE)
"""From grave to light; only an error makes a report not ok."""

MOST_SHOWN = 100
"""Findings of one rule that are told; one more says how many there are."""


class Finding(NamedTuple):
    """One defect, or how many more there are.

    Attributes
    ----------
    code : str
        Of the rule, such as ``V401``.
    severity : str
        One of `SEVERITIES`.
    where : str
        Place in the file, for machines too: ``level=2 face=310``; empty if it is the file.
    message : str
        What was found and what was expected.
    requirement : str
        What is broken, such as ``R-170``.
    """

    code: str
    severity: str
    where: str
    message: str
    requirement: str


class Defects(NamedTuple):
    """Some defects of one kind that a check found.

    Attributes
    ----------
    n_defect : int
    describe : callable
        Number of a defect, from 0, to its place and message.
    """

    n_defect: int
    describe: Callable[[int], tuple[str, str]]


def one(where: str, message: str) -> Defects:
    """Return a single defect.

    Examples
    --------
    >>> one("level=2", "found no face").describe(0)
    ('level=2', 'found no face')
    """
    return Defects(1, lambda _: (where, message))


def some(index: Any, describe: Callable[[int], tuple[str, str]]) -> Iterator[Defects]:
    """Yield the defects at some indices of arrays, if there are any.

    Parameters
    ----------
    index : integers (n,)
    describe : callable
        An index to place and message.

    Examples
    --------
    >>> [found.n_defect for found in some([], str)], [found.describe(1) for found in some([4, 7], lambda i: (f"face={i}", ""))]
    ([], [('face=7', '')])
    """
    if len(index):
        yield Defects(len(index), lambda i: describe(int(index[i])))


class Tally:
    """Defects of one kind, gathered in parts: the first are told, all are counted."""

    def __init__(self) -> None:
        self.count = 0
        self._shown: list[tuple[str, str]] = []

    def add(self, index: NDArray[Any], describe: Callable[[int], tuple[str, str]]) -> None:
        """Add the defects at some indices."""
        for i in index[: MOST_SHOWN - len(self._shown)].tolist():
            self._shown.append(describe(i))
        self.count += len(index)

    def tell(self, where: str, message: str) -> None:
        """Add one defect."""
        self.add(np.zeros(1, np.int64), lambda _: (where, message))

    def defects(self) -> Iterator[Defects]:
        """Yield them, if there are any."""
        if self.count:
            yield Defects(self.count, lambda i: self._shown[i])


@dataclass(frozen=True)
class Rule:
    """A thing that has to hold.

    Attributes
    ----------
    code : str
        ``V`` and three digits; it never changes its meaning and is never given again.
    name : str
        Name in words, such as ``face_clockwise``.
    severity : str
        One of `SEVERITIES`.
    requirement : str
        What it holds, such as ``R-170``.
    title : str
        What is wrong, in a few words.
    check : callable
        Context of the scope to the `Defects` found.
    scope : str
        What it looks at: the context it gets.
    needs : tuple of str
        Names of the rules that must have found nothing there: this one would not work, or only say the same again.
    """

    code: str
    name: str
    severity: str
    requirement: str
    title: str
    check: Callable[[Any], Iterable[Defects]]
    scope: str = "store"
    needs: tuple[str, ...] = ()


class Report(NamedTuple):
    """What was found in a file or folder.

    Attributes
    ----------
    path : Path
    findings : tuple of Finding
        In the order of codes, then of places.
    left_out : tuple of (str, str)
        Codes of rules that could not be followed, everywhere or somewhere, and why: ``needs V105``.
    """

    path: Path
    findings: tuple[Finding, ...]
    left_out: tuple[tuple[str, str], ...]

    @property
    def ok(self) -> bool:
        """Whether no error was found."""
        return all(finding.severity != ERROR for finding in self.findings)

    def __bool__(self) -> NoReturn:
        """Refuse: a report is neither true nor false, ask for `ok`."""
        raise TypeError("a report is neither true nor false; ask for report.ok")
