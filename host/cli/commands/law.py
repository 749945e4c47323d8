"""Carries out `raygrid law`: sweeps arrays and pictures, fits the law, writes the report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from raygrid.host.cli.progress import ProgressReporter
from raygrid.host.files.input_guard import check_outputs, note
from raygrid.host.image.outputs import check_path, made_folder, write_result
from raygrid.host.scene.load import check_name


@dataclass(frozen=True)
class LawRequest:
    """What the command line asks for.

    sizes     kind of array -> edges
    pictures  width and height of each
    along     axis that a square array leaves whole, None: the one along which the camera looks
    folder    where the report goes
    command   how this was asked for, for the report
    settings  of `raygrid.host.render.machine_job.Settings`
    """

    scenes: tuple[str, ...]
    cost: str
    search: str | None
    sizes: dict[str, Sequence[int]]
    pictures: Sequence[tuple[int, int]]
    along: int | None
    folder: str
    quiet: bool
    command: str
    settings: dict[str, Any]


def run_law(request: LawRequest) -> None:
    """Sweep, fit, write the report. Raises RaygridError."""
    from raygrid.host.machine_time.scaling_law_report import report_paths

    for scene in request.scenes:
        check_name(scene)
        note(scene, "the same file as a scene")
    with made_folder(request.folder), ProgressReporter(request.quiet) as reporter:
        check_path(Path(request.folder) / "law.md")
        check_outputs(report_paths(request.folder, request.scenes))
        paths = _run(request, reporter)
    for path in paths:
        write_result(path)


def _run(request: LawRequest, reporter: ProgressReporter) -> list[str]:
    from raygrid.host.cli.commands.simulate import compiling
    from raygrid.host.machine_time.cost_models import load_cost_model
    from raygrid.host.machine_time.plots import check_matplotlib
    from raygrid.host.machine_time.scaling_law import fits_of, sweep
    from raygrid.host.machine_time.scaling_law_report import report_paths, write_report
    from raygrid.host.scene.animation.scene_frames import frame_told
    from raygrid.host.scene.load import load_scene

    cost = load_cost_model(request.cost)
    check_matplotlib("scipy")
    scenes = [load_scene(scene) for scene in request.scenes]
    for scene in scenes:
        if told_frame := frame_told(scene, None, False):
            reporter.remark(told_frame)
    check_outputs(report_paths(request.folder, [scene.name for scene in scenes]))  # now that all is read
    points, frames = [], (request.sizes, request.pictures)
    with compiling(reporter):
        for scene in scenes:
            points += sweep(scene, cost, *frames, request.search, request.along, request.settings, reporter.phase)
    reporter.phase("fitting and plotting")
    return write_report(request.folder, points, fits_of(points), cost, request.command)
