"""C functions called from compiled code by their addresses: those of ZeroMQ that links need, and a checksum.

An address is a number handed in when a kernel is called, so that compiled code stays good for other processes and
can be kept on disk. Who has no such functions (another build of pyzmq or xxhash) gets no addresses, and the links are
served by Python alone: slower, and the same in all else. With RAYGRID_LINKS=python in the environment nobody has any.
"""

# mypy: disallow-untyped-calls=False
# numba's helpers have no types

from __future__ import annotations

import ctypes
import importlib
import os
import sys
from collections.abc import Iterable
from functools import cache
from typing import Any

import numpy as np
import zmq
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic
from numpy.typing import NDArray

# places in the table of addresses
INITIALIZE, RECEIVE, DATA, LENGTH, MORE, CLOSE, SEND, POLL, ERROR, CHECKSUM, MESSAGE, AGAIN, SLEEP, CLOCK = range(14)
ADDRESSES = 14
MESSAGE_WORDS = 8  # of a zmq_msg_t, which has 64 bytes and wants to begin at a multiple of 8

_FROM_ZEROMQ = {
    INITIALIZE: "zmq_msg_init",
    RECEIVE: "zmq_msg_recv",
    DATA: "zmq_msg_data",
    LENGTH: "zmq_msg_size",
    MORE: "zmq_msg_more",
    CLOSE: "zmq_msg_close",
    SEND: "zmq_send",
    POLL: "zmq_poll",
    ERROR: "zmq_errno",
}
# the first also looks which instructions the processor has, where it can (x86)
_CHECKSUMS = ("XXH3_64bits_withSeed_dispatch", "XXH3_64bits_withSeed")
_SLEEP, _CLOCK = "usleep", "clock_gettime"
SWITCH, BY_PYTHON = "RAYGRID_LINKS", "python"


def _address_of(library: ctypes.CDLL, name: str) -> int:
    return int(ctypes.cast(getattr(library, name), ctypes.c_void_p).value or 0)


def _library_of(module: str) -> ctypes.CDLL:
    return ctypes.CDLL(importlib.import_module(module).__file__)


def find_functions() -> NDArray[np.int64] | None:
    """The table of addresses, int64 (ADDRESSES,), without a message; None if one cannot be found.

    To be copied. A fork finds them where its parent did.
    """
    return _look_for_functions()[0]


def why_python() -> str | None:
    """Why Python alone serves the links; None where compiled code does."""
    return _look_for_functions()[1]


@cache
def _look_for_functions() -> tuple[NDArray[np.int64] | None, str | None]:
    """The table, or why there is none."""
    table = np.zeros(ADDRESSES, np.int64)
    if os.environ.get(SWITCH) == BY_PYTHON:
        return None, f"{SWITCH}={BY_PYTHON} asks for it"
    if sys.byteorder != "little":  # of `poll_items`
        return None, "numbers begin with their highest byte on this computer"
    try:
        library = _library_of("zmq.backend.cython._zmq")  # a name is looked for in what it was linked with, too
        for place, name in _FROM_ZEROMQ.items():
            table[place] = _address_of(library, name)
        library = _library_of("xxhash._xxhash")
        names = [name for name in _CHECKSUMS if hasattr(library, name)]
        table[CHECKSUM] = _address_of(library, names[0])
        table[SLEEP], table[CLOCK] = (_address_of(ctypes.CDLL(None), name) for name in (_SLEEP, _CLOCK))
    except (ImportError, AttributeError, IndexError, OSError) as error:
        missing = "no checksum of xxhash" if isinstance(error, IndexError) else str(error)
        return None, f"a C function of pyzmq or xxhash cannot be found: {missing}"
    table[AGAIN] = int(zmq.EAGAIN)
    return table, None


def poll_items(sockets: Iterable[int], descriptors: Iterable[int]) -> NDArray[np.int64]:
    """What `zmq_poll` is to wait for, int64 (n, 2): sockets of these addresses, and descriptors, with something to read.

    An item is a zmq_pollitem_t: address of a socket; descriptor (32 bits), wanted events, found events (16 bits each).
    """
    wanted = int(zmq.POLLIN) << 32
    rows = [(socket, wanted) for socket in sockets] + [(0, wanted | one) for one in descriptors]
    return np.array(rows, np.int64).reshape(-1, 2)


