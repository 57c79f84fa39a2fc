"""Rules, their page and their fixtures hold together: each fixture yields exactly the code of its name."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from rule_fixtures import BASES, FIXTURES, FOLDER, INDEX, base_of, build_base, damage

from vpfx.registry import table
from vpfx.validate import RULES, STORE_RULES, VPF_RULES, Report, validate
from vpfx.validate.report import SEVERITIES, Defects, Finding, Rule
from vpfx.validate.run import Stage, chosen_rules, in_order, run

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "specs" / "rules.md").read_text(encoding="utf-8")
CODES = {rule.code: rule for rule in RULES.values()}


def sections():
    """Return what the page says of each rule, by the heading of its section."""
    parts = re.split(r"^### ", PAGE, flags=re.MULTILINE)[1:]
    return {part.splitlines()[0]: re.split(r"^## ", part, flags=re.MULTILINE)[0] for part in parts}


@pytest.fixture(scope="module")
def bases(tmp_path_factory):
    """Build each base when it is first asked for."""
    built = {}

    def get(name):
        if name not in built:
            built[name] = build_base(name, tmp_path_factory.mktemp(name))
        return built[name]

    return get


def dem_of(path, code):
    """Return the elevation file of a store for rules that need it."""
    return [path.with_suffix(".tif")] if code.startswith("V52") else ()


def test_codes_are_given_once():
    assert len(CODES) == len(RULES) == len(STORE_RULES) + len(VPF_RULES)
    for code, rule in CODES.items():
        assert re.fullmatch(r"V[1-9]\d\d", code)
        assert re.fullmatch(r"[a-z][a-z_0-9]+", rule.name)
        assert rule.severity in SEVERITIES
        assert rule.title == rule.title.strip(" .")


def test_every_rule_has_its_section():
    assert list(sections()) == [f"{code} {CODES[code].name}" for code in sorted(CODES)]


@pytest.mark.parametrize("code", sorted(CODES))
def test_section_says_what_the_rule_says(code):
    rule, section = CODES[code], sections()[f"{code} {CODES[code].name}"]
    assert section.splitlines()[2] == f"*{rule.requirement}, {rule.severity}*: {rule.title}."
    assert "\n**Why.** " in section
    assert "\n**Mend.** " in section


def test_every_rule_has_its_fixture():
    assert sorted(FIXTURES) == sorted(CODES)
    assert [path.stem for path in FIXTURES.values()] == [f"{code}_{CODES[code].name}" for code in FIXTURES]
    assert sorted(INDEX) == sorted(path.name for path in FIXTURES.values())
    assert sorted(path.name for path in FOLDER.iterdir()) == ["INDEX.toml", *sorted(INDEX)]
    assert all(entry["description"] for entry in INDEX.values())


@pytest.mark.parametrize("code", sorted(rule.code for rule in STORE_RULES.values()))
def test_fixture_yields_exactly_its_code(code, bases, tmp_path):
    fixture = FIXTURES[code]
    path = damage(bases(base_of(fixture)), fixture, tmp_path / "a.gpkg")
    report = validate(path, dem=dem_of(bases(base_of(fixture)), code))
    assert {finding.code for finding in report.findings} == {code}, report.findings[:9]
    for finding in report.findings:
        assert (finding.severity, finding.requirement) == (CODES[code].severity, CODES[code].requirement)
    assert report.ok == (CODES[code].severity != "error")


@pytest.mark.parametrize("name", BASES)
def test_bases_are_clean(name, bases):
    for dem in ((), [bases(name).with_suffix(".tif")]):
        assert validate(bases(name), dem=dem) == Report(bases(name), (), ())


def test_every_requirement_that_can_be_checked_has_a_rule():
    """The table at the end of the page names each requirement once, with all rules that cite it."""
    rows = re.findall(r"^\| (R-\d{3}.*?) \| (.*?) \|$", PAGE, re.MULTILINE)
    told = {}
    for requirements, rules in rows:
        for number in re.findall(r"R-\d{3}", requirements):
            told[number] = set(re.findall(r"V\d{3}", rules))
    for rule in STORE_RULES.values():
        assert rule.code in told[rule.requirement]
    form = (ROOT / "specs" / "format.md").read_text(encoding="utf-8")
    assert set(told) | {"R-231", "R-232", "R-233"} == set(re.findall(r"^### (R-\d{3})", form, re.MULTILINE))


def test_needs_are_rules_of_the_same_kind():
    for family in (STORE_RULES, VPF_RULES):
        for rule in family.values():
            assert set(rule.needs) <= set(family) - {rule.name}
    names = [rule.name for rule in in_order(RULES)]
    assert all(names.index(need) < names.index(name) for name in names for need in RULES[name].needs)


def test_a_report_is_neither_true_nor_false():
    finding = Finding("V401", "warning", "face=1", "found something", "R-170")
    report = Report(Path("a"), (finding,), ())
    assert report.ok
    assert not report._replace(findings=(finding, finding._replace(severity="error"))).ok
    with pytest.raises(TypeError, match=r"ask for report\.ok"):
        bool(report)


def counting(n_defect):
    """Return a check that finds some defects and names few."""
    return lambda _: [Defects(n_defect, lambda i: (f"face={i}", "wrong"))] if n_defect else []


def test_many_findings_of_a_rule_are_counted():
    rules = table(Rule("V401", "wrong", "error", "R-170", "wrong", counting(10**9)))
    findings, _ = run(rules, [Stage("store", None, (key,)) for key in "ab"], rules["wrong"])
    assert len(findings) == 101
    assert findings[99].where == "face=99"
    assert findings[100].message == "found 1,999,999,900 more, 2,000,000,000 in all"


def test_a_broken_rule_keeps_others_back_where_it_is_broken():
    """What is found at a level says nothing of another one, and what is found in all holds everywhere."""
    rules = table(
        Rule("V201", "first", "error", "R-120", "", lambda context: counting(int(context == 1))(None), "level"),
        Rule("V301", "second", "error", "R-120", "", counting(1), "level", ("first",)),
        Rule("V302", "third", "error", "R-120", "", counting(1), "step", ("second",)),
        Rule("V303", "fourth", "error", "R-120", "", counting(0), "level", ("third",)),
    )
    stages = [Stage("level", 0, ("0",)), Stage("level", 1, ("1",)), Stage("step", 1, ("0", "1"))]
    findings, left_out = run(
        rules, [*stages, *(Stage("level", 0, (key,)) for key in ("2", "0/9", "00", "1/9"))], rules["first"]
    )
    assert [finding.code for finding in findings] == ["V201", "V301", "V301", "V301", "V301"]  # not at 1, nor at 1/9
    assert left_out == [("V301", "needs V201"), ("V302", "needs V301"), ("V303", "needs V302")]


def test_patterns_choose_rules():
    assert list(chosen_rules(RULES, ["V104"])) == [
        "no_database",
        "file_size",
        "unreadable",
        "no_store",
        "schema",
        "integrity",
    ]
    assert set(RULES) - set(chosen_rules(RULES, [], ["schema"])) >= {"schema", "integrity", "unknown_version"}
    assert list(chosen_rules(RULES, ["v901"])) == list(chosen_rules(RULES, ["no_data*"])) == ["no_database"]
