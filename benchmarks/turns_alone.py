"""Turns alone, without sockets, ZeroMQ and waves: what a packet costs that crosses a face between two cells.

    python benchmarks/turns_alone.py --scene balls_3.nff --array 1x1x1 --array 2x2x2 --size 1024x1024 --runs 5

The array in one process; only compiled code is timed: turns, and the sorting of packets that come over links. A JSON
map an array: CPU seconds, the least of all runs, of which for sorting; rays walked through cells, packets that cross a
face (hops), and nanoseconds a hop: of what an array spends more than the first one that is named, which should have one
cell; calls of compiled code. Runs go round the arrays, so that other work on this computer hits all of them alike.

The way from Python into compiled code costs up to 40 microseconds, most of it cold caches, and processes go it once for
many turns. So nodes gather as much as they can take in a turn, and what a call with nothing to do costs is taken off.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from raygrid.emulator.driver.memory_array import MemoryArray
from raygrid.host.render.job import Job, Settings, make_job
from raygrid.host.scene.load import load_scene
from raygrid.node.geometry.grid_walk import PORTS
from raygrid.node.protocol.counters import SENT, WALKS
from raygrid.node.tracing import work_queues

Shape = tuple[int, int, int]


IDLE_CALLS = 2000
GATHER = 4  # a node may hold so many times less than the one that holds most
TURN = 65536  # packets after which a turn ends


class Clock:
    """CPU seconds spent in calls of functions, and how many there were."""

    def __init__(self) -> None:
        self.seconds, self.calls = 0.0, 0

    def of(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, timed."""

        def timed(*arguments: Any) -> Any:
            begun = time.thread_time_ns()
            try:
                return function(*arguments)
            finally:
                self.seconds += (time.thread_time_ns() - begun) * 1e-9
                self.calls += 1

        return timed

    def clear(self) -> None:
        """Begin anew."""
        self.seconds, self.calls = 0.0, 0


def idle_call(clock: Clock, call: Callable[[], Any]) -> float:
    """Seconds of a call with nothing to do that this clock counts: the least of many."""
    least = np.inf
    for _ in range(IDLE_CALLS):
        clock.clear()
        call()
        least = min(least, clock.seconds)
    return least


class Gathering(MemoryArray):
    """An array in which a node takes no turn while it holds much less than the others."""

    def _pump(self, seconds: float) -> None:
        for processor in self.processors:
            for port in processor.links:
                processor.receive(port)
        held = [processor.node_state.work_queues.held for processor in self.processors]
        for processor, here in zip(self.processors, held, strict=True):
            if here == 0 or here * GATHER >= max(held) or processor.node_state.quota > 0:
                processor.work()
        for corner in self.driver.links:
            self.driver.receive(corner)


class Loaded:
    """An array that holds a scene, with its clocks."""

    def __init__(self, shape: Shape, job: Job, sorting: Clock) -> None:
        self.shape, self.job = shape, job
        self.turns, self.sorting = Clock(), sorting
        self.array = Gathering(shape)
        self.array.driver.ready()
        self.array.driver.load(job.space, job.surfaces)
        for processor in self.array.processors:
            processor.node_state.run_loop = self.turns.of(processor.node_state.run_loop)
            processor.node_state.tuning.batch_packets = TURN
        self.least, self.least_sorting = np.inf, np.inf
        self.calls = 0

    def run(self) -> None:
        """Trace the frame once."""
        self.turns.clear()
        self.sorting.clear()
        self.array.driver.trace(self.job.frame)
        self.calls = self.turns.calls
        spent = [(clock.seconds, clock.calls) for clock in (self.turns, self.sorting)]
        node_state = self.array.processors[0].node_state
        idle = (
            idle_call(self.turns, node_state.work),
            idle_call(self.sorting, lambda: node_state.work_queues.sort_in(b"", 0, 0)),
        )
        turns, sorting = (seconds - calls * one for (seconds, calls), one in zip(spent, idle, strict=True))
        self.least_sorting = min(self.least_sorting, sorting)
        self.least = min(self.least, turns + sorting)

    def figures(self, alone: Loaded) -> dict[str, Any]:
        """What came out; `alone`: the array to compare with."""
        counts = sum(processor.node_state.counts for processor in self.array.processors)
        assert isinstance(counts, np.ndarray)
        hops = int(counts[SENT : SENT + PORTS].sum())
        return {
            "array": "x".join(map(str, self.shape)),
            "cpu_s": round(self.least, 3),
            "calls": self.calls,
            "sorting_s": round(self.least_sorting, 3),
            "walks": int(counts[WALKS]),
            "hops": hops,
            "ns_a_hop": round((self.least - alone.least) / hops * 1e9, 1) if hops else None,
        }


def measure(scene: Path, shapes: list[Shape], size: tuple[int, int], runs: int) -> list[dict[str, Any]]:
    """Figures of each array."""
    sorting = Clock()
    work_queues._sort_in = sorting.of(work_queues._sort_in)
    loaded = load_scene(scene)
    arrays = [Loaded(shape, make_job(loaded, shape, Settings(size=size)), sorting) for shape in shapes]
    for _ in range(runs):
        for array in arrays:
            array.run()
    return [array.figures(arrays[0]) for array in arrays]


def _numbers(text: str) -> tuple[int, ...]:
    return tuple(int(number) for number in text.split("x"))


def main() -> None:
    """Print a line an array."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scene", type=Path, action="append", required=True, metavar="FILE")
    parser.add_argument("--array", type=_numbers, action="append", required=True, metavar="XxYxZ")
    parser.add_argument("--size", type=_numbers, default=(1024, 1024), metavar="WxH")
    parser.add_argument("--runs", type=int, default=5, metavar="N")
    options = parser.parse_args()
    for scene in options.scene:
        for figures in measure(scene, options.array, options.size, options.runs):
            print(json.dumps({"scene": scene.stem, **figures}), flush=True)


if __name__ == "__main__":
    main()
