"""Kernels made of parts: told apart by what they hold, the same name in every process, found again on disk."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from raygrid.node.jit.closures import name_closure

MADE = """
from numba.core import event
from raygrid.node.jit.decorators import lean, part
compiled = []
class Listener(event.Listener):
    def on_start(self, event):
        compiled.append(event.data["dispatcher"].py_func.__name__)
    def on_end(self, event):
        pass
@part
def twice(x):
    return 2.0 * x
@part
def thrice(x):
    return 3.0 * x
def make(inner, offset):
    @part
    def middle(x):
        return inner(x) + offset
    @lean
    def outer(x):
        return middle(x) * 10.0
    return outer
if __name__ == "__main__":
    with event.install_listener("numba:compile", Listener()):
        found = [make(inner, offset)(1.0) for inner in (twice, thrice) for offset in (0.5, 0.25)]
    print(found, sorted(compiled))
"""
WANTED = "[25.0, 22.5, 35.0, 32.5]"


def make(held):
    def inner():
        return held

    name_closure(inner)
    return inner.__qualname__


def test_names_tell_what_is_held():
    names = [make(held) for held in (1, 2, 1.0, True, "1", len, make, test_names_tell_what_is_held)]
    assert len(set(names)) == len(names)
    assert make(2) == names[1]
    assert all(name.startswith("make.<locals>.inner_") for name in names)


def test_a_function_that_holds_nothing_keeps_its_name():
    name_closure(make)
    assert make.__qualname__ == "make"


def test_what_has_no_words_is_refused():
    with pytest.raises(TypeError, match=r"a compiled function holds \[1\], wanted functions and numbers"):
        make([1])


def test_what_was_made_is_loaded_in_another_process(tmp_path: Path):
    script = tmp_path / "made.py"
    script.write_text(MADE)

    def run() -> str:
        command = [sys.executable, str(script)]
        environment = {"RAYGRID_CACHE": str(tmp_path / "kernels"), "PATH": "/usr/bin:/bin"}
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.strip()

    first = run()
    assert first == f"{WANTED} {sorted(['middle', 'outer'] * 4 + ['thrice', 'twice'])}"
    assert run() == f"{WANTED} []"
