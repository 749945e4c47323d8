"""Rounds in compiled code: over real sockets, whatever comes has the same consequences as where Python serves the links."""

from __future__ import annotations

import ctypes
import os
import re
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
from support.packets import ray_bytes, return_bytes, shadow_bytes
from support.scenes import Scene, mixed_scene, space_of
from support.space import EVEN_STEP

from raygrid.node.errors import ProtocolError
from raygrid.node.geometry.grid_walk import HOST
from raygrid.node.geometry.lattice import HALF
from raygrid.node.links import zmq_c_api
from raygrid.node.links.link import Link, LinkPhase
from raygrid.node.links.memory_channel import memory_channels
from raygrid.node.links.zmq_channel import ZmqChannel
from raygrid.node.main import open_links
from raygrid.node.protocol.messages import HEAD, WINDOW, MessageKind, check_packets
from raygrid.node.protocol.packets import REFLECTED, SIZE
from raygrid.node.protocol.reset import NodeConfig
from raygrid.node.runtime.native_link_table import NativeLinkTable
from raygrid.node.runtime.processor import Processor

MASK = 0xFFFFFFFF  # of numbers in headers
UPWARDS = 1  # the port +x of the node at 0,0,0
NAME, SHAPE = "2x1x1", (2, 1, 1)
TURNS = 2000  # after so many a node is taken to hang

needs_functions = pytest.mark.skipif(
    zmq_c_api.find_functions() is None,
    reason="this build of pyzmq or xxhash does not show the functions that are called",
)
pytestmark = [needs_functions, pytest.mark.timeout(120)]


@cache
def scene() -> Scene:
    """All kinds of surfaces, materials and lights."""
    camera = perspective([0.15, 0.2, 1.25], [-0.1, -0.15, -1], 30, (24, 18))
    return mixed_scene(1, EVEN_STEP, 20, size=(24, 18), depth=4, camera=camera)


class Bed:
    """The node at 0,0,0 in the middle of a frame, and the link end of its neighbour, which a test speaks for."""

    def __init__(self, context: zmq.Context[Any], place: str, native: bool, batch: int = 64) -> None:
        self.pair, self.other = (
            ZmqChannel(context, f"ipc://{place}", True),
            ZmqChannel(context, f"ipc://{place}", False),
        )
        low, high = (NodeConfig(index, (2, 1, 1), 3, "m") for index in ((0, 0, 0), (1, 0, 0)))
        links = open_links(low, {UPWARDS: self.pair, HOST: memory_channels()[0]})
        self.node = Processor((0, 0, 0), SHAPE, links, batch)
        self.link = links[UPWARDS]
        (self.peer,) = open_links(high, {UPWARDS ^ 1: self.other}).values()
        self._poller = zmq.Poller()
        self._poller.register(self.pair.socket, zmq.POLLIN)
        self._poller.register(self.other.socket, zmq.POLLIN)
        self.until(lambda: self.link.state is LinkPhase.UP is self.peer.state)
        self.node.node_state.set_space(space_of(NAME, EVEN_STEP))
        for batch_of_kind in scene().surfaces:
            self.node.node_state.retain(batch_of_kind, batch_of_kind.bounds())
        self.node.node_state.build()
        self.node.node_state.set_frame(scene().frame)
        if native:
            self.node.use_native_links(NativeLinkTable(links, {UPWARDS: self.pair}, self.node.reductions.reduction))

    def until(self, done: Any) -> None:
        """Let both ends take in what comes until something holds."""
        for _ in range(TURNS):
            if done():
                return
            self._poller.poll(50)
            for link in (self.link, self.peer):
                while link.receive() is not None:
                    pytest.fail("something came that nobody sent")
                link.push()
        pytest.fail("the node hangs")

    def work(self, taken: int) -> None:
        """Let the node go on until it has taken in so many messages more, and has nothing to do.

        Raises ProtocolError if it does.
        """
        taken += self.link.received + self.link.stale
        for _ in range(TURNS):
            if not self.node.serves_itself(UPWARDS):
                self.node.receive(UPWARDS)
            busy = self.node.work()
            if self.link.received + self.link.stale >= taken and not busy:
                return
            if not busy:
                self._poller.poll(50)
        pytest.fail("the node hangs")

    def answers(self) -> list[bytes]:
        """The packets that the node has sent so far, in order of their bytes; its books must agree with them."""
        packets: list[bytes] = []
        for _ in range(TURNS):
            while (arrival := self.peer.receive()) is not None:
                assert arrival.kind is MessageKind.PACKETS
                check_packets(arrival.message, arrival.items)
                packets += [arrival.message[at : at + SIZE] for at in range(HEAD, len(arrival.message), SIZE)]
                self.peer.grant()
            if self.peer.received == self.link.messages_sent:
                return sorted(packets)
            self._poller.poll(50)
        pytest.fail("not all messages have come")


