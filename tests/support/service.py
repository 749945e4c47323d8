"""Arrays that stay, for tests: up at the beginning of a file of tests, down at its end."""

from __future__ import annotations

import atexit
import contextlib
import functools
import json
import os
import shutil
import socket
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from numpy.typing import NDArray

import raygrid
from raygrid.host.client.client import Service
from raygrid.host.client.protocol import VERSION, message_splitter, pack
from raygrid.host.client.service_files import SOCKET, TOKEN, ServiceRecord, find, state_directory
from raygrid.host.scene.load import load_scene
from raygrid.node.errors import ArrayError
from support.cli import Outcome, as_process, warm_kernels
from support.processes import wait_dead
from support.render import rendered

SIZE = (64, 48)
SHAPE = "2x1x1"
TIMEOUT = 60.0  # seconds; only a failing test takes as long


def up(name: str, *more: str) -> dict[str, Any]:
    """Launch an array that stays; what `raygrid up --json` says."""
    outcome = as_process("up", "--name", name, "--array", SHAPE, "--json", *more)
    assert outcome.code == 0, outcome.err
    said: dict[str, Any] = json.loads(outcome.out)
    return said


def end(name: str) -> None:
    """End it, by whatever means, if it is up."""
    with contextlib.suppress(ArrayError):
        record = find(name)
        if as_process("down", "--name", name, "--cancel").code != 0:
            as_process("down", "--name", name, "--kill")
        wait_dead(record.pid)


@contextlib.contextmanager
def lasting(folder: Path, name: str = "test") -> Iterator[str]:
    """An array that is up for this block, with its journal below `folder`."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(folder))
        try:
            up(name)
            yield name
        finally:
            end(name)


@pytest.fixture(scope="module")
def name(warm_kernels: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """An array of 2x1x1 that is up for all tests of a file; one that ends it launches it again."""
    with lasting(tmp_path_factory.mktemp("state")) as launched:
        yield launched


@pytest.fixture
def array(name: str) -> Iterator[Service]:
    """A connection to it; what a test leaves behind is cancelled."""
    with raygrid.connect(name) as connected:
        yield connected
        connected.cancel(None)


def on(name: str, *arguments: str, **options: Any) -> Outcome:
    """Run a command on that array."""
    return as_process(*arguments, "--name", name, **options)


@pytest.fixture
def array_of_now(name):
    """A connection to the array; what a test leaves behind is cancelled, in the service that is up by then."""
    with raygrid.connect(name) as connected:
        yield connected
    with raygrid.connect(name) as connected:
        connected.cancel(None)


@functools.cache
def shot_of(scene: Path, frames: int) -> Path:
    """A file of a shot of so many frames in which nothing of the scene moves: all have the same bits."""
    folder = Path(tempfile.mkdtemp())
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    shutil.copy(scene, folder)
    file = folder / f"{scene.stem}.toml"
    file.write_text(f'include = "{scene.name}"\n[shot]\nframes = {frames}\n')
    return file


def sums(scene: Path | str, **settings: Any) -> NDArray[np.int64]:
    """The sums by an array inside this process."""
    return rendered(load_scene(scene), **({"size": SIZE} | settings)).sums


def watch_until(service: Service, job: int, what: str, from_frame: int = 0, **facts: Any) -> dict[str, Any]:
    """Follow a job until an event of it comes with these facts, of this frame or a later one.

    Who begins to follow hears of what comes from then on: a frame may be done by then.
    """

    class Found(Exception):
        pass

    found: list[dict[str, Any]] = []

    def look(event: dict[str, Any]) -> None:
        if event["what"] == what and facts.items() <= event.items() and (event.get("frame") or 0) >= from_frame:
            found.append(event)
            raise Found

    with contextlib.suppress(Found), raygrid.connect(service.name) as own:
        own.wait(job, look)
    assert found, f"{what} {facts} did not come"
    return found[0]


def scribe_of(service: Service) -> int:
    """The process that reads scenes for an array that is up."""
    (found,) = scribes_of(service)
    return found


def scribes_of(service: Service) -> list[int]:
    """As `scribe_of`; none where it has just ended."""
    found = []
    for child in psutil.Process(service.pid).children():
        with contextlib.suppress(psutil.NoSuchProcess, psutil.ZombieProcess):
            if "raygrid.host.service.scribe_process" in child.cmdline():
                found.append(int(child.pid))
    return found


class Peer:
    """A bare socket at the door of a service."""

    def __init__(self, record: ServiceRecord) -> None:
        self._splitter = message_splitter()
        self.token = Path(record.directory, TOKEN).read_text()
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.settimeout(TIMEOUT)
        self.socket.connect(os.path.join(record.directory, SOCKET))

    def greet(self) -> None:
        """Be let in."""
        self.send(pack({"do": "hello", "version": VERSION, "token": self.token}))
        answer = self.receive()
        assert answer is not None
        assert answer["is"] == "welcome"

    def send(self, data: bytes) -> None:
        """Send bytes; a door that has closed already is no error."""
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            self.socket.sendall(data)

    def receive(self) -> dict[str, Any] | None:
        """The next message, None if the door was closed."""
        while (message := self._splitter.next()) is None:
            try:
                piece = self.socket.recv(1 << 16)
            except ConnectionResetError:
                piece = b""
            if not piece:
                return None
            self._splitter.feed(piece)
        return message

    def __enter__(self) -> Peer:
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()


__all__ = [
    "SHAPE",
    "SIZE",
    "Peer",
    "array",
    "array_of_now",
    "end",
    "lasting",
    "name",
    "on",
    "scribe_of",
    "scribes_of",
    "shot_of",
    "state_directory",
    "sums",
    "up",
    "warm_kernels",
    "watch_until",
]
