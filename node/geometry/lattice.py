"""Defines machine coordinates, the lattice, and the planes that cut the world box into cells.

The front end moves the scene so that its world box is centred on the origin and scales it by a power of
two so that the longest half edge lies in [0.5, 1). All tolerances are therefore plain numbers. The box
carries 2^24 lattice steps an axis; the step of an axis is its edge / 2^24 (DESIGN section 4).

Lattice coordinate k of an axis stands for (k - 2^23) * step. Which cell holds an origin is an integer
comparison: plane[c] <= k < plane[c + 1], the same for every node.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.node.errors import SceneError
from raygrid.node.geometry.surfaces import STORED_AS, AddedKind, Batch, Kind, SurfaceSet
from raygrid.node.jit.decorators import part
from raygrid.node.jit.formula import formula
from raygrid.node.jit.lanes import F64, I32, I64, LATTICE_POINT, VECTOR, Lanes, Three, dot, most, within

LATTICE = 1 << 24  # steps an axis
HALF = LATTICE // 2
LONGEST_STEP = 2.0**-23  # the step of the longest axis is at most this
T_MIN = LONGEST_STEP  # no hit is nearer to a ray's origin than this, in any cell
LIFT = 2.0 * LONGEST_STEP  # a secondary ray starts this far off the surface, so that rounding cannot put it behind
GENTLE = 0.125  # sine of the angle to a surface below which a secondary ray is not lifted along itself alone
SLOW = 0.25  # a ray is slow on an axis if its unit direction has less than this there; on one it never is
SLACK = 2.0**-17  # a cell retains what comes this near to it; see `node.geometry.overlap`
WIDEN = 2.0**-10  # the world box is this part of its longest edge wider than the surfaces, on each side
FINE = 2.0**92  # squares of parts of a step, below 2^-45, become whole numbers below 2^47
THINNEST_CELL = 64  # lattice steps


class Space(NamedTuple):
    """The world box and its cells, in machine coordinates; the same in every node.

    step    size of a lattice step on each axis
    shape   cells on each axis
    planes  int64 (3, largest axis + 1), lattice coordinates 0 .. 2^24, ascending; unused ends are 2^24
    """

    step: tuple[float, float, float]
    shape: tuple[int, int, int]
    planes: NDArray[np.int64]


class Cell(NamedTuple):
    """One subvolume: its place in the array, its bounds on the lattice, and the same bounds as numbers."""

    index: tuple[int, int, int]  # type: ignore[assignment]  # hides tuple.index, which nothing needs
    low: tuple[int, int, int]
    high: tuple[int, int, int]
    low_at: tuple[float, float, float]
    high_at: tuple[float, float, float]


CELL = Cell(*(LATTICE_POINT,) * 3, *(VECTOR,) * 2)  # type: ignore[arg-type]  # as formulas take it


@formula(takes=(I64, F64), gives=F64)
def coordinate(k: Lanes, step: Lanes) -> Lanes:
    """The number that a lattice coordinate stands for."""
    return (k - HALF).to(F64) * step


@formula(takes=(F64, F64), gives=I64)
def nearest(x: Lanes, step: Lanes) -> Lanes:
    """The lattice coordinate nearest to a number, inside the world box; what is no number lies at 0, too."""
    return within(math.floor(x / step + 0.5) + float(HALF), 0.0, LATTICE - 1.0).to(I32)


def next_on_lattice(places: Three, speeds: Three, d: Three, step: Three) -> tuple[Lanes, Lanes]:
    """(t, speed in steps) at which a ray next has a coordinate on the lattice, of the axis that is worth most there.

    places, speeds  its origin and direction in steps
    A coordinate is worth the more, the coarser its lattice, if the ray is not slow on its axis.
    """
    worth = [(abs(d[axis]) >= SLOW).choose(abs(d[axis]) * step[axis], 0.0) for axis in range(3)]
    by_x, by_y = worth[0] >= most(worth[1], worth[2]), worth[1] >= worth[2]
    place, speed = (by_x.choose(of[0], by_y.choose(of[1], of[2])) for of in (places, speeds))
    return ((speed > 0.0).choose(math.ceil(place), math.floor(place)) - place) * (1.0 / speed), speed


def beside_ray(step: Three, p: Three, d: Three, tries: int) -> list[Lanes]:
    """The lattice coordinates of a point beside the ray that starts at p in direction d, at p or a little further on.

    Rounding p would put the ray up to 0.87 steps aside, but a step along itself changes nothing of what it sees. So of
    the next `tries` points at which one coordinate lies on the lattice, the one is taken whose others miss it least.
    """
    places, speeds = ([of[axis] / step[axis] for axis in range(3)] for of in (p, d))
    t, speed = next_on_lattice(places, speeds, d, step)
    if tries > 1:
        t = _nearest_of_next(t, places, speeds, d, step, tries, speed)
    return [nearest(p[axis] + t * d[axis], step[axis]) for axis in range(3)]


def _nearest_of_next(
    first: Lanes, places: Three, speeds: Three, d: Three, step: Three, tries: int, speed: Lanes
) -> Lanes:
    """The time of that of the next points on the lattice, from time `first` on, which misses the lattice least."""
    stride = most(speed.every(1.0), math.floor(abs(speed) * LONGEST_STEP)) * abs(1.0 / speed)
    least_aside, t = first.every(float("inf")), first
    for k in range(tries):
        after = first + stride * float(k)
        rests = []
        for axis in range(3):
            at = places[axis] + after * speeds[axis]
            rests.append((at - math.floor(at + 0.5)) * step[axis])
        along = dot(rests, d)
        aside = math.trunc((dot(rests, rests) - along * along) * FINE)
        better = aside < least_aside
        least_aside, t = better.choose(aside, least_aside), better.choose(after, t)
    return t


@part
def cell_index(planes, axis, cells, k):
    """Find the cell of an axis that holds lattice coordinate k (bisection)."""
    low, high = 0, cells
    while high - low > 1:
        middle = (low + high) >> 1
        if k < planes[axis, middle]:
            high = middle
        else:
            low = middle
    return low


def make_space(step: tuple[float, float, float], planes: list[list[int]]) -> Space:
    """Check and pack the planes of each axis. Raises SceneError unless they run 0 .. 2^24, far enough apart."""
    for axis, name in enumerate("xyz"):
        line = np.asarray(planes[axis])
        if len(line) < 2 or line[0] != 0 or line[-1] != LATTICE or np.any(np.diff(line) < THINNEST_CELL):
            raise SceneError(
                f"planes of axis {name}: came {planes[axis]}, wanted ascending from 0 to {LATTICE}, "
                f"{THINNEST_CELL} or more apart"
            )
    shape = (len(planes[0]) - 1, len(planes[1]) - 1, len(planes[2]) - 1)
    table = np.full((3, max(shape) + 1), LATTICE, np.int64)
    for axis in range(3):
        table[axis, : shape[axis] + 1] = planes[axis]
    return Space(step, shape, table)


def make_cell(space: Space, index: tuple[int, int, int]) -> Cell:
    """The cell at this place of the array."""
    low = tuple(int(space.planes[axis, index[axis]]) for axis in range(3))
    high = tuple(int(space.planes[axis, index[axis] + 1]) for axis in range(3))
    low_at = tuple((low[axis] - HALF) * space.step[axis] for axis in range(3))
    high_at = tuple((high[axis] - HALF) * space.step[axis] for axis in range(3))
    return Cell(index, low, high, low_at, high_at)  # type: ignore[arg-type]


@dataclass(frozen=True)
class World:
    """Maps scene coordinates to machine coordinates: (x - centre) * scale, scale a power of two."""

    centre: NDArray[np.float64]
    scale: float
    step: tuple[float, float, float]

    def points(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Scene points (..., 3) in machine coordinates."""
        return (points - self.centre) * self.scale

    def surfaces(self, surfaces: SurfaceSet) -> SurfaceSet:
        """All surfaces in machine coordinates, in the precision that nodes store (`node.geometry.surfaces`)."""
        return SurfaceSet(tuple(self._batch(batch) for batch in surfaces))

    def _batch(self, batch: Batch) -> Batch:
        data = batch.data.astype(np.float64)
        if batch.kind == AddedKind.PROGRAMMED:
            data[:, 5:8] = self.points(data[:, 5:8])
            data[:, 4] *= self.scale
        elif batch.kind in (Kind.TRIANGLE, Kind.SMOOTH):
            data[:, :9] = self.points(data[:, :9].reshape(-1, 3, 3)).reshape(-1, 9)
        else:
            data[:, :3] = self.points(data[:, :3])
            if batch.kind == Kind.SPHERE:
                data[:, 3] *= self.scale
            elif batch.kind in (Kind.CYLINDER, Kind.CONE):
                data[:, 4:7] = self.points(data[:, 4:7])
                data[:, [3, 7]] *= self.scale
        return Batch(batch.kind, batch.ids, batch.materials, data.astype(STORED_AS[batch.kind]), batch.starts)


