"""Messages: exact bytes both ways. The fuzz's invariant: a valid value or a ProtocolError, nothing else."""

from __future__ import annotations

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cases import steady
from support.messages import message, orders, random_batch, same_batch, surfaces_message

from raygrid.node.errors import ProtocolError
from raygrid.node.geometry.surfaces import Batch, Kind
from raygrid.node.protocol.codec import DEEPEST, MOST_MAP_ITEMS
from raygrid.node.protocol.messages import (
    HEAD,
    HEADER,
    MAX_MESSAGE,
    SUMMED,
    MessageKind,
    check_packets,
    is_whole,
    pack_message,
    pack_order,
    pack_surfaces,
    read_header,
    read_order,
    read_surfaces,
    seal,
)
from raygrid.node.protocol.packets import SIZE

KINDS = list(MessageKind)

# --- golden bytes --------------------------------------------------------------------------------

HEADERS = {
    MessageKind.HELLO: ((0, 0, 0, 0), "01 00 0000 00000000 00000000 00000000 ac7f3e30"),
    MessageKind.ACK: ((1, 1, 0, 0), "02 00 0100 01000000 00000000 00000000 b58d9b96"),
    MessageKind.PACKETS: (
        (0x0201, 0x06050403, 0x0A090807, 0x0E0D0C0B),
        "03 00 0102 03040506 0708090a 0b0c0d0e 30c95f5e",
    ),
    MessageKind.SURFACES: ((65535, 2**32 - 1, 2**32 - 1, 2**32 - 1), "04 00 ffff ffffffff ffffffff ffffffff 4da10277"),
    MessageKind.DOWN: ((0, 2, 3, 0), "05 00 0000 02000000 03000000 00000000 51226752"),
    MessageKind.UP: ((0, 2, 3, 0), "06 00 0000 02000000 03000000 00000000 ac0661a1"),
    MessageKind.CREDIT: ((0, 9, 16, 0), "07 00 0000 09000000 10000000 00000000 c059b615"),
    MessageKind.BYE: ((7, 256, 0, 0), "08 00 0700 00010000 00000000 00000000 cc973c2d"),
    MessageKind.BYE_ACK: ((7, 257, 0, 0), "09 00 0700 01010000 00000000 00000000 51adfc5a"),
    MessageKind.STAMPED: ((1, 3, 2, 5), "0a 00 0100 03000000 02000000 05000000 120b279f"),
    MessageKind.LOOKAHEAD: ((1, 4, 2, 0), "0b 00 0100 04000000 02000000 00000000 cb331f7f"),
    MessageKind.REDUCE: ((2, 5, 7, 0), "0c 00 0200 05000000 07000000 00000000 517b8c1e"),
    MessageKind.REDUCED: ((2, 6, 7, 0), "0d 00 0200 06000000 07000000 00000000 320acc9a"),
}


def test_there_is_a_golden_header_for_every_kind():
    assert set(HEADERS) == set(KINDS)


@pytest.mark.parametrize("kind", KINDS)
def test_a_header_is_these_bytes_both_ways(kind):
    (epoch, sequence, credit, count), golden = HEADERS[kind]
    raw = bytes.fromhex(golden)
    assert len(raw) == HEAD
    assert message(kind, b"", count, sequence, credit, epoch) == raw
    assert read_header(raw) == (kind, epoch, sequence, credit, count)


def test_an_order_is_these_bytes_both_ways():
    raw = bytes.fromhex("82 a2646f a57472616365 a571756f7461 cd0400")
    assert pack_order({"do": "trace", "quota": 1024}) == raw
    assert read_order(message(MessageKind.DOWN, raw)) == {"do": "trace", "quota": 1024}


F32, F64 = "0000003f", "000000000000e03f"  # a half
SURFACES = {
    # corner, kind, zero, surfaces, points; ids; materials; (polygons: points each); numbers
    Kind.TRIANGLE: "03 00 0000 01000000 00000000  07000000  0201" + 9 * F32,
    Kind.SMOOTH: "03 01 0000 01000000 00000000  07000000  0201" + 18 * F32,
    Kind.POLYGON: "03 02 0000 01000000 04000000  07000000  0201  04000000" + 12 * F64,
    Kind.SPHERE: "03 03 0000 01000000 00000000  07000000  0201" + 4 * F64,
    Kind.CYLINDER: "03 04 0000 01000000 00000000  07000000  0201" + 8 * F64,
    Kind.CONE: "03 05 0000 01000000 00000000  07000000  0201" + 8 * F64,
}


