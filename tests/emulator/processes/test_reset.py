"""The reset line: whatever state an array is in, after a reset it is empty, in a new epoch, and gives the right picture."""

from __future__ import annotations

import os
import resource
import signal
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from support import paths
from support.processes import no_leftovers, wait_dead, wait_readable

from raygrid.emulator.driver.memory_array import MemoryArray
from raygrid.emulator.processes.array import Array
from raygrid.emulator.topology.coordinates import indices
from raygrid.emulator.topology.process_stat import process_state
from raygrid.host.render.frame import render_job
from raygrid.host.render.job import Job, Settings, make_job
from raygrid.host.scene.load import load_scene
from raygrid.node.errors import ArrayError, LostProcess, ProtocolError, Stuck
from raygrid.node.protocol.messages import MessageKind

SCENES = paths.SCENES
SHAPE = (2, 2, 1)
__all__ = ["no_leftovers"]
pytestmark = [pytest.mark.timeout(120)]


@cache
def job(size: tuple[int, int] = (48, 36), samples: int = 1) -> Job:
    """A small frame, or a long one."""
    return make_job(load_scene(SCENES / "tiny.nff"), SHAPE, Settings(size=size, samples=samples))


LONG = ((500, 400), 4)
FEW_DESCRIPTORS = 8  # enough to wait for those that are open, too few to open more


@cache
def truth() -> np.ndarray:
    """Its picture, by the array in this process."""
    array = MemoryArray(SHAPE)
    array.driver.ready()
    return render_job(array.driver, job()).sums


@pytest.fixture(scope="module")
def array() -> Iterator[Array]:
    """One array for all these tests: each leaves it usable."""
    with Array.launch(SHAPE, patience=60.0) as launched:
        yield launched


def still_right(array: Array) -> None:
    """The array gives the right picture."""
    assert np.array_equal(render_job(array.driver, job()).sums, truth())


def wait_stopped(pid: int) -> None:
    """Wait until a process is seen to be stopped."""
    for _ in range(100_000):
        if process_state(pid) == "T":
            return
        os.sched_yield()
    pytest.fail("the process was not stopped")


def test_a_reset_begins_an_epoch_with_the_same_processes(array):
    pids, epoch, restarts = array.pids, array.epoch, array.restarts
    still_right(array)
    array.reset()
    assert array.epoch == epoch + 1
    assert (array.pids, array.restarts) == (pids, restarts)
    still_right(array)


def test_no_socket_of_an_earlier_epoch_is_left(array):
    array.reset()
    os.kill(array.pids[0], signal.SIGKILL)
    array.reset()
    names = {path.name for path in Path(array._place.path).iterdir()} - {"pid"}
    assert {name.partition("-")[0] for name in names} == {str(array.epoch)}


@pytest.mark.parametrize("phase", ["load", "trace", "collect"])
def test_a_frame_that_is_broken_off_leaves_nothing_behind(array, phase):
    pids = array.pids

    def stop(now, progress) -> None:
        if now == phase and (phase != "trace" or (progress is not None and progress.in_flight > 100)):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        render_job(array.driver, job(*LONG), watch=stop)
    array.reset()
    assert array.pids == pids
    still_right(array)


def test_dead_and_stopped_nodes_are_forked_anew_and_the_others_are_not(array):
    pids, restarts = array.pids, array.restarts
    os.kill(pids[1], signal.SIGKILL)
    wait_dead(pids[1])
    os.kill(pids[2], signal.SIGSTOP)
    wait_stopped(pids[2])
    array.reset()
    assert array.restarts == restarts + 2
    assert [now == then for now, then in zip(array.pids, pids, strict=True)] == [True, False, False, True]
    assert [node.index for node in array.nodes()] == list(indices(SHAPE))
    assert [node.pid for node in array.nodes()] == array.pids
    assert {node.state for node in array.nodes()} <= {"running", "waiting"}
    still_right(array)


