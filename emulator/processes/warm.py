"""Makes every kernel ready before the first node needs it: loaded from the cache on disk, or compiled once.

A tiny in-memory array renders a tiny scene that has every kind of surface, light and ray, so every kernel is
called with exactly the argument types that nodes use. Each function that has to be compiled is reported, so that
the minute of a first run can be seen to go on.

There are kernels of several kinds (`kernel_kinds`), of which most runs need only the first: who simulates never needs those that
keep time in real nodes, and nearly nobody needs all. So each kind is compiled when it is first used, and named then.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

import numpy as np

from raygrid.emulator.driver.collector import Collected
from raygrid.emulator.driver.memory_array import MemoryArray
from raygrid.emulator.partition.cost_grid import is_cached
from raygrid.emulator.partition.split import split
from raygrid.emulator.processes.kernel_kinds import NODES, NOTE, TIMED_NODES, compiling
from raygrid.node import remarks
from raygrid.node.errors import ArrayError
from raygrid.node.geometry import (
    LATTICE,
    MOTION_SHIFT,
    STORED_AS,
    Batch,
    Kind,
    Moves,
    SurfaceSet,
    World,
    at_rest,
    make_groups,
    make_space,
)
from raygrid.node.jit import cache, compiling_heard_by
from raygrid.node.links import find_functions
from raygrid.node.protocol import (
    COUNTS,
    HEAD,
    LIGHT_COLUMNS,
    MATERIAL_COLUMNS,
    MAX_PIXEL_SAMPLES,
    Frame,
    Prices,
    prices_order,
)
from raygrid.node.runtime import profile
from raygrid.node.tracing import add_missed

Report = Callable[[int, int, str], None]


# functions of each kind that are compiled in a first run (counted); one more or less moves only the progress bar
KERNELS, TIMED_KERNELS = 338, 24


class Compilations:
    """Reports every function that was compiled and not found in the cache.

    done  how many
    """

    def __init__(self, report: Report, kind: str, expected: int) -> None:
        self._report, self._kind, self._expected = report, kind, expected
        self.done = 0

    def ends(self, function: Callable[..., object]) -> None:
        """One more."""
        self.done += 1
        name = function.__name__.strip("_") if function.__module__.startswith("raygrid.") else "parts of numba"
        self._report(self.done, max(self._expected, self.done + 1), compiling(name, self._kind))


@contextlib.contextmanager
def told_of(report: Report, kind: str, expected: int) -> Iterator[Compilations]:
    """Within, what is compiled is reported, and so are remarks on kernels."""
    compilations = Compilations(report, kind, expected)

    def note(text: str) -> None:
        report(compilations.done, expected, NOTE + text)

    with compiling_heard_by(ends=compilations.ends), remarks.heard_by(note):
        yield compilations


@contextlib.contextmanager
def _helped() -> Iterator[None]:
    """Whatever fails within is told with the place of compiled kernels, and what helps if they are why."""
    try:
        yield
    except Exception as error:
        told = f"{type(error).__name__}: {' '.join(str(error).split())[:300]}"
        helps = f"; if {cache.DIRECTORY} is removed, they are compiled anew" if cache.DIRECTORY else ""
        raise ArrayError(f"the kernels cannot be made ready ({told}){helps}") from error


def warm(report: Report) -> None:
    """Call every kernel once. `report(done, total, what)` is called at the start, after each function that was
    compiled ("compiling ... for ..."), for each remark (NOTE), and at the end; of what is in the cache it hears nothing.

    Raises ArrayError.
    """
    report(0, KERNELS, "loading kernels")
    with _helped(), told_of(report, NODES, KERNELS) as compilations:
        find_functions()
        array = MemoryArray((2, 1, 1))
        half = LATTICE // 2
        space = make_space((2.0**-24, 2.0**-24, 2.0**-24), [[0, half, LATTICE], [0, LATTICE], [0, LATTICE]])
        frame = tiny_frame()
        array.driver.ready()
        moves = Moves(make_groups(np.zeros(1, np.int64), np.zeros(1, np.int64), 1), at_rest(1))
        array.driver.load(space, _one_of_each(), moves)
        moved = moves.motions.copy()
        moved[0, MOTION_SHIFT] = 1e-3
        array.driver.move(moves._replace(motions=moved))
        array.driver.trace(frame)
        sums, _ = array.driver.collect(frame.width * frame.height)
        add_missed(frame, space.step, sums)
        if compilations.done or not is_cached():  # nodes do not need these, so they are not loaded for them
            split(
                "balanced",
                (2, 1, 1),
                World(np.zeros(3), 1.0, space.step),
                _one_of_each(),
                frame._replace(samples=1 << 18),
            )
            Collected(0, MAX_PIXEL_SAMPLES).take(bytes(HEAD), 0)
            profile.warm(array.processors[0].node_state)
    report(KERNELS, KERNELS, "ready")


def warm_timed(report: Report) -> None:
    """The same, and the kernels of nodes that keep machine time."""
    warm(report)
    with _helped(), told_of(report, TIMED_NODES, TIMED_KERNELS):
        array = MemoryArray((2, 1, 1), timed=True)
        half = LATTICE // 2
        space = make_space((2.0**-24, 2.0**-24, 2.0**-24), [[0, half, LATTICE], [0, LATTICE], [0, LATTICE]])
        prices = Prices(np.ones(COUNTS, np.int64), 1, 1, 1, 0)
        array.driver.ready()
        array.driver.load(space, _one_of_each())
        array.driver.trace(tiny_frame(), prices=prices_order(prices, np.zeros(len(Kind), np.int64)))
    report(KERNELS, KERNELS, "ready")


def _one_of_each() -> SurfaceSet:
    """One surface of each kind, across the border between the two cells."""
    flat = [[-0.3, -0.3, 0.0], [0.3, -0.3, 0.01], [0.0, 0.3, 0.02]]
    rows = {
        Kind.TRIANGLE: np.array(flat).reshape(1, 9),
        Kind.SMOOTH: np.concatenate((np.array(flat).ravel() + 0.02, np.tile([0.0, 0.0, 1.0], 3))).reshape(1, 18),
        Kind.POLYGON: np.concatenate((flat, [[-0.3, 0.3, 0.01]])) + 0.05,
        Kind.SPHERE: np.array([[0.0, 0.0, -0.2, 0.1]]),
        Kind.CYLINDER: np.array([[-0.2, 0.0, 0.2, 0.05, 0.2, 0.0, 0.2, 0.05]]),
        Kind.CONE: np.array([[-0.2, 0.2, 0.2, 0.1, 0.2, 0.2, 0.2, 0.02]]),
    }
    batches = []
    for number, (kind, data) in enumerate(rows.items()):
        starts = np.array([0, 4]) if kind == Kind.POLYGON else np.zeros(0, np.int64)
        ids, materials = np.array([number], np.uint32), np.zeros(1, np.uint16)
        batches.append(Batch(kind, ids, materials, data.astype(STORED_AS[kind]), starts))
    return SurfaceSet(tuple(batches))


def tiny_frame() -> Frame:
    """A small frame with lights of both kinds."""
    rows = ((0.0, 0.0, 2.0), (0.0,) * 3, (0.0,) * 3, (-0.2, 0.2, -1.0), (0.05, 0.0, 0.0), (0.0, -0.05, 0.0))
    camera = np.array(rows)
    materials, lights = np.full((1, MATERIAL_COLUMNS), 0.5), np.zeros((2, LIGHT_COLUMNS))
    lights[0, :7], lights[1, :7] = (0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0), (1.0, 0.3, 0.3, 0.6, 1.0, 1.0, 1.0)
    return Frame(camera, materials, lights, 2, (0.1, 0.1, 0.1), 8, 8, 1, 3, 0.0, False)
