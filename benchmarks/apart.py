"""Processes that have nothing to do with each other: what it costs only that there are several, and few processors.

    python benchmarks/apart.py scenes/kinds.nff --processes 8 --size 512x512 --runs 5

So many arrays of one node each render the same scene at the same moment, each with its part of the pixels (a smaller
picture of the whole, of as many pixels in all), beside one that renders them all alone. There are no hops and no links
between them: what eight nodes take more than one is the price of a frame's orders in each process, and of caches that
processes take from each other. A JSON map a run: CPU seconds of the node alone, and of all nodes together.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from typing import IO

from raygrid.host.image.picture import Picture
from raygrid.host.render.api import launch, load_scene


def _cpu(picture: Picture) -> float:
    return sum(float(node["cpu_seconds"]) for node in picture.stats["nodes"])


def _be_one(path: str, size: tuple[int, int]) -> None:
    """Render a frame for each line that comes, and say what it took the node."""
    scene = load_scene(path)
    with launch("1x1x1") as machine:
        spent = _cpu(machine.render(scene, size=size, samples=1))
        print("ready", flush=True)
        for _ in sys.stdin:
            before, spent = spent, _cpu(machine.render(scene, size=size, samples=1))
            print(spent - before, flush=True)


def _start(path: str, size: tuple[int, int]) -> subprocess.Popen[str]:
    words = [sys.executable, __file__, path, "--one", "--size", f"{size[0]}x{size[1]}"]
    return subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def _line(stream: IO[str] | None) -> str:
    assert stream is not None
    return stream.readline().strip()


def _frames(processes: list[subprocess.Popen[str]]) -> float:
    """Let all render one frame at once; CPU seconds of their nodes."""
    for process in processes:
        assert process.stdin is not None
        process.stdin.write("frame\n")
        process.stdin.flush()
    return sum(float(_line(process.stdout)) for process in processes)


def main() -> None:
    """Print a line a run."""
    parser = argparse.ArgumentParser(description="Nodes that have nothing to do with each other, and one alone.")
    parser.add_argument("scene")
    parser.add_argument("--processes", type=int, default=8, metavar="N")
    parser.add_argument("--size", default="512x512", metavar="WxH")
    parser.add_argument("--runs", type=int, default=5, metavar="N")
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    width, height = (int(side) for side in options.size.split("x"))
    if options.one:
        _be_one(options.scene, (width, height))
        return
    share = options.processes**-0.5
    apart = [_start(options.scene, (round(width * share), round(height * share))) for _ in range(options.processes)]
    alone = [_start(options.scene, (width, height))]
    for process in (*apart, *alone):
        assert _line(process.stdout) == "ready"
    for _ in range(options.runs):
        print(json.dumps({"alone": _frames(alone), "apart": _frames(apart)}), flush=True)
    for process in (*apart, *alone):
        assert process.stdin is not None
        process.stdin.close()
        process.wait()


if __name__ == "__main__":
    main()
