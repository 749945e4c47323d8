"""Which functions are kernels, and which of their lines count, is read from sources and a report of coverage."""

import ast
import sys

import pytest
from support import paths

sys.path.insert(0, str(paths.ROOT / "benchmarks"))
import kernel_coverage

TEXT = """
@part
def compiled(a):
    return a

@formula(takes=(F64,), gives=F64)
def written_once(a: Lanes):
    def inner(b):
        return b
    return inner(a)

def staged(p: Three):
    return p

def plain(a):
    return a

class Holder:
    def method(self):
        return 1
"""


def test_kernels_are_told_by_decorators_and_by_what_formulas_are_given():
    found = dict(kernel_coverage.kernels(ast.parse(TEXT)))
    assert found == {
        "compiled": True,
        "written_once": True,
        "written_once.inner": False,
        "staged": True,
        "plain": False,
    }


def test_lines_of_kernels_alone_count(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(kernel_coverage, "ROOT", tmp_path)
    (tmp_path / "a.py").write_text(TEXT)
    lines = {"executed_lines": [1, 2, 3], "missing_lines": [4]}
    report = {"files": {"a.py": {"functions": {"compiled": lines, "plain": {**lines, "missing_lines": [9, 9]}}}}}
    found = kernel_coverage.count(report)
    assert found == {"a.py": (4, 3, [4])}
    assert kernel_coverage.tell(found) == pytest.approx(75.0)
    assert "75.0%" in capsys.readouterr().out
