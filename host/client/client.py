"""Speaks to an array that stays. Light to import: neither numpy nor numba. Any thread may use one connection at any time.

with raygrid.connect("film") as array:
    array.render("room.toml", size=(640, 480)).save("room.png")
    job = array.submit("room.toml", frames=(1, 250), output="out/f_%04d.png", size=(640, 480))
    for file in job.wait().files:
        print(file)
"""

from __future__ import annotations

import contextlib
import math
import os
import secrets
import select
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Self, Unpack, cast

from raygrid.host.client.connection import ANSWER_SECONDS, NO_JOB, Connection, EventListener
from raygrid.host.client.facts import ENDED, JobFacts, StatusFacts
from raygrid.host.client.job_events import Result, check_done, end_of, result_of, tell
from raygrid.host.client.picture_folder import PictureFolder, all_frames, runs_of
from raygrid.host.client.protocol import Message
from raygrid.host.client.service_files import DEFAULT_NAME, ServiceRecord, find
from raygrid.host.client.submission import GivenJob, Name, checked_message, plain, submission_of
from raygrid.host.image.frames import Ends
from raygrid.host.render.given_settings import SETTINGS, GivenSettings
from raygrid.host.render.progress import ProgressHook, following
from raygrid.host.text.clean_text import shown
from raygrid.node.errors import ArrayError

if TYPE_CHECKING:
    from raygrid.host.image.picture import Picture
    from raygrid.host.render.api import Machine
    from raygrid.host.render.renderer import Renderer
    from raygrid.host.scene.load import SceneLike

RESET_SECONDS = 150.0

Watch = Callable[[Message], None]


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

    def __repr__(self) -> str:
        return f"<raygrid.Service {self.name!r} {'x'.join(map(str, self.shape))}, process {self.pid}>"

    def submit(self, scene: Name, *, output: Name | Sequence[Name], **given: Unpack[GivenJob]) -> Submitted:
        """Queue a job and return at once. Paths may be relative to the current directory.

        scene     path of the scene's file, which the service reads when the job's turn comes
        output    path of a picture or a .npy, or several; with several frames each has a %04d for the number, or is a
                  .gif, .webp or .mp4 of them all; %% is a %
        given     frames, stats, transfer, budget, resume, client, turntable, turn_scene, program, priority (`GivenJob`); size,
                  samples, depth, min_weight, highlights, split (`raygrid.host.render.machine_job.Settings`), and eye,
                  at, up, fov, camera, fit, lights, background, crease (`raygrid.host.scene.view.GivenView`)
        Raises TypeError for another setting, OutputError for names that cannot be, ArrayError for what the service refuses.
        """
        asked = submission_of(scene, output, self._client, given)
        return Submitted(self, self._connection.ask(checked_message(asked))["job"])

    def render(
        self,
        scene: SceneLike,
        *,
        budget: int | None = None,
        program: str | Path | None = None,
        priority: int = 0,
        progress: ProgressHook | bool = True,
        **settings: Unpack[GivenSettings],
    ) -> Picture:
        """Render a scene and give the picture back, as `Machine.render` does: a job like others, of which no file is left.

        scene     the path of a file, a raygrid.Scene, or an object of trimesh
        progress  True: a bar in a notebook; False: none; a function: called with a RenderProgress as the work goes on
        The others as for `submit`. If this is interrupted, the job is cancelled.
        Raises ArrayError if the job fails, is cancelled, or the array ends; SceneError for what is no scene.
        """
        with PictureFolder(scene, several=False) as folder:
            (picture,) = self._pictures(folder, None, progress, given_job(settings, budget, program, priority))
        return picture

    def render_frames(
        self,
        scene: SceneLike,
        frames: Iterable[int] | None = None,
        *,
        budget: int | None = None,
        program: str | Path | None = None,
        priority: int = 0,
        progress: ProgressHook | bool = True,
        **settings: Unpack[GivenSettings],
    ) -> Iterator[Picture]:
        """Render frames of a shot one after the other, as `Machine.render_frames` does; the array goes on while the caller
        has a picture.

        frames  their numbers, from 1; None: all of the shot. Those that follow one another are one job
        The others, and what is raised, as for `render`.
        """
        with PictureFolder(scene, several=True) as folder:
            # an array that was launched by an older version does not tell
            runs = all_frames(folder.scene, self.status().get("outside", False)) if frames is None else runs_of(frames)
            for ends in runs:
                yield from self._pictures(folder, ends, progress, given_job(settings, budget, program, priority))

    def _pictures(
        self, folder: PictureFolder, frames: Ends | None, progress: ProgressHook | bool, given: GivenJob
    ) -> Iterator[Picture]:
        """The frames of one job as they are done. Cancels it if they are not all taken."""
        asked = submission_of(
            folder.scene, folder.output, self._client, {**given, "frames": frames, "stats": folder.stats}
        )
        with following(progress, folder.title) as hook, self._connection.listen(NO_JOB) as listener:
            try:
                job = self._connection.ask(checked_message(asked, follow=True), listener=listener)["job"]
                for event in listener.follow():
                    tell(event, folder.title, hook)
                    if event["what"] == "frame":
                        yield folder.take(event["frame"])
                    elif event["what"] == "end":
                        check_done(job, event)
            except BaseException as error:
                self._drop(listener, interrupted=not isinstance(error, Exception))
                raise

    def _drop(self, listener: EventListener, interrupted: bool) -> None:
        """Cancel the job of a listener, whose pictures nobody takes; one that is just being submitted, too, if that was
        interrupted."""
        with contextlib.suppress(ArrayError):
            if listener.job == NO_JOB and interrupted:
                self.cancel([])  # answers come in turn: the one that names the job comes before this one's
            if listener.job:
                self.cancel([listener.job])

    def wait(self, job: int, watch: Watch | None = None) -> Result:
        """Wait until a job has ended. `watch` is called with each event (docs/service.md): progress, frames, remarks, the end.

        Raises ArrayError if it failed or was cancelled, if there is no such job, and if the array ends.
        """
        with self._connection.listen(job) as listener:
            facts = self._connection.ask({"do": "follow", "job": job})
            for event in [end_of(facts)] if facts["state"] in ENDED else listener.follow():
                end = event
                if watch is not None:
                    watch(event)
        return result_of(job, facts, end)

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


def given_job(settings: GivenSettings, budget: int | None, program: str | Path | None, priority: int) -> GivenJob:
    """What a job is given of the arguments of a render. Raises TypeError for another setting."""
    unknown = set(settings) - set(SETTINGS)
    if unknown:
        raise TypeError(f"the settings {sorted(unknown)} came, wanted some of {', '.join(SETTINGS)}")
    return cast(GivenJob, {**settings, "budget": budget, "program": program, "priority": priority})


if TYPE_CHECKING:
    RENDERERS: tuple[type[Renderer], ...] = (Machine, Service)  # checked by mypy: both are what they say they are
