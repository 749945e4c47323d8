"""Stops a clock while kernels are compiled: what a first run compiles is no part of what it measures."""

from __future__ import annotations

import time
from typing import Any

from numba.core import event as _event

event: Any = _event  # has no types


class _Stopped(event.Listener):  # type: ignore[misc]
    """How long the clock has stood; functions are compiled within others, which counts once."""

    def __init__(self) -> None:
        self.seconds, self._begun, self._depth = 0.0, 0.0, 0

    def on_start(self, _event: Any) -> None:
        """It stops."""
        if self._depth == 0:
            self._begun = time.perf_counter()
        self._depth += 1

    def on_end(self, _event: Any) -> None:
        """It goes on."""
        self._depth -= 1
        if self._depth == 0:
            self.seconds += time.perf_counter() - self._begun


_stopped = _Stopped()
event.register("numba:compile", _stopped)


def now() -> float:
    """Seconds, of which only differences mean anything."""
    return time.perf_counter() - _stopped.seconds
