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
from raygrid.node.links.link import CREDIT, DATA_DONE, DATA_DONE_TOLD, DATA_SENT, EPOCH, RECEIVED, REGULAR, SOCKET
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
    ANSWER_BYTES,
    DEADLINE,
    FRESH,
    GATHER,
    OCCUPIED,
    ORDER_BYTES,
    PARENT,
    PENDING,
    QUOTA,
    UNTOLD,
)
from raygrid.node.tracing.batch import CROWDED, FULL, IDLE, LONG, turn
from raygrid.node.tracing.primaries import DONE
from raygrid.node.tracing.work_queues import RAYS, SHADOWS, TRAVELLERS, sort

# further reasons to end, after those of a turn
SEND, OTHER = 4, 5  # Python has something to send; OTHER + port: a message for Python
ROUNDS = 65536  # packets after which Python looks at orders, probes and the clock
LEAST_ROUND = 1024  # packets as which a round counts at least, so that a trickle cannot keep Python from looking
NAPS = 4  # that make up the time for which a node may linger
DROWSY_FLUSH = 256  # packets for which an output is sent before a nap
_PACKETS, _CREDIT = int(MessageKind.PACKETS), int(MessageKind.CREDIT)
_TALLY, _TALLIED = int(MessageKind.TALLY), int(MessageKind.TALLIED)
# places in Tracer.pace: the first three are those of `turn`
AFTER, BELOW, AT_ONCE, FLUSH, LEAST, NAP, BATCH, WAIT, RETURN, PACE = range(10)


# --- receiving -----------------------------------------------------------------------------------------


@part
def _is_in_turn(wires, book, raw, first, size):
    """Whether a message is the next one of a link in this epoch, whole and believable."""
    if raw[1] != 0 or read_u16(raw, 2) != book[EPOCH] or read_u32(raw, 4) != book[RECEIVED] & 0xFFFFFFFF:
        return False
    if (read_u32(raw, 8) - book[CREDIT]) & 0xFFFFFFFF > book[DATA_SENT] - book[CREDIT]:
        return False
    return read_u32(raw, SUMMED) == checksum(wires, first, size)


@part
def _is_regular(wires, port, raw, size):
    """Whether a message is one that is dealt with here, and as long as its kind is."""
    kind, count, payload = np.int64(raw[0]), read_u32(raw, 12), size - HEAD
    if kind == _PACKETS:
        return count > 0 and payload == count * SIZE and port != HOST
    if count != 0:
        return False
    if kind == _TALLY:
        return payload == ORDER_BYTES and reduction.may_begin(wires.tally, port, raw)
    if kind == _TALLIED:
        return payload == ANSWER_BYTES and reduction.may_hear(wires.tally, port, raw)
    return kind == _CREDIT and payload == 0


@part
def _take_packets(raw, count, port, bounds, stacks, held):
    """Put all packets of a message on the stacks, or none if one is bad or there is no room; whether it was done."""
    if count > min(len(stacks.ray_ports) - held[RAYS], len(stacks.shadow_ports) - held[SHADOWS]):
        return False
    if count > len(stacks.traveller_ports) - held[TRAVELLERS]:
        return False
    before = (held[0], held[1], held[2], held[3])
    _, bad = sort(raw, count, port, bounds, stacks, held)
    if bad != 0:
        held[0], held[1], held[2], held[3] = before
    return bad == 0


@part
def _take_tally(wires, port, raw):
    """Take in a message of a tally."""
    if np.int64(raw[0]) == _TALLY:
        reduction.begin_here(wires.tally, raw, clock(wires, MONOTONIC))
    else:
        reduction.hear_here(wires.tally, port, raw)


