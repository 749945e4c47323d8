"""The bounding volume hierarchy of one node: built by binned SAH (Wald 2007), two-wide, walked front to back.

Layout. A node of the hierarchy is 16 words of 32 bits, one cache line, and holds the boxes of its two
children and where they are:

    words 0-2 low, 3-5 high of child 0;  6-8 low, 9-11 high of child 1          (binary32)
    words 12, 13  child: number of an inner node, or of a leaf's first item     (int32)
    words 14, 15  0 for an inner node, else how many items the leaf has         (int32)

The same memory is seen as float32 (n, 16) and int32 (n, 16). Items are the surfaces in leaf order.

The boxes only save work: whatever the hierarchy, the same hits must be found (law 4). So boxes are
widened by INFLATE, more than all roundings of the binary32 slab test together can make it err: a box
edge, an origin and their difference are each off by at most 2^-24 of numbers below 2, the product with
the rounded inverse by 2^-23 of itself, so the test errs by less than 5e-7 of a position.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .compiled import kernel, part

INFLATE = 4e-6  # machine coordinates
LEAF = 4  # most items in a leaf, unless their centres coincide
BINS = 16
DEPTH = 96  # most entries on the stack of a walk
FAR = np.float32(3e38)  # time of a box that is missed
NOWHERE = np.float32(1e30)  # a point that no ray reaches within its bounds


@kernel
def _bin_split(boxes, order, first, count, low, high, counts, bounds):
    """Best (axis, border) to split the items by centre, by surface area heuristic; axis -1 if none is better."""
    best_axis, best_border, best_cost = -1, 0, np.inf
    for axis in range(3):
        extent = high[axis] - low[axis]
        if not extent > 0.0:
            continue
        scale = BINS * (1.0 - 1e-9) / extent
        counts[:] = 0
        bounds[:, :3] = np.inf
        bounds[:, 3:] = -np.inf
        for k in range(first, first + count):
            item = order[k]
            b = np.int64((0.5 * (boxes[item, 0, axis] + boxes[item, 1, axis]) - low[axis]) * scale)
            counts[b] += 1
            for c in range(3):
                bounds[b, c] = min(bounds[b, c], boxes[item, 0, c])
                bounds[b, 3 + c] = max(bounds[b, 3 + c], boxes[item, 1, c])
        border, cost = _best_border(counts, bounds)
        if cost < best_cost:
            best_axis, best_border, best_cost = axis, border, cost
    return best_axis, best_border, best_cost


@part
def _grow(box, bounds, b):
    for c in range(3):
        box[c] = min(box[c], bounds[b, c])
        box[3 + c] = max(box[3 + c], bounds[b, 3 + c])


@part
def _half_area(box):
    x, y, z = box[3] - box[0], box[4] - box[1], box[5] - box[2]
    return x * y + y * z + z * x


@kernel
def _best_border(counts, bounds):
    """The border between bins with the least sum of area times items, and that sum."""
    right = np.empty(BINS)
    box = np.empty(6)
    box[:3], box[3:] = np.inf, -np.inf
    items = 0
    for b in range(BINS - 1, 0, -1):
        if counts[b] > 0:
            _grow(box, bounds, b)
            items += counts[b]
        right[b] = _half_area(box) * items if items > 0 else np.inf
    box[:3], box[3:] = np.inf, -np.inf
    items, best, cost = 0, 0, np.inf
    for b in range(BINS - 1):
        if counts[b] > 0:
            _grow(box, bounds, b)
            items += counts[b]
        if items > 0 and _half_area(box) * items + right[b + 1] < cost:
            best, cost = b + 1, _half_area(box) * items + right[b + 1]
    return best, cost


@kernel
def _partition(boxes, order, first, count, axis, low, scale, border):
    """Move the items of bins below `border` to the front; returns how many they are."""
    i, j = first, first + count - 1
    while i <= j:
        item = order[i]
        if np.int64((0.5 * (boxes[item, 0, axis] + boxes[item, 1, axis]) - low) * scale) < border:
            i += 1
        else:
            order[i], order[j] = order[j], item
            j -= 1
    return i - first


@kernel
def _item_bounds(boxes, order, first, count, whole, centres):
    """Box of the items, and box of their centres."""
    whole[0], centres[0] = np.inf, np.inf
    whole[1], centres[1] = -np.inf, -np.inf
    for k in range(first, first + count):
        item = order[k]
        for c in range(3):
            low, high = boxes[item, 0, c], boxes[item, 1, c]
            middle = 0.5 * (low + high)
            whole[0, c] = min(whole[0, c], low)
            whole[1, c] = max(whole[1, c], high)
            centres[0, c] = min(centres[0, c], middle)
            centres[1, c] = max(centres[1, c], middle)


@kernel
def _build(boxes, order, floats, ints, stack):
    """Fill the nodes; returns how many there are. `stack` (m, 4): first item, items, parent, which child."""
    whole, centres = np.empty((2, 3)), np.empty((2, 3))
    counts, bounds = np.empty(BINS, np.int64), np.empty((BINS, 6))
    made, top = 1, 0
    floats[0] = 0.0
    ints[0, 12:] = 0
    floats[0, 6:12] = NOWHERE  # node 0 has one child, the whole tree; its other box never meets a ray
    stack[0] = (0, len(order), 0, 0)
    while top >= 0:
        first, count, parent, side = stack[top]
        top -= 1
        _item_bounds(boxes, order, first, count, whole, centres)
        for c in range(3):
            floats[parent, 6 * side + c] = np.float32(whole[0, c] - INFLATE)
            floats[parent, 6 * side + 3 + c] = np.float32(whole[1, c] + INFLATE)
        if count <= LEAF:
            ints[parent, 12 + side], ints[parent, 14 + side] = first, count
            continue
        axis, border, _ = _bin_split(boxes, order, first, count, centres[0], centres[1], counts, bounds)
        if axis < 0:  # all centres coincide: halve
            left = count // 2
        else:
            scale = BINS * (1.0 - 1e-9) / (centres[1, axis] - centres[0, axis])
            left = _partition(boxes, order, first, count, axis, centres[0, axis], scale, border)
        ints[parent, 12 + side], ints[parent, 14 + side] = made, 0
        stack[top + 1] = (first, left, made, 0)
        stack[top + 2] = (first + left, count - left, made, 1)
        top += 2
        made += 1
    return made


def build(boxes: NDArray[np.float64]) -> tuple[NDArray[np.intp], NDArray[np.float32]]:
    """(order of the items in the leaves, nodes (n, 16)) over item boxes (items, 2, 3), at least one item."""
    items = len(boxes)
    order = np.arange(items)
    nodes = np.empty((max(items, 2), 16), np.float32)
    # every inner node has at least one item on each side, so there are fewer nodes than items
    made = _build(np.ascontiguousarray(boxes), order, nodes, nodes.view(np.int32), np.empty((items + 2, 4), np.int64))
    return order, nodes[:made].copy()


@part
def slab(floats, node, base, ox, oy, oz, ix, iy, iz, t_low, t_high):
    """Time at which a ray enters a child's box, or FAR if it misses it within t_low .. t_high (all binary32).

    Widening the exit by 2^-21 covers the rounding of times; INFLATE covers that of positions.
    """
    ax, bx = (floats[node, base] - ox) * ix, (floats[node, base + 3] - ox) * ix
    ay, by = (floats[node, base + 1] - oy) * iy, (floats[node, base + 4] - oy) * iy
    az, bz = (floats[node, base + 2] - oz) * iz, (floats[node, base + 5] - oz) * iz
    enter = max(max(min(ax, bx), min(ay, by)), max(min(az, bz), t_low))
    leave = min(min(max(ax, bx), max(ay, by)), min(max(az, bz), t_high))
    if enter <= leave + abs(leave) * np.float32(4.8e-7):
        return enter
    return FAR
