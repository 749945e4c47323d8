"""Compiles programs: code that is loaded into the nodes, and becomes part of their ray step. `docs/programs.md` is for users.

A program is the text of a module with some of these functions, and whatever they call:

    surface_hits(origin, direction, numbers)    where a ray meets the surface: four distances, inf for none
    surface_normal(point, numbers)              its normal there
    tint(point, normal, numbers)                the colour by which the light of a material with a rule is multiplied
    background(direction)                       what rays see that leave the scene

It travels as an order of a wave, over the links between neighbours. Every node checks its digest and its form, compiles
it and tries it; a second wave makes all use it, once every node was content. Compiled code is kept on disk in a directory
of the program's own beside that of the kernels; a lock there lets one process of a computer compile it, and the others
load it.

It is code of whoever wrote it, run with the rights of whoever runs the array: nodes refuse programs unless they were
launched to take them.
"""

from __future__ import annotations

import ast
import contextlib
import fcntl
import hashlib
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from raygrid.node.errors import ProtocolError
from raygrid.node.jit import cache
from raygrid.node.jit.decorators import part
from raygrid.node.programs.powers import with_safe_powers

HOOKS: dict[str, tuple[str, ...]] = {
    "surface_hits": ("origin", "direction", "numbers"),
    "surface_normal": ("point", "numbers"),
    "tint": ("point", "normal", "numbers"),
    "background": ("direction",),
}
MAX_SOURCE = 1 << 20  # bytes
MODULES = ("math", "numpy")  # what a program may import


class Program(NamedTuple):
    """A program as it travels.

    name    for messages
    source  the text of the module
    hooks   which of HOOKS it has
    digest  SHA-256 of the source, in hexadecimal
    """

    name: str
    source: str
    hooks: frozenset[str]
    digest: str


class Compiled(NamedTuple):
    """A program in the ray step: functions that take the place of `step.step` and `background.add_missed`."""

    program: Program
    step: Callable[..., Any]
    add_missed: Callable[..., Any]


def digest_of(source: str) -> str:
    """The digest of a program's text."""
    return hashlib.sha256(source.encode()).hexdigest()


def make_program(name: str, source: str) -> Program:
    """Check the form of a program, without running it. Raises ProtocolError that says what is wrong, and where."""
    if len(source.encode()) > MAX_SOURCE:
        raise ProtocolError(f"the program {name} has more than {MAX_SOURCE} bytes")
    try:
        tree = ast.parse(source)
    except (SyntaxError, ValueError, RecursionError) as error:
        raise ProtocolError(f"the program {name} cannot be read: {error}") from None
    functions = {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}
    for node in ast.walk(tree):
        if not isinstance(node, ast.Import | ast.ImportFrom):
            continue
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        names += [str(node.module)] if isinstance(node, ast.ImportFrom) else []
        for module in names:
            if module not in MODULES:
                raise ProtocolError(
                    f"the program {name}, line {node.lineno}: it imports {module}, wanted {' or '.join(MODULES)}"
                )
    for hook, wanted in HOOKS.items():
        if hook in functions:
            came = ast.unparse(functions[hook].args)
            if came != ", ".join(wanted) or functions[hook].decorator_list:
                raise ProtocolError(
                    f"the program {name}, line {functions[hook].lineno}: {hook}({came}) came, "
                    f"wanted {hook}({', '.join(wanted)}) without decorators"
                )
    hooks = frozenset(functions) & frozenset(HOOKS)
    if not hooks or ("surface_hits" in hooks) != ("surface_normal" in hooks):
        came = ", ".join(sorted(hooks)) or "none"
        raise ProtocolError(
            f"the program {name} has {came} of the functions {', '.join(HOOKS)}, wanted one at least, "
            "and surface_hits together with surface_normal"
        )
    return Program(name, source, hooks, digest_of(source))


def program_order(program: Program | None) -> dict[str, str]:
    """The order that lets every node make a program ready; of None, the step without one."""
    if program is None:
        return {"do": "program", "name": "", "source": "", "digest": ""}
    return {"do": "program", "name": program.name, "source": program.source, "digest": program.digest}


def read_program(order: Mapping[str, object]) -> Program | None:
    """The program of an order. Raises ProtocolError for a wrong digest or form."""
    name, source, digest = order.get("name"), order.get("source"), order.get("digest")
    if not (isinstance(name, str) and isinstance(source, str) and isinstance(digest, str) and len(name) <= 200):
        raise ProtocolError("a program came without a name, a text or a digest")
    if not source and not digest:
        return None
    if digest_of(source) != digest:
        raise ProtocolError(
            f"the program {name} came with the digest {digest[:16]}, its text has {digest_of(source)[:16]}"
        )
    return make_program(name, source)


# --- compiling -------------------------------------------------------------------------------------------


