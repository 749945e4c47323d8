"""Reads the source tree: modules, what they import, what they define; and the rules of imports, each a function over a tree.

Modules are named by their path, so `node.geometry.lattice` is node/geometry/lattice.py; `raygrid.` is left out. A rule returns
the faults that it finds, a sentence each, which begins with the module at fault.
"""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

LAYERS = ("node", "emulator", "host")  # a layer imports itself and those before it
FACADE = "host.facade"  # what is installed as `raygrid` itself


class Import(NamedTuple):
    """`from source import name`; `import source` has no name. Sources above a module's own package begin with a dot."""

    source: str
    name: str
    line: int


class Module(NamedTuple):
    """One source file. `faces`: of a package with a stub, the name that it gives to others -> the module that has it."""

    name: str
    path: Path
    source: str
    tree: ast.Module
    imports: tuple[Import, ...]
    faces: Mapping[str, str]

    @property
    def is_package(self) -> bool:
        return self.path.name == "__init__.py"

    @property
    def layer(self) -> str:
        return self.name.partition(".")[0]


Modules = Mapping[str, Module]
Chains = Mapping[str, tuple[str, ...]]
Edge = tuple[str, str]


def read_modules(root: Path) -> dict[str, Module]:
    """All modules of the layers below a root."""
    found = {}
    for layer in LAYERS:
        for path in sorted((root / layer).rglob("*.py")):
            parts = path.relative_to(root).with_suffix("").parts
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            source = path.read_text()
            tree = ast.parse(source, str(path))
            found[name] = Module(name, path, source, tree, tuple(_imports(tree)), _faces(name, path))
    return {
        name: module._replace(imports=tuple(_opened(module.imports, module.tree, found)))
        for name, module in found.items()
    }


def _imports(tree: ast.Module) -> Iterator[Import]:
    """Every import of ours, in functions and of types alone, too."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.split(".")[0] == "raygrid":
                    yield Import(alias.name.removeprefix("raygrid").removeprefix("."), "", node.lineno)
        elif isinstance(node, ast.ImportFrom):
            for alias in node.names:
                if node.level:
                    yield Import("." * node.level + (node.module or ""), alias.name, node.lineno)
                elif node.module and node.module.split(".")[0] == "raygrid":
                    yield Import(node.module.removeprefix("raygrid").removeprefix("."), alias.name, node.lineno)


def _opened(imports: tuple[Import, ...], tree: ast.Module, modules: Mapping[str, Module]) -> Iterator[Import]:
    """The same, but of a package that is imported whole and has a face, each of its names that the module uses."""
    for taken in imports:
        package = f"{taken.source}.{taken.name}"
        if package in modules and modules[package].faces:
            for node in ast.walk(tree):
                if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == taken.name:
                    yield Import(package, node.attr, node.lineno)
        else:
            yield taken


def _faces(package: str, path: Path) -> dict[str, str]:
    """Names that a package's stub lists, and their modules."""
    stub = path.with_suffix(".pyi")
    if path.name != "__init__.py" or not stub.is_file():
        return {}
    nodes = (node for node in ast.parse(stub.read_text()).body if isinstance(node, ast.ImportFrom))
    return {
        alias.asname or alias.name: f"{package}.{node.module}" if node.module else f"{package}.{alias.name}"
        for node in nodes
        for alias in node.names
    }


def target(modules: Modules, taken: Import) -> str:
    """The module that an import reaches: a submodule, the module behind a face, or the source itself."""
    inner = f"{taken.source}.{taken.name}".removeprefix(".")
    if inner in modules:
        return inner
    source = taken.source or FACADE
    if source in modules and taken.name in modules[source].faces:
        return modules[source].faces[taken.name]
    return source


def edges(modules: Modules) -> set[Edge]:
    """(module, module that it imports), without those that no file is behind."""
    all_edges = {(module.name, target(modules, taken)) for module in modules.values() for taken in module.imports}
    return {(a, b) for a, b in all_edges if a != b and b in modules}


# --- rules of imports --------------------------------------------------------------------------------------


