"""Clients of an array that stays: bad values, threads, crowds, and two who launch it at once. None is told what is not so."""

import contextlib
import os
import signal
import subprocess
import threading
from pathlib import Path

import numpy as np
import pytest
from support.cli import RAYGRID, TIMEOUT, as_process, one_line, warm_kernels
from support.render import SCENES
from support.service import SIZE, Peer, array, end, name, on, shot_of, sums, up

import raygrid
from raygrid.host.client.service_files import find
from raygrid.host.service.listener import BRIEF_SECONDS, MOST_BRIEF, MOST_CLIENTS
from raygrid.node.errors import ArrayError

__all__ = ["array", "name", "warm_kernels"]

TINY, KINDS = SCENES / "tiny.nff", SCENES / "kinds.nff"
LONG = {"size": (3000, 3000), "samples": 64}  # minutes: no test waits for its end


# ---- bad values ----

BAD = [
    ({"size": (0, 1)}, "size came as 0x1, wanted sides of 1 to 65536 and at most 268,435,456 pixels, such as 640x480"),
    ({"size": (1 << 70, 1)}, "size came as 1180591620717411303424, wanted a whole number of at most 64 bits"),
    ({"size": 7}, "size came as 7, wanted sides of 1 to "),
    ({"size": "big"}, "size came as 'big', wanted sides of 1 to "),
    ({"size": np.float64(3.5)}, "size came as 3.5, wanted sides of 1 to "),
    ({"samples": "4"}, "samples came as '4', wanted a whole number from 1 to 4294967296"),
    ({"samples": b"4"}, "samples came as b'4', wanted text, a number, "),
    ({"samples": object}, "samples came as <class 'object'>, wanted text, a number, "),
    ({"min_weight": float("inf")}, "min_weight came as inf, wanted a number from 0 to "),
    ({"frames": 5}, "frames came as 5, wanted the first and the last of "),
    ({"frames": ("a", "b"), "output": "%d.png"}, "frames came as ['a', 'b'], wanted the first and the last of "),
    ({"turntable": -1}, "frames 1 to -1 came|turntable.frames came as -1, wanted |frames came as [1, -1], wanted "),
    ({"turntable": "round"}, "turntable.frames came as 'round', wanted a whole number from 1 to "),
    ({"budget": 0.5}, "budget came as 0.5, wanted a whole number from 1 to "),
    ({"transfer": None}, "transfer came as None, wanted srgb or linear"),
    ({"client": 3}, "client came as 3, wanted text of at most 64 characters"),
    ({"resume": 1}, "resume came as 1, wanted true or false"),
    ({"output": 3}, "output came as 3, wanted the path of a file"),
    ({"output": []}, "outputs came as [], wanted 1 to 16 absolute paths"),
    ({"output": b"a.png"}, "output came as b'a.png', wanted the path of a file"),
    ({"output": "/\udcff.png"}, "outputs came as '/\\udcff.png', wanted a name in UTF-8"),
    ({"stats": "\0"}, "stats came as '"),
]


def test_a_bad_value_is_one_sentence_and_the_connection_lives(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with raygrid.connect(name) as array:
        for change, words in BAD:
            with pytest.raises(ArrayError) as caught:
                array.submit(TINY, **({"output": "a.png"} | change))
            assert str(caught.value).startswith(tuple(words.split("|"))), f"{change}: {caught.value}"
            assert len(str(caught.value)) < 300
            assert array.status()["name"] == name
        for use in (lambda: array.wait("x"), lambda: array.cancel([1 << 80]), lambda: array.jobs(-1)):
            with pytest.raises(ArrayError, match=r" came as .*, wanted "):
                use()
        with pytest.raises(TypeError, match="speed"):
            array.submit(TINY, output="a.png", speed=9)
        array.submit(TINY, output="good.npy", size=SIZE).wait()
    assert np.array_equal(np.load("good.npy"), sums(TINY))
    assert os.listdir() == ["good.npy"]
    for timeout in (0, -1, "soon", float("nan")):
        with pytest.raises(ArrayError, match=r"timeout came as .*, wanted seconds above 0"):
            raygrid.connect(name, timeout)


def test_the_command_line_tells_a_bad_size_in_one_line(name, array, tmp_path):
    outcome = on(name, "submit", str(TINY), "--size", "99999x99999", cwd=tmp_path)
    one_line(outcome, 2, r"raygrid submit: .*99999x99999.*, wanted sides of 1 to 65536\b.*")
    assert array.status()["queue"]["jobs"] == 0


def test_a_name_that_is_not_utf_8_is_one_sentence(name, tmp_path):
    path = os.fsdecode(os.fsencode(tmp_path / "x") + b"\xff.nff")
    with open(path, "w") as file:
        file.write(TINY.read_text())
    outcome = on(name, "submit", path, "-o", str(tmp_path / "a.png"))
    one_line(outcome, 1, r"raygrid: scene came as '.*x\\udcff\.nff', wanted a name in UTF-8")


def test_commands_run_where_the_current_directory_was_removed(name, tmp_path):
    def run(*arguments):
        folder = tmp_path / "gone"
        folder.mkdir()
        command = ["/bin/sh", "-c", 'rmdir "$PWD" && exec "$@"', "sh", RAYGRID, *arguments, "--name", name]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=TIMEOUT)
        return done.returncode, done.stdout, done.stderr

    assert run("status")[0] == 0
    assert run("jobs")[0] == 0
    code, _, words = run("submit", str(TINY))
    assert (code, words.count("\n")) == (1, 1)
    assert "wanted an absolute path: the current directory was removed" in words
    small = ("--size", f"{SIZE[0]}x{SIZE[1]}")
    assert run("submit", str(TINY), *small, "-o", str(tmp_path / "a.npy")) == (0, f"{tmp_path}/a.npy\n", "")


