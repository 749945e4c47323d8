"""How long it takes to flood a scene into an array, in machine time.

The host sends each description to the corner nearest to it, one after the other on each corner's link; a node looks
at the descriptions in the order (tick, port, sequence) and hands each on along the tree of its corner
(`node.geometry.spanning_tree`), only towards boxes of cells that the surface comes near. A description takes as
long on a link as its bytes.
"""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

import heapq
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.emulator.simulator.shared_tables import described, described_meets
from raygrid.node.geometry import HALF, HOST, SLACK, Space, SurfaceSet, corners
from raygrid.node.jit import kernel
from raygrid.node.protocol import SENT, SIZE, Prices

Long = NDArray[np.int64]


class Flooded(NamedTuple):
    """ticks: when the last node has looked at its last description; busy int64 (n,); visits: descriptions looked at."""

    ticks: int
    busy: Long
    visits: int


def flood(space: Space, surfaces: SurfaceSet, prices: Prices, description: int) -> Flooded:
    """Flood surfaces (`shared_tables.ordered`). `description`: ticks that a node takes to look at one."""
    every = described(surfaces)
    several = [any(corner >> axis & 1 for corner in corners(space.shape)) for axis in range(3)]
    middles = every.boxes.mean(axis=1)
    corner_of: Long = np.zeros(len(surfaces), np.int64)
    for axis in range(3):
        corner_of |= ((middles[:, axis] >= 0.0) & several[axis]).astype(np.int64) << axis
    busy = np.zeros(space.shape[0] * space.shape[1] * space.shape[2], np.int64)
    planes = (space.planes - HALF).astype(np.float64) * np.array(space.step)[:, None]
    hand_on = int(prices.counts[SENT])
    ticks, visits = _flood(
        every, corner_of, planes, space.shape, description, hand_on,
        prices.transmit, prices.latency, prices.by_processor, busy,
    )  # fmt: skip
    return Flooded(int(ticks), busy, int(visits))


@kernel
def _flood(every, corner_of, planes, shape, description, hand_on, transmit, latency, by_processor, busy):
    """Events are (tick, port, sequence, node, surface), in the order in which nodes see them."""
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
                    if by_processor:
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
