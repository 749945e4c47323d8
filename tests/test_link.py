"""One contract for links, kept over queues in memory and over ZeroMQ PAIR sockets alike."""

from __future__ import annotations

import random
from collections.abc import Iterator

import numpy as np
import pytest
import zmq
from hypothesis import given
from hypothesis import strategies as st
from support_cases import steady
from support_links import (
    LEFT,
    RIGHT,
    WIRES,
    Meddler,
    Narrow,
    Swapper,
    Talk,
    Watched,
    Wire,
    memory_wire,
    renumbered,
    zeromq_wire,
)
from support_messages import message

from raygrid.node.errors import ProtocolError
from raygrid.node.link import Link, State
from raygrid.node.memory_pair import MemoryPair, memory_pair
from raygrid.node.messages import MAX_MESSAGE, VERSION, WINDOW, MessageKind, pack_order, read_header, read_order
from raygrid.node.packets import SIZE
from raygrid.node.pair import Pair
from raygrid.node.step import HEAD

PACKETS, SURFACES, DOWN, UP = MessageKind.PACKETS, MessageKind.SURFACES, MessageKind.DOWN, MessageKind.UP
HELLO, ACK, CREDIT, BYE, BYE_ACK = (
    MessageKind.HELLO,
    MessageKind.ACK,
    MessageKind.CREDIT,
    MessageKind.BYE,
    MessageKind.BYE_ACK,
)


@pytest.fixture(params=list(WIRES))
def wire(request: pytest.FixtureRequest) -> Iterator[Wire]:
    """Each transport in turn."""
    with WIRES[request.param]() as made:
        yield made


def payloads(arrivals) -> list[bytes]:
    """What came behind the headers."""
    return [arrival.message[HEAD:] for arrival in arrivals]


# --- meeting -------------------------------------------------------------------------------------


def test_both_ends_are_up_after_hello_and_ack(wire):
    talk = Talk(wire)
    assert [link.state for link in talk.links] == [State.NEW, State.NEW]
    talk.up()
    assert talk.heard == ([], [])
    assert not any(link.waiting or link.choked or link.peer_left for link in talk.links)


def test_hello_says_who_and_ack_follows(wire):
    link = Link(wire.ends[0], "left", 5, LEFT, RIGHT)
    while link.messages_sent < 1:
        link.push()  # there may be nobody at the other end yet
        wire.wait()
    hello = wire.next(1)
    assert read_header(hello) == (HELLO, 5, 0, 0, 0)
    assert read_order(hello) == {**LEFT, "version": VERSION}
    wire.ends[1].send(message(HELLO, pack_order({**RIGHT, "version": VERSION}), epoch=5))
    while link.messages_sent < 2:
        assert link.receive() is None
        wire.wait()
    assert read_header(wire.next(1)) == (ACK, 5, 1, 0, 0)
    assert link.state is State.NEW


@pytest.mark.parametrize(
    "said",
    [
        {**RIGHT, "version": VERSION + 1},
        {**RIGHT, "version": VERSION, "machine": "another"},
        {**RIGHT, "version": VERSION, "node": [1, 0, 1]},
        {**RIGHT, "version": VERSION, "port": 1},
        {**RIGHT, "version": VERSION, "more": 1},
        RIGHT,
        {},
    ],
)
def test_a_stranger_is_refused(wire, said):
    link = Link(wire.ends[0], "left", 0, LEFT, RIGHT)
    wire.ends[1].send(message(HELLO, pack_order(said)))
    with pytest.raises(ProtocolError, match=r"^link left: HELLO came as .* wanted .*'machine': 'm'"):
        _receive(wire, link)
    assert link.state is State.NEW


def _receive(wire: Wire, link: Link, until=lambda arrival: True):
    """Wait until a link hands out what is wanted, or refuses what came."""
    for _ in range(100):
        arrival = link.receive()
        if arrival is not None and until(arrival):
            return arrival
        link.push()
        wire.wait()
    pytest.fail("nothing came")


@pytest.mark.parametrize("kind", [kind for kind in MessageKind if kind != HELLO])
def test_nothing_is_taken_before_hello(wire, kind):
    link = Link(wire.ends[0], "left", 0, LEFT, RIGHT)
    wire.ends[1].send(message(kind, bytes(SIZE), 1))
    with pytest.raises(ProtocolError, match=f"link left: {kind.name} came before HELLO"):
        _receive(wire, link)


HELLO_OF_RIGHT = message(HELLO, pack_order({**RIGHT, "version": VERSION}))


