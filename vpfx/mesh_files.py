"""Triangle meshes of other programs, read by trimesh."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from vpfx.errors import FormatError, InputError, NotFoundError
from vpfx.model import Tin

__all__ = ["SUFFIXES", "read_mesh"]

SUFFIXES = (".glb", ".obj", ".off", ".ply", ".stl")
"""Formats that are read."""


def _trimesh() -> Any:
    """Return trimesh, or say how to install it."""
    try:
        import trimesh
    except ImportError:
        raise NotFoundError("mesh: found no trimesh, expected it: pip install 'vpfx[mesh]'") from None
    return trimesh


def read_mesh(path: str | Path) -> Tin:
    r"""Read a mesh whose triangles, seen from above, do not lie on each other; those seen from below are turned.

    Parameters
    ----------
    path : path
        A file of one of the formats `SUFFIXES`; x and y are taken as places, z as heights in metres.

    Returns
    -------
    Tin
        Vertices at one place are one node.

    Raises
    ------
    NotFoundError
        There is no such file, or trimesh is missing.
    InputError
        The format is another.
    FormatError
        The file is broken, has no triangles, or some stand upright.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder, "a.off")
    ...     _ = path.write_text("\n".join(["OFF", "4 2 0", "0 0 5", "1 0 5", "1 1 6", "0 1 6", "3 0 1 2", "3 0 2 3"]))
    ...     read_mesh(path).face_nodes.tolist()
    [[0, 2, 3], [0, 3, 1]]
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: found suffix {path.suffix!r}, expected one of: {', '.join(SUFFIXES)}")
    if not path.is_file():
        raise NotFoundError(f"{path}: there is no such file")
    trimesh = _trimesh()
    try:
        mesh = trimesh.load_mesh(path, process=False, maintain_order=True)
        vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
    except Exception as error:  # trimesh raises whatever its parsers meet
        reason = " ".join(str(error).split()) or type(error).__name__
        raise FormatError(str(path), "", f"cannot be read as a mesh: {reason}") from error
    if len(faces) == 0 or not np.isfinite(vertices).all() or faces.min() < 0 or faces.max() >= len(vertices):
        raise FormatError(str(path), "", "found no triangles, or vertices that are none, expected a mesh")
    nodes, index = np.unique(vertices, axis=0, return_inverse=True)
    face_nodes = index.ravel()[faces]
    a, b, c = (nodes[face_nodes[:, i], :2] for i in range(3))
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    if (area == 0).any():
        raise FormatError(
            str(path), f"triangle {np.flatnonzero(area == 0)[0]}", "found no area from above, expected some"
        )
    face_nodes[area < 0] = face_nodes[area < 0][:, [0, 2, 1]]
    return Tin(nodes, face_nodes.astype(np.int32))
