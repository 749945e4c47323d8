"""Reductions: their bytes, and that compiled code takes care of them as Python does, over real sockets."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import numpy as np
import pytest
import zmq
from hypothesis import given
from hypothesis import strategies as st
from support.cases import steady
from support.frames import perspective
from support.messages import message, sealed
from support.packets import return_bytes
from support.scenes import Scene, mixed_scene, space_of
from support.space import EVEN_STEP

from raygrid.node.errors import ProtocolError
from raygrid.node.links import zmq_c_api
from raygrid.node.links.link import Link, LinkPhase
from raygrid.node.links.zmq_channel import ZmqChannel
from raygrid.node.main import open_links
from raygrid.node.protocol.commands import TraceCommand
from raygrid.node.protocol.counters import BORN
from raygrid.node.protocol.messages import HEAD, MessageKind
from raygrid.node.protocol.packets import PRIMARY
from raygrid.node.protocol.reset import NodeConfig
from raygrid.node.runtime import reduction, reduction_replies
from raygrid.node.runtime.event_loop import BACK_OFFS
from raygrid.node.runtime.native_link_table import NativeLinkTable
from raygrid.node.runtime.processor import Processor
from raygrid.node.runtime.reduction import (
    LONGEST_HOLD,
    MOST_BACK_OFF,
    MOST_PACKETS,
    MOST_QUOTA,
    REQUEST_FIELDS,
    SUMS,
    pack_request,
    read_request,
)
from raygrid.node.runtime.reduction_replies import Reductions

NAME, SHAPE = "3x1x1", (3, 1, 1)
LOW, HIGH = 0, 1  # ports of the node in the middle: to its parent, and to its only child
PEERS = {LOW: (0, 0, 0), HIGH: (2, 0, 0)}
TURNS = 2000  # after so many a node is taken to hang
LONG = 10 * 10**9  # nanoseconds, longer than any test
pytestmark = [pytest.mark.usefixtures("fast_paths_on"), pytest.mark.timeout(120)]

# --- bytes ---------------------------------------------------------------------------------------------

orders = st.tuples(
    st.integers(0, 2**31),
    st.integers(0, MOST_QUOTA),
    st.integers(0, LONGEST_HOLD),
    st.integers(0, MOST_PACKETS),
    st.integers(0, MOST_BACK_OFF),
    st.integers(1, MOST_PACKETS),
).map(list)


def request_bytes(fields: list[int]) -> bytes:
    """The payload of a REDUCE."""
    return np.array(fields, "<i8").tobytes()


def test_the_order_to_trace_is_these_numbers():
    payload = pack_request(5, TraceCommand(7, hold=0.028, batch_threshold=300, back_off=0.0008, flush=4096))
    assert payload == request_bytes([5, 7, 28_000_000, 300, 800, 4096])
    assert read_request(message(MessageKind.REDUCE, payload)).numbers() == [5, 7, 28_000_000, 300, 800, 4096]


@given(fields=orders)
@steady(100)
def test_what_is_in_range_is_read_as_it_was_written(fields):
    assert read_request(message(MessageKind.REDUCE, request_bytes(fields))).numbers() == fields


BAD = {
    "quota": [(1, -1), (1, 2**32)],
    "hold": [(2, -1), (2, LONGEST_HOLD + 1)],
    "batch threshold": [(3, -1), (3, 2**40)],
    "back-off": [(4, -1), (4, MOST_BACK_OFF + 1)],
    "flush": [(5, 0), (5, -(2**63))],
}


@pytest.mark.parametrize(("place", "value"), [case for cases in BAD.values() for case in cases])
def test_what_is_out_of_range_is_refused(place, value):
    fields = [1, 2, 3, 4, 5, 6]
    fields[place] = value
    with pytest.raises(ProtocolError, match="wanted wave, quota, hold, batch threshold, back-off and flush in range"):
        read_request(message(MessageKind.REDUCE, request_bytes(fields)))


@pytest.mark.parametrize("size", [0, 40, 47, 49, 56])
def test_another_length_is_refused(size):
    with pytest.raises(ProtocolError, match=f"came with {size} bytes, wanted"):
        read_request(message(MessageKind.REDUCE, bytes(size)))
    with pytest.raises(ProtocolError, match=f"came with {size} bytes, wanted"):
        reduction.read_reply(message(MessageKind.REDUCED, bytes(size)))


@pytest.mark.parametrize(
    "odd",
    [{"quota": -1}, {"quota": 2**64 + 5}, {"batch_threshold": -1}, {"back_off": 2.0}, {"hold": 61.0}, {"flush": 0}],
)
def test_a_command_out_of_range_goes_as_a_map(odd):
    assert pack_request(1, TraceCommand(**({"quota": 5, "flush": 9} | odd))) is None


# --- a node between its parent and its child -----------------------------------------------------------


@cache
def scene() -> Scene:
    """Something to trace, with the camera in the middle node."""
    camera = perspective([0.05, 0.1, 0.1], [-0.1, -0.15, -1], 50, (24, 18))
    return mixed_scene(1, EVEN_STEP, 20, size=(24, 18), depth=3, camera=camera)


class Middle:
    """The node at 1,0,0 in the middle of a frame, and the link ends of both neighbours, for which a test speaks."""

    def __init__(self, context: zmq.Context[Any], place: str, native: bool) -> None:
        self.pairs = {port: ZmqChannel(context, f"ipc://{place}-{port}", True) for port in PEERS}
        self.others = {port: ZmqChannel(context, f"ipc://{place}-{port}", False) for port in PEERS}
        self.node: Processor
        self._link_table: NativeLinkTable | None = None
        links = open_links(NodeConfig((1, 0, 0), SHAPE, 3, "m"), self.pairs)
        self.peers: dict[int, Link] = {}
        for port, index in PEERS.items():
            made = open_links(NodeConfig(index, SHAPE, 3, "m"), {port ^ 1: self.others[port]})
            self.peers[port] = made[port ^ 1]
        self.node = Processor((1, 0, 0), SHAPE, links, 64)
        self._poller = zmq.Poller()
        for pair in (*self.pairs.values(), *self.others.values()):
            self._poller.register(pair.socket, zmq.POLLIN)
        for _ in range(TURNS):
            every = [*links.values(), *self.peers.values()]
            if all(link.state is LinkPhase.UP for link in every):
                break
            self._poller.poll(50)
            for link in every:
                assert link.receive() is None
                link.push()
        self.node.node_state.set_space(space_of(NAME, EVEN_STEP))
        for batch in scene().surfaces:
            self.node.node_state.retain(batch, batch.bounds())
        self.node.node_state.build()
        self.node.node_state.set_frame(scene().frame)
        if native:
            self._link_table = NativeLinkTable(links, self.pairs, self.node.reductions.reduction)
            self.node.use_native_links(self._link_table)

    def say(self, port: int, kind: MessageKind, payload: bytes) -> None:
        """A neighbour says something."""
        self.peers[port].send_payload(kind, payload)

    def until(self, done: Any) -> list[tuple[int, MessageKind, bytes]]:
        """Let the node go on until something holds; what its neighbours heard but packets.

        Raises ProtocolError if the node does.
        """
        heard: list[tuple[int, MessageKind, bytes]] = []
        for _ in range(TURNS):
            for port in PEERS:
                if not self.node.serves_itself(port):
                    self.node.receive(port)
            self.node.work()
            for port, link in self.peers.items():
                while (arrival := link.receive()) is not None:
                    if arrival.kind is MessageKind.PACKETS:
                        link.grant()
                    else:
                        heard.append((port, arrival.kind, arrival.message[HEAD:]))
            if done(heard):
                return heard
            if not self.node.busy:
                self._poller.poll(20)
        pytest.fail(f"the node hangs; heard {heard}")

    def close(self) -> None:
        """Nothing is left."""
        if self._link_table is not None:
            self._link_table.close()
        for pair in (*self.pairs.values(), *self.others.values()):
            pair.close()


@contextmanager
def middles() -> Iterator[Any]:
    """Makes nodes whose reductions Python takes care of (False) or compiled code (True)."""
    directory, context = tempfile.mkdtemp(prefix="rgtest-", dir="/tmp"), zmq.Context(io_threads=1)
    made: list[Middle] = []

    def make(native: bool) -> Middle:
        made.append(Middle(context, f"{directory}/{len(made)}", native))
        return made[-1]

    try:
        yield make
    finally:
        for middle in made:
            middle.close()
        context.destroy(linger=0)
        shutil.rmtree(directory)


@pytest.fixture
def make() -> Iterator[Any]:
    """`middles`, for a test."""
    with middles() as maker:
        yield maker


def answered(heard: list[tuple[int, MessageKind, bytes]]) -> bool:
    """Whether the parent has its answer."""
    return any(kind is MessageKind.REDUCED for _, kind, _ in heard)


def child_answer(number: int, seed: int = 0) -> bytes:
    """What a child might say."""
    return reduction.pack_reply(number, np.random.default_rng(seed).integers(0, 2**40, SUMS))


@pytest.mark.skipif(zmq_c_api.find_functions() is None, reason="no functions to call")
def test_both_answer_the_same_after_the_same_work(make):
    found = []
    for middle in (make(False), make(True)):
        middle.say(LOW, MessageKind.REDUCE, request_bytes([4, 200, LONG, 0, 0, 64]))
        told = middle.until(lambda heard: len(heard) == 1)
        middle.say(HIGH, MessageKind.REDUCED, child_answer(4))
        (answer,) = middle.until(answered)
        number, sums = reduction.read_reply(message(MessageKind.REDUCED, answer[2]))
        # of its own it counts what it did; messages are a matter of time
        own = sums - np.random.default_rng(0).integers(0, 2**40, SUMS)
        assert own[: reduction.COUNTS].tolist() == middle.node.node_state.counts.tolist()
        assert own[reduction.SUM_DATA_SENT] == sum(link.data_sent for link in middle.node.links.values())
        own[reduction.SUM_DATA_SENT] = 0
        found.append((told, answer[:2], number, own.tolist()))
    assert found[0] == found[1]
    told, answer, number, own = found[1]
    assert told == [(HIGH, MessageKind.REDUCE, request_bytes([4, 200, LONG, 0, 0, 64]))]
    assert (answer, number) == ((LOW, MessageKind.REDUCED), 4)
    assert own[BORN + PRIMARY] == 200
    assert own[reduction.HOMES_LEFT] == 1


@pytest.mark.skipif(zmq_c_api.find_functions() is None, reason="no functions to call")
def test_compiled_code_does_it_and_python_does_not(make, monkeypatch):
    middle = make(True)
    monkeypatch.setattr(reduction_replies, "pack_reply", lambda *rest: pytest.fail("Python answered"))
    monkeypatch.setattr(Reductions, "notify_children", lambda self: pytest.fail("Python told"))
    monkeypatch.setattr(Processor, "receive", lambda self, port: pytest.fail("Python received"))
    monkeypatch.setattr(Processor, "serves_itself", lambda self, port: True)
    middle.say(LOW, MessageKind.REDUCE, request_bytes([9, 50, LONG, 300, 800, 17]))
    middle.until(lambda heard: len(heard) == 1)
    middle.say(HIGH, MessageKind.REDUCED, child_answer(9))
    middle.until(answered)
    tuning = middle.node.node_state.tuning
    assert (tuning.batch_threshold, tuning.back_off, tuning.flush) == (300, 800 // BACK_OFFS, 17)


def spoil(fields: list[int], place: int, value: int) -> bytes:
    """A request with another number in it."""
    changed = list(fields)
    changed[place] = value
    return request_bytes(changed)


GOOD = [4, 200, LONG, 0, 0, 64]
ODD = {
    "a second request": [
        (LOW, MessageKind.REDUCE, request_bytes(GOOD)),
        (LOW, MessageKind.REDUCE, request_bytes(GOOD)),
    ],
    "an order beside it": [
        (LOW, MessageKind.REDUCE, request_bytes(GOOD)),
        (LOW, MessageKind.DOWN, b"\x81\xa2do\xa5ready"),
    ],
    "a request from a child": [(HIGH, MessageKind.REDUCE, request_bytes(GOOD))],
    "an answer from the parent": [(LOW, MessageKind.REDUCED, child_answer(4))],
    "an answer to nothing": [(HIGH, MessageKind.REDUCED, child_answer(4))],
    "an answer to another": [
        (LOW, MessageKind.REDUCE, request_bytes(GOOD)),
        (HIGH, MessageKind.REDUCED, child_answer(5)),
    ],
    "too short": [(LOW, MessageKind.REDUCE, request_bytes(GOOD)[:-8])],
    "too long": [(LOW, MessageKind.REDUCE, request_bytes([*GOOD, 0]))],
    "an empty answer": [(LOW, MessageKind.REDUCE, request_bytes(GOOD)), (HIGH, MessageKind.REDUCED, b"")],
    **{
        f"{name} {value}": [(LOW, MessageKind.REDUCE, spoil(GOOD, place, value))]
        for name, cases in BAD.items()
        for place, value in cases
    },
}


@pytest.mark.parametrize("odd", ODD)
def test_what_is_odd_is_left_to_python(make, odd):
    said = []
    for native in (False, True):
        middle = make(native)
        middle.node.work()
        for port, kind, payload in ODD[odd]:
            middle.say(port, kind, payload)
        with pytest.raises(ProtocolError) as error:
            middle.until(lambda heard: False)
        said.append(str(error.value))
    assert said[0] == said[1]


def test_it_is_answered_when_all_is_done(make):
    """Although the node was given work with it, and has a long time."""
    for native in (False, True):
        middle = make(native)
        packets = [return_bytes(1, k % 400, (0.5, 1.5, 0.0), (1, 0, 0)) for k in range(300)]
        middle.peers[LOW].send_data(MessageKind.PACKETS, len(packets), b"".join(packets))
        middle.say(LOW, MessageKind.REDUCE, request_bytes([4, 20_000, LONG, 0, 0, 64]))
        middle.until(lambda heard: len(heard) == 1)
        middle.say(HIGH, MessageKind.REDUCED, reduction.pack_reply(4, np.zeros(SUMS, np.int64)))
        (answer,) = middle.until(answered)
        _, sums = reduction.read_reply(message(MessageKind.REDUCED, answer[2]))
        assert (sums[reduction.SUM_WAITING], sums[reduction.HOMES_LEFT]) == (0, 0)


@pytest.mark.parametrize("native", [False, True])
def test_a_node_that_is_never_idle_answers_at_the_deadline_and_not_before(make, monkeypatch, native):
    monkeypatch.setattr(Processor, "_idle", lambda self: False)
    monkeypatch.setattr(Processor, "_is_occupied", property(lambda self: True))
    middle = make(native)
    state = middle.node.reductions.state
    for number, hold in ((4, 0), (5, LONG)):
        middle.say(LOW, MessageKind.REDUCE, request_bytes([number, 50, hold, 0, 0, 64]))
        middle.until(lambda heard: any(kind is MessageKind.REDUCE for _, kind, _ in heard))
        middle.say(HIGH, MessageKind.REDUCED, child_answer(number))
        if hold:
            middle.until(lambda heard: state.replied == state.child_ports)
            for _ in range(20):
                middle.node.work()
            assert state.pending
            state.deadline = 0
        assert answered(middle.until(answered))


def test_before_a_frame_it_is_refused(make):
    middle = make(False)
    middle.node.node_state.forget_frame()
    middle.say(LOW, MessageKind.REDUCE, request_bytes(GOOD))
    middle.until(lambda heard: len(heard) == 1)
    assert list(middle.node.refused) == ["node (1, 0, 0): the order 'trace' came before a frame"]


@given(fields=orders, wrong=st.integers(0, REQUEST_FIELDS * 8 + HEAD - 1), value=st.integers(0, 255))
@steady(15)
def test_any_request_has_the_same_consequences(fields, wrong, value):
    """Sound ones and spoilt ones, with their own checksums."""
    outcomes = []
    with middles() as maker:
        for native in (False, True):
            middle = maker(native)
            middle.node.work()
            link = middle.peers[LOW]
            raw = bytearray(
                message(MessageKind.REDUCE, request_bytes(fields), 0, link.messages_sent, link.data_done, link.epoch)
            )
            raw[wrong] = value
            assert middle.others[LOW].send(sealed(bytes(raw)))
            state, taken = (
                middle.node.reductions.state,
                middle.node.links[LOW].received + middle.node.links[LOW].stale,
            )
            said = ""
            try:
                middle.until(lambda heard, m=middle, t=taken: m.node.links[LOW].received + m.node.links[LOW].stale > t)
            except ProtocolError as error:
                said = str(error)
            pending = [state.pending, state.wave, state.replied]
            # compiled code reads a request in place before it believes it: it counts once it is under way
            request = middle.node.reductions.reduction.request.tolist() if state.pending else None
            outcomes.append((said, pending, request, middle.node.links[LOW].stale))
    assert outcomes[0] == outcomes[1]
