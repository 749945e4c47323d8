"""One contract for links, kept over queues in memory and over ZeroMQ PAIR sockets alike."""

from __future__ import annotations

import random

import numpy as np
import pytest
from support.links import (
    LEFT,
    RIGHT,
    Meddler,
    Narrow,
    Swapper,
    Talk,
    Watched,
    payloads,
    received,
    wire,
)
from support.messages import message

from raygrid.node.errors import ProtocolError
from raygrid.node.links.link import (
    Link,
    LinkPhase,
)
from raygrid.node.protocol.messages import HEAD, VERSION, WINDOW, MessageKind, pack_order, read_header, read_order
from raygrid.node.protocol.packets import SIZE

__all__ = ["wire"]

PACKETS, SURFACES, DOWN, UP = MessageKind.PACKETS, MessageKind.SURFACES, MessageKind.DOWN, MessageKind.UP
HELLO, ACK, CREDIT = MessageKind.HELLO, MessageKind.ACK, MessageKind.CREDIT
BYE, BYE_ACK = MessageKind.BYE, MessageKind.BYE_ACK

# --- meeting -------------------------------------------------------------------------------------


def test_both_ends_are_up_after_hello_and_ack(wire):
    talk = Talk(wire)
    assert [link.state for link in talk.links] == [LinkPhase.NEW, LinkPhase.NEW]
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
    assert link.state is LinkPhase.NEW


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
    with pytest.raises(ProtocolError, match=r"^link left: HELLO came as .* wanted .* of this machine$") as caught:
        received(wire, link)
    assert link.state is LinkPhase.NEW
    assert "'m'" not in str(caught.value)  # a stranger who knew that name could pass for a neighbour
    assert ("of another machine, " in str(caught.value)) == (said.get("machine") != "m")


@pytest.mark.parametrize("kind", [kind for kind in MessageKind if kind != HELLO])
def test_nothing_is_taken_before_hello(wire, kind):
    link = Link(wire.ends[0], "left", 0, LEFT, RIGHT)
    wire.ends[1].send(message(kind, bytes(SIZE), 1))
    with pytest.raises(ProtocolError, match=f"link left: {kind.name} came before HELLO"):
        received(wire, link)


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
        received(wire, link, until=lambda arrival: False)


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
    assert talk.links[1].state is LinkPhase.UP


def test_numbers_run_over_their_end(wire):
    talk = Talk(wire).up()
    for link in talk.links:
        link._counted.sent = link._counted.received = 2**32 - 5
        for counter in ("data_sent", "credit", "data_done", "data_told"):
            setattr(link._counted, counter, 2**32 - 50)
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
        received(wire, talk.links[0])


def _flipped(at: int):
    return lambda raw: [raw[:at] + bytes([raw[at] ^ 64]) + raw[at + 1 :]]


@pytest.mark.parametrize(
    "damage", [_flipped(2), _flipped(5), _flipped(9), _flipped(17), _flipped(30), lambda raw: [raw[:-1]]]
)
def test_what_was_changed_on_its_way_is_refused(wire, damage):
    talk = Talk(wire, left=Meddler(wire.ends[0], PACKETS, 2, damage, sealed=False)).up()
    for number in range(3):
        talk.links[0].send_data(PACKETS, 1, bytes([number]) * SIZE)
    with pytest.raises(ProtocolError, match="another checksum than its own: it was changed or cut on its way"):
        talk.until(lambda: False, "an error")
    assert payloads(talk.heard[1]) == [bytes(SIZE)]


@pytest.mark.parametrize("raw", [b"", b"hello", bytes(HEAD), b"\xff" * 40])
def test_rubbish_is_refused(wire, raw):
    talk = Talk(wire).up()
    wire.ends[1].send(raw)
    with pytest.raises(ProtocolError):
        received(wire, talk.links[0])


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
