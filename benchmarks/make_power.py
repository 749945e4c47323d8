"""Works out the constants of node/geometry/power.py: python benchmarks/make_power.py

Exact fractions throughout, so that the same digits come out on every computer; a test makes them again and compares. The series
of the logarithm and of the exponential are written as sums of Chebyshev polynomials, and those of high degree are left
out: what remains is off by hardly more than the best polynomial of its degree (Lanczos' economisation).
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from math import isqrt

Polynomial = list[Fraction]  # the constant first

TERMS = 28  # of a series: what is left out is below 2^-120
LOG_DEGREE, EXP_DEGREE = 6, 10
LARGEST_Z = Fraction(59, 2000)  # ((sqrt 2 - 1) / (sqrt 2 + 1))^2 is 0.0294


def _times(a: Sequence[Fraction], b: Sequence[Fraction]) -> Polynomial:
    product = [Fraction(0)] * (len(a) + len(b) - 1)
    for i, left in enumerate(a):
        for j, right in enumerate(b):
            product[i + j] += left * right
    return product


def _plus(a: Sequence[Fraction], b: Sequence[Fraction]) -> Polynomial:
    size = max(len(a), len(b))
    padded = [[*one, *[Fraction(0)] * (size - len(one))] for one in (a, b)]
    return [left + right for left, right in zip(*padded, strict=True)]


def _of_line(polynomial: Sequence[Fraction], line: Sequence[Fraction]) -> Polynomial:
    """The polynomial of (line[0] + line[1] x), as one of x."""
    found = [Fraction(0)]
    for coefficient in reversed(polynomial):
        found = _plus(_times(found, line), [coefficient])
    return found[: len(polynomial)]


def economised(series: Sequence[Fraction], low: Fraction, high: Fraction, degree: int) -> tuple[Polynomial, Fraction]:
    """(the polynomial of this degree nearly best for a series between low and high, bound of what it is off by)."""
    rest = _of_line(series, [(low + high) / 2, (high - low) / 2])
    chebyshev = [[Fraction(1)], [Fraction(0), Fraction(1)]]
    while len(chebyshev) < len(rest):
        doubled = [Fraction(0), *[2 * c for c in chebyshev[-1]]]
        chebyshev.append(_plus(doubled, [-c for c in chebyshev[-2]]))
    kept, left_out = [Fraction(0)], Fraction(0)
    for k in reversed(range(len(rest))):
        share = rest[k] / chebyshev[k][k]
        part = [share * c for c in chebyshev[k]]
        rest = _plus(rest, [-c for c in part])[:k]
        if k <= degree:
            kept = _plus(kept, part)
        else:
            left_out += abs(share)
    return _of_line(kept, [-(low + high) / (high - low), 2 / (high - low)]), left_out


def _log_of_2() -> Fraction:
    """2 atanh(1/3)."""
    return 2 * sum((Fraction(1, (2 * k + 1) * 3 ** (2 * k + 1)) for k in range(60)), Fraction(0))


def _bits_of_sqrt_half() -> int:
    """The bits of sqrt(1/2) in binary64, rounded to nearest: its 53 digits below the exponent of 1/2."""
    twice = isqrt(2 * 4**53)  # sqrt(1/2) * 2^54
    return (1022 << 52) + ((twice + 1) >> 1) - (1 << 52)


def constants() -> dict[str, str | tuple[str, ...]]:
    """The constants by their names in power.py: hexadecimal digits, of polynomials the constant first."""
    scale = 2 / _log_of_2()
    logarithm = [scale / (2 * k + 3) for k in range(TERMS)]
    exponential, term = [], Fraction(1)
    for k in range(1, TERMS + 1):
        term *= _log_of_2() / k
        exponential.append(term)
    log_terms, _ = economised(logarithm, Fraction(0), LARGEST_Z, LOG_DEGREE)
    exp_terms, _ = economised(exponential, Fraction(-1, 2), Fraction(1, 2), EXP_DEGREE)
    return {
        "SQRT_HALF_BITS": hex(_bits_of_sqrt_half()),
        "LOG_SCALE": float(scale).hex(),
        "LOG_TERMS": tuple(float(c).hex() for c in log_terms),
        "EXP_TERMS": tuple(float(c).hex() for c in exp_terms),
    }


def main() -> None:
    """Print the constants."""
    for name, value in constants().items():
        print(f"{name}:", value if isinstance(value, str) else "\n    " + "\n    ".join(value))


if __name__ == "__main__":
    main()