@pytest.mark.parametrize("kind", list(Kind))
def test_a_surface_is_these_bytes_both_ways(kind):
    raw = bytes.fromhex(SURFACES[kind])
    corner, read = read_surfaces(message(MessageKind.SURFACES, raw, 1), 1)
    assert corner == 3
    assert (read.kind, read.ids.tolist(), read.materials.tolist()) == (kind, [7], [0x0102])
    assert np.all(read.data == 0.5)
    assert read.starts.tolist() == ([0, 4] if kind == Kind.POLYGON else [])
    assert pack_surfaces(3, read) == raw


@pytest.mark.parametrize("kind", list(Kind))
@pytest.mark.parametrize("corner", [0, 7])
def test_surfaces_come_out_as_they_went_in(kind, corner):
    batch = random_batch(kind, 37)
    came_from, read = read_surfaces(surfaces_message(batch, corner), 37)
    assert came_from == corner
    assert same_batch(read, batch)


@given(orders)
def test_orders_come_out_as_they_went_in(order):
    assert read_order(message(MessageKind.DOWN, pack_order(order))) == order


# --- what is refused -----------------------------------------------------------------------------


@pytest.mark.parametrize("length", [0, 1, HEAD - 1, MAX_MESSAGE + 1])
def test_a_message_of_a_wrong_length_is_refused(length):
    with pytest.raises(ProtocolError, match=f"a message came with {length} bytes, wanted {HEAD} to {MAX_MESSAGE}"):
        read_header(bytes(length))


@pytest.mark.parametrize(("kind", "zero"), [(0, 0), (14, 0), (255, 0), (3, 1)])
def test_a_header_of_no_known_kind_is_refused(kind, zero):
    with pytest.raises(ProtocolError, match="wanted a known kind and a zero byte"):
        read_header(message(kind, zero=zero))


@pytest.mark.parametrize(
    ("size", "count"), [(0, 0), (0, 1), (SIZE, 0), (SIZE, 2), (SIZE - 1, 1), (SIZE + 1, 1), (50, 2**32 - 1)]
)
def test_packets_that_are_not_as_long_as_they_say_are_refused(size, count):
    with pytest.raises(ProtocolError, match=f"^{count} packets came in {size} bytes, wanted {25 * count}"):
        check_packets(message(MessageKind.PACKETS, bytes(size), count), count)


def test_packets_as_long_as_they_say_are_taken():
    for count in (1, 2, 1024):
        check_packets(message(MessageKind.PACKETS, bytes(count * SIZE), count), count)


@pytest.mark.parametrize(
    ("payload", "said"),
    [
        (b"", "cannot be read"),
        (b"\xc1", "cannot be read"),  # the one byte that msgpack never uses
        (msgpack.packb({"do": "end"}) + b"\x00", "cannot be read"),  # rubbish after it
        (msgpack.packb({"do": "end"})[:-1], "cannot be read"),
        (msgpack.packb({1: 2}), "cannot be read"),
        (msgpack.packb({b"do": "end"}), "wanted string keys"),
        (msgpack.packb({"do": {b"x": 1}}), "wanted string keys"),
        (msgpack.packb(7), "came as int, wanted a map"),
        (msgpack.packb([{"do": "end"}]), "came as list, wanted a map"),
        (msgpack.packb({"at": msgpack.Timestamp(1, 2)}), "cannot be read"),
        (msgpack.packb({"x": msgpack.ExtType(5, b"y")}), "cannot be read"),
        (b"\x81\xa1x\xa2\xff\xff", "cannot be read"),  # not UTF-8
        (b"\x81\xa1x\xdd\xff\xff\xff\xff", "cannot be read"),  # a list of four thousand million things
        (b"\xdf\xff\xff\xff\xff", "cannot be read"),
        (b"\x81\xa1x\xc6\xff\xff\xff\xff", "cannot be read"),
        (msgpack.packb({"x": [0] * (MOST_MAP_ITEMS + 1)}), "cannot be read"),
        (b"\x81\xa1x" + b"\x91" * 900 + b"\x00", "deeper than"),
        (b"\x81\xa1x" + b"\x91" * 5000 + b"\x00", "cannot be read"),
        (b"\x81\xa1x" * 300_000 + b"\x00", "cannot be read"),
    ],
)
def test_an_order_that_is_none_is_refused(payload, said):
    with pytest.raises(ProtocolError, match=said):
        read_order(message(MessageKind.DOWN, payload))


