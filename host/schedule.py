"""Whose frame is next: clients in turn, the jobs of a client in turn, the frames of a job in order.

So a job of one frame waits for at most one frame of every other client and job, however long theirs are. No clock, no
disk and no array in here.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import StrEnum


class State(StrEnum):
    """Of a job."""

    QUEUED = "queued"
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"
    CANCELLED = "cancelled"


ENDED = (State.DONE, State.FAILED, State.CANCELLED)


@dataclass
class Entry:
    """A job in the schedule.

    todo     frames that were not begun, in order
    running  the frame that is with the array
    done     frames whose files are there; `skipped` of them were there already
    error    why it failed
    """

    job: int
    client: str
    todo: deque[int]
    total: int
    done: int = 0
    skipped: int = 0
    running: int | None = None
    state: State = State.QUEUED
    error: str = ""
    waiting: bool = field(default=False, repr=False)  # in the ring of its client

    @property
    def ended(self) -> bool:
        """Whether nothing more will be done for it."""
        return self.state in ENDED


class Schedule:
    """The jobs that have not ended.

    entries   job -> entry
    """

    def __init__(self) -> None:
        self.entries: dict[int, Entry] = {}
        self._rings: dict[str, deque[int]] = {}
        self._clients: deque[str] = deque()

    def add(self, job: int, client: str, frames: Iterable[int], total: int) -> Entry:
        """Queue a job; `frames` of its `total` are to be done."""
        entry = Entry(job, client, deque(frames), total)
        entry.done = total - len(entry.todo)
        self.entries[job] = entry
        self._wait(entry)
        return entry

    @property
    def frames_queued(self) -> int:
        """Frames that were not begun."""
        return sum(len(entry.todo) for entry in self.entries.values())

    def next(self) -> tuple[Entry, int] | None:
        """The next frame, which counts as running from now on; None if there is none."""
        while self._clients:
            client = self._clients.popleft()
            ring = self._rings[client]
            entry = self._take(ring)
            if ring:
                self._clients.append(client)
            else:
                del self._rings[client]
            if entry is not None:
                entry.running = entry.todo.popleft()
                entry.state = State.RUNNING
                if entry.todo:
                    self._wait(entry)
                return entry, entry.running
        return None

    def _take(self, ring: deque[int]) -> Entry | None:
        """The next job of a client that still waits."""
        while ring:
            entry = self.entries.get(ring.popleft())
            if entry is not None:
                entry.waiting = False
                if entry.todo and not entry.ended:
                    return entry
        return None

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
        entry.done += 1
        entry.skipped += skipped
        if not entry.todo:
            self.end(entry, State.DONE)

    def end(self, entry: Entry, state: State, error: str = "") -> None:
        """End a job, whatever is left of it."""
        entry.state, entry.error = state, error
        entry.todo.clear()
        entry.running = None
        self.entries.pop(entry.job, None)

    def _wait(self, entry: Entry, first: bool = False) -> None:
        """Let a job stand in the ring of its client, and the client in that of clients."""
        if entry.client not in self._rings:
            self._rings[entry.client] = deque()
            (self._clients.appendleft if first else self._clients.append)(entry.client)
        elif first:
            self._clients.remove(entry.client)
            self._clients.appendleft(entry.client)
        ring = self._rings[entry.client]
        if first and entry.waiting:
            ring.remove(entry.job)
        if first or not entry.waiting:
            (ring.appendleft if first else ring.append)(entry.job)
        entry.waiting = True
