"""Powers in programs: each way of writing one becomes the safe power, and what is none stays."""

from __future__ import annotations

import ast
import math

import numpy as np
import pytest

from raygrid.node.geometry.power import power
from raygrid.node.jit.decorators import kernel
from raygrid.node.programs.powers import NAME, any_power, with_safe_powers


@kernel
def _each(x, y, found):
    for k in range(len(x)):
        found[k] = any_power(x[k], y[k])


@kernel
def _safe(x, y, found):
    for k in range(len(x)):
        found[k] = power(x[k], y[k])


def compiled(function, x, y):
    with_safe_powers("", {})  # makes numba know the power
    found = np.empty(len(x))
    function(np.asarray(x), np.asarray(y), found)
    return found


def body(source):
    """The last line of a program, as it becomes."""
    return ast.unparse(with_safe_powers(source, {}).body[-1])


@pytest.mark.parametrize(
    ("source", "wanted"),
    [
        ("a = x ** y", f"a = {NAME}(x, y)"),
        ("a = x ** 2.4", f"a = {NAME}(x, 2.4)"),
        ("a = -x ** (y ** z)", f"a = -{NAME}(x, {NAME}(y, z))"),
        ("x **= y", f"x = {NAME}(x, y)"),
        ("a = pow(x, y)", f"a = {NAME}(x, y)"),
        ("import math\na = math.pow(x, y)", f"a = {NAME}(x, y)"),
        ("import math as m\na = m.pow(x, 2)", f"a = {NAME}(x, 2)"),
        ("from math import pow\na = pow(x, y)", f"a = {NAME}(x, y)"),
        ("from math import pow as p\na = p(x, y)", f"a = {NAME}(x, y)"),
        ("import numpy as np\na = np.power(x, y)", f"a = {NAME}(x, y)"),
        ("import numpy\na = numpy.float_power(x, y)", f"a = {NAME}(x, y)"),
        ("a = x ** 4", "a = x ** 4"),
        ("a = x ** -2", "a = x ** (-2)"),
        ("x **= 3", "x **= 3"),
        ("import math\na = math.sqrt(x)", "a = math.sqrt(x)"),
        ("def pow(x, y):\n    return x\na = pow(x, y)", "a = pow(x, y)"),
        ("from math import sqrt as pow\na = pow(x)", "a = pow(x)"),
        ("pow = 2.0\na = pow + 1.0", "a = pow + 1.0"),
        ("def tint(point, pow):\n    return pow\na = tint", "a = tint"),
        ("def tint(pow):\n    return pow\na = pow(x, y)", f"a = {NAME}(x, y)"),
        ("from math import pow\ndef tint(x):\n    pow = x\n    return pow\na = pow(x, y)", f"a = {NAME}(x, y)"),
        ("def f(pow, x=pow(y, z)):\n    return pow(x)", f"def f(pow, x={NAME}(y, z)):\n    return pow(x)"),
        ("a = lambda pow: pow(x)", "a = lambda pow: pow(x)"),
        (
            "def f(x):\n    def g(y):\n        return pow(x, y)\n    return g",
            f"def f(x):\n\n    def g(y):\n        return {NAME}(x, y)\n    return g",
        ),
    ],
)
def test_what_a_line_becomes(source, wanted):
    came = body(source)
    assert came == ast.unparse(ast.parse(wanted))


def test_what_a_program_works_out_when_its_text_is_run_has_the_same_bits():
    """numba makes a constant of it, so the C library must not have a say."""
    space = {}
    exec(compile(with_safe_powers("import math\nfound = math.pow(2.0, 0.5)", space), "text", "exec"), space)
    assert space["found"] == power(2.0, 0.5) != math.sqrt(2.0)
    assert any_power(2, 10) == 1024
    assert any_power(np.array([2.0, -2.0]), 3.0).tolist() == [power(2.0, 3.0), -power(2.0, 3.0)]
    assert any_power(np.array([[2], [3]]), np.array([0.5, 2.5])).tolist() == [
        [power(x, y) for y in (0.5, 2.5)] for x in (2.0, 3.0)
    ]
    assert any_power(np.zeros((0, 2)), 0.5).shape == (0, 2)


def test_compiled_powers_have_the_safe_bits():
    generator = np.random.default_rng(8)
    x, y = generator.random(5000) * 2.0, generator.random(5000) * 100.0 - 20.0
    assert compiled(_each, x, y).tobytes() == compiled(_safe, x, y).tobytes()


def test_powers_of_numbers_below_0_are_those_of_c():
    x = np.array([-2.0, -2.0, -2.0, -2.0, -0.5, -3.0])
    y = np.array([3.0, 2.0, -1.0, 0.5, 1e17, 0.0])
    np.testing.assert_array_equal(compiled(_each, x, y), [-8.0, 4.0, -0.5, np.nan, 0.0, 1.0])


def test_integer_exponents_are_multiplications():
    x, y = np.array([1.1, -3.0, 2.0]), np.array([7, 3, -2])
    np.testing.assert_allclose(compiled(_each, x, y), [1.1**7, -27.0, 0.25], rtol=1e-15)
