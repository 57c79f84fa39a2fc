"""Attributes of faces: inheritance against a search with dictionaries, and the view against both."""

from __future__ import annotations

import shutil
import sqlite3
from collections import defaultdict
from contextlib import closing
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from surfaces import VOIDS, hills, query, write_dem

import vpfx
from vpfx.errors import InputError, NotFoundError, StoreFormatError
from vpfx.query.attributes import attributes
from vpfx.query.horizontal import edge_neighbours
from vpfx.store.edit import edit_store

KINDS = {
    "nested": ("hills", {"max_error": (40, 20, 8)}),
    "tiles": ("hills", {"max_error": (40, 20, 10), "tile_size": 16}),
    "voids": ("void", {"passes": 2, "tile_size": 8}),
    "pyramid": ("hills", {"method": "delaunay_pyramid", "max_error": (40, 30, 20), "tile_size": 25}),
}
CLOSE = 1e-9  # shares are sums of areas that tile each other to within rounding


class Tables:
    """The tables of a store as dictionaries, and shares worked out face by face."""

    def __init__(self, path):
        with closing(sqlite3.connect(path)) as store:
            faces = store.execute("SELECT face_id, level, node_1, node_2, node_3 FROM face").fetchall()
            place = {row[0]: row[1:] for row in store.execute("SELECT node_id, x, y FROM node")}
            links = store.execute(
                "SELECT parent_face, child_face, area FROM parent_child LEFT JOIN shared_area USING (child_face, parent_face)"
            ).fetchall()
        self.level = {row[0]: row[1] for row in faces}
        self.area = {row[0]: self.area_of(*(place[node] for node in row[2:])) for row in faces}
        self.up, self.down = defaultdict(list), defaultdict(list)
        for parent, child, area in links:
            shared = self.area[child] if area is None else area
            self.up[child].append((parent, shared))
            self.down[parent].append((child, shared))
        self.own = defaultdict(dict)

    @staticmethod
    def area_of(a, b, c):
        """Area of a triangle."""
        (ax, ay), (bx, by), (cx, cy) = (tuple(map(Fraction, corner)) for corner in (a, b, c))
        return float(((bx - ax) * (cy - ay) - (cx - ax) * (by - ay)) / 2)

    def above(self, face):
        """Shares of what a face has by itself or from above."""
        if self.own[face]:
            return dict(self.own[face])
        total = defaultdict(float)
        for parent, shared in self.up[face]:
            for feature, share in self.above(parent).items():
                total[feature] += share * min(1.0, shared / self.area[face])
        return total

    def shares(self, face, inherited=None):
        """Shares of the features of a face: its own or inherited ones, with what lies below in their place."""
        inherited = self.above(face) if inherited is None else inherited
        if not self.down[face]:
            return inherited
        total, all_of_it = defaultdict(float), sum(shared for _, shared in self.down[face])
        for child, shared in self.down[face]:
            for feature, share in self.shares(child, self.own[child] or inherited).items():
                total[feature] += share * shared / all_of_it
        return total


@pytest.fixture(scope="module", params=KINDS)
def bare(request, tmp_path_factory):
    """A store without attributes, and its tables."""
    surface, options = KINDS[request.param]
    heights = {"hills": hills(36, 40), "void": VOIDS["ring with island"].heights}[surface]
    folder = tmp_path_factory.mktemp("attributes")
    path = vpfx.build(write_dem(folder / "a.tif", heights), folder / "bare.gpkg", **options).path
    return path, Tables(path)


@st.composite
def assignments(draw):
    """Some faces, as numbers in [0, 1) of their level, with features and shares."""
    faces = st.tuples(st.integers(0, 2), st.floats(0, 1, exclude_max=True))
    parts = st.lists(st.tuples(st.integers(1, 3), st.sampled_from((0.25, 0.125, 0.5))), min_size=1, max_size=2,
                     unique_by=lambda pair: pair[0])  # fmt: skip
    return draw(st.lists(st.tuples(faces, parts), max_size=25))


