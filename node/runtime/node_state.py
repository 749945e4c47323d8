"""Holds the state of one node - surfaces, pixels, work queues - and runs the event loop over it. No links here."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from raygrid.node.errors import ProtocolError
from raygrid.node.geometry.bvh import DEPTH
from raygrid.node.geometry.bvh_refit import WORSE, expected_cost
from raygrid.node.geometry.grid_walk import HOST
from raygrid.node.geometry.lattice import Cell, Space, make_cell
from raygrid.node.geometry.overlap import meets
from raygrid.node.geometry.spanning_tree import towards_corner
from raygrid.node.geometry.surfaces import AddedKind, Batch, SurfaceSet, merge
from raygrid.node.jit.indirect import Address, address_of
from raygrid.node.programs.programs import Compiled
from raygrid.node.protocol.commands import USUAL_FLUSH
from raygrid.node.protocol.counters import COUNTS, DIED, SENT
from raygrid.node.protocol.frame_tables import Frame, frame_limits
from raygrid.node.protocol.messages import HEAD
from raygrid.node.protocol.packets import PIXEL, SIZE, PacketLimits
from raygrid.node.runtime.event_loop import LOOP_PACKETS, run_loop
from raygrid.node.runtime.increments import Increments
from raygrid.node.runtime.native_links import no_native_links
from raygrid.node.runtime.node_tables import NodeTables, Tuning
from raygrid.node.runtime.timers import make_timers
from raygrid.node.tracing.batch import ADMIT_AT_ONCE, ADMIT_BELOW, BATCH_CROWDED, BATCH_IDLE, BATCH_RAYS, PORTION
from raygrid.node.tracing.framebuffer import Pixels, make_pixels, send_pixels
from raygrid.node.tracing.local_geometry import build_surfaces, empty_surfaces, refit_surfaces
from raygrid.node.tracing.output_queues import clear, make_outputs
from raygrid.node.tracing.primaries import DONE, new_cursor
from raygrid.node.tracing.step import step
from raygrid.node.tracing.step_tables import Outputs, StepTables
from raygrid.node.tracing.work_queues import WorkQueues

CHUNK = 8192  # pixel packets sent at once
OUTPUT_ROOM = 16384  # packets that an output holds


class NodeState:
    """State of one node between two messages.

    counts     int64 (COUNTS,), `node.protocol.counters`: what the machine did for this frame
    tuning     how eagerly it sends and traces
    quota      primaries that this node may still spawn before it hears from the root again
    samples_left  whether primaries of this node are still to be spawned
    retained      descriptions of surfaces, of moving ones as they are at rest
    increments    where the moving ones are
    """

    def __init__(self, index: tuple[int, int, int], shape: tuple[int, int, int]) -> None:
        self.index, self.shape = index, shape
        self.space: Space | None = None
        self.cell: Cell | None = None
        self.frame: Frame | None = None
        self.limits: PacketLimits | None = None
        self.retained: list[Batch] = []
        self.increments = Increments()
        self.program: Compiled | None = None
        self.ready: Compiled | None = None  # a program that is to be used next
        self.run_loop = run_loop
        self._ray_step: Address | None = None  # where it is; None: to be found for the tables that there are now
        self.native, self.timers = no_native_links(), make_timers(False)
        self._tuning = Tuning.rows()
        self.tuning = Tuning.view(self._tuning)
        self.tuning.batch_packets, self.tuning.loop_packets = BATCH_RAYS, LOOP_PACKETS
        self.tuning.admit_below, self.tuning.admit_at_once = ADMIT_BELOW, ADMIT_AT_ONCE
        self.tuning.flush = self.tuning.message_packets = USUAL_FLUSH
        self.halted = False  # whether what still comes is dropped, until the next space or frame
        self._stale = False  # whether what is retained has changed since the tables were made
        self._built_cost = 0.0  # expected cost of the hierarchy when it was built, 0: not worked out
        self.surfaces = empty_surfaces()
        self.work_queues = WorkQueues()
        self._crowded = False  # whether a stack had no room in the last batch
        self.outputs = make_outputs(OUTPUT_ROOM, DEPTH)
        self.counts = np.zeros(COUNTS, np.int64)
        self.cursor = new_cursor(False)
        self.samples_left = False
        self.quota = 0
        self.collecting = -1  # place in the pixel store, -1: nothing to send
        self.pixels: Pixels | None = None
        self._spare_pixels: Pixels | None = None  # of the frame before, for its memory

    # --- set-up ------------------------------------------------------------------------------------

    def set_space(self, space: Space) -> None:
        """A new world: forget all surfaces."""
        self.space, self.cell = space, make_cell(space, self.index)
        self.retained, self.surfaces = [], empty_surfaces()
        self.increments.forget()
        self._stale = True
        self._drop_frame()

    def retain(self, batch: Batch, boxes: np.ndarray, rest: Batch | None = None) -> int:
        """Keep the descriptions that touch this cell; returns how many. `rest`: the same at rest, if they move."""
        assert self.cell is not None
        rows = meets(batch, np.array(self.cell.low_at), np.array(self.cell.high_at), boxes)
        own = (batch if rest is None else rest).select(rows)
        if len(own):
            self.retained.append(own)
            self._stale = True
        return len(own)

    def move(self, order: Mapping[str, object]) -> None:
        """Move what is retained, drop what has left (`node.runtime.increments`). Raises ProtocolError."""
        assert self.space is not None and self.cell is not None
        self.retained, touched = self.increments.move(order, self.space, self.cell, self.retained)
        self._stale = self._stale or touched

    def build(self) -> SurfaceSet:
        """Make the tables of the ray step from what is retained; returns it as one batch a kind.

        In the order of ids, for that of arrival differs from run to run, and with it leaves, tests and machine time.
        Where the same surfaces have moved, the hierarchy is made to fit again, unless it has become too costly.
        """
        assert self.cell is not None
        held = SurfaceSet(tuple(batch.select(np.argsort(batch.ids)) for batch in merge(self.retained)))
        self.retained = list(held)
        if not self._stale:
            return held
        present = SurfaceSet(tuple(self.increments.place(batch) for batch in held))
        fitted = refit_surfaces(present, self.cell, self.surfaces) if self.increments.moves is not None else None
        if fitted is not None:
            self._built_cost = self._built_cost or expected_cost(self.surfaces.floats)
            if expected_cost(fitted.floats) > WORSE * self._built_cost:
                fitted = None
        if fitted is None:
            self._built_cost = 0.0
        self.surfaces = build_surfaces(present, self.cell) if fitted is None else fitted
        self._stale = False
        return held

    def use_ready(self) -> None:
        """Let the program that is ready take the place of the one before; none: the step without a program."""
        self.program, self._ray_step = self.ready, None

    def check_known(self, batch: Batch) -> None:
        """Raise ProtocolError for programmed surfaces where no program says what they are."""
        if batch.kind == AddedKind.PROGRAMMED and (
            self.program is None or "surface_hits" not in self.program.program.hooks
        ):
            raise ProtocolError(
                f"{len(batch)} programmed surfaces came, wanted a program with surface_hits before them"
            )

    def forget_frame(self) -> None:
        """Drop the frame with all its packets; the surfaces stay."""
        self._drop_frame()
        self.quota, self.collecting, self.samples_left = 0, -1, False
        clear(self.outputs)
        self.work_queues.clear()

    def _drop_frame(self) -> None:
        self._spare_pixels = self.pixels or self._spare_pixels
        self.frame = self.limits = self.pixels = self._ray_step = None

    def set_frame(self, frame: Frame) -> None:
        """Begin a frame: an empty pixel store, no packets, all counts zero.

        Raises ProtocolError if a surface names a material that the frame does not have.
        """
        assert self.space is not None and self.cell is not None
        most = max((int(batch.materials.max()) for batch in self.retained if len(batch)), default=0)
        if most >= len(frame.materials):
            raise ProtocolError(f"a frame came with {len(frame.materials)} materials, a surface here has number {most}")
        self.forget_frame()
        self.frame, self.limits = frame, frame_limits(frame, self.shape)
        self.work_queues.set_limits(self.limits)
        self.pixels, self._spare_pixels = make_pixels(frame, self.space, self.cell, self._spare_pixels), None
        self.cursor = new_cursor(len(self.pixels.first) > 0)
        self.samples_left = len(self.pixels.first) > 0
        self.counts[:] = 0
        room = max(OUTPUT_ROOM, 2 * (frame.n_lights + 2))
        if self.outputs.data.shape[1] != HEAD + room * SIZE:
            self.outputs = make_outputs(room, DEPTH)

    # --- work --------------------------------------------------------------------------------------

    @property
    def has_work(self) -> bool:
        """Whether `work` would do anything."""
        return self.work_queues.held > 0 or (self.quota > 0 and self.samples_left) or self.collecting >= 0

    def work(self, wait: bool = False) -> int:
        """Run the event loop over the links and the most urgent packets, and send pixels if no packet waits.

        wait   whether it may wait for messages where nothing is left to do
        Returns why the loop ended (`node.runtime.event_loop`).
        """
        if self.frame is None:
            return BATCH_IDLE
        if self._crowded:
            spawned = PORTION * max(self.frame.n_lights, 2)
            self.work_queues.make_room(0, spawned, max(spawned, ADMIT_AT_ONCE))
        self.tuning.may_wait = wait
        self.quota, why = self.run_loop(self.tables(), self.quota)
        self._crowded = why == BATCH_CROWDED
        self.samples_left = self.samples_left and int(self.cursor[DONE]) == 0
        if self.collecting >= 0 and self.work_queues.held == 0:
            self._send_pixels()
        return int(why)

    def tables(self) -> NodeTables:
        """What compiled code works on, in a node with a frame."""
        queues = self.work_queues
        tables = self.step_tables(self.outputs)
        return NodeTables(
            tables,
            self._address(tables),
            self.cursor,
            self._tuning,
            queues.bounds,
            queues.stacks,
            queues.count,
            self.native,
            self.timers,
        )

    def step_tables(self, outputs: Outputs) -> StepTables:
        """What a ray step of this node reads and writes that puts packets on these outputs; there must be a frame."""
        assert self.cell is not None and self.space is not None and self.frame is not None and self.pixels is not None
        return StepTables(self.cell, self.space, self.frame, self.surfaces, self.pixels, outputs, self.counts)

    def _address(self, tables: StepTables) -> Address:
        """Where the ray step is, compiled for the types of these tables, which are the same while a frame lasts."""
        if self._ray_step is None:
            ray_step, stacks = step if self.program is None else self.program.step, self.work_queues.stacks
            self._ray_step = address_of(ray_step, tables, stacks.rays, stacks.ray_ports, 0, 0)
        return self._ray_step

    def _send_pixels(self) -> None:
        """Fill the output towards the nearest corner with pixel packets."""
        assert self.frame is not None and self.cell is not None
        output = towards_corner(self.index, self.shape)
        row, held = self.outputs.data[output], int(self.outputs.held[output])
        at, most = HEAD + held * SIZE, min((len(row) - HEAD) // SIZE - held, CHUNK)
        width, first = self.frame.width, np.int64(self.collecting)
        made, cursor = send_pixels(self.pixels, width, first, row, at, most, self.counts)
        self.collecting = int(cursor)
        self.outputs.held[output] += made
        self.counts[SENT + output] += made
        if output == HOST:
            self.counts[DIED + PIXEL] += made

    @property
    def memory(self) -> dict[str, int]:
        """Bytes by use: what the memory bound is about."""
        surfaces = sum({table.ctypes.data: table.nbytes for table in self.surfaces}.values())  # one is seen twice
        described = sum(batch.data.nbytes + batch.ids.nbytes + batch.materials.nbytes for batch in self.retained)
        store = self.pixels or self._spare_pixels
        pixels = 0 if store is None else store.sums.nbytes + store.samples.nbytes
        return {
            "surfaces": surfaces + described,
            "pixels": pixels,
            "backlog": self.work_queues.size,
            "outputs": self.outputs.data.nbytes,
        }
