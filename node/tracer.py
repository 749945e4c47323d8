"""The work of one node: its surfaces, its pixels, its backlog, and the ray step over them. No links here."""

from __future__ import annotations

import numpy as np

from .backlog import Backlog
from .births import DONE, new_cursor
from .errors import ProtocolError
from .flood import own_part
from .hierarchy import DEPTH
from .holdings import build_surfaces, empty_surfaces
from .lattice import Cell, Space, make_cell
from .packets import PIXEL, SIZE, Limits
from .pixels import Pixels, make_pixels, send_pixels
from .step import HEAD, make_outputs
from .surfaces import Batch, SurfaceSet, merge
from .tables import BORN, COUNTS, DIED, SENT, Frame, frame_limits
from .turn import ADMIT_AT_ONCE, ADMIT_BELOW, CROWDED, PORTION, TURN, turn
from .walk import HOST, OUTPUTS, SELF_RAYS

CHUNK = 8192  # pixel packets sent in a turn
ROOM = 16384  # packets that an output holds


class Tracer:
    """State of one node between two messages.

    counts     int64, see `node.tables`: what the machine did for this frame
    quota      primaries that this node may still bear before it hears from the root again
    samples_left  whether primaries of this node are still to be born
    """

    def __init__(self, index: tuple[int, int, int], shape: tuple[int, int, int]) -> None:
        self.index, self.shape = index, shape
        self.space: Space | None = None
        self.cell: Cell | None = None
        self.frame: Frame | None = None
        self.limits: Limits | None = None
        self.retained: list[Batch] = []
        self.surfaces = empty_surfaces()
        self.backlog = Backlog()
        self._crowded = False  # whether a stack had no room in the last turn
        self.outputs = make_outputs(ROOM, DEPTH)
        self.counts = np.zeros(COUNTS, np.int64)
        self.cursor = new_cursor(False)
        self.samples_left = False
        self.quota = 0
        self.collecting = -1  # place in the pixel store, -1: nothing to send
        self.pixels: Pixels | None = None

    # --- set-up ------------------------------------------------------------------------------------

    def set_space(self, space: Space) -> None:
        """A new world: forget all surfaces."""
        self.space, self.cell = space, make_cell(space, self.index)
        self.retained, self.surfaces = [], empty_surfaces()
        self.frame = self.limits = self.pixels = None

    def retain(self, batch: Batch, boxes: np.ndarray) -> int:
        """Keep the descriptions that touch this cell; returns how many."""
        assert self.cell is not None
        own = own_part(batch, boxes, self.cell)
        if len(own):
            self.retained.append(own)
        return len(own)

    def build(self) -> SurfaceSet:
        """Make the tables of the ray step from what is retained; returns it as one batch a kind.

        In the order of ids, for that of arrival differs from run to run, and with it leaves, tests and machine time.
        """
        assert self.cell is not None
        held = SurfaceSet(tuple(batch.select(np.argsort(batch.ids)) for batch in merge(self.retained)))
        self.retained = list(held)
        self.surfaces = build_surfaces(held, self.cell)
        return held

    def forget_frame(self) -> None:
        """Drop the frame with all its packets; the surfaces stay."""
        self.frame = self.limits = self.pixels = None
        self.quota, self.collecting, self.samples_left = 0, -1, False
        self.outputs.held[:] = 0
        self.backlog.clear()

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
        self.backlog.set_limits(self.limits)
        self.pixels = make_pixels(frame, self.space, self.cell)
        self.cursor = new_cursor(len(self.pixels.first) > 0)
        self.samples_left = len(self.pixels.first) > 0
        self.counts[:] = 0
        room = max(ROOM, 2 * (frame.n_lights + 2))
        if self.outputs.data.shape[1] != HEAD + room * SIZE:
            self.outputs = make_outputs(room, DEPTH)

    # --- work --------------------------------------------------------------------------------------

    @property
    def has_work(self) -> bool:
        """Whether `work` would do anything."""
        return self.backlog.held > 0 or (self.quota > 0 and self.samples_left) or self.collecting >= 0

    def work(self) -> None:
        """One turn over the most urgent packets, in which primaries are born if few rays wait."""
        if self.frame is None:
            return
        backlog = self.backlog
        if backlog.held or (self.quota > 0 and self.samples_left):
            if self._crowded:
                births = PORTION * max(self.frame.n_lights, 2)
                backlog.make_room(0, births, max(births, ADMIT_AT_ONCE))
            self.quota, why = turn(
                self.cell,
                self.space,
                self.frame,
                self.surfaces,
                self.pixels,
                self.cursor,
                self.quota,
                (TURN, ADMIT_BELOW, ADMIT_AT_ONCE),
                backlog.stacks,
                backlog.count,
                self.outputs,
                self.counts,
            )
            self._crowded = why == CROWDED
            self.samples_left = self.samples_left and int(self.cursor[DONE]) == 0
        elif self.collecting >= 0:
            self._send_pixels()

    def _send_pixels(self) -> None:
        """Fill the output towards the nearest corner with pixel packets."""
        assert self.frame is not None and self.cell is not None
        output = corner_output(self.index, self.shape)
        held = int(self.outputs.held[output])
        room = (self.outputs.data.shape[1] - HEAD) // SIZE - held
        made, cursor = send_pixels(
            self.pixels,
            self.frame.width,
            np.int64(self.collecting),
            self.outputs.data[output],
            HEAD + held * SIZE,
            min(room, CHUNK),
            self.counts,
        )
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
        pixels = 0 if self.pixels is None else self.pixels.sums.nbytes + self.pixels.samples.nbytes
        return {
            "surfaces": surfaces + described,
            "pixels": pixels,
            "backlog": self.backlog.size,
            "outputs": self.outputs.data.nbytes,
        }

    @property
    def primaries_born(self) -> int:
        """How many samples this home has admitted."""
        return int(self.counts[BORN + 1])


def corner_output(index: tuple[int, int, int], shape: tuple[int, int, int]) -> int:
    """The output on the way to the nearest corner (lower one on a tie), HOST at the corner."""
    for axis in range(3):
        near_low = 2 * index[axis] <= shape[axis] - 1
        if near_low and index[axis] > 0:
            return 2 * axis
        if not near_low and index[axis] < shape[axis] - 1:
            return 2 * axis + 1
    return HOST


assert OUTPUTS == SELF_RAYS + 1
