"""Defines reductions: the waves of a trace as rows of numbers, of which Python and compiled code take care by the same rules.

A request goes down the tree of a wave as a row of int64, and its reply comes back as another:

    REDUCE   the fields of `TraceFields`
    REDUCED  number of the wave, then the sums

How a reduction stands in a node is kept in records that Python and compiled code both read and write, so that each can go
on with what the other has begun. The rules are functions that both call: compiled code calls those that end with `_part`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.node.errors import ProtocolError
from raygrid.node.jit.decorators import part
from raygrid.node.jit.records import Record, Rows, record
from raygrid.node.protocol.commands import MOST_HOLD, TraceCommand
from raygrid.node.protocol.counters import COUNTS
from raygrid.node.protocol.messages import HEAD
from raygrid.node.protocol.packets import read_u64, write

# sums of a wave: the counts of a ray step (`node.protocol.counters`), then these
HOMES_LEFT, SUM_WAITING, SUM_RECEIVED, HANDED_ON, COLLECTING, REFUSED, ALLOWED, SUM_DATA_SENT, SUM_DATA_DONE = range(
    COUNTS, COUNTS + 9
)
SUMS = COUNTS + 9

NANO, MICRO = 1_000_000_000, 1_000_000  # in a second
MOST_QUOTA, MOST_BACK_OFF, MOST_PACKETS = 2**32 - 1, MICRO, 2**31
LONGEST_HOLD = int(MOST_HOLD) * NANO

Long = NDArray[np.int64]


@record
class TraceFields(Record):
    """What a node is asked to do in a trace (`node.protocol.commands.TraceCommand`).

    hold  nanoseconds; back_off  microseconds
    """

    wave: int
    quota: int
    hold: int
    batch_threshold: int
    back_off: int
    flush: int


@record
class ReductionState(Record):
    """How a reduction stands in a node.

    pending          whether one is under way here
    wave             its number
    deadline         when it is answered although the node is busy, in nanoseconds of the monotonic clock
    replied          a bit a port: children that have replied; to_notify: children that are still to be told
    fresh            whether what it asks is still to be done
    compiled_serves  whether compiled code may take care of it now
    python_busy      whether the node has something to do of which compiled code knows nothing
    parent_port      port; child_ports: a bit a port
    """

    pending: int
    wave: int
    deadline: int
    replied: int
    to_notify: int
    fresh: int
    compiled_serves: int
    python_busy: int
    parent_port: int
    child_ports: int


FIELD_BYTES = 8
REQUEST_FIELDS = len(TraceFields._fields_)
REQUEST_BYTES, REPLY_BYTES = REQUEST_FIELDS * FIELD_BYTES, (1 + SUMS) * FIELD_BYTES


class Reduction(NamedTuple):
    """How a reduction stands in a node, for compiled code.

    state    ReductionState (1,)
    request  TraceFields (1,), what came from the parent
    sums     int64 (SUMS,), of the children that have replied
    known    int64 (SUMS,), of this node's own sums what compiled code does not know
    total    int64 (SUMS,), scratch
    message  uint8, room for a message
    """

    state: Rows
    request: Rows
    sums: Long
    known: Long
    total: Long
    message: NDArray[np.uint8]


def make_reduction(parent: int = 0, children: tuple[int, ...] = ()) -> Reduction:
    """None is under way."""
    made = Reduction(
        ReductionState.rows(),
        TraceFields.rows(),
        np.zeros(SUMS, np.int64),
        np.zeros(SUMS, np.int64),
        np.zeros(SUMS, np.int64),
        np.zeros(HEAD + max(REQUEST_BYTES, REPLY_BYTES), np.uint8),
    )
    state = ReductionState.view(made.state)
    state.parent_port, state.child_ports = parent, sum(1 << port for port in children)
    return made


# --- the rules, for Python and for compiled code ---------------------------------------------------------


def is_sound(request: TraceFields) -> bool:
    """Whether all fields of a request are in range."""
    times = (0 <= request.hold <= LONGEST_HOLD) & (0 <= request.back_off <= MOST_BACK_OFF)
    packets = (0 <= request.batch_threshold <= MOST_PACKETS) & (1 <= request.flush <= MOST_PACKETS)
    return times & packets & (0 <= request.quota <= MOST_QUOTA)


def begin(state: ReductionState, request: TraceFields, sums: Long, now: int) -> None:
    """A request has come at `now` (nanoseconds): the children are to be told of it, and it is to be done."""
    state.pending, state.wave, state.fresh = 1, request.wave, 1
    state.replied, state.to_notify = 0, state.child_ports
    state.deadline = now + request.hold
    for k in range(SUMS):
        sums[k] = 0


def awaits_reply(state: ReductionState, port: int, wave: int) -> bool:
    """Whether a reply by this port, of this wave, is one that is waited for."""
    asked = state.child_ports & ~state.replied
    return (state.pending != 0) & (wave == state.wave) & ((asked >> port) & 1 != 0)


def waits_for_node(state: ReductionState) -> bool:
    """Whether one is under way that waits for nobody but this node."""
    return (state.pending != 0) & (state.to_notify == 0) & (state.replied == state.child_ports)


def add_own_sums(
    sums: Long, counts: Long, queues_held: Long, outputs_held: Long, samples_left: bool, quota: int
) -> None:
    """Add what a node has counted in its frame, and how it stands, to sums."""
    for k in range(COUNTS):
        sums[k] += counts[k]
    sums[SUM_WAITING] += queues_held[0] + queues_held[1] + queues_held[2]
    for k in range(len(outputs_held)):
        sums[SUM_WAITING] += outputs_held[k]
    if samples_left:
        sums[HOMES_LEFT] += 1
        sums[ALLOWED] += quota


is_sound_part, begin_part, awaits_reply_part = part(is_sound), part(begin), part(awaits_reply)
waits_for_node_part, add_own_sums_part = part(waits_for_node), part(add_own_sums)


# --- bytes, in Python ------------------------------------------------------------------------------------


def trace_request(wave: int, command: TraceCommand) -> TraceFields:
    """The command as a request; what does not fit into 64 bits becomes the nearest number that does."""
    hold, back_off = int(command.hold * NANO), int(command.back_off * MICRO)
    fields = wave, command.quota, hold, command.batch_threshold, back_off, command.flush
    return TraceFields(*(max(-(2**63), min(2**63 - 1, field)) for field in fields))


def pack_request(wave: int, command: TraceCommand) -> bytes | None:
    """The command as the payload of a REDUCE; None if it is out of range, and must go as a map, for nodes to refuse it."""
    request = trace_request(wave, command)
    return pack_fields(request) if is_sound(request) else None


def pack_fields(request: TraceFields) -> bytes:
    """The payload of a REDUCE."""
    return np.array(request.numbers(), "<i8").tobytes()


def read_request(message: bytes) -> TraceFields:
    """The request of a REDUCE. Raises ProtocolError."""
    if len(message) != HEAD + REQUEST_BYTES:
        raise ProtocolError(f"a request came with {len(message) - HEAD} bytes, wanted {REQUEST_BYTES}")
    request = TraceFields(*np.frombuffer(message, "<i8", REQUEST_FIELDS, HEAD).tolist())
    if not is_sound(request):
        raise ProtocolError(
            f"a request came with {request.numbers()}, "
            "wanted wave, quota, hold, batch threshold, back-off and flush in range"
        )
    return request


def pack_reply(wave: int, sums: Long) -> bytes:
    """The payload of a REDUCED."""
    return np.concatenate(([wave], sums)).astype("<i8").tobytes()


def read_reply(message: bytes) -> tuple[int, Long]:
    """(number of the wave, sums) of a REDUCED. Raises ProtocolError."""
    if len(message) != HEAD + REPLY_BYTES:
        raise ProtocolError(f"a reply came with {len(message) - HEAD} bytes, wanted {REPLY_BYTES}")
    numbers = np.frombuffer(message, "<i8", 1 + SUMS, HEAD).astype(np.int64)
    return int(numbers[0]), numbers[1:]


# --- bytes, in compiled code -----------------------------------------------------------------------------


@part
def read_field(raw: NDArray[np.uint8], place: int) -> int:
    """A field of a message, int64."""
    value: int = read_u64(raw, HEAD + place * FIELD_BYTES)
    return value


@part
def put_field(raw: NDArray[np.uint8], place: int, value: int) -> None:
    """Write a field of a message."""
    write(raw, HEAD + place * FIELD_BYTES, value, FIELD_BYTES)
