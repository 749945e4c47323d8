"""Where the planes between cells lie on each axis.

`uniform` gives equal boxes, as in the paper. `balanced` puts the planes so that each slab between two planes
holds about as many surfaces as the next: every surface counts once, spread evenly over its extent along the
axis, and SPACE_SHARE of the measure is spread evenly over the world box, because empty space is walked too.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raygrid.node.errors import ArrayError
from raygrid.node.lattice import HALF, THINNEST_CELL, Space, World, make_space
from raygrid.node.packets import LATTICE
from raygrid.node.surfaces import SurfaceSet

Index = tuple[int, int, int]
SPLITS = ("balanced", "uniform")
SLICES = 4096  # resolution of the measure along an axis
SPACE_SHARE = 0.1


def split(kind: str, shape: Index, world: World, surfaces: SurfaceSet) -> Space:
    """The cells of an array of this shape over these surfaces (machine coordinates). Raises ArrayError."""
    if max(shape) * THINNEST_CELL > LATTICE:
        raise ArrayError(f"an axis came with {max(shape)} cells, wanted at most {LATTICE // THINNEST_CELL}")
    if kind == "uniform":
        planes = [_uniform(cells) for cells in shape]
    elif kind == "balanced":
        boxes = np.concatenate([batch.bounds() for batch in surfaces])
        planes = [_balanced(cells, boxes[:, :, axis], world.step[axis]) for axis, cells in enumerate(shape)]
    else:
        raise ArrayError(f"a split came as {kind!r}, wanted one of {', '.join(SPLITS)}")
    return make_space(world.step, planes)


def _uniform(cells: int) -> list[int]:
    return [k * LATTICE // cells for k in range(cells + 1)]


def _balanced(cells: int, extents: NDArray[np.float64], step: float) -> list[int]:
    """Quantiles of the measure along one axis. extents: (surfaces, 2), machine coordinates."""
    slices = np.clip((extents / step + HALF) * (SLICES / LATTICE), 0.0, SLICES)
    low, high = slices[:, 0], np.maximum(slices[:, 1], slices[:, 0] + 1e-3)
    measure = _spread(low, high) / len(extents) * (1.0 - SPACE_SHARE) + SPACE_SHARE / SLICES
    total = np.concatenate(([0.0], np.cumsum(measure)))
    quantiles = np.interp(np.arange(1, cells) / cells * total[-1], total, np.arange(SLICES + 1))
    planes = np.concatenate(([0], np.round(quantiles * (LATTICE / SLICES)).astype(np.int64), [LATTICE]))
    return [int(plane) for plane in _apart(planes)]


def _spread(low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.float64]:
    """How much of the intervals low..high, each of measure 1, lies in each slice."""
    # the integral of an interval's density is a ramp; sums of ramps at the borders of slices, then differences
    density = 1.0 / (high - low)
    ramp = np.zeros(SLICES + 2)
    slope = np.zeros(SLICES + 2)
    for ends, sign in ((low, 1.0), (high, -1.0)):
        slice_after = np.minimum(np.floor(ends).astype(np.intp) + 1, SLICES + 1)
        np.add.at(ramp, slice_after, sign * density * (slice_after - ends))
        np.add.at(slope, slice_after, sign * density)
    # value at border b: all ramps begun before it
    values = np.cumsum(ramp) + np.concatenate(([0.0], np.cumsum(np.cumsum(slope))[:-1]))
    return np.maximum(np.diff(values[: SLICES + 1]), 0.0)


def _apart(planes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Push planes apart until every cell is at least THINNEST_CELL steps thick."""
    planes = planes.copy()
    for k in range(1, len(planes) - 1):
        planes[k] = max(planes[k], planes[k - 1] + THINNEST_CELL)
    for k in range(len(planes) - 2, 0, -1):
        planes[k] = min(planes[k], planes[k + 1] - THINNEST_CELL)
    return planes
