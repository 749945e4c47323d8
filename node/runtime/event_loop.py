"""Rounds of a node in compiled code: look at the links, take a turn, send, and so on, until Python is needed.

Only what is wholly regular is dealt with here: packets, credit and tallies (`node.runtime.reduction`) of this epoch, in sequence,
with their own checksum, over links that are up and where nothing waits to be sent. Anything else, a fault as well as an
order of another wave, ends the rounds and is left to `node.links.link`, as if it had just come; so the rules of links are in
one place only, and a node without wires (in-memory arrays, faulty links) does the same in Python.
"""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

import numpy as np

from raygrid.node.geometry.grid_walk import HOST
from raygrid.node.jit.decorators import lean, part
from raygrid.node.jit.intrinsics import address, bytes_at, call_int, call_long
from raygrid.node.links import zmq_c_api
from raygrid.node.links.link import (
    CREDIT,
    EPOCH,
    LINK_DATA_DONE,
    LINK_DATA_SENT,
    LINK_DATA_TOLD,
    LINK_RECEIVED,
    REGULAR,
    SOCKET,
)
from raygrid.node.links.zmq_channel import NOBLOCK
from raygrid.node.protocol.messages import HEAD, SUMMED, WINDOW, MessageKind
from raygrid.node.protocol.packets import SIZE, read_u16, read_u32
from raygrid.node.runtime import reduction
from raygrid.node.runtime.native_links import (
    LINKS,
    MONOTONIC,
    OF_THREAD,
    RECEIVING,
    SENDING,
    TIMED,
    TURNING,
    checksum,
    clock,
    post,
)
from raygrid.node.runtime.reduction import (
    BATCH_THRESHOLD,
    DEADLINE,
    FRESH,
    PARENT_PORT,
    PENDING,
    PYTHON_BUSY,
    QUOTA,
    REPLY_BYTES,
    REQUEST_BYTES,
    TO_NOTIFY,
)
from raygrid.node.tracing.batch import BATCH_CROWDED, BATCH_FULL, BATCH_IDLE, BATCH_LONG, run_batch
from raygrid.node.tracing.primaries import DONE
from raygrid.node.tracing.work_queues import IN_TRANSIT, RAYS, SHADOWS, sort

# further reasons to end, after those of a turn
PYTHON_SENDS, PYTHON_RECEIVES = 4, 5  # Python has something to send; PYTHON_RECEIVES + port: a message for Python
LOOP_PACKETS = 65536  # packets after which Python looks at orders, probes and the clock
LEAST_PASS = 1024  # packets as which a round counts at least, so that a trickle cannot keep Python from looking
BACK_OFFS = 4  # that make up the time for which a node may linger
BACK_OFF_FLUSH = 256  # packets for which an output is sent before a nap
_PACKETS, _CREDIT = int(MessageKind.PACKETS), int(MessageKind.CREDIT)
_REDUCE, _REDUCED = int(MessageKind.TALLY), int(MessageKind.TALLIED)
# places in Tracer.pace: the first three are those of `run_batch`
(
    TUNE_AFTER,
    TUNE_BELOW,
    TUNE_AT_ONCE,
    TUNE_FLUSH,
    TUNE_LEAST,
    TUNE_BACK_OFF,
    TUNE_BATCH,
    TUNE_WAIT,
    TUNE_RETURN,
    TUNING,
) = range(10)


# --- receiving -----------------------------------------------------------------------------------------


@part
def _is_in_turn(native, link_state, raw, first, size):
    """Whether a message is the next one of a link in this epoch, whole and believable."""
    if (
        raw[1] != 0
        or read_u16(raw, 2) != link_state[EPOCH]
        or read_u32(raw, 4) != link_state[LINK_RECEIVED] & 0xFFFFFFFF
    ):
        return False
    if (read_u32(raw, 8) - link_state[CREDIT]) & 0xFFFFFFFF > link_state[LINK_DATA_SENT] - link_state[CREDIT]:
        return False
    return read_u32(raw, SUMMED) == checksum(native, first, size)


@part
def _is_regular(native, port, raw, size):
    """Whether a message is one that is dealt with here, and as long as its kind is."""
    kind, count, payload = np.int64(raw[0]), read_u32(raw, 12), size - HEAD
    if kind == _PACKETS:
        return count > 0 and payload == count * SIZE and port != HOST
    if count != 0:
        return False
    if kind == _REDUCE:
        return payload == REQUEST_BYTES and reduction.may_begin(native.reduction_state, port, raw)
    if kind == _REDUCED:
        return payload == REPLY_BYTES and reduction.may_take_reply(native.reduction_state, port, raw)
    return kind == _CREDIT and payload == 0


@part
def _take_packets(raw, count, port, bounds, stacks, held):
    """Put all packets of a message on the stacks, or none if one is bad or there is no room; whether it was done."""
    if count > min(len(stacks.ray_ports) - held[RAYS], len(stacks.shadow_ports) - held[SHADOWS]):
        return False
    if count > len(stacks.transit_ports) - held[IN_TRANSIT]:
        return False
    before = (held[0], held[1], held[2], held[3])
    _, bad = sort(raw, count, port, bounds, stacks, held)
    if bad != 0:
        held[0], held[1], held[2], held[3] = before
    return bad == 0


