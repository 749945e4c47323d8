"""Part c: how long everything takes that is not rendering."""

from __future__ import annotations

import tempfile
from pathlib import Path

from bench_run import RAYGRID, ROOT, Run, alternating, render, run, script
from bench_tables import Section, Table, spread

TINY = ROOT / "scenes" / "tiny.nff"
PROMISED = {"2x2x2": 0.2, "4x4x4": 1.0}  # seconds until ready
PHASES = (
    ("read", "from the program's begin until the scene is read; the fork server warms up beside it"),
    ("launch", "until the nodes are forked and every link is up, what is left of the warm-up included"),
    ("load", "flood and building of the hierarchies"),
    ("trace", ""),
    ("collect", "pixels to the host"),
)


def measure(runs: int, shapes: tuple[str, ...]) -> Section:
    """The section."""
    section = Section(f"c. Start-up, warm; runs: {runs}")
    table = section.table("what", "seconds", "command")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        results = alternating(
            runs,
            {"raygrid --help": lambda: run([RAYGRID, "--help"]), "raygrid render": lambda: render(TINY, folder)},
        )
    helping, whole = (spread(one.wall for one in done) for done in results.values())
    tiny = "`raygrid render scenes/tiny.nff -o tiny.png --stats tiny.json`"
    table.add("`raygrid --help`, whole", helping, "`raygrid --help`")
    table.add("a tiny scene, from shell to picture, whole", whole, tiny)
    table.add(
        "- starting Python, ending it, imports of the command line",
        spread(map(_outside, results["raygrid render"])),
        tiny,
    )
    for phase, words in PHASES:
        row = f"- {phase}: {words}" if words else f"- {phase}"
        table.add(row, spread(one.phase(phase) for one in results["raygrid render"]), tiny)
    table.add("- ending the processes and writing the picture", spread(map(_rest, results["raygrid render"])), tiny)
    section.expect("`raygrid --help`, seconds", helping.median, 0.3, at_most=True)
    section.expect("`raygrid render scenes/tiny.nff`, shell to picture, seconds", whole.median, 1.2, at_most=True)
    _ready(section, table, runs, shapes)
    return section


def _outside(one: Run) -> float:
    return one.wall - one.phase("whole")


def _rest(one: Run) -> float:
    return one.phase("whole") - sum(one.phase(phase) for phase, _ in PHASES)


def _ready(section: Section, table: Table, runs: int, shapes: tuple[str, ...]) -> None:
    arrays = [word for shape in shapes for word in ("--array", shape)]
    lines = script("ready.py", *arrays, "--runs", str(runs))
    words = f"`python benchmarks/ready.py {' '.join(arrays)} --runs {runs}`"
    table.add("warming up the fork server", spread(line["warm"] for line in lines), words)
    for shape in shapes:
        mine = [line for line in lines if line["array"] == shape]
        ready = spread(line["ready"] for line in mine)
        table.add(f"{shape} ready after the warm-up", ready, words)
        table.add(f"{shape} ended", spread(line["end"] for line in mine), words)
        if shape in PROMISED:
            section.expect(f"{shape} ready after the warm-up, seconds", ready.median, PROMISED[shape], at_most=True)
