"""Hands one packet at a time to one node: the ray step under a magnifying glass.

The nodes of an array in memory are loaded by flooding as ever, but not run: each packet is handed to the step alone, so
what comes out of it is known to be its own. Provenance (`emulator.analysis.provenance`) and the model of the naive machine
(`emulator.analysis.deadlock_model`) stand on it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.emulator.analysis.sample_facts import brought_home
from raygrid.emulator.driver.memory_array import MemoryArray
from raygrid.emulator.topology.coordinates import Index
from raygrid.emulator.topology.limits import read_resources
from raygrid.node.errors import TooLarge
from raygrid.node.geometry import DEPTH, Space, SurfaceSet
from raygrid.node.protocol import COUNTS, HEAD, SIZE, Frame, frame_order
from raygrid.node.runtime import NodeState
from raygrid.node.tracing import (
    DONE,
    FOUND_DIRECTION,
    FOUND_POINT,
    FOUND_TIME,
    make_outputs,
    observed_step,
    spawn_primaries,
    spawn_primary,
)

NODE_BYTES = 800_000  # of a node in memory, without surfaces (measured)
Units = tuple[int, int, int]
Vector = tuple[float, float, float]


class Met(NamedTuple):
    """What a ray or shadow ray met first in a cell.

    item       of the node's tables, -1 for nothing
    time       the ray parameter there; point: where that is
    direction  of the ray, also if it met nothing
    inside     whether all of a refracted ray is reflected (total internal reflection)
    """

    item: int
    time: float
    point: Vector
    direction: Vector
    inside: bool


class Served(NamedTuple):
    """What a step made of one packet.

    out     (output, packet), in the order of outputs, on one output in the order in which they were made
    counts  int64 (COUNTS,): what it counted
    met     what the ray met, if it is one and has walked through the cell
    """

    out: list[tuple[int, bytes]]
    counts: NDArray[np.int64]
    met: Met


class SingleStep:
    """A loaded array whose nodes do nothing unless they are told to.

    space, surfaces, frame   machine coordinates, as of `Driver.load` and `Driver.trace`
    nodes                    by place, x fastest
    Raises TooLarge for an array that this computer has no memory for, ArrayError if it cannot be loaded.
    """

    def __init__(self, space: Space, surfaces: SurfaceSet, frame: Frame) -> None:
        need, there = math.prod(space.shape) * NODE_BYTES, read_resources().memory
        if need > there.left:
            raise TooLarge(
                f"an array of {'x'.join(map(str, space.shape))} in one process needs {need / 1e9:.1f} GB of memory, "
                f"and {there.limit} leaves {max(there.left, 0) / 1e9:.1f} GB"
            )
        array = MemoryArray(space.shape)
        array.driver.patience = math.inf  # nothing can get lost in memory, and a large hierarchy takes its time
        array.driver.ready()
        array.driver.load(space, surfaces)
        array.driver.wave(frame_order(frame))
        self.space, self.frame = space, frame
        self.nodes: dict[Index, NodeState] = {processor.index: processor.node_state for processor in array.processors}
        self._outputs = make_outputs(2 * (frame.n_lights + 2), DEPTH, 1)
        self._ports = np.zeros(1, np.uint8)

    def serve(self, index: Index, packet: bytes, port: int) -> Served:
        """Hand one packet, which came by that port, to one node."""
        node, outputs = self.nodes[index], self._outputs
        before = node.counts.copy()
        self._ports[0] = port
        rows = np.frombuffer(bytearray(packet), np.uint8)
        observed_step(node.step_tables(outputs), rows, self._ports, 0, 1)
        out = []
        for output in np.flatnonzero(outputs.held).tolist():
            data = outputs.data[output, HEAD : HEAD + int(outputs.held[output]) * SIZE].tobytes()
            out += [(output, data[at : at + SIZE]) for at in range(0, len(data), SIZE)]
        outputs.held[:] = 0
        return Served(out, node.counts - before, self._met())

    def _met(self) -> Met:
        found, row = self._outputs.found, self._outputs.found.facts[0].tolist()
        point, direction = (tuple(row[at : at + 3]) for at in (FOUND_POINT, FOUND_DIRECTION))
        return Met(int(found.items[0]), row[FOUND_TIME], point, direction, bool(found.inside[0]))

    def brought_home(self) -> Vector:
        """The intensity of the return packet that the packet served last has brought forth."""
        red, green, blue = brought_home(self._outputs)
        return float(red), float(green), float(blue)

    def emit(self, index: Index, sample: int) -> bytes | None:
        """The primary ray of a sample, emitted at this node; None if its home is elsewhere."""
        node, frame = self.nodes[index], self.frame
        pixel, number = divmod(sample, frame.samples)
        j, i = divmod(pixel, frame.width)
        packet = np.zeros(SIZE, np.uint8)
        made = spawn_primary(node.step_tables(self._outputs), i, j, number, packet)
        return packet.tobytes() if made else None

    def emit_next(self, index: Index) -> bytes | None:
        """The primary ray of this home's next sample, coarse to fine; None if none is left."""
        node = self.nodes[index]
        if node.cursor[DONE]:
            return None
        packet = np.zeros(SIZE, np.uint8)
        made = spawn_primaries(node.step_tables(self._outputs), node.cursor, packet, 0, 1)
        return packet.tobytes() if made else None

    def stored(self, index: Index, pixel: int) -> Units:
        """What this home holds of a pixel, in fixed point; zeros where it has no room for it."""
        pixels = self.nodes[index].pixels
        assert pixels is not None
        j, i = divmod(pixel, self.frame.width)
        row = j - pixels.first_row
        if 0 <= row < len(pixels.first):
            at = int(pixels.offsets[row]) + i - int(pixels.first[row])
            if int(pixels.offsets[row]) <= at < int(pixels.offsets[row + 1]):
                red, green, blue = pixels.sums[at].tolist()
                return red, green, blue
        return 0, 0, 0

    def counts(self) -> NDArray[np.int64]:
        """The counts of all nodes together, int64 (COUNTS,)."""
        total = np.zeros(COUNTS, np.int64)
        for node in self.nodes.values():
            total += node.counts
        return total
