"""Runs the event loop of a node in compiled code: receive, trace a batch, send, and so on, until Python is needed.

Only what is wholly regular is dealt with here: packets, credit and reductions (`node.runtime.reduction`) of this epoch, in
sequence, with their own checksum, over links that are up and where nothing waits to be sent. Anything else, a fault as well
as another kind of wave, ends the loop and is left to `node.links.link`, as if it had just come; so the rules of links are in
one place only, and a node without native links (in-memory arrays, faulty links) does the same in Python.
"""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

import numpy as np

from raygrid.node.geometry.grid_walk import HOST
from raygrid.node.jit.decorators import lean, part
from raygrid.node.jit.intrinsics import address, bytes_at, call_int, call_long
from raygrid.node.links.zmq_channel import NOBLOCK
from raygrid.node.protocol.messages import (
    COUNT_AT,
    CREDIT_AT,
    EPOCH_AT,
    HEAD,
    SEQUENCE_AT,
    SUMMED,
    WINDOW,
    MessageKind,
)
from raygrid.node.protocol.packets import SIZE, read_u16, read_u32
from raygrid.node.runtime.native_links import LINKS, checksum, clock, post
from raygrid.node.runtime.reduction import (
    REPLY_BYTES,
    REQUEST_BYTES,
    SUM_DATA_DONE,
    SUM_DATA_SENT,
    SUMS,
    add_own_sums_part,
    awaits_reply_part,
    begin_part,
    is_sound_part,
    put_field,
    read_field,
    waits_for_node_part,
)
from raygrid.node.runtime.timers import NO_PLACE, RECEIVING, SENDING, TRACING, count_time
from raygrid.node.tracing.batch import BATCH_CROWDED, BATCH_FULL, BATCH_IDLE, BATCH_LONG, run_batch
from raygrid.node.tracing.primaries import DONE
from raygrid.node.tracing.work_queues import IN_TRANSIT, RAYS, SHADOWS, sort

# further reasons to end, after those of a batch
PYTHON_SENDS, PYTHON_RECEIVES = 4, 5  # Python has something to send; PYTHON_RECEIVES + port: a message for Python
LOOP_PACKETS = 65536  # packets after which Python looks at orders, probes and the clock
LEAST_PASS = 1024  # packets as which a batch counts at least, so that a trickle cannot keep Python from looking
BACK_OFFS = 4  # that make up the time for which a node may wait for more packets
BACK_OFF_FLUSH = 256  # packets for which an output is sent before a back-off
_PACKETS, _CREDIT = int(MessageKind.PACKETS), int(MessageKind.CREDIT)
_REDUCE, _REDUCED = int(MessageKind.REDUCE), int(MessageKind.REDUCED)


# --- receiving -----------------------------------------------------------------------------------------


@part
def _is_in_turn(native, link, raw, first, size):
    """Whether a message is the next one of a link in this epoch, whole and believable."""
    if (
        raw[1] != 0
        or read_u16(raw, EPOCH_AT) != link.epoch
        or read_u32(raw, SEQUENCE_AT) != link.received & 0xFFFFFFFF
        or (read_u32(raw, CREDIT_AT) - link.credit) & 0xFFFFFFFF > link.data_sent - link.credit
    ):
        return False
    return read_u32(raw, SUMMED) == checksum(native, first, size)


@part
def _is_regular(native, port, raw, size):
    """Whether a message is one that is dealt with here, and as long as its kind is."""
    kind, count, payload = np.int64(raw[0]), read_u32(raw, COUNT_AT), size - HEAD
    if kind == _PACKETS:
        return count > 0 and payload == count * SIZE and port != HOST
    if count != 0:
        return False
    if kind == _REDUCE:
        return payload == REQUEST_BYTES and _may_begin(native.reduction, port, raw)
    if kind == _REDUCED:
        return payload == REPLY_BYTES and _may_take_reply(native.reduction, port, raw)
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
def _receive(native, port, bounds, stacks, held):
    """Take in what has come over a link; whether that was all: False if the last message is one for Python."""
    link, functions = native.links[port], native.functions[0]
    message = functions.message
    while True:
        if call_int(functions.message_receive, (message, link.socket, np.int64(NOBLOCK))) < 0:
            return call_int(functions.error, ()) == functions.again
        first, size = call_long(functions.message_data, (message,)), call_long(functions.message_size, (message,))
        if size < HEAD or call_int(functions.message_more, (message,)) != 0:
            return False
        raw = bytes_at(first, size)
        if not _is_regular(native, port, raw, size) or not _is_in_turn(native, link, raw, first, size):
            return False
        count = read_u32(raw, COUNT_AT)
        if count > 0 and not _take_packets(raw, count, port, bounds, stacks, held):
            return False
        link.received += 1
        link.credit += (read_u32(raw, CREDIT_AT) - link.credit) & 0xFFFFFFFF
        if count > 0:
            link.data_done += 1
            if link.data_done - link.data_told >= WINDOW // 2:
                post(native, link, _CREDIT, 0, native.header, 0, np.int64(HEAD))
        elif size > HEAD:
            _take_reduction(native, port, raw)


