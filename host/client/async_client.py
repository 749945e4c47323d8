"""Speaks to an array that stays from asyncio, as `raygrid.connect` does from threads; `raygrid.aio` is its public name.

async with raygrid.aio.connect("film") as array:
    picture = await array.render("room.toml", size=(640, 480))
    job = await array.submit("room.toml", frames=(1, 250), output="out/f_%04d.png")
    async for event in job.events():
        print(event["what"])

Reading and writing of files, which may take long, is done in threads; everything else in the loop.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import secrets
from collections.abc import AsyncGenerator, AsyncIterator, Coroutine, Generator, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, Unpack, cast

from raygrid.host.client.async_connection import AsyncConnection, AsyncEventListener, open_connection
from raygrid.host.client.client import RESET_SECONDS, Watch, given_job, wait_gone
from raygrid.host.client.connection import ANSWER_SECONDS
from raygrid.host.client.facts import ENDED, JobFacts, StatusFacts
from raygrid.host.client.job_events import Result, check_done, end_of, result_of, tell
from raygrid.host.client.picture_folder import PictureFolder, all_frames, runs_of
from raygrid.host.client.protocol import Message
from raygrid.host.client.service_files import DEFAULT_NAME
from raygrid.host.client.submission import GivenJob, Name, checked_message, plain, submission_of
from raygrid.host.image.frames import Ends
from raygrid.host.render.given_settings import GivenSettings
from raygrid.host.render.progress import ProgressHook, following
from raygrid.host.text.clean_text import shown
from raygrid.node.errors import ArrayError, RaygridError

if TYPE_CHECKING:
    from raygrid.host.image.picture import Picture
    from raygrid.host.scene.load import SceneLike


@dataclass(frozen=True)
class AsyncSubmitted:
    """A job that was submitted. `job` is its number."""

    array: AsyncService
    job: int

    async def wait(self, watch: Watch | None = None) -> Result:
        """Wait until it has ended; as `AsyncService.wait`."""
        return await self.array.wait(self.job, watch)

    def events(self) -> AsyncIterator[Message]:
        """Its events from now on, the last of which is its end; as `AsyncService.events`."""
        return self.array.events(self.job)

    async def cancel(self) -> None:
        """Cancel it, if it has not ended."""
        await self.array.cancel([self.job])


class AsyncService:
    """An array that stays, as a client sees it from asyncio: `raygrid.Service` with coroutines.

    For the coroutines of one event loop, any number of which may wait at once. Use as an asynchronous context manager; jobs and
    array go on when it closes. Where a coroutine that waits for a job is cancelled, the job goes on; `render` and
    `render_frames`, whose pictures nobody would take then, cancel theirs.

    name   of the array
    shape  processors on each axis
    pid    process of its service
    """

    def __init__(self, connection: AsyncConnection) -> None:
        self._connection, record = connection, connection.record
        self._client = f"client {os.getpid()}.{secrets.token_hex(4)}"
        self._late: set[asyncio.Task[None]] = set()  # which do away with what nobody waits for
        self.name, self.shape, self.pid = record.name, record.shape, record.pid

    def __repr__(self) -> str:
        return f"<raygrid.aio.AsyncService {self.name!r} {'x'.join(map(str, self.shape))}, process {self.pid}>"

    async def submit(self, scene: Name, *, output: Name | Sequence[Name], **given: Unpack[GivenJob]) -> AsyncSubmitted:
        """Queue a job and return at once. Arguments and errors as of `Service.submit`."""
        asked = submission_of(scene, output, self._client, given)
        return AsyncSubmitted(self, (await self._connection.ask(checked_message(asked)))["job"])

    async def render(
        self,
        scene: SceneLike,
        *,
        budget: int | None = None,
        program: str | Path | None = None,
        priority: int = 0,
        progress: ProgressHook | bool = True,
        **settings: Unpack[GivenSettings],
    ) -> Picture:
        """Render a scene and give the picture back. Arguments and errors as of `Service.render`."""
        given = given_job(settings, budget, program, priority)
        async with self._folder(scene, several=False) as folder:
            (picture,) = [picture async for picture in self._pictures(folder, None, progress, given)]
        return picture

    async def render_frames(
        self,
        scene: SceneLike,
        frames: Iterable[int] | None = None,
        *,
        budget: int | None = None,
        program: str | Path | None = None,
        priority: int = 0,
        progress: ProgressHook | bool = True,
        **settings: Unpack[GivenSettings],
    ) -> AsyncIterator[Picture]:
        """Render frames of a shot one after the other. Arguments and errors as of `Service.render_frames`."""
        given = given_job(settings, budget, program, priority)
        async with self._folder(scene, several=True) as folder:
            if frames is None:
                outside = (await self.status()).get("outside", False)
                runs = await asyncio.to_thread(all_frames, folder.scene, outside)
            else:
                runs = runs_of(frames)
            for ends in runs:
                async with contextlib.aclosing(self._pictures(folder, ends, progress, given)) as pictures:
                    async for picture in pictures:
                        yield picture

    @contextlib.asynccontextmanager
    async def _folder(self, scene: SceneLike, several: bool) -> AsyncIterator[PictureFolder]:
        """A folder for pictures, which threads make and remove: what lies there takes long to write, and to remove."""
        making = asyncio.ensure_future(asyncio.to_thread(PictureFolder, scene, several))
        try:
            folder = await asyncio.shield(making)
        except asyncio.CancelledError:
            self._leave(_remove(making))
            raise
        try:
            yield folder
        finally:
            await asyncio.shield(asyncio.ensure_future(asyncio.to_thread(folder.close)))

    async def _pictures(
        self, folder: PictureFolder, frames: Ends | None, progress: ProgressHook | bool, given: GivenJob
    ) -> AsyncGenerator[Picture, None]:
        """The frames of one job as they are done. Cancels it if they are not all taken."""
        asked = submission_of(
            folder.scene, folder.output, self._client, {**given, "frames": frames, "stats": folder.stats}
        )
        with following(progress, folder.title) as hook, self._connection.listen() as listener:
            job = await self._submitted(checked_message(asked, follow=True), listener)
            try:
                async for event in listener.follow():
                    tell(event, folder.title, hook)
                    if event["what"] == "frame":
                        yield await asyncio.to_thread(folder.take, event["frame"])
                    elif event["what"] == "end":
                        check_done(job, event)
            except BaseException:
                with contextlib.suppress(ArrayError):
                    await self.cancel([job])
                raise

    async def _submitted(self, message: Message, listener: AsyncEventListener) -> int:
        """Submit a job; returns its number. If this is cancelled the job is cancelled, too, as soon as its number has come."""
        asking = asyncio.ensure_future(self._connection.ask(message, listener=listener))
        try:
            return int((await asyncio.shield(asking))["job"])
        except asyncio.CancelledError:
            self._leave(self._drop(asking))
            raise

    def _leave(self, work: Coroutine[Any, Any, None]) -> None:
        """Let this be done by the time that the connection is closed."""
        late = asyncio.get_running_loop().create_task(work)
        self._late.add(late)
        late.add_done_callback(self._late.discard)

    async def _drop(self, asking: asyncio.Future[Message]) -> None:
        """Cancel a job whose number is still to come."""
        with contextlib.suppress(ArrayError):
            await self.cancel([(await asking)["job"]])

    async def events(self, job: int) -> AsyncIterator[Message]:
        """The events of a job from now on (docs/service.md), the last of which is its end.

        Raises ArrayError if there is no such job, and if the array ends.
        """
        with self._connection.listen(job) as listener:
            facts = await self._connection.ask({"do": "follow", "job": job})
            async for event in self._rest(facts, listener):
                yield event

    async def wait(self, job: int, watch: Watch | None = None) -> Result:
        """Wait until a job has ended. `watch` is called with each event. Errors as of `Service.wait`."""
        with self._connection.listen(job) as listener:
            end = facts = await self._connection.ask({"do": "follow", "job": job})
            async for event in self._rest(facts, listener):
                end = event
                if watch is not None:
                    watch(event)
        return result_of(job, facts, end)

    async def _rest(self, facts: Message, listener: AsyncEventListener) -> AsyncIterator[Message]:
        """What is still to be told of a job: its end alone, if it has ended."""
        if facts["state"] in ENDED:
            yield end_of(facts)
            return
        async for event in listener.follow():
            yield event

    async def cancel(self, jobs: Sequence[int] | None) -> list[int]:
        """Cancel jobs, None: all; returns those that had not ended. Raises ArrayError if one of them is not known."""
        return list((await self._connection.ask({"do": "cancel", "jobs": plain(jobs)}))["jobs"])

    async def jobs(self, ended: int = 10) -> list[JobFacts]:
        """The last `ended` jobs that have ended, and all that have not, each oldest first."""
        found: dict[int, JobFacts] = {}
        left, last = 1, 0
        while left > 0:  # there may be more than a message has room for
            answer = await self._connection.ask({"do": "jobs", "ended": ended, "after": last})
            found |= {facts["job"]: facts for facts in answer["jobs"]}
            left, last = answer["left"], max(found, default=0)
        return sorted(found.values(), key=lambda facts: (facts["state"] not in ENDED, facts["job"]))

    async def status(self) -> StatusFacts:
        """How the array is: nodes, load, queue, frames, faults (docs/service.md)."""
        answer = await self._connection.ask({"do": "status"})
        return cast(StatusFacts, {key: value for key, value in answer.items() if key != "is"})

    async def reset(self) -> list[int]:
        """Empty the array and begin the running frame again; returns the process ids of the nodes."""
        return list((await self._connection.ask({"do": "reset"}, RESET_SECONDS))["nodes"])

    async def down(self, finish: bool = False, cancel: bool = False) -> int:
        """End the array and wait until it has ended; arguments and result as of `Service.down`."""
        answer = await self._connection.ask({"do": "down", "finish": finish, "cancel": cancel})
        await asyncio.to_thread(wait_gone, self._connection.record)
        return int(answer["unfinished"])

    async def close(self) -> None:
        """Close the connection, when jobs and folders that nobody waits for any more are done away with."""
        try:
            if self._late:
                await asyncio.wait(self._late)
        finally:
            await self._connection.close()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()


async def _remove(making: asyncio.Future[PictureFolder]) -> None:
    """Remove a folder that is still being made."""
    with contextlib.suppress(RaygridError, OSError):
        await asyncio.to_thread((await making).close)


class Connecting:
    """A connection that is to be made: `async with connect(...) as array`, or `array = await connect(...)`."""

    def __init__(self, name: str, timeout: float) -> None:
        self._name, self._timeout = name, timeout
        self._service: AsyncService | None = None

    async def _connect(self) -> AsyncService:
        return AsyncService(await open_connection(self._name, self._timeout))

    def __await__(self) -> Generator[Any, None, AsyncService]:
        return self._connect().__await__()

    async def __aenter__(self) -> AsyncService:
        self._service = await self._connect()
        return self._service

    async def __aexit__(self, *_: object) -> None:
        if self._service is not None:
            await self._service.close()


def connect(name: str = DEFAULT_NAME, timeout: float = ANSWER_SECONDS) -> Connecting:
    """Connect to an array that `raygrid up` has launched, from asyncio.

    timeout  seconds to wait for an answer
    Raises ArrayError if no array of that name runs, or if it does not answer.
    """
    if not isinstance(timeout, int | float) or not 0.0 < timeout < math.inf:
        raise ArrayError(f"timeout came as {shown(timeout)}, wanted seconds above 0")
    return Connecting(name, timeout)