def world_around(bounds: NDArray[np.float64]) -> World:
    """The world of a scene (or animation) whose surfaces lie in this box, float64 (2, 3).

    Every surface lies strictly inside; an axis along which the scene is flat gets a small thickness.
    Raises SceneError for a box that is not finite, has no size, or is too small for its place in space.
    """
    if not np.all(np.isfinite(bounds)):
        raise SceneError(f"the box of the surfaces is {bounds.tolist()}, wanted finite numbers")
    centre = bounds.mean(0)
    half = (bounds[1] - bounds[0]) / 2.0
    longest = float(half.max())
    if not 1e-150 < longest < 1e150:
        raise SceneError(f"the surfaces span {2 * longest:g}, wanted between 1e-150 and 1e150")
    if longest < 1e-9 * float(np.abs(centre).max()):
        raise SceneError(
            f"the surfaces span {2 * longest:g} at {centre.tolist()}: too small so far from the origin, "
            "move them nearer"
        )
    half = half + 2.0 * WIDEN * longest
    scale = 2.0 ** -math.ceil(math.log2(float(half.max())))
    half = half * scale
    if float(half.max()) >= 1.0:  # half edge exactly a power of two
        scale, half = scale / 2.0, half / 2.0
    step = half / HALF
    return World(centre, scale, (float(step[0]), float(step[1]), float(step[2])))