@part
def _receive(wires, port, bounds, stacks, held):
    """Take in what has come over a link; whether that was all: False if the last message is one for Python."""
    book, calls = wires.books[port], wires.calls
    while True:
        message = calls[zmq_c_api.MESSAGE]
        if call_int(calls[zmq_c_api.RECEIVE], (message, book[SOCKET], np.int64(NOBLOCK))) < 0:
            return call_int(calls[zmq_c_api.ERROR], ()) == calls[zmq_c_api.AGAIN]
        first, size = call_long(calls[zmq_c_api.DATA], (message,)), call_long(calls[zmq_c_api.LENGTH], (message,))
        if size < HEAD or call_int(calls[zmq_c_api.MORE], (message,)) != 0:
            return False
        raw = bytes_at(first, size)
        if not _is_regular(wires, port, raw, size) or not _is_in_turn(wires, book, raw, first, size):
            return False
        count = read_u32(raw, 12)
        if count > 0 and not _take_packets(raw, count, port, bounds, stacks, held):
            return False
        book[RECEIVED] += 1
        book[CREDIT] += (read_u32(raw, 8) - book[CREDIT]) & 0xFFFFFFFF
        if count > 0:
            book[DATA_DONE] += 1
            if book[DATA_DONE] - book[DATA_DONE_TOLD] >= WINDOW // 2:
                post(wires, book, _CREDIT, 0, wires.header, 0, np.int64(HEAD))
        elif size > HEAD:
            _take_tally(wires, port, raw)


# --- sending -------------------------------------------------------------------------------------------


@part
def _send(wires, port, outputs, least, batch):
    """Send what an output holds, `batch` packets a message, until it holds fewer than `least`; whether it then does.

    What could not go stays, and a rest that is worth no message of its own.
    """
    book, row, sent = wires.books[port], outputs.data[port], np.int64(0)
    while outputs.held[port] - sent >= least and book[DATA_SENT] - book[CREDIT] < WINDOW:
        many = min(batch, outputs.held[port] - sent)
        # the header of a later message takes the place of bytes that were sent
        if not post(wires, book, _PACKETS, many, row, sent * SIZE, HEAD + many * SIZE):
            break
        book[DATA_SENT] += 1
        sent += many
    if sent > 0:
        for k in range(HEAD, HEAD + (outputs.held[port] - sent) * SIZE):
            row[k] = row[k + sent * SIZE]
        outputs.held[port] -= sent
    return outputs.held[port] < least


@part
def _send_all(wires, outputs, least, pressed, batch):
    """Send the outputs with `least` packets or more; whether Python is needed: for an output that is not for this code,
    and where something could not go and that cannot wait (pressed)."""
    needed = False
    for port in range(LINKS):
        if outputs.held[port] >= least:
            wired = wires.books[port, REGULAR] != 0
            if not wired or (not _send(wires, port, outputs, least, batch) and pressed):
                needed = True
    return needed


# --- tallies -------------------------------------------------------------------------------------------


@part
def _tell_children(wires):
    """Hand a tally on to those children that have not been told yet; whether all have."""
    one, state = wires.tally, wires.tally.state
    if state[UNTOLD] == 0:
        return True
    for k in range(reduction.ORDER):
        reduction.put_word(one.room, k, one.order[k])
    for port in range(LINKS):
        if (state[UNTOLD] >> port) & 1 != 0:
            if not post(wires, wires.books[port], _TALLY, 0, one.room, 0, np.int64(HEAD + ORDER_BYTES)):
                return False
            state[UNTOLD] &= ~(1 << port)
    return True


@part
def _answer_tally(wires, idle, quota, cursor, held, outputs, counts):
    """Answer a tally if it is time for that; whether Python is needed for it."""
    state = wires.tally.state
    if not reduction.waits_for_node(wires.tally):
        return False
    if not (idle and state[OCCUPIED] == 0) and clock(wires, MONOTONIC) < state[DEADLINE]:
        return False
    sent, done = np.int64(0), np.int64(0)
    for port in range(LINKS):
        sent += wires.books[port, DATA_SENT]
        done += wires.books[port, DATA_DONE]
    reduction.put_answer(wires.tally, quota, cursor, held, outputs, counts, sent, done)
    book, size = wires.books[state[PARENT]], np.int64(HEAD + ANSWER_BYTES)
    if not post(wires, book, _TALLIED, 0, wires.tally.room, 0, size):
        return True
    state[PENDING] = 0
    return False


@part
def _heed_tally(wires, quota, pace):
    """Do what a tally orders that has just come; the quota."""
    order = wires.tally.order
    pace[LEAST], pace[NAP] = order[GATHER], order[reduction.NAP] // NAPS
    pace[FLUSH] = min(order[reduction.FLUSH], pace[BATCH])
    wires.tally.state[FRESH] = 0
    return max(quota, order[QUOTA])


