"""Functions for kernels alone: no wrapper for Python is made of them, and Python may call them all the same."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
import pytest

from raygrid.node.jit.decorators import kernel, part, piece
from raygrid.node.jit.value_types import type_of

pytestmark = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="nothing is compiled")


class Scaled(NamedTuple):
    """An array and a factor."""

    values: np.ndarray
    factor: float


@part
def scaled_at(scaled, k):
    """Give a value times the factor; raises beyond the end."""
    if k >= len(scaled.values):
        raise IndexError("no such value")
    return scaled.values[k] * scaled.factor


@piece
def made_of(scaled):
    """Give all values times the factor."""
    made = np.empty(len(scaled.values))
    for k in range(len(made)):
        made[k] = scaled_at(scaled, k)
    return made


@kernel
def summed(scaled):
    """Add them up."""
    return made_of(scaled).sum()


SCALED = Scaled(np.arange(4.0), 3.0)


def test_kernels_call_them_and_python_has_no_wrapper_of_theirs():
    assert summed(SCALED) == 18.0
    for function, arguments in ((scaled_at, (SCALED, 0)), (made_of, (SCALED,)), (summed, (SCALED,))):
        kinds = tuple(map(type_of, arguments))
        function.compile(kinds)
        result = function.overloads[kinds]
        wrapper = result.library.get_pointer_to_function(result.fndesc.llvm_cpython_wrapper_name)
        assert bool(wrapper) == (function is summed)


@pytest.mark.parametrize("first", ["python", "kernel"])
def test_python_calls_them_whoever_called_first(first):
    one, other = (Scaled(np.arange(3, dtype=kind), 2.0) for kind in ("f4", "i4"))
    scaled = one if first == "python" else other
    if first == "kernel":
        assert summed(scaled) == 6.0
    for _ in range(2):
        assert scaled_at(scaled, 2) == 4.0
        assert scaled_at(scaled, k=1) == 2.0
        assert made_of(scaled).tolist() == [0.0, 2.0, 4.0]
        assert summed(scaled) == 6.0


def test_what_they_raise_comes_to_python():
    with pytest.raises(IndexError, match="no such value"):
        scaled_at(SCALED, 4)
