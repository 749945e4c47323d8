"""Where the planes between cells lie on each axis.

`uniform` gives equal boxes, as in the paper. `balanced` estimates what each node will have to do from a quick pilot
of rays (`emulator.pilot`) and searches for the planes that make it least, see `_cost_of`. If the pilot sees nothing,
or there are so many cells that it would see too little of each, planes lie at quantiles of a measure: each slab
between two planes has about as much of it as the next.
"""

# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# kernels: numba infers their types

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from raygrid.node.compiled import lean, part
from raygrid.node.errors import ArrayError
from raygrid.node.lattice import HALF, THINNEST_CELL, Space, World, make_space
from raygrid.node.packets import LATTICE
from raygrid.node.surfaces import SurfaceSet
from raygrid.node.tables import Frame

F64 = NDArray[np.float64]
Line = NDArray[np.int64]
Index = tuple[int, int, int]
SPLITS = ("balanced", "uniform")
SLICES = 4096  # resolution of a measure along an axis
SPACE_SHARE = 0.1  # of the measure of surfaces, spread evenly over the world box: empty space is walked too
GRID = 48  # planes to choose from on an axis
MOST_CELLS = 16  # on an axis, for which planes are searched
TOTAL_SHARE = 1.0  # weight of the mean over cells beside the largest cell
SWEEPS = 20


def split(
    kind: str, shape: Index, world: World, surfaces: SurfaceSet, frame: Frame | None = None
) -> Space:
    """The cells of an array of this shape over these surfaces (machine coordinates). Raises ArrayError."""
    if max(shape) * THINNEST_CELL > LATTICE:
        raise ArrayError(f"an axis came with {max(shape)} cells, wanted at most {LATTICE // THINNEST_CELL}")
    if kind not in SPLITS:
        raise ArrayError(f"a split came as {kind!r}, wanted one of {', '.join(SPLITS)}")
    uniform = [_uniform(cells) for cells in shape]
    if kind == "uniform" or shape == (1, 1, 1):
        return make_space(world.step, [line.tolist() for line in uniform])
    extents = (np.concatenate([batch.bounds() for batch in surfaces]) / np.array(world.step) + HALF) / LATTICE
    measures = [_spread(extents[:, :, axis]) * (1.0 - SPACE_SHARE) + SPACE_SHARE / SLICES for axis in range(3)]
    of_surfaces = [_quantiles(cells, measure) for cells, measure in zip(shape, measures, strict=True)]
    planes = of_surfaces
    if frame is not None:
        planes = _by_pilot(shape, world, surfaces, frame, uniform, measures)
    return make_space(world.step, [line.tolist() for line in planes])


def _uniform(cells: int) -> Line:
    return np.arange(cells + 1, dtype=np.int64) * LATTICE // cells


def _quantiles(cells: int, measure: F64) -> Line:
    """Planes between which there is the same of a measure, float64 (SLICES,)."""
    total = np.concatenate(([0.0], np.cumsum(measure)))
    quantiles = np.interp(np.arange(1, cells) / cells * total[-1], total, np.arange(SLICES + 1))
    planes = np.concatenate(([0], np.round(quantiles * (LATTICE / SLICES)).astype(np.int64), [LATTICE]))
    return _apart(planes)


def _spread(extents: F64) -> F64:
    """How much of intervals in 0..1, float64 (n, 2), lies in each slice; all together 1."""
    # the integral of an interval's density is a ramp; sums of ramps at the borders of slices, then differences
    slices = np.clip(extents * SLICES, 0.0, SLICES)
    low, high = slices[:, 0], np.maximum(slices[:, 1], slices[:, 0] + 1e-3)
    density = 1.0 / (high - low)
    ramp = np.zeros(SLICES + 2)
    slope = np.zeros(SLICES + 2)
    for ends, sign in ((low, 1.0), (high, -1.0)):
        slice_after = np.minimum(np.floor(ends).astype(np.intp) + 1, SLICES + 1)
        np.add.at(ramp, slice_after, sign * density * (slice_after - ends))
        np.add.at(slope, slice_after, sign * density)
    # value at border b: all ramps begun before it
    values = np.cumsum(ramp) + np.concatenate(([0.0], np.cumsum(np.cumsum(slope))[:-1]))
    return np.maximum(np.diff(values[: SLICES + 1]), 0.0) / len(extents)


def _apart(planes: Line) -> Line:
    """Push planes apart until every cell is at least THINNEST_CELL steps thick."""
    planes = planes.copy()
    for k in range(1, len(planes) - 1):
        planes[k] = max(planes[k], planes[k - 1] + THINNEST_CELL)
    for k in range(len(planes) - 2, 0, -1):
        planes[k] = min(planes[k], planes[k + 1] - THINNEST_CELL)
    return planes


# --- by a pilot of rays ----------------------------------------------------------------------------------


