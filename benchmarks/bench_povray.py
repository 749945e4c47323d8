"""Part a: the same scenes by POV-Ray and by raygrid, in turn."""

from __future__ import annotations

import re
import shutil
import tempfile
from functools import partial
from pathlib import Path

import numpy as np
from bench_run import RAYGRID, BenchError, Run, alternating, render, run, shown, spd, tell
from bench_tables import Section, Table, geometric_mean, number, ratio, spread
from PIL import Image

SCENES = ("balls_3", "gears_2", "mount_5", "rings_3", "teapot_6", "tetra_6")
SIZE = 512
THREADS = 2
SHAPES = ("2x2x2", "2x1x1", "1x1x1")
JUDGED = {"2x1x1": "2x1x1, as many processes as threads", "2x2x2": "2x2x2"}  # by the targets
SECONDS = re.compile(r"(Parse|Bounding|Trace) Time:.*\(([\d.]+) seconds\)\s+using .* with ([\d.]+) CPU-seconds")
DIFFERENCES = """\
What differs in the work done. Both programs render the same scene, POV-Ray from the file that `raygrid export` writes,
to an 8-bit PNG by the same rules: one ray through the middle of each pixel, no antialiasing; depth 5; a shadow ray to
every light that faces the surface; anything in between, glass too, throws a full shadow; no cut-off by weight; Snell's
law with total internal reflection; no ambient light, no highlights. At total internal reflection on a surface that is a
mirror, too, POV-Ray drops the mirror's ray (no scene here has such a hit). POV-Ray gives each light a memory of the
surface that it last found in the way, which saves it much of the search. Its file has every transparent surface twice,
once for its look and once for its shadow, which was faster for it than to let light through (gears_2: 2.8 s instead of
3.5 s). raygrid packs each ray into 25 bytes when it is born, hands it from process to process, and sums whole numbers.

`trace` of raygrid begins with the order to all nodes and ends with the wave that finds the frame complete; the
collecting of pixels, which POV-Ray does while it traces, is in `whole`. `whole` is from shell to picture: for raygrid
with the start of Python and of the array, for POV-Ray with parsing. POV-Ray has two threads, and so two processes are
raygrid 2x1x1; 2x2x2, which is what `raygrid render` launches if nothing else is said, has eight.
The CPU of tracing is that of POV-Ray's threads, and that of all nodes until the pixels are collected; while others use
the computer, it compares better than seconds of the clock.
`off` is the part of the pixels of which a channel of the two linear pictures differs by more than 2 of 255."""


def povray_program() -> str:
    """Its path. Raises BenchError if it is not installed."""
    found = shutil.which("povray")
    if found is None:
        raise BenchError("skipped: povray is not installed")
    return found


def povray_version() -> str:
    """The version, or that there is none."""
    try:
        words = run([povray_program(), "--version"]).output
    except BenchError:
        return "not installed"
    found = re.search(r"POV-Ray ([\d.]+\S*)", words)
    return found.group(1) if found else "of unknown version"


def seconds_in(log: str) -> dict[str, float]:
    """Wall seconds by phase, and CPU seconds of tracing, of POV-Ray's log. Raises BenchError if they are missing."""
    found: dict[str, float] = {}
    for phase, seconds, cpu in SECONDS.findall(log):
        found |= {phase.lower(): float(seconds), f"{phase.lower()} cpu": float(cpu)}
    if "trace" not in found:
        raise BenchError("POV-Ray's log came without its trace time")
    return found


def options_of_povray() -> list[str]:
    """What it is called with, but for the files."""
    return [f"+W{SIZE}", f"+H{SIZE}", f"+WT{THREADS}", "-A", "-D", "+FN8", "File_Gamma=1.0"]


