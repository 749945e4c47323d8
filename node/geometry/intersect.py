"""Intersects a ray with one surface. Every function is arithmetic on one ray and one surface, in binary64.

Each returns the ray parameter t, or MISS. A hit is accepted only so that its computed point lies within
`lattice.SLACK` of the surface: `node.geometry.overlap` relies on that (retention is implied by acceptance), and
for the same reason rays closer to a flat surface's plane than GRAZING never meet it. Rules of acceptance
are part of the surface, not of the array: they hold in the 1x1x1 array too (law 4).

    triangle   error of the point <= 8 eps / GRAZING, see `triangle`
    polygon    the test is made on the computed point itself
    cone       the computed point's distance from the cone is checked
"""

from __future__ import annotations

import numpy as np

from raygrid.node.geometry.lattice import SLACK
from raygrid.node.jit.decorators import part

MISS = np.inf
GRAZING = 1e-9  # sine of the least angle between ray and plane; also the least area of a triangle over its edges

# columns of the derived tables, made by `node.tracing.local_geometry`
CONE_BASE, CONE_AXIS, CONE_HEIGHT, CONE_RADIUS, CONE_SLOPE, CONE_INSIDE = 0, 3, 6, 7, 8, 9
CONE_COLUMNS = 10
PLANE_NORMAL, PLANE_OFFSET, PLANE_FIRST_BIN, PLANE_BIN_SCALE = 0, 3, 4, 5
PLANE_COLUMNS = 6
POLY_DROP, POLY_BIN_START, POLY_BINS = 0, 1, 2
POLY_COLUMNS = 3


@part
def triangle(data, row, o, d):
    """(t, u, v) for a triangle in columns 0-8 of `data` (Möller and Trumbore 1997).

    The relative error of u, v and t is about eps |o - a| / |det| in units of the edges, so a lower bound
    on |det| / (|e1| |e2|) bounds how far the computed point lies from the triangle (8 eps / 1e-9 < SLACK).
    """
    ax, ay, az = np.float64(data[row, 0]), np.float64(data[row, 1]), np.float64(data[row, 2])
    e1x, e1y, e1z = data[row, 3] - ax, data[row, 4] - ay, data[row, 5] - az
    e2x, e2y, e2z = data[row, 6] - ax, data[row, 7] - ay, data[row, 8] - az
    px, py, pz = d[1] * e2z - d[2] * e2y, d[2] * e2x - d[0] * e2z, d[0] * e2y - d[1] * e2x
    det = e1x * px + e1y * py + e1z * pz
    if det == 0.0:
        return MISS, 0.0, 0.0
    scale = 1.0 / det
    tx, ty, tz = o[0] - ax, o[1] - ay, o[2] - az
    u = (tx * px + ty * py + tz * pz) * scale
    if not (u >= 0.0 and u <= 1.0):
        return MISS, 0.0, 0.0
    qx, qy, qz = ty * e1z - tz * e1y, tz * e1x - tx * e1z, tx * e1y - ty * e1x
    v = (d[0] * qx + d[1] * qy + d[2] * qz) * scale
    if not (v >= 0.0 and u + v <= 1.0):
        return MISS, 0.0, 0.0
    size = (e1x * e1x + e1y * e1y + e1z * e1z) * (e2x * e2x + e2y * e2y + e2z * e2z)
    if not det * det >= GRAZING * GRAZING * size:
        return MISS, 0.0, 0.0
    return (e2x * qx + e2y * qy + e2z * qz) * scale, u, v


@part
def sphere(data, row, o, d, lower):
    """The first t >= lower at which a ray meets a sphere; from inside only if the radius is negative."""
    x, y, z = o[0] - data[row, 0], o[1] - data[row, 1], o[2] - data[row, 2]
    radius = data[row, 3]
    b = -(x * d[0] + y * d[1] + z * d[2])
    # discriminant from the closest approach: no cancellation for a small sphere far away (Haines et al. 2019)
    lx, ly, lz = x + b * d[0], y + b * d[1], z + b * d[2]
    discriminant = radius * radius - (lx * lx + ly * ly + lz * lz)
    if discriminant < 0.0:
        return MISS
    root = np.sqrt(discriminant)
    c = x * x + y * y + z * z - radius * radius
    if b >= 0.0:
        far = b + root
        near = c / far if far > 0.0 else 0.0
    else:
        near = b - root
        far = c / near
    if near >= lower and radius > 0.0:
        return near
    return far if far >= lower else MISS


