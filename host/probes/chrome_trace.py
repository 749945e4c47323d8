"""Writes samples of probes as a trace file in Chrome's trace event format, which Perfetto and chrome://tracing open.

Each node is a process of the trace: a bar for each phase that it was in, and counters for its busy and waiting share, the
packets that wait in it by class, and packets served a second. Times are wall time of this computer.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from raygrid.emulator.driver import NodeSample
from raygrid.host.image.outputs import write_whole
from raygrid.host.probes.sums import Gauges, Index, NodeFigures

MOST_NODES = 64  # in one trace; more cannot be read
TraceEvent = dict[str, Any]


class ChromeTrace:
    """Collects samples of up to MOST_NODES nodes, evenly chosen, and writes them at the end."""

    def __init__(self, shape: tuple[int, int, int]) -> None:
        nodes = [(x, y, z) for z in range(shape[2]) for y in range(shape[1]) for x in range(shape[0])]
        stride = -(-len(nodes) // MOST_NODES)
        self._pid = {node: number + 1 for number, node in enumerate(nodes) if number % stride == 0}
        self._gauges = Gauges(shape)
        self._events: list[TraceEvent] = []
        self._since: dict[Index, NodeSample] = {}  # the first sample of the phase that a node is in
        self._last: dict[Index, NodeSample] = {}
        self._begun: float | None = None

    def take(self, sample: NodeSample) -> None:
        """Take a sample in."""
        if sample.node not in self._pid:
            return
        self._begun = sample.time if self._begun is None else self._begun
        first, last = self._since.get(sample.node), self._last.get(sample.node)
        if first is None or first.phase != sample.phase or first.epoch != sample.epoch:
            if first is not None and last is not None:
                self._phase(first, sample.time if first.epoch == sample.epoch else last.time)
            self._since[sample.node] = sample
        self._last[sample.node] = sample
        self._count(self._gauges.take(sample), last)

    def write(self, path: str | Path) -> None:
        """Write the file. Raises OutputError."""
        events = self._events + [self._bar(first, self._last[node].time) for node, first in self._since.items()]
        begun = [
            {"ph": "M", "name": name, "pid": pid, "tid": 0, "args": args}
            for node, pid in self._pid.items()
            if node in self._last
            for name, args in (
                ("process_name", {"name": f"node {','.join(map(str, node))}"}),
                ("process_sort_index", {"sort_index": pid}),
                ("thread_name", {"name": "phase"}),
            )
        ]
        events.sort(key=lambda event: event["ts"])
        lines = ",\n".join(json.dumps(event) for event in [*begun, *events])
        text = f'{{"displayTimeUnit": "ms", "traceEvents": [\n{lines}\n]}}\n'
        write_whole(path, lambda file: file.writelines([text.encode()]))

    def _at(self, time: float) -> float:
        """Microseconds since the first sample. Nodes are sampled at different moments, so some may lie before it."""
        assert self._begun is not None
        return round(max(0.0, time - self._begun) * 1e6, 1)

    def _phase(self, first: NodeSample, end: float) -> None:
        self._events.append(self._bar(first, end))

    def _bar(self, first: NodeSample, end: float) -> TraceEvent:
        begin = self._at(first.time)
        return {
            "ph": "X",
            "name": first.phase,
            "cat": "phase",
            "pid": self._pid[first.node],
            "tid": 0,
            "ts": begin,
            "dur": max(0.0, round(self._at(end) - begin, 1)),
            "args": {"epoch": first.epoch, "surfaces": first.surfaces},
        }

    def _count(self, state: NodeFigures, last: NodeSample | None) -> None:
        """A counter holds from its time on, so what is known of the time since the last sample is put there."""
        sample = state.sample
        since = self._at(sample.time if last is None else last.time)
        busy = round(state.busy, 4)
        counters = (
            ("busy share", since, {"busy": busy, "wait": round(1.0 - busy, 4)}),
            ("packets/s", since, {"packets/s": round(state.rate, 1)}),
            ("packets waiting", self._at(sample.time), dict(sample.queues)),
        )
        pid = self._pid[sample.node]
        for name, at, values in counters:
            if last is not None or name == "packets waiting":
                self._events.append({"ph": "C", "name": name, "pid": pid, "ts": at, "args": values})
