"""Rounds of a node in compiled code: look at the links, take a turn, send, and so on, until Python is needed.

Only what is wholly regular is dealt with here: PACKETS and CREDIT messages of this epoch, in sequence, with their own
checksum, over links that are up and where nothing waits to be sent. Anything else, a fault as well as an order of a
wave, ends the rounds and is left to `node.link`, as if it had just come; so the rules of links are in one place only,
and a node without wires (in-memory arrays, faulty links) does the same in Python.

A link's book (`node.link`) is a row of `Wires.books`, so that both keep the same accounts.
"""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from . import native
from .backlog import RAYS, SHADOWS, TRAVELLERS, sort
from .births import DONE
from .compiled import lean, part
from .link import (
    BOOK,
    BYTES_SENT,
    CREDIT,
    DATA_DONE,
    DATA_DONE_TOLD,
    DATA_SENT,
    EPOCH,
    MESSAGES_SENT,
    RECEIVED,
    REGULAR,
    SENT,
    SOCKET,
)
from .messages import SUMMED, WINDOW, MessageKind
from .native import address, bytes_at, call_int, call_long
from .outputs import HEAD
from .packets import SIZE, read_u16, read_u32, write
from .pair import NOBLOCK
from .turn import CROWDED, FULL, IDLE, LONG, turn
from .walk import HOST, PORTS

# further reasons to end, after those of a turn
SEND, OTHER = 4, 5  # Python has something to send; OTHER + port: a message for Python
ROUNDS = 65536  # packets after which Python looks at orders, probes and the clock
LEAST_ROUND = 1024  # packets as which a round counts at least, so that a trickle cannot keep Python from looking
NAPS = 4  # that make up the time for which a node may linger
DROWSY_FLUSH = 256  # packets for which an output is sent before a nap
_PACKETS, _CREDIT = int(MessageKind.PACKETS), int(MessageKind.CREDIT)
# places in Wires.spent and Pace
RECEIVING, TURNING, SENDING = 0, 1, 2
AFTER, BELOW, AT_ONCE, FLUSH, LEAST, NAP, BATCH, WAIT = range(8)


class Wires(NamedTuple):
    """What compiled code needs to serve links.

    books   int64 (PORTS, BOOK): the books of the links to neighbours; those without a socket are left to Python
    calls   int64 (native.ADDRESSES,)
    spent   int64 (5,): nanoseconds of receiving, turns and sending, if there is a clock; and room for what it says
    header  uint8 (HEAD,): room for a header
    items   int64 (n, 2): all that a node waits for (`native.poll_items`), sockets of neighbours first
    ports   int64 (n,): the ports of these, -1 for what Python looks after
    """

    books: NDArray[np.int64]
    calls: NDArray[np.int64]
    spent: NDArray[np.int64]
    header: NDArray[np.uint8]
    items: NDArray[np.int64]
    ports: NDArray[np.int64]


def no_wires() -> Wires:
    """Of a node whose links are served by Python alone."""
    zeros = np.zeros((PORTS, BOOK), np.int64), np.zeros(native.ADDRESSES, np.int64), np.zeros(5, np.int64)
    return Wires(*zeros, np.zeros(HEAD, np.uint8), np.zeros((0, 2), np.int64), np.zeros(0, np.int64))


@part
def _checksum(wires, first, size):
    """The checksum of a message (`node.messages`) from its first address on."""
    seed = call_long(wires.calls[native.CHECKSUM], (first, np.int64(SUMMED), np.int64(0)))
    return call_long(wires.calls[native.CHECKSUM], (first + HEAD, size - HEAD, seed)) & 0xFFFFFFFF


@part
def _post(wires, book, kind, count, raw, at, size):
    """Write the header of a message of `size` bytes that begins at `at`, and send it; whether it went."""
    raw[at], raw[at + 1] = kind, 0
    write(raw, at + 2, book[EPOCH], 2)
    write(raw, at + 4, book[SENT], 4)
    write(raw, at + 8, book[DATA_DONE], 4)
    write(raw, at + 12, count, 4)
    first = address(raw, np.int64(at))
    write(raw, at + SUMMED, _checksum(wires, first, size), 4)
    if call_int(wires.calls[native.SEND], (book[SOCKET], first, size, np.int64(NOBLOCK))) < 0:
        return False
    book[SENT] += 1
    book[DATA_DONE_TOLD] = book[DATA_DONE]
    book[MESSAGES_SENT] += 1
    book[BYTES_SENT] += size
    return True


# --- receiving -----------------------------------------------------------------------------------------


@part
def _is_regular(wires, book, raw, first, size):
    """Whether a message is one of packets or credit, in its turn, whole and believable."""
    kind, count = np.int64(raw[0]), read_u32(raw, 12)
    if (kind != _PACKETS and kind != _CREDIT) or raw[1] != 0 or read_u16(raw, 2) != book[EPOCH]:
        return False
    if read_u32(raw, 4) != book[RECEIVED] & 0xFFFFFFFF or size != HEAD + count * SIZE:
        return False
    if (kind == _PACKETS) != (count > 0):
        return False
    if (read_u32(raw, 8) - book[CREDIT]) & 0xFFFFFFFF > book[DATA_SENT] - book[CREDIT]:
        return False
    return read_u32(raw, SUMMED) == _checksum(wires, first, size)


