"""Names the types of numba and llvmlite that intrinsics are written with, for annotations only: neither has any of its own."""

from collections.abc import Callable, Sequence
from typing import Any

from llvmlite.ir import IRBuilder, Value
from numba.core.base import BaseContext
from numba.core.types import Type
from numba.core.typing.context import Context as TypingContext
from numba.core.typing.templates import Signature

Values = Sequence[Value]
Codegen = Callable[[BaseContext, IRBuilder, Signature, Values], Value]
Typed = tuple[Signature, Codegen]  # what the typing function of an intrinsic gives
Intrinsic = Callable[..., Any]  # kernels call it without the typing context

__all__ = [
    "BaseContext",
    "Codegen",
    "IRBuilder",
    "Intrinsic",
    "Signature",
    "Type",
    "Typed",
    "TypingContext",
    "Value",
    "Values",
]
