"""Lists nodes by the share of a processor that they used over all samples: `raygrid probe --table`."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass

from raygrid.host.cli.probe_view import short
from raygrid.host.probes.sums import Index, NodeFigures


@dataclass
class Share:
    """What the samples of a node add up to.

    busy     part of a processor that it used, over `seconds`; most_busy: between two samples
    packets  served, by all frames; most_held: that waited in it at once
    """

    node: Index
    seconds: float = 0.0
    busy: float = 0.0
    most_busy: float = 0.0
    packets: float = 0.0
    most_held: int = 0


class Shares:
    """Adds up what each node did."""

    def __init__(self) -> None:
        self._shares: dict[Index, Share] = {}
        self._times: dict[Index, float] = {}

    def take(self, state: NodeFigures) -> None:
        """Take a state in, as `Gauges` makes it of a sample and the one before it."""
        sample = state.sample
        share = self._shares.setdefault(sample.node, Share(sample.node))
        span = sample.time - self._times.get(sample.node, sample.time)
        self._times[sample.node] = max(sample.time, self._times.get(sample.node, sample.time))
        share.most_held = max(share.most_held, sample.held)
        if span > 0.0:
            whole = share.seconds + span
            share.busy = (share.busy * share.seconds + state.busy * span) / whole
            share.seconds, share.packets = whole, share.packets + state.rate * span
            share.most_busy = max(share.most_busy, state.busy)

    def ordered(self) -> list[Share]:
        """The busiest first."""
        return sorted(self._shares.values(), key=lambda share: (-share.busy, share.node[::-1]))

    def lines(self) -> Iterator[str]:
        """The table: 60 columns at most for arrays of up to 999 nodes an axis."""
        yield f"{'node':<11} {'busy':>5} {'at most':>7} {'seconds':>8} {'packets':>8} {'held at most':>12}"
        for share in self.ordered():
            node = ",".join(map(str, share.node))
            yield (
                f"{node:<11} {share.busy:5.2f} {share.most_busy:7.2f} {share.seconds:8.2f} "
                f"{short(share.packets):>8} {short(share.most_held):>12}"
            )

    def records(self) -> Iterator[str]:
        """The same as lines of JSON."""
        for share in self.ordered():
            facts = asdict(share) | {"node": list(share.node)}
            yield json.dumps(
                {"is": "share", **{key: round(v, 4) if isinstance(v, float) else v for key, v in facts.items()}}
            )
