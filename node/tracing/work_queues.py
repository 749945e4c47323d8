"""Queues packets that wait in a node: one stack a class, newest first out, so that deep rays go before young ones.

Classes in order of service: what is in transit only (returns and pixels), shadows, other rays.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.node.jit.decorators import lean, part
from raygrid.node.protocol.messages import HEAD
from raygrid.node.protocol.packets import (
    SHADOW,
    SIZE,
    PacketLimits,
    copy_packet,
    fault,
    is_sound_ray,
    is_sound_return,
    is_sound_shadow,
    read_kind,
)

IN_TRANSIT, SHADOWS, RAYS = 0, 1, 2
CLASSES = 3
MOST = 3  # place after the classes: the most packets that waited at once
FIRST_QUEUE_ROOM = 32768  # packets; kept from frame to frame, so that its pages are there
BYTES_A_PACKET = SIZE + 1  # the packet, and the port by which it came

Bytes = NDArray[np.uint8]


class Stacks(NamedTuple):
    """Packets of each class, uint8 bytes, 25 each, and the uint8 port by which each came."""

    in_transit: Bytes
    shadows: Bytes
    rays: Bytes
    transit_ports: Bytes
    shadow_ports: Bytes
    ray_ports: Bytes


@part
def _class(kind):
    """The class of a kind of packet; of what is no kind any."""
    return IN_TRANSIT if kind > SHADOW else (SHADOWS if kind == SHADOW else RAYS)


@part
def _take_run(message, first, count, limits, kind, packets, held):
    """Copy packets of one class from packet `first` on to a stack, until one is of another class or has a fault; the
    number of that one. A loop for each class, so that what is checked is not chosen for each packet."""
    at, to, k = HEAD + first * SIZE, held * SIZE, first
    if kind == SHADOWS:
        while k < count and is_sound_shadow(message, at, limits):
            copy_packet(message, at, packets, to)
            at, to, k = at + SIZE, to + SIZE, k + 1
    elif kind == RAYS:
        while k < count and is_sound_ray(message, at, limits):
            copy_packet(message, at, packets, to)
            at, to, k = at + SIZE, to + SIZE, k + 1
    else:
        while k < count and is_sound_return(message, at, limits):
            copy_packet(message, at, packets, to)
            at, to, k = at + SIZE, to + SIZE, k + 1
    return k


@part
def sort(message, count, port, bounds, stacks, held):
    """Check `count` packets of a message and put each on the stack of its class; (first bad one or -1, its fault).

    Packets of a class come in runs, as the neighbour's steps put them out.
    bounds: int64, the fields of PacketLimits; held: int64, packets on each stack, updated. Each stack has room for all.
    """
    limits = PacketLimits(bounds[0], bounds[1], bounds[2], bounds[3], (bounds[4], bounds[5], bounds[6]))
    first = 0
    while first < count:
        at = HEAD + first * SIZE
        kind = _class(read_kind(message, at))
        packets, ports = stacks.in_transit, stacks.transit_ports
        if kind == SHADOWS:
            packets, ports = stacks.shadows, stacks.shadow_ports
        elif kind == RAYS:
            packets, ports = stacks.rays, stacks.ray_ports
        end = _take_run(message, first, count, limits, kind, packets, held[kind])
        if end == first:  # a pixel, or it has a fault
            bad = fault(message, at, limits)
            if bad != 0:
                return first, bad
            copy_packet(message, at, packets, held[kind] * SIZE)
            end += 1
        for k in range(held[kind], held[kind] + end - first):
            ports[k] = port
        held[kind] += end - first
        first = end
    held[MOST] = max(held[MOST], held[IN_TRANSIT] + held[SHADOWS] + held[RAYS])
    return -1, 0


@lean
def _sort_in(message, count, port, bounds, stacks, held):
    return sort(message, count, port, bounds, stacks, held)


class WorkQueues:
    """The stacks of a node.

    bounds  int64 (7,), the fields of `PacketLimits` of the frame
    stacks  their buffers; a new tuple whenever one has grown
    count   int64 (CLASSES + 1,): packets on each, and the most that waited at once
    """

    def __init__(self) -> None:
        self.bounds = np.zeros(7, np.int64)
        self.count = np.zeros(CLASSES + 1, np.int64)
        self.stacks = Stacks(
            *[np.zeros(FIRST_QUEUE_ROOM * (1 if k >= CLASSES else SIZE), np.uint8) for k in range(2 * CLASSES)]
        )

    @property
    def held(self) -> int:
        """Count the packets that wait."""
        one, two, three, _ = self.count.tolist()
        return int(one + two + three)

    @property
    def most_held(self) -> int:
        """The most packets that waited at once."""
        return int(self.count[MOST])

    @property
    def size(self) -> int:
        """Size of the stacks' buffers."""
        return sum(len(self.stacks[CLASSES + kind]) for kind in range(CLASSES)) * BYTES_A_PACKET

    def packets(self, kind: int) -> Bytes:
        """The packets of one class, 25 bytes each, oldest first."""
        return self.stacks[kind][: int(self.count[kind]) * SIZE]

    def clear(self) -> None:
        """Forget all packets, and the most that waited, and give large buffers back."""
        buffers = list(self.stacks)
        for kind in range(CLASSES):
            if len(buffers[CLASSES + kind]) > FIRST_QUEUE_ROOM:
                buffers[kind], buffers[CLASSES + kind] = (
                    np.zeros(FIRST_QUEUE_ROOM * SIZE, np.uint8),
                    np.zeros(FIRST_QUEUE_ROOM, np.uint8),
                )
        self.stacks = Stacks(*buffers)
        self.count[:] = 0

    def set_limits(self, limits: PacketLimits) -> None:
        """Set what packets of the frame may name."""
        self.bounds = np.array([*limits[:4], *limits.shape], np.int64)

    def make_room(self, *more: int) -> None:
        """Make room for so many more packets of each class, by doubling."""
        buffers = list(self.stacks)
        grown = False
        for kind, wanted in enumerate(more):
            held, have = int(self.count[kind]), len(buffers[CLASSES + kind])
            if held + wanted > have:
                room = max(held + wanted, 2 * have)
                for place, size in ((kind, SIZE), (CLASSES + kind, 1)):
                    larger = np.zeros(room * size, np.uint8)
                    larger[: held * size] = buffers[place][: held * size]
                    buffers[place] = larger
                grown = True
        if grown:
            self.stacks = Stacks(*buffers)

    def sort_in(self, message: bytes, count: int, port: int) -> tuple[int, int]:
        """Take in a PACKETS message whose length was checked; (number, fault) of the first bad packet, or (-1, 0)."""
        self.make_room(count, count, count)
        number, bad = _sort_in(np.frombuffer(message, np.uint8), count, port, self.bounds, self.stacks, self.count)
        return int(number), int(bad)
