"""What an array that stays makes of those who clean up behind it, and of what it finds when it starts: removed files are
made anew, all that it makes is for its user alone, and the fork server is looked after as the nodes are."""

import contextlib
import os
import shutil
import signal
import stat
import subprocess
import time
from pathlib import Path

import numpy as np
import psutil
import pytest
from support.cli import RAYGRID, TINY, as_process, one_line, warm_kernels
from support.processes import wait_dead
from support.service import SIZE, end, name, on, state_directory, sums, up
from support.service import array_of_now as array

import raygrid
from raygrid.host.client.service_files import (
    JOURNAL,
    LOCK,
    RECORD,
    SOCKET,
    TOKEN,
    find,
    make_state_directory,
    take_lock,
)
from raygrid.node.errors import ArrayError

__all__ = ["array", "name", "warm_kernels"]


def check_usable(array, folder):
    """The array renders, and right."""
    array.submit(TINY, output=folder / "usable.npy", size=SIZE).wait()
    assert np.array_equal(np.load(folder / "usable.npy"), sums(TINY))


def wait_until(what, done, seconds=30.0):
    """Wait until a condition holds; files have nobody who tells of them."""
    deadline = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < deadline, f"{what} did not come within {seconds} seconds"
        os.sched_yield()


def connects(name):
    """Whether a client finds the array and is let in."""
    with contextlib.suppress(ArrayError, OSError), raygrid.connect(name):
        return True
    return False


# ---- removed ----


@pytest.mark.parametrize("gone", ["directory", SOCKET, TOKEN])
def test_a_door_that_is_removed_is_made_anew_and_clients_inside_stay(name, array, tmp_path, gone):
    directory = find(name).directory
    if gone == "directory":
        shutil.rmtree(directory)
    else:
        os.unlink(Path(directory, gone))
    wait_until("a new door", lambda: connects(name))
    assert array.status()["state"] == "ready"
    with raygrid.connect(name) as other:
        check_usable(other, tmp_path)
    if gone == "directory":
        assert find(name).directory != directory
        assert not os.path.exists(directory)


@pytest.mark.parametrize("gone", [[LOCK, RECORD], [JOURNAL], ["."]])
def test_a_state_directory_that_is_removed_is_made_anew_with_all_jobs(name, array, tmp_path, gone):
    directory = state_directory(name)
    long = array.submit(TINY, output=tmp_path / "a.npy", size=(3000, 3000), samples=64)
    for file in gone:
        if file == ".":
            shutil.rmtree(directory, ignore_errors=True)  # SQLite may have removed a file of its own meanwhile
        else:
            (directory / file).unlink()
    wait_until("a new lock", lambda: (directory / LOCK).exists())
    wait_until("a new record", lambda: connects(name))
    wait_until("a new journal", lambda: (directory / JOURNAL).exists())
    with pytest.raises(ArrayError, match=r"the array 'test' \(2x1x1, process \d+\) runs already"):
        take_lock(directory)
    one_line(on(name, "up"), 1, r"raygrid: the array 'test' .*runs already.*")
    pid = find(name).pid
    os.kill(pid, signal.SIGKILL)
    wait_dead(pid)
    assert up(name)["unfinished"] == 1
    with raygrid.connect(name) as again:
        assert [row["job"] for row in again.jobs(0)] == [long.job]
        again.cancel(None)


def test_a_service_whose_lock_another_one_has_ends_and_leaves_the_journal_to_it(name):
    directory = state_directory(name)
    pid = find(name).pid
    os.kill(pid, signal.SIGSTOP)  # so that it does not notice at once
    try:
        (directory / LOCK).unlink()
        lock = take_lock(directory)
    finally:
        os.kill(pid, signal.SIGCONT)
    wait_dead(pid)
    os.close(lock)
    assert "runs already" in (directory / "log").read_text()
    up(name)


def test_a_socket_directory_that_is_removed_costs_one_repair(array, tmp_path):
    fork_server = fork_server_of(array)
    command = fork_server.cmdline()
    shutil.rmtree(command[command.index("--directory") + 1])
    check_usable(array, tmp_path)
    os.kill(array.status()["nodes"][1]["pid"], signal.SIGKILL)
    check_usable(array, tmp_path)
    assert array.status()["state"] == "ready"


# ---- the fork server ----


def fork_server_of(array):
    children = psutil.Process(array.pid).children()
    (found,) = [child for child in children if "raygrid.emulator.processes.fork_server" in child.cmdline()]
    return found


def test_a_stopped_fork_server_is_replaced_while_idle(array, tmp_path):
    faults, fork_server = array.status()["faults"]["count"], fork_server_of(array)
    node = array.status()["nodes"][1]["pid"]
    fork_server.send_signal(signal.SIGSTOP)
    os.kill(node, signal.SIGKILL)  # of which nobody tells
    wait_until("a repair", lambda: array.status()["faults"]["count"] > faults)
    wait_dead(fork_server.pid)
    status = array.status()
    assert node not in [each["pid"] for each in status["nodes"]]
    assert {each["state"] for each in status["nodes"]} <= {"running", "waiting"}
    assert "is stopped" in status["faults"]["last"][-1]["what"] or "is dead" in status["faults"]["last"][-1]["what"]
    check_usable(array, tmp_path)


def test_a_fork_server_that_is_stopped_while_a_frame_is_traced_keeps_nobody(array, tmp_path):
    job = array.submit(TINY, output=tmp_path / "a.npy", size=(300, 200), samples=4)
    fork_server = fork_server_of(array)
    fork_server.send_signal(signal.SIGSTOP)
    os.kill(array.status()["nodes"][0]["pid"], signal.SIGKILL)
    job.wait()
    assert np.array_equal(np.load(tmp_path / "a.npy"), sums(TINY, size=(300, 200), samples=4))
    wait_dead(fork_server.pid)


# ---- for us alone, and without a terminal ----


def test_all_directories_are_private_whatever_the_umask(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "home" / ".local" / "state"))
    for umask in (0, 0o777):
        before = os.umask(umask)
        try:
            made = make_state_directory(f"of-{umask}")
        finally:
            os.umask(before)
        for path in (made, *made.parents[:4]):
            assert stat.S_IMODE(path.stat().st_mode) == 0o700, path
        assert made.parents[3] == tmp_path / "home"


@pytest.mark.parametrize("closed", ["<&-", "2>&-", "<&- 2>&-", ">&-", "<&- >&- 2>&-"])
def test_streams_that_are_closed_are_no_harm(warm_kernels, tmp_path, monkeypatch, closed):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    shape = "--array 1x1x1"
    commands = [f"up --name closed {shape}", f"submit {TINY} --name closed --size 64x48 -o a.npy", "down --name closed"]
    commands.append(f"render {TINY} {shape} --size 64x48 -o b.npy")
    try:
        for command in commands:
            done = subprocess.run(f"{RAYGRID} {command} {closed}", shell=True, cwd=tmp_path, timeout=100)
            assert done.returncode == 0, command
    finally:
        end("closed")
    for file in ("a.npy", "b.npy"):
        assert np.array_equal(np.load(tmp_path / file), sums(TINY))
    assert as_process("status", "--name", "closed").code == 1
