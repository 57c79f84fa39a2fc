"""Attributes from values of faces: those of a Python function, and those of an SQL statement."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vpfx.attach.common import Attached, check_if_there, kind_of, write_features
from vpfx.errors import InputError
from vpfx.model import Tin
from vpfx.query.sql import answer_sql
from vpfx.store.classes import Column, check_name
from vpfx.store.edit import recover
from vpfx.store.reader import open_reader

__all__ = ["attach_function", "attach_sql"]


def attach_function(
    path: str | Path, class_name: str, function: Callable[[Tin], Any], *, level: int | None = None,
    column: str = "value", if_there: str = "refuse",
) -> Attached:  # fmt: skip
    """Attach what a function says of the faces of a level: each value becomes a feature.

    Parameters
    ----------
    path : path
        The store.
    class_name : str
        Made if it is not there.
    function : callable
        Takes the `Tin` of the level and returns one value a face: whole numbers, reals, texts or dates; None, NaN and NaT
        mean none.
    level : int, optional
        The finest if left out.
    column : str
        Name of the column that keeps the value.
    if_there : str
        What to do if the class is there: ``refuse``, ``append`` or ``replace``.

    Raises
    ------
    InputError
        A name or choice is none, or the function returns something else.
    NotFoundError, StoreFormatError, StoreError
        The store is missing, broken or locked, or has no such level.

    Examples
    --------
    ``attach_function("n36.gpkg", "side", lambda tin: np.where(tin.face_attributes["aspect"] < 180, "east", "west"))``
    """
    check_if_there(if_there)
    check_name(class_name, "class")
    recover(Path(path))
    with open_reader(path) as store:
        tin = store.tin(store.level_or_finest(level))
    values = np.asarray(function(tin))
    if values.shape != (tin.n_face,):
        raise InputError(
            f"function: found an array of shape {values.shape}, expected ({tin.n_face},): one value a face"
        )
    face_ids = tin.face_attributes["face_id"]
    kind = kind_of(values)
    rows = [(value,) for value in (values.astype(object) if values.dtype.kind == "M" else values).tolist()]
    return _attach(Path(path), class_name, {column: Column(kind)}, face_ids.tolist(), rows, if_there)


def attach_sql(path: str | Path, class_name: str, question: str, *, if_there: str = "refuse") -> Attached:
    """Attach what an SQL statement answers: rows of a face and values; each combination of values becomes a feature.

    Parameters
    ----------
    path : path
        The store.
    class_name : str
        Made if it is not there.
    question : str
        Its first column is ``face_id``, of any level; the others become columns. Rows without any value do not count.
    if_there : str
        What to do if the class is there: ``refuse``, ``append`` or ``replace``.

    Raises
    ------
    InputError
        SQLite does not understand the question, it answers something else, or a name or choice is none.
    NotFoundError, StoreFormatError, StoreError
        The store is missing, broken or locked, or a face is none.

    Examples
    --------
    ``attach_sql("n36.gpkg", "steep", "SELECT face_id, slope > 30 AS is_steep FROM face_3")``
    """
    check_if_there(if_there)
    check_name(class_name, "class")
    recover(Path(path))
    answer = answer_sql(path, question)
    if answer.names[:1] != ("face_id",) or len(answer.names) < 2 or len(set(answer.names)) != len(answer.names):
        raise InputError(f"SQL: found columns {', '.join(answer.names)}; expected face_id, then the values")
    columns = {
        name: Column(kind_of(np.array([*(row[i] for row in answer.rows), None], object)))
        for i, name in enumerate(answer.names)
    }
    del columns["face_id"]
    faces = [row[0] for row in answer.rows]
    if not all(isinstance(face, int) for face in faces):
        raise InputError("SQL: found a face_id that is NULL or no whole number, expected ids of faces")
    return _attach(Path(path), class_name, columns, faces, [row[1:] for row in answer.rows], if_there)


def _attach(
    path: Path, class_name: str, columns: dict[str, Column], face_ids: Sequence[int], rows: Sequence[tuple[Any, ...]],
    if_there: str,
) -> Attached:  # fmt: skip
    """Make a feature of each combination of values, and put it on its faces."""
    is_there = [any(value is not None and value == value for value in row) for row in rows]
    number: dict[tuple[Any, ...], int] = {}
    index = [number.setdefault(row, len(number)) for row, wanted in zip(rows, is_there, strict=True) if wanted]
    faces = np.array([face for face, wanted in zip(face_ids, is_there, strict=True) if wanted], np.int64)
    if len(faces) == 0:
        raise InputError(f"class {class_name}: found no value, expected some")
    values = dict(zip(columns, zip(*number, strict=True), strict=True))
    return write_features(
        path, class_name, columns, values, (faces, np.array(index, np.int64), np.ones(len(faces))), if_there
    )
