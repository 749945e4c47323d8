"""Plays a recording of probes again: in its own time, or up to its worst moment."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator

from raygrid.emulator.driver import NodeSample
from raygrid.host.probes.record import replay
from raygrid.host.probes.sums import Index

PAUSE_SECONDS = 0.05  # after which the reader is given a turn


def paced(
    samples: Iterable[NodeSample],
    speed: float,
    clock: Callable[[], float] = time.monotonic,
    wait: Callable[[float], None] = time.sleep,
) -> Iterator[NodeSample | None]:
    """The samples, each when its time has come, `speed` times as fast as they were; None now and then between them."""
    begun, first = clock(), None
    for sample in samples:
        first = sample.time if first is None else first
        due = begun + (sample.time - first) / speed
        while (left := due - clock()) > 0.0:
            wait(min(left, PAUSE_SECONDS))
            yield None
        yield sample


def worst_moment(path: str) -> tuple[int, str]:
    """(how many samples there are until then, words): the moment at which most packets waited in the whole array.

    Raises OutputError as `probe_record.replay` does.
    """
    held: dict[Index, int] = {}
    total = most = worst = 0
    first = at = None
    for number, sample in enumerate(replay(path).samples, 1):
        total += sample.held - held.get(sample.node, 0)
        held[sample.node] = sample.held
        first = sample.time if first is None else min(first, sample.time)
        if total > most or at is None:
            most, worst, at = total, number, sample.time
    if at is None or first is None:
        return 0, "there are no samples"
    return worst, f"worst moment: {most:,} packets wait, {at - first:.2f} s after the first sample"
