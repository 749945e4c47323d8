"""Nodes and front ends that are killed or stopped: told at once, by name, and nothing is left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import psutil
import pytest
from support import paths
from support.processes import TIMEOUT, wait_dead

from raygrid.emulator.processes.array import Array
from raygrid.host.render.frame import render_job
from raygrid.host.render.job import Job, Settings, make_job
from raygrid.host.scene.load import load_scene
from raygrid.node.errors import ArrayError, LostProcess, Stuck

SCENES = paths.SCENES
PATIENCE = 600.0  # longer than the time limit of a test: what is told was told at once, and not by patience
LONG = Settings(size=(700, 700), samples=4)

pytestmark = [pytest.mark.usefixtures("no_leftovers"), pytest.mark.timeout(120)]


def job(shape, settings: Settings = LONG) -> Job:
    """Seconds of work."""
    return make_job(load_scene(SCENES / "tiny.nff"), shape, settings)


def amid_tracing(act):
    """A watcher that acts once when rays are in flight."""
    acted = []

    def watch(phase, progress) -> None:
        if phase == "trace" and progress is not None and progress.in_flight > 0 and not acted:
            acted.append(act())

    return watch


def use(shape, do, **options) -> None:
    """Launch an array and do something with it; what that raises goes through the end of the block."""
    with Array.launch(shape, **options) as array:
        do(array)


@pytest.mark.parametrize("number", [0, 2, 3])
def test_a_node_killed_while_idle_is_named(number):
    with Array.launch((2, 2, 1), patience=PATIENCE) as array:
        pid, index = array.pids[number], ["0,0,0", "1,0,0", "0,1,0", "1,1,0"][number]
        os.kill(pid, signal.SIGKILL)
        wait_dead(pid)
        with pytest.raises(LostProcess, match=rf"^node {index} \(pid {pid}\) ended: signal SIGKILL"):
            render_job(array.driver, job((2, 2, 1)))
        with pytest.raises(LostProcess, match=f"node {index}"):  # and it says so again
            array.driver.report()


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("sign", [signal.SIGKILL, signal.SIGTERM, signal.SIGSEGV])
def test_a_node_killed_while_tracing_is_named(number, sign):
    with Array.launch((2, 1, 1), patience=PATIENCE) as array:
        kill = amid_tracing(lambda: os.kill(array.pids[number], sign))
        said = rf"^node {number},0,0 \(pid {array.pids[number]}\) ended: signal {sign.name}"
        with pytest.raises(LostProcess, match=said):
            render_job(array.driver, job((2, 1, 1)), watch=kill)


def test_a_loss_ends_the_block_and_all_other_nodes():
    pids: list[int] = []
    kill = amid_tracing(lambda: os.kill(pids[3], signal.SIGKILL))
    with pytest.raises(LostProcess):
        use((2, 2, 1), lambda array: [pids.extend(array.pids), render_job(array.driver, job((2, 2, 1)), watch=kill)])
    assert not any(psutil.pid_exists(pid) for pid in pids)


@pytest.mark.parametrize("when", ["idle", "tracing"])
def test_a_stopped_node_is_a_hang_and_is_named(when):
    pids: list[int] = []

    def stop() -> None:
        os.kill(pids[1], signal.SIGSTOP)

    def render(array: Array) -> None:
        pids.extend(array.pids)
        array.driver.patience = 0.5
        if when == "idle":
            stop()
        render_job(array.driver, job((2, 1, 1)), watch=amid_tracing(stop) if when == "tracing" else None)

    with pytest.raises(Stuck) as told:
        use((2, 1, 1), render)
    assert str(told.value).startswith("nothing came from the array for 0.5 seconds while waiting until the order")
    assert str(told.value).endswith(f"node 1,0,0 (pid {pids[1]}) is stopped")
    assert not any(psutil.pid_exists(pid) for pid in pids)


def test_a_node_that_goes_on_in_time_is_no_hang():
    short = job((2, 1, 1), Settings(size=(32, 24)))
    with Array.launch((2, 1, 1), patience=PATIENCE) as array:
        os.kill(array.pids[1], signal.SIGSTOP)
        pump, pumps = array.driver._pump, []

        def continued(seconds: float) -> None:
            pumps.append(1)
            if len(pumps) == 3:
                os.kill(array.pids[1], signal.SIGCONT)
            pump(seconds)

        array.driver._pump = continued
        assert render_job(array.driver, short).sums.any()


def test_an_exception_in_the_block_ends_the_array():
    seen: list[Array] = []
    places: list[str] = []

    def fail(array: Array) -> None:
        seen.append(array)
        places.append(array._place.path)
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        use((2, 1, 1), fail)
    assert not any(psutil.pid_exists(pid) for pid in seen[0].pids)
    assert not os.path.exists(places[0])


def test_an_interrupt_while_tracing_ends_the_array():
    pids: list[int] = []

    def interrupt() -> None:
        raise KeyboardInterrupt

    def render(array: Array) -> None:
        pids.extend(array.pids)
        render_job(array.driver, job((2, 1, 1)), watch=amid_tracing(interrupt))

    with pytest.raises(KeyboardInterrupt):
        use((2, 1, 1), render)
    assert not any(psutil.pid_exists(pid) for pid in pids)


@pytest.mark.parametrize("shape", [(1, 1, 1), (3, 2, 1)])
def test_closing_says_goodbye_and_may_be_done_twice(shape):
    array = Array.launch(shape, patience=PATIENCE)
    ends = []
    fork_server = array._fork_server
    read = fork_server.read_events
    fork_server.read_events = lambda: [ends.append(event) or event for event in read()]
    pids = array.pids
    array.close()
    assert not any(psutil.pid_exists(pid) for pid in pids)
    assert all(event.status == 0 for event in ends)  # those that were seen to end had been told to
    array.close()
    with pytest.raises(ArrayError, match="not ready"):
        _ = array.driver
    array.close()


def test_an_array_that_never_became_ready_closes():
    array = Array((2, 1, 1))
    array.close()
    array = Array((2, 1, 1))
    array.begin()
    array.close()
    with pytest.raises(ArrayError, match="has not begun"):
        array.wait_ready()


FRONT_END = """
import sys
from raygrid.host.render.api import launch
with launch("2x2x1") as machine:
    def watch(phase, progress):
        if phase == "trace" and progress is not None and progress.in_flight > 0:
            print("tracing", flush=True)
    print(*machine.pids, machine._array._fork_server.pid, machine._array._place.path, flush=True)
    machine.render(sys.argv[1], size=(2000, 2000), samples=16, watch=watch)
"""


def test_a_front_end_killed_while_tracing_takes_everything_along():
    command = [sys.executable, "-c", FRONT_END, str(SCENES / "tiny.nff")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True) as front_end:
        *pids, place = front_end.stdout.readline().split()
        assert len(pids) == 5
        assert os.path.isdir(place)
        assert front_end.stdout.readline() == "tracing\n"
        front_end.kill()
        wait_dead(*map(int, pids))
        front_end.stdout.read()  # to its end: nobody holds it any more
        front_end.wait(TIMEOUT)
    assert not os.path.exists(place)
