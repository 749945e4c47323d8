"""Compiled loops over the parts of kernels that tests call many times; few, as each takes seconds to compile."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from reference.packing import put_ray

from raygrid.node.geometry.bvh import DEPTH
from raygrid.node.geometry.grid_walk import inverse
from raygrid.node.geometry.intersect import MISS, cone, in_polygon, plane, sphere, triangle
from raygrid.node.geometry.lattice import Space, make_cell
from raygrid.node.geometry.surface_tables import KIND_SHIFT, SLOT_MASK, Surfaces
from raygrid.node.geometry.surfaces import SurfaceSet
from raygrid.node.jit.decorators import kernel, part
from raygrid.node.protocol.counters import COUNTS
from raygrid.node.protocol.frame_tables import Frame
from raygrid.node.protocol.packets import SIZE
from raygrid.node.protocol.packing import pack_weight
from raygrid.node.tracing.camera import entry, eye_ray, home, image_point
from raygrid.node.tracing.local_geometry import build_surfaces
from raygrid.node.tracing.traverse import blocked, closest
from support.space import even_space

F64 = NDArray[np.float64]
WHOLE = make_cell(even_space((1, 1, 1), (1.0 / (1 << 23),) * 3), (0, 0, 0))


@part
def _meet(surfaces, item, o, d, lower):
    """t of one item: the first not below `lower` for bodies, any t for flat surfaces."""
    word = np.int64(surfaces.items[item])
    kind, row = word >> KIND_SHIFT, word & SLOT_MASK
    if kind == 0:
        return triangle(surfaces.triangles, row, o, d)[0]
    if kind == 1:
        return triangle(surfaces.smooth, row, o, d)[0]
    if kind == 2:
        t = plane(surfaces.planes, row, o, d)
        if t == MISS:
            return MISS
        inside = in_polygon(surfaces.planes, surfaces.headers, surfaces.bins, surfaces.edges, row, o, d, t)
        return t if inside else MISS
    if kind == 3:
        return sphere(surfaces.spheres, row, o, d, lower)
    return cone(surfaces.cones, row, o, d, lower)


@kernel
def _meet_each(surfaces, items, origins, directions, lowers, found):
    for k in range(len(items)):
        o = (origins[k, 0], origins[k, 1], origins[k, 2])
        d = (directions[k, 0], directions[k, 1], directions[k, 2])
        found[k] = _meet(surfaces, items[k], o, d, lowers[k])


@kernel
def _closest_each(surfaces, stack, origins, directions, lowers, uppers, counts, walked, brute):
    """walked, brute (n, 3): t and id (-1 for none) of the closest hit, and whether anything was hit."""
    for k in range(len(origins)):
        o = (origins[k, 0], origins[k, 1], origins[k, 2])
        d = (directions[k, 0], directions[k, 1], directions[k, 2])
        inv = (inverse(d[0]), inverse(d[1]), inverse(d[2]))
        t, item, _, _ = closest(surfaces, stack, o, d, inv, lowers[k], uppers[k], counts)
        walked[k, 0], walked[k, 1] = t, surfaces.ids[item] if item >= 0 else -1.0
        walked[k, 2] = 1.0 if blocked(surfaces, stack, o, d, inv, lowers[k], uppers[k], counts) else 0.0
        brute[k, 0], brute[k, 1] = uppers[k], -1.0
        for other in range(len(surfaces.items)):
            t = _meet(surfaces, other, o, d, lowers[k])
            if not (t >= lowers[k] and t < uppers[k]):
                continue
            if t < brute[k, 0] or (t == brute[k, 0] and surfaces.ids[other] < brute[k, 1]):
                brute[k, 0], brute[k, 1] = t, surfaces.ids[other]
        brute[k, 2] = 1.0 if brute[k, 1] >= 0.0 else 0.0


def built(surfaces: SurfaceSet) -> Surfaces:
    """The tables of a node that holds the whole world."""
    return build_surfaces(surfaces, WHOLE)


def meet_each(surfaces: Surfaces, ids: NDArray[np.integer], origins: F64, directions: F64, lowers: F64) -> F64:
    """t of ray k with the surface of id ids[k], infinite for a miss."""
    item_of = np.full(int(surfaces.ids.max()) + 1, -1)
    item_of[surfaces.ids] = np.arange(len(surfaces.ids))
    found = np.empty(len(ids))
    _meet_each(surfaces, item_of[ids], origins, directions, lowers, found)
    return found


def closest_each(surfaces: Surfaces, origins: F64, directions: F64, lowers: F64, uppers: F64) -> tuple[F64, F64]:
    """(by the hierarchy, over all surfaces one by one): rows of t, id or -1, and 1 if anything was hit."""
    walked, brute = np.empty((len(origins), 3)), np.empty((len(origins), 3))
    stack, counts = np.zeros(DEPTH, np.int64), np.zeros(COUNTS, np.int64)
    _closest_each(surfaces, stack, origins, directions, lowers, uppers, counts, walked, brute)
    return walked, brute


@kernel
def _homes(frame, space, enters, points, places, directions):
    for sample in range(len(enters)):
        i, j = image_point(sample, frame.width, frame.samples)
        origin, direction = eye_ray(frame.camera, i, j)
        enters[sample], point, _ = entry(space.step, origin, direction)
        place = home(space, point)
        for axis in range(3):
            points[sample, axis], places[sample, axis], directions[sample, axis] = (
                point[axis],
                place[axis],
                direction[axis],
            )


class Samples(NamedTuple):
    """Every sample of a frame: whether its ray enters the world box, where, in which cell, and which way it goes."""

    enters: NDArray[np.bool_]
    points: NDArray[np.int64]
    homes: NDArray[np.int64]
    directions: F64


def all_samples(frame: Frame, space: Space) -> Samples:
    """All samples of a frame, one after the other."""
    n = frame.width * frame.height * frame.samples
    samples = Samples(np.zeros(n, bool), np.zeros((n, 3), np.int64), np.zeros((n, 3), np.int64), np.zeros((n, 3)))
    _homes(frame, space, samples.enters, samples.points, samples.homes, samples.directions)
    return samples


@kernel
def _put_rays(kind, depth, origins, codes, weight, rows):
    for k in range(len(origins)):
        origin = (origins[k, 0], origins[k, 1], origins[k, 2])
        put_ray(rows, k * SIZE, kind, depth, k, origin, (codes[k, 0], codes[k, 1]), weight)


def ray_packets(kind: int, origins: NDArray[np.int64], codes: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Rays of weight 1 and depth 1, uint8 (n, 25); sample numbers as they come."""
    rows = np.zeros(len(origins) * SIZE, np.uint8)
    _put_rays(kind, 1, origins, codes, pack_weight(1.0, 1.0, 1.0), rows)
    return rows.reshape(-1, SIZE)