@part
def _take_in(raw, count, port, bounds, stacks, held):
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
def _receive(wires, port, bounds, stacks, held):
    """Take in what has come over a link; whether that was all: False if the last message is one for Python."""
    book, calls = wires.books[port], wires.calls
    while True:
        message = calls[native.MESSAGE]
        if call_int(calls[native.RECEIVE], (message, book[SOCKET], np.int64(NOBLOCK))) < 0:
            return call_int(calls[native.ERROR], ()) == calls[native.AGAIN]
        first, size = call_long(calls[native.DATA], (message,)), call_long(calls[native.LENGTH], (message,))
        if size < HEAD or call_int(calls[native.MORE], (message,)) != 0:
            return False
        raw = bytes_at(first, size)
        if not _is_regular(wires, book, raw, first, size):
            return False
        count = read_u32(raw, 12)
        if count > 0 and not _take_in(raw, count, port, bounds, stacks, held):
            return False
        book[RECEIVED] += 1
        book[CREDIT] += (read_u32(raw, 8) - book[CREDIT]) & 0xFFFFFFFF
        if count > 0:
            book[DATA_DONE] += 1
            if book[DATA_DONE] - book[DATA_DONE_TOLD] >= WINDOW // 2:
                _post(wires, book, _CREDIT, 0, wires.header, 0, np.int64(HEAD))


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
        if not _post(wires, book, _PACKETS, many, row, sent * SIZE, HEAD + many * SIZE):
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
    for port in range(HOST + 1):
        if outputs.held[port] >= least:
            wired = port < PORTS and wires.books[port, REGULAR] != 0
            if not wired or (not _send(wires, port, outputs, least, batch) and pressed):
                needed = True
    return needed


# --- rounds --------------------------------------------------------------------------------------------


@part
def _clock(wires, place, since):
    """Count the nanoseconds of this thread since then for a place in `spent`; now. Nothing without a clock."""
    if wires.calls[native.CLOCK] == 0:
        return since
    call_int(wires.calls[native.CLOCK], (np.int64(3), address(wires.spent, np.int64(3))))  # CLOCK_THREAD_CPUTIME_ID
    now = wires.spent[3] * 1_000_000_000 + wires.spent[4]
    if place >= 0:
        wires.spent[place] += now - since
    return now


@part
def _receive_all(wires, bounds, stacks, held):
    """Take in what has come over all links; -1, or the port of a link with a message for Python."""
    for port in range(PORTS):
        if wires.books[port, REGULAR] != 0 and not _receive(wires, port, bounds, stacks, held):
            return port
    return -1


@part
def _wait(wires):
    """Wait until something comes; whether it came over links that are for this code, and over these only."""
    n = len(wires.items)
    if call_int(wires.calls[native.POLL], (address(wires.items, np.int64(0)), np.int64(n), np.int64(-1))) <= 0:
        return False
    for k in range(n):
        port = wires.ports[k]
        if wires.items[k, 1] >> 48 != 0 and (port < 0 or wires.books[port, REGULAR] == 0):
            return False
    return True


@lean
def go(cell, space, frame, surfaces, pixels, cursor, quota, pace, bounds, stacks, held, outputs, counts, wires):
    """Go rounds until nothing is left to do, or for a reason above. Returns (quota left, why).

    pace    AFTER, BELOW, AT_ONCE: of `turn`; FLUSH: packets for which an output is sent while there is work;
            LEAST: packets that are worth a turn; NAP: microseconds, for which a node sleeps NAPS times before it takes
            one that is not;
            BATCH: most packets a message; WAIT: whether to wait where nothing is left to do, until something comes
    bounds  int64, the fields of `Limits`
    Without wires it is one turn. The other arguments are those of `turn`.
    """
    served, naps, since, wired = 0, NAPS, _clock(wires, -1, 0), False
    for port in range(PORTS):
        wired = wired or wires.books[port, REGULAR] != 0
    while True:
        odd = _receive_all(wires, bounds, stacks, held)
        since = _clock(wires, RECEIVING, since)
        if odd >= 0:
            return quota, OTHER + odd
        waiting = held[TRAVELLERS] + held[SHADOWS] + held[RAYS]
        if quota == 0 or cursor[DONE] != 0:
            drowsy = wired and 0 < waiting < pace[LEAST] and naps > 0
            if waiting == 0 or drowsy:
                needed = _send_all(wires, outputs, DROWSY_FLUSH if drowsy else 1, True, pace[BATCH])
                since = _clock(wires, SENDING, since)
                if needed:
                    return quota, SEND
                if drowsy:
                    naps -= 1
                elif pace[WAIT] == 0 or not wired or not _wait(wires):
                    return quota, IDLE
                if pace[LEAST] > 0 and pace[NAP] > 0:
                    call_int(wires.calls[native.SLEEP], (np.int64(pace[NAP]),))
                continue
        naps = NAPS
        quota, why, done = turn(
            cell, space, frame, surfaces, pixels, cursor, quota, pace, stacks, held, outputs, counts
        )
        since = _clock(wires, TURNING, since)
        if not wired or why == CROWDED:
            return quota, why
        needed = _send_all(wires, outputs, pace[FLUSH], why == FULL, pace[BATCH])
        since = _clock(wires, SENDING, since)
        served += max(done, LEAST_ROUND)
        if needed or served >= ROUNDS:
            return quota, SEND if needed else LONG