@settings(max_examples=15, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(assignments())
def test_inheritance(bare, some):
    path, tables = bare
    by_level = [[face for face in sorted(tables.level) if tables.level[face] == level] for level in range(3)]
    own = {by_level[level][int(at * len(by_level[level]))]: parts for (level, at), parts in some}
    tables.own = defaultdict(dict, {face: dict(parts) for face, parts in own.items()})
    copy = path.with_name("edited.gpkg")
    shutil.copy(path, copy)
    rows = [(face, feature, share) for face, parts in own.items() for feature, share in parts]
    with edit_store(copy) as editor:
        editor.create_class("other", {"name": "text"})
        other = editor.add_features("other", {"name": ["x"]})
        editor.set_faces("other", by_level[0], other)  # another class must not count
        editor.create_class("soil", {"name": "text"})
        ids = editor.add_features("soil", {"name": ["a", "b", "c"]})
        if rows:
            faces, features, shares = zip(*rows, strict=True)
            editor.set_faces("soil", faces, ids[np.array(features) - 1], shares)
    expected = {
        (face, int(ids[feature - 1])): share for face in tables.level for feature, share in tables.shares(face).items()
    }
    asked = np.array(sorted(tables.level))
    with vpfx.open_store(copy) as store:
        found = attributes(store, asked, "soil")
    pairs = list(zip(asked[found.of].tolist(), found.feature_ids.tolist(), strict=True))
    assert pairs == sorted(expected)
    assert found.share == pytest.approx([expected[pair] for pair in pairs], abs=CLOSE)
    assert found.columns["name"].tolist() == ["abc"[feature - ids[0]] for _, feature in pairs]
    view = query(copy, "SELECT face_id, feature_id, share FROM face_attribute WHERE class_name = 'soil' ORDER BY 1, 2")
    assert [row[:2] for row in view] == pairs
    assert [row[2] for row in view] == pytest.approx(found.share.tolist(), abs=1e-14)


def test_shares_of_ancestors_and_descendants(bare):
    """The parts of a face add up to it, and are those of a walk over the links."""
    path, tables = bare
    for view, other, links in (
        ("face_ancestor", "ancestor", tables.up),
        ("face_descendant", "descendant", tables.down),
    ):
        found = defaultdict(float)
        for face, relative, level, share in query(path, f"SELECT face_id, {other}, level, share FROM {view}"):
            assert tables.level[relative] == level
            found[face, relative] = share
        expected = defaultdict(float)
        for face in tables.level:
            waiting = [(face, 1.0)]
            while waiting:
                at, part = waiting.pop()
                for relative, shared in links[at]:
                    expected[face, relative] += part * shared / tables.area[at]
                    waiting.append((relative, part * shared / tables.area[at]))
        assert found.keys() == expected.keys()
        assert [found[key] for key in expected] == pytest.approx(list(expected.values()), rel=1e-6)


def test_neighbours_and_areas(bare):
    path, tables = bare
    area = dict(query(path, "SELECT face_id, area FROM face_area"))
    assert area.keys() == tables.area.keys()
    assert [area[face] for face in area] == pytest.approx([tables.area[face] for face in area], rel=1e-9)
    with vpfx.open_store(path) as store:
        across = edge_neighbours(store, sorted(tables.level)).tolist()
    rows = query(path, "SELECT face_id, side, neighbour FROM face_neighbour ORDER BY face_id, side")
    expected = [
        (face, side + 1, None if other == -1 else other)
        for face, others in zip(sorted(tables.level), across, strict=True)
        for side, other in enumerate(others)
    ]
    assert rows == expected


def test_region_gives_each_face_its_box(bare):
    path, _ = bare
    rows = query(path, "SELECT face_id, level, tile_id, xmin, ymin, xmax, ymax FROM region ORDER BY face_id")
    expected = query(
        path,
        "SELECT f.face_id, f.level, f.tile_id, min(a.x, b.x, c.x), min(a.y, b.y, c.y), max(a.x, b.x, c.x), "
        "max(a.y, b.y, c.y) FROM face f, node a, node b, node c "
        "WHERE a.node_id = f.node_1 AND b.node_id = f.node_2 AND c.node_id = f.node_3 ORDER BY 1",
    )
    assert rows == expected


@pytest.fixture
def small(bare, tmp_path):
    """A copy of a store, to be edited."""
    path, _ = bare
    return shutil.copy(path, tmp_path / "small.gpkg")


def test_columns_keep_their_kinds(small):
    kinds = {"name": "text", "depth": "real", "code": "integer", "count_of": "integer", "surveyed": "date"}
    with edit_store(small) as editor:
        editor.create_class("soil", kinds)
        values = {
            "name": ["é", None], "depth": np.array([1, np.nan]), "code": np.array([3, 4], np.int16),
            "count_of": [2, None], "surveyed": np.array(["1998-12-01", "NaT"], "datetime64[D]"),
        }  # fmt: skip
        ids = editor.add_features("soil", values)
        editor.set_faces("soil", [1, 2], ids)
    with vpfx.open_store(small) as store:
        found = attributes(store, [2, 1, 2], "soil").columns
    assert found["name"].tolist() == [None, "é", None]
    assert found["depth"].tolist() == pytest.approx([np.nan, 1, np.nan], nan_ok=True)
    assert found["code"].tolist() == [4, 3, 4]
    assert found["code"].dtype == np.int64
    assert found["count_of"].tolist() == [None, 2, None]
    assert found["surveyed"].tolist() == [None, "1998-12-01", None]


def test_nothing_is_asked(small):
    with edit_store(small) as editor:
        editor.create_class("soil", {"name": "text"})
    with vpfx.open_store(small) as store:
        found = attributes(store, [], "soil")
        assert found.of.tolist() == found.share.tolist() == found.columns["name"].tolist() == []
        assert attributes(store, [1, 2], "soil").of.tolist() == []
        with pytest.raises(NotFoundError, match="found no feature class 'forest'; there are: soil"):
            attributes(store, [1], "forest")
        with pytest.raises(NotFoundError, match="found no face 99999999"):
            attributes(store, [99999999], "soil")
        with pytest.raises(InputError, match="expected whole numbers"):
            attributes(store, ["one"], "soil")


HOSTILE = {
    "a name that is SQL": "UPDATE feature_class SET class_name = 'soil; DROP TABLE node'",
    "a name of another table": "UPDATE feature_class SET class_name = 'node'",
    "another table": "DROP TABLE soil; CREATE TABLE soil (feature_id INTEGER PRIMARY KEY, name TEXT)",
    "a view": "DROP TABLE soil; CREATE VIEW soil AS SELECT 1 AS feature_id, 'x' AS name",
    "no table": "DROP TABLE soil",
    "another column": "UPDATE feature_column SET column_name = 'name FROM node --'",
    "another kind": "PRAGMA ignore_check_constraints = ON; UPDATE feature_column SET kind = 'blob'",
}


@pytest.mark.parametrize("case", HOSTILE)
def test_hostile_classes_are_refused(case, small):
    with edit_store(small) as editor:
        editor.create_class("soil", {"name": "text"})
    with closing(sqlite3.connect(small)) as connection:
        connection.executescript(HOSTILE[case])
    with vpfx.open_store(small) as store, pytest.raises(StoreFormatError, match="R-225"):
        attributes(store, [1], "soil")
    with pytest.raises(StoreFormatError, match="R-225"), edit_store(small) as editor:
        editor.add_features("soil", {"name": ["x"]})
