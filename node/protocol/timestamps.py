"""Packs what timed processes send: ticks, channel clocks, look-ahead requests; and the cost model in a frame's command.

    STAMPED    frame u32, channel clock i64, ticks i64 each, then the packets of 25 bytes
    LOOKAHEAD  frame u32, answer u8, origin 3 x u16, number u32, tick i64, channel clock i64

channel clock  nothing that is sent on this link after this message arrives before this tick
answer         ASK, YES or NO (`node.timed.lookahead`); origin, number and tick are those of the request
frame          the number of the wave that began the frame; what is left of another one is dropped

Both wait for credit like all data, so that none overtakes another.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any, NamedTuple, TypeGuard

import numpy as np
from numpy.typing import NDArray

from raygrid.node.errors import ProtocolError
from raygrid.node.geometry.surfaces import Kind
from raygrid.node.protocol.counters import COUNTS, SENT
from raygrid.node.protocol.messages import HEAD
from raygrid.node.protocol.packets import SIZE

STAMP = struct.Struct("<Iq")
LOOKAHEAD = struct.Struct("<IBHHHIqq")
Long = NDArray[np.int64]
MOST_TICKS = 10**12  # of one price; no sum of them leaves 64 bits
NEVER_TICK = np.int64(1) << 62  # later than any tick
LAST_TICK = int(NEVER_TICK)
ASK, YES, NO = 0, 1, 2


class Prices(NamedTuple):
    """A cost model as kernels read it; all in ticks.

    counts        int64 (COUNTS,): for each of the counts of a step
    packet        for each packet served, 1 or more
    transmit      a packet of 25 bytes on a link, 0 or more
    latency       from the last byte sent until it can be served, 1 or more
    by_processor  1: the processor moves the bytes, 0: the link
    """

    counts: Long
    packet: int
    transmit: int
    latency: int
    by_processor: int

    @property
    def lookahead(self) -> int:
        """Nothing decided at tick t arrives anywhere before t + lookahead."""
        return int(self.packet + self.counts[SENT] + self.transmit + self.latency)


class Stamped(NamedTuple):
    """A decoded STAMPED message; `at`: where its packets begin."""

    frame: int
    channel_clock: int
    ticks: Long
    at: int


class LookaheadRequest(NamedTuple):
    """A decoded LOOKAHEAD message."""

    frame: int
    answer: int
    origin: tuple[int, int, int]
    number: int
    tick: int
    channel_clock: int


def pack_stamped(frame: int, channel_clock: int, ticks: Long, packets: bytes) -> bytes:
    """The payload of a STAMPED message."""
    return STAMP.pack(frame, channel_clock) + ticks.astype("<i8", copy=False).tobytes() + packets


def read_stamped(message: bytes, count: int) -> Stamped:
    """Decode a STAMPED message of `count` packets. Raises ProtocolError for wrong lengths, or ticks out of order."""
    expected = HEAD + STAMP.size + count * (8 + SIZE)
    if len(message) != expected or count == 0:
        raise ProtocolError(
            f"{count} packets with ticks came in {len(message)} bytes, wanted {expected}, and at least one"
        )
    frame, clock = STAMP.unpack_from(message, HEAD)
    ticks = np.frombuffer(message, "<i8", count, HEAD + STAMP.size).astype(np.int64)
    if not 0 <= clock <= LAST_TICK or np.any(np.diff(ticks) < 0) or ticks[0] < 0 or ticks[-1] >= LAST_TICK:
        raise ProtocolError(f"{count} packets came with the channel clock {clock} and ticks that do not ascend from 0")
    return Stamped(frame, clock, ticks, HEAD + STAMP.size + 8 * count)


def pack_lookahead(request: LookaheadRequest) -> bytes:
    """The payload of a LOOKAHEAD message."""
    return LOOKAHEAD.pack(request.frame, request.answer, *request.origin, *request[3:])


def read_lookahead(message: bytes) -> LookaheadRequest:
    """Decode a LOOKAHEAD message. Raises ProtocolError."""
    if len(message) != HEAD + LOOKAHEAD.size:
        raise ProtocolError(f"a look-ahead request came with {len(message) - HEAD} bytes, wanted {LOOKAHEAD.size}")
    frame, answer, x, y, z, number, tick, clock = LOOKAHEAD.unpack_from(message, HEAD)
    if answer > NO or not (0 <= tick <= LAST_TICK and 0 <= clock <= LAST_TICK):
        raise ProtocolError(f"a look-ahead request came with answer {answer}, tick {tick} and channel clock {clock}")
    return LookaheadRequest(frame, answer, (x, y, z), number, tick, clock)


def prices_order(prices: Prices, tests: Long) -> dict[str, Any]:
    """Facts that the command of a frame carries for timed processes. tests int64 (6,): of a list, 0 for a tree."""
    return {
        "prices": prices.counts.astype("<i8").tobytes(),
        "tests": [int(ticks) for ticks in tests],
        "costs": [int(prices.packet), int(prices.transmit), int(prices.latency), int(prices.by_processor)],
    }


def read_prices(order: Mapping[str, object]) -> tuple[Prices, Long] | None:
    """(prices, ticks of a list's tests) of the command of a frame; None if it is not timed. Raises ProtocolError."""
    if "prices" not in order:
        return None
    table, tests, costs = order["prices"], order.get("tests", []), order.get("costs", [])
    if not isinstance(table, bytes) or len(table) != 8 * COUNTS:
        raise ProtocolError(f"prices came that are not {COUNTS} numbers")
    counts = np.frombuffer(table, "<i8").astype(np.int64)
    if np.any(counts < 0) or np.any(counts > MOST_TICKS):
        raise ProtocolError(f"prices came from {counts.min()} to {counts.max()}, wanted 0 to {MOST_TICKS} ticks")
    if not _numbers(tests, len(Kind)) or not _numbers(costs, 4) or costs[0] < 1 or costs[2] < 1 or costs[3] > 1:
        raise ProtocolError(
            f"costs came as {costs!r} and tests as {tests!r}, wanted ticks, packet and latency 1 or more"
        )
    return Prices(counts, costs[0], costs[1], costs[2], costs[3]), np.array(tests, np.int64)


def _numbers(value: object, count: int) -> TypeGuard[list[int]]:
    return (
        isinstance(value, list) and len(value) == count and all(type(x) is int and 0 <= x <= MOST_TICKS for x in value)
    )
