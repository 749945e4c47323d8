"""The line between the host and a node: words both ways, nothing blocks, nothing that is no map is heard."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator

import msgpack
import pytest
from support.processes import open_descriptors

from raygrid.emulator.processes.control import MOST_DESCRIPTORS, ForkServerChannel
from raygrid.emulator.processes.control_channels import ControlChannels
from raygrid.node.errors import ProtocolError
from raygrid.node.links.control_channel import LONGEST_CONTROL_MESSAGE, ControlChannel
from raygrid.node.protocol.codec import DEEPEST
from raygrid.node.protocol.reset import LAST_EPOCH, LinkConfig, NodeConfig, read_reset


@pytest.fixture
def ends() -> Iterator[tuple[ControlChannel, ControlChannel]]:
    """Both ends of a line."""
    one, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    lines = ControlChannel(one.detach()), ControlChannel(other.detach())
    yield lines
    for line in lines:
        line.close()


def test_words_come_one_by_one_and_in_order(ends):
    host, node = ends
    assert node.receive() is None
    for number in range(5):
        assert host.send({"number": number, "list": [number] * number})
    assert [node.receive() for _ in range(6)] == [*({"number": n, "list": [n] * n} for n in range(5)), None]
    assert node.send({"is": "here"})
    assert host.receive() == {"is": "here"}
    assert not host.closed


def test_a_full_line_drops_words_and_says_so(ends):
    host, node = ends
    sent = 0
    while host.send({"ballast": bytes(1000)}):
        sent += 1
    assert sent > 10
    assert host.dropped == 1
    assert sum(1 for _ in iter(node.receive, None)) == sent
    assert host.send({})


@pytest.mark.parametrize(
    "raw", [b"\xc1", b"\x90", b"\x01", b"\x81\x01\x02", b"\x80\x80", b"\x91" * 50 + b"\xc0", b"\xc7\x01\x05x"]
)
def test_what_is_no_map_is_refused_and_counted(ends, raw):
    host, node = ends
    host._socket.send(raw)
    host.send({"do": "next"})
    assert node.receive() == {"do": "next"}
    assert node.refused == 1


def test_maps_that_are_too_deep_or_too_long_are_refused(ends):
    host, node = ends
    deep: object = 0
    for _ in range(DEEPEST):
        deep = [deep]
    host._socket.send(msgpack.packb({"x": deep}))
    host._socket.send(msgpack.packb({"x": bytes(LONGEST_CONTROL_MESSAGE)}))
    assert node.receive() is None
    assert node.refused == 2
    with pytest.raises(ProtocolError, match=f"a control message has {LONGEST_CONTROL_MESSAGE + 8} bytes"):
        host.send({"x": bytes(LONGEST_CONTROL_MESSAGE)})


def test_the_end_of_the_other_side_is_found_after_its_words(ends):
    host, node = ends
    node.send({"last": 1})
    node.close()
    assert host.receive() == {"last": 1}
    assert host.receive() is None
    assert host.closed
    assert not host.send({})


def test_descriptors_that_come_along_are_not_taken(ends):
    host, node = ends
    before = open_descriptors()
    socket.send_fds(host._socket, [msgpack.packb({"do": "look"})], [0, 1])
    assert node.receive() == {"do": "look"}
    assert open_descriptors() == before


def test_all_channels_are_read_at_once():
    lines = ControlChannels()
    others = {}
    for number in range(4):
        one, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        lines.add((number, 0, 0), one.detach())
        others[number] = ControlChannel(other.detach())
    assert lines.receive() == []
    others[2].send({"is": "two"})
    others[0].send({"is": "none"})
    others[0].send({"is": "more"})
    heard = lines.receive()
    assert sorted(heard, key=lambda pair: pair[0]) == [
        ((0, 0, 0), {"is": "none"}),
        ((0, 0, 0), {"is": "more"}),
        ((2, 0, 0), {"is": "two"}),
    ]
    others[1].close()
    assert lines.receive() == []
    assert lines.receive() == []
    assert not lines.send((1, 0, 0), {})
    assert not lines.send((9, 0, 0), {})
    assert lines.send((3, 0, 0), {"do": "it"})
    assert others[3].receive() == {"do": "it"}
    lines.close()
    assert others[3].receive() is None
    assert others[3].closed
    for other in others.values():
        other.close()


# --- descriptors to the host ----------------------------------------------------------------------


def test_descriptors_come_with_the_messages_that_bring_them():
    left, right = socket.socketpair()
    sender, receiver = ForkServerChannel(left), ForkServerChannel(right)
    before = len(open_descriptors())
    for number in range(3):
        pipes = [os.memfd_create(f"{number}-{k}") for k in range(MOST_DESCRIPTORS)]
        for k, pipe in enumerate(pipes):
            os.write(pipe, f"{number} {k}".encode())
        sender.send({"before": number})
        sender.send({"lines": number}, pipes)
        assert len(open_descriptors()) == before + len(receiver.descriptors)  # the sender's are closed
        messages = receiver.receive()
        assert messages == [{"before": number}, {"lines": number}]
        assert [os.pread(got, 20, 0).decode() for got in receiver.descriptors] == [
            f"{number} {k}" for k in range(MOST_DESCRIPTORS)
        ]
        assert not any(os.get_inheritable(got) for got in receiver.descriptors)
        for got in receiver.descriptors:
            os.close(got)
        receiver.descriptors.clear()
    sender.send({}, [os.memfd_create("left")])
    receiver.receive()
    receiver.close()
    sender.close()
    assert len(open_descriptors()) == before - 2


# --- the reset order ------------------------------------------------------------------------------

CONFIG = NodeConfig((0, 0, 0), (2, 1, 1), 3, "old", (LinkConfig(1, "", True), LinkConfig(6, "", False)), 5)
LINKS = [{"port": 6, "endpoint": "ipc:///a/4-h", "bind": False}, {"port": 1, "endpoint": "ipc:///a/4-x", "bind": True}]
ORDER = {"do": "reset", "epoch": 4, "machine": "new", "links": LINKS}


def test_a_reset_order_gives_the_next_config():
    links = tuple(LinkConfig(**link) for link in LINKS)
    assert read_reset(ORDER, CONFIG) == NodeConfig((0, 0, 0), (2, 1, 1), 4, "new", links, 5)


@pytest.mark.parametrize(
    "change",
    [
        {"epoch": 3},
        {"epoch": 2},
        {"epoch": LAST_EPOCH + 1},
        {"epoch": 4.0},
        {"epoch": True},
        {"epoch": None},
        {"machine": ""},
        {"machine": "x" * 1000},
        {"machine": b"new"},
        {"links": None},
        {"links": []},
        {"links": LINKS[:1]},
        {"links": [*LINKS, LINKS[0]]},
        {"links": [LINKS[0], LINKS[0]]},
        {"links": [LINKS[0], {**LINKS[1], "port": 2}]},
        {"links": [LINKS[0], {**LINKS[1], "port": True}]},
        {"links": [LINKS[0], {**LINKS[1], "port": 7}]},
        {"links": [LINKS[0], {**LINKS[1], "endpoint": "tcp://1.2.3.4:5"}]},
        {"links": [LINKS[0], {**LINKS[1], "endpoint": 5}]},
        {"links": [LINKS[0], {**LINKS[1], "endpoint": "ipc://" + "x" * 1000}]},
        {"links": [LINKS[0], {**LINKS[1], "bind": 1}]},
        {"links": [LINKS[0], []]},
    ],
)
def test_a_reset_order_that_is_none_is_refused(change):
    with pytest.raises(ProtocolError, match="a reset came with"):
        read_reset({**ORDER, **change}, CONFIG)
