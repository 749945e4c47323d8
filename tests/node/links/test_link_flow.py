"""The contract for links, its second half: credit and room, closing, damage, and what ZeroMQ alone does."""

from __future__ import annotations

import random

import pytest
import zmq
from hypothesis import given
from hypothesis import strategies as st
from support.cases import steady
from support.links import (
    Meddler,
    Narrow,
    Talk,
    Watched,
    memory_wire,
    payloads,
    received,
    renumbered,
    wire,
    zeromq_wire,
)
from support.messages import message

from raygrid.node.errors import ProtocolError
from raygrid.node.links.link import LinkPhase
from raygrid.node.links.memory_channel import MemoryChannel, memory_channels
from raygrid.node.links.zmq_channel import ZmqChannel
from raygrid.node.protocol.messages import HEAD, MAX_MESSAGE, WINDOW, MessageKind, read_order
from raygrid.node.protocol.packets import SIZE

__all__ = ["wire"]

PACKETS, SURFACES, DOWN, UP = MessageKind.PACKETS, MessageKind.SURFACES, MessageKind.DOWN, MessageKind.UP
HELLO, ACK, CREDIT = MessageKind.HELLO, MessageKind.ACK, MessageKind.CREDIT
BYE, BYE_ACK = MessageKind.BYE, MessageKind.BYE_ACK

# --- credit and room -----------------------------------------------------------------------------


def test_the_window_is_never_exceeded(wire):
    ends = [Watched(end) for end in wire.ends]
    talk, rng = Talk(wire, *ends), random.Random(2)
    ends[0].peer, ends[1].peer = talk.links[1], talk.links[0]
    talk.up()
    talk.grants = False
    owed, sent = [0, 0], [0, 0]
    for _ in range(2000):
        end = rng.randrange(2)
        if rng.random() < 0.5 and sent[end] < 400:
            talk.links[end].send_data(PACKETS, 1, sent[end].to_bytes(4, "little"))
            sent[end] += 1
        before = len(talk.heard[end])
        talk.turn(end)
        owed[end] += len(talk.heard[end]) - before
        if rng.random() < 0.02 and owed[end]:
            given = rng.randint(1, owed[end])
            talk.links[end].grant(given)
            owed[end] -= given
    for end in range(2):
        talk.links[end].grant(owed[end])
    talk.grants = True
    talk.until(lambda: [len(heard) for heard in talk.heard] == sent[::-1], "all messages")
    assert min(end.most_under_way for end in ends) == WINDOW  # and it was reached


def test_without_credit_no_more_than_the_window_goes(wire):
    watched = Watched(wire.ends[0])
    talk = Talk(wire, left=watched).up()
    talk.grants = False
    for _ in range(3 * WINDOW):
        talk.links[0].send_data(SURFACES, 1, bytes(100))
    talk.until(lambda: len(talk.heard[1]) == WINDOW, "the window")
    talk.turn(0)
    assert watched.data == WINDOW
    assert talk.links[0].waiting == 2 * WINDOW
    assert not talk.links[0].choked  # it waits for credit, not for room


@pytest.mark.parametrize("share", [0.9, 0.5, 0.1])
def test_a_channel_without_room_loses_nothing(wire, share):
    rng = random.Random(3)
    ends = [Narrow(end, lambda: rng.random() < share) for end in wire.ends]
    talk = Talk(wire, *ends)
    for number in range(150):
        for link in talk.links:
            if number % 10 == 0:
                link.send_order(UP, {"number": number})
            else:
                link.send_data(PACKETS, 1, number.to_bytes(2, "little"))
    talk.until(lambda: all(len(heard) == 150 for heard in talk.heard), "all messages")
    for heard in talk.heard:
        data = [int.from_bytes(arrival.message[HEAD:], "little") for arrival in heard if arrival.kind == PACKETS]
        assert data == [number for number in range(150) if number % 10]
        assert [read_order(a.message)["number"] for a in heard if a.kind == UP] == list(range(0, 150, 10))
    for link in talk.links:
        link.close()
    talk.closed()


@pytest.mark.parametrize("room", [1, 2, 3])
def test_a_small_room_in_memory_loses_nothing(room):
    with memory_wire() as wire:
        wire.ends = memory_channels(room)
        talk = Talk(wire)
        for number in range(100):
            for link in talk.links:
                link.send_data(PACKETS, 1, bytes([number]))
        talk.until(lambda: all(len(heard) == 100 for heard in talk.heard), "all messages")
        for heard in talk.heard:
            assert payloads(heard) == [bytes([number]) for number in range(100)]


def test_a_peer_that_does_not_read_blocks_nobody(wire):
    talk = Talk(wire).up()
    for _ in range(10 * WINDOW):
        talk.links[0].send_data(PACKETS, 1000, bytes(1000 * SIZE))
    assert talk.links[0].waiting == 9 * WINDOW
    talk.until(lambda: len(talk.heard[1]) == 10 * WINDOW, "all messages")


# --- closing -------------------------------------------------------------------------------------


@pytest.mark.parametrize("script", ["01", "10", "0a1", "1b0", "0ab1", "0ba1ab", "0aabb1", "n01", "n0ab1"])
def test_bye_and_its_answer_close_both_ends(wire, script):
    """Script: 0, 1: that end closes; a, b: left, right takes its turn; n: not even up."""
    talk = Talk(wire)
    if "n" not in script:
        talk.up()
    for act in script.replace("n", ""):
        if act in "01":
            talk.links[int(act)].close()
        else:
            talk.turn("ab".index(act))
    talk.closed()
    assert all(link.peer_left for link in talk.links)
    assert talk.heard == ([], [])


