"""Counts from a sampling pre-pass what each cell of an array would have to do, and finds the planes for which that is least.

The pre-pass' rays are walked through a fine grid of possible planes. The work of a cell is a sum over

    voxels   work done at a place: rays emitted and walked there, boxes opened, hits shaded, samples taken in
    faces    rays and return packets that cross a plane, each a walk or a hop more in the cell that they enter

and with running sums over both (Crow, "Summed-area tables for texture mapping", SIGGRAPH 1984), the work of any box
between any planes of the grid is a few additions. The count of walks is exact: a path through the fine grid is the
path through any planes chosen from it and some crossings more, as both put the same times, worked out by the same
arithmetic (`node.geometry.grid_walk`), in the same order.

To let the work at hand, and not space, say where an array is cut: Dippe and Swensen, "An adaptive subdivision
algorithm and parallel architecture for realistic image synthesis", SIGGRAPH 1984; by a sample of rays: Priol and
Bouatouch, "Static load balancing for a parallel ray tracing on a MIMD hypercube", The Visual Computer 5, 1989.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.emulator.partition.kernels import search_planes, walk_rays
from raygrid.emulator.partition.sampling_prepass import SamplingPrepass
from raygrid.node.geometry import (
    DEPTH,
    LATTICE,
    Space,
)
from raygrid.node.jit import compiling_heard_by, is_on_disk

F64 = NDArray[np.float64]
# The largest cell is approached by norms of order 2^n: a low order sees all cells, a high one the largest only.
ORDERS = (2, 3, 6)


class Weights(NamedTuple):
    """What each piece of work costs a node, in microseconds of this computer.

    Rounded from least squares over the counts and busy seconds of 110 nodes: seven scenes at 512x512 on 2x2x2. Only
    their proportions matter. `held` is loading a surface, once a frame.
    """

    walk: float = 0.09
    box: float = 0.045
    hit: float = 0.12
    primary: float = 0.18
    hop: float = 0.08
    returned: float = 0.05
    taken_in: float = 0.06
    held: float = 2.0


class CostGrid(NamedTuple):
    """Running sums over a grid of planes, nx x ny x nz voxels.

    done     float64 (nx + 1, ny + 1, nz + 1): work in all voxels before
    crossed  float64 (3, 2, nx + 1, ny + 1, nz + 1): of each axis, upwards and downwards, cost of crossings of a
             plane (its own index along the axis) in all voxels before along the two others
    """

    done: F64
    crossed: F64


def count_work(prepass: SamplingPrepass, grid: Space, weights: Weights | None = None) -> CostGrid:
    """Running sums of the pre-pass' work over a grid of planes."""
    weights = weights or Weights()
    nx, ny, nz = grid.shape
    work = CostGrid(np.zeros((nx + 1, ny + 1, nz + 1)), np.zeros((3, 2, nx + 1, ny + 1, nz + 1)))
    places = _places(prepass, grid) if weights.held > 0.0 else np.zeros((3, 0), np.int64)
    held = float(weights.held * prepass.each / prepass.share)
    costs = Weights(*map(float, weights))
    walk_rays(prepass.rays, prepass.surfaces, np.zeros(DEPTH, np.int64), grid, costs, work, places, held)
    return work


def _places(prepass: SamplingPrepass, grid: Space) -> NDArray[np.int64]:
    """The voxels that hold the middles of surfaces, counted from 1, int64 (3, n)."""
    places = np.empty((3, len(prepass.boxes)), np.int64)
    for axis in range(3):
        middles = (prepass.boxes[:, 0, axis] + prepass.boxes[:, 1, axis]) / 2.0 / prepass.step[axis] + LATTICE // 2
        places[axis] = np.searchsorted(grid.planes[axis, 1 : grid.shape[axis]], middles, "right") + 1
    return places


def by_cell(work: CostGrid) -> F64:
    """The work of each voxel of the grid as a cell of an array, float64 (nx, ny, nz)."""
    cells = np.diff(np.diff(np.diff(work.done, axis=0), axis=1), axis=2)
    for axis in range(3):
        one, two = (other for other in range(3) if other != axis)
        upwards, downwards = (np.diff(np.diff(work.crossed[axis, way], axis=one), axis=two) for way in (0, 1))
        cells += np.delete(upwards, -1, axis=axis) + np.delete(downwards, 0, axis=axis)
    return cells


# --- search ----------------------------------------------------------------------------------------------


def improve(work: CostGrid, shape: tuple[int, int, int], planes: NDArray[np.int64]) -> float:
    """Move planes, indices into the grid's, int64 (3, largest axis + 1), one at a time to where the largest cell
    plus TOTAL_SHARE of the mean cell is least, until none moves. Returns that sum (by the highest norm)."""
    cost = np.inf
    for order in ORDERS:
        cost = search_planes(work.done, work.crossed, shape, planes, order)
    return float(cost)


class NotCompiledError(Exception):
    """A kernel is not in the cache."""


def _refuse(_function: object) -> None:
    raise NotCompiledError


@contextlib.contextmanager
def from_cache_only() -> Iterator[None]:
    """Where a kernel would be compiled, raise NotCompiledError instead."""
    with compiling_heard_by(begins=_refuse):
        yield


def is_cached() -> bool:
    """Whether kernels of a pre-pass were ever compiled in this state of the sources (a look at names of files only)."""
    return is_on_disk(walk_rays)
