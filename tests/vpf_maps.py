"""Small VPF databases for tests: labelled squares of a jittered grid, written byte by byte.

The faces of the map are the connected squares of one label; 0 is outside. Everything is made by plain loops
over the grid; no code of vpfx is used.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import shapely


@dataclass
class Edge:
    """An edge of a tile: places in order, nodes, faces and links, numbered from 1."""

    places: list
    start_node: int = 0
    end_node: int = 0
    right_face: int = 1
    left_face: int = 1
    right_edge: int = 0
    left_edge: int = 0
    key: frozenset = frozenset()


@dataclass
class Tile:
    """A planar graph: face 1 is the universe; `cells` has the squares of each other face."""

    name: str
    edges: list = field(default_factory=list)
    nodes: list = field(default_factory=list)
    n_face: int = 1
    face_at: dict = field(default_factory=dict)
    rings: list = field(default_factory=list)


class Map:
    """Labelled squares `labels (rows, columns)`, cut into tiles of `tile` squares a side (0: one tile)."""

    def __init__(self, labels, seed=0, tile=0, n_spur=0):
        self.labels = np.asarray(labels)
        self.rows, self.columns = self.labels.shape
        self.random = np.random.default_rng(seed)
        self.tile = tile
        self.place = self._jittered()
        self.areas = self._components(lambda cell: True)
        self.spurs = self._spurs(n_spur)
        self.ends, self.drawn = set(), set()  # nodes and segments of the map as a whole
        self.whole = self._graph(0, 0, max(self.rows, self.columns) + 1)
        self.tiles = [self._graph(*corner) for corner in self._corners()]

    def _jittered(self):
        """Place of each corner of the grid, exact in single precision; corners on borders move along them only."""
        step = self.tile or max(self.rows, self.columns) + 1
        moves = (self.random.integers(-6, 7, (self.rows + 1, self.columns + 1, 2)) / 32.0).tolist()
        return {
            (row, column): (
                10.0 + column + (moves[row][column][0] if column % step else 0.0),
                50.0 + row + (moves[row][column][1] if row % step else 0.0),
            )
            for row in range(self.rows + 1)
            for column in range(self.columns + 1)
        }

    def _label(self, cell):
        row, column = cell
        inside = 0 <= row < self.rows and 0 <= column < self.columns
        return int(self.labels[row, column]) if inside else 0

    def _components(self, within):
        """Number of the connected squares of one label, by square: 2, 3, …; squares with a label first, then voids."""
        number, found = {}, 1
        cells = sorted(np.ndindex(self.rows, self.columns), key=lambda cell: not self._label(cell))
        for cell in cells:
            if cell in number or not within(cell):
                continue
            found += 1
            todo = [cell]
            number[cell] = found
            while todo:
                row, column = todo.pop()
                for other in ((row + 1, column), (row - 1, column), (row, column + 1), (row, column - 1)):
                    is_inside = other[0] in range(self.rows) and other[1] in range(self.columns) and within(other)
                    if is_inside and other not in number and self._label(other) == self._label(cell):
                        number[other] = found
                        todo.append(other)
        return self._enclosed(number)

    def _enclosed(self, number):
        """Leave out voids that come to the outline: they are outside."""
        open_voids = set()
        for (row, column), own in number.items():
            others = ((row + 1, column), (row - 1, column), (row, column + 1), (row, column - 1))
            if not self._label((row, column)) and any(other not in number for other in others):
                open_voids.add(own)
        kept = {own: i for i, own in enumerate(sorted(set(number.values()) - open_voids), 2)}
        return {cell: kept[own] for cell, own in number.items() if own in kept}

    def _segments(self):
        """Sides of squares: two corners, and the squares on the left and on the right."""
        for row in range(self.rows + 1):
            for column in range(self.columns):
                yield (row, column), (row, column + 1), (row, column), (row - 1, column)
        for row in range(self.rows):
            for column in range(self.columns + 1):
                yield (row, column), (row + 1, column), (row, column - 1), (row, column)

    def _spurs(self, n_spur):
        """Further segments, with the same face on both sides: they close no ring, in the map or in a tile."""
        root = {corner: corner for corner in self.place}

        def find(corner):
            while root[corner] != corner:
                corner = root[corner]
            return corner

        step = self.tile or max(self.rows, self.columns) + 1
        free = []
        for start, end, left, right in self._segments():
            horizontal = start[0] == end[0]
            on_border = (start[0] % step == 0) if horizontal else (start[1] % step == 0)
            if self.areas.get(left) != self.areas.get(right) or on_border:
                root[find(start)] = find(end)
            elif left in self.areas and self._label(left):
                free.append((start, end))
        chosen = set()
        for i in self.random.permutation(len(free))[:n_spur].tolist():
            start, end = free[i]
            if find(start) != find(end):
                root[find(start)] = find(end)
                chosen.add(frozenset((start, end)))
        return chosen

    def _corners(self):
        step = self.tile or max(self.rows, self.columns) + 1
        return [(row, column, step) for row in range(0, self.rows, step) for column in range(0, self.columns, step)]

    def _graph(self, low_row, low_column, step):
        """The planar graph of one tile."""

        def within(cell):
            return low_row <= cell[0] < low_row + step and low_column <= cell[1] < low_column + step

        faces = self._components(within)
        tile = Tile(rf"{low_row // step:02d}\{low_column // step:02d}")
        tile.face_at, tile.n_face = faces, max(faces.values(), default=1)
        sides = {}
        for start, end, left, right in self._segments():
            pair = faces.get(left, 1), faces.get(right, 1)
            if not (within(left) or within(right)):
                continue
            if pair[0] != pair[1] or (frozenset((start, end)) in self.spurs and pair[0] != 1):
                sides[start, end], sides[end, start] = pair, pair[::-1]
        self._chain(tile, sides)
        _link(tile)
        _find_rings(tile)
        return tile

    def _chain(self, tile, sides):
        """Chains of segments between nodes; a loop gets one node."""
        around = {}
        for start, end in sides:
            around.setdefault(start, []).append(end)
        is_node = {
            corner
            for corner, others in around.items()
            if len(others) != 2
            or corner in self.ends
            or len({frozenset((corner, o)) in self.drawn for o in others}) == 2
        }
        done, number = set(), {}
        for corner in sorted(around, key=lambda corner: (corner not in is_node, corner)):
            for other in sorted(around[corner]):
                if (corner, other) in done or (
                    corner not in is_node and any((corner, o) in done for o in around[corner])
                ):
                    continue
                chain = [corner, other]
                while chain[-1] not in is_node and chain[-1] != corner:
                    chain.append(next(o for o in around[chain[-1]] if o != chain[-2]))
                done |= set(pairwise(chain)) | set(pairwise(chain[::-1]))
                if self.random.random() < 0.5:
                    chain.reverse()
                left, right = sides[chain[0], chain[1]]
                ends = [number.setdefault(end, len(number) + 1) for end in (chain[0], chain[-1])]
                key = frozenset(frozenset(pair) for pair in pairwise(chain))
                tile.edges.append(Edge([self.place[c] for c in chain], *ends, right, left, key=key))
        self.ends = self.ends or set(number)
        self.drawn = self.drawn or {frozenset(pair) for pair in sides}
        tile.nodes = [self.place[corner] for corner in number]

    def polygon(self, number):
        """Oracle: the area of all squares of one component of the map."""
        return shapely.union_all([self.square(cell) for cell, own in self.areas.items() if own == number])

    def square(self, cell):
        row, column = cell
        ring = ((row, column), (row, column + 1), (row + 1, column + 1), (row + 1, column))
        return shapely.Polygon([self.place[corner] for corner in ring])

    def face_polygon(self, tile, face):
        """Oracle: the area of one face of a tile."""
        return shapely.union_all([self.square(cell) for cell, own in tile.face_at.items() if own == face])


def _link(tile):
    """Next edges counter-clockwise, by the angles at which edges leave their nodes."""
    stars = {}
    for i, edge in enumerate(tile.edges, 1):
        for node, (x, y), (x1, y1), is_end in (
            (edge.start_node, edge.places[0], edge.places[1], False),
            (edge.end_node, edge.places[-1], edge.places[-2], True),
        ):
            stars.setdefault(node, []).append((math.atan2(y1 - y, x1 - x), i, is_end))
    for star in stars.values():
        star.sort()
        for (_, i, is_end), (_, follower, _) in zip(star, star[1:] + star[:1], strict=True):
            setattr(tile.edges[i - 1], "right_edge" if is_end else "left_edge", follower)


def _find_rings(tile):
    """Rows of the ring table: face and start edge, outer rings first, by the area that the ring goes round."""
    ends = {}
    for i, edge in enumerate(tile.edges, 1):
        ends[i, True] = (edge.end_node, edge.right_face, edge.right_edge, edge.places)
        ends[i, False] = (edge.start_node, edge.left_face, edge.left_edge, edge.places[::-1])
    angle_first = {}
    for (i, forwards), (_, _, _, places) in ends.items():
        angle_first[i, forwards] = math.atan2(places[1][1] - places[0][1], places[1][0] - places[0][0])
    left, rings = set(ends), []
    while left:
        first = min(left)
        ring, at = [], first
        while True:
            ring.append(at)
            left.discard(at)
            i, forwards = at
            follower = ends[at][2]
            edge = tile.edges[follower - 1]
            choices = [d for d in (True, False) if (edge.start_node if d else edge.end_node) == ends[at][0]]
            if len(choices) == 2:  # a loop: the end that lies counter-clockwise next
                x, y = ends[at][3][-2][0] - ends[at][3][-1][0], ends[at][3][-2][1] - ends[at][3][-1][1]
                back = math.atan2(y, x)
                choices.sort(key=lambda d: (angle_first[follower, d] - back) % (2 * math.pi) or 7.0)
            at = (follower, choices[0])
            if at == first:
                break
        places = [place for side in ring for place in ends[side][3][:-1]]
        area = sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(places, places[1:] + places[:1], strict=True))
        if not any(ends[side][1] == 1 for side in ring) or ends[first][1] == 1:
            rings.append((ends[first][1], area > -1e-9, first[0], ring))
    tile.rings = sorted(rings, key=lambda ring: ring[:3])
