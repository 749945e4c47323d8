"""What the fault campaign runs on: an array that lives through all cases, and moments at which to strike."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from raygrid.emulator.driver import driver
from raygrid.emulator.processes.array import WARM_SECONDS, Array
from raygrid.emulator.processes.fork_server_client import ForkServerClient
from raygrid.host.image.picture import Picture
from raygrid.host.render.animation_jobs import AnimationJobs
from raygrid.host.render.frame import Watch
from raygrid.host.render.job import Job, Settings, make_job
from raygrid.host.render.program_file import read_program
from raygrid.host.render.retry import FaultReport
from raygrid.host.render.session import RenderSession
from raygrid.host.scene.load import load_scene
from raygrid.node.errors import RaygridError

Shape = tuple[int, int, int]
SHAPES: tuple[Shape, ...] = ((2, 2, 2), (4, 3, 1))
SCENES = Path(__file__).parents[1] / "scenes"
SCENE = SCENES / "kinds.nff"
SETTINGS = Settings(size=(96, 72), samples=2)
BUDGET = 2000  # so small that tracing takes many waves, and there are moments to strike at
ATTEMPTS = 8
MOMENTS = ("idle", "load", "trace", "collect", "reset")


@dataclass(frozen=True)
class Frame:
    """What is rendered. `number`: of a shot."""

    scene: Path
    settings: Settings
    budget: int
    number: int | None = None


SMALL = Frame(SCENE, SETTINGS, BUDGET)
# for which a node needs more memory than for the small one, in loading and in tracing
LARGE = Frame(SCENES / "room.glb", Settings(size=(384, 288), samples=2), driver.BUDGET)


@cache
def programmed() -> Frame:
    """A frame for which the nodes run a program."""
    settings = Settings(size=(96, 72), samples=2, program=read_program(SCENES / "programs" / "marble.py"))
    return Frame(SCENES / "marble.toml", settings, BUDGET)


def moving(number: int) -> Frame:
    """A frame of a shot, which follows another one by an increment."""
    return Frame(SCENES / "mobile.toml", Settings(size=(96, 72), samples=1), BUDGET, number)


@dataclass(frozen=True)
class Outcome:
    """What came of a case: same, refused, wrong or hang, and why; seconds until faults were told, and then made good."""

    what: str
    why: str = ""
    noticed: tuple[float, ...] = ()
    ready: tuple[float, ...] = ()


@dataclass(frozen=True)
class Case:
    """One fault: a name that says all about it, and what does it and tells what came of it."""

    name: str
    do: Callable[[Any], Outcome]


@dataclass
class Strike:
    """Does something once at a moment: as a watcher of a frame, and of the resets that it takes.

    moment  a phase, "idle" (before the frame) or "reset" (while the array recovers from another fault)
    nth     at which call of the watcher while tracing; if there are fewer, when collecting begins
    """

    moment: str
    nth: int
    act: Callable[[], Any]
    at: float = 0.0
    _seen: int = field(default=0)

    def now(self) -> None:
        """Strike, if it has not been done."""
        if not self.at:
            self.act()
            self.at = time.perf_counter()

    def watch(self, phase: str, progress: Any) -> None:
        """Told by a render session."""
        self._seen += phase == "trace" and progress is not None
        if self.moment == phase != "trace" or (
            self.moment == "trace" and (self._seen >= self.nth or phase == "collect")
        ):
            self.now()


class Bed:
    """An array of one shape on which cases are run one after the other. Use as a context manager.

    faults   what was told of in the last frame that was struck
    """

    def __init__(self, shape: Shape, folder: Path) -> None:
        self.shape, self.folder = shape, folder
        self.faults: list[str] = []
        self._seconds: dict[Frame, float] = {}
        self.array = Array(shape, patience=20.0, programs=True)

    def run(self, case: Case) -> Outcome:
        """One case, and a right frame of this array after it."""
        try:
            outcome = case.do(self)
            if outcome.what != "wrong" and not right(render(self.array), self.shape):
                return Outcome("wrong", "the frame after it has other bits")
        except RaygridError as error:
            return Outcome("wrong", f"the frame after it failed: {error}")
        except Exception as error:  # what raygrid does not raise on purpose is a bug, and no refusal
            return Outcome("wrong", f"{type(error).__name__}: {error}")
        return outcome

    def strike(self, strike: Strike, frame: Frame = SMALL) -> Outcome:
        """A frame that is struck."""
        self.faults.clear()
        noticed: list[float] = []
        ready: list[float] = []

        def on_fault(fault: FaultReport) -> None:
            self.faults.append(fault.what)
            if strike.at and not noticed:
                told = time.perf_counter() - fault.seconds[1]
                noticed.append(max(0.0, told - strike.at))
                ready.append(fault.seconds[1])

        if strike.moment == "idle":
            strike.now()
        with struck_reset(self.array, strike):
            if strike.moment == "reset":
                os.kill(self.array.pids[-1], 9)
            work = partial(render, self.array, frame, watch=strike.watch, on_fault=on_fault)
            outcome = judge(work, self, frame)
        if outcome.what == "same" and not strike.at:
            return Outcome("wrong", "nothing was struck")
        return Outcome(outcome.what, outcome.why, tuple(noticed), tuple(ready))

    def strike_after(self, part: float, act: Callable[[], Any], frame: Frame = SMALL) -> Outcome:
        """A frame that is struck when a part of the time has gone by that it takes if nothing happens."""
        seconds = self.seconds(frame)
        ready: list[float] = []
        timer = threading.Timer(part * seconds, act)
        timer.start()
        try:
            work = partial(render, self.array, frame, on_fault=lambda fault: ready.append(fault.seconds[1]))
            outcome = judge(work, self, frame)
        finally:
            timer.join()  # one that comes after the frame strikes an idle array
        return Outcome(outcome.what, outcome.why, ready=tuple(ready))

    def seconds(self, frame: Frame) -> float:
        """What a frame takes if nothing happens, its loading included."""
        if frame not in self._seconds:
            other = SMALL if frame.number is None else moving(frame.number - 1)
            render(self.array, other)
            begun = time.perf_counter()
            render(self.array, frame)
            self._seconds[frame] = time.perf_counter() - begun
        return self._seconds[frame]

    def renew(self) -> None:
        """After a hang: another array."""
        self.array.__exit__(TimeoutError, TimeoutError(), None)
        self.array = Array(self.shape, patience=20.0, programs=True)
        self.__enter__()

    def left(self) -> list[str]:
        """What a kind has left behind while this goes on: nothing that could be seen before the end."""
        return []

    def __enter__(self) -> Self:
        self.array.begin()
        self.array.wait_ready()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.array.__exit__(kind, error, trace)


@contextlib.contextmanager
def struck_reset(array: Array, strike: Strike) -> Any:
    """If the moment is that of a reset: strike when the nodes have been told and the first links come up."""
    if strike.moment != "reset":
        yield
        return
    hang_up = array._hang_up

    def struck() -> None:
        hang_up()
        if array.epoch >= 0:
            strike.now()

    array._hang_up = struck  # type: ignore[method-assign]
    try:
        yield
    finally:
        del array._hang_up  # type: ignore[method-assign]


def render(
    array: Array,
    frame: Frame = SMALL,
    watch: Watch | None = None,
    on_fault: Callable[[FaultReport], None] | None = None,
) -> Picture:
    """A frame of the campaign."""
    return RenderSession(array, ATTEMPTS, on_fault).render(job(array.shape, frame), frame.budget, watch)


def judge(work: Callable[[], Picture], bed: Bed, frame: Frame = SMALL) -> Outcome:
    """Whether a frame is right, or was refused in one line."""
    try:
        return Outcome("same") if right(work(), bed.shape, frame) else Outcome("wrong", "other bits")
    except RaygridError as error:
        if "\n" in str(error):
            return Outcome("wrong", f"not one line: {error}")
        bed.array.reset()
        return Outcome("refused", str(error))


@cache
def job(shape: Shape, frame: Frame = SMALL) -> Job:
    """A frame, ready for an array."""
    if frame.number is not None:
        return shot(shape, frame.scene, frame.settings).job(frame.number)
    return make_job(load_scene(frame.scene), shape, frame.settings)


@cache
def shot(shape: Shape, scene: Path, settings: Settings) -> AnimationJobs:
    """The frames of a shot, which share their surfaces: so they can follow each other by increments."""
    return AnimationJobs(load_scene(scene), shape, settings, 1)


@cache
def truth(shape: Shape, frame: Frame) -> np.ndarray:
    """Its sums, from an array to which nothing happens."""
    with Array.launch(shape, programs=frame.settings.program is not None) as array:
        picture = render(array, frame)
    assert picture.stats["faults"] == []
    return picture.sums


def right(picture: Picture, shape: Shape, frame: Frame = SMALL) -> bool:
    """Whether a picture has the bits of an undisturbed run."""
    return np.array_equal(picture.sums, truth(shape, frame))


def warm() -> None:
    """Compile what is not in the cache yet, so that no case has to wait for it."""
    with ForkServerClient.start() as fork_server:
        fork_server.wait_warm(WARM_SECONDS)
    with Array.launch((1, 1, 1), programs=True, patience=WARM_SECONDS) as array:
        render(array, programmed())


def text_of(shape: Shape) -> str:
    """As "2x2x2"."""
    return "x".join(map(str, shape))
