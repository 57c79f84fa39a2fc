"""Following the rules: stage by stage, each rule where what it needs has held."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Mapping, Sequence
from fnmatch import fnmatchcase
from graphlib import TopologicalSorter
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from vpfx.errors import DemFormatError, FormatError, InputError, StoreError
from vpfx.store.connection import error_kind
from vpfx.validate.report import MOST_SHOWN, Defects, Finding, Rule, one

__all__ = ["Stage", "chosen_rules", "in_order", "matches", "run"]


class Stage(NamedTuple):
    """Something that rules of one scope look at.

    Attributes
    ----------
    scope : str
    context : object
        What the checks of the scope get; it reads what it holds when it is first asked for it.
    keys : tuple of str
        What it is about, as paths: ``("",)`` is all, ``("level 1", "level 2")`` two levels. What was found at one stage
        bears upon another if a key of one is a key of the other or a folder above it.
    """

    scope: str
    context: Any
    keys: tuple[str, ...] = ("",)


def in_order(rules: Mapping[str, Rule]) -> list[Rule]:
    """Rules in the order of their codes, but each behind those it needs.

    Raises
    ------
    graphlib.CycleError
        Rules need each other.
    """
    by_code = sorted(rules.values(), key=lambda rule: rule.code)
    sorter = TopologicalSorter({rule.name: rule.needs for rule in by_code})
    return [rules[name] for name in sorter.static_order()]


def matches(rule: Rule, pattern: str) -> bool:
    """Tell whether a pattern is about a rule: the beginning of its code, or its name, in which ``*`` stands for anything.

    Examples
    --------
    >>> rule = Rule("V401", "face_clockwise", "error", "R-170", "", lambda _: ())
    >>> [matches(rule, pattern) for pattern in ("V4", "face_*", "V5", "face")]
    [True, True, False, False]
    """
    return rule.code.startswith(pattern.upper()) or fnmatchcase(rule.name, pattern)


def chosen_rules(rules: Mapping[str, Rule], only: Sequence[str] = (), skip: Sequence[str] = ()) -> dict[str, Rule]:
    """Rules that patterns choose, with all that those need.

    Parameters
    ----------
    rules : mapping
    only : sequence of str
        Patterns (see `matches`) of the rules to follow; all if empty.
    skip : sequence of str
        Patterns of rules not to follow, nor those that need them.

    Raises
    ------
    InputError
        A pattern is about no rule.
    """
    for pattern in (*only, *skip):
        if not pattern or not any(matches(rule, pattern) for rule in rules.values()):
            raise InputError(f"rules: found {pattern!r}, expected the beginning of a code or a name; see --list-rules")
    wanted = {name for name, rule in rules.items() if not only or any(matches(rule, pattern) for pattern in only)}
    dropped = {name for name, rule in rules.items() if any(matches(rule, pattern) for pattern in skip)}
    ordered = in_order(rules)
    for rule in ordered:
        if dropped & set(rule.needs):
            dropped.add(rule.name)
    for rule in reversed(ordered):
        if rule.name in wanted:
            wanted |= set(rule.needs)
    return {rule.name: rule for rule in ordered if rule.name in wanted - dropped}


def run(
    rules: Mapping[str, Rule], stages: Iterable[Stage], refusal: Rule
) -> tuple[list[Finding], list[tuple[str, str]]]:
    """Follow rules at all stages.

    Parameters
    ----------
    rules : mapping
        Those to follow, each behind those it needs.
    stages : iterable of Stage
        Made one after the other, so that only what is looked at is in memory.
    refusal : Rule
        The one that is broken where what is checked cannot be read; it need not be one of `rules`.

    Returns
    -------
    findings : list of Finding
        In the order of codes; of each rule as they were found.
    left_out : list of (str, str)
        Codes of rules that were left out at some stage, and what they need that did not hold.
    """
    journal = _Journal(rules, refusal)
    with np.errstate(all="ignore"):  # values from a stranger's file; rules compare so that NaN is found
        for stage in stages:
            for rule in rules.values():
                if rule.scope == stage.scope and not journal.is_hopeless(rule):
                    journal.follow(rule, stage)
    return journal.findings(), sorted(journal.left_out.items())


class _Keys:
    """Where a rule was broken: keys of stages, and all folders above them, so that no question goes through all keys."""

    def __init__(self) -> None:
        self._keys: set[str] = set()
        self._above: set[str] = set()

    @property
    def are_all(self) -> bool:
        """Whether it was broken in the whole."""
        return "" in self._keys

    def add(self, keys: Iterable[str]) -> None:
        """Note some keys."""
        for key in keys:
            self._keys.add(key)
            self._above.update(_folders_above(key))

    def bear_upon(self, keys: Iterable[str]) -> bool:
        """Tell whether one of them is one of some others, or a folder above or below one."""
        return any(
            key in self._above or key in self._keys or not self._keys.isdisjoint(_folders_above(key)) for key in keys
        )


def _folders_above(key: str) -> list[str]:
    """Folders above a key, from the nearest to the whole; none of the whole itself."""
    parts = key.split("/") if key else []
    return ["/".join(parts[:n]) for n in range(len(parts) - 1, -1, -1)]


class _Journal:
    """What was found so far, and where."""

    def __init__(self, rules: Mapping[str, Rule], refusal: Rule) -> None:
        self._rules, self._refusal = {refusal.name: refusal, **rules}, refusal
        self._shown: dict[str, list[Finding]] = {name: [] for name in self._rules}
        self._count = dict.fromkeys(self._rules, 0)
        self._broken: dict[str, _Keys] = {name: _Keys() for name in self._rules}
        self.left_out: dict[str, str] = {}

    def follow(self, rule: Rule, stage: Stage) -> None:
        """Follow one rule at one stage, or say why not."""
        missing = [name for name in rule.needs if self._broken[name].bear_upon(stage.keys)]
        if missing:
            codes = ", ".join(self._rules[name].code for name in missing)
            self.left_out.setdefault(rule.code, f"needs {codes}")
            is_everywhere = any(self.is_hopeless(self._rules[name]) for name in missing)
            self._broken[rule.name].add([""] if is_everywhere else stage.keys)
            return
        try:
            for defects in rule.check(stage.context):
                self._take(rule, defects, stage)
        except DemFormatError:
            raise
        except (sqlite3.Error, UnicodeDecodeError, FormatError, OverflowError) as error:
            if error_kind(error) in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
                raise StoreError(f"cannot be read: {error}; somebody is writing, try again") from error
            reason = one("", f"found what cannot be read while {rule.code} was checked: {error}")
            self._take(self._refusal, reason, stage)
            self._broken[rule.name].add(stage.keys)

    def is_hopeless(self, rule: Rule) -> bool:
        """Tell whether a rule of a part was broken, or cannot be followed, in the whole."""
        return self._broken[rule.name].are_all

    def _take(self, rule: Rule, defects: Defects, stage: Stage) -> None:
        """Note defects; those beyond the limit are only counted."""
        shown = self._shown[rule.name]
        for i in range(min(defects.n_defect, MOST_SHOWN - len(shown))):
            where, message = defects.describe(i)
            shown.append(Finding(rule.code, rule.severity, where, message, rule.requirement))
        self._count[rule.name] += defects.n_defect
        self._broken[rule.name].add(stage.keys)

    def findings(self) -> list[Finding]:
        """All that was found, in the order of codes."""
        for name, shown in self._shown.items():
            more = self._count[name] - len(shown)
            if more > 0:
                rule = self._rules[name]
                message = f"found {more:,} more, {self._count[name]:,} in all"
                shown.append(Finding(rule.code, rule.severity, "", message, rule.requirement))
        return sorted(chain(*self._shown.values()), key=lambda finding: finding.code)
