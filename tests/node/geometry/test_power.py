"""Powers: the same bits interpreted, compiled, and for processors with and without fused multiply-add; the bound of the error."""

from __future__ import annotations

import hashlib
import json
import math
import os
import platform
import struct
import subprocess
import sys
from decimal import Context, Decimal
from types import FunctionType

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from support import paths

from raygrid.node.geometry import power as module
from raygrid.node.jit.decorators import kernel

sys.path.insert(0, str(paths.ROOT / "benchmarks"))

import make_power

F64 = NDArray[np.float64]
INFINITE = math.inf
LEAST = 5e-324
LARGEST = sys.float_info.max
NORMAL = sys.float_info.min
UNIT = 2.0**-53
EXACT = Context(prec=60, Emin=-(10**9), Emax=10**9)
# Results as they must come out everywhere. Changed only with the constants or the order of operations, and then every picture is.
KNOWN = {
    (0.5, 50.0): "0x1.0000000000000p-50",
    (0.9, 37.5): "0x1.3b25caf9cb5a0p-6",
    (0.999999, 1e6): "0x1.78b5570a90a48p-2",
    (0.1, 0.3): "0x1.009b9cf334253p-1",
    (1.0 - 2.0**-53, 1e6): "0x1.ffffffff0bdc0p-1",
    (1.0 + 2.0**-52, 1e6): "0x1.00000000f4240p+0",
    (0.7071067811865475, 3.0): "0x1.6a09e667f3bcap-2",
    (0.7071067811865476, 3.0): "0x1.6a09e667f3bcep-2",
    (3.7, 11.3): "0x1.4194938155420p+21",
    (LEAST, 0.01): "0x1.328df6e1fea76p-11",
    (0.3, 612.5): "0x0.0000000000450p-1022",
    (1e300, -1.05): "0x0.000000c1069cdp-1022",
}
EACH = """
import hashlib, json, sys
import numpy as np
from numba import float64, njit, void
from raygrid.node.geometry.power import power

def each(x, y, found):
    for k in range(len(x)):
        found[k] = power(x[k], y[k])

def sums(x, y, found):
    for k in range(len(x)):
        found[k] = x[k] * y[k] + found[k]

def fused(function):
    code = "".join(function.inspect_asm().values())
    return sum(code.count(name) for name in ("fmadd", "fmsub", "fmla", "fmls"))

kind = void(*[float64[::1]] * 3)
each, sums = njit(kind, error_model="numpy")(each), njit(kind, fastmath=True)(sums)
text = "".join(each.inspect_llvm().values())
unwanted = ("contract", "fast ", "llvm.fma", "llvm.fmuladd", "@pow(", "llvm.pow", "@exp2", "llvm.exp2", "llvm.log2")
told = {
    "fused": fused(each),
    "fused if it may be": fused(sums),
    "flags": [word for word in unwanted if word in text],
}
if sys.argv[1] == "run":
    generator = np.random.default_rng(11)
    x = np.concatenate((generator.random(20000), 2.0 ** generator.integers(-1074, 1023, 5000)))
    y = np.concatenate((generator.random(20000) * 1e3, generator.random(5000) * 8.0 - 4.0))
    found = np.empty(len(x))
    each(x, y, found)
    told["bits"] = hashlib.sha256(found.tobytes()).hexdigest()
print(json.dumps(told))
"""


@kernel
def _power_each(x, y, found):
    for k in range(len(x)):
        found[k] = module.power(x[k], y[k])


def compiled(x: object, y: object) -> F64:
    """The powers of two arrays, by compiled code."""
    bases, exponents = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
    found = np.empty(bases.size)
    _power_each(bases.ravel().copy(), exponents.ravel().copy(), found)
    return found.reshape(bases.shape)


def interpreted(x: float, y: float) -> float:
    """A power by the text of the module, run as plain Python."""
    space = dict(vars(module))
    for name in ("_number", "_log2", "_exp2", "_limit", "power"):
        function = space[name]
        space[name] = FunctionType(getattr(function, "py_func", function).__code__, space)
    return float(space["power"](x, y))


def bits(value: float) -> bytes:
    return struct.pack("<d", value)


def doublings(x: float, y: float) -> Decimal:
    """y log2 x, to 50 digits and more."""
    return EXACT.divide(EXACT.multiply(EXACT.ln(Decimal(x)), Decimal(y)), EXACT.ln(Decimal(2)))


def exactly(x: float, y: float) -> Decimal:
    """A power, to 50 digits and more."""
    return EXACT.exp(EXACT.multiply(EXACT.ln(Decimal(x)), Decimal(y)))


