"""Measures polygons, many at a time (planes, flatness, convexity), and cuts them into triangles.

Everywhere `points` is float64 (p, 3) and `starts` int64 (n + 1,), as in a Batch of polygons: polygon k has the rows
`starts[k]` to `starts[k + 1]` of `points`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raygrid.host.scene.ear_clipping import CONVEX, clip_ears
from raygrid.host.scene.linear_algebra import dot, lengths, units
from raygrid.node.geometry import F64

Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]

NO_AREA = 1e-12  # twice the area over the squared extent below which a surface is a line: rounding makes more
# Vertices may leave the mean plane by this part of (extent + largest coordinate): what rounded numbers make of a plane.
FLATNESS = 1e-7


def flat_triangles(corners: F64) -> Mask:
    """Find which of the triangles, (n, 3, 3), have no area, (n,)."""
    edges = corners[:, (1, 2, 0)] - corners
    doubled = lengths(np.cross(edges[:, 0], edges[:, 1]))
    longest = dot(edges, edges).max(axis=1, initial=0.0)
    return np.asarray(doubled <= NO_AREA * longest)


def area_vectors(points: F64, starts: Ints) -> F64:
    """Newell's normals: along the front's normal, twice the area long, (n, 3). Right for concave polygons too."""
    if len(starts) < 2:
        return np.zeros((0, 3))
    offsets = points - np.repeat(points[starts[:-1]], np.diff(starts), axis=0)
    return np.add.reduceat(np.cross(offsets, offsets[_following(starts)]), starts[:-1], axis=0)


def extents(points: F64, starts: Ints) -> F64:
    """Diagonals of the polygons' boxes, (n,)."""
    low = np.minimum.reduceat(points, starts[:-1], axis=0)
    return np.asarray(lengths(np.maximum.reduceat(points, starts[:-1], axis=0) - low))


def flat_polygons(points: F64, starts: Ints) -> Mask:
    """Find which of the polygons have no area, (n,)."""
    if len(starts) < 2:
        return np.zeros(0, np.bool_)
    doubled = lengths(area_vectors(points, starts))
    return np.asarray(doubled <= NO_AREA * extents(points, starts) ** 2)


def planar_polygons(points: F64, starts: Ints, most: float | F64 = np.inf) -> Mask:
    """Find which of the polygons lie in a plane, (n,): to FLATNESS of their extent plus their largest coordinate, and to
    `most`, in units of the points, of all or of each, however far from the origin they are."""
    if len(starts) < 2:
        return np.zeros(0, np.bool_)
    sizes = np.diff(starts)
    normals = units(area_vectors(points, starts))
    middles = np.add.reduceat(points, starts[:-1], axis=0) / sizes[:, None]
    offsets = points - np.repeat(middles, sizes, axis=0)
    heights = np.abs(dot(offsets, np.repeat(normals, sizes, axis=0)))
    largest = np.maximum.reduceat(np.abs(points).max(axis=1), starts[:-1])
    allowed = np.minimum(FLATNESS * (extents(points, starts) + largest), most)
    return np.asarray(np.maximum.reduceat(heights, starts[:-1]) <= allowed)


def select_polygons(points: F64, starts: Ints, chosen: Mask) -> tuple[F64, Ints]:
    """The points and starts of the chosen polygons."""
    sizes = np.diff(starts)
    return points[np.repeat(chosen, sizes)], np.concatenate(([0], np.cumsum(sizes[chosen]))).astype(np.int64)


def convex_polygons(points: F64, starts: Ints) -> Mask:
    """Find which of the polygons are convex, seen along their normals, (n,); every triangle is."""
    if len(starts) < 2:
        return np.zeros(0, np.bool_)
    sizes = np.diff(starts)
    normals = np.repeat(units(area_vectors(points, starts)), sizes, axis=0)
    edges = points[_following(starts)] - points
    ahead = edges[_following(starts)]
    turn = dot(np.cross(edges, ahead), normals)
    straight = dot(edges, ahead)
    # Left turns only is not enough: a pentagram turns left at every corner, but twice around.
    around = np.add.reduceat(np.arctan2(turn, straight), starts[:-1])
    left = np.minimum.reduceat(turn + CONVEX * np.hypot(turn, straight), starts[:-1]) >= 0.0
    return np.asarray((sizes == 3) | (left & (np.abs(around - 2.0 * np.pi) < 1.0)))


def triangulate(points: F64, starts: Ints) -> tuple[Ints, Ints, int]:
    """Cut polygons into triangles that keep their vertices and their front.

    Convex ones become a fan around their first vertex, the others lose ear after ear. Returns the triangles as rows of
    `points`, (t, 3), the polygon that each belongs to, (t,), ascending, and how many polygons did not come apart into
    ears, which only those that cross themselves can fail to do (their triangles are a guess).
    """
    convex = convex_polygons(points, starts)
    pieces = np.maximum(np.diff(starts) - 2, 0)
    owner = np.repeat(np.arange(len(pieces)), pieces)
    first = np.concatenate(([0], np.cumsum(pieces))).astype(np.int64)
    step = np.arange(len(owner)) - first[owner]
    begin = starts[:-1][owner]
    corners = np.stack((begin, begin + step + 1, begin + step + 2), axis=1)
    crossing = 0
    for k in np.flatnonzero(~convex & (pieces > 0)):
        ears, clean = _clip_ears(points[starts[k] : starts[k + 1]])
        corners[first[k] : first[k + 1]] = ears + starts[k]
        crossing += not clean
    return corners, owner, crossing


def _following(starts: Ints) -> Ints:
    """For each point the row of the next point of its polygon."""
    following = np.arange(1, starts[-1] + 1)
    following[starts[1:] - 1] = starts[:-1]
    return following


def _clip_ears(points: F64) -> tuple[Ints, bool]:
    """Triangles of one polygon, (m - 2, 3), and whether it had ears to the end, as each has that crosses nowhere."""
    normal = area_vectors(points, np.array((0, len(points)), np.int64))[0]
    axis = int(np.argmax(np.abs(normal)))
    # Drop the axis along which the polygon is seen best; the order of the others keeps it counter-clockwise.
    plane = np.delete(points, axis, axis=1)
    if (normal[axis] < 0.0) != (axis == 1):
        plane = plane[:, ::-1]
    return clip_ears(plane, abs(float(normal[axis])))
