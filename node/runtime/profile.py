"""Tells where a node spends its time: for `--profile` only. A node that is not asked has no `Profile`, and its timers are off.

Seconds are CPU seconds of the node's thread, except `wait`, which is what the wall clock shows beside them: the node
slept, or another process had the processor. Compiled code counts its own (`node.runtime.timers`). What happens inside
its batches is sampled: before one call in EVERY some of the packets that wait are decoded, walked, and searched for hits
once more, by the same functions (`node.runtime.profile_kernel`); the times of a packet, times the packets of all batches are the
parts. Births are sampled likewise.

    receive   links, headers, checks, sorting packets onto the stacks
    birth     primary rays
    decode    packets into numbers
    walk      entry and exit of the cell, the exit port
    hit       hierarchy and surfaces
    shade     what is left of the batch: normals, shading, births, encoding, handing on, pixels
    send      outputs to the links
    other     waves and the loop
    wait      none of these
"""

from __future__ import annotations

import contextlib
import functools
import time
from collections.abc import Callable, Iterator
from typing import Concatenate, ParamSpec, Protocol, TypeVar, cast

import numpy as np

from raygrid.node.protocol.counters import BORN, COUNTS, WALKS
from raygrid.node.protocol.packets import PRIMARY, SIZE
from raygrid.node.runtime.node_state import NodeState
from raygrid.node.runtime.profile_kernel import time_spawning, time_tracing
from raygrid.node.runtime.profile_parts import PARTS
from raygrid.node.runtime.timers import DECODING, RECEIVING, SEARCHING, SENDING, SPAWNING, TRACING, WALKING, make_timers
from raygrid.node.tracing.batch import BATCH_RAYS, PORTION
from raygrid.node.tracing.primaries import new_cursor
from raygrid.node.tracing.work_queues import CLASSES, RAYS, SHADOWS

EVERY = 2  # calls, one of which is sampled
LEAST_SAMPLES = 64  # packets worth sampling
SPAWNED = 8192  # primary rays born aside to know the time of one


