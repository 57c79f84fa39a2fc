"""What all ways to attach share: which level, what becomes of a class that is there, and writing, at once or not at all."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import InputError, UnknownNameError
from vpfx.store.classes import Column
from vpfx.store.edit import edit_store

__all__ = ["IF_THERE", "Attached", "check_if_there", "kind_of", "write_features"]

IF_THERE = ("refuse", "append", "replace")
"""What to do if the class is there: refuse; add features, and put them on faces in the place of what these had; or drop it."""


class Attached(NamedTuple):
    """What was attached.

    Attributes
    ----------
    features, faces : int
        Features that were added, and faces that have some of them.
    """

    features: int
    faces: int


def check_if_there(choice: str) -> None:
    """Refuse an unknown choice.

    Raises
    ------
    UnknownNameError
    """
    if choice not in IF_THERE:
        raise UnknownNameError(f"if_there: found {choice!r}, expected one of: {', '.join(IF_THERE)}")


def kind_of(values: NDArray[Any]) -> str:
    """Kind of the column for an array.

    Raises
    ------
    InputError
        There is none.

    Examples
    --------
    >>> kind_of(np.array([1, 2])), kind_of(np.array(["clay"])), kind_of(np.array([0.5]))
    ('integer', 'text', 'real')
    """
    kinds = {"b": "integer", "i": "integer", "u": "integer", "f": "real", "M": "date", "U": "text"}
    if values.dtype.kind == "O":
        types = {type(value) for value in values.tolist() if value is not None}
        known = (({int}, "integer"), ({int, float}, "real"), ({str}, "text"))
        found = next((kind for those, kind in known if types <= those), None)
    else:
        found = kinds.get(values.dtype.kind)
    if found is None:
        raise InputError(f"values: found {values.dtype}, expected whole numbers, reals, texts or dates of one kind")
    return found


def write_features(
    path: Path, class_name: str, columns: Mapping[str, Column], values: Mapping[str, Any],
    faces: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]], if_there: str,
) -> Attached:  # fmt: skip
    """Add features to a class, made if it is not there, and put them on faces; in one transaction.

    Parameters
    ----------
    path : Path
    class_name : str
    columns : mapping of str to Column
    values : mapping of str to sequence (n_feature,)
    faces : three arrays (n,)
        Face ids, indices of the features, shares.
    if_there : str
        One of `IF_THERE`.

    Raises
    ------
    InputError
        The class is there, or has other columns.
    StoreError
        Somebody else is writing.
    """
    face_ids, index, shares = faces
    used, place = np.unique(index, return_inverse=True)
    with edit_store(path) as editor:
        known = editor.classes
        if class_name in known and if_there == "refuse":
            raise InputError(f"class: found {class_name!r} in {path}; give another name, --append or --overwrite")
        if class_name in known and if_there == "replace":
            editor.drop_class(class_name)
            known = {}
        if class_name not in known:
            editor.create_class(class_name, columns)
        ids = editor.add_features(class_name, {name: [column[i] for i in used] for name, column in values.items()})
        editor.set_faces(class_name, face_ids, ids[place], shares)
    return Attached(len(used), len(np.unique(face_ids)))
