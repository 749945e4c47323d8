"""Speaks to an array that stays. Light to import: neither numpy nor numba. Any thread may use one connection at any time.

with raygrid.connect("film") as array:
    job = array.submit("room.toml", frames=(1, 250), output="out/f_%04d.png", size=(640, 480))
    for file in job.wait().files:
        print(file)
"""

from __future__ import annotations

import math
import os
import secrets
import select
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Self, Unpack, cast

from raygrid.host.client.connection import ANSWER_SECONDS, Connection
from raygrid.host.client.facts import ENDED, JobFacts, StatusFacts
from raygrid.host.client.protocol import Message, shown
from raygrid.host.client.service_files import DEFAULT_NAME, ServiceRecord, find
from raygrid.host.client.submission import Name, Submission, plain
from raygrid.host.image.frames import FrameNames, Turntable, check_job
from raygrid.host.render.given_settings import SETTINGS, GivenSettings
from raygrid.node.errors import ArrayError

RESET_SECONDS = 150.0

Watch = Callable[[Message], None]


@dataclass(frozen=True)
class Result:
    """What became of a job.

    job     its number
    files   all its files, in the order of its frames
    frames  how many it has; `skipped` of them were there already
    """

    job: int
    files: tuple[str, ...]
    frames: int
    skipped: int


@dataclass(frozen=True)
class Submitted:
    """A job that was submitted. `job` is its number."""

    array: Service
    job: int

    def wait(self, watch: Watch | None = None) -> Result:
        """Wait until it has ended; as `Service.wait`."""
        return self.array.wait(self.job, watch)

    def cancel(self) -> None:
        """Cancel it, if it has not ended."""
        self.array.cancel([self.job])


