"""Compiles formulas: `Lanes` are code of LLVM, of one number or of a vector of eight.

LLVM makes of eight lanes one, two or four registers, whatever the processor has. What it makes of a loop over eight numbers
changes with every line around it, so it is given vectors. Pointers have no types here: LLVM has none any more.
"""

# mypy: disallow-untyped-calls=False
# numba's helpers have no types

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import cgutils, types

from raygrid.node.jit.intrinsics import element
from raygrid.node.jit.lanes import (
    BIT,
    EIGHT,
    F32,
    F64,
    FLOATS,
    I32,
    I64,
    U8,
    Declared,
    FlatArray,
    Lanes,
    Memory,
    Number,
)

_TYPES = {F64: ir.DoubleType(), F32: ir.FloatType(), I64: ir.IntType(64), I32: ir.IntType(32), U8: ir.IntType(8)}
_TYPES[BIT] = ir.IntType(1)
_OF_FLOATS = {"add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv"}
_OF_WHOLES = {"and": "and_", "or": "or_", "shr": "lshr"}
_CAST = {
    **{(narrow, wide): "zext" for narrow in (BIT, U8) for wide in (I32, I64)},
    **{(whole, single): "sitofp" for whole in (I32, I64) for single in FLOATS},
    **{(single, whole): "fptosi" for whole in (I32, I64) for single in FLOATS},
    (I32, I64): "sext",
    (I64, I32): "trunc",
    (F64, F32): "fptrunc",
    (F32, F64): "fpext",
}
_BITS_OF = {F64: I64, F32: I32}


class LlvmLanes(Lanes):
    """A value of LLVM: a number, or a vector of eight."""

    def __init__(self, builder: ir.IRBuilder, value: ir.Value, kind: str) -> None:
        self.builder, self.value, self.kind = builder, value, kind

    @property
    def is_wide(self) -> bool:
        """Tell whether this is a vector."""
        return isinstance(self.value.type, ir.VectorType)

    def _of(self, value: ir.Value, kind: str | None = None) -> LlvmLanes:
        return LlvmLanes(self.builder, value, kind or self.kind)

    def _type(self, kind: str) -> ir.Type:
        return ir.VectorType(_TYPES[kind], EIGHT) if self.is_wide else _TYPES[kind]

    def every(self, one: float) -> LlvmLanes:
        return self._of(ir.Constant(self.value.type, [one] * EIGHT if self.is_wide else one))

    def splat(self) -> LlvmLanes:
        """The same number in every lane of a vector."""
        if self.is_wide:
            return self
        vector = ir.VectorType(self.value.type, EIGHT)
        if isinstance(self.value, ir.Constant):
            return self._of(ir.Constant(vector, [self.value.constant] * EIGHT))
        nothing = ir.Constant(vector, ir.Undefined)
        first = self.builder.insert_element(nothing, self.value, ir.Constant(_TYPES[I32], 0))
        order = ir.Constant(ir.VectorType(_TYPES[I32], EIGHT), [0] * EIGHT)
        return self._of(self.builder.shuffle_vector(first, nothing, order))

    def _pair(self, other: Number) -> tuple[LlvmLanes, LlvmLanes]:
        """Both, as wide as the wider; a plain number becomes one of this kind."""
        that = other if isinstance(other, LlvmLanes) else self.every(other)  # type: ignore[arg-type]
        if that.kind != self.kind:
            raise TypeError(f"{self.kind} meets {that.kind} in a formula")
        return (self.splat(), that.splat()) if self.is_wide or that.is_wide else (self, that)

    def _do(self, operation: str, other: Number) -> Lanes:
        a, b = self._pair(other)
        name = _OF_FLOATS[operation] if self.kind in FLOATS else _OF_WHOLES.get(operation, operation)
        return self._of(getattr(self.builder, name)(a.value, b.value))

    def _compare(self, operator: str, other: Number) -> Lanes:
        a, b = self._pair(other)
        compare = self.builder.fcmp_ordered if self.kind in FLOATS else self.builder.icmp_signed
        return self._of(compare(operator, a.value, b.value), BIT)

    def _call(self, name: str, *others: Lanes) -> Lanes:
        lanes = [self, *others]
        if any(one.is_wide for one in lanes):  # type: ignore[attr-defined]
            lanes = [one.splat() for one in lanes]  # type: ignore[attr-defined]
        return self._called(name, *(one.value for one in lanes))  # type: ignore[attr-defined]

    def _called(self, name: str, *values: ir.Value) -> LlvmLanes:
        result = values[0].type
        of = f"v{EIGHT}" if isinstance(result, ir.VectorType) else ""
        code = {F64: "f64", F32: "f32", I64: "i64", I32: "i32"}[self.kind]
        declared = ir.FunctionType(result, [value.type for value in values])
        function = cgutils.get_or_insert_function(self.builder.module, declared, f"llvm.{name}.{of}{code}")
        return self._of(self.builder.call(function, values))

    def __neg__(self) -> Lanes:
        return self._of(self.builder.fneg(self.value) if self.kind in FLOATS else self.builder.neg(self.value))

    def choose(self, yes: Number, no: Number) -> Lanes:
        whole = LlvmLanes(self.builder, ir.Constant(_TYPES[I64], 0), I64)
        alike = next((one for one in (yes, no) if isinstance(one, LlvmLanes)), whole)
        a, b = (one if isinstance(one, LlvmLanes) else alike.every(one) for one in (yes, no))  # type: ignore[arg-type]
        truths = self
        if any(one.is_wide for one in (truths, a, b)):
            truths, a, b = truths.splat(), a.splat(), b.splat()
        return a._of(self.builder.select(truths.value, a.value, b.value))

    def lacks(self, other: Lanes) -> Lanes:
        a, b = self._pair(other)
        return self._of(self.builder.and_(a.value, self.builder.not_(b.value)))

    def to(self, kind: str) -> Lanes:
        if kind == self.kind:
            return self
        return self._of(getattr(self.builder, _CAST[self.kind, kind])(self.value, self._type(kind)), kind)

    def bits(self) -> Lanes:
        kind = _BITS_OF[self.kind]
        return self._of(self.builder.bitcast(self.value, self._type(kind)), kind)

    def of_bits(self) -> Lanes:
        return self._of(self.builder.bitcast(self.value, self._type(F64)), F64)

    def lowest_bit(self) -> Lanes:
        return self._called("cttz", self.value, ir.Constant(ir.IntType(1), 0))

    def packed(self, chosen: LlvmLanes) -> LlvmLanes:
        """A vector with the chosen numbers in front, in order, and then anything."""
        nothing = ir.Constant(self.value.type, ir.Undefined)
        return self._called("experimental.vector.compress", self.value, chosen.splat().value, nothing)


