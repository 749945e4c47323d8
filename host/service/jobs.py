"""Keeps the jobs of a service: schedule in memory and journal on disk, in step. No socket and no array in here.

A job is told of from memory until the journal has taken its end in: the journal of a full disk says for ever that it runs.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable
from typing import NamedTuple

from raygrid.host.client.facts import ENDED, JobFacts
from raygrid.host.client.requests import SubmitMessage, read_job
from raygrid.host.journal.facts import row_facts
from raygrid.host.journal.journal import Damaged, JobRow, Journal, Unwritable
from raygrid.host.journal.repair import open_again
from raygrid.host.service.job_facts import entry_facts
from raygrid.host.service.schedule import Entry, JobState, Schedule
from raygrid.host.text.clean_text import printable
from raygrid.host.text.log import log
from raygrid.node.errors import OutputError, ProtocolError, RaygridError

MOST_UNFINISHED = 10_000  # that have not ended
MOST_QUEUED = 1_000_000  # frames of them all
MOST_REMARKS = 20


class Unrecorded(NamedTuple):
    """A change that is to be written to the journal, and of which job."""

    job: int
    write: Callable[[Journal], object]


class Jobs:
    """All jobs of an array.

    schedule  those that have not ended
    trouble   why the journal cannot be written; "" if it can
    remarks   the last on what was wrong with the journal and has been mended
    """

    def __init__(
        self, journal: Journal, remarks: list[str] | None = None, keep_place: Callable[[], None] = lambda: None
    ) -> None:
        """Take up the jobs of the journal that have not ended. Raises OutputError.

        keep_place  sees to it that the journal's directory is there and ours alone; raises RaygridError if it is not
        """
        self.journal, self.schedule, self.trouble = journal, Schedule(), ""
        self.remarks: deque[str] = deque(maxlen=MOST_REMARKS)
        self._keep_place = keep_place
        self._requests: dict[int, SubmitMessage] = {}
        self._unrecorded: deque[Unrecorded] = deque()
        self._ended: dict[int, JobRow] = {}  # jobs that have ended, of which the journal does not know that
        self._last = 0  # the highest number of a job
        self._in_part = False  # whether the journal was made anew and lacks jobs that have not ended
        self._remark(*(remarks or ()))
        for row in journal.unfinished():
            try:
                self._take_up(row)
            except ProtocolError as error:
                self._record_end(row._replace(ended=time.time(), state=str(JobState.FAILED), error=str(error)))
        self._hear_journal()

    def _take_up(self, row: JobRow) -> None:
        request = read_job(row.request)
        done = self.journal.frames_done(row.job)
        first, last = request.frames or (0, 0)
        left = [frame for frame in range(first, last + 1) if frame not in done]
        entry = self.schedule.add(row.job, row.client, left, last - first + 1, request.priority)
        entry.submitted, entry.begun = row.submitted, row.begun
        self._requests[row.job] = request
        self._last = max(self._last, row.job)
        entry.skipped = row.skipped
        if not left:
            self._end(entry, JobState.DONE)

    def submit(self, request: SubmitMessage) -> Entry:
        """Queue a job. Raises OutputError if it cannot be recorded, RaygridError if there are too many."""
        if len(self.schedule.entries) >= MOST_UNFINISHED:
            raise RaygridError(f"{MOST_UNFINISHED} jobs are queued already, wanted fewer")
        first, last = request.frames or (0, 0)
        if self.schedule.frames_queued + last - first + 1 > MOST_QUEUED:
            raise RaygridError(
                f"{self.schedule.frames_queued:,} frames are queued already, wanted at most {MOST_QUEUED:,}"
            )
        self.flush()
        if self.trouble:
            raise OutputError(self.trouble)
        now = time.time()
        job = self.journal.add(request.client, request.model_dump(mode="json"), now)
        self._last = max(self._last, job)
        self._requests[job] = request
        entry = self.schedule.add(job, request.client, range(first, last + 1), last - first + 1, request.priority)
        entry.submitted = now
        return entry

    def request(self, job: int) -> SubmitMessage:
        """What was asked for, of a job that has not ended."""
        return self._requests[job]

    def begun(self, entry: Entry) -> None:
        """A frame of the job is with the array."""
        if entry.begun is None:
            entry.begun = time.time()
        if entry.done == 0:
            job, at = entry.job, entry.begun
            self._record(job, lambda to: to.set_state(job, JobState.RUNNING, at=at))

    def frame_done(self, entry: Entry, skipped: bool, seconds: float, files: dict[str, str]) -> None:
        """The running frame's files are there; ends the job if it was the last."""
        job, frame = entry.job, entry.running or 0
        self.schedule.finish(entry, skipped)
        self._unrecorded.append(Unrecorded(job, lambda to: to.frame_done(job, frame, skipped, seconds, files)))
        if entry.ended:
            self._end(entry, JobState.DONE)
        else:
            self.flush()

    def fail(self, entry: Entry, why: str) -> None:
        """The job has failed."""
        self._end(entry, JobState.FAILED, printable(why))

    def cancel(self, entry: Entry) -> None:
        """The job is not wanted any more."""
        self._end(entry, JobState.CANCELLED)

    def _end(self, entry: Entry, state: JobState, error: str = "") -> None:
        self.schedule.end(entry, state, error)
        self._record_end(_row_of(entry, self._requests.pop(entry.job))._replace(ended=time.time()))

    # --- the journal ----------------------------------------------------------------------------------

    def _record_end(self, row: JobRow) -> None:
        """Record that a job has ended as this row says, and tell of it from the row until that is written."""
        self._ended[row.job] = row

        def write(journal: Journal) -> None:
            if journal.set_state(row.job, row.state, row.error, row.ended):  # one made anew does not have it
                self._ended.pop(row.job, None)

        self._record(row.job, write)

    def _record(self, job: int, write: Callable[[Journal], object]) -> None:
        """Write to the journal now, or when that is possible again: the array goes on without."""
        self._unrecorded.append(Unrecorded(job, write))
        self.flush()

    def flush(self) -> None:
        """See to it that the journal is there, and write what is to be written, oldest first; to be called now and then, too.

        What can never be written is left out, and keeps nothing else back.
        """
        try:
            self._keep_place()
            if self._in_part or not self.journal.there:
                self._renew(f"{self.journal.path}: the journal was removed or replaced, and was made anew")
            while self._unrecorded:
                self._write(self._unrecorded[0])
                self._unrecorded.popleft()
            self.trouble = ""
        except (RaygridError, OSError) as error:
            self.trouble = str(error)

    def _write(self, record: Unrecorded) -> None:
        """Write one record. Raises OutputError if the disk cannot be written."""
        try:
            try:
                record.write(self.journal)
            except Damaged as error:
                self._renew(str(error))
                record.write(self.journal)
        except Damaged:
            raise
        except (Unwritable, ArithmeticError, LookupError, TypeError, ValueError) as error:
            self._remark(f"of job {record.job} something could not be recorded: {printable(str(error), 300)}")

    def _renew(self, why: str) -> None:
        """Open the journal anew, and record all jobs that have not ended. Raises OutputError."""
        self._in_part = True
        self.journal, remarks = open_again(self.journal)
        for entry in self.schedule.entries.values():
            request = self._requests[entry.job]
            first, last = request.frames or (0, 0)
            left = {*entry.todo, entry.running}
            done = [(frame, 0, 0.0) for frame in range(first, last + 1) if frame not in left]
            self.journal.restore(_row_of(entry, request), done, self._last)
        self.journal.skip_to(self._last)
        self._in_part = False
        self._remark(*(remarks or [why]))

    def _remark(self, *remarks: str) -> None:
        for text in remarks:
            self.remarks.append(text)
            log(f"journal: {printable(text)}")

    def _hear_journal(self) -> None:
        """Take over what the journal has to say of its rows."""
        self._remark(*self.journal.remarks)
        self.journal.remarks.clear()

    # --- facts ----------------------------------------------------------------------------------------

    def facts(self, job: int) -> JobFacts | None:
        """What there is to say of a job; None if there is no such job."""
        entry = self.schedule.entries.get(job)
        if entry is not None:
            return entry_facts(entry, self._requests[job])
        row = self._ended.get(job) or self.journal.find(job)
        self._hear_journal()
        return None if row is None else row_facts(row)

    def list(self, ended: int) -> list[JobFacts]:
        """The last `ended` jobs that have ended, then those that have not, each oldest first. Raises OutputError."""
        rows = {row.job: row for row in self.journal.ended(ended)} | self._ended if ended else {}
        self._hear_journal()
        last = [row_facts(rows[job]) for job in sorted(rows)[-ended:]]
        entries = sorted(self.schedule.entries.items())
        return last + [entry_facts(entry, self._requests[job]) for job, entry in entries]

    def counts(self) -> dict[str, int]:
        """Jobs by state: those that have ended of the journal and of memory, the others of the schedule; none if the
        journal cannot be read."""
        try:
            kept = self.journal.counts()
        except OutputError:
            return {}
        counts = Counter({state: count for state, count in kept.items() if state in ENDED})
        counts.update(str(entry.state) for entry in self.schedule.entries.values())
        counts.update(row.state for row in self._ended.values())
        return dict(sorted(counts.items()))

    def close(self) -> None:
        """Write what can be written, and close the journal."""
        self.flush()
        self.journal.close()


def _row_of(entry: Entry, request: SubmitMessage) -> JobRow:
    """The row of a job of the schedule as it is now."""
    times = entry.submitted, entry.begun, None
    asked = request.model_dump(mode="json")
    return JobRow(entry.job, entry.client, asked, *times, str(entry.state), entry.error, entry.done, entry.skipped)