def _by_pilot(
    shape: Index, world: World, surfaces: SurfaceSet, frame: Frame, uniform: Sequence[Line], measures: Sequence[F64]
) -> list[Line]:
    from .pilot import fly, run_sums, tally

    pilot = fly(world.step, surfaces, frame)
    grid = make_space(world.step, [_grid(cells, measure, pilot.rays.origins[:, axis]).tolist() for axis, (cells, measure) in enumerate(zip(shape, measures, strict=True))])
    work = tally(pilot, grid)
    run_sums(work)
    starts = [uniform, [_quantiles(c, m) for c, m in zip(shape, measures, strict=True)]]
    starts.append([_quantiles(c, _points(pilot.rays.origins[:, axis])) for axis, c in enumerate(shape)])
    best, least = None, np.inf
    for start in starts:
        chosen = np.zeros((3, max(shape) + 1), np.int64)
        for axis in range(3):
            line = grid.planes[axis, : grid.shape[axis] + 1]
            chosen[axis, : shape[axis] + 1] = _nearest_of(line, start[axis])
        cost = _search(work.done, work.crossed, np.array(shape), chosen, np.array(grid.shape), SWEEPS, TOTAL_SHARE)
        if cost < least:
            best, least = chosen, cost
    assert best is not None
    return [grid.planes[axis, best[axis, : shape[axis] + 1]] for axis in range(3)]


def _points(at: Line) -> F64:
    return np.bincount(at * SLICES // LATTICE, minlength=SLICES) / max(1, len(at)) * (1 - SPACE_SHARE) + SPACE_SHARE / SLICES


def _grid(cells: int, measure: F64, points: Line) -> Line:
    if cells == 1:
        return np.array([0, LATTICE])
    g = max(GRID, 3 * cells)
    lines = [_uniform(g // 4), _quantiles(g // 4, measure), _quantiles(g // 2, _points(points))]
    line = np.unique(np.concatenate(lines))
    line = line[np.concatenate(([True], np.diff(line) >= THINNEST_CELL))]
    return np.append(line[LATTICE - line >= THINNEST_CELL], LATTICE)


def _nearest_of(line: Line, wanted: Line) -> Line:
    """Indices of different entries of a line near to the wanted ones, the first and the last of it included."""
    found = np.abs(line[:, None] - wanted[None, :]).argmin(axis=0)
    for k in range(1, len(found)):
        found[k] = max(found[k], found[k - 1] + 1)
    found[-1] = len(line) - 1
    for k in range(len(found) - 2, -1, -1):
        found[k] = min(found[k], found[k + 1] - 1)
    return found


@part
def _rectangle(sums, y0, y1, z0, z1):
    return sums[y1, z1] - sums[y0, z1] - sums[y1, z0] + sums[y0, z0]


@part
def _cell_cost(done, crossed, x0, x1, y0, y1, z0, z1):
    """Work of the box between these planes: what is done in it, and what enters by its six faces."""
    cost = _rectangle(done[x1], y0, y1, z0, z1) - _rectangle(done[x0], y0, y1, z0, z1)
    cost += _rectangle(crossed[0, 0, x0], y0, y1, z0, z1) + _rectangle(crossed[0, 1, x1], y0, y1, z0, z1)
    cost += _rectangle(crossed[1, 0, :, y0], x0, x1, z0, z1) + _rectangle(crossed[1, 1, :, y1], x0, x1, z0, z1)
    cost += _rectangle(crossed[2, 0, :, :, z0], x0, x1, y0, y1) + _rectangle(crossed[2, 1, :, :, z1], x0, x1, y0, y1)
    return cost


@part
def _slab(done, crossed, shape, chosen, axis, low, high, unit):
    """(sum of 8th powers of cells in unit, sum of cells) of the cells between two planes of an axis."""
    powers, total = 0.0, 0.0
    nx, ny, nz = shape[0], shape[1], shape[2]
    if axis == 0:
        nx = 1
    elif axis == 1:
        ny = 1
    else:
        nz = 1
    for i in range(nx):
        x0, x1 = (low, high) if axis == 0 else (chosen[0, i], chosen[0, i + 1])
        for j in range(ny):
            y0, y1 = (low, high) if axis == 1 else (chosen[1, j], chosen[1, j + 1])
            for k in range(nz):
                z0, z1 = (low, high) if axis == 2 else (chosen[2, k], chosen[2, k + 1])
                cost = _cell_cost(done, crossed, x0, x1, y0, y1, z0, z1)
                total += cost
                c = cost / unit
                c *= c
                c *= c
                powers += c * c
    return powers, total


@lean
def _search(done, crossed, shape, chosen, last, sweeps, total_share):
    """Move one plane at a time to where the cost is least, until none moves; returns the cost."""
    cells = shape[0] * shape[1] * shape[2]
    best = np.inf
    unit = 1e-300
    for i in range(shape[0]):
        _, total = _slab(done, crossed, shape, chosen, 0, chosen[0, i], chosen[0, i + 1], 1.0)
        unit += total / cells
    for _ in range(sweeps):
        moved = False
        for axis in range(3):
            for k in range(1, shape[axis]):
                powers, total = 0.0, 0.0
                for i in range(shape[axis]):
                    if i != k - 1 and i != k:
                        more, some = _slab(done, crossed, shape, chosen, axis, chosen[axis, i], chosen[axis, i + 1], unit)
                        powers += more
                        total += some
                here, before = np.inf, chosen[axis, k]
                for at in range(chosen[axis, k - 1] + 1, chosen[axis, k + 1]):
                    p1, t1 = _slab(done, crossed, shape, chosen, axis, chosen[axis, k - 1], at, unit)
                    p2, t2 = _slab(done, crossed, shape, chosen, axis, at, chosen[axis, k + 1], unit)
                    cost = unit * ((powers + p1 + p2) / 1.0) ** 0.125 + total_share * (total + t1 + t2) / cells
                    if cost < here:
                        here = cost
                        if cost < best - 1e-9 * unit:
                            chosen[axis, k] = at
                            best = cost
                if chosen[axis, k] != before:
                    moved = True
        if not moved:
            break
    return best