class LlvmMemory(Memory):
    """An array of numba, of which a vector, or the lane of this number, is read at once."""

    def __init__(self, context: Any, builder: ir.IRBuilder, kind: Any, array: ir.Value, lane: int | None) -> None:
        self._context, self._builder, self._array_kind, self._array = context, builder, kind, array
        self._kind, self._lane = str(kind.dtype), lane

    def _pointer(self, place: Lanes | int, lane: int = 0, many: int = 1) -> ir.Value:
        at: ir.Value = place.value if isinstance(place, LlvmLanes) else ir.Constant(_TYPES[I64], place)
        if lane:
            at = self._builder.add(at, ir.Constant(_TYPES[I64], lane))
        return element(self._context, self._builder, self._array_kind, self._array, at, many)

    def _loaded(self, pointer: ir.Value, of: ir.Type) -> LlvmLanes:
        return LlvmLanes(self._builder, self._builder.load(pointer, align=_SIZES[self._kind], typ=of), self._kind)

    def one(self, place: Lanes | int) -> Lanes:
        return self._loaded(self._pointer(place), _TYPES[self._kind])

    def read(self, place: Lanes | int) -> Lanes:
        if self._lane is not None:
            return self._loaded(self._pointer(place, self._lane), _TYPES[self._kind])
        return self._loaded(self._pointer(place, many=EIGHT), ir.VectorType(_TYPES[self._kind], EIGHT))

    def write(self, place: Lanes | int, lanes: Lanes) -> None:
        assert isinstance(lanes, LlvmLanes)
        if lanes.kind != self._kind:  # a pointer has no type, so LLVM would not say it
            raise TypeError(f"{lanes.kind} is written to an array of {self._kind}")
        if self._lane is None:
            value, pointer = lanes.splat().value, self._pointer(place, many=EIGHT)
        else:
            value, pointer = lanes.value, self._pointer(place, self._lane)
        self._builder.store(value, pointer, align=_SIZES[self._kind])

    def append(self, place: Lanes, lanes: Lanes, chosen: Lanes) -> Lanes:
        assert isinstance(lanes, LlvmLanes) and isinstance(chosen, LlvmLanes)
        builder = self._builder
        pointer = self._pointer(place, many=EIGHT if self._lane is None else 1)
        if self._lane is not None:
            builder.store(lanes.value, pointer, align=_SIZES[self._kind])
            return chosen.to(I64)
        truths = chosen.splat().value
        builder.store(lanes.packed(chosen).value, pointer, align=_SIZES[self._kind])
        together = builder.bitcast(truths, ir.IntType(EIGHT))
        return LlvmLanes(builder, builder.zext(builder.ctpop(together), _TYPES[I64]), I64)

    def numbered(self, place: Lanes) -> Lanes:
        if self._lane is not None:
            return place + self._lane
        numbers = ir.Constant(ir.VectorType(_TYPES[I64], EIGHT), list(range(EIGHT)))
        return place + LlvmLanes(self._builder, numbers, I64)


