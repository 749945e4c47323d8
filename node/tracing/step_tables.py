"""Declares what the ray step of one node reads and writes: one tuple that compiled code takes whole.

numba passes a tuple of arrays as if each had been named, so it costs nothing where a function is inlined.
"""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.node.geometry.lattice import Cell, Space
from raygrid.node.geometry.surface_tables import Surfaces
from raygrid.node.jit.decorators import part
from raygrid.node.protocol.frame_tables import Frame
from raygrid.node.tracing.framebuffer import Pixels
from raygrid.node.tracing.primary_rays import PrimaryBatch
from raygrid.node.tracing.ray_setup import RaySetup
from raygrid.node.tracing.spawn import SpawnBatch

# columns of Found.facts: where a ray starts, its direction, when it leaves its cell, and reaches its light; when it meets a
# surface, and where
FOUND_ORIGIN, FOUND_DIRECTION, FOUND_OUT, FOUND_DISTANCE, FOUND_TIME, FOUND_POINT, FOUND_FACTS = 0, 3, 6, 7, 8, 9, 12


class Found(NamedTuple):
    """What an observed step found of rays and shadow rays, by the numbers of their packets. Other steps leave it alone.

    facts   float64 (n, FOUND_FACTS); the last four say nothing of a ray that meets no surface
    items   int64 (n,), the item that each meets first, or -1
    inside  uint8 (n,), 1 where all of a refracted ray is reflected (total internal reflection)
    """

    facts: NDArray[np.float64]
    items: NDArray[np.int64]
    inside: NDArray[np.uint8]


class Outputs(NamedTuple):
    """Output queues and scratch of a step: bytes uint8 (OUTPUTS, HEAD + room * SIZE), packets held int64 (OUTPUTS,).

    stack  int64, keys of the hierarchy; setup  rays that are set up; spawns, seen  rays to be spawned, and samples, noted
    found  what an observed step leaves
    """

    data: NDArray[np.uint8]
    held: NDArray[np.int64]
    stack: NDArray[np.int64]
    setup: RaySetup
    spawns: SpawnBatch
    seen: PrimaryBatch
    found: Found


class StepTables(NamedTuple):
    """All that the ray step of one node reads and writes, but for the packets that it is given.

    counts  int64 (COUNTS,), `node.protocol.counters`: added to
    """

    cell: Cell
    space: Space
    frame: Frame
    surfaces: Surfaces
    pixels: Pixels
    outputs: Outputs
    counts: NDArray[np.int64]


@part
def note_ray(found, k, ray, distance):
    """Note the ray of packet k, as `ray_setup.column` gives it, that has met nothing so far."""
    _, o, d, _, _, t_out, _ = ray
    for axis in range(3):
        found.facts[k, FOUND_ORIGIN + axis], found.facts[k, FOUND_DIRECTION + axis] = o[axis], d[axis]
    found.facts[k, FOUND_OUT], found.facts[k, FOUND_DISTANCE] = t_out, distance
    found.items[k], found.inside[k] = -1, 0


@part
def note_hit(found, k, item, t, inside):
    """Note what the ray of packet k meets, item -1 for nothing."""
    found.facts[k, FOUND_TIME] = t
    for axis in range(3):
        found.facts[k, FOUND_POINT + axis] = (
            found.facts[k, FOUND_ORIGIN + axis] + t * found.facts[k, FOUND_DIRECTION + axis]
        )
    found.items[k], found.inside[k] = item, inside


@part
def counted_in(tables, counts):
    """Make the same tables with other counts."""
    return StepTables(tables.cell, tables.space, tables.frame, tables.surfaces, tables.pixels, tables.outputs, counts)
