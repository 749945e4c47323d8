"""Packs directions, weights and packets of rays one by one, with branches: the reference of `node.protocol.packing`."""

import math

import numpy as np

from raygrid.node.jit.decorators import part
from raygrid.node.protocol.packets import SHADOW
from raygrid.node.protocol.packing import (
    HALF_DIRECTION,
    LARGEST_BINARY32,
    LARGEST_SHADOW_WEIGHT,
    SHORTEST,
    TOO_LARGE_WEIGHT,
    WEIGHT_BIAS,
)

WEIGHT_INVERSE_UNIT = np.ldexp(1.0, WEIGHT_BIAS + 11 - np.arange(128))


@part
def octahedral(x, y, z):
    """The two direction codes of a vector (need not be a unit vector); one too short to have a direction goes along +z."""
    size = abs(x) + abs(y) + abs(z)
    scale = 1.0 / size if size >= SHORTEST else 0.0
    u, v = x * scale, y * scale
    if z < 0.0:
        u, v = (1.0 - abs(v)) * math.copysign(1.0, u), (1.0 - abs(u)) * math.copysign(1.0, v)
    a = np.int64(math.floor(u * HALF_DIRECTION + 0.5)) + HALF_DIRECTION
    b = np.int64(math.floor(v * HALF_DIRECTION + 0.5)) + HALF_DIRECTION
    return min(max(a, 0), 2 * HALF_DIRECTION), min(max(b, 0), 2 * HALF_DIRECTION)


@part
def unit_vector(a, b):
    """The unit vector that two direction codes stand for."""
    u = np.float64(a - HALF_DIRECTION) * (1.0 / HALF_DIRECTION)
    v = np.float64(b - HALF_DIRECTION) * (1.0 / HALF_DIRECTION)
    z = 1.0 - abs(u) - abs(v)
    # of the lower half the folded ones; neither is ever -0, and a choice costs less than a branch
    folded_x, folded_y = math.copysign(1.0 - abs(v), u), math.copysign(1.0 - abs(u), v)
    x, y = folded_x if z < 0.0 else u, folded_y if z < 0.0 else v
    scale = 1.0 / math.sqrt(x * x + y * y + z * z)
    return x * scale, y * scale, z * scale


@part
def pack_weight(red, green, blue):
    """Three weights >= 0 as 40 bits. Below 2^-75 they become 0; at 2^64 and above the largest that fits."""
    largest = max(red, green, blue)
    if not largest > 0.0:
        return np.int64(0)
    # largest = f * 2^e with 0.5 <= f < 1; an infinity has no e
    exponent = max(math.frexp(largest)[1] + WEIGHT_BIAS, 0) if largest < TOO_LARGE_WEIGHT else 127
    if exponent < 127 and largest * WEIGHT_INVERSE_UNIT[exponent] + 0.5 >= 2048.0:
        exponent += 1
    unit = WEIGHT_INVERSE_UNIT[exponent]
    r = np.int64(min(red * unit + 0.5, 2047.0))
    g = np.int64(min(green * unit + 0.5, 2047.0))
    b = np.int64(min(blue * unit + 0.5, 2047.0))
    return r | (g << 11) | (b << 22) | (np.int64(exponent) << 33)


@part
def pack_shadow_weight(value):
    """A weight >= 0 as the upper 24 bits of its binary32 without the sign, rounded to nearest."""
    if not value > 0.0:
        return np.int64(0)
    bits = np.int64(np.float32(min(value, LARGEST_BINARY32)).view(np.uint32)) + 64
    return min(bits, np.int64(LARGEST_SHADOW_WEIGHT)) >> 7


@part
def write(buffer, at, value, size):
    """Put a whole number into `size` bytes, the least first."""
    for k in range(size):
        buffer[at + k] = np.uint8((value >> (8 * k)) & 0xFF)


@part
def put_ray(buffer, at, kind, depth, sample, origin, codes, weight):
    """Write a primary, reflected or refracted ray. `origin`: three lattice coordinates, `codes`: direction."""
    buffer[at] = np.uint8(kind | (depth << 3))
    write(buffer, at + 1, sample, 4)
    write(buffer, at + 5, origin[0], 3)
    write(buffer, at + 8, origin[1], 3)
    write(buffer, at + 11, origin[2], 3)
    write(buffer, at + 14, codes[0], 3)
    write(buffer, at + 17, codes[1], 3)
    write(buffer, at + 20, weight, 5)


@part
def put_shadow(buffer, at, depth, sample, origin, light, weights):
    """Write a shadow ray. `weights`: three floats, the intensity it adds if it reaches the light."""
    buffer[at] = np.uint8(SHADOW | (depth << 3))
    write(buffer, at + 1, sample, 4)
    write(buffer, at + 5, origin[0], 3)
    write(buffer, at + 8, origin[1], 3)
    write(buffer, at + 11, origin[2], 3)
    write(buffer, at + 14, light, 2)
    for k in range(3):
        write(buffer, at + 16 + 3 * k, pack_shadow_weight(weights[k]), 3)