@part
def cone(data, row, o, d, lower):
    """The first t >= lower on the side of a cone's frustum or cylinder (no caps).

    With A the unit axis, y = (X - base) . A the height and r(y) = radius + slope y:
    |X - base|^2 - y^2 = r(y)^2, a quadratic in t. The origin is first moved along the ray to the point
    nearest to the frustum's middle, so that all terms have the size of the frustum.
    """
    bx, by, bz = data[row, CONE_BASE], data[row, CONE_BASE + 1], data[row, CONE_BASE + 2]
    ax, ay, az = data[row, CONE_AXIS], data[row, CONE_AXIS + 1], data[row, CONE_AXIS + 2]
    height, radius, slope = data[row, CONE_HEIGHT], data[row, CONE_RADIUS], data[row, CONE_SLOPE]
    half = 0.5 * height
    shift = (bx + half * ax - o[0]) * d[0] + (by + half * ay - o[1]) * d[1] + (bz + half * az - o[2]) * d[2]
    mx, my, mz = o[0] + shift * d[0] - bx, o[1] + shift * d[1] - by, o[2] + shift * d[2] - bz
    md, dd = mx * ax + my * ay + mz * az, d[0] * ax + d[1] * ay + d[2] * az
    k = 1.0 + slope * slope
    a = 1.0 - dd * dd * k
    b = mx * d[0] + my * d[1] + mz * d[2] - md * dd * k - radius * slope * dd
    c = mx * mx + my * my + mz * mz - md * md * k - 2.0 * radius * slope * md - radius * radius
    discriminant = b * b - a * c
    if discriminant < 0.0:
        return MISS
    q = -(b + np.copysign(np.sqrt(discriminant), b))
    t1 = q / a if a != 0.0 else MISS
    t2 = c / q if q != 0.0 else MISS
    first, second = min(t1, t2), max(t1, t2)
    middle = (mx, my, mz)
    if _on_cone(data, row, d, lower, middle, dd, (first + shift, first, md + first * dd)):
        return first + shift
    if _on_cone(data, row, d, lower, middle, dd, (second + shift, second, md + second * dd)):
        return second + shift
    return MISS


@part
def _on_cone(data, row, d, lower, middle, dd, hit):
    """Tell whether the point m + s d at height y is a point of the frustum that this ray sees.

    middle  m, from which s counts; dd  cosine between ray and axis; hit  (t, s, y)
    """
    (mx, my, mz), (t, s, y) = middle, hit
    if not (t >= lower and t < 1e6 and y >= 0.0 and y <= data[row, CONE_HEIGHT]):
        return False
    x, z = mx + s * d[0] - y * data[row, CONE_AXIS], mz + s * d[2] - y * data[row, CONE_AXIS + 2]
    w = my + s * d[1] - y * data[row, CONE_AXIS + 1]
    reach = np.sqrt(x * x + w * w + z * z)
    expected = data[row, CONE_RADIUS] + data[row, CONE_SLOPE] * y
    if not abs(reach - expected) <= 0.25 * SLACK:
        return False
    if data[row, CONE_INSIDE] == 0.0:
        return True
    outward = x * d[0] + w * d[1] + z * d[2] - data[row, CONE_SLOPE] * reach * dd
    return outward > 0.0


@part
def plane(planes, row, o, d):
    """t of the plane of a polygon."""
    nx, ny, nz = planes[row, PLANE_NORMAL], planes[row, PLANE_NORMAL + 1], planes[row, PLANE_NORMAL + 2]
    det = nx * d[0] + ny * d[1] + nz * d[2]
    if not abs(det) >= GRAZING:
        return MISS
    return (planes[row, PLANE_OFFSET] - (nx * o[0] + ny * o[1] + nz * o[2])) / det


@part
def in_polygon(planes, headers, bins, edges, row, o, d, t):
    """Tell whether the point at t lies in the polygon: an odd number of edges to its right, in the projection
    along the largest component of the normal. Each edge is stored from its lower end to its upper one,
    and counts for low <= y < high, so a point on an edge that two polygons share lies in one of them.

    Edges are found by strips of the polygon's height (`node.tracing.local_geometry`), which changes the work, not the answer.
    """
    drop = headers[row, POLY_DROP]
    if drop == 0:
        x, y = o[1] + t * d[1], o[2] + t * d[2]
    elif drop == 1:
        x, y = o[2] + t * d[2], o[0] + t * d[0]
    else:
        x, y = o[0] + t * d[0], o[1] + t * d[1]
    where = (y - planes[row, PLANE_FIRST_BIN]) * planes[row, PLANE_BIN_SCALE]
    if not (where >= 0.0 and where < headers[row, POLY_BINS]):
        return False
    strip = headers[row, POLY_BIN_START] + np.int64(where)
    inside = False
    for k in range(bins[strip], bins[strip + 1]):
        if edges[k, 1] <= y and y < edges[k, 2] and x < edges[k, 0] + (y - edges[k, 1]) * edges[k, 3]:
            inside = not inside
    return inside