@pytest.mark.parametrize(
    ("script", "said"),
    [
        ([HELLO], "HELLO came a second time"),
        ([ACK, ACK], "ACK came a second time"),
        ([PACKETS], "PACKETS came before ACK"),
        ([SURFACES], "SURFACES came before ACK"),
        ([ACK, BYE_ACK], "BYE_ACK came without a BYE to answer"),
        ([ACK, BYE, BYE], "BYE came after BYE"),
        ([ACK, BYE, PACKETS], "PACKETS came after BYE"),
        ([ACK, BYE, DOWN], "DOWN came after BYE"),
        ([ACK, BYE, CREDIT], "CREDIT came after BYE"),
    ],
)
def test_what_may_not_come_in_a_state_is_refused(wire, script, said):
    link = Link(wire.ends[0], "left", 0, LEFT, RIGHT)
    wire.ends[1].send(HELLO_OF_RIGHT)
    for sequence, kind in enumerate(script, 1):
        payload = HELLO_OF_RIGHT[HEAD:] if kind == HELLO else bytes(SIZE)
        wire.ends[1].send(message(kind, payload, 1, sequence))
    with pytest.raises(ProtocolError, match=f"link left: {said}"):
        _receive(wire, link, until=lambda arrival: False)


def test_an_order_may_come_before_the_link_is_up_but_not_data(wire):
    watched = Watched(wire.ends[0])
    talk = Talk(wire, left=watched)
    talk.links[0].send_data(PACKETS, 1, bytes(SIZE))
    talk.links[0].send_order(DOWN, {"do": "ready"})
    assert watched.data == 0
    talk.until(lambda: len(talk.heard[1]) == 2, "both messages")
    assert [arrival.kind for arrival in talk.heard[1]] == [DOWN, PACKETS]


# --- order and numbers ---------------------------------------------------------------------------


def test_messages_come_whole_and_in_order_both_ways(wire):
    talk, rng = Talk(wire).up(), random.Random(1)
    sent: tuple[list[bytes], list[bytes]] = ([], [])
    for number in range(300):
        for end, link in enumerate(talk.links):
            payload = number.to_bytes(4, "little") * rng.choice([1, 25, 1000])
            link.send_data(PACKETS if rng.random() < 0.7 else SURFACES, 1, payload)
            sent[end].append(payload)
        if rng.random() < 0.2:
            talk.turn(rng.randrange(2))
    talk.until(lambda: all(len(heard) == 300 for heard in talk.heard), "all messages")
    assert payloads(talk.heard[1]) == sent[0]
    assert payloads(talk.heard[0]) == sent[1]


def test_orders_overtake_data_without_credit_and_stay_in_order(wire):
    talk = Talk(wire).up()
    talk.grants = False
    for number in range(WINDOW + 5):
        talk.links[0].send_data(PACKETS, 1, bytes([number]))
    for number in range(10):
        talk.links[0].send_order(DOWN, {"number": number})
    assert talk.links[0].waiting == 5
    talk.until(lambda: len(talk.heard[1]) == WINDOW + 10, "all that has credit")
    orders = [read_order(arrival.message)["number"] for arrival in talk.heard[1] if arrival.kind == DOWN]
    assert orders == list(range(10))
    talk.links[1].grant(WINDOW)
    talk.until(lambda: len(talk.heard[1]) == WINDOW + 15, "the rest")


def doubled(raw: bytes) -> list[bytes]:
    """The same message twice."""
    return [raw, raw]


def lost(raw: bytes) -> list[bytes]:
    """Nothing."""
    return []


@pytest.mark.parametrize("what", [lost, doubled])
@pytest.mark.parametrize("nth", [1, 3])
def test_a_lost_or_doubled_message_is_noticed(wire, what, nth):
    talk = Talk(wire, left=Meddler(wire.ends[0], PACKETS, nth, what)).up()
    for _ in range(4):
        talk.links[0].send_data(PACKETS, 1, bytes(SIZE))
    with pytest.raises(ProtocolError, match=r"link right: message \d+ \(PACKETS\) came, wanted \d+: messages"):
        talk.until(lambda: False, "an error")
    assert len(talk.heard[1]) == (nth if what is doubled else nth - 1)


def test_messages_out_of_order_are_noticed(wire):
    talk = Talk(wire, left=Swapper(wire.ends[0], PACKETS, 2)).up()
    for number in range(4):
        talk.links[0].send_data(PACKETS, 1, bytes([number]))
    with pytest.raises(ProtocolError, match="lost, doubled or out of order"):
        talk.until(lambda: False, "an error")
    assert payloads(talk.heard[1]) == [b"\x00"]


def test_a_lost_order_is_noticed_by_the_next_message(wire):
    talk = Talk(wire, left=Meddler(wire.ends[0], DOWN, 1, lost)).up()
    talk.links[0].send_order(DOWN, {})
    talk.links[0].send_data(PACKETS, 1, bytes(SIZE))
    with pytest.raises(ProtocolError, match="wanted"):
        talk.until(lambda: False, "an error")


def test_a_message_of_another_epoch_is_counted_and_dropped(wire):
    talk = Talk(wire, epoch=3).up()
    for epoch in (2, 4, 0):
        wire.ends[0].send(message(PACKETS, b"old", 1, sequence=77, epoch=epoch))
        wire.ends[0].send(message(BYE, epoch=epoch))
    talk.links[0].send_data(PACKETS, 1, b"new")
    talk.until(lambda: bool(talk.heard[1]), "the new message")
    assert payloads(talk.heard[1]) == [b"new"]
    assert talk.links[1].stale == 6
    assert talk.links[1].state is State.UP


