"""Kernel of sight: where rays from one place first run below the faces of a mesh.

A face lies under a ray if its corners lie on both sides of it, or on it. That is asked of corners alone, so faces that share
an edge or a node give the same answer there, and no ray slips through between them. Faces come from bins
(`vpfx.query.location`), so it does not matter whether they hang together.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from vpfx.query.location import bin_of

__all__ = ["first_blocks"]

END = 1e-9
"""Share of a ray at both ends at which nothing blocks it: there it stands on its own ground, or on an edge of it."""

SLACK = 1e-9
"""Of a bin: by so much more the bins under a ray are taken, against rounding."""


@njit(nogil=True, cache=True)
def first_blocks(nodes, face_nodes, observer_z, ways, bulge, graze, is_first, offsets, faces, low, step, n_col, n_row):  # type: ignore[no-untyped-def]
    """Share of each ray at which it is blocked, infinite where it is not, float64 (n,).

    Parameters
    ----------
    nodes : float64 (n_node, 3)
        x and y from the observer.
    face_nodes : int32 (n_face, 3)
    observer_z : float
        Height of the observer, metres.
    ways : float64 (n, 3)
        Ends of the rays: x and y from the observer, height in metres.
    bulge : float64 (n,)
        What curvature adds to the ground at the share t of a ray is bulge · t · (1 − t), metres.
    graze : float
        So far a ray may run below a face, metres.
    is_first : bool
        Whether to look for the first place; else for any.
    offsets, faces, low, step, n_col, n_row
        Faces in bins.

    Notes
    -----
    Bins are taken column by column in the direction of the ray; in each, the rows under it. Cost: the faces in those bins.
    """
    found = np.full(len(ways), np.inf)
    for ray in range(len(ways)):
        x, y = ways[ray, 0], ways[ray, 1]
        first, last = bin_of(0.0, low[0], step[0], n_col), bin_of(x, low[0], step[0], n_col)
        col_step = 1 if last >= first else -1
        for col in range(first, last + col_step, col_step):
            # shares of the ray at which it comes into the column and leaves it
            enter, leave = 0.0, 1.0
            if x != 0.0:
                one = (low[0] + (col - SLACK) * step[0]) / x
                other = (low[0] + (col + 1 + SLACK) * step[0]) / x
                enter = max(enter, min(one, other)) if col != first else 0.0
                leave = min(leave, max(one, other)) if col != last else 1.0
            if enter > found[ray]:
                break
            y0, y1 = min(enter * y, leave * y), max(enter * y, leave * y)
            row0 = bin_of(y0 - SLACK * step[1], low[1], step[1], n_row)
            row1 = bin_of(y1 + SLACK * step[1], low[1], step[1], n_row)
            for row in range(row0, row1 + 1):
                for at in range(offsets[row * n_col + col], offsets[row * n_col + col + 1]):
                    share = _block(nodes, face_nodes[faces[at]], observer_z, ways[ray], bulge[ray], graze)
                    found[ray] = min(found[ray], share)
                if not is_first and found[ray] < np.inf:
                    break
            if not is_first and found[ray] < np.inf:
                break
    return found


@njit(nogil=True, cache=True)
def _block(nodes, corner, observer_z, way, bulge, graze):  # type: ignore[no-untyped-def]
    r"""Share of a ray at which one face blocks it, infinite if it does not.

           c           side of a corner: above 0 to the left of the ray, below 0 to its right. The ray goes over the
          / \          face from the least to the greatest share at which it meets an edge (*) or a corner.
    ray--*---*--> end
        a-----b
    """
    length = way[0] * way[0] + way[1] * way[1]
    if length == 0.0:
        return _block_upright(nodes, corner, observer_z, way[2], graze)
    start, end, gap_start, gap_end = np.inf, -np.inf, 0.0, 0.0
    for i in range(3):
        a, b = nodes[corner[i]], nodes[corner[(i + 1) % 3]]
        side_a, side_b = way[0] * a[1] - way[1] * a[0], way[0] * b[1] - way[1] * b[0]
        if side_a != 0.0 and (side_b == 0.0 or (side_a < 0.0) == (side_b < 0.0)):
            continue
        part = 0.0 if side_a == 0.0 else side_a / (side_a - side_b)
        x, y, z = a[0] + part * (b[0] - a[0]), a[1] + part * (b[1] - a[1]), a[2] + part * (b[2] - a[2])
        share = (x * way[0] + y * way[1]) / length
        gap = z - observer_z - share * (way[2] - observer_z)
        if share < start:
            start, gap_start = share, gap
        if share > end:
            end, gap_end = share, gap
    if end <= END or start >= 1.0 - END:
        return np.inf
    rise = (gap_end - gap_start) / (end - start) if end > start else 0.0
    return _first_above(max(start, 0.0), min(end, 1.0), gap_start - rise * start, rise, bulge, graze)


@njit(nogil=True, cache=True)
def _block_upright(nodes, corner, observer_z, end, graze):  # type: ignore[no-untyped-def]
    """Share of an upright ray at which a face over or under the observer blocks it, infinite if it does not."""
    a, b, c = nodes[corner[0]], nodes[corner[1]], nodes[corner[2]]
    of_a, of_b, of_c = b[0] * c[1] - b[1] * c[0], c[0] * a[1] - c[1] * a[0], a[0] * b[1] - a[1] * b[0]
    if min(of_a, of_b, of_c) < 0.0:
        return np.inf
    z = (of_a * a[2] + of_b * b[2] + of_c * c[2]) / (of_a + of_b + of_c)
    is_between = min(observer_z, end) < z - graze and z + graze < max(observer_z, end)
    return (z - observer_z) / (end - observer_z) if is_between else np.inf


@njit(nogil=True, cache=True)
def _first_above(start, end, base, rise, bulge, graze):  # type: ignore[no-untyped-def]
    """First share from start to end at which base + rise · t + bulge · t · (1 − t) is above a bound; infinite if none."""
    slope = rise + bulge
    top = end
    if bulge > 0.0:
        top = min(max(slope / (2.0 * bulge), start), end)
    elif rise <= 0.0:
        top = start
    if base + slope * top - bulge * top * top <= graze:
        return np.inf
    if base + slope * start - bulge * start * start > graze:
        return start
    # between start and top the gap comes up through 0, or through the bound where it is above 0 from the start
    level = base if base + slope * start - bulge * start * start <= 0.0 else base - graze
    if bulge == 0.0:
        return min(max(-level / slope, start), top)
    root = np.sqrt(max(slope * slope + 4.0 * bulge * level, 0.0))
    return min(max(2.0 * level / (-slope - root) if slope + root != 0.0 else start, start), top)
