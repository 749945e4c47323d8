"""Carries out `raygrid jam`: the naive machine of finite buffers, without admission and with it (docs/deadlock.md)."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass

from raygrid.emulator.analysis import NaiveMachine, Outcome, Waiting, surely_free
from raygrid.emulator.processes import ANALYSIS
from raygrid.host.cli.commands.simulate import compiling
from raygrid.host.cli.progress import ProgressReporter
from raygrid.host.image.outputs import write_lines, write_result
from raygrid.host.render.animation_jobs import still_job
from raygrid.host.render.given_settings import GivenSettings, parted
from raygrid.host.render.job import Job, Settings
from raygrid.host.scene.load import load_scene
from raygrid.node.main import PORT_NAMES

DEFAULT_SIZE = (64, 64)  # a jam comes early or not at all, and every hop is a step of its own


@dataclass(frozen=True)
class JamRequest:
    """What the command line asks for.

    room      packets that a link's buffer holds
    budget    primary rays alive at once in the run with admission; None: as many as can surely not jam, 1 at least
    frame     of a shot, None for its first
    settings  of the frame and of the view
    """

    scene: str
    shape: tuple[int, int, int]
    room: int
    budget: int | None
    as_json: bool
    frame: int | None
    settings: GivenSettings


def run_jam(request: JamRequest) -> None:
    """Run the model without admission and with it, and print how both ended. Raises RaygridError."""
    of_frame, view = parted(request.settings)
    scene = load_scene(request.scene, **view)
    settings = {**of_frame, "size": of_frame.get("size") or DEFAULT_SIZE}
    with ProgressReporter(False) as reporter, compiling(reporter, ANALYSIS):
        reporter.phase(f"splitting {scene.name}")
        job = still_job(scene, request.shape, Settings(**settings), request.frame)
        free = surely_free(job.frame, request.room)
        budget = max(1, free) if request.budget is None else request.budget
        reporter.phase("letting it jam, and then not")
        naive, admitted = _run(job, request.room, None), _run(job, request.room, budget)
    if request.as_json:
        facts: dict[str, object] = {
            "scene": scene.name,
            "frame": job.number,
            "array": list(request.shape),
            "surely_free_budget": free,
        }
        facts |= {"without_admission": asdict(naive), "with_admission": asdict(admitted)}
        write_result(json.dumps(facts))
        return
    size = f"{job.frame.width}x{job.frame.height}"
    shape = "x".join(map(str, request.shape))
    frame = "" if scene.shot is None else f"frame {job.number} of {scene.shot.frames}, "
    lines = [f"{scene.name}, {frame}{size} pixels, array {shape}, buffers of {request.room} packets"]
    lines += ["", "without admission:", *_outcome_lines(naive)]
    lines += [
        "",
        f"with admission, never more than {_many(budget, 'primary ray')} alive:",
        *_outcome_lines(admitted),
        _guarantee(budget, free),
    ]
    write_lines(lines)


def _run(job: Job, room: int, budget: int | None) -> Outcome:
    return NaiveMachine(job.space, job.surfaces, job.frame, room, budget).run()


def _outcome_lines(outcome: Outcome) -> Iterator[str]:
    """Lines on one run."""
    born = ", ".join(f"{count:,} {kind}" for kind, count in outcome.born.items() if count)
    if not outcome.jammed:
        yield f"  all is traced after {outcome.rounds:,} rounds: {born} packets"
    else:
        yield f"  jammed: after {outcome.rounds:,} rounds nothing can move; {born} packets were born"
        yield f"  {outcome.stuck:,} packets are stuck, {outcome.unborn:,} samples were never begun"
    yield (
        f"  fullest buffer {outcome.fullest} of {outcome.room}, {_many(outcome.most_trees, 'primary ray')} alive at most, "
        f"{outcome.blocked:,} turns lost in waiting"
    )
    if outcome.cycle:
        yield f"  the cycle, closed after {outcome.closed:,} rounds:"
        yield (
            "    "
            + " -> ".join(f"{_cell(node.node)} -> {PORT_NAMES[node.port]}" for node in outcome.cycle)
            + (f" -> {_cell(outcome.cycle[0].node)}")
        )
    if outcome.waiting:
        yield "  what each node waits for at the end:"
        yield from (f"    {_wait(node)}" for node in outcome.waiting)


def _wait(node: Waiting) -> str:
    ahead = ", ".join(f"{count} {kind}" for kind, count in sorted(node.ahead.items()))
    queued = ", ".join(f"{PORT_NAMES[port]} {held}" for port, held in enumerate(node.inputs[:6]) if held)
    return (
        f"{_cell(node.node)} waits at port {PORT_NAMES[node.port]} until {_cell(node.neighbour)} takes one of its packets "
        f"({ahead}); {node.held} in hand; in its own buffers: {queued or 'nothing'}"
    )


def _guarantee(budget: int, free: int) -> str:
    if budget <= free:
        return f"  it cannot jam: the packets of {_many(free, 'tree')} of rays never fill a buffer"
    if free == 0:
        return "  nothing promises that it does not jam: the packets of a single tree of rays can fill a buffer"
    return f"  nothing promises that it does not jam: the packets of more than {_many(free, 'tree')} of rays can fill a buffer"


def _many(count: int, what: str) -> str:
    return f"{count:,} {what}{'s' * (count != 1)}"


def _cell(index: tuple[int, int, int]) -> str:
    return ",".join(map(str, index))
