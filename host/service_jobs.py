"""The jobs of a service: the schedule in memory and the journal on disk, kept in step. No socket and no array in here."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from raygrid.host.journal import JobRow, Journal
from raygrid.host.requests import Submit, read_job
from raygrid.host.schedule import Entry, Schedule, State
from raygrid.node.errors import OutputError, ProtocolError, RaygridError

MOST_JOBS = 10_000  # that have not ended
MOST_QUEUED = 1_000_000  # frames of them all


class Jobs:
    """All jobs of an array.

    schedule  those that have not ended
    trouble   why the journal cannot be written; "" if it can
    """

    def __init__(self, journal: Journal) -> None:
        """Take up the jobs of the journal that have not ended. Raises OutputError."""
        self.journal, self.schedule, self.trouble = journal, Schedule(), ""
        self._requests: dict[int, Submit] = {}
        self._unrecorded: deque[Callable[[], None]] = deque()
        for row in journal.unfinished():
            try:
                self._take_up(row)
            except ProtocolError as error:
                journal.set_state(row.job, State.FAILED, str(error))

    def _take_up(self, row: JobRow) -> None:
        request = read_job(row.request)
        done = self.journal.frames_done(row.job)
        first, last = request.frames or (0, 0)
        left = [frame for frame in range(first, last + 1) if frame not in done]
        entry = self.schedule.add(row.job, row.client, left, last - first + 1)
        self._requests[row.job] = request
        entry.skipped = row.skipped
        if not left:
            self._end(entry, State.DONE)

    def submit(self, request: Submit) -> Entry:
        """Queue a job. Raises OutputError if it cannot be recorded, RaygridError if there are too many."""
        if len(self.schedule.entries) >= MOST_JOBS:
            raise RaygridError(f"{MOST_JOBS} jobs are queued already, wanted fewer")
        first, last = request.frames or (0, 0)
        if self.schedule.frames_queued + last - first + 1 > MOST_QUEUED:
            raise RaygridError(
                f"{self.schedule.frames_queued:,} frames are queued already, wanted at most {MOST_QUEUED:,}"
            )
        self._flush()
        job = self.journal.add(request.client, request.model_dump(mode="json"))
        self._requests[job] = request
        return self.schedule.add(job, request.client, range(first, last + 1), last - first + 1)

    def request(self, job: int) -> Submit:
        """What was asked for, of a job that has not ended."""
        return self._requests[job]

    def begun(self, entry: Entry) -> None:
        """A frame of the job is with the array."""
        if entry.done == 0:
            self._record(lambda: self.journal.set_state(entry.job, State.RUNNING))

    def frame_done(self, entry: Entry, skipped: bool, seconds: float, files: dict[str, str]) -> None:
        """The running frame's files are there; ends the job if it was the last."""
        job, frame = entry.job, entry.running or 0
        self.schedule.finish(entry, skipped)
        self._record(lambda: self.journal.frame_done(job, frame, skipped, seconds, files))
        if entry.ended:
            self._end(entry, State.DONE)

    def fail(self, entry: Entry, why: str) -> None:
        """The job has failed."""
        self._end(entry, State.FAILED, why)

    def cancel(self, entry: Entry) -> None:
        """The job is not wanted any more."""
        self._end(entry, State.CANCELLED)

    def _end(self, entry: Entry, state: State, error: str = "") -> None:
        self.schedule.end(entry, state, error)
        self._requests.pop(entry.job, None)
        self._record(lambda: self.journal.set_state(entry.job, state, error))

    def _record(self, change: Callable[[], None]) -> None:
        """Write to the journal now, or when that is possible again: the array goes on without."""
        self._unrecorded.append(change)
        self._flush()

    def _flush(self) -> None:
        try:
            while self._unrecorded:
                self._unrecorded[0]()
                self._unrecorded.popleft()
            self.trouble = ""
        except OutputError as error:
            self.trouble = str(error)

    def facts(self, job: int) -> dict[str, Any] | None:
        """What there is to say of a job; None if there is no such job."""
        entry = self.schedule.entries.get(job)
        if entry is not None:
            return self._facts(entry)
        row = self.journal.find(job)
        return None if row is None else _row_facts(row)

    def list(self, ended: int) -> list[dict[str, Any]]:
        """The last `ended` jobs that have ended, then those that have not, each oldest first. Raises OutputError."""
        rows = [_row_facts(row) for row in self.journal.ended(ended)] if ended else []
        return rows + [self._facts(entry) for _, entry in sorted(self.schedule.entries.items())]

    def _facts(self, entry: Entry) -> dict[str, Any]:
        done = entry.done, entry.skipped
        return _facts(entry.job, entry.state, entry.client, self._requests[entry.job], *done, entry.error)

    def counts(self) -> dict[str, int]:
        """Jobs of the journal by state; none if it cannot be read."""
        try:
            return self.journal.counts()
        except OutputError:
            return {}

    def close(self) -> None:
        """Write what can be written, and close the journal."""
        self._flush()
        self.journal.close()


def _row_facts(row: JobRow) -> dict[str, Any]:
    request = Submit.model_construct(**row.request)
    return _facts(row.job, row.state, row.client, request, row.done, row.skipped, row.error)


def _facts(job: int, state: str, client: str, request: Submit, done: int, skipped: int, error: str) -> dict[str, Any]:
    """
    job, state, client  its number, what it is doing, whose it is
    scene, outputs      as submitted
    first, last         its frames; None if it names none
    frames, done        how many there are, and are done; `skipped` of them were there already
    error               why it failed
    """
    first, last = request.frames or (None, None)
    return {
        "job": job,
        "state": str(state),
        "client": client,
        "scene": request.scene,
        "outputs": list(request.outputs),
        "first": first,
        "last": last,
        "frames": 1 if first is None or last is None else last - first + 1,
        "done": done,
        "skipped": skipped,
        "error": error,
    }
