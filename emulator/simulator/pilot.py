"""Counts a pilot of a frame on an array: what each cell would do, by the ray step of the nodes, without queues.

A pilot is the frame itself or the same view with fewer pixels. All rays are followed through the cells of the array, so the
counts are exact for these pixels; a frame with more pixels has that much more of everything. Several cost models that look for
hits in the same way are priced at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raygrid.emulator.partition.sampling_prepass import coarse_frame
from raygrid.emulator.simulator.kernels import find_homes
from raygrid.emulator.simulator.pilot_kernels import (
    GROUPS,
    TICKS,
    PilotStack,
    PilotWork,
    PriceLists,
    follow_samples,
)
from raygrid.emulator.simulator.shared_tables import SharedGeometry, one_hierarchy, ordered, shared_geometry, trees
from raygrid.emulator.simulator.simulator import whole_picture
from raygrid.emulator.topology.limits import check_simulated_fits
from raygrid.node.geometry import DEPTH, PORTS, Space, Surfaces, SurfaceSet
from raygrid.node.protocol import COUNTS, SIZE, Frame, Prices
from raygrid.node.tracing import make_outputs

Long = NDArray[np.int64]
FIRST_ACROSS = 24  # pixels along a side of the pilot that finds out how many steps a sample takes
MOST_ACROSS = 1024
LIST_BYTES = 8 * (GROUPS + 1)  # of a cell and a price list
CELL_BYTES = 8 * PORTS + 8 + 64 + 128  # of a cell, whatever it holds


@dataclass(frozen=True)
class Holding:
    """What the cells of an array hold, ready for pilots of any size.

    held     int64 (cells, 6): surfaces of each kind
    surfaces, roots   tables, and rows of the hierarchy of each cell
    """

    space: Space
    held: Long
    surfaces: Surfaces
    roots: Long

    @property
    def cells(self) -> int:
        """How many processors the array has."""
        return len(self.held)


@dataclass(frozen=True)
class Pilot:
    """What the pixels of a pilot cost, for each price list.

    share     samples of the frame for each sample of the pilot; 1: the pilot is the frame
    samples   of the pilot, rays that miss the world box included
    busy      int64 (cells, GROUPS, lists), ticks of work; the groups are pixels of even and odd rows and columns
    sent      int64 (cells, PORTS), packets by each port
    born      int64 (cells,), samples that begin there
    longest, mean   float64 (lists,): ticks of a sample that meets no other, the longest and the mean
    counts    int64 (COUNTS,), as of the ray step
    steps     packets served
    """

    share: float
    samples: int
    busy: Long
    sent: Long
    born: Long
    longest: NDArray[np.float64]
    mean: NDArray[np.float64]
    counts: Long
    steps: int


def check_pilot_fits(shape: tuple[int, int, int], lists: int) -> None:
    """Raise TooLarge for an array that this computer has no memory for."""
    check_simulated_fits(
        shape, MOST_ACROSS**2, bytes_per_node=CELL_BYTES + lists * LIST_BYTES, fixed_bytes=64 * MOST_ACROSS**2
    )


def hold(space: Space, surfaces: SurfaceSet, search: str) -> Holding:
    """Work out what each cell holds; with `tree` each has the hierarchy that its node would build."""
    sorted_surfaces = ordered(surfaces)
    held: SharedGeometry = shared_geometry(sorted_surfaces, space)
    tables, roots = (trees if search == "tree" else one_hierarchy)(sorted_surfaces, space, held)
    return Holding(space, held.held, tables, roots)


def price_lists(prices: Sequence[Prices], walks: Sequence[Long]) -> PriceLists:
    """Gather price lists; walks: of each, what a walk costs in each cell beside its price, int64 (cells,)."""
    return PriceLists(
        np.stack([one.counts for one in prices]),
        *(
            np.array([getattr(one, name) for one in prices], np.int64)
            for name in ("packet", "transmit", "latency", "by_processor")
        ),
        np.stack(list(walks)),
    )


def count_pilot(holding: Holding, frame: Frame, prices: PriceLists, most_steps: int) -> Pilot:
    """Count a pilot of about so many steps, of the whole frame if it has no more. Two runs: a small one tells how many
    steps a sample takes."""
    small = _counted(holding, coarse_frame(frame, FIRST_ACROSS), frame, prices)
    across = int((most_steps * small.samples / max(small.steps, 1)) ** 0.5)
    if frame.width * frame.height * frame.samples <= across**2:
        return _counted(holding, frame, frame, prices)
    across = min(max(across, FIRST_ACROSS), MOST_ACROSS)
    return _counted(holding, coarse_frame(frame, across), frame, prices)


def _counted(holding: Holding, pilot: Frame, frame: Frame, prices: PriceLists) -> Pilot:
    samples, lists = pilot.width * pilot.height * pilot.samples, len(prices.packet)
    homes = np.empty(samples, np.int32)
    find_homes(pilot, holding.space, homes)
    room = (pilot.n_lights + 4) * (pilot.depth + 4)
    stack = PilotStack(np.zeros(room * SIZE, np.uint8), np.zeros((room, TICKS + lists), np.int64))
    work = PilotWork(
        np.zeros((holding.cells, GROUPS, lists), np.int64),
        np.zeros((holding.cells, PORTS), np.int64),
        np.zeros(holding.cells, np.int64),
        np.zeros(lists, np.int64),
        np.zeros(lists, np.int64),
        np.zeros(COUNTS, np.int64),
        np.zeros(1, np.int64),
    )
    follow_samples(
        homes, holding.space, pilot, holding.surfaces, holding.roots, whole_picture(pilot),
        make_outputs(2 * (pilot.n_lights + 4), DEPTH), stack, prices, work, np.zeros(COUNTS, np.int64),
        np.zeros((4, lists), np.int64),
    )  # fmt: skip
    born = max(int(work.born.sum()), 1)
    share = frame.width * frame.height * frame.samples / samples
    return Pilot(
        share, samples, work.busy, work.sent, work.born, work.longest.astype(np.float64), work.together / born,
        work.counts, int(work.steps[0]),
    )  # fmt: skip
