"""The simulator's compiled loop: all processors of an array in one process, in machine time.

The loop knows nothing of services and their order: that is `node.timed.service_clock`, which the processes call too. It decides
which node's turn it is. Nothing that is decided at tick t arrives anywhere before t + lookahead, so within a stretch
of lookahead ticks nodes do not depend on each other. Time is cut into stretches of a power of two ticks, no longer
than that; a wheel has a list for each stretch of those nodes whose next decision lies in it. A node has one place in
the wheel or none (nothing to do), and is moved to an earlier one when a packet is on its way to it. So an event costs
a few memory accesses, however many nodes there are, and the order within a stretch cannot matter.
"""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.node.geometry import HOST, PORTS, Cell, Surfaces, coordinate
from raygrid.node.jit import lean, part
from raygrid.node.protocol import BORN, COUNTS, DIED, HEAD, KINDS, NEVER_TICK, PIXEL, PRIMARY, RETURN, SIZE, put_pixel
from raygrid.node.timed import (
    HOPS_AT,
    MOST_HOPS,
    PACKET,
    RECORD_BYTES,
    RECORD_WORDS,
    TICK,
    arrival,
    decides,
    give_back,
    put,
    queue_arrivals,
    serve,
    spawned,
    take,
)
from raygrid.node.tracing import spawn_sample

Long = NDArray[np.int64]

STRETCHES = 1 << 16  # of the wheel; who is due later is put into the last one, and looked at again there
BINS = 4096  # of time, for what is counted over time; each becomes twice as long whenever they do not suffice
HOPS = 512  # of the histogram; more are counted in the last

DONE, NO_ROOM, TURN = 0, 1, 2  # why `run` returns
NOW, IN_WHEEL, EVENTS, BIN_SHIFT, HOST_TICK = 0, 1, 2, 3, 4  # places in Wheel.state
WAITS, SERVICES, LINKS = 0, 1, 2  # rows of Watch.bins


class Wheel(NamedTuple):
    """firsts: int64 (STRETCHES,), first node of each stretch or -1; shift: log2 of its ticks; state: int64 (8,)"""

    firsts: Long
    shift: int
    state: Long


class Watch(NamedTuple):
    """What is counted beside the nodes' own books.

    total  int64 (COUNTS,), counts of all steps
    hops   int64 (KINDS, HOPS), packets that died after so many hops
    bins   int64 (3, BINS): by how much the packets that wait, the nodes that serve and the packets on links become
           more or fewer in each stretch of time
    """

    total: Long
    hops: Long
    bins: Long


class PrimaryOrder(NamedTuple):
    """What nodes bear when no packet waits: rays of samples, or pixel packets.

    samples  uint32 (n,), sorted by node; node k has rows `next_primary` to `last_primary` - 1
    pixels   whether they are pixels
    """

    samples: NDArray[np.uint32]
    pixels: bool


@part
def _enter(wheel, nodes, k, tick):
    """Put node k, which has no place in the wheel, into the stretch of `tick`."""
    nodes[k]["wake"] = tick
    stretch = min(tick >> wheel.shift, wheel.state[NOW] + len(wheel.firsts) - 1) & (len(wheel.firsts) - 1)
    after = wheel.firsts[stretch]
    nodes[k]["wake_before"], nodes[k]["wake_after"] = -1 - stretch, after
    if after >= 0:
        nodes[after]["wake_before"] = k
    wheel.firsts[stretch] = k
    wheel.state[IN_WHEEL] += 1


@part
def _leave(wheel, nodes, k):
    """Take node k out of the wheel."""
    before, after = nodes[k]["wake_before"], nodes[k]["wake_after"]
    if before >= 0:
        nodes[before]["wake_after"] = after
    else:
        wheel.firsts[-1 - before] = after
    if after >= 0:
        nodes[after]["wake_before"] = before
    nodes[k]["wake"] = -1
    wheel.state[IN_WHEEL] -= 1


