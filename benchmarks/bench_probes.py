"""What probes cost: the same frame with and without, in turns, on one array; and what one sample costs its node.

    python benchmarks/bench_probes.py --scene scenes/tiny.nff --size 1024x1024 --samples 4 --array 2x2x2 --rate 10 --runs 9

A sample costs so little that at 10 Hz other things the computer does hide it; --rate 100 shows it.

Prints wall seconds of a frame and processor seconds of all nodes and the front end, with and without probes: the least
of each, and the median of the ratios of frames that followed each other, which says most on a computer that does other
things too.
"""

from __future__ import annotations

import argparse
import math
import os
import statistics
import time
from dataclasses import replace

from raygrid.emulator.driver.memory_array import MemoryArray
from raygrid.emulator.processes.array import Array
from raygrid.emulator.topology.limits import parse_shape
from raygrid.host.probes.sums import Gauges
from raygrid.host.render.frame import render_job
from raygrid.host.render.job import Job, Settings, make_job
from raygrid.host.scene.load import load_scene
from raygrid.node.runtime.probe import memory, sample

COLUMNS = (
    "wall seconds of a frame",
    "processor seconds of the nodes",
    "processor seconds of the front end",
    "both together",
)
TOGETHER, SAMPLES = 3, 4


def frames(array: Array, job: Job, rate: float, runs: int) -> dict[float, list[tuple[float, ...]]]:
    """The figures of COLUMNS of each frame, by rate, frames of both rates in turn."""
    gauges = Gauges(array.shape)
    found: dict[float, list[tuple[float, ...]]] = {0.0: [], rate: []}
    for run in range(2 * runs + 1):
        now = (0.0, rate)[run % 2]
        array.probe(now, gauges.take)
        spent, before = time.process_time(), gauges.samples
        picture = render_job(array.driver, replace(job, load_key="held"))
        seconds = picture.stats["wall_seconds"]
        if run:  # the first one loads, and warms up
            front = time.process_time() - spent
            busy = sum(node["busy_seconds"] for node in picture.stats["nodes"])
            wall = seconds["trace"] + seconds["collect"]
            found[now].append((wall, busy, front, busy + front, gauges.samples - before))
    return found


def one_sample(job: Job) -> float:
    """Microseconds that a node needs to make one sample and pack it."""
    from raygrid.node.protocol.codec import pack_map

    array = MemoryArray(job.space.shape)
    array.driver.ready()
    array.driver.load(job.space, job.surfaces)
    times, used = [], memory(array.processors[0])
    for _ in range(2000):
        begun = time.perf_counter()
        pack_map(sample(array.processors[0], 0, 0, 1.0, 0, used))
        times.append(time.perf_counter() - begun)
    return statistics.median(times) * 1e6


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", default="scenes/tiny.nff")
    parser.add_argument("--size", default="1024x1024")
    parser.add_argument("--samples", type=int, default=4)
    parser.add_argument("--array", default="2x2x2")
    parser.add_argument("--rate", type=float, default=10.0)
    parser.add_argument("--runs", type=int, default=9)
    wanted = parser.parse_args()
    width, height = map(int, wanted.size.split("x"))
    shape = parse_shape(wanted.array)
    job = make_job(load_scene(wanted.scene), shape, Settings(size=(width, height), samples=wanted.samples))
    with Array.launch(shape) as array:
        found = frames(array, job, wanted.rate, wanted.runs)
    print(f"{wanted.scene} {wanted.size} x {wanted.samples}, {wanted.array}, {wanted.runs} frames each")
    for column, name in enumerate(COLUMNS):
        off, on = ([run[column] for run in found[rate]] for rate in (0.0, wanted.rate))
        ratio = statistics.median(one / other for one, other in zip(on, off, strict=True)) - 1.0
        print(
            f"{name}: at least {min(off):.3f} without, {min(on):.3f} at {wanted.rate:g} Hz "
            f"({100.0 * (min(on) / min(off) - 1.0):+.2f} %); median of ratios {100.0 * ratio:+.2f} %"
        )
    off, on = ([run[TOGETHER] for run in found[rate]] for rate in (0.0, wanted.rate))
    samples = statistics.median(run[SAMPLES] for run in found[wanted.rate])
    each = (statistics.median(on) - statistics.median(off)) / max(samples, 1)
    nodes, processors = math.prod(shape), len(os.sched_getaffinity(0))
    print(
        f"a sample: {each * 1e6:.0f} microseconds of processor time, all told ({samples:.0f} a frame); "
        f"{nodes} nodes at 10 Hz: {100.0 * each * 10 * nodes / processors:.2f} % of {processors} processors"
    )
    print(f"of that, to make and pack it, warm: {one_sample(job):.0f} microseconds")


if __name__ == "__main__":
    main()