def compiled(program: Program, attempt: Callable[[Compiled], None]) -> Compiled:
    """A program in the ray step. `attempt` calls what is to be compiled.

    One process of this computer compiles, others wait for it and load what it has left on disk. Raises ProtocolError
    with what the program or the compiler said.
    """
    try:
        with _directory(program) as file:
            made = _linked(program, file)
            attempt(made)
            return made
    except ProtocolError:
        raise
    except RecursionError:
        raise ProtocolError(f"the program {program.name} calls itself too deep") from None
    except Exception as error:
        raise ProtocolError(f"the program {program.name} fails: {_said(error, program)}") from None


def _said(error: Exception, program: Program) -> str:
    """An error in one line: what it is, and of numba's long ones what they begin with and the line of the program."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    at = [line for line in lines if program.digest in line and "line" in line]
    where = "" if not at else ", line " + at[-1].split("line")[-1].strip(" ():.")
    what = [line for line in lines if not line.startswith(("Failed in", "-", "During:", "File ", "^"))]
    return f"{type(error).__name__}{where}: {' '.join(what[:2])[:300]}"


@contextlib.contextmanager
def _directory(program: Program) -> Iterator[Path]:
    """Within, kernels are cached in the program's own directory, by one process at a time until it is known to be full.

    Gives the file of the program's text there: numba wants to know where a function came from.
    """
    if cache.DIRECTORY is None:
        why = f"there is no directory for compiled code ({cache.KEEPING.why}); {cache.REMEDY}"
        raise ProtocolError(f"the program {program.name} cannot be compiled: {why}")
    with cache.apart(f"program-{program.digest[:32]}") as directory:
        place = Path(directory)
        file, full = place / f"{program.digest}.py", place / "full"
        if full.exists() and file.exists():
            yield file
            return
        if not cache.KEEPING.writable:
            raise ProtocolError(
                f"the program {program.name} cannot be compiled: {place} cannot be written; {cache.REMEDY}"
            )
        if not file.exists():
            cache.write_whole(str(file), program.source.encode())
        with open(place / "lock", "wb") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield file
            full.touch()


def _linked(program: Program, file: Path) -> Compiled:
    """Run the text of a program, and make a ray step with its functions in it. Nothing is compiled yet."""
    # a front end knows programs, and traces no ray
    from raygrid.node.programs.hooks import parts_of
    from raygrid.node.tracing.background import make_add_missed
    from raygrid.node.tracing.step import make_step

    module = ModuleType(f"raygrid_program_{program.digest[:16]}")
    sys.modules[module.__name__] = module  # numba imports it by this name when it takes a function from the cache
    own = module.__dict__
    own["__file__"] = str(file)
    exec(compile(with_safe_powers(program.source, own), str(file), "exec"), own)
    for name, value in list(own.items()):
        if callable(value) and getattr(value, "__module__", None) == own["__name__"]:
            own[name] = part(value)
    parts = parts_of({hook: own[hook] for hook in program.hooks})
    return Compiled(program, make_step(parts), make_add_missed(parts.edge_colour))


# --- the form of hooks' results ---------------------------------------------------------------------------


def try_functions(program: Program) -> None:
    """Call a program's functions as Python, on plain numbers. Raises ProtocolError if one raises or gives the wrong
    number of numbers."""
    own: dict[str, Any] = {"__name__": "raygrid_program"}
    numbers = (0.5,) * 8
    arguments: dict[str, tuple[Any, ...]] = {
        "surface_hits": ((0.1, 0.2, 0.3), (0.6, 0.0, 0.8), numbers),
        "surface_normal": ((0.1, 0.2, 0.3), numbers),
        "tint": ((0.1, 0.2, 0.3), (0.0, 0.0, 1.0), numbers),
        "background": ((0.6, 0.0, 0.8),),
    }
    wanted = {"surface_hits": 4, "surface_normal": 3, "tint": 3, "background": 3}
    name = "its text"
    try:
        with np.errstate(all="ignore"):
            exec(compile(program.source, program.name, "exec"), own)
            for name in sorted(program.hooks):
                result = own[name](*arguments[name])
                if not (isinstance(result, tuple) and len(result) == wanted[name] and all(map(_is_number, result))):
                    raise ProtocolError(
                        f"the program {program.name}: {name} gives {result!r}, wanted {wanted[name]} numbers in a tuple"
                    )
    except ZeroDivisionError:
        return  # compiled code goes on with inf
    except ProtocolError:
        raise
    except Exception as error:
        raise ProtocolError(f"the program {program.name} raises in {name}: {type(error).__name__}: {error}") from None


def _is_number(value: object) -> bool:
    return isinstance(value, int | float | np.floating | np.integer) and not (
        isinstance(value, int) and abs(value) > 2**53
    )
