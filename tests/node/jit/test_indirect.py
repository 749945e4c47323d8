"""Kernels called by their address: one caller for many, what they raise, and types that are not theirs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from raygrid.node.jit.decorators import lean
from raygrid.node.jit.indirect import OTHER_TYPES, Address, address_of, call_at


class Scaled(NamedTuple):
    """An array and a factor."""

    values: np.ndarray
    factor: float


@lean
def total(scaled, first, last):
    """Add values up, times the factor, rounded."""
    found = 0.0
    for k in range(first, last):
        found += scaled.values[k]
    return np.int64(found * scaled.factor)


@lean
def last_of(scaled, first, last):
    """Give the last value; raises for none."""
    if last <= first:
        raise ValueError("no value came")
    scaled.values[first] = -1.0
    return np.int64(scaled.values[last - 1])


@lean
def half_of(scaled, first, last):
    """Give no whole number."""
    return 0.5


@lean
def call_it(kernel, scaled, first, last):
    """Call a kernel of these arguments by its address."""
    return 1 + call_at(kernel, (scaled, first, last))


@pytest.fixture
def scaled() -> Scaled:
    return Scaled(np.arange(5.0), 2.0)


def test_one_caller_calls_whatever_is_at_the_address(scaled):
    by_name = [int(kernel(scaled, 1, 4)) for kernel in (total, last_of)]
    scaled.values[1] = 1.0
    compiled = len(call_it.signatures)
    found = [int(call_it(address_of(kernel, scaled, 0, 0), scaled, 1, 4)) for kernel in (total, last_of)]
    assert found == [1 + number for number in by_name] == [13, 4]
    assert scaled.values[1] == -1.0  # it is the same memory
    assert len(call_it.signatures) <= compiled + 1


def test_what_it_raises_is_raised(scaled):
    with pytest.raises(ValueError, match=r"^no value came$"):
        call_it(address_of(last_of, scaled, 0, 0), scaled, 3, 3)


def test_arguments_of_other_types_are_refused_before_the_call(scaled):
    address = address_of(total, scaled, 0, 0)
    for other in (Scaled(scaled.values.astype(np.float32), 2.0), Scaled(scaled.values[::2], 2.0)):
        with pytest.raises(TypeError, match=OTHER_TYPES):
            call_it(address, other, 0, 1)
    with pytest.raises(TypeError, match=OTHER_TYPES):
        call_it(Address(address.address, address.types + 1), scaled, 0, 1)


def test_a_kernel_that_gives_no_whole_number_has_no_address(scaled):
    with pytest.raises(TypeError, match=r"half_of gives float64, wanted int64"):
        address_of(half_of, scaled, 0, 0)
