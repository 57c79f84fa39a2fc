"""Rules about VPF: each fixture yields exactly its code, valid directories none, real ones what is true of them."""

from __future__ import annotations

import random
import shutil
import time
from pathlib import Path

import numpy as np
import pytest
from rule_fixtures import FIXTURES
from vpf_fixtures import VPF_BASES, build_vpf_base, damage_vpf, edit, read_rows, run

from vpfx.errors import InputError, NotFoundError
from vpfx.validate import VPF_RULES, Report, validate

CODES = {rule.code: rule for rule in VPF_RULES.values()}
DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "vpf"
LONGEST = 60.0  # seconds that a validation of a small directory may take, whatever is in it

real_data = pytest.mark.skipif(not DATA.is_dir(), reason="real VPF data is not beside the checkout")


@pytest.fixture(scope="module")
def bases(tmp_path_factory):
    """Make each base when it is first asked for."""
    made = {}

    def get(name):
        if name not in made:
            made[name] = build_vpf_base(name, tmp_path_factory.mktemp(name))
        return made[name]

    return get


def codes(report):
    return {finding.code for finding in report.findings}


@pytest.mark.parametrize("name", VPF_BASES)
def test_bases_are_clean(name, bases):
    assert validate(bases(name)) == Report(bases(name), (), ())


@pytest.mark.parametrize("code", sorted(CODES))
def test_fixture_yields_exactly_its_code(code, bases, tmp_path):
    fixture = FIXTURES[code]
    base = fixture.read_text(encoding="utf-8").split('"')[1]
    report = validate(damage_vpf(bases(base), fixture, tmp_path / base))
    assert codes(report) == {code}, report.findings[:9]
    for finding in report.findings:
        assert (finding.severity, finding.requirement) == (CODES[code].severity, CODES[code].requirement)
        assert finding.where
        assert "found" in finding.message
    assert report.ok == (CODES[code].severity != "error")


@pytest.mark.parametrize("options", [["--double"], ["--upper"]])
def test_forms_of_export_are_told_and_no_more(options, bases, tmp_path):
    store = bases("voids").with_suffix(".gpkg")
    target = tmp_path / ("VOIDS" if options == ["--upper"] else "voids")
    run("export", str(store), "--to", "vpf", "-o", str(target), "--quiet", *options)
    report = validate(target)
    assert report.ok
    assert codes(report) == {"V763"} if options == ["--double"] else {"V761"}


def test_parts_of_a_database(bases, tmp_path):
    """A library or a coverage can be checked alone; what stands above it counts, and what is wrong elsewhere does not."""
    town = shutil.copytree(bases("town"), tmp_path / "town")
    for part in ("lib", "lib/land", "lib/tileref"):
        assert validate(town / part).findings == ()
    edit(town, {"table": "lib/land/00/00/edg", "row": 4, "column": "right_edge", "value": [9, 0, 0]})
    assert validate(town / "lib" / "tileref").findings == ()
    for part in ("lib", "lib/land"):
        assert codes(validate(town / part)) == {"V720"}
    shutil.copytree(town / "lib" / "land" / "00" / "01", tmp_path / "alone")
    assert codes(validate(tmp_path / "alone")) == set()


def test_what_is_no_vpf_is_refused(tmp_path):
    (tmp_path / "readme").write_text("Nothing here.")
    with pytest.raises(NotFoundError, match="found nothing of VPF"):
        validate(tmp_path)
    with pytest.raises(InputError, match="found a directory of VPF with elevation files"):
        validate(tmp_path, dem=["a.tif"])


def test_one_broken_table_hides_no_other(bases, tmp_path):
    """A tile that cannot be read leaves the other one to be judged, and what needs both out."""
    town = shutil.copytree(bases("town"), tmp_path / "town")
    (town / "lib/land/00/00/edg").write_bytes(b"\xff" * 99)
    edit(town, {"table": "lib/land/00/01/edg", "row": 4, "column": "right_edge", "value": [2, 0, 0]})
    edit(town, {"delete": "lib/lht"})
    report = validate(town)
    assert codes(report) == {"V700", "V711", "V722"}
    assert dict(report.left_out)["V720"].startswith("needs V700")


def test_names_do_not_lead_elsewhere(bases, tmp_path):
    """Links and paths out of the database are told and not followed."""
    outside = tmp_path / "outside"
    shutil.copytree(bases("town") / "lib" / "land", outside)
    town = shutil.copytree(bases("town"), tmp_path / "town")
    shutil.rmtree(town / "lib" / "land")
    (town / "lib" / "land").symlink_to(outside)
    assert codes(validate(town)) == {"V710", "V712"}
    town = shutil.copytree(bases("town"), tmp_path / "again")
    edit(town, {"table": "lib/tileref/tileref.aft", "row": 1, "column": "tile_name", "value": r"..\..\..\outside"})
    assert "V740" in codes(validate(town))
    edit(town, {"table": "lib/land/fcs", "row": 9, "column": "table1", "value": "../t.tft"})
    assert {"V714", "V740"} <= codes(validate(town))
    (town / "lib" / "land" / "loop").symlink_to(town)
    assert "V710" not in codes(validate(town))


