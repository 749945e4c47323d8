"""Lets compiled code count what it spends, part by part, if it is asked to; a look at one number else."""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.node.jit.decorators import part
from raygrid.node.jit.intrinsics import address, call_int
from raygrid.node.links.zmq_c_api import find_clock

# places in Timers.spent: parts of the event loop, and those that are sampled (`node.runtime.profile_kernel`)
RECEIVING, TRACING, SENDING, DECODING, WALKING, SEARCHING, SPAWNING = PLACES = range(7)
NO_PLACE = -1
MONOTONIC, OF_THREAD = 1, 3  # clocks of `clock_gettime`
BILLION = 1_000_000_000


class Timers(NamedTuple):
    """What compiled code has spent.

    clock     address of `clock_gettime`; 0: nothing is counted
    spent     int64 (len(PLACES),): nanoseconds of processor time of this thread
    timespec  int64 (2,): room for what the clock says, seconds and nanoseconds
    """

    clock: int
    spent: NDArray[np.int64]
    timespec: NDArray[np.int64]


def make_timers(on: bool) -> Timers:
    """Timers that have counted nothing; on a computer without such a clock they never will."""
    return Timers(find_clock() if on else 0, np.zeros(len(PLACES), np.int64), np.zeros(2, np.int64))


@part
def read_clock(function, which, timespec):
    """Nanoseconds by one of the clocks of `clock_gettime`, whose address is `function`."""
    call_int(function, (np.int64(which), address(timespec, np.int64(0))))
    return timespec[0] * BILLION + timespec[1]


@part
def count_time(timers, place, since):
    """Count the nanoseconds of this thread since then for a place; returns now. Nothing unless timers are on."""
    if timers.clock == 0:
        return since
    now = read_clock(timers.clock, OF_THREAD, timers.timespec)
    if place >= 0:
        timers.spent[place] += now - since
    return now