def test_numbers_run_over_their_end(wire):
    talk = Talk(wire).up()
    for link in talk.links:
        link._sent = link._received = 2**32 - 5
        link._data_sent = link._credit = link._data_done = link._data_done_told = 2**32 - 50
    for number in range(200):
        for link in talk.links:
            link.send_data(PACKETS, 1, bytes([number]))
    talk.until(lambda: all(len(heard) == 200 for heard in talk.heard), "all messages")
    assert payloads(talk.heard[0]) == [bytes([number]) for number in range(200)]


@pytest.mark.parametrize("credit", [1, 2**32 - 1, 2**31])
def test_credit_for_what_was_never_sent_is_refused(wire, credit):
    talk = Talk(wire).up()
    wire.ends[1].send(message(CREDIT, sequence=2, credit=credit))
    with pytest.raises(ProtocolError, match=f"the peer says it has processed {credit} messages, 0 were sent"):
        _receive(wire, talk.links[0])


@pytest.mark.parametrize("raw", [b"", b"hello", bytes(HEAD), b"\xff" * 40])
def test_rubbish_is_refused(wire, raw):
    talk = Talk(wire).up()
    wire.ends[1].send(raw)
    with pytest.raises(ProtocolError):
        _receive(wire, talk.links[0])


def test_what_was_sent_is_counted(wire):
    watched = Watched(wire.ends[0])
    talk = Talk(wire, left=watched)
    watched.peer = talk.links[1]
    talk.up()
    for _ in range(100):
        talk.links[0].send_data(PACKETS, 2, bytes(2 * SIZE))
    talk.links[0].send_order(DOWN, {"do": "end"})
    talk.until(lambda: len(talk.heard[1]) == 101, "all messages")
    assert talk.links[0].messages_sent == watched.messages
    assert talk.links[0].bytes_sent == watched.bytes
    assert talk.links[1].received == watched.messages
    assert talk.links[0].most_waiting >= 100 - WINDOW


# --- packets -------------------------------------------------------------------------------------


def output(packets: int) -> np.ndarray:
    """A row of outputs with room for a header, each packet filled with its own number."""
    row = np.zeros(HEAD + packets * SIZE, np.uint8)
    row[HEAD:] = np.repeat(np.arange(packets, dtype=np.uint8), SIZE)
    return row


@pytest.mark.parametrize(("batch", "sizes"), [(1, [1] * 10), (4, [4, 4, 2]), (10, [10]), (1024, [10])])
def test_packets_are_cut_into_batches(wire, batch, sizes):
    talk = Talk(wire).up()
    row = output(12)
    talk.links[0].send_packets(row, 10, batch)
    row[:] = 0xEE  # the output is filled anew while messages wait
    talk.until(lambda: sum(arrival.items for arrival in talk.heard[1]) == 10, "ten packets")
    assert [arrival.items for arrival in talk.heard[1]] == sizes
    assert b"".join(payloads(talk.heard[1])) == output(10)[HEAD:].tobytes()


def test_packets_wait_their_turn_behind_others(wire):
    talk = Talk(wire).up()
    talk.grants = False
    for number in range(WINDOW + 3):
        talk.links[0].send_packets(output(number + 1), number + 1, 1024)
    assert talk.links[0].waiting == 3
    talk.until(lambda: len(talk.heard[1]) == WINDOW, "the window")
    talk.links[1].grant(WINDOW)
    talk.until(lambda: len(talk.heard[1]) == WINDOW + 3, "the rest")
    assert [arrival.items for arrival in talk.heard[1]] == list(range(1, WINDOW + 4))


def test_packets_do_not_overtake_what_had_no_room(wire):
    room = [True]
    talk = Talk(wire, left=Narrow(wire.ends[0], lambda: room[0])).up()
    room[0] = False
    talk.links[0].send_order(DOWN, {})
    assert talk.links[0].choked
    room[0] = True
    talk.links[0].send_packets(output(1), 1, 1024)
    talk.until(lambda: len(talk.heard[1]) == 2, "both")
    assert [arrival.kind for arrival in talk.heard[1]] == [DOWN, PACKETS]


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
        wire.ends = memory_pair(room)
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
        wire.ends = memory_pair(room)
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
    assert talk.links[0].state is State.CLOSING
    assert talk.links[1].state is State.UP
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
            _receive(wire, talk.links[0])


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
    pair = Pair(context, "inproc://nobody", bind=True)
    try:
        assert pair.send(b"x") is False
        assert pair.receive() is None
    finally:
        pair.close()
        context.destroy(linger=0)


def test_both_kinds_of_end_are_channels():
    for made in (MemoryPair, Pair):
        assert all(callable(getattr(made, name)) for name in ("send", "receive", "close"))
