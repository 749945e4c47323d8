"""Which surfaces touch a box: what a cell retains, and where a description is handed on.

A hit is accepted only if its computed point lies within SLACK of the surface (`node.intersect`) and it
belongs to the cell that holds that point (up to rounding, far below SLACK). So a cell that retains every
surface which comes within SLACK of it holds every surface that can be hit there, and no other needs to be
kept: retention is implied by acceptance. Boxes are widened by SLACK here, and only here.

Polygons and triangles are clipped against the box (Sutherland and Hodgman 1974: for a convex box the
result is empty exactly if they do not meet, for concave polygons too). A sphere's surface misses a box
that lies outside or wholly inside it. A cone is kept if its box and a capsule round it touch the box.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .compiled import kernel, part, piece
from .lattice import SLACK
from .surfaces import Batch, Kind

F64 = NDArray[np.float64]


@part
def _clip_plane(source, count, target, axis, sign, limit):
    """Clip `count` points against sign * x[axis] <= limit; returns how many points remain."""
    kept = 0
    for k in range(count):
        after = k + 1 if k + 1 < count else 0
        here = sign * source[k, axis] - limit
        there = sign * source[after, axis] - limit
        if here <= 0.0:
            for c in range(3):
                target[kept, c] = source[k, c]
            kept += 1
        if (here < 0.0 and there > 0.0) or (here > 0.0 and there < 0.0):
            part_way = here / (here - there)
            for c in range(3):
                target[kept, c] = source[k, c] + part_way * (source[after, c] - source[k, c])
            target[kept, axis] = sign * limit
            kept += 1
    return kept


@piece
def _polygon_meets(points, count, low, high, one, two):
    """Whether a polygon meets a box.

    `one` and `two` have room for 12 times its points: a plane adds at most half as many again, and 1.5^6 < 12.
    """
    for k in range(count):
        for c in range(3):
            one[k, c] = points[k, c]
    for axis in range(3):
        count = _clip_plane(one, count, two, axis, 1.0, high[axis])
        if count == 0:
            return False
        count = _clip_plane(two, count, one, axis, -1.0, -low[axis])
        if count == 0:
            return False
    return True


@part
def _box_distances(x, y, z, low, high):
    """Squared distances of a point to the nearest and the farthest point of a box."""
    near, far = 0.0, 0.0
    for axis in range(3):
        p = x if axis == 0 else (y if axis == 1 else z)
        below, above = low[axis] - p, p - high[axis]
        gap = max(0.0, max(below, above))
        near += gap * gap
        reach = max(abs(below), abs(above))
        far += reach * reach
    return near, far


@part
def _sphere_meets(data, row, low, high):
    near, far = _box_distances(data[row, 0], data[row, 1], data[row, 2], low, high)
    radius = abs(data[row, 3])
    hollow = max(radius - SLACK, 0.0)
    return near <= (radius + SLACK) ** 2 and far >= hollow * hollow


@part
def _capsule_meets(data, row, low, high):
    """The frustum lies in the capsule round its axis; the box in the ball round its middle."""
    reach = max(abs(data[row, 3]), abs(data[row, 7])) + SLACK
    half, along, length, squared = 0.0, 0.0, 0.0, 0.0
    for axis in range(3):
        edge = 0.5 * (high[axis] - low[axis])
        half += edge * edge
        a = data[row, 4 + axis] - data[row, axis]
        along += a * (0.5 * (low[axis] + high[axis]) - data[row, axis])
        length += a * a
    t = min(max(along / length, 0.0), 1.0)
    for axis in range(3):
        a = data[row, 4 + axis] - data[row, axis]
        gap = 0.5 * (low[axis] + high[axis]) - data[row, axis] - t * a
        squared += gap * gap
    return squared <= (reach + np.sqrt(half)) ** 2


@kernel
def _meeting(kind, data, starts, boxes, low, high, most, found):
    """Fill found (n,) with whether each surface meets the box low..high, already widened."""
    points = np.empty((most, 3))
    one = np.empty((12 * most, 3))
    two = np.empty((12 * most, 3))
    polygon, flat = kind == 2, kind <= 1
    for row in range(len(found)):
        found[row] = False
        inside, apart = True, False
        for axis in range(3):
            if boxes[row, 0, axis] > high[axis] or boxes[row, 1, axis] < low[axis]:
                apart = True
            if boxes[row, 0, axis] < low[axis] or boxes[row, 1, axis] > high[axis]:
                inside = False
        if apart or inside:
            found[row] = inside
        elif flat:
            for k in range(3):
                for c in range(3):
                    points[k, c] = data[row, 3 * k + c]
            found[row] = _polygon_meets(points, 3, low, high, one, two)
        elif polygon:
            first = starts[row]
            found[row] = _polygon_meets(data[first : starts[row + 1]], starts[row + 1] - first, low, high, one, two)
        elif kind == 3:
            found[row] = _sphere_meets(data, row, low, high)
        else:
            found[row] = _capsule_meets(data, row, low, high)


def meets(batch: Batch, low: F64, high: F64, boxes: F64 | None = None) -> NDArray[np.bool_]:
    """Which surfaces of a batch come within SLACK of the box low..high (machine coordinates): bool (n,).

    `boxes` may hand in `batch.bounds()` if it is at hand.
    """
    found = np.zeros(len(batch), np.bool_)
    if len(batch) == 0:
        return found
    if boxes is None:
        boxes = batch.bounds()
    most = int(np.diff(batch.starts).max()) if batch.kind == Kind.POLYGON else 3
    data = batch.data if batch.kind in (Kind.TRIANGLE, Kind.SMOOTH) else batch.data.astype(np.float64, copy=False)
    starts = batch.starts if batch.kind == Kind.POLYGON else np.zeros(1, np.int64)
    _meeting(int(batch.kind), _own(data), starts, boxes, low - SLACK, high + SLACK, most, found)
    return found


def _own(data: NDArray[np.floating]) -> NDArray[np.floating]:
    """Contiguous and writable: one compiled version, whatever a message or a slice handed in."""
    return np.require(data, requirements=["C", "W"])
