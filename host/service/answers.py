"""What a service answers to each request of its clients (docs/service.md). Nothing here waits for the array but a reset."""

from __future__ import annotations

import asyncio
import os
from typing import TYPE_CHECKING, Any

from raygrid.host.client.protocol import LONGEST
from raygrid.host.service.job_facts import first_page
from raygrid.node.errors import ArrayError
from raygrid.node.links import why_python

if TYPE_CHECKING:
    from raygrid.host.client.protocol import Message
    from raygrid.host.client.requests import (
        CancelMessage,
        DownMessage,
        FollowMessage,
        ProbeMessage,
        Request,
        SubmitMessage,
    )
    from raygrid.host.client.requests import JobsMessage as JobsRequest
    from raygrid.host.service.listener import ClientConnection
    from raygrid.host.service.schedule import Entry
    from raygrid.host.service.service import ArrayService

RESET_SECONDS = 120.0
PAGE_BYTES = LONGEST // 2  # of facts of jobs in one answer


class Answers:
    """Answers for one service."""

    def __init__(self, service: ArrayService) -> None:
        self._service = service

    async def answer(self, client: ClientConnection, request: Request) -> Message:
        """The answer to a request. Raises RaygridError for what is refused."""
        answer: Message = await getattr(self, f"_do_{request.do}")(client, request)
        return answer

    async def _do_submit(self, client: ClientConnection, request: SubmitMessage) -> Message:
        from raygrid.host.scene.load import check_taken

        if self._service.finishing or self._service.state == "ending":
            raise ArrayError(f"the array {self._service.name!r} is being taken down, and takes no more jobs")
        check_taken(request.program, self._service.options.programs)
        entry = self._service.jobs.submit(request)
        if request.follow:
            client.follows.add(entry.job)
        asyncio.get_running_loop().call_soon(self._service.next)  # after the answer
        return {"is": "submitted", "job": entry.job, "frames": entry.total}

    async def _do_follow(self, client: ClientConnection, request: FollowMessage) -> Message:
        facts = self._facts(request.job)
        if request.job in self._service.jobs.schedule.entries:
            client.follows.add(request.job)
        return {"is": "following", **facts}

    def _facts(self, job: int) -> dict[str, Any]:
        facts = self._service.jobs.facts(job)
        if facts is None:
            raise ArrayError(f"the array {self._service.name!r} has no job {job}")
        return facts

    async def _do_cancel(self, client: ClientConnection, request: CancelMessage) -> Message:
        entries = self._service.jobs.schedule.entries
        wanted = list(entries) if request.jobs is None else request.jobs
        for job in wanted:
            self._facts(job)  # an unknown one: none is cancelled
        cancelled = [job for job in dict.fromkeys(wanted) if job in entries]
        for job in cancelled:
            self._cancel(entries[job])
        return {"is": "cancelled", "jobs": cancelled, "ended": [job for job in wanted if job not in cancelled]}

    def _cancel(self, entry: Entry) -> None:
        self._service.jobs.cancel(entry)
        if entry is self._service.entry and self._service.task is not None:
            self._service.worker.interrupt(self._service.task)
        self._service.tell_end(entry)

    async def _do_jobs(self, client: ClientConnection, request: JobsRequest) -> Message:
        rows = sorted(self._service.jobs.list(request.ended), key=lambda facts: facts["job"])
        rows = [facts for facts in rows if facts["job"] > request.after]
        page = first_page(rows, PAGE_BYTES)
        return {"is": "jobs", "jobs": page, "left": len(rows) - len(page)}

    async def _do_probe(self, client: ClientConnection, request: ProbeMessage) -> Message:
        client.rate = request.rate
        self._service.set_rate()
        return {
            "is": "probing",
            "array": list(self._service.options.shape),
            "rate": self._service.worker.supervisor.rate,
        }

    async def _do_reset(self, client: ClientConnection, request: Request) -> Message:
        done = asyncio.get_running_loop().create_future()
        self._service.resets.append(done)
        self._service.worker.ask_reset()
        if self._service.task is not None:
            self._service.worker.interrupt(self._service.task)
        try:
            async with asyncio.timeout(RESET_SECONDS):
                await done
        except TimeoutError:
            raise ArrayError(f"the array was not reset within {RESET_SECONDS:g} seconds") from None
        return {"is": "reset", "nodes": self._service.worker.supervisor.pids}

    async def _do_down(self, client: ClientConnection, request: DownMessage) -> Message:
        if request.cancel:
            for entry in list(self._service.jobs.schedule.entries.values()):
                self._cancel(entry)
        left = len(self._service.jobs.schedule.entries)
        if request.finish and left:
            self._service.finishing = True
        else:
            asyncio.get_running_loop().call_soon(self._service.end)
        return {"is": "ending", "pid": os.getpid(), "unfinished": left}

    async def _do_status(self, client: ClientConnection, request: Request) -> Message:
        return {"is": "status", **await self.facts()}

    async def facts(self) -> dict[str, Any]:
        """How the array is (docs/service.md)."""
        service = self._service
        pids, shape = service.worker.supervisor.pids, service.options.shape
        session = service.worker.supervisor.session
        nodes = await asyncio.to_thread(service.samples.nodes, pids, shape)
        loads = [node["load"] for node in nodes if node["load"] is not None]
        schedule = service.jobs.schedule
        task, running = service.task, None
        if task is not None:
            running = {"job": task.job, "frame": task.frame, "scene": task.request.scene, **service.now}
        return {
            "name": service.name,
            "state": "finishing" if service.finishing and service.state == "ready" else service.state,
            "why": service.why,
            "pid": os.getpid(),
            "started": service.started,
            "array": list(shape),
            "load": round(sum(loads) / len(loads), 3) if loads else None,
            "pss": sum(node["pss"] for node in nodes),
            "nodes": nodes,
            "jobs": service.jobs.counts(),
            "queue": {"jobs": len(schedule.entries), "frames": schedule.frames_queued},
            "running": running,
            "frames": {name: service.counts[name] for name in ("done", "skipped", "failed")},
            "floods": 0 if session is None else session.floods,
            "increments": 0 if session is None else session.increments,
            "links": {"served_by": "python" if why_python() else "compiled", "why": why_python()},
            "resets": service.counts["resets"],
            "faults": {"count": service.fault_count, "last": list(service.faults)},
            "clients": len(service.door.clients),
            "refused": dict(service.door.refused),
            "journal": {
                "path": str(service.options.journal),
                "trouble": service.jobs.trouble,
                "remarks": list(service.jobs.remarks),
            },
            "prometheus": service.prometheus,
        }
