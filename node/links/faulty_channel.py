"""Harms messages on purpose as a bad link does, for experiments (`raygrid render --fault`).

    drop      a message is lost
    double    a message comes twice
    reorder   a message comes after the one that followed it, or DELAY seconds late if none follows
    delay     a message and those behind it come DELAY seconds late
    corrupt   one bit of a message is changed
    truncate  a message loses bytes at its end

Which messages are hit follows from the seed, the node, the port and the epoch, and from nothing else.
"""

from __future__ import annotations

import random
import time
from collections import deque
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from raygrid.node.links.link import Channel

FAULT_KINDS = ("drop", "double", "reorder", "delay", "corrupt", "truncate")
DEFAULT_RATE = 1e-4
DELAY = 0.05  # seconds
TICK_MS = 10  # how often a node with faulty links looks for what is due


class FaultPlan(NamedTuple):
    """What goes wrong on the links between neighbours: its kind, how often (a part of the messages), and a seed."""

    kind: str
    rate: float = DEFAULT_RATE
    seed: int = 0


def parse_fault(text: str) -> FaultPlan:
    """Read KIND[:RATE[:SEED]], such as "drop:0.001:7". Raises ValueError with one sentence."""
    wanted = f"wanted KIND[:RATE[:SEED]] with KIND one of {' '.join(FAULT_KINDS)}, such as drop:0.001:7"
    words = text.split(":")
    if words[0] not in FAULT_KINDS or len(words) > 3 or len(text) > 60:
        raise ValueError(f"a fault came as {text[:60]!r}, {wanted}")
    try:
        rate = float(words[1]) if len(words) > 1 else DEFAULT_RATE
        seed = int(words[2]) if len(words) > 2 else 0
    except ValueError:
        raise ValueError(f"a fault came as {text!r}, {wanted}") from None
    if not 0.0 < rate <= 1.0:
        raise ValueError(f"a fault came with rate {words[1]}, wanted a part of the messages above 0 and at most 1")
    return FaultPlan(words[0], rate, seed)


class FaultyChannel:
    """A channel that hits some of the messages sent over it.

    key   what the choice of messages follows from, beside the plan's seed
    tell  called with a map for each message that is hit; what it returns is not looked at
    """

    def __init__(
        self,
        inner: Channel,
        plan: FaultPlan,
        key: Iterable[int],
        tell: Callable[[dict[str, object]], object] = lambda message: None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.inner, self._plan, self._tell, self._clock = inner, plan, tell, clock
        self._random = random.Random(":".join(map(str, (plan.kind, plan.seed, *key))))
        self._held: deque[tuple[float, bytes]] = deque()  # when each is due; later ones never before earlier ones
        self._sent = 0

    def send(self, message: bytes | memoryview) -> bool:
        """Hand over a message, or do to it what the plan says; False if there is no room now."""
        hit = self._random.random() < self._plan.rate
        if not hit:
            return self._pass_on(message)
        self._tell({"is": "injected", "kind": self._plan.kind, "message": self._sent, "bytes": len(message)})
        self._sent += 1
        kind = self._plan.kind
        if kind in ("delay", "reorder"):
            self._held.append((self._clock() + DELAY, bytes(message)))
        elif kind != "drop":
            for changed in self._changed(bytes(message)):
                self.inner.send(changed)
        return True

    def _pass_on(self, message: bytes | memoryview) -> bool:
        self.release()
        if self._held and self._plan.kind == "delay":
            self._held.append((self._held[-1][0], bytes(message)))
        elif not self.inner.send(message):
            return False
        else:
            self.release(at_once=True)
        self._sent += 1
        return True

    def _changed(self, message: bytes) -> list[bytes]:
        """What is sent instead of a message."""
        if self._plan.kind == "double":
            return [message, message]
        if self._plan.kind == "truncate":
            return [message[: self._random.randrange(len(message))]]
        data = bytearray(message)
        bit = self._random.randrange(8 * len(data))
        data[bit >> 3] ^= 1 << (bit & 7)
        return [bytes(data)]

    def release(self, at_once: bool = False) -> None:
        """Send what was held back and is due."""
        now = self._clock()
        while self._held and (at_once or self._held[0][0] <= now):
            if not self.inner.send(self._held[0][1]):
                return
            self._held.popleft()

    def receive(self) -> bytes | None:
        """The next message, or None if there is none now."""
        return self.inner.receive()

    def close(self) -> None:
        """Give the channel up."""
        self.inner.close()


def send_delayed(channels: Iterable[FaultyChannel], patience: int | None) -> int:
    """Send what is due on these channels; returns the milliseconds to wait for messages, at most TICK_MS."""
    for channel in channels:
        channel.release()
    return TICK_MS if patience is None else min(patience, TICK_MS)
