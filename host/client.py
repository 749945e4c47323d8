"""Speak to an array that stays. Light to import: neither numpy nor numba.

with raygrid.connect("film") as array:
    job = array.submit("room.toml", frames=(1, 250), output="out/f_%04d.png", size=(640, 480))
    for file in job.wait().files:
        print(file)
"""

from __future__ import annotations

import contextlib
import os
import secrets
import select
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from raygrid.emulator.places import LONGEST_PATH
from raygrid.host.frames import absolute, check_job, is_played, path_of
from raygrid.host.service_files import (
    DEFAULT_NAME,
    SOCKET,
    TOKEN,
    Record,
    check_private,
    find,
    read_private,
)
from raygrid.host.wire import VERSION, Message, Splitter, pack
from raygrid.node.errors import ArrayError, ProtocolError

ANSWER_SECONDS = 20.0  # a service that lives answers at once
RESET_SECONDS = 150.0
QUIET_SECONDS = 30.0  # without any news of a job, after which the service is asked whether it lives
SETTINGS = ("size", "samples", "depth", "min_weight", "highlights", "split")

Watch = Callable[[dict[str, Any]], None]
Name = str | os.PathLike[str]


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


class Connection:
    """One connection to a service: requests, answers and events. For use by one thread at a time."""

    def __init__(self, record: Record, timeout: float = ANSWER_SECONDS) -> None:
        """Connect and be let in. Raises ArrayError if there is no service, or if it does not answer."""
        self.record, self._timeout = record, timeout
        self._splitter = Splitter()
        self._events: list[Message] = []
        check_private(record.directory, directory=True)
        token = read_private(Path(record.directory, TOKEN))
        path = os.path.join(record.directory, SOCKET)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC)
        try:
            self._socket.settimeout(timeout)
            if len(os.fsencode(path)) > LONGEST_PATH:
                raise ArrayError(f"{path}: a socket's path is that long, wanted at most {LONGEST_PATH} bytes")
            with self._told():
                self._socket.connect(path)
            self.ask({"do": "hello", "version": VERSION, "token": token})
        except BaseException:
            self._socket.close()
            raise

    @contextlib.contextmanager
    def _told(self) -> Iterator[None]:
        """Errors of the socket as ours."""
        name, pid = self.record.name, self.record.pid
        try:
            yield
        except TimeoutError:
            raise ArrayError(
                f"the array {name!r} (process {pid}) does not answer; raygrid down --kill --name {name} ends it"
            ) from None
        except OSError as error:
            raise ArrayError(f"the array {name!r} (process {pid}) is gone ({error.strerror or error})") from None

    def ask(self, request: Message, timeout: float | None = None) -> Message:
        """Send a request and wait for its answer; events that come before it are kept.

        Raises ArrayError for what the service refuses, and if it is gone or does not answer.
        """
        with self._told():
            self._socket.settimeout(timeout or self._timeout)
            self._socket.sendall(pack(request))
            while (message := self._receive())["is"] == "event":
                self._events.append(message)
        if message["is"] == "error":
            raise ArrayError(str(message["error"]))
        return message

    def next_event(self, job: int) -> Message:
        """The next event, of any job that is followed, waited for as long as it takes.

        Where none comes for a while, the service is asked for `job`. Raises ArrayError if it is gone or hangs.
        """
        while not self._events:
            self._socket.settimeout(QUIET_SECONDS)
            try:
                message = self._receive()
            except TimeoutError:
                self.ask({"do": "follow", "job": job})
                continue
            except OSError as error:
                raise ArrayError(f"the array {self.record.name!r} is gone ({error.strerror or error})") from None
            if message["is"] == "event":
                self._events.append(message)
        return self._events.pop(0)

    def poll_event(self, seconds: float) -> Message | None:
        """The next event if one comes within that time. Raises ArrayError if the service is gone."""
        if not self._events:
            self._socket.settimeout(seconds)
            try:
                message = self._receive()
            except TimeoutError:
                return None
            except OSError as error:
                raise ArrayError(f"the array {self.record.name!r} is gone ({error.strerror or error})") from None
            if message["is"] != "event":
                return None
            self._events.append(message)
        return self._events.pop(0)

    def _receive(self) -> Message:
        while (message := self._splitter.next()) is None:
            piece = self._socket.recv(1 << 16)
            if not piece:
                raise ArrayError(f"the array {self.record.name!r} has closed the connection")
            self._splitter.feed(piece)
        if not isinstance(message.get("is"), str):
            raise ProtocolError(f"the array {self.record.name!r} sent a message that says not what it is")
        return message

    def close(self) -> None:
        """Close; jobs go on."""
        self._socket.close()


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
        **settings: Any,
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
        settings  size, samples, depth, min_weight, highlights, split; see `raygrid.host.job.Settings`
        Raises TypeError for another setting, OutputError for names that cannot be, ArrayError for what the service refuses.
        """
        unknown = set(settings) - set(SETTINGS)
        if unknown:
            raise TypeError(f"the settings {sorted(unknown)} came, wanted some of {', '.join(SETTINGS)}")
        if frames is None and turntable is not None:
            frames = 1, turntable
        outputs = [absolute(path) for path in ([output] if isinstance(output, str | os.PathLike) else output)]
        figures = None if stats is None else absolute(stats)
        check_job(outputs, figures, frames)
        request: Message = {
            "do": "submit",
            "scene": os.path.abspath(scene),
            "settings": {name: _plain(value) for name, value in settings.items() if value is not None},
            "frames": None if frames is None else list(frames),
            "outputs": outputs,
            "stats": figures,
            "transfer": transfer,
            "resume": resume,
            "client": self._client if client is None else client,
            "turntable": None if turntable is None else {"frames": turntable, "scene": turn_scene},
            "program": None if program is None else os.path.abspath(program),
        }
        if budget is not None:
            request["budget"] = budget
        return Submitted(self, self._connection.ask(request)["job"])

    def wait(self, job: int, watch: Watch | None = None) -> Result:
        """Wait until a job has ended. `watch` is called with each event (docs/service.md): progress, frames, remarks.

        Raises ArrayError if it failed or was cancelled, if there is no such job, and if the array ends.
        """
        facts = self._connection.ask({"do": "follow", "job": job})
        end = {**facts, "what": "end"} if facts["state"] in ("done", "failed", "cancelled") else None
        while end is None:
            event = self._connection.next_event(job)
            if event["job"] != job:
                continue  # a job of this connection that nobody waits for
            if event["what"] == "end":
                end = event
            if watch is not None:
                watch(event)
        if end["state"] != "done":
            raise ArrayError(f"job {job} {_said(end)}")
        return Result(job, tuple(_files_of(facts)), end["frames"], end["skipped"])

    def cancel(self, jobs: Sequence[int] | None) -> list[int]:
        """Cancel jobs, None: all; returns those that had not ended. Raises ArrayError if one of them is not known."""
        answer = self._connection.ask({"do": "cancel", "jobs": None if jobs is None else list(jobs)})
        return list(answer["jobs"])

    def jobs(self, ended: int = 10) -> list[dict[str, Any]]:
        """The last `ended` jobs that have ended, and all that have not, each oldest first."""
        return list(self._connection.ask({"do": "jobs", "ended": ended})["jobs"])

    def status(self) -> dict[str, Any]:
        """How the array is: nodes, load, queue, frames, faults (docs/service.md)."""
        answer = self._connection.ask({"do": "status"})
        return {key: value for key, value in answer.items() if key != "is"}

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

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def connect(name: str = DEFAULT_NAME, timeout: float = ANSWER_SECONDS) -> Service:
    """Connect to an array that `raygrid up` has launched.

    timeout  seconds to wait for an answer
    Raises ArrayError if no array of that name runs, or if it does not answer.
    """
    return Service(name, timeout)


def wait_gone(record: Record, timeout: float | None = None) -> bool:
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


def _files_of(facts: Message) -> Iterator[str]:
    """All files of a job, in the order of its frames; those that play after the last."""
    shot = facts["first"] is not None
    numbers = range(facts["first"], facts["last"] + 1) if shot else [None]
    played = [pattern for pattern in facts["outputs"] if is_played(pattern, shot)]
    for number in numbers:
        yield from (path_of(pattern, number) for pattern in facts["outputs"] if pattern not in played)
    yield from (path_of(pattern, None) for pattern in played)


def _plain(value: Any) -> Any:
    """A setting as a message can carry it: pairs as lists, numpy's numbers as numbers."""
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(item) for item in value]
    return value.item() if hasattr(value, "item") else value


def _said(end: Message) -> str:
    """What became of a job that is not done, as the end of a sentence."""
    if end["state"] == "failed":
        return f"failed: {end['error']}"
    return "was cancelled" if end["state"] == "cancelled" else f"is not done: {end['error']}"
