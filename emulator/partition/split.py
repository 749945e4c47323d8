"""Places the planes between cells on each axis.

`uniform` gives equal boxes, as in the paper. `balanced` estimates from a sampling pre-pass
(`emulator.partition.sampling_prepass`) what each node would have to do, and searches for the planes by which the busiest
has least (`emulator.partition.cost_grid`). The same scene, camera, settings and shape always give the same planes, and the
picture is the same for any planes.

Without a camera, for a very small picture, with surfaces of a program, or if no ray enters the world box, planes lie at
quantiles of the surfaces: each slab between two planes has about as many as the next. Where an axis has more than
MOST_CELLS cells, they lie at quantiles of where rays begin.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from raygrid.emulator.topology.coordinates import Index
from raygrid.node.errors import ArrayError
from raygrid.node.geometry import F64, HALF, LATTICE, THINNEST_CELL, AddedKind, Space, SurfaceSet, World, make_space
from raygrid.node.protocol import Frame

Line = NDArray[np.int64]
SPLITS = ("balanced", "uniform")
SLICES = 4096  # resolution of a measure along an axis
SPACE_SHARE = 0.1  # of every measure, spread evenly over the world box: empty space is walked too
GRID = 48  # planes to choose from on an axis
MOST_CELLS = 16  # on an axis, for which planes are searched
# Fewer primary and first shadow rays are traced in less time than a pre-pass costs a process that has just started: 0.03 s
# and 0.05 s to load its kernels, part of it while the fork server warms up beside it.
WORTHWHILE = 1 << 18


def split(
    kind: str,
    shape: Index,
    world: World,
    surfaces: SurfaceSet,
    frame: Frame | None = None,
    wait: Callable[[], None] | None = None,
) -> Space:
    """The cells of an array of this shape over these surfaces and for this frame (machine coordinates).

    `wait` is called where the pre-pass' kernels would have to be compiled, and returns when another process has done
    that. Raises ArrayError for what cannot be.
    """
    if max(shape) * THINNEST_CELL > LATTICE:
        raise ArrayError(f"an axis came with {max(shape)} cells, wanted at most {LATTICE // THINNEST_CELL}")
    if kind not in SPLITS:
        raise ArrayError(f"a split came as {kind!r}, wanted one of {', '.join(SPLITS)}")
    planes: Sequence[Line] | None = None
    if kind == "uniform" or shape == (1, 1, 1):
        planes = [_uniform(cells) for cells in shape]
    elif frame is not None and _rays(frame) >= WORTHWHILE and not surfaces.count(AddedKind.PROGRAMMED):
        planes = _when_compiled(lambda: _by_prepass(shape, world, surfaces, frame), wait)
    if planes is None:
        boxes = np.concatenate([batch.bounds() for batch in surfaces])
        planes = [_quantiles(cells, of) for cells, of in zip(shape, _of_surfaces(boxes, world), strict=True)]
    return make_space(world.step, [line.tolist() for line in planes])


def _rays(frame: Frame) -> int:
    return frame.width * frame.height * frame.samples * (1 + frame.n_lights)


def _when_compiled(work: Callable[[], Sequence[Line] | None], wait: Callable[[], None] | None) -> Sequence[Line] | None:
    if wait is not None:
        from raygrid.emulator.partition.cost_grid import NotCompiledError, from_cache_only

        try:
            with from_cache_only():
                return work()
        except NotCompiledError:
            wait()
    return work()


def _uniform(cells: int) -> Line:
    return np.arange(cells + 1, dtype=np.int64) * LATTICE // cells


def _quantiles(cells: int, measure: F64) -> Line:
    """Planes between which there is the same of a measure, float64 (SLICES,)."""
    total = np.concatenate(([0.0], np.cumsum(measure)))
    wanted = np.arange(1, cells) / cells * total[-1]
    below = np.minimum(np.searchsorted(total, wanted, "right") - 1, SLICES - 1)
    # numpy's interpolation may fuse this sum with its product, and then the planes are others
    quantiles = 1.0 / (total[below + 1] - total[below]) * (wanted - total[below]) + below
    return _apart(np.concatenate(([0], np.round(quantiles * (LATTICE / SLICES)).astype(np.int64), [LATTICE])))


def _of_surfaces(boxes: F64, world: World) -> list[F64]:
    """A measure of each axis: every surface counts once, spread evenly over its extent."""
    extents = (boxes / np.array(world.step) + HALF) * (SLICES / LATTICE)
    return [_with_space(_spread(extents[:, :, axis])) for axis in range(3)]


def _of_points(points: Line) -> list[F64]:
    """A measure of each axis: every point on the lattice, int64 (n, 3), counts once."""
    slices = points * SLICES // LATTICE
    return [_with_space(np.bincount(slices[:, axis], minlength=SLICES) / len(points)) for axis in range(3)]


def _with_space(measure: F64) -> F64:
    return measure * (1.0 - SPACE_SHARE) + SPACE_SHARE / SLICES


def _spread(extents: F64) -> F64:
    """How much of intervals, float64 (n, 2), lies in each slice; all together 1."""
    # the integral of an interval's density is a ramp; sums of ramps at the borders of slices, then differences
    slices = np.clip(extents, 0.0, SLICES)
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


# --- by a sampling pre-pass ------------------------------------------------------------------------------


def _by_prepass(shape: Index, world: World, surfaces: SurfaceSet, frame: Frame) -> list[Line] | None:
    """The planes of the least cost that is found from three starts; None if no ray enters the world box."""
    from raygrid.emulator.partition.cost_grid import count_work, improve
    from raygrid.emulator.partition.sampling_prepass import run_prepass

    prepass = run_prepass(world.step, surfaces, frame)
    if len(prepass.rays.origins) == 0:
        return None
    of_rays, of_surfaces = _of_points(prepass.rays.origins), _of_surfaces(prepass.boxes, world)
    by_rays, by_surfaces = (
        [_quantiles(cells, measure) for cells, measure in zip(shape, measures, strict=True)]
        for measures in (of_rays, of_surfaces)
    )
    if max(shape) > MOST_CELLS:
        return by_rays
    lines = [_choice(*axis) for axis in zip(shape, of_rays, of_surfaces, strict=True)]
    work = count_work(prepass, make_space(world.step, [line.tolist() for line in lines]))
    least, best = np.inf, by_rays
    for start in ([_uniform(cells) for cells in shape], by_surfaces, by_rays):
        planes = np.zeros((3, max(shape) + 1), np.int64)
        for axis, cells in enumerate(shape):
            planes[axis, : cells + 1] = _nearest(lines[axis], start[axis])
        cost = improve(work, shape, planes)
        if cost < least:
            least = cost
            best = [line[planes[axis, : shape[axis] + 1]] for axis, line in enumerate(lines)]
    return best


def _choice(cells: int, of_rays: F64, of_surfaces: F64) -> Line:
    """Planes to choose from, close together where there is much."""
    if cells == 1:
        return np.array([0, LATTICE])
    lines = (_quantiles(GRID // 2, of_rays), _quantiles(GRID // 4, of_surfaces), _uniform(GRID // 4))
    kept = [0]
    # by a set, since np.unique imports numpy.ma, 25 ms of every start
    for plane in sorted(set(np.concatenate(lines).tolist())):
        if plane - kept[-1] >= THINNEST_CELL and LATTICE - plane >= THINNEST_CELL:
            kept.append(plane)
    return np.array([*kept, LATTICE])


def _nearest(line: Line, wanted: Line) -> Line:
    """Indices of entries of a line near to the wanted ones, all different, the first and the last among them."""
    found: Line = np.abs(line[:, None] - wanted[None, :]).argmin(axis=0).astype(np.int64)
    last = len(wanted) - 1
    for k in range(1, last):
        found[k] = max(found[k], found[k - 1] + 1)
    found[last] = len(line) - 1
    for k in range(last - 1, 0, -1):
        found[k] = min(found[k], found[k + 1] - 1)
    return found
