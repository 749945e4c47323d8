"""Gives programs powers with the same bits on every computer, however they write them.

`x ** y`, `x **= y`, `pow`, `math.pow` and numpy's `power` and `float_power` mean `node.geometry.power` where a program becomes
compiled code. A power with a whole literal exponent stays what numba makes of it, a chain of multiplications, as does one
whose exponent is an integer.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import numpy as np
from numba import types
from numba.extending import overload

from raygrid.node.geometry.power import power
from raygrid.node.jit.decorators import lean, part

NAME = "_raygrid_power"  # by which a program's code calls `any_power`
WRITTEN = {("math", "pow"), ("numpy", "power"), ("numpy", "float_power")}


@part
def _signed(x, y):  # type: ignore[no-untyped-def]
    """A power as C has it, of numbers below 0 as well: no number unless the exponent is whole."""
    if not x < 0.0:
        return power(x, y)
    if y != np.floor(y):
        return np.nan
    half = y * 0.5
    return power(-x, y) if half == np.floor(half) else -power(-x, y)


@lean
def _signed_each(x, y, found):  # type: ignore[no-untyped-def]
    """Take the powers of numbers in rows."""
    for k in range(len(x)):
        found[k] = _signed(x[k], y[k])


def any_power(x, y):  # type: ignore[no-untyped-def]  # numba wants the same parameters below
    """What programs call for a power. In plain Python, too, as what a program's text works out is a constant of its code."""
    if isinstance(y, int | np.integer):
        return x**y
    bases, exponents = (np.ascontiguousarray(one) for one in np.broadcast_arrays(np.float64(x), np.float64(y)))
    found = np.empty(bases.shape)
    _signed_each(bases.reshape(-1), exponents.reshape(-1), found.reshape(-1))
    return found if np.ndim(x) or np.ndim(y) else float(found.reshape(-1)[0])


def _typed(x, y):  # type: ignore[no-untyped-def]
    if isinstance(y, types.Integer | types.Boolean):
        return lambda x, y: x**y
    return lambda x, y: _signed(float(x), float(y))


@cache
def _make_known() -> None:
    """Tell numba what `any_power` is compiled to: with the first program, since that takes 15 ms of every start."""
    overload(any_power)(_typed)


class _Powers(ast.NodeTransformer):
    """Writes a call of NAME wherever a program takes a power."""

    def __init__(self, modules: dict[str, str], powers: set[str]) -> None:
        self._modules = modules  # name in the program -> module
        self._powers = powers  # names that are powers here

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        node.decorator_list = [self.visit(one) for one in node.decorator_list]
        node.args = self.visit(node.args)  # defaults are worked out outside
        with self._within(node):
            node.body = [self.visit(one) for one in node.body]
        return node

    def visit_Lambda(self, node: ast.Lambda) -> ast.AST:
        node.args = self.visit(node.args)
        with self._within(node):
            node.body = self.visit(node.body)
        return node

    @contextmanager
    def _within(self, function: ast.FunctionDef | ast.Lambda) -> Iterator[None]:
        """In a function, its parameters and variables are no powers, whatever their names."""
        before = self._powers
        self._powers = before - set(_names_given(function))
        yield
        self._powers = before

    def visit_Name(self, node: ast.Name) -> ast.AST:
        is_power = isinstance(node.ctx, ast.Load) and node.id in self._powers
        return ast.copy_location(_name(), node) if is_power else node

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        self.generic_visit(node)
        if not isinstance(node.op, ast.Pow) or _is_whole(node.right):
            return node
        return ast.copy_location(_call(node.left, node.right), node)

    def visit_AugAssign(self, node: ast.AugAssign) -> ast.AST:
        self.generic_visit(node)
        if not isinstance(node.op, ast.Pow) or _is_whole(node.value) or not isinstance(node.target, ast.Name):
            return node
        read = ast.copy_location(ast.Name(node.target.id, ast.Load()), node.target)
        return ast.copy_location(ast.Assign([node.target], _call(read, node.value)), node)

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        self.generic_visit(node)
        module = self._modules.get(node.value.id) if isinstance(node.value, ast.Name) else None
        return ast.copy_location(_name(), node) if (module, node.attr) in WRITTEN else node


def _name() -> ast.Name:
    return ast.Name(NAME, ast.Load())


def _call(left: ast.expr, right: ast.expr) -> ast.Call:
    return ast.Call(_name(), [left, right], [])


def _is_whole(exponent: ast.expr) -> bool:
    """Tell a literal whole number, with a sign or without."""
    value = exponent.operand if isinstance(exponent, ast.UnaryOp) else exponent
    return isinstance(value, ast.Constant) and isinstance(value.value, int)


def _names_given(scope: ast.Module | ast.FunctionDef | ast.Lambda) -> Iterator[str]:
    """The names that a program, or a function, gives to things of its own: functions, parameters and variables."""
    waiting = list(ast.iter_child_nodes(scope))
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.Name) and not isinstance(node.ctx, ast.Load):
            yield node.id
        elif isinstance(node, ast.FunctionDef):
            yield node.name
        if not isinstance(node, ast.FunctionDef | ast.Lambda):  # what is given in those is theirs
            waiting.extend(ast.iter_child_nodes(node))


def with_safe_powers(source: str, space: dict[str, Any]) -> ast.Module:
    """The text of a program in which powers are calls of `any_power`, which is put into the namespace for it."""
    tree = ast.parse(source)
    modules, taken = {}, {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            modules.update({alias.asname or alias.name: alias.name for alias in node.names})
        elif isinstance(node, ast.ImportFrom):
            taken.update({alias.asname or alias.name: (node.module, alias.name) for alias in node.names})
    powers = {name for name, what in taken.items() if what in WRITTEN}
    own = set(_names_given(tree)) | (taken.keys() - powers)
    powers = (powers | {"pow"}) - own
    _make_known()
    space[NAME] = any_power
    _Powers(modules, powers).visit(tree)
    return ast.fix_missing_locations(tree)
