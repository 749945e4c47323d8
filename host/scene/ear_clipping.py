"""Cuts one polygon of the plane into triangles, ear after ear, the widest first.

A corner is an ear if it turns left and no other vertex lies in the triangle with its neighbours. What was found to be none
because of a vertex stays none until that vertex, or a neighbour, is gone, so it is not looked at again before.

That takes time by the square of the corners. Of polygons with many mapbox-earcut finds ears in a hundredth of the time or less, but
narrower ones; it leaves out vertices that come twice, and of hard cases those in a line, and does not tell of polygons that cross.
So what it gives is taken if it is seen to be whole, and else the polygon is cut here.
"""

from __future__ import annotations

import heapq
from collections import defaultdict

import numpy as np
from numpy.typing import NDArray

from raygrid.node.geometry import F64

Ints = NDArray[np.int64]
MANY = 64  # corners, of which one takes 4 ms here
LOST = 1e-9  # of the area: what rounding takes away
CONVEX = 1e-9  # a corner may turn the wrong way by this sine: nearly straight corners of rounded numbers


def clip_ears(plane: F64, doubled_area: float) -> tuple[Ints, bool]:
    """Triangles of a polygon, (m - 2, 3), and whether it had ears to the end, as each has that crosses nowhere.

    plane: its vertices, (m, 2), counter-clockwise.
    """
    if len(plane) >= MANY and (found := clip_many(plane, doubled_area)) is not None:
        return found, True
    ring = _Ring(plane)
    ears, clean = [], True
    for _ in range(len(plane) - 3):
        ear = ring.find()
        clean = clean and ear >= 0
        ear = ear if ear >= 0 else ring.first()
        ears.append((ring.before[ear], ear, ring.after[ear]))
        ring.clip(ear)
    left = ring.left()
    ears.append((left[0], left[1], left[2]))
    a, b, c = plane[left]
    clean = clean and float(_cross(b - a, c - b)) >= -CONVEX * doubled_area
    return np.array(ears, np.int64), clean


def clip_many(plane: F64, doubled_area: float) -> Ints | None:
    """Triangles of a polygon, arguments as of `clip_ears`, by mapbox-earcut; None if vertices or area are lost, or more is
    covered than there is."""
    from mapbox_earcut import triangulate_float64

    found = triangulate_float64(np.ascontiguousarray(plane), np.array([len(plane)], np.uint32))
    ears = found.reshape(-1, 3).astype(np.int64)
    if len(ears) != len(plane) - 2 or not np.bincount(found, minlength=len(plane)).all():
        return None
    a, b, c = (plane[ears[:, k]] for k in range(3))
    doubled = _cross(b - a, c - a)
    whole = doubled.min() >= 0.0 and abs(float(doubled.sum()) - doubled_area) <= LOST * doubled_area
    return ears if whole else None


class _Ring:
    """The vertices that are left, which of them follow each other, and those that may be ears by how wide they are."""

    def __init__(self, plane: F64) -> None:
        many = len(plane)
        self.before = [(k - 1) % many for k in range(many)]
        self.after = [(k + 1) % many for k in range(many)]
        self._points: list[list[float]] = plane.tolist()
        self._plane, self._names = plane, np.arange(many)  # those left, and some that are gone
        self._there = np.ones(many, np.bool_)
        self._count = many
        self._version = [0] * many
        self._heap = [(-self._turn(k), k, 0) for k in range(many)]
        heapq.heapify(self._heap)
        self._blocked_by: defaultdict[int, list[tuple[float, int, int]]] = defaultdict(list)

    def left(self) -> list[int]:
        """The vertices that are left, ascending."""
        return [int(k) for k in self._names[self._there[self._names]]]

    def first(self) -> int:
        """The first vertex that is left."""
        return int(np.argmax(self._there))

    def find(self) -> int:
        """The ear with the widest opening, of equal ones the first; -1 if there is none."""
        while self._heap:
            entry = self._heap[0]
            turn, k, version = entry
            if version != self._version[k] or not self._there[k]:
                heapq.heappop(self._heap)
                continue
            if turn > 0.0:
                return -1
            blocker = self._blocker(k)
            if blocker < 0:
                return k
            heapq.heappop(self._heap)
            self._blocked_by[blocker].append(entry)
        return -1

    def clip(self, k: int) -> None:
        """Take a vertex away."""
        before, after = self.before[k], self.after[k]
        self.after[before], self.before[after] = after, before
        self._there[k] = False
        self._count -= 1
        for entry in self._blocked_by.pop(k, ()):
            heapq.heappush(self._heap, entry)
        for near in (before, after):
            self._version[near] += 1
            heapq.heappush(self._heap, (-self._turn(near), near, self._version[near]))
        if 2 * self._count < len(self._names):
            self._names = self._names[self._there[self._names]]
            self._plane = np.array(self._points)[self._names]

    def _turn(self, k: int) -> float:
        """How far a corner turns to the left."""
        (ax, ay), (bx, by), (cx, cy) = (self._points[i] for i in (self.before[k], k, self.after[k]))
        return (bx - ax) * (cy - by) - (by - ay) * (cx - bx)

    def _blocker(self, k: int) -> int:
        """A vertex in the triangle of a corner and its neighbours, -1 for none.

        Vertices at the triangle's own corners (a bridge to a hole visits them twice) do not count.
        """
        plane, names = self._plane, self._names
        a, b, c = (np.array(self._points[i]) for i in (self.before[k], k, self.after[k]))
        inside = (_cross(b - a, plane - a) >= 0.0) & (_cross(c - b, plane - b) >= 0.0) & (_cross(a - c, plane - c) >= 0)
        found = np.flatnonzero(inside)
        found = found[self._there[names[found]]]
        own = (plane[found] == a).all(1) | (plane[found] == b).all(1) | (plane[found] == c).all(1)
        others = found[~own]
        return int(names[others[0]]) if len(others) else -1


def _cross(u: F64, v: F64) -> F64:
    return np.asarray(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])