@part
def _take_reduction(native, port, raw):
    """Take in a message of a tally."""
    if np.int64(raw[0]) == _REDUCE:
        reduction.begin_reduction(native.reduction_state, raw, clock(native, MONOTONIC))
    else:
        reduction.take_reply(native.reduction_state, port, raw)


@part
def _receive(native, port, bounds, stacks, held):
    """Take in what has come over a link; whether that was all: False if the last message is one for Python."""
    link_state, calls = native.link_states[port], native.calls
    while True:
        message = calls[zmq_c_api.MESSAGE]
        if call_int(calls[zmq_c_api.ZMQ_RECEIVE], (message, link_state[SOCKET], np.int64(NOBLOCK))) < 0:
            return call_int(calls[zmq_c_api.ZMQ_ERROR], ()) == calls[zmq_c_api.ZMQ_AGAIN]
        first, size = (
            call_long(calls[zmq_c_api.ZMQ_DATA], (message,)),
            call_long(calls[zmq_c_api.ZMQ_LENGTH], (message,)),
        )
        if size < HEAD or call_int(calls[zmq_c_api.ZMQ_MORE], (message,)) != 0:
            return False
        raw = bytes_at(first, size)
        if not _is_regular(native, port, raw, size) or not _is_in_turn(native, link_state, raw, first, size):
            return False
        count = read_u32(raw, 12)
        if count > 0 and not _take_packets(raw, count, port, bounds, stacks, held):
            return False
        link_state[LINK_RECEIVED] += 1
        link_state[CREDIT] += (read_u32(raw, 8) - link_state[CREDIT]) & 0xFFFFFFFF
        if count > 0:
            link_state[LINK_DATA_DONE] += 1
            if link_state[LINK_DATA_DONE] - link_state[LINK_DATA_TOLD] >= WINDOW // 2:
                post(native, link_state, _CREDIT, 0, native.header, 0, np.int64(HEAD))
        elif size > HEAD:
            _take_reduction(native, port, raw)


# --- sending -------------------------------------------------------------------------------------------


@part
def _send(native, port, outputs, least, batch):
    """Send what an output holds, `batch` packets a message, until it holds fewer than `least`; whether it then does.

    What could not go stays, and a rest that is worth no message of its own.
    """
    link_state, row, sent = native.link_states[port], outputs.data[port], np.int64(0)
    while outputs.held[port] - sent >= least and link_state[LINK_DATA_SENT] - link_state[CREDIT] < WINDOW:
        many = min(batch, outputs.held[port] - sent)
        # the header of a later message takes the place of bytes that were sent
        if not post(native, link_state, _PACKETS, many, row, sent * SIZE, HEAD + many * SIZE):
            break
        link_state[LINK_DATA_SENT] += 1
        sent += many
    if sent > 0:
        for k in range(HEAD, HEAD + (outputs.held[port] - sent) * SIZE):
            row[k] = row[k + sent * SIZE]
        outputs.held[port] -= sent
    return outputs.held[port] < least


@part
def _send_all(native, outputs, least, pressed, batch):
    """Send the outputs with `least` packets or more; whether Python is needed: for an output that is not for this code,
    and where something could not go and that cannot wait (pressed)."""
    needed = False
    for port in range(LINKS):
        if outputs.held[port] >= least:
            link_table = native.link_states[port, REGULAR] != 0
            if not link_table or (not _send(native, port, outputs, least, batch) and pressed):
                needed = True
    return needed


# --- tallies -------------------------------------------------------------------------------------------


@part
def _tell_children(native):
    """Hand a tally on to those children that have not been told yet; whether all have."""
    one, state = native.reduction_state, native.reduction_state.state
    if state[TO_NOTIFY] == 0:
        return True
    for k in range(reduction.REQUEST_FIELDS):
        reduction.put_word(one.room, k, one.order[k])
    for port in range(LINKS):
        if (state[TO_NOTIFY] >> port) & 1 != 0:
            if not post(native, native.link_states[port], _REDUCE, 0, one.room, 0, np.int64(HEAD + REQUEST_BYTES)):
                return False
            state[TO_NOTIFY] &= ~(1 << port)
    return True


@part
def _reply(native, idle, quota, cursor, held, outputs, counts):
    """Answer a tally if it is time for that; whether Python is needed for it."""
    state = native.reduction_state.state
    if not reduction.waits_for_node(native.reduction_state):
        return False
    if not (idle and state[PYTHON_BUSY] == 0) and clock(native, MONOTONIC) < state[DEADLINE]:
        return False
    sent, done = np.int64(0), np.int64(0)
    for port in range(LINKS):
        sent += native.link_states[port, LINK_DATA_SENT]
        done += native.link_states[port, LINK_DATA_DONE]
    reduction.put_reply(native.reduction_state, quota, cursor, held, outputs, counts, sent, done)
    link_state, size = native.link_states[state[PARENT_PORT]], np.int64(HEAD + REPLY_BYTES)
    if not post(native, link_state, _REDUCED, 0, native.reduction_state.room, 0, size):
        return True
    state[PENDING] = 0
    return False


