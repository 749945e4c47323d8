"""Gives formulas one interface to numbers: `Lanes` are one number, eight in a vector of LLVM, or numpy's.

A formula is written once, over `Lanes`, and runs in three ways (`node.jit.formula`): compiled for one number, compiled for
eight at once, and interpreted. The operations are the same IEEE ones in the same order, so are the bits. No comparison is a
branch: it gives truths, by which is chosen. A number that is the same for all, such as a plane of the cell, meets
eight others as it is, and so does a plain number of Python.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, TypeAlias

F64, F32, I64, I32, U8, BIT = "float64", "float32", "int64", "int32", "uint8", "bool"
FLOATS = (F64, F32)
EIGHT = 8  # numbers in a vector


class Lanes(ABC):
    """Numbers of one kind, or truths; `kind` is F64, F32, I64, I32, U8 or BIT."""

    kind: str

    # --- what a back end does ------------------------------------------------------------------------

    @abstractmethod
    def _do(self, operation: str, other: Number) -> Lanes:
        """Do add, sub, mul, div, and, or, xor, shl or shr (of bits) with another of the same kind."""

    @abstractmethod
    def _compare(self, operator: str, other: Number) -> Lanes:
        """Compare by <, <=, > , >= or ==; false for what is no number."""

    @abstractmethod
    def _call(self, name: str, *others: Lanes) -> Lanes:
        """Call sqrt, fabs, floor, ceil, trunc or copysign of binary64."""

    @abstractmethod
    def every(self, one: float) -> Lanes:
        """A number of this kind."""

    @abstractmethod
    def __neg__(self) -> Lanes: ...

    @abstractmethod
    def choose(self, yes: Number, no: Number) -> Lanes:
        """Choose by truths: where they hold the one, elsewhere the other. Two plain numbers must be whole: int64."""

    @abstractmethod
    def lacks(self, other: Lanes) -> Lanes:
        """Truths that hold where these do and the others do not."""

    @abstractmethod
    def to(self, kind: str) -> Lanes:
        """The same numbers in another kind: the nearest binary32; of whole numbers the lower half; a fraction is cut off
        what must be small enough; a truth is 1 or 0."""

    @abstractmethod
    def bits(self) -> Lanes:
        """The bits of binary64 as int64, of binary32 as int32."""

    @abstractmethod
    def of_bits(self) -> Lanes:
        """The binary64 of these bits."""

    @abstractmethod
    def lowest_bit(self) -> Lanes:
        """The place of the lowest bit that is set; of 0 the width of the kind."""

    # --- arithmetic ----------------------------------------------------------------------------------

    def __add__(self, other: Number) -> Lanes:
        return self._do("add", other)

    def __sub__(self, other: Number) -> Lanes:
        return self._do("sub", other)

    def __mul__(self, other: Number) -> Lanes:
        return self._do("mul", other)

    def __truediv__(self, other: Number) -> Lanes:
        return self._do("div", other)

    def __and__(self, other: Lanes | int) -> Lanes:
        return self._do("and", other)

    def __or__(self, other: Lanes | int) -> Lanes:
        return self._do("or", other)

    def __xor__(self, other: Lanes | int) -> Lanes:
        return self._do("xor", other)

    def __lshift__(self, places: Lanes | int) -> Lanes:
        return self._do("shl", places)

    def __rshift__(self, places: Lanes | int) -> Lanes:
        return self._do("shr", places)

    def __radd__(self, one: float) -> Lanes:
        return self.every(one) + self

    def __rsub__(self, one: float) -> Lanes:
        return self.every(one) - self

    def __rmul__(self, one: float) -> Lanes:
        return self.every(one) * self

    def __rtruediv__(self, one: float) -> Lanes:
        return self.every(one) / self

    def __abs__(self) -> Lanes:
        return self._call("fabs")

    def __floor__(self) -> Lanes:
        return self._call("floor")

    def __ceil__(self) -> Lanes:
        return self._call("ceil")

    def __trunc__(self) -> Lanes:
        return self._call("trunc")

    def root(self) -> Lanes:
        """Square roots."""
        return self._call("sqrt")

    def signed_as(self, other: Lanes) -> Lanes:
        """These sizes with the signs of others."""
        return self._call("copysign", other)

    # --- comparisons ---------------------------------------------------------------------------------

    def __lt__(self, other: Number) -> Lanes:
        return self._compare("<", other)

    def __le__(self, other: Number) -> Lanes:
        return self._compare("<=", other)

    def __gt__(self, other: Number) -> Lanes:
        return self._compare(">", other)

    def __ge__(self, other: Number) -> Lanes:
        return self._compare(">=", other)

    def equals(self, other: Number) -> Lanes:
        """Compare for equality."""
        return self._compare("==", other)

    def both(self, other: Lanes) -> Lanes:
        """Truths that hold where these and the others do."""
        return self & other

    def either(self, other: Lanes) -> Lanes:
        """Truths that hold where these or the others do."""
        return self | other


Number: TypeAlias = Lanes | float
Three: TypeAlias = Sequence[Lanes]  # the coordinates of a point or vector


class Memory(ABC):
    """An array that is seen as flat. What is at places is not checked when compiled, and is an IndexError interpreted."""

    @abstractmethod
    def one(self, place: Lanes | int) -> Lanes:
        """The number at a place, for all lanes."""

    @abstractmethod
    def read(self, place: Lanes | int) -> Lanes:
        """The numbers from a place on, one a lane."""

    @abstractmethod
    def write(self, place: Lanes | int, lanes: Lanes) -> None:
        """Put one number a lane to the places from this one on."""

    @abstractmethod
    def append(self, place: Lanes, lanes: Lanes, chosen: Lanes) -> Lanes:
        """Put the chosen int64 to the places from this one on, in order; returns how many, one int64. As many places as
        there are lanes are written over. One instruction with AVX-512."""

    @abstractmethod
    def numbered(self, place: Lanes) -> Lanes:
        """The places that `read` reads from there on."""


class Columns:
    """Rows of `length` numbers of an array, one column a ray: those from column `at` on, one a lane."""

    def __init__(self, memory: Memory, at: Lanes, length: int) -> None:
        self._memory, self._at, self._length = memory, at, length

    def read(self, row: int) -> Lanes:
        """The numbers of a row."""
        return self._memory.read(self._at + row * self._length)

    def three(self, row: int) -> list[Lanes]:
        """The numbers of three rows."""
        return [self.read(row + axis) for axis in range(3)]

    def write(self, row: int, lanes: Lanes) -> None:
        """Put the numbers of a row."""
        self._memory.write(self._at + row * self._length, lanes)


def least(first: Lanes, *others: Lanes) -> Lanes:
    """Lane by lane as Python's min."""
    for other in others:
        first = (other < first).choose(other, first)
    return first


