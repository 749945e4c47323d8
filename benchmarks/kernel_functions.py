"""Tells which functions of a source file are kernels: those that become compiled code.

Taken by all that asks: how many of their lines are run (`kernel_coverage.py`), and the tests that hold rules for kernels.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator

DECORATORS = {"kernel", "lean", "part", "piece", "formula", "eight"}  # of node.jit
STAGED = {"Lanes", "Three", "Staged"}  # types of what formulas work with, for one ray and for eight


def is_kernel(function: ast.AST) -> bool:
    """Whether a function becomes compiled code: by its decorator, or since what it works with is known to formulas alone."""
    if not isinstance(function, ast.FunctionDef):
        return False
    decorators = {_called(each) for each in function.decorator_list}
    annotations = [each.annotation for each in _parameters(function) if each.annotation is not None]
    named = {_called(node) for each in annotations for node in ast.walk(each) if isinstance(node, ast.expr)}
    return bool(decorators & DECORATORS or named & STAGED)


def kernels(tree: ast.Module) -> dict[str, ast.FunctionDef]:
    """All kernels of a module, those that factories make and those that are compiled by a call (`f_part = part(f)`), too.

    Named as coverage names them, `factory.kernel`. Methods are none.
    """
    by_call = {
        argument.id
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and _called(node) in DECORATORS
        for argument in node.args
        if isinstance(argument, ast.Name)
    }
    return {name: function for name, function in _functions(tree) if is_kernel(function) or name in by_call}


def _functions(tree: ast.AST, outer: str = "") -> Iterator[tuple[str, ast.FunctionDef]]:
    """(full name, function) of all functions but methods."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef):
            yield f"{outer}{node.name}", node
            yield from _functions(node, f"{outer}{node.name}.")
        elif not isinstance(node, ast.ClassDef):
            yield from _functions(node, outer)


def _called(node: ast.expr) -> str:
    """The bare name of a decorator, with its arguments or without: `part`, `formula(...)`, `jit.part`."""
    return ast.unparse(node.func if isinstance(node, ast.Call) else node).rpartition(".")[2]


def _parameters(function: ast.FunctionDef) -> list[ast.arg]:
    return [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]
