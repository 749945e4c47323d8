"""Asks the kernel how the processes of the nodes stand: state, processor time, memory. Nothing is asked of the nodes."""

from __future__ import annotations

import time
from collections.abc import Sequence

from raygrid.emulator.topology import STATES, indices, process_times
from raygrid.host.client.facts import NodeFacts
from raygrid.node.runtime import proportional_memory

NODE_STATES = STATES | {"": "gone"}  # told apart from one that has ended and waits to be reaped
LEAST_SPAN = 0.5  # seconds over which a load is measured, if it can be

Shape = tuple[int, int, int]


class Samples:
    """Processor times of the nodes at two moments not long ago, from which their load is worked out."""

    def __init__(self) -> None:
        self._older: tuple[float, dict[int, float]] = (0.0, {})
        self._newer: tuple[float, dict[int, float]] = (0.0, {})

    def take(self, pids: Sequence[int]) -> None:
        """Remember the processor times now; to be called about every two seconds."""
        self._older = self._newer
        self._newer = time.monotonic(), {pid: process_times(pid)[1] for pid in pids}

    def nodes(self, pids: Sequence[int], shape: Shape) -> list[NodeFacts]:
        """What the kernel says of each node, x fastest."""
        now = time.monotonic()
        since, before = self._newer if now - self._newer[0] >= LEAST_SPAN else self._older
        found: list[NodeFacts] = []
        for index, pid in zip(indices(shape), pids, strict=False):  # none while there is no array
            state, spent = process_times(pid)
            load = (spent - before[pid]) / (now - since) if pid in before and now > since else None
            found.append(
                {
                    "node": list(index),
                    "pid": pid,
                    "state": NODE_STATES.get(state, state),
                    "cpu_seconds": round(spent, 2),
                    "load": None if load is None else round(max(load, 0.0), 3),
                    "pss": proportional_memory(pid),
                }
            )
        return found
