"""Feature classes of a directory put into a store: their features, and what faces have by themselves (specs/evpf.md E-430)."""

from __future__ import annotations

import re
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import VpfFormatError
from vpfx.evpf.checked import Run, TileRuns, check, given_texts, open_checked, read_checked, read_texts
from vpfx.evpf.numbering import FIRST_FACE
from vpfx.store.classes import Column
from vpfx.store.edit import Editor
from vpfx.vpf.catalog import Coverage
from vpfx.vpf.table import Table
from vpfx.vpf.values import is_null

__all__ = ["read_classes"]

Ints = NDArray[np.int64]

CLASSES = {"id": "I", "name": "TL*", "description": "TL*", "fclass": "T", "store_id": "I"}
COLUMNS = {"id": "I", "class_id": "I", "name": "TL*", "vpf_name": "T", "kind": "T", "unit": "TL*", "description": "TL*"}
VALUES = {"id": "I", "column_id": "I", "value": "TL*", "description": "TL*"}
OWN = {"id": "I", "tile_id": "S", "fac_id": "I", "class_id": "I", "feature_id": "I", "share": "R"}
WRITTEN = {"text": "TL*", "real": "R", "date": "D"}
"""Types of columns by kind; integers are I, or texts."""

BATCH = 1 << 16  # faces given features at once


class _Class(NamedTuple):
    """A class, and the ids of its features in the store by row."""

    name: str
    feature_ids: Ints


def read_classes(coverages: list[Coverage], editor: Editor, n_face: Ints) -> None:
    """Put classes, features and what faces have into a store.

    Parameters
    ----------
    coverages : list of Coverage
        The levels, coarse to fine.
    editor : Editor
        Of the store.
    n_face : int64 (n_tile, n_level)
        Faces of each tile and level.

    Raises
    ------
    VpfFormatError
        A table is missing or broken.
    InputError, NotFoundError
        What it says does not do for a store.
    """
    table = read_checked(coverages[0], "class.rat", CLASSES)
    names, descriptions, tables = (given_texts(table, name) for name in ("name", "description", "fclass"))
    columns = read_checked(coverages[0], "column.rat", COLUMNS)
    class_id = columns["class_id"]
    _check_positive(table)
    is_there = (class_id >= 1) & (class_id <= table.n_row)
    check(is_there, columns.path, f"found class_id {{}}, expected 1 … {table.n_row}", "E-430", class_id)
    described, written = _columns(columns)
    classes = []
    for i, name in enumerate(names):
        rows = np.flatnonzero(class_id == i + 1).tolist()
        editor.create_class(
            name, dict(described[row] for row in rows), descriptions[i], class_id=int(table["store_id"][i])
        )
        kinds = {written[row]: described[row] for row in rows}
        classes.append(_Class(name, _read_features(coverages[0], f"{tables[i]}.aft", name, kinds, editor)))
    _read_values(coverages[0], columns, table["store_id"], [name for name, _ in described], editor)
    first_face = 1 + np.cumsum(n_face).reshape(n_face.shape) - n_face
    for level, coverage in enumerate(coverages):
        with open_checked(coverage, "own.rat", OWN) as file:
            _read_own(TileRuns(file), classes, editor, first_face[:, level], n_face[:, level])


def _check_positive(table: Table) -> None:
    """Refuse ids of the store that are none."""
    ids = table["store_id"]
    check(ids >= 1, table.path, "found store_id {}, expected one above 0", "E-430", ids)


def _columns(table: Table) -> tuple[list[tuple[str, Column]], list[str]]:
    """Columns of all classes with their names in the store, and their names as written."""
    texts = [given_texts(table, name) for name in ("name", "kind", "unit", "description", "vpf_name")]
    described = [(name, Column(kind, unit, text)) for name, kind, unit, text in zip(*texts[:4], strict=True)]
    for row, (_, column) in enumerate(described, 1):
        if column.kind not in (*WRITTEN, "integer"):
            known = ", ".join((*WRITTEN, "integer"))
            message = f"found kind {column.kind!r}, expected one of: {known}"
            raise VpfFormatError(table.path, f"row {row}", message, "E-430")
    return described, texts[4]


