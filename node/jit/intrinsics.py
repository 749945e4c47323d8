"""Gives kernels instructions that numba lacks: calls by address, bytes at an address, words of bytes.

Nothing is checked in them: whoever calls one has made sure that its places are inside the array. With NUMBA_BOUNDSCHECK=1
places are checked as numba checks indices. With NUMBA_DISABLE_JIT=1 each is the Python function that defines it, which
checks always.

A pointer is a place and no more, as LLVM has it: whoever reads or steps on says of what. llvmlite still lets pointers have
types, which numba gives them and which llvmlite is going to drop; so theirs are forgotten first (`array_data`).
"""

# mypy: disallow-untyped-calls=False
# numba's helpers have no types

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core import config as _config
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

config: Any = _config  # its names are made at run time

_LONG, _INT = ir.IntType(64), ir.IntType(32)
_POINTER = ir.PointerType()


class FunctionAt:
    """What `IRBuilder.call` asks of a function, which a pointer alone cannot tell it."""

    def __init__(self, place: Value, function: ir.FunctionType) -> None:
        self.type, self.function_type, self._place = place.type, function, place

    def get_reference(self) -> str:
        """Give the name by which it is called."""
        return str(self._place.get_reference())


def array_data(context: BaseContext, builder: IRBuilder, kind: Type, array: Value) -> Value:
    """The place at which an array's elements begin: a pointer without the type of what it points to.

    llvmlite has no cast for that, as it takes both kinds of pointers for equal. What is laid into a structure and taken
    out again has the type of its field, and costs nothing in machine code.
    """
    data = context.make_array(kind)(context, builder, array).data
    holder = ir.Constant(ir.LiteralStructType([_POINTER]), ir.Undefined)
    return builder.extract_value(builder.insert_value(holder, data, 0), 0)


def element(context: BaseContext, builder: IRBuilder, kind: Any, array: Value, index: Value, many: Any) -> Value:
    """The place of an element of a flat array. `many`: how many are read or written from there on, a number or a Value."""
    if config.BOUNDSCHECK:
        held = context.make_array(kind)(context, builder, array).nitems
        many = ir.Constant(_LONG, many) if isinstance(many, int) else many
        beyond = builder.add(held, ir.Constant(_LONG, 1))  # an end may lie behind the last one
        for place in (index, builder.add(index, many)):
            cgutils.do_boundscheck(context, builder, place, beyond)
    data = array_data(context, builder, kind, array)
    return builder.gep(data, [index], source_etype=context.get_data_type(kind.dtype))


def _called(result: ir.Type) -> Codegen:
    """The code generator of a call by address with whole numbers."""

    def codegen(context: BaseContext, builder: IRBuilder, signature: Signature, arguments: Values) -> Value:
        address, packed = arguments
        numbers = cgutils.unpack_tuple(builder, packed)
        function = ir.FunctionType(result, [_LONG] * len(numbers))
        value = builder.call(FunctionAt(builder.inttoptr(address, _POINTER), function), numbers)
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
        data = builder.inttoptr(arguments[0], _POINTER)
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
        place = element(context, builder, signature.args[0], arguments[0], arguments[1], 0)
        return builder.ptrtoint(place, _LONG)

    return types.int64(array, types.int64), codegen


def _copy_bytes(typingctx: TypingContext, source: Type, at: Type, target: Type, to: Type, size: Type) -> Typed:
    """Copy bytes between two flat uint8 arrays, which must not overlap there.

    A loop over bytes becomes as many loads and stores, since arrays might overlap; of a packet this makes two each.
    """

    def codegen(context: BaseContext, builder: IRBuilder, signature: Signature, arguments: Values) -> Value:
        read, at, written, to, many = arguments
        kinds = signature.args
        target = element(context, builder, kinds[2], written, to, many)
        source = element(context, builder, kinds[0], read, at, many)
        cgutils.raw_memcpy(builder, target, source, many, 1)
        return context.get_dummy_value()

    return types.void(source, types.int64, target, types.int64, types.int64), codegen


