"""Which functions are kernels, and which of their lines count, is read from sources and a report of coverage."""

import ast
import sys

import pytest
from support import paths

sys.path.insert(0, str(paths.ROOT / "benchmarks"))
import kernel_coverage
from kernel_functions import kernels

TEXT = """
@part
def compiled(a):
    return a

@formula(takes=(F64,), gives=F64)
def written_once(a):
    def inner(b):
        return b
    return inner(a)

@jit.eight(takes=_TAKES)
def by_eights(a):
    pass

def staged(p, n: tuple[lanes.Lanes, ...]):
    return p

def told_apart(planes: ThreePlanes):
    return planes

@made_of_parts
def make_step(parts):
    @part
    def step(a):
        return a
    return step

def both(a):
    return a

both_part = part(both)

def plain(a):
    return both(a)

class Holder:
    @part
    def method(self):
        return 1
"""


def test_kernels_are_told_by_decorators_by_calls_and_by_what_formulas_are_given():
    found = set(kernels(ast.parse(TEXT)))
    assert found == {"compiled", "written_once", "by_eights", "staged", "make_step.step", "both"}


def test_lines_of_kernels_alone_count(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(kernel_coverage, "ROOT", tmp_path)
    (tmp_path / "a.py").write_text(TEXT)
    lines = {"executed_lines": [1, 2, 3], "missing_lines": [4]}
    report = {"files": {"a.py": {"functions": {"compiled": lines, "plain": {**lines, "missing_lines": [9, 9]}}}}}
    found = kernel_coverage.count(report)
    assert found == {"a.py": (4, 3, [4])}
    assert kernel_coverage.tell(found) == pytest.approx(75.0)
    assert "75.0%" in capsys.readouterr().out
