"""Counts what the rays of a small picture cost each cell of an array, packet after packet and without queues: compiled.

The ray step is that of the nodes, and so are the counts and their prices, so the work of a cell is what a node would do. What
is left out is waiting: a packet is followed to its end before the next one, last in, first out, so that few are kept, and
its ticks are those of a machine in which nobody waits for anybody.
"""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.emulator.simulator.event_loop import cell_of, held_by, neighbour, step_tables
from raygrid.node.geometry import PORTS, SELF, Space, Surfaces
from raygrid.node.jit import lean, part
from raygrid.node.protocol import BORN, COUNTS, HEAD, PRIMARY, SENT, SIZE, WALKS, Frame
from raygrid.node.tracing import Outputs, Pixels, spawn_sample
from raygrid.node.tracing.step import step_one

Long = NDArray[np.int64]

APART = 4  # pixels of one group lie so far apart along rows and columns
GROUPS = APART * APART  # of samples: so many coarser pictures in one
CELL, PORT, TICKS = 0, 1, 2  # columns of PacketStack.facts; from TICKS on one for each price list


class PriceLists(NamedTuple):
    """What counts cost, by several price lists at once.

    counts     int64 (lists, COUNTS); packet, transmit, latency, by_processor: int64 (lists,), as of `Prices`
    walks      int64 (lists, cells): of each walk, beside its price, the tests of all that the cell holds
    """

    counts: Long
    packet: Long
    transmit: Long
    latency: Long
    by_processor: Long
    walks: Long


class PacketStack(NamedTuple):
    """Packets that are still to be followed: uint8 (room * SIZE,), and int64 (room, TICKS + lists)."""

    packets: NDArray[np.uint8]
    facts: Long


class WorkSums(NamedTuple):
    """What was found.

    busy     int64 (cells, GROUPS, lists): ticks of work
    sent     int64 (cells, PORTS): packets
    born     int64 (cells,): samples that begin there
    longest  int64 (lists,): ticks of the sample that would take longest alone
    counts   int64 (COUNTS,) of all; steps: int64 (1,), how many packets were served
    """

    busy: Long
    sent: Long
    born: Long
    longest: Long
    counts: Long
    steps: Long


class Following(NamedTuple):
    """All that following takes: an array, a frame, and where the sums go.

    homes   int32 (samples,), the cell in which each begins, -1: it misses the world box
    roots   int64 (cells, 2): rows of surfaces.floats of cell k are roots[k, 0] to roots[k, 1] - 1
    counts  int64 (COUNTS,), of one service; times: int64 (TIMES, lists), its ticks
    """

    homes: NDArray[np.int32]
    space: Space
    frame: Frame
    surfaces: Surfaces
    roots: Long
    pixels: Pixels
    outputs: Outputs
    stack: PacketStack
    prices: PriceLists
    work: WorkSums
    counts: Long
    times: Long


# rows of Following.times: when a service begins, from when a packet can be sent, when one is served that starts here, and
# when all of a sample has ended so far
BEGIN, READY, OWN, END, TIMES = 0, 1, 2, 3, 4


@part
def _push_sent(run, top, k):
    """Put on the stack what a service of cell k has put on the outputs; returns the new height."""
    outputs, stack, prices = run.outputs, run.stack, run.prices
    nth = np.int64(0)
    for output in range(len(outputs.held)):
        for packet in range(outputs.held[output]):
            cell, port = k, np.int64(SELF)
            if output < PORTS:
                cell, port = neighbour(run.space.shape, k, output)
                nth += 1
            for byte in range(SIZE):
                stack.packets[top * SIZE + byte] = outputs.data[output, HEAD + packet * SIZE + byte]
            stack.facts[top, CELL], stack.facts[top, PORT] = cell, port
            for row in range(run.times.shape[1]):
                tick = run.times[OWN, row]
                if output < PORTS:
                    before = nth if prices.by_processor[row] != 0 else 1
                    tick = run.times[READY, row] + before * prices.transmit[row] + prices.latency[row]
                stack.facts[top, TICKS + row] = tick
            top += 1
        outputs.held[output] = 0
    return top


@part
def _price(run, k, group):
    """Add what a service costs to its cell, and work out its ticks."""
    work, prices, counts, times = run.work, run.prices, run.counts, run.times
    sent = np.int64(0)
    for output in range(PORTS):
        sent += counts[SENT + output]
        work.sent[k, output] += counts[SENT + output]
    for row in range(times.shape[1]):
        ticks = prices.packet[row] + prices.walks[row, k] * counts[WALKS]
        for count in range(COUNTS):
            ticks += prices.counts[row, count] * counts[count]
        times[READY, row] = times[BEGIN, row] + ticks
        ticks += prices.by_processor[row] * prices.transmit[row] * sent
        times[OWN, row] = times[BEGIN, row] + ticks
        times[END, row] = max(times[END, row], times[OWN, row])
        work.busy[k, group, row] += ticks
    for count in range(COUNTS):
        work.counts[count] += counts[count]
    work.steps[0] += 1


@part
def _begin(run, home, group):
    """Begin with the primary ray that lies first on the stack."""
    stack, work = run.stack, run.work
    work.born[home] += 1
    stack.facts[0, CELL], stack.facts[0, PORT] = home, SELF
    for row in range(run.times.shape[1]):
        price = run.prices.counts[row, BORN + PRIMARY]
        work.busy[home, group, row] += price
        stack.facts[0, TICKS + row] = run.times[END, row] = price


@lean
def follow_samples(run):
    """Follow all packets of the samples of a frame."""
    frame, stack, work, times = run.frame, run.stack, run.work, run.times
    for sample in range(len(run.homes)):
        home = np.int64(run.homes[sample])
        if home < 0:
            continue
        pixel = sample // frame.samples
        j = pixel // frame.width
        i = pixel - j * frame.width
        group = (i & (APART - 1)) + APART * (j & (APART - 1))
        number = sample - pixel * frame.samples
        tables = step_tables(run, cell_of(run.space, home), run.surfaces)
        if spawn_sample(tables, (i, j, pixel), number, stack.packets) == 0:
            continue
        _begin(run, home, group)
        top = np.int64(1)
        while top > 0:
            top -= 1
            k, port = stack.facts[top, CELL], stack.facts[top, PORT]
            for row in range(times.shape[1]):
                times[BEGIN, row] = stack.facts[top, TICKS + row]
            run.counts[:] = 0
            here = held_by(run.surfaces, run.roots[k, 0], run.roots[k, 1])
            step_one(step_tables(run, cell_of(run.space, k), here), stack.packets, top * SIZE, port)
            _price(run, k, group)
            top = _push_sent(run, top, k)
        for row in range(times.shape[1]):
            work.longest[row] = max(work.longest[row], times[END, row])
