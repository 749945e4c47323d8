"""The service that faults are tried on: an array that stays, up for many cases, with a client whose jobs must go on."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import psutil
from faults_bed import BUDGET, SCENES, SETTINGS, Case, Frame, Outcome, render, truth

import raygrid
from raygrid.emulator.processes.array import Array
from raygrid.host.client.client import Service, wait_gone
from raygrid.host.client.service_files import ServiceRecord, find, state_directory
from raygrid.host.render.job import Settings
from raygrid.node.errors import RaygridError

RAYGRID = str(Path(sys.executable).with_name("raygrid"))
NAME = "campaign"
SHAPE = (2, 1, 1)
SIZE, SAMPLES = SETTINGS.size, SETTINGS.samples
TINY, MOBILE = SCENES / "tiny.nff", SCENES / "mobile.toml"
COMMAND_SECONDS = 100.0
MOST_MEMORY = 3e9  # bytes of the service and all its processes, whatever a scene brings
MORE_THREADS, MORE_DESCRIPTORS = 8, 4  # a pool of threads for requests, and databases that are opened now and then


class Wrong(Exception):
    """Something that must not be."""


class ServiceBed:
    """An array that stays. Use as a context manager.

    folder  of its outputs, empty at the beginning of each case
    """

    def __init__(self, folder: Path) -> None:
        self.root, self.folder = folder, folder / "out"
        self._before: tuple[int, int, int] | None = None

    # --- cases ---------------------------------------------------------------------------------------

    def run(self, case: Case) -> Outcome:
        """One case; then the array must be up and right, and nothing may lie beside the outputs."""
        self.empty(self.folder)
        try:
            outcome = case.do(self)
            if outcome.what != "wrong":
                self.check()
        except Wrong as error:
            outcome = Outcome("wrong", str(error))
        except RaygridError as error:
            outcome = Outcome("wrong", f"{type(error).__name__}: {error}")
        except Exception as error:  # what raygrid does not raise on purpose is a bug, and no refusal
            outcome = Outcome("wrong", f"{type(error).__name__}: {error}")
        if outcome.what == "wrong":
            self.renew()
        return outcome

    def check(self) -> None:
        """The array is up, renders right, and has left no part of a file. Raises Wrong."""
        with raygrid.connect(NAME) as array:
            picture = self.folder / "check.npy"
            array.submit(TINY, output=picture, size=SIZE, samples=SAMPLES).wait()
            right(picture)
            status = array.status()
        if status["state"] != "ready":
            raise Wrong(f"the array is {status['state']}: {status['why']}")
        if status["journal"]["trouble"]:
            raise Wrong(f"the journal has trouble: {status['journal']['trouble']}")
        parts = [
            path.name for path in self.folder.rglob("*") if path.name.startswith(".raygrid") or ".part" in path.name
        ]
        if parts:
            raise Wrong(f"parts of files are left: {parts}")

    # --- its life ------------------------------------------------------------------------------------

    def up(self, *more: str) -> subprocess.CompletedProcess[str]:
        """Run `raygrid up`."""
        shape = "x".join(map(str, SHAPE))
        return command("up", "--name", NAME, "--array", shape, "--json", "--allow-programs", "--patience", "20", *more)

    def bring_up(self) -> None:
        """Have it up. Raises Wrong if it cannot be."""
        with contextlib.suppress(RaygridError):
            find(NAME)
            return
        done = self.up()
        if done.returncode != 0:
            raise Wrong(f"raygrid up: exit code {done.returncode}: {done.stderr.strip()}")

    def down(self) -> None:
        """Have it down, whatever state it is in."""
        with contextlib.suppress(RaygridError):
            record = find(NAME)
            if command("down", "--name", NAME).returncode != 0:
                command("down", "--name", NAME, "--kill")
                with contextlib.suppress(OSError):
                    os.kill(record.pid, 9)
            wait_gone(record, 30.0)

    def renew(self) -> None:
        """After something wrong: another service, with another journal."""
        self.end_all()
        shutil.rmtree(state_directory(NAME), ignore_errors=True)
        self.bring_up()
        self._before = self._use()

    def end_all(self) -> None:
        """End the service, even one that nobody finds any more."""
        self.down()
        for process in services():
            with contextlib.suppress(psutil.Error):
                process.kill()
                process.wait(10.0)

    @staticmethod
    def empty(folder: Path) -> None:
        """Have a folder with nothing in it."""
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()

    @property
    def record(self) -> ServiceRecord:
        """Where it is."""
        return find(NAME)

    def left(self) -> list[str]:
        """Threads, descriptors and memory that the service has more than at the beginning of the kind, if it is the same."""
        before, after = self._before, self._use()
        self._before = after
        found = [f"a service beside it: {process.pid}" for process in services() if process.pid != self.record.pid]
        if before is not None and before[0] == after[0]:
            if after[1] > before[1] + MORE_THREADS:
                found.append(f"{after[1] - before[1]} threads of the service")
            if after[2] > before[2] + MORE_DESCRIPTORS:
                found.append(f"{after[2] - before[2]} descriptors of the service")
        return found

    def _use(self) -> tuple[int, int, int]:
        process = psutil.Process(self.record.pid)
        return process.pid, process.num_threads(), process.num_fds()

    def __enter__(self) -> Self:
        self.bring_up()
        self._before = self._use()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.end_all()


def services() -> list[psutil.Process]:
    """All processes of a service of the campaign."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, OSError):
            line = process.cmdline()
            if "raygrid.host.service.process" in line and line[line.index("raygrid.host.service.process") + 1] == NAME:
                environment = process.environ()
                if environment.get("XDG_STATE_HOME") == os.environ["XDG_STATE_HOME"]:
                    found.append(process)
    return found