def test_a_node_that_does_not_answer_is_forked_anew(array, monkeypatch):
    """As one in a loop without end: to the kernel it is as well as any other."""
    pids = array.pids
    os.kill(pids[3], signal.SIGSTOP)
    wait_stopped(pids[3])
    monkeypatch.setattr("raygrid.emulator.processes.node_processes.process_state", lambda pid: "R")
    array.reset()
    assert [now == then for now, then in zip(array.pids, pids, strict=True)] == [True, True, True, False]
    still_right(array)


def test_a_node_that_cannot_open_its_new_links_is_told_and_forked_anew(array):
    pid = array.pids[1]
    resource.prlimit(pid, resource.RLIMIT_NOFILE, (FEW_DESCRIPTORS, FEW_DESCRIPTORS))
    array.reset()
    assert pid not in array.pids
    assert array.lost_nodes == [
        f"node 1,0,0 (pid {pid}) ended: exit code 1: ZMQError: Too many open files",
    ]
    still_right(array)
    array.reset()
    assert array.lost_nodes == []


def test_a_node_that_hangs_is_noticed_when_patience_ends(array, monkeypatch):
    monkeypatch.setattr("raygrid.emulator.processes.node_processes.process_state", lambda pid: "R")
    os.kill(array.pids[1], signal.SIGSTOP)
    array.driver.patience = 0.5
    with pytest.raises(Stuck, match=r"nothing came from the array for 0\.5 seconds"):
        render_job(array.driver, job())
    array.reset()
    still_right(array)


def test_if_nodes_cannot_be_forked_it_is_said_and_the_next_reset_may_succeed(array, monkeypatch):
    os.kill(array.pids[0], signal.SIGKILL)
    wait_dead(array.pids[0])
    with monkeypatch.context() as patch:

        def refuse(configs):
            raise ArrayError("the array could not be launched: node 1 of 1 could not be forked: no room")

        patch.setattr(array._fork_server, "launch", refuse)
        with pytest.raises(ArrayError, match="could not be forked: no room"):
            array.reset()
        with pytest.raises(ArrayError, match="could not be forked: no room"):
            _ = array.driver
    array.reset()
    still_right(array)


def test_links_that_never_come_up_lead_to_a_new_launch(array, monkeypatch):
    """Somebody takes the place of a neighbour again and again."""
    fork_server = array._fork_server.pid
    begin = Array._begin_epoch

    def fail(self):
        if self._fork_server.pid == fork_server:
            raise Stuck("nothing came from the array while waiting until the order 'ready' came back")
        begin(self)

    monkeypatch.setattr(Array, "_begin_epoch", fail)
    array.reset()
    assert array._fork_server.pid != fork_server
    still_right(array)


def test_all_nodes_may_be_dead(array):
    pids = array.pids
    for pid in pids:
        os.kill(pid, signal.SIGKILL)
    array.reset()
    assert not set(pids) & set(array.pids)
    still_right(array)


def test_a_lost_fork_server_is_told_and_the_array_is_launched_anew(array):
    pids = array.pids
    os.kill(array._fork_server.pid, signal.SIGKILL)
    wait_dead(array._fork_server.pid)
    with pytest.raises(
        LostProcess, match=r"the fork server \(process \d+\) ended by signal SIGKILL|ended: signal SIGTERM"
    ):
        render_job(array.driver, job())
    array.reset()
    wait_dead(*pids)
    still_right(array)


def test_a_jammed_link_does_not_hinder_the_reset(array):
    """Rays without end in flight, and a node that takes nothing in."""
    os.kill(array.pids[3], signal.SIGSTOP)
    wait_stopped(array.pids[3])
    with pytest.raises(LostProcess, match=rf"^node 1,1,0 \(pid {array.pids[3]}\) is stopped$"):
        render_job(array.driver, job(*LONG))
    array.reset()
    still_right(array)


