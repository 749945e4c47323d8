"""Shapes, and whether an array fits: by made-up resources and by made-up /proc and control groups."""

import os
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from raygrid.emulator.topology.limits import (
    FIXED_TASKS,
    FORK_SERVER_BYTES,
    HOST_DESCRIPTORS,
    HOST_DESCRIPTORS_A_NODE,
    NODE_DESCRIPTORS,
    NODE_TASKS,
    UNLIMITED,
    Bound,
    Resources,
    check_fits,
    check_simulated_fits,
    largest_that_fits,
    parse_shape,
    read_cores,
    read_resources,
)
from raygrid.node.errors import TooLarge

PLENTY = Resources(
    descriptors=Bound(1 << 20, "RLIMIT_NOFILE (ulimit -n)"),
    all_files=Bound(UNLIMITED, "fs.file-max"),
    tasks=Bound(UNLIMITED, "RLIMIT_NPROC (ulimit -u)"),
    memory=Bound(UNLIMITED, "the memory available"),
)


def with_memory_for(nodes: int, bytes_per_node: int = 10_000_000, more: int = 0) -> Resources:
    """Resources with memory for exactly so many nodes."""
    return replace(PLENTY, memory=Bound(FORK_SERVER_BYTES + nodes * bytes_per_node + more, "the memory available"))


# --- shapes --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "shape"),
    [
        ("2x2x2", (2, 2, 2)),
        (" 4X4x1 ", (4, 4, 1)),
        ("1x1x1", (1, 1, 1)),
        ("065535x1x1", (65535, 1, 1)),
    ],
)
def test_shapes(text, shape):
    assert parse_shape(text) == shape


@pytest.mark.parametrize(
    ("text", "came"),
    [
        ("4x4", 'array shape "4x4" has 2 parts,'),
        ("4", 'array shape "4" has 1 part,'),
        ("", 'array shape "" has 1 part,'),
        ("2x2x2x2", 'array shape "2x2x2x2" has 4 parts,'),
        ("0x2x2", 'array shape "0x2x2" has 0 cells on an axis,'),
        ("2x2x000", 'array shape "2x2x000" has 000 cells on an axis,'),
        ("-2x2x2", 'array shape "-2x2x2" has "-2" for a number,'),
        ("2x2x", 'array shape "2x2x" has "" for a number,'),
        ("2x2.0x2", 'array shape "2x2.0x2" has "2.0" for a number,'),
        ("2x 2x2", 'array shape "2x 2x2" has " 2" for a number,'),
        ("2x²x2", 'array shape "2x²x2" has "²" for a number,'),
        ("٢x2x2", 'array shape "٢x2x2" has "٢" for a number,'),
        ("2x65536x2", 'array shape "2x65536x2" has 65536 cells on an axis,'),
        ("9" * 9000 + "x1x1", f'array shape "{"9" * 37}..." has {"9" * 37}... cells on an axis,'),
    ],
)
def test_what_is_no_shape(text, came):
    with pytest.raises(ValueError, match="wanted three numbers from 1 to 65535, such as 4x4x4, or 4x4x1 for") as error:
        parse_shape(text)
    assert str(error.value).startswith(came)


# --- what fits -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("nodes", "side"), [(0, 0), (1, 1), (7, 1), (8, 2), (26, 2), (27, 3), (1728, 12), (10**6, 100)]
)
def test_the_largest_cube(nodes, side):
    found = replace(with_memory_for(nodes), descriptors=Bound(UNLIMITED, ""))
    assert largest_that_fits(found, bytes_per_node=10_000_000) == (side, side, side)


def test_the_largest_cube_is_never_larger_than_a_packet_can_name():
    assert largest_that_fits(replace(PLENTY, descriptors=Bound(UNLIMITED, "")), bytes_per_node=1) == (
        65535,
        65535,
        65535,
    )


def test_an_array_that_just_fits_and_one_that_just_does_not():
    found = with_memory_for(12, more=9_999_999)
    check_fits((2, 2, 3), bytes_per_node=10_000_000, resources=found)
    with pytest.raises(TooLarge) as error:
        check_fits((13, 1, 1), bytes_per_node=10_000_000, resources=found)
    assert str(error.value) == (
        "a 13x1x1 array does not fit this computer: its 13 processors need 330 MB of memory,"
        " and the memory available leaves 329 MB; largest that fits: 2x2x2"
    )


