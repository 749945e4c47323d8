"""Checks whether an array fits this computer: descriptors, processes and memory, before anything is started.

What an array needs of each is a fixed part and a part for each node. What there is comes from the process limits,
the kernel's own limits, /proc/meminfo and the control groups (version 1 and 2), whichever leaves least.
"""

from __future__ import annotations

import os
import resource
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from math import ceil, floor, prod
from pathlib import Path
from typing import NamedTuple

from raygrid.node.errors import TooLarge

Shape = tuple[int, int, int]

LARGEST_AXIS = 0xFFFF  # cells of an axis; packets and orders name them by a u16

NODE_DESCRIPTORS = 25  # of one node: six links, a host link, the two global lines, ZeroMQ's own
HOST_DESCRIPTORS = 100 + 8 * 3  # scene and picture files, the fork server's pipes; eight corner sockets
HOST_DESCRIPTORS_A_NODE = 2  # the host's end of its line, and another one while it is forked anew
NODE_TASKS = 3  # the node, and the two threads of its ZeroMQ context (measured)
FIXED_TASKS = 3  # the fork server, and the host's two ZeroMQ threads
NODE_BYTES = 14_000_000  # private memory of a node without surfaces
FORK_SERVER_BYTES = 200_000_000  # numba, LLVM and the kernels, once
UNLIMITED = 1 << 62  # control groups of version 1 write "no limit" as a number of about this size

# The files of a control group that hold the limit, what is used, and the line of memory.stat to take off that.
GROUP_FILES = {
    "pids": (("pids.max", "pids.current", ""),),
    "memory": (
        ("memory.max", "memory.current", "inactive_file"),  # version 2
        ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),  # version 1
    ),
}
CORE_FILES = (("cpu.max",), ("cpu.cfs_quota_us", "cpu.cfs_period_us"))  # quota and period, of version 2 and 1


class Bound(NamedTuple):
    """How much is left of something, and which limit leaves no more."""

    left: int
    limit: str


@dataclass(frozen=True)
class Resources:
    """What this computer has left.

    descriptors   open files that one process may have
    all_files     open files that all processes together may still open
    tasks         processes and threads that may still be started
    memory        bytes
    """

    descriptors: Bound
    all_files: Bound
    tasks: Bound
    memory: Bound


class Demand(NamedTuple):
    """What an array takes of one resource: fixed + a_node x number of nodes."""

    what: str
    fixed: int
    a_node: int
    bound: Bound
    in_bytes: bool = False

    def most_nodes(self) -> int:
        """The most nodes for which the resource suffices; 0 if not even the fixed part is there."""
        spare = self.bound.left - self.fixed
        if spare < 0:
            return 0
        return spare // self.a_node if self.a_node else UNLIMITED

    def shortage(self, nodes: int) -> str:
        """What so many nodes need, and what there is, in words."""
        need, left = self.fixed + self.a_node * nodes, max(self.bound.left, 0)
        if self.in_bytes:
            return f"{_bytes_text(need, ceil)} {self.what}, and {self.bound.limit} leaves {_bytes_text(left, floor)}"
        return f"{need} {self.what}, and {self.bound.limit} leaves {left}"


def parse_shape(text: str) -> Shape:
    """Read the shape of an array such as "4x4x1": cells on the axes x, y and z, 1 to 65535 each.

    Raises ValueError with one sentence that says what came and what was wanted.
    """
    wanted = f"wanted three numbers from 1 to {LARGEST_AXIS}, such as 4x4x4, or 4x4x1 for a square array"
    came = f'array shape "{_shorten(text)}"'
    words = text.strip().lower().split("x")
    if len(words) != 3:
        raise ValueError(f"{came} has {len(words)} part{'s' if len(words) > 1 else ''}, {wanted}")
    cells = []
    for word in words:
        if not (word.isascii() and word.isdigit()):
            raise ValueError(f'{came} has "{_shorten(word)}" for a number, {wanted}')
        # Python refuses to read numbers of thousands of digits, so the length is looked at first.
        if len(word.lstrip("0")) > len(str(LARGEST_AXIS)) or not 1 <= int(word) <= LARGEST_AXIS:
            raise ValueError(f"{came} has {_shorten(word)} cells on an axis, {wanted}")
        cells.append(int(word))
    return cells[0], cells[1], cells[2]


