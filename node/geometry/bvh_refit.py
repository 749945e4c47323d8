"""Refits a hierarchy after its surfaces have moved: the same tree, new boxes.

A tree whose surfaces have moved apart has large boxes that overlap, and rays open more of them. So the expected cost of a
ray (`node.geometry.bvh`) is worked out as well, and whoever asked builds a new tree when it has grown too much.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raygrid.node.geometry.bvh import (
    COUNT_MASK,
    COUNT_SHIFT,
    EMPTY_BOUND,
    FIRST_MASK,
    INFLATE,
    ITEM_COST,
    LEAF_BIT,
    NODE_COST,
    NODE_WORDS,
    aligned,
)
from raygrid.node.geometry.bvh_boxes import CHILD_COLUMN, WIDE
from raygrid.node.jit.decorators import kernel

WORSE = 1.25  # expected cost, against that of the tree when it was built, from which building anew pays


@kernel
def _refit(floats, words, boxes, whole):
    """Write the boxes of all nodes, the last first: children have larger numbers than their parents."""
    for node in range(len(floats) - 1, -1, -1):
        whole[node, :3], whole[node, 3:] = np.inf, -np.inf
        for lane in range(WIDE):
            if floats[node, lane] == EMPTY_BOUND:
                continue
            child = np.int64(words[node, CHILD_COLUMN + lane])
            for c in range(3):
                low, high = np.inf, -np.inf
                if child & LEAF_BIT:
                    first = child & FIRST_MASK
                    for item in range(first, first + (child >> COUNT_SHIFT & COUNT_MASK) + 1):
                        low, high = min(low, boxes[item, 0, c]), max(high, boxes[item, 1, c])
                else:
                    low, high = whole[child, c], whole[child, 3 + c]
                floats[node, c * WIDE + lane] = np.float32(low - INFLATE)
                floats[node, (3 + c) * WIDE + lane] = np.float32(high + INFLATE)
                whole[node, c] = min(whole[node, c], low)
                whole[node, 3 + c] = max(whole[node, 3 + c], high)


@kernel
def _expected(floats, words):
    """The cost of all children, each times its area, over the area of the whole."""
    cost = 0.0
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for node in range(len(floats)):
        for lane in range(WIDE):
            if floats[node, lane] == EMPTY_BOUND:
                continue
            child = np.int64(words[node, CHILD_COLUMN + lane])
            x = np.float64(floats[node, 3 * WIDE + lane]) - floats[node, lane]
            y = np.float64(floats[node, 4 * WIDE + lane]) - floats[node, WIDE + lane]
            z = np.float64(floats[node, 5 * WIDE + lane]) - floats[node, 2 * WIDE + lane]
            items = (child >> COUNT_SHIFT & COUNT_MASK) + 1
            cost += (x * y + y * z + z * x) * (items * ITEM_COST if child & LEAF_BIT else NODE_COST)
            if node == 0:
                for c in range(3):
                    low[c] = min(low[c], np.float64(floats[node, c * WIDE + lane]))
                    high[c] = max(high[c], np.float64(floats[node, (3 + c) * WIDE + lane]))
    x, y, z = high[0] - low[0], high[1] - low[1], high[2] - low[2]
    return cost / (x * y + y * z + z * x)


def expected_cost(floats: NDArray[np.float32]) -> float:
    """Average cost of a ray that meets the whole, in tests of a surface; `floats` as of `bvh.build`."""
    return float(_expected(floats, floats.view(np.uint32)))


def refitted(floats: NDArray[np.float32], boxes: NDArray[np.float64]) -> NDArray[np.float32]:
    """The tree `floats` over boxes (items, 2, 3) in leaf order, float32 (n, NODE_WORDS)."""
    fitted = aligned(len(floats))
    fitted[:] = floats
    _refit(fitted, fitted.view(np.uint32), np.ascontiguousarray(boxes), np.empty((len(floats), 6)))
    assert fitted.shape[1] == NODE_WORDS
    return fitted