def _read_features(
    coverage: Coverage, table_name: str, class_name: str, kinds: dict[str, tuple[str, Column]], editor: Editor
) -> Ints:
    """Put the features of a class into the store; return their ids by row."""
    wanted = {"id": "I", "store_id": "I"}
    with open_checked(coverage, table_name, wanted) as file:
        forms = {column.name.lower(): column.kind for column in file.layout.columns}
    for written, (_, column) in kinds.items():
        is_number = column.kind == "integer" and forms.get(written.lower()) == "I"
        wanted[written] = "I" if is_number else WRITTEN.get(column.kind, "TL*")
    table = read_checked(coverage, table_name, wanted)
    _check_positive(table)
    ids = table["store_id"].astype(np.int64)
    values = {name: _values(table, written, column.kind) for written, (name, column) in kinds.items()}
    editor.add_features(class_name, values, ids)
    return ids


def _values(table: Table, name: str, kind: str) -> list[Any]:
    """Values of a column as the store has them; None for nulls."""
    column = table[name]
    if kind == "text":
        return read_texts(table, name)
    if kind == "date":
        days = [day.decode("latin-1") for day in column.tolist()]
        return [None if not day.strip() else f"{day[:4]}-{day[4:6]}-{day[6:8]}" for day in days]
    if kind == "real":
        return [None if value != value else value for value in column.tolist()]
    if isinstance(column, np.ndarray):
        nulls = is_null(column, "I").tolist()
        return [None if null else value for value, null in zip(column.tolist(), nulls, strict=True)]
    return [
        None if text is None else _whole(text, table.path, row) for row, text in enumerate(read_texts(table, name), 1)
    ]


def _whole(text: str, path: str, row: int) -> int:
    if not re.fullmatch(r"-?[0-9]{1,19}", text, re.ASCII):
        raise VpfFormatError(path, f"row {row}", f"found {text[:40]!r}, expected a whole number", "E-310")
    return int(text)


def _read_values(coverage: Coverage, columns: Table, store_id: Ints, names: list[str], editor: Editor) -> None:
    """Put what values mean into the store, in the very words."""
    table = read_checked(coverage, "value.rat", VALUES)
    row = table["column_id"].astype(np.int64) - 1
    is_there = (row >= 0) & (row < columns.n_row)
    check(is_there, table.path, f"found column_id {{}}, expected 1 … {columns.n_row}", "E-430", row + 1)
    class_id = store_id[columns["class_id"][row] - 1].tolist()
    texts = given_texts(table, "value"), given_texts(table, "description")
    rows = zip(class_id, (names[i] for i in row.tolist()), *texts, strict=True)
    editor.connection.executemany("INSERT INTO value_description VALUES (?, ?, ?, ?)", rows)


def _read_own(runs: TileRuns, classes: list[_Class], editor: Editor, first_face: Ints, n_face: Ints) -> None:
    """Give the faces of a level their features."""
    parts: list[tuple[Ints, Run]] = []
    n_row = 0
    for tile, (first, n) in enumerate(zip(first_face.tolist(), n_face.tolist(), strict=True), 1):
        rows = runs.take(tile)
        face = rows["fac_id"].astype(np.int64) - FIRST_FACE
        is_there = (face >= 0) & (face < n)
        message = f"found fac_id {{}}, expected {FIRST_FACE} … {FIRST_FACE + n - 1}"
        check(is_there, rows.path, message, "E-430", rows["fac_id"], start=rows.start)
        parts.append((first + face, rows))
        n_row += rows.n_row
        if n_row >= BATCH or tile == len(n_face):
            _set_faces(parts, classes, editor)
            parts, n_row = [], 0
    runs.finish()


def _set_faces(parts: list[tuple[Ints, Run]], classes: list[_Class], editor: Editor) -> None:
    """Give the faces of some tiles their features."""
    face_id = np.concatenate([ids for ids, _ in parts])
    class_id, row, share = (
        np.concatenate([rows[name] for _, rows in parts]) for name in ("class_id", "feature_id", "share")
    )
    path, start = parts[0][1].path, parts[0][1].start
    is_there = (class_id >= 1) & (class_id <= len(classes))
    check(is_there, path, f"found class_id {{}}, expected 1 … {len(classes)}", "E-430", class_id, start=start)
    for i, of_class in enumerate(classes, 1):
        at = np.flatnonzero(class_id == i)
        feature, n = row[at], len(of_class.feature_ids)
        is_feature = (feature >= 1) & (feature <= n)
        check(is_feature, path, f"found feature_id {{}}, expected 1 … {n}", "E-430", feature, rows=start + at)
        if len(at):
            editor.set_faces(of_class.name, face_id[at], of_class.feature_ids[feature - 1], share[at])
