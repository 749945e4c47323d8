"""Render in spite of faults: notice, name, reset, load again, and repeat; the picture has the same bits."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from raygrid.emulator.driver import BUDGET, Progress
from raygrid.emulator.processes import Array
from raygrid.host.image.picture import Picture
from raygrid.host.render.frame import Watch, render_job
from raygrid.host.render.job import Job
from raygrid.node.errors import ArrayError, Garbled, LostProcess, ProtocolError, RaygridError, Stuck

ATTEMPTS = 4
MOST_LOST = 8  # nodes that are named in a fault besides
RECOVERABLE = (LostProcess, Stuck, Garbled, ProtocolError)


@dataclass(frozen=True)
class FaultReport:
    """Something that went wrong in an array and was made good.

    kind     name of the error's class: LostProcess, Stuck, Garbled, ProtocolError
    what     the error in words, and which nodes ended besides until the reset after it
    phase    load, trace or collect: what the array was doing; "" if it had not begun
    seconds  wall time from the beginning of the attempt to the error, and then until the array was ready again
    restarts nodes that were forked anew
    epoch    the epoch that began after it
    """

    kind: str
    what: str
    phase: str
    seconds: tuple[float, float]
    restarts: int
    epoch: int


def render_with_retries(
    array: Array,
    job: Job,
    budget: int = BUDGET,
    watch: Watch | None = None,
    loaded: bool = False,
    attempts: int = ATTEMPTS,
    on_fault: Callable[[FaultReport], None] | None = None,
    prices: dict[str, Any] | None = None,
) -> Picture:
    """Render one frame as `render_job` does, on an array that may lose nodes and messages meanwhile.

    After a fault the array is reset, the scene loaded anew, and the pass repeated, at most `attempts` times in all. The
    picture has the same bits as without faults; stats["faults"] is a map for each fault (see `FaultReport`).

    attempts  1 or more
    on_fault  told of each fault when the array is ready again
    prices    of machine time, as of `render_job`
    Raises what went wrong last if no attempt succeeds, or the array cannot be reset: ArrayError and its kinds, ProtocolError.
    """
    if attempts < 1:
        raise ValueError(f"{attempts} attempts came, wanted 1 or more")
    faults: list[FaultReport] = []
    while True:
        begun = time.perf_counter()
        phase = ""

        def seen(now: str, progress: Progress | None) -> None:
            nonlocal phase
            phase = now
            if watch is not None:
                watch(now, progress)

        try:
            picture = render_job(array.driver, job, budget, seen, loaded and not faults, prices)
        except RECOVERABLE as error:
            if len(faults) + 1 >= attempts:
                raise _given_up(error, faults) from error
            faults.append(_reset(array, error, phase, begun))
            if on_fault is not None:
                on_fault(faults[-1])
            continue
        picture.stats["faults"] = [asdict(fault) for fault in faults]
        picture.stats["injected"] = array.injected
        return picture


def _reset(array: Array, error: RaygridError, phase: str, begun: float) -> FaultReport:
    noticed, restarts = time.perf_counter(), array.restarts
    array.reset()
    seconds = (round(noticed - begun, 6), round(time.perf_counter() - noticed, 6))
    others = [lost for lost in array.lost_nodes if lost != str(error)][:MOST_LOST]
    what = f"{error}; besides, {'; '.join(others)}" if others else str(error)
    return FaultReport(type(error).__name__, what, phase, seconds, array.restarts - restarts, array.epoch)


def _given_up(error: RaygridError, faults: list[FaultReport]) -> RaygridError:
    """The last error, with how often it was tried, in one sentence of the same kind."""
    if not faults:
        return error
    kinds = {fault.kind for fault in faults}
    before = f"{len(faults)} times before" if len(faults) > 1 else "once before"
    same = "in the same way" if kinds == {type(error).__name__} else f"by {', '.join(sorted(kinds))}"
    kind = type(error) if isinstance(error, ArrayError | ProtocolError) else ArrayError
    return kind(f"{error}; the array was reset and the frame repeated, it had failed {before} {same}")