def relative_imports(modules: Modules) -> list[str]:
    """Sources name what they import in full, so that a reader and a search find it."""
    return [
        f"{module.name}:{taken.line} imports {taken.source!r}, which is relative"
        for module in modules.values()
        for taken in module.imports
        if taken.source.startswith(".")
    ]


def unknown_imports(modules: Modules) -> list[str]:
    """Every module of ours that is imported is there."""
    return [
        f"{module.name}:{taken.line} imports {taken.source}, which is not there"
        for module in modules.values()
        for taken in module.imports
        if not taken.source.startswith(".") and (taken.source or FACADE) not in modules
    ]


def wrong_layers(modules: Modules) -> list[str]:
    """A layer imports only itself and the layers below."""
    return [
        f"{a} imports {b}, a layer above its own"
        for a, b in sorted(edges(modules))
        if LAYERS.index(_layer(a)) < LAYERS.index(_layer(b))
    ]


def against_chains(modules: Modules, chains: Chains) -> list[str]:
    """Within a layer a package imports itself and those before it in the chain; every package stands in the chain."""
    faults = [
        f"{name} is in no place of the chain of {_layer(name)}"
        for name in modules
        if name not in LAYERS and _room(name) not in chains[_layer(name)]
    ]
    for a, b in sorted(edges(modules)):
        if _layer(a) == _layer(b) and a not in LAYERS and b not in LAYERS:
            chain = chains[_layer(a)]
            if _room(a) in chain and _room(b) in chain and chain.index(_room(a)) < chain.index(_room(b)):
                faults.append(f"{a} imports {b}, which comes after it in the chain of {_layer(a)}")
    return faults


def past_faces(modules: Modules, open_modules: Collection[str]) -> list[str]:
    """A layer takes from another only what its packages' faces give, but for modules that are open to all."""
    faults = []
    for module in modules.values():
        for taken in module.imports:
            reached = target(modules, taken)
            if taken.source.startswith(".") or _layer(reached) == module.layer or reached in open_modules:
                continue
            given = taken.source in modules and taken.name in modules[taken.source].faces
            if not given:
                faults.append(
                    f"{module.name}:{taken.line} takes {taken.name or 'all'} from {taken.source}, past its face"
                )
    return faults


def unused_openings(modules: Modules, open_modules: Collection[str]) -> list[str]:
    """Modules that are said to be open to all, and that no other layer imports."""
    used = {b for a, b in edges(modules) if _layer(a) != _layer(b)}
    return [f"{name} is listed as open, and no other layer imports it" for name in sorted(set(open_modules) - used)]


def unused_faces(modules: Modules, without: Collection[str] = ()) -> list[str]:
    """Names in a package's stub that no other layer takes; without: `package.name` of some that stay all the same."""
    unused = _untaken(modules) - set(without)
    return [f"{name} is in the stub of its package, and no other layer takes it" for name in sorted(unused)]


def stale_faces(modules: Modules, known: Collection[str]) -> list[str]:
    """Names that are said to be taken by no other layer, and are taken or gone."""
    return [f"{name} is taken, or in no stub" for name in sorted(set(known) - _untaken(modules))]


def _untaken(modules: Modules) -> set[str]:
    taken = {
        f"{taken.source}.{taken.name}"
        for module in modules.values()
        for taken in module.imports
        if _layer(taken.source) != module.layer
    }
    return {f"{module.name}.{name}" for module in modules.values() for name in module.faces} - taken


def cycles(modules: Modules, without: Collection[Edge] = ()) -> list[str]:
    """Modules that import each other, over however many; imports of types alone count, and those in functions."""
    return [f"{' '.join(ring)} import each other" for ring in _rings(edges(modules) - set(without))]


def stale_cycles(modules: Modules, known: Collection[Edge]) -> list[str]:
    """Imports that are said to close a cycle, and no longer do."""
    rings = _rings(edges(modules))
    return [
        f"{a} -> {b} closes no cycle" for a, b in sorted(known) if not any(a in ring and b in ring for ring in rings)
    ]