@part
def _wake(wheel, timed, k, tick):
    """A packet arrives at node k at `tick`."""
    wake = timed.nodes[k]["wake"]
    if wake < 0:
        _enter(wheel, timed.nodes, k, max(tick, timed.nodes[k]["free"]))
    elif tick < wake and wake > timed.nodes[k]["free"]:
        _leave(wheel, timed.nodes, k)
        _enter(wheel, timed.nodes, k, max(tick, timed.nodes[k]["free"]))


@part
def _count_time(watch, wheel, row, begin, end):
    """One more from tick `begin` on, one fewer from `end` on."""
    while end >> wheel.state[BIN_SHIFT] >= BINS:
        wheel.state[BIN_SHIFT] += 1
        for line in range(3):
            for k in range(BINS // 2):
                watch.bins[line, k] = watch.bins[line, 2 * k] + watch.bins[line, 2 * k + 1]
            watch.bins[line, BINS // 2 :] = 0
    watch.bins[row, begin >> wheel.state[BIN_SHIFT]] += 1
    watch.bins[row, end >> wheel.state[BIN_SHIFT]] -= 1


@part
def cell_of(space, k):
    """(index, cell) of node number k, x fastest; the same numbers as `lattice.make_cell`."""
    nx, ny = space.shape[0], space.shape[1]
    z = k // (nx * ny)
    y = (k - z * nx * ny) // nx
    x = k - (z * ny + y) * nx
    low = (space.planes[0, x], space.planes[1, y], space.planes[2, z])
    high = (space.planes[0, x + 1], space.planes[1, y + 1], space.planes[2, z + 1])
    step = space.step
    return Cell(
        (x, y, z),
        low,
        high,
        (coordinate(low[0], step[0]), coordinate(low[1], step[1]), coordinate(low[2], step[2])),
        (coordinate(high[0], step[0]), coordinate(high[1], step[1]), coordinate(high[2], step[2])),
    )


@part
def held_by(surfaces, first, last):
    """The tables as a node sees them whose hierarchy lies in these rows."""
    return Surfaces(
        surfaces.floats[first:last],
        surfaces.words,
        surfaces.items,
        surfaces.ids,
        surfaces.materials,
        surfaces.triangles,
        surfaces.smooth,
        surfaces.spheres,
        surfaces.cones,
        surfaces.planes,
        surfaces.headers,
        surfaces.bins,
        surfaces.edges,
        surfaces.programmed,
    )


@part
def _spawn_next(timed, k, tick, cell, space, frame, pixels, births, scratch, watch, outputs, prices):
    """The next ray or pixel packet of a node."""
    number = np.int64(births.samples[timed.nodes[k]["next_primary"]])
    timed.nodes[k]["next_primary"] += 1
    if births.pixels:
        sums = (pixels.sums[number, 0], pixels.sums[number, 1], pixels.sums[number, 2])
        put_pixel(scratch, 0, number, sums, frame.samples & 0xFFFF)
        watch.total[BORN + PIXEL] += 1
        spawned(timed, k, tick, scratch, 0, prices.counts[BORN + PIXEL])
    else:
        pixel = number // frame.samples
        j = pixel // frame.width
        i, sample = pixel - j * frame.width, number - pixel * frame.samples
        made = spawn_sample(cell, space, frame, pixels, i, j, pixel, sample, scratch, outputs.seen)
        watch.total[BORN + PRIMARY] += made
        spawned(timed, k, tick, scratch, 0, prices.counts[BORN + PRIMARY])


@part
def _deliver(timed, wheel, watch, space, outputs, k, done, hops, handed_on, prices):
    """Put what node k sends into the queues of its neighbours."""
    nx, nxy = space.shape[0], space.shape[0] * space.shape[1]
    nth = np.int64(0)
    for port in range(PORTS + 1):
        for packet in range(outputs.held[port]):
            tick = arrival(timed, k, port, done, nth, prices)
            nth += 1
            if port == HOST:
                wheel.state[HOST_TICK] = max(wheel.state[HOST_TICK], tick)
                continue
            stride = 1 if port < 2 else (nx if port < 4 else nxy)
            to = k + stride if port & 1 else k - stride
            so_far = min(hops + 1, MOST_HOPS) if handed_on else 1
            put(timed, to, port ^ 1, tick, port ^ 1, so_far, outputs.data[port], HEAD + packet * SIZE)
            _count_time(watch, wheel, LINKS, done, tick)
            _wake(wheel, timed, to, tick)
        outputs.held[port] = 0


@part
def _serve_next(timed, k, tick, wheel, watch, cell, space, frame, surfaces, pixels, outputs, counts, prices):
    """Serve the next packet of node k and send on what comes of it."""
    slot = take(timed, k, tick)
    arrived = timed.words[slot * RECORD_WORDS + TICK]
    byte = slot * RECORD_BYTES
    kind = np.int64(timed.bytes[byte + PACKET]) & 7
    hops = np.int64(timed.bytes[byte + HOPS_AT]) | np.int64(timed.bytes[byte + HOPS_AT + 1]) << 8
    done = serve(timed, k, slot, tick, cell, space, frame, surfaces, pixels, outputs, counts, prices)
    give_back(timed, slot)
    for count in range(COUNTS):
        watch.total[count] += counts[count]
    dead = counts[DIED + kind] > 0
    if dead:
        watch.hops[kind, min(hops, HOPS - 1)] += 1
    if kind != RETURN:
        watch.hops[RETURN, 0] += counts[DIED + RETURN]
    if arrived < tick:
        _count_time(watch, wheel, WAITS, arrived, tick)
    _count_time(watch, wheel, SERVICES, tick, timed.nodes[k]["free"])
    _deliver(timed, wheel, watch, space, outputs, k, done, hops, not dead, prices)


@lean
def run(timed, wheel, watch, space, frame, surfaces, roots, pixels, births, scratch, outputs, counts, prices, most):
    """Carry out events until nothing is left to do (DONE), the store is full (NO_ROOM) or `most` are done (TURN).

    roots  int64 (n, 2): rows of surfaces.floats of node k are roots[k, 0] to roots[k, 1] - 1
    """
    need = frame.n_lights + 4
    stop = wheel.state[EVENTS] + most
    while wheel.state[IN_WHEEL] > 0:
        stretch = wheel.state[NOW]
        while wheel.firsts[stretch & (len(wheel.firsts) - 1)] < 0:
            stretch += 1
        wheel.state[NOW] = stretch
        k = wheel.firsts[stretch & (len(wheel.firsts) - 1)]
        end = (stretch + 1) << wheel.shift
        tick = timed.nodes[k]["wake"]
        if tick < end and (timed.spare[1] < need or wheel.state[EVENTS] >= stop):
            return NO_ROOM if timed.spare[1] < need else TURN
        _leave(wheel, timed.nodes, k)
        cell = cell_of(space, k)
        while tick < end and timed.spare[1] >= need:
            wheel.state[EVENTS] += 1
            queue_arrivals(timed, k, tick)
            if timed.nodes[k]["waiting"] > 0:
                here = held_by(surfaces, roots[k, 0], roots[k, 1])
                _serve_next(timed, k, tick, wheel, watch, cell, space, frame, here, pixels, outputs, counts, prices)
            else:
                _spawn_next(timed, k, tick, cell, space, frame, pixels, births, scratch, watch, outputs, prices)
                _count_time(watch, wheel, SERVICES, tick, timed.nodes[k]["free"])
            tick = decides(timed, k, timed.nodes[k]["next_primary"] < timed.nodes[k]["last_primary"])
        if tick < NEVER_TICK:
            _enter(wheel, timed.nodes, k, tick)
    return DONE


@lean
def enter_all(timed, wheel):
    """Put every node that has something to bear into the wheel."""
    for k in range(len(timed.nodes)):
        if timed.nodes[k]["next_primary"] < timed.nodes[k]["last_primary"]:
            _enter(wheel, timed.nodes, k, timed.nodes[k]["free"])


assert PRIMARY < KINDS
