"""Tells where a node spends its time: for `--profile` only, attached from outside, so that nothing is paid for it else.

Seconds are CPU seconds of the node's thread, except `wait`, which is what the wall clock shows beside them: the node
slept, or another process had the processor. Compiled code counts its own (`NativeLinks.spent`). What happens inside
its batches is sampled: before one call in EVERY some of the packets that wait are decoded, walked, and searched for hits
once more, by the same functions, each time from the beginning; the differences, a packet, times the packets of all
batches are the parts. Births are sampled likewise.

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

import time
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import numpy as np

from raygrid.node.protocol.counters import BORN, COUNTS, WALKS
from raygrid.node.protocol.frame_tables import Frame
from raygrid.node.protocol.packets import PRIMARY, SIZE
from raygrid.node.runtime.node_state import NodeState
from raygrid.node.runtime.processor import Processor
from raygrid.node.runtime.profile_kernel import DECODE, HIT, WALK, trace_again
from raygrid.node.runtime.profile_parts import PARTS
from raygrid.node.runtime.reduction import Long
from raygrid.node.runtime.report import NodeRecord
from raygrid.node.tracing.batch import BATCH_RAYS, PORTION
from raygrid.node.tracing.primaries import new_cursor, spawn_primaries
from raygrid.node.tracing.work_queues import CLASSES, RAYS, SHADOWS, Bytes, WorkQueues

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

EVERY = 2  # calls, one of which is sampled
LEAST_SAMPLES = 64  # packets worth sampling
SPAWNED = 8192  # primary rays born aside to know the time of one


def warm(node_state: NodeState) -> None:
    """Load the kernel, or compile it, for a node with a frame."""
    _again(node_state, np.zeros(SIZE, np.uint8), np.zeros(1, np.uint8), 0, 0, HIT, np.zeros(COUNTS, np.int64))


def _again(node_state: NodeState, packets: Bytes, ports: Bytes, first: int, last: int, what: int, counts: Long) -> None:
    tables = node_state.cell, node_state.space, node_state.frame, node_state.surfaces
    trace_again(*tables, packets, ports, first, last, what, node_state.outputs.stack, node_state.outputs.setup, counts)


class Profile:
    """Seconds of one node by part, since its frame began.

    Attached to a processor it takes the place of three of its methods, and adds its figures to the record.
    """

    def __init__(self, processor: Processor) -> None:
        self._processor = processor
        self._counts = np.zeros(COUNTS, np.int64)
        self._scratch = np.ones(SPAWNED * SIZE, np.uint8)
        self._frames = 0
        # back to Python while packets wait, or there are none to sample
        processor.node_state.tuning.loop_packets = 4 * BATCH_RAYS
        self._begin()
        self._record = processor.record
        self._serve, self._set_frame = processor.node_state.work, processor.node_state.set_frame
        for owner, name, method in (
            (processor, "receive", self._timed("receive", processor.receive)),
            (processor, "_flush", self._timed("send", processor._flush)),
            (processor, "record", self.record),
            (processor.node_state, "work", self._work),
            (processor.node_state, "set_frame", self._begin_frame),
        ):
            setattr(owner, name, method)

    def _begin_frame(self, frame: Frame) -> None:
        self._set_frame(frame)
        warm(self._processor.node_state)  # or the first sample would hold the loading of the kernel
        self._begin()

    def _begin(self) -> None:
        self._seconds = dict.fromkeys(("receive", "send", "batches", "aside"), 0.0)
        self._sampled = dict.fromkeys(("birth", "decode", "walk", "hit"), 0.0)
        self._packets = self._spawned = 0  # that were sampled
        self._calls = 0
        self._frames += 1
        self._wall, self._cpu = time.perf_counter(), time.thread_time()

    def _timed(self, part: str, method: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
        def timed(*arguments: Arguments.args, **options: Arguments.kwargs) -> Result:
            begun, frames = time.thread_time(), self._frames
            try:
                return method(*arguments, **options)
            finally:
                if self._frames == frames:  # else the frame began in it
                    self._seconds[part] += time.thread_time() - begun

        return timed

    def _work(self, wait: bool = False) -> int:
        self._calls += 1
        begun = time.thread_time()
        if self._calls % EVERY == 1 and self._processor.node_state.frame is not None:
            self._sample()
        spent = self._processor.node_state.native.spent
        spent[:] = 0
        served = time.thread_time()
        why = self._serve(wait)
        whole = time.thread_time() - served
        receiving, tracing, sending = (spent * 1e-9).tolist()
        self._seconds["receive"] += receiving
        self._seconds["send"] += sending
        self._seconds["batches"] += tracing or whole  # where the event loop is not timed there is nothing else to go by
        self._seconds["aside"] += served - begun
        return why

    def _sample(self) -> None:
        """Time packets that wait, and some that are spawned."""
        node_state = self._processor.node_state
        for kind in (SHADOWS, RAYS):
            held = int(node_state.work_queues.count[kind])
            if held >= LEAST_SAMPLES:
                self._sample_stack(node_state.work_queues, kind, held)
        if node_state.quota > 0 and node_state.samples_left:
            self._sample_spawned()

    def _sample_stack(self, work_queues: WorkQueues, kind: int, held: int) -> None:
        node_state = self._processor.node_state
        first = max(0, held - PORTION)

        def timed(end: int, what: int) -> float:
            begun = time.thread_time()
            _again(
                node_state, work_queues.stacks[kind], work_queues.stacks[CLASSES + kind], first, end, what, self._counts
            )
            return time.thread_time() - begun

        timed(first, DECODE)  # the way into compiled code is long, and cold the first time
        before = timed(first, DECODE)
        self._packets += held - first
        for part, what in (("decode", DECODE), ("walk", WALK), ("hit", HIT)):
            spent = timed(held, what)
            self._sampled[part] += max(spent - before, 0.0)
            before = spent

    def _sample_spawned(self) -> None:
        """Spawn some primaries aside."""
        node_state = self._processor.node_state
        tables = node_state.step_tables(node_state.outputs)
        pixels = tables.pixels._replace(samples=tables.pixels.samples.copy())
        cursor = new_cursor(True)
        begun = time.thread_time()
        self._spawned += spawn_primaries(
            tables._replace(pixels=pixels, counts=self._counts), cursor, self._scratch, 0, SPAWNED
        )
        self._sampled["birth"] += time.thread_time() - begun

    def record(self) -> NodeRecord:
        """The processor's record with `profile`: seconds by part."""
        record = self._record()
        record["profile"] = {part: round(seconds, 6) for part, seconds in self.seconds().items()}
        return record

    def seconds(self) -> dict[str, float]:
        """Seconds by part since the frame began; sampled parts scaled to all batches."""
        wall, cpu = time.perf_counter() - self._wall, time.thread_time() - self._cpu
        spent, sampled = self._seconds, self._sampled
        traced, counts = spent["batches"], self._processor.node_state.counts
        parts = {part: sampled[part] / max(self._packets, 1) * int(counts[WALKS]) for part in ("decode", "walk", "hit")}
        parts["birth"] = sampled["birth"] / max(self._spawned, 1) * int(counts[BORN + PRIMARY])
        known = sum(parts.values())
        if known > traced:  # what is sampled is colder than what it stands for
            parts = {part: seconds * traced / known for part, seconds in parts.items()}
        parts["shade"] = max(traced - known, 0.0)
        parts |= {"receive": spent["receive"], "send": spent["send"]}
        parts["other"] = max(cpu - spent["aside"] - traced - spent["receive"] - spent["send"], 0.0)
        parts["wait"] = max(wall - cpu, 0.0)
        return {part: parts[part] for part in PARTS}
