"""Counts what each cell of an array would do for a frame, from a picture with few pixels, by the ray step of the nodes.

The picture, called the pilot, is the frame itself or the same view with fewer pixels. All its rays are followed through the
cells of the array, so the counts are exact for these pixels; a frame with more pixels has that much more of everything.
Several price lists that look for hits in the same way are summed at once.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raygrid.emulator.partition.sampling_prepass import coarse_frame
from raygrid.emulator.simulator.kernels import find_homes
from raygrid.emulator.simulator.simulator import (
    CLOCK_BYTES,
    NODE_BYTES,
    Holding,
    bytes_of_a_picture,
    whole_picture,
)
from raygrid.emulator.simulator.work_kernels import (
    GROUPS,
    TICKS,
    TIMES,
    Following,
    PacketStack,
    PriceLists,
    WorkSums,
    follow_samples,
)
from raygrid.emulator.topology.limits import check_simulated_fits
from raygrid.node.geometry import DEPTH, PORTS
from raygrid.node.protocol import BORN, COUNTS, PRIMARY, SIZE, Frame, Prices
from raygrid.node.tracing import make_outputs

Long = NDArray[np.int64]
FIRST_ACROSS = 24  # pixels along a side of the picture that tells how many steps a sample takes
LEAST_ACROSS, MOST_ACROSS = 16, 1024  # and of any
LIST_BYTES = 8 * (GROUPS + 2)  # of a cell and a price list: ticks of each group, and what a walk costs, twice
CELL_BYTES = 8 * PORTS + 8 + NODE_BYTES + CLOCK_BYTES  # of a cell, whatever it holds; it is simulated, too


@dataclass(frozen=True)
class CellWork:
    """What the pixels of a small picture cost, for each price list.

    share     samples of the frame for each sample of the picture; 1: the picture is the frame
    samples   of the picture, rays that miss the world box included
    busy      int64 (cells, GROUPS, lists), ticks of work; pixels are dealt to groups row by row and column by column
    sent      int64 (cells, PORTS), packets by each port
    born      int64 (cells,), samples that begin there
    longest   float64 (lists,): ticks of the longest sample, if it meets no other
    counts    int64 (COUNTS,), as of the ray step
    steps     packets served
    """

    share: float
    samples: int
    busy: Long
    sent: Long
    born: Long
    longest: NDArray[np.float64]
    counts: Long
    steps: int


def check_count_fits(shape: tuple[int, int, int], lists: int) -> None:
    """Raise TooLarge for an array that this computer has no memory for.

    lists   price lists that are counted for; one of them is simulated, one phase at a time, while the counts are kept
    """
    most = MOST_ACROSS**2
    check_simulated_fits(
        shape, most, bytes_per_node=CELL_BYTES + lists * LIST_BYTES, fixed_bytes=bytes_of_a_picture(most, most)
    )


def price_lists(prices: Sequence[Prices], walks: Sequence[Long]) -> PriceLists:
    """Put price lists together; walks: of each, what a walk costs in each cell beside its price, int64 (cells,)."""
    packet, transmit, latency, by_processor = (
        np.array([getattr(one, name) for one in prices], np.int64)
        for name in ("packet", "transmit", "latency", "by_processor")
    )
    counts = np.stack([one.counts for one in prices])
    return PriceLists(counts, packet, transmit, latency, by_processor, np.stack(list(walks)))


def steps_of_a_sample(holding: Holding, frame: Frame, prices: PriceLists) -> float:
    """Packets that are served for a sample of this frame, in the mean, samples that miss the world box included."""
    found = _counted(holding, coarse_frame(frame, FIRST_ACROSS), frame, prices)
    return max(found.steps / found.samples, 0.01)


def few_pixels(frame: Frame, samples: float, least: int = LEAST_ACROSS) -> Frame:
    """The same view with about so many pixels of a sample each; the frame itself if it has no more samples than that.

    least   pixels along a side that there are at least, if the frame has them
    Never more samples than MOST_ACROSS along both sides, however many are asked for: for so many there is memory.
    """
    if frame.width * frame.height * frame.samples <= min(samples, MOST_ACROSS**2):
        return frame
    return coarse_frame(frame, int(min(max(math.sqrt(samples), least), MOST_ACROSS)))


def count_cell_work(holding: Holding, frame: Frame, prices: PriceLists, samples: float) -> CellWork:
    """Count the work of a frame's cells from a picture of about so many samples."""
    return _counted(holding, few_pixels(frame, samples), frame, prices)


def _counted(holding: Holding, few: Frame, frame: Frame, prices: PriceLists) -> CellWork:
    samples, lists = few.width * few.height * few.samples, len(prices.packet)
    homes = np.empty(samples, np.int32)
    find_homes(few, holding.space, homes)
    room = (few.n_lights + 4) * (few.depth + 4)
    stack = PacketStack(np.zeros(room * SIZE, np.uint8), np.zeros((room, TICKS + lists), np.int64))
    work = WorkSums(
        np.zeros((holding.cells, GROUPS, lists), np.int64),
        np.zeros((holding.cells, PORTS), np.int64),
        np.zeros(holding.cells, np.int64),
        np.zeros(lists, np.int64),
        np.zeros(COUNTS, np.int64),
        np.zeros(1, np.int64),
    )
    outputs = make_outputs(2 * (few.n_lights + 4), DEPTH)
    counts, times = np.zeros(COUNTS, np.int64), np.zeros((TIMES, lists), np.int64)
    follow_samples(
        Following(
            homes, holding.space, few, holding.surfaces, holding.roots, whole_picture(few), outputs, stack, prices, work,
            counts, times,
        )
    )  # fmt: skip
    work.counts[BORN + PRIMARY] = int(work.born.sum())
    share = frame.width * frame.height * frame.samples / samples
    return CellWork(
        share,
        samples,
        work.busy,
        work.sent,
        work.born,
        work.longest.astype(np.float64),
        work.counts,
        int(work.steps[0]),
    )