def test_orders_may_be_so_deep_and_no_deeper():
    order: object = 1
    for _ in range(DEEPEST):
        order = {"x": order}
    assert read_order(message(MessageKind.DOWN, pack_order(order))) == order
    with pytest.raises(ProtocolError, match="deeper than"):
        read_order(message(MessageKind.DOWN, pack_order({"x": order})))


def test_what_is_too_long_for_a_message_is_not_sent():
    with pytest.raises(ProtocolError, match="wanted at most"):
        pack_order({"x": bytes(MAX_MESSAGE)})
    points = MAX_MESSAGE // 24 + 1
    huge = Batch(
        Kind.POLYGON, np.zeros(1, np.uint32), np.zeros(1, np.uint16), np.zeros((points, 3)), np.array([0, points])
    )
    with pytest.raises(ProtocolError, match="wanted at most"):
        pack_surfaces(0, huge)


def _with(raw: bytes, at: int, new: bytes) -> bytes:
    return raw[:at] + new + raw[at + len(new) :]


@pytest.mark.parametrize("kind", list(Kind))
def test_surfaces_that_are_not_as_they_say_are_refused(kind):
    good = surfaces_message(random_batch(kind, 3))
    for bad, count, said in (
        (good[: HEAD + 5], 3, "came in 5 bytes, wanted"),
        (good[:-1], 3, "came in"),
        (good + b"\x00", 3, "came in"),
        (good, 2, "3 of 2"),
        (good, 0, "3 of 0"),
        (_with(good, HEAD, b"\x09"), 3, "corner 9"),
        (_with(good, HEAD + 1, b"\x07"), 3, "kind 7"),
        (_with(good, HEAD + 2, b"\x01"), 3, "surfaces came with"),
        (_with(good, HEAD + 4, b"\xff\xff\xff\xff"), 2**32 - 1, "came in"),
        (_with(good, HEAD + 8, b"\xff\xff\xff\xff"), 3, "came in"),
        (_with(good, len(good) - 8, b"\xff" * 8), 3, "beyond the world box"),  # no numbers
        (_with(good, len(good) - 8, b"\x00\x00\x80\x7f\x00\x00\xf0\x7f"), 3, "beyond the world box"),  # infinite
        (_with(good, len(good) - 8, b"\x01\x00\x80\x7f\x01\x00\xf0\x7f"), 3, "beyond the world box"),  # signalling
        (_with(good, len(good) - 8, b"\x00\x00\x80\x4f\x00\x00\x80\x4f"), 3, "beyond the world box"),
    ):
        with pytest.raises(ProtocolError, match=said):
            read_surfaces(bad, count)


def test_polygons_whose_points_do_not_add_up_are_refused():
    good = surfaces_message(random_batch(Kind.POLYGON, 2))
    at = HEAD + 12 + 2 * 6
    first, second = (int.from_bytes(good[at + 4 * k : at + 4 * k + 4], "little") for k in range(2))
    for sizes in ((first + 1, second), (2, first + second - 2), (0, first + second), (2**32 - 1, first + second + 1)):
        bad = _with(good, at, b"".join(size.to_bytes(4, "little") for size in sizes))
        with pytest.raises(ProtocolError, match="polygons came with"):
            read_surfaces(bad, 2)


# --- fuzz ----------------------------------------------------------------------------------------


def read_all(raw: bytes) -> None:
    """Read a message as each kind; each gives a value or a ProtocolError."""
    try:
        header = read_header(raw)
    except ProtocolError:
        return
    numbers = (int(header.kind), 0, header.epoch, header.sequence, header.credit, header.items)
    assert HEADER.pack(*numbers, 0)[:SUMMED] == raw[:SUMMED]
    _read_order(raw)
    _read_surfaces(raw, header.items)
    try:
        check_packets(raw, header.items)
    except ProtocolError:
        return
    assert len(raw) == HEAD + SIZE * header.items


