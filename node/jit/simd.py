"""Writes arithmetic on eight numbers at once, for code that is given to LLVM as vectors (see `node.geometry.bvh_simd`).

An expression of `Lanes` is written like that of plain numbers and becomes the same operations in the same order, in
every lane; LLVM makes of eight lanes one, two or four registers, whatever the processor has. No comparison is a branch.
"""

# mypy: disallow-untyped-calls=False
# numba's helpers have no types

from __future__ import annotations

from copy import copy
from typing import TYPE_CHECKING, Any

from llvmlite import ir
from numba.core import cgutils

if TYPE_CHECKING:
    from raygrid.node.jit.code_types import BaseContext, IRBuilder, Value, Values


EIGHT = 8

_LONG, _INT = ir.IntType(64), ir.IntType(32)
_DOUBLE, _SINGLE = ir.DoubleType(), ir.FloatType()
_OF = {"float64": _DOUBLE, "float32": _SINGLE, "uint8": ir.IntType(8), "int32": _INT, "int64": _LONG}


class Lanes:
    """Eight numbers, or eight truths, of one type: binary64, binary32, int32 or int64. A plain number is in every lane.

    Bytes and binary32 are read and written, and little else; what is worked out with them is written out below.
    """

    def __init__(self, builder: IRBuilder, value: Value) -> None:
        self.builder, self.value = builder, value

    def _with(self, value: Value) -> Lanes:
        return Lanes(self.builder, value)

    def _same(self, other: Lanes | float) -> Value:
        return other.value if isinstance(other, Lanes) else ir.Constant(self.value.type, [other] * EIGHT)

    def _as(self, convert: str, kind: ir.Type) -> Lanes:
        return self._with(getattr(self.builder, convert)(self.value, ir.VectorType(kind, EIGHT)))

    def _do(self, of_floats: str, of_wholes: str, other: Lanes | float) -> Lanes:
        name = of_floats if self.value.type.element in (_DOUBLE, _SINGLE) else of_wholes
        return self._with(getattr(self.builder, name)(self.value, self._same(other)))

    def every(self, one: float) -> Lanes:
        """A number of this type in every lane."""
        return self._with(self._same(one))

    # --- arithmetic ----------------------------------------------------------------------------------

    def __add__(self, other: Lanes | float) -> Lanes:
        return self._do("fadd", "add", other)

    def __sub__(self, other: Lanes | float) -> Lanes:
        return self._do("fsub", "sub", other)

    def __rsub__(self, one: float) -> Lanes:
        return self.every(one) - self

    def __mul__(self, other: Lanes | float) -> Lanes:
        return self._do("fmul", "mul", other)

    def __truediv__(self, other: Lanes | float) -> Lanes:
        return self._with(self.builder.fdiv(self.value, self._same(other)))

    def __rtruediv__(self, one: float) -> Lanes:
        return self.every(one) / self

    def __neg__(self) -> Lanes:
        return self._with(self.builder.fneg(self.value))

    def __and__(self, other: Lanes | int) -> Lanes:
        return self._with(self.builder.and_(self.value, self._same(other)))

    def __or__(self, other: Lanes | int) -> Lanes:
        return self._with(self.builder.or_(self.value, self._same(other)))

    def __xor__(self, other: Lanes | int) -> Lanes:
        return self._with(self.builder.xor(self.value, self._same(other)))

    def __lshift__(self, places: Lanes | int) -> Lanes:
        return self._with(self.builder.shl(self.value, self._same(places)))

    def __rshift__(self, places: Lanes | int) -> Lanes:
        return self._with(self.builder.lshr(self.value, self._same(places)))

    def _call(self, name: str, *others: Lanes) -> Lanes:
        kind = self.value.type
        declared = ir.FunctionType(kind, [kind] * (1 + len(others)))
        function = cgutils.get_or_insert_function(self.builder.module, declared, f"llvm.{name}.v{EIGHT}f64")
        return self._with(self.builder.call(function, [self.value, *(other.value for other in others)]))

    def root(self) -> Lanes:
        """Square roots."""
        return self._call("sqrt")

    def __abs__(self) -> Lanes:
        return self._call("fabs")

    def __floor__(self) -> Lanes:
        return self._call("floor")

    def __ceil__(self) -> Lanes:
        return self._call("ceil")

    def __trunc__(self) -> Lanes:
        return self._call("trunc")

    def signed_as(self, other: Lanes) -> Lanes:
        """These sizes with the signs of others."""
        return self._call("copysign", other)

    # --- comparisons and choices ---------------------------------------------------------------------

    def _compared(self, operator: str, other: Lanes | float) -> Lanes:
        floats = self.value.type.element in (_DOUBLE, _SINGLE)
        compare = self.builder.fcmp_ordered if floats else self.builder.icmp_signed
        return self._with(compare(operator, self.value, self._same(other)))

    def __lt__(self, other: Lanes | float) -> Lanes:
        return self._compared("<", other)

    def __le__(self, other: Lanes | float) -> Lanes:
        return self._compared("<=", other)

    def __gt__(self, other: Lanes | float) -> Lanes:
        return self._compared(">", other)

    def __ge__(self, other: Lanes | float) -> Lanes:
        return self._compared(">=", other)

    def equals(self, other: Lanes | float) -> Lanes:
        """Compare for equality."""
        return self._compared("==", other)

    def choose(self, yes: Lanes | float, no: Lanes) -> Lanes:
        """Choose by truths: where they hold the one, elsewhere the other."""
        return self._with(self.builder.select(self.value, no._same(yes), no.value))

    def lacks(self, other: Lanes) -> Lanes:
        """Truths that hold where these do and the others do not."""
        return self._with(self.builder.and_(self.value, self.builder.not_(other.value)))

    def both(self, other: Lanes) -> Lanes:
        """Truths that hold where these and the others do."""
        return self._with(self.builder.and_(self.value, other.value))

    def either(self, other: Lanes) -> Lanes:
        """Truths that hold where these or the others do."""
        return self._with(self.builder.or_(self.value, other.value))

    def count(self) -> Value:
        """Count the truths that hold, one int64."""
        together = self.builder.bitcast(self.value, ir.IntType(EIGHT))
        return self.builder.zext(self.builder.ctpop(together), _LONG)

    def in_front(self, chosen: Lanes) -> Lanes:
        """Move the chosen int64 to the front, in order, and then anything; one instruction with AVX-512."""
        kind = self.value.type
        declared = ir.FunctionType(kind, [kind, chosen.value.type, kind])
        name = f"llvm.experimental.vector.compress.v{EIGHT}i64"
        compress = cgutils.get_or_insert_function(self.builder.module, declared, name)
        return self._with(self.builder.call(compress, [self.value, chosen.value, ir.Constant(kind, ir.Undefined)]))

    def as_int(self) -> Lanes:
        """Truths or bytes as int32, truths 1 where they hold, else 0."""
        return self._as("zext", _INT)

    # --- other types ---------------------------------------------------------------------------------

    def as_float(self) -> Lanes:
        """Whole numbers as binary64."""
        return self._as("sitofp", _DOUBLE)

    def as_whole(self) -> Lanes:
        """Numbers without their fractions, which must be small, as int32."""
        return self._as("fptosi", _INT)

    def as_number(self) -> Lanes:
        """Numbers without their fractions, as int64."""
        return self._as("fptosi", _LONG)

    def as_long(self) -> Lanes:
        """Whole numbers that are not negative, or truths, as int64."""
        return self._as("zext", _LONG)

    def lower_half(self) -> Lanes:
        """The lower halves of int64, as int32."""
        return self._as("trunc", _INT)

    def as_single(self) -> Lanes:
        """The nearest binary32."""
        return self._as("fptrunc", _SINGLE)

    def bits(self) -> Lanes:
        """The bits of binary64."""
        return self._as("bitcast", _LONG)

    def of_bits(self) -> Lanes:
        """The binary64 of these bits."""
        return self._as("bitcast", _DOUBLE)

    def bits_of_single(self) -> Lanes:
        """The bits of the nearest binary32, as int64."""
        return self.as_single()._as("bitcast", _INT).as_long()


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
    """Numbers, or the nearest to them from low to high; what is no number becomes the low one, as in `lattice.nearest`."""
    raised = (lanes > low).choose(lanes, lanes.every(low))  # so told, it is one instruction
    return (raised > high).choose(high, raised)


