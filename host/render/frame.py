"""Render a scene on an array: load, trace, collect, and say what happened."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raygrid.emulator.driver import BUDGET, Collected, Driver, Progress, Samples, is_held
from raygrid.emulator.topology import read_memory
from raygrid.host.image.picture import Picture
from raygrid.host.render.machine_job import Job, rays_enter
from raygrid.host.render.stats import make_stats
from raygrid.node.errors import ArrayError, Garbled, TooLarge
from raygrid.node.geometry import LONGEST_STEP
from raygrid.node.tracing import MAX_INTENSITY, UNIT

MOST_BUDGET = (1 << 32) - 1  # a quota of primary rays travels as a u32
LAYER_BYTES = (
    90  # of one pixel while layers are traced: the picture, and layers that are found (86 measured, 3000x2000)
)
PIXEL_BYTES = 96  # of one pixel in its home, in the sums collected, and while its picture is made
Watch = Callable[[str, Progress | None], None]


def render_job(
    driver: Driver,
    job: Job,
    budget: int = BUDGET,
    watch: Watch | None = None,
    prices: dict[str, Any] | None = None,
) -> Picture:
    """Render one frame. `watch(phase, progress)` is told of each phase, and of progress while tracing.

    Nothing is loaded that the array holds already (`holds`). `prices`: of machine time, for an array that keeps it
    (`raygrid.node.protocol.timestamps.prices_order`). Raises ArrayError and its kinds.
    """
    if not 1 <= budget <= MOST_BUDGET:
        raise ArrayError(f"a budget came as {budget}, wanted 1 to {MOST_BUDGET} packets in flight")
    _check_memory(job)
    seconds: dict[str, float] = {}
    progress: Progress | None = None

    def timed(phase: str, work: Callable[[], Any]) -> Any:
        if watch is not None:
            watch(phase, None)
        begun = time.perf_counter()
        result = work()
        seconds[phase] = time.perf_counter() - begun
        return result

    collected = Collected(job.pixels, job.frame.samples)

    def tell(now: Progress) -> None:
        if now.primaries > 0:  # the nodes are at work until the next wave
            collected.touch()
        if watch is not None:
            watch("trace", now)

    if not holds(driver, job):
        timed("load", lambda: _bring(driver, job))
    progress = timed("trace", lambda: driver.trace(job.frame, budget, tell, prices))
    sums, samples = timed("collect", lambda: driver.collect(job.pixels, collected))
    add_misses(job, sums, samples)
    frame = job.frame
    stats = make_stats(job, driver, progress, seconds)
    return Picture(sums.reshape(frame.height, frame.width, 3), frame.samples, stats)


def _bring(driver: Driver, job: Job) -> None:
    """Let the nodes run the job's program and hold its surfaces: by an increment if they hold another frame of it."""
    by_increment = needs_increment(driver, job)
    if job.settings.program != driver.program:
        driver.load_program(job.settings.program)
    if by_increment and job.moves is not None:
        driver.move(job.moves, job.load_key)
    else:
        driver.load(job.space, job.surfaces, job.moves, job.load_key)


def holds(driver: Driver, job: Job) -> bool:
    """Whether the nodes hold just this job's surfaces, where it has them, and run its program: by its key."""
    return bool(job.load_key) and driver.held is not None and driver.held.key == job.load_key


def needs_increment(driver: Driver, job: Job) -> bool:
    """Whether the nodes hold another frame of the job's shot, and need be told only what has moved."""
    same_program = driver.program == job.settings.program  # another one has surfaces loaded anew
    return same_program and is_held(driver.held, job.space, job.surfaces, job.moves)


def _check_memory(job: Job) -> None:
    """Raise TooLarge for a picture that this computer has no room for, before the kernel ends a process for it."""
    a_pixel = PIXEL_BYTES + (LAYER_BYTES if job.settings.layers else 0)
    need, there = job.pixels * a_pixel, read_memory()
    if need > there.left:
        raise TooLarge(
            f"a picture of {job.frame.width}x{job.frame.height} pixels needs {need / 1e9:.1f} GB of memory, "
            f"and {there.limit} leaves {max(there.left, 0) / 1e9:.1f} GB"
        )


CHECKED = 65_536  # pixels without samples that are looked at again
SURELY_INSIDE = 64 * LONGEST_STEP  # so far inside the world box no rounding turns a hit into a miss
BLOCK = 1 << 16  # pixels that are worked on at a time: what is made for them stays in the cache


def _blocks(pixels: int) -> Iterator[slice]:
    return (slice(first, first + BLOCK) for first in range(0, pixels, BLOCK))


def _some_lacking(samples: Samples, most: int) -> NDArray[np.int64]:
    """Up to CHECKED of the pixels that have not all of their samples, spread evenly over these."""
    counts = [int(np.count_nonzero(samples[block] != most)) for block in _blocks(len(samples))]
    stride = sum(counts) // CHECKED + 1
    chosen, before = [np.zeros(0, np.int64)], 0
    for block, count in zip(_blocks(len(samples)), counts, strict=True):
        if count:
            chosen.append(np.flatnonzero(samples[block] != most)[-before % stride :: stride] + block.start)
        before += count
    return np.concatenate(chosen)


def _check_missing(job: Job, samples: Samples) -> None:
    """A pixel may lack samples only if rays through it miss the world box. Raises ArrayError.

    Conservation cannot see a sample that no home has borne, so some of these pixels are worked out again. The
    outline of a box is convex: if the rays through a pixel's corners enter, so do all through the pixel.
    """
    lacking = _some_lacking(samples, job.frame.samples)
    i, j = (lacking % job.frame.width).astype(np.float64), (lacking // job.frame.width).astype(np.float64)
    enters = np.ones(len(lacking), np.bool_)
    corners = ((-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)) if job.frame.samples > 1 else ((0.0, 0.0),)
    for di, dj in corners:
        enters &= rays_enter(job, i + di, j + dj, SURELY_INSIDE)
    if enters.any():
        pixel = int(lacking[np.argmax(enters)])
        raise Garbled(f"pixel {pixel} came without all its samples, though its rays enter the world box")


def check_samples(job: Job, samples: Samples) -> None:
    """Raise ArrayError if a pixel has more samples than it should, or fewer though its rays enter the world box."""
    if int(samples.max()) > job.frame.samples:
        raise Garbled(f"pixel {int(np.argmax(samples))} came with more samples than the {job.frame.samples} it has")
    _check_missing(job, samples)


def add_misses(job: Job, sums: NDArray[np.int64], samples: Samples) -> None:
    """Add what the samples see whose rays never enter the world box; no home counts them."""
    frame = job.frame
    check_samples(job, samples)
    program = job.settings.program
    if program is not None and "background" in program.hooks:
        if job.add_missed is not None:
            job.add_missed(job, sums)
            return
        from raygrid.host.render.program_file import for_host

        for_host(program).add_missed(frame, job.space.step, sums)
        return
    if frame.discs:
        from raygrid.node.tracing import add_missed

        add_missed(frame, job.space.step, sums)
        return
    background = np.minimum(np.array(frame.background, np.float32).astype(np.float64), MAX_INTENSITY)
    units = np.floor(background * UNIT + 0.5).astype(np.int64)
    if not units.any():
        return
    for block in _blocks(len(samples)):
        missing = frame.samples - samples[block].astype(np.int64)
        if missing.any():
            for colour in range(3):  # a column at a time: rows of three are slow
                sums[block, colour] += missing * units[colour]
