"""Raises numbers to powers, with the same bits on every computer.

The C library's `pow` picks its instructions by the processor, and its last bit is another with fused multiply-add than
without, so nodes on two computers could draw two pictures. Here a power is additions, subtractions, multiplications and
one division of binary64, which IEEE 754 rounds one way, and whole-number operations on its bits:

    x = 2^k m, sqrt(1/2) <= m < sqrt 2    from the bits of x
    s = (m - 1) / (m + 1), z = s^2        log2 m = 2 / ln 2 * (s + s^3 / 3 + s^5 / 5 + ...) = s (LOG_SCALE + z LOG_TERMS(z))
    t = y (k + log2 m) = n + f            n whole, -1/2 <= f <= 1/2
    x^y = 2^n 2^f                         2^f = 1 + f EXP_TERMS(f); 2^n is added to the exponent

The compiler may not fuse a multiplication with an addition: LLVM does so only with what carries the flag `contract`, or
for the intrinsics `fma` and `fmuladd`, and numba without fastmath makes none of them. A test looks at the code that is
made for processors that could.

The error is at most (3 + 5 |y log2 x|) 2^-53 of the result, and where the result is below 2^-1022 half of the least number
more. In units of 2^-53: m + 1, the division, LOG_SCALE, its sum, the product with s, the sum with k, the product with
y are off by 1 each, the terms by less than 0.3, so t by 7.3 |t| and 2^t by 5.0 |t|; f is exact; 2^f adds 1 for its sum,
1.7 for the product, and 0.1 for the terms left out. So a highlight of 2^-24, the least that a picture's sums tell from 0, is
right to 1.4e-14. A power of a number up to 1 is never above 1, and of one from 1 on never below (exponents above 0).

The constants are those of benchmarks/make_power.py.
"""

from __future__ import annotations

import math

import numpy as np

from raygrid.node.jit.decorators import part

EXPONENT = 52  # bits below it
BIAS = 1023
LEAST_NORMAL_BITS = 1 << EXPONENT
SQRT_HALF_BITS = 0x3FE6A09E667F3BCD
LIFT_TO_NORMAL, LIFTED = 2.0**54, 54
LARGEST, LEAST = 1024.0, -1075.0  # log2 of what is infinite, of what rounds to 0

LOG_SCALE = float.fromhex("0x1.71547652b82fep+1")  # 2 / ln 2
LOG_TERMS = (
    float.fromhex("0x1.ec709dc3a0401p-1"),
    float.fromhex("0x1.2776c50ef680fp-1"),
    float.fromhex("0x1.a61762b565631p-2"),
    float.fromhex("0x1.484b08fc7a3afp-2"),
    float.fromhex("0x1.0c9e9a21586fbp-2"),
    float.fromhex("0x1.c4fd0d01b6ec8p-3"),
    float.fromhex("0x1.aff7ce1eaca68p-3"),
)
EXP_TERMS = (
    float.fromhex("0x1.62e42fefa39efp-1"),
    float.fromhex("0x1.ebfbdff82c598p-3"),
    float.fromhex("0x1.c6b08d704a0c6p-5"),
    float.fromhex("0x1.3b2ab6fba1dd9p-7"),
    float.fromhex("0x1.5d87fe78a3f9bp-10"),
    float.fromhex("0x1.43091309701a7p-13"),
    float.fromhex("0x1.ffcbfc6da72aep-17"),
    float.fromhex("0x1.62bfd476c729fp-20"),
    float.fromhex("0x1.b524ebd0ad040p-24"),
    float.fromhex("0x1.e60640a3f3efbp-28"),
    float.fromhex("0x1.e9ec20ad87111p-32"),
)


@part
def _number(bits):
    """The binary64 number that has these bits, an int64."""
    return float(np.int64(bits).view(np.float64))


@part
def _log2(x):
    """The logarithm to base 2 of a finite number above 0, right to 6.3 * 2^-53 of itself; of 1, 0."""
    bits, whole = np.float64(x).view(np.int64), 0
    if bits < LEAST_NORMAL_BITS:
        bits, whole = np.float64(x * LIFT_TO_NORMAL).view(np.int64), -LIFTED
    k = (bits - SQRT_HALF_BITS) >> EXPONENT
    m = _number(bits - (k << EXPONENT))
    s = (m - 1.0) / (m + 1.0)
    z = s * s
    zz = z * z
    high = (LOG_TERMS[4] + LOG_TERMS[5] * z) + zz * LOG_TERMS[6]
    terms = (LOG_TERMS[0] + LOG_TERMS[1] * z) + zz * ((LOG_TERMS[2] + LOG_TERMS[3] * z) + zz * high)
    return float(k + whole) + s * (LOG_SCALE + z * terms)


@part
def _exp2(t):
    """2 to a power between LEAST and LARGEST."""
    n = math.floor(t + 0.5)
    f = t - float(n)
    ff = f * f
    low = (EXP_TERMS[0] + EXP_TERMS[1] * f) + ff * (EXP_TERMS[2] + EXP_TERMS[3] * f)
    middle = (EXP_TERMS[4] + EXP_TERMS[5] * f) + ff * (EXP_TERMS[6] + EXP_TERMS[7] * f)
    high = (EXP_TERMS[8] + EXP_TERMS[9] * f) + ff * EXP_TERMS[10]
    ffff = ff * ff
    scaled = 1.0 + f * (low + ffff * (middle + ffff * high))
    if n > -1022 and n < 1023:
        return _number(np.float64(scaled).view(np.int64) + (np.int64(n) << EXPONENT))
    part_of_n = n >> 1  # 2^n itself may be no number; the first product is exact, so there is one rounding
    rest = n - part_of_n
    return scaled * _number(np.int64(part_of_n + BIAS) << EXPONENT) * _number(np.int64(rest + BIAS) << EXPONENT)


@part
def _limit(x, y):
    """A power at the ends: of 0, of what is infinite or no number, or with such an exponent."""
    if x == 1.0 or y == 0.0:
        return 1.0
    if not (x >= 0.0 and (y < 0.0 or y > 0.0)):
        return np.nan
    return np.inf if (x > 1.0) == (y > 0.0) else 0.0


@part
def power(x, y):
    """x to the power y, binary64 both, as C says for x from 0 on: 1 if y is 0 or x is 1. Below 0 it is no number.

    -0 is 0. The module says how large the error is.
    """
    if not (x > 0.0 and x < np.inf and y > -np.inf and y < np.inf):
        return _limit(x, y)
    t = y * _log2(x)
    if t >= LARGEST:
        return np.inf
    return _exp2(t) if t > LEAST else 0.0
