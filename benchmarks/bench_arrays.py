"""Parts b and d: raygrid against itself, on arrays of 1, 8 and 64 processes."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from bench_run import BenchError, alternating, own, render, script, shown, spd, tell
from bench_tables import Section, Spread, Table, number, ratio, spread

SHAPES = ("1x1x1", "2x2x2", "4x4x4")
OWN = ("kinds.nff", "glass.toml", "lights.toml", "room.glb", "tree.nff")
SPD = ("balls_3", "gears_2", "mount_5", "rings_3", "teapot_6", "tetra_6")
UNEVEN = ("tree", "balls", "teapot")  # scenes on large ground polygons, of which the balance is promised
OVERHEAD = ("balls_3", "mount_5", "tetra_6")
FRAME_CPU = """\
CPU of a frame is that of all processes, the host included: user and system seconds from the scene in memory to the
picture in memory (split, flood, building, tracing, collecting), as each process counts its own (`time.process_time`,
ZeroMQ's threads included) and the nodes report it. Start-up is not in it, so that it is the array's own overhead. All
arrays are launched at once and render in turn; an array that waits takes no CPU time."""
WHOLE_CPU = """\
CPU of a whole command is what the kernel has added up when it ends: of the front end, of the fork server, which it waits
for, and of all nodes, which the fork server waits for. Starting Python, numba and ZeroMQ is a large part of it."""


def scenes(names: tuple[str, ...]) -> list[Path | BenchError]:
    """Paths of scenes, ours with a suffix, the databases' without; for one that is not there, why."""
    found: list[Path | BenchError] = []
    for name in names:
        try:
            found.append(own(name) if "." in name else spd(name))
        except BenchError as error:
            found.append(error)
    return found


def measure(runs: int, names: tuple[str, ...], shapes: tuple[str, ...], size: int) -> Section:
    """Part b."""
    section = Section(f"b. raygrid on {', '.join(shapes)}, {size}x{size}, 1 sample a pixel; runs: {runs}")
    section.say(WHOLE_CPU)
    whole = section.table(
        "scene", "array", "read, s", "load, s", "trace, s", "collect, s", "whole, s", "CPU of all, s",
        f"whole / {shapes[0]}", f"CPU / {shapes[0]}", "command",
    )  # fmt: skip
    section.say(FRAME_CPU)
    frames = section.table(
        "scene", "array", "wall, s", "CPU of nodes, s", "CPU of host, s", f"CPU / {shapes[0]}", f"wall / {shapes[0]}",
        "max / mean busy, balanced", "max / mean busy, uniform", "command",
    )  # fmt: skip
    for scene in scenes(names):
        if isinstance(scene, BenchError):
            whole.add(str(scene), *["-"] * 10)
            continue
        tell(f"  {scene.name}")
        options = ("--size", f"{size}x{size}", "--samples", "1")
        try:
            _whole_commands(whole, scene, runs, shapes, options)
            _frames(section, frames, scene, runs, shapes, f"{size}x{size}", ("balanced", "uniform"))
        except BenchError as error:
            whole.add(scene.name, str(error), *["-"] * 9)
    return section


def _whole_commands(table: Table, scene: Path, runs: int, shapes: tuple[str, ...], options: tuple[str, ...]) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        turns = {shape: (lambda s=shape: render(scene, folder, "--array", s, *options)) for shape in shapes}
        results = alternating(runs, turns)
    base = results[shapes[0]]
    for shape in shapes:
        done = results[shape]
        phases = [spread(one.phase(phase) for one in done) for phase in ("read", "load", "trace", "collect")]
        wall, cpu = spread(one.wall for one in done), spread(one.cpu for one in done)
        ratios = ratio(wall, spread(one.wall for one in base)), ratio(cpu, spread(one.cpu for one in base))
        words = f"`raygrid render {shown(scene)} --array {shape} {' '.join(options)}`"
        table.add(scene.name, shape, *phases, wall, cpu, *map(number, ratios), words)


def _frames(
    section: Section, table: Table, scene: Path, runs: int, shapes: tuple[str, ...], size: str, splits: tuple[str, ...]
) -> None:
    arrays = [word for shape in shapes for word in ("--array", shape)]
    both = [word for split in splits for word in ("--split", split)]
    lines = script("frames.py", str(scene), *arrays, *both, "--size", size, "--runs", str(runs))
    words = f"`python benchmarks/frames.py {shown(scene)} {' '.join([*arrays, *both])} --size {size} --runs {runs}`"
    base = _of(lines, shapes[0], splits[0])
    for shape in shapes:
        mine = _of(lines, shape, splits[0])
        overhead, wall = ratio(mine["cpu"], base["cpu"]), ratio(mine["wall"], base["wall"])
        balances = [_of(lines, shape, split)["balance"] for split in splits]
        several = len(splits) > 1
        table.add(
            scene.name, shape, mine["wall"], mine["cpu_nodes"], mine["cpu_host"], number(overhead), number(wall),
            *(balances if several else []), words,
        )  # fmt: skip
        _promised(section, scene, shape, size, overhead, wall, balances[0].median)


def _promised(
    section: Section, scene: Path, shape: str, size: str, overhead: float, wall: float, balance: float
) -> None:
    most = {("512x512", "2x2x2"): 1.5, ("2048x2048", "2x2x2"): 1.3, ("2048x2048", "4x4x4"): 1.6}
    if (size, shape) in most and scene.suffix == ".nff":
        section.expect(f"CPU of {shape} over 1x1x1, {scene.stem} at {size}", overhead, most[size, shape], at_most=True)
    if (size, shape) == ("2048x2048", "2x2x2"):
        section.expect(f"wall seconds of {shape} over 1x1x1, {scene.stem} at {size}", wall, 0.65, at_most=True)
    if shape == "2x2x2" and scene.stem.startswith(UNEVEN):
        section.expect(f"max / mean busy of {shape}, {scene.stem} at {size}", balance, 2.0, at_most=True)


def _of(lines: list[dict[str, Any]], shape: str, split: str) -> dict[str, Spread]:
    """The measurements of one array and split."""
    mine = [line for line in lines if line["array"] == shape and line["split"] == split]
    names = ("wall", "cpu_nodes", "cpu_host", "balance")
    return {name: spread(line[name] for line in mine) for name in names} | {
        "cpu": spread(line["cpu_nodes"] + line["cpu_host"] for line in mine)
    }


def measure_overhead(runs: int, names: tuple[str, ...], shapes: tuple[str, ...], size: int) -> Section:
    """Part d."""
    section = Section(f"d. Overhead of the array at {size}x{size}; runs: {runs}")
    section.say(FRAME_CPU)
    table = section.table(
        "scene", "array", "wall, s", "CPU of nodes, s", "CPU of host, s", f"CPU / {shapes[0]}", f"wall / {shapes[0]}",
        "command",
    )  # fmt: skip
    for scene in scenes(names):
        if isinstance(scene, BenchError):
            table.add(str(scene), *["-"] * 7)
            continue
        tell(f"  {scene.name}")
        try:
            _frames(section, table, scene, runs, shapes, f"{size}x{size}", ("balanced",))
        except BenchError as error:
            table.add(scene.name, str(error), *["-"] * 6)
    return section
