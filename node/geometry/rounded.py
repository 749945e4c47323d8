"""Rounds sines, cosines, tangents, arc cosines and powers correctly, so that they have the same bits on every computer.

For the few numbers that a scene is made of: cameras, turns, cones of light, colours of materials. The C library's functions are
off by last bits, in another place on another processor. Here the exact value is worked out to some 60 digits more than
binary64 has, in whole numbers, and rounded once: no two computers differ, and it is the nearest number unless the exact
value lies within 2^-150 of itself of the middle between two. Some 45 microseconds a value, powers 120; kernels have
`node.geometry.power`.

Arguments and results are floats; angles are in radians.
"""

from __future__ import annotations

from decimal import Context, Decimal
from functools import cache
from math import isfinite, isqrt

BITS = (
    320  # of the fixed point, below 1: no angle of binary64 comes nearer than 2^-62 to a whole number of quarter turns
)
DIGITS = Context(prec=60, Emin=-(10**6), Emax=10**6)


def _arc_tangent_of_part(divisor: int, bits: int) -> int:
    """atan(1 / divisor) in units of 2^-bits, by its series."""
    power = (1 << bits) // divisor
    total, k = 0, 0
    while power:
        total += (-power if k & 1 else power) // (2 * k + 1)
        power //= divisor * divisor
        k += 1
    return total


@cache
def _quarter_turn(bits: int) -> int:
    """pi / 2 in units of 2^-bits, right to the last ten of them (Machin 1706)."""
    more = bits + 20
    return (8 * _arc_tangent_of_part(5, more) - 2 * _arc_tangent_of_part(239, more)) >> 20


def _cos_and_sin(angle: float) -> tuple[int, int]:
    """The cosine and the sine in units of 2^-BITS."""
    if not isfinite(angle):
        raise ValueError(f"an angle is {angle}, wanted a finite number")
    over, under = float(angle).as_integer_ratio()
    more = BITS + max(over.bit_length() - under.bit_length(), 0)  # digits of pi for each turn that is taken off
    exact = (over << more) // under
    quarters, rest = divmod(exact, _quarter_turn(more))
    x = rest >> (more - BITS)
    sums, term, k = [1 << BITS, 0], 1 << BITS, 0
    while term:
        k += 1
        term = term * x // (k << BITS)
        sums[k & 1] += -term if k & 2 else term
    cosine, sine = sums
    return ((cosine, sine), (-sine, cosine), (-cosine, -sine), (sine, -cosine))[quarters & 3]


def cos(angle: float) -> float:
    """The cosine. Raises ValueError for an angle that is not finite, as do the sine and the tangent."""
    return _cos_and_sin(angle)[0] / (1 << BITS)


def sin(angle: float) -> float:
    """The sine."""
    if abs(angle) < 2.0**-60:
        return angle  # it is less than half of a last bit off
    return _cos_and_sin(angle)[1] / (1 << BITS)


def tan(angle: float) -> float:
    """The tangent."""
    if abs(angle) < 2.0**-60:
        return angle
    cosine, sine = _cos_and_sin(angle)
    return sine / cosine


def acos(cosine: float) -> float:
    """The angle from 0 to pi that has a cosine. Raises ValueError for one that is not between -1 and 1."""
    if not -1.0 <= cosine <= 1.0:
        raise ValueError(f"a cosine is {cosine}, wanted a number from -1 to 1")
    over, under = float(cosine).as_integer_ratio()
    one = 1 << BITS
    if over == -under:
        return 2 * _quarter_turn(BITS) / one
    tangent, doublings = isqrt(((under - over) << 2 * BITS) // (under + over)), 1  # of half of the angle
    while 16 * tangent > one:
        tangent = (tangent << BITS) // (one + isqrt((one << BITS) + tangent * tangent))
        doublings += 1
    squared = tangent * tangent >> BITS
    total, power, k = 0, tangent, 0
    while power:
        total += (-power if k & 1 else power) // (2 * k + 1)
        power = power * squared >> BITS
        k += 1
    return (total << doublings) / one


def power(base: float, exponent: float) -> float:
    """A power of a finite number above 0, or 0 of 0. Raises ValueError for another base, and exponents from -1e6 down or 1e6 up."""
    if not (0.0 <= base < float("inf") and abs(exponent) < 1e6) or (base == 0.0 and exponent <= 0.0):
        raise ValueError(
            f"{base} to the power {exponent} came, wanted a finite base above 0 and an exponent between -1e6 and 1e6"
        )
    if base == 0.0:
        return 0.0
    return float(DIGITS.exp(DIGITS.multiply(DIGITS.ln(Decimal(base)), Decimal(exponent))))
