"""The store that users open: every question is a method, and several can be put to one state of the file."""

from __future__ import annotations

import inspect
import pkgutil
from importlib import import_module

import numpy as np
import pytest
from surfaces import hills, write_dem

import vpfx
import vpfx.query
from vpfx.errors import StoreError
from vpfx.store import edit
from vpfx.store.edit import edit_store

ABOUT_STORES = {"areas_of", "follow", "shown"}
"""Functions that take a store, but serve others."""


def questions():
    """Public functions of the modules of questions whose first parameter is the store."""
    found = {}
    for module in pkgutil.iter_modules(vpfx.query.__path__, "vpfx.query."):
        names = import_module(module.name).__all__
        for name in names:
            function = getattr(import_module(module.name), name)
            if inspect.isfunction(function) and next(iter(inspect.signature(function).parameters), "") == "store":
                found[name] = function
    return found


@pytest.fixture
def path(tmp_path):
    path = vpfx.build(write_dem(tmp_path / "a.tif", hills(20, 20)), tmp_path / "a.gpkg", max_error=(30, 10)).path
    with edit_store(path) as editor:
        editor.create_class("soil", {"kind": "text"})
        editor.set_faces("soil", [1], editor.add_features("soil", {"kind": ["clay"]}))
    return path


def test_every_question_is_a_method():
    found = questions()
    assert len(found) > 20
    for name, function in found.items():
        assert name in ABOUT_STORES or getattr(vpfx.Store, name) is function, name


def test_methods_are_the_functions(path):
    with vpfx.open_store(path) as store:
        x, y = store.extent[:2]
        assert store.locate([(x + 50, y + 50)], 0).face_ids.tolist() == [
            int(store.region(0, bbox=(x + 50, y + 50, x + 50, y + 50)).face_attributes["face_id"][0])
        ]
        assert store.attributes([1], "soil").columns["kind"].tolist() == ["clay"]
        assert store.cut(error=1e6).n_face == store.levels[0].faces
        assert repr(store).startswith("<Store ")


def test_one_state_for_several_questions(path, monkeypatch):
    monkeypatch.setattr(edit, "BUSY_SECONDS", 0.1)
    with vpfx.open_store(path) as store:
        with store.snapshot():
            before = store.attributes([1], "soil").columns["kind"].tolist()
            faces = store.fetch("face", [1, 2])
            with pytest.raises(StoreError, match="is locked"), edit_store(path) as editor:
                editor.set_faces("soil", [1], editor.add_features("soil", {"kind": ["sand"]}))
            assert store.attributes([1], "soil").columns["kind"].tolist() == before == ["clay"]
            with store.snapshot():  # may stand inside another
                np.testing.assert_array_equal(store.fetch("face", [1, 2])["node_1"], faces["node_1"])
            assert len(store.linked("parent_face", np.array([1])))
        with edit_store(path) as editor:
            editor.set_faces("soil", [1], editor.add_features("soil", {"kind": ["sand"]}))
        assert store.attributes([1], "soil").columns["kind"].tolist() == ["sand"]


def test_what_is_kept_is_forgotten_when_the_file_changes(path):
    made = []
    with vpfx.open_store(path) as store:
        for _ in range(2):
            store.keep("x", lambda: (made.append(1) or np.zeros(1),))
        assert len(made) == 1
        with edit_store(path) as editor:
            editor.describe_values("soil", "kind", {"clay": "fine"})
        store.keep("x", lambda: (made.append(1) or np.zeros(1),))
        assert len(made) == 2