class Table:
    """Rows of `length` numbers of an array that is seen as flat, eight of each from place `at` of the first row on."""

    def __init__(
        self, context: BaseContext, builder: IRBuilder, kind: Any, array: Value, at: Value, length: int
    ) -> None:
        self._builder, self._at = builder, at
        self._data = context.make_array(kind)(context, builder, array).data
        self._vector = ir.VectorType(_OF[str(kind.dtype)], EIGHT)
        self._bytes, self._length = kind.dtype.bitwidth // 8, length

    def _place(self, row: int) -> Value:
        index = self._builder.add(self._at, ir.Constant(_LONG, row * self._length))
        return self._builder.bitcast(self._builder.gep(self._data, [index]), self._vector.as_pointer())

    def at(self, place: Value) -> Table:
        """This table from another place on."""
        other = copy(self)
        other._at = place
        return other

    def read(self, row: int) -> Lanes:
        """Eight numbers of a row."""
        return Lanes(self._builder, self._builder.load(self._place(row), align=self._bytes))

    def read_three(self, row: int) -> list[Lanes]:
        """Eight numbers each of three rows."""
        return [self.read(row + axis) for axis in range(3)]

    def write(self, row: int, lanes: Lanes) -> None:
        """Put eight numbers into a row."""
        self._builder.store(lanes.value, self._place(row), align=self._bytes)


def splat(builder: IRBuilder, value: Value) -> Lanes:
    """Put the same number into every lane."""
    kind = ir.VectorType(value.type, EIGHT)
    nothing = ir.Constant(kind, ir.Undefined)
    first = builder.insert_element(nothing, value, ir.Constant(_INT, 0))
    return Lanes(builder, builder.shuffle_vector(first, nothing, ir.Constant(ir.VectorType(_INT, EIGHT), [0] * EIGHT)))


def splats(builder: IRBuilder, values: Values) -> list[Lanes]:
    """Splat each number of a tuple."""
    return [splat(builder, value) for value in cgutils.unpack_tuple(builder, values)]
