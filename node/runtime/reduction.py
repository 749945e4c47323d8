"""Tallies: the waves of a trace, in a form of which compiled code can take care (`node.runtime.event_loop`).

A tally goes down the tree of a wave as a row of int64, and its answer comes back as another:

    TALLY    number of the wave, quota, hold (nanoseconds), gather, nap (microseconds), flush
    TALLIED  number of the wave, sums

How a tally stands in a node is kept in arrays that Python and compiled code both read and write, so that each can go on
with what the other has begun (`node.runtime.reduction_replies` is what Python does).
"""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.node.errors import ProtocolError
from raygrid.node.jit.decorators import part
from raygrid.node.protocol.counters import COUNTS
from raygrid.node.protocol.messages import HEAD
from raygrid.node.protocol.packets import read_u64
from raygrid.node.tracing.primaries import DONE

# sums of a wave: the counts of node.tables, then these
HOMES_LEFT, SUM_WAITING, SUM_RECEIVED, HANDED_ON, COLLECTING, REFUSED, ALLOWED, SUM_DATA_SENT, SUM_DATA_DONE = range(
    COUNTS, COUNTS + 9
)
SUMS = COUNTS + 9

# fields of a TALLY
WAVE, QUOTA, HOLD, BATCH_THRESHOLD, BACK_OFF, FLUSH_PACKETS = range(6)
REQUEST_FIELDS = 6
FIELD_BYTES = 8  # bytes of a field
REQUEST_BYTES, REPLY_BYTES = REQUEST_FIELDS * FIELD_BYTES, (1 + SUMS) * FIELD_BYTES

# places in Reduction.state
PENDING = 0  # whether one is under way here
CURRENT = 1  # its number
DEADLINE = 2  # when it is answered although the node is busy, in nanoseconds of the monotonic clock
REPLIED, TO_NOTIFY = 3, 4  # a bit a port: children that have answered, children that are still to be told
FRESH = 5  # whether what it orders is still to be done
COMPILED_SERVES = 6  # whether compiled code may take care of it now
PYTHON_BUSY = 7  # whether the node has something to do of which compiled code knows nothing
PARENT_PORT, CHILD_PORTS = 8, 9  # port; a bit a port
STATE = 10

MOST_QUOTA, MOST_HOLD, MOST_BACK_OFF, MOST_PACKETS = 2**32 - 1, 60 * 10**9, 10**6, 2**31


class Reduction(NamedTuple):
    """How a tally stands in a node.

    state  int64 (STATE,)
    order  int64 (REQUEST_FIELDS,), what came from the parent
    sums   int64 (SUMS,), of the children that have answered
    known  int64 (SUMS,), of this node's own sums what compiled code does not know
    room   uint8, for a message
    """

    state: NDArray[np.int64]
    order: NDArray[np.int64]
    sums: NDArray[np.int64]
    known: NDArray[np.int64]
    room: NDArray[np.uint8]


def make_reduction(parent: int = 0, children: tuple[int, ...] = ()) -> Reduction:
    """None is under way."""
    reduction_state = Reduction(
        np.zeros(STATE, np.int64),
        np.zeros(REQUEST_FIELDS, np.int64),
        np.zeros(SUMS, np.int64),
        np.zeros(SUMS, np.int64),
        np.zeros(HEAD + max(REQUEST_BYTES, REPLY_BYTES), np.uint8),
    )
    reduction_state.state[PARENT_PORT] = parent
    reduction_state.state[CHILD_PORTS] = sum(1 << port for port in children)
    return reduction_state


# --- in Python -----------------------------------------------------------------------------------------


def pack_request(number: int, order: dict[str, Any]) -> bytes | None:
    """The order `trace` as a TALLY; None if it cannot be one, and must go as a map, to be refused by the nodes."""
    quota, gather, flush = order.get("quota"), order.get("gather", 0), order.get("flush")
    hold, linger = order.get("hold", 0.0), order.get("linger", 0.0)
    if not (type(quota) is int and type(gather) is int and type(flush) is int):
        return None
    if not (isinstance(hold, float) and isinstance(linger, float) and 0.0 <= hold <= 60.0 and 0.0 <= linger <= 1.0):
        return None
    fields = number, quota, int(hold * 1e9), gather, int(linger * 1e6), flush
    return np.array(fields, "<i8").tobytes() if _is_sound(fields) else None


def read_request(message: bytes) -> list[int]:
    """The fields of a TALLY. Raises ProtocolError."""
    if len(message) != HEAD + REQUEST_BYTES:
        raise ProtocolError(f"a tally came with {len(message) - HEAD} bytes, wanted {REQUEST_BYTES}")
    fields: list[int] = np.frombuffer(message, "<i8", REQUEST_FIELDS, HEAD).tolist()
    if not _is_sound(fields):
        raise ProtocolError(f"a tally came with {fields}, wanted number, quota, hold, gather, nap and flush in range")
    return fields


