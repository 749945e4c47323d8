"""Frames in spite of faults: the same bits, and what happened is told."""

from __future__ import annotations

import os
import resource
import signal
from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from support import paths
from support.processes import no_leftovers

from raygrid.emulator.driver.memory_array import MemoryArray
from raygrid.emulator.processes.array import Array
from raygrid.host.image.picture import Picture
from raygrid.host.render.frame import render_job
from raygrid.host.render.job import Job, Settings, make_job
from raygrid.host.render.retry import FaultReport
from raygrid.host.render.session import RenderSession
from raygrid.host.scene.load import load_scene
from raygrid.node.errors import ArrayError, LostProcess, ProtocolError
from raygrid.node.protocol.messages import MessageKind

SCENES = paths.SCENES
SHAPE = (2, 2, 1)
BUDGET = 4000
__all__ = ["no_leftovers"]
pytestmark = [pytest.mark.timeout(120)]


@cache
def job(load_key: str = "") -> Job:
    """A frame long enough for something to happen to it."""
    made = make_job(load_scene(SCENES / "kinds.nff"), SHAPE, Settings(size=(160, 120), samples=2))
    return replace(made, load_key=load_key)


@cache
def truth() -> np.ndarray:
    """Its picture."""
    array = MemoryArray(SHAPE)
    array.driver.ready()
    return render_job(array.driver, job()).sums


def render_steadily(array: Array, job: Job, budget: int = BUDGET, watch=None, **options) -> Picture:
    """With a budget so small that rays are in flight at many waves."""
    return RenderSession(array, **options).render(job, budget, watch)


@pytest.fixture(scope="module")
def array() -> Iterator[Array]:
    """One array for all these tests."""
    with Array.launch(SHAPE, patience=60.0) as launched:
        yield launched


def once(phase: str, act):
    """A watcher that acts once, at the beginning of a phase or amid tracing."""
    acted = []

    def watch(now, progress) -> None:
        amid = now != "trace" or (progress is not None and progress.in_flight > 0)
        if now == phase and amid and not acted:
            acted.append(act())

    return watch


@pytest.mark.parametrize("sign", [signal.SIGKILL, signal.SIGSTOP])
@pytest.mark.parametrize("phase", ["load", "trace", "collect"])
def test_a_node_lost_in_any_phase_changes_no_bit(array, phase, sign):
    pid = array.pids[2]
    told: list[FaultReport] = []
    watch = once(phase, lambda: os.kill(pid, sign))
    picture = render_steadily(array, job(), watch=watch, on_fault=told.append)
    assert np.array_equal(picture.sums, truth())
    (fault,) = picture.stats["faults"]
    assert (fault["kind"], fault["phase"], fault["restarts"], fault["epoch"]) == ("LostProcess", phase, 1, array.epoch)
    said = "is stopped" if sign == signal.SIGSTOP else "ended: signal SIGKILL"
    assert fault["what"] == f"node 0,1,0 (pid {pid}) {said}"
    assert [fault.what for fault in told] == [fault["what"] for fault in picture.stats["faults"]]


def test_a_fault_names_all_nodes_that_ended(array):
    killed, limited = array.pids[2], array.pids[0]

    def act() -> None:
        resource.prlimit(limited, resource.RLIMIT_NOFILE, (8, 8))
        os.kill(killed, signal.SIGKILL)

    picture = render_steadily(array, job(), watch=once("trace", act))
    assert np.array_equal(picture.sums, truth())
    (fault,) = picture.stats["faults"]
    assert fault["restarts"] == 2
    assert fault["what"] == (
        f"node 0,1,0 (pid {killed}) ended: signal SIGKILL; besides, "
        f"node 0,0,0 (pid {limited}) ended: exit code 1: ZMQError: Too many open files"
    )


def test_without_faults_there_are_none(array):
    picture = render_steadily(array, job())
    assert picture.stats["faults"] == []
    assert np.array_equal(picture.sums, truth())
    assert np.array_equal(render_steadily(array, job("held")).sums, truth())
    assert "load" not in render_steadily(array, job("held")).stats["wall_seconds"]


def test_after_a_fault_a_loaded_scene_is_loaded_again(array):
    render_steadily(array, job("held"))
    phases: list[str] = []

    def watch(now, progress) -> None:
        if progress is None:
            phases.append(now)
        kill(now, progress)

    kill = once("collect", lambda: os.kill(array.pids[0], signal.SIGKILL))
    assert np.array_equal(render_steadily(array, job("held"), watch=watch).sums, truth())
    assert phases == ["trace", "collect", "load", "trace", "collect"]


def test_several_faults_in_one_frame(array):
    left = [3, 1, 0]

    def watch(now, progress) -> None:
        if now == "trace" and progress is not None and left:
            os.kill(array.pids[left.pop()], signal.SIGKILL)

    picture = render_steadily(array, job(), watch=watch)
    assert np.array_equal(picture.sums, truth())
    assert sum(fault["restarts"] for fault in picture.stats["faults"]) == 3


def test_a_node_that_dies_each_time_ends_in_one_clear_line(array):
    def watch(now, progress) -> None:
        if now == "trace" and progress is None:
            os.kill(array.pids[1], signal.SIGKILL)

    told: list[FaultReport] = []
    with pytest.raises(LostProcess) as error:
        render_steadily(array, job(), watch=watch, attempts=3, on_fault=told.append)
    assert len(told) == 2
    assert str(error.value).startswith(f"node 1,0,0 (pid {array.pids[1]}) ended: signal SIGKILL; ")
    assert str(error.value).endswith("it had failed 2 times before in the same way")
    array.reset()
    assert np.array_equal(render_steadily(array, job()).sums, truth())


def test_a_single_attempt_raises_what_went_wrong(array):
    kill = once("trace", lambda: os.kill(array.pids[3], signal.SIGKILL))
    with pytest.raises(LostProcess, match=r"^node 1,1,0 \(pid \d+\) ended: signal SIGKILL$"):
        render_steadily(array, job(), watch=kill, attempts=1)
    array.reset()
    with pytest.raises(ValueError, match="0 attempts came, wanted 1 or more"):
        render_steadily(array, job(), attempts=0)


def test_a_link_that_breaks_is_made_good(array):
    def break_it() -> None:
        array.driver.links[0].send_order(MessageKind.UP, {"do": "ready"})

    pids = array.pids
    picture = render_steadily(array, job(), watch=once("trace", break_it))
    assert np.array_equal(picture.sums, truth())
    assert [fault["kind"] for fault in picture.stats["faults"]] == [ProtocolError.__name__]
    assert array.pids == pids


def test_what_is_refused_is_made_good(array):
    """Packets that no node can have sent come to a corner."""

    def spoil() -> None:
        array.driver.links[0].send_data(MessageKind.PACKETS, 2, b"\xff" * 50)

    picture = render_steadily(array, job(), watch=once("trace", spoil))
    assert np.array_equal(picture.sums, truth())
    assert [fault["kind"] for fault in picture.stats["faults"]] == ["Garbled"]


def test_a_wrong_budget_is_no_fault(array):
    epoch = array.epoch
    with pytest.raises(ArrayError, match="a budget came as 0"):
        render_steadily(array, job(), budget=0)
    assert array.epoch == epoch


def test_an_interrupt_is_no_fault(array):
    def interrupt() -> None:
        raise KeyboardInterrupt

    epoch = array.epoch
    with pytest.raises(KeyboardInterrupt):
        render_steadily(array, job(), watch=once("trace", interrupt))
    assert array.epoch == epoch
    assert np.array_equal(render_steadily(array, job()).sums, truth())
