"""Sends diagnostic probes: how a node stands, so many times a second as the host has asked for (law 9).

A sample only reads. It goes up the control channel if there is room, and is dropped and counted if nobody reads. It is a map:

    is        "sample"
    epoch     of the node
    number    of the sample since the process began, dropped ones counted too
    time      seconds of this computer's monotonic clock, which all its processes share
    phase     load, trace, collect or idle: of the last order
    counts    int64 as bytes, the counts of `node.geometry.surface_tables` for this frame
    queues    packets that wait: returns and pixels, shadow rays, other rays
    waiting   those packets by the port of their arrival (6: host, 7: born here) and by kind: port * KINDS + kind, how
              many, and so on for those that are any; of each queue the newest LOOKED_AT at most
    outputs   packets on the six ports' outputs and that to the host, not yet sent
    links     [port, messages that wait, messages sent, bytes sent, messages received] a link
    surfaces  held
    memory    bytes by use, as in the record of a node, and pss (of the process), at most MEMORY_SECONDS old
    cpu       seconds of processor time since the process began
    dropped   messages that this node could not send on its control channel
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Protocol

import numpy as np

from raygrid.node.errors import ProtocolError
from raygrid.node.geometry.grid_walk import HOST, SELF
from raygrid.node.protocol.packets import KINDS, SIZE
from raygrid.node.runtime.memory_stats import proportional_memory
from raygrid.node.tracing.work_queues import CLASSES

if TYPE_CHECKING:
    from raygrid.node.runtime.processor import Processor

MEMORY_SECONDS = 5.0  # between two looks at memory, which take the kernel two milliseconds or more
FASTEST = 100.0  # samples a second
LOOKED_AT = 32_768  # packets of a queue; counting more would take a millisecond
ARRIVALS = SELF + 1
NEVER_DUE = float("inf")


class ProbeWriter(Protocol):
    """The node's end of its control channel."""

    dropped: int

    def send(self, message: Mapping[str, object]) -> bool:
        """Send a message now, or not at all."""


def read_rate(order: Mapping[str, object]) -> float:
    """Samples a second of an order {do: probe, rate}; 0: none. Raises ProtocolError."""
    rate = order.get("rate")
    if not isinstance(rate, int | float) or isinstance(rate, bool) or not 0.0 <= rate <= FASTEST:
        raise ProtocolError(f"a rate of probes came as {rate!r}, wanted 0 to {FASTEST:g} samples a second")
    return float(rate)


class NodeProbe:
    """When a node is to send a sample, and what it says.

    due   moment of the next sample by `clock`; infinite while nobody wants any
    """

    def __init__(self, control: ProbeWriter, clock: Callable[[], float] = time.monotonic) -> None:
        self._control, self._clock = control, clock
        self._period = 0.0
        self._number = 0
        self._memory: dict[str, int] = {}
        self._measured = -NEVER_DUE
        self.due = NEVER_DUE

    @property
    def wanted(self) -> bool:
        """Whether anybody wants samples."""
        return self._period > 0.0

    def set_rate(self, rate: float) -> None:
        """Samples a second from now on, the first one at once; 0: none."""
        self._period = 1.0 / rate if rate else 0.0
        self.due = self._clock() if rate else NEVER_DUE

    def patience(self, limit: float | None) -> float | None:
        """Seconds until the next sample is due, if that is sooner than a limit; None: no limit."""
        if self.due == NEVER_DUE:
            return limit
        left = max(0.0, self.due - self._clock())
        return left if limit is None else min(limit, left)

    def maybe_send(self, processor: Processor, epoch: int) -> None:
        """Send a sample if one is due. A node that was busy for longer than a period does not make up for it."""
        now = self._clock()
        if now < self.due:
            return
        self.due = max(self.due + self._period, now)
        if now >= self._measured + MEMORY_SECONDS or not self._memory:
            self._memory, self._measured = memory(processor), now
        self._control.send(sample(processor, epoch, self._number, now, self._control.dropped, self._memory))
        self._number += 1


def memory(processor: Processor) -> dict[str, int]:
    """Bytes by use, and of the process."""
    return {**processor.node_state.memory, "pss": proportional_memory()}


def sample(
    processor: Processor, epoch: int, number: int, now: float, dropped: int, used: dict[str, int]
) -> dict[str, object]:
    """How a node stands. used: as of `memory`, which takes longer than all the rest."""
    node_state = processor.node_state
    return {
        "is": "sample",
        "epoch": epoch,
        "number": number,
        "time": now,
        "phase": processor.phase,
        "counts": node_state.counts.astype("<i8").tobytes(),
        "queues": node_state.work_queues.count[:CLASSES].tolist(),
        "waiting": _waiting(processor),
        "outputs": node_state.outputs.held[: HOST + 1].tolist(),
        "links": [
            [port, link.waiting, link.messages_sent, link.bytes_sent, link.received]
            for port, link in processor.links.items()
        ],
        "surfaces": sum(len(batch) for batch in node_state.retained),
        "memory": used,
        "cpu": time.process_time(),
        "dropped": dropped,
    }


def _waiting(processor: Processor) -> list[int]:
    """Packets that wait, by port of arrival and kind: place in the table and how many, for those that are any."""
    work_queues = processor.node_state.work_queues
    table = np.zeros(ARRIVALS * KINDS, np.int64)
    for queue in range(CLASSES):
        held = int(work_queues.count[queue])
        if held:
            first = max(0, held - LOOKED_AT)
            kinds = work_queues.stacks[queue][first * SIZE : held * SIZE : SIZE] & 7
            at = work_queues.stacks[CLASSES + queue][first:held].astype(np.int64) * KINDS + kinds
            table += np.bincount(at, minlength=len(table))
    places = np.flatnonzero(table)
    counted: list[int] = np.stack((places, table[places]), axis=1).ravel().tolist()
    return counted
