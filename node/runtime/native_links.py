"""What compiled code needs to serve links (`node.runtime.event_loop`): their books, the functions that it calls, and how it posts.

A link's book (`node.links.link`) is a row of `NativeLinks.books`, so that both keep the same accounts.
"""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.node.geometry.grid_walk import PORTS
from raygrid.node.jit.decorators import part
from raygrid.node.jit.intrinsics import address, call_int, call_long
from raygrid.node.links import zmq_c_api
from raygrid.node.links.link import (
    BYTES_SENT,
    EPOCH,
    LINK_DATA_DONE,
    LINK_DATA_TOLD,
    LINK_SENT,
    LINK_STATE,
    MESSAGES_SENT,
    SOCKET,
)
from raygrid.node.links.zmq_channel import NOBLOCK
from raygrid.node.protocol.messages import HEAD, SUMMED
from raygrid.node.protocol.packets import write
from raygrid.node.runtime.reduction import Reduction, make_reduction

LINKS = PORTS + 1  # to neighbours and, of a corner, to the host
# places in NativeLinks.spent: nanoseconds of the parts of a round, room for what a clock says, whether rounds are timed
RECEIVING, TURNING, SENDING = 0, 1, 2
SECONDS, NANOSECONDS, TIMED, SPENT = 3, 4, 5, 6
MONOTONIC, OF_THREAD = 1, 3  # clocks of `clock_gettime`
BILLION = 1_000_000_000


class NativeLinks(NamedTuple):
    """What compiled code needs to serve links.

    books   int64 (LINKS, BOOK): the books of the links; those without a socket are left to Python
    calls   int64 (native.ADDRESSES,)
    spent   int64 (SPENT,): nanoseconds of receiving, turns and sending, if rounds are timed
    header  uint8 (HEAD,): room for a header
    items   int64 (n, 2): all that a node waits for (`native.poll_items`), sockets of links first
    ports   int64 (n,): the ports of these, -1 for what Python looks after
    tally   the tally that is under way
    """

    link_states: NDArray[np.int64]
    calls: NDArray[np.int64]
    spent: NDArray[np.int64]
    header: NDArray[np.uint8]
    items: NDArray[np.int64]
    ports: NDArray[np.int64]
    reduction_state: Reduction


def no_native_links(reduction_state: Reduction | None = None) -> NativeLinks:
    """Of a node whose links are served by Python alone."""
    link_states, calls, spent = (
        np.zeros((LINKS, LINK_STATE), np.int64),
        np.zeros(zmq_c_api.ADDRESSES, np.int64),
        np.zeros(SPENT, np.int64),
    )
    nothing = np.zeros(HEAD, np.uint8), np.zeros((0, 2), np.int64), np.zeros(0, np.int64)
    return NativeLinks(
        link_states, calls, spent, *nothing, make_reduction() if reduction_state is None else reduction_state
    )


@part
def clock(native, which):
    """Nanoseconds by one of the clocks of `clock_gettime`."""
    call_int(native.calls[zmq_c_api.CLOCK], (np.int64(which), address(native.spent, np.int64(SECONDS))))
    return native.spent[SECONDS] * BILLION + native.spent[NANOSECONDS]


@part
def checksum(native, first, size):
    """The checksum of a message (`node.protocol.messages`) from its first address on."""
    seed = call_long(native.calls[zmq_c_api.HASH], (first, np.int64(SUMMED), np.int64(0)))
    return call_long(native.calls[zmq_c_api.HASH], (first + HEAD, size - HEAD, seed)) & 0xFFFFFFFF


@part
def post(native, link_state, kind, count, raw, at, size):
    """Write the header of a message of `size` bytes that begins at `at`, and send it; whether it went."""
    raw[at], raw[at + 1] = kind, 0
    write(raw, at + 2, link_state[EPOCH], 2)
    write(raw, at + 4, link_state[LINK_SENT], 4)
    write(raw, at + 8, link_state[LINK_DATA_DONE], 4)
    write(raw, at + 12, count, 4)
    first = address(raw, np.int64(at))
    write(raw, at + SUMMED, checksum(native, first, size), 4)
    if call_int(native.calls[zmq_c_api.ZMQ_SEND], (link_state[SOCKET], first, size, np.int64(NOBLOCK))) < 0:
        return False
    link_state[LINK_SENT] += 1
    link_state[LINK_DATA_TOLD] = link_state[LINK_DATA_DONE]
    link_state[MESSAGES_SENT] += 1
    link_state[BYTES_SENT] += size
    return True
