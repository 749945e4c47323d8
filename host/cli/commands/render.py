"""The command `raygrid render`.

What is heavy to import (numba comes with it) is imported after the fork server was started, which imports the same beside it.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from raygrid.emulator.processes import Array
from raygrid.host.cli.commands.frames import run_frames
from raygrid.host.cli.progress import ProgressReporter
from raygrid.host.files.input_guard import check_outputs, note
from raygrid.host.image.frames import Turntable, check_patterns, path_of, wants_shot
from raygrid.host.image.outputs import check_named, check_path, check_picture_path, check_side, write_names
from raygrid.host.scene.load import check_allowed, check_name

if TYPE_CHECKING:
    from raygrid.host.image.picture import Encoder, Picture
    from raygrid.host.probes.probing import Probing
    from raygrid.host.render.job import Job
    from raygrid.node.links import FaultPlan
    from raygrid.node.programs import Program


@dataclass(frozen=True)
class RenderRequest:
    """What the command line asks for.

    scene     path of the scene
    shape     processors on each axis
    outputs   paths of pictures and sums
    stats     path of the statistics, or None
    profile   whether to say where the nodes' time went
    settings  of `raygrid.host.render.job.Settings`
    cost      a cost model for machine time, or None: no machine time is kept
    search    list, tree, or None: as the cost model says
    frames    first and last frame of a shot, or None
    turntable make the scene a shot of one turn, or None
    resume    skip frames of a shot whose files are there
    program   path of a program that the nodes are to run, or None
    allow_programs  whether the array takes programs
    probe_record, chrome_trace   paths of what probes tell `probe_rate` times a second, or None
    """

    scene: str
    shape: tuple[int, int, int]
    outputs: tuple[str, ...]
    batch: int
    budget: int
    transfer: str
    stats: str | None
    patience: float
    attempts: int
    fault: FaultPlan | None
    quiet: bool
    profile: bool
    settings: dict[str, Any]
    cost: str | None = None
    search: str | None = None
    frames: tuple[int, int] | None = None
    turntable: Turntable | None = None
    program: str | None = None
    allow_programs: bool = False
    probe_record: str | None = None
    chrome_trace: str | None = None
    probe_rate: float = 10.0
    resume: bool = False

    @property
    def patterns(self) -> tuple[str, ...]:
        """The names of all files that a frame has."""
        return (*self.outputs, *([] if self.stats is None else [self.stats]))

    @property
    def of_shot(self) -> bool:
        """Whether frames of a shot are asked for, and not a picture of the scene as it stands. Raises OutputError."""
        return wants_shot(self.frames, self.turntable is not None, self.patterns)


def run_render(request: RenderRequest) -> None:
    """Launch, read, load, trace, collect, write. Raises RaygridError."""
    check_allowed(request.program, request.allow_programs)
    if request.of_shot:
        run_frames(request)
        return
    request = _named(request)
    begun = time.perf_counter()
    check_name(request.scene)
    if request.cost is not None:
        _prices(request.cost, request.search)
    _check_outputs(request)
    with ProgressReporter(request.quiet, request.program is not None) as reporter, _probing(request) as probing:
        picture, encoding = _render(request, reporter, begun, probing)
        for output in request.outputs:
            reporter.phase(f"writing {output}")
            encoding.save(output)
        seconds = picture.stats["wall_seconds"]
        seconds["whole"] = round(time.perf_counter() - begun, 6)
        if request.stats is not None:
            from raygrid.host.render.stats import save_stats

            save_stats(request.stats, picture.stats)
        if (blank := picture.blank()) is not None:
            reporter.remark(blank)
        for line in _summary(picture):
            reporter.say(line)
        if request.profile:
            from raygrid.host.cli.profile_table import profile_table

            reporter.table(profile_table(picture.stats["nodes"]))
    write_names(request.outputs, request.patterns)


def _named(request: RenderRequest) -> RenderRequest:
    """The same with the names of files as they are, and not as patterns. Raises OutputError."""
    check_patterns(request.outputs, request.stats, None, False)
    stats = None if request.stats is None else path_of(request.stats, None)
    return replace(request, outputs=tuple(path_of(name, None) for name in request.outputs), stats=stats)


def _render(
    request: RenderRequest, reporter: ProgressReporter, begun: float, probing: Probing | None
) -> tuple[Picture, Encoder]:
    shape = request.shape
    with launching(request, reporter) as array:
        array.begin()
        reporter.phase(f"reading {request.scene}")
        job = _read_job(request, reporter, array.wait_warm)
        read = time.perf_counter()
        reporter.phase(f"launching {shape[0] * shape[1] * shape[2]} processors")
        from raygrid.host.image.picture import Encoder, prepare
        from raygrid.host.render.job import samples_expected
        from raygrid.host.render.retry import render_with_retries

        if not array.is_warm():
            prepare(request.outputs)
        array.wait_ready()
        ready = time.perf_counter()
        reporter.expect(samples_expected(job))
        if probing is not None:
            array.probe(request.probe_rate, probing.take)
        picture = render_with_retries(
            array,
            job,
            request.budget,
            reporter.watch,
            attempts=request.attempts,
            on_fault=reporter.fault,
            prices=None if request.cost is None else _prices(request.cost, request.search),
        )
        picture.stats["wall_seconds"] |= {"read": round(read - begun, 6), "launch": round(ready - read, 6)}
        reporter.phase("ending the processors")
        encoding = Encoder(picture, request.outputs, request.transfer)
    return picture, encoding


def _prices(name: str, search: str | None) -> dict[str, Any]:
    """The middle prices of a cost model as an order carries them. Raises CostError."""
    from raygrid.host.machine_time.cost_models import load_cost_model
    from raygrid.node.protocol import prices_order

    cost = load_cost_model(name)
    chosen = search or cost.file.search
    return prices_order(cost.prices("middle", chosen), cost.tests("middle") * (chosen == "list"))


def _probing(request: RenderRequest) -> AbstractContextManager[Probing | None]:
    """Takes what probes tell, if that is asked for; outside of the array, so that its troubles cost no picture."""
    if request.probe_record is None and request.chrome_trace is None:
        return contextlib.nullcontext()
    from raygrid.host.probes.probing import Probing

    return Probing(request.shape, request.probe_rate, request.probe_record, request.chrome_trace)


def launching(request: RenderRequest, reporter: ProgressReporter) -> Array:
    """The array that is asked for, not yet begun."""
    options: dict[str, Any] = {"fault": request.fault, "profile": request.profile, "programs": request.allow_programs}
    options["timed"] = request.cost is not None
    return Array(request.shape, request.batch, request.patience, reporter.warming, **options)


def program_of(request: RenderRequest) -> Program | None:
    """The program that is asked for. Raises SceneError."""
    from raygrid.host.render.program_file import read_program

    return None if request.program is None else read_program(request.program)


def _read_job(request: RenderRequest, reporter: ProgressReporter, wait_warm: Callable[[], None]) -> Job:
    from raygrid.host.render.import_block import hidden
    from raygrid.host.scene.load import load_scene

    with hidden("scipy"):
        from raygrid.host.render.job import Settings, make_job

    scene = load_scene(request.scene)
    for remark in scene.remarks:
        reporter.remark(remark)
    if scene.shot is not None and scene.shot.frames > 1:
        reporter.remark(f"frame 1 of {scene.shot.frames}; --frames 1-{scene.shot.frames} renders all")
    job = make_job(scene, request.shape, Settings(**request.settings, program=program_of(request)), wait_warm)
    check_outputs(_written(request))  # now that all is read
    for output in request.outputs:
        check_side(output, job.frame.width, job.frame.height)
    return job


def _written(request: RenderRequest) -> list[str]:
    """All files that are to be written."""
    return [*request.patterns, *(path for path in (request.probe_record, request.chrome_trace) if path is not None)]


def _check_outputs(request: RenderRequest) -> None:
    for output in request.outputs:
        check_picture_path(output)
    if request.stats is not None:
        check_path(request.stats)
    for path in (request.probe_record, request.chrome_trace):
        if path is not None:
            check_named(path)
    note_read(request)
    check_outputs(_written(request))


def note_read(request: RenderRequest) -> None:
    """Note what is named to be read, before it is: no output may be one of them."""
    note(request.scene, "the same file as the scene")
    if request.program is not None:
        note(request.program, "the same file as the program")


def _summary(picture: Picture) -> tuple[str, ...]:
    """What was traced, and the wall seconds of this computer (not of the machine of 1983)."""
    from raygrid.host.render.stats import ray_counts

    seconds, counts = picture.stats["wall_seconds"], ray_counts(picture.stats)
    rays = ", ".join(f"{count:,} {kind}" for kind, count in counts.items() if count) or "no"
    rate = sum(counts.values()) / max(seconds["trace"], 1e-9) / 1e6
    machine = (f"{picture.stats['ticks']:,} ticks of machine time",) if "ticks" in picture.stats else ()
    return (
        *machine,
        f"{rays} rays; {picture.stats['total']['hops']:,} hops",
        f"traced in {seconds['trace']:.2f} s of wall time ({rate:.2f} million rays/s), {seconds['whole']:.2f} s in all",
    )
