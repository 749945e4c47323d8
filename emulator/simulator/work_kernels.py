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

from raygrid.emulator.simulator.event_loop import cell_of, held_by
from raygrid.node.geometry import PORTS, SELF
from raygrid.node.jit import lean, part
from raygrid.node.protocol import BORN, COUNTS, HEAD, PRIMARY, SENT, SIZE, WALKS
from raygrid.node.tracing import StepTables, spawn_sample
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
    longest  int64 (lists,): ticks of the sample that would take longest alone; together: the sum over all
    counts   int64 (COUNTS,) of all; steps: int64 (1,), how many packets were served
    """

    busy: Long
    sent: Long
    born: Long
    longest: Long
    together: Long
    counts: Long
    steps: Long


@part
def _push(stack, top, cell, port, source, at):
    """Put a packet on the stack; its ticks are written by who calls."""
    for byte in range(SIZE):
        stack.packets[top * SIZE + byte] = source[at + byte]
    stack.facts[top, CELL], stack.facts[top, PORT] = cell, port


@part
def _push_sent(stack, top, k, nx, nxy, prices, outputs, counts, ready, own):
    """Take what a service has put on the outputs; returns the new height. `ready`, `own`: int64 (lists,), ticks from
    which a packet can be sent, and at which one is served that starts here."""
    nth = np.int64(0)
    for output in range(len(outputs.held)):
        for packet in range(outputs.held[output]):
            cell, port = k, np.int64(SELF)
            if output < PORTS:
                stride = 1 if output < 2 else (nx if output < 4 else nxy)
                cell, port = (k + stride if output & 1 else k - stride), np.int64(output ^ 1)
                nth += 1
            _push(stack, top, cell, port, outputs.data[output], HEAD + packet * SIZE)
            for row in range(len(ready)):
                tick = own[row]
                if output < PORTS:
                    before = nth if prices.by_processor[row] != 0 else 1
                    tick = ready[row] + before * prices.transmit[row] + prices.latency[row]
                stack.facts[top, TICKS + row] = tick
            top += 1
        outputs.held[output] = 0
    return top


@part
def _price(work, prices, counts, k, group, tick, ready, own):
    """Add what a service costs to its cell; tick int64 (lists,): when it begins."""
    sent = np.int64(0)
    for output in range(PORTS):
        sent += counts[SENT + output]
        work.sent[k, output] += counts[SENT + output]
    for row in range(len(ready)):
        ticks = prices.packet[row] + prices.walks[row, k] * counts[WALKS]
        for count in range(COUNTS):
            ticks += prices.counts[row, count] * counts[count]
        ready[row] = tick[row] + ticks
        ticks += prices.by_processor[row] * prices.transmit[row] * sent
        own[row] = tick[row] + ticks
        work.busy[k, group, row] += ticks
    for count in range(COUNTS):
        work.counts[count] += counts[count]
    work.steps[0] += 1


@lean
def follow_samples(homes, space, frame, surfaces, roots, pixels, outputs, stack, prices, work, counts, times):
    """Follow all packets of the samples of a frame.

    homes   int32 (samples,), -1: misses the world box; times: int64 (4, lists), scratch
    """
    nx, nxy = space.shape[0], space.shape[0] * space.shape[1]
    ready, own, tick, end = times[0], times[1], times[2], times[3]
    for sample in range(len(homes)):
        home = np.int64(homes[sample])
        if home < 0:
            continue
        pixel = sample // frame.samples
        j = pixel // frame.width
        i = pixel - j * frame.width
        group = (i & (APART - 1)) + APART * (j & (APART - 1))
        tables = StepTables(cell_of(space, home), space, frame, surfaces, pixels, outputs, counts)
        made = spawn_sample(tables, (i, j, pixel), sample - pixel * frame.samples, stack.packets)
        if made == 0:
            continue
        work.born[home] += 1
        stack.facts[0, CELL], stack.facts[0, PORT] = home, SELF
        for row in range(len(ready)):
            price = prices.counts[row, BORN + PRIMARY]
            work.busy[home, group, row] += price
            stack.facts[0, TICKS + row] = end[row] = price
        top = np.int64(1)
        while top > 0:
            top -= 1
            k, port = stack.facts[top, CELL], stack.facts[top, PORT]
            for row in range(len(ready)):
                tick[row] = stack.facts[top, TICKS + row]
            counts[:] = 0
            here = held_by(surfaces, roots[k, 0], roots[k, 1])
            step_one(
                StepTables(cell_of(space, k), space, frame, here, pixels, outputs, counts),
                stack.packets,
                top * SIZE,
                port,
            )
            _price(work, prices, counts, k, group, tick, ready, own)
            for row in range(len(ready)):
                end[row] = max(end[row], own[row])
            top = _push_sent(stack, top, k, nx, nxy, prices, outputs, counts, ready, own)
        for row in range(len(ready)):
            work.longest[row] = max(work.longest[row], end[row])
            work.together[row] += end[row]
