"""Carries out `raygrid trace`: prints the ray tree of one pixel."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass

from raygrid.emulator.processes import ANALYSIS
from raygrid.host.cli.commands.simulate import compiling
from raygrid.host.cli.progress import ProgressReporter
from raygrid.host.cli.trace import Facts, headline, plain_lines, ray_line, sample_line, trace_pixel
from raygrid.host.image.outputs import write_result
from raygrid.host.render.animation_jobs import still_job
from raygrid.host.render.given_settings import GivenSettings, parted
from raygrid.host.render.job import Settings
from raygrid.host.scene.load import load_scene


@dataclass(frozen=True)
class TraceRequest:
    """What the command line asks for.

    pixel     column and row, 0,0 top left
    sample    the only sample to show, or None for all
    frame     of a shot, None for its first
    settings  of the frame and of the view
    """

    scene: str
    shape: tuple[int, int, int]
    pixel: tuple[int, int]
    sample: int | None
    as_json: bool
    frame: int | None
    settings: GivenSettings


def run_trace(request: TraceRequest) -> None:
    """Load the scene into an array in memory, trace the pixel, print its tree. Raises RaygridError."""
    settings, view = parted(request.settings)
    scene = load_scene(request.scene, **view)
    with ProgressReporter(False) as reporter, compiling(reporter, ANALYSIS):
        reporter.phase(f"splitting {scene.name}")
        job = still_job(scene, request.shape, Settings(**settings), request.frame)
        reporter.phase(f"tracing pixel {request.pixel[0]},{request.pixel[1]}")
        facts = trace_pixel(job, *request.pixel, request.sample)
    if request.as_json:
        write_result(json.dumps(facts, indent=1))
    elif sys.stdout.isatty():
        _print_tree(facts)
    else:
        write_result("\n".join(plain_lines(facts)))


def _print_tree(facts: Facts) -> None:
    from rich.console import Console
    from rich.text import Text
    from rich.tree import Tree

    tree = Tree(Text(headline(facts), "bold"))
    for sample in facts["trees"]:
        branch = tree.add(Text(sample_line(sample)))
        waiting = [(branch, sample["ray"])] if sample["ray"] else []
        while waiting:
            above, ray = waiting.pop()
            here = above.add(Text(ray_line(ray), STYLES[ray["kind"]] if ray["returned"] or ray["children"] else "dim"))
            waiting += [(here, child) for child in reversed(ray["children"])]
    Console(highlight=False).print(tree)


STYLES = {"primary": "bold", "reflected": "cyan", "refracted": "green", "shadow": "yellow"}