def _put_words(typingctx: TypingContext, target: Type, at: Type, first: Type, second: Type, third: Type) -> Typed:
    """Put three int64 into a flat uint8 array, 24 bytes from `at` on, the least of each first."""

    def codegen(context: BaseContext, builder: IRBuilder, signature: Signature, arguments: Values) -> Value:
        raw, at, *words = arguments
        for k, value in enumerate(words):
            index = builder.add(at, ir.Constant(_LONG, 8 * k))
            place = element(context, builder, signature.args[0], raw, index, 8)
            builder.store(_least_first(builder, value), place, align=1)
        return context.get_dummy_value()

    return types.void(target, types.int64, types.int64, types.int64, types.int64), codegen


def _load(bits: int) -> Callable[..., Typed]:
    """The typing function of what reads so many bits, the least byte first, as int64.

    numba looks at every index whether it counts from the end, so bytes that are named one by one are loaded one by one.
    """

    def load(typingctx: TypingContext, array: Type, at: Type) -> Typed:
        """The number that begins at place `at` of a flat uint8 array."""

        def codegen(context: BaseContext, builder: IRBuilder, signature: Signature, arguments: Values) -> Value:
            place = element(context, builder, signature.args[0], arguments[0], arguments[1], bits // 8)
            value = _least_first(builder, builder.load(place, align=1, typ=ir.IntType(bits)))
            return value if bits == 64 else builder.zext(value, _LONG)

        return types.int64(array, types.int64), codegen

    return load


def _least_first(builder: IRBuilder, value: Value) -> Value:
    """A number in the order of bytes of this computer that puts the least first."""
    return value if sys.byteorder == "little" or value.type.width == 8 else builder.bswap(value)


# --- the same in Python ------------------------------------------------------------------------------------


def _checked(array: np.ndarray, at: int, size: int) -> slice:
    if not 0 <= at <= at + size <= len(array):
        raise IndexError("index is out of bounds")
    return slice(at, at + size)


def _python_call(result: type[ctypes.c_int64 | ctypes.c_int]) -> Callable[[int, tuple[int, ...]], np.int64]:
    def call(address: int, arguments: tuple[int, ...]) -> np.int64:
        function = ctypes.CFUNCTYPE(result, *[ctypes.c_int64] * len(arguments))(int(address))
        return np.int64(function(*map(int, arguments)))

    return call


def _python_bytes_at(address: int, size: int) -> np.ndarray:
    return np.ctypeslib.as_array((ctypes.c_uint8 * int(size)).from_address(int(address)))


def _python_address(array: np.ndarray, index: int) -> np.int64:
    return np.int64(array.ctypes.data + _checked(array, int(index), 0).start * array.itemsize)


def _python_copy_bytes(source: np.ndarray, at: int, target: np.ndarray, to: int, size: int) -> None:
    target[_checked(target, to, size)] = source[_checked(source, at, size)]


def _python_put_words(target: np.ndarray, at: int, first: int, second: int, third: int) -> None:
    target[_checked(target, at, 24)] = np.array([first, second, third], "<i8").view(np.uint8)


def _python_load(bits: int) -> Callable[[np.ndarray, int], np.int64]:
    def load(array: np.ndarray, at: int) -> np.int64:
        raw = array[_checked(array, at, bits // 8)].tobytes()
        return np.int64(int.from_bytes(raw, "little", signed=bits == 64))

    return load


# name -> (what numba is given, what it is in Python)
DEFINED: dict[str, tuple[Callable[..., Typed], Callable[..., Any]]] = {
    "call_long": (_call_long, _python_call(ctypes.c_int64)),
    "call_int": (_call_int, _python_call(ctypes.c_int)),
    "bytes_at": (_bytes_at, _python_bytes_at),
    "address": (_address, _python_address),
    "copy_bytes": (_copy_bytes, _python_copy_bytes),
    "put_words": (_put_words, _python_put_words),
    **{f"load_{bits}": (_load(bits), _python_load(bits)) for bits in (8, 16, 32, 64)},
}


def _made(name: str) -> Intrinsic:
    compiled, interpreted = DEFINED[name]
    return interpreted if config.DISABLE_JIT else intrinsic(compiled)


# kernels call them without the typing context
call_long = _made("call_long")
call_int = _made("call_int")
bytes_at = _made("bytes_at")
address = _made("address")
copy_bytes = _made("copy_bytes")
put_words = _made("put_words")
load_8 = _made("load_8")
load_16 = _made("load_16")
load_32 = _made("load_32")
load_64 = _made("load_64")
