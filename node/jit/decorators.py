"""Compiles kernels with numba: cached on disk, no fastmath (the bits must not depend on the compiler's mood).

`kernel` is called from Python; `part` is a piece of a kernel and is inlined into it, because a call
that hands on tables of surfaces would copy all their descriptors to the stack each time.

`lean` is a kernel without reference counts, and so is every part. numba counts references to each array
wherever one is handed on or a row of it is named: 801 calls of atomic instructions in the machine code of
the ray step, 350 ns a ray of 450 outside the hierarchy, 3.2 to 4.0 times the whole (balls 1.03 s to 0.31 s,
gears 1.89 s to 0.47 s). Arrays handed in from Python are held by the caller for as long as the kernel runs,
so nothing needs to be counted, as long as a `lean` or a `part`

    - makes no array (numba refuses to compile that: "Require NRT"),
    - and hands no array back to a `kernel`, which would release what nobody holds. From `part` to `lean`
      it may.

`_nrt` is numba's own name for it; it has been there since 2015 but is not documented.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

from numba import njit

from raygrid.node.jit import cache
from raygrid.node.jit.closures import name_closure
from raygrid.node.jit.fast_load import LazyCache
from raygrid.node.jit.value_types import type_of

Function = Callable[..., Any]  # annotations inside kernels would never be checked, so they have none

_COUNTING: dict[str, Any] = {"no_cfunc_wrapper": True, "error_model": "numpy", "fastmath": False}
_LEAN: dict[str, Any] = {**_COUNTING, "_nrt": False}
CALLED = "called"  # directory of what Python calls and only kernels were meant to


def _compiled(function: Function, **options: Any) -> Function:
    name_closure(function)
    return _dispatcher(function, cache.DIRECTORY, options)


def _inner(function: Function, **options: Any) -> Function:
    """Compile for kernels alone; for Python, tests most of all, once more when it calls.

    The wrapper by which Python calls takes each table of a large tuple apart, and was two fifths of what there was to compile.
    """
    name_closure(function)
    directory = cache.DIRECTORY
    inner: Any = _dispatcher(function, directory, {**options, "no_cpython_wrapper": True})
    if not hasattr(inner, "_cache"):
        return cast(Function, inner)
    made: list[Any] = []

    def keep(result: Any) -> None:  # numba would let Python call it, by an address that is none
        inner.overloads[tuple(result.signature.args)] = result

    def compile_for_python(*arguments: Any) -> Any:
        if not made:
            made.append(_dispatcher(function, cache.within(directory, CALLED), options))
        try:
            return made[0]._compile_for_args(*arguments)
        finally:
            inner._types_active_call.clear()

    inner.add_overload, inner._compile_for_args = keep, compile_for_python
    return cast(Function, inner)


def _dispatcher(function: Function, directory: cache.DirectoryName, options: dict[str, Any]) -> Function:
    dispatcher: Any = njit(**options)(function)
    if hasattr(dispatcher, "_cache"):  # without a compiler (NUMBA_DISABLE_JIT) it has none
        dispatcher._cache = LazyCache(function, directory)
        dispatcher.typeof_pyval = _types_for(dispatcher)
    return cast(Function, dispatcher)


def _types_for(dispatcher: Any) -> Callable[[Any], Any]:
    """What a kernel asks for types of arguments that it has not met: types of ours, and what numba makes of all else."""
    by_numba = dispatcher.typeof_pyval

    def type_for(value: Any) -> Any:
        try:
            kind = type_of(value)
        except Exception:  # numba knows what to say of it
            return by_numba(value)
        dispatcher._types_active_call.add(kind)
        return kind

    return type_for


def is_on_disk(function: Function) -> bool:
    """Tell whether a kernel was ever compiled in this state of the sources (a look at names of files only)."""
    dispatcher: Any = function
    if not hasattr(dispatcher, "stats"):  # without a compiler
        return False
    return any(Path(dispatcher.stats.cache_path).glob(f"*.{dispatcher.py_func.__name__}-*.nbi"))


def kernel(function: Function) -> Function:
    """Compile a function that Python calls and that may make arrays."""
    return _compiled(function, **_COUNTING)


def lean(function: Function) -> Function:
    """Compile a function that Python calls and that makes no array."""
    return _compiled(function, **_LEAN)


def part(function: Function) -> Function:
    """Compile a function that kernels call; always inlined."""
    return _inner(function, forceinline=True, **_LEAN)


def piece(function: Function) -> Function:
    """Compile a function that kernels call, too large to be inlined wherever it is used."""
    return _inner(function, **_COUNTING)