class Profile:
    """Seconds of one node by part, since its frame began."""

    def __init__(self, node_state: NodeState) -> None:
        self._node_state = node_state
        self._counts = np.zeros(COUNTS, np.int64)
        self._scratch = np.ones(SPAWNED * SIZE, np.uint8)
        self._frames = 0
        node_state.timers = make_timers(True)
        # back to Python while packets wait, or there are none to sample
        node_state.tuning.loop_packets = 4 * BATCH_RAYS
        self._begin()

    def begin_frame(self) -> None:
        """Begin anew, in a node that has just got a frame."""
        warm(self._node_state)  # or the first sample would hold the loading of kernels
        self._begin()

    def _begin(self) -> None:
        self._seconds = dict.fromkeys(("receive", "send", "batches", "aside"), 0.0)
        self._sampled = np.zeros_like(self._node_state.timers.spent)
        self._packets = self._spawned = 0  # that were sampled
        self._calls = 0
        self._frames += 1
        self._wall, self._cpu = time.perf_counter(), time.thread_time()

    @contextlib.contextmanager
    def counting(self, part: str) -> Iterator[None]:
        """What is done within is a part, "receive" or "send", unless a frame begins in it."""
        begun, frames = time.thread_time(), self._frames
        try:
            yield
        finally:
            if self._frames == frames:
                self._seconds[part] += time.thread_time() - begun

    def work(self, wait: bool) -> int:
        """Let the node work, as `NodeState.work`, and see what it spends; some of the packets are sampled before."""
        self._calls += 1
        begun = time.thread_time()
        spent = self._node_state.timers.spent
        spent[:] = 0
        if self._calls % EVERY == 1 and self._node_state.frame is not None:
            self._sample()
            self._sampled += spent
            spent[:] = 0
        served = time.thread_time()
        why = self._node_state.work(wait)
        whole = time.thread_time() - served
        seconds = (spent * 1e-9).tolist()
        self._seconds["receive"] += seconds[RECEIVING]
        self._seconds["send"] += seconds[SENDING]
        self._seconds["batches"] += seconds[TRACING] or whole  # where there is no clock there is nothing else to go by
        self._seconds["aside"] += served - begun
        return why

    def _sample(self) -> None:
        """Time packets that wait, and some that are spawned."""
        node_state = self._node_state
        queues = node_state.work_queues
        for kind in (SHADOWS, RAYS):
            held = int(queues.count[kind])
            if held >= LEAST_SAMPLES:
                first = max(0, held - PORTION)
                packets, ports = queues.stacks[kind], queues.stacks[CLASSES + kind]
                time_tracing(node_state.tables(), packets, ports, first, held, self._counts)
                self._packets += held - first
        if node_state.quota > 0 and node_state.samples_left:
            self._spawned += _spawn_aside(node_state, self._scratch, self._counts)

    def seconds(self) -> dict[str, float]:
        """Seconds by part since the frame began; sampled parts scaled to all batches."""
        wall, cpu = time.perf_counter() - self._wall, time.thread_time() - self._cpu
        spent, sampled, counts = self._seconds, (self._sampled * 1e-9).tolist(), self._node_state.counts
        traced = spent["batches"]
        walked = int(counts[WALKS]) / max(self._packets, 1)
        parts = {
            "decode": sampled[DECODING] * walked,
            "walk": sampled[WALKING] * walked,
            "hit": sampled[SEARCHING] * walked,
            "birth": sampled[SPAWNING] / max(self._spawned, 1) * int(counts[BORN + PRIMARY]),
        }
        known = sum(parts.values())
        if known > traced:  # what is sampled is colder than what it stands for
            parts = {part: seconds * traced / known for part, seconds in parts.items()}
        parts["shade"] = max(traced - known, 0.0)
        parts |= {"receive": spent["receive"], "send": spent["send"]}
        parts["other"] = max(cpu - spent["aside"] - traced - spent["receive"] - spent["send"], 0.0)
        parts["wait"] = max(wall - cpu, 0.0)
        return {part: round(parts[part], 6) for part in PARTS}


def warm(node_state: NodeState) -> None:
    """Load the kernels, or compile them, for a node with a frame."""
    counts = np.zeros(COUNTS, np.int64)
    time_tracing(node_state.tables(), np.zeros(SIZE, np.uint8), np.zeros(1, np.uint8), 0, 0, counts)
    _spawn_aside(node_state, np.zeros(0, np.uint8), counts)


def _spawn_aside(node_state: NodeState, scratch: np.ndarray, counts: np.ndarray) -> int:
    """Spawn as many primary rays as there is room for, of which the node knows nothing; returns how many."""
    tables = node_state.step_tables(node_state.outputs)
    pixels = tables.pixels._replace(samples=tables.pixels.samples.copy())
    aside = tables._replace(pixels=pixels, counts=counts)
    return int(time_spawning(node_state.timers, aside, new_cursor(True), scratch, len(scratch) // SIZE))


# --- what a processor is marked with -----------------------------------------------------------------------


class Profiled(Protocol):
    """Who may have a profile."""

    profile: Profile | None


Who = TypeVar("Who", bound=Profiled)
Arguments = ParamSpec("Arguments")
Method = Callable[Concatenate[Who, Arguments], None]


def counted_as(part: str) -> Callable[[Method[Who, Arguments]], Method[Who, Arguments]]:
    """What a method does is a part of its processor's profile, if it has one."""

    def marked(method: Method[Who, Arguments]) -> Method[Who, Arguments]:
        @functools.wraps(method)
        def counted(self: Who, *arguments: Arguments.args, **options: Arguments.kwargs) -> None:
            if self.profile is None:
                return method(self, *arguments, **options)
            with self.profile.counting(part):
                return method(self, *arguments, **options)

        return cast("Method[Who, Arguments]", counted)

    return marked