# --- sending -------------------------------------------------------------------------------------------


@part
def _send(native, port, outputs, least, most):
    """Send what an output holds, at `most` so many packets a message, until it holds fewer than `least`; whether it then does.

    What could not go stays, and a rest that is worth no message of its own.
    """
    link, row, sent = native.links[port], outputs.data[port], np.int64(0)
    while outputs.held[port] - sent >= least and link.data_sent - link.credit < WINDOW:
        many = min(most, outputs.held[port] - sent)
        # the header of a later message takes the place of bytes that were sent
        if not post(native, link, _PACKETS, many, row, sent * SIZE, HEAD + many * SIZE):
            break
        link.data_sent += 1
        sent += many
    if sent > 0:
        for k in range(HEAD, HEAD + (outputs.held[port] - sent) * SIZE):
            row[k] = row[k + sent * SIZE]
        outputs.held[port] -= sent
    return outputs.held[port] < least


@part
def _send_all(native, outputs, least, pressed, most):
    """Send the outputs with `least` packets or more; whether Python is needed: for an output that is not for this code,
    and where something could not go and that cannot wait (pressed)."""
    needed = False
    for port in range(LINKS):
        if outputs.held[port] >= least:
            regular = native.links[port].regular != 0
            if not regular or (not _send(native, port, outputs, least, most) and pressed):
                needed = True
    return needed


# --- reductions ----------------------------------------------------------------------------------------


@part
def _may_begin(reduction, port, raw):
    """Whether a message, as long as a REDUCE, is one that this code can take care of. Reads it, if none is under way."""
    state, request = reduction.state[0], reduction.request[0]
    if state.compiled_serves == 0 or state.pending != 0 or port != state.parent_port:
        return False
    request.wave, request.quota, request.hold = read_field(raw, 0), read_field(raw, 1), read_field(raw, 2)
    request.batch_threshold, request.back_off = read_field(raw, 3), read_field(raw, 4)
    request.flush = read_field(raw, 5)
    return is_sound_part(request)


@part
def _may_take_reply(reduction, port, raw):
    """Whether a message, as long as a REDUCED, is one that is waited for."""
    state = reduction.state[0]
    return state.compiled_serves != 0 and awaits_reply_part(state, port, read_field(raw, 0))


@part
def _take_reduction(native, port, raw):
    """Take in a message of a reduction."""
    reduction, state = native.reduction, native.reduction.state[0]
    if np.int64(raw[0]) == _REDUCE:
        begin_part(state, reduction.request[0], reduction.sums, clock(native))
        return
    for k in range(SUMS):
        reduction.sums[k] += read_field(raw, 1 + k)
    state.replied |= 1 << port


@part
def _notify_children(native):
    """Hand a request on to those children that have not been told yet; whether all have."""
    state, request, message = native.reduction.state[0], native.reduction.request[0], native.reduction.message
    if state.to_notify == 0:
        return True
    put_field(message, 0, request.wave)
    put_field(message, 1, request.quota)
    put_field(message, 2, request.hold)
    put_field(message, 3, request.batch_threshold)
    put_field(message, 4, request.back_off)
    put_field(message, 5, request.flush)
    for port in range(LINKS):
        if (state.to_notify >> port) & 1 != 0:
            if not post(native, native.links[port], _REDUCE, 0, message, 0, np.int64(HEAD + REQUEST_BYTES)):
                return False
            state.to_notify &= ~(1 << port)
    return True