def test_an_idle_array_says_that_a_node_is_lost(array):
    array.check()
    pid = array.pids[2]
    os.kill(pid, signal.SIGKILL)
    wait_readable(array._node_processes.fork_server.fileno(), "the end of the node")
    for _ in range(2):
        with pytest.raises(LostProcess, match=rf"^node 0,1,0 \(pid {pid}\) ended: signal SIGKILL"):
            array.check()
    array.reset()
    array.check()


def test_an_idle_array_says_that_a_node_is_stopped(array):
    pid = array.pids[0]
    os.kill(pid, signal.SIGSTOP)
    wait_stopped(pid)

    def look() -> None:
        for _ in range(10_000):
            array.check()
            wait_idle()

    def wait_idle() -> None:
        array._poller.poll(20)

    with pytest.raises(LostProcess, match=rf"^node 0,0,0 \(pid {pid}\) is stopped$"):
        look()
    array.reset()
    still_right(array)


def test_a_broken_link_is_told_by_the_node_that_goes_on_after_the_reset(array):
    pids = array.pids
    array.driver.links[0].send_order(MessageKind.UP, {"do": "ready"})
    with pytest.raises(ProtocolError, match=rf"^node 0,0,0 \(pid {pids[0]}\): link 0,0,0 port host: UP came on a port"):
        still_right(array)
    with pytest.raises(ProtocolError, match="UP came on a port"):  # and it is said again
        array.check()
    array.reset()
    assert array.pids == pids
    still_right(array)


def test_messages_of_an_older_epoch_are_counted_and_dropped(array):
    array.reset()
    link = array.driver.links[0]
    link.epoch -= 1
    for _ in range(3):
        link.channel.send(_order_of(link, {"do": "end"}))
    link.epoch += 1
    still_right(array)
    nodes = array.driver.report()
    assert [node["stale"] for node in nodes] == [3, 0, 0, 0]


def _order_of(link, order) -> bytes:
    sent = []
    channel, link.channel = link.channel, type("Taken", (), {"send": lambda self, raw: sent.append(raw) or True})()
    before = link._counted.numbers()
    link.send_order(MessageKind.DOWN, order)
    link._counted.take(type(link._counted)(*before))
    link.channel = channel
    return sent[0]


RUBBISH = [
    {},
    {"do": None},
    {"do": "reset"},
    {"do": "reset", "epoch": 0, "machine": "m", "links": []},
    {"do": "reset", "epoch": True, "machine": "m", "links": []},
    {"do": "reset", "epoch": 60_000, "machine": 7, "links": []},
    {"do": "reset", "epoch": 60_000, "machine": "m", "links": []},
    {"do": "reset", "epoch": 60_000, "machine": "m", "links": [1, 2, 3]},
    {"do": "reset", "epoch": 60_000, "machine": "m", "links": [{"port": 0, "endpoint": "tcp://*:1", "bind": True}] * 3},
    {"do": "reset", "epoch": 70_000, "machine": "m", "links": []},
    {"do": "reset", "epoch": [1], "machine": "m", "links": {}},
]


def test_words_that_are_no_order_change_nothing(array):
    pids, epoch = array.pids, array.epoch
    for words in RUBBISH:
        for index in indices(SHAPE):
            assert array._node_processes.control_channels.send(index, words)
    still_right(array)
    array.reset()
    assert (array.pids, array.epoch) == (pids, epoch + 1)
    still_right(array)


@pytest.mark.usefixtures("no_leftovers")
def test_a_reset_before_the_launch_and_after_the_end_is_refused():
    array = Array((1, 1, 1))
    with pytest.raises(ArrayError, match="cannot be reset: it was not launched"):
        array.reset()
    array.begin()
    array.wait_ready()
    array.close()
    with pytest.raises(ArrayError, match=r"cannot be reset.*closed"):
        array.reset()


@pytest.mark.usefixtures("no_leftovers")
def test_nothing_is_left_after_resets():
    with Array.launch((2, 1, 1)) as array:
        for number in range(6):
            os.kill(array.pids[number % 2], signal.SIGKILL if number % 3 else signal.SIGSTOP)
            array.reset()
        assert (array.epoch, array.restarts) == (6, 6)
