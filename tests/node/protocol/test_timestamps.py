"""What timed processes send beside the packets: golden bytes, and what is refused."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from raygrid.host.machine_time.cost_models import load_cost_model
from raygrid.node.errors import ProtocolError
from raygrid.node.protocol.messages import HEAD
from raygrid.node.protocol.packets import SIZE
from raygrid.node.protocol.timestamps import (
    ASK,
    LAST_TICK,
    NO,
    LookaheadRequest,
    pack_lookahead,
    pack_stamped,
    prices_order,
    read_lookahead,
    read_prices,
    read_stamped,
)

HEADER = bytes(HEAD)
ticks = st.integers(0, LAST_TICK)


def stamped(times, channel_clock=9, frame=1, packets=None):
    body = bytes(SIZE * len(times)) if packets is None else packets
    return HEADER + pack_stamped(frame, channel_clock, np.array(times, np.int64), body)


def test_golden_bytes():
    assert stamped([3, 5], 0x0201, 7)[HEAD : HEAD + 28].hex() == (
        "07000000" "0102000000000000" "0300000000000000" "0500000000000000"
    )  # fmt: skip
    request = LookaheadRequest(7, NO, (1, 2, 0x304), 5, 6, 8)
    assert pack_lookahead(request).hex() == "070000000201000200040305000000" + "0600000000000000" + "08" + "00" * 7


@given(st.lists(st.integers(0, LAST_TICK - 1), min_size=1, max_size=20), ticks)
def test_ticks_and_packets_come_out_as_they_went_in(times, channel_clock):
    times.sort()
    packets = bytes(k % 251 for k in range(SIZE * len(times)))
    message = stamped(times, channel_clock, 3, packets)
    read = read_stamped(message, len(times))
    assert (read.frame, read.channel_clock, read.ticks.tolist()) == (3, channel_clock, times)
    assert message[read.at :] == packets


@given(st.integers(ASK, NO), st.tuples(*[st.integers(0, 65535)] * 3), st.integers(0, 2**32 - 1), ticks, ticks)
def test_requests_come_out_as_they_went_in(answer, origin, number, tick, channel_clock):
    request = LookaheadRequest(2, answer, origin, number, tick, channel_clock)
    assert read_lookahead(HEADER + pack_lookahead(request)) == request


@pytest.mark.parametrize(
    ("message", "count"),
    [
        (stamped([1, 2])[:-1], 2),
        (stamped([1, 2]), 1),
        (stamped([]), 0),
        (stamped([2, 1]), 2),
        (stamped([-1]), 1),
        (stamped([LAST_TICK]), 1),
        (stamped([1], channel_clock=-1), 1),
        (stamped([1], channel_clock=LAST_TICK + 1), 1),
        (HEADER, 0),
    ],
)
def test_bad_stamps_are_refused(message, count):
    with pytest.raises(ProtocolError):
        read_stamped(message, count)


@pytest.mark.parametrize("payload", [b"", bytes(30), bytes(32)])
def test_requests_of_a_wrong_length_are_refused(payload):
    with pytest.raises(ProtocolError, match="a look-ahead request came with"):
        read_lookahead(HEADER + payload)


@pytest.mark.parametrize("change", [{"answer": 3}, {"tick": -1}, {"channel_clock": LAST_TICK + 1}])
def test_bad_lookahead_requests_are_refused(change):
    request = LookaheadRequest(1, ASK, (0, 0, 0), 1, 1, 1)._replace(**change)
    with pytest.raises(ProtocolError, match="a look-ahead request came with answer"):
        read_lookahead(HEADER + pack_lookahead(request))


@given(st.binary(max_size=200), st.integers(0, 5))
def test_any_bytes_are_a_message_or_a_protocol_error(payload, count):
    for read in (lambda: read_stamped(HEADER + payload, count), lambda: read_lookahead(HEADER + payload)):
        with contextlib.suppress(ProtocolError):
            read()


def good_order():
    model = load_cost_model("8086")
    return prices_order(model.prices("middle", "list"), model.tests("middle"))


def test_prices_come_out_as_they_went_in():
    model = load_cost_model("8086")
    found = read_prices(good_order())
    assert found is not None
    prices, tests = found
    expected = model.prices("middle", "list")
    assert (prices.counts == expected.counts).all()
    assert prices[1:] == expected[1:]
    assert (tests == model.tests("middle")).all()
    assert read_prices({"do": "frame"}) is None


@pytest.mark.parametrize(
    "change",
    [
        {"prices": b"x"},
        {"prices": 5},
        {"prices": good_order()["prices"][:-8] + b"\xff" * 8},
        {"tests": [1, 2]},
        {"tests": [1, 2, 3, 4, 5, -6]},
        {"tests": None},
        {"costs": [0, 1, 1, 0]},
        {"costs": [1, 1, 0, 0]},
        {"costs": [1, 1, 1, 2]},
        {"costs": [1.0, 1, 1, 0]},
        {"costs": [1, 10**13, 1, 0]},
    ],
)
def test_bad_prices_are_refused(change):
    with pytest.raises(ProtocolError, match="came"):
        read_prices({**good_order(), **change})
