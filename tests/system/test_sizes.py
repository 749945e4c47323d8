"""Nothing is too large to be read at one sitting: files, functions, lists of parameters. What still is stands in a table."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator, Mapping

from support import paths
from support.modules import Modules, read_modules

sys.path.insert(0, str(paths.ROOT / "benchmarks"))

from kernel_functions import kernels

LINES_OF_A_FILE = 400  # all below
LINES_OF_A_FUNCTION = 60
MOST_PARAMETERS = 10
MOST_OF_A_KERNEL = 8  # tables that belong together are one tuple

# what is larger -> how large. Entries may only shrink or go.
LARGE_FILES: dict[str, int] = {}
LONG_FUNCTIONS: dict[str, int] = {}
MANY_PARAMETERS: dict[str, int] = {}

LARGE_KERNELS: dict[str, int] = {}

MODULES = read_modules(paths.ROOT)
Function = ast.FunctionDef | ast.AsyncFunctionDef
Sizes = dict[str, int]


def file_sizes(modules: Modules) -> Sizes:
    """Lines of each module."""
    return {name: len(module.source.splitlines()) for name, module in modules.items()}


def functions(name: str, tree: ast.AST) -> Iterator[tuple[str, Function]]:
    """All functions below a module, a class or a function, with their full names."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, Function):
            yield f"{name}.{node.name}", node
            yield from functions(f"{name}.{node.name}", node)
        elif isinstance(node, ast.ClassDef):
            yield from functions(f"{name}.{node.name}", node)
        else:
            yield from functions(name, node)


def all_functions(modules: Modules) -> Iterator[tuple[str, Function]]:
    for name, module in modules.items():
        yield from functions(name, module.tree)


def function_sizes(modules: Modules) -> Sizes:
    """Lines of each function, from `def` to its end."""
    return {name: (node.end_lineno or 0) - node.lineno + 1 for name, node in all_functions(modules)}


def parameter_counts(modules: Modules, of_kernels: bool = False) -> Sizes:
    """Parameters of each function that is no kernel, or of each that is one; `self` is none."""
    compiled = kernel_names(modules)
    return {name: len(parameters(node)) for name, node in all_functions(modules) if (name in compiled) == of_kernels}


def kernel_names(modules: Modules) -> set[str]:
    return {f"{name}.{kernel}" for name, module in modules.items() for kernel in kernels(module.tree)}


def parameters(node: Function) -> list[str]:
    every = [*node.args.posonlyargs, *node.args.args, node.args.vararg, *node.args.kwonlyargs, node.args.kwarg]
    return [one.arg for one in every if one is not None and one.arg not in ("self", "cls")]


def faults(sizes: Sizes, limit: int, listed: Mapping[str, int]) -> list[str]:
    """What is larger than the limit and than the table says, and lines of the table that are larger than what is there."""
    found = [
        f"{name}: {size}, and at most {max(limit, listed.get(name, 0))} are allowed"
        for name, size in sizes.items()
        if size > max(limit, listed.get(name, 0))
    ]
    for name, size in listed.items():
        if sizes.get(name, 0) <= limit:
            found.append(f"{name}: {sizes.get(name, 0)} now, take it out of the table")
        elif sizes[name] < size:
            found.append(f"{name}: {sizes[name]} now, the table says {size}")
    return found


def test_files_are_short():
    assert faults(file_sizes(MODULES), LINES_OF_A_FILE - 1, LARGE_FILES) == []


def test_functions_are_short():
    assert faults(function_sizes(MODULES), LINES_OF_A_FUNCTION - 1, LONG_FUNCTIONS) == []


def test_functions_take_few_things():
    assert faults(parameter_counts(MODULES), MOST_PARAMETERS, MANY_PARAMETERS) == []


def test_kernels_take_few_things():
    assert faults(parameter_counts(MODULES, of_kernels=True), MOST_OF_A_KERNEL, LARGE_KERNELS) == []


def test_kernels_are_told_from_the_rest():
    found = kernel_names(MODULES)
    assert len(found) > 300
    assert {
        "node.tracing.step.make_step.step",
        "node.geometry.grid_walk.passage",
        "node.runtime.reduction.begin",
    } <= found
    assert found <= {name for name, _ in all_functions(MODULES)}


def test_what_is_too_large_is_seen(tmp_path):
    (tmp_path / "node").mkdir()
    text = (
        "class A:\n    def f(self, a, *b, c, **d):\n"
        + "        pass\n" * 9
        + "@part\ndef g(a, b, c, d, e):\n    pass\n"
    )
    (tmp_path / "node" / "errors.py").write_text(text)
    modules = read_modules(tmp_path)
    assert faults(file_sizes(modules), 13, {}) == ["node.errors: 14, and at most 13 are allowed"]
    assert faults(function_sizes(modules), 9, {}) == ["node.errors.A.f: 10, and at most 9 are allowed"]
    assert faults(parameter_counts(modules), 3, {}) == ["node.errors.A.f: 4, and at most 3 are allowed"]
    assert faults(parameter_counts(modules), 3, {"node.errors.A.f": 4}) == []
    stale = {"node.errors.A.f": 5, "node.errors.g": 5}
    assert faults(parameter_counts(modules), 3, stale) == [
        "node.errors.A.f: 4 now, the table says 5",
        "node.errors.g: 0 now, take it out of the table",
    ]
