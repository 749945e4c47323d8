"""Orders samples, finds what cells hold, and floods descriptions over an array: the simulator's kernels beside its loop."""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

import heapq
from typing import Any

import numpy as np

from raygrid.node.geometry import CHILD_COLUMN, FIRST_MASK, HOST, LEAF_BIT, SLACK, WIDE, surface_meets
from raygrid.node.jit import kernel, part
from raygrid.node.protocol import SENT, SIZE
from raygrid.node.tracing import COARSEST, home, ray_of_sample


@kernel
def find_homes(frame, space, homes):
    """The node that is home to each sample, -1 if its ray misses the world box: int32 (samples,)."""
    for sample in range(len(homes)):
        enters, point, _ = ray_of_sample(frame, space.step, sample)
        homes[sample] = -1
        if enters:
            cell = home(space, point)
            homes[sample] = (cell[2] * space.shape[1] + cell[1]) * space.shape[0] + cell[0]


@kernel
def deal_samples(frame, homes, places, order):
    """Put samples coarse to fine into `order`; places int64 (nodes,): where each node's next one goes."""
    for number in range(frame.samples):
        for level in range(COARSEST, -1, -1):
            stride = 1 << level
            for j in range(0, frame.height, stride):
                coarser = level < COARSEST and j % (2 * stride) == 0
                for i in range(0, frame.width, stride):
                    sample = (j * frame.width + i) * frame.samples + number
                    node = homes[sample]
                    if node >= 0 and not (coarser and i % (2 * stride) == 0):
                        order[places[node]] = sample
                        places[node] += 1


@part
def described_meets(every, surface, low, high, scratch):
    """Whether a surface meets the box low..high, already widened. `scratch`: float64 (3, 3)."""
    data = every.points if every.kinds[surface] == 2 else every.table
    return surface_meets(every.kinds[surface], data, every.starts, every.boxes, surface, low, high, scratch)


@kernel
def touched_cells(every, low_at, high_at, shape, cells, surfaces):
    """Write (cell, surface) of each surface and cell that meet, as many as there is room for; returns how many do."""
    scratch, low, high = np.empty((3, 3)), np.empty(3), np.empty(3)
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    found = 0
    for surface in range(len(every.kinds)):
        for axis in range(3):
            first[axis], last[axis] = shape[axis], -1
            for k in range(shape[axis]):
                if (
                    low_at[axis, k] <= every.boxes[surface, 1, axis]
                    and high_at[axis, k] >= every.boxes[surface, 0, axis]
                ):
                    first[axis], last[axis] = min(first[axis], k), k
        for z in range(first[2], last[2] + 1):
            low[2], high[2] = low_at[2, z], high_at[2, z]
            for y in range(first[1], last[1] + 1):
                low[1], high[1] = low_at[1, y], high_at[1, y]
                for x in range(first[0], last[0] + 1):
                    low[0], high[0] = low_at[0, x], high_at[0, x]
                    if described_meets(every, surface, low, high, scratch):
                        if found < len(cells):
                            cells[found], surfaces[found] = (z * shape[1] + y) * shape[0] + x, surface
                        found += 1
    return found


@kernel
def relocate_leaves(words, first):
    """Let the leaves of a hierarchy name items from `first` on."""
    for node in range(len(words)):
        for lane in range(CHILD_COLUMN, CHILD_COLUMN + WIDE):
            child = np.int64(words[node, lane])
            if child >= LEAF_BIT:
                kept = child - (child & FIRST_MASK)
                words[node, lane] = np.uint32(kept | ((child & FIRST_MASK) + first))


@kernel
def run_flood(every, corner_of, planes, shape, description, prices, busy):
    """Events are (tick, port, sequence, node, surface), in the order in which nodes see them."""
    transmit, latency, hand_on = prices.transmit, prices.latency, prices.counts[SENT]
    free = np.zeros(len(busy), np.int64)
    link_free = np.zeros((len(busy), 6), np.int64)
    dealt = np.zeros(8, np.int64)
    low, high, scratch = np.empty(3), np.empty(3), np.empty((3, 3))
    events: list[Any] = [(np.int64(0), np.int64(0), np.int64(0), np.int64(0), np.int64(0))]  # so that its type is known
    events.pop()
    for surface in range(len(corner_of)):
        corner = corner_of[surface]
        node = np.int64(0)
        for axis in range(2, -1, -1):
            node = node * shape[axis] + (shape[axis] - 1 if corner >> axis & 1 else 0)
        dealt[corner] += -(-every.sizes[surface] * transmit // SIZE)
        events.append((dealt[corner] + latency, np.int64(HOST), np.int64(surface), node, np.int64(surface)))
    heapq.heapify(events)
    sequence, visits, last = len(corner_of), 0, np.int64(0)
    while len(events) > 0:
        tick, _, _, node, surface = heapq.heappop(events)
        visits += 1
        begin = max(tick, free[node])
        done = begin + description
        z = node // (shape[0] * shape[1])
        y = node // shape[0] - z * shape[1]
        index = (node - (z * shape[1] + y) * shape[0], y, z)
        on_link = -(-every.sizes[surface] * transmit // SIZE)
        corner = corner_of[surface]
        for axis in range(2, -1, -1):
            up = corner >> axis & 1 == 0
            onward = index[axis] + (1 if up else -1)
            if 0 <= onward < shape[axis]:
                for other in range(3):
                    first, end = index[other], index[other]
                    if other > axis:
                        first, end = 0, shape[other] - 1
                    elif other == axis:
                        first, end = (first + 1, shape[axis] - 1) if up else (0, first - 1)
                    low[other] = planes[other, first] - SLACK
                    high[other] = planes[other, end + 1] + SLACK
                if described_meets(every, surface, low, high, scratch):
                    port = 2 * axis + (1 if up else 0)
                    done += hand_on
                    if prices.by_processor:
                        done += on_link
                        sent = done
                    else:
                        sent = max(done, link_free[node, port]) + on_link
                        link_free[node, port] = sent
                    stride = 1 if axis == 0 else (shape[0] if axis == 1 else shape[0] * shape[1])
                    to = node + (stride if up else -stride)
                    heapq.heappush(events, (sent + latency, np.int64(port ^ 1), sequence, to, surface))
                    sequence += 1
            if index[axis] != (0 if up else shape[axis] - 1):
                break  # it has turned into this axis; lower axes were done before
        busy[node] += done - begin
        free[node] = done
        last = max(last, done)
    return last, visits
