"""Tests eight boxes against one ray at once: the inner loop of every traversal, written as vectors.

numba cannot say "a vector of eight binary32", and what LLVM makes of a loop over eight lanes changes with
every line around it. So this one step is given to LLVM as vectors. It is compiled for whatever the
processor has: one AVX register a plane, or pairs of SSE or NEON ones. The operations are the same
IEEE ones everywhere, so are the bits.

A node of the hierarchy (layout in `node.geometry.bvh`) keeps the six planes of its boxes as rows of eight. The
caller says which row of an axis is the near one, so no lane has to put its two times in order.

Nothing here is checked: `at` must be the first word of a node, and `keys` must have WIDE free places from `top`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

if TYPE_CHECKING:
    from raygrid.node.jit.code_types import (
        BaseContext,
        Intrinsic,
        IRBuilder,
        Signature,
        Type,
        Typed,
        TypingContext,
        Value,
        Values,
    )


WIDE = 8  # boxes in a node of the hierarchy
CHILD_COLUMN = 6 * WIDE  # the word of a node at which its children are named
LEAVE_LATER = 1.0 + 2.0**-21  # see `node.geometry.bvh`

_INT, _LONG = ir.IntType(32), ir.IntType(64)
_BITS = ir.VectorType(ir.IntType(1), WIDE)
_FLOATS = ir.VectorType(ir.FloatType(), WIDE)
_INTS = ir.VectorType(_INT, WIDE)
_LONGS = ir.VectorType(_LONG, WIDE)


def _splat(builder: IRBuilder, value: Value) -> Value:
    """Put the same binary32 into every lane."""
    nothing = ir.Constant(_FLOATS, ir.Undefined)
    first = builder.insert_element(nothing, value, ir.Constant(_INT, 0))
    return builder.shuffle_vector(first, nothing, ir.Constant(_INTS, [0] * WIDE))


def _choose(builder: IRBuilder, operator: str, a: Value, b: Value) -> Value:
    """Lane by lane a if `a operator b`, else b: one vmaxps or vminps."""
    return builder.select(builder.fcmp_ordered(operator, a, b), a, b)


def _address(
    context: BaseContext, builder: IRBuilder, kind: Type, array: Value, index: Value, vector: ir.VectorType
) -> Value:
    """Address of eight numbers of an array, which is seen as flat."""
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), vector.as_pointer())


def _pack(builder: IRBuilder, values: Value, chosen: Value) -> Value:
    """The chosen lanes in front, in order; one instruction with AVX-512."""
    name = f"llvm.experimental.vector.compress.v{WIDE}i64"
    compress = cgutils.get_or_insert_function(builder.module, ir.FunctionType(_LONGS, [_LONGS, _BITS, _LONGS]), name)
    return builder.call(compress, [values, chosen, ir.Constant(_LONGS, ir.Undefined)])


def _times(
    builder: IRBuilder, plane: Callable[[Value], Value], near: Value, ray: Value, low: Value, high: Value
) -> tuple[Value, Value]:
    """(when the ray enters, when it leaves) each box, at least low and at most high."""
    enter, leave = _splat(builder, low), _splat(builder, high)
    for axis in range(3):
        origin = _splat(builder, builder.extract_value(ray, axis))
        inverse = _splat(builder, builder.extract_value(ray, 3 + axis))
        first = builder.extract_value(near, axis)
        last = builder.sub(ir.Constant(_LONG, (2 * axis + 3) * WIDE), first)  # the other row of this axis
        a = builder.fmul(builder.fsub(plane(first), origin), inverse)
        b = builder.fmul(builder.fsub(plane(last), origin), inverse)
        enter, leave = _choose(builder, ">", a, enter), _choose(builder, "<", b, leave)
    return enter, leave


def _push_boxes(
    typingctx: TypingContext,
    floats: Type,
    at: Type,
    near: Type,
    ray: Type,
    low: Type,
    high: Type,
    keys: Type,
    top: Type,
) -> Typed:
    """Put a key on the stack `keys` for each box of a node that the ray meets; returns how many.

    floats     float32 array, the nodes; at  int64, first word of the node
    near       three int64, word of the row of near planes of each axis (of the far ones if the ray runs backwards)
    ray        six float32, origin and inverse direction; low, high  float32, 0 < low
    keys, top  int64 array, and the first free place in it; the WIDE places from there are overwritten

    A key is time << 32 | child: the time is a positive binary32, so keys are in the order of their times.
    """

    def codegen(context: BaseContext, builder: IRBuilder, signature: Signature, args: Values) -> Value:
        floats, at, near, ray, low, high, keys, top = args

        def load(offset: Value, vector: ir.VectorType) -> Value:
            place = builder.add(at, offset)
            return builder.load(_address(context, builder, signature.args[0], floats, place, vector), align=4)

        enter, leave = _times(builder, lambda row: load(row, _FLOATS), near, ray, low, high)
        # a box that is met is left after low > 0, so a larger factor is a later time
        later = builder.fmul(leave, ir.Constant(_FLOATS, [LEAVE_LATER] * WIDE))
        met = builder.fcmp_ordered("<=", enter, later)
        times = builder.zext(builder.bitcast(enter, _INTS), _LONGS)
        children = builder.zext(load(ir.Constant(_LONG, CHILD_COLUMN), _INTS), _LONGS)
        every = builder.or_(builder.shl(times, ir.Constant(_LONGS, [32] * WIDE)), children)
        place = _address(context, builder, signature.args[6], keys, top, _LONGS)
        builder.store(_pack(builder, every, met), place, align=8)
        return builder.zext(builder.ctpop(builder.bitcast(met, ir.IntType(WIDE))), _LONG)

    single, triple = types.float32, types.UniTuple(types.int64, 3)
    arguments = (floats, types.int64, triple, types.UniTuple(single, 6), single, single, keys, types.int64)
    return types.int64(*arguments), codegen


def _copy_keys(typingctx: TypingContext, source: Type, at: Type, target: Type, to: Type) -> Typed:
    """Copy WIDE keys between two int64 arrays, at once. Nothing is checked."""

    def codegen(context: BaseContext, builder: IRBuilder, signature: Signature, args: Values) -> Value:
        places = [_address(context, builder, signature.args[k], args[k], args[k + 1], _LONGS) for k in (0, 2)]
        builder.store(builder.load(places[0], align=8), places[1], align=8)
        return context.get_dummy_value()

    return types.void(source, types.int64, target, types.int64), codegen


# kernels call them without the first argument
push_boxes: Intrinsic = intrinsic(_push_boxes)
copy_keys: Intrinsic = intrinsic(_copy_keys)
