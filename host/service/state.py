"""Holds how a service stands: what its array does, the frame under way, what was done and what went wrong."""

from __future__ import annotations

import time
from collections import Counter, deque
from dataclasses import dataclass, field
from typing import Literal

from raygrid.host.client.facts import FaultFacts
from raygrid.host.service.events import FrameMoved, Options, Task
from raygrid.host.service.schedule import Entry
from raygrid.host.text.clean_text import printable
from raygrid.host.text.log import log

FAULTS_KEPT = 20

Condition = Literal["launching", "ready", "broken", "ending"]


@dataclass
class ServiceState:
    """How one service stands.

    condition, why  of the array; `why` if it is broken
    finishing    takes no more jobs and ends after the last
    task, entry  the frame that is with the array, and its job; None: none
    moved        how far it is; None: not begun
    counts       frames done, skipped, failed; resets
    faults       the last ones; `fault_count`: how many there were
    prometheus   port at which its figures are served, None for none
    """

    name: str
    options: Options
    condition: Condition = "launching"
    why: str = ""
    finishing: bool = False
    task: Task | None = None
    entry: Entry | None = None
    moved: FrameMoved | None = None
    started: float = field(default_factory=time.time)
    counts: Counter[str] = field(
        default_factory=lambda: Counter(dict.fromkeys(("done", "skipped", "failed", "resets"), 0))
    )
    faults: deque[FaultFacts] = field(default_factory=lambda: deque(maxlen=FAULTS_KEPT))
    fault_count: int = 0
    prometheus: int | None = None

    def note_fault(self, what: str, task: Task | None) -> None:
        """Remember a fault, and write it to the log."""
        fault = FaultFacts(at=time.time(), what=printable(what))
        if task is not None:
            fault |= {"job": task.job, "frame": task.frame}
        self.fault_count += 1
        self.faults.append(fault)
        log(f"fault: {fault['what']}")

    def settle(self) -> None:
        """The frame that was with the array is so no more."""
        self.task = self.entry = self.moved = None
