"""Records of 64-bit whole numbers that Python and compiled code share: attributes here, fields of an array's records there.

A field of a record costs compiled code what a place in an array of int64 costs. In Python an attribute of a ctypes
structure is a plain int and costs what a place in a memoryview costs; a field of a numpy record costs ten times as much.
"""

from __future__ import annotations

import ctypes
import inspect
from typing import Any, ClassVar, Self, TypeVar

import numpy as np
from numba.core import config as _config
from numpy.typing import NDArray

config: Any = _config  # its names are made at run time

Rows = NDArray[np.void]  # records as compiled code takes them: `rows[k].field`


class Record(ctypes.Structure):
    """The base of what `record` declares.

    dtype  of an array of such records; one object, since numba tells arrays apart by it
    """

    dtype: ClassVar[np.dtype[np.void]]

    @classmethod
    def rows(cls, count: int = 1) -> Rows:
        """Records for compiled code, (count,), all fields zero."""
        return np.zeros(count, cls.dtype)

    @classmethod
    def view(cls, rows: Rows, row: int = 0) -> Self:
        """One of these records as Python reads and writes it: the same memory."""
        return cls.from_buffer(rows.data, row * cls.dtype.itemsize)

    def take(self, other: Self) -> None:
        """Take over the numbers of another record."""
        ctypes.memmove(ctypes.addressof(self), ctypes.addressof(other), ctypes.sizeof(self))

    def numbers(self) -> list[int]:
        """The fields in their order."""
        return [getattr(self, declared[0]) for declared in self._fields_]


AnyRecord = TypeVar("AnyRecord", bound=Record)


def record(declared: type[AnyRecord]) -> type[AnyRecord]:
    """Make the annotated names of a class its fields, int64 each, in this order."""
    declared._fields_ = [(name, ctypes.c_int64) for name in inspect.get_annotations(declared)]
    declared.dtype = with_attributes(np.dtype(declared))
    return declared


def with_attributes(dtype: np.dtype[np.void]) -> np.dtype[np.void]:
    """A type of records of which kernels name fields as attributes, `rows[k].field`."""
    # without a compiler kernels are Python, in which numpy's own records alone have such attributes
    return np.dtype((np.record, dtype)) if config.DISABLE_JIT else dtype
