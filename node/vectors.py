"""Eight numbers at once in the words of arithmetic, for code that is given to LLVM as vectors (see `node.lanes`).

An expression of `Lanes` is written like that of plain numbers and becomes the same operations in the same order, in
every lane; LLVM makes of eight lanes one, two or four registers, whatever the processor has. No comparison is a branch.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import cgutils

EIGHT = 8

_LONG, _INT, _FLOAT = ir.IntType(64), ir.IntType(32), ir.DoubleType()
_OF = {"float64": _FLOAT, "int32": _INT, "int64": _LONG}


class Lanes:
    """Eight numbers, or eight truths, of one type."""

    def __init__(self, builder: Any, value: Any) -> None:
        self.builder, self.value = builder, value

    def _with(self, value: Any) -> Lanes:
        return Lanes(self.builder, value)

    def _same(self, other: Lanes | float) -> Any:
        """The value of other lanes, or of a constant in every lane."""
        return other.value if isinstance(other, Lanes) else ir.Constant(self.value.type, [other] * EIGHT)

    @property
    def _is_float(self) -> bool:
        return self.value.type.element == _FLOAT

    def __add__(self, other: Lanes | float) -> Lanes:
        return self._with(self.builder.fadd(self.value, self._same(other)))

    def __sub__(self, other: Lanes | float) -> Lanes:
        subtract = self.builder.fsub if self._is_float else self.builder.sub
        return self._with(subtract(self.value, self._same(other)))

    def __rsub__(self, one: float) -> Lanes:
        return self._with(self.builder.fsub(self._same(one), self.value))

    def __mul__(self, other: Lanes | float) -> Lanes:
        return self._with(self.builder.fmul(self.value, self._same(other)))

    def __or__(self, other: Lanes) -> Lanes:
        return self._with(self.builder.or_(self.value, other.value))

    def _compared(self, operator: str, other: Lanes | float) -> Lanes:
        compare = self.builder.fcmp_ordered if self._is_float else self.builder.icmp_signed
        return self._with(compare(operator, self.value, self._same(other)))

    def __lt__(self, other: Lanes | float) -> Lanes:
        return self._compared("<", other)

    def __le__(self, other: Lanes | float) -> Lanes:
        return self._compared("<=", other)

    def __ge__(self, other: Lanes | float) -> Lanes:
        return self._compared(">=", other)

    def under(self, one: float) -> Lanes:
        """A constant over these numbers."""
        return self._with(self.builder.fdiv(self._same(one), self.value))

    def equals(self, one: float) -> Lanes:
        """Whether these are this number."""
        return self._compared("==", one)

    def choose(self, yes: Lanes | float, no: Lanes) -> Lanes:
        """Of truths: where they hold the one, elsewhere the other."""
        return self._with(self.builder.select(self.value, no._same(yes), no.value))

    def choose_whole(self, yes: int, no: int | Lanes) -> Lanes:
        """Of truths: where they hold the one whole number, elsewhere the other."""
        kind = ir.VectorType(_LONG, EIGHT)
        other = no.value if isinstance(no, Lanes) else ir.Constant(kind, [no] * EIGHT)
        return self._with(self.builder.select(self.value, ir.Constant(kind, [yes] * EIGHT), other))

    def _call(self, name: str, *others: Lanes) -> Lanes:
        kind = self.value.type
        declared = ir.FunctionType(kind, [kind] * (1 + len(others)))
        function = cgutils.get_or_insert_function(self.builder.module, declared, f"llvm.{name}.v{EIGHT}f64")
        return self._with(self.builder.call(function, [self.value, *(other.value for other in others)]))

    def root(self) -> Lanes:
        """Square roots."""
        return self._call("sqrt")

    def size(self) -> Lanes:
        """Numbers without their signs."""
        return self._call("fabs")

    def signed_as(self, other: Lanes) -> Lanes:
        """These sizes with the signs of others."""
        return self._call("copysign", other)

    def as_float(self) -> Lanes:
        """Whole numbers as binary64."""
        return self._with(self.builder.sitofp(self.value, ir.VectorType(_FLOAT, EIGHT)))

    def bit(self, place: int) -> Lanes:
        """Of truths: a whole number with this bit where they hold."""
        kind = ir.VectorType(_INT, EIGHT)
        return self._with(self.builder.select(self.value, *(ir.Constant(kind, [n] * EIGHT) for n in (1 << place, 0))))

    def has_bit(self, place: Lanes) -> Lanes:
        """Whether these whole numbers have the bits of other whole numbers set."""
        one = ir.Constant(self.value.type, [1] * EIGHT)
        shifted = self.builder.and_(self.builder.lshr(self.value, place.value), one)
        return self._with(self.builder.icmp_unsigned("!=", shifted, ir.Constant(self.value.type, [0] * EIGHT)))

    def lacks(self, other: Lanes) -> Lanes:
        """Of truths: where these hold and the others do not."""
        return self._with(self.builder.and_(self.value, self.builder.not_(other.value)))


def least(a: Lanes, b: Lanes) -> Lanes:
    return (b < a).choose(b, a)


def most(a: Lanes, b: Lanes) -> Lanes:
    return (a < b).choose(b, a)


class Table:
    """Rows of `length` numbers, of which eight are seen from lane `at` on."""

    def __init__(self, context: Any, builder: Any, kind: Any, array: Any, at: Any, length: int) -> None:
        self._builder, self._at = builder, at
        self._data = context.make_array(kind)(context, builder, array).data
        self._vector = ir.VectorType(_OF[str(kind.dtype)], EIGHT)
        self._bytes, self._length = kind.dtype.bitwidth // 8, length

    def _place(self, row: int) -> Any:
        index = self._builder.add(self._at, ir.Constant(_LONG, row * self._length))
        return self._builder.bitcast(self._builder.gep(self._data, [index]), self._vector.as_pointer())

    def read(self, row: int) -> Lanes:
        return Lanes(self._builder, self._builder.load(self._place(row), align=self._bytes))

    def write(self, row: int, lanes: Lanes) -> None:
        self._builder.store(lanes.value, self._place(row), align=self._bytes)


def splat(builder: Any, value: Any) -> Lanes:
    """The same number in every lane."""
    kind = ir.VectorType(value.type, EIGHT)
    nothing = ir.Constant(kind, ir.Undefined)
    first = builder.insert_element(nothing, value, ir.Constant(_INT, 0))
    return Lanes(builder, builder.shuffle_vector(first, nothing, ir.Constant(ir.VectorType(_INT, EIGHT), [0] * EIGHT)))
