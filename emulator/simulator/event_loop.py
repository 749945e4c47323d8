"""Runs all processors of an array in one process and in machine time: the simulator's compiled loop.

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

from raygrid.node.geometry import HOST, PORTS, Cell, Space, Surfaces, coordinate
from raygrid.node.jit import lean, part
from raygrid.node.protocol import (
    BORN,
    COUNTS,
    DIED,
    HEAD,
    NEVER_TICK,
    PIXEL,
    PRIMARY,
    RETURN,
    SIZE,
    Frame,
    Prices,
    put_pixel,
)
from raygrid.node.timed import (
    HOPS_AT,
    MOST_HOPS,
    PACKET,
    RECORD_BYTES,
    RECORD_WORDS,
    TICK,
    ServiceClock,
    arrival,
    decides,
    give_back,
    put,
    queue_arrivals,
    serve,
    spawned,
    take,
)
from raygrid.node.tracing import Outputs, Pixels, StepTables, spawn_sample

Long = NDArray[np.int64]

STRETCHES = 1 << 16  # of the wheel; who is due later is put into the last one, and looked at again there
BINS = 4096  # of time, for what is counted over time; each becomes twice as long whenever they do not suffice
HOPS = 512  # of the histogram; more are counted in the last

DONE, NO_ROOM, TURN = 0, 1, 2  # why `run` returns
LOOP_STATE = np.dtype(
    [
        ("now", np.int64),  # the stretch of time that is looked at
        ("in_wheel", np.int64),  # nodes that have a place in the wheel
        ("events", np.int64),  # carried out so far
        ("bin_shift", np.int64),  # log2 of the ticks of a bin of Watch.bins
        ("host_tick", np.int64),  # at which the last packet reached the host
    ]
)
WAITS, SERVICES, LINKS = 0, 1, 2  # rows of Watch.bins


class Wheel(NamedTuple):
    """Which node decides next.

    firsts  int64 (STRETCHES,), first node of each stretch or -1; shift: log2 of its ticks
    state   LOOP_STATE (1,)
    """

    firsts: Long
    shift: int
    state: NDArray[np.void]


class Watch(NamedTuple):
    """What is counted beside the nodes' own counts.

    total  int64 (COUNTS,), counts of all steps
    hops   int64 (KINDS, HOPS), packets that died after so many hops
    bins   int64 (3, BINS): by how much the packets that wait, the nodes that serve and the packets on links become
           more or fewer in each stretch of time
    """

    total: Long
    hops: Long
    bins: Long


class PrimaryOrder(NamedTuple):
    """What nodes emit when no packet waits: rays of samples, or pixel packets.

    samples  uint32 (n,), sorted by node; node k has rows `next_primary` to `last_primary` - 1
    pixels   whether they are pixels
    """

    samples: NDArray[np.uint32]
    pixels: bool


class Simulation(NamedTuple):
    """An array and a phase of its work: all that the loop needs.

    roots     int64 (n, 2): rows of surfaces.floats of node k are roots[k, 0] to roots[k, 1] - 1
    scratch   uint8 (SIZE,), a new packet; counts: int64 (COUNTS,), of one service
    """

    timed: ServiceClock
    wheel: Wheel
    watch: Watch
    space: Space
    frame: Frame
    surfaces: Surfaces
    roots: Long
    pixels: Pixels
    primaries: PrimaryOrder
    scratch: NDArray[np.uint8]
    outputs: Outputs
    counts: Long
    prices: Prices


@part
def _enter(wheel, nodes, k, tick):
    """Put node k, which has no place in the wheel, into the stretch of `tick`."""
    nodes[k]["wake"] = tick
    stretch = min(tick >> wheel.shift, wheel.state[0]["now"] + len(wheel.firsts) - 1) & (len(wheel.firsts) - 1)
    after = wheel.firsts[stretch]
    nodes[k]["wake_before"], nodes[k]["wake_after"] = -1 - stretch, after
    if after >= 0:
        nodes[after]["wake_before"] = k
    wheel.firsts[stretch] = k
    wheel.state[0]["in_wheel"] += 1


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
    wheel.state[0]["in_wheel"] -= 1


@part
def _wake(sim, k, tick):
    """A packet arrives at node k at `tick`."""
    wheel, timed = sim.wheel, sim.timed
    wake = timed.nodes[k]["wake"]
    if wake < 0:
        _enter(wheel, timed.nodes, k, max(tick, timed.nodes[k]["free"]))
    elif tick < wake and wake > timed.nodes[k]["free"]:
        _leave(wheel, timed.nodes, k)
        _enter(wheel, timed.nodes, k, max(tick, timed.nodes[k]["free"]))


@part
def _count_time(sim, row, begin, end):
    """One more from tick `begin` on, one fewer from `end` on."""
    watch, wheel = sim.watch, sim.wheel
    while end >> wheel.state[0]["bin_shift"] >= BINS:
        wheel.state[0]["bin_shift"] += 1
        for line in range(3):
            for k in range(BINS // 2):
                watch.bins[line, k] = watch.bins[line, 2 * k] + watch.bins[line, 2 * k + 1]
            watch.bins[line, BINS // 2 :] = 0
    watch.bins[row, begin >> wheel.state[0]["bin_shift"]] += 1
    watch.bins[row, end >> wheel.state[0]["bin_shift"]] -= 1


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
def neighbour(shape, k, port):
    """(number of the node to which `port` of node k leads, the port at which it receives what is sent there)."""
    stride = 1 if port < 2 else (shape[0] if port < 4 else shape[0] * shape[1])
    return k + stride if port & 1 else k - stride, port ^ 1


@part
def step_tables(run, cell, surfaces):
    """What the ray step of a node reads and writes that has this cell and holds these surfaces; run: whoever calls it."""
    return StepTables(cell, run.space, run.frame, surfaces, run.pixels, run.outputs, run.counts)


@part
def _spawn_next(sim, k, tick, cell):
    """The next ray or pixel packet of a node."""
    timed, frame, pixels, scratch, prices = sim.timed, sim.frame, sim.pixels, sim.scratch, sim.prices
    number = np.int64(sim.primaries.samples[timed.nodes[k]["next_primary"]])
    timed.nodes[k]["next_primary"] += 1
    if sim.primaries.pixels:
        sums = (pixels.sums[number, 0], pixels.sums[number, 1], pixels.sums[number, 2])
        put_pixel(scratch, 0, number, sums, frame.samples & 0xFFFF)
        sim.watch.total[BORN + PIXEL] += 1
        spawned(timed, k, tick, scratch, 0, prices.counts[BORN + PIXEL])
    else:
        pixel = number // frame.samples
        j = pixel // frame.width
        i, sample = pixel - j * frame.width, number - pixel * frame.samples
        made = spawn_sample(step_tables(sim, cell, sim.surfaces), (i, j, pixel), sample, scratch)
        sim.watch.total[BORN + PRIMARY] += made
        spawned(timed, k, tick, scratch, 0, prices.counts[BORN + PRIMARY])


@part
def _deliver(sim, k, done, hops, handed_on):
    """Put what node k sends into the queues of its neighbours."""
    timed, outputs = sim.timed, sim.outputs
    nth = np.int64(0)
    for port in range(PORTS + 1):
        for packet in range(outputs.held[port]):
            tick = arrival(timed, k, port, done, nth, sim.prices)
            nth += 1
            if port == HOST:
                sim.wheel.state[0]["host_tick"] = max(sim.wheel.state[0]["host_tick"], tick)
                continue
            to, back = neighbour(sim.space.shape, k, port)
            so_far = min(hops + 1, MOST_HOPS) if handed_on else 1
            put(timed, to, back, tick, back, so_far, outputs.data[port], HEAD + packet * SIZE)
            _count_time(sim, LINKS, done, tick)
            _wake(sim, to, tick)
        outputs.held[port] = 0


@part
def _serve_next(sim, k, tick, cell, surfaces):
    """Serve the next packet of node k and send on what comes of it."""
    timed, watch, counts = sim.timed, sim.watch, sim.counts
    slot = take(timed, k, tick)
    arrived = timed.words[slot * RECORD_WORDS + TICK]
    byte = slot * RECORD_BYTES
    kind = np.int64(timed.bytes[byte + PACKET]) & 7
    hops = np.int64(timed.bytes[byte + HOPS_AT]) | np.int64(timed.bytes[byte + HOPS_AT + 1]) << 8
    done = serve(timed, k, slot, tick, step_tables(sim, cell, surfaces), sim.prices)
    give_back(timed, slot)
    for count in range(COUNTS):
        watch.total[count] += counts[count]
    dead = counts[DIED + kind] > 0
    if dead:
        watch.hops[kind, min(hops, HOPS - 1)] += 1
    if kind != RETURN:
        watch.hops[RETURN, 0] += counts[DIED + RETURN]
    if arrived < tick:
        _count_time(sim, WAITS, arrived, tick)
    _count_time(sim, SERVICES, tick, timed.nodes[k]["free"])
    _deliver(sim, k, done, hops, not dead)


@lean
def run(sim, most):
    """Carry out events until nothing is left to do (DONE), the store is full (NO_ROOM) or `most` are done (TURN)."""
    timed, wheel = sim.timed, sim.wheel
    need = sim.frame.n_lights + 4
    stop = wheel.state[0]["events"] + most
    while wheel.state[0]["in_wheel"] > 0:
        stretch = wheel.state[0]["now"]
        while wheel.firsts[stretch & (len(wheel.firsts) - 1)] < 0:
            stretch += 1
        wheel.state[0]["now"] = stretch
        k = wheel.firsts[stretch & (len(wheel.firsts) - 1)]
        end = (stretch + 1) << wheel.shift
        tick = timed.nodes[k]["wake"]
        if tick < end and (timed.spare[1] < need or wheel.state[0]["events"] >= stop):
            return NO_ROOM if timed.spare[1] < need else TURN
        _leave(wheel, timed.nodes, k)
        cell = cell_of(sim.space, k)
        while tick < end and timed.spare[1] >= need:
            wheel.state[0]["events"] += 1
            queue_arrivals(timed, k, tick)
            if timed.nodes[k]["waiting"] > 0:
                here = held_by(sim.surfaces, sim.roots[k, 0], sim.roots[k, 1])
                _serve_next(sim, k, tick, cell, here)
            else:
                _spawn_next(sim, k, tick, cell)
                _count_time(sim, SERVICES, tick, timed.nodes[k]["free"])
            tick = decides(timed, k, timed.nodes[k]["next_primary"] < timed.nodes[k]["last_primary"])
        if tick < NEVER_TICK:
            _enter(wheel, timed.nodes, k, tick)
    return DONE


@lean
def enter_all(timed, wheel):
    """Put every node that has something to emit into the wheel."""
    for k in range(len(timed.nodes)):
        if timed.nodes[k]["next_primary"] < timed.nodes[k]["last_primary"]:
            _enter(wheel, timed.nodes, k, timed.nodes[k]["free"])