def past_fences(modules: Modules, fences: Mapping[str, tuple[str, ...]]) -> list[str]:
    """The insides of a library are named only in the packages and modules that a fence lets in.

    fences  the inside, a dotted name -> who may name it
    In imports, behind the name of an imported library (`numba.core`), and in strings that an import could be made of.
    """
    faults = []
    for module in modules.values():
        named = list(_foreign_names(module.tree))
        for inside, places in fences.items():
            if any(f"{module.name}.".startswith(f"{place}.") for place in places):
                continue
            lines = {line for name, line in named if f"{name}.".startswith(f"{inside}.")}
            faults += [
                f"{module.name}:{line} names {inside}, which is for {' and '.join(places)}" for line in sorted(lines)
            ]
    return faults


def _foreign_names(tree: ast.Module) -> Iterator[tuple[object, int]]:
    """(dotted name, line) of everything that may be of another library."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield from ((f"{node.module}.{alias.name}", node.lineno) for alias in node.names)
        elif isinstance(node, ast.Attribute):
            yield ast.unparse(node), node.lineno
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and "." in node.value:
            yield node.value, node.lineno  # a dotted name, if it is one
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith(("import_module", "__import__")):
            yield from ((one.value, node.lineno) for one in node.args if isinstance(one, ast.Constant))


def typed_pointers(modules: Modules) -> list[str]:
    """Whoever writes LLVM's instructions by llvmlite gives pointers no types, and says what is read and stepped over, as
    llvmlite is going to drop pointers that know it."""
    return [
        f"{module.name}:{line} {what}"
        for module in modules.values()
        if any(str(name).startswith("llvmlite") for name, _ in _foreign_names(module.tree))
        for line, what in sorted(_uses_of_types(module.tree))
    ]


def _uses_of_types(tree: ast.Module) -> Iterator[tuple[int, str]]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and node.attr in ("as_pointer", "pointee"):
            yield node.lineno, f"uses {node.attr}"
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            named = {keyword.arg for keyword in node.keywords}
            if node.func.attr == "gep" and "source_etype" not in named:
                yield node.lineno, "steps over what a pointer points to: gep without source_etype"
            elif node.func.attr == "load" and "typ" not in named and ast.unparse(node.func.value).endswith("builder"):
                yield node.lineno, "reads what a pointer points to: load without typ"
            elif node.func.attr == "PointerType" and node.args:
                yield node.lineno, "makes a pointer of a type"


def crowded_rooms(modules: Modules, most: int) -> list[str]:
    """A package has no more than so many modules of its own."""
    sizes = Counter(name.rpartition(".")[0] for name, module in modules.items() if not module.is_package)
    return [f"{room} has {count} modules, more than {most}" for room, count in sizes.items() if count > most]


def packages_that_say_nothing(modules: Modules) -> list[str]:
    """Every package says in its docstring what lives there."""
    said = {module.name for module in modules.values() if module.is_package and ast.get_docstring(module.tree)}
    packages = {module.name if module.is_package else name.rpartition(".")[0] for name, module in modules.items()}
    return [f"{package} has no __init__.py that says what lives there" for package in sorted(packages - said)]


def _layer(name: str) -> str:
    return name.partition(".")[0]


def _room(name: str) -> str:
    return name.split(".")[1]


def _rings(all_edges: set[Edge]) -> list[list[str]]:
    """Sets of modules each of which reaches all others of its set, over imports."""
    after: dict[str, set[str]] = {}
    for a, b in all_edges:
        after.setdefault(a, set()).add(b)
    reach = {name: reached(name, after) for name in after}
    rings = {frozenset(b for b in reach[a] if a in reach.get(b, ())) for a in reach if a in reach[a]}
    return sorted(sorted(ring) for ring in rings)


def reached(start: str, after: Mapping[str, set[str]]) -> set[str]:
    found: set[str] = set()
    waiting = [start]
    while waiting:
        fresh = after.get(waiting.pop(), set()) - found
        found |= fresh
        waiting += fresh
    return found
