"""Running commands: wall seconds, CPU seconds and memory of a command with all its processes, and turns A B A B."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

ROOT = Path(__file__).resolve().parents[1]
SHARED = Path(os.environ.get("RAYGRID_SHARED", ROOT.parent / "shared"))
RAYGRID = str(Path(sys.executable).with_name("raygrid"))
LONGEST = 1800.0  # seconds that any one command may take
SAMPLE = 0.2  # seconds between two looks at the memory of all processes
T = TypeVar("T")


class BenchError(Exception):
    """A command failed; the text is one sentence that can stand in the table."""


@dataclass(frozen=True)
class Run:
    """What one run of a command took.

    wall    seconds from starting it to its end
    cpu     user and system seconds of the command and of all processes that it and they have started: the kernel adds
            up for a process what it waited for, the fork server waits for all nodes, and the front end for the fork server
    memory  bytes, the most that all of them together held at one time (shared pages counted once); 0 if not watched
    output  what it wrote to standard output and error
    stats   the statistics that raygrid wrote, if asked
    """

    wall: float
    cpu: float
    memory: int
    output: str
    stats: dict[str, Any] = field(default_factory=dict)

    def phase(self, name: str) -> float:
        """Wall seconds of a phase of raygrid."""
        return float(self.stats["wall_seconds"][name])


def run(command: list[str], cwd: Path = ROOT, stats: Path | None = None, watch_memory: bool = False) -> Run:
    """Run a command to its end. Raises BenchError if it cannot be started, fails, or takes too long."""
    with tempfile.TemporaryFile() as out:
        begun = time.perf_counter()
        try:
            process = subprocess.Popen(command, cwd=cwd, stdin=subprocess.DEVNULL, stdout=out, stderr=out)
        except OSError as error:
            raise BenchError(f"{Path(command[0]).name} cannot be started ({error.strerror})") from None
        watcher = MemoryWatcher(process.pid) if watch_memory else None
        code, cpu = _wait(process)
        wall = time.perf_counter() - begun
        memory = watcher.stop() if watcher is not None else 0
        out.seek(0)
        output = out.read().decode(errors="replace")
    if code != 0:
        last = (output.strip().splitlines() or ["without a word"])[-1]
        raise BenchError(f"{Path(command[0]).name} failed with {code}: {last[:200]}")
    return Run(wall, cpu, memory, output, json.loads(stats.read_text()) if stats is not None else {})


def _wait(process: subprocess.Popen[bytes]) -> tuple[int, float]:
    """(exit code, CPU seconds of all) once it has ended; ends it if it takes too long or Ctrl-C comes."""
    descriptor, ended = os.pidfd_open(process.pid), False
    try:
        poller = select.poll()
        poller.register(descriptor, select.POLLIN)
        ended = bool(poller.poll(LONGEST * 1000))
    finally:
        os.close(descriptor)
        if not ended:
            process.send_signal(signal.SIGTERM)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if not ended:
        raise BenchError(f"a command took more than {LONGEST:g} seconds")
    return process.returncode, usage.ru_utime + usage.ru_stime


class MemoryWatcher:
    """Looks again and again at how much memory a process and all its descendants hold together."""

    def __init__(self, pid: int) -> None:
        self._pid, self._most = pid, 0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    def stop(self) -> int:
        """End watching; returns the most bytes seen."""
        self._over.set()
        self._thread.join()
        return self._most

    def _watch(self) -> None:
        while not self._over.wait(SAMPLE):
            self._most = max(self._most, sum(map(proportional_memory, descendants(self._pid))))


def descendants(pid: int) -> list[int]:
    """The process and all that descend from it."""
    children: dict[int, list[int]] = {}
    for entry in os.listdir("/proc"):
        if entry.isdigit():
            try:
                parent = int(Path("/proc", entry, "stat").read_text().rpartition(")")[2].split()[1])
            except (OSError, ValueError, IndexError):
                continue  # it has ended
            children.setdefault(parent, []).append(int(entry))
    found = [pid]
    for member in found:
        found += children.get(member, [])
    return found


def proportional_memory(pid: int) -> int:
    """Bytes resident of a process, of pages that n processes share the n-th part; 0 if it is gone."""
    try:
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0
    return sum(1024 * int(line.split()[1]) for line in lines if line.startswith("Pss:"))


def alternating(runs: int, turns: Mapping[str, Callable[[], T]]) -> dict[str, list[T]]:
    """Take all turns, A B C, `runs` times over, so that what else this computer does hits all of them alike."""
    results: dict[str, list[T]] = {name: [] for name in turns}
    for k in range(runs):
        for name, turn in turns.items():
            tell(f"    {name}, run {k + 1} of {runs}")
            results[name].append(turn())
    return results


def render(scene: Path, folder: Path, *options: str, watch_memory: bool = False) -> Run:
    """`raygrid render`, the picture and the statistics going to a folder."""
    stats = folder / "stats.json"
    command = [RAYGRID, "render", str(scene), *options, "-o", str(folder / "raygrid.png"), "--stats", str(stats)]
    return run(command, stats=stats, watch_memory=watch_memory)


def script(name: str, *arguments: str) -> list[dict[str, Any]]:
    """Run a script of this directory that prints a JSON map a line."""
    done = run([sys.executable, str(ROOT / "benchmarks" / name), *arguments])
    return [json.loads(line) for line in done.output.splitlines() if line.startswith("{")]


def shown(path: Path) -> str:
    """A path as a reader of the table can use it."""
    if path.is_relative_to(SHARED):
        return f"$RAYGRID_SHARED/{path.relative_to(SHARED)}"
    return str(path.relative_to(ROOT)) if path.is_relative_to(ROOT) else path.name


def own(name: str) -> Path:
    """A scene of this repository. Raises BenchError if it is not there."""
    path = ROOT / "scenes" / name
    if not path.is_file():
        raise BenchError(f"skipped: there is no scenes/{name}")
    return path


def spd(name: str) -> Path:
    """A scene of the Standard Procedural Databases. Raises BenchError if it is not there."""
    path = SHARED / "scenes" / "spd" / f"{name}.nff"
    if not path.is_file():
        raise BenchError(f"skipped: {name}.nff is not in $RAYGRID_SHARED/scenes/spd (RAYGRID_SHARED, else ../shared)")
    return path


def tell(line: str) -> None:
    """Progress."""
    print(line, file=sys.stderr, flush=True)
