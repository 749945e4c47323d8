"""Answers the requests of clients (docs/service.md). Nothing here waits for the array but a reset."""

from __future__ import annotations

import asyncio
import os
from typing import TYPE_CHECKING, Protocol, assert_never

from raygrid.host.client import requests
from raygrid.host.client.protocol import LONGEST
from raygrid.host.service.job_facts import first_page
from raygrid.node.errors import ArrayError
from raygrid.node.links import why_python

if TYPE_CHECKING:
    from raygrid.host.client.facts import JobFacts, RunningFacts, StatusFacts
    from raygrid.host.client.protocol import Message
    from raygrid.host.service.jobs import Jobs
    from raygrid.host.service.listener import ClientConnection, Listener
    from raygrid.host.service.node_samples import Samples
    from raygrid.host.service.schedule import Entry
    from raygrid.host.service.state import ServiceState
    from raygrid.host.service.worker import Worker

RESET_SECONDS = 120.0
PAGE_BYTES = LONGEST // 2  # of facts of jobs in one answer


class ServiceParts(Protocol):
    """What of a service its answers look at, and act on."""

    state: ServiceState
    jobs: Jobs
    worker: Worker
    samples: Samples
    listener: Listener
    resets: list[asyncio.Future[None]]

    def next(self) -> None:
        """Give the array its next frame."""

    def end(self) -> None:
        """Give up the running frame, and end."""

    def set_rate(self) -> None:
        """Probe the array as often as any client wants."""

    def tell_end(self, entry: Entry) -> None:
        """Tell all that follow a job that it has ended."""


class Answers:
    """Answers for one service."""

    def __init__(self, service: ServiceParts) -> None:
        self._service, self._state = service, service.state

    async def answer(self, client: ClientConnection, request: requests.Request) -> Message:
        """The answer to a request. Raises RaygridError for what is refused."""
        match request:
            case requests.SubmitMessage():
                return self._submit(client, request)
            case requests.FollowMessage(job=job):
                return self._follow(client, job)
            case requests.CancelMessage(jobs=jobs):
                return self._cancel_all(jobs)
            case requests.JobsMessage(ended=ended, after=after):
                return self._jobs(ended, after)
            case requests.StatusMessage():
                return {"is": "status", **await self.facts()}
            case requests.ProbeMessage(rate=rate):
                return self._probe(client, rate)
            case requests.ResetMessage():
                return await self._reset()
            case requests.DownMessage(finish=finish, cancel=cancel):
                return self._down(finish, cancel)
            case _:
                assert_never(request)

    def _submit(self, client: ClientConnection, request: requests.SubmitMessage) -> Message:
        from raygrid.host.scene.load import check_taken

        if self._state.finishing or self._state.condition == "ending":
            raise ArrayError(f"the array {self._state.name!r} is being taken down, and takes no more jobs")
        check_taken(request.program, self._state.options.programs)
        entry = self._service.jobs.submit(request)
        if request.follow:
            client.follows.add(entry.job)
        asyncio.get_running_loop().call_soon(self._service.next)  # after the answer
        return {"is": "submitted", "job": entry.job, "frames": entry.total}

    def _follow(self, client: ClientConnection, job: int) -> Message:
        facts = self._facts(job)
        if job in self._service.jobs.schedule.entries:
            client.follows.add(job)
        return {"is": "following", **facts}

    def _facts(self, job: int) -> JobFacts:
        facts = self._service.jobs.facts(job)
        if facts is None:
            raise ArrayError(f"the array {self._state.name!r} has no job {job}")
        return facts

    def _cancel_all(self, jobs: list[int] | None) -> Message:
        entries = self._service.jobs.schedule.entries
        wanted = list(entries) if jobs is None else jobs
        for job in wanted:
            self._facts(job)  # an unknown one: none is cancelled
        cancelled = [job for job in dict.fromkeys(wanted) if job in entries]
        for job in cancelled:
            self._cancel(entries[job])
        return {"is": "cancelled", "jobs": cancelled, "ended": [job for job in wanted if job not in cancelled]}

    def _cancel(self, entry: Entry) -> None:
        self._service.jobs.cancel(entry)
        if entry is self._state.entry and self._state.task is not None:
            self._service.worker.interrupt(self._state.task)
        self._service.tell_end(entry)

    def _jobs(self, ended: int, after: int) -> Message:
        rows = sorted(self._service.jobs.list(ended), key=lambda facts: facts["job"])
        rows = [facts for facts in rows if facts["job"] > after]
        page = first_page(rows, PAGE_BYTES)
        return {"is": "jobs", "jobs": page, "left": len(rows) - len(page)}

    def _probe(self, client: ClientConnection, rate: float) -> Message:
        client.rate = rate
        self._service.set_rate()
        shape, rate = self._state.options.shape, self._service.worker.supervisor.rate
        return {"is": "probing", "array": list(shape), "rate": rate}

    async def _reset(self) -> Message:
        done = asyncio.get_running_loop().create_future()
        self._service.resets.append(done)
        self._service.worker.ask_reset()
        if self._state.task is not None:
            self._service.worker.interrupt(self._state.task)
        try:
            async with asyncio.timeout(RESET_SECONDS):
                await done
        except TimeoutError:
            raise ArrayError(f"the array was not reset within {RESET_SECONDS:g} seconds") from None
        return {"is": "reset", "nodes": self._service.worker.supervisor.pids}

    def _down(self, finish: bool, cancel: bool) -> Message:
        if cancel:
            for entry in list(self._service.jobs.schedule.entries.values()):
                self._cancel(entry)
        left = len(self._service.jobs.schedule.entries)
        if finish and left:
            self._state.finishing = True
        else:
            asyncio.get_running_loop().call_soon(self._service.end)
        return {"is": "ending", "pid": os.getpid(), "unfinished": 0 if finish else left}

    async def facts(self) -> StatusFacts:
        """How the array is (docs/service.md)."""
        service, state = self._service, self._state
        supervisor, schedule, task = service.worker.supervisor, service.jobs.schedule, state.task
        session, shape = supervisor.session, state.options.shape
        nodes = await asyncio.to_thread(service.samples.nodes, supervisor.pids, shape)
        loads = [node["load"] for node in nodes if node["load"] is not None]
        running: RunningFacts | None = None
        if task is not None:
            running = {"job": task.job, "frame": task.frame, "scene": task.request.scene}
            if state.moved is not None:
                running = {**running, **state.moved.facts}
        return {
            "name": state.name,
            "state": "finishing" if state.finishing and state.condition == "ready" else state.condition,
            "why": state.why,
            "pid": os.getpid(),
            "started": state.started,
            "array": list(shape),
            "load": round(sum(loads) / len(loads), 3) if loads else None,
            "pss": sum(node["pss"] for node in nodes),
            "nodes": nodes,
            "jobs": service.jobs.counts(),
            "queue": {"jobs": len(schedule.entries), "frames": schedule.frames_queued},
            "running": running,
            "frames": {name: state.counts[name] for name in ("done", "skipped", "failed")},
            "floods": 0 if session is None else session.floods,
            "increments": 0 if session is None else session.increments,
            "links": {"served_by": "python" if why_python() else "compiled", "why": why_python()},
            "resets": state.counts["resets"],
            "faults": {"count": state.fault_count, "last": list(state.faults)},
            "clients": len(service.listener.clients),
            "refused": dict(service.listener.refused),
            "journal": {
                "path": str(state.options.journal),
                "trouble": service.jobs.trouble,
                "remarks": list(service.jobs.remarks),
            },
            "outside": state.options.outside,
            "prometheus": state.prometheus,
        }
