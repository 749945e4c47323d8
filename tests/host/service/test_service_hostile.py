"""What scenes, files and programs of one client can do to an array that stays: their own job fails, or is given up at once;
the others go on, and so they do after a restart."""

import contextlib
import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from support.cli import TINY, as_process, one_line, warm_kernels
from support.processes import wait_dead
from support.service import SIZE, name, on, scribe_of, shot_of, sums, up, watch_until
from support.service import array_of_now as array

import raygrid
from raygrid.host.service.scribe import ScribeLost
from raygrid.host.service.worker import ATTEMPTS, Worker
from raygrid.node.errors import ArrayError

__all__ = ["array", "name", "warm_kernels"]


def check_usable(array, folder):
    """The array renders, and right."""
    array.submit(TINY, output=folder / "usable.npy", size=SIZE).wait()
    assert np.array_equal(np.load(folder / "usable.npy"), sums(TINY))


# ---- texts ----


def latin_1(folder):
    """A material library that names a missing texture in bytes that are no UTF-8."""
    (folder / "m.mtl").write_bytes(b"newmtl m\nmap_Kd caf\xe9\x1b[31m.png\n")
    (folder / "s.obj").write_text("mtllib m.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n")
    return folder / "s.obj"


def half_a_character(folder):
    (folder / "s.gltf").write_text('{"asset": {"version": "2.0"}, "extensionsRequired": ["\\ud800"]}')
    return folder / "s.gltf"


def nine_megabytes(folder):
    (folder / "s.nff").write_text("z" * 9_000_000 + " 1 2 3\n")
    return folder / "s.nff"


@pytest.mark.parametrize("make", [latin_1, half_a_character, nine_megabytes])
def test_what_a_scene_s_error_says_harms_nobody_and_no_later_service(name, array, tmp_path, make):
    scene = make(tmp_path)
    other = array.submit(
        shot_of(Path(TINY), 6), output=tmp_path / "f_%d.npy", frames=(1, 6), size=SIZE, client="another"
    )
    bad = array.submit(scene, output=tmp_path / "bad.png", size=SIZE)
    ended = {}
    try:
        bad.wait()
    except ArrayError as error:
        ended["error"] = str(error)
    assert "a bug" not in ended.get("error", "")
    assert len(ended.get("error", "")) < 5000
    assert other.wait().frames == 6
    facts = {row["job"]: row for row in array.jobs()}
    assert facts[bad.job]["error"].isprintable()
    assert array.status()["journal"]["trouble"] == ""
    assert on(name, "down").code == 0
    assert up(name)["unfinished"] == 0
    with raygrid.connect(name) as again:
        assert {row["job"]: row["state"] for row in again.jobs()}[other.job] == "done"
        check_usable(again, tmp_path)


def test_jobs_of_more_than_a_message_are_all_listed(name, array, tmp_path):
    """Each has 16 outputs with names as long as names can be."""
    folder = "/".join([str(tmp_path), *["x" * 200] * 18])
    long = array.submit(TINY, output=tmp_path / "a.npy", size=(3000, 3000), samples=64)
    outputs = [f"{folder}/{number}.png" for number in range(16)]
    many = [array.submit(TINY, output=outputs).job for _ in range(150)]
    listed = array.jobs(0)
    assert [row["job"] for row in listed] == [long.job, *many]
    assert sum(len("".join(row["outputs"])) for row in listed) > 8 << 20


# ---- what does not come to an end ----


def fifo_as_scene(folder):
    os.mkfifo(folder / "s.nff")
    return {"scene": folder / "s.nff", "output": folder / "a.png"}


def fifo_as_output(folder):
    os.mkfifo(folder / "a.png")
    return {"scene": TINY, "output": folder / "a.png"}


def fifo_as_stats(folder):
    os.mkfifo(folder / "a.json")
    return {"scene": TINY, "output": folder / "a.npy", "stats": folder / "a.json"}


@pytest.mark.parametrize("make", [fifo_as_scene, fifo_as_output, fifo_as_stats])
def test_a_pipe_is_refused_in_one_line(array, tmp_path, make):
    with pytest.raises(ArrayError, match=r"job \d+ failed: .* a (FIFO|pipe).*, wanted a (regular )?file"):
        array.submit(size=SIZE, **make(tmp_path)).wait()
    check_usable(array, tmp_path)


LOOP = """
def background(direction):
    x = direction[0]
    while x < 2.0:
        x = min(x, 1.0)
    return x, x, x
"""


