"""Stops a clock while kernels are compiled: what a first run compiles is no part of what it measures."""

from __future__ import annotations

import time

from raygrid.node.jit import always_heard_by


class _Stopped:
    """How long the clock has stood; functions are compiled within others, which counts once."""

    def __init__(self) -> None:
        self.seconds, self._begun, self._depth = 0.0, 0.0, 0

    def begins(self, _function: object) -> None:
        """It stops."""
        if self._depth == 0:
            self._begun = time.perf_counter()
        self._depth += 1

    def ends(self, _function: object) -> None:
        """It goes on."""
        self._depth -= 1
        if self._depth == 0:
            self.seconds += time.perf_counter() - self._begun


_stopped = _Stopped()
always_heard_by(_stopped.begins, _stopped.ends)


def now() -> float:
    """Seconds, of which only differences mean anything."""
    return time.perf_counter() - _stopped.seconds
