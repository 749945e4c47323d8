"""Resets an array after a fault that can be made good, and says what happened."""

from __future__ import annotations

import time
from typing import NamedTuple

from raygrid.emulator.processes import Array
from raygrid.node.errors import ArrayError, Garbled, LostProcess, ProtocolError, RaygridError, Stuck

ATTEMPTS = 4
MOST_LOST = 8  # nodes that are named in a fault besides
RECOVERABLE = (LostProcess, Stuck, Garbled, ProtocolError)


class FaultReport(NamedTuple):
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


def reset_after(array: Array, error: RaygridError, phase: str, begun: float) -> FaultReport:
    """Reset the array after an error of an attempt that began at `begun` (`time.perf_counter`) and was in `phase`.

    Raises ArrayError and its kinds, or ProtocolError, if it cannot be reset.
    """
    noticed, restarts = time.perf_counter(), array.restarts
    array.reset()
    seconds = (round(noticed - begun, 6), round(time.perf_counter() - noticed, 6))
    others = [lost for lost in array.lost_nodes if lost != str(error)][:MOST_LOST]
    what = f"{error}; besides, {'; '.join(others)}" if others else str(error)
    return FaultReport(type(error).__name__, what, phase, seconds, array.restarts - restarts, array.epoch)


def given_up(error: RaygridError, faults: list[FaultReport]) -> RaygridError:
    """The last error, with how often it was tried, in one sentence of the same kind."""
    if not faults:
        return error
    kinds = {fault.kind for fault in faults}
    before = f"{len(faults)} times before" if len(faults) > 1 else "once before"
    same = "in the same way" if kinds == {type(error).__name__} else f"by {', '.join(sorted(kinds))}"
    kind = type(error) if isinstance(error, ArrayError | ProtocolError) else ArrayError
    return kind(f"{error}; the array was reset and the frame repeated, it had failed {before} {same}")