def measure(runs: int, names: tuple[str, ...]) -> Section:
    """The section."""
    section = Section(f"a. POV-Ray with {THREADS} threads and raygrid, {SIZE}x{SIZE}; runs: {runs}")
    program = povray_program()
    table = section.table(
        "scene", "program", "parse or read and load, s", "trace, s", "CPU of tracing, s", "whole, s", "CPU of all, s",
        "POV-Ray trace / this", "POV-Ray CPU of tracing / this", "POV-Ray whole / this", "off", "command",
    )  # fmt: skip
    ratios: dict[str, list[tuple[float, ...]]] = {}
    for name in names:
        tell(f"  {name}")
        try:
            with tempfile.TemporaryDirectory() as folder:
                _compare(spd(name), program, runs, Path(folder), table, ratios)
        except BenchError as error:
            table.add(name, str(error), *["-"] * 10)
    for shape, rows in ratios.items():
        means = [geometric_mean(values) for values in zip(*rows, strict=True)]
        count = f"all {len(rows)}, geometric mean"
        table.add(count, f"raygrid {shape}", *["-"] * 5, *map(number, means), "-", "-")
        if shape in JUDGED:
            ours = f"raygrid's ({JUDGED[shape]})"
            section.expect(f"POV-Ray's trace time over {ours}, geometric mean", means[0], 2.0, at_most=False)
            section.expect("the same, the worst scene", min(row[0] for row in rows), 1.0, at_most=False)
            section.expect(f"POV-Ray's whole time over {ours}, geometric mean", means[2], 1.2, at_most=False)
    section.say(DIFFERENCES)
    return section


def _compare(
    scene: Path, program: str, runs: int, folder: Path, table: Table, ratios: dict[str, list[tuple[float, ...]]]
) -> None:
    pov = folder / f"{scene.stem}.pov"
    run([RAYGRID, "export", str(scene), "-o", str(pov)])
    options = ("--size", f"{SIZE}x{SIZE}", "--transfer", "linear")
    command = [program, f"+I{pov.name}", "+Opovray.png", *options_of_povray()]
    turns = {
        "POV-Ray": lambda: run(command, cwd=folder),
    } | {shape: partial(render, scene, folder, "--array", shape, *options) for shape in SHAPES}
    results = alternating(runs, turns)
    theirs = [spread(values) for values in zip(*map(_of_povray, results["POV-Ray"]), strict=True)]
    words = f"`raygrid export {shown(scene)}`, `povray +I{pov.name} {' '.join(options_of_povray())}`"
    table.add(scene.stem, "POV-Ray", *theirs, 1, 1, 1, "-", words)
    off = f"{100.0 * part_off(folder / 'povray.png', folder / 'raygrid.png'):.3f} %"
    for shape in SHAPES:
        ours = [spread(values) for values in zip(*map(_of_raygrid, results[shape]), strict=True)]
        three = tuple(ratio(theirs[k], ours[k]) for k in (1, 2, 3))
        ratios.setdefault(shape, []).append(three)
        words = f"`raygrid render {shown(scene)} --array {shape} {' '.join(options)}`"
        table.add(scene.stem, f"raygrid {shape}", *ours, *map(number, three), off, words)


def _of_povray(one: Run) -> tuple[float, ...]:
    """Seconds of parsing, tracing, CPU of tracing, the whole, CPU of all."""
    log = seconds_in(one.output)
    return log.get("parse", 0.0) + log.get("bounding", 0.0), log["trace"], log["trace cpu"], one.wall, one.cpu


def _of_raygrid(one: Run) -> tuple[float, ...]:
    """The same."""
    busy = sum(float(node["busy_seconds"]) for node in one.stats["nodes"])
    return one.phase("read") + one.phase("load"), one.phase("trace"), busy, one.wall, one.cpu


def part_off(one: Path, other: Path) -> float:
    """The part of the pixels of which a channel differs by more than 2 of 255."""
    pictures = [np.asarray(Image.open(path).convert("RGB")).astype(np.int16) for path in (one, other)]
    return float(np.mean((np.abs(pictures[0] - pictures[1]) > 2).any(axis=2)))