def command(*arguments: str, seconds: float = COMMAND_SECONDS, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run a command of raygrid."""
    return subprocess.run(
        [RAYGRID, *arguments],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        errors="replace",
        timeout=seconds,
        **options,
    )


FRAMES = 12  # of the mobile, that are used


@cache
def mobile_truth() -> dict[int, np.ndarray]:
    """The sums of its frames, from an array to which nothing happens."""
    settings = Settings(size=SIZE, samples=SAMPLES)
    with Array.launch(SHAPE) as array:
        frames = range(1, FRAMES + 1)
        return {number: render(array, Frame(MOBILE, settings, BUDGET, number)).sums for number in frames}


def right(file: Path, scene: Path = TINY, frame: int | None = None) -> None:
    """Raise Wrong unless a file has the bits of an undisturbed run: of a still scene, or of a frame of the mobile."""
    still = Frame(scene, Settings(size=SIZE, samples=SAMPLES), BUDGET)
    wanted = truth(SHAPE, still) if frame is None else mobile_truth()[frame]
    if not file.exists():
        raise Wrong(f"{file.name} is not there")
    if not np.array_equal(np.load(file), wanted):
        raise Wrong(f"{file.name} has other bits than an undisturbed run")


def one_line(text: str) -> str:
    """An error that came, if it is one line that a terminal can show and no bug. Raises Wrong."""
    if "a bug" in text or "Traceback" in text:
        raise Wrong(f"a bug: {text[:300]}")
    if "\n" in text.strip("\n") or len(text) > 4000 or not text.strip():
        raise Wrong(f"not one line: {len(text)} characters, {text[:300]!r}")
    if any(ord(letter) < 32 or 0xD800 <= ord(letter) < 0xE000 for letter in text.strip("\n")):
        raise Wrong(f"letters that no terminal should get: {text[:300]!r}")
    return text.strip()


@contextlib.contextmanager
def neighbour(bed: ServiceBed, frames: int = 4) -> Iterator[None]:
    """Another client, whose job must be done and right after what is tried in this block."""
    with raygrid.connect(NAME) as array:
        job = submit(array, bed.folder / "neighbour_%d.npy", MOBILE, frames=(1, frames))
        yield
        job.wait()
    for frame in range(1, frames + 1):
        right(bed.folder / f"neighbour_{frame}.npy", frame=frame)


@contextlib.contextmanager
def modest() -> Iterator[None]:
    """The service and its processes never hold more than MOST_MEMORY in this block. Raises Wrong."""
    over, most = threading.Event(), 0

    def look() -> None:
        nonlocal most
        while not over.wait(0.1):
            for process in services():
                with contextlib.suppress(psutil.Error):
                    every = [process, *process.children(recursive=True)]
                    most = max(most, sum(one.memory_info().rss for one in every))

    thread = threading.Thread(target=look)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
    if most > MOST_MEMORY:
        raise Wrong(f"the service held {most / 1e9:.1f} GB, wanted at most {MOST_MEMORY / 1e9:g}")


def submit(array: Service, output: Path, scene: Path = TINY, **more: Any) -> Any:
    """A job of the campaign's size."""
    return array.submit(scene, output=output, **({"size": SIZE, "samples": SAMPLES} | more))


def wait_until(true: Callable[[], bool], seconds: float, what: str) -> None:
    """Wait until something is so. Raises Wrong if it is not within that time."""
    deadline = time.monotonic() + seconds
    while not true():
        if time.monotonic() > deadline:
            raise Wrong(f"{what} did not come within {seconds:g} s")
        time.sleep(0.02)
