"""Says how a node's process ended and what it said before."""

from __future__ import annotations

import signal
from dataclasses import dataclass

from raygrid.emulator.topology.coordinates import Index, name_of

SIGNALS = {number.value: number.name for number in signal.Signals}


@dataclass(frozen=True)
class ProcessEnded:
    """The node with coordinates `index` has ended.

    status   its exit code, or minus the number of the signal that ended it
    words    its error as it, or the library that ended it, wrote it; "" if there was none
    """

    pid: int
    index: Index
    status: int
    words: str

    @property
    def code(self) -> int | None:
        """The exit code; None if a signal ended it."""
        return self.status if self.status >= 0 else None

    @property
    def signal(self) -> str | None:
        """The name of the signal that ended it, such as "SIGKILL"; None if it exited."""
        return SIGNALS.get(-self.status, str(-self.status)) if self.status < 0 else None

    @property
    def why(self) -> str:
        """How it ended and what it said: "exit code 1: no such surface"."""
        return how_ended(self.status) + (f": {self.words}" if self.words else "")

    @property
    def told(self) -> str:
        """In words: "node 1,0,0 (pid 17) ended: exit code 1: no such surface"."""
        return f"node {name_of(self.index)} (pid {self.pid}) ended: {self.why}"

    def __str__(self) -> str:
        return f"node {name_of(self.index)} (process {self.pid}) ended by {self.why}"


def how_ended(status: int) -> str:
    """An exit code, or minus the number of a signal, in words."""
    return f"exit code {status}" if status >= 0 else f"signal {SIGNALS.get(-status, -status)}"
