"""How kernels are compiled: numba, cached on disk, no fastmath (the bits must not depend on the compiler's mood).

`kernel` is called from Python; `part` is a piece of a kernel and is inlined into it, because a call
that hands on tables of surfaces would copy all their descriptors to the stack each time.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit

F = TypeVar("F", bound=Callable[..., Any])


def kernel(function: F) -> F:
    """Compile a function that Python calls."""
    return cast(F, njit(cache=True, error_model="numpy", fastmath=False)(function))


def part(function: F) -> F:
    """Compile a function that kernels call; always inlined."""
    return cast(F, njit(cache=True, error_model="numpy", fastmath=False, forceinline=True)(function))


def piece(function: F) -> F:
    """Compile a function that kernels call, too large to be inlined wherever it is used."""
    return cast(F, njit(cache=True, error_model="numpy", fastmath=False)(function))