class Message:
    """Room for one message of ZeroMQ, into which compiled code receives; Python can read what it left there."""

    def __init__(self, table: NDArray[np.int64]) -> None:
        self._words = np.zeros(MESSAGE_WORDS, np.int64)
        table[MESSAGE] = self._words.ctypes.data
        self._place = ctypes.c_void_p(self._words.ctypes.data)
        prototype = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)
        self._data = prototype(int(table[DATA]))
        self._length = ctypes.CFUNCTYPE(ctypes.c_size_t, ctypes.c_void_p)(int(table[LENGTH]))
        number = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p)
        self._more, self._close = number(int(table[MORE])), number(int(table[CLOSE]))
        number(int(table[INITIALIZE]))(self._place)

    def copy(self) -> bytes:
        """The bytes of the message that was received last."""
        return ctypes.string_at(self._data(self._place), self._length(self._place))

    def close(self) -> None:
        """Give back what ZeroMQ holds for it. Nothing may be received into it afterwards."""
        self._close(self._place)

    @property
    def has_more(self) -> bool:
        """Whether it is but a part of a message."""
        return bool(self._more(self._place))


_LONG, _INT = ir.IntType(64), ir.IntType(32)


def _called(result: ir.Type) -> Any:
    """The code generator of a call by address with whole numbers."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        address, packed = arguments
        numbers = cgutils.unpack_tuple(builder, packed)
        function = ir.FunctionType(result, [_LONG] * len(numbers))
        value = builder.call(builder.inttoptr(address, function.as_pointer()), numbers)
        return value if result is _LONG else builder.sext(value, _LONG)

    return codegen


def _call_long(typingctx: Any, address: Any, arguments: Any) -> Any:
    """Call a C function of 64-bit numbers (a tuple) that gives one; what it gives, as int64."""
    return types.int64(types.int64, arguments), _called(_LONG)


def _call_int(typingctx: Any, address: Any, arguments: Any) -> Any:
    """Call a C function of 64-bit numbers (a tuple) that gives an `int`; what it gives, as int64."""
    return types.int64(types.int64, arguments), _called(_INT)


def _bytes_at(typingctx: Any, address: Any, size: Any) -> Any:
    """The bytes from an address on, as uint8 (size,). They must outlive the array."""
    array = types.Array(types.uint8, 1, "C")

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
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


def _address(typingctx: Any, array: Any, index: Any) -> Any:
    """The address of an element of a flat array."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        return builder.ptrtoint(builder.gep(data, [arguments[1]]), _LONG)

    return types.int64(array, types.int64), codegen


def _copy_bytes(typingctx: Any, source: Any, at: Any, target: Any, to: Any, size: Any) -> Any:
    """Copy bytes between two flat uint8 arrays, which must not overlap there. Nothing is checked.

    A loop over bytes becomes as many loads and stores, since arrays might overlap; of a packet this makes two each.
    """

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        places = []
        for array, index in ((2, 3), (0, 1)):
            data = context.make_array(signature.args[array])(context, builder, arguments[array]).data
            places.append(builder.gep(data, [arguments[index]]))
        cgutils.raw_memcpy(builder, places[0], places[1], arguments[4], 1)
        return context.get_dummy_value()

    return types.void(source, types.int64, target, types.int64, types.int64), codegen


def _put_words(typingctx: Any, target: Any, at: Any, first: Any, second: Any, third: Any) -> Any:
    """Put three int64 into a flat uint8 array, 24 bytes from `at` on, the least of each first. Nothing is checked."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        for k, value in enumerate(arguments[2:]):
            place = builder.gep(data, [builder.add(arguments[1], ir.Constant(_LONG, 8 * k))])
            builder.store(_least_first(builder, value), builder.bitcast(place, _LONG.as_pointer()), align=1)
        return context.get_dummy_value()

    return types.void(target, types.int64, types.int64, types.int64, types.int64), codegen


def _load(bits: int) -> Any:
    """The intrinsic that reads so many bits, the least byte first, as int64.

    numba looks at every index whether it counts from the end, so bytes that are named one by one are loaded one by one.
    """

    def intrinsic_function(typingctx: Any, array: Any, at: Any) -> Any:
        """The number that begins at place `at` of a flat uint8 array. Nothing is checked."""

        def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
            place = builder.bitcast(builder.gep(data, [arguments[1]]), ir.IntType(bits).as_pointer())
            value = _least_first(builder, builder.load(place, align=1))
            return value if bits == 64 else builder.zext(value, _LONG)

        return types.int64(array, types.int64), codegen

    return intrinsic(intrinsic_function)


def _least_first(builder: Any, value: Any) -> Any:
    """A number in the order of bytes of this computer that puts the least first."""
    return value if sys.byteorder == "little" or value.type.width == 8 else builder.bswap(value)


# kernels call them without the first argument
call_long: Any = intrinsic(_call_long)
call_int: Any = intrinsic(_call_int)
bytes_at: Any = intrinsic(_bytes_at)
address: Any = intrinsic(_address)
copy_bytes: Any = intrinsic(_copy_bytes)
put_words: Any = intrinsic(_put_words)
load_8: Any = _load(8)
load_16: Any = _load(16)
load_32: Any = _load(32)
load_64: Any = _load(64)
