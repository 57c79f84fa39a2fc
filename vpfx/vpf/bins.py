"""Kernels of the tree of bins that a spatial index is (specs/vpf.md, V-302).

A bin's number says where it lies: bin k has the children 2k and 2k + 1, the even one to the right or above::

    bin 1                 bins 2, 3             bins 4 to 7
    +-------------+       +------+------+       +------+------+
    |             |       |      |      |       |  6   |  4   |
    |      1      |  x    |  3   |  2   |  y    +------+------+
    |             |       |      |      |       |  7   |  5   |
    +-------------+       +------+------+       +------+------+

A box that crosses a cut stays in the bin that is cut.
"""

from __future__ import annotations

import numpy as np
from numba import njit

__all__ = ["bin_boxes", "is_placed", "place_boxes", "walk_bins"]

DEEPEST = 32  # cuts above a bin whose number fits 31 bits


@njit(nogil=True, cache=True)
def place_boxes(boxes, n_cut):
    """Bin of each box, int16 (n,): the smallest that holds it, at most n_cut cuts down. Source: V-302."""
    bins = np.empty(boxes.shape[0], np.int16)
    for i in range(boxes.shape[0]):
        number = 1
        low = [0, 0]
        high = [255, 255]
        for cut in range(n_cut):
            axis = cut & 1
            at = low[axis] + ((high[axis] - low[axis]) >> 1)
            if boxes[i, axis] >= at:
                number = 2 * number
                low[axis] = at
            elif boxes[i, axis + 2] <= at:
                number = 2 * number + 1
                high[axis] = at
            else:
                break
        bins[i] = number
    return bins


@njit(nogil=True, cache=True)
def is_placed(starts, boxes):
    """Whether each box lies in the place of its bin, bool (n,). Source: V-302."""
    answer = np.empty(boxes.shape[0], np.bool_)
    for k in range(1, starts.shape[0]):
        if starts[k - 1] == starts[k]:
            continue
        n_cut = 0
        while k >> (n_cut + 1):
            n_cut += 1
        low = [0, 0]
        high = [255, 255]
        for cut in range(n_cut):
            axis = cut & 1
            at = low[axis] + ((high[axis] - low[axis]) >> 1)
            if k >> (n_cut - 1 - cut) & 1:
                high[axis] = at
            else:
                low[axis] = at
        for i in range(starts[k - 1], starts[k]):
            answer[i] = (
                low[0] <= boxes[i, 0] and low[1] <= boxes[i, 1] and boxes[i, 2] <= high[0] and boxes[i, 3] <= high[1]
            )
    return answer


@njit(nogil=True, cache=True)
def bin_boxes(starts, boxes):
    """Box around the boxes of each bin and of all bins below it, uint8 (n_bin + 1, 4); row 0 is not used."""
    around = np.empty((starts.shape[0], 4), np.uint8)
    around[:, :2] = 255
    around[:, 2:] = 0
    for k in range(starts.shape[0] - 1, 0, -1):
        for i in range(starts[k - 1], starts[k]):
            for axis in range(2):
                around[k, axis] = min(around[k, axis], boxes[i, axis])
                around[k, axis + 2] = max(around[k, axis + 2], boxes[i, axis + 2])
        for axis in range(2):
            around[k >> 1, axis] = min(around[k >> 1, axis], around[k, axis])
            around[k >> 1, axis + 2] = max(around[k >> 1, axis + 2], around[k, axis + 2])
    return around


@njit(nogil=True, cache=True)
def walk_bins(query, starts, around, boxes, ids, found):
    """Fill `found` with the ids of boxes that touch the query, int64 (4,) in steps; return how many. Source: V-302."""
    n = 0
    stack = np.empty(DEEPEST + 2, np.int64)
    stack[0] = 1
    n_stack = 1 if starts.shape[0] > 1 else 0
    while n_stack > 0:
        n_stack -= 1
        k = stack[n_stack]
        box = around[k]
        if box[0] > query[2] or box[2] < query[0] or box[1] > query[3] or box[3] < query[1]:
            continue
        for i in range(starts[k - 1], starts[k]):
            box = boxes[i]
            if box[0] <= query[2] and box[2] >= query[0] and box[1] <= query[3] and box[3] >= query[1]:
                found[n] = ids[i]
                n += 1
        for child in (2 * k, 2 * k + 1):
            if child < starts.shape[0]:
                stack[n_stack] = child
                n_stack += 1
    return n
