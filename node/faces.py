"""Gives other layers what a package's stub (`__init__.pyi`) lists, each name loaded when it is first used.

Type checkers read the stub, too, so what a package gives stands once. Its lines are all of one form,
`from .lattice import Cell as Cell`, so it is read word by word, and only when a name is asked for: a parser would take ten
times as long, in every process that imports the package.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from sys import modules


def read_stub(text: str) -> dict[str, str]:
    """Read what a stub lists: name -> the module of the package that has it. Raises ValueError for a line of another form."""
    found = {}
    for line in text.splitlines():
        module, _, name = line.removeprefix("from .").partition(" import ")
        name = name.partition(" ")[0]
        if line != f"from .{module} import {name} as {name}":
            raise ValueError(f"a stub has the line {line!r}, wanted 'from .module import name as name'")
        found[name] = module
    return found


def face(package: str, file: str) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """Make `__getattr__` and `__dir__` of a package from its `__name__` and `__file__`; the stub lies beside that file."""
    listed: dict[str, str] = {}

    def names() -> dict[str, str]:
        if not listed:
            with open(f"{file}i", encoding="utf-8") as stub:
                listed.update(read_stub(stub.read()))
        return listed

    def get(name: str) -> object:
        if name.startswith("__") or name not in names():
            raise AttributeError(f"{package} gives no {name}")
        value = getattr(import_module(f"{package}.{names()[name]}"), name)
        setattr(modules[package], name, value)  # so that it is asked for once
        return value

    return get, lambda: sorted(names())
