"""A soak: many small frames by several clients at once, and what every process holds meanwhile.

    python benchmarks/soak.py --frames 500 --clients 3

Each client is a process that submits its frames one job at a time, of its own scene and size. After a tenth of the
frames, and then every few, each process of the array (service, fork server, nodes) is looked at: private memory,
descriptors, threads. They count as flat if descriptors and threads are no more at the end than at the first look, and
memory of the last quarter of the looks is at most 3 % or 2 MB above that of the second quarter. Each frame's file is
compared with the first of its client. Prints Markdown; exit code 1 if anything is not flat or not the same.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

import psutil
from bench_run import RAYGRID, ROOT, run

import raygrid

NAME = "bench-soak"
SCENES = ("tiny.nff", "kinds.nff", "room.glb")
SLACK_PART, SLACK_BYTES = 0.03, 2_000_000
CLIENT = """
import sys, raygrid
name, scene, size, frames, pattern = sys.argv[1:]
with raygrid.connect(name) as array:
    for frame in range(int(frames)):
        array.submit(scene, output=pattern.replace("%d", str(frame)), size=(int(size), int(size))).wait()
        print(frame, flush=True)
"""


@dataclass
class Held:
    """What one process held at each look."""

    what: str
    memory: list[int] = field(default_factory=list)
    descriptors: list[int] = field(default_factory=list)
    threads: list[int] = field(default_factory=list)

    def flat(self) -> bool:
        """Whether it does not grow."""
        quarter = max(1, len(self.memory) // 4)
        before, after = median(self.memory[quarter : 2 * quarter]), median(self.memory[-quarter:])
        same = self.descriptors[-1] <= self.descriptors[0] and self.threads[-1] <= self.threads[0]
        return same and after - before <= max(SLACK_BYTES, SLACK_PART * before)

    def row(self) -> str:
        """As a line of the table."""
        memory = f"{self.memory[0] / 1e6:.1f} / {max(self.memory) / 1e6:.1f} / {self.memory[-1] / 1e6:.1f}"
        counts = (f"{values[0]} / {max(values)} / {values[-1]}" for values in (self.descriptors, self.threads))
        return f"| {self.what} | {memory} | {' | '.join(counts)} | {'yes' if self.flat() else 'NO'} |"


def look(processes: dict[int, Held]) -> None:
    """Note what each process holds now."""
    for pid, held in processes.items():
        process = psutil.Process(pid)
        held.memory.append(process.memory_full_info().uss)
        held.descriptors.append(process.num_fds())
        held.threads.append(process.num_threads())


def processes_of(array: raygrid.Service) -> dict[int, Held]:
    """All processes of the array."""
    nodes = {node["pid"]: "node " + ",".join(map(str, node["node"])) for node in array.status()["nodes"]}
    found = {array.pid: Held("service")}
    for process in psutil.Process(array.pid).children(recursive=True):
        found[process.pid] = Held(nodes.get(process.pid, "fork server"))
    return found


def soak(array: raygrid.Service, folder: Path, frames: int, clients: int) -> tuple[dict[int, Held], int]:
    """Run the clients to their ends; what processes held, and how many frames differ from the first of their client."""
    shares = [frames // clients + (k < frames % clients) for k in range(clients)]
    running = []
    for k, share in enumerate(shares):
        scene = ROOT / "scenes" / SCENES[k % len(SCENES)]
        arguments = [NAME, str(scene), str(64 + 16 * k), str(share), str(folder / f"{k}_%d.npy")]
        running.append(subprocess.Popen([sys.executable, "-c", CLIENT, *arguments], stdout=subprocess.PIPE, text=True))
    processes: dict[int, Held] = {}
    first = running[0].stdout
    assert first is not None
    for line in first:  # the first client is the clock of the looks
        done = int(line) * clients
        if done >= frames // 10:
            processes = processes or processes_of(array)
            look(processes)
    for client in running:
        client.communicate()
        assert client.returncode == 0, "a client failed"
    different = 0
    for k, share in enumerate(shares):
        sums = [hashlib.sha256((folder / f"{k}_{frame}.npy").read_bytes()).digest() for frame in range(share)]
        different += sum(one != sums[0] for one in sums)
    return processes, different


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--array", default="2x2x2", metavar="NXxNYxNZ")
    parser.add_argument("--frames", type=int, default=500, metavar="N")
    parser.add_argument("--clients", type=int, default=3, metavar="N")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        os.environ["XDG_STATE_HOME"] = name
        run([RAYGRID, "up", "--array", options.array, "--name", NAME])
        try:
            with raygrid.connect(NAME) as array:
                processes, different = soak(array, Path(name), options.frames, options.clients)
                status = array.status()
        finally:
            run([RAYGRID, "down", "--name", NAME])
    print(f"{status['frames']['done']} frames by {options.clients} clients, {status['floods']} floods;", end=" ")
    print(f"{different} frames differ, {status['frames']['failed']} failed, {status['faults']['count']} faults.\n")
    print(
        "| process | private memory, MB (first / most / last look) | descriptors | threads | flat |\n|---|---|---|---|---|"
    )
    for held in processes.values():
        print(held.row())
    bad = different or status["frames"]["failed"] or not all(held.flat() for held in processes.values())
    raise SystemExit(1 if bad else 0)


if __name__ == "__main__":
    main()