def most(first: Lanes, *others: Lanes) -> Lanes:
    """Lane by lane as Python's max."""
    for other in others:
        first = (first < other).choose(other, first)
    return first


def within(lanes: Lanes, low: float, high: float) -> Lanes:
    """Numbers, or the nearest to them from low to high; what is no number becomes the low one."""
    raised = (lanes > low).choose(lanes, low)  # so told, it is one instruction
    return (raised > high).choose(high, raised)


def dot(a: Three, b: Three) -> Lanes:
    """The inner product of two vectors, x before y before z."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


# what formulas take and give: a kind, an array, or a tuple of these; a named tuple comes as one of its class
Declared: TypeAlias = Any
Staged: TypeAlias = Any  # what a formula is given of a named tuple: one of its class, of Lanes and Memory


class FlatArray:
    """Declares an array of one of the kinds, which a formula is given as `Memory`."""


ARRAY = FlatArray()
VECTOR = (F64, F64, F64)
LATTICE_POINT = (I64, I64, I64)


def mapped(function: Any, declared: Declared, *trees: Any) -> Any:
    """Call a function with each kind or array that is declared and what stands there in the trees; returns a tree."""
    if not isinstance(declared, tuple):
        return function(declared, *trees)
    parts = [mapped(function, *each) for each in zip(declared, *trees, strict=True)]
    return type(declared)(*parts) if hasattr(declared, "_fields") else tuple(parts)
