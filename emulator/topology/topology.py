"""Connects the processors of an array: neighbours to each other, the host to the corners, surfaces to the nearest corner."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.emulator.topology.coordinates import Index, beyond, indices
from raygrid.node.geometry import HOST, corners
from raygrid.node.links import Channel, Link


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


def neighbour_links(shape: Index) -> Iterator[Wiring]:
    """Every link between two face neighbours, once."""
    for index in indices(shape):
        for axis in range(3):
            if index[axis] + 1 < shape[axis]:
                yield Wiring(index, beyond(index, 2 * axis + 1), axis)


def nearest_corners(middles: NDArray[np.float64], shape: Index) -> NDArray[np.int64]:
    """The corner, int64 (n,), at which the host deals each surface, by the surface's middle, float64 (n, 3), machine
    coordinates: bit a is set for the upper end of axis a. Axes of one cell have no upper end."""
    found = np.zeros(len(middles), np.int64)
    for axis in range(3):
        if shape[axis] > 1:
            found |= (middles[:, axis] >= 0.0).astype(np.int64) << axis
    return found


def host_links(shape: Index, channels: Mapping[int, Channel], machine: str, epoch: int) -> dict[int, Link]:
    """The host's ends of the links to the corners, corner number -> link."""
    links = {}
    for corner, index in corners(shape).items():
        identity = {"machine": machine, "node": list(index), "port": -1}
        peer = {"machine": machine, "node": list(index), "port": HOST}
        links[corner] = Link(channels[corner], f"host to corner {corner}", epoch, identity, peer)
    return links
