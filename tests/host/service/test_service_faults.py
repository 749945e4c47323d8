"""What an array that stays makes of every failure: client, node, service, disk. Nothing is lost and nothing hangs."""

import contextlib
import os
import re
import resource
import shutil
import signal
import subprocess
import threading
from pathlib import Path

import numpy as np
import pytest
from support.cli import RAYGRID, TINY, as_process, one_line, warm_kernels
from support.processes import wait_dead
from support.render import SCENES
from support.service import (
    SIZE,
    array,
    end,
    name,
    on,
    scribe_of,
    scribes_of,
    shot_of,
    state_directory,
    sums,
    up,
    watch_until,
)
from support.terminal import Terminal

import raygrid
from raygrid.emulator.processes.fork_server_client import ForkServerClient
from raygrid.emulator.topology import socket_directory
from raygrid.host.client import connection
from raygrid.host.client.service_files import JOURNAL, find, take_lock
from raygrid.host.service.events import ArrayEnded, KernelsWarming, Options
from raygrid.host.service.worker import Worker
from raygrid.node.errors import ArrayError

__all__ = ["array", "name", "warm_kernels"]

KINDS = SCENES / "kinds.nff"
MIDDLE = {"size": (400, 300), "samples": 4}  # a second or so
LONG = {"size": (3000, 3000), "samples": 64}  # minutes: no test waits for its end


def check_usable(array, folder):
    """The array renders, and right."""
    array.submit(TINY, output=folder / "usable.npy", size=SIZE).wait()
    assert np.array_equal(np.load(folder / "usable.npy"), sums(TINY))


def node_pid(array, number=1):
    return array.status()["nodes"][number]["pid"]