# --- rounds --------------------------------------------------------------------------------------------


@part
def _count_time(wires, place, since):
    """Count the nanoseconds of this thread since then for a place in `spent`; now. Nothing unless rounds are timed."""
    if wires.spent[TIMED] == 0:
        return since
    now = clock(wires, OF_THREAD)
    if place >= 0:
        wires.spent[place] += now - since
    return now


@part
def _receive_all(wires, bounds, stacks, held):
    """Take in what has come over all links; -1, or the port of a link with a message for Python."""
    for port in range(LINKS):
        if wires.books[port, REGULAR] != 0 and not _receive(wires, port, bounds, stacks, held):
            return port
    return -1


@part
def _wait(wires):
    """Wait until something comes; whether it came over links that are for this code, and over these only."""
    n = len(wires.items)
    if call_int(wires.calls[zmq_c_api.POLL], (address(wires.items, np.int64(0)), np.int64(n), np.int64(-1))) <= 0:
        return False
    for k in range(n):
        port = wires.ports[k]
        if wires.items[k, 1] >> 48 != 0 and (port < 0 or wires.books[port, REGULAR] == 0):
            return False
    return True


@lean
def go(cell, space, frame, surfaces, pixels, cursor, quota, pace, bounds, stacks, held, outputs, counts, wires):
    """Go rounds until nothing is left to do, or for a reason above. Returns (quota left, why).

    pace    int64 (PACE,). AFTER, BELOW, AT_ONCE: of `turn`; FLUSH: packets for which an output is sent while there is
            work; LEAST: packets that are worth a turn; NAP: microseconds, for which a node sleeps NAPS times before it
            takes one that is not; BATCH: most packets a message; WAIT: whether to wait where nothing is left to do,
            until something comes; RETURN: packets after which it ends in any case. Tallies change FLUSH, LEAST and NAP
    bounds  int64, the fields of `Limits`
    Without wires it is one turn. The other arguments are those of `turn`.
    """
    served, naps, since, wired = 0, NAPS, _count_time(wires, -1, 0), False
    for port in range(LINKS):
        wired = wired or wires.books[port, REGULAR] != 0
    while True:
        odd = _receive_all(wires, bounds, stacks, held)
        if wires.tally.state[FRESH] != 0:
            quota = _heed_tally(wires, quota, pace)
        told = _tell_children(wires)
        since = _count_time(wires, RECEIVING, since)
        if odd >= 0:
            return quota, OTHER + odd
        if not told:
            return quota, SEND
        waiting = held[TRAVELLERS] + held[SHADOWS] + held[RAYS]
        if quota == 0 or cursor[DONE] != 0:
            drowsy = wired and 0 < waiting < pace[LEAST] and naps > 0
            if waiting == 0 or drowsy:
                needed = _send_all(wires, outputs, DROWSY_FLUSH if drowsy else 1, True, pace[BATCH])
                needed = needed or _answer_tally(wires, not drowsy, quota, cursor, held, outputs, counts)
                since = _count_time(wires, SENDING, since)
                if needed:
                    return quota, SEND
                if drowsy:
                    naps -= 1
                elif pace[WAIT] == 0 or not wired or not _wait(wires):
                    return quota, IDLE
                if pace[LEAST] > 0 and pace[NAP] > 0:
                    call_int(wires.calls[zmq_c_api.SLEEP], (np.int64(pace[NAP]),))
                continue
        naps = NAPS
        quota, why, done = turn(
            cell, space, frame, surfaces, pixels, cursor, quota, pace, stacks, held, outputs, counts
        )
        since = _count_time(wires, TURNING, since)
        if not wired or why == CROWDED:
            return quota, why
        needed = _send_all(wires, outputs, pace[FLUSH], why == FULL, pace[BATCH])
        needed = needed or _answer_tally(wires, False, quota, cursor, held, outputs, counts)
        since = _count_time(wires, SENDING, since)
        served += max(done, LEAST_ROUND)
        if needed or served >= pace[RETURN]:
            return quota, SEND if needed else LONG
