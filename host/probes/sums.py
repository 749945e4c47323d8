"""Adds samples of probes up: the latest of each node, and rates between two of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass

from raygrid.emulator.driver import NodeSample

Shape = tuple[int, int, int]
Index = tuple[int, int, int]


@dataclass(frozen=True)
class NodeFigures:
    """A node between its last two samples: part of a processor that it used (0 to 1), packets served a second, by wall time."""

    sample: NodeSample
    busy: float
    rate: float


class Gauges:
    """The latest state of every node of an array."""

    def __init__(self, shape: Shape) -> None:
        self.shape = shape
        self.samples = 0
        self._states: dict[Index, NodeFigures] = {}

    def take(self, sample: NodeSample) -> NodeFigures:
        """Take a sample in; what it says of its node together with the one before."""
        self.samples += 1
        last = self._states.get(sample.node)
        busy, rate = (0.0, 0.0) if last is None else (last.busy, last.rate)
        if last is not None and sample.time > last.sample.time:
            span, before = sample.time - last.sample.time, last.sample
            busy = min(1.0, max(0.0, (sample.cpu - before.cpu) / span))  # a node that was forked anew begins at 0
            rate = max(0, sample.work - before.work) / span  # a new frame begins at 0
        state = self._states[sample.node] = NodeFigures(sample, busy, rate)
        return state

    def __iter__(self) -> Iterator[NodeFigures]:
        """The states, x fastest. Another thread may take samples meanwhile."""
        nodes = tuple(self._states)
        yield from (self._states[node] for node in sorted(nodes, key=lambda node: node[::-1]))

    def __len__(self) -> int:
        return len(self._states)

    def get(self, node: Index) -> NodeFigures | None:
        """The state of a node, None before its first sample."""
        return self._states.get(node)

    def totals(self) -> dict[str, float]:
        """Sums over the nodes."""
        states = list(self)
        samples = [state.sample for state in states]
        total: dict[str, float] = {
            "nodes": len(states),
            "busy": sum(state.busy for state in states),
            "rate": sum(state.rate for state in states),
            "held": sum(sample.held for sample in samples),
            "surfaces": sum(sample.surfaces for sample in samples),
            "pss": sum(sample.memory["pss"] for sample in samples),
            "cpu": sum(sample.cpu for sample in samples),
            "messages_waiting": sum(link.waiting for sample in samples for link in sample.links.values()),
            "messages": sum(link.messages_sent for sample in samples for link in sample.links.values()),
            "bytes": sum(link.bytes_sent for sample in samples for link in sample.links.values()),
            "dropped": sum(sample.dropped for sample in samples),
        }
        return total

    def by_kind(self, of: str) -> dict[str, int]:
        """`born` or `died` of all nodes, by kind."""
        counts: dict[str, int] = {}
        for state in self:
            for kind, count in getattr(state.sample, of).items():
                counts[kind] = counts.get(kind, 0) + count
        return counts

    @property
    def phase(self) -> str:
        """What most nodes do."""
        phases = [state.sample.phase for state in self]
        return max(sorted(set(phases)), key=phases.count, default="idle")


def sample_record(state: NodeFigures) -> dict[str, object]:
    """A sample as a map ready for JSON, with what it says together with the one before it."""
    record = asdict(state.sample)
    record["node"] = list(state.sample.node)
    return {**record, "busy": round(state.busy, 4), "rate": round(state.rate, 1)}