# ---- clients ----


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGHUP])
def test_the_job_of_a_client_that_was_killed_goes_on(name, array, tmp_path, number):
    arguments = [
        "submit",
        KINDS,
        "--name",
        name,
        "--size",
        "400x300",
        "--samples",
        "4",
        "-o",
        tmp_path / "a.npy",
        "--json",
    ]
    process = subprocess.Popen([RAYGRID, *arguments], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    with process:
        assert process.stdout is not None
        process.stdout.readline()
        process.send_signal(number)
        process.wait(60)
    array.wait(array.jobs()[-1]["job"])
    assert np.array_equal(np.load(tmp_path / "a.npy"), sums(KINDS, **MIDDLE))


def test_a_client_that_does_not_read_holds_nobody_up(name, array, tmp_path):
    arguments = [
        "submit",
        shot_of(Path(TINY), 30),
        "--name",
        name,
        "--size",
        "64x48",
        "--frames",
        "1-30",
        "-o",
        tmp_path / "%d.npy",
    ]
    process = subprocess.Popen([RAYGRID, *arguments, "--json"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    with process:
        assert process.stdout is not None
        process.stdout.readline()
        process.send_signal(signal.SIGSTOP)
        try:
            array.wait(array.jobs()[-1]["job"])
            assert len(list(tmp_path.iterdir())) == 30
        finally:
            process.kill()


# ---- nodes ----


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_node_lost_while_tracing_costs_a_repeat_and_no_bit(array, tmp_path, number):
    job = array.submit(KINDS, output=tmp_path / "a.npy", size=(800, 600), samples=4)
    watch_until(array, job.job, "progress", phase="trace")
    faults, pid = array.status()["faults"]["count"], node_pid(array)
    os.kill(pid, number)
    seen = []
    job.wait(seen.append)
    assert np.array_equal(np.load(tmp_path / "a.npy"), sums(KINDS, size=(800, 600), samples=4))
    status = array.status()
    assert status["faults"]["count"] == faults + 1
    assert f"node 1,0,0 (pid {pid})" in status["faults"]["last"][-1]["what"]
    assert [event for event in seen if event["what"] == "fault"]


# A floor that fills the picture and is not lit: hardly any work for many pixels.
FLOOR = (
    "v from 0 0 5 at 0 0 0 up 0 1 0 angle 40 hither 1 resolution 9 9 f 1 1 1 1 0 0 0 0 p 4 -9 -9 0 9 -9 0 9 9 0 -9 9 0"
)


def test_a_node_out_of_memory_is_named_and_costs_no_bit(array, tmp_path):
    (tmp_path / "floor.nff").write_text(FLOOR)
    faults, pid = array.status()["faults"]["count"], node_pid(array)
    with open(f"/proc/{pid}/statm") as file:
        used = int(file.read().split()[0]) * resource.getpagesize()
    resource.prlimit(pid, resource.RLIMIT_AS, (used, resource.RLIM_INFINITY))  # not a byte more
    array.submit(tmp_path / "floor.nff", output=tmp_path / "a.npy", size=(1500, 1000)).wait()
    assert np.array_equal(np.load(tmp_path / "a.npy"), sums(tmp_path / "floor.nff", size=(1500, 1000)))
    status = array.status()
    assert status["faults"]["count"] == faults + 1
    assert re.search(rf"node 1,0,0 \(pid {pid}\) ended: ", status["faults"]["last"][-1]["what"])


def test_a_node_lost_while_idle_is_replaced_unasked(array, tmp_path):
    faults, pid = array.status()["faults"]["count"], node_pid(array)
    os.kill(pid, signal.SIGKILL)
    wait_dead(pid)
    check_usable(array, tmp_path)
    status = array.status()
    assert status["faults"]["count"] == faults + 1
    assert pid not in [node["pid"] for node in status["nodes"]]


def test_a_reset_and_a_cancel_reach_an_array_that_hangs(array, tmp_path):
    job = array.submit(TINY, output=tmp_path / "a.npy", **LONG)
    watch_until(array, job.job, "progress", phase="trace")
    os.kill(node_pid(array), signal.SIGSTOP)
    array.reset()
    watch_until(array, job.job, "progress", phase="trace")
    os.kill(node_pid(array), signal.SIGSTOP)
    job.cancel()
    check_usable(array, tmp_path)


# ---- the service ----


def test_jobs_survive_a_crash_of_the_service(name, tmp_path):
    with raygrid.connect(name) as array:
        short = array.submit(shot_of(Path(TINY), 60), output=tmp_path / "f_%d.npy", frames=(1, 60), size=SIZE)
        other = array.submit(shot_of(KINDS, 60), output=tmp_path / "k_%d.npy", frames=(1, 60), size=SIZE)
        watch_until(array, short.job, "frame", from_frame=3)
        nodes = [node["pid"] for node in array.status()["nodes"]]
        os.kill(array.pid, signal.SIGKILL)
        with pytest.raises(ArrayError, match=r"the array 'test' .*(gone|closed)"):
            short.wait()
        wait_dead(array.pid, *nodes)
    one_line(on(name, "status"), 1, r"raygrid: the array 'test' has ended without being told to: .*")
    times = {file.name: file.stat().st_mtime_ns for file in tmp_path.iterdir()}
    assert {"f_1.npy", "f_2.npy", "f_3.npy"} <= set(times)
    assert up(name)["unfinished"] == 2
    with raygrid.connect(name) as array:
        assert array.wait(short.job).frames == 60
        array.wait(other.job)
        assert array.status()["frames"]["done"] <= 120 - 3
    for frame in (1, 2):
        assert (tmp_path / f"f_{frame}.npy").stat().st_mtime_ns == times[f"f_{frame}.npy"], "rendered again"
    assert len(list(tmp_path.iterdir())) == 120
    assert np.array_equal(np.load(tmp_path / "f_60.npy"), sums(shot_of(Path(TINY), 60)))
    assert np.array_equal(np.load(tmp_path / "k_60.npy"), sums(shot_of(KINDS, 60)))


def test_a_crashed_service_leaves_no_socket_behind_when_the_next_is_up(name):
    directory = find(name).directory
    pid = find(name).pid
    os.kill(pid, signal.SIGKILL)
    wait_dead(pid)
    assert os.path.isdir(directory)
    up(name)
    assert not os.path.exists(directory)


def test_taken_down_jobs_go_on_when_it_is_up_again(name, tmp_path):
    with raygrid.connect(name) as array:
        job = array.submit(TINY, output=tmp_path / "a.npy", **LONG)
        watch_until(array, job.job, "progress", phase="trace")
    assert on(name, "down") == (0, "test: ended, 1 job left in its journal\n", "")
    assert list(tmp_path.iterdir()) == []
    assert up(name)["unfinished"] == 1
    with raygrid.connect(name) as array:
        assert array.jobs(0)[0]["job"] == job.job
        array.cancel([job.job])
        check_usable(array, tmp_path)


def test_a_service_that_hangs_is_told_and_can_be_killed(name, tmp_path, monkeypatch):
    """To those who come, and to those who wait."""
    monkeypatch.setattr(connection, "QUIET_SECONDS", 0.3)
    record = find(name)
    words = rf"process {record.pid}(, stopped)?\) does not answer: nothing came for .* seconds, .*; its jobs are kept$"
    waiting = raygrid.connect(name, timeout=2.0)
    job = waiting.submit(TINY, output=tmp_path / "a.npy", **LONG)
    try:
        with pytest.raises(ArrayError, match=words):
            job.wait(lambda event: os.kill(record.pid, signal.SIGSTOP))
        with pytest.raises(ArrayError, match=words):
            raygrid.connect(name, timeout=0.3)
    finally:
        assert on(name, "down", "--kill") == (0, "test: killed\n", "")
    waiting.close()
    wait_dead(record.pid)
    up(name)
    on(name, "cancel", "--all")


# ---- the disk ----


def test_a_full_disk_fails_the_job_in_one_line_and_not_the_array(name, array, tmp_path):
    """/dev/full is a device without room."""
    os.symlink("/dev/full", tmp_path / "a.png")
    outcome = on(name, "submit", TINY, "--size", "64x48", "-o", str(tmp_path / "a.png"))
    one_line(outcome, 1, r"raygrid: job \d+ failed: .*a\.png: the file cannot be written \(No space left on device\)")
    check_usable(array, tmp_path)


@contextlib.contextmanager
def limited(array, what, most, of_service=None):
    """The service of an array, and its scribe, have a limit for this block."""
    before = resource.prlimit(array.pid, what)
    scribe = scribe_of(array)
    for pid, limit in ((array.pid, of_service or most), (scribe, most)):
        resource.prlimit(pid, what, (limit, before[1]))
    try:
        yield
    finally:
        resource.prlimit(array.pid, what, before)  # first: a scribe that is started from now on has no limit
        for pid in scribes_of(array):  # one that was started within the block has the limit of the service
            with contextlib.suppress(ProcessLookupError):
                resource.prlimit(pid, what, before)


def no_room(array):
    """No file can grow."""
    return limited(array, resource.RLIMIT_FSIZE, 0)


def test_a_limit_ends_with_its_block_also_for_a_scribe_that_was_started_within(array, tmp_path):
    before, first = resource.prlimit(array.pid, resource.RLIMIT_FSIZE), scribe_of(array)
    long = array.submit(TINY, output=tmp_path / "a.npy", **LONG)
    waiting = array.submit(TINY, output=tmp_path / "b.npy", size=SIZE)
    watch_until(array, long.job, "progress", phase="trace")
    with no_room(array):
        os.kill(first, signal.SIGKILL)
        long.cancel()
        with pytest.raises(ArrayError, match="failed"):
            waiting.wait()
        assert resource.prlimit(scribe_of(array), resource.RLIMIT_FSIZE)[0] == 0
    for pid in (array.pid, scribe_of(array)):
        assert resource.prlimit(pid, resource.RLIMIT_FSIZE) == before


def test_without_room_for_the_journal_jobs_are_refused_until_there_is_some(name, array, tmp_path):
    jobs = len(array.jobs(1000))
    with no_room(array):
        with pytest.raises(ArrayError, match=r"journal\.sqlite: the journal cannot be kept \(.+\)") as caught:
            array.submit(TINY, output=tmp_path / "a.npy", size=SIZE)
        assert "\n" not in str(caught.value)
        assert array.status()["state"] == "ready"
    assert len(array.jobs(1000)) == jobs
    check_usable(array, tmp_path)


def test_when_the_disk_fills_up_meanwhile_the_array_goes_on_and_the_journal_catches_up(name, array, tmp_path):
    job = array.submit(shot_of(Path(TINY), 200), output=tmp_path / "f_%d.npy", frames=(1, 200), size=SIZE)
    watch_until(array, job.job, "frame", from_frame=2)
    with no_room(array):
        for _ in range(2):  # who comes when the job has ended hears of it, too
            with pytest.raises(
                ArrayError, match=rf"job {job.job} failed: frame \d+: .*npy: the file cannot be written"
            ):
                job.wait()
        assert array.status()["journal"]["trouble"]
        assert {row["job"]: row["state"] for row in array.jobs()}[job.job] == "failed"
    check_usable(array, tmp_path)
    assert array.status()["journal"]["trouble"] == ""
    listed = {row["job"]: row["state"] for row in array.jobs()}
    assert listed[job.job] == "failed"
    again = array.submit(
        shot_of(Path(TINY), 200), output=tmp_path / "f_%d.npy", frames=(1, 200), size=SIZE, resume=True
    ).wait()
    assert again.frames == 200
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".raygrid")]


def test_a_fault_that_cannot_be_logged_is_told_and_counted_once(name, array, tmp_path):
    class Told(Exception):
        pass

    faults, pids = array.status()["faults"]["count"], [node_pid(array)]

    def look(event):
        if event["what"] == "progress" and event["phase"] == "trace" and pids:
            os.kill(pids.pop(), signal.SIGKILL)
        if event["what"] == "fault":
            raise Told

    job = array.submit(TINY, output=tmp_path / "a.npy", **LONG)
    watch_until(array, job.job, "progress", phase="trace")
    with no_room(array):
        with pytest.raises(Told):
            job.wait(look)
        assert array.status()["faults"]["count"] == faults + 1
        job.cancel()
    check_usable(array, tmp_path)


def test_an_output_directory_that_goes_away_fails_the_job_in_one_line(name, array, tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    job = array.submit(shot_of(Path(TINY), 1000), output=folder / "f_%d.npy", frames=(1, 1000), size=SIZE)
    watch_until(array, job.job, "frame", from_frame=2)
    shutil.rmtree(folder, ignore_errors=True)
    while folder.exists():  # a frame may have been written meanwhile
        shutil.rmtree(folder, ignore_errors=True)
    with pytest.raises(ArrayError, match=rf"job {job.job} failed: frame \d+: .*/out.*") as caught:
        job.wait()
    assert "\n" not in str(caught.value)
    check_usable(array, tmp_path)


def test_out_of_descriptors_is_no_end(name, array, tmp_path):
    """The service may open no more files; what it has open goes on."""
    open_now = [int(number) for number in os.listdir(f"/proc/{array.pid}/fd")]
    # A new one is the lowest that is free. The service polls what it has, which the kernel refuses beyond the limit.
    with limited(array, resource.RLIMIT_NOFILE, 3, of_service=max(open_now) + 1):
        with pytest.raises(ArrayError, match=r"job \d+ failed: .+") as caught:
            array.submit(TINY, output=tmp_path / "a.npy", size=SIZE).wait()
        assert "a bug" not in str(caught.value)
    check_usable(array, tmp_path)


# ---- starting ----


def test_what_keeps_it_from_starting_is_said_by_up(name, tmp_path, monkeypatch):
    one_line(
        as_process("up", "--name", "big", "--array", "90x90x90"), 1, r"raygrid: .*a 90x90x90 array does not fit .*"
    )
    with pytest.raises(ArrayError, match="no array named 'big' runs"):
        find("big")
    journal = state_directory("broken")
    journal.mkdir(parents=True)
    (journal / "journal.sqlite").mkdir()
    one_line(as_process("up", "--name", "broken"), 1, r"raygrid: .*journal\.sqlite: the journal cannot be kept .*")
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    one_line(as_process("up"), 1, r"raygrid: .*the directory for the journal cannot be made .*: set XDG_STATE_HOME")


def test_a_damaged_journal_is_set_aside_and_said_by_up_and_status(name):
    journal = state_directory("damaged")
    journal.mkdir(parents=True)
    (journal / "journal.sqlite").write_text("something else" * 100)
    try:
        outcome = as_process("up", "--name", "damaged", "--array", "1x1x1")
        assert outcome.code == 0
        assert re.search(
            r"journal\.sqlite: .* it is kept as journal\.sqlite\.damaged-[\d-]+, and the 0 jobs", outcome.err
        )
        assert "journal.sqlite.damaged-" in as_process("status", "--name", "damaged").out
    finally:
        end("damaged")


def test_a_state_directory_that_is_a_link_or_open_to_others_is_refused(name, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "raygrid").mkdir(mode=0o700)
    (tmp_path / "raygrid" / "default").symlink_to(tmp_path / "elsewhere")
    one_line(as_process("up"), 1, r"raygrid: .*default: a link is there, wanted a directory")
    (tmp_path / "raygrid" / "default").unlink()
    (tmp_path / "raygrid" / "default").mkdir()
    (tmp_path / "raygrid" / "default").chmod(0o777)
    one_line(as_process("up"), 1, r"raygrid: .*default: others may write to it \(mode 777\), wanted 700 or 600")


def test_a_socket_directory_open_to_others_is_not_used(name):
    record = find(name)
    os.chmod(record.directory, 0o777)
    try:
        with pytest.raises(ArrayError, match="others may write to it"):
            raygrid.connect(name)
    finally:
        os.chmod(record.directory, 0o700)


def test_two_services_never_share_a_journal(name):
    with pytest.raises(ArrayError, match=r"the array 'test' \(2x1x1, process \d+\) runs already"):
        take_lock(state_directory(name))


def test_control_c_while_it_is_launched_leaves_nothing(name, tmp_path):
    before = set(directories())
    with Terminal([RAYGRID, "up", "--name", "stopped"], tmp_path) as terminal:
        terminal.wait_for("launching 8 processors")
        terminal.press("\x03")
        assert terminal.wait_end() == 130
    with pytest.raises(ArrayError, match="no array named 'stopped' runs"):
        find("stopped")
    assert set(directories()) <= before


def test_an_end_is_heard_while_the_kernels_are_compiled(monkeypatch, tmp_path):
    """For the minute of a first run nodes cannot be forked, and nothing else is waited for either."""
    begun = threading.Event()
    started = ForkServerClient.start.__func__

    def start(cls, **options):
        options |= {"program": "support.processes", "warm": "support.processes:warm_for_ever"}
        fork_server = started(cls, **options)
        begun.set()
        return fork_server

    monkeypatch.setattr(ForkServerClient, "start", classmethod(start))
    events = []
    worker = Worker(Options((2, 1, 1), journal=tmp_path / JOURNAL), events.append)
    worker.start()
    assert begun.wait(60.0)
    worker.ask_end()
    worker.join(60.0)
    assert not worker.is_alive(), "the array goes on warming"
    assert [type(event) for event in events if not isinstance(event, KernelsWarming)] == [ArrayEnded]


def directories():
    """The socket directories of this user."""
    for base in filter(os.path.isdir, socket_directory.bases()):
        yield from (entry.path for entry in os.scandir(base) if entry.name.startswith(socket_directory.PREFIX))