# ---- threads ----


def test_five_threads_wait_on_one_connection(name, tmp_path):
    results, raised = {}, []
    with raygrid.connect(name, timeout=5.0) as array:
        jobs = [
            array.submit(shot_of(Path(TINY), 4), output=tmp_path / f"{k}_%d.npy", frames=(1, 4), size=SIZE)
            for k in range(4)
        ]

        def wait(k):
            try:
                seen = []
                results[k] = jobs[k % 4].wait(seen.append)  # the last waits for the same one as the first
                assert {event["job"] for event in seen} <= {jobs[k % 4].job}
                assert array.status()["name"] == name
            except BaseException as error:
                raised.append(error)

        threads = [threading.Thread(target=wait, args=(k,)) for k in range(5)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(120.0)
    assert raised == []
    assert [len(results[k].files) for k in range(5)] == [4] * 5
    assert results[0] == results[4]
    for result in results.values():
        for file in result.files:
            assert np.array_equal(np.load(file), sums(shot_of(Path(TINY), 4)))


def test_status_is_answered_to_one_thread_while_another_waits(array, tmp_path):
    job, told = array.submit(TINY, output=tmp_path / "a.npy", **LONG), []

    def wait():
        with pytest.raises(ArrayError, match=f"job {job.job} was cancelled") as caught:
            job.wait(lambda event: begun.set())
        told.append(caught.value)

    begun, thread = threading.Event(), threading.Thread(target=wait)
    thread.start()
    assert begun.wait(60.0)
    assert array.status()["running"]["job"] == job.job
    job.cancel()
    thread.join(60.0)
    assert told


# ---- crowds ----


@contextlib.contextmanager
def crowd(name, count):
    """So many clients that are let in and idle."""
    record = find(name)
    with contextlib.ExitStack() as stack:
        for _ in range(count):
            stack.enter_context(Peer(record)).greet()
        yield


def test_a_crowd_of_idle_clients_locks_nobody_out_who_looks_after_the_array(name, array, tmp_path):
    with crowd(name, MOST_CLIENTS + MOST_BRIEF // 2):
        assert on(name, "status").code == 0
        outcome = on(name, "submit", str(TINY), cwd=tmp_path)
        one_line(
            outcome, 1, r"raygrid: the array is crowded: \d+ clients are connected, wanted at most 200; it still .*"
        )
        up("crowded")
        try:
            with crowd("crowded", MOST_CLIENTS + MOST_BRIEF // 2):
                assert on("crowded", "down").code == 0
        finally:
            end("crowded")
    assert array.status()["refused"]["crowd"] >= 1


def test_a_crowd_that_takes_every_place_goes_and_status_waits_for_that(name):
    assert BRIEF_SECONDS < 20.0
    with crowd(name, MOST_CLIENTS + MOST_BRIEF):
        assert on(name, "status").code == 0


def test_a_service_that_is_stopped_for_a_moment_is_not_said_to_be_gone(name):
    pid, raised, ready = find(name).pid, [], threading.Barrier(121)

    def client():
        ready.wait(60.0)
        try:
            with raygrid.connect(name) as array:
                array.jobs(0)
        except ArrayError as error:
            raised.append(str(error))

    threads = [threading.Thread(target=client) for _ in range(120)]
    for thread in threads:
        thread.start()
    os.kill(pid, signal.SIGSTOP)
    try:
        ready.wait(60.0)
        threads[0].join(0.5)
    finally:
        os.kill(pid, signal.SIGCONT)
    for thread in threads:
        thread.join(60.0)
    assert raised == []


# ---- two who launch it at once ----


def test_of_two_who_launch_it_at_once_one_is_told_so_and_nothing_that_ends_an_array(name):
    arguments = [RAYGRID, "up", "--name", "twice", "--array", "2x1x1", "--quiet"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    try:
        both = [subprocess.Popen(arguments, **pipes) for _ in range(2)]
        told = [process.communicate(timeout=TIMEOUT)[1] for process in both]
        assert sorted(process.returncode for process in both) == [0, 1]
        (words,) = filter(None, told)
        assert words.count("\n") == 1
        assert "'twice'" in words
        assert "raygrid status --name twice" in words
        assert "down" not in words.replace("taken down by another process", "")
        again = as_process("up", "--name", "twice")
        one_line(
            again, 1, r"raygrid: the array 'twice' \(2x1x1, process \d+\) runs already: raygrid status --name twice .*"
        )
        assert on("twice", "status").code == 0
    finally:
        end("twice")
