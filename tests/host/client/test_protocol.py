"""Messages between clients and an array that stays: cut right wherever they are torn, and nothing else is let through."""

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cases import steady

from raygrid.host.client.protocol import DEEPEST, LONGEST, MOST_ITEMS, message_splitter, pack, unpack, unsendable
from raygrid.node.errors import ProtocolError
from raygrid.node.protocol.framing import LENGTH

plain = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(1 << 63), (1 << 64) - 1)
    | st.floats(allow_nan=False)
    | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=8,
).map(lambda value: {"value": value})


def depth(value):
    if not isinstance(value, dict | list):
        return 0
    return 1 + max((depth(inner) for inner in (value.values() if isinstance(value, dict) else value)), default=0)


@steady(100)
@given(st.lists(plain, max_size=5), st.lists(st.integers(1, 50), min_size=1))
def test_messages_come_out_as_they_went_in_however_the_stream_is_torn(messages, sizes):
    messages = [message for message in messages if depth(message) <= DEEPEST]
    stream = b"".join(map(pack, messages))
    splitter, found, at, turn = message_splitter(), [], 0, 0
    while at < len(stream):
        size = sizes[turn % len(sizes)]
        splitter.feed(stream[at : at + size])
        at, turn = at + size, turn + 1
        while (message := splitter.next()) is not None:
            found.append(message)
    assert found == messages
    assert splitter.held == 0


@steady(500)
@given(st.binary(max_size=60))
def test_any_bytes_are_a_message_or_a_protocol_error(body):
    try:
        message = unpack(body)
    except ProtocolError:
        return
    assert isinstance(message, dict)
    assert depth(message) <= DEEPEST


@pytest.mark.parametrize(
    ("value", "pattern"),
    [
        ([1], "came as list"),
        (7, "came as int"),
        ({1: 2}, "cannot be read"),
        ({b"k": 2}, "cannot be read"),
        ({b"": 2}, "came with keys that are bytes, wanted string keys"),
        ({"k": b"bytes"}, "cannot be read"),
        ({"k": b""}, "wanted plain text"),
        ({"k": msgpack.ExtType(5, b"x")}, "cannot be read"),
        ({"k": msgpack.Timestamp(1)}, "cannot be read"),
        ({"k": [0] * (MOST_ITEMS + 1)}, "cannot be read"),
        ({"a": {"a": {"a": {"a": {"a": {"a": {}}}}}}}, f"deeper than {DEEPEST}"),
        ({"a": [[[[[[[[]]]]]]]]}, f"deeper than {DEEPEST}"),
    ],
)
def test_what_is_no_plain_map_is_refused(value, pattern):
    with pytest.raises(ProtocolError, match=pattern):
        unpack(msgpack.packb(value, use_bin_type=True))


@pytest.mark.parametrize(
    "body", [b"", b"\xc1", b"\x81", b"\x80\x80", b"\xdf\xff\xff\xff\xff", b"\x81\xa1k" + b"\x91" * 5000]
)
def test_what_is_no_msgpack_is_refused(body):
    with pytest.raises(ProtocolError, match=r"cannot be read|deeper"):
        unpack(body)


def test_a_length_beyond_the_longest_is_refused_before_the_message_has_come():
    splitter = message_splitter(longest=100)
    splitter.feed(LENGTH.pack(101))
    with pytest.raises(ProtocolError, match="a message of 101 bytes came, wanted at most 100"):
        splitter.next()


def test_a_message_that_is_too_long_is_not_sent():
    with pytest.raises(ProtocolError, match="was to be sent"):
        pack({"k": "x" * LONGEST})


def test_text_that_is_no_utf_8_is_refused_or_escaped():
    path = "/tmp/\udcff.png"
    with pytest.raises(ProtocolError, match=r"a message cannot be sent: .*surrogates"):
        pack({"path": path})
    assert unpack(pack({"path": path}, escape=True)[4:]) == {"path": "/tmp/\\udcff.png"}
    assert unsendable({"path": path}) == f"path came as {path!r}, wanted a name in UTF-8"


keys = st.text(st.characters(), max_size=4) | st.integers()


@given(st.dictionaries(keys, plain | st.binary(max_size=3) | st.integers() | st.text(st.characters()), max_size=4))
def test_what_is_not_said_to_be_unsendable_comes_back_as_it_was(message):
    if unsendable(message):
        assert unsendable(message).isprintable()
    else:
        assert unpack(pack(message)[4:]) == message
