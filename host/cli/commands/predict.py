"""Carries out `raygrid predict`: the machine time of a frame on any arrays, from pictures with few pixels."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from raygrid.host.cli.commands.simulate import compiling
from raygrid.host.cli.progress import ProgressReporter
from raygrid.host.image.outputs import write_lines, write_result
from raygrid.host.scene.load import check_name
from raygrid.host.text.tables import count_of, table

if TYPE_CHECKING:
    from raygrid.host.machine_time.cost_models import CostModel
    from raygrid.host.machine_time.predict import Estimate, Prediction

HEAD = ("array", "frame, s", "low to high costs", "set-up, s", "read-out, s", "busiest/mean", "rays a processor", "")


@dataclass(frozen=True)
class PredictRequest:
    """What the command line asks for.

    shapes    processors on each axis, of each array
    cost      name or path of a cost model; search: list, tree, or None: as the cost model says
    frame     of a shot, None for its first
    settings  of `raygrid.host.render.machine_job.Settings`
    """

    scene: str
    shapes: tuple[tuple[int, int, int], ...]
    cost: str
    search: str | None
    as_json: bool
    quiet: bool
    frame: int | None
    settings: dict[str, Any]


def run_predict(request: PredictRequest) -> None:
    """Read, predict, and print a row for each array. Raises RaygridError."""
    check_name(request.scene)
    with ProgressReporter(request.quiet) as reporter:
        reporter.phase(f"reading {request.scene}")
        from raygrid.host.machine_time.cost_models import load_cost_model
        from raygrid.host.render.job import Settings
        from raygrid.host.scene.animation.scene_frames import frame_told
        from raygrid.host.scene.load import load_scene

        cost = load_cost_model(request.cost)
        scene = load_scene(request.scene)
        for remark in scene.remarks:
            reporter.remark(remark)
        if told_frame := frame_told(scene, request.frame):
            reporter.remark(told_frame)
        with compiling(reporter):
            from raygrid.host.machine_time.predict import predict_arrays

            settings = Settings(**request.settings)
            found = predict_arrays(
                scene, list(request.shapes), cost, request.search, settings, request.frame, reporter.phase
            )
    if request.as_json:
        write_result(json.dumps(facts(scene.name, cost, found), indent=2))
    else:
        write_lines(lines(scene.name, cost, found))


def facts(scene: str, cost: CostModel, found: list[Prediction]) -> dict[str, Any]:
    """The map of --json; docs/predict.md has its keys."""
    first = found[0]
    known = ("cost", "search", "size", "samples")
    rows = [{name: value for name, value in asdict(one).items() if name not in known} for one in found]
    return {
        "version": 1,
        "scene": scene,
        "size": list(first.size),
        "samples": first.samples,
        "cost": {"name": cost.name, "about": cost.file.about, "hertz": cost.file.hertz, "search": first.search},
        "arrays": [{**row, "processors": one.processors} for row, one in zip(rows, found, strict=True)],
    }


def lines(scene: str, cost: CostModel, found: list[Prediction]) -> list[str]:
    """What came out, for people."""
    first = found[0]
    size = "x".join(map(str, first.size))
    samples = "" if first.samples == 1 else f", {first.samples} samples a pixel"
    rows = [HEAD, *(_row(one) for one in found)]
    said = [
        f"{scene}, {size} pixels{samples}, {cost.name} ({first.search} search): machine seconds, and what they may be off by",
        "",
        *(line.rstrip() for line in table(rows)),
    ]
    few = [one for one in found if one.few_rays and not one.whole]
    if few:
        arrays = count_of(len(few), "array")
        said += [
            "",
            f"few rays: on {arrays} fewer than ten meet a processor, so that single rays tell and less is sure",
        ]
    return said


def _row(one: Prediction) -> tuple[str, ...]:
    low, high = one.band
    note = "simulated as it is" if one.whole else "few rays" if one.few_rays else ""
    return (
        "x".join(map(str, one.array)),
        _told(one.frame),
        f"{_seconds(low)} to {_seconds(high)}",
        _told(one.set_up),
        _told(one.read_out),
        f"{one.balance:.1f}",
        f"{one.rays_a_processor:,.1f}",
        note,
    )


def _told(told: Estimate) -> str:
    return _seconds(told.seconds) if told.error == 0.0 else f"{_seconds(told.seconds)} ± {told.error:.1%}"


def _seconds(seconds: float) -> str:
    """Four digits or more, and never as 1.583e+04."""
    return f"{seconds:,.0f}" if seconds >= 1000.0 else f"{seconds:.4g}"
