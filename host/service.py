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
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from raygrid.emulator.places import Place, process_mark
from raygrid.host.service_files import (
    RECORD,
    Record,
    write_record,
)
from raygrid.host.worker import Event, Options, Task, Worker
from raygrid.node.errors import ArrayError

if TYPE_CHECKING:
    from raygrid.host.requests import Cancel, Down, Follow, Probe, Request, Submit
    from raygrid.host.requests import Jobs as JobsRequest
    from raygrid.host.schedule import Entry
    from raygrid.host.service_door import Client
    from raygrid.host.wire import Message

END_SECONDS = 30.0  # for the array to end; then its processes see that the service is gone
SAMPLE_SECONDS = 2.0
FAULTS_KEPT = 20
RESET_SECONDS = 120.0
ENDING = {signal.SIGTERM, signal.SIGINT, signal.SIGHUP}


class Service:
    """One array that stays, its jobs and its clients."""

    def __init__(self, name: str, options: Options, place: Place, tell: Any) -> None:
        from raygrid.host.journal import Journal
        from raygrid.host.node_samples import Samples
        from raygrid.host.service_door import Door
        from raygrid.host.service_jobs import Jobs

        self._name, self._options, self._place, self._tell = name, options, place, tell
        self._directory = options.journal.parent
        self._loop = asyncio.get_running_loop()
        self._worker = Worker(options, self._post)
        self._worker.start()  # first of all: the nursery warms up while the rest is made ready
        self._jobs = Jobs(Journal(options.journal))
        self._door = Door(place.path, self._answer)
        self._samples = Samples()
        self._state, self._why = "launching", ""
        self._task: Task | None = None
        self._entry: Entry | None = None
        self._now: dict[str, Any] = {}
        self._serial = 0
        self._started = time.time()
        self._counts: Counter[str] = Counter(dict.fromkeys(("done", "skipped", "failed", "resets"), 0))
        self._faults: deque[dict[str, Any]] = deque(maxlen=FAULTS_KEPT)
        self._fault_count = 0
        self._resets: list[asyncio.Future[None]] = []
        self._finishing = False
        self._over = asyncio.Event()
        self._launched = False

    async def run(self) -> int:
        """Serve until told to end; returns the exit code."""
        for number in ENDING:
            self._loop.add_signal_handler(number, self._end)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)
        sampling = asyncio.create_task(self._sample())
        try:
            await self._door.open()
            await self._over.wait()
        finally:
            sampling.cancel()
            await self._close()
        return 0 if self._launched else 1

    async def _close(self) -> None:
        with contextlib.suppress(OSError):
            (self._directory / RECORD).unlink(missing_ok=True)
        for entry in list(self._jobs.schedule.entries.values()):
            words = "the array was taken down; the job goes on when it is up again"
            self._tell_followers(entry.job, {"what": "end", "state": "queued", "error": words})
        self._jobs.close()
        await self._door.close()

    async def _sample(self) -> None:
        while True:
            self._samples.take(self._worker.keeper.pids)
            await asyncio.sleep(SAMPLE_SECONDS)

    # --- events of the array --------------------------------------------------------------------------

    def _post(self, event: Event) -> None:
        """Called by the worker's thread."""
        with contextlib.suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(self._hear, event)

    def _hear(self, event: Event) -> None:
        getattr(self, f"_hear_{event.kind}")(event)

    def _hear_warming(self, event: Event) -> None:
        self._report({"is": "warming", **event.facts})

    def _hear_ready(self, event: Event) -> None:
        if self._state == "ending":
            return
        self._state, self._why = "ready", ""
        if not self._launched:
            self._launched = True
            mark = process_mark(os.getpid()) or ""
            record = Record(self._name, os.getpid(), mark, self._place.path, self._options.shape, self._started)
            try:
                write_record(self._directory, record)
            except OSError as error:
                self._report({"is": "error", "error": f"{self._directory}: {error.strerror or error}"})
                self._launched = False
                self._end()
                return
            unfinished = len(self._jobs.schedule.entries)
            self._report({"is": "ready", "pid": os.getpid(), "nodes": event.facts["pids"], "unfinished": unfinished})
            self._tell.close()
        self._samples.take(event.facts["pids"])
        self._next()

    def _hear_broken(self, event: Event) -> None:
        if self._state == "ending":
            return
        self._state, self._why = "broken", event.facts["why"]
        self._note_fault(event.facts["why"], event.task)
        if not self._launched:
            self._report({"is": "error", "error": event.facts["why"]})
            self._end()

    def _hear_begun(self, event: Event) -> None:
        assert event.task is not None
        self._now = {"phase": "read", "part": 0.0, "in_flight": 0}

    def _hear_moved(self, event: Event) -> None:
        assert event.task is not None
        self._now = event.facts
        if self._entry is not None and not self._entry.ended:
            about = {
                "what": "progress",
                "frame": event.task.frame,
                "done": self._entry.done,
                "frames": self._entry.total,
            }
            self._tell_followers(event.task.job, {**about, **event.facts}, droppable=True)

    def _hear_note(self, event: Event) -> None:
        assert event.task is not None
        self._tell_followers(event.task.job, {"what": "note", "text": event.facts["text"]})

    def _hear_fault(self, event: Event) -> None:
        self._note_fault(event.facts["what"], event.task)
        if event.task is not None:
            self._tell_followers(event.task.job, {"what": "fault", "text": event.facts["what"]})

    def _hear_done(self, event: Event) -> None:
        entry, task = self._settle(event)
        facts = event.facts
        self._counts["skipped" if facts["skipped"] else "done"] += 1
        if not entry.ended:
            seconds = facts["seconds"].get("whole", 0.0)
            self._jobs.frame_done(entry, facts["skipped"], seconds, facts["files"] | facts["played"])
            about = {"frame": task.frame, "files": list(facts["files"]), "skipped": facts["skipped"]}
            about["played"] = list(facts["played"])
            self._tell_followers(entry.job, {"what": "frame", **about, "seconds": facts["seconds"]})
            self._tell_end(entry)
        self._next()

    def _hear_failed(self, event: Event) -> None:
        entry, task = self._settle(event)
        self._counts["failed"] += 1
        if not entry.ended:
            where = "" if task.frame is None else f"frame {task.frame}: "
            self._jobs.fail(entry, where + event.facts["why"])
            self._tell_end(entry)
        self._next()

    def _hear_interrupted(self, event: Event) -> None:
        entry, _ = self._settle(event)
        if not entry.ended:
            self._jobs.schedule.put_back(entry)
        self._next()

    def _hear_reset(self, event: Event) -> None:
        self._counts["resets"] += 1
        for waiting in self._resets:
            if not waiting.done():
                waiting.set_result(None)
        self._resets.clear()

    def _hear_sample(self, event: Event) -> None:
        told: Message | None = None
        for client in self._door.clients:
            if client.rate:
                told = told or {"is": "event", "what": "sample", "sample": asdict(event.facts["sample"])}
                client.send(told, droppable=True)
        self._set_rate()  # a client may have left

    def _set_rate(self) -> None:
        self._worker.keeper.rate = max((client.rate for client in self._door.clients), default=0.0)

    def _hear_ended(self, event: Event) -> None:
        self._over.set()

    def _settle(self, event: Event) -> tuple[Entry, Task]:
        """The task of an event is under way no more."""
        entry, task = self._entry, event.task
        assert entry is not None
        assert task is not None
        self._entry = self._task = None
        self._now = {}
        return entry, task

    def _next(self) -> None:
        """Give the array its next frame, if it has none and there is one."""
        if self._task is not None or self._state != "ready":
            return
        found = self._jobs.schedule.next()
        if found is None:
            if self._finishing:
                self._end()
            return
        entry, frame = found
        request = self._jobs.request(entry.job)
        self._serial += 1
        number = None if request.frames is None else frame
        self._task = Task(self._serial, entry.job, number, request, last=not entry.todo)
        self._entry = entry
        self._jobs.begun(entry)
        self._worker.give(self._task)

    # --- telling --------------------------------------------------------------------------------------

    def _report(self, message: Message) -> None:
        """A line to `raygrid up`, which waits; without it there is nobody to launch for."""
        try:
            self._tell.write((json.dumps(message) + "\n").encode())
            self._tell.flush()
        except ValueError:  # it has heard that the array is ready, and closed
            pass
        except OSError:
            self._end()

    def _note_fault(self, what: str, task: Task | None) -> None:
        self._fault_count += 1
        where = {} if task is None else {"job": task.job, "frame": task.frame}
        self._faults.append({"at": time.time(), "what": what, **where})
        print(f"{time.strftime('%Y-%m-%d %H:%M:%S')} fault: {what}", file=sys.stderr, flush=True)

    def _tell_followers(self, job: int, event: Message, droppable: bool = False) -> None:
        for client in self._door.clients:
            if job in client.follows:
                client.send({"is": "event", "job": job, **event}, droppable)
                if event["what"] == "end":
                    client.follows.discard(job)

    def _tell_end(self, entry: Entry) -> None:
        if entry.ended:
            about = {"state": str(entry.state), "error": entry.error, "done": entry.done, "skipped": entry.skipped}
            self._tell_followers(entry.job, {"what": "end", **about, "frames": entry.total})

    # --- requests -------------------------------------------------------------------------------------

    async def _answer(self, client: Client, request: Request) -> Message:
        answer: Message = await getattr(self, f"_do_{request.do}")(client, request)
        return answer

    async def _do_submit(self, client: Client, request: Submit) -> Message:
        from raygrid.host.load import check_allowed

        if self._finishing or self._state == "ending":
            raise ArrayError(f"the array {self._name!r} is being taken down, and takes no more jobs")
        check_allowed(request.program, self._options.programs)
        entry = self._jobs.submit(request)
        if request.follow:
            client.follows.add(entry.job)
        self._loop.call_soon(self._next)  # after the answer
        return {"is": "submitted", "job": entry.job, "frames": entry.total}

    async def _do_follow(self, client: Client, request: Follow) -> Message:
        facts = self._facts(request.job)
        if request.job in self._jobs.schedule.entries:
            client.follows.add(request.job)
        return {"is": "following", **facts}

    def _facts(self, job: int) -> dict[str, Any]:
        facts = self._jobs.facts(job)
        if facts is None:
            raise ArrayError(f"the array {self._name!r} has no job {job}")
        return facts

    async def _do_cancel(self, client: Client, request: Cancel) -> Message:
        entries = self._jobs.schedule.entries
        wanted = list(entries) if request.jobs is None else request.jobs
        for job in wanted:
            self._facts(job)  # an unknown one: none is cancelled
        cancelled = [job for job in dict.fromkeys(wanted) if job in entries]
        for job in cancelled:
            self._cancel(entries[job])
        return {"is": "cancelled", "jobs": cancelled, "ended": [job for job in wanted if job not in cancelled]}

    def _cancel(self, entry: Entry) -> None:
        self._jobs.cancel(entry)
        if entry is self._entry and self._task is not None:
            self._worker.interrupt(self._task)
        self._tell_end(entry)

    async def _do_jobs(self, client: Client, request: JobsRequest) -> Message:
        return {"is": "jobs", "jobs": self._jobs.list(request.ended)}

    async def _do_probe(self, client: Client, request: Probe) -> Message:
        client.rate = request.rate
        self._set_rate()
        return {"is": "probing", "array": list(self._options.shape), "rate": self._worker.keeper.rate}

    async def _do_reset(self, client: Client, request: Request) -> Message:
        done = self._loop.create_future()
        self._resets.append(done)
        self._worker.ask_reset()
        if self._task is not None:
            self._worker.interrupt(self._task)
        try:
            async with asyncio.timeout(RESET_SECONDS):
                await done
        except TimeoutError:
            raise ArrayError(f"the array was not reset within {RESET_SECONDS:g} seconds") from None
        return {"is": "reset", "nodes": self._worker.keeper.pids}

    async def _do_down(self, client: Client, request: Down) -> Message:
        if request.cancel:
            for entry in list(self._jobs.schedule.entries.values()):
                self._cancel(entry)
        left = len(self._jobs.schedule.entries)
        if request.finish and left:
            self._finishing = True
        else:
            self._loop.call_soon(self._end)
        return {"is": "ending", "pid": os.getpid(), "unfinished": left}

    async def _do_status(self, client: Client, request: Request) -> Message:
        pids, shape = self._worker.keeper.pids, self._options.shape
        nodes = await asyncio.to_thread(self._samples.nodes, pids, shape)
        loads = [node["load"] for node in nodes if node["load"] is not None]
        schedule = self._jobs.schedule
        running = None
        if self._task is not None and self._entry is not None:
            running = {"job": self._task.job, "frame": self._task.frame, "scene": self._task.request.scene, **self._now}
        return {
            "is": "status",
            "name": self._name,
            "state": "finishing" if self._finishing and self._state == "ready" else self._state,
            "why": self._why,
            "pid": os.getpid(),
            "started": self._started,
            "array": list(shape),
            "load": round(sum(loads) / len(loads), 3) if loads else None,
            "memory": sum(node["memory"] for node in nodes),
            "nodes": nodes,
            "queue": {"jobs": len(schedule.entries), "frames": schedule.frames_queued},
            "running": running,
            "frames": {name: self._counts[name] for name in ("done", "skipped", "failed")},
            "floods": self._worker.keeper.floods,
            "increments": self._worker.keeper.increments,
            "resets": self._counts["resets"],
            "faults": {"count": self._fault_count, "last": list(self._faults)},
            "clients": len(self._door.clients),
            "refused": dict(self._door.refused),
            "journal": {"path": str(self._options.journal), "trouble": self._jobs.trouble},
        }

    # --- the end --------------------------------------------------------------------------------------

    def _end(self) -> None:
        """Give up the running frame, which stays in the journal, and end."""
        if self._state == "ending":
            return
        self._state = "ending"
        self._worker.ask_end()
        self._loop.call_later(END_SECONDS, self._give_up)

    def _give_up(self) -> None:
        print(f"the array did not end within {END_SECONDS:g} seconds", file=sys.stderr, flush=True)
        self._over.set()
