"""Real VPF: counts on which independent readers agree, faces without face tables, and OGDI feature by feature."""

from __future__ import annotations

import shutil
import subprocess

import numpy as np
import pytest
import shapely
from conftest import shared_vpf

from vpfx.vpf.opening import feature_classes, open_coverages
from vpfx.vpf.reader import read_class, read_primitives


def test_real_boundaries():
    """Counts on which independent readers agree; see ../shared/data/vpf/PROVENANCE.md."""
    root = shared_vpf("vm2alv2_texash")
    opened = open_coverages(root)
    rows = {}
    for coverage in opened.coverages:
        for name, one in feature_classes(coverage)[0].items():
            rows[name] = read_class(coverage, one)
    assert {name: len(found.geometry) for name, found in rows.items()} == {
        "tileref": 1, "tilereft": 1, "markersp": 40, "polbndl": 2, "polbnda": 6, "bndtxt": 4,
    }  # fmt: skip
    assert all(found.problems == () for found in rows.values())
    assert not any(shapely.is_missing(found.geometry).any() for found in rows.values())
    assert not any(shapely.has_z(found.geometry).any() for found in rows.values())  # the heights are no numbers
    assert shapely.get_num_coordinates(rows["polbndl"].geometry).sum() == 20
    bounds = shapely.total_bounds(rows["tileref"].geometry)
    assert np.allclose(bounds, (-97.750298, 31.000177, -97.500290, 31.250172), atol=1e-6)
    assert rows["bndtxt"].fields["string"].to_list()[1] == "BELL COUNTY"
    (bnd,) = (coverage for coverage in opened.coverages if coverage.name == "bnd")
    edges = read_primitives(bnd, "edg")
    assert (len(edges.geometry), shapely.get_num_coordinates(edges.geometry).sum()) == (23, 905)
    faces = read_primitives(bnd, "fac")
    assert shapely.is_valid(faces.geometry).all()
    tile = rows["tileref"].geometry[0]
    assert shapely.area(faces.geometry).sum() == pytest.approx(tile.area, rel=1e-3)


def test_real_coastline_without_face_tables():
    """Rings of 683 faces from the edges alone: the universe, and a ring clockwise and others counter-clockwise."""
    coverage = open_coverages(shared_vpf("dnc13_coa/browse/coa")).coverages[0]
    edges, faces = (read_primitives(coverage, name) for name in ("edg", "fac"))
    assert (len(edges.geometry), shapely.get_num_coordinates(edges.geometry).sum()) == (996, 26867)
    assert faces.problems == ()
    assert faces.fields["id"].to_list() == list(range(2, 684))
    assert set(shapely.get_type_id(faces.geometry)) == {3}
    assert shapely.is_valid(faces.geometry).all()
    assert shapely.get_num_interior_rings(faces.geometry).sum() == 537  # with the one of the universe 538
    assert shapely.get_num_interior_rings(faces.geometry[537 - 2]) == 536
    assert shapely.area(shapely.union_all(faces.geometry)) == pytest.approx(
        shapely.area(faces.geometry).sum(), rel=1e-9
    )


def ogdi_features(library):
    """Features as OGDI reads them: by layer, values and geometry as WKT."""
    if shutil.which("ogrinfo") is None:
        pytest.skip("ogrinfo is absent")
    formats = subprocess.run(["ogrinfo", "--formats"], capture_output=True, text=True, check=True).stdout
    if "OGDI" not in formats:
        pytest.skip("ogrinfo has no OGDI")
    command = ["ogrinfo", "-ro", "-al", f"gltp:/vrf{library.resolve()}"]
    told = subprocess.run(command, capture_output=True, text=True, check=True, encoding="latin-1").stdout
    layers, name = {}, ""
    for line in told.splitlines():
        if line.startswith("Layer name: "):
            name = line.split(": ")[1].split("@")[0]
            layers[name] = []
        elif line.startswith("OGRFeature("):
            layers[name].append([{}, ""])
        elif line.startswith("  ") and layers.get(name):
            field, is_field, value = line.strip().partition(" = ")
            if is_field:
                layers[name][-1][0][field.split(" (")[0]] = value.strip()
            elif line.strip().startswith(("POINT", "LINESTRING", "POLYGON", "MULTI")):
                layers[name][-1][1] = line.strip()
    return layers


def test_another_reader_finds_the_same():
    """Values and geometries of OGDI, feature by feature."""
    root = shared_vpf("vm2alv2_texash")
    found = ogdi_features(root / "texash")
    assert {name: len(rows) for name, rows in found.items()} == {
        "tileref": 1, "tilereft": 1, "markersp": 40, "polbndl": 2, "polbnda": 6, "bndtxt": 4,
    }  # fmt: skip
    for coverage in open_coverages(root).coverages:
        for name, one in feature_classes(coverage)[0].items():
            rows = read_class(coverage, one)
            for i, (values, wkt) in enumerate(found[name]):
                same_values(values, {field: column.to_list()[i] for field, column in rows.fields.items()})
                other = shapely.from_wkt(wkt)
                if one.kind == "T":  # OGDI has the first place of a text alone
                    place = shapely.Point(rows.geometry[i].coords[0])
                    assert place.distance(other) < 1e-5
                elif one.kind == "A":  # decimals are cut; OGDI has a node of the ring twice
                    assert rows.geometry[i].hausdorff_distance(other) < 1e-11
                    assert (
                        shapely.symmetric_difference(shapely.set_precision(other, 1e-9), rows.geometry[i]).area < 1e-9
                    )
                else:
                    assert rows.geometry[i].equals_exact(other, 1e-11)


def same_values(values, own):
    """OGDI knows no nulls: text nulls stand as they are, and numbers as their patterns."""
    for field, value in values.items():
        mine = own["string" if field == "text" else field]
        if mine is None:
            assert value in ("", "N/A", "-", "--", "-32768", "-32767", "nan", str(-(2**31)), str(1 - 2**31)), field
        elif isinstance(mine, float):
            assert float(value) == pytest.approx(mine)
        else:
            assert value == str(mine).strip(), field
