"""Rules about VPF: each fixture yields exactly its code, valid directories none, real ones what is true of them."""

from __future__ import annotations

import random
import shutil
import struct
from pathlib import Path

import numpy as np
import pytest
from rule_fixtures import FIXTURES
from vpf_fixtures import VPF_BASES, build_vpf_base, damage_vpf, edit, read_rows, run, write_rows

from vpfx.errors import InputError, NotFoundError
from vpfx.validate import VPF_RULES, Report, validate
from vpfx.validate.vpf.folders import kind_of

CODES = {rule.code: rule for rule in VPF_RULES.values()}
DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "vpf"

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


def test_broken_tables_of_hierarchies_are_told(bases, tmp_path):
    """What needs a table is left out, in a library without its database too."""
    root = shutil.copytree(bases("soils"), tmp_path / "soils")
    table = root / "terrain/tin1/tinface.aft"
    table.write_bytes(table.read_bytes()[:200])
    alone = shutil.copytree(root / "terrain", tmp_path / "alone" / "terrain")
    for path in (root, alone):
        report = validate(path)
        assert codes(report) == {"V700"}
        assert {"V770", "V774", "V787"} <= set(dict(report.left_out))


def test_a_lattice_of_too_many_tiles_is_told(bases, tmp_path):
    root = shutil.copytree(bases("soils"), tmp_path / "soils")
    header, fields, rows = read_rows(root / "terrain/tin0/evpf.rat")
    for row in rows:
        if row[1].rstrip() == b"lattice":
            row[2] = b'{"n_row": 2000000000, "n_col": 2000000000, "x0": 0, "y0": 0, "dx": 1, "dy": 1}'
        elif row[1].rstrip() == b"tile_size":
            row[2] = b"8"
    assert fields[2].count < 0
    write_rows(root / "terrain/tin0/evpf.rat", header, rows)
    report = validate(root)
    assert codes(report) == {"V772"}
    assert "1048576 tiles" in report.findings[0].message


@pytest.mark.parametrize("kind", ["K", "X", "C"])
def test_ids_of_any_type_end_nothing(kind, bases, tmp_path):
    """The row of a level, and a column that an index is about, may have columns that are no numbers."""
    root = shutil.copytree(bases("soils"), tmp_path / "soils")
    value = {"K": (1, 0, 0), "X": [], "C": [(1.0, 2.0)]}[kind]
    for name, column in (("level.rat", "id"), ("tinface.aft", "tile_id")):
        path = root / "terrain" / "tin1" / name
        header, fields, rows = read_rows(path)
        at = [field.name for field in fields].index(column)
        old = f"{column}={fields[at].kind},1"
        assert old in header
        for row in rows:
            row[at] = value
        write_rows(path, header.replace(old, f"{column}={kind},1"), rows)
    assert judge_damaged(root).findings