@contextmanager
def made() -> Iterator[Any]:
    """Makes pairs of beds: one served by Python, one by compiled code."""
    directory = tempfile.mkdtemp(prefix="rgtest-", dir="/tmp")
    context: zmq.Context[Any] = zmq.Context(io_threads=1)
    beds: list[Bed] = []

    def make(**options: Any) -> list[Bed]:
        for native in (False, True):
            beds.append(Bed(context, f"{directory}/{len(beds)}", native, **options))
        return beds[-2:]

    try:
        yield make
    finally:
        for bed in beds:
            if bed.node._link_table is not None:
                bed.node._link_table.close()
                assert not bed.node.serves_itself(UPWARDS)
            bed.pair.close()
            bed.other.close()
        context.term()
        shutil.rmtree(directory)


@pytest.fixture
def beds() -> Iterator[Any]:
    """`made`, for a test."""
    with made() as make:
        yield make


def some_packets(n: int, seed: int = 0) -> list[bytes]:
    """Rays, shadow rays and returns as the neighbour would send them."""
    rng = np.random.default_rng(seed)
    made = []
    for k in range(n):
        origin = (int(rng.integers(HALF, 2 * HALF)), int(rng.integers(0, 2 * HALF)), int(rng.integers(0, 2 * HALF)))
        sample, codes = (
            int(rng.integers(0, 24 * 18)),
            (int(rng.integers(0, 1 << 23)), int(rng.integers(0, 1 << 24) - 1)),
        )
        if k % 3 == 0:
            made.append(shadow_bytes(1, sample, origin, int(rng.integers(0, scene().frame.n_lights)), (0.5, 0.25, 1.0)))
        elif k % 3 == 1:
            made.append(ray_bytes(REFLECTED, 2, sample, origin, (max(codes[0], 0), max(codes[1], 0)), 1 << 33))
        else:
            made.append(return_bytes(1, sample, (0.5, 1.5, 0.0), (0, 0, 0)))
    return made


def messages(link: Link, groups: list[list[bytes]]) -> list[bytes]:
    """PACKETS messages that follow what a link has sent."""
    first, credit = link.messages_sent, link.data_done
    return [
        message(MessageKind.PACKETS, b"".join(group), len(group), first + k & MASK, credit & MASK, link.epoch)
        for k, group in enumerate(groups)
    ]


def outcome(bed: Bed, raw: list[bytes], taken: int | None = None) -> dict[str, Any]:
    """What becomes of a node to which these messages come."""
    for one in raw:
        assert bed.other.send(one)
        bed.peer._counted.sent += 1
        bed.peer._counted.data_sent += 1
    said = ""
    try:
        bed.work(len(raw) if taken is None else taken)
    except ProtocolError as error:
        said = re.sub(r", \d+ were sent", ", others were sent", str(error))  # which is a matter of time
    result = {
        "said": said,
        "refused": dict(bed.node.refused),
        "received": (bed.link.received, bed.link.stale, bed.link.data_done),
        "credit": bed.link._counted.credit,
    }
    if said:  # how far it had come with what it had received, is a matter of when that came
        return result
    node_state = bed.node.node_state
    return {
        **result,
        "counts": node_state.counts.tolist(),
        "pixels": node_state.pixels.sums.tolist(),
        "waits": node_state.work_queues.held,
    }


def test_packets_have_the_same_consequences(beds):
    plain, native = beds()
    groups = [some_packets(n, n) for n in (1, 64, 3, 40, 64, 2)]
    outcomes = [outcome(bed, messages(bed.peer, groups)) for bed in (plain, native)]
    assert outcomes[0] == outcomes[1]
    assert outcomes[1]["received"][2] == len(groups)
    assert native.node.node_state.native.links[UPWARDS]["data_done"] == len(groups)
    sent = [bed.answers() for bed in (plain, native)]
    assert sent[0] == sent[1]
    assert len(sent[1]) > 20


