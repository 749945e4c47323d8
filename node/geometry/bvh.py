"""Builds the bounding volume hierarchy of one node: eight-wide, collapsed from a binary one built by binned SAH.

Layout. A node of the hierarchy is 64 words of 32 bits, four cache lines, and holds the boxes of up to eight
children and where they are. The same memory is seen as float32 (n, 64) and uint32 (n, 64):

    words  0- 7   8-15  16-23   low x, y, z of the eight boxes     (binary32)
    words 24-31  32-39  40-47   high x, y, z                       (binary32)
    words 48-55  child: number of an inner node, or a leaf:        (uint32)
                 LEAF_BIT | items - 1 << COUNT_SHIFT | first item
    words 56-63  zero

Lanes without a child hold a box that no ray meets. The root is node 0. Items are the surfaces in leaf
order; the items of a leaf are of one kind, so a walk looks up the kind once a leaf.

Building. The binary tree is divided down to single items (Wald 2007). Which of its nodes become lanes, and which
subtrees become leaves, is then chosen for the least expected cost (Ylitalo, Laine, Karras 2017, "Efficient
Incoherent Ray Traversal on GPUs Through Compressed Wide BVHs", section 3.1): NODE_COST a node opened, ITEM_COST a
surface tested, each times the chance that a ray comes by, its area. Costs from 0.5 to 3 nodes an item and leaves
of 4 or 8 give the same times within 5 %.

The boxes only save work: whatever the hierarchy, the same hits must be found (law 4). So boxes are
widened by INFLATE, more than all roundings of the binary32 slab test together can make it err: a box
edge, an origin and their difference are each off by at most 2^-24 of numbers below 2, the product with
the rounded inverse by 2^-23 of itself, so the test errs by less than 5e-7 of a position.
`bvh_boxes.LEAVE_LATER` covers the rounding of times.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raygrid.node.geometry.bvh_boxes import CHILD_COLUMN, WIDE
from raygrid.node.jit.decorators import kernel, part

INFLATE = 4e-6  # machine coordinates; a hit that counts lies within SLACK / 4 of its surface's box
LEAF = 4  # most items in a leaf
ITEM_COST, NODE_COST = 1.0, 2.0
BINS = 16
STEEP = 48  # from this depth on the binary tree is simply halved
NODE_WORDS = 64  # in a node
LEAF_BIT, COUNT_SHIFT, COUNT_MASK = 1 << 31, 28, 7
FIRST_MASK = (1 << COUNT_SHIFT) - 1
MOST_LEAF_ITEMS = 1 << COUNT_SHIFT
# Most keys on the stack of a walk. Each level opened leaves at most WIDE - 1 keys, a level of the wide tree is at least
# one of the binary tree, and that has at most STEEP levels and then halves; the last node needs WIDE places.
DEPTH = (STEEP + COUNT_SHIFT + 1) * (WIDE - 1) + WIDE
EMPTY_BOUND = np.float32(1e30)  # a point that no ray reaches within its bounds


@kernel
def _bin_split(boxes, order, first, count, low, high, counts, bounds):
    """Best (axis, border) to split the items by centre, by surface area heuristic; axis -1 if none is better."""
    best_axis, best_border, best_cost = -1, 0, np.inf
    for axis in range(3):
        extent = high[axis] - low[axis]
        if not extent > 1e-30:  # the inverse of a smaller one may be infinite
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
def _binary(boxes, order, areas, left, firsts, counts):
    """The binary tree, down to single items. Children of node n are left[n] and left[n] + 1; 0: it has none."""
    whole, centres, box = np.empty((2, 3)), np.empty((2, 3)), np.empty(6)
    bin_counts, bounds = np.empty(BINS, np.int64), np.empty((BINS, 6))
    depths = np.zeros(len(left), np.uint8)
    made = 1
    firsts[0], counts[0] = 0, len(order)
    for node in range(len(left)):
        first, count = firsts[node], counts[node]
        _item_bounds(boxes, order, first, count, whole, centres)
        box[:3], box[3:] = whole[0], whole[1]
        areas[node] = _half_area(box)
        left[node] = 0
        if count == 1:
            continue
        axis, border, _ = _bin_split(boxes, order, first, count, centres[0], centres[1], bin_counts, bounds)
        if axis < 0 or depths[node] >= STEEP:  # all centres coincide, or the tree is a comb
            half = count // 2
        else:
            scale = BINS * (1.0 - 1e-9) / (centres[1, axis] - centres[0, axis])
            half = _partition(boxes, order, first, count, axis, centres[0, axis], scale, border)
        left[node] = made
        firsts[made], counts[made] = first, half
        firsts[made + 1], counts[made + 1] = first + half, count - half
        depths[made : made + 2] = depths[node] + 1
        made += 2


@part
def _distribute(costs, cuts, node, a):
    """Cheapest ways to hand the children a, a + 1 of a node to 2 .. WIDE lanes; `cuts`: lanes for the first child."""
    for lanes in range(2, WIDE + 1):
        costs[node, lanes] = np.inf
        for k in range(1, lanes):
            cost = costs[a, k] + costs[a + 1, lanes - k]
            if cost < costs[node, lanes]:
                costs[node, lanes], cuts[node, lanes] = cost, k


@kernel
def _plan(areas, left, counts, kinds, cuts):
    """Fill `cuts` (nodes, WIDE + 1) of the binary tree, from the leaves up.

    `kinds` of a node's items, -1 if they differ; those of single items are given.

    cuts[n, 0]       lanes of the first child, if n becomes a wide node
    cuts[n, 1]       1 if n, given one lane, becomes a wide node, 0 if a leaf
    cuts[n, lanes]   lanes of the first child, if n is given so many; 0: give it one less
    """
    costs = np.empty((len(areas), WIDE + 1))
    for node in range(len(areas) - 1, -1, -1):
        a = left[node]
        if a == 0:
            costs[node, 1:] = areas[node] * ITEM_COST
            cuts[node] = 0
            continue
        kinds[node] = kinds[a] if kinds[a] == kinds[a + 1] else -1
        _distribute(costs, cuts, node, a)
        cuts[node, 0] = cuts[node, WIDE]
        inner = costs[node, WIDE] + areas[node] * NODE_COST
        leaf = areas[node] * counts[node] * ITEM_COST if kinds[node] >= 0 and counts[node] <= LEAF else np.inf
        costs[node, 1], cuts[node, 1] = min(inner, leaf), 1 if inner < leaf else 0
        for lanes in range(2, WIDE + 1):
            if costs[node, lanes - 1] <= costs[node, lanes]:
                costs[node, lanes], cuts[node, lanes] = costs[node, lanes - 1], 0


@kernel
def _chosen(root, left, cuts, lanes):
    """Write the binary nodes that become the lanes of the wide node made of `root`; returns how many."""
    parts = np.empty((2 * WIDE, 2), np.int64)  # binary node, how many lanes it is given
    used, top = 0, 0
    parts[0] = (root, 1)
    if cuts[root, 1] == 1:
        cut = np.int64(cuts[root, 0])
        parts[0] = (left[root], cut)
        parts[1] = (left[root] + 1, WIDE - cut)
        top = 1
    while top >= 0:
        node, given = parts[top]
        top -= 1
        while given > 1 and cuts[node, given] == 0:
            given -= 1
        if given == 1:
            lanes[used] = node
            used += 1
            continue
        cut = np.int64(cuts[node, given])
        parts[top + 1] = (left[node], cut)
        parts[top + 2] = (left[node] + 1, given - cut)
        top += 2
    return used


@kernel
def _wide(boxes, order, left, firsts, counts, cuts, floats, words):
    """Write the wide nodes; returns how many there are."""
    whole, centres = np.empty((2, 3)), np.empty((2, 3))
    lanes = np.empty(WIDE, np.int64)
    todo = np.empty((len(left), 3), np.int64)  # binary node, wide node and lane that name it
    todo[0] = 0
    made, waiting = 0, 1
    while waiting > 0:
        waiting -= 1
        root, parent, lane = todo[waiting]
        floats[made, :CHILD_COLUMN] = EMPTY_BOUND
        words[made, CHILD_COLUMN:] = 0
        if made > 0:
            words[parent, CHILD_COLUMN + lane] = made
        for k in range(_chosen(root, left, cuts, lanes)):
            node = lanes[k]
            _item_bounds(boxes, order, firsts[node], counts[node], whole, centres)
            for c in range(3):
                floats[made, c * WIDE + k] = np.float32(whole[0, c] - INFLATE)
                floats[made, (3 + c) * WIDE + k] = np.float32(whole[1, c] + INFLATE)
            if cuts[node, 1] == 0:
                words[made, CHILD_COLUMN + k] = np.uint32(LEAF_BIT | (counts[node] - 1) << COUNT_SHIFT | firsts[node])
            else:
                todo[waiting] = (node, made, k)
                waiting += 1
        made += 1
    return made


def build(
    boxes: NDArray[np.float64], kinds: NDArray[np.int8] | None = None
) -> tuple[NDArray[np.intp], NDArray[np.float32]]:
    """(order of the items in the leaves, nodes (n, NODE_WORDS)) over item boxes (items, 2, 3), at least one item.

    `kinds` of the items, all the same if not given. Raises ValueError for more items than a leaf can name.
    """
    items = len(boxes)
    if items > MOST_LEAF_ITEMS:
        raise ValueError(f"a hierarchy over {items} items, wanted at most {MOST_LEAF_ITEMS}")
    boxes, order = np.ascontiguousarray(boxes), np.arange(items)
    size = 2 * items - 1  # of a binary tree
    areas, kind = np.empty(size), np.zeros(size, np.int8)
    left, firsts, counts = np.empty(size, np.int64), np.empty(size, np.int64), np.empty(size, np.int64)
    _binary(boxes, order, areas, left, firsts, counts)
    if kinds is not None:
        single = counts == 1
        kind[single] = kinds[order[firsts[single]]]
    cuts = np.empty((size, WIDE + 1), np.uint8)
    _plan(areas, left, counts, kind, cuts)
    nodes = aligned(items)
    made = _wide(boxes, order, left, firsts, counts, cuts, nodes, nodes.view(np.uint32))
    kept = aligned(made)
    kept[:] = nodes[:made]
    return order, kept


def aligned(nodes: int) -> NDArray[np.float32]:
    """Room for nodes that begin at a cache line, so that no row of planes lies in two."""
    room = np.empty((nodes + 1) * NODE_WORDS, np.float32)
    first = -(room.ctypes.data // room.itemsize) % (64 // room.itemsize)
    return room[first : first + nodes * NODE_WORDS].reshape(nodes, NODE_WORDS)
