"""Gives kernels instructions that numba lacks: calls by address, bytes at an address, words of bytes.

Nothing is checked in them: whoever calls one has made sure that its places are inside the array.
"""

# mypy: disallow-untyped-calls=False
# numba's helpers have no types

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

if TYPE_CHECKING:
    from raygrid.node.jit.code_types import (
        BaseContext,
        Codegen,
        Intrinsic,
        IRBuilder,
        Signature,
        Type,
        Typed,
        TypingContext,
        Value,
        Values,
    )


_LONG, _INT = ir.IntType(64), ir.IntType(32)


def _called(result: ir.Type) -> Codegen:
    """The code generator of a call by address with whole numbers."""

    def codegen(context: BaseContext, builder: IRBuilder, signature: Signature, arguments: Values) -> Value:
        address, packed = arguments
        numbers = cgutils.unpack_tuple(builder, packed)
        function = ir.FunctionType(result, [_LONG] * len(numbers))
        value = builder.call(builder.inttoptr(address, function.as_pointer()), numbers)
        return value if result is _LONG else builder.sext(value, _LONG)

    return codegen


def _call_long(typingctx: TypingContext, address: Type, arguments: Type) -> Typed:
    """Call a C function of 64-bit numbers (a tuple) that gives one; what it gives, as int64."""
    return types.int64(types.int64, arguments), _called(_LONG)


def _call_int(typingctx: TypingContext, address: Type, arguments: Type) -> Typed:
    """Call a C function of 64-bit numbers (a tuple) that gives an `int`; what it gives, as int64."""
    return types.int64(types.int64, arguments), _called(_INT)


def _bytes_at(typingctx: TypingContext, address: Type, size: Type) -> Typed:
    """The bytes from an address on, as uint8 (size,). They must outlive the array."""
    array = types.Array(types.uint8, 1, "C")

    def codegen(context: BaseContext, builder: IRBuilder, signature: Signature, arguments: Values) -> Value:
        made = context.make_array(array)(context, builder)
        data = builder.inttoptr(arguments[0], ir.IntType(8).as_pointer())
        one = context.get_constant(types.intp, 1)
        length = arguments[1]
        made.data = data
        made.shape = cgutils.pack_array(builder, [length], ty=context.get_value_type(types.intp))
        made.strides = cgutils.pack_array(builder, [one], ty=context.get_value_type(types.intp))
        made.itemsize, made.nitems = one, length
        made.meminfo = context.get_constant_null(types.MemInfoPointer(types.voidptr))
        made.parent = context.get_constant_null(types.pyobject)
        return made._getvalue()

    return array(types.int64, types.int64), codegen


def _address(typingctx: TypingContext, array: Type, index: Type) -> Typed:
    """The address of an element of a flat array."""

    def codegen(context: BaseContext, builder: IRBuilder, signature: Signature, arguments: Values) -> Value:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        return builder.ptrtoint(builder.gep(data, [arguments[1]]), _LONG)

    return types.int64(array, types.int64), codegen


def _copy_bytes(typingctx: TypingContext, source: Type, at: Type, target: Type, to: Type, size: Type) -> Typed:
    """Copy bytes between two flat uint8 arrays, which must not overlap there. Nothing is checked.

    A loop over bytes becomes as many loads and stores, since arrays might overlap; of a packet this makes two each.
    """

    def codegen(context: BaseContext, builder: IRBuilder, signature: Signature, arguments: Values) -> Value:
        places = []
        for array, index in ((2, 3), (0, 1)):
            data = context.make_array(signature.args[array])(context, builder, arguments[array]).data
            places.append(builder.gep(data, [arguments[index]]))
        cgutils.raw_memcpy(builder, places[0], places[1], arguments[4], 1)
        return context.get_dummy_value()

    return types.void(source, types.int64, target, types.int64, types.int64), codegen


def _put_words(typingctx: TypingContext, target: Type, at: Type, first: Type, second: Type, third: Type) -> Typed:
    """Put three int64 into a flat uint8 array, 24 bytes from `at` on, the least of each first. Nothing is checked."""

    def codegen(context: BaseContext, builder: IRBuilder, signature: Signature, arguments: Values) -> Value:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        for k, value in enumerate(arguments[2:]):
            place = builder.gep(data, [builder.add(arguments[1], ir.Constant(_LONG, 8 * k))])
            builder.store(_least_first(builder, value), builder.bitcast(place, _LONG.as_pointer()), align=1)
        return context.get_dummy_value()

    return types.void(target, types.int64, types.int64, types.int64, types.int64), codegen


def _load(bits: int) -> Intrinsic:
    """The intrinsic that reads so many bits, the least byte first, as int64.

    numba looks at every index whether it counts from the end, so bytes that are named one by one are loaded one by one.
    """

    def intrinsic_function(typingctx: TypingContext, array: Type, at: Type) -> Typed:
        """The number that begins at place `at` of a flat uint8 array. Nothing is checked."""

        def codegen(context: BaseContext, builder: IRBuilder, signature: Signature, arguments: Values) -> Value:
            data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
            place = builder.bitcast(builder.gep(data, [arguments[1]]), ir.IntType(bits).as_pointer())
            value = _least_first(builder, builder.load(place, align=1))
            return value if bits == 64 else builder.zext(value, _LONG)

        return types.int64(array, types.int64), codegen

    return intrinsic(intrinsic_function)


def _least_first(builder: IRBuilder, value: Value) -> Value:
    """A number in the order of bytes of this computer that puts the least first."""
    return value if sys.byteorder == "little" or value.type.width == 8 else builder.bswap(value)


# kernels call them without the first argument
call_long: Intrinsic = intrinsic(_call_long)
call_int: Intrinsic = intrinsic(_call_int)
bytes_at: Intrinsic = intrinsic(_bytes_at)
address: Intrinsic = intrinsic(_address)
copy_bytes: Intrinsic = intrinsic(_copy_bytes)
put_words: Intrinsic = intrinsic(_put_words)
load_8: Intrinsic = _load(8)
load_16: Intrinsic = _load(16)
load_32: Intrinsic = _load(32)
load_64: Intrinsic = _load(64)
