"""Makes primary rays: from a sample number to the packet of its ray, and to its home.

A sample's place in its pixel is a function of its number alone, so it needs no state and every node
can work out every sample's home: the cell of the rounded point where its primary ray enters the world box
(the rounded eye if that lies inside). The ray itself starts up to TRIES steps further on, where the
lattice has a point nearer to it; that can be in another cell, to which it is then handed first.
"""

from __future__ import annotations

import numpy as np

from raygrid.node.geometry.grid_walk import inverse
from raygrid.node.geometry.lattice import HALF, MOST_TRIES, beside_ray, cell_index, nearest
from raygrid.node.jit.decorators import part
from raygrid.node.protocol.packets import SHORTEST

TRIES = MOST_TRIES  # takes a primary ray 0.03 to 0.1 steps aside instead of 0.4

# plastic-number sequence (M. Roberts 2018, "The unreasonable effectiveness of quasirandom sequences")
R2_X, R2_Y = 0.7548776662466927, 0.5698402909980532


@part
def hash32(x):
    """Mix the bits of a 32-bit number (the finaliser of MurmurHash3)."""
    x = np.uint32(x)
    x = np.uint32((x ^ (x >> np.uint32(16))) * np.uint32(0x85EBCA6B))
    x = np.uint32((x ^ (x >> np.uint32(13))) * np.uint32(0xC2B2AE35))
    return np.uint32(x ^ (x >> np.uint32(16)))


@part
def image_point(sample, width, samples):
    """(i, j) of a sample: the pixel's middle for one sample a pixel, else spread evenly over the pixel."""
    pixel = sample // samples
    j = pixel // width
    i = pixel - j * width
    if samples == 1:
        return np.float64(i), np.float64(j)
    number = sample - pixel * samples
    mixed = np.int64(hash32(pixel))
    x = (mixed & 0xFFFF) / 65536.0 + (number + 1) * R2_X
    y = (mixed >> 16) / 65536.0 + (number + 1) * R2_Y
    return i + (x - np.floor(x)) - 0.5, j + (y - np.floor(y)) - 0.5


@part
def eye_ray(camera, i, j):
    """((origin), (direction)) of the ray through an image point; the direction is a unit vector, +z if it has none."""
    origin = (
        camera[0, 0] + i * camera[1, 0] + j * camera[2, 0],
        camera[0, 1] + i * camera[1, 1] + j * camera[2, 1],
        camera[0, 2] + i * camera[1, 2] + j * camera[2, 2],
    )
    direction = (
        camera[3, 0] + i * camera[4, 0] + j * camera[5, 0],
        camera[3, 1] + i * camera[4, 1] + j * camera[5, 1],
        camera[3, 2] + i * camera[4, 2] + j * camera[5, 2],
    )
    squared = direction[0] * direction[0] + direction[1] * direction[1] + direction[2] * direction[2]
    if not squared >= SHORTEST * SHORTEST:
        return origin, (0.0, 0.0, 1.0)
    scale = 1.0 / np.sqrt(squared)
    return origin, (direction[0] * scale, direction[1] * scale, direction[2] * scale)


@part
def _slab(at, inv, half):
    a, b = (-half - at) * inv, (half - at) * inv
    return (a, b) if inv >= 0.0 else (b, a)


@part
def reach(step, origin, direction):
    """(t, t): at which a primary ray enters the world box, 0 if the eye is inside, and leaves it."""
    near_x, far_x = _slab(origin[0], inverse(direction[0]), HALF * step[0])
    near_y, far_y = _slab(origin[1], inverse(direction[1]), HALF * step[1])
    near_z, far_z = _slab(origin[2], inverse(direction[2]), HALF * step[2])
    return max(near_x, max(near_y, max(near_z, 0.0))), min(far_x, min(far_y, far_z))


@part
def entry(step, origin, direction):
    """(enters, (lattice point), t) of a primary ray and the world box; its home is the cell of that point."""
    near, far = reach(step, origin, direction)
    point = (
        nearest(origin[0] + near * direction[0], step[0]),
        nearest(origin[1] + near * direction[1], step[1]),
        nearest(origin[2] + near * direction[2], step[2]),
    )
    return near <= far, point, near


@part
def primary_origin(step, origin, direction, near):
    """Lattice origin of a primary ray that enters the world box at t = near: a little further on, to be on the ray.

    The definition; `node.tracing.primary_rays` works it out for eight rays at once.
    """
    start = (origin[0] + near * direction[0], origin[1] + near * direction[1], origin[2] + near * direction[2])
    return beside_ray(step, start, direction, TRIES)


@part
def home(space, point):
    """The cell that holds a primary ray's origin."""
    return (
        cell_index(space.planes, 0, space.shape[0], point[0]),
        cell_index(space.planes, 1, space.shape[1], point[1]),
        cell_index(space.planes, 2, space.shape[2], point[2]),
    )
