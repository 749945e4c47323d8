"""Which processors there are, and which pairs of them are wired."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

from raygrid.node.geometry import HOST, corners
from raygrid.node.links import Channel, Link

Index = tuple[int, int, int]


class Wiring(NamedTuple):
    """A link between neighbours: `lower` is the one with the smaller coordinate on the axis."""

    lower: Index
    upper: Index
    axis: int

    @property
    def lower_port(self) -> int:
        """The port of the lower node that leads to the upper one."""
        return 2 * self.axis + 1

    @property
    def upper_port(self) -> int:
        """The port of the upper node that leads to the lower one."""
        return 2 * self.axis


def indices(shape: Index) -> Iterator[Index]:
    """Every cell, x fastest."""
    for z in range(shape[2]):
        for y in range(shape[1]):
            for x in range(shape[0]):
                yield (x, y, z)


def neighbour_links(shape: Index) -> Iterator[Wiring]:
    """Every link between two face neighbours, once."""
    for index in indices(shape):
        for axis in range(3):
            if index[axis] + 1 < shape[axis]:
                upper = list(index)
                upper[axis] += 1
                yield Wiring(index, (upper[0], upper[1], upper[2]), axis)


def host_links(shape: Index, channels: Mapping[int, Channel], machine: str, epoch: int) -> dict[int, Link]:
    """The host's ends of the links to the corners, corner number -> link."""
    links = {}
    for corner, index in corners(shape).items():
        identity = {"machine": machine, "node": list(index), "port": -1}
        peer = {"machine": machine, "node": list(index), "port": HOST}
        links[corner] = Link(channels[corner], f"host to corner {corner}", epoch, identity, peer)
    return links