def _is_sound(fields: Any) -> bool:
    _, quota, hold, gather, nap, flush = fields
    return bool(
        0 <= quota <= MOST_QUOTA
        and 0 <= hold <= MOST_HOLD
        and 0 <= gather <= MOST_PACKETS
        and 0 <= nap <= MOST_BACK_OFF
        and 1 <= flush <= MOST_PACKETS
    )


def pack_reply(number: int, sums: NDArray[np.int64]) -> bytes:
    """The answer to a tally."""
    return np.concatenate(([number], sums)).astype("<i8").tobytes()


def read_reply(message: bytes) -> tuple[int, NDArray[np.int64]]:
    """(number, sums) of an answer to a tally. Raises ProtocolError."""
    if len(message) != HEAD + REPLY_BYTES:
        raise ProtocolError(f"an answer to a tally came with {len(message) - HEAD} bytes, wanted {REPLY_BYTES}")
    numbers = np.frombuffer(message, "<i8", 1 + SUMS, HEAD).astype(np.int64)
    return int(numbers[0]), numbers[1:]


# --- in compiled code ----------------------------------------------------------------------------------


@part
def read_word(raw, place):
    """A field of a message, int64."""
    return read_u64(raw, HEAD + place * FIELD_BYTES)


@part
def put_word(raw, place, value):
    """Write a field of a message."""
    at = HEAD + place * FIELD_BYTES
    for k in range(FIELD_BYTES):
        raw[at + k] = np.uint8((value >> (8 * k)) & 0xFF)


@part
def may_begin(reduction_state, port, raw):
    """Whether a message, as long as a TALLY, is one that this code can take care of."""
    state = reduction_state.state
    if state[COMPILED_SERVES] == 0 or state[PENDING] != 0 or port != state[PARENT_PORT]:
        return False
    quota, hold, gather = read_word(raw, QUOTA), read_word(raw, HOLD), read_word(raw, BATCH_THRESHOLD)
    nap, flush = read_word(raw, BACK_OFF), read_word(raw, FLUSH_PACKETS)
    times = (hold >= 0) & (hold <= MOST_HOLD) & (nap >= 0) & (nap <= MOST_BACK_OFF)
    packets = (gather >= 0) & (gather <= MOST_PACKETS) & (flush >= 1) & (flush <= MOST_PACKETS)
    return times & packets & (quota >= 0) & (quota <= MOST_QUOTA)


@part
def begin_reduction(reduction_state, raw, now):
    """As `tallies.Tallies.begin`; what it orders is still to be done."""
    state = reduction_state.state
    for k in range(REQUEST_FIELDS):
        reduction_state.order[k] = read_word(raw, k)
    state[PENDING], state[CURRENT], state[REPLIED], state[TO_NOTIFY] = (
        1,
        reduction_state.order[WAVE],
        0,
        state[CHILD_PORTS],
    )
    state[DEADLINE], state[FRESH] = now + reduction_state.order[HOLD], 1
    for k in range(SUMS):
        reduction_state.sums[k] = 0


@part
def may_take_reply(reduction_state, port, raw):
    """Whether a message, as long as a TALLIED, is one that is waited for."""
    state = reduction_state.state
    if state[COMPILED_SERVES] == 0 or state[PENDING] == 0 or (state[CHILD_PORTS] >> port) & 1 == 0:
        return False
    return (state[REPLIED] >> port) & 1 == 0 and read_word(raw, 0) == state[CURRENT]


@part
def take_reply(reduction_state, port, raw):
    """As `tallies.Tallies.hear`."""
    for k in range(SUMS):
        reduction_state.sums[k] += read_word(raw, 1 + k)
    reduction_state.state[REPLIED] |= 1 << port


@part
def waits_for_node(reduction_state):
    """Whether one is under way that this code serves, and that waits for nobody but this node."""
    state = reduction_state.state
    return (
        state[PENDING] != 0
        and state[COMPILED_SERVES] != 0
        and state[TO_NOTIFY] == 0
        and state[REPLIED] == state[CHILD_PORTS]
    )


@part
def put_reply(reduction_state, quota, cursor, held, outputs, counts, data_sent, data_done):
    """Write the answer into `room`: the children's sums and this node's own.

    data_sent, data_done  messages of the links that this code serves; those of others are known
    """
    waiting = held[0] + held[1] + held[2]
    for k in range(len(outputs.held)):
        waiting += outputs.held[k]
    left = np.int64(cursor[DONE] == 0)
    put_word(reduction_state.room, 0, reduction_state.state[CURRENT])
    for k in range(SUMS):
        value = reduction_state.sums[k] + reduction_state.known[k]
        if k < COUNTS:
            value += counts[k]
        elif k == HOMES_LEFT:
            value += left
        elif k == SUM_WAITING:
            value += waiting
        elif k == ALLOWED:
            value += left * quota
        elif k == SUM_DATA_SENT:
            value += data_sent
        elif k == SUM_DATA_DONE:
            value += data_done
        put_word(reduction_state.room, 1 + k, value)