def check_fits(
    shape: Shape, *, bytes_per_node: int = NODE_BYTES, surface_bytes: int = 0, resources: Resources | None = None
) -> None:
    """Raise TooLarge unless an array of this shape fits; the message names what is short and the largest cube.

    bytes_per_node   private memory of a node without surfaces
    surface_bytes    of the surfaces in all nodes together
    resources        what there is; read from this computer if None
    """
    found = read_resources() if resources is None else resources
    _check(f"a {_shape_text(shape)} array", "", shape, _demands(found, bytes_per_node, surface_bytes))


def check_simulated_fits(
    shape: Shape, samples: int, *, bytes_per_node: int, fixed_bytes: int, memory: Bound | None = None
) -> None:
    """Raise TooLarge unless a simulation of an array of this shape fits into memory, as `check_fits` does.

    samples          of the frame, for the message; what they take is a part of `fixed_bytes`
    bytes_per_node   of a node that holds no surface
    fixed_bytes      whatever the number of nodes
    memory           what there is; read from this computer if None
    """
    there = read_memory() if memory is None else memory
    demand = Demand("of memory", fixed_bytes, bytes_per_node, there, in_bytes=True)
    what = f"a simulated {_shape_text(shape)} array"
    _check(what, f" and {samples} sample{'s' * (samples != 1)}", shape, (demand,))


def _check(what: str, beside: str, shape: Shape, demands: tuple[Demand, ...]) -> None:
    """Raise TooLarge unless there is enough of everything; beside: what is needed beside the processors, in words."""
    nodes = prod(shape)
    shortest = min(demands, key=Demand.most_nodes)
    if nodes <= shortest.most_nodes():
        return
    largest = _largest(demands)
    raise TooLarge(
        f"{what} does not fit this computer: its {nodes} processors{beside} need"
        f" {shortest.shortage(nodes)}; {f'largest that fits: {_shape_text(largest)}' if largest[0] else 'nothing fits'}"
    )


def largest_that_fits(resources: Resources, *, bytes_per_node: int = NODE_BYTES, surface_bytes: int = 0) -> Shape:
    """The largest cubic array for which the resources suffice; (0, 0, 0) if they do not suffice for one node."""
    return _largest(_demands(resources, bytes_per_node, surface_bytes))


def _largest(demands: tuple[Demand, ...]) -> Shape:
    nodes = min(demand.most_nodes() for demand in demands)
    side = min(round(nodes ** (1 / 3)), LARGEST_AXIS)
    if side**3 > nodes:
        side -= 1
    return side, side, side


def _demands(found: Resources, bytes_per_node: int, surface_bytes: int) -> tuple[Demand, ...]:
    return (
        Demand("descriptors in each node", NODE_DESCRIPTORS, 0, found.descriptors),
        Demand("descriptors in the host", HOST_DESCRIPTORS, HOST_DESCRIPTORS_A_NODE, found.descriptors),
        Demand("open files", HOST_DESCRIPTORS, HOST_DESCRIPTORS_A_NODE + NODE_DESCRIPTORS, found.all_files),
        Demand("processes and threads", FIXED_TASKS, NODE_TASKS, found.tasks),
        Demand("of memory", FORK_SERVER_BYTES + surface_bytes, bytes_per_node, found.memory, in_bytes=True),
    )


def _shape_text(shape: Shape) -> str:
    return "x".join(str(cells) for cells in shape)


def _bytes_text(number: int, rounded: Callable[[float], int]) -> str:
    """Bytes with their unit; rounded up for a need and down for a rest, so that the two never look equal."""
    for size, unit in ((10**12, "TB"), (10**9, "GB")):
        if number >= size:
            return f"{rounded(number / size * 10) / 10:.1f} {unit}"
    return f"{rounded(number / 10**6)} MB"


def _shorten(text: str) -> str:
    return text if len(text) <= 40 else text[:37] + "..."


# --- what this computer has ----------------------------------------------------------------------


def read_resources(proc: Path = Path("/proc"), cgroups: Path = Path("/sys/fs/cgroup")) -> Resources:
    """What this computer has left now. A limit that cannot be read counts as none."""
    return Resources(
        descriptors=Bound(_process_limit(resource.RLIMIT_NOFILE), "RLIMIT_NOFILE (ulimit -n)"),
        all_files=_all_files(proc),
        tasks=min(_tasks(proc), *_group_bounds(proc, cgroups, "pids")),
        memory=read_memory(proc, cgroups),
    )