def test_surfaces_take_memory_too():
    found = with_memory_for(8)
    check_fits((2, 2, 2), bytes_per_node=10_000_000, resources=found)
    with pytest.raises(TooLarge, match=r"need 281 MB of memory, .* leaves 280 MB; largest that fits: 1x1x1"):
        check_fits((2, 2, 2), bytes_per_node=10_000_000, surface_bytes=1, resources=found)


def test_terabytes_are_called_so():
    with pytest.raises(
        TooLarge, match=r"64000 processors need 1\.1 TB of memory, .* leaves 1\.2 GB; largest .*: 3x3x3"
    ):
        check_fits((40, 40, 40), bytes_per_node=16_000_000, resources=with_memory_for(100))


@pytest.mark.parametrize(
    ("name", "left", "said"),
    [
        ("descriptors", NODE_DESCRIPTORS - 1, "need 25 descriptors in each node, and the limit leaves 24; nothing"),
        (
            "descriptors",
            HOST_DESCRIPTORS + 27 * HOST_DESCRIPTORS_A_NODE,
            "need 252 descriptors in the host, and the limit leaves 178; largest that fits: 3x3x3",
        ),
        (
            "all_files",
            HOST_DESCRIPTORS + 8 * (HOST_DESCRIPTORS_A_NODE + NODE_DESCRIPTORS),
            "need 1852 open files, and the limit leaves 340; largest that fits: 2x2x2",
        ),
        (
            "tasks",
            FIXED_TASKS + 27 * NODE_TASKS + NODE_TASKS - 1,
            "need 195 processes and threads, and the limit leaves 86; largest that fits: 3x3x3",
        ),
        ("tasks", -5, "need 195 processes and threads, and the limit leaves 0; nothing fits"),
    ],
)
def test_what_is_short_is_named(name, left, said):
    with pytest.raises(TooLarge) as error:
        check_fits((4, 4, 4), resources=replace(PLENTY, **{name: Bound(left, "the limit")}))
    assert said in str(error.value)


def test_this_computer_has_room_for_one_node_and_not_for_all():
    check_fits((1, 1, 1))
    with pytest.raises(TooLarge, match=r"a 65535x65535x65535 array does not fit this computer: .* largest that fits: "):
        check_fits((65535, 65535, 65535))


# --- what there is -------------------------------------------------------------------------------


class Computer:
    """A made-up /proc and /sys/fs/cgroup."""

    def __init__(self, root: Path) -> None:
        self.proc, self.cgroups = root / "proc", root / "cgroup"
        self.write(self.proc / "meminfo", "MemTotal: 9000 kB\nMemAvailable:    8000000 kB\n")
        self.write(self.proc / "loadavg", "0.1 0.2 0.3 2/300 4711\n")
        self.write(self.proc / "sys/kernel/pid_max", "4194304\n")
        self.write(self.proc / "sys/kernel/threads-max", "1300\n")
        self.write(self.proc / "sys/fs/file-nr", "5000\t0\t100000\n")
        for pid, user, threads in ((1, 4242, 50), (7, os.getuid(), 3), (8, os.getuid(), 2)):
            status = f"Name:\tx\nUid:\t{user}\t0\t0\t0\nThreads:\t{threads}\n"
            self.write(self.proc / str(pid) / "status", status)
        self.write(self.proc / "self/cgroup", "0::/\n")

    def write(self, path: Path, text: str) -> None:
        """Write a file in its directory."""
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)

    def read(self) -> Resources:
        """What there is."""
        return read_resources(self.proc, self.cgroups)


@pytest.fixture
def computer(tmp_path, monkeypatch) -> Computer:
    monkeypatch.setattr("resource.getrlimit", lambda which: (10_000, 20_000))
    return Computer(tmp_path)


def test_without_control_groups(computer):
    found = computer.read()
    assert found.memory == Bound(8_000_000 * 1024, "the memory available")
    assert found.tasks == Bound(1000, "kernel.threads-max")
    assert found.all_files == Bound(95_000, "fs.file-max")
    assert found.descriptors == Bound(10_000, "RLIMIT_NOFILE (ulimit -n)")


def test_the_tasks_of_the_user_count(computer):
    computer.write(computer.proc / "sys/kernel/threads-max", "100000")
    assert computer.read().tasks == Bound(10_000 - 5, "RLIMIT_NPROC (ulimit -u)")


