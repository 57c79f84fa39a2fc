"""Reports and lists of rules as text, JSON and SARIF."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Mapping
from typing import Any
from urllib.parse import quote

from vpfx import __version__
from vpfx.validate.report import Report, Rule

__all__ = ["FORMS", "rules_json", "rules_text"]

RULES_PAGE = "specs/rules.md"
SARIF_SCHEMA = "https://json.schemastore.org/sarif-2.1.0.json"
Rules = Mapping[str, Rule]


def to_text(report: Report, rules: Rules) -> str:
    """Return a report as lines: ``path: place: severity V401 face_clockwise: message (R-170)``."""
    names = {rule.code: rule.name for rule in rules.values()}
    lines = []
    for code, severity, where, message, requirement in report.findings:
        place = f"{report.path}: {where}: " if where else f"{report.path}: "
        lines.append(_printable(f"{place}{severity} {code} {names[code]}: {message} ({requirement})"))
    if report.left_out:
        lines.append(f"{report.path}: not checked everywhere: {_left_out(report)}")
    counts = {severity: sum(f.severity == severity for f in report.findings) for _, severity, *_ in report.findings}
    told = ", ".join(f"{count} {severity}{'s' * (count > 1)}" for severity, count in counts.items())
    lines.append(f"{report.path}: {told or 'nothing found'}")
    return "\n".join(lines)


def _printable(text: str) -> str:
    """A line as it is, but for what would end it or steer a terminal: names in the file may hold anything."""
    return "".join(char if char.isprintable() else ascii(char)[1:-1] for char in text)


def _left_out(report: Report) -> str:
    """Rules left out, those with the same reason together."""
    reasons: dict[str, list[str]] = {}
    for code, reason in report.left_out:
        reasons.setdefault(reason, []).append(code)
    return "; ".join(f"{', '.join(codes)} ({reason})" for reason, codes in reasons.items())


def to_json(report: Report, rules: Rules) -> str:
    """Return a report as one JSON document."""
    names = {rule.code: rule.name for rule in rules.values()}
    document = {
        "path": str(report.path),
        "ok": report.ok,
        "findings": [{**finding._asdict(), "name": names[finding.code]} for finding in report.findings],
        "left_out": [{"code": code, "reason": reason} for code, reason in report.left_out],
    }
    return json.dumps(document, indent=2, ensure_ascii=False)


def to_sarif(report: Report, rules: Rules) -> str:
    """Return a report as SARIF 2.1.0, which continuous integration and editors read."""
    ordered = sorted(rules.values(), key=lambda rule: rule.code)
    index = {rule.code: i for i, rule in enumerate(ordered)}
    path = report.path
    artifact = {"uri": path.as_uri() if path.is_absolute() else quote(os.fsencode(path.as_posix()))}
    results = [
        {
            "ruleId": finding.code,
            "ruleIndex": index[finding.code],
            "level": finding.severity,
            "message": {"text": f"{finding.message} ({finding.requirement})"},
            "locations": [_location(artifact, finding.where)],
        }
        for finding in report.findings
    ]
    driver = {
        "name": "vpfx",
        "version": __version__,
        "rules": [
            {
                "id": rule.code,
                "name": rule.name,
                "shortDescription": {"text": rule.title},
                "help": {"text": f"{rule.requirement}; see {RULES_PAGE}, {rule.code}"},
                "defaultConfiguration": {"level": rule.severity},
            }
            for rule in ordered
        ],
    }
    told = [
        {"level": "note", "associatedRule": {"id": code}, "message": {"text": f"not checked everywhere: {reason}"}}
        for code, reason in report.left_out
    ]
    done = [{"executionSuccessful": True, "toolExecutionNotifications": told}]
    document = {
        "$schema": SARIF_SCHEMA,
        "version": "2.1.0",
        "runs": [{"tool": {"driver": driver}, "invocations": done, "results": results}],
    }
    return json.dumps(document, indent=2, ensure_ascii=False)


def _location(artifact: dict[str, str], where: str) -> dict[str, Any]:
    """Place of a finding: the file, and what in it."""
    location: dict[str, Any] = {"physicalLocation": {"artifactLocation": artifact}}
    if where:
        location["logicalLocations"] = [{"fullyQualifiedName": where}]
    return location


FORMS: Mapping[str, Callable[[Report, Rules], str]] = {"text": to_text, "json": to_json, "sarif": to_sarif}
"""Ways to write a report."""


def rules_text(rules: Iterable[Rule]) -> str:
    """Return rules as lines: code, name, severity, requirement, title."""
    rows = [(r.code, r.name, r.severity, r.requirement, r.title) for r in sorted(rules, key=lambda rule: rule.code)]
    widths = [max((len(row[i]) for row in rows), default=0) for i in range(4)]
    return "\n".join("  ".join([*(row[i].ljust(widths[i]) for i in range(4)), row[4]]) for row in rows)


def rules_json(rules: Iterable[Rule]) -> str:
    """Return rules as one JSON document."""
    names = ("code", "name", "severity", "requirement", "title", "needs")
    ordered = sorted(rules, key=lambda rule: rule.code)
    return json.dumps([{name: getattr(rule, name) for name in names} for rule in ordered], indent=2, ensure_ascii=False)
