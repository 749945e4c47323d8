"""Describes surfaces: as the host deals them, as they are flooded, as a node retains them.

A description is one row of a `Batch`. A batch holds descriptions of one kind only, as flat arrays,
because they are read from files, checked, moved, sent and built into hierarchies many at a time.

=========  =====================================================================  ================
kind       data (a row each; polygons: a row a point, cut up by `starts`)          stored as
=========  =====================================================================  ================
TRIANGLE   three vertices                                              9 numbers   float32
SMOOTH     three vertices, then their three unit normals              18 numbers   float32
POLYGON    its vertices in order, planar, convex or concave         3 per point   float64
SPHERE     centre, radius (negative: only the inside shows)            4 numbers   float64
CYLINDER   base centre, radius, top centre, radius (equal radii)       8 numbers   float64
CONE       base centre, base radius, apex centre, apex radius          8 numbers   float64
PROGRAMMED where it is (a motion, 8 numbers), half its box, 8 more    19 numbers   float64
=========  =====================================================================  ================

The front of a triangle or polygon is the side from which its vertices run counter-clockwise.
Scenes are float64 throughout; "stored as" is the precision in machine coordinates (`node.geometry.lattice`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from raygrid.node.geometry.quaternion import F64 as F64
from raygrid.node.geometry.quaternion import rotation_matrices


class Kind(IntEnum):
    """The kinds of surface, in the order in which tests are counted."""

    TRIANGLE = 0
    SMOOTH = 1
    POLYGON = 2
    SPHERE = 3
    CYLINDER = 4
    CONE = 5


class AddedKind(IntEnum):
    """The kind that a program adds (`node.programs.programs`): it is not there without one."""

    PROGRAMMED = 6


AnyKind = Kind | AddedKind
SURFACE_KINDS: tuple[AnyKind, ...] = (*Kind, *AddedKind)
# columns of a programmed surface: its motion from its own coordinates, half the edges of its box in these, its numbers
OWN_MOTION, OWN_HALF, OWN_NUMBERS, NUMBERS = 0, 8, 11, 8
STRIDE: dict[AnyKind, int] = {
    Kind.TRIANGLE: 9,
    Kind.SMOOTH: 18,
    Kind.POLYGON: 3,
    Kind.SPHERE: 4,
    Kind.CYLINDER: 8,
    Kind.CONE: 8,
    AddedKind.PROGRAMMED: OWN_NUMBERS + NUMBERS,
}
STORED_AS: dict[AnyKind, type[np.floating]] = {
    Kind.TRIANGLE: np.float32,
    Kind.SMOOTH: np.float32,
    Kind.POLYGON: np.float64,
    Kind.SPHERE: np.float64,
    Kind.CYLINDER: np.float64,
    Kind.CONE: np.float64,
    AddedKind.PROGRAMMED: np.float64,
}
MAX_SURFACES = 2**28  # a leaf of the hierarchy keeps 4 bits of a 32-bit word for kind and number
MAX_MATERIALS = 2**16


@dataclass(frozen=True)
class Batch:
    """Surface descriptions of one kind.

    kind       the kind of every row
    ids        uint32 (n,), the surface's number in the scene; the smaller wins a tie
    materials  uint16 (n,), row of the scene's material table
    data       floating (n, STRIDE[kind]); for polygons (points, 3)
    starts     int64 (n + 1,) for polygons, row of `data` where each begins; int64 (0,) otherwise

    Raises ValueError if the shapes do not fit each other.
    """

    kind: AnyKind
    ids: NDArray[np.uint32]
    materials: NDArray[np.uint16]
    data: NDArray[np.floating]
    starts: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))

    def __post_init__(self) -> None:
        n = len(self.ids)
        rows = int(self.starts[-1]) if self.kind == Kind.POLYGON and len(self.starts) else n
        if self.kind == Kind.POLYGON and len(self.starts) != n + 1:
            raise ValueError(f"{n} polygons came with {len(self.starts)} starts, wanted {n + 1}")
        if len(self.materials) != n or self.data.shape != (rows, STRIDE[self.kind]):
            raise ValueError(
                f"{n} surfaces of kind {self.kind.name} came with {len(self.materials)} materials and data of shape "
                f"{self.data.shape}, wanted {n} and ({rows}, {STRIDE[self.kind]})"
            )

    def __len__(self) -> int:
        return len(self.ids)

    def select(self, rows: NDArray[np.bool_] | NDArray[np.intp]) -> Batch:
        """The descriptions of the chosen rows (a mask or ascending indices), copied."""
        chosen = np.flatnonzero(rows) if rows.dtype == np.bool_ else rows
        if self.kind != Kind.POLYGON:
            return Batch(self.kind, self.ids[chosen], self.materials[chosen], self.data[chosen])
        sizes = np.diff(self.starts)[chosen]
        starts = np.concatenate(([0], np.cumsum(sizes))).astype(np.int64)
        points = np.repeat(self.starts[chosen] - starts[:-1], sizes) + np.arange(starts[-1])
        return Batch(self.kind, self.ids[chosen], self.materials[chosen], self.data[points], starts)

    def bounds(self) -> F64:
        """Axis-aligned boxes, float64 (n, 2, 3). A cone's is that of its two rims (exact)."""
        if self.kind in (Kind.TRIANGLE, Kind.SMOOTH):
            return _triangle_bounds(self.data)
        data = self.data.astype(np.float64, copy=False)
        if self.kind == Kind.POLYGON:
            if len(self) == 0:
                return np.zeros((0, 2, 3))
            low = np.minimum.reduceat(data, self.starts[:-1], axis=0)
            return np.stack((low, np.maximum.reduceat(data, self.starts[:-1], axis=0)), axis=1)
        if self.kind == Kind.SPHERE:
            return _sphere_bounds(data)
        if self.kind == AddedKind.PROGRAMMED:
            return _own_bounds(data)
        return _cone_bounds(data)