@real_data
def test_real_database_has_few_true_findings():
    """The VMap 2 prototype: each finding was looked up in the bytes by hand."""
    report = validate(DATA / "vm2alv2_texash")
    found = [(finding.code, finding.where) for finding in report.findings]
    assert found == [
        ("V702", "table=texash/tileref/tileref.aft"),  # a line feed
        ("V706", "table=texash/bnd/fcs row=3"),  # ids 1 2 7 8 11 ... 15
        ("V709", "table=dht column=edition_date row=1"),  # 199311150000000.0000
        ("V712", "table=lat"),  # an extract: one of four libraries
        ("V712", "table=dht column=database_name"),  # vmaplv2 in a folder of another name
        ("V712", "table=texash/cat"),  # two of eleven coverages
        ("V716", "table=texash/bnd/fca"),  # barrierl and bndvoida are not in fcs
        ("V717", "table=texash/dqt"),  # lineage.doc
        ("V717", "table=texash/bnd/markersp.pft column=f_code"),
        ("V717", "table=texash/bnd/markersp.pft column=tile_id"),
        ("V737", "table=texash/bnd/f/j/hb/1500/rng"),  # face 1 has the row without start edge alone
        ("V737", "table=texash/tileref/rng"),
        ("V741", "tile=texash/bnd/f/j/hb/1500"),  # -97.7502975 is west of -97.7502899
        ("V745", "tile=texash/bnd/f/j/hb/1500"),  # lat is rounded to quarters of a degree
        ("V745", "tile=texash/tileref"),
        *(("V751", f"table=texash/bnd/f/j/hb/1500/fbr row={row}") for row in (2, 4, 5, 6)),  # the same number
        ("V751", "table=texash/tileref/fbr row=2"),
        ("V769", "table=texash/bnd/f/j/hb/1500/rng column=start_edge row=1"),  # -2147483647
        ("V769", "table=texash/tileref/fac column=tileref.aft_id row=1"),
        ("V769", "table=texash/tileref/rng column=start_edge row=1"),
    ]
    assert report.left_out == (("V764", "needs V745"),)


@real_data
def test_real_primitives_obey_the_links():
    """The coastline of DNC 13: edges and nodes without faces around them."""
    report = validate(DATA / "dnc13_coa" / "browse" / "coa")
    assert {(finding.code, finding.message[:20]) for finding in report.findings} == {
        ("V711", "found no table 'fac'"),
        ("V711", "found no table 'rng'"),
        ("V762", "found ebr not there,"),
    }


def files_of(root):
    return sorted(path for path in root.rglob("*") if path.is_file())


def judge_damaged(root):
    """Validate what may be anything: a report in time, and the same again."""
    start = time.monotonic()
    try:
        report = validate(root)
    except NotFoundError:
        assert not any((root / name).is_file() for name in ("lat", "dht"))
        return None
    assert time.monotonic() - start < LONGEST
    for finding in report.findings:
        assert finding.code in CODES
        assert "\n" not in finding.message
    return report


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("base", ["town", "soils"])
def test_damaged_directories_give_findings(seed, base, bases, tmp_path):
    """Files cut, bytes changed, files gone: no exception, whatever the place."""
    random = np.random.default_rng([seed, len(base)])
    root = shutil.copytree(bases(base), tmp_path / base)
    files = files_of(root)
    for path in random.choice(files, 4, replace=False):
        data = bytearray(path.read_bytes())
        way = int(random.integers(4))
        if way == 0:
            del data[int(random.integers(len(data))) :]
        elif way == 1:
            for at in random.integers(0, len(data), 6):
                data[at] = int(random.integers(256))
        elif way == 2:
            at = int(random.integers(max(1, len(data) - 4)))
            data[at : at + 4] = random.choice(
                [b"\xff\xff\xff\x7f", b"\0\0\0\x80", b"\xff\xff\xff\xff", b"\0\0\xc0\x7f"]
            )
        path.write_bytes(data)
        if way == 3:
            path.unlink()
    judge_damaged(root)


@pytest.mark.slow
@pytest.mark.xfail(reason="known: some damaged tables of hierarchies still end the validation", strict=False)
@pytest.mark.parametrize("base", ["town", "junction"])
def test_files_cut_and_gone(base, bases, tmp_path):
    root = shutil.copytree(bases(base), tmp_path / base)
    for path in files_of(root)[::3]:
        data = path.read_bytes()
        for part in (data[: len(data) // 2], data[:-1], b"", data + b"\0", None):
            path.unlink()
            if part is not None:
                path.write_bytes(part)
            judge_damaged(root)
            path.write_bytes(data)
    assert validate(root).findings == ()


@pytest.mark.slow
@pytest.mark.xfail(reason="known: some damaged tables of hierarchies still end the validation", strict=False)
@pytest.mark.parametrize("base", ["town", "soils"])
def test_columns_of_other_types_are_told(base, bases, tmp_path):
    """Columns get another type, their bytes stay as they are or their values go: no exception."""
    rng = random.Random(base)
    root = shutil.copytree(bases(base), tmp_path / base)
    for path in files_of(root):
        data = path.read_bytes()
        if path.suffix in (".ati", ".pti", ".lti") or path.name[-2:] in ("si", "ax", "dx", "nx", "fx", "dz"):
            continue
        try:
            header, fields, _ = read_rows(path)
        except (ValueError, IndexError):
            continue
        for field in fields[1:]:
            for kind in rng.sample("TISRKXC", 1):
                count = "*" if field.count < 0 else str(field.count)
                old, new = f"{field.name}={field.kind},{count},", f"{field.name}={kind},1,"
                if old != new and old in header:
                    text = header.replace(old, new).encode("latin-1")
                    path.write_bytes(len(text).to_bytes(4, "little") + text)
                    judge_damaged(root)
                    path.write_bytes(len(text).to_bytes(4, "little") + text + data[4 + len(header) :])
                    judge_damaged(root)
        path.write_bytes(data)
