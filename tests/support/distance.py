"""How far a point is from a surface: plain equations, for the tests."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raygrid.node.geometry.surfaces import Batch, Kind
from support.surfaces import F64


def distance(rows: Batch, k: int, p: F64) -> float:
    """Distance of a point from surface k of a batch."""
    if rows.kind == Kind.POLYGON:
        return from_polygon(rows.data[rows.starts[k] : rows.starts[k + 1]], p)
    row = rows.data[k].astype(np.float64)
    if rows.kind in (Kind.TRIANGLE, Kind.SMOOTH):
        return from_polygon(row[:9].reshape(3, 3), p)
    if rows.kind == Kind.SPHERE:
        return abs(float(np.linalg.norm(p - row[:3])) - abs(row[3]))
    axis = row[4:7] - row[:3]
    height = float(np.linalg.norm(axis))
    y = float((p - row[:3]) @ axis) / height
    beside = float(np.linalg.norm(p - row[:3] - y * axis / height))
    return from_segment(np.array([abs(row[3]), 0.0]), np.array([abs(row[7]), height]), np.array([beside, y]))


def from_segment(a: F64, b: F64, p: F64) -> float:
    """Distance of a point from the segment between two, in any dimension."""
    way = b - a
    squared = float(way @ way)
    along = min(max(float((p - a) @ way) / squared, 0.0), 1.0) if squared > 0.0 else 0.0
    return float(np.linalg.norm(p - a - along * way))


def from_polygon(points: F64, p: F64) -> float:
    """Distance of a point from a plane polygon: to its plane if it lies over the inside, else to its outline."""
    rim = min(from_segment(a, b, p) for a, b in zip(points, np.roll(points, -1, axis=0), strict=True))
    from_first = points - points[0]
    normal = np.cross(from_first, np.roll(from_first, -1, axis=0)).sum(0)
    size = float(np.linalg.norm(normal))
    if size == 0.0:
        return rim
    drop = int(np.argmax(np.abs(normal)))
    height = float(normal @ (p - points[0])) / size
    foot = p - height * normal / size
    u, v = (drop + 1) % 3, (drop + 2) % 3
    inside = False
    for a, b in zip(points, np.roll(points, -1, axis=0), strict=True):
        if (a[v] > foot[v]) != (b[v] > foot[v]):
            inside ^= bool(foot[u] < a[u] + (foot[v] - a[v]) / (b[v] - a[v]) * (b[u] - a[u]))
    return min(rim, abs(height)) if inside else rim


def crossing_number(points: F64, x: F64, y: F64) -> NDArray[np.bool_]:
    """Whether (x, y) have an odd number of edges to their right, all edges tried, each from its lower end up."""
    inside = np.zeros(len(x), bool)
    for a, b in zip(points, np.roll(points, -1, axis=0), strict=True):
        if a[1] == b[1]:
            continue
        a, b = (a, b) if a[1] < b[1] else (b, a)
        slope = (b[0] - a[0]) / (b[1] - a[1])
        inside ^= (a[1] <= y) & (y < b[1]) & (x < a[0] + (y - a[1]) * slope)
    return inside
