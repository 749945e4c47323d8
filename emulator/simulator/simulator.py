"""Simulates a whole array, up to 125,000 processors and more, in one process and in machine time.

The same ray step, the same queues and the same order as in the processes (`node.timed.service_clock`), so the picture has the same
bits and the ticks are the same. What the nodes of an array share here, they share to save memory only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from raygrid.emulator.processes import compile_clock
from raygrid.emulator.simulator import event_loop
from raygrid.emulator.simulator.sample_order import order_of_pixels, order_of_samples
from raygrid.emulator.simulator.shared_tables import one_hierarchy, ordered, shared_geometry, trees
from raygrid.emulator.topology.limits import check_simulated_fits, read_memory
from raygrid.node.errors import ArrayError, TooLarge
from raygrid.node.geometry import DEPTH, Space, Surfaces, SurfaceSet
from raygrid.node.protocol import BORN, COUNTS, DIED, KINDS, SIZE, Frame, Prices
from raygrid.node.timed import CLOCK_RECORD, RECORD_BYTES, ServiceClock, grown, make_service_clock
from raygrid.node.tracing import Pixels, make_outputs

Long = NDArray[np.int64]
TURN_EVENTS = 1 << 20  # between two looks at signals and progress
FIRST_ROOM = 1 << 16  # packets; doubled whenever they do not suffice
CLOCK_BYTES = CLOCK_RECORD.itemsize  # of a node in a phase that runs, or is kept
NODE_BYTES = 128  # of a node that holds nothing, beside its clock: who emits and holds what, the flood (measured: 96)
SAMPLE_BYTES = 16  # of a sample while the order of primaries is worked out
PIXEL_BYTES = 160  # of a pixel: sums of the phase and of the picture, and the order of the read-out (measured: 143)

Tell = Callable[[str, int, int], None]
"""Told the phase, events so far and packets that died so far."""


@dataclass(frozen=True)
class Phase:
    """What happened in one phase, which begins at tick 0 with empty queues.

    ticks      when the last service ended
    nodes      node.timed.CLOCK_RECORD (n,), the clock of every node, with what it counted
    total      int64 (COUNTS,), counts of all steps
    hops       int64 (KINDS, HOPS): packets that died after so many hops
    levels     int64 (3, BINS): packets that wait, nodes that serve, packets on links, at the begin of each bin
    bin_ticks  length of a bin
    host       tick at which the last packet reached the host, 0 if none did
    """

    ticks: int
    nodes: NDArray[np.void]
    total: Long
    hops: Long
    levels: Long
    bin_ticks: int
    host: int
    events: int
    most_packets: int
    seconds: float

    @property
    def trace(self) -> str:
        """A digest of every service of every node: its packet, port, begin and end. Equal for equal runs."""
        return digest_of(self.nodes["trace"])

    def column(self, field: str) -> Long:
        """A field of the clocks of all nodes, int64 (n,)."""
        return self.nodes[field]

    def without_clocks(self) -> Phase:
        """The same, but that what each node did is forgotten, which is nearly all that a phase takes."""
        return replace(self, nodes=np.zeros(0, CLOCK_RECORD))


def digest_of(traces: Long) -> str:
    """The digests of all nodes, in order, as 16 hexadecimal digits."""
    import hashlib

    return hashlib.sha256(np.ascontiguousarray(traces, "<i8").tobytes()).hexdigest()[:16]


@dataclass(frozen=True)
class Holding:
    """What the nodes of an array hold, ready for frames of any size.

    held     int64 (n, 6): surfaces of each kind that each node holds
    surfaces, roots   tables, and rows of the hierarchy of each node
    """

    space: Space
    held: Long
    surfaces: Surfaces
    roots: Long
    search: str

    @property
    def cells(self) -> int:
        """How many processors the array has."""
        return len(self.held)

    def model(self, frame: Frame) -> Model:
        """A frame on this array, to be simulated."""
        return Model(self, frame, *order_of_samples(frame, self.space))


@dataclass
class Model:
    """A frame on an array, ready to be simulated with any prices.

    samples, borders  who emits what, in order
    """

    holding: Holding
    frame: Frame
    samples: NDArray[np.uint32]
    borders: Long
    seconds: dict[str, float] = field(default_factory=dict)


def hold(space: Space, surfaces: SurfaceSet, search: str) -> Holding:
    """Work out what each node holds; with `tree` each has the hierarchy that it would build itself.

    Raises ArrayError for a search that is none.
    """
    if search not in ("list", "tree"):
        raise ArrayError(f"a search came as {search!r}, wanted list or tree")
    sorted_surfaces = ordered(surfaces)
    shared = shared_geometry(sorted_surfaces, space)
    tables, roots = (trees if search == "tree" else one_hierarchy)(sorted_surfaces, space, shared)
    return Holding(space, shared.held, tables, roots, search)


def make_model(space: Space, surfaces: SurfaceSet, frame: Frame, search: str, kept_phases: int = 1) -> Model:
    """Work out who holds and who emits what. Raises TooLarge if this computer has no room for it, and ArrayError.

    kept_phases   most phases at a time of which the nodes' clocks are kept, the one that runs included
    """
    check_room(space.shape, frame, kept_phases)
    begun = compile_clock.now()
    holding = hold(space, surfaces, search)
    held = compile_clock.now()
    model = holding.model(frame)
    model.seconds.update(hold=held - begun, order=compile_clock.now() - held)
    return model


def check_room(shape: tuple[int, int, int], frame: Frame, kept_phases: int) -> None:
    """Raise TooLarge for an array or a picture that this computer has no memory for; kept_phases: as of `make_model`."""
    pixels = frame.width * frame.height
    samples = pixels * frame.samples
    check_simulated_fits(
        shape,
        samples,
        bytes_per_node=NODE_BYTES + kept_phases * CLOCK_BYTES,
        fixed_bytes=bytes_of_a_picture(pixels, samples),
    )


def bytes_of_a_picture(pixels: int, samples: int) -> int:
    """Count what simulating a picture takes, whatever the number of nodes: its sums, who emits what, packets in flight."""
    return samples * SAMPLE_BYTES + pixels * PIXEL_BYTES + 2 * FIRST_ROOM * RECORD_BYTES


def whole_picture(frame: Frame) -> Pixels:
    """One pixel store for all homes."""
    pixels = frame.width * frame.height
    return Pixels(
        0,
        np.zeros(frame.height, np.int64),
        np.arange(frame.height + 1, dtype=np.int64) * frame.width,
        np.zeros((pixels, 3), np.int64),
        np.zeros(pixels, np.int64),
    )


def trace(model: Model, prices: Prices, list_ticks: Long, tell: Tell | None = None) -> tuple[Phase, Pixels]:
    """Trace the frame. `list_ticks` int64 (n,): what each walk costs in each node beside its price."""
    pixels = whole_picture(model.frame)
    primaries = event_loop.PrimaryOrder(model.samples, False)
    phase = _run(model, prices, list_ticks, primaries, model.borders, pixels, tell, "trace")
    born, died = phase.total[BORN : BORN + KINDS], phase.total[DIED : DIED + KINDS]
    if not np.array_equal(born, died):
        raise ArrayError(f"of {int(born.sum())} packets {int(died.sum())} died: the simulator has lost some")
    return phase, pixels


def read_out(model: Model, prices: Prices, pixels: Pixels, tell: Tell | None = None) -> Phase:
    """Send all pixels from their homes to the host, as after a frame."""
    numbers, borders = order_of_pixels(model.frame, model.samples, model.borders)
    primaries = event_loop.PrimaryOrder(numbers, True)
    return _run(model, prices, np.zeros(model.holding.cells, np.int64), primaries, borders, pixels, tell, "read-out")


def _run(
    model: Model,
    prices: Prices,
    list_ticks: Long,
    primaries: event_loop.PrimaryOrder,
    borders: Long,
    pixels: Pixels,
    tell: Tell | None,
    what: str,
) -> Phase:
    """Run one phase to its end."""
    begun = compile_clock.now()
    timed = make_service_clock(model.holding.cells, FIRST_ROOM)
    timed.nodes["list_ticks"] = list_ticks
    timed.nodes["next_primary"], timed.nodes["last_primary"] = borders[:-1], borders[1:]
    shift = prices.lookahead.bit_length() - 1
    wheel = event_loop.Wheel(np.full(event_loop.STRETCHES, -1, np.int64), shift, np.zeros(1, event_loop.LOOP_STATE))
    hops, bins = np.zeros((KINDS, event_loop.HOPS), np.int64), np.zeros((3, event_loop.BINS), np.int64)
    watch = event_loop.Watch(np.zeros(COUNTS, np.int64), hops, bins)
    outputs = make_outputs(2 * (model.frame.n_lights + 4), DEPTH)
    counts, scratch = np.zeros(COUNTS, np.int64), np.zeros(SIZE, np.uint8)
    event_loop.enter_all(timed, wheel)
    held = model.holding
    simulation = event_loop.Simulation(
        timed, wheel, watch, held.space, model.frame, held.surfaces, held.roots, pixels, primaries, scratch, outputs,
        counts, prices,
    )  # fmt: skip
    state = wheel.state[0]  # a view, so it stays up to date
    while True:
        why = event_loop.run(simulation, TURN_EVENTS)
        if why == event_loop.DONE:
            break
        if why == event_loop.NO_ROOM:
            simulation = simulation._replace(timed=_with_more_room(simulation.timed))
        if tell is not None:
            tell(what, int(state["events"]), int(watch.total[DIED : DIED + KINDS].sum()))
    timed = simulation.timed
    return Phase(
        int(timed.nodes["ended"].max()),
        timed.nodes,
        watch.total,
        watch.hops,
        np.cumsum(watch.bins, axis=1),
        1 << int(state["bin_shift"]),
        int(state["host_tick"]),
        int(state["events"]),
        len(timed.words) * 8 // RECORD_BYTES,
        compile_clock.now() - begun,
    )


def _with_more_room(timed: ServiceClock) -> ServiceClock:
    room = 2 * (len(timed.words) * 8 // RECORD_BYTES)
    there = read_memory()
    if room * RECORD_BYTES > there.left:
        raise TooLarge(
            f"{room // 2:,} packets are in flight, and room for {room:,} needs {room * RECORD_BYTES / 1e9:.1f} GB: "
            f"{there.limit} leaves {max(there.left, 0) / 1e9:.1f} GB"
        )
    return grown(timed, room)
