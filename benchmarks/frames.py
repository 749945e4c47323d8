"""Frames on several arrays in turn, with all arrays launched at once: a JSON map a frame.

    python benchmarks/frames.py scenes/kinds.nff --array 1x1x1 --array 2x2x2 --size 512x512 --runs 3

Each line: array, split, seconds of load, trace, collect and all of it (wall), CPU seconds of the nodes and of this
process, which is their host, from the scene in memory to the picture in memory (cpu_nodes, cpu_host; start-up is not in
them), and the busiest node's CPU seconds over the mean (balance). The CPU seconds of a node are those of its process,
ZeroMQ's thread included. Waiting arrays take none. One small frame an array goes before, so that none pays for being
the first.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import time
from typing import Any

from raygrid.host.image.picture import Picture
from raygrid.host.render.api import Machine, launch, load_scene
from raygrid.host.scene.scene import Scene


class Meter:
    """An array and what its nodes have spent so far."""

    def __init__(self, shape: str, machine: Machine, scene: Scene) -> None:
        self.shape, self._machine, self._scene = shape, machine, scene
        self._spent = _cpu_of_nodes(machine.render(scene, size=(32, 32), samples=1))

    def frame(self, size: tuple[int, int], samples: int, split: str) -> dict[str, Any]:
        """Render one frame and say what it took."""
        wall, cpu = time.perf_counter(), time.process_time()
        picture = self._machine.render(self._scene, size=size, samples=samples, split=split)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        before, self._spent = self._spent, _cpu_of_nodes(picture)
        seconds = picture.stats["wall_seconds"]
        return {
            "array": self.shape,
            "split": split,
            **{phase: seconds[phase] for phase in ("load", "trace", "collect")},
            "wall": wall,
            "cpu_nodes": self._spent - before,
            "cpu_host": cpu,
            "balance": picture.stats["balance"],
        }


def _cpu_of_nodes(picture: Picture) -> float:
    return sum(float(node["cpu_seconds"]) for node in picture.stats["nodes"])


def main() -> None:
    """Print a line a frame."""
    parser = argparse.ArgumentParser(description="Frames on several arrays in turn, a JSON map a frame.")
    parser.add_argument("scene")
    parser.add_argument("--array", action="append", required=True, metavar="NXxNYxNZ")
    parser.add_argument("--size", default="512x512", metavar="WxH")
    parser.add_argument("--samples", type=int, default=1, metavar="N")
    parser.add_argument("--split", action="append", choices=["balanced", "uniform"])
    parser.add_argument("--runs", type=int, default=3, metavar="N")
    options = parser.parse_args()
    width, height = (int(side) for side in options.size.split("x"))
    scene = load_scene(options.scene)
    with contextlib.ExitStack() as stack:
        meters = [Meter(shape, stack.enter_context(launch(shape)), scene) for shape in options.array]
        for _ in range(options.runs):
            for split in options.split or ["balanced"]:
                for meter in meters:
                    print(json.dumps(meter.frame((width, height), options.samples, split)), flush=True)


if __name__ == "__main__":
    main()