def test_control_groups_of_version_2_the_tightest_above_us_counts(computer):
    computer.write(computer.proc / "self/cgroup", "0::/user/session\n")
    for group, limit in (("", "max"), ("user", "3000000"), ("user/session", "max")):
        computer.write(computer.cgroups / group / "memory.max", limit)
        computer.write(computer.cgroups / group / "memory.current", "1000000")
        computer.write(computer.cgroups / group / "memory.stat", "anon 1\ninactive_file 500000\n")
    computer.write(computer.cgroups / "user/pids.max", "60")
    computer.write(computer.cgroups / "user/pids.current", "10")
    found = computer.read()
    assert found.memory == Bound(2_500_000, "memory.max of the control group")
    assert found.tasks == Bound(50, "pids.max of the control group")


def test_control_groups_of_version_1_in_a_container(computer):
    # The path is the one outside; inside, its group is mounted as the root.
    computer.write(computer.proc / "self/cgroup", "9:name=systemd:/\n8:pids:/docker/1\n4:memory:/docker/1\n0::/\n")
    group = computer.cgroups / "memory"
    computer.write(group / "memory.limit_in_bytes", "2000000")
    computer.write(group / "memory.usage_in_bytes", "900000")
    computer.write(group / "memory.stat", "total_inactive_file 100000\n")
    computer.write(computer.cgroups / "pids/pids.max", "max")
    found = computer.read()
    assert found.memory == Bound(1_200_000, "memory.limit_in_bytes of the control group")
    assert found.tasks.limit == "kernel.threads-max"


def test_no_limit_of_version_1_is_no_limit(computer):
    computer.write(computer.proc / "self/cgroup", "4:memory:/\n")
    computer.write(computer.cgroups / "memory/memory.limit_in_bytes", "9223372036854771712")
    assert computer.read().memory.limit == "the memory available"


def test_nothing_that_can_be_read_is_no_limit(tmp_path, monkeypatch):
    monkeypatch.setattr("resource.getrlimit", lambda which: (-1, -1))
    found = read_resources(tmp_path / "none", tmp_path / "none")
    assert min(found.memory.left, found.tasks.left, found.descriptors.left, found.all_files.left) == UNLIMITED


def test_cores_are_those_of_the_process_or_the_share_of_its_group(computer, monkeypatch):
    monkeypatch.setattr("os.sched_getaffinity", lambda _process: range(6))
    cores = partial(read_cores, computer.proc, computer.cgroups)
    assert cores() == 6.0
    computer.write(computer.cgroups / "cpu.max", "max 100000\n")
    assert cores() == 6.0
    computer.write(computer.cgroups / "cpu.max", "250000 100000\n")
    assert cores() == 2.5
    computer.write(computer.proc / "self/cgroup", "1:cpu,cpuacct:/docker/1\n")
    group = computer.cgroups / "cpu,cpuacct"
    computer.write(group / "cpu.cfs_quota_us", "-1\n")
    computer.write(group / "cpu.cfs_period_us", "100000\n")
    assert cores() == 6.0
    computer.write(group / "cpu.cfs_quota_us", "50000\n")
    assert cores() == 0.5


# --- the simulator -------------------------------------------------------------------------------


def test_a_simulated_array_is_held_against_memory():
    memory = Bound(5_000 + 1_000 * 27_000, "memory.max of the control group")
    check_simulated_fits((30, 30, 30), 64, bytes_per_node=1_000, fixed_bytes=5_000, memory=memory)
    with pytest.raises(TooLarge) as error:
        check_simulated_fits((27_001, 1, 1), 64, bytes_per_node=1_000, fixed_bytes=5_000, memory=memory)
    assert str(error.value) == (
        "a simulated 27001x1x1 array does not fit this computer: its 27001 processors and 64 samples need "
        "28 MB of memory, and memory.max of the control group leaves 27 MB; largest that fits: 30x30x30"
    )


def test_a_picture_that_leaves_no_room_for_any_simulated_array():
    with pytest.raises(TooLarge, match=r"its 1 processors and 9 samples need .* leaves 0 MB; nothing fits"):
        check_simulated_fits((1, 1, 1), 9, bytes_per_node=1, fixed_bytes=10, memory=Bound(9, "the memory available"))
