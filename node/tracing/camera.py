"""Makes primary rays: from a sample number to the packet of its ray, and to its home.

A sample's place in its pixel is a function of its number alone, so it needs no state and every node
can work out every sample's home: the cell of the rounded point where its primary ray enters the world box
(the rounded eye if that lies inside). The ray itself starts up to TRIES steps further on, where the
lattice has a point nearer to it; that can be in another cell, to which it is then handed first.
"""

from __future__ import annotations

import math

from raygrid.node.geometry.grid_walk import inverse
from raygrid.node.geometry.lattice import HALF, beside_ray, cell_index, nearest
from raygrid.node.jit.decorators import part
from raygrid.node.jit.formula import formula
from raygrid.node.jit.lanes import ARRAY, BIT, F64, I64, LATTICE_POINT, VECTOR, Lanes, Memory, Three, dot, least, most
from raygrid.node.protocol.packing import SHORTEST

TRIES = 16  # points of which the one nearest to the ray is taken: takes a primary ray 0.03 to 0.1 steps aside instead of 0.4

# plastic-number sequence (M. Roberts 2018, "The unreasonable effectiveness of quasirandom sequences")
R2_X, R2_Y = 0.7548776662466927, 0.5698402909980532


def hash32(x: Lanes) -> Lanes:
    """Mix the bits of a 32-bit number, as int64 (the finaliser of MurmurHash3)."""
    x = ((x ^ x >> 16) * 0x85EBCA6B) & 0xFFFFFFFF
    x = ((x ^ x >> 13) * 0xC2B2AE35) & 0xFFFFFFFF
    return x ^ x >> 16


@formula(takes=(I64, F64, F64), gives=((I64, I64), (F64, F64)))
def pixel_and_point(sample: Lanes, width: Lanes, samples: Lanes) -> tuple[list[Lanes], list[Lanes]]:
    """(column and row of a sample's pixel, the point in the image).

    The point is the pixel's middle for one sample a pixel, else they are spread evenly over the pixel. Whole numbers are
    in binary64: quotients of numbers below 2^32 lie farther below the next whole than rounding can raise them.
    """
    number = sample.to(F64)
    pixel = math.floor(number / samples)
    row = math.floor(pixel / width)
    column = pixel - row * width
    number = number - pixel * samples + 1.0
    mixed = hash32(pixel.to(I64))
    alone = samples.equals(1.0)
    point = []
    for middle, bits, ratio in ((column, mixed & 0xFFFF, R2_X), (row, mixed >> 16, R2_Y)):
        at = bits.to(F64) * (1.0 / 65536.0) + number * ratio
        point.append(alone.choose(middle, middle + (at - math.floor(at)) - 0.5))
    return [column, row], point


@formula(takes=(I64, F64, F64), gives=(F64, F64))
def image_point(sample: Lanes, width: Lanes, samples: Lanes) -> list[Lanes]:
    """(i, j) of a sample in the image, columns and rows."""
    return pixel_and_point(sample, width, samples)[1]  # type: ignore[no-any-return]


@formula(takes=(ARRAY, F64, F64), gives=(VECTOR, VECTOR))
def eye_ray(camera: Memory, i: Lanes, j: Lanes) -> tuple[list[Lanes], list[Lanes]]:
    """((origin), (direction)) of the ray through an image point; the direction is a unit vector, +z if it has none.

    camera  float64 (6, 3): origin and direction at (0, 0), each followed by what it changes by a column and by a row
    """
    origin, (u, v, w) = (
        [camera.one(row + axis) + i * camera.one(row + 3 + axis) + j * camera.one(row + 6 + axis) for axis in range(3)]
        for row in (0, 9)
    )
    squared = dot((u, v, w), (u, v, w))
    has_one = squared >= SHORTEST * SHORTEST
    scale = has_one.choose(1.0 / squared.root(), 0.0)
    return origin, [u * scale, v * scale, has_one.choose(w * scale, 1.0)]


@formula(takes=(VECTOR, VECTOR, VECTOR), gives=(F64, F64))
def reach(step: Three, origin: Three, direction: Three) -> tuple[Lanes, Lanes]:
    """(t, t): at which a primary ray enters the world box, 0 if the eye is inside, and leaves it."""
    nears, fars = [], []
    for at, d, one in zip(origin, direction, step, strict=True):
        inv, half = inverse(d), one * float(HALF)
        a, b = (-half - at) * inv, (half - at) * inv
        nears.append((inv >= 0.0).choose(a, b))
        fars.append((inv >= 0.0).choose(b, a))
    near = most(nears[0], most(nears[1], most(nears[2], nears[2].every(0.0))))
    return near, least(fars[0], least(fars[1], fars[2]))


@formula(takes=(VECTOR, VECTOR, VECTOR), gives=(BIT, LATTICE_POINT, F64))
def entry(step: Three, origin: Three, direction: Three) -> tuple[Lanes, list[Lanes], Lanes]:
    """(enters, (lattice point), t) of a primary ray and the world box; its home is the cell of that point."""
    near, far = reach(step, origin, direction)
    point = [nearest(origin[axis] + near * direction[axis], step[axis]) for axis in range(3)]
    return near <= far, point, near


@formula(takes=(VECTOR, VECTOR, VECTOR, F64), gives=LATTICE_POINT)
def primary_origin(step: Three, origin: Three, direction: Three, near: Lanes) -> list[Lanes]:
    """Lattice origin of a primary ray that enters the world box at t = near: a little further on, to be on the ray."""
    start = [origin[axis] + near * direction[axis] for axis in range(3)]
    return beside_ray(step, start, direction, TRIES)


@part
def home(space, point):
    """The cell that holds a primary ray's origin."""
    return (
        cell_index(space.planes, 0, space.shape[0], point[0]),
        cell_index(space.planes, 1, space.shape[1], point[1]),
        cell_index(space.planes, 2, space.shape[2], point[2]),
    )
