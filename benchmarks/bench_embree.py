"""Part f: the kernel against Embree, by the script that measures it."""

from __future__ import annotations

import sys

from bench_run import ROOT, BenchError, run, shown, spd
from bench_tables import Section

SCRIPT = ROOT / "benchmarks" / "kernel_embree.py"
SCENES = ("tetra_6", "mount_6")


def measure(names: tuple[str, ...]) -> Section:
    """The section: what the script prints."""
    section = Section("f. The kernel against Embree, one core")
    if not SCRIPT.is_file():
        section.say("skipped: benchmarks/kernel_embree.py is not there.")
        return section
    paths = []
    for name in names:
        try:
            paths.append(spd(name))
        except BenchError as error:
            section.say(f"{error}.")
    section.say(f"`{' '.join(['python benchmarks/kernel_embree.py', *map(shown, paths)])}`")
    try:
        output = run([sys.executable, str(SCRIPT), *map(str, paths)]).output
    except BenchError as error:
        section.say(f"{error}.")
        return section
    section.say(f"```\n{output.rstrip()}\n```")
    for mesh, rays, ratio in ratios_in(output):
        section.expect(f"closest hits a second over Embree's, {mesh}, {rays} rays", ratio, 0.5, at_most=False)
    return section


def ratios_in(output: str) -> list[tuple[str, str, float]]:
    """(mesh, rays, ratio) of each line of the script's table: name, triangles, rays, ..., ratio, same hits in %."""
    found = []
    for words in map(str.split, output.splitlines()):
        if len(words) > 5 and words[1].isdigit():
            try:
                found.append((words[0], words[2], float(words[-2])))
            except ValueError:
                continue
    return found
