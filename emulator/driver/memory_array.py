"""Runs an array inside one process: the same processors and links over queues in memory. For tests and comparison."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from raygrid.emulator.driver.driver import Driver
from raygrid.emulator.topology.coordinates import indices
from raygrid.emulator.topology.topology import host_links, neighbour_links
from raygrid.node.geometry import HOST, corners
from raygrid.node.links import Link, MemoryChannel, memory_channels
from raygrid.node.main import open_links, processor_class
from raygrid.node.protocol import NodeConfig
from raygrid.node.runtime import Processor

Order = Callable[[int], np.ndarray]


class MemoryArray:
    """Processors of an array, run in turn. `order(n)` may give another order of the n nodes for each round."""

    def __init__(
        self,
        shape: tuple[int, int, int],
        batch: int = 1024,
        order: Order = np.arange,
        programs: bool = False,
        timed: bool = False,
        profile: bool = False,
    ) -> None:
        channels: dict[tuple[int, int, int], dict[int, Any]] = {index: {} for index in indices(shape)}
        for link in neighbour_links(shape):
            channels[link.lower][link.lower_port], channels[link.upper][link.upper_port] = memory_channels()
        host_ends: dict[int, MemoryChannel] = {}
        for corner, index in corners(shape).items():
            channels[index][HOST], host_ends[corner] = memory_channels()
        self._order = order
        self.processors: list[Processor] = []
        for index in indices(shape):
            links = open_links(NodeConfig(index, shape), channels[index])
            kind = processor_class(timed)
            self.processors.append(kind(index, shape, links, batch, lambda: 0.0, programs, profile))
        links_of_host: dict[int, Link] = host_links(shape, host_ends, "memory", 0)
        self.driver = Driver(shape, links_of_host, self._pump)

    def _pump(self, _seconds: float) -> None:
        """One round: every node receives and works once, then the host receives."""
        for number in self._order(len(self.processors)):
            processor = self.processors[int(number)]
            for port in processor.links:
                processor.receive(port)
            processor.work()
        for corner in self.driver.links:
            self.driver.receive(corner)
