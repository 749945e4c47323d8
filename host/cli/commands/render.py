"""Renders one frame for `raygrid render`.

What is heavy to import (numba comes with it) is imported after the fork server was started, which imports the same beside it.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any

from raygrid.host.cli.commands.frames import run_frames
from raygrid.host.cli.commands.render_request import RenderRequest
from raygrid.host.cli.progress import ProgressReporter
from raygrid.host.files.input_guard import check_outputs
from raygrid.host.image.outputs import check_named, check_path, check_picture_path, check_side, write_names
from raygrid.host.scene.load import check_allowed, check_name
from raygrid.host.scene.view import view_of

if TYPE_CHECKING:
    from raygrid.host.image.picture import Encoder, Picture
    from raygrid.host.probes.probing import Probing
    from raygrid.host.render.job import Job


def run_render(request: RenderRequest) -> None:
    """Launch, read, load, trace, collect, write. Raises RaygridError."""
    check_allowed(request.program, request.allow_programs)
    if request.of_shot:
        run_frames(request)
        return
    pictures, stats = request.names.of(None), request.names.stats_of(None)
    begun = time.perf_counter()
    check_name(request.scene)
    view_of(request.view)
    if request.cost is not None:
        _prices(request.cost, request.search)
    _check_outputs(request, pictures, stats)
    with ProgressReporter(request.quiet, request.program is not None) as reporter, _probing(request) as probing:
        picture, encoding = _render(request, pictures, reporter, begun, probing)
        for output in pictures:
            reporter.phase(f"writing {output}")
            encoding.save(output)
        layers = request.names.layers_of(None)
        for file, layer in layers:
            from raygrid.host.image.layer_pictures import save_layer

            save_layer(file, layer, picture.layers[layer])
        seconds = picture.stats["wall_seconds"]
        seconds["whole"] = round(time.perf_counter() - begun, 6)
        if stats is not None:
            from raygrid.host.render.stats import save_stats

            save_stats(stats, picture.stats)
        if (blank := picture.blank()) is not None:
            reporter.remark(blank)
        for line in _summary(picture):
            reporter.say(line)
        if request.profile:
            from raygrid.host.cli.profile_table import profile_table

            reporter.table(profile_table(picture.stats["nodes"]))
    write_names([*pictures, *(file for file, _ in layers)], [*pictures, stats])


def _render(
    request: RenderRequest, pictures: list[str], reporter: ProgressReporter, begun: float, probing: Probing | None
) -> tuple[Picture, Encoder]:
    shape = request.shape
    with request.launching(reporter) as array:
        array.begin()
        reporter.phase(f"reading {request.scene}")
        job = _read_job(request, pictures, reporter, array.wait_warm)
        read = time.perf_counter()
        reporter.phase(f"launching {shape[0] * shape[1] * shape[2]} processors")
        from raygrid.host.image.picture import Encoder, prepare
        from raygrid.host.render.job import samples_expected
        from raygrid.host.render.session import RenderSession

        if not array.is_warm():
            prepare(pictures)
        array.wait_ready()
        ready = time.perf_counter()
        reporter.expect(samples_expected(job))
        if probing is not None:
            array.probe(request.probe_rate, probing.take)
        prices = None if request.cost is None else _prices(request.cost, request.search)
        session = RenderSession(array, request.attempts, reporter.fault)
        picture = session.render(job, request.budget, reporter.watch, prices)
        picture.stats["wall_seconds"] |= {"read": round(read - begun, 6), "launch": round(ready - read, 6)}
        reporter.phase("ending the processors")
        encoding = Encoder(picture, pictures, request.transfer)
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


def _read_job(
    request: RenderRequest, pictures: list[str], reporter: ProgressReporter, wait_warm: Callable[[], None]
) -> Job:
    from raygrid.host.render.import_block import hidden
    from raygrid.host.scene.load import load_scene

    with hidden("scipy"):
        from raygrid.host.render.job import make_job
        from raygrid.host.render.prepared import remarks_on

    scene = load_scene(request.scene, **request.view)
    for remark in remarks_on(scene, None):
        reporter.remark(remark)
    job = make_job(scene, request.shape, request.read_settings(), wait_warm)
    check_outputs(_every_file(request))  # now that all is read
    for output in pictures:
        check_side(output, job.frame.width, job.frame.height)
    return job


def _check_outputs(request: RenderRequest, pictures: list[str], stats: str | None) -> None:
    for output in pictures:
        check_picture_path(output)
    for file, _ in request.names.layers_of(None):
        check_path(file)
    if stats is not None:
        check_path(stats)
    for path in request.probed:
        check_named(path)
    request.note_read()
    check_outputs(_every_file(request))


def _every_file(request: RenderRequest) -> list[str]:
    """All files that are to be written."""
    return [*request.names.every([None]), *request.probed]


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
