"""Calls a kernel by its address, so that who calls it need not be compiled again when another takes its place.

A compiled call by name is to one function, and holds for as long as its caller lives. The event loop of a node calls the
ray step by address instead: a program brings a step of its own, and nothing else changes.

Compiled code has no types at an address, and a call with others would write anywhere. So an address carries a number that is
worked out of the types for which the kernel was compiled, and a caller compares it with that of what it hands over.
"""

# mypy: disallow-untyped-calls=False
# numba's helpers have no types

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, Any, NamedTuple
from weakref import WeakKeyDictionary

from llvmlite import ir
from numba.core import cgutils, types
from numba.core import config as _config
from numba.extending import intrinsic

from raygrid.node.jit.decorators import Function
from raygrid.node.jit.intrinsics import FunctionAt
from raygrid.node.jit.value_types import type_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from raygrid.node.jit.code_types import (
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

OTHER_TYPES = "a kernel was called by its address with arguments of other types than it was compiled for"
_INTERPRETED: list[Function] = []  # kernels by their address, where nothing is compiled
# what was asked for once, by numbers of types: nodes are forks, and ask for what is known
_ADDRESSES: WeakKeyDictionary[Function, dict[tuple[int, ...], Address]] = WeakKeyDictionary()


class Address(NamedTuple):
    """Where a kernel is. address: of its machine code; types: a number that stands for the types of its arguments."""

    address: int
    types: int


def address_of(kernel: Function, *arguments: Any) -> Address:
    """Compile a kernel that gives a whole number for arguments of these types, or load it; returns where it is.

    The address holds for as long as this process and its forks.
    """
    if config.DISABLE_JIT:
        if kernel not in _INTERPRETED:
            _INTERPRETED.append(kernel)
        return Address(_INTERPRETED.index(kernel), 0)
    kinds = tuple(type_of(argument) for argument in arguments)
    known, key = _ADDRESSES.setdefault(kernel, {}), tuple(kind._code for kind in kinds)
    if key not in known:
        known[key] = _address_for(kernel, kinds)
    return known[key]


def _address_for(kernel: Function, kinds: tuple[Type, ...]) -> Address:
    dispatcher: Any = kernel
    dispatcher.compile(kinds)
    result = dispatcher.overloads[kinds]  # it holds the types, so their numbers stay theirs
    if result.signature.return_type != types.int64:
        raise TypeError(f"{dispatcher.py_func.__qualname__} gives {result.signature.return_type}, wanted int64")
    address = result.library.get_pointer_to_function(result.fndesc.llvm_func_name)
    return Address(address, _number_of(kinds))


def _number_of(kinds: Sequence[Type]) -> int:
    """A number that stands for types: the same in every process."""
    digest = hashlib.sha256("; ".join(map(str, kinds)).encode()).digest()
    return int.from_bytes(digest[:8], "little") >> 1


def _call_at(typingctx: TypingContext, address: Type, arguments: Any) -> Typed:
    """Call the kernel at an `Address` with a tuple of arguments; the int64 that it gives. What it raises is raised on."""
    kinds = tuple(types.unliteral(kind) for kind in arguments.types)

    def codegen(context: Any, builder: IRBuilder, signature: Signature, given: Values) -> Value:
        convention: Any = context.call_conv
        there, packed = given
        number = builder.extract_value(there, 1)
        with cgutils.if_unlikely(
            builder, builder.icmp_signed("!=", number, ir.Constant(number.type, _number_of(kinds)))
        ):
            convention.return_user_exc(builder, TypeError, (OTHER_TYPES,))
        function = convention.get_function_type(types.int64, kinds)
        kernel = FunctionAt(builder.inttoptr(builder.extract_value(there, 0), ir.PointerType()), function)
        values = cgutils.unpack_tuple(builder, packed)
        status, result = convention.call_function(builder, kernel, types.int64, kinds, values)
        with cgutils.if_unlikely(builder, status.is_error):
            convention.return_status_propagate(builder, status)
        return result

    return types.int64(address, types.BaseTuple.from_types(kinds)), codegen


def _call_interpreted(address: Address, arguments: tuple[Any, ...]) -> int:
    """Do the same where nothing is compiled."""
    return int(_INTERPRETED[address.address](*arguments))


# kernels call it without the first argument
call_at: Intrinsic = _call_interpreted if config.DISABLE_JIT else intrinsic(_call_at)