def test_compiled_code_serves_the_link_and_python_does_not(beds, monkeypatch):
    _, native = beds()
    monkeypatch.setattr(Link, "receive", lambda self: pytest.fail("Python received"))
    monkeypatch.setattr(Link, "send_packets", lambda self, *rest: pytest.fail("Python sent"))
    native.work(0)  # marks what is regular
    assert outcome(native, messages(native.peer, [some_packets(50)]))["said"] == ""
    assert native.node.node_state.native.links[UPWARDS]["socket"] == native.pair.socket.underlying
    assert native.node.node_state.native.links[UPWARDS]["regular"] == 1


def test_a_node_that_may_wait_is_woken_by_what_is_for_python(beds):
    """A descriptor that compiled code knows nothing of, and a message of a link that is not for it."""
    _, native = beds()
    ends = os.pipe()
    try:
        table = NativeLinkTable(native.node.links, {UPWARDS: native.pair}, native.node.reductions.reduction, [ends[0]])
        native.node._link_table.close()
        native.node.use_native_links(table)
        os.write(ends[1], b"x")
        assert not native.node.work(wait=True)
        assert table.native.items["found"].tolist() == [0, zmq.POLLIN]
        assert outcome(native, messages(native.peer, [some_packets(5)]))["received"][2] == 1
    finally:
        for end in ends:
            os.close(end)


def test_a_link_without_a_socket_of_its_own_is_left_to_python(beds):
    plain, _ = beds()
    plain.link.channel = type("Between", (), {"send": plain.pair.send, "receive": plain.pair.receive})()
    plain.node.use_native_links(
        NativeLinkTable(plain.node.links, {UPWARDS: plain.pair}, plain.node.reductions.reduction)
    )
    assert not plain.node.serves_itself(UPWARDS)
    assert outcome(plain, messages(plain.peer, [some_packets(50)]))["received"][2] == 1


def test_without_the_functions_python_serves_all(beds, monkeypatch):
    monkeypatch.setattr(zmq_c_api, "find_functions", lambda: None)
    plain, native = beds()
    assert not native.node.serves_itself(UPWARDS)
    assert outcome(plain, messages(plain.peer, [some_packets(9)])) == outcome(
        native, messages(native.peer, [some_packets(9)])
    )


def changed(raw: bytes, at: int, value: int, seal: bool = True) -> bytes:
    """A message with another byte, and its own checksum if it is to be sealed."""
    data = bytearray(raw)
    data[at] = value
    return sealed(bytes(data)) if seal else bytes(data)


ODD = {
    "another kind": lambda raw: changed(raw, 0, MessageKind.STAMPED),
    "no kind": lambda raw: changed(raw, 0, 77),
    "an acknowledgement": lambda raw: changed(raw[:HEAD], 0, MessageKind.ACK),
    "not zero": lambda raw: changed(raw, 1, 1),
    "another sequence": lambda raw: changed(raw, 4, 99),
    "credit beyond what was sent": lambda raw: changed(raw, 8, 200),
    "more packets than bytes": lambda raw: changed(raw, 12, 9),
    "no packets": lambda raw: changed(raw[:HEAD], 12, 0),
    "another checksum": lambda raw: changed(raw, 16, raw[16] ^ 1, seal=False),
    "a bit changed": lambda raw: changed(raw, HEAD + 30, raw[HEAD + 30] ^ 4, seal=False),
    "cut": lambda raw: raw[:-3],
    "no header": lambda raw: raw[:7],
    "nothing": lambda raw: b"",
    "a packet of no kind": lambda raw: changed(raw, HEAD + SIZE, 7),
    "a packet of no sample": lambda raw: changed(raw, HEAD + SIZE + 4, 255),
}


@pytest.mark.parametrize("odd", ODD)
def test_what_is_odd_is_left_to_the_rules_of_links(beds, odd):
    groups = [some_packets(5, 1), some_packets(6, 2), some_packets(7, 3)]
    outcomes = []
    for bed in beds():
        bed.work(0)
        raw = messages(bed.peer, groups)
        raw[1] = ODD[odd](raw[1])
        outcomes.append(outcome(bed, raw))
    assert outcomes[0] == outcomes[1]
    assert outcomes[0]["said"] or outcomes[0]["refused"]