def read_memory(proc: Path = Path("/proc"), cgroups: Path = Path("/sys/fs/cgroup")) -> Bound:
    """Bytes of memory that this computer has left now. Alone, because the counting of tasks takes ten times as long."""
    return min(Bound(_meminfo(proc), "the memory available"), *_group_bounds(proc, cgroups, "memory"))


def read_cores(proc: Path = Path("/proc"), cgroups: Path = Path("/sys/fs/cgroup")) -> float:
    """Cores that this process may use at once: those that it may run on, or the share that its control groups leave it."""
    shares = [float(len(os.sched_getaffinity(0)))]
    for group in _groups(proc, cgroups, "cpu"):
        for files in CORE_FILES:
            words = [word for file in files for word in _words(group / file)]
            if len(words) == 2 and words[0].isdigit() and int(words[1]) > 0:  # else "max", or -1
                shares.append(int(words[0]) / int(words[1]))
    return min(shares)


def _process_limit(which: int) -> int:
    soft, _ = resource.getrlimit(which)
    return UNLIMITED if soft == resource.RLIM_INFINITY else soft


def _all_files(proc: Path) -> Bound:
    words = _words(proc / "sys/fs/file-nr")  # allocated, unused, most
    left = int(words[2]) - int(words[0]) if len(words) == 3 else UNLIMITED
    return Bound(left, "fs.file-max")


def _tasks(proc: Path) -> Bound:
    """Processes and threads that the user's limit and the kernel's own leave."""
    bounds = [Bound(_process_limit(resource.RLIMIT_NPROC) - _tasks_of(proc, os.getuid()), "RLIMIT_NPROC (ulimit -u)")]
    load = _words(proc / "loadavg")  # the fourth is "running/all", threads included
    all_tasks = int(load[3].partition("/")[2]) if len(load) > 3 else 0
    for name in ("pid_max", "threads-max"):
        words = _words(proc / "sys/kernel" / name)
        if words:
            bounds.append(Bound(int(words[0]) - all_tasks, f"kernel.{name}"))
    return min(bounds)


def _tasks_of(proc: Path, user: int) -> int:
    """Threads of all processes of a user; those that end meanwhile are left out."""
    tasks = 0
    for status in proc.glob("[0-9]*/status"):
        with suppress(OSError):
            fields = dict(line.split(":\t", 1) for line in status.read_text().splitlines() if ":\t" in line)
            if int(fields.get("Uid", "-1").split()[0]) == user:
                tasks += int(fields.get("Threads", "0"))
    return tasks


def _meminfo(proc: Path) -> int:
    """Bytes that can be had without swapping."""
    with suppress(OSError):
        for line in (proc / "meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    return UNLIMITED


def _group_bounds(proc: Path, cgroups: Path, controller: str) -> Iterator[Bound]:
    """What the control groups above this process leave of "memory" (bytes) or "pids" (tasks)."""
    yield Bound(UNLIMITED, "no limit")
    for group in _groups(proc, cgroups, controller):
        for most, used, reclaimable in GROUP_FILES[controller]:
            words = _words(group / most)
            if not words or words[0] == "max" or int(words[0]) >= UNLIMITED:
                continue
            taken = int((_words(group / used) or ["0"])[0])
            # Pages of files that nobody uses just now count as used, but the kernel gives them up first.
            yield Bound(int(words[0]) - taken + _statistic(group, reclaimable), f"{most} of the control group")


def _groups(proc: Path, cgroups: Path, controller: str) -> Iterator[Path]:
    """The directories of the groups of this process, and of all groups above them.

    In a container the path told may be the one outside, of which only the upper end is mounted;
    directories that are not there are simply found to hold no limit.
    """
    with suppress(OSError):
        for line in (proc / "self/cgroup").read_text().splitlines():
            _, controllers, path = line.split(":", 2)
            if controllers and controller not in controllers.split(","):
                continue
            root = cgroups / controllers if controllers else cgroups
            here = root / path.lstrip("/")
            while here != root:
                yield here
                here = here.parent
            yield root


def _statistic(group: Path, name: str) -> int:
    """A line of memory.stat, in bytes."""
    words = _words(group / "memory.stat")
    return int(words[words.index(name) + 1]) if name in words else 0


def _words(path: Path) -> list[str]:
    """The words of a file; none if it cannot be read."""
    try:
        return path.read_text().split()
    except OSError:
        return []
