"""Types of values as numba gives them, each made once."""

from __future__ import annotations

import re
from typing import NamedTuple

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from raygrid.node.jit.decorators import lean
from raygrid.node.jit.value_types import type_of

RECORD = np.dtype([("first", np.int64), ("second", np.float32, (3,))])


class Pair(NamedTuple):
    """An array and what lies in it."""

    values: object
    more: object


def _views(array: np.ndarray) -> list[np.ndarray]:
    """An array as it is, turned round, with gaps, and without leave to write."""
    locked = array.view()
    locked.flags.writeable = False
    return [array, array.T, array[::2], array[..., :0], locked]


DTYPES = st.sampled_from([np.float64, np.float32, np.int64, np.uint8, np.bool_, np.complex128]).map(np.dtype)
ARRAYS = st.builds(
    np.zeros, arrays.array_shapes(min_dims=1, max_dims=4, min_side=1, max_side=3), DTYPES | st.just(RECORD)
).flatmap(lambda array: st.sampled_from(_views(array)))
LEAVES = ARRAYS | st.integers(-5, 1 << 40) | st.floats() | st.booleans() | st.just(np.float32(1.0)) | st.none()
VALUES = st.recursive(
    LEAVES, lambda inner: st.lists(inner, max_size=4).map(tuple) | st.builds(Pair, inner, inner), max_leaves=8
)


@given(VALUES)
def test_types_are_those_of_numba(value):
    found = type_of(value)
    assert found == numba.typeof(value)
    assert type_of(value) is found


def test_tuples_of_other_classes_are_of_other_types():
    class Other(NamedTuple):
        values: object
        more: object

    values = (np.zeros(2), 1)
    found = [type_of(made) for made in (values, Pair(*values), Other(*values))]
    assert found == [numba.typeof(made) for made in (values, Pair(*values), Other(*values))]
    assert len(set(found)) == 3


@pytest.mark.parametrize(
    "value", [np.zeros(2, "O,i4"), np.ma.masked_array([1, 2]), object()], ids=["objects", "masked", "object"]
)
def test_what_has_no_type_is_told_by_numba(value):
    with pytest.raises((ValueError, numba.TypingError)) as by_numba:
        numba.typeof(value)
    with pytest.raises(type(by_numba.value), match=re.escape(str(by_numba.value))):
        type_of(value)


@lean
def first_of(values):
    """Give the first value."""
    return values[0]


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_a_kernel_says_what_it_cannot_take():
    with pytest.raises(numba.TypingError, match="Cannot determine Numba type"):
        first_of(object())
