"""Makes functions of formulas: written once over `Lanes`, called from kernels, from Python and by other formulas.

    @formula(takes=(F64, VECTOR), gives=VECTOR)
    def scaled(size: Lanes, v: Three) -> list[Lanes]:
        return [size * v[axis] for axis in range(3)]

In a kernel `scaled(2.0, v)` is code for one number, at the place of the call. Called from Python it is interpreted by numpy,
of numbers or of arrays. Called with `Lanes`, by another formula, it is a part of that one.

`eight` is the same for what is done to eight at once: its arrays are read and written eight numbers at a time. With
RAYGRID_SIMD=0 in the environment it is code for one number, eight times over.
"""

# mypy: disallow-untyped-calls=False
# numba's helpers have no types

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import wraps
from typing import Any, cast

from numba.core import types
from numba.extending import lower_builtin, type_callable

from raygrid.node.jit.lanes import EIGHT, Declared, Lanes, Memory
from raygrid.node.jit.lanes_numpy import interpret
from raygrid.node.jit.switches import SIMD, why_off

Function = Callable[..., Any]


def formula(takes: tuple[Declared, ...], gives: Declared) -> Callable[[Function], Function]:
    """Make a function of a formula.

    takes, gives  a kind of `node.jit.lanes`, ARRAY, a tuple of these or a named tuple of these; gives None for nothing
    """
    return _maker(takes, gives, wide=False, carries=False)


def eight(takes: tuple[Declared, ...], gives: Declared = None, carries: bool = False) -> Callable[[Function], Function]:
    """Make a function of what is done to eight at once.

    carries  the last argument is what the lanes before gave, as a count that each lane adds to
    """
    return _maker(takes, gives, wide=True, carries=carries)


def _is_staged(argument: Any) -> bool:
    """Tell whether an argument comes from another formula."""
    if isinstance(argument, (tuple, list)):
        return any(_is_staged(part) for part in argument)
    return isinstance(argument, (Lanes, Memory))


def _maker(
    takes: tuple[Declared, ...], gives: Declared, *, wide: bool, carries: bool
) -> Callable[[Function], Function]:
    def make(staged: Function) -> Function:
        @wraps(staged)
        def run(*arguments: Any) -> Any:
            if any(map(_is_staged, arguments)):
                return staged(*arguments)
            return interpret(staged, takes, gives, arguments, EIGHT if wide else 1)

        _teach_numba(run, staged, takes, gives, wide, carries)
        return run

    return make


def _teach_numba(
    run: Function,
    staged: Function,
    takes: tuple[Declared, ...],
    gives: Declared,
    wide: bool,
    carries: bool,
) -> None:
    """Tell numba the types of a formula, and the code of a call. What that needs is imported by the first kernel that calls it."""

    def typing(context: Any) -> Function:
        def typer(*arguments: Any) -> Any:
            from numba.core.typing.templates import signature

            from raygrid.node.jit.lanes_llvm import result_type, type_of

            if len(arguments) != len(takes):
                return None
            return signature(result_type(gives), *map(type_of, takes, arguments))

        cast(Any, typer).pysig = inspect.signature(staged)  # else numba folds the arguments into one
        return typer

    def lower(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        from raygrid.node.jit.lanes_llvm import Codegen

        codegen = Codegen(context, builder)
        lanes = [None] if not wide or why_off(SIMD) is None else list(range(EIGHT))
        result: Any = None
        for lane in lanes:
            arguments = codegen.arguments(takes, signature, values, lane if wide else 0)
            if carries and lane:
                arguments[-1] = result
            result = staged(*arguments)
        return codegen.result(gives, signature.return_type, result)

    type_callable(run)(typing)
    lower_builtin(run, types.VarArg(types.Any))(lower)