def wait_phase(array, job, phase):
    """Wait until a frame of a job is in a phase; whoever follows hears only of the next one."""
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline:
        running = array.status()["running"] or {}
        if (running.get("job"), running.get("phase")) == (job, phase):
            return
    raise AssertionError(f"job {job} did not come to {phase}")


@pytest.fixture
def stuck(array, tmp_path):
    """A job whose scribe is held up in whatever way: it is stopped, as good as in a loop of compiled code."""
    pid = scribe_of(array)
    os.kill(pid, signal.SIGSTOP)
    job = array.submit(TINY, output=tmp_path / "a.npy", size=SIZE)
    wait_phase(array, job.job, "read")
    yield job
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGCONT)


def test_a_frame_that_is_being_read_can_be_given_up(array, tmp_path, stuck):
    pid = scribe_of(array)
    stuck.cancel()
    wait_dead(pid)
    check_usable(array, tmp_path)


def test_a_frame_that_is_being_read_does_not_keep_a_reset(array, tmp_path, stuck):
    array.reset()
    assert stuck.wait().frames == 1  # begun again, by another scribe
    assert np.array_equal(np.load(tmp_path / "a.npy"), sums(TINY))


def test_a_frame_that_is_being_read_does_not_keep_the_array_from_its_end(name, array, stuck):
    assert on(name, "down") == (0, "test: ended, 1 job left in its journal\n", "")
    assert up(name)["unfinished"] == 1
    with raygrid.connect(name) as again:
        again.wait(stuck.job)


def test_a_scribe_that_ends_costs_the_frame_a_repeat(array, tmp_path, stuck):
    os.kill(scribe_of(array), signal.SIGKILL)
    assert stuck.wait().frames == 1
    assert np.array_equal(np.load(tmp_path / "a.npy"), sums(TINY))
    check_usable(array, tmp_path)


@pytest.mark.parametrize(("ends", "right"), [(0, True), (ATTEMPTS - 1, True), (ATTEMPTS, False), (1000, False)])
def test_a_scribe_that_ends_each_time_fails_the_frame(ends, right):
    worker, notes, tries = Worker.__new__(Worker), [], []

    def make(task):
        tries.append(task)
        if len(tries) <= ends:
            raise ScribeLost("it ended")
        return task

    worker._make, worker._note = make, lambda task, words: notes.extend(words)
    if right:
        assert worker._frame("a task") == "a task"
    else:
        with pytest.raises(ScribeLost, match="it ended"):
            worker._frame("a task")
    assert len(tries) == min(ends + 1, ATTEMPTS)
    assert notes == ["it ended; the frame is begun again"] * min(ends, ATTEMPTS - 1)


def test_a_scribe_does_not_outlive_the_service(name, array, stuck):
    pid = scribe_of(array)
    os.kill(array.pid, signal.SIGKILL)
    wait_dead(array.pid, pid)
    up(name)
    with raygrid.connect(name) as again:
        again.wait(stuck.job)


@pytest.mark.timeout(900)
def test_a_program_that_loops_is_given_up_and_the_next_frame_comes(warm_kernels, name, tmp_path):
    (tmp_path / "loop.py").write_text(LOOP)
    up("loops", "--allow-programs", "--patience", "600")
    try:
        with raygrid.connect("loops") as array:
            job = array.submit(TINY, output=tmp_path / "a.npy", size=SIZE, program=tmp_path / "loop.py")
            wait_phase(array, job.job, "load")
            job.cancel()
            check_usable(array, tmp_path)  # the nodes are not waited for, for 600 seconds
            again = array.submit(TINY, output=tmp_path / "a.npy", size=SIZE, program=tmp_path / "loop.py")
            wait_phase(array, again.job, "load")
        assert as_process("down", "--name", "loops").code == 0
    finally:
        as_process("down", "--name", "loops", "--kill")


# ---- priorities ----


def test_a_small_frame_of_a_higher_priority_does_not_wait_for_a_large_one(name, array, tmp_path):
    large = array.submit(TINY, output=tmp_path / "large.npy", size=(3000, 3000), samples=64)
    watch_until(array, large.job, "progress", phase="trace")
    small = on(name, "submit", TINY, "--size", "64x48", "-o", str(tmp_path / "small.npy"), "--priority", "1")
    assert small.code == 0
    assert np.array_equal(np.load(tmp_path / "small.npy"), sums(TINY))
    (row,) = array.jobs(0)
    assert (row["job"], row["state"], row["done"]) == (large.job, "running", 0)
    watch_until(array, large.job, "progress", phase="trace")  # begun again
    one_line(on(name, "submit", TINY, "--priority", "101"), 2, r"raygrid submit: --priority: .101. came, wanted .*")
