"""A tiny array for the tests: cells and queues in one process, driven in any order, with every law checked on the way.

Nothing here is the machine's: it holds the ray step to its own word.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from raygrid.node.geometry.bvh import DEPTH
from raygrid.node.geometry.grid_walk import HOST, OPPOSITE, OUTPUTS, SELF, SELF_RAYS, leaves_array
from raygrid.node.geometry.lattice import Space, make_cell
from raygrid.node.geometry.overlap import meets
from raygrid.node.geometry.surfaces import SurfaceSet, merge
from raygrid.node.protocol import decoding, packets
from raygrid.node.protocol.counters import BORN, COUNTS, DIED, HOMES, MISADDRESSED
from raygrid.node.protocol.frame_tables import Frame, frame_limits
from raygrid.node.protocol.messages import HEAD
from raygrid.node.protocol.packets import SIZE
from raygrid.node.tracing.framebuffer import make_pixels, send_pixels
from raygrid.node.tracing.local_geometry import build_surfaces
from raygrid.node.tracing.output_queues import make_outputs
from raygrid.node.tracing.primaries import DONE, new_cursor, spawn_primaries
from raygrid.node.tracing.step import step
from raygrid.node.tracing.step_tables import StepTables
from support.space import Index, indices, neighbour

Bytes = NDArray[np.uint8]
ROOM = 1024  # packets an output holds
COUNTED = slice(packets.PRIMARY, packets.PIXEL + 1)


class Node:
    """One cell: what it retains, its pixels, its counts, and the packets that wait for it."""

    def __init__(self, space: Space, index: Index, surfaces: SurfaceSet, frame: Frame) -> None:
        self.cell = make_cell(space, index)
        low, high = np.array(self.cell.low_at), np.array(self.cell.high_at)
        self.retained = merge(batch.select(meets(batch, low, high)) for batch in surfaces)
        self.surfaces = build_surfaces(self.retained, self.cell)
        self.pixels = make_pixels(frame, space, self.cell)
        self.cursor = new_cursor(len(self.pixels.first) > 0)
        self.counts = np.zeros(COUNTS, np.int64)
        self.packets: Bytes = np.zeros((0, SIZE), np.uint8)
        self.ports: Bytes = np.zeros(0, np.uint8)
        self.arrived: list[tuple[Bytes, int]] = []

    def receive(self, rows: Bytes, port: int) -> None:
        """Packets (n, 25) that came by one port."""
        self.arrived.append((rows, port))

    def waiting(self) -> int:
        """How many packets wait; those that arrived join the queue."""
        if self.arrived:
            self.packets = np.concatenate([self.packets, *(rows for rows, _ in self.arrived)])
            ports = [np.full(len(rows), port, np.uint8) for rows, port in self.arrived]
            self.ports = np.concatenate([self.ports, *ports])
            self.arrived = []
        return len(self.ports)


class Grid:
    """All cells of an array. `schedule` shuffles nodes, orders of packets, and how many are handed to a call.

    serve  what takes packets first..last-1, arguments and result as of `step`
    """

    def __init__(
        self,
        space: Space,
        surfaces: SurfaceSet,
        frame: Frame,
        schedule: np.random.Generator | None = None,
        serve: Callable[..., int] = step,
    ) -> None:
        self.step = serve
        self.space, self.frame, self.schedule = space, frame, schedule
        self.limits = frame_limits(frame, space.shape)
        self.nodes = {index: Node(space, index, surfaces, frame) for index in indices(space)}
        self.outputs = make_outputs(ROOM, DEPTH)
        self.outputs.data[:, :HEAD] = 0
        self.to_host: list[Bytes] = []
        self.processed = 0  # packets
        self.stopped = 0  # calls that stopped early, for want of room
        self.fullest = 0  # most packets that an output has held

    def run(self, births: bool = True) -> None:
        """Until nothing waits and no sample is left to be born."""
        live = list(self.nodes.values())
        while live:
            if self.schedule is not None:
                live = [live[k] for k in self.schedule.permutation(len(live))]
            for node in live:
                if births and node.cursor[DONE] == 0:
                    self._bear(node)
                if node.waiting():
                    self._serve(node)
            live = [n for n in self.nodes.values() if n.waiting() or (births and n.cursor[DONE] == 0)]

    def tables(self, node: Node) -> StepTables:
        """What the step of a cell reads and writes."""
        return StepTables(node.cell, self.space, self.frame, node.surfaces, node.pixels, self.outputs, node.counts)

    def _bear(self, node: Node) -> None:
        room = 4096 if self.schedule is None else int(self.schedule.choice([1, 100, 4096]))
        buffer = np.zeros(room * SIZE, np.uint8)
        made = spawn_primaries(self.tables(node), node.cursor, buffer, 0, room)
        node.receive(buffer.reshape(-1, SIZE)[:made].copy(), SELF)

    def _serve(self, node: Node) -> None:
        """Hand a part of what waits to the step, in as many calls as it wants."""
        rows, ports, many = node.packets, node.ports, len(node.ports)
        if self.schedule is not None:
            order = self.schedule.permutation(many)
            rows, ports = rows[order], ports[order]
            many = int(np.ceil(many * self.schedule.choice([0.1, 0.6, 1.0, 1.0, 1.0, 1.0])))
        node.packets, node.ports = rows[many:], ports[many:]
        flat, served, first = np.ascontiguousarray(rows[:many]).reshape(-1), ports[:many].copy(), 0
        while first < many:
            in_parts = self.schedule is not None and self.schedule.random() < 0.3
            last = int(self.schedule.integers(first + 1, many + 1)) if in_parts else many
            done = self.step(self.tables(node), flat, served, first, last)
            assert done > first, "a step with room for its outputs made no headway"
            self.processed += done - first
            self.stopped += done < last
            self.fullest = max(self.fullest, int(self.outputs.held.max()))
            first = done
            self.drain(node)

    def drain(self, node: Node) -> None:
        """Take what a step has put out to where it belongs; every packet must be one of this frame."""
        for output in range(OUTPUTS):
            held = int(self.outputs.held[output])
            if held == 0:
                continue
            data = self.outputs.data[output]
            assert packets.first_fault(data, HEAD, held, self.limits) == (-1, 0)
            rows = data[HEAD : HEAD + held * SIZE].reshape(held, SIZE).copy()
            self.outputs.held[output] = 0
            if output in (SELF, SELF_RAYS):
                node.receive(rows, SELF)
            elif output == HOST:
                self.to_host.append(rows)
            else:
                assert not leaves_array(node.cell.index, self.space.shape, output), "sent out of the array"
                self.nodes[neighbour(node.cell.index, output)].receive(rows, OPPOSITE[output])

    # --- what came of it --------------------------------------------------------------------------------

    def counts(self) -> NDArray[np.int64]:
        """The counts of all nodes together."""
        return np.sum([node.counts for node in self.nodes.values()], axis=0)

    def check_conservation(self) -> None:
        """Law 5: every packet born has died, kind by kind, and every return found its home."""
        counts = self.counts()
        born, died = counts[BORN:][COUNTED], counts[DIED:][COUNTED]
        np.testing.assert_array_equal(born, died)
        assert counts[MISADDRESSED] == 0
        assert counts[HOMES] == counts[BORN + packets.RETURN]
        assert all(node.waiting() == 0 for node in self.nodes.values())

    def sums(self) -> NDArray[np.int64]:
        """Red, green, blue and samples of every pixel, added over the homes: int64 (pixels, 4)."""
        width = self.frame.width
        picture = np.zeros((width * self.frame.height, 4), np.int64)
        for node in self.nodes.values():
            pixels = node.pixels
            row = np.repeat(np.arange(len(pixels.first)), np.diff(pixels.offsets))
            column = np.arange(len(row)) - pixels.offsets[row] + pixels.first[row]
            np.add.at(
                picture, (pixels.first_row + row) * width + column, np.column_stack((pixels.sums, pixels.samples))
            )
        return picture

    def delivered(self) -> NDArray[np.int64]:
        """The same as the host gets it: stores are emptied into pixel packets, which travel to the corners."""
        for node in self.nodes.values():
            cursor = np.int64(0)
            while cursor >= 0:
                buffer = np.zeros(50 * SIZE, np.uint8)
                made, cursor = send_pixels(node.pixels, self.frame.width, cursor, buffer, 0, 50, node.counts)
                node.receive(buffer.reshape(-1, SIZE)[:made], SELF)
        self.run(births=False)
        picture = np.zeros((self.frame.width * self.frame.height, 4), np.int64)
        for row in np.concatenate(self.to_host or [np.zeros((0, SIZE), np.uint8)]):
            packet = decoding.decode(row.tobytes())
            picture[packet.number] += (*packet.values, packet.samples)
        return picture


def inject(grid: Grid, rows: Bytes, at: Sequence[Index] | NDArray[np.int64]) -> None:
    """Put packets (n, 25) into cells as if they had been born there; their births are counted."""
    by_cell: dict[Index, list[int]] = {}
    for k, index in enumerate(at):
        by_cell.setdefault((int(index[0]), int(index[1]), int(index[2])), []).append(k)
    for index, chosen in by_cell.items():
        node = grid.nodes[index]
        node.receive(rows[chosen], SELF)
        np.add.at(node.counts, BORN + (rows[chosen, 0] & 7).astype(int), 1)
