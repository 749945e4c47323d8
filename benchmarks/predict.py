"""What `raygrid predict` says against what `raygrid simulate` finds, case by case; writes the table of docs/predict.md.

    python benchmarks/predict.py tetra_5.nff mount_4.nff scenes/room.glb --array 2x2x2 --array 10x10x10 \\
        --cost 8086 --cost t800 --size 512x512 --csv cases.csv -o docs/predict.md

The table lies between two marks of that file and replaces what was there. --only N: every Nth case, for a quick look.
An interrupt (Ctrl-C) ends it early, with the table of what is done; before the first case nothing is written.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import re
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from raygrid.emulator.simulator import flood, make_model, ordered, read_out, trace
from raygrid.emulator.topology import parse_shape
from raygrid.host.machine_time.cost_models import LEVELS, CostModel, load_cost_model
from raygrid.host.machine_time.predict import Prediction, predict
from raygrid.host.render.animation_jobs import still_job
from raygrid.host.render.job import Settings
from raygrid.host.scene.load import load_scene
from raygrid.host.scene.scene import Scene

BEGIN, END = "<!-- the table of benchmarks/predict.py -->", "<!-- its end -->"
FITTED = ("tetra_5.nff", "mount_4.nff")  # scenes at which the constants of the law were looked at
COLUMNS = (
    "scene", "array", "cost", "search", "told", "error", "simulated", "off", "covered", "whole", "rays_a_processor", "share",
    "latency", "work_told", "work_error", "work", "set_up_told", "set_up", "read_out_told", "read_out", "cpu", "simulated_cpu",
)  # fmt: skip


@dataclass(frozen=True)
class Case:
    """A prediction and what a simulation found: ticks in seconds, of the frame, the set-up and the read-out."""

    told: Prediction
    scene: str
    frame: float
    set_up: float
    read_out: float
    busiest: float
    cpu: float
    simulated_cpu: float

    @property
    def off(self) -> float:
        """By what part the frame was foretold too long."""
        return self.told.frame.seconds / self.frame - 1.0

    @property
    def covered(self) -> bool:
        """Whether it lies within the stated error."""
        return self.told.frame.low <= self.frame <= self.told.frame.high


def compare(scene: Scene, array: str, cost: CostModel, search: str, settings: dict[str, Any]) -> Case:
    """Predict and simulate one frame."""
    begun = time.process_time()
    (told,) = predict(scene, array, cost.name, search=search, **settings)
    spent = time.process_time() - begun
    job = still_job(scene, parse_shape(array), Settings(**settings))
    model = make_model(job.space, job.surfaces, job.frame, search)
    prices = cost.prices("middle", search)
    phase, pixels = trace(model, prices, cost.list_ticks("middle", search, model.holding.held))
    out = read_out(model, prices, pixels)
    description = cost.file.ticks.description[LEVELS.index("middle")]
    set_up = flood(job.space, ordered(job.surfaces), prices, description)
    ticks = (phase.ticks, set_up.ticks, out.host, int(phase.column("busy").max()))
    return Case(told, scene.name, *map(cost.seconds, ticks), spent, time.process_time() - begun - spent)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--array", action="append", dest="arrays", required=True)
    parser.add_argument("--cost", action="append", dest="costs", required=True)
    parser.add_argument("--search", action="append", dest="searches")
    parser.add_argument("--size", default="512x512")
    parser.add_argument("--split", default="uniform")
    parser.add_argument("--only", type=int, default=1)
    parser.add_argument("--csv")
    parser.add_argument("-o", "--output")
    options = parser.parse_args()
    width, height = map(int, options.size.split("x"))
    settings: dict[str, Any] = {"size": (width, height), "split": options.split}
    predict(options.scenes[0], "2x2x2", "unit", size=(8, 8))  # loads the kernels
    asked = [
        (path, array, cost, search)
        for path in options.scenes
        for array in options.arrays
        for cost in options.costs
        for search in options.searches or ("list", "tree")
    ][:: options.only]
    cases, scenes = [], {path: load_scene(path) for path in options.scenes}
    with contextlib.suppress(KeyboardInterrupt):
        for path, array, cost, search in asked:
            case = compare(scenes[path], array, load_cost_model(cost), search, settings)
            cases.append(case)
            print(_line(case), flush=True)
    if not cases:
        sys.exit("ended before the first case was done: nothing is written")
    if options.csv:
        _save(options.csv, cases)
    rows = table(cases, options)
    print("\n".join(rows))
    if options.output:
        path = Path(options.output)
        mark = re.compile(f"{re.escape(BEGIN)}.*{re.escape(END)}", re.DOTALL)
        path.write_text(mark.sub("\n".join([BEGIN, "", *rows, "", END]), path.read_text()))


def _line(case: Case) -> str:
    told, work = case.told, case.told.busiest
    return (
        f"{case.scene} {'x'.join(map(str, told.array))} {told.cost} {told.search}: {told.frame.seconds:.4g} s "
        f"({told.frame.error:.1%}), simulated {case.frame:.4g} s: {case.off:+.2%}, W {work.seconds / case.busiest - 1:+.2%} "
        f"(± {work.error:.2%}), read-out {told.read_out.seconds / case.read_out - 1:+.2%}, "
        f"set-up {told.set_up.seconds / max(case.set_up, 1e-12) - 1:+.2%}, {told.rays_a_processor:.1f} rays a processor, "
        f"T/W {case.frame / case.busiest:.4f}, share {told.share:.4f}, latency {told.latency / told.frame.seconds:.2%}, "
        f"{case.cpu:.2f} and {case.simulated_cpu:.2f} s{' whole' if told.whole else ''}"
    )


def _save(path: str, cases: list[Case]) -> None:
    with Path(path).open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        for c in cases:
            t = c.told
            writer.writerow(
                [c.scene, "x".join(map(str, t.array)), t.cost, t.search, t.frame.seconds, t.frame.error, c.frame, c.off,
                 int(c.covered), int(t.whole), t.rays_a_processor, t.share, t.latency, t.busiest.seconds, t.busiest.error,
                 c.busiest, t.set_up.seconds, c.set_up, t.read_out.seconds, c.read_out, c.cpu, c.simulated_cpu]
            )  # fmt: skip


def table(cases: list[Case], options: argparse.Namespace) -> list[str]:
    """Rows for groups of one case or more. Frames that were simulated as they are stand in one row of their own."""
    guessed = [case for case in cases if not case.told.whole]
    many = [case for case in guessed if not case.told.few_rays]
    groups = {
        "all": guessed,
        "ten rays a processor or more": many,
        "fewer than ten": [case for case in guessed if case.told.few_rays],
        "scenes that nothing was fitted on": [case for case in guessed if case.scene not in FITTED],
        **{f"`{cost}`": [c for c in guessed if c.told.cost == cost] for cost in options.costs},
        **{f"`{search}`": [c for c in guessed if c.told.search == search] for search in ("list", "tree")},
        **{array: [c for c in guessed if c.told.array == parse_shape(array)] for array in options.arrays},
        "frames that were simulated as they are": [case for case in cases if case.told.whole],
    }
    scenes = sorted({case.scene for case in cases})
    rows = [
        f"{len(cases)} frames of {options.size}, {options.split} split: {len(scenes)} scenes ({', '.join(scenes)}), arrays",
        f"{', '.join(options.arrays)}, costs {', '.join(options.costs)}. Errors of the frame's time, as parts of it.",
        "",
        "| frames | how many | median | 95 % within | worst | covered by the stated error | median stated |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, group in groups.items():
        if group:
            off = np.abs([case.off for case in group])
            stated = np.median([case.told.frame.error for case in group])
            rows.append(
                f"| {name} | {len(group)} | {np.median(off):.2%} | {np.quantile(off, 0.95):.2%} | {off.max():.2%} "
                f"| {np.mean([case.covered for case in group]):.0%} | {stated:.1%} |"
            )
    return [*rows, "", *_around(cases, guessed)]


def _around(cases: list[Case], guessed: list[Case]) -> list[str]:
    """The rest of the table: read-outs, of frames that were extrapolated; set-ups and processor seconds, of all."""
    rows = []
    if guessed:
        out = np.abs([c.told.read_out.seconds / c.read_out - 1.0 for c in guessed])
        rows.append(f"Read-out: median {np.median(out):.2%}, worst {out.max():.2%}.")
    flooded = np.abs([c.told.set_up.seconds / max(c.set_up, 1e-12) - 1.0 for c in cases])
    cpu, simulated = [case.cpu for case in cases], [case.simulated_cpu for case in cases]
    return [
        *rows,
        f"Set-up: median {np.median(flooded):.2%}, worst {flooded.max():.2%}.",
        f"Processor seconds of a prediction: median {np.median(cpu):.2f}, most {max(cpu):.2f}; of the simulation: median "
        f"{np.median(simulated):.2f}, most {max(simulated):.2f}.",
    ]


if __name__ == "__main__":
    main()
