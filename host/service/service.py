"""Runs the service of an array that stays: takes events of the array in, and gives it the frame that is next.

One process an array (`process`); docs/service.md describes it. The main thread answers clients, keeps the schedule and
writes the journal, and never waits for the array; a thread of its own drives that (`worker`), so status, cancel and down
are answered at once whatever a frame does.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import time
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, BinaryIO, assert_never

from raygrid.emulator.topology import SocketDirectory, process_mark
from raygrid.host.client.service_files import Home, LockTaken, ServiceRecord
from raygrid.host.service import events
from raygrid.host.service.state import ServiceState
from raygrid.host.service.worker import Worker
from raygrid.host.text.error_text import told
from raygrid.host.text.log import log
from raygrid.node.errors import ArrayError

if TYPE_CHECKING:
    from raygrid.host.client.protocol import Message
    from raygrid.host.service.schedule import Entry

END_SECONDS = 30.0  # for the array to end; then its processes see that the service is gone
SAMPLE_SECONDS = 2.0
LOOK_SECONDS = 1.0  # between two looks at whether lock, record, journal and listener are still there
SHORT_SECONDS = 2.0  # a frame that will be done sooner than this is not given up for another one
ENDING = {signal.SIGTERM, signal.SIGINT, signal.SIGHUP}


class ArrayService:
    """One array that stays, its jobs and its clients.

    state        how it stands
    resets       who waits for a reset
    """

    def __init__(self, home: Home, options: events.Options, place: SocketDirectory, tell: BinaryIO) -> None:
        from raygrid.host.journal.repair import open_journal
        from raygrid.host.service.answers import Answers
        from raygrid.host.service.jobs import Jobs
        from raygrid.host.service.listener import Listener
        from raygrid.host.service.node_samples import Samples

        self.state, self._tell = ServiceState(home.name, options), tell
        self._home, self._place = home, place
        self._loop = asyncio.get_running_loop()
        self.worker = Worker(options, self._post)
        self.worker.start()  # first of all: the fork server warms up while the rest is made ready
        self.jobs = Jobs(*open_journal(options.journal), home.keep)
        self.answers = Answers(self)
        self.listener = Listener(place.path, self.answers.answer)
        self.samples = Samples()
        self._serial = 0
        self._given = 0.0  # when the task was given to the array
        self._yielded = 0  # serial of the last task that was given up for a higher priority
        self.resets: list[asyncio.Future[None]] = []
        self._over = asyncio.Event()
        self._launched = False
        self._record: ServiceRecord | None = None

    async def run(self) -> int:
        """Serve until told to end; returns the exit code."""
        for number in ENDING:
            self._loop.add_signal_handler(number, self.end)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)
        try:
            await self.listener.open()
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
        await self.listener.close()
        self._place.remove()

    async def _sample(self) -> None:
        while True:
            self.samples.take(self.worker.supervisor.pids)
            await asyncio.sleep(SAMPLE_SECONDS)

    async def _look_after(self) -> None:
        """Make anew what somebody has removed that takes all to be litter: directory, lock, record, journal, listener."""
        while True:
            await asyncio.sleep(LOOK_SECONDS)
            try:
                self._home.keep()
            except LockTaken as error:  # by another service: it has our journal, and the jobs in it
                self.state.note_fault(f"{error}; this one ends", None)
                self.end()
                return
            except (OSError, ArrayError) as error:
                log(f"the state directory cannot be made anew: {error}")
            try:
                await self._keep_listening()
                if self._record is not None:
                    self._home.keep_record(self._record)
            except (OSError, ArrayError) as error:
                log(f"the door cannot be made anew: {error}")
            self.jobs.flush()

    async def _keep_listening(self) -> None:
        """Let clients come, wherever that can be. Raises OSError, ArrayError."""
        there = self._place.keep()
        if there and self.listener.is_sound():
            return
        if not there:
            self._place = SocketDirectory.create((1, 1, 1))
        await self.listener.open(self._place.path)
        if self._record is not None:
            self._record = replace(self._record, directory=self._place.path)

    # --- events of the array --------------------------------------------------------------------------

    def _post(self, event: events.Event) -> None:
        """Called by the worker's thread."""
        with contextlib.suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(self._hear, event)

    def _hear(self, event: events.Event) -> None:
        """Take in an event. Whatever goes wrong with it, the array goes on with what is next."""
        try:
            self._take(event)
        except Exception as error:
            self.state.note_fault(told(error), getattr(event, "task", None))
        finally:
            if isinstance(event, events.TaskEnd):
                self.next()

    def _take(self, event: events.Event) -> None:
        match event:
            case events.KernelsWarming():
                self._report({"is": "warming", **asdict(event)})
            case events.ArrayReady():
                self._array_ready(event)
            case events.ArrayBroken():
                self._array_broken(event)
            case events.ArrayRepaired(fault, task):
                self.state.note_fault(fault, task)
                if task is not None:
                    self.tell_followers(task.job, {"what": "fault", "text": fault})
            case events.ArrayReset():
                self._array_reset()
            case events.NodeSampled():
                self._node_sampled(event)
            case events.ArrayEnded():
                self._over.set()
            case events.FrameBegun(task):
                self.state.moved = events.FrameMoved(task)
            case events.SceneRemarked(task, text):
                self.tell_followers(task.job, {"what": "note", "text": text})
            case events.FrameMoved():
                self._frame_moved(event)
            case events.FrameDone() | events.FrameFailed() | events.FrameInterrupted():
                self._frame_ended(event)
            case _:
                assert_never(event)

    def _array_ready(self, event: events.ArrayReady) -> None:
        state = self.state
        if state.condition == "ending":
            return
        state.condition, state.why = "ready", ""
        if not self._launched:
            self._launched = True
            pid, mark = os.getpid(), process_mark(os.getpid()) or ""
            self._record = ServiceRecord(state.name, pid, mark, self._place.path, state.options.shape, state.started)
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
                "prometheus": state.prometheus,
            }
            self._report({"is": "ready", "pid": pid, "nodes": event.pids, **said})
            self._tell.close()
        self.samples.take(event.pids)
        self.next()

    def _array_broken(self, event: events.ArrayBroken) -> None:
        if self.state.condition == "ending":
            return
        self.state.condition, self.state.why = "broken", event.why
        self.state.note_fault(event.why, event.task)
        if not self._launched:
            self._report({"is": "error", "error": event.why})
            self.end()

    def _array_reset(self) -> None:
        self.state.counts["resets"] += 1
        for waiting in self.resets:
            if not waiting.done():
                waiting.set_result(None)
        self.resets.clear()

    def _node_sampled(self, event: events.NodeSampled) -> None:
        message: Message | None = None
        for client in self.listener.clients:
            if client.rate:
                message = message or {"is": "event", "what": "sample", "sample": asdict(event.sample)}
                client.send(message, droppable=True)
        self.set_rate()  # a client may have left

    def set_rate(self) -> None:
        """Probe the array as often as the client wants that wants it most."""
        self.worker.supervisor.rate = max((client.rate for client in self.listener.clients), default=0.0)

    def _frame_moved(self, event: events.FrameMoved) -> None:
        self.state.moved, entry = event, self.state.entry
        if entry is not None and not entry.ended:
            about = {"what": "progress", "frame": event.task.frame, "done": entry.done, "frames": entry.total}
            self.tell_followers(event.task.job, {**about, **event.facts}, droppable=True)

    def _frame_ended(self, event: events.TaskEnd) -> None:
        """A frame is with the array no more; its job may have ended before."""
        entry, task, counts = self.state.entry, event.task, self.state.counts
        assert entry is not None
        self.state.settle()
        match event:
            case events.FrameDone(task, files, played, skipped, seconds):
                counts["skipped" if skipped else "done"] += 1
                if not entry.ended:
                    self.jobs.frame_done(entry, skipped, seconds.get("whole", 0.0), files | played)
                    about = {"frame": task.frame, "files": list(files), "skipped": skipped, "played": list(played)}
                    self.tell_followers(entry.job, {"what": "frame", **about, "seconds": seconds})
                    self.tell_end(entry)
            case events.FrameFailed(task, why):
                counts["failed"] += 1
                if not entry.ended:
                    where = "" if task.frame is None else f"frame {task.frame}: "
                    self.jobs.fail(entry, where + why)
                    self.tell_end(entry)
            case events.FrameInterrupted() if not entry.ended:
                self.jobs.schedule.put_back(entry)

    def next(self) -> None:
        """Give the array its next frame, if there is one: when it has none, or its own is to be given up for it."""
        state = self.state
        if state.condition != "ready":
            return
        if state.task is not None:
            self._yield()
            return
        found = self.jobs.schedule.next()
        if found is None:
            if state.finishing:
                self.end()
            return
        entry, frame = found
        self.jobs.begun(entry)  # first: what is set below says that the array has it
        request = self.jobs.request(entry.job)
        self._serial += 1
        number = None if request.frames is None else frame
        state.task = events.Task(self._serial, entry.job, number, request, last=not entry.todo)
        state.entry, self._given = entry, time.monotonic()
        self.worker.give(state.task)

    def _yield(self) -> None:
        """Give the running frame up, to be begun again later, if a higher priority waits and it would take long."""
        entry, task, moved = self.state.entry, self.state.task, self.state.moved
        if entry is None or task is None or entry.ended or self._yielded == task.serial:
            return
        part = moved.part if moved is not None and moved.phase in ("trace", "collect", "write") else 0.0
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

    def tell_followers(self, job: int, event: Message, droppable: bool = False) -> None:
        """Tell all that follow a job of an event."""
        for client in self.listener.clients:
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
        if self.state.condition == "ending":
            return
        self.state.condition = "ending"
        self.worker.ask_end()
        self._loop.call_later(END_SECONDS, self._give_up)

    def _give_up(self) -> None:
        log(f"the array did not end within {END_SECONDS:g} seconds")
        self._over.set()