@pytest.mark.parametrize("count", ["2", "*"])
def test_columns_of_several_elements_end_nothing(count, bases, tmp_path):
    """Numbers and codes may come several in a row; each is looked at, and told in its row."""
    root = shutil.copytree(bases("town"), tmp_path / "town")
    path = root / "lib" / "land" / "area.aft"
    header = "L;Areas;-;id=I,1,P,Row,-,-,-,:kind=S,{0},N,Kind,int.vdt,-,-,:fac_id=I,1,N,Face,-,-,-,:;"
    lead = b"" if count == "2" else struct.pack("<i", 2)
    text = header.format(count).encode()
    rows = [
        struct.pack("<i", i) + lead + struct.pack("<2h", i, null) + struct.pack("<i", 2)
        for i, null in ((1, 5), (2, -32767))
    ]
    path.write_bytes(struct.pack("<i", len(text)) + text + b"".join(rows))
    found = {(finding.code, finding.where) for finding in judge_damaged(root).findings}
    assert ("V769", "table=lib/land/area.aft column=kind row=2") in found


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
    """Validate what may be anything: a report, or a word that there is no VPF."""
    try:
        report = validate(root)
    except NotFoundError:
        assert not any((root / name).is_file() for name in ("lat", "dht"))
        return None
    for finding in report.findings:
        assert finding.code in CODES
        assert "\n" not in finding.message
    return report


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("base", ["town", "soils"])
def test_damaged_directories_give_findings(seed, base, bases, tmp_path):
    """Files cut, bytes changed, files gone: no exception, whatever the place."""
    rng = np.random.default_rng([seed, len(base)])
    root = shutil.copytree(bases(base), tmp_path / base)
    files = files_of(root)
    for path in rng.choice(files, 4, replace=False):
        data = bytearray(path.read_bytes())
        way = int(rng.integers(4))
        if way == 0:
            del data[int(rng.integers(len(data))) :]
        elif way == 1:
            for at in rng.integers(0, len(data), 6):
                data[at] = int(rng.integers(256))
        elif way == 2:
            at = int(rng.integers(max(1, len(data) - 4)))
            data[at : at + 4] = rng.choice([b"\xff\xff\xff\x7f", b"\0\0\0\x80", b"\xff\xff\xff\xff", b"\0\0\xc0\x7f"])
        path.write_bytes(data)
        if way == 3:
            path.unlink()
    judge_damaged(root)


@pytest.mark.slow
@pytest.mark.parametrize(("base", "n_file"), [("town", 12), ("junction", 4), ("soils", 6)])
def test_files_cut_and_gone(base, n_file, bases, tmp_path):
    """Each table that is cut, empty or gone is told; feature indexes may be gone where there is no hierarchy."""
    root = shutil.copytree(bases(base), tmp_path / base)
    for path in random.Random(base).sample(files_of(root), n_file):
        data, kind = path.read_bytes(), kind_of(path.name)
        for part in (data[: len(data) // 2], data[:-1], b"", data + b"\0", None):
            path.unlink()
            if part is not None:
                path.write_bytes(part)
            report = judge_damaged(root)
            is_optional = part is None and kind == "fit" and base == "town"
            if kind and not is_optional and report is not None:
                assert report.findings, (path, part)
            path.write_bytes(data)
    assert validate(root).findings == ()


@pytest.mark.parametrize("base", ["town", "soils"])
def test_headers_cut_are_told_of_each_table(base, bases, tmp_path):
    """Of all tables at once the half is left: each is named."""
    root = shutil.copytree(bases(base), tmp_path / base)
    tables = [path for path in files_of(root) if kind_of(path.name)]
    for path in tables:
        path.write_bytes(path.read_bytes()[:40])
    named = {finding.where for finding in judge_damaged(root).findings if finding.code == "V700"}
    names = [path.relative_to(root) for path in tables]
    assert named >= {f"table={name}" for name in names if len(name.parts) <= 3}  # deeper ones are found by others


@pytest.mark.slow
@pytest.mark.parametrize(("base", "share"), [("town", 4), ("soils", 16)])
def test_columns_of_other_types_are_told(base, share, bases, tmp_path):
    """Columns get another type, their bytes stay as they are or their values go: no exception."""
    rng = random.Random(base)
    root = shutil.copytree(bases(base), tmp_path / base)
    tables = [path for path in files_of(root) if kind_of(path.name)]
    for path in rng.sample(tables, len(tables) // share):
        data = path.read_bytes()
        header, fields, _ = read_rows(path)
        for field in fields:
            count = "*" if field.count < 0 else str(field.count)
            old, new = f"{field.name}={field.kind},{count},", f"{field.name}={rng.choice('TISRKXC')},1,"
            if old != new:
                text = header.replace(old, new).encode("latin-1")
                for rows in (b"", data[4 + len(header) :]):
                    path.write_bytes(len(text).to_bytes(4, "little") + text + rows)
                    judge_damaged(root)
        path.write_bytes(data)
