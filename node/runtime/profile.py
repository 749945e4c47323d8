"""Where a node spends its time: for `--profile` only, attached from outside, so that nothing is paid for it else.

Seconds are CPU seconds of the node's thread, except `wait`, which is what the wall clock shows beside them: the node
slept, or another process had the processor. Compiled code counts its own (`wires.Wires.spent`). What happens inside
its turns is sampled: before one call in EVERY some of the packets that wait are decoded, walked, and searched for hits
once more, by the same functions, each time from the beginning; the differences, a packet, times the packets of all
turns are the parts. Births are sampled likewise.

    receive   links, headers, checks, sorting packets onto the stacks
    birth     primary rays
    decode    packets into numbers
    walk      entry and exit of the cell, the exit port
    hit       hierarchy and surfaces
    shade     what is left of the turn: normals, shading, births, encoding, handing on, pixels
    send      outputs to the links
    other     waves and the loop
    wait      none of these
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np

from raygrid.node.geometry.lattice import T_MIN
from raygrid.node.jit.decorators import lean
from raygrid.node.protocol.counters import BORN, COUNTS, WALKS
from raygrid.node.protocol.packets import PRIMARY, SHADOW, SIZE
from raygrid.node.runtime.event_loop import TUNE_RETURN
from raygrid.node.runtime.profile_parts import PARTS
from raygrid.node.tracing.batch import BATCH_RAYS, PORTION
from raygrid.node.tracing.primaries import new_cursor, spawn_primaries
from raygrid.node.tracing.ray_setup import SETUP_RAYS, column, read_prepared, set_up_rays
from raygrid.node.tracing.traverse import blocked, closest
from raygrid.node.tracing.work_queues import CLASSES, RAYS, SHADOWS, WorkQueues

if TYPE_CHECKING:
    from raygrid.node.runtime.node_state import NodeState
    from raygrid.node.runtime.processor import Processor

EVERY = 2  # calls, one of which is sampled
LEAST_SAMPLES = 64  # packets worth sampling
DECODE, WALK, HIT = 0, 1, 2
BIRTHS = 8192  # primary rays born aside to know the time of one


@lean
def again(cell, space, frame, surfaces, packets, ports, first, last, what, stack, ahead, counts):
    """Decode packets first..last-1, of one class, and walk and search as far as `what` says; a number that depends on
    all of it."""
    told = 0.0
    shadow = (np.int64(packets[first * SIZE]) & 7) == SHADOW
    for k in range(first, last, SETUP_RAYS):
        many = min(SETUP_RAYS, last - k)
        read_prepared(frame, packets, ports, k, k + many, shadow, ahead)
        told += ahead.words[0]
        if what == DECODE:
            continue
        set_up_rays(cell, space, many, shadow, ahead)
        told += ahead.ways[0]
        if what == WALK or len(surfaces.floats) == 0:
            continue
        for j in range(many):
            _, o, d, inv, t_in, t_out, distance = column(ahead, j)
            lower = max(t_in, T_MIN)
            if shadow:
                told += blocked(surfaces, stack, o, d, inv, lower, min(t_out, distance), counts)
            else:
                told += closest(surfaces, stack, o, d, inv, lower, t_out, counts)[1]
    return told


def warm(node_state: NodeState) -> None:
    """Load the kernel, or compile it, for a tracer with a frame."""
    _again(node_state, np.zeros(SIZE, np.uint8), np.zeros(1, np.uint8), 0, 0, HIT, np.zeros(COUNTS, np.int64))


def _again(
    node_state: NodeState, packets: np.ndarray, ports: np.ndarray, first: int, last: int, what: int, counts: np.ndarray
) -> None:
    tables = node_state.cell, node_state.space, node_state.frame, node_state.surfaces
    again(*tables, packets, ports, first, last, what, node_state.outputs.stack, node_state.outputs.setup, counts)


class Profile:
    """Seconds of one node by part, since its frame began.

    Attached to a processor it takes the place of three of its methods, and adds its figures to the record.
    """

    def __init__(self, processor: Processor) -> None:
        self._processor = processor
        self._counts = np.zeros(COUNTS, np.int64)
        self._scratch = np.ones(BIRTHS * SIZE, np.uint8)
        self._frames = 0
        processor.node_state.tuning[TUNE_RETURN] = (
            4 * BATCH_RAYS
        )  # back to Python while packets wait, or there are none to sample
        self._begin()
        self._record = processor.record
        processor.receive = self._timed("receive", processor.receive)  # type: ignore[method-assign]
        processor._flush = self._timed("send", processor._flush)  # type: ignore[method-assign]
        self._serve = processor.node_state.work
        processor.node_state.work = self._work  # type: ignore[method-assign]
        set_frame = processor.node_state.set_frame

        def begin(frame: Any) -> None:
            set_frame(frame)
            warm(processor.node_state)  # or the first sample would hold the loading of the kernel
            self._begin()

        processor.node_state.set_frame = begin  # type: ignore[method-assign]
        processor.record = self.record  # type: ignore[method-assign]

    def _begin(self) -> None:
        self._seconds = dict.fromkeys(("receive", "send", "turns", "aside"), 0.0)
        self._sampled = dict.fromkeys(("birth", "decode", "walk", "hit"), 0.0)
        self._packets = self._births = 0  # that were sampled
        self._calls = 0
        self._frames += 1
        self._wall, self._cpu = time.perf_counter(), time.thread_time()

    def _timed(self, part: str, method: Any) -> Any:
        def timed(*arguments: Any) -> Any:
            begun, frames = time.thread_time(), self._frames
            try:
                return method(*arguments)
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
        spent[:3] = 0
        served = time.thread_time()
        why = self._serve(wait)
        whole = time.thread_time() - served
        receiving, turning, sending = (spent[:3] * 1e-9).tolist()
        self._seconds["receive"] += receiving
        self._seconds["send"] += sending
        self._seconds["turns"] += turning or whole  # where rounds are not timed there is nothing else to go by
        self._seconds["aside"] += served - begun
        return why

    def _sample(self) -> None:
        """Time packets that wait, and some births."""
        node_state = self._processor.node_state
        for kind in (SHADOWS, RAYS):
            held = int(node_state.work_queues.count[kind])
            if held >= LEAST_SAMPLES:
                self._sample_stack(node_state.work_queues, kind, held)
        if node_state.quota > 0 and node_state.samples_left:
            self._sample_births()

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

    def _sample_births(self) -> None:
        """Bear some primaries aside."""
        node_state = self._processor.node_state
        assert node_state.pixels is not None
        pixels = node_state.pixels._replace(samples=node_state.pixels.samples.copy())
        cursor = new_cursor(True)
        begun = time.thread_time()
        self._births += spawn_primaries(
            node_state.cell,
            node_state.space,
            node_state.frame,
            pixels,
            cursor,
            self._scratch,
            0,
            BIRTHS,
            node_state.outputs.seen,
            self._counts,
        )
        self._sampled["birth"] += time.thread_time() - begun

    def record(self) -> dict[str, Any]:
        """The processor's record with `profile`: seconds by part."""
        record = self._record()
        record["profile"] = {part: round(seconds, 6) for part, seconds in self.seconds().items()}
        return record

    def seconds(self) -> dict[str, float]:
        """Seconds by part since the frame began; sampled parts scaled to all turns."""
        wall, cpu = time.perf_counter() - self._wall, time.thread_time() - self._cpu
        spent, sampled = self._seconds, self._sampled
        turns, counts = spent["turns"], self._processor.node_state.counts
        parts = {part: sampled[part] / max(self._packets, 1) * int(counts[WALKS]) for part in ("decode", "walk", "hit")}
        parts["birth"] = sampled["birth"] / max(self._births, 1) * int(counts[BORN + PRIMARY])
        known = sum(parts.values())
        if known > turns:  # what is sampled is colder than what it stands for
            parts = {part: seconds * turns / known for part, seconds in parts.items()}
        parts["shade"] = max(turns - known, 0.0)
        parts |= {"receive": spent["receive"], "send": spent["send"]}
        parts["other"] = max(cpu - spent["aside"] - turns - spent["receive"] - spent["send"], 0.0)
        parts["wait"] = max(wall - cpu, 0.0)
        return {part: parts[part] for part in PARTS}
