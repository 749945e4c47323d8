"""Finds the surfaces that touch a box: those that a cell retains, and the ways by which a description is handed on.

A hit is accepted only if its computed point lies within SLACK of the surface (`node.geometry.intersect`) and it
belongs to the cell that holds that point (up to rounding, far below SLACK). So a cell that retains every
surface which comes within SLACK of it holds every surface that can be hit there, and no other needs to be
kept: retention is implied by acceptance. Boxes are widened by SLACK here, and only here.

A triangle or polygon meets a box if an edge of it does, or if the box cuts its plane wholly inside its
outline. (Clipping it by the box's planes in turn is no test: a concave one leaves edges of no area in a
notch.) A sphere's surface misses a box that lies outside or wholly inside it. A cone is kept if its box
and a capsule round it touch the box.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raygrid.node.geometry.lattice import SLACK
from raygrid.node.geometry.surfaces import F64, AddedKind, Batch, Kind
from raygrid.node.jit.decorators import kernel, part, piece


@part
def _edge_meets(points, j, k, low, high):
    """Tell whether the edge between points j and k meets a box."""
    enter, leave = 0.0, 1.0
    for axis in range(3):
        start, way = points[j, axis], points[k, axis] - points[j, axis]
        if way == 0.0:
            if start < low[axis] or start > high[axis]:
                return False
        else:
            one, two = (low[axis] - start) / way, (high[axis] - start) / way
            enter, leave = max(enter, min(one, two)), min(leave, max(one, two))
    return enter <= leave


@part
def _normal(points, count):
    """Area vector of a polygon (Newell), about its first point."""
    x, y, z = 0.0, 0.0, 0.0
    for k in range(1, count - 1):
        ax, ay, az = points[k, 0] - points[0, 0], points[k, 1] - points[0, 1], points[k, 2] - points[0, 2]
        bx, by, bz = points[k + 1, 0] - points[0, 0], points[k + 1, 1] - points[0, 1], points[k + 1, 2] - points[0, 2]
        x += ay * bz - az * by
        y += az * bx - ax * bz
        z += ax * by - ay * bx
    return x, y, z


@piece
def _polygon_meets(points, count, low, high):
    """Tell whether a polygon meets a box. If no edge does, its part in the box is all of the plane there, or nothing."""
    for k in range(count):
        if _edge_meets(points, k, k + 1 if k + 1 < count else 0, low, high):
            return True
    normal = _normal(points, count)
    below, above = 0.0, 0.0  # heights over the plane of the box's lowest and highest corners
    for c in range(3):
        first, second = normal[c] * (low[c] - points[0, c]), normal[c] * (high[c] - points[0, c])
        below += min(first, second)
        above += max(first, second)
    if not (below <= 0.0 and above >= 0.0 and above > below):
        return False
    # where the diagonal between these corners passes the plane: a point of the plane in the box
    up = -below / (above - below)
    drop = 0
    for c in range(1, 3):
        if abs(normal[c]) > abs(normal[drop]):
            drop = c
    u, v = (drop + 1) % 3, (drop + 2) % 3
    x = low[u] + (up if normal[u] >= 0.0 else 1.0 - up) * (high[u] - low[u])
    y = low[v] + (up if normal[v] >= 0.0 else 1.0 - up) * (high[v] - low[v])
    inside = False
    for k in range(count):
        j = k + 1 if k + 1 < count else 0
        if (points[k, v] > y) != (points[j, v] > y):
            part_way = (y - points[k, v]) / (points[j, v] - points[k, v])
            if x < points[k, u] + part_way * (points[j, u] - points[k, u]):
                inside = not inside
    return inside


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
    squared = data[row, 3] * data[row, 3]
    return near <= squared and far >= squared


@part
def _capsule_meets(data, row, low, high):
    """The frustum lies in the capsule round its axis; the box in the ball round its middle."""
    reach = max(abs(data[row, 3]), abs(data[row, 7]))
    half, along, length, squared = 0.0, 0.0, 0.0, 0.0
    for axis in range(3):
        edge = 0.5 * (high[axis] - low[axis])
        half += edge * edge
        a = data[row, 4 + axis] - data[row, axis]
        along += a * (0.5 * (low[axis] + high[axis]) - data[row, axis])
        length += a * a
    t = min(max(along / length, 0.0), 1.0) if length > 0.0 else 0.0
    for axis in range(3):
        a = data[row, 4 + axis] - data[row, axis]
        gap = 0.5 * (low[axis] + high[axis]) - data[row, axis] - t * a
        squared += gap * gap
    return squared <= (reach + np.sqrt(half)) ** 2


@part
def surface_meets(kind, data, starts, boxes, row, low, high, points):
    """Tell whether one surface meets the box low..high, already widened. `points`: scratch, float64 (3, 3)."""
    inside, apart = True, False
    for axis in range(3):
        if boxes[row, 0, axis] > high[axis] or boxes[row, 1, axis] < low[axis]:
            apart = True
        if boxes[row, 0, axis] < low[axis] or boxes[row, 1, axis] > high[axis]:
            inside = False
    if apart or inside:
        return inside
    if kind <= 1:
        for k in range(3):
            for c in range(3):
                points[k, c] = data[row, 3 * k + c]
        return _polygon_meets(points, 3, low, high)
    if kind == 2:
        first = starts[row]
        return _polygon_meets(data[first : starts[row + 1]], starts[row + 1] - first, low, high)
    if kind == 3:
        return _sphere_meets(data, row, low, high)
    return _capsule_meets(data, row, low, high)


@kernel
def _meeting(kind, data, starts, boxes, low, high, found):
    """Fill found (n,) with whether each surface meets the box low..high, already widened."""
    points = np.empty((3, 3))
    for row in range(len(found)):
        found[row] = surface_meets(kind, data, starts, boxes, row, low, high, points)


def meets(batch: Batch, low: F64, high: F64, boxes: F64 | None = None) -> NDArray[np.bool_]:
    """Mark the surfaces of a batch that come within SLACK of the box low..high (machine coordinates): bool (n,).

    `boxes` may hand in `batch.bounds()` if it is at hand.
    """
    found = np.zeros(len(batch), np.bool_)
    if len(batch) == 0:
        return found
    if boxes is None:
        boxes = batch.bounds()
    if batch.kind == AddedKind.PROGRAMMED:  # it is hit in its box only, see `node.programs.hooks`
        return np.asarray(((boxes[:, 1] >= low - SLACK) & (boxes[:, 0] <= high + SLACK)).all(axis=1))
    data = batch.data if batch.kind in (Kind.TRIANGLE, Kind.SMOOTH) else batch.data.astype(np.float64, copy=False)
    starts = batch.starts if batch.kind == Kind.POLYGON else np.zeros(1, np.int64)
    _meeting(int(batch.kind), _own(data), starts, boxes, low - SLACK, high + SLACK, found)
    return found


def _own(data: NDArray[np.floating]) -> NDArray[np.floating]:
    """Contiguous and writable: one compiled version, whatever a message or a slice handed in."""
    return np.require(data, requirements=["C", "W"])