def _triangle_bounds(data: NDArray[np.floating]) -> F64:
    """Column by column: numpy is slow along axes of length 3."""
    boxes = np.empty((len(data), 2, 3))
    for axis in range(3):
        a, b, c = data[:, axis], data[:, 3 + axis], data[:, 6 + axis]
        boxes[:, 0, axis] = np.minimum(np.minimum(a, b), c)
        boxes[:, 1, axis] = np.maximum(np.maximum(a, b), c)
    return boxes


def _sphere_bounds(data: F64) -> F64:
    boxes, radius = np.empty((len(data), 2, 3)), np.abs(data[:, 3])
    for axis in range(3):
        boxes[:, 0, axis], boxes[:, 1, axis] = data[:, axis] - radius, data[:, axis] + radius
    return boxes


def _cone_bounds(data: F64) -> F64:
    """The box of a disc with unit normal n and radius r reaches r * sqrt(1 - n_a^2) from its centre along axis a."""
    boxes, base_r, apex_r = np.empty((len(data), 2, 3)), np.abs(data[:, 3]), np.abs(data[:, 7])
    squares = [(data[:, 4 + axis] - data[:, axis]) ** 2 for axis in range(3)]
    squared = squares[0] + squares[1] + squares[2]
    squared[~(squared > 0.0)] = 1.0
    for axis in range(3):
        base, apex = data[:, axis], data[:, 4 + axis]
        reach = np.sqrt(np.clip(1.0 - squares[axis] / squared, 0.0, 1.0))
        boxes[:, 0, axis] = np.minimum(base - base_r * reach, apex - apex_r * reach)
        boxes[:, 1, axis] = np.maximum(base + base_r * reach, apex + apex_r * reach)
    return boxes


def _own_bounds(data: F64) -> F64:
    """The box of a rotated box: along each axis it reaches as far as its three half edges together."""
    axes = np.abs(rotation_matrices(data[:, :4])) * (data[:, OWN_HALF : OWN_HALF + 3] * data[:, 4:5])[:, None, :]
    reach = axes[:, :, 0] + axes[:, :, 1] + axes[:, :, 2]
    return np.stack((data[:, 5:8] - reach, data[:, 5:8] + reach), axis=1)


@dataclass(frozen=True)
class SurfaceSet:
    """All surfaces of a scene, at most one batch a kind. Ids are unique over the whole set."""

    batches: tuple[Batch, ...] = ()

    def __len__(self) -> int:
        return sum(len(batch) for batch in self.batches)

    def __iter__(self) -> Iterator[Batch]:
        return iter(self.batches)

    def bounds(self) -> F64:
        """The box of all surfaces, float64 (2, 3). Raises ValueError for an empty set."""
        boxes = [batch.bounds() for batch in self.batches if len(batch)]
        if not boxes:
            raise ValueError("there are no surfaces")
        lows = np.array([[box[:, 0, axis].min() for axis in range(3)] for box in boxes])
        highs = np.array([[box[:, 1, axis].max() for axis in range(3)] for box in boxes])
        return np.stack((lows.min(0), highs.max(0)))

    def count(self, kind: AnyKind) -> int:
        """Count the surfaces of this kind."""
        return sum(len(batch) for batch in self.batches if batch.kind == kind)


def merge(batches: Iterable[Batch]) -> SurfaceSet:
    """One batch a kind out of many, rows in the order given."""
    groups: dict[AnyKind, list[Batch]] = {}
    for batch in batches:
        if len(batch):
            groups.setdefault(batch.kind, []).append(batch)
    return SurfaceSet(tuple(_joined(groups[kind]) for kind in SURFACE_KINDS if kind in groups))


def _joined(group: list[Batch]) -> Batch:
    starts = np.zeros(0, np.int64)
    if group[0].kind == Kind.POLYGON:
        sizes = np.concatenate([np.diff(batch.starts) for batch in group])
        starts = np.concatenate(([0], np.cumsum(sizes))).astype(np.int64)
    return Batch(
        group[0].kind,
        np.concatenate([batch.ids for batch in group]),
        np.concatenate([batch.materials for batch in group]),
        np.concatenate([batch.data for batch in group]),
        starts,
    )
