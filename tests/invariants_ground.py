"""Judge of one level against the posts: that its faces tile the ground with data and keep the vertical error.

A tiling is proved, not sampled: if all faces turn counter-clockwise, no edge is used twice in one sense, and the edges
used once run along the outline of the ground, once, with the ground on their left, then every place of the ground is
covered exactly once and nothing else is (a chain of faces is determined by its boundary).
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
from invariants_mesh import (
    CHUNK,
    PLAIN,
    UNIT,
    Border,
    Label,
    border_halves,
    border_length,
    chunks,
    coordinate_tolerance,
    ragged,
    require,
    total_area,
)

HEIGHT_ULPS = 8
"""Heights are trusted to this many ulps of the greatest |z|: an interpolation in floats rounds about so often."""

LINE_BITS = 24
"""Rows and columns, and their sums, fit into so many bits of a key."""


class Posts(NamedTuple):
    """Heights on a lattice, row 0 in the south; `vpfx.model.Grid` has the same fields."""

    heights: Any
    x0: float
    y0: float
    dx: float
    dy: float


class Ground(NamedTuple):
    """The ground with data in lattice units: its outline as straight runs, its posts, its Euler characteristic."""

    key: Any  # per run: direction and lattice line in one number, ascending
    low: Any  # per run: least column (row, if it runs north or south)
    high: Any  # per run: greatest column (row)
    has_post: Any  # (n_row, n_col) bool: posts on the ground
    n_triangle: int  # lattice triangles, each half a square
    euler: int  # V - E + F of its lattice triangles


class Measured(NamedTuple):
    """Vertical errors of one level, each post of the ground counted once."""

    max_error: float
    rmse: float
    squared_error: float
    n_post: int
    least_max: float  # max_error can be no less than this,
    greatest_max: float  # nor more than this, however coordinates were rounded
    rmse_slack: float


def find_ground(heights: Any) -> Ground:
    """Outline, posts and Euler characteristic of the lattice triangles whose three corners are valid.

    ::

        nw ─ top ─ ne      The triangle of a square with one void corner has two of the sides and one diagonal.
        │           │      A side counts for the square on either side of it, with opposite sign;
        west     east      what is left over is the outline, with the ground on its left.
        │           │
        sw ─bottom─ se
    """
    valid = np.isfinite(heights)
    n_row, n_col = valid.shape
    require(max(n_row, n_col) < 1 << (LINE_BITS - 2), "a lattice too large for the keys of its lines")
    sw, se, nw, ne = valid[:-1, :-1], valid[:-1, 1:], valid[1:, :-1], valid[1:, 1:]
    count = sw.astype(np.int8) + se + nw + ne
    piece, three = count >= 3, count == 3
    across, along = np.zeros((2, n_row, n_col - 1), np.int8), np.zeros((2, n_row - 1, n_col), np.int8)
    across[0, :-1], across[1, 1:] = piece & sw & se, piece & nw & ne
    along[0, :, 1:], along[1, :, :-1] = piece & se & ne, piece & sw & nw
    has_post = np.zeros(valid.shape, bool)
    corners = ((has_post[:-1, :-1], sw), (has_post[:-1, 1:], se), (has_post[1:, :-1], nw), (has_post[1:, 1:], ne))
    for post, corner in corners:
        post |= piece & corner
    east, north = across[0] - across[1], along[0] - along[1]
    sides = [
        *((0, forward, *np.nonzero(east == sign)) for forward, sign in ((1, 1), (0, -1))),
        *((1, forward, *np.nonzero(north == sign)) for forward, sign in ((1, 1), (0, -1))),
        *((2, forward, *np.nonzero(three & ~corner)) for forward, corner in ((1, se), (0, nw))),
        *((3, forward, *np.nonzero(three & ~corner)) for forward, corner in ((1, sw), (0, ne))),
    ]
    n_triangle = int(piece.sum()) + int((count == 4).sum())
    n_edge = int(across.any(axis=0).sum()) + int(along.any(axis=0).sum()) + int(piece.sum())
    return Ground(*_runs(sides), has_post, n_triangle, int(has_post.sum()) - n_edge + n_triangle)


def _line_key(kind: Any, forward: Any, line: Any) -> Any:
    """One number for a directed lattice line: row, column, column - row or column + row constant; forward or back."""
    return ((np.asarray(kind, np.int64) * 2 + forward) << LINE_BITS) + np.asarray(line, np.int64) + (1 << LINE_BITS - 1)


def _runs(sides: list[Any]) -> tuple[Any, Any, Any]:
    """Join unit sides (kind, forward, row, column) that continue each other into straight runs."""
    keys, lows = [], []
    for kind, forward, row, col in sides:
        line = (row, col, col - row, col + row + 1)[kind]
        keys.append(_line_key(kind, forward, line))
        lows.append(row if kind == 1 else col)
    key, low = np.concatenate(keys), np.concatenate(lows)
    order = np.lexsort((low, key))
    key, low = key[order], low[order]
    is_first = np.ones(len(key), bool)
    is_first[1:] = (key[1:] != key[:-1]) | (low[1:] != low[:-1] + 1)
    return key[is_first], low[is_first], low[np.roll(is_first, -1)] + 1


def judge_cover(
    nodes: Any, face_nodes: Any, posts: Any, ground: Ground, *, border: Border | None = None, label: Label = PLAIN
) -> float:
    """Judge that faces which `judge_mesh` has passed tile exactly the ground; return their area.

    Parameters
    ----------
    border : Border, optional
        What `judge_mesh` found; needed where there may be T-junctions.

    The sides with one face must run once along every run of the outline, ground on their left; area and Euler
    characteristic must then agree too and are compared as further witnesses.
    """
    xy, faces = np.asarray(nodes, np.float64)[:, :2], np.asarray(face_nodes, np.int64)
    if len(ground.key) == 0:
        label.accuse(len(faces) > 0, lambda _: "faces, but no ground with data")
        return 0.0
    half, n_edge = border_halves(faces, len(xy), label)
    if border is not None:
        half, n_edge = border.half, border.n_edge - len(border.long)  # of two edges side by side the shorter ones count
    start, end = faces.ravel()[half], np.roll(faces, -1, axis=1).ravel()[half]
    tolerance = coordinate_tolerance(xy, _far_corner(posts))
    slack = tolerance / np.array([posts.dx, posts.dy])
    lattice = (xy - (posts.x0, posts.y0)) / (posts.dx, posts.dy)
    key, low, high = _on_lines(lattice[start], lattice[end], slack)
    reach = slack.sum()
    place = (key << LINE_BITS) + np.maximum(np.floor(low + reach), 0).astype(np.int64)
    run = np.maximum(np.searchsorted((ground.key << LINE_BITS) + ground.low, place, side="right") - 1, 0)
    is_off = (ground.key[run] != key) | (low < ground.low[run] - reach) | (high > ground.high[run] + reach)
    label.accuse(
        is_off,
        lambda i: (
            f"{label.face(half[i] // 3)}: edge {label.node(start[i])} – {label.node(end[i])} "
            "has no other face and does not lie on the outline of the ground"
        ),
    )
    order = np.lexsort((low, run))
    judge_runs(ground, run[order], low[order], high[order], reach, label)
    area, expected = total_area(xy, faces), ground.n_triangle * posts.dx * posts.dy / 2
    allowed = tolerance * border_length(xy, faces, half) + 4 * UNIT * expected
    label.accuse(abs(area - expected) > allowed, lambda _: f"faces cover {area!r}, the ground is {expected!r}")
    euler = len(np.unique(faces)) - n_edge + len(faces)
    label.accuse(euler != ground.euler, lambda _: f"V - E + F is {euler}, that of the ground is {ground.euler}")
    return area


def _far_corner(posts: Any) -> Any:
    """Greatest |x| and |y| of the posts."""
    n_row, n_col = posts.heights.shape
    return np.array([posts.x0, posts.y0, posts.x0 + (n_col - 1) * posts.dx, posts.y0 + (n_row - 1) * posts.dy])


def _on_lines(start: Any, end: Any, slack: Any) -> tuple[Any, Any, Any]:
    """Directed lattice line on which each side lies (-1: none), and the interval it takes there."""
    key, low, high = np.full(len(start), -1, np.int64), np.zeros(len(start)), np.zeros(len(start))
    for kind in range(4):
        line = [(p[:, 1], p[:, 0], p[:, 0] - p[:, 1], p[:, 0] + p[:, 1])[kind] for p in (start, end)]
        place = [p[:, 1 if kind == 1 else 0] for p in (start, end)]
        reach = (slack[1], slack[0], slack.sum(), slack.sum())[kind]
        nearest = np.rint(line[0])
        is_on = (np.abs(line[0] - nearest) <= reach) & (np.abs(line[1] - nearest) <= reach) & (key < 0)
        is_on &= np.abs(nearest) < 1 << (LINE_BITS - 1)
        key = np.where(is_on, _line_key(kind, place[1] > place[0], np.where(is_on, nearest, 0)), key)
        low, high = np.where(is_on, np.minimum(*place), low), np.where(is_on, np.maximum(*place), high)
    return key, low, high


def judge_runs(ground: Ground, run: Any, low: Any, high: Any, reach: float, label: Label) -> None:
    """Sides sorted along each run begin at its beginning, continue each other and end at its end."""

    def name(i: int) -> str:
        kind, line = divmod(int(ground.key[i]), 2 << LINE_BITS)
        where = ("row", "column", "column - row", "column + row")[kind]
        line = line % (1 << LINE_BITS) - (1 << LINE_BITS - 1)
        return f"outline of the ground on {where} {line} from {ground.low[i]} to {ground.high[i]}"

    has_side = np.zeros(len(ground.key), bool)
    has_side[run] = True
    label.accuse(~has_side, lambda i: f"{name(i)}: no edge lies on it")
    is_first = np.ones(len(run), bool)
    is_first[1:] = run[1:] != run[:-1]
    begin = np.where(is_first, ground.low[run], np.roll(high, 1))
    label.accuse(np.abs(low - begin) > reach, lambda i: f"{name(run[i])}: a gap or two edges at {low[i]:.9g}")
    is_short = np.roll(is_first, -1) & (np.abs(high - ground.high[run]) > reach)
    label.accuse(is_short, lambda i: f"{name(run[i])}: edges end at {high[i]:.9g}")


class _Planes(NamedTuple):
    """Faces ready for interpolation, corners a, b, c; one entry per face."""

    number: Any  # index of the face in the level
    corners: Any  # (n, 3, 3) a, b, c by x, y, z
    to_b: Any  # (n, 3) b - a
    to_c: Any  # (n, 3) c - a
    area: Any  # twice the plan area
    reach: Any  # (n, 3) an area coordinate of a, b, c may be so much below 0
    error: Any  # forward bound of the error of a vertical error computed in floats
    slack: Any  # what rounding of coordinates can change it by, at most


def _planes(nodes: Any, faces: Any, number: Any, tolerance: tuple[float, float], label: Label) -> _Planes:
    """Prepare faces for interpolation; `tolerance` is that of x and y, and an ulp of the heights.

    An area coordinate is the difference of two products of differences: its error is at most 8 half-ulps of width ×
    height; that of its quotient by the area at most four times as much, all roundings of the rise included.
    """
    corners = nodes[faces]
    to_b, to_c = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = to_b[:, 0] * to_c[:, 1] - to_b[:, 1] * to_c[:, 0]
    label.accuse(area <= 0, lambda i: f"{label.face(number[i])}: not counter-clockwise")
    width, height = (np.maximum(np.abs(to_b[:, i]), np.abs(to_c[:, i])) for i in range(2))
    noise = 8 * UNIT * width * height
    sides = corners[:, [2, 0, 1]] - corners[:, [1, 2, 0]]
    opposite = np.hypot(sides[:, :, 0], sides[:, :, 1])
    relief = np.abs(to_b[:, 2]) + np.abs(to_c[:, 2])
    slope = [(to_b[:, 2] * to_c[:, i] - to_c[:, 2] * to_b[:, i]) / area for i in (0, 1)]
    return _Planes(
        number,
        corners,
        to_b,
        to_c,
        area,
        tolerance[0] * opposite + noise[:, None],
        4 * noise / area * relief + 2 * tolerance[1],
        np.minimum(np.hypot(*slope) * tolerance[0], relief) + HEIGHT_ULPS * tolerance[1],
    )


def judge_bound(
    nodes: Any, face_nodes: Any, is_filled: Any, posts: Any, *, bound: float = math.nan, is_adjacent: bool = True,
    label: Label = PLAIN,
) -> Measured:  # fmt: skip
    """Judge that each post of the ground is covered and lies within `bound` of the surface; measure the errors.

    Parameters
    ----------
    nodes, face_nodes
        As in `judge_tin`.
    is_filled : bool (n_face,)
        Faces that are left out, since there are no data under them.
    posts : Posts or Grid
        The lattice with heights in metres.
    bound : float
        Metres; NaN if there is none.
    is_adjacent : bool
        Whether faces agree on their edges; else the one that is farthest off counts.

    Returns
    -------
    Measured
        All 0 where there is no ground, as in a store of faces that are all filled (specs/format.md R-121).

    Raises
    ------
    AssertionError
        A post is uncovered or off by more than the bound, or a void post lies in a face.
    """
    nodes, faces = np.asarray(nodes, np.float64), np.asarray(face_nodes, np.int64)
    number = np.flatnonzero(~np.asarray(is_filled, bool))
    tolerance = coordinate_tolerance(nodes[:, :2], _far_corner(posts))
    has_post = find_ground(posts.heights).has_post.ravel()
    if not has_post.any():
        label.accuse(len(number) > 0, lambda _: "faces, but no ground with data")
        return Measured(0.0, 0.0, 0.0, 0, 0.0, 0.0, 0.0)
    highest = max(np.abs(nodes[:, 2]).max(), np.nanmax(np.abs(posts.heights)))
    planes = _planes(nodes, faces[number], number, (tolerance, float(np.spacing(highest))), label)
    best, face = _interpolate(planes, posts, tolerance, is_adjacent, label)
    n_col = posts.heights.shape[1]
    label.accuse(has_post & (face < 0), lambda i: f"post {divmod(i, n_col)}: no face covers it")
    best, face, post = best[has_post], face[has_post], np.flatnonzero(has_post)
    _judge_worst(planes, posts, (best, face, post), bound, label)
    spread = planes.error[face] + planes.slack[face]
    squared, n_post = float(np.sum(best * best)), len(best)
    return Measured(
        float(best.max()),
        math.sqrt(squared / n_post),
        squared,
        n_post,
        float((best - spread).max()),
        float((best + spread).max()),
        math.sqrt(float(np.mean(spread * spread))),
    )


def _interpolate(planes: _Planes, posts: Any, tolerance: float, is_adjacent: bool, label: Label) -> tuple[Any, Any]:
    """Vertical error at every post (infinite where no face is) and the face, as a row of `planes`, it was taken from.

    A post on an edge or node is in several faces, which agree there up to the rounding of coordinates; the least error
    counts, or, without `is_adjacent`, the greatest. A post beside a face by less than the tolerance takes the height of the
    nearest place of the face.
    """
    n_row, n_col = posts.heights.shape
    heights = np.ascontiguousarray(posts.heights, np.float64).ravel()
    xs, ys = posts.x0 + np.arange(n_col) * posts.dx, posts.y0 + np.arange(n_row) * posts.dy
    best, owner = np.full(heights.size, np.inf if is_adjacent else -np.inf), np.full(heights.size, -1, np.int32)
    u, v = (planes.corners[:, :, 0] - posts.x0) / posts.dx, (planes.corners[:, :, 1] - posts.y0) / posts.dy
    pad = 2 * tolerance / posts.dx, 2 * tolerance / posts.dy
    for face, row, col in _pairs(u, v, (n_row, n_col), pad):
        a, to_b, to_c = planes.corners[face, 0], planes.to_b[face], planes.to_c[face]
        x, y = xs[col] - a[:, 0], ys[row] - a[:, 1]
        at_b = x * to_c[:, 1] - y * to_c[:, 0]
        at_c = to_b[:, 0] * y - to_b[:, 1] * x
        at_a = planes.area[face] - at_b - at_c
        reach = planes.reach[face]
        is_in = (at_a >= -reach[:, 0]) & (at_b >= -reach[:, 1]) & (at_c >= -reach[:, 2])
        at_a, at_b, at_c = np.maximum(at_a, 0), np.maximum(at_b, 0), np.maximum(at_c, 0)
        post = row * n_col + col
        rise = (at_b * to_b[:, 2] + at_c * to_c[:, 2]) / (at_a + at_b + at_c)
        error = np.abs(a[:, 2] + rise - heights[post])
        label.accuse(
            is_in & ~np.isfinite(error),
            lambda i, face=face, row=row, col=col: (
                f"{label.face(planes.number[face[i]])}: covers the void post ({row[i]}, {col[i]})"
            ),
        )
        post, error, face = post[is_in], error[is_in], face[is_in]
        (np.minimum if is_adjacent else np.maximum).at(best, post, error)
        is_best = error == best[post]
        owner[post[is_best]] = face[is_best]
    return best, owner


def _pairs(u: Any, v: Any, shape: tuple[int, int], pad: tuple[float, float]) -> Any:
    """Yield (face, row, column) of all posts in or near each face, a few hundred thousand at a time.

    In each row, a face reaches from the least to the greatest u of its sides within the row ± pad.
    """
    first = np.clip(np.ceil(v.min(axis=1) - pad[1]), 0, shape[0]).astype(np.int64)
    n_row = np.maximum(np.clip(np.floor(v.max(axis=1) + pad[1]), -1, shape[0] - 1).astype(np.int64) - first + 1, 0)
    for part in chunks(n_row):
        face, row = ragged(first[part], n_row[part])
        face += part.start
        low, high = np.full(len(face), np.inf), np.full(len(face), -np.inf)
        for i, j in ((0, 1), (1, 2), (2, 0)):
            u1, v1, u2, v2 = u[face, i], v[face, i], u[face, j], v[face, j]
            bottom = np.maximum(np.minimum(v1, v2), row - pad[1])
            top = np.minimum(np.maximum(v1, v2), row + pad[1])
            for cut, end in ((bottom, u1), (top, u2)):
                part_of = np.divide(cut - v1, v2 - v1, out=np.zeros(len(face)), where=v1 != v2)
                place = np.where(v1 == v2, end, u1 + np.clip(part_of, 0, 1) * (u2 - u1))
                low = np.where(bottom <= top, np.minimum(low, place), low)
                high = np.where(bottom <= top, np.maximum(high, place), high)
        start = np.ceil(np.clip(low - pad[0], 0, shape[1])).astype(np.int64)
        count = np.maximum(np.floor(np.clip(high + pad[0], -1, shape[1] - 1)).astype(np.int64) - start + 1, 0)
        for piece in chunks(count, CHUNK):
            span, col = ragged(start[piece], count[piece])
            yield face[piece][span], row[piece][span], col


def _judge_worst(planes: _Planes, posts: Any, measured: tuple[Any, Any, Any], bound: float, label: Label) -> None:
    """No post is off by more than the bound; where floats cannot tell, fractions do."""
    best, face, post = measured
    if math.isnan(bound):
        return
    n_col = posts.heights.shape[1]
    excess, doubt = best - bound - planes.slack[face], planes.error[face]
    is_wrong = excess > doubt
    for i in np.flatnonzero((excess > -doubt) & ~is_wrong):
        error = _exact_error(planes.corners[face[i]], posts, *divmod(int(post[i]), n_col))
        is_wrong[i] = error > Fraction(bound) + Fraction(float(planes.slack[face[i]]))
    worst = int(np.argmax(np.where(is_wrong, best, -1.0)))
    label.accuse(
        is_wrong.any(),
        lambda _: (
            f"post {divmod(int(post[worst]), n_col)}: {best[worst]:.9g} m off "
            f"{label.face(planes.number[face[worst]])}, the bound is {bound!r} m"
        ),
    )


def _exact_error(corners: Any, posts: Any, row: int, col: int) -> Fraction:
    """Vertical error of one post against the plane of one face, without error."""
    a, b, c = ([Fraction(float(value)) for value in corner] for corner in corners)
    post = [Fraction(float(v)) for v in (posts.x0 + col * posts.dx, posts.y0 + row * posts.dy, posts.heights[row, col])]
    to_b, to_c, to_p = ([q - p for p, q in zip(a, other, strict=True)] for other in (b, c, post))
    area = to_b[0] * to_c[1] - to_b[1] * to_c[0]
    at_b, at_c = to_p[0] * to_c[1] - to_p[1] * to_c[0], to_b[0] * to_p[1] - to_b[1] * to_p[0]
    return abs((at_b * to_b[2] + at_c * to_c[2]) / area - to_p[2])
