"""Random surfaces of every kind in machine coordinates, ordinary and nasty, for the tests."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from raygrid.node.geometry.surfaces import STORED_AS, STRIDE, Batch, Kind, SurfaceSet, merge

F64 = NDArray[np.float64]
Generator = np.random.Generator


def batch(kind: Kind, rows: Sequence[F64], first_id: int = 0, materials: Sequence[int] | None = None) -> Batch:
    """One batch out of one array a surface, in the precision that nodes store."""
    n = len(rows)
    ids = np.arange(first_id, first_id + n, dtype=np.uint32)
    named = np.zeros(n, np.uint16) if materials is None else np.asarray(materials, np.uint16)
    if kind == Kind.POLYGON:
        starts = np.concatenate(([0], np.cumsum([len(row) for row in rows]))).astype(np.int64)
        data = np.concatenate([*rows, np.zeros((0, 3))]).astype(np.float64)
        return Batch(kind, ids, named, data, starts)
    return Batch(kind, ids, named, np.asarray(rows, STORED_AS[kind]).reshape(n, STRIDE[kind]))


def shuffled_ids(surfaces: Sequence[Batch], rng: Generator) -> SurfaceSet:
    """The batches under ids that are mixed over all of them."""
    ids = rng.permutation(sum(len(b) for b in surfaces)).astype(np.uint32)
    ends = np.cumsum([len(b) for b in surfaces])
    parts = np.split(ids, ends[:-1])
    return merge(Batch(b.kind, part, b.materials, b.data, b.starts) for b, part in zip(surfaces, parts, strict=True))


def unit_vectors(rng: Generator, n: int) -> F64:
    """Unit vectors in all directions."""
    v = rng.normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def frame_of(normal: F64) -> tuple[F64, F64]:
    """Two unit vectors that stand square on a unit normal; axes for axes."""
    helper = np.eye(3)[(int(np.argmax(np.abs(normal))) + 1) % 3]
    u = np.cross(helper, normal)
    u = u / np.linalg.norm(u)
    return u, np.cross(normal, u)


def outline(rng: Generator, points: int) -> F64:
    """A star-shaped outline (n, 2) round the origin, mostly concave, counter-clockwise."""
    angles = (np.arange(points) + rng.uniform(-0.4, 0.4, points)) * 2.0 * np.pi / points
    radii = rng.uniform(0.3, 1.0, points)
    return np.stack((radii * np.cos(angles), radii * np.sin(angles)), axis=1)


def gear(teeth: int, radius: float = 1.0, depth: float = 0.1) -> F64:
    """A gear wheel (4 * teeth, 2) whose first tooth has a horizontal top, counter-clockwise."""
    quarter = np.arange(4 * teeth) * 2.0 * np.pi / (4 * teeth)
    radii = np.where(np.arange(4 * teeth) % 4 < 2, radius, radius * (1.0 - depth))
    turned = quarter + np.pi / 2.0 - np.pi / (4 * teeth)
    points = np.stack((radii * np.cos(turned), radii * np.sin(turned)), axis=1)
    points[1, 1] = points[0, 1]
    return points


def castle(rng: Generator, merlons: int) -> F64:
    """An outline (4 * merlons + 2, 2) made of level and upright edges only, many heights equal."""
    heights = rng.integers(1, 6, 2 * merlons) / 8.0
    x = np.repeat(np.arange(2 * merlons + 1), 2)[1:-1] / (2.0 * merlons)
    top = np.stack((x, np.repeat(heights, 2)), axis=1)
    return np.concatenate(([[0.0, 0.0], [1.0, 0.0]], top[::-1])) - 0.5


def placed(flat: F64, centre: F64, normal: F64, size: float) -> F64:
    """An outline put into space: (n, 2) to (n, 3)."""
    u, v = frame_of(normal)
    return centre + size * (flat[:, :1] * u + flat[:, 1:] * v)


def random_rows(
    kind: Kind, rng: Generator, n: int, reach: float = 0.45, size: tuple[float, float] = (1e-4, 0.3)
) -> list[F64]:
    """Ordinary surfaces with centres within `reach`, sizes evenly over the powers of ten."""
    rows = []
    for _ in range(n):
        s = float(np.exp(rng.uniform(np.log(size[0]), np.log(size[1]))))
        centre = rng.uniform(-reach, reach, 3)
        rows.append(_random_row(kind, rng, centre, s))
    return rows


def _random_row(kind: Kind, rng: Generator, centre: F64, s: float) -> F64:
    if kind in (Kind.TRIANGLE, Kind.SMOOTH):
        points = centre + s * rng.uniform(-1, 1, (3, 3))
        if rng.random() < 0.25:  # a sliver, down to a needle
            points[2] = (
                points[0]
                + rng.uniform(0, 1) * (points[1] - points[0])
                + s * 10.0 ** -rng.uniform(2, 7) * rng.normal(size=3)
            )
        normals = unit_vectors(rng, 3)
        return points.ravel() if kind == Kind.TRIANGLE else np.concatenate((points.ravel(), normals.ravel()))
    if kind == Kind.POLYGON:
        return placed(outline(rng, int(rng.integers(3, 12))), centre, unit_vectors(rng, 1)[0], s)
    sign = -1.0 if rng.random() < 0.3 else 1.0
    if kind == Kind.SPHERE:
        return np.array([*centre, sign * s])
    top = centre + s * rng.normal(size=3)
    radius = sign * s * rng.uniform(0.01, 1.0)
    if kind == Kind.CYLINDER:
        return np.array([*centre, radius, *top, radius])
    other = 0.0 if rng.random() < 0.4 else sign * s * rng.uniform(0.01, 1.0)
    ends = (radius, other) if rng.random() < 0.5 else (other, radius)
    return np.array([*centre, ends[0], *top, ends[1]])


def rows_on_planes(kind: Kind, rng: Generator, n: int, planes: Sequence[F64], size: float = 0.15) -> list[F64]:
    """Surfaces that lie in, end at, or touch these planes (coordinates of the planes of each axis)."""
    rows = []
    for _ in range(n):
        axis = int(rng.integers(3))
        at = float(rng.choice(planes[axis]))
        centre = rng.uniform(-0.4, 0.4, 3)
        for other in range(3):  # a third of the other coordinates lie on planes, too
            if rng.random() < 0.33:
                centre[other] = rng.choice(planes[other])
        centre[axis] = at
        rows.append(_row_on_plane(kind, rng, axis, centre, size * rng.uniform(0.2, 1.0)))
    return rows


def _row_on_plane(kind: Kind, rng: Generator, axis: int, centre: F64, s: float) -> F64:
    normal = np.eye(3)[axis]
    if kind in (Kind.TRIANGLE, Kind.SMOOTH):
        points = np.tile(centre, (3, 1))
        for other in ((axis + 1) % 3, (axis + 2) % 3):
            points[:, other] += s * rng.uniform(-1, 1, 3)
        if rng.random() < 0.3:
            points[rng.integers(3)] += s * rng.uniform(-1, 1, 3)  # touches the plane with an edge
        return points.ravel() if kind == Kind.TRIANGLE else np.concatenate((points.ravel(), np.tile(normal, 3)))
    if kind == Kind.POLYGON:
        flat = castle(rng, int(rng.integers(1, 5))) if rng.random() < 0.5 else outline(rng, int(rng.integers(3, 12)))
        points = placed(flat, centre, normal, s)
        points[:, axis] = centre[axis]
        return points
    side = s * (1.0 if rng.random() < 0.5 else -1.0)
    if kind == Kind.SPHERE:
        centre[axis] += side if rng.random() < 0.5 else 0.0  # touches the plane, or is halved by it
        return np.array([*centre, s if rng.random() < 0.7 else -s])
    top = centre + 2.0 * side * normal
    if rng.random() < 0.3:  # lies on the plane: touches it along a line
        top = centre + s * np.eye(3)[(axis + 1) % 3]
        centre[axis], top[axis] = centre[axis] + abs(side), top[axis] + abs(side)
    other = s if kind == Kind.CYLINDER else s * float(rng.choice([0.0, 0.5]))
    return np.array([*centre, s, *top, other])


def points_on(rows: Batch, rng: Generator) -> F64:
    """A random point on each surface, now and then on an edge, a vertex, a rim or an apex."""
    return np.array([_point_on(rows, k, rng) for k in range(len(rows))]).reshape(-1, 3)


def _point_on(rows: Batch, k: int, rng: Generator) -> F64:
    nasty = rng.random() < 0.2
    if rows.kind == Kind.POLYGON:
        points = rows.data[rows.starts[k] : rows.starts[k + 1]]
        j = int(rng.integers(len(points)))
        edge = points[j] + (float(rng.integers(2)) if nasty else rng.random()) * (points[j - 1] - points[j])
        return edge if rng.random() < 0.3 else edge + rng.random() * (points.mean(0) - edge)
    row = rows.data[k].astype(np.float64)
    if rows.kind in (Kind.TRIANGLE, Kind.SMOOTH):
        weights = rng.dirichlet((1.0, 1.0, 1.0))
        if nasty:
            weights[rng.permutation(3)[: int(rng.integers(1, 3))]] = 0.0
        return weights @ row[:9].reshape(3, 3) / weights.sum()
    if rows.kind == Kind.SPHERE:
        way = np.eye(3)[rng.integers(3)] if nasty else unit_vectors(rng, 1)[0]
        return row[:3] + row[3] * way
    axis, y = row[4:7] - row[:3], float(rng.integers(2)) if nasty else rng.random()
    u, v = frame_of(axis / np.linalg.norm(axis))
    angle, radius = rng.uniform(0, 2 * np.pi), abs(row[3]) + y * (abs(row[7]) - abs(row[3]))
    return row[:3] + y * axis + radius * (np.cos(angle) * u + np.sin(angle) * v)


def sizes_of(rows: Batch) -> F64:
    """The diagonals of the surfaces' boxes."""
    return np.linalg.norm(np.diff(rows.bounds(), axis=1)[:, 0], axis=1)
