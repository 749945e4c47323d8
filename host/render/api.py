"""The Python interface: launch an array, render scenes on it."""

from __future__ import annotations

import contextlib
import logging
import math
import threading
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Unpack

from raygrid.emulator.driver import BUDGET, PATIENCE, NodeSample, Progress
from raygrid.emulator.processes import BATCH, NOTE, Array, kind_of
from raygrid.emulator.topology import parse_shape
from raygrid.host.image.layer_names import checked_layers
from raygrid.host.image.picture import Picture
from raygrid.host.render.animation_jobs import jobs_of
from raygrid.host.render.frame import Watch
from raygrid.host.render.given_settings import GivenSettings, parted
from raygrid.host.render.job import Job, Settings, make_job, samples_expected
from raygrid.host.render.program_file import read_program
from raygrid.host.render.progress import ProgressHook, RenderProgress, following, traced_part
from raygrid.host.render.retry import ATTEMPTS, FaultReport
from raygrid.host.render.session import RenderSession
from raygrid.host.scene.load import load_scene
from raygrid.host.text.remarks import remark
from raygrid.node.errors import ArrayError
from raygrid.node.links import parse_fault
from raygrid.node.programs import Program

if TYPE_CHECKING:
    from raygrid.host.scene.load import SceneLike

MOST_BATCH = 8192  # packets; their message stays far below the longest that a link takes

__all__ = ["Machine", "Picture", "launch", "load_scene"]


class Machine:
    """A launched array. Use as a context manager; when it closes, no process, socket or file is left.

    One thread at a time may use it; another one is refused by an ArrayError meanwhile. But any may close it.
    """

    def __init__(self, array: Array, allow_outside: bool = False) -> None:
        self._array, self._allow_outside = array, allow_outside
        self._in_use = threading.RLock()  # what is told of the work may use the array, in the same thread
        self._told: set[str] = set()  # remarks on scenes: each is told once

    @contextlib.contextmanager
    def _use(self) -> Iterator[Array]:
        """The array, for this thread alone. Raises ArrayError while another thread has it."""
        if not self._in_use.acquire(blocking=False):
            raise ArrayError(
                "the array is in use by another thread, wanted one at a time: launch an array for each, "
                "or one that stays (raygrid up), to which many may raygrid.connect"
            )
        try:
            yield self._array
        finally:
            self._in_use.release()

    def __repr__(self) -> str:
        return f"<raygrid.Machine {'x'.join(map(str, self.shape))}>"

    @property
    def shape(self) -> tuple[int, int, int]:
        """Processors on each axis."""
        return self._array.shape

    @property
    def pids(self) -> tuple[int, ...]:
        """Process ids of the nodes, x fastest. Nodes that were lost are replaced by new ones."""
        return tuple(self._array.pids)

    def render(
        self,
        scene: SceneLike,
        *,
        budget: int = BUDGET,
        watch: Watch | None = None,
        attempts: int = ATTEMPTS,
        program: str | Path | Program | None = None,
        layers: Iterable[str] = (),
        progress: ProgressHook | bool = True,
        **settings: Unpack[GivenSettings],
    ) -> Picture:
        """Render a scene: the path of a file, a raygrid.Scene, what load_scene gives, or an object of trimesh (docs/scenes.md).

        settings  size, samples, depth, min_weight, highlights, split (`raygrid.host.render.machine_job.Settings`), and eye,
                  at, up, fov, camera, fit, lights, background, crease (`raygrid.host.scene.view.GivenView`)
        budget    packets in flight below which new primary rays are admitted
        watch     called with (phase, progress) as the work goes on
        attempts  how often to try in all: when a node is lost or a link breaks, the array is reset and the frame
                  begins anew; what happened is in the picture's stats["faults"]
        program   path of a program for the nodes (docs/programs.md), on a machine launched with allow_programs
        layers    names of layers that the picture is to have: "depth", "normal", "surface", "material" (`Picture.layers`)
        progress  True: a bar in a notebook; False: none; a function: called with a RenderProgress as the work goes on
        What is to be said of scene and picture goes to the logger "raygrid" (`raygrid.host.text.remarks`).
        Raises SceneError for a scene or settings that cannot be rendered, ArrayError if the array fails.
        """
        with self._use() as array:
            frame, view = parted(settings)
            asked = self._settings(frame, program, layers)
            job = make_job(load_scene(scene, self._allow_outside, **view), self.shape, asked)
            with following(progress, job.scene.name) as hook:
                picture = RenderSession(array, attempts, _tell_fault).render(job, budget, _watching(job, hook, watch))
        self._tell_remarks(job, picture)
        return picture

    def render_frames(
        self,
        scene: SceneLike,
        frames: Iterable[int] | None = None,
        *,
        budget: int = BUDGET,
        watch: Watch | None = None,
        attempts: int = ATTEMPTS,
        program: str | Path | Program | None = None,
        layers: Iterable[str] = (),
        progress: ProgressHook | bool = True,
        **settings: Unpack[GivenSettings],
    ) -> Iterator[Picture]:
        """Render frames of a shot one after the other, from one to the next by increments; each has the bits that it
        has alone.

        frames  their numbers, from 1; None: all of the shot
        The rest, and what is raised, as for `render`. `raygrid.host.scene.animation.turntable` makes a shot of a still scene.
        """
        frame, view = parted(settings)
        read = load_scene(scene, self._allow_outside, **view)
        with following(progress, read.name) as hook:
            for job in jobs_of(read, self.shape, self._settings(frame, program, layers), frames):
                with self._use() as array:  # not while the caller has the picture
                    session = RenderSession(array, attempts, _tell_fault)
                    picture = session.render(job, budget, _watching(job, hook, watch))
                self._tell_remarks(job, picture)
                yield picture

    def _tell_remarks(self, job: Job, picture: Picture) -> None:
        for text in (f"{job.scene.name}: {words}" for words in job.scene.remarks):
            if text not in self._told:
                self._told.add(text)
                remark(text)
        if (blank := picture.blank()) is not None:
            remark(f"{job.scene.name}: {blank}", logging.WARNING)

    def _settings(self, given: dict[str, Any], program: str | Path | Program | None, layers: Iterable[str]) -> Settings:
        if program is not None and not self._array.programs:
            raise ArrayError("a program is code that runs with your rights, wanted launch(..., allow_programs=True)")
        read = read_program(program) if isinstance(program, str | Path) else program
        return Settings(**given, program=read, layers=checked_layers(layers))

    def probe(self, rate: float, watch: Callable[[NodeSample], object] | None) -> None:
        """Let every node tell `rate` times a second how it stands, while the array renders; 0: no more (docs/probes.md).

        watch  called with each `raygrid.emulator.driver.samples.NodeSample`
        Raises ProtocolError for a rate that cannot be.
        """
        with self._use() as array:
            array.probe(rate, watch)

    def reset(self) -> None:
        """The reset line: drop whatever the array holds or does; afterwards it is empty and ready (`Array.reset`)."""
        with self._use() as array:
            array.reset()

    def close(self) -> None:
        """End the array. May be called twice, and by any thread: what another one renders is given up, by an ArrayError."""
        with self._taken():
            self._array.close()

    @contextlib.contextmanager
    def _taken(self) -> Iterator[None]:
        """The array for this thread, as soon as another one has given up what it does with it."""
        if not self._in_use.acquire(blocking=False):
            self._array.on_wait = _give_up
            self._in_use.acquire()
        try:
            self._array.on_wait = None
            yield
        finally:
            self._in_use.release()

    def __enter__(self) -> Machine:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._taken():
            self._array.__exit__(kind, error, trace)


