"""Feature classes of one level: faces and nodes, classes of attributes, which primitive has which (specs/evpf.md chapter 3)."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from vpfx.errors import StoreFormatError
from vpfx.evpf.classes import ClassTable, write_class, write_values
from vpfx.evpf.folder import Folder
from vpfx.evpf.graph import TileGraph
from vpfx.evpf.hierarchy import junction_layout, own_layout, parent_layout
from vpfx.evpf.joins import Joins
from vpfx.evpf.numbering import FIRST_FACE, LevelTiles
from vpfx.evpf.precision import rounded
from vpfx.query.attributes import attributes
from vpfx.store.arrays import look_up, runs_of
from vpfx.vpf import layouts, thematic_index
from vpfx.vpf.table import Column, Layout, TableWriter
from vpfx.vpf.values import NULL_INT

__all__ = ["LevelFeatures"]

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

FACES, NODES = 1, 2
"""Rows of `fca`; classes of attributes follow."""

FACE_COLUMNS = (
    Column("slope", "F", 1, "N", "Steepness in degrees"),
    Column("aspect", "F", 1, "N", "Direction of steepest descent in degrees clockwise from grid north"),
    Column("filled", "S", 1, "N", "Whether heights are interpolated", "int.vdt"),
    Column("parent", "I", 1, "N", "Face of the coverage before as row of its tinface.aft"),
)
NODE_COLUMNS = (
    Column("z", "R", 1, "N", "Height in metres"),
    Column("z_parent", "R", 1, "N", "Height of the surface of the level before in metres"),
    Column("first_level", "S", 1, "N", "Level at which the node first appears"),
)
DESCRIPTION_WIDTH = 50
RELATED = ("level", "parent", "own", "tjunct", "evpf", "source", "class", "column", "value")
"""Tables of the hierarchy, in the order in which `fcs` names those that are there."""


class LevelFeatures:
    """The tables of a coverage beside its tiles, written tile by tile; use as a context manager.

    Parameters
    ----------
    coverage : Folder
    tiles : LevelTiles
        Of the level.
    coarser : LevelTiles, optional
        Of the level before.
    classes : sequence of ClassTable
    is_double : bool
    """

    def __init__(
        self, coverage: Folder, tiles: LevelTiles, coarser: LevelTiles | None, classes: Sequence[ClassTable], *, is_double: bool
    ) -> None:  # fmt: skip
        self._coverage, self._tiles, self._coarser = coverage, tiles, coarser
        self._classes, self._is_double = classes, is_double
        self._is_nested = tiles.store.is_nested
        self._has_junctions = bool(tiles.store.raw("SELECT 1 FROM t_junction WHERE level = ? LIMIT 1", (tiles.level,)))
        self._n_nodes: list[int] = []
        self._open = ExitStack()
        self._writers: dict[str, TableWriter] = {}
        self._joins: list[Joins] = []

    def __enter__(self) -> Self:
        with ExitStack() as opening:
            for name, layout in self._layouts().items():
                self._writers[name] = opening.enter_context(self._coverage.open(name, layout))
            for table in self._classes:
                path = self._coverage.path / f".{table.name}.joins"
                self._joins.append(opening.enter_context(Joins(path, len(table.feature_ids))))
            self._open = opening.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open.__exit__(kind, error, trace)

    def _layouts(self) -> dict[str, Layout]:
        """Tables that are written tile by tile."""
        faces = layouts.feature("Faces of the TIN", FACE_COLUMNS, "fac", is_tiled=True)
        nodes = layouts.feature("Nodes of the TIN", NODE_COLUMNS, "cnd", is_tiled=True)
        found = {
            "tinface.aft": _indexed(faces, "tile1.ati"), "tinnode.pft": _indexed(nodes, "tile2.pti"),
            "fac.fit": layouts.fit(is_tiled=True), "cnd.fit": layouts.fit(is_tiled=True),
        }  # fmt: skip
        if self._has_junctions:
            found["tjunct.rat"] = junction_layout()
        if self._coarser is not None:
            found["parent.rat"] = parent_layout(self._is_nested)
        if self._classes:
            found["own.rat"] = own_layout()
        for table in self._classes:
            layout = layouts.join(f"Faces of {table.name}", f"{table.name}_id", "fac", is_tiled=True)
            share = Column("share", "R", 1, "N", "Share of the area of the face")
            found[f"{table.name}.ajt"] = layout._replace(columns=(*layout.columns[:2], share, *layout.columns[2:]))
        return found

    def _append(self, name: str, n_row: int, **columns: Any) -> Ints:
        """Append rows, numbered on; return their ids."""
        writer = self._writers[name]
        ids = np.arange(writer.n_row + 1, writer.n_row + n_row + 1)
        writer.append({"id": ids, **{c: np.full(n_row, v) if np.ndim(v) == 0 else v for c, v in columns.items()}})
        return ids

    def add(self, graph: TileGraph) -> None:
        """Write the rows of the next tile."""
        faces, tile_id = graph.numbers.faces, graph.tile_id
        fac_ids = np.arange(FIRST_FACE, FIRST_FACE + len(faces["face_id"]))
        parent = self._add_parents(graph, fac_ids)
        aspect = faces["aspect_centidegrees"]
        ids = self._append(
            "tinface.aft", len(fac_ids), slope=faces["slope_centidegrees"] / 100.0,
            aspect=np.where(aspect < 0, np.nan, aspect / 100.0), filled=faces["is_filled"], parent=parent,
            tile_id=tile_id, fac_id=fac_ids,
        )  # fmt: skip
        index = [np.stack([fac_ids, np.full(len(ids), FACES), ids])]
        for i, table in enumerate(self._classes):
            face, feature = self._add_class(i, table, faces["face_id"], tile_id)
            index.append(np.stack([face + FIRST_FACE, np.full(len(face), NODES + 1 + i), feature + 1]))
        prim, fc, feature = np.concatenate(index, axis=1)
        order = np.lexsort((feature, fc, prim))
        rows = {"prim_id": prim[order], "fc_id": fc[order], "feature_id": feature[order]}
        self._append("fac.fit", len(order), tile_id=tile_id, **rows)
        self._add_nodes(graph)
        self._add_own(graph)

    def _add_nodes(self, graph: TileGraph) -> None:
        nodes, tile_id = graph.nodes, graph.tile_id
        cnd_ids = np.arange(1, len(nodes["node_id"]) + 1)
        z_parent = nodes["z_parent"] if self._is_double else rounded(nodes["z_parent"])
        ids = self._append(
            "tinnode.pft", len(cnd_ids), z=graph.xyz[:, 2], z_parent=z_parent, first_level=nodes["level"],
            tile_id=tile_id, cnd_id=cnd_ids,
        )  # fmt: skip
        self._append("cnd.fit", len(ids), prim_id=cnd_ids, tile_id=tile_id, fc_id=NODES, feature_id=ids)
        self._n_nodes.append(len(ids))
        if self._has_junctions:
            face, node, gap = graph.numbers.junctions
            self._append("tjunct.rat", len(face), tile_id=tile_id, fac_id=face + FIRST_FACE, cnd_id=node + 1, gap=gap)

    def _add_parents(self, graph: TileGraph, fac_ids: Ints) -> Ints:
        """Write the links of the tile; return the parent of each face as row of `tinface.aft`, null where there are several."""
        if self._coarser is None or len(fac_ids) == 0:
            return np.full(len(fac_ids), NULL_INT)
        store, face_ids = self._tiles.store, graph.numbers.faces["face_id"]
        child, parent = store.linked("child_face", face_ids).T
        if not np.array_equal(np.unique(child), face_ids):
            raise self._tiles.broken(graph.tile_id - 1, "found a face without a parent", "R-180")
        if (self._coarser.tile_of_faces(parent) != graph.tile_id - 1).any():
            raise self._tiles.broken(graph.tile_id - 1, "found a parent of another tile", "R-180")
        area = {}
        if not self._is_nested:
            query = "SELECT area FROM shared_area WHERE child_face BETWEEN ? AND ? ORDER BY child_face, parent_face"
            area["area"] = store.select(query, (int(face_ids[0]), int(face_ids[-1])))["area"]
        self._append(
            "parent.rat", len(child), tile_id=graph.tile_id, parent_id=self._coarser.fac_ids(parent),
            child_id=self._tiles.fac_ids(child), **area,
        )  # fmt: skip
        return self._coarser.tinface_ids(parent) if self._is_nested else np.full(len(fac_ids), NULL_INT)

    def _add_class(self, i: int, table: ClassTable, face_ids: Ints, tile_id: int) -> tuple[Ints, Ints]:
        """Take the features of a class that the faces of a tile have, inherited or not: faces and features, as indices."""
        found = attributes(self._tiles.store, face_ids, table.stored.name)
        feature = self._features(table, found.feature_ids)
        self._joins[i].append(feature, found.share, tile_id, found.of + FIRST_FACE)
        return found.of, feature

    def _features(self, table: ClassTable, feature_ids: Ints) -> Ints:
        """Indices of features of a class."""
        feature, is_known = look_up(table.feature_ids, feature_ids)
        if not is_known.all():
            message = f"found feature {feature_ids[~is_known][0]} of class {table.stored.name}, which is not there"
            raise StoreFormatError(str(self._tiles.store.path), "table face_feature", message, "R-224")
        return feature

    def _add_own(self, graph: TileGraph) -> None:
        """Write what features the faces of a tile have by themselves."""
        face_ids = graph.numbers.faces["face_id"]
        if not self._classes or len(face_ids) == 0:
            return
        query = (
            "SELECT face_id, class_id, feature_id, share FROM face_feature WHERE face_id BETWEEN ? AND ? "
            "ORDER BY face_id, class_id, feature_id"
        )
        (run,) = runs_of(face_ids)
        rows = self._tiles.store.select(query, run)
        class_row, feature = np.zeros((2, len(rows["face_id"])), np.int64)
        for i, table in enumerate(self._classes):
            at = rows["class_id"] == table.stored.class_id
            class_row[at], feature[at] = i + 1, self._features(table, rows["feature_id"][at]) + 1
        if (class_row == 0).any():
            raise self._tiles.broken(graph.tile_id - 1, "found a face with a class that is not there", "R-224")
        self._append(
            "own.rat", len(class_row), tile_id=graph.tile_id, fac_id=rows["face_id"] - face_ids[0] + FIRST_FACE,
            class_id=class_row, feature_id=feature, share=rows["share"],
        )  # fmt: skip

    def finish(self, further: Sequence[str]) -> None:
        """Write what hangs on all tiles: joins, indexes, classes, the schema.

        Parameters
        ----------
        further : sequence of str
            Tables of the hierarchy that are written besides, such as ``evpf``.
        """
        coverage = self._coverage
        for table, joins in zip(self._classes, self._joins, strict=True):
            joins.write(self._writers[f"{table.name}.ajt"], f"{table.name}_id")
            write_class(coverage, table)
        tile_ids = np.arange(1, self._tiles.tiling.n_tile + 1)
        indexes = (("tile1.ati", "tinface.aft", self._tiles.n_face), ("tile2.pti", "tinnode.pft", self._n_nodes))
        for name, table_name, counts in indexes:
            values = np.repeat(tile_ids, counts)
            coverage.write_bytes(name, thematic_index.build(values, coverage.named(table_name), "tile_id", "S"))
        write_values(coverage, list(self._classes))
        self._write_schema(further)

    def _write_schema(self, further: Sequence[str]) -> None:
        """Write `fcs` and `fca`."""
        relations = [
            ("tinface", "tinface.aft", "fac_id", "fac", "id"),
            ("tinnode", "tinnode.pft", "cnd_id", "cnd", "id"),
        ]
        classes = [("tinface", "A", "Faces of the TIN"), ("tinnode", "P", "Nodes of the TIN")]
        for table in self._classes:
            name = table.name
            relations.append((name, f"{name}.aft", "id", f"{name}.ajt", f"{name}_id"))
            relations.append((name, f"{name}.ajt", "fac_id", "fac", "id"))
            classes.append((name, "A", table.layout.description[:DESCRIPTION_WIDTH].strip()))
        rows = []
        for fclass, one, key, other, other_key in relations:
            rows += [(fclass, one, key, other, other_key), (fclass, other, other_key, one, key)]
        there = {name.partition(".")[0] for name in self._writers if name.endswith(".rat")} | {"level", *further}
        rows += [("tinface", "tinface.aft", "id", f"{name}.rat", "id") for name in RELATED if name in there]
        named = self._coverage.named
        columns = [[row[i] if i in (2, 4) else named(row[i]) for row in rows] for i in range(5)]
        names = ("feature_class", "table1", "table1_key", "table2", "table2_key")
        schema = {"id": list(range(1, len(rows) + 1)), **dict(zip(names, columns, strict=True))}
        self._coverage.write("fcs", layouts.FCS, schema)
        class_names, kinds, texts = zip(*classes, strict=True)
        described = {"fclass": [named(name) for name in class_names], "type": list(kinds), "descr": list(texts)}
        self._coverage.write("fca", layouts.fca(DESCRIPTION_WIDTH), {"id": list(range(1, len(kinds) + 1)), **described})


def _indexed(layout: Layout, index: str) -> Layout:
    """Return a layout whose tiles have a thematic index."""
    columns = (c._replace(index=index) if c.name == "tile_id" else c for c in layout.columns)
    return layout._replace(columns=tuple(columns))
