"""Numbers of a scene rounded correctly: against the C library's to a last bit, at exact values, and for huge angles."""

from __future__ import annotations

import math
from decimal import Context, Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from raygrid.node.geometry import rounded

ANGLES = st.one_of(st.floats(-10.0, 10.0), st.floats(-1e9, 1e9), st.integers(-7200, 7200).map(math.radians))
EXACT = Context(prec=80)
# angle -> (cosine, sine), to more digits than binary64 has; the first comes nearest of all to a multiple of pi / 2
KNOWN = {
    6381956970095103.0 * 2.0**797: ("-4.68716592425462761112E-19", "1"),
    1.0: ("0.540302305868139717400936607443", "0.841470984807896506652502321630"),
    1e22: ("0.523214785395138945497594", "-0.852200849767188801772705"),
}


def near(came: float, wanted: float, most: int = 1) -> bool:
    """Tell whether two numbers are the same or neighbours: the C library's are off by less than a last bit."""
    return abs(came - wanted) <= most * math.ulp(wanted)


@given(ANGLES)
def test_as_the_c_library_to_a_last_bit(angle):
    assert near(rounded.cos(angle), math.cos(angle))
    assert near(rounded.sin(angle), math.sin(angle))
    assert near(rounded.tan(angle), math.tan(angle))


@given(st.floats(-1.0, 1.0))
def test_arc_cosines_as_the_c_library_to_a_last_bit(cosine):
    assert near(rounded.acos(cosine), math.acos(cosine))


@given(st.floats(1e-6, 1e6), st.floats(-20.0, 20.0))
def test_powers_as_the_c_library_to_a_last_bit(base, exponent):
    assert near(rounded.power(base, exponent), math.pow(base, exponent))


@pytest.mark.parametrize(("angle", "wanted"), KNOWN.items())
def test_known_digits(angle, wanted):
    assert rounded.cos(angle) == float(wanted[0])
    assert rounded.sin(angle) == float(wanted[1])


@given(st.floats(-4.0, 4.0))
def test_squares_of_cosine_and_sine_make_1(angle):
    """What is rounded correctly is off by half of a last bit at most, so their squares by a last bit of 1 altogether."""
    cosine, sine = Decimal(rounded.cos(angle)), Decimal(rounded.sin(angle))
    assert abs(EXACT.add(cosine * cosine, sine * sine) - 1) <= Decimal(2.0**-52)


@given(st.floats(0.0, math.pi))
def test_arc_cosines_turn_cosines_back(angle):
    sine = max(math.sin(angle), 1e-8)
    assert abs(rounded.acos(rounded.cos(angle)) - angle) <= 2.0**-51 + 2.0**-53 / sine


@pytest.mark.parametrize("exponent", [0.5, 1.0, 2.0, 3.0, -1.0, 7.0])
def test_powers_that_are_known_exactly(exponent):
    for base in (0.25, 1.0, 4.0, 9.0, 0.0625, 1e10):
        exact = math.sqrt(base) if exponent == 0.5 else float(Decimal(base) ** int(exponent))
        assert rounded.power(base, exponent) == exact


def test_ends():
    assert (rounded.cos(0.0), rounded.sin(0.0), rounded.tan(0.0)) == (1.0, 0.0, 0.0)
    assert math.copysign(1.0, rounded.sin(-0.0)) == -1.0
    assert rounded.sin(5e-324) == 5e-324
    assert rounded.sin(math.pi) == 1.2246467991473532e-16  # what the number nearest to pi lacks
    assert (rounded.acos(1.0), rounded.acos(0.0), rounded.acos(-1.0)) == (0.0, math.pi / 2.0, math.pi)
    assert rounded.power(0.0, 2.4) == 0.0
    assert rounded.power(0.5, 0.0) == 1.0


@pytest.mark.parametrize("function", [rounded.cos, rounded.sin, rounded.tan, rounded.acos])
@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan])
def test_what_is_not_finite_is_refused(function, value):
    with pytest.raises(ValueError, match="wanted a"):
        function(value)


@pytest.mark.parametrize("arguments", [(-1.0, 2.0), (0.0, -1.0), (math.nan, 1.0), (2.0, math.inf), (2.0, 1e6)])
def test_powers_that_are_refused(arguments):
    with pytest.raises(ValueError, match="wanted a finite base above 0"):
        rounded.power(*arguments)


def test_a_cosine_beyond_1_is_refused():
    with pytest.raises(ValueError, match=r"a cosine is 1.5, wanted a number from -1 to 1"):
        rounded.acos(1.5)
