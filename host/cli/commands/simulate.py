"""Carries out `raygrid simulate`: a frame in machine time, in one process."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from raygrid.emulator.processes import SIMULATOR
from raygrid.host.cli.progress import ProgressReporter
from raygrid.host.files.input_guard import STANDARD, check_outputs, note
from raygrid.host.image.outputs import (
    check_folder,
    check_path,
    check_picture_path,
    check_side,
    made_folder,
    write_lines,
)
from raygrid.host.render.given_settings import GivenSettings, parted
from raygrid.host.render.stats import save_stats
from raygrid.host.scene.load import check_name
from raygrid.host.scene.view import view_of

if TYPE_CHECKING:
    from raygrid.host.machine_time.simulate import Simulated

Stats = dict[str, Any]

KERNELS = 70  # of the simulator, about


@dataclass(frozen=True)
class SimulateRequest:
    """What the command line asks for.

    scene     path of the scene
    shape     processors on each axis
    cost      name or path of a cost model
    search    list, tree, or None: as the cost model says
    band      low and high costs, too
    outputs, stats, table, plots   paths to write, plots being a folder
    frame     of a shot, None for its first
    as_json   what came out as JSON, instead of the summary
    settings  of the frame and of the view
    """

    scene: str
    shape: tuple[int, int, int]
    cost: str
    search: str | None
    band: bool
    outputs: tuple[str, ...]
    stats: str | None
    table: str | None
    plots: str | None
    transfer: str
    quiet: bool
    frame: int | None
    as_json: bool
    settings: GivenSettings


def run_simulate(request: SimulateRequest) -> None:
    """Read, simulate, write, and say what came out. Raises RaygridError."""
    check_name(request.scene)
    view_of(parted(request.settings)[1])
    _check_outputs(request)
    with ProgressReporter(request.quiet) as reporter:
        done = _simulate(request, reporter)
        stats = _write(request, done, reporter)
        if request.as_json:
            save_stats(STANDARD, {"nodes": [], **stats})
            return
        lines = summary(done, stats)
        if STANDARD in _written(request):  # where the summary would be in the way
            reporter.table(lines)
            return
    write_lines(lines)


def _simulate(request: SimulateRequest, reporter: ProgressReporter) -> Simulated:
    reporter.phase(f"reading {request.scene}")
    from raygrid.host.machine_time.cost_models import load_cost_model
    from raygrid.host.render.animation_jobs import still_job
    from raygrid.host.render.job import Settings
    from raygrid.host.scene.animation.scene_frames import frame_told
    from raygrid.host.scene.load import load_scene

    cost = load_cost_model(request.cost)
    settings, view = parted(request.settings)
    scene = load_scene(request.scene, **view)
    for remark in scene.remarks:
        reporter.remark(remark)
    if told_frame := frame_told(scene, request.frame):
        reporter.remark(told_frame)
    check_outputs(_written(request))  # now that all is read
    with compiling(reporter):
        from raygrid.host.machine_time.simulate import simulate_job

        job = still_job(scene, request.shape, Settings(**settings), request.frame)
        for output in request.outputs:
            check_side(output, job.frame.width, job.frame.height)
        reporter.phase("simulating")
        return simulate_job(job, cost, request.search, request.band, tell=phase_reporter(reporter))


def phase_reporter(reporter: ProgressReporter) -> Callable[[str, int, int], None]:
    """A teller for `simulate_job`: the phase, events so far, and how many a second."""
    from raygrid.emulator.processes import now

    begun = now()

    def tell(phase: str, events: int, died: int) -> None:
        rate = events / max(now() - begun, 1e-3) / 1e6
        reporter.phase(
            f"{phase}: {events / 1e6:.0f} million events, {died / 1e6:.1f} million packets done, {rate:.1f} M/s"
        )

    return tell


def compiling(reporter: ProgressReporter, kind: str = SIMULATOR) -> AbstractContextManager[object]:
    """While this lasts, kernels that have to be compiled are told of."""
    from raygrid.emulator.processes import told_of

    return told_of(reporter.warming, kind, KERNELS)


def _check_outputs(request: SimulateRequest) -> None:
    for output in request.outputs:
        check_picture_path(output)
    for path in (request.stats, request.table):
        if path is not None:
            check_path(path)
    if request.plots is not None:
        from raygrid.host.machine_time.plots import check_matplotlib

        check_folder(request.plots)
        check_matplotlib()
    note(request.scene, "the same file as the scene")
    check_outputs(_written(request))


def _written(request: SimulateRequest) -> list[str]:
    """All files that are to be written."""
    written = [*request.outputs, *(path for path in (request.stats, request.table) if path is not None)]
    if request.plots is not None:
        from raygrid.host.machine_time.plots import FILES

        written += [str(Path(request.plots) / name) for name in FILES]
    return written


def _write(request: SimulateRequest, done: Simulated, reporter: ProgressReporter) -> Stats:
    from raygrid.host.image.picture import Picture
    from raygrid.host.machine_time.simulate_stats import make_stats, save_csv

    stats = make_stats(done)
    picture = Picture(done.sums, done.job.frame.samples, stats)
    for output in request.outputs:
        reporter.phase(f"writing {output}")
        picture.save(output, request.transfer)
    if request.stats is not None:
        save_stats(request.stats, {"nodes": [], **stats})
    if request.table is not None:
        save_csv(request.table, done)
    if request.plots is not None:
        from raygrid.host.machine_time.plots import save_plots

        reporter.phase("drawing plots")
        with made_folder(request.plots):
            save_plots(request.plots, done)
    return stats


def summary(done: Simulated, stats: Stats) -> list[str]:
    """What came out, for people."""
    shares, total, queue = stats["shares"], stats["total"], stats["queue"]
    rays = sum(total["born"][kind] for kind in ("primary", "reflected", "refracted", "shadow"))
    lines = [
        f"machine: {'x'.join(map(str, stats['array']))} processors, {done.cost.name} ({done.search} search), "
        f"{stats['split']} split",
        f"frame: {stats['ticks']:,} ticks, {_seconds(stats, 'frame')}",
    ]
    if done.floods:
        lines += [f"set-up: {_seconds(stats, 'set_up')}", f"read-out: {_seconds(stats, 'read_out')}"]
    busiest = stats["busiest"]
    lines += [
        f"rays: {rays:,}; hops: {total['hops']:,}",
        f"busiest processor: {_place(busiest['node'])}, at work {busiest['share']:.1%} of the frame; {_link(stats)}",
        f"processors: {shares['working']:.1%} working, {shares['sending']:.1%} sending, {shares['waiting']:.1%} waiting; "
        f"busiest/mean {stats['balance']:.2f}; links {shares['links']:.1%} busy",
        f"queues: at most {queue['most']:,} packets, {queue['mean']:.2f} on average",
        f"simulated in {in_words(done.seconds['whole'])} of wall time, {stats['simulator']['events']:,} events a frame",
    ]
    return lines


def _place(index: list[int]) -> str:
    return ",".join(map(str, index))


def _link(stats: Stats) -> str:
    """The busiest link, by the processors at both of its ends."""
    busiest = stats["links"]["busiest"]
    if not busiest["packets"]:
        return "no packet went from one to another"
    port = busiest["port"]
    to = list(busiest["node"])
    to["xyz".index(port[1])] += 1 if port[0] == "+" else -1
    return f"busiest link: {_place(busiest['node'])} to {_place(to)} ({port}), {busiest['packets']:,} packets"


def _seconds(stats: Stats, phase: str) -> str:
    """Machine seconds, with the band in brackets if there is one; long times in words, too."""
    band = stats["band"]
    seconds = band["middle"]["seconds"][phase]
    middle = f"{_plain(seconds)} machine seconds"
    if seconds >= MINUTE:
        middle = f"{middle} ({in_words(seconds)})"
    if "low" not in band:
        return middle
    low, high = band["low"]["seconds"][phase], band["high"]["seconds"][phase]
    words = f" ({in_words(low)} to {in_words(high)})" if high >= MINUTE else ""
    return f"{middle}; low to high costs: {_plain(low)} to {_plain(high)}{words}"


def _plain(seconds: float) -> str:
    """Seconds with four digits or more, and never as 1.583e+04."""
    return f"{seconds:,.0f}" if seconds >= 1000.0 else f"{seconds:.4g}"


MINUTE, HOUR, DAY = 60, 3600, 86400


def in_words(seconds: float) -> str:
    """A time with its two largest units: 3.1 s, 12 min 5 s, 4 h 24 min, 12 d 3 h."""
    if round(seconds) < MINUTE:
        return f"{seconds:.3g} s"
    for large, small, names in ((DAY, HOUR, "d h"), (HOUR, MINUTE, "h min"), (MINUTE, 1, "min s")):
        whole, rest = divmod(round(seconds / small), large // small)
        if whole:
            first, second = names.split()
            return f"{whole:,} {first}" + (f" {rest} {second}" if rest else "")
    raise AssertionError("a minute or more has minutes")
