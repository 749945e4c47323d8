"""Packets that wait in a node: one stack a class, newest first out, so that deep rays go before young ones.

Classes in order of service: what only travels (returns and pixels), shadows, other rays.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .compiled import kernel
from .packets import PIXEL, RETURN, SHADOW, SIZE, Limits, copy_packet, fault
from .step import HEAD

TRAVELLERS, SHADOWS, RAYS = 0, 1, 2
CLASSES = 3
FIRST_ROOM = 8192  # packets
BYTES_A_PACKET = SIZE + 1  # the packet, and the port by which it came


class Stack:
    """Packets of one class: uint8 bytes, 25 each, and the uint8 port by which each came."""

    def __init__(self) -> None:
        self.packets: NDArray[np.uint8] = np.zeros(FIRST_ROOM * SIZE, np.uint8)
        self.ports: NDArray[np.uint8] = np.zeros(FIRST_ROOM, np.uint8)
        self.held = 0
        self.most_held = 0

    def make_room(self, more: int) -> None:
        """Room for this many more packets, by doubling."""
        wanted, have = self.held + more, len(self.ports)
        if wanted > have:
            room = max(wanted, 2 * have)
            packets, ports = np.zeros(room * SIZE, np.uint8), np.zeros(room, np.uint8)
            packets[: self.held * SIZE] = self.packets[: self.held * SIZE]
            ports[: self.held] = self.ports[: self.held]
            self.packets, self.ports = packets, ports

    def push(self, packets: NDArray[np.uint8], port: int) -> None:
        """Put packets (uint8, 25 bytes each) that came by one port on top."""
        many = len(packets) // SIZE
        self.make_room(many)
        self.packets[self.held * SIZE : (self.held + many) * SIZE] = packets
        self.ports[self.held : self.held + many] = port
        self.grew(many)

    def grew(self, many: int) -> None:
        """Note that packets were written on top."""
        self.held += many
        self.most_held = max(self.most_held, self.held)

    def took(self, first: int, done: int) -> None:
        """Note that packets first..done-1 are processed; what lies above them sinks."""
        above = self.held - done
        if above and done > first:
            self.packets[first * SIZE : (first + above) * SIZE] = self.packets[done * SIZE : self.held * SIZE].copy()
            self.ports[first : first + above] = self.ports[done : self.held].copy()
        self.held = first + above

    def clear(self) -> None:
        """Forget everything, and give large buffers back."""
        self.__init__()  # type: ignore[misc]


@kernel
def _sort_in(message, count, port, bounds, travellers, t_ports, shadows, s_ports, rays, r_ports, held):
    """Check `count` packets of a message and put each on the stack of its class; (first bad one or -1, its fault).

    bounds: int64, the fields of Limits; bytes and ports of each stack; held: int64 (CLASSES,), updated.
    """
    limits = Limits(bounds[0], bounds[1], bounds[2], bounds[3], (bounds[4], bounds[5], bounds[6]))
    for k in range(count):
        at = HEAD + k * SIZE
        bad = fault(message, at, limits)
        if bad != 0:
            return k, bad
        kind = np.int64(message[at]) & 7
        if kind == SHADOW:
            copy_packet(message, at, shadows, held[1] * SIZE)
            s_ports[held[1]] = port
            held[1] += 1
        elif kind == RETURN or kind == PIXEL:
            copy_packet(message, at, travellers, held[0] * SIZE)
            t_ports[held[0]] = port
            held[0] += 1
        else:
            copy_packet(message, at, rays, held[2] * SIZE)
            r_ports[held[2]] = port
            held[2] += 1
    return -1, 0


class Backlog:
    """The three stacks of a node."""

    def __init__(self) -> None:
        self.stacks = (Stack(), Stack(), Stack())
        self.most_held = 0
        self._held = np.zeros(CLASSES, np.int64)
        self._bounds = np.zeros(7, np.int64)

    @property
    def held(self) -> int:
        """Packets that wait."""
        one, two, three = self.stacks
        return one.held + two.held + three.held

    @property
    def size(self) -> int:
        """Size of the stacks' buffers."""
        return sum(len(stack.ports) for stack in self.stacks) * BYTES_A_PACKET

    def clear(self) -> None:
        """Forget all packets, and the most that waited."""
        for stack in self.stacks:
            stack.clear()
        self.most_held = 0

    def set_limits(self, limits: Limits) -> None:
        """What packets of the frame may name."""
        self._bounds = np.array([*limits[:4], *limits.shape], np.int64)

    def sort_in(self, message: bytes, count: int, port: int) -> tuple[int, int]:
        """Take in a PACKETS message whose length was checked; (number, fault) of the first bad packet, or (-1, 0)."""
        one, two, three = self.stacks
        for stack in self.stacks:
            if stack.held + count > len(stack.ports):
                stack.make_room(count)
        held = self._held
        held[0], held[1], held[2] = one.held, two.held, three.held
        number, bad = _sort_in(
            np.frombuffer(message, np.uint8),
            count,
            port,
            self._bounds,
            one.packets,
            one.ports,
            two.packets,
            two.ports,
            three.packets,
            three.ports,
            held,
        )
        for stack, now in zip(self.stacks, held.tolist(), strict=True):
            if now != stack.held:
                stack.grew(now - stack.held)
        self.most_held = max(self.most_held, self.held)
        return int(number), int(bad)

    def most_urgent(self, worthwhile: int) -> Stack | None:
        """The stack to serve next: the first with `worthwhile` packets, else the first with any."""
        for stack in self.stacks:
            if stack.held >= worthwhile:
                return stack
        for stack in self.stacks:
            if stack.held:
                return stack
        return None
