"""Makes normals for triangles whose file has none: smooth across edges that bend little, sharp across all others.

Corners that meet at one point belong together as far as one gets from triangle to triangle across smooth edges. Their
normal is the mean of their triangles' normals, each weighted by its angle at the point (Thuermer and Wuethrich 1998,
"Computing Vertex Normals from Polygonal Facets"), so that it does not depend on how a face is cut into triangles.
Vertices at exactly the same place are one: files repeat them, for each triangle (STL) or for each pair of texture
coordinates.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import numpy as np
from numpy.typing import NDArray

from raygrid.host.scene.linear_algebra import dot, lengths, units
from raygrid.host.scene.polygons import Ints, Mask
from raygrid.node.geometry import F64, rounded

CREASE = 40.0  # degrees: cylinders of ten sides are round, icosahedra (41.8) are not
MOST_SMOOTHED = 1 << 22  # triangles: beyond, facets are too small to be seen, and smooth ones take twice the memory
EVEN = 1e-6  # radians: normals this near to the triangle's own are that
TURNED = 0.05  # cosine: a mean that leaves its triangle so far has nothing to do with it

ARC_COSINE = (
    *(1.5707963050, -0.2145988016, 0.0889789874, -0.0501743046),
    *(0.0308918810, -0.0170881256, 0.0066700901, -0.0012624911),
)

_asked: ContextVar[float | None] = ContextVar("asked", default=None)
_of_file: ContextVar[float | None] = ContextVar("of_file", default=None)


@contextmanager
def crease_asked(angle: float) -> Iterator[None]:
    """Smooth all meshes that are read in this block across edges that bend by no more degrees, whatever files say."""
    before = _asked.set(angle)
    try:
        yield
    finally:
        _asked.reset(before)


@contextmanager
def crease_of_file(angle: float | None) -> Iterator[None]:
    """The same if nobody asks for another one; None: as the format has it."""
    before = _of_file.set(angle)
    try:
        yield
    finally:
        _of_file.reset(before)


def crease_for(usual: float) -> float:
    """The angle in degrees that counts here: that which is asked for, else the file's, else the usual one of a format."""
    asked, of_file = _asked.get(), _of_file.get()
    return asked if asked is not None else of_file if of_file is not None else usual


def smooth_normals(corners: F64, crease: float) -> tuple[F64, Mask]:
    """Unit normals at the corners of triangles, and which triangles need them, the others being flat.

    corners  (n, 3, 3)
    crease   degrees by which an edge may bend and be smooth
    Returns float64 (n, 3, 3) and bool (n,).
    """
    largest = float(np.abs(corners).max(initial=0.0))
    if not (crease > 0.0 and len(corners) and 0.0 < largest < math.inf):
        return np.zeros_like(corners), np.zeros(len(corners), np.bool_)
    normals, angles = _measured(corners / largest)
    points = _places(corners)
    first, second = _smooth_edges(points, normals, rounded.cos(math.radians(crease)) - 1e-12)
    groups = _joined(first, second, 3 * len(corners))
    weighted = normals[:, None] * angles[..., None]
    sums: F64 = np.stack(
        [np.bincount(groups, weighted[..., k].reshape(-1), 3 * len(corners)) for k in range(3)], axis=1
    )
    means = units(sums)[groups].reshape(-1, 3, 3)
    cosines = dot(means, normals[:, None])
    means = np.where((cosines > TURNED)[..., None], means, normals[:, None])
    bent = lengths(means - normals[:, None]).max(axis=1) > EVEN
    return means, np.asarray(bent & normals.any(axis=1))


def _measured(corners: F64) -> tuple[F64, F64]:
    """Unit normals of triangles, (n, 3), zero without an area, and their angles in radians, (n, 3)."""
    edges = corners[:, (1, 2, 0)] - corners
    normals = units(np.cross(edges[:, 0], edges[:, 1]))
    sides = units(edges)
    cosines = -dot(sides, sides[:, (2, 0, 1)])
    has_area = np.any(normals != 0.0, axis=1)
    return normals, _angles(np.clip(cosines, -1.0, 1.0)) * has_area[:, None]


def _angles(cosines: F64) -> F64:
    """Arc cosines to 2e-8 radians, with the same bits on every computer (Abramowitz and Stegun 1964, 4.4.46)."""
    size = np.abs(cosines)
    series = np.full_like(size, ARC_COSINE[-1])
    for coefficient in ARC_COSINE[-2::-1]:
        series = series * size + coefficient
    angles = np.sqrt(1.0 - size) * series
    return np.asarray(np.where(cosines < 0.0, math.pi - angles, angles))


def _places(corners: F64) -> Ints:
    """A number for each corner, (n, 3), equal where the coordinates are."""
    rows = corners.reshape(-1, 3)
    order = np.lexsort(rows.T)
    ranked = rows[order]
    places = np.empty(len(rows), np.int64)
    places[order] = np.concatenate(([0], np.cumsum((ranked[1:] != ranked[:-1]).any(axis=1))))
    return places.reshape(-1, 3)


def _smooth_edges(points: Ints, normals: F64, least: float) -> tuple[Ints, Ints]:
    """Pairs of corners, numbered 3 t + k, that are joined: two for each edge that is smooth.

    An edge is one of just two triangles that run along it in opposite directions; of more, none is smooth with another.
    """
    here, there = points.reshape(-1), points[:, (1, 2, 0)].reshape(-1)
    low, high = np.minimum(here, there), np.maximum(here, there)
    keys = low * (int(points.max()) + 1) + high
    order = np.argsort(keys, kind="stable")
    ranked = keys[order]
    same = ranked[1:] == ranked[:-1]
    alone = np.concatenate(([False], same)), np.concatenate((same, [False]))
    pair = same & ~alone[0][:-1] & ~alone[1][1:]
    one, other = order[:-1][pair], order[1:][pair]
    bends = dot(normals[one // 3], normals[other // 3])
    smooth = (here[one] == there[other]) & (here[one] != there[one]) & (bends >= least)
    one, other = one[smooth], other[smooth]
    return np.concatenate((one, _following(one))), np.concatenate((_following(other), other))


def _following(corner: Ints) -> Ints:
    """The next corner of the same triangle."""
    return corner - corner % 3 + (corner + 1) % 3


def _joined(first: Ints, second: Ints, count: int) -> NDArray[np.int64]:
    """The least number of each set of numbers below `count` that pairs join.

    Each set hangs below its least number in the end: roots are hung below lesser ones that a pair leads to, and paths are
    halved until they are short. The rounds are as the logarithm of the longest chain.
    """
    root = np.arange(count)
    while True:
        one, other = root[first], root[second]
        apart = one != other
        if not apart.any():
            return root
        first, second, one, other = first[apart], second[apart], one[apart], other[apart]
        np.minimum.at(root, np.maximum(one, other), np.minimum(one, other))
        while True:
            above = root[root]
            if (above == root).all():
                break
            root = above
