"""Streams of bytes are cut into the messages that were put behind their lengths, however the stream is cut."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from raygrid.node.errors import ProtocolError
from raygrid.node.protocol.framing import LENGTH, Splitter, framed


@given(st.lists(st.binary(max_size=20), max_size=5), st.integers(1, 30))
def test_what_was_framed_comes_out_as_it_was(bodies, piece):
    stream = b"".join(map(framed, bodies))
    splitter, found = Splitter(bytes, 20), []
    for at in range(0, len(stream), piece):
        splitter.feed(stream[at : at + piece])
        found += iter(splitter.next, None)
    assert found == bodies
    assert splitter.held == 0


def test_a_length_is_looked_at_before_the_body_is_there():
    splitter = Splitter(bytes, 20)
    splitter.feed(LENGTH.pack(21))
    with pytest.raises(ProtocolError, match=r"^a message of 21 bytes came, wanted at most 20$"):
        splitter.next()


def test_a_body_that_cannot_be_read_is_behind_us():
    def read(body):
        if body == b"bad":
            raise ProtocolError("bad")
        return body

    splitter = Splitter(read, 20)
    splitter.feed(framed(b"bad") + framed(b"good"))
    with pytest.raises(ProtocolError, match=r"^bad$"):
        splitter.next()
    assert splitter.next() == b"good"
