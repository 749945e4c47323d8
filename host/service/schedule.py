"""Says whose frame is next: by priority first, then clients in turn, the jobs of a client in turn, the frames of a job in order.

So a job of one frame waits for at most one frame of every other client and job of its priority, however long theirs are.
Nobody waits for ever: a priority that was passed over PASSES times has the next frame. No clock, no disk and no array in
here.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import StrEnum

from raygrid.host.client.facts import ENDED

PASSES = 8  # frames of higher priorities, after which a lower one has a frame
MOST_YIELDS = 2  # times that a frame is given up for one of a higher priority; then it is finished first


class JobState(StrEnum):
    """Of a job."""

    QUEUED = "queued"
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"
    CANCELLED = "cancelled"


@dataclass
class Entry:
    """A job in the schedule.

    todo     frames that were not begun, in order
    running  the frame that is with the array
    done     frames whose files are there; `skipped` of them were there already
    error    why it failed
    priority  higher ones go first
    submitted, begun  seconds since 1970; for the caller to set
    yields   how often its frame was given up for a higher priority, since the last one that was done
    owed     whether its frame has its turn because it was passed over: that is not given up for others
    """

    job: int
    client: str
    todo: deque[int]
    total: int
    priority: int = 0
    done: int = 0
    skipped: int = 0
    running: int | None = None
    state: JobState = JobState.QUEUED
    error: str = ""
    submitted: float = 0.0
    begun: float | None = None
    yields: int = 0
    owed: bool = field(default=False, repr=False)
    waiting: bool = field(default=False, repr=False)  # in the ring of its client

    @property
    def ended(self) -> bool:
        """Whether nothing more will be done for it."""
        return self.state in ENDED


class _Turns:
    """The jobs of one priority: clients in turn, the jobs of a client in turn.

    passed   frames of higher priorities that went first since the last one from here
    """

    def __init__(self) -> None:
        self.passed = 0
        self._rings: dict[str, deque[Entry]] = {}
        self._clients: deque[str] = deque()

    @property
    def waits(self) -> bool:
        """Whether there is a frame to be done; forgets the jobs that have none, or have ended, from the front."""
        while self._clients:
            ring = self._rings[self._clients[0]]
            while ring and (ring[0].ended or not ring[0].todo):
                ring.popleft().waiting = False
            if ring:
                return True
            del self._rings[self._clients.popleft()]
        return False

    def take(self) -> Entry:
        """The job whose turn it is, of which the caller takes a frame. To be called only if one `waits`."""
        client = self._clients.popleft()
        ring = self._rings[client]
        entry = ring.popleft()
        entry.waiting = False
        if ring:
            self._clients.append(client)
        else:
            del self._rings[client]
        return entry

    def wait(self, entry: Entry, first: bool = False) -> None:
        """Let a job stand in the ring of its client, and the client in that of clients."""
        if entry.client not in self._rings:
            self._rings[entry.client] = deque()
            (self._clients.appendleft if first else self._clients.append)(entry.client)
        elif first:
            self._clients.remove(entry.client)
            self._clients.appendleft(entry.client)
        ring = self._rings[entry.client]
        if first and entry.waiting:
            ring.remove(entry)
        if first or not entry.waiting:
            (ring.appendleft if first else ring.append)(entry)
        entry.waiting = True


class Schedule:
    """The jobs that have not ended.

    entries   job -> entry
    """

    def __init__(self) -> None:
        self.entries: dict[int, Entry] = {}
        self._levels: dict[int, _Turns] = {}

    def add(self, job: int, client: str, frames: Iterable[int], total: int, priority: int = 0) -> Entry:
        """Queue a job; `frames` of its `total` are to be done."""
        entry = Entry(job, client, deque(frames), total, priority)
        entry.done = total - len(entry.todo)
        self.entries[job] = entry
        self._wait(entry)
        return entry

    @property
    def frames_queued(self) -> int:
        """Frames that were not begun."""
        return sum(len(entry.todo) for entry in self.entries.values())

    def _waiting(self) -> list[int]:
        """The priorities that have a frame to be done, highest first."""
        self._levels = {level: turns for level, turns in self._levels.items() if turns.waits}
        return sorted(self._levels, reverse=True)

    def next(self) -> tuple[Entry, int] | None:
        """The next frame, which counts as running from now on; None if there is none."""
        levels = self._waiting()
        if not levels:
            return None
        longest = max(levels, key=lambda level: self._levels[level].passed)
        owed = self._levels[longest].passed >= PASSES
        level = longest if owed else levels[0]
        for lower in levels[levels.index(level) + 1 :]:
            self._levels[lower].passed += 1
        turns = self._levels[level]
        turns.passed = 0
        entry = turns.take()
        entry.running, entry.owed = entry.todo.popleft(), owed
        entry.state = JobState.RUNNING
        if entry.todo:
            self._wait(entry)
        return entry, entry.running

    def should_yield(self, entry: Entry) -> bool:
        """Whether the running frame of a job should be given up because a higher priority waits."""
        if entry.owed or entry.yields >= MOST_YIELDS:
            return False
        return any(level > entry.priority for level in self._waiting())

    def put_back(self, entry: Entry) -> None:
        """The running frame was not rendered: it is the job's next one again, and the job is at the head."""
        if entry.running is None:
            return
        entry.todo.appendleft(entry.running)
        entry.running = None
        self._wait(entry, first=True)

    def finish(self, entry: Entry, skipped: bool = False) -> None:
        """The running frame is done; the job has ended if it was the last."""
        entry.running = None
        entry.yields = 0
        entry.done += 1
        entry.skipped += skipped
        if not entry.todo:
            self.end(entry, JobState.DONE)

    def end(self, entry: Entry, state: JobState, error: str = "") -> None:
        """End a job, whatever is left of it."""
        entry.state, entry.error = state, error
        entry.todo.clear()
        entry.running = None
        self.entries.pop(entry.job, None)

    def _wait(self, entry: Entry, first: bool = False) -> None:
        self._levels.setdefault(entry.priority, _Turns()).wait(entry, first)