def off(x: float, y: float, came: float) -> Decimal:
    """How far a power is off, in parts of what the module allows: at most 1."""
    t = doublings(x, y)
    allowed = (3 + 5 * abs(t)) * Decimal(UNIT)
    if came == INFINITE:
        return (1024 - t) / (2 * allowed)
    if came == 0.0:
        return (t + 1075) / (2 * allowed)
    if abs(t) > 1100:
        return Decimal(INFINITE)
    wanted = exactly(x, y)
    slack = Decimal(LEAST) / 2 if came < NORMAL else Decimal(0)
    return abs(Decimal(came) - wanted) / (wanted * allowed + slack)


def test_the_constants_are_those_that_exact_arithmetic_makes():
    made = make_power.constants()
    assert hex(module.SQRT_HALF_BITS) == made["SQRT_HALF_BITS"]
    assert module.LOG_SCALE.hex() == made["LOG_SCALE"]
    assert tuple(term.hex() for term in module.LOG_TERMS) == made["LOG_TERMS"]
    assert tuple(term.hex() for term in module.EXP_TERMS) == made["EXP_TERMS"]


@pytest.mark.parametrize(("arguments", "wanted"), KNOWN.items(), ids=str)
def test_known_bits(arguments, wanted):
    assert interpreted(*arguments).hex() == wanted
    assert float(compiled(*arguments)).hex() == wanted


NUMBERS = st.one_of(
    st.floats(0.0, 1.0), st.floats(0.0, 2.0), st.floats(), st.sampled_from((0.0, -0.0, 1.0, LEAST, NORMAL, LARGEST))
)
EXPONENTS = st.one_of(st.floats(0.0, 1000.0), st.floats(-4.0, 4.0), st.floats(0.0, 1e6), st.floats())


@settings(max_examples=3000, deadline=None)
@given(NUMBERS, EXPONENTS)
@example(1.0, math.nan)
@example(math.nan, 0.0)
@example(LEAST, -1.0)
@example(2.0, -1074.5)
@example(2.0, -1022.0)
@example(2.0, 1023.99999999999989)
def test_compiled_code_gives_the_bits_of_the_interpreted_text(x, y):
    assert bits(interpreted(x, y)) == bits(float(compiled(x, y))) or math.isnan(interpreted(x, y))


@settings(max_examples=3000, deadline=None)
@given(
    st.one_of(st.floats(LEAST, 1.0), st.floats(LEAST, LARGEST), st.floats(0.999, 1.001)),
    st.one_of(st.floats(0.0, 1e6), st.floats(-1100.0, 1100.0), st.floats(-2.0, 2.0)),
)
@example(LEAST, 1.0)
@example(LARGEST, 1.0)
@example(1.0 - UNIT, 1e6)
@example(1.0 + 2 * UNIT, 1e300)
def test_the_error_is_within_the_bound(x, y):
    assert off(x, y, float(compiled(x, y))) <= 1


def test_errors_of_many_highlights():
    """Where pictures have their highlights: bases up to 1, shines that files have, results down to 2^-24."""
    generator = np.random.default_rng(3)
    shines = 10.0 ** generator.uniform(0.0, 6.0, 4000)
    bases = np.exp2(-24.0 * generator.random(4000) / shines)
    found = compiled(bases, shines)
    errors = [
        abs(Decimal(float(z)) / exactly(float(x), float(y)) - 1) for x, y, z in zip(bases, shines, found, strict=True)
    ]
    assert max(errors) < Decimal("1.4e-14")


def test_as_near_to_the_c_library_as_both_allow():
    generator = np.random.default_rng(4)
    bases, exponents = generator.random(100_000), 10.0 ** generator.uniform(-1.0, 3.0, 100_000)
    theirs = np.array([math.pow(x, y) for x, y in zip(bases.tolist(), exponents.tolist(), strict=True)])
    normal = theirs >= NORMAL
    doubled = np.abs(np.log2(bases) * exponents)[normal]
    ours = compiled(bases, exponents)[normal]
    assert (np.abs(ours / theirs[normal] - 1.0) <= (5.0 + 5.0 * doubled) * UNIT).all()


