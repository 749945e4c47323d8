"""Packs what a ray's packet says: directions, weights, and the words that its bytes are (`node.protocol.packets` says which).

Rounding to the wire is defined here. A ray is rounded when it is spawned (law 4).
"""

from __future__ import annotations

import math

from raygrid.node.jit.formula import formula
from raygrid.node.jit.lanes import F32, F64, I32, I64, LATTICE_POINT, VECTOR, Lanes, Three, dot, least, most, within

HALF_DIRECTION = (1 << 23) - 1  # the code of component 0; codes run 0 .. 2 * HALF_DIRECTION
WEIGHT_BIAS = 63
TOO_LARGE_WEIGHT = 2.0**64
SHORTEST = 1e-140  # a vector this short or shorter has no direction: its square, and that one's root, must be numbers
LARGEST_BINARY32 = (2.0 - 2.0**-23) * 2.0**127
LARGEST_SHADOW_WEIGHT = 0x7F7FFF80  # bits of the largest weight that 24 bits hold
WORDS = (I64, I64, I64, I64)  # bytes 0-7, 8-15, 16-23 and 24 of a packet as numbers


@formula(takes=(F64, F64, F64), gives=(I64, I64))
def octahedral(x: Lanes, y: Lanes, z: Lanes) -> list[Lanes]:
    """The two direction codes of a vector (need not be a unit vector); one too short to have a direction goes along +z."""
    size = abs(x) + abs(y) + abs(z)
    scale = (size >= SHORTEST).choose(1.0 / size, 0.0)
    u, v = x * scale, y * scale
    one = u.every(1.0)
    folded = ((1.0 - abs(v)) * one.signed_as(u), (1.0 - abs(u)) * one.signed_as(v))
    codes = []
    for plain, other in zip((u, v), folded, strict=True):
        code = math.floor((z < 0.0).choose(other, plain) * float(HALF_DIRECTION) + 0.5)
        codes.append(within(code + float(HALF_DIRECTION), 0.0, 2.0 * HALF_DIRECTION).to(I32))
    return codes


@formula(takes=(I64, I64), gives=VECTOR)
def unit_vector(a: Lanes, b: Lanes) -> list[Lanes]:
    """The unit vector that two direction codes stand for."""
    u, v = ((code - HALF_DIRECTION).to(F64) * (1.0 / HALF_DIRECTION) for code in (a, b))
    z = 1.0 - abs(u) - abs(v)
    # of the lower half the folded ones; neither is ever -0
    x = (z < 0.0).choose((1.0 - abs(v)).signed_as(u), u)
    y = (z < 0.0).choose((1.0 - abs(u)).signed_as(v), v)
    scale = 1.0 / dot((x, y, z), (x, y, z)).root()
    return [x * scale, y * scale, z * scale]


@formula(takes=(F64, F64, F64), gives=I64)
def pack_weight(red: Lanes, green: Lanes, blue: Lanes) -> Lanes:
    """Three weights >= 0 as 40 bits. Below 2^-75 they become 0; at 2^64 and above the largest that fits."""
    largest = most(red, green, blue)
    e = (largest.bits() >> 52) - 1022 + WEIGHT_BIAS  # of binary64: f * 2^e with 0.5 <= f < 1
    e = (e < 0).choose(0, e)
    e = (largest < TOO_LARGE_WEIGHT).choose(e, 127)
    rounds_up = (largest * _inverse_unit(e) + 0.5 >= 2048.0).to(I64)
    e = e + (e < 127).choose(rounds_up, 0)
    unit = _inverse_unit(e)
    r, g, b = (least(one * unit + 0.5, unit.every(2047.0)).to(I32).to(I64) for one in (red, green, blue))
    return (largest > 0.0).choose(r | g << 11 | b << 22 | e << 33, 0)


def _inverse_unit(e: Lanes) -> Lanes:
    """2^(WEIGHT_BIAS + 11 - e): one over the unit of mantissas under this exponent."""
    return ((1023 + WEIGHT_BIAS + 11 - e) << 52).of_bits()


@formula(takes=(F64,), gives=I64)
def pack_shadow_weight(value: Lanes) -> Lanes:
    """A weight >= 0 as the upper 24 bits of its binary32 without the sign, rounded to nearest."""
    bits = least(value, value.every(LARGEST_BINARY32)).to(F32).bits().to(I64) + 64
    bits = least(bits, bits.every(LARGEST_SHADOW_WEIGHT))
    return (value > 0.0).choose(bits >> 7, 0)


@formula(takes=(I64, LATTICE_POINT, VECTOR, I64), gives=WORDS)
def ray_words(head: Lanes, origin: Three, direction: Three, weight: Lanes) -> list[Lanes]:
    """The words of a primary, reflected or refracted ray.

    head  its first five bytes; weight  as packed
    """
    a, b = (code.to(I64) for code in octahedral(*direction))
    return [*_front(head, origin, a & 0xFFFF), a >> 16 | b << 8 | weight << 32, weight >> 32]


@formula(takes=(I64, LATTICE_POINT, I64, VECTOR), gives=WORDS)
def shadow_words(head: Lanes, origin: Three, light: Lanes, weights: Three) -> list[Lanes]:
    """The words of a shadow ray; `head`: its first five bytes, `weights`: what it adds if it reaches the light."""
    red, green, blue = (pack_shadow_weight(one) for one in weights)
    return [*_front(head, origin, light), red | green << 24 | blue << 48, blue >> 16]


def _front(head: Lanes, origin: Three, two: Lanes) -> list[Lanes]:
    """The first two words: five bytes, the origin, and bytes 14 and 15 as one number."""
    x, y, z = (at.to(I64) for at in origin)
    return [head | x << 40, y | z << 24 | two << 48]
