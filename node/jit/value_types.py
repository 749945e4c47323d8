"""Tells the type that compiled code gives to a value of Python, and remembers types that were asked for.

numba works out the type of each array and each tuple anew whenever it meets a combination for the first time, names of nested
tuples and all: of a node's tables some 5 ms, in every node, and for arrays it imports `numpy.ma` first, to refuse what is
masked. Here a type is made once in a process and its forks. The types are numba's own (tests/node/jit/test_value_types.py).
"""

# mypy: disable-error-code="no-untyped-call"
# numba's helpers have no types

from __future__ import annotations

from typing import Any

import numpy as np
from numba import typeof
from numba.core import types
from numba.np import numpy_support

_ARRAYS: dict[tuple[Any, ...], Any] = {}
_TUPLES: dict[tuple[Any, ...], Any] = {}


def type_of(value: Any) -> Any:
    """The type of an argument, a `numba.types.Type`. Raises ValueError for what compiled code cannot take."""
    if type(value) is np.ndarray:
        return _type_of_array(value)
    if isinstance(value, tuple):
        return _type_of_tuple(value)
    return typeof(value)


def _type_of_array(array: np.ndarray[Any, Any]) -> Any:
    flags = array.flags
    key = (array.dtype, array.ndim, flags.c_contiguous, flags.f_contiguous, flags.writeable)
    found = _ARRAYS.get(key)
    if found is None:
        try:
            item = numpy_support.from_dtype(array.dtype)
        except Exception:  # whatever numba says of such arrays
            return typeof(array)
        found = types.Array(item, array.ndim, numpy_support.map_layout(array), readonly=not flags.writeable)
        _ARRAYS[key] = found
    return found


def _type_of_tuple(values: tuple[Any, ...]) -> Any:
    kinds = [type_of(value) for value in values]
    key = (type(values), *(kind._code for kind in kinds))  # numbers: to hash a type is to hash its name
    found = _TUPLES.get(key)
    if found is None:
        # it holds the types that it is made of, so their numbers stay theirs
        found = _TUPLES[key] = types.BaseTuple.from_types(kinds, type(values))
    return found
