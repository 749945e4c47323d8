"""What an increment sends and takes against a full load, for a shot in which one surface in a hundred moves.

    python benchmarks/bench_increments.py [--write docs/animation.md]

Bytes and messages are those of all links of the array, the host's too, counted by the links themselves, waves included;
seconds are wall seconds of this computer, the median of REPEATS.
"""

from __future__ import annotations

import argparse
import time
from functools import partial
from pathlib import Path
from statistics import median

import numpy as np

from raygrid.emulator.driver.driver import Driver
from raygrid.emulator.processes.array import Array
from raygrid.node.geometry.lattice import LATTICE, make_space
from raygrid.node.geometry.rigid_motion import Moves, at_rest, make_groups
from raygrid.node.geometry.surfaces import Batch, Kind, SurfaceSet

SURFACES, GROUPS = 100_000, 10
REPEATS = 7
BEGIN, END = "<!-- increments: begin -->", "<!-- increments: end -->"


def _shot() -> tuple[SurfaceSet, Moves]:
    """Small triangles all over a cube; one in a hundred in GROUPS groups, each a cloud round its own middle."""
    rng = np.random.default_rng(1)
    middles = rng.uniform(-0.45, 0.45, (SURFACES, 1, 3))
    moving = SURFACES // 100
    middles[:moving] = rng.uniform(-0.04, 0.04, (moving, 1, 3))
    corners = middles + rng.uniform(-0.006, 0.006, (SURFACES, 3, 3))
    ids = np.arange(SURFACES, dtype=np.uint32)
    batch = Batch(Kind.TRIANGLE, ids, np.zeros(SURFACES, np.uint16), corners.reshape(-1, 9).astype(np.float32))
    groups = make_groups(ids[:moving], np.arange(moving) * GROUPS // moving, GROUPS)
    motions = at_rest(GROUPS)
    motions[:, 5:] = rng.uniform(-0.4, 0.4, (GROUPS, 3))
    return SurfaceSet((batch,)), Moves(groups, motions)


def _traffic(driver: Driver) -> np.ndarray:
    """(messages, bytes) that all links have sent so far."""
    nodes = driver.report()
    links = driver.links.values()
    messages = sum(node["messages"] for node in nodes) + sum(link.messages_sent for link in links)
    return np.array([messages, sum(node["bytes"] for node in nodes) + sum(link.bytes_sent for link in links)])


def _measured(driver: Driver, work: list) -> tuple[float, int, int]:
    """(seconds, messages, bytes), the median of each, of the calls."""
    idle = -_traffic(driver) + _traffic(driver)  # what asking costs
    seconds, sent = [], []
    for call in work:
        before, begun = _traffic(driver), time.perf_counter()
        call()
        seconds.append(time.perf_counter() - begun)
        sent.append(_traffic(driver) - before - idle)
    messages, octets = np.median(np.array(sent), axis=0)
    return median(seconds), int(messages), int(octets)


def _row(name: str, found: tuple[float, int, int], full: tuple[float, int, int]) -> str:
    seconds, messages, octets = found
    if found is full:
        return f"| {name} | {octets:,} | {messages:,} | {1e3 * seconds:.0f} ms | |"
    less = full[2] / max(octets, 1)
    return f"| {name} | {octets:,} | {messages:,} | {1e3 * seconds:.0f} ms | {less:.0f} |"


def tables(shapes: tuple[tuple[int, int, int], ...] = ((2, 2, 2), (3, 3, 3))) -> str:
    """The tables as Markdown."""
    surfaces, moves = _shot()
    rng = np.random.default_rng(2)

    def shifted(far: float) -> Moves:
        motions = moves.motions.copy()
        motions[:, 5:] = np.clip(motions[:, 5:] + rng.uniform(-far, far, (GROUPS, 3)), -0.44, 0.44)
        return moves._replace(motions=motions)

    parts = []
    for shape in shapes:
        space = make_space((2.0**-24,) * 3, [[LATTICE * k // n for k in range(n + 1)] for n in shape])
        with Array.launch(shape) as array:
            driver = array.driver
            full = _measured(driver, [partial(driver.load, space, surfaces, moves)] * REPEATS)
            near = [partial(driver.move, shifted(0.02)) for _ in range(REPEATS)]
            far = [partial(driver.move, shifted(0.8)) for _ in range(REPEATS)]
            rows = [("full load", full)]
            rows += [("increment, moved by 2 % of the box", _measured(driver, near))]
            rows += [("increment, moved anywhere", _measured(driver, far))]
        head = f"| {'x'.join(map(str, shape))} | bytes | messages | wall time | times fewer bytes |\n|---|---|---|---|---|\n"
        parts.append(head + "\n".join(_row(name, found, full) for name, found in rows))
    return "\n\n".join(parts)


def main() -> None:
    """Print the tables, or write them between their marks in a file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", type=Path, metavar="FILE")
    options = parser.parse_args()
    text = tables()
    if options.write is None:
        print(text)
        return
    page = options.write.read_text()
    before, rest = page.split(BEGIN)
    options.write.write_text(f"{before}{BEGIN}\n{text}\n{END}{rest.split(END)[1]}")


if __name__ == "__main__":
    main()
