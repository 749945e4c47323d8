"""Part a: the same scenes by POV-Ray and by raygrid, in turn."""

from __future__ import annotations

import re
import shutil
import tempfile
from pathlib import Path

import numpy as np
from bench_run import RAYGRID, BenchError, Run, alternating, render, run, shown, spd, tell
from bench_tables import Section, Table, geometric_mean, number, ratio, spread
from PIL import Image

SCENES = ("balls_3", "gears_2", "mount_5", "rings_3", "teapot_6", "tetra_6")
SIZE = 512
THREADS = 2
SECONDS = re.compile(r"(Parse|Bounding|Trace) Time:.*\(([\d.]+) seconds\)")
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
with the start of Python and of the array, for POV-Ray with parsing. raygrid 2x2x2 has 8 processes, POV-Ray two threads.
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
    """Seconds by phase that POV-Ray's log gives. Raises BenchError if the trace time is missing."""
    found = {phase.lower(): float(seconds) for phase, seconds in SECONDS.findall(log)}
    if "trace" not in found:
        raise BenchError("POV-Ray's log came without its trace time")
    return found


def options_of_povray() -> list[str]:
    """What it is called with, but for the files."""
    return [f"+W{SIZE}", f"+H{SIZE}", f"+WT{THREADS}", "-A", "-D", "+FN8", "File_Gamma=1.0"]


def measure(runs: int, names: tuple[str, ...]) -> Section:
    """The section."""
    section = Section(f"a. POV-Ray with {THREADS} threads and raygrid, {SIZE}x{SIZE}")
    program = povray_program()
    table = section.table(
        "scene", "program", "parse or read and load, s", "trace, s", "whole, s", "CPU, s", "POV-Ray trace / this",
        "POV-Ray whole / this", "off", "command",
    )  # fmt: skip
    ratios: dict[str, list[tuple[float, float]]] = {}
    for name in names:
        tell(f"  {name}")
        try:
            with tempfile.TemporaryDirectory() as folder:
                _compare(spd(name), program, runs, Path(folder), table, ratios)
        except BenchError as error:
            table.add(name, str(error), *["-"] * 8)
    for shape, pairs in ratios.items():
        trace, whole = (geometric_mean(pair[k] for pair in pairs) for k in (0, 1))
        table.add(
            f"all {len(pairs)}, geometric mean", f"raygrid {shape}", *["-"] * 4, number(trace), number(whole), "-", "-"
        )
        if shape == "2x2x2":
            section.expect("POV-Ray's trace time over raygrid's, geometric mean", trace, 2.0, at_most=False)
            least = min((pair[0] for pair in pairs), default=float("nan"))
            section.expect("the same, the worst scene", least, 1.0, at_most=False)
            section.expect("POV-Ray's whole time over raygrid's, geometric mean", whole, 1.2, at_most=False)
    section.say(DIFFERENCES)
    return section


def _compare(
    scene: Path, program: str, runs: int, folder: Path, table: Table, ratios: dict[str, list[tuple[float, float]]]
) -> None:
    pov = folder / f"{scene.stem}.pov"
    run([RAYGRID, "export", str(scene), "-o", str(pov)])
    options = ("--size", f"{SIZE}x{SIZE}", "--transfer", "linear")
    command = [program, f"+I{pov.name}", "+Opovray.png", *options_of_povray()]
    turns = {
        "POV-Ray": lambda: run(command, cwd=folder),
        "2x2x2": lambda: render(scene, folder, "--array", "2x2x2", *options),
        "1x1x1": lambda: render(scene, folder, "--array", "1x1x1", *options),
    }
    results = alternating(runs, turns)
    logs = [seconds_in(one.output) for one in results["POV-Ray"]]
    their_trace, their_whole = spread(log["trace"] for log in logs), spread(one.wall for one in results["POV-Ray"])
    parse = spread(log.get("parse", 0.0) + log.get("bounding", 0.0) for log in logs)
    cpu = spread(one.cpu for one in results["POV-Ray"])
    shown_command = f"`raygrid export {shown(scene)}`, `povray +I{pov.name} {' '.join(options_of_povray())}`"
    table.add(scene.stem, "POV-Ray", parse, their_trace, their_whole, cpu, 1, 1, "-", shown_command)
    off = f"{100.0 * part_off(folder / 'povray.png', folder / 'raygrid.png'):.3f} %"
    for shape in ("2x2x2", "1x1x1"):
        trace, whole = (spread(values) for values in zip(*map(_times, results[shape]), strict=True))
        load = spread(one.phase("read") + one.phase("load") for one in results[shape])
        pair = ratio(their_trace, trace), ratio(their_whole, whole)
        ratios.setdefault(shape, []).append(pair)
        cpu = spread(one.cpu for one in results[shape])
        words = f"`raygrid render {shown(scene)} --array {shape} {' '.join(options)}`"
        table.add(
            scene.stem, f"raygrid {shape}", load, trace, whole, cpu, number(pair[0]), number(pair[1]), off, words
        )  # fmt: skip


def _times(one: Run) -> tuple[float, float]:
    return one.phase("trace"), one.wall


def part_off(one: Path, other: Path) -> float:
    """The part of the pixels of which a channel differs by more than 2 of 255."""
    pictures = [np.asarray(Image.open(path).convert("RGB")).astype(np.int16) for path in (one, other)]
    return float(np.mean((np.abs(pictures[0] - pictures[1]) > 2).any(axis=2)))