def _watching(job: Job, hook: ProgressHook | None, watch: Watch | None) -> Watch | None:
    """Tells both how far the render of a job is; None if nobody is to be told."""
    if hook is None:
        return watch
    expected = samples_expected(job)

    def tell(phase: str, now: Progress | None) -> None:
        if watch is not None:
            watch(phase, now)
        if now is None:
            hook(RenderProgress(phase, 1.0 if phase == "collect" else 0.0, 0, job.number))
        else:
            hook(RenderProgress(phase, traced_part(now, expected), now.in_flight, job.number))

    return tell


def _tell_fault(fault: FaultReport) -> None:
    remark(f"{fault.what}; the array was reset in {fault.seconds[1]:.2f} s, and the frame begins anew", logging.WARNING)


def _warming() -> Callable[[int, int, str], None]:
    """Tells of a first run, which compiles the kernels."""
    told: set[str] = set()

    def tell(_done: int, _total: int, what: str) -> None:
        if what.startswith(NOTE):
            remark(what.removeprefix(NOTE))
        elif (kind := kind_of(what)) is not None and kind not in told:
            told.add(kind)
            remark(f"compiling the kernels of {kind}, once on this computer: a minute", logging.WARNING)

    return tell


def _give_up() -> None:
    raise ArrayError("the array was closed by another thread while it was in use")


def launch(
    shape: str | tuple[int, int, int] = "2x2x2",
    *,
    batch: int = BATCH,
    patience: float = PATIENCE,
    allow_programs: bool = False,
    allow_outside: bool = False,
    fault: str | None = None,
) -> Machine:
    """Launch an array of node processes on this computer, and wait until it is ready.

    shape     processors on each axis, "2x2x2" or (2, 2, 2)
    batch     most packets a message
    patience  seconds without any progress after which the array is taken to hang
    allow_programs  whether nodes take programs: code that runs with your rights
    allow_outside   whether files of scenes may refer to files outside their folders, which are read with your rights
    fault     for experiments: what links between neighbours do to messages, "KIND[:RATE[:SEED]]" (`node.links.faulty_channel`)
    Raises ValueError for what none of these can be, TooLarge for an array that does not fit this computer.
    """
    if not 1 <= batch <= MOST_BATCH:
        raise ValueError(f"a batch came as {batch}, wanted 1 to {MOST_BATCH} packets")
    if not 0.0 < patience < math.inf:
        raise ValueError(f"a patience came as {patience}, wanted seconds above 0")
    cells = parse_shape(shape if isinstance(shape, str) else "x".join(map(str, shape)))
    plan = None if fault is None else parse_fault(fault)
    options = {"batch": batch, "patience": patience, "fault": plan, "programs": allow_programs}
    array = Array.launch(cells, on_warming=_warming(), **options)
    return Machine(array, allow_outside)
