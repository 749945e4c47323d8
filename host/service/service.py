"""The service of an array that stays: one process an array (`service_process`). docs/service.md describes it.

The main thread answers clients, keeps the schedule and writes the journal, and never waits for the array; a thread of
its own drives that (`worker`), so status, cancel and down are answered at once whatever a frame does.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import sys
import time
from collections import Counter, deque
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

from raygrid.emulator.topology import SocketDirectory, process_mark
from raygrid.host.client.service_files import Home, LockTaken, ServiceRecord
from raygrid.host.service.worker import Event, Options, Task, Worker
from raygrid.host.text.clean_text import printable
from raygrid.host.text.error_text import told
from raygrid.node.errors import ArrayError

if TYPE_CHECKING:
    from raygrid.host.client.protocol import Message
    from raygrid.host.service.schedule import Entry

END_SECONDS = 30.0  # for the array to end; then its processes see that the service is gone
SAMPLE_SECONDS = 2.0
LOOK_SECONDS = 1.0  # between two looks at whether lock, record, journal and door are still there
SHORT_SECONDS = 2.0  # a frame that will be done sooner than this is not given up for another one
ENDS_TASK = ("done", "failed", "interrupted")
FAULTS_KEPT = 20
ENDING = {signal.SIGTERM, signal.SIGINT, signal.SIGHUP}


class ArrayService:
    """One array that stays, its jobs and its clients.

    state, why   launching, ready, broken and why, ending; `finishing`: takes no more jobs and ends after the last
    task, entry  the frame that is with the array, and its job; None: none
    now          how far it is: phase, part, in_flight
    counts       frames done, skipped, failed; resets
    faults       the last ones; `fault_count`: how many there were
    resets       who waits for a reset
    prometheus   port at which its figures are served, None for none; to be set before it runs
    """

    def __init__(self, home: Home, options: Options, place: SocketDirectory, tell: Any) -> None:
        from raygrid.host.journal.repair import open_journal
        from raygrid.host.service.answers import Answers
        from raygrid.host.service.jobs import Jobs
        from raygrid.host.service.listener import Listener
        from raygrid.host.service.node_samples import Samples

        self.name, self.options, self._tell = home.name, options, tell
        self._home, self._place = home, place
        self._loop = asyncio.get_running_loop()
        self.worker = Worker(options, self._post)
        self.worker.start()  # first of all: the fork server warms up while the rest is made ready
        self.jobs = Jobs(*open_journal(options.journal), home.keep)
        self.answers = Answers(self)
        self.door = Listener(place.path, self.answers.answer)
        self.samples = Samples()
        self.prometheus: int | None = None
        self.state, self.why = "launching", ""
        self.task: Task | None = None
        self.entry: Entry | None = None
        self.now: dict[str, Any] = {}
        self._serial = 0
        self._given = 0.0  # when the task was given to the array
        self._yielded = 0  # serial of the last task that was given up for a higher priority
        self.started = time.time()
        self.counts: Counter[str] = Counter(dict.fromkeys(("done", "skipped", "failed", "resets"), 0))
        self.faults: deque[dict[str, Any]] = deque(maxlen=FAULTS_KEPT)
        self.fault_count = 0
        self.resets: list[asyncio.Future[None]] = []
        self.finishing = False
        self._over = asyncio.Event()
        self._launched = False
        self._record: ServiceRecord | None = None

    async def run(self) -> int:
        """Serve until told to end; returns the exit code."""
        for number in ENDING:
            self._loop.add_signal_handler(number, self.end)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)
        try:
            await self.door.open()
        except BaseException:
            await self._close()
            raise
        tasks = [asyncio.create_task(self._sample()), asyncio.create_task(self._look_after())]
        try:
            await self._over.wait()
        finally:
            for task in tasks:
                task.cancel()
            await self._close()
        return 0 if self._launched else 1

    async def _close(self) -> None:
        self._home.forget(self._record)
        for entry in list(self.jobs.schedule.entries.values()):
            words = "the array was taken down; the job goes on when it is up again"
            self.tell_followers(entry.job, {"what": "end", "state": "queued", "error": words})
        self.jobs.close()
        await self.door.close()
        self._place.remove()

    async def _sample(self) -> None:
        while True:
            self.samples.take(self.worker.supervisor.pids)
            await asyncio.sleep(SAMPLE_SECONDS)

    async def _look_after(self) -> None:
        """Make anew what somebody has removed that takes all to be litter: directory, lock, record, journal, door."""
        while True:
            await asyncio.sleep(LOOK_SECONDS)
            try:
                self._home.keep()
            except LockTaken as error:  # by another service: it has our journal, and the jobs in it
                self.note_fault(f"{error}; this one ends", None)
                self.end()
                return
            except (OSError, ArrayError) as error:
                print(f"the state directory cannot be made anew: {error}", file=sys.stderr, flush=True)
            try:
                await self._keep_door()
                if self._record is not None:
                    self._home.keep_record(self._record)
            except (OSError, ArrayError) as error:
                print(f"the door cannot be made anew: {error}", file=sys.stderr, flush=True)
            self.jobs.look_after()

    async def _keep_door(self) -> None:
        """Let clients come, wherever that can be. Raises OSError, ArrayError."""
        there = self._place.keep()
        if there and self.door.is_sound():
            return
        if not there:
            self._place = SocketDirectory.create((1, 1, 1))
        await self.door.open(self._place.path)
        if self._record is not None:
            self._record = replace(self._record, directory=self._place.path)

    # --- events of the array --------------------------------------------------------------------------

    def _post(self, event: Event) -> None:
        """Called by the worker's thread."""
        with contextlib.suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(self._hear, event)

    def _hear(self, event: Event) -> None:
        """Take in an event. Whatever goes wrong with it, the array goes on with what is next."""
        try:
            getattr(self, f"_hear_{event.kind}")(event)
        except Exception as error:
            self.note_fault(told(error), event.task)
        finally:
            if event.kind in ENDS_TASK:
                self.next()

    def _hear_warming(self, event: Event) -> None:
        self._report({"is": "warming", **event.facts})

    def _hear_ready(self, event: Event) -> None:
        if self.state == "ending":
            return
        self.state, self.why = "ready", ""
        if not self._launched:
            self._launched = True
            mark = process_mark(os.getpid()) or ""
            self._record = ServiceRecord(
                self.name, os.getpid(), mark, self._place.path, self.options.shape, self.started
            )
            try:
                self._home.keep_record(self._record)
            except OSError as error:
                self._report({"is": "error", "error": f"{self._home.directory}: {error.strerror or error}"})
                self._launched = False
                self.end()
                return
            said = {
                "unfinished": len(self.jobs.schedule.entries),
                "remarks": list(self.jobs.remarks),
                "prometheus": self.prometheus,
            }
            self._report({"is": "ready", "pid": os.getpid(), "nodes": event.facts["pids"], **said})
            self._tell.close()
        self.samples.take(event.facts["pids"])
        self.next()

    def _hear_broken(self, event: Event) -> None:
        if self.state == "ending":
            return
        self.state, self.why = "broken", event.facts["why"]
        self.note_fault(event.facts["why"], event.task)
        if not self._launched:
            self._report({"is": "error", "error": event.facts["why"]})
            self.end()

    def _hear_begun(self, event: Event) -> None:
        assert event.task is not None
        self.now = {"phase": "read", "part": 0.0, "in_flight": 0}

    def _hear_moved(self, event: Event) -> None:
        assert event.task is not None
        self.now = event.facts
        if self.entry is not None and not self.entry.ended:
            about = {
                "what": "progress",
                "frame": event.task.frame,
                "done": self.entry.done,
                "frames": self.entry.total,
            }
            self.tell_followers(event.task.job, {**about, **event.facts}, droppable=True)

    def _hear_note(self, event: Event) -> None:
        assert event.task is not None
        self.tell_followers(event.task.job, {"what": "note", "text": event.facts["text"]})

    def _hear_fault(self, event: Event) -> None:
        self.note_fault(event.facts["what"], event.task)
        if event.task is not None:
            self.tell_followers(event.task.job, {"what": "fault", "text": event.facts["what"]})

    def _hear_done(self, event: Event) -> None:
        entry, task = self._settle(event)
        facts = event.facts
        self.counts["skipped" if facts["skipped"] else "done"] += 1
        if not entry.ended:
            seconds = facts["seconds"].get("whole", 0.0)
            self.jobs.frame_done(entry, facts["skipped"], seconds, facts["files"] | facts["played"])
            about = {"frame": task.frame, "files": list(facts["files"]), "skipped": facts["skipped"]}
            about["played"] = list(facts["played"])
            self.tell_followers(entry.job, {"what": "frame", **about, "seconds": facts["seconds"]})
            self.tell_end(entry)

    def _hear_failed(self, event: Event) -> None:
        entry, task = self._settle(event)
        self.counts["failed"] += 1
        if not entry.ended:
            where = "" if task.frame is None else f"frame {task.frame}: "
            self.jobs.fail(entry, where + event.facts["why"])
            self.tell_end(entry)

    def _hear_interrupted(self, event: Event) -> None:
        entry, _ = self._settle(event)
        if not entry.ended:
            self.jobs.schedule.put_back(entry)

    def _hear_reset(self, event: Event) -> None:
        self.counts["resets"] += 1
        for waiting in self.resets:
            if not waiting.done():
                waiting.set_result(None)
        self.resets.clear()

    def _hear_sample(self, event: Event) -> None:
        told: Message | None = None
        for client in self.door.clients:
            if client.rate:
                told = told or {"is": "event", "what": "sample", "sample": asdict(event.facts["sample"])}
                client.send(told, droppable=True)
        self.set_rate()  # a client may have left

    def set_rate(self) -> None:
        """Probe the array as often as the client wants that wants it most."""
        self.worker.supervisor.rate = max((client.rate for client in self.door.clients), default=0.0)

    def _hear_ended(self, event: Event) -> None:
        self._over.set()

    def _settle(self, event: Event) -> tuple[Entry, Task]:
        """The task of an event is under way no more."""
        entry, task = self.entry, event.task
        assert entry is not None
        assert task is not None
        self.entry = self.task = None
        self.now = {}
        return entry, task

    def next(self) -> None:
        """Give the array its next frame, if there is one: when it has none, or its own is to be given up for it."""
        if self.state != "ready":
            return
        if self.task is not None:
            self._yield()
            return
        found = self.jobs.schedule.next()
        if found is None:
            if self.finishing:
                self.end()
            return
        entry, frame = found
        request = self.jobs.request(entry.job)
        self._serial += 1
        number = None if request.frames is None else frame
        self.task = Task(self._serial, entry.job, number, request, last=not entry.todo)
        self.entry, self._given = entry, time.monotonic()
        self.jobs.begun(entry)
        self.worker.give(self.task)

    def _yield(self) -> None:
        """Give the running frame up, to be begun again later, if a higher priority waits and it would take long."""
        entry, task = self.entry, self.task
        if entry is None or task is None or entry.ended or self._yielded == task.serial:
            return
        part = self.now.get("part", 0.0) if self.now.get("phase") in ("trace", "collect", "write") else 0.0
        spent = time.monotonic() - self._given
        if part and spent * (1.0 - part) / part < SHORT_SECONDS:
            return
        if self.jobs.schedule.should_yield(entry):
            entry.yields += 1
            self._yielded = task.serial
            self.worker.interrupt(task)
            where = "the frame" if task.frame is None else f"frame {task.frame}"
            text = f"{where} was given up for a job of higher priority, and is begun again after it"
            self.tell_followers(entry.job, {"what": "note", "text": text})

    # --- telling --------------------------------------------------------------------------------------

    def _report(self, message: Message) -> None:
        """A line to `raygrid up`, which waits; without it there is nobody to launch for."""
        try:
            self._tell.write((json.dumps(message) + "\n").encode())
            self._tell.flush()
        except ValueError:  # it has heard that the array is ready, and closed
            pass
        except OSError:
            self.end()

    def note_fault(self, what: str, task: Task | None) -> None:
        """Remember a fault, and write it to the log."""
        what = printable(what)
        self.fault_count += 1
        where = {} if task is None else {"job": task.job, "frame": task.frame}
        self.faults.append({"at": time.time(), "what": what, **where})
        print(f"{time.strftime('%Y-%m-%d %H:%M:%S')} fault: {what}", file=sys.stderr, flush=True)

    def tell_followers(self, job: int, event: Message, droppable: bool = False) -> None:
        """Tell all that follow a job of an event."""
        for client in self.door.clients:
            if job in client.follows:
                client.send({"is": "event", "job": job, **event}, droppable)
                if event["what"] == "end":
                    client.follows.discard(job)

    def tell_end(self, entry: Entry) -> None:
        """Tell all that follow a job that it has ended, if it has."""
        if entry.ended:
            about = {"state": str(entry.state), "error": entry.error, "done": entry.done, "skipped": entry.skipped}
            self.tell_followers(entry.job, {"what": "end", **about, "frames": entry.total})

    # --- the end --------------------------------------------------------------------------------------

    def end(self) -> None:
        """Give up the running frame, which stays in the journal, and end."""
        if self.state == "ending":
            return
        self.state = "ending"
        self.worker.ask_end()
        self._loop.call_later(END_SECONDS, self._give_up)

    def _give_up(self) -> None:
        print(f"the array did not end within {END_SECONDS:g} seconds", file=sys.stderr, flush=True)
        self._over.set()
