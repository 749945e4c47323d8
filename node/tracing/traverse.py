"""Traverses the hierarchy: the closest hit of a ray with all surfaces of a node, or any, within lower <= t < upper.

Ties in t go to the smallest surface id, so the answer does not depend on the hierarchy's shape. Every
walk begins at the root with nothing remembered from other rays: how many boxes and surfaces it looks at is a
function of the ray and the hierarchy, and machine time is worked out from that.

The stack holds keys, time << 32 | child (`node.geometry.bvh_boxes`). Leaves are put on it like inner nodes, in the order in
which the ray enters them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from raygrid.node.geometry.bvh import COUNT_MASK, COUNT_SHIFT, FIRST_MASK, LEAF_BIT, NODE_WORDS
from raygrid.node.geometry.bvh_boxes import FAREST, for_boxes, push_boxes
from raygrid.node.geometry.intersect import MISS, cone, in_polygon, plane, sphere, triangle
from raygrid.node.geometry.surface_tables import KIND_SHIFT, SLOT_MASK
from raygrid.node.jit.closures import made_of_parts
from raygrid.node.jit.decorators import Function, part
from raygrid.node.protocol.counters import BOXES, TESTS


class Search(NamedTuple):
    """A ray that is looked for hits. Compiled code makes it.

    origin, direction  three float64 each; boxes  the ray as `for_boxes` gives it
    lower, upper       hits count at lower <= t < upper
    """

    origin: Any
    direction: Any
    boxes: Any
    lower: Any
    upper: Any


@part
def meet(surfaces, kind, row, o, d, lower, upper):
    """(t, u, v) of one surface; t may lie outside lower .. upper."""
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
def _bits(best):
    """The upper half of the keys of boxes that are entered at `best`, or later by less than rounding can make it."""
    return np.int64(np.float32(best * (1.0 + 1e-6)).view(np.uint32))


@part
def _nearest_last(stack, first, top):
    """Put keys first .. top-1 in order: two on average, so by insertion."""
    for i in range(first + 1, top):
        key = stack[i]
        k = i
        while k > first and stack[k - 1] < key:
            stack[k] = stack[k - 1]
            k -= 1
        stack[k] = key


@part
def _leaf(surfaces, child):
    """(first item, items, kind, row of the first) of a leaf; the others follow in the table of their kind."""
    first = child & FIRST_MASK
    word = np.int64(surfaces.items[first])
    return first, ((child >> COUNT_SHIFT) & COUNT_MASK) + 1, word >> KIND_SHIFT, word & SLOT_MASK


@part
def open_root(surfaces, keys, at, o, inv, lower, upper):
    """Put the keys of the root's boxes that a ray meets into `keys`, int64, from place `at` on (WIDE places are
    overwritten); returns how many. There must be a root."""
    ray, near = for_boxes(o, inv)
    high = np.float32(min(upper, FAREST))
    return push_boxes(surfaces.floats, 0, near, ray, np.float32(lower), high, keys, at) - at


@made_of_parts
def make_closest(meet: Function) -> Function:
    """Make `closest_below`, which finds the first hit of a ray, over what `meet` says of one surface."""

    @part
    def closest_below(surfaces, stack, met, ray, counts):
        """(t, item, u, v) of the first hit, item -1 if there is none; the keys that `open_root` gives are on the stack,
        this many. ray  `Search`; stack  int64 (bvh.DEPTH,)."""
        single, near = ray.boxes
        low = np.float32(ray.lower)
        best, best_item, best_u, best_v = ray.upper, np.int64(-1), 0.0, 0.0
        limit = _bits(best)
        top, opened = np.int64(0), 0
        while True:
            opened += 1
            _nearest_last(stack, top, top + met)
            top += met
            node = np.int64(-1)
            while top > 0 and node < 0:
                top -= 1
                child = stack[top] & 0xFFFFFFFF
                if stack[top] >> 32 > limit:
                    continue
                if child < LEAF_BIT:
                    node = child
                    continue
                first, count, kind, row = _leaf(surfaces, child)
                counts[TESTS + kind] += count
                for k in range(count):
                    t, u, v = meet(surfaces, kind, row + k, ray.origin, ray.direction, ray.lower, best)
                    if t >= ray.lower and (
                        t < best or (t == best and best_item >= 0 and surfaces.ids[first + k] < surfaces.ids[best_item])
                    ):
                        best, best_item, best_u, best_v = t, first + k, u, v
                        limit = _bits(best)
            if node < 0:
                break
            high = np.float32(min(best, FAREST))
            met = push_boxes(surfaces.floats, node * NODE_WORDS, near, single, low, high, stack, top) - top
        counts[BOXES] += opened
        return best, best_item, best_u, best_v

    return closest_below


@made_of_parts
def make_blocked(meet: Function) -> Function:
    """Make `blocked_below`, which tells whether a ray hits anything, over what `meet` says of one surface."""

    @part
    def blocked_below(surfaces, stack, met, ray, counts):
        """Tell whether anything is hit; arguments as of `closest_below`. In no order: sorting costs more than it saves (2 to
        18 %)."""
        single, near = ray.boxes
        low, high = np.float32(ray.lower), np.float32(min(ray.upper, FAREST))
        top, opened = np.int64(0), 0
        while True:
            opened += 1
            top += met
            node = np.int64(-1)
            while top > 0 and node < 0:
                top -= 1
                child = stack[top] & 0xFFFFFFFF
                if child < LEAF_BIT:
                    node = child
                    continue
                _, count, kind, row = _leaf(surfaces, child)
                for k in range(count):
                    counts[TESTS + kind] += 1
                    t, _, _ = meet(surfaces, kind, row + k, ray.origin, ray.direction, ray.lower, ray.upper)
                    if t >= ray.lower and t < ray.upper:
                        counts[BOXES] += opened
                        return True
            if node < 0:
                break
            met = push_boxes(surfaces.floats, node * NODE_WORDS, near, single, low, high, stack, top) - top
        counts[BOXES] += opened
        return False

    return blocked_below


_closest_below, _blocked_below = make_closest(meet), make_blocked(meet)


@part
def closest(surfaces, stack, o, d, inv, lower, upper, counts):
    """(t, item, u, v) of the first hit; item -1 if there is none. `stack`: scratch, int64 (bvh.DEPTH,)."""
    met = open_root(surfaces, stack, np.int64(0), o, inv, lower, upper)
    return _closest_below(surfaces, stack, met, Search(o, d, for_boxes(o, inv), lower, upper), counts)


@part
def blocked(surfaces, stack, o, d, inv, lower, upper, counts):
    """Tell whether anything is hit within lower <= t < upper."""
    met = open_root(surfaces, stack, np.int64(0), o, inv, lower, upper)
    return _blocked_below(surfaces, stack, met, Search(o, d, for_boxes(o, inv), lower, upper), counts)
