"""Samples of probes by hand, and what a terminal shows of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from raygrid.emulator.driver.samples import LinkSample, NodeSample
from raygrid.host.probes.probing import Probing
from raygrid.host.probes.sums import Gauges


def made(node=(0, 0, 0), time=1.0, cpu=0.0, phase="trace", walks=0, served=0, epoch=0, number=0) -> NodeSample:
    """A sample by hand."""
    return NodeSample(
        node, epoch, number, time, phase, {"primary": served}, {}, {}, walks, 0,
        {"travellers": 1, "shadows": 2, "rays": 3}, {}, {"-x": 4}, {"+x": LinkSample(1, 2, 3, 4)}, 5,
        {"pss": 1_000_000}, cpu, 0,
    )  # fmt: skip


def filled(shape: tuple[int, int, int], busy: Callable[[int, int, int], float] = lambda x, y, z: 0.0) -> Gauges:
    """An array each of whose nodes has told twice."""
    gauges = Gauges(shape)
    for time in (1.0, 2.0):
        for node in np.ndindex(*shape):
            gauges.take(made(node=node, time=time, cpu=(time - 1.0) * busy(*node)))
    return gauges


def text_of(renderable, width=100) -> str:
    from rich.console import Console

    console = Console(width=width, no_color=True)
    with console.capture() as text:
        console.print(renderable)
    return text.get()


def recorded(path: Path) -> str:
    """A recording of two nodes, one of them half busy."""
    with Probing((2, 1, 1), 10.0, str(path)) as probing:
        for time in (1.0, 2.0):
            for x in (0, 1):
                probing.take(made(node=(x, 0, 0), time=time, cpu=time * x / 2))
    return str(path)
