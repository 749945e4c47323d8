"""Links that are bad on purpose: each kind does what it says, is noticed, and never changes a picture."""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from support.cli import TINY, as_process, here, one_line
from support.links import LEFT, RIGHT
from support.processes import no_leftovers

import raygrid
from raygrid.emulator.driver.memory_array import MemoryArray
from raygrid.emulator.processes.array import Array
from raygrid.host.render.frame import render_job
from raygrid.host.render.job import Job, Settings, make_job
from raygrid.host.render.retry import RECOVERABLE
from raygrid.host.render.session import RenderSession
from raygrid.host.scene.load import load_scene
from raygrid.node.errors import ProtocolError
from raygrid.node.links.faulty_channel import (
    DELAY,
    FAULT_KINDS,
    TICK_MS,
    FaultPlan,
    FaultyChannel,
    parse_fault,
    send_delayed,
)
from raygrid.node.links.link import Link, LinkPhase
from raygrid.node.links.memory_channel import memory_channels
from raygrid.node.protocol.messages import MessageKind

SHAPE = (2, 2, 1)
__all__ = ["no_leftovers"]
MESSAGES = [bytes([number]) * 40 for number in range(200)]


class Clock:
    """Time that goes on when told to."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


def sent_over(plan: FaultPlan, key=(0, 0, 0, 1, 0)) -> tuple[list[bytes], list[dict]]:
    """What comes of MESSAGES, and what was told of it."""
    one, other = memory_channels(room=10_000)
    told: list[dict] = []
    clock = Clock()
    channel = FaultyChannel(one, plan, key, told.append, clock)
    for message in MESSAGES:
        assert channel.send(message)
        clock.now += DELAY / 10
    clock.now += DELAY
    channel.release()
    return list(iter(other.receive, None)), told


def test_drop_loses_messages():
    came, told = sent_over(FaultPlan("drop", 0.1))
    hit = {words["message"] for words in told}
    assert 5 < len(hit) < 50
    assert came == [message for number, message in enumerate(MESSAGES) if number not in hit]


def test_double_sends_messages_twice():
    came, told = sent_over(FaultPlan("double", 0.1))
    hit = {words["message"] for words in told}
    assert came == [message for number, message in enumerate(MESSAGES) for _ in range(1 + (number in hit))]
    assert hit


def test_reorder_loses_none_and_swaps_neighbours():
    came, told = sent_over(FaultPlan("reorder", 0.1))
    assert sorted(came) == sorted(MESSAGES)
    assert 0 < sum(one > other for one, other in pairwise(came)) <= len(told)


def test_delay_keeps_the_order():
    came, told = sent_over(FaultPlan("delay", 0.1))
    assert told
    assert came == MESSAGES


def test_delay_is_a_delay():
    one, other = memory_channels()
    clock = Clock()
    channel = FaultyChannel(one, FaultPlan("delay", 1.0), (0,), clock=clock)
    assert channel.send(b"a")
    assert send_delayed([channel], None) == TICK_MS
    assert other.receive() is None
    clock.now += DELAY
    assert send_delayed([channel], 3) == 3
    assert other.receive() == b"a"


def test_corrupt_changes_one_bit():
    came, told = sent_over(FaultPlan("corrupt", 0.1))
    changed = {
        number: (one, other) for number, (one, other) in enumerate(zip(MESSAGES, came, strict=True)) if one != other
    }
    assert changed.keys() == {words["message"] for words in told}
    for one, other in changed.values():
        assert (int.from_bytes(one, "big") ^ int.from_bytes(other, "big")).bit_count() == 1


def test_truncate_cuts_the_end():
    came, told = sent_over(FaultPlan("truncate", 0.1))
    cut = {number for number, (one, other) in enumerate(zip(MESSAGES, came, strict=True)) if one != other}
    assert cut == {words["message"] for words in told}
    assert all(MESSAGES[number].startswith(came[number]) and len(came[number]) < 40 for number in cut)


@pytest.mark.parametrize("kind", FAULT_KINDS)
def test_the_seed_and_the_place_decide_and_nothing_else(kind):
    plan = FaultPlan(kind, 0.2, 5)
    assert sent_over(plan) == sent_over(plan)
    assert sent_over(plan)[1] != sent_over(plan._replace(seed=6))[1]
    assert sent_over(plan)[1] != sent_over(plan, key=(0, 0, 1, 1, 0))[1]
    assert sent_over(plan)[1] != sent_over(plan, key=(0, 0, 0, 1, 1))[1]


# --- noticed by the link --------------------------------------------------------------------------


def talk_over(kind: str, seed: int) -> tuple[list[bytes], int, str]:
    """Data sent over a bad link: what came before anything was noticed, how many were hit, and what was said."""
    one, other = memory_channels(room=10_000)
    told: list[dict] = []
    clock = Clock()
    bad = FaultyChannel(one, FaultPlan(kind, 0.02, seed), (0,), told.append, clock)
    left, right = Link(bad, "left", 0, LEFT, RIGHT), Link(other, "right", 0, RIGHT, LEFT)
    heard: list[bytes] = []
    try:
        for number in range(300):
            left.receive()
            if left.state is LinkPhase.UP:
                left.send_data(MessageKind.PACKETS, 1, number.to_bytes(2, "little"))
            while (arrival := right.receive()) is not None:
                heard.append(arrival.message[-2:])
                right.grant()
            left.receive()
            clock.now += DELAY / 10
            bad.release()
    except ProtocolError as error:
        return heard, len(told), str(error)
    return heard, len(told), ""


@pytest.mark.parametrize("kind", FAULT_KINDS)
def test_whatever_comes_before_it_is_noticed_is_right(kind):
    noticed = harmless = 0
    for seed in range(40):
        heard, hit, said = talk_over(kind, seed)
        first = int.from_bytes(heard[0], "little") if heard else 0
        assert heard == [number.to_bytes(2, "little") for number in range(first, first + len(heard))]
        noticed += bool(said)
        harmless += hit > 0 and not said
    if kind == "delay":
        assert (noticed, harmless) == (0, 40)
    else:
        assert noticed > 30  # and not, if HELLO was lost and nothing came after it


# --- in arrays of processes -----------------------------------------------------------------------


@cache
def job() -> Job:
    """A small frame."""
    return make_job(load_scene(TINY), SHAPE, Settings(size=(96, 72)))


@cache
def truth() -> np.ndarray:
    """Its picture."""
    array = MemoryArray(SHAPE)
    array.driver.ready()
    return render_job(array.driver, job()).sums


@pytest.mark.usefixtures("no_leftovers")
@pytest.mark.timeout(200)
@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=pytest.mark.slow) if kind == "drop" else kind for kind in FAULT_KINDS]
)  # what is dropped is found by patience
def test_the_picture_is_right_or_there_is_none(kind):
    with Array.launch(SHAPE, batch=64, fault=FaultPlan(kind, 0.002, 1)) as array:
        pictures = 0
        for _ in range(4):
            try:
                picture = RenderSession(array, attempts=4).render(job(), budget=500)
            except RECOVERABLE as error:
                assert "\n" not in str(error)
                array.reset()
                continue
            pictures += 1
            assert np.array_equal(picture.sums, truth())
            assert kind != "delay" or picture.stats["faults"] == []
        assert array.injected > 0
        assert pictures > 0


# --- the option -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "plan"),
    [("drop", ("drop", 1e-4, 0)), ("corrupt:0.5", ("corrupt", 0.5, 0)), ("delay:1:77", ("delay", 1.0, 77))],
)
def test_faults_that_can_be_asked_for(text, plan):
    assert parse_fault(text) == plan


@pytest.mark.parametrize(
    "text", ["", "x", "drop:", "drop:0", "drop:2", "drop:nan", "drop:1:x", "drop:1:1:1", "drop:" + "1" * 100]
)
def test_faults_that_cannot_be_asked_for(text):
    with pytest.raises(ValueError, match="a fault came"):
        parse_fault(text)
    one_line(here("render", TINY, "--fault", text), 2, r"raygrid render: --fault: a fault came .*wanted .*")


@pytest.mark.usefixtures("no_leftovers")
def test_faults_in_python():
    with raygrid.launch("2x1x1", fault="delay:0.05", batch=64) as machine:
        picture = machine.render(TINY, size=(48, 36))
    assert picture.stats["injected"] > 0
    with pytest.raises(ValueError, match="a fault came as 'x'"):
        raygrid.launch("2x1x1", fault="x")


@pytest.mark.usefixtures("no_leftovers")
def test_faults_from_the_command_line_are_told_and_made_good(tmp_path):
    options = ("--array", "2x2x1", "--size", "64x48", "-o")
    plain, faulty = tmp_path / "plain.npy", tmp_path / "faulty.npy"
    assert as_process("render", TINY, *options, str(plain)).code == 0
    done = as_process(
        "render", TINY, *options, str(faulty), "--batch", "32", "--fault", "double:0.003:3", "--attempts", "50"
    )
    assert done.code == 0, done.err
    assert "doubled or out of order; the array was reset in" in done.err
    assert np.array_equal(np.load(plain), np.load(faulty))
    assert Path(faulty).exists()
