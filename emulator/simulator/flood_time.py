"""Computes how long it takes to flood a scene into an array, in machine time.

The host sends each description to the corner nearest to it, one after the other on each corner's link; a node looks
at the descriptions in the order (tick, port, sequence) and hands each on along the tree of its corner
(`node.geometry.spanning_tree`), only towards boxes of cells that the surface comes near. A description takes as long on
a link as its bytes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raygrid.emulator.simulator.kernels import run_flood
from raygrid.emulator.simulator.shared_tables import Long, described
from raygrid.emulator.topology.topology import nearest_corners
from raygrid.node.geometry import HALF, Space, SurfaceSet
from raygrid.node.protocol import Prices


class Flooded(NamedTuple):
    """ticks: when the last node has looked at its last description; busy int64 (n,); visits: descriptions looked at."""

    ticks: int
    busy: Long
    visits: int


def flood(space: Space, surfaces: SurfaceSet, prices: Prices, description: int) -> Flooded:
    """Flood surfaces (`shared_tables.ordered`). `description`: ticks that a node takes to look at one."""
    every = described(surfaces)
    corner_of = nearest_corners(every.boxes.mean(axis=1), space.shape)
    busy = np.zeros(space.shape[0] * space.shape[1] * space.shape[2], np.int64)
    planes = (space.planes - HALF).astype(np.float64) * np.array(space.step)[:, None]
    ticks, visits = run_flood(every, corner_of, planes, space.shape, description, prices, busy)
    return Flooded(int(ticks), busy, int(visits))