class Service:
    """An array that stays, as a client sees it. Use as a context manager; jobs and array go on when it closes.

    Any thread may call any method at any time; several may wait for jobs, or for the same one.

    name   of the array
    shape  processors on each axis
    pid    process of its service
    """

    def __init__(self, name: str = DEFAULT_NAME, timeout: float = ANSWER_SECONDS) -> None:
        self._record = find(name)
        self._timeout = timeout
        self._connection = Connection(self._record, timeout)
        self._client = f"client {os.getpid()}.{secrets.token_hex(4)}"
        self.name, self.shape, self.pid = self._record.name, self._record.shape, self._record.pid

    def submit(
        self,
        scene: Name,
        *,
        output: Name | Sequence[Name],
        frames: tuple[int, int] | None = None,
        stats: Name | None = None,
        transfer: str = "srgb",
        budget: int | None = None,
        resume: bool = False,
        client: str | None = None,
        turntable: int | None = None,
        turn_scene: bool = False,
        program: Name | None = None,
        priority: int = 0,
        **settings: Unpack[GivenSettings],
    ) -> Submitted:
        """Queue a job and return at once. Paths may be relative to the current directory.

        scene     path of the scene's file, which the service reads when the job's turn comes
        output    path of a picture or a .npy, or several; with several frames each has a %04d for the number, or is a
                  .gif, .webp or .mp4 of them all; %% is a %
        frames    first and last; None: all of a turntable, else one frame without number
        stats     path of the statistics, with %04d likewise
        resume    skip frames whose files are there, whole, and of this very job
        client    in whose turn it is rendered; None: this connection's own
        turntable  so many frames make a shot of a still scene: the camera goes once round; `turn_scene`: the scene turns
        program   path of a program for the nodes, for an array that was launched to take it
        priority  -100 to 100: frames of higher ones go first, and one that runs is given up for them if it would take long
        settings  size, samples, depth, min_weight, highlights, split (`raygrid.host.render.machine_job.Settings`), and eye,
                  at, up, fov, camera, fit, lights, background, crease (`raygrid.host.scene.view.GivenView`)
        Raises TypeError for another setting, OutputError for names that cannot be, ArrayError for what the service refuses.
        """
        unknown = set(settings) - set(SETTINGS)
        if unknown:
            raise TypeError(f"the settings {sorted(unknown)} came, wanted some of {', '.join(SETTINGS)}")
        if frames is None and isinstance(turntable, int):
            frames = 1, turntable
        several = isinstance(output, Sequence) and not isinstance(output, str | bytes)
        patterns: list[Any] = list(output) if several else [output]  # type: ignore[arg-type]
        asked = Submission(
            scene=scene,
            outputs=patterns,
            settings=settings,
            frames=frames,
            stats=stats,
            transfer=transfer,
            budget=budget,
            resume=resume,
            client=self._client if client is None else client,
            turntable=None if turntable is None else Turntable(turntable, turn_scene),
            program=program,
            priority=priority,
        ).message()
        if frames is None or _are_ends(frames):
            check_job(asked["outputs"], asked["stats"], frames)  # else the service says what is wrong
        return Submitted(self, self._connection.ask(asked)["job"])

    def wait(self, job: int, watch: Watch | None = None) -> Result:
        """Wait until a job has ended. `watch` is called with each event (docs/service.md): progress, frames, remarks.

        Raises ArrayError if it failed or was cancelled, if there is no such job, and if the array ends.
        """
        with self._connection.listen(job) as listener:
            facts = self._connection.ask({"do": "follow", "job": job})
            end = facts
            for event in () if facts["state"] in ENDED else listener.follow():
                end = event
                if watch is not None:
                    watch(event)
        if end["state"] != "done":
            raise ArrayError(f"job {job} {_said(end)}")
        return Result(job, tuple(_files_of(facts)), end["frames"], end["skipped"])

    def cancel(self, jobs: Sequence[int] | None) -> list[int]:
        """Cancel jobs, None: all; returns those that had not ended. Raises ArrayError if one of them is not known."""
        answer = self._connection.ask({"do": "cancel", "jobs": plain(jobs)})
        return list(answer["jobs"])

    def jobs(self, ended: int = 10) -> list[JobFacts]:
        """The last `ended` jobs that have ended, and all that have not, each oldest first."""
        found: dict[int, JobFacts] = {}
        left, last = 1, 0
        while left > 0:  # there may be more than a message has room for
            answer = self._connection.ask({"do": "jobs", "ended": ended, "after": last})
            found |= {facts["job"]: facts for facts in answer["jobs"]}
            left, last = answer["left"], max(found, default=0)
        return sorted(found.values(), key=lambda facts: (facts["state"] not in ENDED, facts["job"]))

    def status(self) -> StatusFacts:
        """How the array is: nodes, load, queue, frames, faults (docs/service.md)."""
        answer = self._connection.ask({"do": "status"})
        return cast(StatusFacts, {key: value for key, value in answer.items() if key != "is"})

    def reset(self) -> list[int]:
        """Empty the array and begin the running frame again; returns the process ids of the nodes."""
        return list(self._connection.ask({"do": "reset"}, RESET_SECONDS)["nodes"])

    def down(self, finish: bool = False, cancel: bool = False) -> int:
        """End the array and wait until it has ended; returns how many jobs were left, which go on at the next launch.

        finish  when all jobs have ended
        cancel  cancel them first
        """
        answer = self._connection.ask({"do": "down", "finish": finish, "cancel": cancel})
        wait_gone(self._record)
        return int(answer["unfinished"])

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def connect(name: str = DEFAULT_NAME, timeout: float = ANSWER_SECONDS) -> Service:
    """Connect to an array that `raygrid up` has launched. Threads may share the connection.

    timeout  seconds to wait for an answer
    Raises ArrayError if no array of that name runs, or if it does not answer.
    """
    if not isinstance(timeout, int | float) or not 0.0 < timeout < math.inf:
        raise ArrayError(f"timeout came as {shown(timeout)}, wanted seconds above 0")
    return Service(name, timeout)


def wait_gone(record: ServiceRecord, timeout: float | None = None) -> bool:
    """Wait until the process of a service has ended; whether it has within `timeout` seconds."""
    deadline = None if timeout is None else time.monotonic() + timeout
    try:
        descriptor = os.pidfd_open(record.pid)
    except ProcessLookupError:
        return True
    try:
        poller = select.poll()
        poller.register(descriptor, select.POLLIN)
        while record.alive:
            left = None if deadline is None else max(0.0, deadline - time.monotonic())
            if poller.poll(None if left is None else left * 1000) or left == 0.0:
                break
    finally:
        os.close(descriptor)
    return not record.alive


def _are_ends(frames: Any) -> bool:
    """Whether this is the first and the last of some frames."""
    pair = isinstance(frames, Sequence) and len(frames) == 2 and all(isinstance(number, int) for number in frames)
    return pair and 1 <= frames[0] <= frames[1]


def _files_of(facts: Message) -> Iterator[str]:
    """All files of a job, in the order of its frames; those that play after the last."""
    shot = facts["first"] is not None
    names = FrameNames.split(facts["outputs"], None, shot)
    for number in range(facts["first"], facts["last"] + 1) if shot else [None]:
        yield from names.of(number)
    yield from names.played


def _said(end: Message) -> str:
    """What became of a job that is not done, as the end of a sentence."""
    if end["state"] == "failed":
        return f"failed: {end['error']}"
    return "was cancelled" if end["state"] == "cancelled" else f"is not done: {end['error']}"