@part
def _reply(node, idle, quota):
    """Reply to a request if it is time for that; whether Python is needed for it."""
    native, reduction, state = node.native, node.native.reduction, node.native.reduction.state[0]
    if state.compiled_serves == 0 or not waits_for_node_part(state):
        return False
    if not (idle and state.python_busy == 0) and clock(native) < state.deadline:
        return False
    for k in range(SUMS):
        reduction.total[k] = reduction.sums[k] + reduction.known[k]
    add_own_sums_part(
        reduction.total, node.step.counts, node.held, node.step.outputs.held, node.cursor[DONE] == 0, quota
    )
    for port in range(LINKS):
        reduction.total[SUM_DATA_SENT] += native.links[port].data_sent
        reduction.total[SUM_DATA_DONE] += native.links[port].data_done
    put_field(reduction.message, 0, state.wave)
    for k in range(SUMS):
        put_field(reduction.message, 1 + k, reduction.total[k])
    parent = native.links[state.parent_port]
    if not post(native, parent, _REDUCED, 0, reduction.message, 0, np.int64(HEAD + REPLY_BYTES)):
        return True
    state.pending = 0
    return False


@part
def _serve_reduction(reduction, quota, tuning):
    """Do what a request asks that has just come; the quota."""
    request = reduction.request[0]
    tuning.batch_threshold, tuning.back_off = request.batch_threshold, request.back_off // BACK_OFFS
    tuning.flush = min(request.flush, tuning.message_packets)
    reduction.state[0].fresh = 0
    return max(quota, request.quota)


# --- the loop ------------------------------------------------------------------------------------------


@part
def _receive_all(native, bounds, stacks, held):
    """Take in what has come over all links; -1, or the port of a link with a message for Python."""
    for port in range(LINKS):
        if native.links[port].regular != 0 and not _receive(native, port, bounds, stacks, held):
            return port
    return -1


@part
def _wait(native):
    """Wait until something comes; whether it came over links that are for this code, and over these only."""
    n = len(native.items)
    if call_int(native.functions[0].poll, (address(native.items, np.int64(0)), np.int64(n), np.int64(-1))) <= 0:
        return False
    for k in range(n):
        port = native.ports[k]
        if native.items[k].found != 0 and (port < 0 or native.links[port].regular == 0):
            return False
    return True


@lean
def run_loop(node, quota):
    """Go round until nothing is left to do, or for a reason above. Returns (quota left, why).

    node   `node_tables.NodeTables`
    quota  primaries that may be spawned
    Without native links it is one batch.
    """
    native, timers, tuning, held, outputs = node.native, node.timers, node.tuning[0], node.held, node.step.outputs
    served, back_offs, since, serves = 0, BACK_OFFS, count_time(timers, NO_PLACE, np.int64(0)), False
    for port in range(LINKS):
        serves = serves or native.links[port].regular != 0
    while True:
        odd = _receive_all(native, node.bounds, node.stacks, held)
        if native.reduction.state[0].fresh != 0:
            quota = _serve_reduction(native.reduction, quota, tuning)
        notified = _notify_children(native)
        since = count_time(timers, RECEIVING, since)
        if odd >= 0:
            return quota, PYTHON_RECEIVES + odd
        if not notified:
            return quota, PYTHON_SENDS
        waiting = held[IN_TRANSIT] + held[SHADOWS] + held[RAYS]
        if quota == 0 or node.cursor[DONE] != 0:
            backs_off = serves and 0 < waiting < tuning.batch_threshold and back_offs > 0
            if waiting == 0 or backs_off:
                needed = _send_all(native, outputs, BACK_OFF_FLUSH if backs_off else 1, True, tuning.message_packets)
                needed = needed or _reply(node, not backs_off, quota)
                since = count_time(timers, SENDING, since)
                if needed:
                    return quota, PYTHON_SENDS
                if backs_off:
                    back_offs -= 1
                elif tuning.may_wait == 0 or not serves or not _wait(native):
                    return quota, BATCH_IDLE
                if tuning.batch_threshold > 0 and tuning.back_off > 0:
                    call_int(native.functions[0].sleep, (np.int64(tuning.back_off),))
                continue
        back_offs = BACK_OFFS
        quota, why, done = run_batch(node.step, node.ray_step, node.cursor, quota, tuning, node.stacks, held)
        since = count_time(timers, TRACING, since)
        if not serves or why == BATCH_CROWDED:
            return quota, why
        needed = _send_all(native, outputs, tuning.flush, why == BATCH_FULL, tuning.message_packets)
        needed = needed or _reply(node, False, quota)
        since = count_time(timers, SENDING, since)
        served += max(done, LEAST_PASS)
        if needed or served >= tuning.loop_packets:
            return quota, PYTHON_SENDS if needed else BATCH_LONG
