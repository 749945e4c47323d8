"""Renders frames on one array: loads or moves what it lacks, traces, and repeats after faults with the same bits.

The one way by which the command line, the Python interface and the service have a frame rendered. What an array holds is
known to its driver alone (`Driver.held`), which a reset replaces by one that holds nothing.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from raygrid.emulator.driver import BUDGET, Progress
from raygrid.emulator.processes import Array
from raygrid.host.image.picture import Picture
from raygrid.host.render.frame import Watch, needs_increment, render_job
from raygrid.host.render.layer_frames import with_layers
from raygrid.host.render.machine_job import Job
from raygrid.host.render.retry import ATTEMPTS, RECOVERABLE, FaultReport, given_up, reset_after


class RenderSession:
    """Renders frames on an array that may lose nodes and messages meanwhile.

    attempts    how often to try a frame in all, 1 or more
    on_fault    told of each fault when the array is ready again
    floods      how often a scene was loaded
    increments  how often the nodes were told only what has moved since the frame before
    """

    def __init__(
        self, array: Array, attempts: int = ATTEMPTS, on_fault: Callable[[FaultReport], None] | None = None
    ) -> None:
        self.array, self.floods, self.increments = array, 0, 0
        self._attempts, self._on_fault = attempts, on_fault

    def render(
        self, job: Job, budget: int = BUDGET, watch: Watch | None = None, prices: dict[str, Any] | None = None
    ) -> Picture:
        """Render one frame as `render_job` does, whose arguments these are, and then its layers, if it is to have some.

        After a fault the array is reset, the scene loaded anew, and the pass repeated. The picture has the same bits as
        without faults; stats["faults"] is a map for each fault (see `FaultReport`).

        Raises what went wrong last if no attempt succeeds, or the array cannot be reset: ArrayError and its kinds,
        ProtocolError; ValueError for attempts that are none.
        """
        if self._attempts < 1:
            raise ValueError(f"{self._attempts} attempts came, wanted 1 or more")
        faults: list[FaultReport] = []
        while True:
            begun, phase = time.perf_counter(), ""

            def seen(now: str, progress: Progress | None) -> None:
                nonlocal phase
                phase = now
                if now == "load":
                    self._count_load(job)
                if watch is not None:
                    watch(now, progress)

            try:
                picture = render_job(self.array.driver, job, budget, seen, prices)
                picture = with_layers(self.array.driver, job, picture, budget, seen, prices)
            except RECOVERABLE as error:
                if len(faults) + 1 >= self._attempts:
                    raise given_up(error, faults) from error
                faults.append(reset_after(self.array, error, phase, begun))
                if self._on_fault is not None:
                    self._on_fault(faults[-1])
                continue
            picture.stats["faults"] = [fault._asdict() for fault in faults]
            picture.stats["injected"] = self.array.injected
            return picture

    def _count_load(self, job: Job) -> None:
        if needs_increment(self.array.driver, job):
            self.increments += 1
        else:
            self.floods += 1