@pytest.mark.parametrize("x", [0.0, -0.0, LEAST, 0.3, 1.0, 2.5, LARGEST, INFINITE])
@pytest.mark.parametrize("y", [0.0, -0.0, LEAST, 0.5, 1.0, 30.0, 1e6, LARGEST, INFINITE, -0.5, -1.0, -1e6, -INFINITE])
def test_the_ends_are_those_of_c(x, y):
    try:
        wanted = math.pow(abs(x), y)
    except (OverflowError, ValueError):
        wanted = INFINITE
    came = interpreted(x, y)
    assert bits(came) == bits(float(compiled(x, y)))
    if wanted in (0.0, 1.0, INFINITE):
        assert came == wanted
    else:
        assert off(x, y, came) <= 1


@pytest.mark.parametrize(
    "arguments", [(-1.0, 2.0), (-INFINITE, 0.5), (math.nan, 1.0), (0.5, math.nan), (0.0, math.nan)]
)
def test_what_is_no_number(arguments):
    assert math.isnan(interpreted(*arguments))
    assert math.isnan(float(compiled(*arguments)))


def test_to_the_power_0_and_of_1_all_is_1():
    every = [0.0, LEAST, 0.3, 1.0, 7.0, LARGEST, INFINITE, math.nan, -3.0]
    assert (compiled(every, 0.0) == 1.0).all()
    assert (compiled(1.0, every) == 1.0).all()


@pytest.mark.parametrize("exponent", [1.0, 2.0, 5.0, 27.4, 50.0, 1000.0, 1e5, 1e6])
def test_highlights_grow_towards_their_middle(exponent):
    """Step by step of 2^-24 of the base they never fall, and they stay between 0 and 1, last steps before 1 as well."""
    bases = np.concatenate((np.arange(0, (1 << 24) + 1, 61) / 2.0**24, 1.0 - np.arange(4096)[::-1] / 2.0**24))
    found = compiled(np.sort(bases), exponent)
    assert (np.diff(found) >= 0.0).all()
    assert found[0] == 0.0
    assert found[-1] == 1.0


def test_neighbours_never_fall_by_more_than_the_error():
    """From one number to the next a power may fall by last bits, at the seams of the two polynomials as well."""
    seams = [math.sqrt(0.5), 1.0, 2.0**-0.01, 0.5]
    for seam in seams:
        bases = seam + np.arange(-2000, 2000) * np.spacing(seam)
        for exponent in (1.0, 30.0, 50.0, 100.0):
            found = compiled(bases, exponent)
            assert (np.diff(found) >= -8.0 * UNIT * found[1:]).all()


def test_up_to_1_never_above_1_and_from_1_on_never_below():
    near = np.arange(1, 5000) * UNIT
    exponents = 10.0 ** np.linspace(-3.0, 6.0, 40)[:, None]
    assert (compiled(1.0 - near, exponents) <= 1.0).all()
    assert (compiled(1.0 + 2 * near, exponents) >= 1.0).all()
    generator = np.random.default_rng(5)
    assert (compiled(generator.random(100_000), 10.0 ** generator.uniform(-3, 6, 100_000)) <= 1.0).all()


def run_each(task: str, **variables: str) -> dict[str, object]:
    """Compile a loop of powers for some processor in a process of its own: the code, and the digest of the bits if it is run."""
    environment = os.environ | {"NUMBA_DISABLE_JIT": "0"} | variables  # also where this process has no compiler
    done = subprocess.run(
        [sys.executable, "-c", EACH, task], env=environment, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    found: dict[str, object] = json.loads(done.stdout)
    return found


def test_the_same_bits_for_this_processor_for_the_plainest_and_without_a_compiler():
    generator = np.random.default_rng(11)
    x = np.concatenate((generator.random(20000), 2.0 ** generator.integers(-1074, 1023, 5000)))
    y = np.concatenate((generator.random(20000) * 1e3, generator.random(5000) * 8.0 - 4.0))
    by_hand = np.array([interpreted(a, b) for a, b in zip(x.tolist(), y.tolist(), strict=True)])
    digest = hashlib.sha256(by_hand.tobytes()).hexdigest()
    for made in (run_each("run"), run_each("run", NUMBA_CPU_NAME="generic", NUMBA_CPU_FEATURES="")):
        assert made["flags"] == []
        assert made["bits"] == digest


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="names processors of one family")
@pytest.mark.parametrize("processor", ["haswell", "skylake-avx512", "znver3"])
def test_no_multiplication_is_fused_with_an_addition_where_a_processor_could(processor):
    """Looked at, not run: the code for processors with fused multiply-add, which that of a fast-math sum does use."""
    made = run_each("look", NUMBA_CPU_NAME=processor, NUMBA_CPU_FEATURES="+fma,+avx2")
    assert made["fused if it may be"] > 0
    assert made["fused"] == 0
    assert made["flags"] == []
