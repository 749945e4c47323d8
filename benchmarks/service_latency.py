"""How quick an array that stays is: until it is up, and around a small frame of a scene that is loaded.

    python benchmarks/service_latency.py --runs 5 --frames 50

`up`: wall seconds of the command `raygrid up`, from the shell's view. `overhead`: milliseconds from handing a job to the
service until its client hears that the file is there, without the tracing; the scene is loaded, the client connected.
`command`: wall seconds of the command `raygrid submit` for the same. Prints Markdown, the last line says whether the
promises are kept: up in 2 s, overhead below 50 ms, both medians.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path
from statistics import median

from bench_run import RAYGRID, ROOT, run
from bench_tables import spread

import raygrid

NAME = "bench-latency"
PROMISED_UP, PROMISED_OVERHEAD = 2.0, 50.0


def overheads(
    scene: Path, folder: Path, frames: int, size: tuple[int, int]
) -> tuple[list[float], dict[str, list[float]]]:
    """Milliseconds beside the tracing of each frame, and those of its phases; the first frame loads and is left out."""
    around: list[float] = []
    phases: dict[str, list[float]] = {}
    with raygrid.connect(NAME) as array:
        for _ in range(frames + 1):
            seconds: dict[str, float] = {}
            begun = time.perf_counter()
            job = array.submit(scene, output=folder / "frame.png", size=size)
            job.wait(lambda event, seconds=seconds: seconds.update(event.get("seconds", {})))  # type: ignore[misc]
            whole = time.perf_counter() - begun
            around.append(1e3 * (whole - seconds.get("trace", 0.0)))
            for phase, spent in seconds.items():
                phases.setdefault(phase, []).append(1e3 * spent)
    return around[1:], {phase: spent[1:] for phase, spent in phases.items() if len(spent) > 1}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--array", default="2x2x2", metavar="NXxNYxNZ")
    parser.add_argument("--runs", type=int, default=5, metavar="N")
    parser.add_argument("--frames", type=int, default=50, metavar="N")
    options = parser.parse_args()
    size = (160, 120)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        os.environ["XDG_STATE_HOME"] = name
        ups, downs = [], []
        for _ in range(options.runs):
            ups.append(run([RAYGRID, "up", "--array", options.array, "--name", NAME]).wall)
            downs.append(run([RAYGRID, "down", "--name", NAME]).wall)
        run([RAYGRID, "up", "--array", options.array, "--name", NAME])
        try:
            print("| what | figure |\n|---|---|")
            print(f"| `raygrid up --array {options.array}`, warm, whole command, s | {spread(ups)} |")
            print(f"| `raygrid down`, s | {spread(downs)} |")
            worst = 0.0
            for scene in ("tiny.nff", "room.glb", "kinds.nff"):
                around, phases = overheads(ROOT / "scenes" / scene, folder, options.frames, size)
                worst = max(worst, median(around))
                print(f"| {scene}, {size[0]}x{size[1]}: beside the tracing, ms | {spread(around)} |")
                for phase in ("trace", "collect"):
                    print(f"| - {phase}, ms | {spread(phases[phase])} |")
            command = [RAYGRID, "submit", "scenes/tiny.nff", "--name", NAME, "--size", "160x120", "-o", f"{name}/c.png"]
            commands = [run(command).wall for _ in range(options.runs)]
            print(f"| `raygrid submit scenes/tiny.nff --size 160x120`, whole command, s | {spread(commands)} |")
        finally:
            run([RAYGRID, "down", "--name", NAME])
    kept = median(ups) < PROMISED_UP and worst < PROMISED_OVERHEAD
    print(f"\nup {median(ups):.2f} s, overhead {worst:.1f} ms: {'kept' if kept else 'NOT KEPT'}")


if __name__ == "__main__":
    main()