@steady(150)
@given(st.lists(st.sampled_from("01abxy"), max_size=14), st.integers(1, 3), st.booleans())
def test_links_close_whatever_the_order(script, room, up):
    """0, 1: that end closes; a, b: a turn; x, y: that end sends data. Over queues with next to no room."""
    with memory_wire() as wire:
        wire.ends = memory_channels(room)
        talk = Talk(wire).up() if up else Talk(wire)
        for act in script:
            if act in "01":
                talk.links[int(act)].close()
            elif act in "ab":
                talk.turn("ab".index(act))
            else:
                talk.links["xy".index(act)].send_data(PACKETS, 1, bytes(SIZE))
        for link in talk.links:
            link.close()
        talk.closed()


def test_one_end_alone_does_not_close_a_link(wire):
    talk = Talk(wire).up()
    talk.links[0].close()
    talk.until(lambda: talk.links[1].peer_left, "BYE")
    talk.turn(0)
    assert talk.links[0].state is LinkPhase.CLOSING
    assert talk.links[1].state is LinkPhase.UP
    talk.links[1].send_data(PACKETS, 1, b"late")  # who has not said BYE may still speak
    talk.until(lambda: bool(talk.heard[0]), "the late message")
    talk.links[1].close()
    talk.closed()


def test_orders_that_wait_go_before_bye_and_data_without_credit_is_given_up(wire):
    room = [True]
    talk = Talk(wire, left=Narrow(wire.ends[0], lambda: room[0])).up()
    talk.grants = False
    for _ in range(WINDOW + 1):
        talk.links[0].send_data(PACKETS, 1, bytes(SIZE))
    room[0] = False
    talk.links[0].send_order(UP, {"last": True})
    talk.links[0].close()
    room[0] = True
    for link in talk.links:
        link.close()
    talk.closed()
    assert [arrival.kind for arrival in talk.heard[1]] == [PACKETS] * WINDOW + [UP]


def test_a_closed_link_neither_sends_nor_takes(wire):
    talk = Talk(wire).up()
    for link in talk.links:
        link.close()
    talk.closed()
    sent = talk.links[0].messages_sent
    talk.links[0].close()
    talk.links[0].send_data(PACKETS, 1, bytes(SIZE))
    talk.links[0].grant(WINDOW)
    wire.ends[1].send(message(PACKETS, bytes(SIZE), 1))
    assert talk.links[0].receive() is None
    assert talk.links[0].messages_sent == sent


# --- a link that is damaged in any way -----------------------------------------------------------


@steady(300)
@given(
    kind=st.sampled_from([HELLO, ACK, PACKETS, DOWN, CREDIT, BYE, BYE_ACK]),
    nth=st.integers(1, 3),
    fields=st.dictionaries(
        st.sampled_from(["kind", "zero", "sequence", "credit", "count"]), st.integers(0, 255), min_size=1, max_size=2
    ),
    cut=st.one_of(st.none(), st.integers(0, 40)),
)
def test_a_damaged_message_gives_an_error_or_does_no_harm(kind, nth, fields, cut):
    """The fuzz's invariant: what arrives undamaged arrives in order, or a ProtocolError says why not."""
    with memory_wire() as wire:

        def damage(raw: bytes) -> list[bytes]:
            return [renumbered(raw, **fields)[:cut]]

        talk = Talk(wire, left=Meddler(wire.ends[0], kind, nth, damage))
        try:
            for number in range(3 * WINDOW):
                talk.links[0].send_data(PACKETS, 1, number.to_bytes(4, "little"))
                if number % WINDOW == 0:
                    talk.links[0].send_order(DOWN, {"number": number})
                for end in (0, 1):
                    talk.turn(end)
            for link in talk.links:
                link.close()
            for _ in range(10):
                for end in (0, 1):
                    talk.turn(end)
        except ProtocolError:
            pass
        data = [p for a, p in zip(talk.heard[1], payloads(talk.heard[1]), strict=True) if len(p) == 4]
        untouched = [p for p in data if int.from_bytes(p, "little") < 3 * WINDOW]
        assert untouched == sorted(untouched, key=lambda p: int.from_bytes(p, "little"))


# --- ZeroMQ alone --------------------------------------------------------------------------------


def test_several_parts_are_refused():
    with zeromq_wire() as wire:
        talk = Talk(wire).up()
        wire.ends[1].socket.send_multipart([message(PACKETS, bytes(SIZE), 1, 2), b"more"])
        with pytest.raises(ProtocolError, match=r"ipc://.*: a message of several parts came, wanted one"):
            received(wire, talk.links[0])


def test_a_message_above_the_limit_never_arrives():
    with zeromq_wire() as wire:
        talk = Talk(wire).up()
        left = wire.ends[0].socket
        monitor = left.get_monitor_socket(zmq.EVENT_DISCONNECTED)
        wire.ends[1].socket.send(bytes(MAX_MESSAGE + 1))
        assert monitor.poll(20_000), "the connection was not cut"
        left.disable_monitor()
        monitor.close(0)
        assert talk.links[0].receive() is None


def test_the_largest_message_arrives(wire):
    talk = Talk(wire).up()
    talk.links[0].send_data(PACKETS, 1, bytes(MAX_MESSAGE - HEAD))
    talk.until(lambda: bool(talk.heard[1]), "the message")
    assert len(talk.heard[1][0].message) == MAX_MESSAGE


def test_a_full_socket_says_so_and_blocks_not():
    context: zmq.Context = zmq.Context(io_threads=1)
    pair = ZmqChannel(context, "inproc://nobody", bind=True)
    try:
        assert pair.send(b"x") is False
        assert pair.receive() is None
    finally:
        pair.close()
        context.destroy(linger=0)


def test_both_kinds_of_end_are_channels():
    for made in (MemoryChannel, ZmqChannel):
        assert all(callable(getattr(made, name)) for name in ("send", "receive", "close"))
