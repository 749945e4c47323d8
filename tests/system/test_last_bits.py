"""Functions whose last bits depend on the computer: in no kernel, and elsewhere only where no picture can show it.

IEEE 754 rounds + - * / and square roots one way, and floor, ceil, trunc, frexp, ldexp and copysign are exact. The C library's sines,
logarithms and powers, and sums of products by BLAS, LAPACK or einsum, differ in their last bits from processor to processor.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator, Mapping

import pytest
from support import paths
from support.modules import read_modules

sys.path.insert(0, str(paths.ROOT / "benchmarks"))

from kernel_functions import kernels

MODULES = read_modules(paths.ROOT)
LIBRARIES = {"math", "np", "numpy"}
INEXACT = frozenset(
    word
    for words in (
        "sin cos tan asin acos atan atan2 sinh cosh tanh asinh acosh atanh exp expm1 exp2 log log2 log10 log1p pow hypot cbrt dist",
        "arcsin arccos arctan arctan2 arcsinh arccosh arctanh power float_power logaddexp gamma lgamma erf erfc sumprod",
        "dot vdot inner matmul tensordot einsum convolve polyfit interp",
    )
    for word in words.split()
)
PRODUCT = "product of matrices"
POWER = "power"
# Why no picture can show it -> module -> what it uses. Lines may only go.
EXPLAINED: dict[str, dict[str, set[str]]] = {
    "outlines of a cell in the picture are for how much room its pixels get; they are widened by four lattice steps and by a "
    "pixel and a half": {"node.tracing.framebuffer": {"np.linalg.det", "np.linalg.inv", PRODUCT}},
    "products of whole numbers are exact": {
        "node.timed.timed_processor": {PRODUCT},
        "host.machine_time.cost_models": {PRODUCT},
        "host.machine_time.simulate_stats": {PRODUCT},
    },
    "a shape that is suggested in a message, rounded": {"emulator.topology.limits": {POWER}},
    "compared with a tolerance: a turn to the left, and once or twice around": {
        "host.scene.polygons": {"np.arctan2", "np.hypot"}
    },
    "in plain Python, where a program is only tried": {"node.programs.powers": {POWER}},
    "told to people": {
        "host.scene.scene": {"np.arctan"},
        "host.machine_time.scaling_law": {"np.exp", "np.log", "np.linalg.pinv", PRODUCT, POWER},
        "host.machine_time.scaling_law_report": {"np.exp", PRODUCT},
        "host.machine_time.law_rivals": {"np.expm1", "np.log", PRODUCT},
        "host.machine_time.prediction_law": {POWER},
    },
    "POV-Ray's scene, which it renders with its own arithmetic": {
        "host.export.povray": {"np.linalg.norm", "math.log10", POWER},
        "host.export.povray_surfaces": {"np.linalg.norm"},
    },
    "meshes for other programs, in which round surfaces are brought near and numbers have 32 bits": {
        "host.export.gltf_file": {"np.linalg.norm", "math.acos", "math.atan", POWER},
        "host.export.tessellation": {"np.linalg.norm", "np.sin", "np.cos"},
    },
    "tests/host/image/test_transfer.py shows that a last bit changes no byte": {"host.image.transfer": {POWER}},
}


def _literal(node: ast.expr) -> bool:
    try:
        ast.literal_eval(node)
    except (ValueError, TypeError):
        return False
    return True


def _powers(node: ast.AST) -> tuple[ast.expr, ast.expr] | None:
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow):
        return node.left, node.right
    if isinstance(node, ast.AugAssign) and isinstance(node.op, ast.Pow):
        return node.target, node.value
    return None


def inexact(tree: ast.Module, compiled: bool = False) -> Iterator[str]:
    """What a module uses whose last bits are not the same everywhere.

    compiled   in compiled code a whole literal exponent is a chain of multiplications; elsewhere only 2 is, or it is a constant
    """
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in LIBRARIES:
            if node.attr in INEXACT:
                yield f"{node.value.id}.{node.attr}"
        elif isinstance(node, ast.Attribute) and ast.unparse(node.value) in ("np.linalg", "numpy.linalg"):
            if node.attr != "LinAlgError":
                yield ast.unparse(node)
        elif isinstance(node, ast.ImportFrom) and node.module in ("math", "numpy", "numpy.linalg"):
            yield from (f"{node.module}.{alias.name}" for alias in node.names if alias.name in INEXACT)
        elif isinstance(node, ast.BinOp | ast.AugAssign) and isinstance(node.op, ast.MatMult):
            yield PRODUCT
        else:
            taken = _powers(node)
            if taken is not None and not _is_exact(*taken, compiled):
                yield POWER


def _is_exact(base: ast.expr, exponent: ast.expr, compiled: bool) -> bool:
    if _literal(exponent):
        value = ast.literal_eval(exponent)
        return value == 2 or _literal(base) or (compiled and isinstance(value, int))
    return _literal(base) and isinstance(ast.literal_eval(base), int) and not isinstance(exponent, ast.BinOp | ast.Call)


def used() -> dict[str, set[str]]:
    found = {name: set(inexact(module.tree)) for name, module in MODULES.items()}
    return {name: what for name, what in found.items() if what}


def explained(table: Mapping[str, Mapping[str, set[str]]]) -> dict[str, set[str]]:
    return {name: what for modules in table.values() for name, what in modules.items()}


def test_whatever_depends_on_the_computer_is_explained_and_no_more():
    assert used() == explained(EXPLAINED)


def test_no_kernel_depends_on_the_computer():
    compiled = {name: list(kernels(module.tree).values()) for name, module in MODULES.items()}
    assert sum(map(len, compiled.values())) > 300
    assert compiled["node.tracing.step"]
    found = {name: set(inexact(ast.Module(body, []), compiled=True)) for name, body in compiled.items()}
    assert {name: what for name, what in found.items() if what} == {}


@pytest.mark.parametrize(
    ("source", "wanted"),
    [
        ("math.sin(x)", {"math.sin"}),
        ("f = np.exp", {"np.exp"}),
        ("from math import log", {"math.log"}),
        ("np.linalg.norm(x)", {"np.linalg.norm"}),
        ("a @ b", {PRODUCT}),
        ("a @= b", {PRODUCT}),
        ("x ** y", {POWER}),
        ("x **= 0.5", {POWER}),
        ("x ** 3", {POWER}),
        ("2.0 ** -math.ceil(x)", {POWER}),
        ("x ** 2 + 2.0 ** -24 + 2 ** BITS + math.sqrt(x) + np.floor(x)", set()),
        ("try: pass\nexcept np.linalg.LinAlgError: pass", set()),
    ],
)
def test_what_is_found(source, wanted):
    assert set(inexact(ast.parse(source))) == wanted


def test_in_kernels_whole_exponents_are_multiplications():
    assert set(inexact(ast.parse("x ** 3"), compiled=True)) == set()
    assert set(inexact(ast.parse("x ** 3.0 + x ** y"), compiled=True)) == {POWER}
