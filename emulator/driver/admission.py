"""Decides how many primary rays nodes admit next, and how many packets make a batch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from raygrid.node.protocol import BORN, DIED, KINDS, PRIMARY, TraceCommand
from raygrid.node.runtime import HOMES_LEFT

# seconds that a node waits for more packets: so long for every node that a processor of this computer carries, once more
# for so many packets under way; at most
BACK_OFF, PACKETS_A_BACK_OFF, LONGEST_BACK_OFF = 0.0002, 1 << 19, 0.016
BATCH_SHARE = 0.25  # part of the mean share of packets that it waits for
EAGER_FLUSH, CROWDED_FLUSH = 256, 4096  # packets for which a node with work sends an output
LEAST_SHARE = 256  # packets a node below which nobody waits


@dataclass(frozen=True)
class Progress:
    """State of a pass as the last wave found it. born, died: by packet kind."""

    born: tuple[int, ...]
    died: tuple[int, ...]
    homes_left: int

    @property
    def in_flight(self) -> int:
        """Packets born and not yet dead."""
        return sum(self.born) - sum(self.died)

    @property
    def primaries(self) -> int:
        """Samples admitted so far."""
        return self.born[PRIMARY]

    @classmethod
    def of(cls, sums: Sequence[int]) -> Progress:
        """From what a wave has summed up (`node.runtime.reduction`)."""
        return cls(tuple(sums[BORN : BORN + KINDS]), tuple(sums[DIED : DIED + KINDS]), sums[HOMES_LEFT])


def next_quota(budget: int, now: Progress, before: Progress | None, allowed: int) -> int:
    """How many primaries each home may emit next, if it may not spawn more than that already.

    What a wave counts is no picture of one moment: a packet may be counted dead where it died and not yet born where
    it was born. But every death of the wave before last was counted before any birth of the last one, so births now
    less deaths before are at least the packets in flight between the two waves, and each primary whose tree of rays
    is still alive is one of them or has a descendant there. With the primaries that homes may still emit, that is
    all that can become alive without a further order; what is left of the budget is shared out. So the primaries
    whose trees are alive are never more than the budget, or than the homes if there are more of these: where nothing
    is in flight each home may emit one.
    """
    in_flight = sum(now.born) - (sum(before.died) if before is not None else 0)
    if now.homes_left == 0:
        return 0
    if in_flight == 0 and allowed == 0:
        return max(1, budget // now.homes_left)
    return max(0, budget - in_flight - allowed) // now.homes_left


def batching(in_flight: int, nodes: int, processors: int) -> TraceCommand:
    """How many packets are worth a batch, and how long a node may wait for them, on a computer with so many processors.

    With more nodes than processors of this computer, a node that wakes for every message does little but wake.
    A node waits for a part of the mean share, so some node always has enough; the tail of a pass waits for nothing.
    Fewer and larger messages cost less, and the more there is to do, the less it matters when they come.
    """
    share = in_flight // nodes
    if nodes <= processors or share < LEAST_SHARE:
        return TraceCommand(0, flush=EAGER_FLUSH)
    back_off = BACK_OFF * nodes / processors * (1.0 + in_flight / PACKETS_A_BACK_OFF)
    return TraceCommand(
        0, batch_threshold=int(share * BATCH_SHARE), back_off=min(LONGEST_BACK_OFF, back_off), flush=CROWDED_FLUSH
    )
