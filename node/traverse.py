"""A ray against all surfaces of a node: the closest hit, or any hit, within lower <= t < upper.

Ties in t go to the smallest surface id, so the answer does not depend on the hierarchy's shape.
"""

from __future__ import annotations

import numpy as np

from .compiled import part
from .hierarchy import FAR, slab
from .intersect import MISS, cone, in_polygon, plane, sphere, triangle
from .tables import BOXES, KIND_SHIFT, SLOT_MASK, TESTS


@part
def _meet(surfaces, item, o, d, lower, upper, counts):
    """(t, u, v) of one item; t may lie outside lower .. upper."""
    word = np.int64(surfaces.items[item])
    kind, row = word >> KIND_SHIFT, word & SLOT_MASK
    counts[TESTS + kind] += 1
    if kind == 0:
        return triangle(surfaces.triangles, row, o, d)
    if kind == 1:
        return triangle(surfaces.smooth, row, o, d)
    if kind == 3:
        return sphere(surfaces.spheres, row, o, d, lower), 0.0, 0.0
    if kind == 2:
        t = plane(surfaces.planes, row, o, d)
        if not (t >= lower and t <= upper) or not in_polygon(
            surfaces.planes, surfaces.headers, surfaces.bins, surfaces.edges, row, o, d, t
        ):
            t = MISS
        return t, 0.0, 0.0
    return cone(surfaces.cones, row, o, d, lower), 0.0, 0.0


@part
def _narrow(inverse):
    """An inverse direction in binary32, finite."""
    return np.float32(min(max(inverse, -1e18), 1e18))


@part
def closest(surfaces, stack, times, o, d, inv, lower, upper, counts):
    """(t, item, u, v) of the first hit; item -1 if there is none. `stack`, `times`: scratch of hierarchy.DEPTH."""
    floats, ints = surfaces.floats, surfaces.ints
    ox, oy, oz = np.float32(o[0]), np.float32(o[1]), np.float32(o[2])
    ix, iy, iz = _narrow(inv[0]), _narrow(inv[1]), _narrow(inv[2])
    low = np.float32(lower)
    best, best_item, best_u, best_v = upper, -1, 0.0, 0.0
    top, node = 0, 0
    while True:
        counts[BOXES] += 1
        high = np.float32(best)
        t0 = slab(floats, node, 0, ox, oy, oz, ix, iy, iz, low, high)
        t1 = slab(floats, node, 6, ox, oy, oz, ix, iy, iz, low, high)
        near = 0 if t0 <= t1 else 1
        following = -1
        for turn in range(2):
            side = near if turn == 0 else 1 - near
            t_side = t0 if side == 0 else t1
            if t_side == FAR:
                break
            child, count = np.int64(ints[node, 12 + side]), np.int64(ints[node, 14 + side])
            if count == 0:
                if following < 0:
                    following = child
                else:
                    stack[top], times[top] = child, t_side
                    top += 1
                continue
            for item in range(child, child + count):
                t, u, v = _meet(surfaces, item, o, d, lower, best, counts)
                if t >= lower and (
                    t < best or (t == best and best_item >= 0 and surfaces.ids[item] < surfaces.ids[best_item])
                ):
                    best, best_item, best_u, best_v = t, item, u, v
        node = following
        while node < 0 and top > 0:
            top -= 1
            if np.float64(times[top]) <= best * (1.0 + 1e-6):
                node = stack[top]
        if node < 0:
            return best, best_item, best_u, best_v


@part
def blocked(surfaces, stack, o, d, inv, lower, upper, counts):
    """Whether anything is hit within lower <= t < upper."""
    floats, ints = surfaces.floats, surfaces.ints
    ox, oy, oz = np.float32(o[0]), np.float32(o[1]), np.float32(o[2])
    ix, iy, iz = _narrow(inv[0]), _narrow(inv[1]), _narrow(inv[2])
    low, high = np.float32(lower), np.float32(min(upper, 1e18))
    top, node = 0, 0
    while True:
        counts[BOXES] += 1
        following = -1
        for side in range(2):
            if slab(floats, node, 6 * side, ox, oy, oz, ix, iy, iz, low, high) == FAR:
                continue
            child, count = np.int64(ints[node, 12 + side]), np.int64(ints[node, 14 + side])
            if count == 0:
                if following < 0:
                    following = child
                else:
                    stack[top] = child
                    top += 1
                continue
            for item in range(child, child + count):
                t, _, _ = _meet(surfaces, item, o, d, lower, upper, counts)
                if t >= lower and t < upper:
                    return True
        node = following
        if node < 0:
            if top == 0:
                return False
            top -= 1
            node = stack[top]