_SIZES = {F64: 8, F32: 4, I64: 8, I32: 4, U8: 1}


def type_of(declared: Declared, came: Any) -> Any:
    """The type of numba as which an argument is taken: what is declared; of an array what came.

    Raises TypeError if what came is no contiguous array where one is declared, or a fraction where a whole number is.
    """
    if isinstance(declared, FlatArray):
        if not isinstance(came, types.Array) or came.layout != "C":
            raise TypeError(f"{came} is no contiguous array")
        return came
    if not isinstance(declared, tuple):
        if isinstance(came, types.Float) and declared not in FLOATS:
            raise TypeError(f"{came} came, wanted {declared}")
        return types.boolean if declared == BIT else getattr(types, declared)
    if getattr(came, "count", None) != len(declared):
        raise TypeError(f"{came} is no tuple of {len(declared)}")
    parts = [type_of(*each) for each in zip(declared, came, strict=True)]
    return types.BaseTuple.from_types(parts, type(declared) if hasattr(declared, "_fields") else None)


def result_type(gives: Declared) -> Any:
    """The type of numba of what a formula gives."""
    if gives is None:
        return types.void
    if isinstance(gives, tuple):
        return types.Tuple([result_type(part) for part in gives])
    return types.boolean if gives == BIT else getattr(types, gives)


class Codegen:
    """Generates the code of one call of a formula."""

    def __init__(self, context: Any, builder: ir.IRBuilder) -> None:
        self._context, self._builder = context, builder

    def arguments(self, takes: tuple[Declared, ...], signature: Any, values: Any, lane: int | None) -> list[Any]:
        """What the formula is called with; arrays are read by vectors, or at the place of a lane."""

        def given(declared: Declared, kind: Any, value: ir.Value) -> Any:
            if isinstance(declared, tuple):
                parts = [given(part, kind[k], self._builder.extract_value(value, k)) for k, part in enumerate(declared)]
                return type(declared)(*parts) if hasattr(declared, "_fields") else tuple(parts)
            if isinstance(declared, FlatArray):
                return LlvmMemory(self._context, self._builder, kind, value, lane)
            return LlvmLanes(self._builder, value, declared)

        return [given(*each) for each in zip(takes, signature.args, values, strict=True)]

    def result(self, gives: Declared, kind: Any, result: Any) -> ir.Value:
        """The value that the call gives."""
        if gives is None:
            return self._context.get_dummy_value()
        if not isinstance(gives, tuple):
            if not isinstance(result, Lanes):
                return self._context.get_constant(kind, result)
            return result.to(gives).value  # type: ignore[attr-defined]
        parts = [self.result(part, kind[k], result[k]) for k, part in enumerate(gives)]
        return self._context.make_tuple(self._builder, kind, parts)
