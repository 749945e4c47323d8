"""Part e: a large frame and a large mesh."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bench_run import SAMPLE, BenchError, Run, alternating, render, shown, spd, tell
from bench_tables import Section, Spread, Table, number, ratio, spread
from big_mesh import write_ring

ALONE, BALANCED = "--array 1x1x1 --size 512x512", "--array 2x2x2 --size 512x512"
UNIFORM = BALANCED + " --split uniform"
GIB, MIB = 2.0**30, 2.0**20


def measure(runs: int, side: int, triangles: int) -> Section:
    """The section."""
    section = Section(f"e. A frame of {side}x{side}, a mesh of {triangles:,} triangles; runs: {runs}")
    section.say(
        "Memory of all processes is the most that front end, fork server and nodes held together at any time, shared pages "
        f"counted once (Pss), looked at every {SAMPLE:g} s. Surface memory is what a node holds of the scene: "
        "descriptions, derived tables and the hierarchy."
    )
    with tempfile.TemporaryDirectory() as name:
        for part in (_large_frame, _large_mesh):
            try:
                part(section, runs, side if part is _large_frame else triangles, Path(name))
            except BenchError as error:
                section.say(f"{error}.")
    return section


def _large_frame(section: Section, runs: int, side: int, folder: Path) -> None:
    scene = spd("tetra_6")
    tell(f"  {scene.name} at {side}x{side}")
    table = section.table("scene", "samples", "trace, s", "collect, s", "whole, s", "memory of all, GiB", "command")
    memory: dict[str, Spread] = {}
    for samples in ("1", "2"):
        options = ("--array", "2x2x2", "--size", f"{side}x{side}", "--samples", samples)
        done = alternating(runs, {samples: lambda o=options: render(scene, folder, *o, watch_memory=True)})[samples]  # type: ignore[misc]
        memory[samples] = spread(one.memory / GIB for one in done)
        phases = [spread(one.phase(phase) for one in done) for phase in ("trace", "collect")]
        words = f"`raygrid render {shown(scene)} {' '.join(options)}`"
        table.add(scene.name, samples, *phases, spread(one.wall for one in done), memory[samples], words)
    section.expect(f"memory of all processes, tetra_6 at {side}x{side}, GiB", memory["1"].median, 3.0, at_most=True)
    grown = ratio(memory["2"], memory["1"])
    section.expect("the same with 2 samples a pixel over 1 sample", grown, 1.1, at_most=True)


def _large_mesh(section: Section, runs: int, triangles: int, folder: Path) -> None:
    mesh = folder / "ring.ply"
    count = write_ring(mesh, triangles)
    tell(f"  a mesh of {count:,} triangles")
    table = section.table(
        "options", "read, s", "flood and build, s", "trace, s", "whole, s", "memory of all, GiB",
        "surface memory of the largest node, MiB", "of all nodes, MiB", "command",
    )  # fmt: skip
    turns: dict[str, Callable[[], Run]] = {
        words: (lambda w=words: render(mesh, folder, *w.split(), watch_memory=True))
        for words in (ALONE, BALANCED, UNIFORM)
    }
    results = alternating(runs, turns)
    for words, done in results.items():
        _mesh_row(
            table, done, words, f"`python benchmarks/big_mesh.py {count} ring.ply`, `raygrid render ring.ply {words}`"
        )
    loaded = spread(one.phase("read") + one.phase("load") for one in results[BALANCED])
    section.expect(f"{count:,} triangles read, flooded and built on 2x2x2, seconds", loaded.median, 15.0, at_most=True)
    for words, split in ((BALANCED, "balanced"), (UNIFORM, "uniform")):
        one, eight = (max(_surface_memory(results[each][0].stats)) for each in (ALONE, words))
        share = 8.0 * eight / one if one else math.nan
        section.expect(
            f"surface memory of the largest of 8 nodes, {split}, times 8, over the single node's", share, 1.6, True
        )


def _mesh_row(table: Table, done: list[Run], array: str, command: str) -> None:
    phases = [spread(one.phase(phase) for one in done) for phase in ("read", "load", "trace")]
    held = [memory / MIB for memory in _surface_memory(done[0].stats)]
    memory = spread(one.memory / GIB for one in done)
    table.add(
        array, *phases, spread(one.wall for one in done), memory, number(max(held)), number(sum(held)), command
    )  # fmt: skip


def _surface_memory(stats: dict[str, Any]) -> list[int]:
    """Bytes that each node holds of the scene."""
    return [node["memory"]["surfaces"] for node in stats["nodes"]]