def _read_order(raw: bytes) -> None:
    try:
        order = read_order(raw)
    except ProtocolError:
        return
    assert all(type(key) is str for key in order)
    pack_order(order)  # so it can be handed on


def _read_surfaces(raw: bytes, count: int) -> None:
    try:
        corner, batch = read_surfaces(raw, count)
    except ProtocolError:
        return
    assert np.all(np.isfinite(batch.data))
    assert np.all(np.isfinite(batch.bounds()))
    assert pack_surfaces(corner, batch) == raw[HEAD:]
    assert same_batch(batch.select(np.ones(len(batch), np.bool_)), batch)


@steady(300)
@given(st.binary(max_size=200), st.sampled_from(KINDS), st.integers(0, 5))
def test_random_bytes_are_read_or_refused(payload, kind, count):
    read_all(payload)
    read_all(message(kind, payload, count))


@st.composite
def damaged(draw: st.DrawFn) -> bytes:
    """Good messages of all sorts with bytes changed, cut off, put in, or doubled."""
    sort = draw(st.sampled_from(["surfaces", "order", "packets"]))
    count = draw(st.integers(1, 3))
    if sort == "surfaces":
        raw = surfaces_message(random_batch(draw(st.sampled_from(list(Kind))), count), draw(st.integers(0, 7)))
    elif sort == "order":
        raw = message(MessageKind.DOWN, pack_order(draw(orders)))
    else:
        raw = message(MessageKind.PACKETS, draw(st.binary(min_size=SIZE, max_size=SIZE)) * count, count)
    data = bytearray(raw)
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.integers(0, max(len(data) - 1, 0)))
        how = draw(st.sampled_from(["flip", "byte", "cut", "insert", "word", "end"]))
        if how == "flip" and data:
            data[at] ^= 1 << draw(st.integers(0, 7))
        elif how == "byte" and data:
            data[at] = draw(st.sampled_from([0, 1, 0x7F, 0x80, 0xC1, 0xDD, 0xFF]))
        elif how == "cut":
            del data[at : at + draw(st.integers(1, 30))]
        elif how == "insert":
            data[at:at] = draw(st.binary(min_size=1, max_size=8))
        elif how == "word":
            data[at : at + 4] = draw(st.sampled_from([b"\xff\xff\xff\xff", b"\x00\x00\xc0\x7f", b"\x00\x00\x00\x80"]))
        else:
            del data[at:]
    return bytes(data)


@steady(1500)
@given(damaged())
def test_damaged_messages_are_read_or_refused(raw):
    read_all(raw)


@pytest.mark.parametrize("kind", list(Kind))
def test_every_cut_of_a_surfaces_message_is_refused(kind):
    raw = surfaces_message(random_batch(kind, 2))
    for length in range(HEAD, len(raw)):
        with pytest.raises(ProtocolError):
            read_surfaces(raw[:length], 2)


def test_every_flip_of_a_bit_in_the_heads_is_read_or_refused():
    for kind in Kind:
        raw = surfaces_message(random_batch(kind, 2))
        for bit in range(8 * (HEAD + 12 + 24)):
            data = bytearray(raw)
            data[bit >> 3] ^= 1 << (bit & 7)
            read_all(bytes(data))


@pytest.mark.parametrize("kind", list(Kind))
def test_every_flip_of_a_bit_and_every_cut_is_seen_in_the_checksum(kind):
    raw = surfaces_message(random_batch(kind, 2))
    assert is_whole(raw)
    for bit in range(8 * len(raw)):
        data = bytearray(raw)
        data[bit >> 3] ^= 1 << (bit & 7)
        assert not is_whole(bytes(data))
    assert not any(is_whole(raw[:length]) for length in range(HEAD, len(raw)))
    assert not is_whole(raw + b"\0")


def test_a_message_made_whole_and_one_sealed_in_place_are_the_same():
    raw = pack_message(3, 1, 2, 3, 4, b"payload")
    assert is_whole(raw)
    row = np.frombuffer(raw, np.uint8).copy()
    row[SUMMED:HEAD] = 0
    seal(row.data)
    assert row.tobytes() == raw
