"""Simulates a frame of a scene on an array, in machine time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raygrid.emulator.processes import compile_clock
from raygrid.emulator.simulator import Flooded, Model, Phase, flood, make_model, ordered, read_out, trace
from raygrid.host.machine_time.cost_models import LEVELS, CostModel
from raygrid.host.render.frame import add_misses
from raygrid.host.render.job import Job

Watch = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Simulated:
    """A simulated frame.

    model     which node holds what, and whose samples start there
    search    list or tree
    frames    of each level that was asked for, "middle" among them: what happened while tracing; only that of "middle"
              has the nodes' books, since those of an array take half a kilobyte a node
    floods, read_outs   of the same levels: setting the scene up, and collecting the pixels
    sums      int64 (height, width, 3), the picture
    seconds   wall seconds of this computer, by phase
    """

    job: Job
    cost: CostModel
    search: str
    model: Model
    frames: dict[str, Phase]
    floods: dict[str, Flooded]
    read_outs: dict[str, Phase]
    sums: NDArray[np.int64]
    seconds: dict[str, float]

    @property
    def ticks(self) -> int:
        """Machine time of the frame: when the last service ended."""
        return self.frames["middle"].ticks


def simulate_job(
    job: Job,
    cost: CostModel,
    search: str | None = None,
    band: bool = True,
    around: bool = True,
    tell: Watch | None = None,
) -> Simulated:
    """Simulate one frame.

    search  list or tree; None: as the cost model says
    band    the low and the high costs, too
    around  set-up and read-out, too

    `tell(phase, events, packets that died)` is called about once a second. Raises TooLarge, ArrayError.
    """
    chosen = cost.file.search if search is None else search
    begun = compile_clock.now()
    model = make_model(job.space, job.surfaces, job.frame, chosen, 2 if band or around else 1)
    seconds = {"prepare": compile_clock.now() - begun, "trace": 0.0, "around": 0.0}
    frames: dict[str, Phase] = {}
    floods: dict[str, Flooded] = {}
    read_outs: dict[str, Phase] = {}
    surfaces, sums = ordered(job.surfaces), np.zeros((0, 3), np.int64)
    for level in LEVELS if band else ("middle",):
        prices = cost.prices(level, chosen)
        ticks = cost.list_ticks(level, chosen, model.holding.held)
        traced, pixels = trace(model, prices, ticks, tell)
        seconds["trace"] += traced.seconds
        frames[level] = traced if level == "middle" else traced.without_clocks()
        del traced
        if level == "middle":
            sums = pixels.sums.copy()
            add_misses(job, sums, pixels.samples)
        if around:
            since = compile_clock.now()
            description = cost.file.ticks.description[LEVELS.index(level)]
            floods[level] = flood(job.space, surfaces, prices, description)._replace(busy=np.zeros(0, np.int64))
            read_outs[level] = read_out(model, prices, pixels, tell).without_clocks()
            seconds["around"] += compile_clock.now() - since
    seconds["whole"] = compile_clock.now() - begun
    picture = sums.reshape(job.frame.height, job.frame.width, 3)
    return Simulated(job, cost, chosen, model, frames, floods, read_outs, picture, seconds)
