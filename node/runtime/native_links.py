"""Gives compiled code what it needs to serve links (`node.runtime.event_loop`): their state, C functions, and how it posts.

Links (`node.links.link`) count in `NativeLinks.links`, so that Python and compiled code keep the same accounts.
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
from raygrid.node.jit.records import Rows
from raygrid.node.links.link import LinkState
from raygrid.node.links.zmq_c_api import POLL_ITEM, CFunctions
from raygrid.node.links.zmq_channel import NOBLOCK
from raygrid.node.protocol.messages import COUNT_AT, CREDIT_AT, EPOCH_AT, HEAD, SEQUENCE_AT, SUMMED
from raygrid.node.protocol.packets import write
from raygrid.node.runtime.reduction import Reduction, make_reduction
from raygrid.node.runtime.timers import MONOTONIC, read_clock

LINKS = PORTS + 1  # to neighbours and, of a corner, to the host


class NativeLinks(NamedTuple):
    """What compiled code needs to serve links.

    links      LinkState (LINKS,): those without a socket are left to Python
    functions  CFunctions (1,)
    items      POLL_ITEM (n,): all that a node waits for, sockets of links first
    ports      int64 (n,): the ports of these, -1 for what Python looks after
    header     uint8 (HEAD,): room for a header
    reduction  the reduction that is under way
    timespec   int64 (2,): room for what a clock says, seconds and nanoseconds
    """

    links: Rows
    functions: Rows
    items: Rows
    ports: NDArray[np.int64]
    header: NDArray[np.uint8]
    reduction: Reduction
    timespec: NDArray[np.int64]


def no_native_links(reduction: Reduction | None = None) -> NativeLinks:
    """Of a node whose links are served by Python alone."""
    return NativeLinks(
        LinkState.rows(LINKS),
        CFunctions.rows(),
        np.zeros(0, POLL_ITEM),
        np.zeros(0, np.int64),
        np.zeros(HEAD, np.uint8),
        make_reduction() if reduction is None else reduction,
        np.zeros(2, np.int64),
    )


@part
def clock(native):
    """Nanoseconds by the clock that Python calls `time.monotonic`."""
    return read_clock(native.functions[0].clock, MONOTONIC, native.timespec)


@part
def checksum(native, first, size):
    """The checksum of a message (`node.protocol.messages`) from its first address on."""
    function = native.functions[0].checksum
    seed = call_long(function, (first, np.int64(SUMMED), np.int64(0)))
    return call_long(function, (first + HEAD, size - HEAD, seed)) & 0xFFFFFFFF


@part
def post(native, link, kind, count, raw, at, size):
    """Write the header of a message of `size` bytes that begins at `at`, and send it; whether it went."""
    raw[at], raw[at + 1] = kind, 0
    write(raw, at + EPOCH_AT, link.epoch, 2)
    write(raw, at + SEQUENCE_AT, link.sent, 4)
    write(raw, at + CREDIT_AT, link.data_done, 4)
    write(raw, at + COUNT_AT, count, 4)
    first = address(raw, np.int64(at))
    write(raw, at + SUMMED, checksum(native, first, size), 4)
    if call_int(native.functions[0].send, (link.socket, first, size, np.int64(NOBLOCK))) < 0:
        return False
    link.sent += 1
    link.data_told = link.data_done
    link.bytes_sent += size
    return True
