"""Packets that wait in a node: one stack a class, newest first out, so that deep rays go before young ones.

Classes in order of service: what only travels (returns and pixels), shadows, other rays.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .compiled import lean, part
from .native import copy_bytes
from .outputs import HEAD
from .packets import (
    SHADOW,
    SIZE,
    Limits,
    fault,
    is_sound_ray,
    is_sound_shadow,
    is_sound_traveller,
    read_kind,
)

TRAVELLERS, SHADOWS, RAYS = 0, 1, 2
CLASSES = 3
RUN = 64  # most packets that are copied at once: so they are still in the nearest cache
MOST = 3  # place after the classes: the most packets that waited at once
FIRST_ROOM = 32768  # packets; kept from frame to frame, so that its pages are there
BYTES_A_PACKET = SIZE + 1  # the packet, and the port by which it came

Bytes = NDArray[np.uint8]


class Stacks(NamedTuple):
    """Packets of each class, uint8 bytes, 25 each, and the uint8 port by which each came."""

    travellers: Bytes
    shadows: Bytes
    rays: Bytes
    traveller_ports: Bytes
    shadow_ports: Bytes
    ray_ports: Bytes


@part
def _class(kind):
    """The class of a kind of packet; of what is no kind any."""
    return TRAVELLERS if kind > SHADOW else (SHADOWS if kind == SHADOW else RAYS)


@part
def _sound_run(message, first, last, limits):
    """(class of packet `first`, end of the run of packets of that class from there that have no fault, or `last`).

    In a loop for each class, so that what is checked is not chosen for each packet.
    """
    kind, k = _class(read_kind(message, HEAD + first * SIZE)), first
    if kind == SHADOWS:
        while k < last and is_sound_shadow(message, HEAD + k * SIZE, limits):
            k += 1
    elif kind == RAYS:
        while k < last and is_sound_ray(message, HEAD + k * SIZE, limits):
            k += 1
    else:
        while k < last and is_sound_traveller(message, HEAD + k * SIZE, limits):
            k += 1
    return kind, k


@part
def _put(message, first, end, packets, ports, port, held):
    """Put packets first..end-1 of a message on a stack; how many it holds then."""
    many = end - first
    copy_bytes(message, HEAD + first * SIZE, packets, held * SIZE, many * SIZE)
    for k in range(held, held + many):
        ports[k] = port
    return held + many


@part
def sort(message, count, port, bounds, stacks, held):
    """Check `count` packets of a message and put each on the stack of its class; (first bad one or -1, its fault).

    Packets of a class come in runs, as the neighbour's steps put them out, and are copied so.
    bounds: int64, the fields of Limits; held: int64, packets on each stack, updated.
    """
    limits = Limits(bounds[0], bounds[1], bounds[2], bounds[3], (bounds[4], bounds[5], bounds[6]))
    first = 0
    while first < count:
        kind, end = _sound_run(message, first, min(count, first + RUN), limits)
        if end == first:
            bad = fault(message, HEAD + first * SIZE, limits)
            if bad != 0:
                return first, bad
            end += 1  # sound after all
        if kind == SHADOWS:
            held[SHADOWS] = _put(message, first, end, stacks.shadows, stacks.shadow_ports, port, held[SHADOWS])
        elif kind == RAYS:
            held[RAYS] = _put(message, first, end, stacks.rays, stacks.ray_ports, port, held[RAYS])
        else:
            held[TRAVELLERS] = _put(
                message, first, end, stacks.travellers, stacks.traveller_ports, port, held[TRAVELLERS]
            )
        first = end
    held[MOST] = max(held[MOST], held[TRAVELLERS] + held[SHADOWS] + held[RAYS])
    return -1, 0


@lean
def _sort_in(message, count, port, bounds, stacks, held):
    return sort(message, count, port, bounds, stacks, held)


class Backlog:
    """The stacks of a node.

    bounds  int64 (7,), the fields of `Limits` of the frame
    stacks  their buffers; a new tuple whenever one has grown
    count   int64 (CLASSES + 1,): packets on each, and the most that waited at once
    """

    def __init__(self) -> None:
        self.bounds = np.zeros(7, np.int64)
        self.count = np.zeros(CLASSES + 1, np.int64)
        self.stacks = Stacks(
            *[np.zeros(FIRST_ROOM * (1 if k >= CLASSES else SIZE), np.uint8) for k in range(2 * CLASSES)]
        )

    @property
    def held(self) -> int:
        """Packets that wait."""
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
            if len(buffers[CLASSES + kind]) > FIRST_ROOM:
                buffers[kind], buffers[CLASSES + kind] = (
                    np.zeros(FIRST_ROOM * SIZE, np.uint8),
                    np.zeros(FIRST_ROOM, np.uint8),
                )
        self.stacks = Stacks(*buffers)
        self.count[:] = 0

    def set_limits(self, limits: Limits) -> None:
        """What packets of the frame may name."""
        self.bounds = np.array([*limits[:4], *limits.shape], np.int64)

    def make_room(self, *more: int) -> None:
        """Room for so many more packets of each class, by doubling."""
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