@part
def _serve_reduction(native, quota, tuning):
    """Do what a tally orders that has just come; the quota."""
    order = native.reduction_state.order
    tuning[TUNE_LEAST], tuning[TUNE_BACK_OFF] = order[BATCH_THRESHOLD], order[reduction.BACK_OFF] // BACK_OFFS
    tuning[TUNE_FLUSH] = min(order[reduction.FLUSH_PACKETS], tuning[TUNE_BATCH])
    native.reduction_state.state[FRESH] = 0
    return max(quota, order[QUOTA])


# --- rounds --------------------------------------------------------------------------------------------


@part
def _count_time(native, place, since):
    """Count the nanoseconds of this thread since then for a place in `spent`; now. Nothing unless rounds are timed."""
    if native.spent[TIMED] == 0:
        return since
    now = clock(native, OF_THREAD)
    if place >= 0:
        native.spent[place] += now - since
    return now


@part
def _receive_all(native, bounds, stacks, held):
    """Take in what has come over all links; -1, or the port of a link with a message for Python."""
    for port in range(LINKS):
        if native.link_states[port, REGULAR] != 0 and not _receive(native, port, bounds, stacks, held):
            return port
    return -1


@part
def _wait(native):
    """Wait until something comes; whether it came over links that are for this code, and over these only."""
    n = len(native.items)
    if call_int(native.calls[zmq_c_api.ZMQ_POLL], (address(native.items, np.int64(0)), np.int64(n), np.int64(-1))) <= 0:
        return False
    for k in range(n):
        port = native.ports[k]
        if native.items[k, 1] >> 48 != 0 and (port < 0 or native.link_states[port, REGULAR] == 0):
            return False
    return True


@lean
def run_loop(
    cell, space, frame, surfaces, pixels, cursor, quota, tuning, bounds, stacks, held, outputs, counts, native
):
    """Go rounds until nothing is left to do, or for a reason above. Returns (quota left, why).

    pace    int64 (PACE,). TUNE_AFTER, TUNE_BELOW, TUNE_AT_ONCE: of `run_batch`; TUNE_FLUSH: packets for which an output is sent
            while there is work; TUNE_LEAST: packets that are worth a turn; NAP: microseconds, for which a node
            sleeps NAPS times before it takes one that is not; TUNE_BATCH: most packets a message; WAIT: whether to wait
            where nothing is left to do, until something comes; TUNE_RETURN: packets after which it ends in any case.
            Tallies change TUNE_FLUSH, TUNE_LEAST and NAP
    bounds  int64, the fields of `Limits`
    Without wires it is one turn. The other arguments are those of `run_batch`.
    """
    served, naps, since, link_table = 0, BACK_OFFS, _count_time(native, -1, 0), False
    for port in range(LINKS):
        link_table = link_table or native.link_states[port, REGULAR] != 0
    while True:
        odd = _receive_all(native, bounds, stacks, held)
        if native.reduction_state.state[FRESH] != 0:
            quota = _serve_reduction(native, quota, tuning)
        told = _tell_children(native)
        since = _count_time(native, RECEIVING, since)
        if odd >= 0:
            return quota, PYTHON_RECEIVES + odd
        if not told:
            return quota, PYTHON_SENDS
        waiting = held[IN_TRANSIT] + held[SHADOWS] + held[RAYS]
        if quota == 0 or cursor[DONE] != 0:
            drowsy = link_table and 0 < waiting < tuning[TUNE_LEAST] and naps > 0
            if waiting == 0 or drowsy:
                needed = _send_all(native, outputs, BACK_OFF_FLUSH if drowsy else 1, True, tuning[TUNE_BATCH])
                needed = needed or _reply(native, not drowsy, quota, cursor, held, outputs, counts)
                since = _count_time(native, SENDING, since)
                if needed:
                    return quota, PYTHON_SENDS
                if drowsy:
                    naps -= 1
                elif tuning[TUNE_WAIT] == 0 or not link_table or not _wait(native):
                    return quota, BATCH_IDLE
                if tuning[TUNE_LEAST] > 0 and tuning[TUNE_BACK_OFF] > 0:
                    call_int(native.calls[zmq_c_api.SLEEP], (np.int64(tuning[TUNE_BACK_OFF]),))
                continue
        naps = BACK_OFFS
        quota, why, done = run_batch(
            cell, space, frame, surfaces, pixels, cursor, quota, tuning, stacks, held, outputs, counts
        )
        since = _count_time(native, TURNING, since)
        if not link_table or why == BATCH_CROWDED:
            return quota, why
        needed = _send_all(native, outputs, tuning[TUNE_FLUSH], why == BATCH_FULL, tuning[TUNE_BATCH])
        needed = needed or _reply(native, False, quota, cursor, held, outputs, counts)
        since = _count_time(native, SENDING, since)
        served += max(done, LEAST_PASS)
        if needed or served >= tuning[TUNE_RETURN]:
            return quota, PYTHON_SENDS if needed else BATCH_LONG