def test_another_epoch_is_counted_and_dropped(beds):
    outcomes = []
    for bed in beds():
        bed.work(0)
        raw = messages(bed.peer, [some_packets(5, 1), some_packets(6, 2)])
        stale = changed(raw[0], 2, 9)
        outcomes.append(outcome(bed, [stale, raw[0], stale, raw[1]]))
    assert outcomes[0] == outcomes[1]
    assert outcomes[0]["received"][1] == 2


def test_several_parts_are_refused(beds):
    said = []
    for bed in beds():
        bed.work(0)
        (raw,) = messages(bed.peer, [some_packets(5, 1)])
        bed.other.socket.send_multipart([raw, raw])
        said.append(outcome(bed, [], 1)["said"].split(": ", 1)[1])
    assert said[0] == said[1]
    assert "several parts" in said[0]


@steady(25)
@given(data=st.data())
def test_any_stream_has_the_same_consequences(data):
    """Packets, credit, rubbish, in messages of any length, one of them spoilt at any byte."""
    sizes = data.draw(st.lists(st.integers(1, 40), min_size=1, max_size=8))
    spoilt, at, value = data.draw(st.tuples(st.integers(0, len(sizes)), st.integers(0, 19), st.integers(0, 255)))
    with made() as make:
        outcomes = []
        for bed in make():
            bed.work(0)
            raw = messages(bed.peer, [some_packets(n, k) for k, n in enumerate(sizes)])
            if spoilt < len(raw):
                raw[spoilt] = changed(raw[spoilt], at, value, seal=bool(value & 1))
            outcomes.append(outcome(bed, raw))
        assert outcomes[0] == outcomes[1]


def test_numbers_run_over_their_end(beds):
    outcomes = []
    for bed in beds():
        bed.work(0)
        for link in (bed.link, bed.peer):
            link._counted.sent = link._counted.received = 2**32 - 5
            for counter in ("data_sent", "credit", "data_done", "data_told"):
                setattr(link._counted, counter, 2**32 - 9)
        outcomes.append(outcome(bed, messages(bed.peer, [some_packets(3, k) for k in range(40)])))
        assert len(bed.answers()) > 20
    assert outcomes[0] == outcomes[1]
    assert outcomes[1]["received"] == (2**32 + 35, 0, 2**32 + 31)


def test_credit_is_told_and_bounds_what_is_sent(beds):
    """One packet a message: compiled code stops at the window, the rest waits in the link, and goes with the credit."""
    _, native = beds(batch=1)
    packets = [packet for packet in some_packets(400, 5) if packet[0] & 7 != 5]  # of returns nothing comes
    raw = messages(native.peer, [packets[k : k + 30] for k in range(0, 240, 30)])
    assert outcome(native, raw)["said"] == ""
    assert native.link.data_sent == WINDOW
    assert native.link.waiting > 0
    native.node.links[HOST].give_up()
    for _ in range(TURNS):
        while (arrival := native.peer.receive()) is not None:
            assert arrival.items == 1
            native.peer.grant()
        native.node.receive(UPWARDS)
        native.node.work()
        if native.link.waiting == 0 and native.peer.received == native.link.messages_sent:
            break
        native._poller.poll(20)
    else:
        pytest.fail("what waits for credit is never sent")
    assert native.link.data_sent > 2 * WINDOW
    assert native.peer._counted.received == native.link.messages_sent


@given(payload=st.binary(max_size=3000), numbers=st.tuples(*[st.integers(0, 2**32 - 1)] * 3))
@steady(60)
def test_checksums_are_those_of_messages(payload, numbers):
    calls = zmq_c_api.find_functions()
    raw = np.frombuffer(message(3, payload, *numbers), np.uint8)
    digest = ctypes.CFUNCTYPE(ctypes.c_uint64, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_uint64)(calls.checksum)
    seed = digest(raw.ctypes.data, 16, 0)
    assert digest(raw.ctypes.data + HEAD, len(raw) - HEAD, seed) & 0xFFFFFFFF == int.from_bytes(
        raw[16:20].tobytes(), "little"
    )
