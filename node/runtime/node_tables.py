"""Declares the state of a node that compiled code works on: one tuple of tables, and the numbers that tune the event loop."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.node.jit.indirect import Address
from raygrid.node.jit.records import Record, Rows, record
from raygrid.node.runtime.native_links import NativeLinks
from raygrid.node.runtime.timers import Timers
from raygrid.node.tracing.step_tables import StepTables
from raygrid.node.tracing.work_queues import Stacks


@record
class Tuning(Record):
    """How eagerly a node traces, sends and waits. Requests of a trace change flush, batch_threshold and back_off.

    batch_packets    packets after which a batch ends, and the links are looked at
    admit_below      rays that wait below which primaries are spawned; admit_at_once: how many at once
    flush            packets for which an output is sent while there is work
    batch_threshold  packets that are worth a batch
    back_off         microseconds that a node sleeps, BACK_OFFS times, before it traces fewer
    message_packets  most packets a message
    may_wait         whether to wait for messages where nothing is left to do
    loop_packets     packets after which the event loop ends in any case
    """

    batch_packets: int
    admit_below: int
    admit_at_once: int
    flush: int
    batch_threshold: int
    back_off: int
    message_packets: int
    may_wait: int
    loop_packets: int


class NodeTables(NamedTuple):
    """All that the event loop of a node reads and writes, but for the primaries that it may spawn.

    step       what the ray step reads and writes; counts there are of the frame
    ray_step   the address of the ray step
    cursor     the place of the next primary (`node.tracing.primaries`)
    tuning     Tuning (1,)
    bounds     int64 (7,), what packets of the frame may name, as of `WorkQueues`
    stacks     packets that wait, by class; held: int64 (CLASSES + 1,), how many
    """

    step: StepTables
    ray_step: Address
    cursor: NDArray[np.int64]
    tuning: Rows
    bounds: NDArray[np.int64]
    stacks: Stacks
    held: NDArray[np.int64]
    native: NativeLinks
    timers: Timers
